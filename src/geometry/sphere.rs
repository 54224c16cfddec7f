//! Where a ray meets a sphere, in f64.
//!
//! Haines, Günther and Akenine-Möller, "Precision Improvements for Ray/Sphere Intersection", Ray Tracing Gems (2019), ch. 7: the
//! discriminant from the distance between line and centre, the smaller root without cancellation.

use super::{Prepared, dot};

/// Both crossings (t near <= t far) of the line with the sphere, in units of the scaled direction.
#[inline]
pub fn intersect(ray: &Prepared, center: [f64; 3], radius: f64) -> Option<[f64; 2]> {
    crossings(ray.origin, ray.direction, center, radius)
}

/// The same for a line that has only these.
#[inline(always)]
pub fn crossings(origin: [f64; 3], d: [f64; 3], center: [f64; 3], radius: f64) -> Option<[f64; 2]> {
    let f = super::sub(origin, center);
    let a = dot(d, d);
    let b = -dot(f, d);
    let shift = b / a;
    let nearest = [f[0] + shift * d[0], f[1] + shift * d[1], f[2] + shift * d[2]];
    let discriminant = radius * radius - dot(nearest, nearest);
    if discriminant < 0.0 {
        return None;
    }
    let root = (a * discriminant).sqrt();
    let q = if b < 0.0 { b - root } else { b + root };
    // (|f| - r)(|f| + r) keeps the digits that |f|^2 - r^2 loses where the origin is near the surface.
    let length = dot(f, f).sqrt();
    let c = (length - radius) * (length + radius);
    let (t0, t1) = (if q == 0.0 { 0.0 } else { c / q }, q / a);
    Some(if t0 <= t1 { [t0, t1] } else { [t1, t0] })
}

/// The first crossing that isn't before the ray's begin, for a sphere of this primitive id.
#[inline]
pub fn first(ray: &Prepared, center: [f64; 3], radius: f64, id: u32) -> Option<f64> {
    intersect(ray, center, radius)?.into_iter().find(|&t| ray.begun(t, id))
}

/// The other crossing of a ray that starts on the sphere itself: there is one only where it goes inwards.
#[inline]
pub fn leave(ray: &Prepared, center: [f64; 3]) -> Option<f64> {
    let d = ray.direction;
    let b = -dot(super::sub(ray.origin, center), d);
    (b > 0.0).then(|| 2.0 * b / dot(d, d))
}

#[cfg(test)]
mod tests {
    use super::super::{NONE, Prepared, Ray};
    use super::*;
    use glam::DVec3;

    fn ray(origin: [f64; 3], direction: [f64; 3]) -> Prepared {
        let (origin, direction) = (DVec3::from(origin), DVec3::from(direction));
        Prepared::new(&Ray { origin, direction, t_min: 0.0, t_max: f64::INFINITY, first_id: 0, start: NONE })
    }

    #[test]
    fn near_and_far_from_outside_and_inside() {
        let hits = |o, d| intersect(&ray(o, d), [0.0; 3], 1.0);
        assert_eq!(hits([-3.0, 0.0, 0.0], [1.0, 0.0, 0.0]), Some([2.0, 4.0]));
        assert_eq!(hits([0.0; 3], [0.0, 1.0, 0.0]), Some([-1.0, 1.0]));
        assert_eq!(hits([-3.0, 1.5, 0.0], [1.0, 0.0, 0.0]), None);
        let grazing = hits([-3.0, 1.0, 0.0], [1.0, 0.0, 0.0]).unwrap();
        assert!(grazing.iter().all(|t| (t - 3.0).abs() < 1e-15), "{grazing:?}");
    }

    #[test]
    fn a_huge_sphere_under_the_feet_keeps_its_digits() {
        // A floor: radius 1e10, its top at y = 0, seen from 1 above.
        let [near, _] = intersect(&ray([0.0, 1.0, 0.0], [0.0, -1.0, 0.0]), [0.0, -1e10, 0.0], 1e10).unwrap();
        assert!((near - 1.0).abs() < 1e-5, "{near}");
    }

    #[test]
    fn leaving_finds_the_far_side_only_inwards() {
        let on = ray([-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]);
        assert_eq!(leave(&on, [0.0; 3]), Some(2.0));
        assert_eq!(leave(&ray([-1.0, 0.0, 0.0], [-1.0, 0.3, 0.0]), [0.0; 3]), None);
    }
}
