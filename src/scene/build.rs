//! Puts a scene together: placed meshes and spheres in world space in, a [`Scene`] in stored space out.

use std::path::{Path, PathBuf};

use glam::{DAffine3, DMat3, DVec3};

use super::mesh::{Mesh, NONE, Part, Shading, Sphere};
use super::normals;
use super::{Camera, Frame, Material, Scene, SceneHeader, Surfaces, Texture, light::LightShape};
use crate::error::{Error, Result};

/// A sphere before it is placed: centre and radius in the object's own space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ball {
    pub center: DVec3,
    pub radius: f64,
}

/// Collects the parts of a scene. Primitive ids follow the order of the calls: triangles, then spheres.
#[derive(Debug)]
pub struct SceneBuilder {
    file: PathBuf,
    surfaces: Surfaces,
    triangle_parts: Vec<Part>,
    sphere_parts: Vec<Part>,
    materials: Vec<Material>,
    textures: Vec<Texture>,
}

impl SceneBuilder {
    /// `file` is named in errors.
    pub fn new(file: &Path) -> Self {
        SceneBuilder {
            file: file.to_owned(),
            surfaces: Surfaces::default(),
            triangle_parts: Vec::new(),
            sphere_parts: Vec::new(),
            materials: Vec::new(),
            textures: Vec::new(),
        }
    }

    /// The file that is named in errors.
    pub fn file(&self) -> &Path {
        &self.file
    }

    /// Adds a material and returns its index.
    pub fn material(&mut self, material: Material) -> u32 {
        self.materials.push(material);
        self.materials.len() as u32 - 1
    }

    /// Adds a texture and returns its index.
    pub fn texture(&mut self, texture: Texture) -> u32 {
        self.textures.push(texture);
        self.textures.len() as u32 - 1
    }

    /// Places a mesh. Missing normals are computed where the shading needs them. A mirroring transform keeps outsides
    /// outside.
    ///
    /// # Errors
    /// An index out of range, a coordinate that isn't finite in f32 after the transform, or more than 2^31 primitives or vertices.
    pub fn mesh(
        &mut self,
        mut mesh: Mesh,
        transform: &DAffine3,
        material: u32,
        shading: Shading,
    ) -> Result<()> {
        self.check_mesh(&mesh)?;
        if mesh.triangles.is_empty() {
            return Ok(());
        }
        if shading == Shading::Flat {
            mesh.normals = Vec::new();
        } else if mesh.normals.is_empty() {
            mesh.normals = normals::smooth(&mesh.positions, &mesh.triangles);
        }
        let surfaces = &mut self.surfaces;
        let vertices = surfaces.positions.len() as u32;
        let start_of = |stored: usize, added: usize| if added == 0 { NONE } else { stored as u32 };
        self.triangle_parts.push(Part {
            first: surfaces.triangles.len() as u32,
            material,
            shading,
            vertices,
            normals: start_of(surfaces.normals.len(), mesh.normals.len()),
            uvs: start_of(surfaces.uvs.len(), mesh.uvs.len()),
            colors: start_of(surfaces.colors.len(), mesh.colors.len()),
        });
        let identity = *transform == DAffine3::IDENTITY;
        if !identity {
            for point in &mut mesh.positions {
                *point = place(transform, *point);
            }
            let normal_transform = normal_transform(&transform.matrix3);
            for normal in &mut mesh.normals {
                let moved = normal_transform * DVec3::from(normal.map(f64::from));
                *normal = moved.normalize_or_zero().to_array().map(|c| c as f32);
            }
        }
        if let Some(bad) = mesh.positions.iter().find(|point| point.iter().any(|c| !c.is_finite())) {
            return Err(self.error(
                format!("a vertex lies at {bad:?}, which f32 can't hold"),
                "make the object's scale and translation smaller",
            ));
        }
        let mirrored = transform.matrix3.determinant() < 0.0;
        surfaces.triangles.extend(mesh.triangles.iter().map(|&[a, b, c]| {
            let [b, c] = if mirrored { [c, b] } else { [b, c] };
            [a + vertices, b + vertices, c + vertices]
        }));
        append(&mut surfaces.positions, mesh.positions);
        append(&mut surfaces.normals, mesh.normals);
        append(&mut surfaces.uvs, mesh.uvs);
        append(&mut surfaces.colors, mesh.colors);
        Ok(())
    }

    /// Places spheres under a transform that keeps them spheres.
    ///
    /// # Errors
    /// A transform that isn't a similarity, a centre or radius that isn't finite in f32, or a radius that isn't positive.
    pub fn spheres(&mut self, balls: &[Ball], transform: &DAffine3, material: u32) -> Result<()> {
        if balls.is_empty() {
            return Ok(());
        }
        let scale = self.uniform_scale(&transform.matrix3)?;
        self.sphere_parts.push(Part {
            first: self.surfaces.spheres.len() as u32,
            material,
            shading: Shading::Phong,
            vertices: NONE,
            normals: NONE,
            uvs: NONE,
            colors: NONE,
        });
        for ball in balls {
            let center = transform.transform_point3(ball.center).to_array().map(|c| c as f32);
            let radius = (ball.radius * scale) as f32;
            if !(center.iter().all(|c| c.is_finite()) && radius.is_finite() && radius > 0.0) {
                return Err(self.error(
                    format!("a sphere has centre {center:?} and radius {radius}"),
                    "give finite numbers and a radius above 0",
                ));
            }
            self.surfaces.spheres.push(Sphere { center, radius });
        }
        self.check_count()
    }

    /// World-space bounds of what has been placed so far, or `None` if that is nothing.
    pub fn bounds(&self) -> Option<(DVec3, DVec3)> {
        self.surfaces.bounds()
    }

    /// Completes the scene: chooses the frame and moves everything into stored space. `header` holds camera,
    /// lights and colours in world space; the rest of it is filled in.
    pub fn finish(mut self, mut header: SceneHeader) -> Scene {
        let frame = Frame::apply(&mut self.surfaces);
        let triangles = self.surfaces.triangles.len() as u32;
        header.parts = self.triangle_parts;
        header
            .parts
            .extend(self.sphere_parts.into_iter().map(|part| Part { first: part.first + triangles, ..part }));
        self.surfaces.objects = header.parts.iter().map(|part| part.first).collect();
        header.materials = self.materials;
        header.frame = frame;
        store_camera(&mut header.camera, &frame);
        for light in &mut header.lights {
            match &mut light.shape {
                LightShape::Point { position } | LightShape::Spot { position, .. } => {
                    *position = frame.to_stored(*position);
                }
                LightShape::Directional { .. } => {}
            }
        }
        Scene { surfaces: self.surfaces, textures: self.textures, header }
    }

    fn check_mesh(&self, mesh: &Mesh) -> Result<()> {
        let vertices = mesh.positions.len();
        let complete = |length: usize| length == 0 || length == vertices;
        let in_range = mesh.triangles.iter().flatten().all(|&index| (index as usize) < vertices);
        let whole = complete(mesh.normals.len()) && complete(mesh.uvs.len()) && complete(mesh.colors.len());
        if !(in_range && whole) {
            return Err(self.error(
                format!("a triangle refers to a vertex beyond the {vertices} there are"),
                "write the mesh file anew",
            ));
        }
        let limit = i32::MAX as usize;
        if self.surfaces.positions.len() + vertices > limit
            || self.surfaces.len() + mesh.triangles.len() > limit
        {
            return Err(self.too_many());
        }
        Ok(())
    }

    fn check_count(&self) -> Result<()> {
        if self.surfaces.len() > i32::MAX as usize { Err(self.too_many()) } else { Ok(()) }
    }

    fn too_many(&self) -> Error {
        self.error("more than 2^31 primitives or vertices".into(), "use a coarser mesh or fewer levels")
    }

    fn uniform_scale(&self, matrix: &DMat3) -> Result<f64> {
        let (x, y, z) = (matrix.x_axis, matrix.y_axis, matrix.z_axis);
        let (a, b, c) = (x.length(), y.length(), z.length());
        let close = |p: f64, q: f64| (p - q).abs() <= 1e-9 * p.abs().max(q.abs());
        let right_angled = [x.dot(y), y.dot(z), z.dot(x)].iter().all(|d| d.abs() <= 1e-9 * a * a);
        if a > 0.0 && close(a, b) && close(b, c) && right_angled {
            Ok(a)
        } else {
            Err(self
                .error("spheres can't be stretched".into(), "scale them by one number, or use an icosphere"))
        }
    }

    fn error(&self, what: String, mend: &str) -> Error {
        Error::scene(&self.file, None, what, mend)
    }
}

fn place(transform: &DAffine3, point: [f32; 3]) -> [f32; 3] {
    transform.transform_point3(DVec3::from(point.map(f64::from))).to_array().map(|c| c as f32)
}

/// Moves normals so that they stay upright on a surface that `matrix` moves: its cofactor matrix, turned outwards.
fn normal_transform(matrix: &DMat3) -> DMat3 {
    let (x, y, z) = (matrix.x_axis, matrix.y_axis, matrix.z_axis);
    let cofactors = DMat3::from_cols(y.cross(z), z.cross(x), x.cross(y));
    if matrix.determinant() < 0.0 { cofactors * -1.0 } else { cofactors }
}

fn store_camera(camera: &mut Camera, frame: &Frame) {
    camera.position = frame.to_stored(camera.position);
    if camera.projection == super::camera::Projection::Orthographic {
        camera.right *= frame.scale;
        camera.up *= frame.scale;
    }
}

/// Appends without copying where the target is still empty.
fn append<T>(target: &mut Vec<T>, mut source: Vec<T>) {
    if target.is_empty() { *target = source } else { target.append(&mut source) }
}
