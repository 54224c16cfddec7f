//! The product's own traversal: a tree of eight children per node, walked by many rays at once.
//!
//! Built from obvhs's binary tree (PLOC, Meister and Bittner 2018, with reinsertion). Any number of threads builds the same tree.

mod filter;
mod lanes;
pub mod level;
pub mod tree;
mod walk;

use std::cell::RefCell;

use obvhs::BvhBuildParams;
use obvhs::aabb::Aabb;
use obvhs::bvh2::reinsertion::ReinsertionOptimizer;
use obvhs::ploc::PlocBuilder;
use rayon::prelude::*;

use crate::geometry::Ray;
use crate::geometry::record::{Answer, RayRecord};
use crate::scene::Surfaces;
use crate::scene::mesh::has_area;
use crate::settings::BuildPreset;
use lanes::Baseline;
use level::Level;
use tree::Tree;
pub use walk::Questions;
use walk::{Scratch, Walked};

/// Bytes for each primitive while the tree is built: 345 were measured on a terrain of 4.2 million triangles, 283 on 1.9 million triangles of spheres.
pub const BYTES_TO_BUILD: u64 = 360;

/// The tree and where it lies.
#[derive(Clone, Debug, Default)]
pub struct Wide {
    pub tree: Tree,
    /// Corners of the box around everything.
    pub low: [f32; 3],
    pub high: [f32; 3],
}

thread_local! {
    /// Kept between batches.
    static SCRATCH: RefCell<Scratch> = RefCell::default();
}

impl Wide {
    /// Builds over all primitives but triangles without area. On the current rayon pool.
    pub fn build(surfaces: &Surfaces, preset: BuildPreset) -> Wide {
        let ids: Vec<u32> = (0..surfaces.len() as u32)
            .into_par_iter()
            .filter(|&id| surfaces.sphere_at(id).is_some() || has_area(&surfaces.triangle(id)))
            .collect();
        if ids.is_empty() {
            return Wide::default();
        }
        let boxes: Vec<Aabb> = ids.par_iter().map(|&id| bounds(surfaces, id)).collect();
        let (params, reinsertion) = match preset {
            BuildPreset::Fast => (BvhBuildParams::fastest_build(), 0.0),
            BuildPreset::Balanced => (BvhBuildParams::medium_build(), 0.02),
            BuildPreset::Best => (BvhBuildParams::slow_build(), 0.3),
        };
        let mut binary = PlocBuilder::with_capacity(boxes.len()).build(
            params.ploc_search_distance,
            &boxes,
            (0..boxes.len() as u32).collect(),
            params.sort_precision,
            params.search_depth_threshold,
        );
        drop(boxes);
        if reinsertion > 0.0 {
            ReinsertionOptimizer::default().run(&mut binary, reinsertion, None);
        }
        let tree = tree::collapse(&binary, &ids, surfaces);
        let root = &binary.nodes[0];
        Wide { tree, low: root.min.to_array(), high: root.max.to_array() }
    }

    /// Bytes of nodes and blocks.
    pub fn memory(&self) -> usize {
        size_of_val(self.tree.nodes.as_slice()) + size_of_val(self.tree.blocks.as_slice())
    }

    /// Answers a batch of records in their order.
    pub fn trace(&self, surfaces: &Surfaces, records: &[RayRecord], answers: &mut [Answer]) {
        self.answer(Level::chosen(), surfaces, records, answers);
    }

    /// The least (t, primitive id) that each ray meets, or whether it meets anything: then a hit is primitive 0.
    ///
    /// # Panics
    /// At a level that the processor lacks.
    pub fn trace_at(
        &self,
        level: Level,
        surfaces: &Surfaces,
        questions: &(impl Questions + ?Sized),
        answers: &mut [Answer],
    ) {
        assert!(level.is_available(), "{} isn't there", level.name());
        self.answer(level, surfaces, questions, answers);
    }

    /// As [`trace_at`](Self::trace_at) for plain rays, of which all or none ask only whether there is `any` hit.
    pub fn trace_rays(
        &self,
        level: Level,
        surfaces: &Surfaces,
        rays: &[Ray],
        any: bool,
        answers: &mut [Answer],
    ) {
        self.trace_at(level, surfaces, &(rays, any), answers);
    }

    fn answer(
        &self,
        level: Level,
        surfaces: &Surfaces,
        questions: &(impl Questions + ?Sized),
        answers: &mut [Answer],
    ) {
        if self.tree.nodes.is_empty() {
            answers.fill(Answer::MISS);
            return;
        }
        let extent = self.low.iter().chain(&self.high).fold(0.0, |m: f64, c| m.max(f64::from(c.abs())));
        let walked = Walked { tree: &self.tree, surfaces, extent, low: self.low, high: self.high };
        SCRATCH.with_borrow_mut(|scratch| {
            // SAFETY: levels that the processor lacks are never chosen, and refused above.
            unsafe {
                match level {
                    Level::Baseline => walk::walk::<Baseline>(&walked, questions, answers, scratch),
                    #[cfg(target_arch = "x86_64")]
                    Level::Avx2 => walk_avx2(&walked, questions, answers, scratch),
                    #[cfg(target_arch = "x86_64")]
                    Level::Avx512 => walk_avx512(&walked, questions, answers, scratch),
                    #[cfg(not(target_arch = "x86_64"))]
                    _ => walk::walk::<Baseline>(&walked, questions, answers, scratch),
                }
            }
        });
    }
}

/// # Safety
/// The processor has AVX2 and FMA.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
unsafe fn walk_avx2(
    walked: &Walked,
    questions: &(impl Questions + ?Sized),
    answers: &mut [Answer],
    scratch: &mut Scratch,
) {
    // SAFETY: the caller's promise.
    unsafe { walk::walk::<lanes::Avx2>(walked, questions, answers, scratch) }
}

/// # Safety
/// The processor has AVX-512 F, VL, DQ and BW.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt,avx512f,avx512vl,avx512dq,avx512bw")]
unsafe fn walk_avx512(
    walked: &Walked,
    questions: &(impl Questions + ?Sized),
    answers: &mut [Answer],
    scratch: &mut Scratch,
) {
    // SAFETY: the caller's promise.
    unsafe { walk::walk::<lanes::Avx512>(walked, questions, answers, scratch) }
}

fn bounds(surfaces: &Surfaces, id: u32) -> Aabb {
    match surfaces.sphere_at(id) {
        None => {
            let [a, b, c] = surfaces.triangle(id).map(glam::Vec3A::from);
            Aabb::new(a.min(b).min(c), a.max(b).max(c))
        }
        Some(sphere) => {
            let side = |sign: f64| {
                let c = sphere.center.map(|c| f64::from(c) + sign * f64::from(sphere.radius));
                // Rounded outwards: a sphere's box has no f32 corners of its own.
                glam::Vec3A::from(
                    c.map(|c| if sign < 0.0 { (c as f32).next_down() } else { (c as f32).next_up() }),
                )
            };
            Aabb::new(side(-1.0), side(1.0))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::Accel;
    use super::*;
    use crate::geometry::NONE;
    use crate::scene::generate::icosphere::icosphere;
    use crate::scene::mesh::Sphere;
    use glam::DVec3;
    use proptest::prelude::*;

    /// Triangles and spheres with many coincidences: coordinates from a coarse lattice.
    fn soup() -> impl Strategy<Value = Surfaces> {
        let coordinate = || prop_oneof![(-4i8..=4).prop_map(|c| f32::from(c) / 4.0), -1.0f32..1.0];
        let point = || prop::array::uniform3(coordinate());
        let sphere = (point(), prop_oneof![Just(0.25f32), 0.01f32..0.5])
            .prop_map(|(center, radius)| Sphere { center, radius });
        (prop::collection::vec(prop::array::uniform3(point()), 0..60), prop::collection::vec(sphere, 0..10))
            .prop_map(|(triangles, spheres)| Surfaces {
                positions: triangles.concat(),
                triangles: (0..triangles.len() as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect(),
                spheres,
                ..Surfaces::default()
            })
    }

    fn direction() -> impl Strategy<Value = [f64; 3]> {
        let component =
            || prop_oneof![Just(0.0), Just(-0.0), Just(1.0), Just(-0.5), Just(1e-310), -1.0f64..1.0];
        prop::array::uniform3(component()).prop_filter("a direction", |d| d.iter().any(|c| c.abs() > 1e-3))
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(400))]
        #[test]
        fn answers_exactly_as_brute_force(
            surfaces in soup(),
            origin in prop::array::uniform3(prop_oneof![(-8i8..=8).prop_map(|c| f64::from(c) / 4.0), -3.0f64..3.0]),
            directions in prop::collection::vec(direction(), 8),
            far in prop_oneof![Just(1.0), Just(1e6)],
        ) {
            let wide = Wide::build(&surfaces, BuildPreset::Balanced);
            let mut rays = Vec::new();
            for d in directions {
                let ray = Ray {
                    origin: DVec3::from(origin) * far,
                    direction: if far > 1.0 { DVec3::from(d) - DVec3::from(origin) * far } else { DVec3::from(d) },
                    t_min: 0.0, t_max: f64::INFINITY, first_id: 0, start: NONE,
                };
                if ray.direction == DVec3::ZERO {
                    continue;
                }
                rays.push(ray);
                let truth = Accel::Brute.closest(&surfaces, &ray);
                if truth.is_hit() {
                    rays.push(Ray { t_min: truth.t, first_id: truth.primitive + 1, ..ray });
                    rays.push(Ray { t_max: truth.t, ..ray });
                    if truth.t > 1e-300 {
                        rays.push(Ray { t_max: truth.t.next_down(), ..ray });
                    }
                    let spawned = Ray { origin: ray.origin + ray.direction * truth.t, direction: DVec3::from(origin) - ray.direction, start: truth.primitive, ..ray };
                    if spawned.direction != DVec3::ZERO {
                        rays.push(spawned);
                    }
                }
            }
            let truth: Vec<Answer> = rays.iter().map(|ray| Accel::Brute.closest(&surfaces, ray)).collect();
            let hits: Vec<bool> = truth.iter().map(Answer::is_hit).collect();
            let mut answers = vec![Answer::MISS; rays.len()];
            for level in Level::ALL.into_iter().filter(|level| level.is_available()) {
                wide.trace_rays(level, &surfaces, &rays, false, &mut answers);
                prop_assert_eq!(&answers, &truth, "{:?}", level);
                wide.trace_rays(level, &surfaces, &rays, true, &mut answers);
                prop_assert_eq!(answers.iter().map(Answer::is_hit).collect::<Vec<_>>(), hits.clone(), "{:?}", level);
            }
        }
    }

    #[test]
    fn any_number_of_threads_builds_the_same_tree() {
        let mesh = icosphere(5, DVec3::ZERO, 1.0);
        let surfaces =
            Surfaces { positions: mesh.positions, triangles: mesh.triangles, ..Surfaces::default() };
        for preset in [BuildPreset::Fast, BuildPreset::Balanced, BuildPreset::Best] {
            let built = |threads| {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                pool.install(|| Wide::build(&surfaces, preset)).tree
            };
            let (one, three) = (built(1), built(3));
            assert_eq!(
                bytemuck::cast_slice::<_, u8>(&one.nodes),
                bytemuck::cast_slice::<_, u8>(&three.nodes)
            );
            assert_eq!(
                bytemuck::cast_slice::<_, u8>(&one.blocks),
                bytemuck::cast_slice::<_, u8>(&three.blocks)
            );
        }
    }

    #[test]
    fn every_primitive_lies_in_one_block_and_in_all_boxes_above() {
        let mesh = icosphere(4, DVec3::new(3.0, -1.0, 0.5), 2.0);
        let surfaces =
            Surfaces { positions: mesh.positions, triangles: mesh.triangles, ..Surfaces::default() };
        let wide = Wide::build(&surfaces, BuildPreset::Balanced);
        let (mut seen, mut waiting) =
            (vec![0; surfaces.len()], vec![(0u32, [f32::NEG_INFINITY; 3], [f32::INFINITY; 3])]);
        while let Some((index, low, high)) = waiting.pop() {
            let node = &wide.tree.nodes[index as usize];
            for lane in (0..tree::WIDTH).filter(|&lane| node.children[lane] != tree::EMPTY) {
                let below: [f32; 3] = std::array::from_fn(|axis| node.planes[axis][lane]);
                let above: [f32; 3] = std::array::from_fn(|axis| node.planes[axis + 3][lane]);
                assert!((0..3).all(|axis| below[axis] >= low[axis] && above[axis] <= high[axis]));
                let child = node.children[lane];
                if child & tree::LEAF == 0 {
                    waiting.push((child, below, above));
                    continue;
                }
                let block = &wide.tree.blocks[tree::block_number(child) as usize];
                for &id in &block.ids[..(child & 7) as usize + 1] {
                    seen[id as usize] += 1;
                    let corners = surfaces.triangle(id);
                    assert!(
                        corners
                            .iter()
                            .all(|v| (0..3).all(|axis| v[axis] >= below[axis] && v[axis] <= above[axis]))
                    );
                }
            }
        }
        assert!(seen.iter().all(|&count| count == 1));
    }

    #[test]
    fn nothing_is_hit_where_nothing_is() {
        let empty = Surfaces::default();
        let flat =
            Surfaces { positions: vec![[0.0; 3]; 3], triangles: vec![[0, 1, 2]], ..Surfaces::default() };
        let ray = Ray {
            origin: DVec3::ZERO,
            direction: DVec3::X,
            t_min: 0.0,
            t_max: f64::INFINITY,
            first_id: 0,
            start: NONE,
        };
        for surfaces in [empty, flat] {
            let accel = Accel::Bvh(Wide::build(&surfaces, BuildPreset::Fast));
            assert!(!accel.closest(&surfaces, &ray).is_hit());
        }
    }

    #[test]
    fn levels_are_named_and_never_above_what_there_is() {
        for level in Level::ALL {
            let found = Level::named(level.name()).unwrap();
            assert!(found <= level && found.is_available());
        }
        assert!(Level::named("sse9").is_err());
    }
}
