//! Boxes: f32 corners, and the padded slab test that never loses what `triangle` and `sphere` call a hit.

use super::Prepared;

/// A ray made ready for slab tests against f32 boxes.
///
/// Both planes of each slab are moved outwards by `pad` = 2^-31 (|origin|∞ + extent), twice the bound of t's error that
/// `triangle::GRAZING` derives; the slab arithmetic's own few ulps of f64 are far below it. The pad is put into the
/// origin, once for the near and once for the far planes, so that it costs nothing per box (Ize 2013, "Robust BVH Ray Traversal",
/// pads by ulps, which is too little for an origin far away).
#[derive(Clone, Copy, Debug)]
pub struct Slabs {
    inverse: [f64; 3],
    near_origin: [f64; 3],
    far_origin: [f64; 3],
    /// Whether the direction's component is negative: then the upper plane is the near one.
    pub negative: [bool; 3],
    t_min: f64,
}

impl Slabs {
    /// `extent` is the largest magnitude of a coordinate of the boxes.
    pub fn new(ray: &Prepared, extent: f64) -> Self {
        let largest = ray.origin.iter().fold(0.0, |m: f64, c| m.max(c.abs()));
        let pad = (largest + extent) * (1.0 / 2_147_483_648.0);
        let negative = ray.direction.map(|d| d < 0.0);
        let side = |axis: usize| if negative[axis] { -pad } else { pad };
        Slabs {
            // Of a zero component no division: a finite, huge slope sends the padded inside to ∓huge .. ±huge, and anything outside beyond every t.
            inverse: ray.direction.map(|d| if d == 0.0 { 1e300 } else { 1.0 / d }),
            near_origin: std::array::from_fn(|axis| ray.origin[axis] + side(axis)),
            far_origin: std::array::from_fn(|axis| ray.origin[axis] - side(axis)),
            negative,
            t_min: ray.t_min,
        }
    }

    /// Where the ray enters the box, if it does so before `t_max`. At most the t of any hit inside.
    #[inline]
    pub fn enter(&self, low: [f32; 3], high: [f32; 3], t_max: f64) -> Option<f64> {
        let (mut near, mut far) = (self.t_min, t_max);
        for axis in 0..3 {
            let (first, last) =
                if self.negative[axis] { (high[axis], low[axis]) } else { (low[axis], high[axis]) };
            near = near.max((f64::from(first) - self.near_origin[axis]) * self.inverse[axis]);
            far = far.min((f64::from(last) - self.far_origin[axis]) * self.inverse[axis]);
        }
        (near <= far).then_some(near)
    }
}

#[cfg(test)]
mod tests {
    use super::super::{NONE, Ray};
    use super::*;
    use glam::DVec3;
    use proptest::prelude::*;

    fn slabs(origin: [f64; 3], direction: [f64; 3]) -> Slabs {
        let ray = Ray {
            origin: DVec3::from(origin),
            direction: DVec3::from(direction),
            t_min: 0.0,
            t_max: f64::INFINITY,
            first_id: 0,
            start: NONE,
        };
        Slabs::new(&Prepared::new(&ray), 1.0)
    }

    #[test]
    fn zero_components_test_the_inside() {
        for zero in [0.0, -0.0] {
            for (x, inside) in [(0.5, true), (0.0, true), (1.0, true), (1.001, false), (-0.001, false)] {
                let found = slabs([x, -1.0, 0.5], [zero, 1.0, zero]).enter([0.0; 3], [1.0; 3], f64::INFINITY);
                assert_eq!(found.is_some(), inside, "{x}");
            }
        }
    }

    #[test]
    fn flat_boxes_are_met() {
        let found = slabs([0.3, -1.0, 0.2], [0.0, 1.0, 0.0]).enter([0.0; 3], [1.0, 0.0, 1.0], f64::INFINITY);
        assert!((found.unwrap() - 1.0).abs() < 1e-8);
    }

    proptest! {
        #[test]
        fn a_point_inside_is_always_reached(
            point in prop::array::uniform3(0.0f64..=1.0),
            origin in prop::array::uniform3(-50.0f64..50.0),
        ) {
            let direction: [f64; 3] = std::array::from_fn(|axis| point[axis] - origin[axis]);
            let found = slabs(origin, direction).enter([0.0; 3], [1.0; 3], f64::INFINITY);
            prop_assert!(found.is_some());
        }
    }
}
