//! The one decision whether and where a ray meets a triangle, in f64.
//!
//! Edges: Woop, Benthin and Wald 2013, with products and differences rounded one by one, so that two triangles
//! sharing an edge compute the same number for it but for its sign: no ray passes between them. Distance: from the plane's
//! equation, since interpolating it over a sliver's edge functions loses all digits.

use super::twofold::{Twofold, differences, twofold_cross, twofold_dot};
use super::{Prepared, cross, dot, norm_max, norm1, normalising_power, of_axis, sub};

/// Where |n·d| is at most this times |e1|₁|e2|₁, t is computed with twice the digits and clamped to where the ray runs along the triangle.
///
/// Above it, t's error times |d| is below 2^-32 Q, with Q = |origin|∞ + max|vertex|∞: each component of n = e1 × e2 is off by at
/// most 3u times its two products' magnitudes (u = 2^-53), so n·(v − o) and n·d are off by at most 16u |e1|₁|e2|₁ times Q and |d|∞ < 2; dividing by
/// |n·d| > 2^-16 |e1|₁|e2|₁ leaves (16uQ + 16u|td|∞) 2^16 ≤ 2^-32 Q. `bounds` pads boxes by twice that.
pub const GRAZING: f64 = 1.0 / 65536.0;

/// A triangle's plane and a line, in plain f64.
#[derive(Clone, Copy, Debug)]
pub struct Plane {
    /// e1 × e2.
    normal: [f64; 3],
    /// n·d.
    along: f64,
    /// n·(v − o), for the first vertex.
    pub height: f64,
    /// |e1|₁|e2|₁.
    pub size: f64,
}

impl Plane {
    #[inline(always)]
    pub fn seen(origin: [f64; 3], direction: [f64; 3], vertices: &[[f64; 3]; 3]) -> Self {
        let (e1, e2) = (sub(vertices[1], vertices[0]), sub(vertices[2], vertices[0]));
        let normal = cross(e1, e2);
        let height = dot(normal, sub(vertices[0], origin));
        Plane { normal, along: dot(normal, direction), height, size: norm1(e1) * norm1(e2) }
    }

    /// Whether [`Plane::t`] keeps digits enough: see [`GRAZING`]. Not if products left f64's range (NaN).
    #[inline(always)]
    pub fn is_upright(&self) -> bool {
        self.along.abs() > GRAZING * self.size
    }

    /// Where the line meets the plane.
    #[inline(always)]
    pub fn t(&self) -> f64 {
        self.height / self.along
    }
}

/// A hit in units of the scaled direction, with its unnormalised barycentric coordinates.
#[derive(Clone, Copy, Debug)]
pub struct TriangleHit {
    pub t: f64,
    /// The edge functions opposite to each vertex: weights of the three vertices, all of one sign.
    pub weights: [f64; 3],
}

/// The triangle as the ray sees it: sheared so that the ray is the z axis.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sheared {
    x: [f64; 3],
    y: [f64; 3],
    /// The edge functions opposite to each vertex; of one sign where the ray passes through.
    pub weights: [f64; 3],
}

impl Sheared {
    #[inline(always)]
    pub fn new(ray: &Prepared, vertices: &[[f64; 3]; 3]) -> Self {
        let (kx, ky, kz) = (ray.kx, ray.ky, ray.kz);
        let [ox, oy, oz] = [ray.origin[kx], ray.origin[ky], ray.origin[kz]];
        let shear = |v: &[f64; 3]| {
            let z = v[kz] - oz;
            ((v[kx] - ox) - ray.shear_x * z, (v[ky] - oy) - ray.shear_y * z)
        };
        let [(ax, ay), (bx, by), (cx, cy)] = [shear(&vertices[0]), shear(&vertices[1]), shear(&vertices[2])];
        let u = cx * by - cy * bx;
        let v = ax * cy - ay * cx;
        let w = bx * ay - by * ax;
        Sheared { x: [ax, bx, cx], y: [ay, by, cy], weights: [u, v, w] }
    }

    /// How far the weight opposite to a vertex can be off for coordinates that are off by `aside` each.
    pub fn doubt(&self, vertex: usize, aside: f64) -> f64 {
        let (p, q) = ((vertex + 1) % 3, (vertex + 2) % 3);
        2.0 * aside * ((self.x[q] - self.x[p]).abs() + (self.y[q] - self.y[p]).abs())
    }

    /// Whether the ray passes through, edges and corners included.
    #[inline]
    pub fn is_crossed(&self) -> bool {
        let [u, v, w] = self.weights;
        if !has_one_sign(self.weights) {
            return false;
        }
        // A computed sign is right or 0, as rounding keeps the order of the two products. Where it is 0 the box of the sheared vertices,
        // which holds whatever they enclose, tells what is far away: a triangle smaller than the rounding of v − o has only zeros.
        !((u == 0.0 || v == 0.0 || w == 0.0) && !self.is_within(0.0))
    }

    /// Whether the ray comes to within this distance of the box of the sheared vertices.
    pub fn is_within(&self, aside: f64) -> bool {
        !(excludes(self.x, aside) || excludes(self.y, aside))
    }
}

/// Whether no two of these have opposite signs.
#[inline]
pub(super) fn has_one_sign([u, v, w]: [f64; 3]) -> bool {
    !((u < 0.0 || v < 0.0 || w < 0.0) && (u > 0.0 || v > 0.0 || w > 0.0))
}

/// Meets the whole line of the ray; the caller checks the range of t.
///
/// A triangle without area, in itself or as the ray sees it, is missed. `vertices` are exact f32 values.
#[inline]
pub fn intersect(ray: &Prepared, vertices: &[[f64; 3]; 3]) -> Option<TriangleHit> {
    let sheared = Sheared::new(ray, vertices);
    if !sheared.is_crossed() {
        return None;
    }
    let plane = Plane::seen(ray.origin, ray.direction, vertices);
    let t = meet_plane(ray, vertices, &plane, sheared.weights, 0.0)?;
    Some(TriangleHit { t, weights: sheared.weights })
}

/// Where the line from `origin` along `direction`, of any length but 0, meets a triangle, in units of `direction`: exactly as [`intersect`] says, or NaN where that doesn't meet it, meets an edge or
/// grazes it. Without a branch, so that the compiler can work on many side by side.
#[inline(always)]
pub fn meet_plainly(origin: [f64; 3], direction: [f64; 3], vertices: &[[f64; 3]; 3]) -> f64 {
    let [a, b, c] = [direction[0].abs(), direction[1].abs(), direction[2].abs()];
    let (along_x, along_y) = ((a > b) & (a > c), (a <= b) & (b > c));
    let of_axis = |numbers: [f64; 3]| of_axis(along_x, along_y, numbers);
    let (scale, _) = normalising_power(of_axis([a, b, c]));
    let [x, y, z] = [direction[0] * scale, direction[1] * scale, direction[2] * scale];
    let along = of_axis([x, y, z]);
    let (shear_x, shear_y) = (of_axis([y, z, x]) / along, of_axis([z, x, y]) / along);
    let mut sheared = [[0.0; 2]; 3];
    for vertex in 0..3 {
        let [x, y, z] = sub(vertices[vertex], origin);
        let (first, second, last) = (of_axis([y, z, x]), of_axis([z, x, y]), of_axis([x, y, z]));
        sheared[vertex] = [first - shear_x * last, second - shear_y * last];
    }
    let [[ax, ay], [bx, by], [cx, cy]] = sheared;
    let u = cx * by - cy * bx;
    let v = ax * cy - ay * cx;
    let w = bx * ay - by * ax;
    let plane = Plane::seen(origin, [x, y, z], vertices);
    let is_crossed = ((u > 0.0) & (v > 0.0) & (w > 0.0)) | ((u < 0.0) & (v < 0.0) & (w < 0.0));
    if is_crossed & plane.is_upright() { plane.t() * scale } else { f64::NAN }
}

/// Where the ray meets the plane of a triangle that it passes through with these weights, or passes as near as `aside` if that is more than rounding.
///
/// None where the triangle has no area, or none as the ray sees it. One that lies in a plane with the ray and yet has weights has an area by rounding, which covers what
/// rounding has taken from its neighbours: left out, it would let the ray slip through.
#[inline]
pub(super) fn meet_plane(
    ray: &Prepared,
    vertices: &[[f64; 3]; 3],
    plane: &Plane,
    weights: [f64; 3],
    aside: f64,
) -> Option<f64> {
    if plane.along == 0.0 && (weights == [0.0; 3] || plane.normal == [0.0; 3]) {
        return None;
    }
    Some(if plane.is_upright() {
        plane.t()
    } else {
        clamp_to_triangle(ray, vertices, grazing_t(ray, vertices), aside)
    })
}

/// Whether all three lie on the same side of 0, farther from it than this.
fn excludes([a, b, c]: [f64; 3], aside: f64) -> bool {
    (a > aside && b > aside && c > aside) || (a < -aside && b < -aside && c < -aside)
}

/// t of the plane with twice the digits: of a ray that nearly lies in the plane f64 would keep none.
#[cold]
fn grazing_t(ray: &Prepared, vertices: &[[f64; 3]; 3]) -> f64 {
    let (e1, e2) = (differences(vertices[1], vertices[0]), differences(vertices[2], vertices[0]));
    let normal = twofold_cross(&e1, &e2);
    let direction = ray.direction.map(Twofold::from);
    twofold_dot(&normal, &differences(vertices[0], ray.origin)).ratio(twofold_dot(&normal, &direction))
}

/// Brings t into the interval in which the ray runs along the triangle, as far as rounding lets it be: the point at t lies then beside the triangle, not only in its plane. So
/// whatever boxes hold the triangle's points, be it in parts, are entered no later, once they are padded.
///
/// How far beside: within 2^-43 Q; within 2^-29 Q where `start` gives an `aside` of 2^-31 Q, though no farther outside the triangle's box than `aside`. Boxes of parts are padded in f32 alone, which
/// leaves 2^-23 Q and more.
///
/// Seen along the largest component of the normal, the point lies on the inner side of each edge, and in the triangle's box. Both are widened by what separates the computed line from
/// the exact one: 32 u Q, Q = |origin|∞ + max|vertex|∞, u = 2^-53 (a sheared coordinate is off by 6 u Q, a weight that was rounded to 0 lets in another 16 u Q), or `aside`; an edge's side by
/// as much again for its own rounding (12 u Q). So the interval isn't empty: it holds the t' where the ray comes nearest. Between t' and the plane's t the ray comes no farther from the plane.
#[cold]
pub(super) fn clamp_to_triangle(ray: &Prepared, vertices: &[[f64; 3]; 3], t: f64, aside: f64) -> f64 {
    let reach = norm_max(ray.origin) + vertices.iter().map(|&v| norm_max(v)).fold(0.0, f64::max);
    let aside = aside.max(32.0 * (f64::EPSILON / 2.0) * reach);
    let (mut near, mut far) = (f64::NEG_INFINITY, f64::INFINITY);
    let normal =
        twofold_cross(&differences(vertices[1], vertices[0]), &differences(vertices[2], vertices[0]))
            .map(|n| n.value());
    let largest = (0..3).fold(0, |k, axis| if normal[axis].abs() > normal[k].abs() { axis } else { k });
    // Corners on one line are on it from all sides.
    for k in (0..3).filter(|&k| k == largest || normal[largest] == 0.0) {
        let (i, j) = ((k + 1) % 3, (k + 2) % 3);
        for vertex in 0..3 {
            let (p, q) = (vertices[vertex], vertices[(vertex + 1) % 3]);
            let (along_i, along_j) = ((q[i] - p[i]) * normal[k].signum(), (q[j] - p[j]) * normal[k].signum());
            let height = along_i * (ray.origin[j] - p[j]) - along_j * (ray.origin[i] - p[i]);
            let rise = along_i * ray.direction[j] - along_j * ray.direction[i];
            let least = -2.0 * aside * (along_i.abs() + along_j.abs());
            if rise > 0.0 {
                near = near.max((least - height) / rise);
            } else if rise < 0.0 {
                far = far.min((least - height) / rise);
            }
        }
    }
    let t = t.max(near).min(far);
    (near, far) = (f64::NEG_INFINITY, f64::INFINITY);
    for axis in 0..3 {
        let direction = ray.direction[axis];
        if direction == 0.0 {
            continue;
        }
        let [a, b, c] = vertices.map(|v| v[axis] - ray.origin[axis]);
        let first = (a.min(b).min(c) - aside) / direction;
        let last = (a.max(b).max(c) + aside) / direction;
        near = near.max(first.min(last));
        far = far.min(first.max(last));
    }
    t.max(near).min(far)
}

/// The weights of the second and the third vertex, in [0, 1], their sum at most 1.
///
/// An edge-on hit has no area to divide: there the point of the ray at `t` is projected onto the longest edge.
pub fn barycentrics(ray: &Prepared, vertices: &[[f64; 3]; 3], hit: &TriangleHit) -> [f64; 2] {
    let [u, v, w] = hit.weights;
    let sum = (u + v) + w;
    if sum != 0.0 && sum.is_finite() {
        return [v / sum, w / sum];
    }
    let point: [f64; 3] = std::array::from_fn(|axis| ray.origin[axis] + hit.t * ray.direction[axis]);
    let edge = |from: usize, to: usize| sub(vertices[to], vertices[from]);
    let length2 = |e: [f64; 3]| dot(e, e);
    let place = |from: usize, e: [f64; 3]| {
        let s = dot(sub(point, vertices[from]), e) / length2(e);
        if s >= 0.0 { s.min(1.0) } else { 0.0 }
    };
    let (ab, bc, ca) = (edge(0, 1), edge(1, 2), edge(2, 0));
    if length2(ab) >= length2(bc) && length2(ab) >= length2(ca) {
        [place(0, ab), 0.0]
    } else if length2(bc) >= length2(ca) {
        let s = place(1, bc);
        [1.0 - s, s]
    } else {
        [0.0, 1.0 - place(2, ca)]
    }
}

#[cfg(test)]
mod tests {
    use super::super::{NONE, Numbers, Ray};
    use super::*;
    use glam::DVec3;

    const UNIT: [[f64; 3]; 3] = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];

    fn ray(origin: [f64; 3], direction: [f64; 3]) -> Prepared {
        Prepared::new(&Ray {
            origin: DVec3::from(origin),
            direction: DVec3::from(direction),
            t_min: 0.0,
            t_max: f64::INFINITY,
            first_id: 0,
            start: NONE,
        })
    }

    #[test]
    fn hits_inside_edges_and_corners_and_nothing_beyond() {
        for (x, y, expected) in [
            (0.25, 0.25, true),
            (0.0, 0.0, true),
            (1.0, 0.0, true),
            (0.5, 0.5, true),
            (0.5, 0.0, true),
            (0.5, 0.500001, false),
            (-1e-300, 0.5, false),
        ] {
            let prepared = ray([x, y, 2.0], [0.0, 0.0, -0.5]);
            let hit = intersect(&prepared, &UNIT);
            assert_eq!(hit.is_some(), expected, "{x} {y}");
            if let Some(hit) = hit {
                assert_eq!(hit.t / prepared.scale.recip(), 2.0 * 2.0);
                assert_eq!(barycentrics(&prepared, &UNIT, &hit), [x, y]);
            }
        }
    }

    #[test]
    fn directions_of_any_length_give_t_in_their_units() {
        for exponent in [-1000, -600, -1, 0, 3, 900] {
            let length = libm::exp2(f64::from(exponent));
            let prepared = ray([0.25, 0.25, 1.0], [0.0, -0.0, -length]);
            let hit = intersect(&prepared, &UNIT).expect("straight down");
            assert_eq!(hit.t * prepared.scale * length, 1.0, "2^{exponent}");
        }
    }

    #[test]
    fn specks_are_met_only_by_rays_that_pass_them() {
        for exponent in [-20, -60, -100] {
            let size = libm::exp2(f64::from(exponent));
            let speck = UNIT.map(|v| v.map(|c| c * size));
            assert!(intersect(&ray([0.3, 0.4, 2.0], [0.1, 0.2, -1.0]), &speck).is_none(), "2^{exponent}");
            assert!(
                intersect(&ray([0.25, 0.5, 2.0], [-0.125, -0.25, -1.0]), &speck).is_some(),
                "2^{exponent}"
            );
        }
    }

    #[test]
    fn grazing_rays_are_met_where_the_plane_is() {
        // z = (x + y) / 3 over a tilted triangle, and a ray that sinks by 2^-40 for each unit along it.
        let tilted = [[0.0, 0.0, 0.0], [3.0, 0.0, 1.0], [0.0, 3.0, 1.0]];
        let sink = libm::exp2(-40.0);
        let prepared = ray([0.75, 0.75, 0.5 + sink], [3.0, -3.0, -4.0 * sink]);
        let hit = intersect(&prepared, &tilted).expect("it sinks through");
        assert_eq!(hit.t * prepared.scale, 0.25);
    }

    #[test]
    fn no_ray_slips_through_what_it_sees_edge_on() {
        // A plate, a riser in whose plane the ray runs, and a plate that goes on at its other end: seen along the riser the two plates touch.
        let mut numbers = Numbers(1);
        let mut whole = |below: u64| ((numbers.bits() >> 33) % below) as f64 - ((below - 1) / 2) as f64;
        let (mut edge_on, mut leaks) = (0, Vec::new());
        for case in 0..200_000 {
            let mut point = |below| [whole(below), whole(below), whole(below)];
            let (along, across, out) = (point(15), point(15), point(15));
            let normal = cross(along, across);
            if dot(normal, out) == 0.0 {
                continue;
            }
            let plus = |p: [f64; 3], v: [f64; 3], times: f64| [0, 1, 2].map(|k| p[k] + times * v[k]);
            let corner = point(1001);
            // Along the ray the riser is as long as `along`; across it, both plates reach far.
            let [a, b] = [plus(corner, across, -8.0), plus(corner, across, 8.0)];
            let [c, d] = [plus(a, along, 1.0), plus(b, along, 1.0)];
            let [e, f] = [plus(a, out, 8.0), plus(b, out, 8.0)];
            let [g, h] = [plus(c, out, -8.0), plus(d, out, -8.0)];
            let strip = [[a, b, e], [b, f, e], [a, c, b], [b, c, d], [c, d, g], [d, h, g]];
            let aim = plus(corner, across, 0.25 * whole(63).abs() - 7.0);
            let direction = plus(along, across, whole(7) / 64.0);
            let prepared = ray(plus(aim, direction, -3.0), direction);
            edge_on += u32::from(dot(normal, prepared.direction) == 0.0);
            if !strip.iter().any(|triangle| intersect(&prepared, triangle).is_some()) {
                leaks.push(case);
            }
        }
        assert!(edge_on > 100_000, "{edge_on}");
        assert!(leaks.is_empty(), "{} of {edge_on}, first {:?}", leaks.len(), leaks.first());
    }

    #[test]
    fn grazing_hits_lie_beside_the_triangle() {
        // Rays that run in the plane but for rounding: where they meet it is anyone's guess, but not where there is no triangle.
        let tilted = [[0.1f32, 0.2, 0.3], [1.3, 0.1, 0.9], [0.2, 1.1, -0.4]].map(|v| v.map(f64::from));
        let [a, b, c] = tilted.map(DVec3::from);
        let normal = (b - a).cross(c - a).normalize();
        let sides = [[a, b], [b, c], [c, a]];
        let (mut hits, mut farthest) = (0, 0.0);
        for case in 0..20_000 {
            let [s, t, turn, lift] =
                [0.618, 0.324, 0.171, 0.419].map(|step| (f64::from(case) * step).fract());
            let inside = a + (b - a) * (s * (1.0 - t)) + (c - a) * (s * t);
            let along = (b - a) * libm::cos(6.3 * turn) + (c - a) * libm::sin(6.3 * turn);
            let origin = inside + 2.0 * along + normal * (2e-15 * (lift - 0.5));
            let direction = inside - origin;
            let Some(hit) = intersect(&ray(origin.to_array(), direction.to_array()), &tilted) else {
                continue;
            };
            let prepared = ray(origin.to_array(), direction.to_array());
            let point = origin + direction * (hit.t * prepared.scale);
            let out = |[p, q]: [DVec3; 2]| (q - p).normalize().cross(normal).dot(point - p);
            farthest = sides.map(out).into_iter().fold(farthest, f64::max);
            hits += 1;
        }
        assert!(hits > 1000 && farthest < 1e-13, "{hits} hits, up to {farthest} outside");
    }

    /// Distance of a point from a triangle: from its nearest side, or from its plane.
    fn distance(point: DVec3, [a, b, c]: [DVec3; 3]) -> f64 {
        let from_side = |p: DVec3, q: DVec3| {
            let s = ((point - p).dot(q - p) / (q - p).length_squared()).clamp(0.0, 1.0);
            point.distance(p + (q - p) * s)
        };
        // f64 alone would tilt a sliver's.
        let [e1, e2] = [b, c].map(|v| differences(v.to_array(), a.to_array()));
        let normal = DVec3::from(twofold_cross(&e1, &e2).map(Twofold::value)).normalize();
        let is_beside =
            [[a, b], [b, c], [c, a]].iter().all(|[p, q]| (q - p).cross(point - p).dot(normal) >= 0.0);
        let from_plane = if is_beside { (point - a).dot(normal).abs() } else { f64::INFINITY };
        from_side(a, b).min(from_side(b, c)).min(from_side(c, a)).min(from_plane)
    }

    #[test]
    fn hits_of_needles_lie_beside_them() {
        // Slivers of every thinness, seen nearly edge-on from anywhere in or near their plane.
        let mut numbers = Numbers(1);
        let mut unit = || numbers.unit();
        let (mut hits, mut grazing) = (0, 0);
        for case in 0..400_000 {
            let mut point = || DVec3::new(unit() - 0.5, unit() - 0.5, unit() - 0.5);
            let (a, b, aside, place) = (point(), point(), point(), point());
            let thin = libm::exp2(-24.0 * unit());
            // Two corners that nearly fall together, or a third one nearly on the side of the others.
            let along = if case % 2 == 0 { 0.0 } else { unit() };
            let moved = if case % 3 == 0 { place * libm::exp2(20.0 * unit()) } else { DVec3::ZERO };
            let corners = [a, b, a + (b - a) * along + aside * thin]
                .map(|v| (v + moved).to_array().map(|c| f64::from(c as f32)));
            let [a, b, c] = corners.map(DVec3::from);
            let area = (b - a).cross(c - a);
            if area.length() == 0.0 {
                continue;
            }
            let normal = area.normalize();
            let (s, t) = (unit(), unit());
            let target = a + ((b - a) * (1.0 - t) + (c - a) * t) * (1.0 + 1e-3 * (unit() - 0.5)) * s;
            let mut way = place.reject_from_normalized(normal);
            if case % 5 == 0 {
                way = b - a;
            }
            let tilted = way + normal * ((unit() - 0.5) * libm::exp2(-60.0 * unit()));
            let origin = target - tilted * libm::exp2(40.0 * unit() - 20.0);
            let direction = target - origin;
            if direction.length() == 0.0 {
                continue;
            }
            let ray = ray(origin.to_array(), direction.to_array());
            let Some(hit) = intersect(&ray, &corners) else { continue };
            let point = origin + DVec3::from(ray.direction) * hit.t;
            let reach = norm_max(ray.origin) + corners.iter().map(|&v| norm_max(v)).fold(0.0, f64::max);
            let off = distance(point, [a, b, c]) / reach;
            let is_grazing = area.dot(DVec3::from(ray.direction)).abs()
                <= GRAZING * (norm1((b - a).to_array()) * norm1((c - a).to_array()));
            // What boxes are padded by, of which twofold digits need far less.
            let bound = if is_grazing { libm::exp2(-43.0) } else { libm::exp2(-32.0) };
            assert!(
                off <= bound,
                "case {case}: {off:e} off at {}, grazing: {is_grazing}, {corners:?}, {ray:?}",
                hit.t
            );
            hits += 1;
            grazing += u32::from(is_grazing);
        }
        assert!(hits > 50_000 && grazing > 20_000, "{hits} hits, {grazing} grazing");
    }

    #[test]
    fn corners_that_fall_together_are_met_only_where_they_are() {
        // From so far away f64 can't tell the corners apart, and every edge function is 0.
        let power = |exponent: i32| libm::exp2(f64::from(exponent));
        let wall = [[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let origin = [-power(100), power(70), power(71)];
        assert!(intersect(&ray(origin, [power(30), -1.0, -2.0]), &wall).is_some());
        assert!(intersect(&ray(origin, [power(30), -1.0, -3.0]), &wall).is_none());
        assert!(intersect(&ray(origin, [1.0, 0.0, 0.0]), &wall).is_none());
    }

    #[test]
    fn rays_in_the_plane_miss() {
        assert!(intersect(&ray([-1.0, 0.25, 0.0], [1.0, 0.0, 0.0]), &UNIT).is_none());
    }
}
