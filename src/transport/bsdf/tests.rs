//! Every lobe against what its definition says: densities integrate to the chance of a direction, sampled directions have them, mean
//! weights are the albedo, and light goes both ways alike. Densities, weights and histograms are shown to notice half a per cent.

mod closed_forms;
mod quadrature;
mod statistics;

use std::f64::consts::{PI, TAU};

use glam::DVec3;

use self::quadrature::{Four, Polar};
use self::statistics::{Random, chi_square, chi_square_limit, each_of, mean_and_error};
use super::compensation::{self, Loss};
use super::microfacet::Ggx;
use super::{Bsdf, fresnel, mean, specular};
use crate::scene::Color;
use crate::scene::material::{Material, Physical};
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
    physical: None,
};

/// How far the compensated albedo of a perfect mirror may be from 1.
const TABLE_ERROR: f64 = 1e-3;

/// Cosines of the viewer's direction.
const VIEWS: [f64; 4] = [1.0, 0.8, 0.4, 0.08];

/// A surface that is looked at, and what its mirror and refraction give of a white world.
struct Case {
    name: String,
    bsdf: Bsdf,
    delta: Color,
    /// Index on the viewer's side over the one behind, where radiance changes by its square on its way through; else 1.
    eta: f64,
    /// Whether a lobe is narrow, around [`axis`](Case::axis).
    narrow: bool,
}

fn case(name: impl Into<String>, material: Material, delta: Color) -> Case {
    let narrow = match material.physical {
        Some(Physical::Conductor { roughness, .. }) => roughness <= 0.2,
        _ => material.ks != BLACK && material.shininess > 20.0,
    };
    Case { name: name.into(), bsdf: Bsdf::new(&material, [1.0; 3], true), delta, eta: 1.0, narrow }
}

fn conductor(eta: Color, k: Color, roughness: f64) -> Material {
    Material { physical: Some(Physical::Conductor { eta, k, roughness }), ..DARK }
}

/// Johnson and Christy's gold.
fn gold(roughness: f64) -> Material {
    conductor([0.188, 0.544, 1.332], [3.403, 2.231, 1.869], roughness)
}

/// A conductor of an imaginary index reflects everything.
fn perfect(roughness: f64) -> Material {
    conductor([0.0; 3], [1.0; 3], roughness)
}

fn glass(roughness: f64, entering: bool) -> Case {
    let material = Material { physical: Some(Physical::Dielectric { roughness }), ..DARK };
    Case {
        name: format!("glass {roughness} {}", if entering { "from outside" } else { "from inside" }),
        bsdf: Bsdf::new(&material, [1.0; 3], entering),
        delta: if roughness == 0.0 { [1.0; 3] } else { BLACK },
        eta: if entering { 1.0 / 1.5 } else { 1.5 },
        narrow: roughness <= 0.2,
    }
}

fn cases() -> Vec<Case> {
    let mut cases = vec![
        case("black", DARK, BLACK),
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
    for roughness in [0.1, 0.35, 0.7, 1.0] {
        cases.push(case(format!("gold {roughness}"), gold(roughness), BLACK));
        cases.push(case(format!("perfect mirror {roughness}"), perfect(roughness), BLACK));
    }
    for roughness in [0.0, 0.2, 0.5, 1.0] {
        cases.extend([glass(roughness, true), glass(roughness, false)]);
    }
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

impl Case {
    /// Value and density; what has passed is measured in the radiance it would have on the viewer's side.
    fn four(&self, wo: DVec3, wi: DVec3) -> Four {
        let (value, pdf) = self.bsdf.evaluate(wo, wi);
        let [r, g, b] = self.measured(value, wi);
        [r, g, b, pdf]
    }

    fn measured(&self, value: Color, wi: DVec3) -> Color {
        value.map(|c| if wi.z < 0.0 { c / (self.eta * self.eta) } else { c })
    }

    /// The direction that a lobe on the upper or the lower side may be narrow around.
    fn axis(&self, wo: DVec3, upper: bool) -> DVec3 {
        match fresnel::dielectric(wo.z, self.eta) {
            _ if upper => specular::mirrored(wo),
            Some(boundary) => specular::refracted(wo, self.eta, boundary.behind),
            None => DVec3::NEG_Z,
        }
    }

    /// Coordinates for the lobes of each side that has some, and whether it is the upper one; of wide ones for both at once.
    fn polars(&self, wo: DVec3) -> Vec<(Polar, Option<bool>)> {
        match self.narrow {
            false => vec![(Polar::upright(), None)],
            true if self.eta == 1.0 => vec![(Polar::about(self.axis(wo, true)), None)],
            true => [true, false].map(|upper| (Polar::about(self.axis(wo, upper)), Some(upper))).into(),
        }
    }

    /// The integral of [`four`](Case::four).
    fn total(&self, wo: DVec3) -> Four {
        let mut sum = [0.0; 4];
        for (polar, side) in self.polars(wo) {
            let there = |wi: DVec3| side.is_none_or(|upper| (wi.z > 0.0) == upper);
            let part = polar.over_sphere(|wi| if there(wi) { self.four(wo, wi) } else { [0.0; 4] });
            sum = std::array::from_fn(|k| sum[k] + part[k]);
        }
        sum
    }
}

/// What `sample` gives on average: the weights of smooth lobes and the chance of one, the weights of delta lobes; each with
/// its standard error, from independent scramblings of a Sobol sequence.
fn averages(case: &Case, wo: DVec3) -> ([[f64; 2]; 4], [[f64; 2]; 3]) {
    const SETS: u32 = 16;
    const SAMPLES: u32 = 4096;
    let mut smooth = [const { Vec::new() }; 4];
    let mut delta = [const { Vec::new() }; 3];
    for set in 0..SETS {
        let (mut smooth_sum, mut delta_sum) = ([0.0; 4], [0.0; 3]);
        for sample in 0..SAMPLES {
            let u =
                [0, 1, 2].map(|dimension| f64::from(sobol_burley::sample(sample, dimension, set * 7919 + 1)));
            let Some(scattered) = case.bsdf.sample(wo, u) else { continue };
            let weight = case.measured(scattered.weight, scattered.wi);
            let smooth = scattered.pdf.is_finite();
            for channel in 0..3 {
                let sum = if smooth { &mut smooth_sum[channel] } else { &mut delta_sum[channel] };
                *sum += weight[channel];
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

#[test]
fn densities_integrate_to_the_chance_and_weights_to_the_albedo() {
    for case in cases() {
        let Case { name, bsdf, delta, .. } = &case;
        for cosine in VIEWS {
            let wo = view(cosine);
            let total = case.total(wo);
            let (smooth, mirrored) = averages(&case, wo);
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
                let albedo = total[k] + delta[k];
                let excess = if name.starts_with("perfect mirror") { TABLE_ERROR } else { 1e-4 };
                assert!(albedo <= 1.0 + excess, "{name}, {cosine}: {albedo}");
            }
            assert!(total[3] <= 1.0 + 1e-5, "{name}, {cosine}: {total:?}");
            assert_eq!(bsdf.is_smooth(), total[3] > 0.0, "{name}");
        }
    }
}

/// χ² of sampled directions, and its limit. Numbers that are `bias` times what they should be must give more.
fn histogram(case: &Case, wo: DVec3, polar: Polar, bias: f64, tests: usize) -> (f64, f64) {
    const SIZE: usize = 8;
    // The error is looked for harder.
    let samples = if bias == 1.0 { 1 << 16 } else { 1 << 20 };
    let mut expected: Vec<f64> = polar
        .cells(SIZE, SIZE)
        .map(|cell| polar.integral(cell, 1e-6, &|wi| case.four(wo, wi))[3] * samples as f64)
        .collect();
    expected.push(samples as f64 - expected.iter().sum::<f64>());
    let mut counted = vec![0.0; expected.len()];
    let mut random = Random(17);
    for _ in 0..samples {
        let [lobe, u, v] = random.numbers();
        let bin = match case.bsdf.sample(wo, [lobe, u * bias, v * bias]) {
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
    // A perfect mirror is sampled as gold is.
    let sampled = |case: &Case| case.bsdf.is_smooth() && !case.name.starts_with("perfect");
    let smooth: Vec<Case> = cases().into_iter().filter(sampled).collect();
    let tests = 6 * smooth.len();
    for case in &smooth {
        for cosine in [1.0, 0.4, 0.08] {
            for (polar, _) in case.polars(view(cosine)) {
                let (found, limit) = histogram(case, view(cosine), polar, 1.0, tests);
                assert!(found < limit, "{}, {cosine}: χ² {found}, limit {limit}", case.name);
            }
        }
    }
    // One of each kind.
    let kinds =
        ["diffuse", "phong 60", "gold 0.35", "glass 0.5 from outside", "glass 0.5 from inside", "all"];
    let of_kind = |case: &&Case| kinds.contains(&&case.name[..]);
    assert_eq!(smooth.iter().filter(of_kind).count(), kinds.len());
    for case in smooth.iter().filter(of_kind) {
        let wo = view(0.4);
        let (found, limit) = histogram(case, wo, case.polars(wo)[0].0, 0.995, tests);
        assert!(found > limit, "{}: half a per cent off gives {found}, limit {limit}", case.name);
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
fn refraction_is_reciprocal_but_for_the_square_of_the_index() {
    let mut random = Random(11);
    for roughness in [0.2, 0.5, 1.0] {
        let [outside, inside] = [true, false].map(|entering| glass(roughness, entering).bsdf);
        let mut seen = 0;
        for _ in 0..4000 {
            let [mut a, mut b] = [anywhere(&mut random), anywhere(&mut random)];
            (a.z, b.z) = (a.z.abs(), -b.z.abs());
            let there = outside.evaluate(a, b).0[0] / -b.z;
            // The same two directions with z on the other side.
            let back = inside.evaluate(-b, -a).0[0] / a.z / (1.5 * 1.5);
            assert!((there - back).abs() <= 1e-7 * there.max(back), "{roughness}: {there}, {back}");
            seen += u32::from(there > 0.0);
        }
        assert!(seen > 500, "{seen}");
    }
}

#[test]
fn a_white_world_stays_white() {
    let mut white = vec![
        (case("diffuse", Material { kd: [1.0; 3], ..DARK }, BLACK), 1e-4),
        (case("mirror", Material { kr: [1.0; 3], ..DARK }, BLACK), 1e-4),
        (case("classic glass", Material { kt: [1.0; 3], fresnel: true, ..DARK }, BLACK), 1e-4),
        (case("perfect mirror", perfect(0.0), BLACK), 1e-4),
        (glass(0.0, true), 1e-4),
        (glass(0.0, false), 1e-4),
    ];
    for roughness in [0.05, 0.1, 0.3, 0.5, 0.77, 1.0] {
        white.push((case(format!("perfect mirror {roughness}"), perfect(roughness), BLACK), TABLE_ERROR));
    }
    for (case, tolerance) in white {
        for cosine in VIEWS {
            let (smooth, delta) = averages(&case, view(cosine));
            for k in 0..3 {
                let albedo = smooth[k][0] + delta[k][0];
                assert!((albedo - 1.0).abs() < tolerance, "{}, {cosine}: {albedo}", case.name);
            }
        }
    }
}
