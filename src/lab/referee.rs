//! The referee: which triangles a ray truly meets, and in what order, in exact arithmetic.
//!
//! It shares no code with the tracer. Vertices are exact f32, the ray is exact; signs and orders come from integers of any
//! length. Plain f64 serves only to leave out, by wide margins, what is nowhere near, and to say how near the rest is.

use std::cmp::Ordering;
use std::f64::consts::TAU;
use std::sync::OnceLock;

use glam::{DVec2, DVec3};

use super::dyadic::{self, Dyadic, Exact3, exact, ratio};
use super::spheres::SphereTree;

/// Half an ulp of 1 in f64.
pub const U: f64 = f64::EPSILON / 2.0;

/// How far aside of the exact line a tracer that rounds to f64 may see it, over U (|origin|∞ + |vertex|∞).
///
/// Mapping the origin into stored space rounds once and so does each v − o: with the shear (its rounding, product, difference; |shear| <= 1) at most 8 in each
/// sheared coordinate. A sign of an edge function is right or 0; it is 0 where the line passes the edge within 8 more. Together
/// below 24 across two coordinates. A start on a surface is a sum of three products, 8 more; the referee's own f64 distances take 16.
pub const ASIDE: f64 = 48.0;

/// How far off along the ray: n·(v − o) and n·d are each off by at most this, times U |e1|₁|e2|₁, times |origin|∞ + |vertex|∞ or |d|.
pub const ALONG: f64 = 20.0;

/// Triangles whose exact f32 vertices are the truth.
#[derive(Debug)]
pub struct Referee {
    pub triangles: Vec<[[f32; 3]; 3]>,
    /// What each triangle is exactly, once a ray has asked for it.
    exact: Vec<OnceLock<Box<ExactTriangle>>>,
    tree: SphereTree,
    /// The largest magnitude of a coordinate.
    extent: f64,
}

/// A triangle's corners and the normal (b − a) × (c − a), exactly.
#[derive(Debug)]
pub struct ExactTriangle {
    pub corners: [Exact3; 3],
    pub normal: Exact3,
    /// The normal, rounded.
    plain_normal: DVec3,
}

impl ExactTriangle {
    pub fn new(vertices: &[[f32; 3]; 3]) -> Self {
        let corners = vertices.map(|v| exact(v.map(f64::from)));
        let [a, b, c] = &corners;
        let normal = dyadic::cross(&dyadic::minus(b, a), &dyadic::minus(c, a));
        let plain_normal = DVec3::from(std::array::from_fn(|k| normal[k].approximate()));
        ExactTriangle { corners, normal, plain_normal }
    }

    /// On which side of the plane these vertices lie: the sign of n·(v − a).
    pub fn sides(&self, vertices: &[[f32; 3]; 3]) -> [i32; 3] {
        vertices.map(|v| {
            dyadic::dot(&self.normal, &dyadic::minus(&exact(v.map(f64::from)), &self.corners[0])).sign()
        })
    }
}

/// A ray, exactly.
#[derive(Clone, Debug)]
pub struct ExactRay {
    origin: Exact3,
    direction: Exact3,
    /// The origin rounded to f64.
    near_origin: DVec3,
    /// Unit direction and the two that span the plane across it, rounded.
    forward: DVec3,
    across: [DVec3; 2],
    /// The direction in f64 exactly.
    plain_direction: DVec3,
}

/// A triangle that the ray meets or passes within the bound.
#[derive(Clone, Debug)]
pub struct Meeting {
    pub primitive: u32,
    /// Whether the closed triangle is met exactly, edges included, and not in its own plane.
    pub met: bool,
    /// Whether that holds for every line within the bound.
    pub surely: bool,
    /// t of the plane is `numerator / denominator`, exactly; no t where the ray runs in the plane.
    numerator: Dyadic,
    denominator: Dyadic,
    /// That t rounded, or NaN.
    pub t: f64,
    /// How far a rounded t may lie from it.
    blur: f64,
    /// What t changes by where the ray is moved by 1.
    pub steepness: f64,
    /// Where the ray passes the triangle's own box, widened by the bound.
    slab: [f64; 2],
    /// Whether the ray is so nearly in the plane that only `slab` is asked of a rounded t.
    grazing: bool,
    /// Whether f64 can't tell the ray from the plane's directions.
    pub level: bool,
}

impl Meeting {
    /// Whether it is met at or after the ray's origin.
    pub fn ahead(&self) -> bool {
        self.met && self.numerator.sign() * self.denominator.sign() >= 0
    }

    /// Whether it is met after the ray's origin.
    pub fn beyond_origin(&self) -> bool {
        self.met && self.numerator.sign() * self.denominator.sign() > 0
    }

    /// Whether its plane, met or not, lies after the ray's origin.
    pub fn plane_is_ahead(&self) -> bool {
        self.numerator.sign() * self.denominator.sign() > 0
    }

    /// From which side it is met: the sign of n·d.
    pub fn side(&self) -> i32 {
        self.denominator.sign()
    }

    /// The exact order along the ray.
    pub fn order(&self, other: &Meeting) -> Ordering {
        if (self.t - other.t).abs() > 1e-13 * (self.t.abs() + other.t.abs()) {
            return self.t.total_cmp(&other.t);
        }
        let left = self.numerator.times(&other.denominator);
        let right = other.numerator.times(&self.denominator);
        let difference = left.minus(&right).sign() * self.denominator.sign() * other.denominator.sign();
        difference.cmp(&0)
    }

    /// Whether a rounded answer to a ray up to `slack` aside may give this t for it.
    pub fn allows(&self, t: f64, slack: f64) -> bool {
        (t - self.t).abs() <= self.blur + slack * self.steepness
            || (self.level && self.slab[0] <= t && t <= self.slab[1])
    }

    /// Whether a line within the bound may meet it as early as `first` and another as late as `last`: it is seen nearly edge-on. `reach` bounds the error of t.
    pub fn spans(&self, first: f64, last: f64, reach: f64) -> bool {
        let covers = |low: f64, high: f64| low <= first && high >= last;
        covers(self.t - reach, self.t + reach) || (self.level && covers(self.slab[0], self.slab[1]))
    }

    /// Whether it is too near to the origin to tell that it lies ahead.
    pub fn optional(&self) -> bool {
        self.t.is_nan() || self.t <= self.uncertainty()
    }

    /// How far from `t` a rounded answer may lie.
    pub fn uncertainty(&self) -> f64 {
        // A rounded t is clamped to the slab; where there is no blur to speak of (NaN), that is all that holds it.
        if self.grazing { self.blur.min((self.slab[1] - self.slab[0]).max(0.0)) } else { self.blur }
    }
}

impl ExactRay {
    /// `origin` is given exactly as a sum of terms.
    pub fn new(origin: Exact3, direction: DVec3) -> Self {
        let near_origin = DVec3::from(std::array::from_fn(|k| origin[k].approximate()));
        // Two steps, so that no length leaves f64's range.
        let forward = (direction / direction.abs().max_element()).normalize();
        let across = forward.any_orthonormal_vector();
        ExactRay {
            origin,
            direction: exact(direction.to_array()),
            near_origin,
            forward,
            across: [across, forward.cross(across)],
            plain_direction: direction,
        }
    }

    pub fn plain(origin: DVec3, direction: DVec3) -> Self {
        ExactRay::new(exact(origin.to_array()), direction)
    }

    /// The same ray moved aside.
    pub fn moved(&self, by: DVec3) -> Self {
        let origin = dyadic::plus(&self.origin, &exact(by.to_array()));
        let near_origin = DVec3::from(std::array::from_fn(|k| origin[k].approximate()));
        ExactRay { origin, near_origin, direction: self.direction.clone(), ..*self }
    }

    /// Rays around it at this distance.
    pub fn ring(&self, distance: f64) -> impl Iterator<Item = ExactRay> + '_ {
        const COUNT: u32 = 32;
        (0..COUNT).map(move |k| {
            let (y, x) = libm::sincos(TAU * f64::from(k) / f64::from(COUNT));
            self.moved((self.across[0] * x + self.across[1] * y) * distance)
        })
    }

    /// The coordinates of a point across the ray.
    fn place(&self, point: [f32; 3]) -> [f64; 2] {
        let from = DVec3::from(point.map(f64::from)) - self.near_origin;
        [self.across[0].dot(from), self.across[1].dot(from)]
    }

    /// The same, exact but for one rounding of each.
    fn exact_place(&self, point: [f32; 3]) -> DVec2 {
        let from = dyadic::minus(&exact(point.map(f64::from)), &self.origin);
        DVec2::from(self.across.map(|axis| dyadic::dot(&exact(axis.to_array()), &from).approximate()))
    }

    /// Whether the ray's line comes within the bound of a segment.
    pub fn passes_segment(&self, ends: &[[f32; 3]; 2], bound: f64) -> bool {
        distance_to_segment(self.place(ends[0]), self.place(ends[1])) <= bound
    }

    /// Whether the ray leads towards a point, rounded.
    pub fn is_ahead(&self, point: DVec3) -> bool {
        (point - self.near_origin).dot(self.forward) >= 0.0
    }

    /// Distance of the ray's line from a point, rounded.
    pub fn distance_aside(&self, point: DVec3) -> f64 {
        (point - self.near_origin).reject_from_normalized(self.forward).length()
    }

    /// Distance of the origin from a point, rounded.
    pub fn distance(&self, point: [f32; 3]) -> f64 {
        self.near_origin.distance(DVec3::from(point.map(f64::from)))
    }

    /// Distance of the origin from a triangle's plane: found exactly, then rounded.
    pub fn distance_from_plane(&self, triangle: &ExactTriangle) -> f64 {
        let height = dyadic::dot(&triangle.normal, &dyadic::minus(&self.origin, &triangle.corners[0]));
        height.approximate().abs() / triangle.plain_normal.length()
    }

    /// Length of the direction, as its largest component.
    pub fn length(&self) -> f64 {
        self.plain_direction.abs().max_element()
    }
}

impl Referee {
    pub fn new(triangles: Vec<[[f32; 3]; 3]>) -> Self {
        let extent = triangles.iter().flatten().flatten().fold(0.0, |m: f64, &c| m.max(f64::from(c).abs()));
        let tree = SphereTree::build(&triangles);
        let exact = triangles.iter().map(|_| OnceLock::new()).collect();
        Referee { triangles, exact, tree, extent }
    }

    /// The triangle, exactly.
    pub fn exact(&self, primitive: u32) -> &ExactTriangle {
        let index = primitive as usize;
        self.exact[index].get_or_init(|| Box::new(ExactTriangle::new(&self.triangles[index])))
    }

    /// The unit of all bounds for this ray: U (|origin|∞ + |vertex|∞).
    pub fn unit(&self, ray: &ExactRay) -> f64 {
        U * (ray.near_origin.abs().max_element() + self.extent)
    }

    /// How far aside of the exact line a rounded one may run.
    pub fn aside(&self, ray: &ExactRay) -> f64 {
        ASIDE * self.unit(ray)
    }

    /// The same for what one triangle alone makes of it.
    fn unit_at(&self, ray: &ExactRay, primitive: u32) -> f64 {
        let corners = self.triangles[primitive as usize];
        let extent = corners.iter().flatten().fold(0.0, |m: f64, &c| m.max(f64::from(c).abs()));
        U * (ray.near_origin.abs().max_element() + extent)
    }

    /// All triangles that the ray's line exactly meets, ahead of the origin or not far behind.
    pub fn meetings(&self, ray: &ExactRay) -> Vec<Meeting> {
        let mut found = Vec::new();
        self.tree.near_line(ray.near_origin, ray.forward, 2.0 * self.aside(ray), |primitive| {
            let (met, surely) = self.passes(ray, primitive, 0.0).unwrap_or((false, false));
            if met {
                found.extend(Some(self.measure(ray, primitive, true, surely, 0.0)).filter(|found| found.met));
            }
        });
        found
    }

    /// All triangles that the ray's line meets or passes within the bound, ahead of the origin or not far behind.
    pub fn near(&self, ray: &ExactRay) -> Vec<Meeting> {
        let mut found = Vec::new();
        self.tree.near_line(ray.near_origin, ray.forward, 2.0 * self.aside(ray), |primitive| {
            found.extend(self.meeting(ray, primitive, 0.0));
        });
        found
    }

    /// Rays within this distance that pass between the edges leaving a corner that `ray` passes as near: the outline may have a notch there that is narrower than any ring of rays shows.
    pub fn between_edges(&self, ray: &ExactRay, distance: f64) -> Vec<ExactRay> {
        let near: Vec<[[f32; 3]; 3]> =
            self.near(ray).iter().map(|meeting| self.triangles[meeting.primitive as usize]).collect();
        let mut corners: Vec<([f32; 3], DVec2)> = near
            .iter()
            .flatten()
            .map(|&corner| (corner, ray.exact_place(corner)))
            .filter(|(_, place)| place.length() < distance)
            .collect();
        corners.sort_by(|(a, _), (b, _)| a.partial_cmp(b).unwrap_or(Ordering::Equal));
        corners.dedup_by(|(a, _), (b, _)| a == b);
        let mut angles = Vec::new();
        for (corner, place) in &corners {
            for triangle in near.iter().filter(|triangle| triangle.contains(corner)) {
                let along = triangle.map(|end| ray.exact_place(end) - *place);
                angles.extend(along.iter().filter(|v| v.length() > distance).map(|v| libm::atan2(v.y, v.x)));
            }
        }
        angles.sort_by(f64::total_cmp);
        let next = angles.iter().skip(1).copied().chain(angles.first().map(|first| first + TAU));
        let between: Vec<f64> = angles.iter().zip(next).map(|(a, b)| 0.5 * (a + b)).collect();
        let beside = |(place, angle): (DVec2, f64)| {
            let (y, x) = libm::sincos(angle);
            let at = place + DVec2::new(x, y) * (distance - place.length());
            ray.moved(ray.across[0] * at.x + ray.across[1] * at.y)
        };
        corners.iter().flat_map(|(_, place)| between.iter().map(|angle| beside((*place, *angle)))).collect()
    }

    /// The one triangle, if the ray's line meets it or passes within the bound and `slack` more.
    pub fn meeting(&self, ray: &ExactRay, primitive: u32, slack: f64) -> Option<Meeting> {
        let (met, surely) = self.passes(ray, primitive, slack)?;
        Some(self.measure(ray, primitive, met, surely, slack))
    }

    /// Whether the line exactly meets the triangle, and whether every line within the bound does; `None` if none of them does.
    fn passes(&self, ray: &ExactRay, primitive: u32, slack: f64) -> Option<(bool, bool)> {
        let vertices = &self.triangles[primitive as usize];
        let bound = ASIDE * self.unit_at(ray, primitive) + slack;
        let places = vertices.map(|v| ray.place(v));
        match judge_flat(places, bound) {
            Flat::Out => None,
            Flat::Inside => Some((true, true)),
            Flat::Border => Some((self.meets_exactly(ray, primitive, places, bound), false)),
        }
    }

    /// Whether the line meets the closed triangle, by the exact signs of d · ((a − o) × (b − o)) around it.
    fn meets_exactly(&self, ray: &ExactRay, primitive: u32, places: [[f64; 2]; 3], bound: f64) -> bool {
        let corners = &self.exact(primitive).corners;
        let sign = |a: usize, b: usize| {
            let ([ax, ay], [bx, by]) = (places[a], places[b]);
            // Of places that are off by less than `bound` this has the right sign.
            let turn = ax * by - ay * bx;
            if turn.abs() > 4.0 * bound * (ax.abs() + ay.abs() + bx.abs() + by.abs()) {
                return if turn > 0.0 { 1 } else { -1 };
            }
            let [a, b] = [a, b].map(|corner| dyadic::minus(&corners[corner], &ray.origin));
            dyadic::dot(&ray.direction, &dyadic::cross(&a, &b)).sign()
        };
        let (first, second) = (sign(0, 1), sign(1, 2));
        if first * second < 0 {
            return false;
        }
        let third = sign(2, 0);
        first * third >= 0 && second * third >= 0
    }

    /// Whether a point, said to be where the ray meets the triangle, lies on the ray's line as nearly as weights of rounded areas can bring it there.
    pub fn holds_point(&self, ray: &ExactRay, primitive: u32, point: DVec3, slack: f64) -> bool {
        let [a, b, c] = self.triangles[primitive as usize].map(|v| DVec3::from(v.map(f64::from)));
        let longest2 = (b - a).length_squared().max((c - b).length_squared()).max((a - c).length_squared());
        let seen = (b - a).cross(c - a).dot(ray.forward).abs();
        let bound = 4.0 * (ASIDE * self.unit_at(ray, primitive) + slack) * (1.0 + longest2 / seen);
        // Seen edge-on, it says nothing: the bound is infinite, or NaN.
        bound.is_nan() || ray.distance_aside(point) <= bound
    }

    fn measure(&self, ray: &ExactRay, primitive: u32, met: bool, surely: bool, slack: f64) -> Meeting {
        let vertices = &self.triangles[primitive as usize];
        let ExactTriangle { corners, normal, plain_normal } = self.exact(primitive);
        let numerator = dyadic::dot(normal, &dyadic::minus(&corners[0], &ray.origin));
        let denominator = dyadic::dot(normal, &ray.direction);
        let t = ratio(&numerator, &denominator);

        let [pa, pb, pc] = vertices.map(|v| DVec3::from(v.map(f64::from)));
        let sum = |v: DVec3| v.abs().element_sum();
        let spread = sum(pb - pa) * sum(pc - pa);
        let along = denominator.approximate().abs();
        let length = sum(ray.plain_direction);
        let unit = self.unit_at(ray, primitive);
        let tilt = sum(*plain_normal);
        let blur = ALONG * (unit + U * t.abs() * length) * spread / along + 8.0 * U * t.abs();
        // Twice the tracer's own limit: rounding may put it on either side.
        let grazing = along.is_nan() || along <= spread * length / 16_384.0;
        let slab = slab(ray, vertices, ASIDE * unit + slack);
        let met = met && denominator.sign() != 0;
        let steepness = tilt / along;
        Meeting {
            primitive,
            met,
            surely: surely && met,
            numerator,
            denominator,
            t,
            blur,
            steepness,
            slab,
            grazing,
            level: along <= ALONG * U * spread * length,
        }
    }
}

enum Flat {
    Out,
    Inside,
    /// Some point of the border lies within the bound.
    Border,
}

/// Where the origin of the plane across the ray lies to a triangle in it, up to `bound`.
fn judge_flat(corners: [[f64; 2]; 3], bound: f64) -> Flat {
    for axis in 0..2 {
        let [a, b, c] = corners.map(|corner| corner[axis]);
        if a.min(b).min(c) > bound || a.max(b).max(c) < -bound {
            return Flat::Out;
        }
    }
    let pairs = [(0, 1), (1, 2), (2, 0)];
    if pairs.iter().any(|&(from, to)| distance_to_segment(corners[from], corners[to]) <= bound) {
        return Flat::Border;
    }
    // No border is near: f64 signs are right.
    let turns = pairs.map(|(from, to)| {
        let ([ax, ay], [bx, by]) = (corners[from], corners[to]);
        ax * by - ay * bx > 0.0
    });
    if turns[0] == turns[1] && turns[1] == turns[2] { Flat::Inside } else { Flat::Out }
}

/// Distance of (0, 0) from the segment.
fn distance_to_segment([ax, ay]: [f64; 2], [bx, by]: [f64; 2]) -> f64 {
    let (dx, dy) = (bx - ax, by - ay);
    let length2 = dx * dx + dy * dy;
    let s = if length2 > 0.0 { (-(ax * dx + ay * dy) / length2).clamp(0.0, 1.0) } else { 0.0 };
    let (x, y) = (ax + s * dx, ay + s * dy);
    (x * x + y * y).sqrt()
}

/// Where the line is within the triangle's box, widened on all sides.
fn slab(ray: &ExactRay, vertices: &[[f32; 3]; 3], wider: f64) -> [f64; 2] {
    let (mut near, mut far) = (f64::NEG_INFINITY, f64::INFINITY);
    for axis in 0..3 {
        let d = ray.plain_direction[axis];
        if d == 0.0 {
            continue;
        }
        let [a, b, c] = vertices.map(|v| f64::from(v[axis]));
        let low = (a.min(b).min(c) - wider - ray.near_origin[axis]) / d;
        let high = (a.max(b).max(c) + wider - ray.near_origin[axis]) / d;
        near = near.max(low.min(high));
        far = far.min(low.max(high));
    }
    let rounding = 8.0 * U * near.abs().max(far.abs());
    [near - rounding, far + rounding]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two triangles of the unit square at z = 0, and one at z = -1 under the first.
    fn square() -> Referee {
        let [a, b, c, d] = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0f32]];
        let below = [a, b, c].map(|[x, y, _]| [x, y, -1.0]);
        Referee::new(vec![[a, b, c], [a, c, d], below])
    }

    fn ids(referee: &Referee, origin: [f64; 3], direction: [f64; 3]) -> Vec<u32> {
        let ray = ExactRay::plain(DVec3::from(origin), DVec3::from(direction));
        let mut met: Vec<_> = referee.meetings(&ray).into_iter().filter(Meeting::ahead).collect();
        met.sort_by(|a, b| a.order(b).then(a.primitive.cmp(&b.primitive)));
        met.iter().map(|m| m.primitive).collect()
    }

    #[test]
    fn edges_and_corners_belong_to_all_their_triangles() {
        let down = [0.0, 0.0, -1.0];
        assert_eq!(ids(&square(), [0.75, 0.25, 1.0], down), [0, 2]);
        assert_eq!(ids(&square(), [0.25, 0.75, 1.0], down), [1]);
        assert_eq!(ids(&square(), [0.5, 0.5, 1.0], down), [0, 1, 2]);
        assert_eq!(ids(&square(), [0.0, 0.0, 1.0], down), [0, 1, 2]);
        assert_eq!(ids(&square(), [0.75, 0.25, -0.5], down), [2]);
        assert_eq!(ids(&square(), [0.75, 0.25, 0.0], down), [0, 2], "at the origin itself");
    }

    #[test]
    fn a_denormal_aside_of_an_edge_is_outside() {
        let down = [0.0, 0.0, -1.0];
        assert_eq!(ids(&square(), [-5e-324, 0.5, 1.0], down), [0u32; 0]);
        assert_eq!(ids(&square(), [5e-324, 0.5, 1.0], down), [1]);
        // The tilt carries the ray over the edge by less than any f64 could say.
        assert_eq!(ids(&square(), [0.0, 0.5, 1.0], [-5e-324, 0.0, -1.0]), [0u32; 0]);
    }

    #[test]
    fn a_ray_in_the_plane_meets_nothing() {
        assert_eq!(ids(&square(), [-1.0, 0.25, 0.0], [1.0, 0.0, 0.0]), [0u32; 0]);
        assert_eq!(ids(&square(), [-1.0, 0.25, 5e-324], [1.0, 0.0, -5e-324]), [1]);
    }

    #[test]
    fn what_is_only_near_is_named_but_not_met() {
        let referee = square();
        let ray = ExactRay::plain(DVec3::new(-1e-16, 0.5, 1.0), DVec3::NEG_Z);
        assert!(referee.meetings(&ray).is_empty());
        let near = referee.meeting(&ray, 1, 0.0).expect("it passes within the bound");
        assert!(!near.met && near.allows(1.0, 0.0) && !near.allows(1.0 + 1e-12, 0.0));
        assert!(referee.meeting(&ray.moved(DVec3::X * -1e-12), 1, 0.0).is_none());
    }

    #[test]
    fn notches_narrower_than_a_ring_are_looked_into() {
        // A disc with a wedge of 0.01 missing, its apex where the ray passes.
        let apex = [0.25, 0.5, 0.0f32];
        let rim: Vec<[f32; 3]> = (0..=5u8)
            .map(|k| {
                let (y, x) = libm::sincos(0.5 + (TAU - 0.01) / 5.0 * f64::from(k));
                [(0.25 + x) as f32, (0.5 + y) as f32, 0.0]
            })
            .collect();
        let referee = Referee::new(rim.windows(2).map(|side| [apex, side[0], side[1]]).collect());
        let ray = ExactRay::plain(DVec3::new(0.25, 0.5, 1.0), DVec3::NEG_Z);
        let distance = referee.aside(&ray);
        assert!(ray.ring(distance).all(|ray| !referee.meetings(&ray).is_empty()));
        let between = referee.between_edges(&ray, distance);
        assert_eq!(between.iter().filter(|ray| referee.meetings(ray).is_empty()).count(), 1);
        assert!(between.iter().all(|moved| moved.distance_aside(DVec3::new(0.25, 0.5, 0.0)) <= distance + U));
    }

    #[test]
    fn the_order_of_surfaces_closer_than_f64_can_tell_is_exact() {
        let tilted = |z: f32| [[-4.0, -4.0, z], [5.0, -3.0, z], [0.0, 7.0, 3.0f32]];
        let referee = Referee::new(vec![tilted(1.0), tilted(1.0f32.next_up())]);
        let meet = |direction: [f64; 3]| ids(&referee, [0.0, 6.999_999_999_999_9, 0.0], direction);
        assert_eq!(meet([0.0, 0.0, 1.0]), [0, 1]);
        assert_eq!(meet([1e-17, 0.0, 1.0]), [0, 1]);
    }
}
