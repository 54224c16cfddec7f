//! A fractal heightfield: octaves of gradient noise (Perlin 2002) evaluated point by point, so that any part of
//! a terrain of any size can be made without the rest.

use rayon::prelude::*;

use crate::scene::mesh::{MeshMut, MeshSize};

/// 2 * MAX_CELLS^2 triangles still have 31-bit numbers.
pub const MAX_CELLS: u32 = 32767;
/// Finer octaves than this are below f64's resolution.
pub const MAX_OCTAVES: u32 = 32;

/// Cells of the coarsest octave's lattice along an edge of the terrain.
const FEATURES: f64 = 4.0;

/// The square |x|, |z| <= extent / 2 in `cells` * `cells` squares of two triangles, y up.
#[derive(Clone, Debug, PartialEq)]
pub struct Terrain {
    /// 1 ..= MAX_CELLS.
    pub cells: u32,
    /// Length of an edge, > 0.
    pub extent: f64,
    /// No point is farther than this from y = 0; most are within a third of it.
    pub height: f64,
    /// Octaves of noise, 1 ..= MAX_OCTAVES, each twice as fine as the one before. Those too fine for the cells are
    /// left out.
    pub octaves: u32,
    /// Weight of an octave relative to the one before, in [0, 1].
    pub roughness: f64,
    pub seed: u64,
}

impl Default for Terrain {
    fn default() -> Self {
        Terrain { cells: 256, extent: 10.0, height: 2.0, octaves: 8, roughness: 0.5, seed: 0 }
    }
}

/// A point of the terrain.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Vertex {
    pub position: [f32; 3],
    pub normal: [f32; 3],
    pub uv: [f32; 2],
}

impl Terrain {
    /// Number of triangles.
    pub fn count(&self) -> u64 {
        2 * u64::from(self.cells) * u64::from(self.cells)
    }

    /// Height at (x, z) and its derivatives by x and z.
    pub fn surface(&self, x: f64, z: f64) -> (f64, [f64; 2]) {
        let frequency = FEATURES / self.extent;
        // Columns of the map from (x, z) to the octave's lattice. Each octave is turned by the angle whose cosine is 4/5
        // and sine 3/5, lest the zeros of all octaves fall together.
        let mut to_lattice = [[frequency, 0.0], [0.0, frequency]];
        let (mut sum, mut slope, mut weight, mut total) = (0.0, [0.0; 2], 1.0, 0.0);
        for octave in 0..self.visible_octaves() {
            let [[a, b], [c, d]] = to_lattice;
            let (value, [du, dv]) =
                gradient_noise(a * x + c * z, b * x + d * z, hash(self.seed ^ hash(u64::from(octave))));
            sum += weight * value;
            slope[0] += weight * (du * a + dv * b);
            slope[1] += weight * (du * c + dv * d);
            total += weight;
            weight *= self.roughness;
            to_lattice = to_lattice.map(|[p, q]| [1.6 * p - 1.2 * q, 1.2 * p + 1.6 * q]);
        }
        let scale = self.height / total;
        (sum * scale, slope.map(|s| s * scale))
    }

    /// The octaves whose noise has at least two cells between its zeros: the rest would be seen as spikes.
    fn visible_octaves(&self) -> u32 {
        let finest = libm::log2(f64::from(self.cells) / (2.0 * FEATURES)).floor().max(0.0);
        self.octaves.min(1 + finest as u32)
    }

    /// Vertex (i, j), 0 ..= cells each, i along x and j along z.
    pub fn vertex(&self, i: u32, j: u32) -> Vertex {
        let (u, v) = (f64::from(i) / f64::from(self.cells), f64::from(j) / f64::from(self.cells));
        let (x, z) = ((u - 0.5) * self.extent, (v - 0.5) * self.extent);
        let (y, [dx, dz]) = self.surface(x, z);
        let length = (dx * dx + dz * dz + 1.0).sqrt();
        Vertex {
            position: [x as f32, y as f32, z as f32],
            normal: [(-dx / length) as f32, (1.0 / length) as f32, (-dz / length) as f32],
            uv: [u as f32, (1.0 - v) as f32],
        }
    }

    /// The two triangles of cell (i, j), as indices j * (cells + 1) + i of vertices.
    pub fn cell(&self, i: u32, j: u32) -> [[u32; 3]; 2] {
        let row = self.cells + 1;
        let a = j * row + i;
        let (b, c, d) = (a + 1, a + row, a + row + 1);
        [[a, c, b], [b, c, d]]
    }

    /// What the whole terrain consists of.
    pub fn size(&self) -> MeshSize {
        let row = self.cells as usize + 1;
        MeshSize { vertices: row * row, triangles: self.count() as usize }
    }

    /// Makes the whole terrain where it is kept.
    pub fn fill(&self, mesh: MeshMut) {
        let row = self.cells as usize + 1;
        let mut normals: Vec<&mut [[f32; 3]]> = mesh.normals.chunks_mut(row).collect();
        normals.resize_with(row, Default::default);
        let rows = mesh.positions.par_chunks_mut(row).zip(mesh.uvs.par_chunks_mut(row)).zip(normals);
        rows.enumerate().for_each(|(j, ((positions, uvs), normals))| {
            for i in 0..row {
                let vertex = self.vertex(i as u32, j as u32);
                (positions[i], uvs[i]) = (vertex.position, vertex.uv);
                if let Some(normal) = normals.get_mut(i) {
                    *normal = vertex.normal;
                }
            }
        });
        mesh.triangles.par_chunks_mut(2 * self.cells as usize).enumerate().for_each(|(j, row)| {
            for (i, cell) in row.as_chunks_mut::<2>().0.iter_mut().enumerate() {
                *cell = self.cell(i as u32, j as u32);
            }
        });
    }
}

/// Noise in [-1, 1] at (u, v), 0 at whole numbers, and its two derivatives.
fn gradient_noise(u: f64, v: f64, seed: u64) -> (f64, [f64; 2]) {
    let (iu, iv) = (u.floor(), v.floor());
    let (fu, fv) = (u - iu, v - iv);
    let (iu, iv) = (iu as i64, iv as i64);
    let corner = |du: i64, dv: i64| {
        let bits = hash(seed ^ hash(iu.wrapping_add(du) as u64 ^ hash(iv.wrapping_add(dv) as u64)));
        let signed = |half: u32| f64::from(half as i32) * (1.0 / 2_147_483_648.0);
        let gradient = [signed(bits as u32), signed((bits >> 32) as u32)];
        (gradient[0] * (fu - du as f64) + gradient[1] * (fv - dv as f64), gradient)
    };
    let ((a, ga), (b, gb), (c, gc), (d, gd)) = (corner(0, 0), corner(1, 0), corner(0, 1), corner(1, 1));
    let (su, sv) = (quintic(fu), quintic(fv));
    let (slope_u, slope_v) = (quintic_slope(fu), quintic_slope(fv));
    let blend = |a: f64, b: f64, c: f64, d: f64| {
        let (low, high) = (a + (b - a) * su, c + (d - c) * su);
        low + (high - low) * sv
    };
    let value = blend(a, b, c, d);
    let du = blend(ga[0], gb[0], gc[0], gd[0]) + slope_u * ((b - a) + ((d - c) - (b - a)) * sv);
    let dv = blend(ga[1], gb[1], gc[1], gd[1]) + slope_v * ((c - a) + ((d - b) - (c - a)) * su);
    (value, [du, dv])
}

fn quintic(t: f64) -> f64 {
    t * t * t * (t * (t * 6.0 - 15.0) + 10.0)
}

fn quintic_slope(t: f64) -> f64 {
    30.0 * t * t * (t * (t - 2.0) + 1.0)
}

/// SplitMix64's step (Steele, Lea and Flood 2014).
fn hash(x: u64) -> u64 {
    let x = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::generate::check;
    use crate::scene::mesh::Mesh;

    fn whole(terrain: &Terrain) -> Mesh {
        let MeshSize { vertices, triangles } = terrain.size();
        let mut mesh = Mesh {
            positions: vec![[0.0; 3]; vertices],
            triangles: vec![[0; 3]; triangles],
            normals: vec![[0.0; 3]; vertices],
            uvs: vec![[0.0; 2]; vertices],
            ..Mesh::default()
        };
        let Mesh { positions, triangles, normals, uvs, .. } = &mut mesh;
        terrain.fill(MeshMut { positions, triangles, normals, uvs });
        mesh
    }

    #[test]
    fn a_whole_sound_field() {
        let terrain = Terrain { cells: 37, seed: 5, ..Terrain::default() };
        let mesh = whole(&terrain);
        assert_eq!(mesh.positions.len(), 38 * 38);
        assert_eq!(mesh.triangles.len() as u64, terrain.count());
        check::sound(&mesh);
        assert_eq!(check::open_edges(&mesh).len(), 4 * 37);
        assert_eq!(check::euler_characteristic(&mesh), 1);
        let heights = mesh.positions.iter().map(|p| p[1]);
        let (low, high) = heights.fold((0f32, 0f32), |(low, high), y| (low.min(y), high.max(y)));
        assert!(low < -0.2 && high > 0.2 && low >= -2.0 && high <= 2.0, "{low} {high}");
    }

    #[test]
    fn any_part_equals_that_part_of_the_whole() {
        let terrain = Terrain { cells: 20, ..Terrain::default() };
        let mesh = whole(&terrain);
        let vertex = terrain.vertex(7, 13);
        assert_eq!(mesh.positions[13 * 21 + 7], vertex.position);
        assert_eq!(mesh.normals[13 * 21 + 7], vertex.normal);
        assert_eq!(mesh.triangles[2 * (13 * 20 + 7)], terrain.cell(7, 13)[0]);
        assert_ne!(Terrain { seed: 1, ..terrain }.vertex(7, 13), vertex);
    }

    #[test]
    fn slopes_are_the_derivatives() {
        let terrain = Terrain { octaves: 3, ..Terrain::default() };
        for (x, z) in [(0.3, 0.7), (-2.2, 1.9), (4.9, -4.9)] {
            let (_, [dx, dz]) = terrain.surface(x, z);
            let step = 1e-5;
            let along_x = (terrain.surface(x + step, z).0 - terrain.surface(x - step, z).0) / (2.0 * step);
            let along_z = (terrain.surface(x, z + step).0 - terrain.surface(x, z - step).0) / (2.0 * step);
            assert!((dx - along_x).abs() < 1e-6 && (dz - along_z).abs() < 1e-6);
        }
    }
}
