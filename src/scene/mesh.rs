//! The large arrays of a scene: triangles, spheres and what is stored at vertices; and the mesh of one
//! object before it is placed.

use glam::DVec3;
use serde::{Deserialize, Serialize};

use crate::geometry::position;
use crate::geometry::record::{Answer, RayRecord};
use crate::memory::Store;

/// "No such index" in a 32-bit index.
pub const NONE: u32 = u32::MAX;

/// How normals are used across a triangle (a sphere is always smooth).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Shading {
    /// Normals interpolated, light computed at the hit (Phong 1975).
    #[default]
    Phong,
    /// Light computed at the vertices and interpolated (Gouraud 1971); shadows still at the hit.
    Gouraud,
    /// One normal for each triangle.
    Flat,
}

/// A run of primitives that share material and shading.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Part {
    /// Its first primitive id; it ends where the next part begins.
    pub first: u32,
    pub material: u32,
    pub shading: Shading,
    /// The first of its vertices in `Surfaces::positions`.
    pub vertices: u32,
    /// Where its vertex normals begin in `Surfaces::normals`, or [`NONE`].
    pub normals: u32,
    /// Where its texture coordinates begin in `Surfaces::uvs`, or [`NONE`].
    pub uvs: u32,
    /// Where its vertex colours begin in `Surfaces::colors`, or [`NONE`].
    pub colors: u32,
}

/// A sphere. Its f32 numbers are the truth, like a triangle's vertices.
#[repr(C)]
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, bytemuck::Pod, bytemuck::Zeroable,
)]
pub struct Sphere {
    pub center: [f32; 3],
    pub radius: f32,
}

/// A primitive by its numbers alone.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Shape {
    Triangle([[f32; 3]; 3]),
    Sphere(Sphere),
}

/// Ids from here on are those of guests, see [`Surfaces::guests`].
pub const FIRST_GUEST: u32 = 1 << 31;

/// Whether a primitive that a ray starts on is a guest.
#[inline(always)]
pub fn is_guest(start: u32) -> bool {
    // No short circuit: it is asked of many rays side by side.
    (start >= FIRST_GUEST) & (start != NONE)
}

/// All primitives of a scene in stored space, in memory or in the file that they were converted to.
#[derive(Clone, Debug, Default)]
pub struct Surfaces {
    pub positions: Store<[f32; 3]>,
    /// Three indices into `positions` for each triangle.
    pub triangles: Store<[u32; 3]>,
    pub spheres: Store<Sphere>,
    /// The first primitive of each object, ascending; what comes before the first is one more.
    pub objects: Vec<u32>,
    /// Unit vertex normals of the parts that have them.
    pub normals: Store<[f32; 3]>,
    /// Texture coordinates; v grows upwards.
    pub uvs: Store<[f32; 2]>,
    /// Linear RGB vertex colours, which multiply kd.
    pub colors: Store<[f32; 3]>,
    /// Primitives that rays may start on though they lie in another part of the scene. They are never met; the first has the id [`FIRST_GUEST`].
    pub guests: Vec<Option<Shape>>,
}

impl Surfaces {
    /// Number of primitives: triangles, then spheres.
    pub fn len(&self) -> usize {
        self.triangles.len() + self.spheres.len()
    }

    /// Bytes of the arrays.
    pub fn memory(&self) -> usize {
        size_of_val(&self.positions[..])
            + size_of_val(&self.triangles[..])
            + size_of_val(&self.spheres[..])
            + size_of_val(&self.normals[..])
            + size_of_val(&self.uvs[..])
            + size_of_val(&self.colors[..])
    }

    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The sphere of a primitive id, or `None` if that is a triangle or no primitive.
    #[inline]
    pub fn sphere_at(&self, primitive: u32) -> Option<&Sphere> {
        (primitive as usize).checked_sub(self.triangles.len()).and_then(|index| self.spheres.get(index))
    }

    /// Lower and upper corner of everything, or `None` if there is nothing.
    pub fn bounds(&self) -> Option<(DVec3, DVec3)> {
        let point = |p: [f32; 3]| DVec3::from(p.map(f64::from));
        let points = self.positions.iter().map(|&p| (point(p), 0.0));
        let spheres = self.spheres.iter().map(|s| (point(s.center), f64::from(s.radius)));
        points
            .chain(spheres)
            .map(|(center, radius)| (center - radius, center + radius))
            .reduce(|(low, high), (l, h)| (low.min(l), high.max(h)))
    }

    /// The number of the object that a primitive belongs to.
    pub fn object(&self, primitive: u32) -> usize {
        self.objects.partition_point(|&first| first <= primitive)
    }

    /// What spheres and boxes around a primitive must hold: the vertices of a triangle with radius 0; three times the same sphere.
    #[inline]
    pub fn balls(&self, primitive: u32) -> [([f64; 3], f64); 3] {
        match self.sphere_at(primitive) {
            Some(sphere) => [(sphere.center.map(f64::from), f64::from(sphere.radius)); 3],
            None => self.triangle(primitive).map(|vertex| (vertex.map(f64::from), 0.0)),
        }
    }

    /// The three vertices of a triangle id.
    #[inline(always)]
    pub fn triangle(&self, primitive: u32) -> [[f32; 3]; 3] {
        let [a, b, c] = self.triangles[primitive as usize];
        [self.positions[a as usize], self.positions[b as usize], self.positions[c as usize]]
    }

    /// What a ray starts on, if it starts on anything.
    #[inline]
    pub fn start(&self, primitive: u32) -> Option<Shape> {
        if (primitive as usize) < self.triangles.len() {
            return Some(Shape::Triangle(self.triangle(primitive)));
        }
        match self.sphere_at(primitive) {
            Some(sphere) => Some(Shape::Sphere(*sphere)),
            None if primitive == NONE => None,
            None => self.guest(primitive),
        }
    }

    #[cold]
    fn guest(&self, primitive: u32) -> Option<Shape> {
        let index = primitive.checked_sub(FIRST_GUEST)?;
        self.guests.get(index as usize).copied().flatten()
    }

    /// The point of a hit, in stored space: where the rays that go on from it start.
    pub fn position(&self, record: &RayRecord, answer: &Answer) -> DVec3 {
        let point = |p: [f32; 3]| DVec3::from(p.map(f64::from));
        match self.sphere_at(answer.primitive) {
            Some(sphere) => {
                let hit = DVec3::from(record.origin) + DVec3::from(record.direction) * answer.t;
                position::on_sphere(point(sphere.center), f64::from(sphere.radius), hit).0
            }
            None => {
                let corners = self.triangle(answer.primitive).map(point);
                position::on_triangle(corners, position::weights(answer.u, answer.v))
            }
        }
    }
}

/// Whether a triangle has an area: its corners don't lie on one line. One that has none is never hit.
pub fn has_area(vertices: &[[f32; 3]; 3]) -> bool {
    let corner = |k: usize| DVec3::new(vertices[k][0].into(), vertices[k][1].into(), vertices[k][2].into());
    let a = corner(0);
    (corner(1) - a).cross(corner(2) - a) != DVec3::ZERO
}

/// One mesh with one material, in the object's own space, before it is placed in the scene.
///
/// `normals`, `uvs` and `colors` are empty or hold one entry for each position.
#[derive(Clone, Debug, Default)]
pub struct Mesh {
    pub positions: Vec<[f32; 3]>,
    /// Three indices into `positions` for each triangle, in the order of the file.
    pub triangles: Vec<[u32; 3]>,
    pub normals: Vec<[f32; 3]>,
    pub uvs: Vec<[f32; 2]>,
    pub colors: Vec<[f32; 3]>,
}

/// What a mesh consists of, before it is made.
#[derive(Clone, Copy, Debug)]
pub struct MeshSize {
    pub vertices: usize,
    pub triangles: usize,
}

/// Room for a mesh where it is kept: as [`Mesh`], but without colours, and `normals` is empty where none are wanted.
#[derive(Debug)]
pub struct MeshMut<'a> {
    pub positions: &'a mut [[f32; 3]],
    pub triangles: &'a mut [[u32; 3]],
    pub normals: &'a mut [[f32; 3]],
    pub uvs: &'a mut [[f32; 2]],
}
