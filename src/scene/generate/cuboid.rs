//! An axis-aligned box: six faces with their own vertices, so that its edges stay sharp under any shading.

use glam::DVec3;

use crate::scene::mesh::Mesh;

/// The box between the corners `low` and `high` (`low < high` on each axis). Texture coordinates run from 0 to 1
/// across each face.
pub fn cuboid(low: DVec3, high: DVec3) -> Mesh {
    let mut mesh = Mesh::default();
    for axis in 0..3 {
        for high_side in [false, true] {
            let first = mesh.positions.len() as u32;
            for [u, v] in [[0, 0], [1, 0], [1, 1], [0, 1]] {
                let mut pick = [0; 3];
                pick[axis] = usize::from(high_side);
                // Turning the other two axes the other way round on the low side keeps the outside out.
                let (across, up) = ((axis + 1) % 3, (axis + 2) % 3);
                (pick[across], pick[up]) = if high_side { (u, v) } else { (v, u) };
                mesh.positions
                    .push(std::array::from_fn(|k| if pick[k] == 0 { low[k] as f32 } else { high[k] as f32 }));
                mesh.uvs.push([u as f32, v as f32]);
                let mut normal = [0.0; 3];
                normal[axis] = if high_side { 1.0 } else { -1.0 };
                mesh.normals.push(normal);
            }
            mesh.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
        }
    }
    mesh
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::generate::check;

    #[test]
    fn closed_with_outsides_out() {
        let mesh = cuboid(DVec3::new(-1.0, 0.0, 2.0), DVec3::new(1.0, 3.0, 4.0));
        assert_eq!((mesh.positions.len(), mesh.triangles.len()), (24, 12));
        check::sound(&mesh);
        assert!(check::open_edges(&mesh).is_empty());
        assert_eq!(check::euler_characteristic(&mesh), 2);
        assert!((check::volume(&mesh) - 12.0).abs() < 1e-9);
    }
}
