//! Every lobe against what its definition says: densities integrate to the chance of a direction, sampled directions have them, mean
//! weights are the albedo, and light goes both ways alike. Each check is shown to fail on an error of half a per cent.

mod quadrature;
mod statistics;

use std::f64::consts::{PI, TAU};

use glam::DVec3;

use self::quadrature::{Four, Polar};
use self::statistics::{Random, chi_square, chi_square_limit, each_of, mean_and_error};
use super::{Bsdf, mean, specular};
use crate::scene::{Color, Material};
use crate::transport::BLACK;

const DARK: Material = Material {
    ka: BLACK,
    kd: BLACK,
    ks: BLACK,
    shininess: 32.0,
    kr: BLACK,
    kt: BLACK,
    ior: 1.5,
    reflectivity: 0.0,
    emission: BLACK,
    one_sided: false,
    fresnel: false,
    texture: None,
};

/// Cosines of the viewer's direction.
const VIEWS: [f64; 4] = [1.0, 0.8, 0.4, 0.08];

/// A surface that is looked at, and what its mirror and refraction give of a white world.
struct Case {
    name: String,
    bsdf: Bsdf,
    delta: Color,
}

fn case(name: impl Into<String>, material: Material, delta: Color) -> Case {
    Case { name: name.into(), bsdf: Bsdf::new(&material, [1.0; 3], true), delta }
}

fn cases() -> Vec<Case> {
    let mut cases = vec![
        case("diffuse", Material { kd: [0.8, 0.5, 0.0], ..DARK }, BLACK),
        case("mirror", Material { kr: [0.9, 0.5, 0.0], ..DARK }, [0.9, 0.5, 0.0]),
        case("window", Material { kt: [0.9, 0.5, 0.0], ior: 1.0, ..DARK }, [0.9, 0.5, 0.0]),
        case("glass", Material { kt: [1.0; 3], fresnel: true, ..DARK }, [1.0; 3]),
        case("blend", Material { kd: [0.6; 3], ks: [0.2; 3], reflectivity: 0.25, ..DARK }, [0.25; 3]),
    ];
    for shininess in [0.0, 3.5, 60.0, 4000.0] {
        let ks = [0.9, 0.6, 0.1];
        cases.push(case(format!("phong {shininess}"), Material { ks, shininess, ..DARK }, BLACK));
    }
    let (kd, ks, kr, kt) = ([0.3, 0.2, 0.1], [0.1, 0.2, 0.3], [0.1, 0.0, 0.1], [0.2; 3]);
    cases.push(case("all", Material { kd, ks, kr, kt, fresnel: true, ..DARK }, [0.3, 0.2, 0.3]));
    cases
}

fn view(cosine: f64) -> DVec3 {
    let sine = (1.0 - cosine * cosine).sqrt();
    DVec3::new(0.6 * sine, 0.8 * sine, cosine)
}

/// A direction, uniform over the sphere.
fn anywhere(random: &mut Random) -> DVec3 {
    let [z, phi]: [f64; 2] = [2.0 * random.number() - 1.0, TAU * random.number()];
    let sine = (1.0 - z * z).sqrt();
    DVec3::new(sine * libm::cos(phi), sine * libm::sin(phi), z)
}

fn four((value, pdf): (Color, f64)) -> Four {
    [value[0], value[1], value[2], pdf]
}

/// What `sample` gives on average: the weights of smooth lobes and the chance of one, the weights of delta lobes; each with
/// its standard error, from independent scramblings of a Sobol sequence.
fn averages(bsdf: &Bsdf, wo: DVec3) -> ([[f64; 2]; 4], [[f64; 2]; 3]) {
    const SETS: u32 = 16;
    const SAMPLES: u32 = 4096;
    let mut smooth = [const { Vec::new() }; 4];
    let mut delta = [const { Vec::new() }; 3];
    for set in 0..SETS {
        let (mut smooth_sum, mut delta_sum) = ([0.0; 4], [0.0; 3]);
        for sample in 0..SAMPLES {
            let u =
                [0, 1, 2].map(|dimension| f64::from(sobol_burley::sample(sample, dimension, set * 7919 + 1)));
            let Some(scattered) = bsdf.sample(wo, u) else { continue };
            let smooth = scattered.pdf.is_finite();
            for channel in 0..3 {
                let sum = if smooth { &mut smooth_sum[channel] } else { &mut delta_sum[channel] };
                *sum += scattered.weight[channel];
            }
            smooth_sum[3] += f64::from(smooth);
        }
        for (list, sum) in smooth.iter_mut().zip(smooth_sum).chain(delta.iter_mut().zip(delta_sum)) {
            list.push(sum / f64::from(SAMPLES));
        }
    }
    (smooth.map(|list| mean_and_error(&list)), delta.map(|list| mean_and_error(&list)))
}

/// Whether a mean may be `expected`. A Student variable of 15 degrees of freedom exceeds 6.5 once in 100,000 times.
fn agrees([mean, error]: [f64; 2], expected: f64) -> bool {
    (mean - expected).abs() <= 6.5 * error + 2e-5
}

/// The direction that lobes may be narrow around.
fn axis(wo: DVec3) -> DVec3 {
    specular::mirrored(wo)
}

#[test]
fn densities_integrate_to_the_chance_and_weights_to_the_albedo() {
    for Case { name, bsdf, delta } in cases() {
        for cosine in VIEWS {
            let wo = view(cosine);
            let total = Polar::about(axis(wo)).over_sphere(|wi| four(bsdf.evaluate(wo, wi)));
            let (smooth, mirrored) = averages(&bsdf, wo);
            for k in 0..4 {
                assert!(
                    agrees(smooth[k], total[k]),
                    "{name}, {cosine}, {k}: {:?}, not {}",
                    smooth[k],
                    total[k]
                );
                // Half a per cent more or less would be seen.
                let seen = [0.995, 1.005].map(|bias| !agrees(smooth[k], total[k] * bias));
                assert!(seen == [true; 2] || total[k] < 0.02, "{name}, {cosine}, {k}: {:?}", smooth[k]);
            }
            for k in 0..3 {
                assert!(agrees(mirrored[k], delta[k]), "{name}, {cosine}: {:?}, not {delta:?}", mirrored[k]);
                assert!(total[k] + delta[k] <= 1.0 + 1e-4, "{name}, {cosine}: {total:?} and {delta:?}");
            }
            assert!(total[3] <= 1.0 + 1e-5, "{name}, {cosine}: {total:?}");
            assert_eq!(bsdf.is_smooth(), total[3] > 0.0, "{name}");
        }
    }
}

/// χ² of sampled directions, and its limit. Numbers that are `bias` times what they should be must give more.
fn histogram(bsdf: &Bsdf, wo: DVec3, axis: DVec3, bias: f64, tests: usize) -> (f64, f64) {
    const SIZE: usize = 12;
    const SAMPLES: usize = 1 << 18;
    let polar = Polar::about(axis);
    let mut expected: Vec<f64> = polar
        .cells(SIZE, SIZE)
        .map(|cell| polar.integral(cell, 1e-7, &|wi| four(bsdf.evaluate(wo, wi)))[3] * SAMPLES as f64)
        .collect();
    expected.push(SAMPLES as f64 - expected.iter().sum::<f64>());
    let mut counted = vec![0.0; expected.len()];
    let mut random = Random(17);
    for _ in 0..SAMPLES {
        let [lobe, u, v] = random.numbers();
        let bin = match bsdf.sample(wo, [lobe, u * bias, v * bias]) {
            Some(scattered) if scattered.pdf.is_finite() => {
                let [t, phi] = polar.coordinates(scattered.wi);
                let place = |x: f64| ((x * SIZE as f64) as usize).min(SIZE - 1);
                place(t) * SIZE + place(phi / TAU)
            }
            _ => SIZE * SIZE,
        };
        counted[bin] += 1.0;
    }
    let (chi_square, freedom) = chi_square(&counted, &expected);
    (chi_square, chi_square_limit(freedom, each_of(tests)))
}

#[test]
fn sampled_directions_have_the_density() {
    let smooth: Vec<Case> = cases().into_iter().filter(|case| case.bsdf.is_smooth()).collect();
    let tests = smooth.len() * VIEWS.len();
    for Case { name, bsdf, .. } in &smooth {
        for cosine in VIEWS {
            let wo = view(cosine);
            let (found, limit) = histogram(bsdf, wo, axis(wo), 1.0, tests);
            assert!(found < limit, "{name}, {cosine}: χ² {found}, limit {limit}");
            let (found, limit) = histogram(bsdf, wo, axis(wo), 0.995, tests);
            assert!(found > limit, "{name}, {cosine}: half a per cent off gives only {found}, limit {limit}");
        }
    }
}

#[test]
fn a_sample_weighs_its_value_over_its_density() {
    let mut random = Random(5);
    for Case { name, bsdf, .. } in cases() {
        for cosine in VIEWS {
            let wo = view(cosine);
            for _ in 0..1000 {
                let Some(scattered) = bsdf.sample(wo, random.numbers()) else { continue };
                let wi = scattered.wi;
                assert!((wi.length() - 1.0).abs() < 1e-12, "{name}: {wi}");
                assert_eq!(scattered.transmitted, wi.z < 0.0, "{name}: {wi}");
                if scattered.pdf.is_finite() {
                    let (value, pdf) = bsdf.evaluate(wo, wi);
                    assert!((scattered.pdf / pdf - 1.0).abs() < 1e-9, "{name}: {} {pdf}", scattered.pdf);
                    for k in 0..3 {
                        assert!((scattered.weight[k] - value[k] / pdf).abs() < 1e-9, "{name}: {scattered:?}");
                    }
                }
            }
        }
    }
}

#[test]
fn reflection_is_reciprocal() {
    let mut random = Random(7);
    for Case { name, bsdf, .. } in cases() {
        for _ in 0..2000 {
            let [mut a, mut b] = [anywhere(&mut random), anywhere(&mut random)];
            (a.z, b.z) = (a.z.abs(), b.z.abs());
            let there = mean(bsdf.evaluate(a, b).0) / b.z;
            let back = mean(bsdf.evaluate(b, a).0) / a.z;
            // The tail of a narrow lobe is a high power of a number with a rounding error.
            assert!((there - back).abs() <= 1e-9 * there.max(back) + 1e-30, "{name}: {there}, {back}");
        }
    }
}

#[test]
fn a_white_world_stays_white() {
    let white = [
        case("diffuse", Material { kd: [1.0; 3], ..DARK }, BLACK),
        case("mirror", Material { kr: [1.0; 3], ..DARK }, BLACK),
        case("glass", Material { kt: [1.0; 3], fresnel: true, ..DARK }, BLACK),
    ];
    for Case { name, bsdf, .. } in white {
        for cosine in VIEWS {
            let (smooth, delta) = averages(&bsdf, view(cosine));
            for k in 0..3 {
                let albedo = smooth[k][0] + delta[k][0];
                assert!((albedo - 1.0).abs() < 1e-4, "{name}, {cosine}: {albedo}");
            }
        }
    }
}

#[test]
fn refraction_follows_snell_and_fresnel() {
    let glass = Material { kt: [1.0; 3], fresnel: true, ..DARK };
    let wo = view(0.6);
    let into = Bsdf::new(&glass, [1.0; 3], true).sample(wo, [0.999, 0.5, 0.5]).unwrap();
    assert!(into.transmitted && into.pdf == f64::INFINITY);
    // sin 0.8 / 1.5, on the other side of the normal and in the same plane.
    let expected = DVec3::new(-0.6 * 0.8 / 1.5, -0.8 * 0.8 / 1.5, -(1.0 - 0.64 / 2.25f64).sqrt());
    assert!((into.wi - expected).length() < 1e-15, "{}", into.wi);
    // Straight on 4 % are reflected: ((1.5 - 1) / (1.5 + 1))².
    for entering in [true, false] {
        let bsdf = Bsdf::new(&glass, [1.0; 3], entering);
        assert!(!bsdf.sample(DVec3::Z, [0.0399, 0.5, 0.5]).unwrap().transmitted);
        assert!(bsdf.sample(DVec3::Z, [0.0401, 0.5, 0.5]).unwrap().transmitted);
    }
    // From inside, beyond the critical angle of 41.8°, everything turns back.
    let out = Bsdf::new(&glass, [1.0; 3], false);
    for cosine in [0.74, 0.75] {
        let transmitted = out.sample(view(cosine), [0.999_999, 0.5, 0.5]).unwrap().transmitted;
        assert_eq!(transmitted, cosine > 0.745, "{cosine}");
    }
}

#[test]
fn nothing_comes_from_behind_but_straight_through() {
    let below = view(-0.2);
    for Case { name, bsdf, .. } in cases() {
        for u in [0.0, 0.3, 0.6, 0.999] {
            assert_eq!(bsdf.evaluate(below, DVec3::Z), (BLACK, 0.0), "{name}");
            match bsdf.sample(below, [u, 0.2, 0.7]) {
                Some(scattered) => assert_eq!((&name[..], scattered.wi), ("window", -below)),
                None => assert_ne!(name, "window"),
            }
        }
    }
}

#[test]
fn a_mirror_of_phong_gives_its_coefficient_back() {
    // The whole lobe is above the surface, where the cosine with the normal is that with the mirror direction.
    let bsdf = Bsdf::new(&Material { ks: [0.7; 3], shininess: 9.0, ..DARK }, [1.0; 3], true);
    let albedo = Polar::about(DVec3::Z).over_sphere(|wi| four(bsdf.evaluate(DVec3::Z, wi)))[0];
    assert!((albedo - 0.7).abs() < 1e-6, "{albedo}");
    let peak = bsdf.evaluate(DVec3::Z, DVec3::Z).0[0];
    assert!((peak - 0.7 * 11.0 / (2.0 * PI)).abs() < 1e-12, "{peak}");
}
