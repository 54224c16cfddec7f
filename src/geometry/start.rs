//! Rays that start on a surface: which of the triangles around the start they meet, and where.
//!
//! A ray starts at the computed f64 hit point, which lies off its triangle's plane, and off a neighbour's that holds the point, by rounding: on which
//! side is chance. Leaving out the triangle itself isn't enough; neither is a rule that only strikes out hits, since a point behind a wall's plane
//! never meets the wall. So what rounding has put in doubt isn't asked of the computed point:
//!
//! The ray truly starts in its own triangle S, at o = Σ wᵢsᵢ with weights above 0. Those of the computed point are off by at most
//! `RADIUS` (largest coordinate) / (height of S), so they are raised to that, which puts o inside S for certain. Of a triangle N that shares a vertex x with
//! S, things are then measured from x: n·(x − o) = −Σ wᵢ n·(sᵢ − x), where the vertices that N shares drop out as the zeros that they are. What is left has no
//! cancellation: the ray is on the right side of each crease however near the start is to it, and as near to a vertex as f64 goes it sees
//! the triangles around it as cones. A triangle in the plane of S gives only zeros, and is never met.
//!
//! In doubt is a neighbour whose plane holds the computed point to within `RADIUS`; and, of a ray that leaves so flat that it is still within rounding of S when
//! it comes to an edge of S, on which side of that edge it passes. Everything else is the ordinary test's, so that it sees all surfaces from one point: there are no cracks
//! between those that were in doubt and those that weren't.

use super::triangle::{Sheared, TriangleHit, clamp_to_slabs, meet_plane};
use super::{Prepared, cross, dot, sub};

/// How far the computed start may lie off the true surface, relative to the largest coordinate: the point is a sum of three
/// products with weights that sum to 1, each step rounded (below 8 u, u = 2^-53); the plane's own equation adds as much again.
const RADIUS: f64 = 16.0 * (f64::EPSILON / 2.0);

/// How far the weights may be raised, over the largest coordinate: an eighth of what `bounds` pads boxes by.
const FARTHEST: f64 = 1.0 / 17_179_869_184.0;

/// A component of n is off by 3 u times the magnitudes of its two products, n·f by 3 u more: below this times `spread`·|f| it
/// is no evidence that a point lies off the plane.
const COPLANAR: f64 = 8.0 * (f64::EPSILON / 2.0);

/// The triangle that a ray starts on.
#[derive(Clone, Copy, Debug)]
pub struct Start {
    vertices: [[f64; 3]; 3],
    /// The computed start.
    origin: [f64; 3],
}

/// How another triangle stands to the start.
#[derive(Clone, Copy, Debug)]
pub enum Relation {
    /// It shares no vertex with the start: the ordinary test decides.
    Stranger,
    /// It does: this is the answer.
    Neighbour(Option<TriangleHit>),
}

impl Start {
    /// `origin` is the computed start.
    #[inline]
    pub fn new(vertices: [[f64; 3]; 3], origin: [f64; 3]) -> Self {
        Start { vertices, origin }
    }

    /// Barycentric weights of the start, each above 0. Few rays ever ask for them.
    #[cold]
    fn weights(&self) -> [f64; 3] {
        let Start { vertices, origin } = *self;
        let largest = largest_on_axes([0.0; 3], &vertices);
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
        let farthest = largest[0].max(largest[1]).max(largest[2]);
        let most = (farthest / longest2.sqrt() * FARTHEST).min(0.25);
        for k in 0..3 {
            let least = RADIUS * farthest * (length2[k] / area2).sqrt();
            weights[k] = weights[k].max(least.min(most));
        }
        weights
    }

    /// Whether and where the ray, which starts on this triangle, meets another one.
    pub fn meet(&self, ray: &Prepared, other: &[[f64; 3]; 3]) -> Relation {
        let shared = other.map(|v| self.vertices.contains(&v));
        let Some(anchor) = shared.iter().position(|&is| is) else { return Relation::Stranger };
        if shared == [true; 3] {
            return Relation::Neighbour(None);
        }
        let (e1, e2) = (sub(other[1], other[0]), sub(other[2], other[0]));
        let plane = Plane { normal: cross(e1, e2), spread: spread(e1, e2), anchor };
        let largest = largest_on_axes(largest_on_axes([0.0; 3], &self.vertices), other);
        let to_plane = dot(plane.normal, sub(other[anchor], ray.origin));
        if to_plane.abs() <= RADIUS * dot(plane.spread, largest) {
            return Relation::Neighbour(self.meet_at_start(ray, other, &shared, &plane));
        }
        match shared {
            [false, true, true] => Relation::Neighbour(self.meet_over_edge(ray, other, &shared, 0, largest)),
            [true, false, true] => Relation::Neighbour(self.meet_over_edge(ray, other, &shared, 1, largest)),
            [true, true, false] => Relation::Neighbour(self.meet_over_edge(ray, other, &shared, 2, largest)),
            _ => Relation::Stranger,
        }
    }

    /// The ordinary test, but that the side on which the ray passes a shared edge is that of the true start where it is in doubt.
    /// `apex` is the vertex that isn't shared.
    fn meet_over_edge(
        &self,
        ray: &Prepared,
        other: &[[f64; 3]; 3],
        shared: &[bool; 3],
        apex: usize,
        largest: [f64; 3],
    ) -> Option<TriangleHit> {
        let mut sheared = Sheared::new(ray, other);
        let reach = largest.into_iter().chain(ray.origin.map(f64::abs)).fold(0.0, f64::max);
        if sheared.weights[apex].abs() <= sheared.doubt(apex, RADIUS * reach) {
            let (p, q) = ((apex + 1) % 3, (apex + 2) % 3);
            // Sheared, d is the z axis: (p × q)·d = d_z (p × q)_z, which the weights have with the opposite sign.
            sheared.weights[apex] =
                -self.edge(ray, other, shared, &self.weights(), p, q) / ray.direction[ray.kz];
        }
        if !sheared.is_crossed() {
            return None;
        }
        let t = meet_plane(ray, other)?;
        Some(TriangleHit { t, weights: sheared.weights })
    }

    /// Whether a triangle lies in the plane of this one: no ray that has left the plane comes back to it.
    #[cold]
    pub fn is_level_with(&self, other: &[[f64; 3]; 3]) -> bool {
        let (e1, e2) = (sub(other[1], other[0]), sub(other[2], other[0]));
        let (normal, spread) = (cross(e1, e2), spread(e1, e2));
        self.vertices.iter().all(|vertex| {
            let from = sub(*vertex, other[0]);
            dot(normal, from).abs() <= COPLANAR * dot(spread, from.map(f64::abs))
        })
    }

    /// Meets a triangle whose plane holds the start to within rounding.
    fn meet_at_start(
        &self,
        ray: &Prepared,
        other: &[[f64; 3]; 3],
        shared: &[bool; 3],
        plane: &Plane,
    ) -> Option<TriangleHit> {
        let own = self.weights();
        // n·(o − x), which is 0 for each vertex in the plane.
        let mut above = 0.0;
        for (vertex, weight) in self.vertices.iter().zip(own) {
            let from = sub(*vertex, other[plane.anchor]);
            let height = dot(plane.normal, from);
            if !other.contains(vertex) && height.abs() > COPLANAR * dot(plane.spread, from.map(f64::abs)) {
                above += weight * height;
            }
        }
        let along = dot(plane.normal, ray.direction);
        let t = -above / along;
        // Also NaN: in the plane, and along it.
        if !(t > 0.0 && t < f64::INFINITY) {
            return None;
        }
        let weights =
            [(1, 2), (2, 0), (0, 1)].map(|(p, q)| along.signum() * self.edge(ray, other, shared, &own, p, q));
        if weights.iter().any(|&weight| weight < 0.0) {
            return None;
        }
        // The boxes that a traversal tests know the computed start only.
        Some(TriangleHit { t: clamp_to_slabs(ray, other, t).max(0.0), weights })
    }

    /// d · ((p − o) × (q − o)) for an edge of the other triangle: on which side of it the ray passes. Of the same edge the other way round exactly the negative.
    /// `own` are the start's weights.
    fn edge(
        &self,
        ray: &Prepared,
        other: &[[f64; 3]; 3],
        shared: &[bool; 3],
        own: &[f64; 3],
        p: usize,
        q: usize,
    ) -> f64 {
        let (from, to) = (other[p], other[q]);
        let side = sub(to, from);
        // Any point of the edge will do, the same both ways.
        let base = match (shared[p], shared[q]) {
            // Far from the start: as the ordinary test of the triangle behind the edge.
            (false, false) => {
                return -ray.direction[ray.kz] * Sheared::new(ray, other).weights[3 - p - q];
            }
            (true, false) => from,
            (false, true) => to,
            (true, true) if from < to => from,
            (true, true) => to,
        };
        // (p − o) × (q − o) = (x − o) × (q − p) for any point x of the edge; the edge's own vertices give 0.
        self.vertices.iter().zip(own).fold(0.0, |sum, (vertex, weight)| {
            if *vertex == from || *vertex == to {
                sum
            } else {
                sum - weight * dot(ray.direction, cross(sub(*vertex, base), side))
            }
        })
    }
}

/// The plane of a triangle that shares the vertex `anchor` with the start.
struct Plane {
    normal: [f64; 3],
    spread: [f64; 3],
    anchor: usize,
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
    use super::super::{NONE, Ray};
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
            match Start::new(FLOOR, prepared.origin).meet(&prepared, &other) {
                Relation::Stranger => {
                    crate::geometry::triangle::intersect(&prepared, &other).is_some_and(|hit| hit.t > 0.0)
                }
                Relation::Neighbour(hit) => {
                    assert!(hit.is_none_or(|hit| (0.0..1e-14).contains(&hit.t)), "{hit:?}");
                    hit.is_some()
                }
            }
        });
        assert!(answers.iter().all(|&answer| answer == answers[0]), "{answers:?}");
        answers[0]
    }

    #[test]
    fn concave_creases_stop_rays_that_pass_behind_them() {
        assert!(admits([-1.0, 0.5, 0.0], slope(0.0, 1.0)));
        assert!(!admits([1.0, 0.5, 0.0], slope(0.0, 1.0)));
        assert!(admits([0.5, 1.0, 0.0], slope(1.0, 1.0)));
        assert!(!admits([1.0, 0.5, 0.0], slope(1.0, 1.0)));
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
            match Start::new(FLOOR, prepared.origin).meet(&prepared, &other) {
                Relation::Stranger => panic!("it shares a vertex with the start"),
                Relation::Neighbour(hit) => hit.is_some(),
            }
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
    fn only_what_lies_in_the_plane_is_level() {
        let start = Start::new(FLOOR, [0.25, 0.0, 0.25]);
        let at = |y: f64| [[-1.0, y, -1.0], [-1.0, y, 3.0], [3.0, y, -1.0]];
        assert!(start.is_level_with(&at(0.0)));
        for y in [1e-40, -1e-7, 0.5] {
            assert!(!start.is_level_with(&at(y)), "{y}");
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
