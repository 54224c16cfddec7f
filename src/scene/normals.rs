//! Vertex normals for meshes that come without.

use glam::DVec3;
use rayon::slice::ParallelSliceMut;

/// Unit vertex normals: at each position the sum over its triangles of the normal weighted by area and by the
/// angle there. Vertices at the same position share one normal, so that seams of texture coordinates don't show.
/// A vertex without any proper triangle gets (0, 0, 0).
pub fn smooth(positions: &[[f32; 3]], triangles: &[[u32; 3]]) -> Vec<[f32; 3]> {
    let representative = weld(positions);
    let mut sums = vec![DVec3::ZERO; positions.len()];
    for triangle in triangles {
        let corners = triangle.map(|index| DVec3::from(positions[index as usize].map(f64::from)));
        let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
        for corner in 0..3 {
            let to_next = corners[(corner + 1) % 3] - corners[corner];
            let to_last = corners[(corner + 2) % 3] - corners[corner];
            let angle = libm::atan2(to_next.cross(to_last).length(), to_next.dot(to_last));
            sums[representative[triangle[corner] as usize] as usize] += normal * angle;
        }
    }
    representative.iter().map(|&vertex| unit(sums[vertex as usize]).to_array().map(|c| c as f32)).collect()
}

/// Normalises also what is so small or large that its square leaves f64's range.
fn unit(sum: DVec3) -> DVec3 {
    let largest = sum.abs().max_element();
    if largest > 0.0 && largest.is_finite() { (sum / largest).normalize() } else { DVec3::ZERO }
}

/// For each vertex the least index of a vertex at the same position (0 and -0 are the same).
fn weld(positions: &[[f32; 3]]) -> Vec<u32> {
    let key = |index: u32| positions[index as usize].map(|c| (c + 0.0).to_bits());
    let mut order: Vec<u32> = (0..positions.len() as u32).collect();
    order.par_sort_unstable_by_key(|&index| (key(index), index));
    let mut representative = vec![0; positions.len()];
    for run in order.chunk_by(|&a, &b| key(a) == key(b)) {
        for &index in run {
            representative[index as usize] = run[0];
        }
    }
    representative
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn corner_of_a_cube_points_diagonally() {
        // Three faces around the origin, one of them cut into two triangles: the angle keeps them balanced.
        let positions =
            [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 1.0, 0.0], [-0.0, 0.0, -0.0]];
        let triangles = [[0, 2, 4], [0, 4, 1], [5, 3, 2], [0, 1, 3]];
        let normals = smooth(&positions, &triangles);
        assert_eq!(normals[0], normals[5]);
        let expected = -(1.0f32 / 3.0).sqrt();
        assert!(normals[0].iter().all(|c| (c - expected).abs() < 1e-6), "{:?}", normals[0]);
    }

    #[test]
    fn a_vertex_of_no_area_has_no_normal() {
        assert_eq!(smooth(&[[1.0; 3], [2.0; 3], [3.0; 3]], &[[0, 1, 2]]), [[0.0; 3]; 3]);
    }
}
