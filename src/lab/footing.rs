//! Where a ray that starts on a triangle truly starts: the exact point of its barycentric weights, and points a little inside
//! the triangle, any of which may stand for it next to a border that f64 can't tell it from.

use glam::DVec3;

use super::dyadic::{self, Dyadic, Exact3, exact};
use super::referee::{ExactRay, Referee};

/// A start on a triangle, exactly.
pub struct Footing {
    corners: [Exact3; 3],
    weights: [Dyadic; 3],
    direction: DVec3,
    /// Of the triangle over each side.
    heights: [f64; 3],
    longest: f64,
}

/// A ray, with a bound of how far it starts from the start itself.
pub type Sample = (ExactRay, f64);

/// Shares of the corners in a point inside; all turns of them are taken.
const SHARES: [[f64; 3]; 2] = [[2.0, 3.0, 3.0], [6.0, 1.0, 1.0]];
const NEAR_SIDES: [[f64; 3]; 2] = [[1e4, 1.0, 1.0], [1.0, 1e4, 1e4]];

impl Footing {
    /// `uv` are the weights of the second and third vertex.
    pub fn new(referee: &Referee, start: u32, uv: [f64; 2], direction: DVec3) -> Self {
        let vertices = referee.triangles[start as usize];
        let [u, v] = uv.map(Dyadic::new);
        let mut weights = [Dyadic::new(1.0).minus(&u).minus(&v), u, v];
        // Rounding may leave the first weight a little below 0, outside.
        if weights[0].sign() < 0 {
            let larger = if uv[0] > uv[1] { 1 } else { 2 };
            weights[larger] = weights[larger].plus(&weights[0]);
            weights[0] = Dyadic::default();
        }
        let [a, b, c] = vertices.map(|v| DVec3::from(v.map(f64::from)));
        let sides = [(c - b).length(), (a - c).length(), (b - a).length()];
        Footing {
            corners: vertices.map(|v| exact(v.map(f64::from))),
            weights,
            direction,
            heights: sides.map(|side| (b - a).cross(c - a).length() / side),
            longest: sides[0].max(sides[1]).max(sides[2]),
        }
    }

    /// The ray from the start itself.
    pub fn center(&self) -> ExactRay {
        self.ray(&self.weights)
    }

    /// Whether the border is farther away than rounding to within `bound` can reach.
    pub fn is_clear(&self, bound: f64) -> bool {
        self.sides_near(8.0 * bound) == 0
    }

    /// How many sides lie within this distance.
    fn sides_near(&self, distance: f64) -> usize {
        (0..3).filter(|&k| self.weights[k].approximate() * self.heights[k] <= distance).count()
    }

    /// Whether rounding to within `bound` can reach one side alone, and no sample starts near an end of it or passes one.
    pub fn is_by_one_side(&self, bound: f64) -> bool {
        let near = 8.0 * self.step(bound) * self.longest;
        self.sides_near(8.0 * bound) == 1 && self.sides_near(near) == 1 && !self.passes_corner(near)
    }

    /// Whether the ray goes on to pass a corner of its own triangle within this distance.
    fn passes_corner(&self, distance: f64) -> bool {
        let center = self.center();
        self.corners.iter().any(|corner| {
            let corner = DVec3::from(std::array::from_fn(|axis| corner[axis].approximate()));
            center.is_ahead(corner) && center.distance_aside(corner) <= distance
        })
    }

    /// Rays from far enough inside that rounding to within `bound` can't reach the border, if the triangle is large enough for that.
    pub fn inner(&self, bound: f64) -> Vec<Sample> {
        let step = self.step(bound);
        turns(SHARES)
            .flat_map(|shares| [shares, self.by_height(shares)])
            .map(|s| self.sample(s, step))
            .collect()
    }

    /// More rays, from nearer to the start and nearer to the sides, whose answers are as good.
    pub fn closer(&self, bound: f64) -> impl Iterator<Item = Sample> + '_ {
        const TINY: f64 = 1.0 / (1u64 << 50) as f64;
        let step = self.step(bound);
        let near = turns(SHARES).flat_map(|shares| [shares, self.by_height(shares)]).map(|s| (s, TINY));
        let sides =
            turns(NEAR_SIDES).flat_map(move |s| [(self.by_height(s), step), (self.by_height(s), TINY)]);
        near.chain(sides).map(|(shares, step)| self.sample(shares, step))
    }

    /// How much of the way to a point inside leads 64 times `bound` away from the border.
    fn step(&self, bound: f64) -> f64 {
        let lowest = self.heights[0].min(self.heights[1]).min(self.heights[2]);
        let mut step = 0.25;
        while step > 1e-12 && step * lowest > 512.0 * bound {
            step *= 0.5;
        }
        step
    }

    /// Shares for distances from the sides in this ratio.
    fn by_height(&self, shares: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|k| shares[k] / self.heights[k])
    }

    fn sample(&self, shares: [f64; 3], step: f64) -> Sample {
        let inside = whole(shares);
        let moved: [Dyadic; 3] = std::array::from_fn(|k| {
            let towards = Dyadic::new(step).times(&Dyadic::new(inside[k]));
            self.weights[k].times(&Dyadic::new(1.0 - step)).plus(&towards)
        });
        (self.ray(&moved), step * self.longest)
    }

    fn ray(&self, weights: &[Dyadic; 3]) -> ExactRay {
        let parts: [Exact3; 3] =
            std::array::from_fn(|k| std::array::from_fn(|axis| self.corners[k][axis].times(&weights[k])));
        ExactRay::new(dyadic::plus(&dyadic::plus(&parts[0], &parts[1]), &parts[2]), self.direction)
    }
}

fn turns(shares: [[f64; 3]; 2]) -> impl Iterator<Item = [f64; 3]> {
    shares.into_iter().flat_map(|[a, b, c]| [[a, b, c], [c, a, b], [b, c, a]])
}

/// Positive weights in this ratio, in whole 2^-40, so that their sum is exactly 1.
fn whole(shares: [f64; 3]) -> [f64; 3] {
    const UNITS: f64 = (1u64 << 40) as f64;
    let sum = shares[0] + shares[1] + shares[2];
    let mut parts = shares.map(|share| ((share / sum * UNITS).floor() + 1.0) / UNITS);
    let last = (0..3).max_by(|&a, &b| parts[a].total_cmp(&parts[b])).unwrap_or(0);
    parts[last] = 1.0 - parts[(last + 1) % 3] - parts[(last + 2) % 3];
    parts
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_are_positive_and_whole() {
        for shares in [[1.0, 1.0, 1.0], [1e4, 1.0, 1.0], [1e-9, 1.0, 1e9], [6.0, 1.0, 1.0]] {
            let weights = whole(shares);
            assert!(weights.iter().all(|&weight| weight > 0.0), "{weights:?}");
            let sum = weights.map(Dyadic::new).into_iter().fold(Dyadic::default(), |sum, w| sum.plus(&w));
            assert_eq!(sum.minus(&Dyadic::new(1.0)).sign(), 0);
        }
    }

    #[test]
    fn what_passes_a_corner_of_its_triangle_is_not_by_one_side() {
        let referee = Referee::new(vec![[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0f32]]]);
        let at = |along: f64, direction| {
            Footing::new(&referee, 0, [along, 0.0], direction).is_by_one_side(referee_bound(&referee))
        };
        // From the side along x, by which all of these start.
        assert!(at(0.5, DVec3::new(1.0, 0.5, 1.0)));
        assert!(at(0.5, DVec3::new(-1.0, 0.0, 1e-3)));
        assert!(!at(0.5, DVec3::new(-1.0, 0.0, 1e-16)));
        assert!(!at(1e-9, DVec3::new(-1.0, -1e-6, 1e-6)), "past the corner by 1e-15");
        assert!(at(1e-9, DVec3::new(0.0, -1.0, 1e-6)), "across the side");
    }

    fn referee_bound(referee: &Referee) -> f64 {
        referee.aside(&ExactRay::plain(DVec3::ZERO, DVec3::X))
    }

    #[test]
    fn samples_lie_inside_the_plane_exactly() {
        let triangle = [[0.1, 0.2, 0.3], [1.1, -0.7, 0.33], [0.7, 0.9, -0.4f32]];
        let referee = Referee::new(vec![triangle]);
        let footing = Footing::new(&referee, 0, [1.0, 0.0], DVec3::new(0.3, 0.4, 0.5));
        assert!(!footing.is_clear(1e-15));
        assert!(Footing::new(&referee, 0, [0.3, 0.3], DVec3::X).is_clear(1e-15));
        for (ray, slack) in footing.inner(1e-15).into_iter().chain(footing.closer(1e-15)) {
            let found = referee.meetings(&ray);
            assert_eq!(found.len(), 1, "{slack}");
            assert!(found[0].ahead() && !found[0].beyond_origin(), "t is 0 exactly");
        }
    }
}
