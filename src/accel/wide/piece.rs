//! Boxes of primitives and of parts of them: what a spatial split cuts in two.
//!
//! A triangle's pieces hold every point of it: a cut takes the triangle's part on either side of a plane, in f64, rounded outwards, and of that what lies in the box that it cuts.
//! A hit lies within the rounding of its t of the triangle (`geometry::triangle`), so within that of one of its pieces, and boxes are padded by 2^8 times that when rays enter them (`bundle`).

use glam::Vec3A;
use obvhs::aabb::Aabb;

use crate::geometry::{round_down, round_up};
use crate::scene::Surfaces;

/// Rounding of a cut's point, relative to the triangle's largest coordinate: five operations of 2^-53 each, with room to spare.
const ROUNDING: f64 = 1.0 / (1u64 << 48) as f64;

/// A primitive, or a part of a triangle.
#[derive(Clone, Copy, Debug)]
pub struct Piece {
    pub low: [f32; 3],
    /// Its place in the list of those that are built over.
    pub primitive: u32,
    pub high: [f32; 3],
}

/// A triangle that may be cut.
pub struct Corners {
    corners: [[f64; 3]; 3],
    /// What a point of a cut may be off by.
    off: f64,
}

impl Corners {
    /// None of a sphere, which isn't cut.
    pub fn of(surfaces: &Surfaces, id: u32) -> Option<Corners> {
        if surfaces.sphere_at(id).is_some() {
            return None;
        }
        let (values, mut corners, mut largest) = (surfaces.triangle(id), [[0.0; 3]; 3], 0.0);
        for k in 0..3 {
            for axis in 0..3 {
                corners[k][axis] = f64::from(values[k][axis]);
                largest = f64::max(largest, corners[k][axis].abs());
            }
        }
        Some(Corners { corners, off: largest * ROUNDING })
    }
}

impl Piece {
    pub fn bounds(&self) -> Aabb {
        Aabb::new(Vec3A::from(self.low), Vec3A::from(self.high))
    }

    pub fn with(&self, bounds: &Aabb) -> Piece {
        Piece { low: bounds.min.to_array(), high: bounds.max.to_array(), ..*self }
    }
}

/// Boxes of the parts of a box's piece of a triangle below and above a plane; inside out where there is nothing.
pub fn cut(bounds: &Aabb, triangle: &Corners, axis: usize, plane: f32) -> [Aabb; 2] {
    let (at, mut low, mut high) = (f64::from(plane), [[f64::INFINITY; 3]; 2], [[f64::NEG_INFINITY; 3]; 2]);
    let mut hold = |side: usize, point: [f64; 3], off: f64| {
        for axis in 0..3 {
            low[side][axis] = low[side][axis].min(point[axis] - off);
            high[side][axis] = high[side][axis].max(point[axis] + off);
        }
    };
    for k in 0..3 {
        let (from, to) = (triangle.corners[k], triangle.corners[(k + 1) % 3]);
        let (a, b) = (from[axis], to[axis]);
        if a <= at {
            hold(0, from, 0.0);
        }
        if a >= at {
            hold(1, from, 0.0);
        }
        if (a < at && at < b) || (b < at && at < a) {
            let (along, mut point) = ((at - a) / (b - a), from);
            for axis in 0..3 {
                point[axis] += along * (to[axis] - from[axis]);
            }
            hold(0, point, triangle.off);
            hold(1, point, triangle.off);
        }
    }
    let mut parts = [*bounds; 2];
    for side in 0..2 {
        for axis in 0..3 {
            parts[side].min[axis] = parts[side].min[axis].max(round_down(low[side][axis]));
            parts[side].max[axis] = parts[side].max[axis].min(round_up(high[side][axis]));
        }
    }
    parts[0].max[axis] = parts[0].max[axis].min(plane);
    parts[1].min[axis] = parts[1].min[axis].max(plane);
    parts
}

/// The same in f32, rounded anyhow: good enough to choose a plane by.
#[inline]
pub fn cut_about(bounds: &Aabb, corners: &[Vec3A; 3], axis: usize, plane: f32) -> [Aabb; 2] {
    let (mut low, mut high) = ([Vec3A::INFINITY; 2], [Vec3A::NEG_INFINITY; 2]);
    for k in 0..3 {
        let (from, to) = (corners[k], corners[(k + 1) % 3]);
        let (a, b) = (from[axis], to[axis]);
        if a <= plane {
            (low[0], high[0]) = (low[0].min(from), high[0].max(from));
        }
        if a >= plane {
            (low[1], high[1]) = (low[1].min(from), high[1].max(from));
        }
        if (a < plane && plane < b) || (b < plane && plane < a) {
            let point = from + (to - from) * ((plane - a) / (b - a));
            for side in 0..2 {
                (low[side], high[side]) = (low[side].min(point), high[side].max(point));
            }
        }
    }
    high[0][axis] = high[0][axis].min(plane);
    low[1][axis] = low[1][axis].max(plane);
    [
        Aabb::new(low[0].max(bounds.min), high[0].min(bounds.max)),
        Aabb::new(low[1].max(bounds.min), high[1].min(bounds.max)),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn every_point_of_a_triangle_is_on_one_side_of_a_cut(
            corners in prop::array::uniform3(prop::array::uniform3(prop_oneof![-1.0f32..1.0, Just(0.25f32), -1e-6f32..1e-6])),
            planes in prop::collection::vec((0usize..3, -1.0f32..1.0), 1..6),
            weights in prop::collection::vec((0.0f64..=1.0, 0.0f64..=1.0), 20),
        ) {
            let surfaces = Surfaces { positions: corners.to_vec().into(), triangles: vec![[0, 1, 2]].into(), ..Surfaces::default() };
            let triangle = Corners::of(&surfaces, 0).unwrap();
            let whole = corners.iter().fold(Aabb::empty(), |mut b, &v| *b.extend(Vec3A::from(v)));
            let mut pieces = vec![whole];
            for (axis, plane) in planes {
                let cuts: Vec<_> = pieces.iter().flat_map(|piece| cut(piece, &triangle, axis, plane)).collect();
                for half in &cuts {
                    // Nothing is in a piece that wasn't in the one that was cut.
                    prop_assert!(!half.valid() || pieces.iter().any(|piece| piece.union(half) == *piece));
                }
                pieces = cuts.into_iter().filter(Aabb::valid).collect();
            }
            for (s, t) in weights {
                let weights = [1.0 - s, s * (1.0 - t), s * t];
                let point: [f64; 3] = std::array::from_fn(|axis| (0..3).map(|k| weights[k] * f64::from(corners[k][axis])).sum());
                let holds = |b: &Aabb| (0..3).all(|axis| point[axis] >= f64::from(b.min[axis]) - 1e-15 && point[axis] <= f64::from(b.max[axis]) + 1e-15);
                prop_assert!(pieces.iter().any(holds), "{:?}", point);
            }
        }
    }
}
