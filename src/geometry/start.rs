//! Rays that start on a surface: which of the triangles around the start they meet, and where.
//!
//! A ray starts at the computed f64 hit point, which lies off its triangle's plane, and off any other that holds the point, by rounding: on which
//! side is chance. Leaving out the triangle itself isn't enough; neither is a rule that only strikes out hits, since a point behind a wall's plane
//! never meets the wall. So what rounding has put in doubt isn't asked of the computed point:
//!
//! The ray truly starts in its own triangle S, at o = Σ wᵢsᵢ with weights above 0. Those of the computed point are off by at most
//! `RADIUS` (largest coordinate) / (height of S), so they are raised to that, which puts o inside S for certain. Of another triangle N with a vertex x and the normal
//! n things are then measured with twice the digits: n·(o − x) = Σ wᵢ n·(sᵢ − x), where the vertices of S in the plane of N drop out as the zeros that they are. What is left
//! has no cancellation: the ray is on the right side of each crease however near the start is to it, whether N shares an edge, a vertex or
//! only a line of contact with S; as near to a vertex as f64 goes it sees the triangles around it as cones. A triangle in the plane of S gives only
//! zeros, and is never met.
//!
//! In doubt are the distance of a plane that holds the computed point to within `RADIUS`, and the side on which the ray passes an edge that it comes as near to. For each edge that is settled from
//! the edge, the ray and S alone: both triangles beside it see the ray pass on the same side, so there are no cracks between them. Everything else is the ordinary test's.

use std::cell::OnceCell;

use super::triangle::{Plane, Sheared, TriangleHit, clamp_to_triangle, has_one_sign, meet_plane};
use super::twofold::{Twofold, differences, twofold_cross, twofold_dot};
use super::{Prepared, cross, dot, norm_max, sub};

/// How far the computed start may lie off the true surface, relative to the largest coordinate, u = 2^-53. The point is a sum of three
/// products with weights that sum to 1, each step rounded (below 5 u); a plane's equation adds its normal (8 u), products and sums (6 u), and a difference (2 u).
pub const RADIUS: f64 = 32.0 * (f64::EPSILON / 2.0);

/// How far the weights may be raised, over the largest coordinate: an eighth of what `bounds` pads boxes by.
const FARTHEST: f64 = 1.0 / 17_179_869_184.0;

/// Twofold arithmetic is off by some 2^-100 of the products' magnitudes: below this times `spread`·|f|, n·f is 0.
const LEVEL: f64 = 1.0 / (1u128 << 92) as f64;

/// 2^-900.
const UNDERFLOW: f64 = f64::MIN_POSITIVE * (1u128 << 122) as f64;

/// The triangle that a ray starts on.
#[derive(Clone, Debug)]
pub struct Start {
    vertices: [[f64; 3]; 3],
    /// The computed start.
    origin: [f64; 3],
    /// The largest magnitude of a coordinate of these.
    reach: f64,
    /// Its weights, once a triangle has asked for them: few rays ever do, some for hundreds of triangles.
    weights: OnceCell<[Twofold; 3]>,
}

impl Start {
    /// `origin` is the computed start.
    #[inline]
    pub fn new(vertices: [[f64; 3]; 3], origin: [f64; 3]) -> Self {
        let reach = vertices.iter().fold(norm_max(origin), |m, &v| m.max(norm_max(v)));
        Start { vertices, origin, reach, weights: OnceCell::new() }
    }

    /// Whether and where the ray, which starts on this triangle, meets another one.
    pub fn meet(&self, ray: &Prepared, other: &[[f64; 3]; 3]) -> Option<TriangleHit> {
        let mut sheared = Sheared::new(ray, other);
        // No doubt reaches farther than this: what lies beyond needs no further question.
        let reaches = [norm_max(other[0]), norm_max(other[1]), norm_max(other[2])];
        let farthest = 4.0 * FARTHEST * self.reach.max(reaches[0]).max(reaches[1]).max(reaches[2]);
        if !sheared.is_within(farthest) {
            return None;
        }
        let is_open = |k: usize| {
            let reach = self.reach.max(reaches[(k + 1) % 3]).max(reaches[(k + 2) % 3]);
            sheared.weights[k].abs() <= sheared.doubt(k, RADIUS * reach)
        };
        let open = [is_open(0), is_open(1), is_open(2)];
        let is_crossed = if open.contains(&true) {
            sheared.weights = self.settle(ray, other, sheared.weights, open)?;
            has_one_sign(sheared.weights)
        } else {
            sheared.is_crossed()
        };
        if !is_crossed {
            return None;
        }
        // The computed line comes as near to a side that is settled as its doubt, and to the triangle, be it a needle, as its box says.
        let aside = if open.contains(&true) { 2.0 * farthest } else { 0.0 };
        let (e1, e2) = (sub(other[1], other[0]), sub(other[2], other[0]));
        let plane = Plane::seen(ray.origin, ray.direction, other);
        let largest = largest_on_axes([self.reach; 3], other);
        let t = if plane.height.abs() <= RADIUS * dot(spread(e1, e2), largest) {
            self.meet_plane_at_start(ray, other, aside)?
        } else {
            meet_plane(ray, other, &plane, sheared.weights, aside)?
        };
        Some(TriangleHit { t, weights: sheared.weights })
    }

    /// The weights with those settled that are `open`; `None` as soon as two have opposite signs, whatever is still open.
    fn settle(
        &self,
        ray: &Prepared,
        other: &[[f64; 3]; 3],
        mut weights: [f64; 3],
        open: [bool; 3],
    ) -> Option<[f64; 3]> {
        // Sheared, d is the z axis: (p × q)·d = d_z (p × q)_z, which the weights have with the opposite sign.
        let dz = ray.direction[ray.kz];
        let side = |k: usize| (other[(k + 1) % 3], other[(k + 2) % 3]);
        for k in (0..3).filter(|&k| open[k]) {
            weights[k] = 0.0;
        }
        for k in (0..3).filter(|&k| open[k]) {
            if !has_one_sign(weights) {
                return None;
            }
            let (p, q) = side(k);
            weights[k] = -self.edge_sign(ray, p, q) * dz;
        }
        if !has_one_sign(weights) {
            return None;
        }
        for k in (0..3).filter(|&k| open[k]) {
            let (p, q) = side(k);
            weights[k] = -self.edge(ray, p, q) / dz;
        }
        Some(weights)
    }

    /// Barycentric weights of the start, each above 0, their sum exactly 1.
    fn weights(&self) -> [Twofold; 3] {
        *self.weights.get_or_init(|| self.find_weights())
    }

    #[cold]
    fn find_weights(&self) -> [Twofold; 3] {
        let Start { vertices, origin, .. } = *self;
        let sides: [[f64; 3]; 3] = std::array::from_fn(|k| sub(vertices[(k + 2) % 3], vertices[(k + 1) % 3]));
        let length2 = sides.map(|side| dot(side, side));
        let longest2 = length2[0].max(length2[1]).max(length2[2]);
        // The longest side a b and the corner c across it. Along that side the place is found directly, so that the error of the weight of c, which
        // of a sliver is large, doesn't move it.
        let c = if length2[0] == longest2 { 0 } else { usize::from(length2[1] != longest2) + 1 };
        let (a, b) = ((c + 1) % 3, (c + 2) % 3);
        let normal = cross(sides[c], sub(vertices[c], vertices[a]));
        let area2 = dot(normal, normal);
        let along = |point: [f64; 3]| dot(sub(point, vertices[a]), sides[c]) / longest2;
        let mut weights = [0.0; 3];
        weights[c] = dot(normal, cross(sides[c], sub(origin, vertices[a]))) / area2;
        weights[b] = along(origin) - weights[c] * along(vertices[c]);
        weights[a] = 1.0 - weights[b] - weights[c];
        // Of a sliver thinner than the bound no point is inside for certain; and the boxes that a traversal tests are padded for no longer way than this.
        for k in 0..3 {
            let way = sub(vertices[k], origin);
            let most = (self.reach * FARTHEST / dot(way, way).sqrt()).min(0.25);
            let least = RADIUS * self.reach * (length2[k] / area2).sqrt();
            weights[k] = weights[k].max(least.min(most));
        }
        // The largest takes what the others leave.
        let largest = (0..3).fold(0, |m, k| if weights[k] > weights[m] { k } else { m });
        let mut exact = weights.map(Twofold::from);
        exact[largest] = Twofold::from(1.0) - exact[(largest + 1) % 3] - exact[(largest + 2) % 3];
        exact
    }

    /// t at which the ray from the true start meets a plane that holds the computed one to within rounding.
    #[cold]
    fn meet_plane_at_start(&self, ray: &Prepared, other: &[[f64; 3]; 3], aside: f64) -> Option<f64> {
        let (e1, e2) = (differences(other[1], other[0]), differences(other[2], other[0]));
        let normal = twofold_cross(&e1, &e2);
        let spread = spread(sub(other[1], other[0]), sub(other[2], other[0]));
        // n·(o − x), which is 0 for each vertex in the plane.
        let mut above = Twofold::from(0.0);
        for (vertex, weight) in self.vertices.iter().zip(self.weights()) {
            let from = differences(*vertex, other[0]);
            let height = twofold_dot(&normal, &from);
            if height.value().abs() > LEVEL * dot(spread, from.map(|c| c.value().abs())) {
                above = above + weight * height;
            }
        }
        let along = twofold_dot(&normal, &ray.direction.map(Twofold::from));
        let t = -above.ratio(along);
        // Also NaN: in the plane, and along it.
        if !(t > 0.0 && t < f64::INFINITY) {
            return None;
        }
        let t = clamp_to_triangle(ray, other, t, aside);
        // Before the computed start, which is all that the boxes of a traversal know: at the start, if the triangle is there and not somewhere behind.
        let here = 4.0 * FARTHEST * other.iter().fold(self.reach, |m, &v| m.max(norm_max(v)));
        (t >= -here).then(|| t.max(0.0))
    }

    /// The sign of `edge` if plain f64 can tell it, else 0.
    ///
    /// Differences, products and sums round the term of each vertex by less than 8 u of its magnitudes' sum; its weight and adding up take 4 u more.
    fn edge_sign(&self, ray: &Prepared, p: [f64; 3], q: [f64; 3]) -> f64 {
        let (side, steep) = (sub(q, p), ray.direction.map(f64::abs));
        let (mut sum, mut magnitude) = (0.0, 0.0);
        for (&vertex, weight) in self.vertices.iter().zip(self.weights()) {
            if vertex != p && vertex != q {
                let (from, weight) = (sub(p, vertex), weight.value());
                sum += weight * dot(ray.direction, cross(from, side));
                magnitude += weight.abs() * dot(steep, spread(from, side));
            }
        }
        // What underflows is far below 2^-900.
        let is_sure = sum.abs() > 32.0 * (f64::EPSILON / 2.0) * magnitude + UNDERFLOW;
        if is_sure { sum.signum() } else { 0.0 }
    }

    /// d · ((p − o) × (q − o)): on which side of the edge the ray from the true start passes. Of the same edge the other way round exactly the negative.
    #[cold]
    fn edge(&self, ray: &Prepared, p: [f64; 3], q: [f64; 3]) -> f64 {
        if q < p {
            return -self.edge(ray, q, p);
        }
        let direction = ray.direction.map(Twofold::from);
        let side = differences(q, p);
        // (p − o) × (q − o) = (p − o) × (q − p), and a vertex of S on the edge's line gives 0.
        let mut sum = Twofold::from(0.0);
        for (&vertex, weight) in self.vertices.iter().zip(self.weights()) {
            if vertex != p && vertex != q {
                let moment = twofold_cross(&differences(p, vertex), &side);
                sum = sum + weight * twofold_dot(&direction, &moment);
            }
        }
        sum.value()
    }
}

fn largest_on_axes(at_least: [f64; 3], vertices: &[[f64; 3]; 3]) -> [f64; 3] {
    vertices.iter().fold(at_least, |m, v| std::array::from_fn(|axis| m[axis].max(v[axis].abs())))
}

/// For each component of e1 × e2 the sum of its two products' magnitudes.
fn spread(e1: [f64; 3], e2: [f64; 3]) -> [f64; 3] {
    let (a, b) = (e1.map(f64::abs), e2.map(f64::abs));
    [a[1] * b[2] + a[2] * b[1], a[2] * b[0] + a[0] * b[2], a[0] * b[1] + a[1] * b[0]]
}

#[cfg(test)]
mod tests {
    use super::super::{NONE, Numbers, Ray};
    use super::*;
    use glam::DVec3;

    /// A floor in y = 0 whose edge lies on the z axis, and a wall or slope that rises from that edge.
    const FLOOR: [[f64; 3]; 3] = [[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]];

    fn slope(x: f64, y: f64) -> [[f64; 3]; 3] {
        [[0.0, 0.0, 1.0], [0.0, 0.0, 0.0], [x, y, 0.5]]
    }

    fn admits(direction: [f64; 3], other: [[f64; 3]; 3]) -> bool {
        let ray = Ray {
            origin: DVec3::new(1e-17, -1e-17, 0.5),
            direction: DVec3::from(direction),
            t_min: 0.0,
            t_max: f64::INFINITY,
            first_id: 0,
            start: NONE,
        };
        // Whatever side of floor and wall rounding has put it on.
        let answers = [[1e-17, -1e-17], [-1e-17, 1e-17], [-1e-17, -1e-17], [0.0, 0.0]].map(|[x, y]| {
            let prepared = Prepared::new(&Ray { origin: DVec3::new(x, y, 0.5), ..ray });
            Start::new(FLOOR, prepared.origin).meet(&prepared, &other).is_some_and(|hit| hit.t >= 0.0)
        });
        assert!(answers.iter().all(|&answer| answer == answers[0]), "{answers:?}");
        answers[0]
    }

    #[test]
    fn plain_signs_of_edges_never_contradict_exact_ones() {
        let mut numbers = Numbers(1);
        let mut unit = || numbers.unit();
        let mut sure = 0;
        for case in 0..100_000 {
            let mut point = || DVec3::new(unit() - 0.5, unit() - 0.5, unit() - 0.5);
            let rounded = |v: DVec3| v.to_array().map(|c| f64::from(c as f32));
            let own = [rounded(point()), rounded(point()), rounded(point())];
            let (far, aimed) = (rounded(point()), point());
            let [a, b, c] = own.map(DVec3::from);
            // On the triangle, or as near to a vertex as f64 goes; past an edge of its own or one that shares a vertex.
            let near = if case % 2 == 0 { libm::exp2(-60.0 * unit()) } else { 1.0 };
            let (u, v) = (0.5 * near * unit(), 0.5 * near * unit());
            let origin = a * (1.0 - u - v) + b * u + c * v;
            let [p, q] = [[own[0], own[1]], [own[0], far], [own[1], own[2]], [far, own[0]]][case % 4];
            let along = DVec3::from(q) - DVec3::from(p);
            let direction = [aimed, along + aimed * libm::exp2(-60.0 * unit()), b - origin][case / 4 % 3];
            let ray = Ray { origin, direction, t_min: 0.0, t_max: f64::INFINITY, first_id: 0, start: NONE };
            let (ray, start) = (Prepared::new(&ray), Start::new(own, origin.to_array()));
            let (plain, exact) = (start.edge_sign(&ray, p, q), start.edge(&ray, p, q));
            assert!(plain == 0.0 || plain * exact > 0.0, "case {case}: {plain} for {exact:e}");
            sure += u32::from(plain != 0.0);
        }
        assert!((50_000..100_000).contains(&sure), "{sure} are sure");
    }

    #[test]
    fn concave_creases_stop_rays_that_pass_behind_them() {
        assert!(admits([-1.0, 0.5, 0.0], slope(0.0, 1.0)));
        assert!(!admits([1.0, 0.5, 0.0], slope(0.0, 1.0)));
        assert!(admits([0.5, 1.0, 0.0], slope(1.0, 1.0)));
        assert!(!admits([1.0, 0.5, 0.0], slope(1.0, 1.0)));
    }

    #[test]
    fn what_lies_behind_in_a_plane_that_holds_the_ray_is_not_met() {
        // Straight up from a floor, above a speck whose edge points upwards too.
        let floor = [[-0.5, 0.5, -0.5], [0.5, 0.5, 0.5], [0.5, 0.5, -0.5]];
        let speck = [
            [-2.5e-4, -1.545085e-4, -4.045085e-4],
            [-4.253254e-4, 0.0, -2.6286553e-4],
            [-2.5e-4, 1.545085e-4, -4.045085e-4],
        ]
        .map(|v: [f64; 3]| v.map(|c| f64::from(c as f32)));
        let prepared = Prepared::new(&Ray {
            origin: DVec3::new(-0.000_250_000_011_874_376_7, 0.5, -0.000_404_508_493_375_019_26),
            direction: DVec3::new(-1e-300, 1.0, 0.0),
            t_min: 0.0,
            t_max: f64::INFINITY,
            first_id: 0,
            start: NONE,
        });
        let start = Start::new(floor, prepared.origin);
        assert!(start.meet(&prepared, &speck).is_none_or(|hit| hit.t < 0.0));
    }

    #[test]
    fn convex_and_coplanar_neighbours_never_stop_a_ray() {
        for direction in [[-1.0, 0.1, 0.0], [1.0, 0.1, 0.0], [-0.1, 1.0, 0.3]] {
            assert!(!admits(direction, slope(-1.0, -0.5)));
            assert!(!admits(direction, slope(-1.0, 0.0)));
        }
    }

    #[test]
    fn around_a_vertex_triangles_are_met_as_cones() {
        let corner = |at: [f64; 3], direction: [f64; 3], other| {
            let origin = DVec3::from(at);
            let ray = Ray {
                origin,
                direction: DVec3::from(direction),
                t_min: 0.0,
                t_max: f64::INFINITY,
                first_id: 0,
                start: NONE,
            };
            let prepared = Prepared::new(&ray);
            Start::new(FLOOR, prepared.origin).meet(&prepared, &other).is_some()
        };
        // A fin over the floor that shares only its corner at the origin, across the diagonal; its plane is straddled by the floor.
        let fin = [[0.0, 0.0, 0.0], [-1.0, 1.0, 1.0], [1.0, 1.0, -1.0]];
        let beside = [[0.0, 0.0, 0.0], [-1.0, 0.1, 1.0], [-1.0, 0.2, 1.0]];
        for at in [[0.0; 3], [1e-17, -1e-17, 1e-18], [-1e-18, 1e-17, -1e-17]] {
            assert!(corner(at, [-1.0, 2.0, -1.0], fin), "{at:?}");
            assert!(!corner(at, [1.0, 2.0, 1.0], fin), "{at:?}");
            assert!(!corner(at, [-1.0, 0.5, 0.0], beside), "{at:?}");
        }
    }

    #[test]
    fn what_lies_in_the_plane_is_never_met() {
        let beside = |y: f64| [[-1.0, y, -1.0], [-1.0, y, 3.0], [3.0, y, -1.0]];
        assert!(!admits([0.1, 1.0, 0.1], beside(0.0)));
        assert!(!admits([0.1, -1.0, 0.1], beside(0.0)));
        for y in [1e-20, 1e-7, 0.5] {
            assert!(admits([0.1, 1.0, 0.1], beside(y)), "{y}");
            assert!(!admits([0.1, -1.0, 0.1], beside(y)), "{y}");
        }
    }

    #[test]
    fn lines_of_contact_are_creases_too() {
        // They touch the floor along a part of its edge, and share no vertex with it.
        let at = |x: f64, y: f64| [[0.0, 0.0, 0.25], [0.0, 0.0, 0.75], [x, y, 0.5]];
        let wall = at(0.0, 1.0);
        assert!(admits([-1.0, 0.5, 0.0], wall));
        assert!(!admits([1.0, 0.5, 0.0], wall));
        for direction in [[-1.0, 0.1, 0.0], [1.0, 0.1, 0.0], [-0.1, 1.0, 0.03]] {
            assert!(!admits(direction, at(0.0, -1.0)));
            assert!(!admits(direction, at(-1.0, -0.5)));
        }
    }

    #[test]
    fn below_the_floor_the_convex_edge_is_concave() {
        assert!(admits([-1.0, -0.1, 0.0], slope(-1.0, -0.5)));
        assert!(!admits([-0.1, -1.0, 0.0], slope(-1.0, -0.5)));
    }

    #[test]
    fn duplicates_in_any_order_count_as_the_start() {
        assert!(!admits([0.0, 1.0, 0.0], [FLOOR[2], FLOOR[0], FLOOR[1]]));
    }

    #[test]
    fn strangers_and_distant_neighbours_are_met() {
        assert!(admits([0.0, 1.0, 0.0], [[-1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 1.5]]));
        assert!(admits([0.0, 1.0, 0.1], [[0.0, 0.0, 1.0], [-1.0, 1.0, 0.0], [1.0, 1.0, 0.0]]));
    }
}
