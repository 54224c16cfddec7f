//! A rectangle on the ground: two triangles around the origin, facing up.

use crate::scene::mesh::Mesh;

/// `size` is the extent along x and z, `repeat` how often texture coordinates run from 0 to 1 across it. Seen from
/// above with z towards the viewer a texture is upright.
pub fn plane(size: [f64; 2], repeat: [f64; 2]) -> Mesh {
    let corners = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
    Mesh {
        positions: corners
            .iter()
            .map(|[u, v]| [((u - 0.5) * size[0]) as f32, 0.0, ((0.5 - v) * size[1]) as f32])
            .collect(),
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        normals: vec![[0.0, 1.0, 0.0]; 4],
        uvs: corners.iter().map(|[u, v]| [(u * repeat[0]) as f32, (v * repeat[1]) as f32]).collect(),
        colors: Vec::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::generate::check;

    #[test]
    fn faces_up_and_repeats() {
        let mesh = plane([4.0, 2.0], [2.0, 1.0]);
        check::sound(&mesh);
        assert_eq!(check::open_edges(&mesh).len(), 4);
        assert_eq!(mesh.positions[2], [2.0, 0.0, -1.0]);
        assert_eq!(mesh.uvs[2], [2.0, 1.0]);
    }
}
