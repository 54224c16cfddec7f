//! Arithmetic that meets a ray with a sphere and reflects it: textbook floating point, and the renderer's own. Knows no scene.

use glam::DVec3;

use crate::geometry::{NONE, Prepared, Ray, position, sphere};

/// A way to compute with rays and spheres. Positions lie in the cube [-1, 1]³, distances between them below 2.
pub trait Arithmetic: Sync {
    type Ray: Copy + Send + Sync;
    type Ball: Copy + Send + Sync;
    type T: Copy + PartialOrd;
    fn ball(&self, center: DVec3, radius: f64) -> Self::Ball;
    fn ray(&self, origin: DVec3, direction: DVec3) -> Self::Ray;
    /// The first crossing ahead.
    fn meet(&self, ray: &Self::Ray, ball: &Self::Ball) -> Option<Self::T>;
    fn bounce(&self, ray: &Self::Ray, ball: &Self::Ball, t: Self::T) -> Bounce<Self::Ray>;
    /// From the ray's origin to its point at t, in units of space.
    fn distance(&self, ray: &Self::Ray, t: Self::T) -> f64;
    /// Of unit length.
    fn direction(&self, ray: &Self::Ray) -> DVec3;
}

/// What a mirror makes of a ray.
#[derive(Clone, Copy, Debug)]
pub struct Bounce<R> {
    /// Of unit length, as seen from f64.
    pub normal: DVec3,
    pub reflected: R,
}

macro_rules! textbook {
    ($name:ident, $ray:ident, $float:ty, $doc:literal) => {
        #[doc = $doc]
        pub struct $name;

        #[derive(Clone, Copy, Debug)]
        pub struct $ray {
            origin: [$float; 3],
            direction: [$float; 3],
        }

        impl $ray {
            /// Where the ray's line enters and leaves.
            #[inline]
            pub fn crossings(&self, (center, radius): &([$float; 3], $float)) -> Option<[$float; 2]> {
                let dot = |a: [$float; 3], b: [$float; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
                let f: [$float; 3] = std::array::from_fn(|axis| self.origin[axis] - center[axis]);
                let a = dot(self.direction, self.direction);
                let b = 2.0 * dot(f, self.direction);
                let c = dot(f, f) - radius * radius;
                let discriminant = b * b - 4.0 * a * c;
                if discriminant < 0.0 {
                    return None;
                }
                let root = discriminant.sqrt();
                Some([(-b - root) / (2.0 * a), (-b + root) / (2.0 * a)])
            }
        }

        impl Arithmetic for $name {
            type Ray = $ray;
            type Ball = ([$float; 3], $float);
            type T = $float;

            fn ball(&self, center: DVec3, radius: f64) -> Self::Ball {
                (center.to_array().map(|c| c as $float), radius as $float)
            }

            fn ray(&self, origin: DVec3, direction: DVec3) -> $ray {
                let of = |v: DVec3| v.to_array().map(|c| c as $float);
                $ray { origin: of(origin), direction: of(direction) }
            }

            #[inline]
            fn meet(&self, ray: &$ray, ball: &Self::Ball) -> Option<$float> {
                let [near, far] = ray.crossings(ball)?;
                if near > 0.0 { Some(near) } else { (far > 0.0).then_some(far) }
            }

            fn bounce(&self, ray: &$ray, (center, radius): &Self::Ball, t: $float) -> Bounce<$ray> {
                let d = ray.direction;
                let point: [$float; 3] = std::array::from_fn(|axis| ray.origin[axis] + t * d[axis]);
                let n: [$float; 3] = std::array::from_fn(|axis| (point[axis] - center[axis]) / radius);
                let twice = 2.0 * (n[0] * d[0] + n[1] * d[1] + n[2] * d[2]);
                let reflected =
                    $ray { origin: point, direction: std::array::from_fn(|axis| d[axis] - twice * n[axis]) };
                Bounce { normal: DVec3::from(n.map(f64::from)).normalize(), reflected }
            }

            fn distance(&self, ray: &$ray, t: $float) -> f64 {
                f64::from(t) * DVec3::from(ray.direction.map(f64::from)).length()
            }

            fn direction(&self, ray: &$ray) -> DVec3 {
                DVec3::from(ray.direction.map(f64::from)).normalize()
            }
        }
    };
}
textbook!(
    TextbookF32,
    RayF32,
    f32,
    "The quadratic formula as in Glassner 1989, \"An Introduction to Ray Tracing\", ch. 2, in f32."
);
textbook!(
    TextbookF64,
    RayF64,
    f64,
    "The quadratic formula as in Glassner 1989, \"An Introduction to Ray Tracing\", ch. 2, in f64."
);

/// What the renderer does: [`sphere::first`] (Haines, Günther & Akenine-Möller 2019), in f64.
pub struct Product;

impl Product {
    fn prepare(origin: DVec3, direction: DVec3) -> Prepared {
        let (t_min, t_max) = (0.0, f64::INFINITY);
        Prepared::new(&Ray { origin, direction, t_min, t_max, first_id: 0, start: NONE })
    }
}

impl Arithmetic for Product {
    type Ray = Prepared;
    type Ball = ([f64; 3], f64);
    type T = f64;

    fn ball(&self, center: DVec3, radius: f64) -> Self::Ball {
        (center.to_array(), radius)
    }

    fn ray(&self, origin: DVec3, direction: DVec3) -> Prepared {
        Self::prepare(origin, direction)
    }

    #[inline]
    fn meet(&self, ray: &Prepared, (center, radius): &Self::Ball) -> Option<f64> {
        sphere::first(ray, *center, *radius, 0)
    }

    fn bounce(&self, ray: &Prepared, (center, radius): &Self::Ball, t: f64) -> Bounce<Prepared> {
        let d = DVec3::from(ray.direction);
        let hit = DVec3::from(ray.origin) + d * t;
        let (point, normal) = position::on_sphere(DVec3::from(*center), *radius, hit);
        Bounce { normal, reflected: Self::prepare(point, d - normal * (2.0 * d.dot(normal))) }
    }

    fn distance(&self, ray: &Prepared, t: f64) -> f64 {
        t * DVec3::from(ray.direction).length()
    }

    fn direction(&self, ray: &Prepared) -> DVec3 {
        DVec3::from(ray.direction).normalize()
    }
}
