//! What stands between a surface and a light.

use glam::DVec3;
use heliostat::scene::light::LightShape;
use heliostat::scene::{Color, Material};

use crate::tiny::*;

const EYE: DVec3 = DVec3::new(6.0, 0.5, 0.0);
const LAMP: DVec3 = DVec3::new(0.25, 8.0, -0.5);

fn glass(kt: Color) -> Material {
    Material { kt, ior: 1.7, ..BLACK }
}

/// The light on a white floor at the origin below what `put` puts there, as a share of the unshadowed light; from a lamp and
/// from the same direction, endlessly far.
fn share(put: impl Fn(&mut Tiny)) -> [Color; 2] {
    let far = LightShape::Directional { direction: -LAMP.normalize() };
    [LightShape::Point { position: LAMP }, far].map(|shape| {
        let mut tiny = Tiny::new(EYE, DVec3::ZERO);
        tiny.level(0.0, &Material { kd: [1.0; 3], ..BLACK });
        put(&mut tiny);
        tiny.light(&shining(shape));
        let cosine = LAMP.normalize().y;
        tiny.color().map(|c| c / cosine)
    })
}

#[track_caller]
fn assert_share(found: [Color; 2], expected: Color) {
    found.into_iter().for_each(|found| assert_color(found, expected));
}

#[test]
fn opaque_surfaces_block_from_either_side() {
    assert_share(share(|_| ()), [1.0; 3]);
    assert_share(share(|tiny| tiny.patch([0.0, 4.0, 0.0], 2.0, &BLACK)), [0.0; 3]);
    let mut turned = square(3.0, 2.0);
    turned.reverse();
    assert_share(share(|tiny| tiny.quad(turned, &BLACK)), [0.0; 3]);
    assert_share(share(|tiny| tiny.sphere(v(0.0, 2.0, 0.0), 0.5, &BLACK)), [0.0; 3]);
    // A mirror that glows is opaque too.
    let mirror = Material { kr: [1.0; 3], emission: [0.5; 3], ..BLACK };
    assert_share(share(|tiny| tiny.patch([0.0, 4.0, 0.0], 2.0, &mirror)), [0.0; 3]);
}

#[test]
fn only_what_lies_between_blocks() {
    let [lamp, far] = share(|tiny| tiny.patch([0.0, 9.0, 0.0], 2.0, &BLACK));
    assert_color(lamp, [1.0; 3]);
    assert_color(far, [0.0; 3]);
    assert_share(share(|tiny| tiny.patch([0.0, -1.0, 0.0], 2.0, &BLACK)), [1.0; 3]);
    assert_share(share(|tiny| tiny.patch([3.0, 4.0, 0.0], 1.0, &BLACK)), [1.0; 3]);
}

#[test]
fn transparent_surfaces_weaken_by_the_product_of_their_kt() {
    let [a, b, c] = [[0.9, 0.5, 0.25], [0.3, 1.0, 0.75], [0.5, 0.0, 2.0]];
    let pane = |tiny: &mut Tiny, y: f64, kt: Color| tiny.patch([0.0, y, 0.0], 2.0, &glass(kt));
    assert_share(share(|tiny| pane(tiny, 2.0, a)), a);
    assert_share(
        share(|tiny| [(3.0, a), (1.0, b)].iter().for_each(|&(y, kt)| pane(tiny, y, kt))),
        product(a, b),
    );
    let three =
        |tiny: &mut Tiny| [(1.0, c), (2.0, a), (3.0, b)].iter().for_each(|&(y, kt)| pane(tiny, y, kt));
    assert_share(share(three), product(product(a, b), c));
    // A lamp's light doesn't pass what is behind it.
    let [lamp, far] = share(|tiny| [(1.0, a), (8.5, b)].iter().for_each(|&(y, kt)| pane(tiny, y, kt)));
    assert_color(lamp, a);
    assert_color(far, product(a, b));
    // Something opaque among them.
    for y in [0.5, 1.5, 3.5] {
        let shut = |tiny: &mut Tiny| {
            tiny.patch([0.0, y, 0.0], 2.0, &BLACK);
            [(1.0, a), (2.0, b)].iter().for_each(|&(y, kt)| pane(tiny, y, kt));
        };
        assert_share(share(shut), [0.0; 3]);
    }
}

#[test]
fn a_glass_sphere_is_passed_twice() {
    let kt = [0.9, 0.5, 0.25];
    let sphere = |tiny: &mut Tiny| tiny.sphere(v(0.0, 2.0, 0.0), 0.75, &glass(kt));
    assert_share(share(sphere), product(kt, kt));
    // One sphere within another.
    let both = |tiny: &mut Tiny| {
        sphere(tiny);
        tiny.sphere(v(0.0, 2.0, 0.0), 0.5, &glass([0.5; 3]));
    };
    assert_share(share(both), scaled(product(kt, kt), 0.25));
}

#[test]
fn each_of_two_coincident_surfaces_counts() {
    let [a, b] = [[0.9, 0.5, 0.25], [0.3, 1.0, 0.75]];
    let panes = |first: Material, second: Material| {
        move |tiny: &mut Tiny| {
            tiny.patch([0.0, 2.0, 0.0], 2.0, &first);
            tiny.patch([0.0, 2.0, 0.0], 2.0, &second);
        }
    };
    assert_share(share(panes(glass(a), glass(b))), product(a, b));
    assert_share(share(panes(glass(a), BLACK)), [0.0; 3]);
    assert_share(share(panes(BLACK, glass(a))), [0.0; 3]);
    let spheres = |tiny: &mut Tiny| {
        tiny.sphere(v(0.0, 2.0, 0.0), 0.75, &glass(a));
        tiny.sphere(v(0.0, 2.0, 0.0), 0.75, &glass(b));
    };
    let once = product(a, b);
    assert_share(share(spheres), product(once, once));
}

#[test]
fn a_double_of_the_lit_surface_casts_no_shadow_on_it() {
    let white = Material { kd: [1.0; 3], ..BLACK };
    assert_share(share(|tiny| tiny.level(0.0, &white)), [1.0; 3]);
    // With the corners in another order, and one that is transparent.
    assert_share(share(|tiny| tiny.level(0.0, &glass([0.5; 3]))), [1.0; 3]);

    let lit = |twice: bool| {
        let mut tiny = Tiny::new(v(0.0, 4.0, 3.0), v(0.0, 1.0, 0.0));
        (0..=u32::from(twice)).for_each(|_| tiny.sphere(DVec3::ZERO, 1.0, &white));
        tiny.light(&point_light(v(1.0, 4.0, 1.0)));
        tiny.color()
    };
    assert!(lit(false)[0] > 0.5);
    assert_eq!(lit(true), lit(false));
}

#[test]
fn seen_through_a_doubled_pane_it_counts_once() {
    // The refracted ray starts on one of the two, and both count as its start.
    let kt = [0.5, 0.25, 0.75];
    for doubles in 1..=2 {
        let mut tiny = Tiny::new(v(0.5, 3.0, 0.5), v(0.25, 1.0, 0.5));
        (0..doubles).for_each(|_| tiny.patch([0.0, 1.0, 0.0], 2.0, &glass(kt)));
        tiny.level(0.0, &glowing([1.0; 3]));
        assert_color(tiny.color(), kt);
    }
}
