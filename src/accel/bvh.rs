//! A binary bounding volume hierarchy: built by obvhs (PLOC, Meister and Bittner 2018, with reinsertion), traversed here.

use obvhs::BvhBuildParams;
use obvhs::aabb::Aabb;
use obvhs::bvh2::leaf_collapser::collapse;
use obvhs::bvh2::node::Bvh2Node;
use obvhs::bvh2::reinsertion::ReinsertionOptimizer;
use obvhs::ploc::PlocBuilder;
use rayon::prelude::*;

use super::{LANES, Visitor};
use crate::geometry::bounds::Slabs;
use crate::geometry::filter::round_down;
use crate::scene::Surfaces;
use crate::scene::mesh::has_area;

/// The hierarchy as flat arrays.
#[derive(Clone, Debug, Default)]
pub struct Bvh {
    /// Children stand side by side; node 0 is the root. Empty where there is nothing to hit.
    pub nodes: Vec<Bvh2Node>,
    /// Primitive ids in the order of the leaves.
    pub primitives: Vec<u32>,
    /// Levels below the root.
    pub depth: u32,
    /// The largest magnitude of a coordinate of the boxes.
    pub extent: f64,
}

/// A leaf is one block of the filter.
/// Bytes for each primitive while the hierarchy is built: measured on terrains of 1 and 4 million triangles.
pub const BYTES_TO_BUILD: u64 = 180;

const PRIMITIVES_PER_LEAF: u32 = LANES as u32;
/// Stacks up to this depth live on the processor's stack.
const SHALLOW: usize = 64;

impl Bvh {
    /// Builds over all primitives but triangles without area.
    pub fn build(surfaces: &Surfaces) -> Bvh {
        let ids: Vec<u32> = (0..surfaces.len() as u32)
            .into_par_iter()
            .filter(|&id| surfaces.sphere_at(id).is_some() || has_area(&surfaces.triangle(id)))
            .collect();
        if ids.is_empty() {
            return Bvh::default();
        }
        let boxes: Vec<Aabb> = ids.par_iter().map(|&id| bound(surfaces, id)).collect();
        let preset = BvhBuildParams::fast_build();
        let mut tree = PlocBuilder::with_capacity(boxes.len()).build(
            preset.ploc_search_distance,
            &boxes,
            (0..boxes.len() as u32).collect(),
            preset.sort_precision,
            preset.search_depth_threshold,
        );
        drop(boxes);
        ReinsertionOptimizer::default().run(&mut tree, preset.reinsertion_batch_ratio, None);
        collapse(&mut tree, PRIMITIVES_PER_LEAF, preset.collapse_traversal_cost);
        let primitives = tree.primitive_indices.iter().map(|&index| ids[index as usize]).collect();
        let mut bvh = Bvh { nodes: tree.nodes, primitives, depth: 0, extent: 0.0 };
        bvh.depth = bvh.measure_depth();
        let root = &bvh.nodes[0];
        bvh.extent = f64::from(root.min.abs().max(root.max.abs()).max_element());
        bvh
    }

    /// Bytes of nodes and ids.
    pub fn memory(&self) -> usize {
        size_of_val(self.nodes.as_slice()) + size_of_val(self.primitives.as_slice())
    }

    /// Offers the visitor each primitive that could give the least hit; with `ANY` it ends at the first hit.
    pub fn traverse<const ANY: bool>(&self, visitor: &mut impl Visitor) {
        if self.nodes.is_empty() {
            return;
        }
        visitor.begin(self.extent);
        if (self.depth as usize) < SHALLOW {
            self.walk::<ANY>(visitor, &mut [(0, 0.0); SHALLOW]);
        } else {
            self.walk::<ANY>(visitor, &mut vec![(0, 0.0); self.depth as usize + 1]);
        }
    }

    fn walk<const ANY: bool>(&self, visitor: &mut impl Visitor, stack: &mut [(u32, f32)]) {
        let slabs = Slabs::new(visitor.ray(), self.extent);
        let enter =
            |node: &Bvh2Node, t_best: f64| slabs.enter(node.min.to_array(), node.max.to_array(), t_best);
        if enter(&self.nodes[0], visitor.limit()).is_none() {
            return;
        }
        let (mut node, mut waiting) = (&self.nodes[0], 0);
        loop {
            let first = node.first_index as usize;
            if node.is_leaf() {
                let primitives = &self.primitives[first..first + node.prim_count as usize];
                for few in primitives.chunks(LANES) {
                    visitor.visit(few);
                    if ANY && visitor.found() {
                        return;
                    }
                }
            } else {
                let (left, right) = (&self.nodes[first], &self.nodes[first + 1]);
                match (enter(left, visitor.limit()), enter(right, visitor.limit())) {
                    (Some(l), Some(r)) => {
                        let (far, t) = if l <= r { (first + 1, r) } else { (first, l) };
                        stack[waiting] = (far as u32, round_down(t));
                        waiting += 1;
                        node = if l <= r { left } else { right };
                        continue;
                    }
                    (Some(_), None) => {
                        node = left;
                        continue;
                    }
                    (None, Some(_)) => {
                        node = right;
                        continue;
                    }
                    (None, None) => {}
                }
            }
            node = loop {
                if waiting == 0 {
                    return;
                }
                waiting -= 1;
                let (next, t) = stack[waiting];
                if f64::from(t) <= visitor.limit() {
                    break &self.nodes[next as usize];
                }
            };
        }
    }

    fn measure_depth(&self) -> u32 {
        let (mut deepest, mut waiting) = (0, vec![(0u32, 0u32)]);
        while let Some((index, depth)) = waiting.pop() {
            let node = &self.nodes[index as usize];
            deepest = deepest.max(depth);
            if !node.is_leaf() {
                waiting.extend([(node.first_index, depth + 1), (node.first_index + 1, depth + 1)]);
            }
        }
        deepest
    }
}

fn bound(surfaces: &Surfaces, id: u32) -> Aabb {
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
    use crate::geometry::{NONE, Ray};
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
            let bvh = Accel::Bvh(Bvh::build(&surfaces));
            for d in directions {
                let ray = Ray {
                    origin: DVec3::from(origin) * far,
                    direction: if far > 1.0 { DVec3::from(d) - DVec3::from(origin) * far } else { DVec3::from(d) },
                    t_min: 0.0, t_max: f64::INFINITY, first_id: 0, start: NONE,
                };
                let truth = Accel::Brute.closest(&surfaces, &ray);
                prop_assert_eq!(bvh.closest(&surfaces, &ray), truth);
                prop_assert_eq!(bvh.occluded(&surfaces, &ray), truth.is_hit());
                if truth.is_hit() {
                    let onward = Ray { t_min: truth.t, first_id: truth.primitive + 1, ..ray };
                    prop_assert_eq!(bvh.closest(&surfaces, &onward), Accel::Brute.closest(&surfaces, &onward));
                    let spawned = Ray { origin: ray.origin + ray.direction * truth.t, direction: DVec3::from(origin) - ray.direction, start: truth.primitive, ..ray };
                    if spawned.direction != DVec3::ZERO {
                        prop_assert_eq!(bvh.closest(&surfaces, &spawned), Accel::Brute.closest(&surfaces, &spawned));
                    }
                }
            }
        }
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
            assert!(!Accel::Bvh(Bvh::build(&surfaces)).closest(&surfaces, &ray).is_hit());
        }
    }
}
