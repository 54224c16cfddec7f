//! Lambert's formula and rectangles, written down apart from the library.

use std::f64::consts::TAU;

use glam::DVec3;

/// The part of the light that leaves a small surface at `point` that meets a polygon wholly above its horizon: the integral of cosine / π over the solid angle.
/// As many radiances of the polygon arrive as irradiance over π (Lambert 1760; Arvo 1995, section 2). Counter-clockwise or not.
pub fn factor(point: DVec3, normal: DVec3, polygon: &[DVec3]) -> f64 {
    let mut sum = DVec3::ZERO;
    for (i, &a) in polygon.iter().enumerate() {
        let b = polygon[(i + 1) % polygon.len()];
        let (a, b) = (a - point, b - point);
        let Some(across) = a.cross(b).try_normalize() else { continue };
        // More exact than the arc cosine where the angle is small.
        sum += across * libm::atan2(a.cross(b).length(), a.dot(b));
    }
    sum.dot(normal).abs() / TAU
}

/// Spanned from a corner; its normal is that of across × along, and it reflects and shines on that side.
#[derive(Clone, Copy, Debug)]
pub struct Rectangle {
    pub corner: DVec3,
    pub across: DVec3,
    pub along: DVec3,
}

impl Rectangle {
    pub fn new(corner: [f64; 3], across: [f64; 3], along: [f64; 3]) -> Self {
        Rectangle { corner: corner.into(), across: across.into(), along: along.into() }
    }

    pub fn normal(&self) -> DVec3 {
        self.across.cross(self.along).normalize()
    }

    pub fn point(&self, [u, v]: [f64; 2]) -> DVec3 {
        self.corner + self.across * u + self.along * v
    }

    pub fn corners(&self) -> [DVec3; 4] {
        [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]].map(|place| self.point(place))
    }

    /// The part between fractions of both edges.
    pub fn part(&self, [u0, u1]: [f64; 2], [v0, v1]: [f64; 2]) -> Self {
        Rectangle {
            corner: self.point([u0, v0]),
            across: self.across * (u1 - u0),
            along: self.along * (v1 - v0),
        }
    }

    /// Distance along a ray and the place met.
    pub fn meet(&self, origin: DVec3, direction: DVec3) -> Option<(f64, [f64; 2])> {
        let normal = self.normal();
        let t = (self.corner - origin).dot(normal) / direction.dot(normal);
        let at = origin + direction * t - self.corner;
        let place = [self.across, self.along].map(|edge| at.dot(edge) / edge.length_squared());
        (t > 0.0 && place.iter().all(|c| (0.0..=1.0).contains(c))).then_some((t, place))
    }
}

/// An OBJ file of one polygon's triangles around its first corner.
pub fn obj(polygon: &[DVec3]) -> Vec<u8> {
    let mut text = String::new();
    for DVec3 { x, y, z } in polygon {
        text += &format!("v {x} {y} {z}\n");
    }
    for i in 2..polygon.len() {
        text += &format!("f 1 {i} {}\n", i + 1);
    }
    text.into_bytes()
}

/// The regular polygon of `count` corners that has the area of a disc, level at height `y`; seen from below it is counter-clockwise.
pub fn disc(radius: f64, y: f64, count: u32) -> Vec<DVec3> {
    let step = TAU / f64::from(count);
    let radius = radius * (step / libm::sin(step)).sqrt();
    (0..count)
        .map(|i| {
            let (sin, cos) = libm::sincos(step * f64::from(i));
            DVec3::new(radius * cos, y, radius * sin)
        })
        .collect()
}

#[test]
fn lambert_agrees_with_a_half_sky_and_a_far_square() {
    let square = |half: f64, y: f64| {
        Rectangle::new([-half, y, -half], [2.0 * half, 0.0, 0.0], [0.0, 0.0, 2.0 * half]).corners()
    };
    assert!((factor(DVec3::ZERO, DVec3::Y, &square(1e9, 1.0)) - 1.0).abs() < 1e-8);
    let far = factor(DVec3::ZERO, DVec3::Y, &square(0.5, 1000.0));
    assert!((far * std::f64::consts::PI * 1e6 - 1.0).abs() < 1e-5, "{far}");
}
