//! The surface at a hit: exact position, both normals on the viewer's side, material and colours.

use glam::DVec3;

use crate::geometry::position;
use crate::geometry::record::{Answer, RayRecord};
use crate::scene::mesh::NONE;
use crate::scene::{Color, Material, Part, Scene, Shading};

/// What shading needs to know of a hit.
pub struct Interaction<'a> {
    pub position: DVec3,
    pub primitive: u32,
    /// Unit geometric normal on the side that the ray came from.
    pub geometric: DVec3,
    /// Unit shading normal on the same side of the surface.
    pub normal: DVec3,
    /// Whether the ray came from outside: from where the surface's own geometric normal points.
    pub entering: bool,
    pub material: &'a Material,
    pub shading: Shading,
    /// What multiplies kd: texture and vertex colour.
    pub diffuse_tint: Color,
    /// What multiplies ka: the texture.
    pub ambient_tint: Color,
    /// Of a Gouraud-shaded triangle its vertices, and their normals as seen from the ray's side.
    pub vertices: [Vertex; 3],
    /// Barycentric weights of the vertices.
    pub weights: [f64; 3],
}

#[derive(Clone, Copy, Debug, Default)]
pub struct Vertex {
    pub position: DVec3,
    pub normal: DVec3,
}

impl<'a> Interaction<'a> {
    /// Radiance that the surface sends back along the ray by itself.
    pub fn emission(&self) -> Color {
        self.material.emitted(self.entering)
    }

    pub fn new(scene: &'a Scene, record: &RayRecord, answer: &Answer) -> Self {
        let part = scene.part(answer.primitive);
        let material = &scene.header.materials[part.material as usize];
        let direction = DVec3::from(record.direction);
        match scene.surfaces.sphere_at(answer.primitive) {
            Some(sphere) => {
                let center = widened(sphere.center);
                let hit = DVec3::from(record.origin) + direction * answer.t;
                let (position, outward) = position::on_sphere(center, f64::from(sphere.radius), hit);
                let entering = outward.dot(direction) < 0.0;
                let normal = if entering { outward } else { -outward };
                Interaction {
                    position,
                    primitive: answer.primitive,
                    geometric: normal,
                    normal,
                    entering,
                    material,
                    shading: part.shading,
                    diffuse_tint: [1.0; 3],
                    ambient_tint: [1.0; 3],
                    vertices: [Vertex::default(); 3],
                    weights: [0.0; 3],
                }
            }
            None => Self::on_triangle(scene, part, material, answer, direction),
        }
    }

    fn on_triangle(
        scene: &'a Scene,
        part: &Part,
        material: &'a Material,
        answer: &Answer,
        direction: DVec3,
    ) -> Self {
        let surfaces = &scene.surfaces;
        let [a, b, c] = surfaces.triangle(answer.primitive);
        let corners @ [a, b, c] = [widened(a), widened(b), widened(c)];
        let weights = position::weights(answer.u, answer.v);
        let outward = unit((b - a).cross(c - a));
        let entering = outward.dot(direction) < 0.0;
        let geometric = if entering { outward } else { -outward };
        let [i, j, k] = surfaces.triangles[answer.primitive as usize];
        let indices = [i - part.vertices, j - part.vertices, k - part.vertices];
        let at = |base: u32, corner: usize| (base + indices[corner]) as usize;

        let vertex = |position| Vertex { position, normal: geometric };
        let mut vertices = [vertex(a), vertex(b), vertex(c)];
        let mut normal = geometric;
        if part.normals != NONE {
            let stored_at = |corner| widened(surfaces.normals[at(part.normals, corner)]);
            let stored = [stored_at(0), stored_at(1), stored_at(2)];
            let turned = turned(stored, geometric);
            for (vertex, turned) in vertices.iter_mut().zip(turned) {
                vertex.normal = turned;
            }
            let blend = weighted(turned, weights);
            normal = facing(blend, geometric);
        }

        let mut ambient_tint = [1.0; 3];
        if let Some(texture) = material.texture
            && part.uvs != NONE
        {
            let uvs: [[f32; 2]; 3] = std::array::from_fn(|corner| surfaces.uvs[at(part.uvs, corner)]);
            let [u, v] = std::array::from_fn(|k| {
                (f64::from(uvs[0][k]) * weights[0] + f64::from(uvs[1][k]) * weights[1])
                    + f64::from(uvs[2][k]) * weights[2]
            });
            ambient_tint = scene.textures[texture as usize].sample(u, v);
        }
        let mut diffuse_tint = ambient_tint;
        if part.colors != NONE {
            let colors: [DVec3; 3] =
                std::array::from_fn(|corner| widened(surfaces.colors[at(part.colors, corner)]));
            diffuse_tint = super::times(diffuse_tint, weighted(colors, weights).to_array());
        }
        Interaction {
            position: position::on_triangle(corners, weights),
            primitive: answer.primitive,
            geometric,
            normal,
            entering,
            material,
            shading: part.shading,
            diffuse_tint,
            ambient_tint,
            vertices,
            weights,
        }
    }
}

#[inline(always)]
pub(super) fn widened(v: [f32; 3]) -> DVec3 {
    DVec3::new(f64::from(v[0]), f64::from(v[1]), f64::from(v[2]))
}

#[inline(always)]
pub(super) fn weighted(values: [DVec3; 3], weights: [f64; 3]) -> DVec3 {
    (values[0] * weights[0] + values[1] * weights[1]) + values[2] * weights[2]
}

/// A unit vector, also where the square of its length leaves f64's range.
#[inline(always)]
pub(super) fn unit(v: DVec3) -> DVec3 {
    let largest = v.abs().max_element();
    if largest > 0.0 { (v / largest).normalize() } else { DVec3::Z }
}

/// A unit vector, or `instead` where `v` has no direction.
#[inline(always)]
fn unit_or(v: DVec3, instead: DVec3) -> DVec3 {
    let inverse = v.length_recip();
    if (inverse > 0.0) & (inverse < f64::INFINITY) { v * inverse } else { instead }
}

/// A triangle's vertex normals, normalised, on the side of the surface that `geometric` points to. All three turn together: at a sharp edge one may point behind this triangle, and turning it
/// here but not next door would tear the shading apart.
#[inline(always)]
pub(super) fn turned(stored: [DVec3; 3], geometric: DVec3) -> [DVec3; 3] {
    let side = if (stored[0] + stored[1] + stored[2]).dot(geometric) < 0.0 { -1.0 } else { 1.0 };
    let turn = |normal: DVec3| unit_or(normal * side, geometric);
    [turn(stored[0]), turn(stored[1]), turn(stored[2])]
}

/// `normal`, normalised, on the side of the surface that `geometric` points to, which stands in for one without direction.
#[inline(always)]
pub(super) fn facing(normal: DVec3, geometric: DVec3) -> DVec3 {
    let normal = unit_or(normal, geometric);
    if normal.dot(geometric) < 0.0 { -normal } else { normal }
}
