//! A bounding sphere around each object and nothing below it: the spheres that a ray meets are opened from the nearest on, and all that is in them is tested. Simple to build, and linear in
//! the primitives of an object.
//!
//! No hit is lost: with Q = |origin|∞ + extent, u = 2^-53,
//!
//! * A line that meets a primitive passes within 2^-31 Q of it (`geometry::start` raises weights by no more than 2^-32 Q; the edge functions' signs and a sphere's discriminant are off by some
//!   uQ). Its distance to a centre is computed to within 2^-45 Q. So it meets the object's sphere if that is grown by `PAD` Q.
//! * The t that it meets a triangle at is that of a point within 2^-31 Q of the triangle's box (`bounds`), not always of the triangle: it is looked for inside a second sphere, around the boxes. Growing
//!   that by as much also covers what the half chord's root makes of errors. Spheres' own t is off by the root of 2^-53 where they are hardly touched, for which `SLACK` Q allows, as the grid does.
//! * What isn't a number, far out of f64's middle, counts as met.

use std::cell::RefCell;

use bytemuck::{Pod, Zeroable};
use rayon::prelude::*;

use super::tester::Tester;
use super::wide::sieve::Sieve;
use super::wide::tree::{Block, WIDTH, put};
use super::{extent, solid};
use crate::geometry::bounding::{self, Ball};
use crate::geometry::record::Answer;
use crate::geometry::{NONE, Prepared, Ray, dot, norm_max, sub};
use crate::memory::{Array, HugeArray};
use crate::scene::Surfaces;
use crate::simd::Level;

/// Bytes for each primitive while the spheres are built: blocks, ids and chunks of them.
pub const BYTES_TO_BUILD: u64 = 56;
/// What spheres are grown by, in Q.
const PAD: f64 = 1.0 / (1u64 << 29) as f64;
/// How far before and behind its sphere an object may be met, in Q.
const SLACK: f64 = 1.0 / (1u64 << 22) as f64;

/// An object's sphere and what is in it.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct Object {
    center: [f64; 3],
    /// Around its surfaces.
    radius: f64,
    /// Around the boxes of its triangles, about the same centre.
    reach: f64,
    /// Its first block, and the first of the next.
    blocks: [u32; 2],
}

/// The objects' spheres.
#[derive(Clone, Debug, Default)]
pub struct Spheres {
    pub objects: Vec<Object>,
    /// The primitives, each object's by themselves and all of one kind; missing ones are [`NONE`].
    pub blocks: HugeArray<Block>,
    /// The largest magnitude of a coordinate.
    pub extent: f64,
}

thread_local! {
    /// The objects that a ray meets, by where it enters them.
    static MET: RefCell<Vec<(f64, u32)>> = RefCell::default();
}

impl Spheres {
    /// Builds over all primitives but triangles without area. On the current rayon pool.
    pub fn build(surfaces: &Surfaces) -> Spheres {
        Spheres::build_over(surfaces, &solid(surfaces))
    }

    /// Builds over these primitives, whose ids ascend.
    pub fn build_over(surfaces: &Surfaces, ids: &[u32]) -> Spheres {
        let object = |id: u32| (surfaces.object(id), surfaces.sphere_at(id).is_some());
        let runs: Vec<&[u32]> = ids.chunk_by(|&a, &b| object(a) == object(b)).collect();
        let mut next = 0;
        let starts: Vec<u32> = runs
            .iter()
            .map(|run| {
                let first = next;
                next += run.len().div_ceil(WIDTH) as u32;
                first
            })
            .collect();
        let objects = runs
            .par_iter()
            .zip(&starts)
            .map(|(run, &first)| Object::around(surfaces, run, first))
            .collect::<Vec<_>>();
        let mut blocks: HugeArray<Block> =
            HugeArray::zeroed(next as usize).expect("memory for the objects' blocks");
        let chunks: Vec<&[u32]> = runs.iter().flat_map(|run| run.chunks(WIDTH)).collect();
        blocks.par_iter_mut().zip(&chunks).for_each(|(block, chunk)| {
            block.ids = [NONE; WIDTH];
            for (lane, &id) in chunk.iter().enumerate() {
                put(&mut block.corners, lane, surfaces, id);
                block.ids[lane] = id;
            }
        });
        Spheres { objects, blocks, extent: extent(surfaces, ids) }
    }

    /// Bytes of spheres and blocks.
    pub fn memory(&self) -> usize {
        size_of_val(&*self.objects) + size_of_val(&*self.blocks)
    }

    /// The least (t, primitive id), or with `any` whether there is one.
    pub(super) fn answer(&self, surfaces: &Surfaces, ray: &Ray, any: bool) -> Answer {
        let mut tester = Tester::new(surfaces, ray);
        MET.with_borrow_mut(|met| {
            let line = Line::new(&tester.ray, self.extent);
            met.clear();
            met.extend(
                (0..).zip(&self.objects).filter_map(|(number, object)| Some((line.enter(object)?, number))),
            );
            if met.is_empty() {
                return;
            }
            met.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
            let sieve = Sieve::new(Level::chosen(), &tester.ray, self.extent);
            for &(enter, number) in met.iter() {
                if enter > tester.t_best || (any && tester.found()) {
                    return;
                }
                let [first, end] = self.objects[number as usize].blocks;
                test(&mut tester, &sieve, &self.blocks[first as usize..end as usize], any);
            }
        });
        tester.verdict(any)
    }
}

/// Tests all primitives of an object that the filter lets through.
fn test(tester: &mut Tester, sieve: &Sieve, blocks: &[Block], any: bool) {
    let triangles = tester.surfaces.triangles.len() as u32;
    for block in blocks {
        let mut left = sieve.survivors_of(block, block.ids[0] >= triangles, tester.t_best);
        while left != 0 {
            tester.test(block.ids[left.trailing_zeros() as usize]);
            left &= left - 1;
            if any && tester.found() {
                return;
            }
        }
    }
}

impl Object {
    /// The spheres around primitives of one kind, whose blocks begin at `first`.
    fn around(surfaces: &Surfaces, ids: &[u32], first: u32) -> Object {
        let balls = ids.iter().flat_map(|&id| surfaces.balls(id));
        let center = bounding::center(balls.clone());
        let radius = bounding::radius(center, balls);
        let boxes = ids.iter().map(|&id| match surfaces.sphere_at(id) {
            Some(_) => surfaces.balls(id)[0],
            None => (farthest_corner(center, surfaces.balls(id)), 0.0),
        });
        let reach = bounding::radius(center, boxes);
        Object { center, radius, reach, blocks: [first, first + ids.len().div_ceil(WIDTH) as u32] }
    }
}

/// The corner of a triangle's box that lies farthest from a point.
fn farthest_corner(from: [f64; 3], vertices: [Ball; 3]) -> [f64; 3] {
    std::array::from_fn(|axis| {
        let [a, b, c] = vertices.map(|(vertex, _)| vertex[axis]);
        let (low, high) = (a.min(b).min(c), a.max(b).max(c));
        if (low - from[axis]).abs() > (high - from[axis]).abs() { low } else { high }
    })
}

/// A ray made ready for the objects' spheres.
struct Line<'a> {
    ray: &'a Prepared,
    /// The direction's square.
    square: f64,
    pad: f64,
    /// In units of the direction.
    slack: f64,
}

impl<'a> Line<'a> {
    fn new(ray: &'a Prepared, extent: f64) -> Self {
        let q = norm_max(ray.origin) + extent;
        let square = dot(ray.direction, ray.direction);
        Line { ray, square, pad: q * PAD, slack: q * SLACK / square.sqrt() }
    }

    /// A lower bound of the t at which the ray meets anything in the object; `None` if it surely meets nothing there. Conditions are written so that NaN is met.
    fn enter(&self, object: &Object) -> Option<f64> {
        let from = sub(self.ray.origin, object.center);
        let middle = -dot(from, self.ray.direction) / self.square;
        let nearest: [f64; 3] = std::array::from_fn(|axis| from[axis] + middle * self.ray.direction[axis]);
        let aside = dot(nearest, nearest);
        let (radius, reach) = (object.radius + self.pad, object.reach + self.pad);
        if aside > radius * radius {
            return None;
        }
        let half = ((reach * reach - aside).max(0.0) / self.square).sqrt() + self.slack;
        let (enter, exit) = (middle - half, middle + half);
        if exit < self.ray.t_min || enter > self.ray.t_max {
            return None;
        }
        Some(if enter.is_nan() { f64::NEG_INFINITY } else { enter })
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use proptest::prelude::*;

    use super::*;
    use crate::accel::brute;
    use crate::scene::mesh::Sphere;

    /// Clusters of triangles and spheres, each an object, far enough apart for spheres to be passed by.
    fn clusters() -> impl Strategy<Value = Surfaces> {
        let point = || prop::array::uniform3(-1.0f32..1.0);
        let cluster = (prop::array::uniform3(-8i8..=8), prop::collection::vec(point(), 3..30));
        let ball = (prop::array::uniform3(-8i8..=8), prop::collection::vec((point(), 0.01f32..1.0), 1..12));
        (prop::collection::vec(cluster, 1..6), prop::collection::vec(ball, 0..4)).prop_map(
            |(meshes, flakes)| {
                let moved =
                    |by: [i8; 3], p: [f32; 3]| std::array::from_fn(|axis| p[axis] + f32::from(by[axis]));
                let mut surfaces = Surfaces::default();
                for (by, points) in meshes {
                    surfaces.objects.push(surfaces.triangles.len() as u32);
                    for corners in points.chunks_exact(3) {
                        let first = surfaces.positions.len() as u32;
                        let corners = corners.iter().map(|&p| moved(by, p)).collect();
                        surfaces.positions.append(corners).unwrap();
                        surfaces.triangles.append(vec![[first, first + 1, first + 2]]).unwrap();
                    }
                }
                for (by, spheres) in flakes {
                    surfaces.objects.push(surfaces.len() as u32);
                    let spheres =
                        spheres.into_iter().map(|(p, radius)| Sphere { center: moved(by, p), radius });
                    surfaces.spheres.append(spheres.collect()).unwrap();
                }
                surfaces
            },
        )
    }

    #[test]
    fn each_object_has_a_sphere() {
        let surfaces = Surfaces {
            positions: vec![
                [0.0; 3],
                [2.0, 0.0, 0.0],
                [0.0, 2.0, 0.0],
                [9.0; 3],
                [9.0, 9.0, 7.0],
                [9.0, 7.0, 9.0],
            ]
            .into(),
            triangles: vec![[0, 1, 2], [3, 4, 5]].into(),
            spheres: vec![Sphere { center: [5.0; 3], radius: 0.5 }].into(),
            objects: vec![0, 1, 2],
            ..Surfaces::default()
        };
        let spheres = Spheres::build(&surfaces);
        let [a, b, ball] = spheres.objects[..] else { panic!("{} objects", spheres.objects.len()) };
        assert_eq!((a.center, a.radius, a.reach), ([1.0, 1.0, 0.0], 2f64.sqrt(), 2f64.sqrt()));
        assert_eq!((b.center, b.blocks), ([9.0, 8.0, 8.0], [1, 2]));
        assert_eq!((ball.center, ball.radius, ball.reach), ([5.0; 3], 0.5, 0.5));
        // Without objects all triangles are one, and all spheres.
        let whole = Spheres::build(&Surfaces { objects: Vec::new(), ..surfaces });
        assert_eq!(whole.objects.len(), 2);
    }

    #[test]
    fn spheres_that_are_passed_by_are_not_opened() {
        let object = Object { center: [0.0, 0.0, 5.0], radius: 1.0, reach: 1.5, blocks: [0, 1] };
        let enter = |x: f64, z: f64, t_max: f64| {
            let (origin, direction) = (DVec3::new(x, 0.0, z), DVec3::Z);
            let ray = Ray { origin, direction, t_min: 0.0, t_max, first_id: 0, start: NONE };
            Line::new(&Prepared::new(&ray), 6.0).enter(&object)
        };
        assert!((enter(0.0, 0.0, 9.0).unwrap() - 3.5).abs() < 1e-5);
        assert!(enter(1.0, 0.0, 9.0).is_some() && enter(1.0 + 1e-6, 0.0, 9.0).is_none());
        assert!(enter(0.0, 6.499, 9.0).is_some() && enter(0.0, 6.501, 9.0).is_none());
        assert!(enter(0.0, 0.0, 3.499).is_none());
        // Where squares overflow anything may be met, at any time.
        assert!(enter(f64::MAX, 0.0, 9.0).unwrap() < -1e300);
    }

    proptest! {
        #[test]
        fn answers_are_those_of_brute_force(
            surfaces in clusters(),
            ends in prop::array::uniform2(prop::array::uniform3(-10.0f64..10.0)),
            target in any::<prop::sample::Index>(),
            far in prop_oneof![3 => Just(1.0), 1 => Just(1e6), 1 => Just(1e12)],
        ) {
            let spheres = Spheres::build(&surfaces);
            let [from, to] = ends.map(DVec3::from);
            // At a vertex, where the line grazes, or anywhere.
            let vertex = DVec3::from(surfaces.positions[target.index(surfaces.positions.len())].map(f64::from));
            for aim in [to, vertex] {
                let origin = aim + (from - aim) * far;
                prop_assume!(origin != aim);
                let ray = Ray { origin, direction: aim - origin, t_min: 0.0, t_max: f64::INFINITY, first_id: 0, start: NONE };
                let expected = brute::answer(&surfaces, 0..surfaces.len() as u32, &ray, false);
                prop_assert_eq!(spheres.answer(&surfaces, &ray, false), expected);
                for t_max in [expected.t, expected.t.next_down()] {
                    let ray = Ray { t_max, ..ray };
                    let any = spheres.answer(&surfaces, &ray, true).is_hit();
                    prop_assert_eq!(any, expected.is_hit() && t_max >= expected.t);
                }
            }
        }
    }
}
