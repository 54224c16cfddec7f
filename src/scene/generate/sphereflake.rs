//! The sphereflake, "balls" of the Standard Procedural Databases (Haines, "A Proposal for Standard Graphics
//! Environments", 1987): every sphere bears nine of a third of its radius, six around its equator and three
//! above.

use std::f64::consts::FRAC_1_SQRT_2;

use glam::DVec3;

use crate::scene::build::Ball;

/// The deepest flake whose spheres can be counted in 31 bits.
pub const MAX_DEPTH: u32 = 9;

/// Number of spheres of a depth: 1, 10, 91, 820, 7381, 66430, …
pub fn count(depth: u32) -> u64 {
    (0..=depth).fold(0, |sum, _| sum * 9 + 1)
}

/// The flake around the origin, its axis along y, each sphere before its children, one after the other so that a large one need
/// never be there whole. `depth <= MAX_DEPTH`; `radius` is the first sphere's, 0.5 in the database.
pub fn sphereflake(depth: u32, radius: f64) -> impl Iterator<Item = Ball> {
    let children = directions();
    let mut waiting = vec![Bud { center: DVec3::ZERO, radius, direction: DVec3::Z, depth }];
    std::iter::from_fn(move || {
        let Bud { center, radius, direction, depth } = waiting.pop()?;
        if depth > 0 {
            // The last to be pushed is the next.
            waiting.extend(children.iter().rev().map(|&child| {
                let direction = turn(child, direction);
                let center = center + direction * (radius + radius / 3.0);
                Bud { center, radius: radius / 3.0, direction, depth: depth - 1 }
            }));
        }
        // The database is z-up.
        Some(Ball { center: DVec3::new(center.x, center.z, -center.y + 0.0), radius })
    })
}

/// A sphere whose children haven't grown yet.
struct Bud {
    center: DVec3,
    radius: f64,
    /// Away from its parent.
    direction: DVec3,
    /// Generations to come.
    depth: u32,
}

/// Where the nine children of a sphere that grows along +z touch it, in the order of the database.
fn directions() -> [DVec3; 9] {
    let (low, high) = (libm::sqrt(1.0 / 3.0), libm::sqrt(2.0 / 3.0));
    // The unit vectors at 45, 15 and 75 degrees.
    let s15 = (libm::sqrt(6.0) - libm::sqrt(2.0)) / 4.0;
    let c15 = (libm::sqrt(6.0) + libm::sqrt(2.0)) / 4.0;
    let trio = [
        DVec3::new(low * FRAC_1_SQRT_2, low * FRAC_1_SQRT_2, high),
        DVec3::new(c15, s15, 0.0),
        DVec3::new(s15, c15, 0.0),
    ];
    // A third of a turn about z.
    let third = |v: DVec3| {
        let (cos, sin) = (-0.5, 0.75f64.sqrt());
        DVec3::new(cos * v.x - sin * v.y, sin * v.x + cos * v.y, v.z)
    };
    let second = trio.map(third);
    let last = second.map(third);
    std::array::from_fn(|k| [trio, second, last][k / 3][k % 3])
}

/// Turns `v` by the shortest way that takes +z to the unit vector `direction`; about x where that is -z.
fn turn(v: DVec3, direction: DVec3) -> DVec3 {
    let sin = (direction.x * direction.x + direction.y * direction.y).sqrt();
    if sin < 1e-9 {
        return if direction.z > 0.0 { v } else { DVec3::new(v.x, -v.y, -v.z) };
    }
    let axis = DVec3::new(-direction.y / sin, direction.x / sin, 0.0);
    let cos = direction.z;
    (v * cos + axis.cross(v) * sin + axis * (axis.dot(v) * (1.0 - cos))).normalize()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts() {
        assert_eq!([0, 1, 2, 3, 4, 5].map(count), [1, 10, 91, 820, 7381, 66430]);
        assert!(count(MAX_DEPTH) < 1 << 31 && count(MAX_DEPTH + 1) > 1 << 31);
        for depth in 0..5 {
            assert_eq!(sphereflake(depth, 0.5).count() as u64, count(depth));
        }
    }

    #[test]
    fn first_spheres_are_those_of_the_database() {
        // Lines of `balls -s 4`, turned y-up.
        let expected = [
            [0.0, 0.0, 0.0, 0.5],
            [0.272166, 0.544331, -0.272166, 0.166667],
            [0.420314, 0.618405, -0.420314, 0.0555556],
            [0.470715, 0.598245, -0.470715, 0.0185185],
            [0.481689, 0.57904, -0.481689, 0.00617284],
            [0.475329, 0.577669, -0.45787, 0.00617284],
        ];
        for (ball, expected) in sphereflake(4, 0.5).zip(expected) {
            let [x, y, z] = ball.center.to_array();
            for (ours, theirs) in [x, y, z, ball.radius].into_iter().zip(expected) {
                assert!((ours - theirs).abs() < 1e-6, "{ball:?} is not {expected:?}");
            }
        }
    }

    #[test]
    fn children_touch_their_parents() {
        let balls: Vec<Ball> = sphereflake(2, 0.5).collect();
        for child in 0..9 {
            let ball = balls[1 + child * 10];
            assert!((ball.center.length() - 2.0 / 3.0).abs() < 1e-12);
            for grandchild in 0..9 {
                let other = balls[2 + child * 10 + grandchild];
                let distance = (other.center - ball.center).length();
                assert!((distance - (ball.radius + other.radius)).abs() < 1e-12);
            }
        }
    }
}
