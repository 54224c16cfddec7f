//! A textbook tracer that answers for whole images: the kernels of the ladder over a binary hierarchy (Rubin & Whitted 1980, halved at the median), in f32 or in f64. What
//! an image loses by rounding, faults included: boxes aren't padded, the surface that a ray starts on is passed by an ε, and so is whatever else is as near.
//!
//! Knows surfaces and rays. Shading stays as it is, and so does the point of a hit on its surface.

use serde::{Deserialize, Serialize};

use super::sphere::{Arithmetic, TextbookF32, TextbookF64};
use super::triangle;
use crate::accel::Trace;
use crate::geometry::Ray;
use crate::geometry::record::{Answer, Query, RayRecord};
use crate::scene::Surfaces;
use crate::scene::mesh::has_area;

/// In what arithmetic rays are answered.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Precision {
    /// The renderer's own.
    #[default]
    Exact,
    /// A textbook's, in f32.
    F32,
    /// A textbook's, in f64.
    F64,
}

/// A tracer of textbooks.
pub enum Textbook {
    F32(single::Tree),
    F64(double::Tree),
}

impl Textbook {
    /// `None` of the renderer's own arithmetic.
    pub fn new(precision: Precision, surfaces: &Surfaces) -> Option<Textbook> {
        match precision {
            Precision::Exact => None,
            Precision::F32 => Some(Textbook::F32(single::Tree::new(surfaces))),
            Precision::F64 => Some(Textbook::F64(double::Tree::new(surfaces))),
        }
    }

    pub fn precision(&self) -> Precision {
        match self {
            Textbook::F32(_) => Precision::F32,
            Textbook::F64(_) => Precision::F64,
        }
    }
}

impl Trace for Textbook {
    fn trace(&self, surfaces: &Surfaces, records: &[RayRecord], answers: &mut Vec<Answer>) {
        answers.clear();
        answers.extend(records.iter().map(|record| {
            let (ray, any) = (record.ray(), record.query() == Query::Occluded);
            match self {
                Textbook::F32(tree) => tree.answer(surfaces, &ray, any),
                Textbook::F64(tree) => tree.answer(surfaces, &ray, any),
            }
        }));
    }
}

/// Most primitives of a leaf.
const LEAF: usize = 4;

/// A box and what is in it: primitives, or two nodes, the first of which comes next.
struct Node<F> {
    low: [F; 3],
    high: [F; 3],
    /// Of a leaf's primitives in the tree's list; else the second node's number.
    first: u32,
    /// Of primitives; 0 of an inner node.
    count: u32,
}

/// The nodes over all primitives that rays can meet, and the list of these.
fn build(surfaces: &Surfaces) -> (Vec<Node<f64>>, Vec<u32>) {
    let solid = |&id: &u32| surfaces.sphere_at(id).is_some() || has_area(&surfaces.triangle(id));
    let mut boxes: Vec<(u32, [[f64; 3]; 2])> = (0..surfaces.len() as u32)
        .filter(solid)
        .map(|id| (id, surfaces.balls(id).into_iter().map(corners).reduce(joined).unwrap_or_default()))
        .collect();
    let mut nodes = Vec::new();
    if !boxes.is_empty() {
        divide(&mut boxes, 0, &mut nodes);
    }
    (nodes, boxes.into_iter().map(|(id, _)| id).collect())
}

fn corners((center, radius): ([f64; 3], f64)) -> [[f64; 3]; 2] {
    [center.map(|c| c - radius), center.map(|c| c + radius)]
}

fn joined(a: [[f64; 3]; 2], b: [[f64; 3]; 2]) -> [[f64; 3]; 2] {
    let of = |k: usize, pick: fn(f64, f64) -> f64| std::array::from_fn(|axis| pick(a[k][axis], b[k][axis]));
    [of(0, f64::min), of(1, f64::max)]
}

/// Adds the node of these primitives, the first of which is number `first` of all, and those below it.
fn divide(boxes: &mut [(u32, [[f64; 3]; 2])], first: usize, nodes: &mut Vec<Node<f64>>) {
    let all = boxes.iter().map(|&(_, corners)| corners).reduce(joined).unwrap_or_default();
    let number = nodes.len();
    let [low, high] = all;
    nodes.push(Node { low, high, first: first as u32, count: boxes.len() as u32 });
    if boxes.len() <= LEAF {
        return;
    }
    let width = |axis: usize| high[axis] - low[axis];
    let axis = (0..3).max_by(|&a, &b| width(a).total_cmp(&width(b))).unwrap_or(0);
    let middle = boxes.len() / 2;
    let twice_center = |[low, high]: &[[f64; 3]; 2]| low[axis] + high[axis];
    boxes.select_nth_unstable_by(middle, |(a, x), (b, y)| {
        twice_center(x).total_cmp(&twice_center(y)).then(a.cmp(b))
    });
    let (left, right) = boxes.split_at_mut(middle);
    divide(left, first, nodes);
    (nodes[number].first, nodes[number].count) = (nodes.len() as u32, 0);
    divide(right, first + middle, nodes);
}

macro_rules! tree {
    ($name:ident, $float:ty, $sphere:expr, $epsilon:literal) => {
        pub mod $name {
            use super::triangle::$name::{dot, moller_trumbore};
            use super::*;

            /// How far a ray passes what it starts on, and how far before a light it ends. The largest coordinate of a scene is from 0.5 to 1.
            const EPSILON: $float = $epsilon;

            pub struct Tree {
                nodes: Vec<Node<$float>>,
                ids: Vec<u32>,
            }

            impl Tree {
                pub fn new(surfaces: &Surfaces) -> Tree {
                    let (nodes, ids) = build(surfaces);
                    let round = |v: [f64; 3]| v.map(|c| c as $float);
                    let nodes = nodes.into_iter().map(|Node { low, high, first, count }| Node {
                        low: round(low),
                        high: round(high),
                        first,
                        count,
                    });
                    Tree { nodes: nodes.collect(), ids }
                }

                /// With `any` only whether there is a hit, as primitive 0.
                pub fn answer(&self, surfaces: &Surfaces, ray: &Ray, any: bool) -> Answer {
                    let origin = ray.origin.to_array().map(|c| c as $float);
                    let direction = ray.direction.to_array().map(|c| c as $float);
                    let inverse = direction.map(|c| 1.0 / c);
                    let ball_ray = $sphere.ray(ray.origin, ray.direction);
                    let margin = EPSILON / dot(direction, direction).sqrt();
                    let begin = ray.t_min as $float + margin;
                    let (mut end, mut best) = (ray.t_max as $float - margin, Answer::MISS);
                    let mut stack: Vec<u32> = Vec::with_capacity(64);
                    stack.extend((!self.nodes.is_empty()).then_some(0));
                    while let Some(number) = stack.pop() {
                        let node = &self.nodes[number as usize];
                        // Kay & Kajiya 1986.
                        let (mut near, mut far) = (begin, end);
                        for axis in 0..3 {
                            let first = (node.low[axis] - origin[axis]) * inverse[axis];
                            let last = (node.high[axis] - origin[axis]) * inverse[axis];
                            near = near.max(first.min(last));
                            far = far.min(first.max(last));
                        }
                        if near > far {
                            continue;
                        }
                        if node.count == 0 {
                            stack.extend([node.first, number + 1]);
                            continue;
                        }
                        let first = node.first as usize;
                        for &id in &self.ids[first..first + node.count as usize] {
                            let hit = match surfaces.sphere_at(id) {
                                Some(ball) => {
                                    let center = ball.center.map(f64::from).into();
                                    let ball = $sphere.ball(center, f64::from(ball.radius));
                                    let crossings = ball_ray.crossings(&ball);
                                    let ahead = |t: &$float| *t > begin;
                                    crossings
                                        .and_then(|both| both.into_iter().find(ahead))
                                        .map(|t| [t, 0.0, 0.0])
                                }
                                None => {
                                    let corners = surfaces.triangle(id).map(|v| v.map(<$float>::from));
                                    moller_trumbore(origin, direction, &corners, 0.0)
                                        .filter(|[t, ..]| *t > begin)
                                }
                            };
                            let Some([t, u, v]) = hit.filter(|[t, ..]| *t < end) else { continue };
                            if any {
                                return Answer { primitive: 0, ..Answer::MISS };
                            }
                            end = t;
                            best = Answer {
                                t: t.into(),
                                u: u.into(),
                                v: v.into(),
                                primitive: id,
                                ..Answer::MISS
                            };
                        }
                    }
                    best
                }
            }
        }
    };
}
tree!(single, f32, TextbookF32, 1e-4);
tree!(double, f64, TextbookF64, 1e-9);

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::super::aim::Dice;
    use super::*;
    use crate::accel::Accel;
    use crate::geometry::NONE;
    use crate::scene::mesh::Sphere;

    /// Triangles and balls of a tenth of the space that they fill.
    fn surfaces() -> Surfaces {
        let mut dice = Dice::new(1, 2, 3);
        let mut point = |size: f32| [(); 3].map(|()| size * (dice.below(2001) as f32 / 1000.0 - 1.0));
        let mut positions = Vec::new();
        for _ in 0..200 {
            let center = point(0.8);
            positions.extend([(); 3].map(|()| {
                let by = point(0.1);
                std::array::from_fn(|axis| center[axis] + by[axis])
            }));
        }
        Surfaces {
            triangles: (0..200).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect(),
            positions: positions.into(),
            spheres: (0..100).map(|_| Sphere { center: point(0.8), radius: 0.05 }).collect(),
            ..Surfaces::default()
        }
    }

    #[test]
    fn away_from_edges_a_textbook_is_right_but_for_its_digits() {
        let surfaces = surfaces();
        let trees = [Precision::F32, Precision::F64].map(|p| Textbook::new(p, &surfaces).unwrap());
        assert!(Textbook::new(Precision::Exact, &surfaces).is_none());
        let mut dice = Dice::new(4, 5, 6);
        let (mut hits, mut differ) = (0, [0, 0]);
        for _ in 0..2000 {
            let mut point = || DVec3::from([(); 3].map(|()| dice.below(2001) as f64 / 1000.0 - 1.0));
            let (from, to) = (point() * 3.0, point() * 0.8);
            let record = RayRecord::camera(from, to - from, 0, 0, 0);
            let truth = Accel::Brute.closest(&surfaces, &record.ray());
            hits += u32::from(truth.is_hit());
            for (tree, (differ, digits)) in trees.iter().zip(differ.iter_mut().zip([1e-4, 1e-10])) {
                let mut found = Vec::new();
                tree.trace(
                    &surfaces,
                    &[record, RayRecord { query: Query::Occluded as u8, ..record }],
                    &mut found,
                );
                assert_eq!(found[0].is_hit(), found[1].is_hit());
                if found[0].primitive != truth.primitive {
                    *differ += 1;
                } else if truth.is_hit() {
                    let off = [found[0].t - truth.t, found[0].u - truth.u, found[0].v - truth.v];
                    assert!(off.iter().all(|off| off.abs() < digits), "{truth:?} {:?}", found[0]);
                }
            }
        }
        assert!(hits > 500 && differ[0] < 20 && differ[1] == 0, "{hits} {differ:?}");
    }

    #[test]
    fn what_is_nearer_than_epsilon_is_passed_and_a_light_s_end_kept_clear() {
        let surfaces = Surfaces {
            spheres: vec![Sphere { center: [0.0, 0.0, 0.5], radius: 0.25 }].into(),
            ..Surfaces::default()
        };
        let tree = Textbook::new(Precision::F32, &surfaces).unwrap();
        let t = |z: f64, t_max: f64| {
            let mut record = RayRecord::camera(DVec3::new(0.0, 0.0, z), DVec3::Z, 0, 0, 0);
            record.t_max = t_max;
            let mut found = Vec::new();
            tree.trace(&surfaces, &[record], &mut found);
            (found[0].primitive != NONE).then_some(found[0].t)
        };
        assert_eq!((t(0.0, 1.0), t(0.0, 0.25), t(0.0, 0.250_05)), (Some(0.25), None, None));
        // From just before the near side only the far one is left.
        assert!(t(0.249_95, 1.0).is_some_and(|t| (t - 0.5).abs() < 1e-3));
        assert_eq!(tree.precision(), Precision::F32);
    }
}
