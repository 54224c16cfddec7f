//! Surfaces that shine, as lights: which there are, and points chosen on them.

use std::f64::consts::PI;

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::mesh::{Shape, Sphere, has_area};
use super::{Color, Scene};
use crate::geometry::{NONE, Prepared, Ray, sphere, triangle};

/// A triangle or sphere that shines evenly into all directions.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Emitter {
    /// Its id in the whole scene.
    pub primitive: u32,
    pub shape: Shape,
    pub radiance: Color,
    /// Whether it shines into where its geometric normal doesn't point, too.
    pub both_sides: bool,
}

/// A ray from a point to a chosen point on an emitter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Aim {
    /// Not normalised.
    pub direction: DVec3,
    /// Just before the emitter, in units of `direction`: what lies in the way is met up to here, and the emitter isn't.
    pub t_max: f64,
    /// Of the choice, over solid angle.
    pub pdf: f64,
}

impl Emitter {
    /// Surface area of a side, in stored units.
    pub fn area(&self) -> f64 {
        match &self.shape {
            Shape::Triangle(corners) => 0.5 * normal(corners).length(),
            Shape::Sphere(sphere) => 4.0 * PI * f64::from(sphere.radius) * f64::from(sphere.radius),
        }
    }

    /// A point on the emitter chosen by two numbers in [0, 1), as seen from `from`: on a triangle evenly over its area, on a sphere over the solid angle of it. `None` where no
    /// light comes that way.
    pub fn aim(&self, from: DVec3, [u, v]: [f64; 2]) -> Option<Aim> {
        match &self.shape {
            Shape::Triangle(corners) => self.aim_at_triangle(corners, from, u, v),
            Shape::Sphere(sphere) => self.aim_at_sphere(sphere, from, u, v),
        }
    }

    /// The density with which [`Emitter::aim`] chooses, from `from`, the direction of unit length in which the emitter is met at distance `t`.
    pub fn pdf(&self, from: DVec3, direction: DVec3, t: f64) -> f64 {
        match &self.shape {
            Shape::Triangle(corners) => 2.0 * t * t / direction.dot(normal(corners)).abs(),
            Shape::Sphere(sphere) => 1.0 / solid_angle(sphere, from),
        }
    }

    fn aim_at_triangle(&self, corners: &[[f32; 3]; 3], from: DVec3, u: f64, v: f64) -> Option<Aim> {
        let corners = points(corners);
        let Towards { direction, facing, pdf } = Towards::triangle(&corners, from, u, v);
        if facing == 0.0 || (facing > 0.0 && !self.both_sides) {
            return None;
        }
        let ray = line(from, direction);
        let hit = triangle::intersect(&ray, &corners.map(|corner| corner.to_array()))?;
        Some(Aim { direction, t_max: (hit.t * ray.scale).next_down(), pdf }).filter(Aim::is_sound)
    }

    fn aim_at_sphere(&self, sphere: &Sphere, from: DVec3, u: f64, v: f64) -> Option<Aim> {
        let (center, radius) = (point(sphere.center), f64::from(sphere.radius));
        let to_center = center - from;
        let distance = to_center.length();
        let inside = distance <= radius;
        if inside && !self.both_sides {
            return None;
        }
        let solid_angle = solid_angle(sphere, from);
        // Evenly over the cone's cap: its height is the solid angle over 2 π.
        let cosine = 1.0 - u * (solid_angle / (2.0 * PI));
        let sine = ((1.0 - cosine) * (1.0 + cosine)).max(0.0).sqrt();
        let axis = if distance > 0.0 { to_center / distance } else { DVec3::Z };
        let (across, along) = axis.any_orthonormal_pair();
        let (sin_phi, cos_phi) = libm::sincos(2.0 * PI * v);
        let direction = axis * cosine + (across * (sine * cos_phi) + along * (sine * sin_phi));
        let ray = line(from, direction);
        let t = sphere::first(&ray, sphere.center.map(f64::from), radius, 0)?;
        Some(Aim { direction, t_max: (t * ray.scale).next_down(), pdf: 1.0 / solid_angle })
            .filter(Aim::is_sound)
    }
}

/// A direction, not normalised, to a chosen point on a triangle.
pub struct Towards {
    pub direction: DVec3,
    /// Along the geometric normal: negative towards the side that it points to.
    pub facing: f64,
    /// As [`Aim::pdf`].
    pub pdf: f64,
}

impl Towards {
    /// The point is chosen evenly over the area (Heitz 2019, "A Low-Distortion Map Between Triangle and Square").
    #[inline(always)]
    pub fn triangle(corners: &[DVec3; 3], from: DVec3, u: f64, v: f64) -> Towards {
        let [a, b, c] = *corners;
        let (second, third) = if v > u { (0.5 * u, v - 0.5 * u) } else { (u - 0.5 * v, 0.5 * v) };
        let direction = ((b - a) * second + (c - a) * third) + (a - from);
        let facing = direction.dot((b - a).cross(c - a));
        let length = direction.length();
        Towards { direction, facing, pdf: 2.0 * length * length * length / facing.abs() }
    }
}

impl Aim {
    fn is_sound(&self) -> bool {
        self.t_max > 0.0 && self.pdf.is_finite() && self.direction != DVec3::ZERO
    }
}

/// Of a sphere as seen from a point: all of the sky from inside.
fn solid_angle(sphere: &Sphere, from: DVec3) -> f64 {
    let radius = f64::from(sphere.radius);
    let squared = (point(sphere.center) - from).length_squared();
    let sin2 = radius * radius / squared;
    if sin2 >= 1.0 || sin2.is_nan() {
        return 4.0 * PI;
    }
    // 1 - cos without cancellation.
    2.0 * PI * (sin2 / (1.0 + (1.0 - sin2).sqrt()))
}

/// Of twice the area's length.
#[inline]
fn normal(corners: &[[f32; 3]; 3]) -> DVec3 {
    let [a, b, c] = points(corners);
    (b - a).cross(c - a)
}

#[inline]
fn point(p: [f32; 3]) -> DVec3 {
    DVec3::new(f64::from(p[0]), f64::from(p[1]), f64::from(p[2]))
}

#[inline]
fn points(&[a, b, c]: &[[f32; 3]; 3]) -> [DVec3; 3] {
    [point(a), point(b), point(c)]
}

fn line(origin: DVec3, direction: DVec3) -> Prepared {
    Prepared::new(&Ray { origin, direction, t_min: 0.0, t_max: f64::INFINITY, first_id: 0, start: NONE })
}

impl Scene {
    /// All primitives that shine, ascending by id, and the radius of a sphere around everything: what choosing among lights needs to know of the whole scene.
    pub fn find_emitters(&mut self) {
        let parts = &self.header.parts;
        let ends = parts.iter().skip(1).map(|part| part.first).chain([self.surfaces.len() as u32]);
        let mut emitters = Vec::new();
        for (part, end) in parts.iter().zip(ends) {
            let material = &self.header.materials[part.material as usize];
            if material.emission == [0.0; 3] {
                continue;
            }
            for primitive in part.first..end {
                let shape = match self.surfaces.sphere_at(primitive) {
                    Some(sphere) => Shape::Sphere(*sphere),
                    None => Shape::Triangle(self.surfaces.triangle(primitive)),
                };
                if matches!(shape, Shape::Triangle(corners) if !has_area(&corners)) {
                    continue;
                }
                let both_sides = !material.one_sided;
                emitters.push(Emitter { primitive, shape, radiance: material.emission, both_sides });
            }
        }
        self.header.emitters = emitters;
        self.header.radius = self.surfaces.bounds().map_or(1.0, |(low, high)| 0.5 * (high - low).length());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn emitter(shape: Shape) -> Emitter {
        Emitter { primitive: 0, shape, radiance: [1.0; 3], both_sides: true }
    }

    /// ∫ 1/pdf over what is chosen is the solid angle; `aim` and `pdf` agree; the aim ends just before the surface.
    fn judge(emitter: &Emitter, from: DVec3, solid_angle: f64) {
        let n = 256;
        let mut sum = 0.0;
        for i in 0..n * n {
            let [u, v] = [i % n, i / n].map(|k| (f64::from(k) + 0.5) / f64::from(n));
            let Some(aim) = emitter.aim(from, [u, v]) else { continue };
            let unit = aim.direction.normalize();
            let pdf = emitter.pdf(from, unit, aim.t_max * aim.direction.length());
            assert!((pdf / aim.pdf - 1.0).abs() < 1e-9, "{pdf} {}", aim.pdf);
            sum += 1.0 / aim.pdf;
        }
        let found = sum / f64::from(n * n);
        assert!((found / solid_angle - 1.0).abs() < 2e-4, "{found} instead of {solid_angle}");
    }

    #[test]
    fn densities_are_those_of_the_choices() {
        // An octant's triangle seen from the centre of a cube whose face it halves: a twelfth of the sky.
        let corners = [[-1.0, -1.0, 1.0], [1.0, -1.0, 1.0], [1.0, 1.0, 1.0]];
        judge(&emitter(Shape::Triangle(corners)), DVec3::ZERO, 4.0 * PI / 12.0);
        let sphere = emitter(Shape::Sphere(Sphere { center: [0.0, 3.0, 0.0], radius: 1.5 }));
        // sin = 1/2: 2 π (1 - cos 30°).
        judge(&sphere, DVec3::ZERO, 2.0 * PI * (1.0 - 0.75f64.sqrt()));
        judge(&sphere, DVec3::new(0.3, 2.5, 0.2), 4.0 * PI);
        judge(&sphere, DVec3::new(0.0, 3.0, 0.0), 4.0 * PI);
        let far = DVec3::new(1e6, 3.0, 0.0);
        judge(&sphere, far, PI * 2.25e-12);
    }

    #[test]
    fn the_dark_side_sends_nothing() {
        let corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
        let mut emitter = emitter(Shape::Triangle(corners));
        let (front, back) = (DVec3::new(0.2, 0.2, 2.0), DVec3::new(0.2, 0.2, -2.0));
        assert!(emitter.aim(front, [0.4, 0.3]).is_some() && emitter.aim(back, [0.4, 0.3]).is_some());
        emitter.both_sides = false;
        assert!(emitter.aim(front, [0.4, 0.3]).is_some());
        assert_eq!(emitter.aim(back, [0.4, 0.3]), None);
        // Edge-on there is nothing to aim at.
        assert_eq!(emitter.aim(DVec3::new(5.0, 0.0, 0.0), [0.4, 0.3]), None);
    }
}
