//! A sphere of triangles: the icosahedron, each triangle cut into four `level` times.

use std::collections::HashMap;

use glam::DVec3;

use crate::scene::mesh::Mesh;

/// 20 * 4^level triangles.
pub const MAX_LEVEL: u32 = 11;

/// Number of triangles of a level.
pub fn count(level: u32) -> u64 {
    20 << (2 * level)
}

/// An icosphere of `level <= MAX_LEVEL`. Its vertices lie on the sphere, which gives their normals.
pub fn icosphere(level: u32, center: DVec3, radius: f64) -> Mesh {
    let (mut directions, mut triangles) = icosahedron();
    for _ in 0..level {
        let mut middles = HashMap::with_capacity(triangles.len() * 3 / 2);
        let mut finer = Vec::with_capacity(triangles.len() * 4);
        for [a, b, c] in triangles {
            let mut middle = |p: u32, q: u32| {
                *middles.entry((p.min(q), p.max(q))).or_insert_with(|| {
                    directions.push((directions[p as usize] + directions[q as usize]).normalize());
                    directions.len() as u32 - 1
                })
            };
            let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
            finer.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
        }
        triangles = finer;
    }
    let single = |v: DVec3| v.to_array().map(|c| c as f32);
    Mesh {
        positions: directions.iter().map(|&direction| single(center + direction * radius)).collect(),
        triangles,
        normals: directions.into_iter().map(single).collect(),
        ..Mesh::default()
    }
}

/// Unit vertices and outward triangles, a vertex pair along each axis.
fn icosahedron() -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let golden = (1.0 + 5f64.sqrt()) / 2.0;
    let mut vertices = Vec::with_capacity(12);
    for axis in 0..3 {
        for (one, other) in [(-1.0, -golden), (1.0, -golden), (-1.0, golden), (1.0, golden)] {
            let mut vertex = DVec3::ZERO;
            vertex[axis] = one;
            vertex[(axis + 1) % 3] = other;
            vertices.push(vertex.normalize());
        }
    }
    // Corners of a face are neighbours: their distance is the edge's, the least there is.
    let edge = (vertices[0] - vertices[1]).length() * 1.01;
    let near = |a: usize, b: usize| (vertices[a] - vertices[b]).length() < edge;
    let mut triangles = Vec::with_capacity(20);
    for a in 0..12 {
        for b in a + 1..12 {
            for c in b + 1..12 {
                if near(a, b) && near(b, c) && near(c, a) {
                    let outwards = vertices[a].dot(vertices[b].cross(vertices[c])) > 0.0;
                    let (b, c) = if outwards { (b, c) } else { (c, b) };
                    triangles.push([a as u32, b as u32, c as u32]);
                }
            }
        }
    }
    (vertices, triangles)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::generate::check;

    #[test]
    fn closed_at_every_level() {
        for level in 0..5 {
            let mesh = icosphere(level, DVec3::new(0.5, -1.0, 2.0), 1.5);
            assert_eq!(mesh.triangles.len() as u64, count(level));
            assert_eq!(mesh.positions.len() as u64, count(level) / 2 + 2);
            check::sound(&mesh);
            assert!(check::open_edges(&mesh).is_empty());
            assert_eq!(check::euler_characteristic(&mesh), 2);
            let ball = 4.0 / 3.0 * std::f64::consts::PI * 1.5f64 * 1.5 * 1.5;
            let volume = check::volume(&mesh);
            assert!(volume > 0.6 * ball && volume < ball, "level {level}: {volume} of {ball}");
        }
    }
}
