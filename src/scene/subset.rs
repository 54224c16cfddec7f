//! Part of a scene as a scene of its own: some of its primitives, and of everything else what these need.
//!
//! Primitive ids of a subset are places in the ascending list of those that it was made of, so hits of equal t are ordered as in the whole. It lies in the stored
//! space of the whole.

use bytemuck::Pod;
use rayon::prelude::*;

use super::mesh::{NONE, Part, Surfaces};
use super::{Scene, Texture};
use crate::memory::Store;

impl Scene {
    /// The primitives `ids`, ascending, with their vertices, and the textures of their materials; the others' are left empty. All materials and lights stay. On the current rayon pool.
    pub fn subset(&self, ids: &[u32]) -> Scene {
        let mut part = Scene { header: self.header.clone(), ..Scene::default() };
        part.header.parts.clear();
        let triangles = self.surfaces.triangles.len() as u32;
        for (number, whole) in self.header.parts.iter().enumerate() {
            let end = self.header.parts.get(number + 1).map_or(NONE, |next| next.first);
            let within = |limit: u32| ids.partition_point(|&id| id < limit);
            let own = &ids[within(whole.first)..within(end)];
            if own.is_empty() {
                continue;
            }
            let first = part.surfaces.len() as u32;
            let moved = if whole.first < triangles {
                self.append_triangles(whole, own, &mut part.surfaces)
            } else {
                let spheres = &self.surfaces.spheres;
                let own = own.iter().map(|&id| spheres[(id - triangles) as usize]);
                append(&mut part.surfaces.spheres, own.collect());
                *whole
            };
            part.header.parts.push(Part { first, ..moved });
        }
        part.surfaces.objects = part.header.objects();
        part.textures = vec![Texture::default(); self.textures.len()];
        for Part { material, .. } in &part.header.parts {
            if let Some(texture) = self.header.materials[*material as usize].texture {
                part.textures[texture as usize].clone_from(&self.textures[texture as usize]);
            }
        }
        part
    }

    /// Appends triangles of one part, and the vertices that they use in the order of the whole.
    fn append_triangles(&self, whole: &Part, ids: &[u32], to: &mut Surfaces) -> Part {
        let from = &self.surfaces;
        let corners = |id: u32| from.triangles[id as usize].map(|index| index - whole.vertices);
        let used = Numbering::new(ids.par_iter().flat_map_iter(|&id| corners(id)));
        let vertices = to.positions.len() as u32;
        let triangles = ids.par_iter().map(|&id| corners(id).map(|old| vertices + used.number(old)));
        append(&mut to.triangles, triangles.collect());
        let copy = |base: u32, source: &[[f32; 3]], target: &mut Store<[f32; 3]>| {
            append(target, used.members().map(|old| source[(base + old) as usize]).collect())
        };
        copy(whole.vertices, &from.positions, &mut to.positions);
        let mut moved = Part { vertices, ..*whole };
        if whole.normals != NONE {
            moved.normals = copy(whole.normals, &from.normals, &mut to.normals);
        }
        if whole.colors != NONE {
            moved.colors = copy(whole.colors, &from.colors, &mut to.colors);
        }
        if whole.uvs != NONE {
            let uvs = used.members().map(|old| from.uvs[(whole.uvs + old) as usize]);
            moved.uvs = append(&mut to.uvs, uvs.collect());
        }
        moved
    }
}

/// Appends to an array; where the new elements begin.
fn append<T: Pod>(to: &mut Store<T>, elements: Vec<T>) -> u32 {
    let first = to.len() as u32;
    to.append(elements).expect("memory for a part of the scene");
    first
}

/// A set of numbers, and the place of each among them in ascending order.
struct Numbering {
    bits: Vec<u64>,
    /// Members in the words before.
    before: Vec<u32>,
}

impl Numbering {
    fn new(members: impl ParallelIterator<Item = u32> + Clone) -> Self {
        use std::sync::atomic::{AtomicU64, Ordering};
        let words = members.clone().max().map_or(0, |most| most as usize / 64 + 1);
        let bits: Vec<AtomicU64> = (0..words).map(|_| AtomicU64::new(0)).collect();
        members.for_each(|member| {
            bits[member as usize / 64].fetch_or(1 << (member % 64), Ordering::Relaxed);
        });
        let bits: Vec<u64> = bits.into_iter().map(AtomicU64::into_inner).collect();
        let mut before = Vec::with_capacity(bits.len());
        let mut sum = 0;
        for word in &bits {
            before.push(sum);
            sum += word.count_ones();
        }
        Numbering { bits, before }
    }

    /// The place of a member.
    fn number(&self, member: u32) -> u32 {
        let (word, bit) = (member as usize / 64, member % 64);
        self.before[word] + (self.bits[word] & ((1 << bit) - 1)).count_ones()
    }

    fn members(&self) -> impl Iterator<Item = u32> + '_ {
        self.bits.iter().enumerate().flat_map(|(word, &bits)| {
            (0..64).filter(move |bit| bits >> bit & 1 == 1).map(move |bit| word as u32 * 64 + bit)
        })
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::scene::load;

    #[test]
    fn a_numbering_counts_members_only() {
        let numbering = Numbering::new([200u32, 3, 64, 3, 63].into_par_iter());
        assert_eq!(numbering.members().collect::<Vec<_>>(), [3, 63, 64, 200]);
        assert_eq!([3, 63, 64, 200].map(|member| numbering.number(member)), [0, 1, 2, 3]);
        assert_eq!(Numbering::new(Vec::<u32>::new().into_par_iter()).members().count(), 0);
    }

    #[test]
    fn primitives_keep_all_that_is_theirs() {
        for scene in ["textured", "shading", "sphereflake", "glass"] {
            let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes").join(format!("{scene}.toml"));
            let whole = load::load(&path).unwrap().scene;
            let ids: Vec<u32> = (0..whole.surfaces.len() as u32).filter(|id| id % 3 == 1).collect();
            let part = whole.subset(&ids);
            assert_eq!(part.surfaces.len(), ids.len(), "{scene}");
            assert!(part.surfaces.positions.len() <= whole.surfaces.positions.len());
            for (own, &id) in (0..).zip(&ids) {
                let (a, b) = (part.part(own), whole.part(id));
                assert_eq!((a.material, a.shading), (b.material, b.shading));
                if whole.surfaces.sphere_at(id).is_some() {
                    assert_eq!(part.surfaces.sphere_at(own), whole.surfaces.sphere_at(id));
                    continue;
                }
                assert_eq!(part.surfaces.triangle(own), whole.surfaces.triangle(id));
                let corner = |scene: &Scene, part: &Part, id: u32, k: usize| {
                    let surfaces = &scene.surfaces;
                    let index = surfaces.triangles[id as usize][k] - part.vertices;
                    let at = |base: u32| (base != NONE).then_some((base.wrapping_add(index)) as usize);
                    (
                        at(part.normals).map(|at| surfaces.normals[at]),
                        at(part.uvs).map(|at| surfaces.uvs[at]),
                        at(part.colors).map(|at| surfaces.colors[at]),
                    )
                };
                for k in 0..3 {
                    assert_eq!(corner(&part, a, own, k), corner(&whole, b, id, k), "{scene}, {id}");
                }
                if let Some(texture) = whole.header.materials[b.material as usize].texture {
                    assert_eq!(part.textures[texture as usize], whole.textures[texture as usize]);
                }
            }
        }
    }
}
