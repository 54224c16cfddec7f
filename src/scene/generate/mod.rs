//! Shapes that are computed rather than read: meshes and spheres in their own space, y up, outsides out.
//! Knows no file format and no scene.

pub mod cuboid;
pub mod icosphere;
pub mod plane;
pub mod sphereflake;
pub mod teapot;
pub mod terrain;

/// What the tests of all generators ask of a mesh.
#[cfg(test)]
mod check {
    use std::collections::HashMap;

    use glam::DVec3;

    use crate::scene::mesh::Mesh;

    pub fn point(p: [f32; 3]) -> DVec3 {
        DVec3::from(p.map(f64::from))
    }

    fn corners(mesh: &Mesh, triangle: [u32; 3]) -> [DVec3; 3] {
        triangle.map(|index| point(mesh.positions[index as usize]))
    }

    /// Indices are in range, arrays complete, normals of length 1 on their triangle's side, no area is zero.
    pub fn sound(mesh: &Mesh) {
        assert_eq!(mesh.normals.len(), mesh.positions.len());
        assert!(mesh.uvs.is_empty() || mesh.uvs.len() == mesh.positions.len());
        for normal in &mesh.normals {
            assert!((point(*normal).length() - 1.0).abs() < 1e-6, "normal {normal:?}");
        }
        for &triangle in &mesh.triangles {
            let [a, b, c] = corners(mesh, triangle);
            let normal = (b - a).cross(c - a);
            assert!(normal.length() > 0.0, "no area: {a} {b} {c}");
            for index in triangle {
                let side = normal.dot(point(mesh.normals[index as usize]));
                assert!(side > 0.0, "normal at {} points inwards", point(mesh.positions[index as usize]));
            }
        }
    }

    /// Sum over the triangles of the signed volume below them: positive if outsides are out (divergence theorem).
    pub fn volume(mesh: &Mesh) -> f64 {
        mesh.triangles
            .iter()
            .map(|&triangle| {
                let [a, b, c] = corners(mesh, triangle);
                a.dot(b.cross(c)) / 6.0
            })
            .sum()
    }

    /// A vertex after welding, as the bits of its position (-0 as 0).
    pub type Key = [u32; 3];

    /// For each directed edge between distinct positions the number of triangles that have it.
    pub fn edges(mesh: &Mesh) -> HashMap<(Key, Key), usize> {
        let key = |index: u32| mesh.positions[index as usize].map(|c| (c + 0.0).to_bits());
        let mut edges = HashMap::new();
        for [a, b, c] in &mesh.triangles {
            for (from, to) in [(a, b), (b, c), (c, a)] {
                *edges.entry((key(*from), key(*to))).or_default() += 1;
            }
        }
        edges
    }

    /// Edges without a partner that runs the other way, after vertices of equal position are one.
    pub fn open_edges(mesh: &Mesh) -> Vec<(Key, Key)> {
        let edges = edges(mesh);
        assert!(edges.values().all(|&count| count == 1), "an edge is used twice in the same direction");
        edges.keys().filter(|(from, to)| !edges.contains_key(&(*to, *from))).copied().collect()
    }

    /// Vertices - edges + faces after welding.
    pub fn euler_characteristic(mesh: &Mesh) -> i64 {
        let edges = edges(mesh);
        let vertices: std::collections::HashSet<_> = edges.keys().map(|(from, _)| *from).collect();
        let undirected =
            edges.keys().filter(|(from, to)| from < to || !edges.contains_key(&(*to, *from))).count();
        vertices.len() as i64 - undirected as i64 + mesh.triangles.len() as i64
    }
}
