//! Small spheres around many: Ritter 1990, "An Efficient Bounding Sphere", Graphics Gems, pp. 301-303, for spheres in the place of points.
//!
//! Some 5 % larger than the smallest, in four passes; exact for two points, boxes and spheres.

use super::{dot, sub};

/// Centre and radius; a point is a sphere of radius 0.
pub type Ball = ([f64; 3], f64);

/// The centre of a small sphere around all; the origin if there is nothing.
pub fn center(balls: impl Iterator<Item = Ball> + Clone) -> [f64; 3] {
    let farthest_from = |from: [f64; 3]| {
        balls.clone().map(|ball| (reach(from, ball), ball)).max_by(|a, b| a.0.total_cmp(&b.0))
    };
    let Some((some, _)) = balls.clone().next() else { return [0.0; 3] };
    // From any of them the farthest, and from that one again: nearly a diameter.
    let Some((_, first)) = farthest_from(some) else { return some };
    let Some((_, second)) = farthest_from(first.0) else { return some };
    // Then it grows to hold each that it doesn't, keeping what it has on its far side.
    let grow = |(center, radius): Ball, ball: Ball| {
        let across = reach(center, ball);
        if across <= radius {
            return (center, radius);
        }
        let away = sub(ball.0, center);
        let distance = dot(away, away).sqrt();
        let grown = (0.5 * (radius + across)).max(ball.1);
        let step = if distance > 0.0 { ((grown - radius) / distance).min(1.0) } else { 0.0 };
        (std::array::from_fn(|axis| center[axis] + step * away[axis]), grown)
    };
    balls.clone().fold(grow(first, second), grow).0
}

/// The least radius about a centre that holds all, each distance rounded by a few units of f64.
pub fn radius(center: [f64; 3], balls: impl Iterator<Item = Ball>) -> f64 {
    balls.map(|ball| reach(center, ball)).fold(0.0, f64::max)
}

/// How far a sphere's far side lies from a point.
fn reach(from: [f64; 3], (center, radius): Ball) -> f64 {
    let away = sub(center, from);
    dot(away, away).sqrt() + radius
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn around(balls: &[Ball]) -> Ball {
        let center = center(balls.iter().copied());
        (center, radius(center, balls.iter().copied()))
    }

    #[test]
    fn simple_things_have_their_own_sphere() {
        assert_eq!(around(&[]), ([0.0; 3], 0.0));
        assert_eq!(around(&[([1.0, 2.0, 3.0], 0.5)]), ([1.0, 2.0, 3.0], 0.5));
        assert_eq!(around(&[([0.0; 3], 0.0), ([2.0, 0.0, 0.0], 0.0)]), ([1.0, 0.0, 0.0], 1.0));
        // One inside the other, whichever comes first.
        assert_eq!(around(&[([0.0; 3], 3.0), ([1.0, 0.0, 0.0], 1.0)]), ([0.0; 3], 3.0));
        assert_eq!(around(&[([1.0, 0.0, 0.0], 1.0), ([0.0; 3], 3.0)]), ([0.0; 3], 3.0));
        let cube: Vec<Ball> =
            (0..8).map(|k| (std::array::from_fn(|axis| f64::from(k >> axis & 1)), 0.0)).collect();
        assert_eq!(around(&cube), ([0.5; 3], 0.75f64.sqrt()));
    }

    proptest! {
        #[test]
        fn the_sphere_is_small(
            balls in prop::collection::vec((prop::array::uniform3(-1.0f64..1.0), 0.0f64..0.3), 2..50),
        ) {
            let (center, radius) = around(&balls);
            // No sphere around all is smaller than half the largest extent of any two.
            let extent = |a: &Ball, b: &Ball| reach(a.0, *b) + a.1;
            let widest = balls.iter().flat_map(|a| balls.iter().map(move |b| extent(a, b))).fold(0.0, f64::max);
            prop_assert!(balls.iter().all(|&ball| reach(center, ball) <= radius));
            prop_assert!(radius <= 1.3 * 0.5 * 3f64.sqrt() * widest, "{radius} for {widest}");
        }
    }
}
