//! Lobes, their table and Fresnel's equations against closed forms, finer integrals and what is documented.

use super::*;

#[test]
fn the_table_of_losses_is_close_to_what_it_stands_for() {
    let mut worst: [f64; 2] = [0.0; 2];
    for roughness in [0.02, 0.047, 0.11, 0.36, 0.55, 0.83, 0.98] {
        let (ggx, table) = (Ggx::new(roughness).unwrap(), Loss::new(roughness));
        let (mut sum, mut weight) = (0.0, 0.0);
        for step in 0..40 {
            let cosine = (f64::from(step) + 0.5) / 40.0;
            let error = table.at(cosine) - compensation::loss(ggx, cosine, 256, 64);
            worst[0] = worst[0].max(error.abs());
            sum += error * cosine;
            weight += cosine;
        }
        worst[1] = worst[1].max((sum / weight).abs());
    }
    assert!(worst[0] < 5e-3 && worst[1] < 1e-4, "{worst:?}");
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
fn conductors_reflect_as_computed_by_complex_numbers() {
    // |(cos θ - q) / (cos θ + q)|² and |(n² cos θ - q) / (n² cos θ + q)|² with q = √(n² - sin² θ), for n = 0.188 + 3.403i.
    for (cosine, expected) in
        [(1.0, 0.9421171261491811), (0.5, 0.9364813690497531), (0.1, 0.9631769694249128)]
    {
        let found = fresnel::conductor(cosine, 0.188, 3.403);
        assert!((found - expected).abs() < 1e-12, "{cosine}: {found}, not {expected}");
    }
    // Of a real index it is what a dielectric reflects.
    for cosine in VIEWS {
        let [metal, glass] = [
            fresnel::conductor(cosine, 1.5, 0.0),
            fresnel::dielectric(cosine, 1.0 / 1.5).unwrap().reflectance,
        ];
        assert!((metal - glass).abs() < 1e-12, "{cosine}: {metal}, {glass}");
        assert_eq!(fresnel::conductor(cosine, 0.0, 2.0), 1.0);
        assert!(fresnel::conductor(cosine, 0.0, 0.0).is_finite());
    }
    assert!(fresnel::conductor(1.0, 0.0, 0.0).is_finite());
}

#[test]
fn the_mean_reflectance_of_a_conductor_is_close() {
    for (eta, k) in [(0.188, 3.403), (1.332, 1.869), (0.054, 3.429), (1.43, 7.508), (0.0, 1.0), (3.0, 0.1)] {
        const STEPS: u32 = 10_000;
        let cosines = (0..STEPS).map(|step| (f64::from(step) + 0.5) / f64::from(STEPS));
        let mean = cosines.map(|c| 2.0 * c * fresnel::conductor(c, eta, k)).sum::<f64>() / f64::from(STEPS);
        let error = fresnel::conductor_mean(eta, k) - mean;
        assert!(error.abs() < 2e-3, "{eta} {k}: {error}");
    }
}

/// What single scattering at a rough boundary of glass loses, in the table of `docs/materials.md`.
#[test]
fn rough_glass_loses_what_is_documented() {
    let documented = [
        (0.2, [[0.000, 0.001, 0.049], [0.002, 0.005, 0.075]]),
        (0.5, [[0.008, 0.040, 0.109], [0.071, 0.174, 0.194]]),
        (1.0, [[0.107, 0.325, 0.580], [0.583, 0.526, 0.544]]),
    ];
    for (roughness, losses) in documented {
        for (entering, losses) in [(true, losses[0]), (false, losses[1])] {
            let case = glass(roughness, entering);
            for (cosine, loss) in [1.0, 0.5, 0.1].into_iter().zip(losses) {
                let found = 1.0 - case.total(view(cosine))[0];
                assert!((found - loss).abs() < 6e-4, "{}, {cosine}: {found}, not {loss}", case.name);
            }
        }
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
    let material = Material { ks: [0.7; 3], shininess: 9.0, ..DARK };
    let bsdf = Bsdf::new(&material, [1.0; 3], true);
    let albedo = case("", material, BLACK).total(DVec3::Z)[0];
    assert!((albedo - 0.7).abs() < 1e-6, "{albedo}");
    let peak = bsdf.evaluate(DVec3::Z, DVec3::Z).0[0];
    assert!((peak - 0.7 * 11.0 / (2.0 * PI)).abs() < 1e-12, "{peak}");
}
