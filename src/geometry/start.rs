//! Rays that start on a surface: which of the triangles around the start they may meet.
//!
//! A ray starts at the computed f64 hit point, which lies off its triangle's plane and, on an edge, off the neighbour's, by rounding. So the
//! start's own triangle and its coincident duplicates are excluded, and a triangle that shares a vertex with the start and whose plane holds
//! the start point to within `Start::RADIUS` is met only where topology says so: the ray passes from the start's side behind it (a concave crease).

use super::{Prepared, cross, dot, norm1, sub};

/// The triangle that a ray starts on.
#[derive(Clone, Copy, Debug)]
pub struct Start {
    vertices: [[f64; 3]; 3],
    normal: [f64; 3],
}

impl Start {
    /// How far the computed start may lie off the true surface, relative to the largest coordinate: the point is a sum of three
    /// products with weights that sum to 1, each step rounded (below 8 u, u = 2^-53); the plane's own equation adds as much again.
    const RADIUS: f64 = 16.0 * (f64::EPSILON / 2.0);

    /// A computed n·(v − p) within this times |e1|₁|e2|₁ max|v − p| is no evidence that v lies off the plane.
    const COPLANAR: f64 = 16.0 * (f64::EPSILON / 2.0);

    pub fn new(vertices: [[f64; 3]; 3]) -> Self {
        let normal = cross(sub(vertices[1], vertices[0]), sub(vertices[2], vertices[0]));
        Start { vertices, normal }
    }

    /// Whether a hit of the ray on another triangle is a true one.
    ///
    /// Two triangles that share an edge or vertex, seen along it: the start's triangle and the other enclose an angle on the ray's side, and the
    /// ray leaves within it or beyond the other. It meets the other exactly if that lies on the ray's side of the start's plane, and the ray goes to the
    /// side of the other's plane on which the start's triangle does not lie.
    pub fn admits(&self, ray: &Prepared, other: &[[f64; 3]; 3]) -> bool {
        let shared = other.iter().filter(|v| self.vertices.contains(v)).count();
        if shared == 0 {
            return true;
        }
        if shared == 3 {
            return false;
        }
        let (e1, e2) = (sub(other[1], other[0]), sub(other[2], other[0]));
        let normal = cross(e1, e2);
        let to_plane = dot(normal, sub(other[0], ray.origin));
        let largest = other.iter().chain(&self.vertices).flatten().fold(0.0, |m: f64, c| m.max(c.abs()));
        if to_plane.abs() > Self::RADIUS * largest * (norm1(e1) * norm1(e2)) {
            return true;
        }
        let ray_side = dot(self.normal, ray.direction);
        let other_side = side(self.normal, &self.vertices, other);
        let start_side = side(normal, other, &self.vertices);
        other_side * ray_side > 0.0 && start_side * dot(normal, ray.direction) < 0.0
    }
}

/// On which side of the plane of `reference` the triangle `of` lies: the signed distance (times |normal|) of its farthest vertex, or 0 where
/// rounding can't tell any of them from the plane.
fn side(normal: [f64; 3], reference: &[[f64; 3]; 3], of: &[[f64; 3]; 3]) -> f64 {
    let spread = norm1(sub(reference[1], reference[0])) * norm1(sub(reference[2], reference[0]));
    let mut farthest: f64 = 0.0;
    for vertex in of {
        let from = sub(*vertex, reference[0]);
        let distance = dot(normal, from);
        if distance.abs() > Start::COPLANAR * spread * norm1(from) && distance.abs() > farthest.abs() {
            farthest = distance;
        }
    }
    farthest
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
        Start::new(FLOOR).admits(&Prepared::new(&ray), &other)
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
        assert!(admits([0.0, 1.0, 0.0], [[0.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 1.0]]));
        assert!(admits([0.0, 1.0, 0.1], [[0.0, 0.0, 1.0], [-1.0, 1.0, 0.0], [1.0, 1.0, 0.0]]));
    }
}
