//! Pixels as means over the filter: what a filter says a half-covered pixel is, many samples say too.

use glam::DVec3;
use heliostat::scene::Camera;
use heliostat::settings::{Crop, Filter};

use crate::tiny::*;

const FILTERS: [Filter; 4] = [Filter::Box, Filter::Tent, Filter::Gaussian, Filter::Mitchell];

/// The filter's integral from minus infinity to `x` pixels from the centre, by its antiderivative.
fn below(filter: Filter, x: f64) -> f64 {
    let from_center = |x: f64| match filter {
        Filter::Box => x.min(0.5),
        Filter::Tent => {
            let x = x.min(1.0);
            x - x * x / 2.0
        }
        Filter::Gaussian => {
            // exp(-2 x²) less its value at 1.5.
            let integral = |x: f64| {
                (std::f64::consts::PI / 8.0).sqrt() * libm::erf(std::f64::consts::SQRT_2 * x)
                    - libm::exp(-4.5) * x
            };
            0.5 * integral(x.min(1.5)) / integral(1.5)
        }
        Filter::Mitchell => {
            let inner = |x: f64| (1.75 * x * x * x * x - 4.0 * x * x * x + 16.0 / 3.0 * x) / 6.0;
            let outer = |x: f64| {
                (-7.0 / 12.0 * x * x * x * x + 4.0 * x * x * x - 10.0 * x * x + 32.0 / 3.0 * x) / 6.0
            };
            if x < 1.0 { inner(x) } else { inner(1.0) + outer(x.min(2.0)) - outer(1.0) }
        }
    };
    0.5 + if x < 0.0 { -from_center(-x) } else { from_center(x) }
}

/// The pixel at the middle of 3 x 3 over a glow in the quarter plane x < `east`, z < `south`, in pixels from its centre.
fn covered(filter: Filter, east: f64, south: f64) -> f64 {
    let mut tiny = Tiny::new(DVec3::Y, DVec3::ZERO).sized(3, 3);
    tiny.header.camera = Camera::orthographic(DVec3::Y, DVec3::ZERO, DVec3::NEG_Z, 3.0).unwrap();
    let glow = glowing([0.5; 3]);
    tiny.quad([v(-9.0, 0.0, south), v(east, 0.0, south), v(east, 0.0, -9.0), v(-9.0, 0.0, -9.0)], &glow);
    (tiny.image.filter, tiny.image.spp) = (filter, 65536);
    tiny.image.crop = Crop { x0: 1, y0: 1, x1: 2, y1: 2 };
    f64::from(tiny.render().pixels[0][0]) / 0.5
}

#[test]
fn integrals_of_the_filters_are_whole() {
    for filter in FILTERS {
        assert!(below(filter, -3.0).abs() < 1e-12 && (below(filter, 3.0) - 1.0).abs() < 1e-12, "{filter:?}");
        assert!((below(filter, 0.0) - 0.5).abs() < 1e-12);
    }
}

#[test]
fn a_partly_covered_pixel_is_the_filters_coverage() {
    for filter in FILTERS {
        let tolerance = if filter == Filter::Mitchell { 4e-4 } else { 1e-4 };
        for (east, south) in [(0.0, 9.0), (0.3, 9.0), (-0.8, 9.0), (1.3, 9.0), (9.0, 0.4), (9.0, -1.2)] {
            let expected = below(filter, east) * below(filter, south);
            let found = covered(filter, east, south);
            let expected = expected.max(0.0);
            assert!(
                (found.max(0.0) - expected).abs() < tolerance,
                "{filter:?} {east} {south}: {found}, not {expected}"
            );
        }
        for (east, south) in [(0.25, 0.375), (-0.25, 0.625), (0.75, -0.375)] {
            let expected = below(filter, east) * below(filter, south);
            let found = covered(filter, east, south);
            assert!(
                (found - expected).abs() < 2.0 * tolerance,
                "{filter:?} {east} {south}: {found}, not {expected}"
            );
        }
    }
}

#[test]
fn what_is_the_same_all_over_stays_so() {
    for filter in FILTERS {
        let found = covered(filter, 9.0, 9.0);
        assert!((found - 1.0).abs() < 1e-6, "{filter:?} {found}");
    }
}

#[test]
fn what_changes_evenly_is_what_the_centre_sees() {
    for filter in FILTERS {
        let mut tiny = Tiny::new(DVec3::Y, DVec3::ZERO).sized(2, 1);
        tiny.header.camera =
            Camera::orthographic(v(0.5, 1.0, 0.25), v(0.5, 0.0, 0.25), DVec3::NEG_Z, 2.0).unwrap();
        tiny.map(0.0);
        (tiny.image.filter, tiny.image.spp) = (filter, 4096);
        let image = tiny.render();
        for (pixel, x) in image.pixels.iter().zip([-0.5, 1.5]) {
            let color = pixel.map(f64::from);
            assert!((color[0] - (x / 16.0 + 0.5)).abs() < 2e-4, "{filter:?} {color:?}");
            assert!((color[1] - (0.25 / 16.0 + 0.5)).abs() < 2e-4, "{filter:?} {color:?}");
        }
    }
}
