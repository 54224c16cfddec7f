//! One ray against single primitives: keeps the least (t, id) that counts.

use crate::geometry::record::Answer;
use crate::geometry::start::Start;
use crate::geometry::triangle::{self, TriangleHit};
use crate::geometry::{NONE, Prepared, Ray, sphere};
use crate::scene::Surfaces;
use crate::scene::mesh::{Shape, Sphere};

/// A decided hit.
#[derive(Clone, Copy, Debug)]
pub struct Best {
    /// In units of the scaled direction.
    pub t: f64,
    weights: [f64; 3],
    primitive: u32,
}

impl Best {
    pub const NONE: Best = Best { t: f64::INFINITY, weights: [0.0; 3], primitive: NONE };
}

/// A ray on its way through the primitives, with the best hit so far.
pub struct Tester<'a> {
    pub surfaces: &'a Surfaces,
    pub ray: Prepared,
    pub start: u32,
    /// The triangle that the ray starts on, if it does.
    start_triangle: Option<Start>,
    /// The sphere that the ray starts on, if it does.
    start_sphere: Option<Sphere>,
    /// In units of the scaled direction; only (t, id) below (`t_best`, `primitive`) counts.
    pub t_best: f64,
    primitive: u32,
    weights: [f64; 3],
}

impl<'a> Tester<'a> {
    #[inline]
    pub fn new(surfaces: &'a Surfaces, ray: &Ray) -> Self {
        let prepared = Prepared::new(ray);
        let (mut start_triangle, mut start_sphere) = (None, None);
        match surfaces.start(ray.start) {
            Some(Shape::Triangle(corners)) => {
                start_triangle = Some(Start::new(corners.map(widened), prepared.origin));
            }
            Some(Shape::Sphere(sphere)) => start_sphere = Some(sphere),
            None => {}
        }
        Tester {
            surfaces,
            ray: prepared,
            start: ray.start,
            start_triangle,
            start_sphere,
            t_best: prepared.t_max,
            primitive: NONE,
            weights: [0.0; 3],
        }
    }

    /// Goes on from what was decided before.
    pub fn resume(&mut self, best: &Best) {
        (self.t_best, self.primitive, self.weights) = (best.t, best.primitive, best.weights);
    }

    /// The best hit so far.
    pub fn best(&self) -> Best {
        Best { t: self.t_best, weights: self.weights, primitive: self.primitive }
    }

    /// Tests one primitive.
    #[inline(always)]
    pub fn test(&mut self, primitive: u32) {
        if (primitive as usize) < self.surfaces.triangles.len() {
            self.test_triangle(primitive);
        } else {
            self.test_sphere(primitive);
        }
    }

    #[inline(always)]
    fn test_triangle(&mut self, primitive: u32) {
        self.test_corners(primitive, &corners(self.surfaces, primitive));
    }

    /// Tests a triangle whose corners are at hand.
    #[inline(always)]
    pub fn test_corners(&mut self, primitive: u32, corners: &[[f64; 3]; 3]) {
        if primitive != self.start {
            self.offer_hit(primitive, self.meet(corners));
        }
    }

    /// Where the ray, whatever its range, meets a triangle that it doesn't start on.
    #[inline(always)]
    pub fn meet(&self, corners: &[[f64; 3]; 3]) -> Option<TriangleHit> {
        match &self.start_triangle {
            None => triangle::intersect(&self.ray, corners),
            Some(start) => start.meet(&self.ray, corners),
        }
    }

    /// Keeps a triangle's hit, if it counts.
    #[inline]
    pub fn offer_hit(&mut self, primitive: u32, hit: Option<TriangleHit>) {
        if let Some(hit) = hit
            && self.counts(hit.t, primitive)
        {
            self.t_best = hit.t;
            self.primitive = primitive;
            self.weights = hit.weights;
        }
    }

    #[inline]
    pub fn found(&self) -> bool {
        self.primitive != NONE
    }

    /// The answer; with `any` only whether there is a hit, as primitive 0.
    #[inline]
    pub fn verdict(&self, any: bool) -> Answer {
        match any {
            false => self.answer(),
            true if self.found() => Answer { primitive: 0, ..Answer::MISS },
            true => Answer::MISS,
        }
    }

    fn test_sphere(&mut self, primitive: u32) {
        if let Some(t) = self.meet_sphere(primitive) {
            self.offer(t, primitive);
        }
    }

    /// Where the ray first meets a sphere after its begin.
    #[inline]
    pub fn meet_sphere(&self, primitive: u32) -> Option<f64> {
        let index = primitive as usize - self.surfaces.triangles.len();
        let sphere = &self.surfaces.spheres[index];
        let center = sphere.center.map(f64::from);
        if self.starts_on(primitive, index) {
            sphere::leave(&self.ray, center)
        } else {
            sphere::first(&self.ray, center, f64::from(sphere.radius), primitive)
        }
    }

    /// Whether the ray starts on this sphere or on one that coincides with it.
    fn starts_on(&self, primitive: u32, index: usize) -> bool {
        primitive == self.start || self.start_sphere.is_some_and(|own| own == self.surfaces.spheres[index])
    }

    fn offer(&mut self, t: f64, primitive: u32) {
        if self.counts(t, primitive) {
            self.t_best = t;
            self.primitive = primitive;
        }
    }

    /// Whether (t, id) lies in the ray's range and before the best so far.
    #[inline]
    fn counts(&self, t: f64, primitive: u32) -> bool {
        self.ray.begun(t, primitive) && (t < self.t_best || (t == self.t_best && primitive < self.primitive))
    }

    /// The best hit, complete.
    fn answer(&self) -> Answer {
        if !self.found() {
            return Answer::MISS;
        }
        let mut answer =
            Answer { t: self.t_best * self.ray.scale, primitive: self.primitive, ..Answer::MISS };
        if (self.primitive as usize) < self.surfaces.triangles.len() {
            let vertices = corners(self.surfaces, self.primitive);
            let hit = TriangleHit { t: self.t_best, weights: self.weights };
            [answer.u, answer.v] = triangle::barycentrics(&self.ray, &vertices, &hit);
        }
        answer
    }
}

#[inline(always)]
fn corners(surfaces: &Surfaces, primitive: u32) -> [[f64; 3]; 3] {
    let [a, b, c] = surfaces.triangle(primitive);
    [widened(a), widened(b), widened(c)]
}

#[inline(always)]
fn widened(v: [f32; 3]) -> [f64; 3] {
    [f64::from(v[0]), f64::from(v[1]), f64::from(v[2])]
}
