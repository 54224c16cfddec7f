//! Puts a scene together: placed meshes and spheres in world space in, a [`Scene`] in stored space out.

use std::borrow::Borrow;
use std::io;
use std::path::{Path, PathBuf};

use glam::{DAffine3, DMat3, DVec3};

use super::mesh::{Mesh, MeshMut, MeshSize, NONE, Part, Shading, Sphere};
use super::normals;
use super::{Camera, Frame, Material, Scene, SceneHeader, Surfaces, Texture, light::LightShape};
use crate::error::{Error, Result};
use crate::memory::Store;

/// A sphere before it is placed: centre and radius in the object's own space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ball {
    pub center: DVec3,
    pub radius: f64,
}

/// Where the surfaces of a scene are kept.
#[derive(Clone, Copy, Debug)]
pub enum Space<'a> {
    Memory,
    /// On the disk of this folder, in files without a name.
    Disk(&'a Path),
}

impl Space<'_> {
    fn surfaces(self) -> io::Result<Surfaces> {
        match self {
            Space::Memory => Ok(Surfaces::default()),
            Space::Disk(folder) => Ok(Surfaces {
                positions: Store::spilling(folder)?,
                triangles: Store::spilling(folder)?,
                spheres: Store::spilling(folder)?,
                normals: Store::spilling(folder)?,
                uvs: Store::spilling(folder)?,
                colors: Store::spilling(folder)?,
                guests: Vec::new(),
                objects: Vec::new(),
            }),
        }
    }
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
    /// A scene in memory; `file` is named in errors.
    pub fn new(file: &Path) -> Self {
        SceneBuilder::with(file, Surfaces::default())
    }

    /// A scene that is kept in `space`; `file` is named in errors.
    ///
    /// # Errors
    /// A folder that can't be written to.
    pub fn new_in(file: &Path, space: Space) -> Result<Self> {
        let surfaces = space.surfaces().map_err(|source| match space {
            Space::Disk(folder) => Error::write(folder, source),
            Space::Memory => kept(file, source),
        })?;
        Ok(SceneBuilder::with(file, surfaces))
    }

    fn with(file: &Path, surfaces: Surfaces) -> Self {
        SceneBuilder {
            file: file.to_owned(),
            surfaces,
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
    /// An index out of range, a coordinate that isn't finite in f32 after the transform, more than 2^31 primitives or vertices, or no
    /// space for them.
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
        let start = self.start();
        let surfaces = &mut self.surfaces;
        surfaces
            .triangles
            .append(mesh.triangles)
            .and_then(|()| surfaces.positions.append(mesh.positions))
            .and_then(|()| surfaces.normals.append(mesh.normals))
            .and_then(|()| surfaces.uvs.append(mesh.uvs))
            .and_then(|()| surfaces.colors.append(mesh.colors))
            .map_err(|source| kept(&self.file, source))?;
        self.place(start, transform, material, shading)
    }

    /// Places a mesh that `fill` makes where it is kept. Everything else is as for [`mesh`](SceneBuilder::mesh).
    ///
    /// # Errors
    /// As for [`mesh`](SceneBuilder::mesh).
    pub fn mesh_in_place(
        &mut self,
        size: MeshSize,
        fill: impl FnOnce(MeshMut),
        transform: &DAffine3,
        material: u32,
        shading: Shading,
    ) -> Result<()> {
        self.check_size(size)?;
        let start = self.start();
        let normals = if shading == Shading::Flat { 0 } else { size.vertices };
        fill(grow(&mut self.surfaces, size, normals).map_err(|source| kept(&self.file, source))?);
        self.place(start, transform, material, shading)
    }

    /// Where the next mesh begins in each array.
    fn start(&self) -> Start {
        let surfaces = &self.surfaces;
        Start {
            positions: surfaces.positions.len(),
            triangles: surfaces.triangles.len(),
            normals: surfaces.normals.len(),
            uvs: surfaces.uvs.len(),
            colors: surfaces.colors.len(),
        }
    }

    /// Makes a part of what the arrays hold from `start` on, still in the object's own space.
    fn place(&mut self, start: Start, transform: &DAffine3, material: u32, shading: Shading) -> Result<()> {
        let surfaces = &mut self.surfaces;
        let vertices = start.positions as u32;
        let start_of = |start: usize, end: usize| if start == end { NONE } else { start as u32 };
        self.triangle_parts.push(Part {
            first: start.triangles as u32,
            material,
            shading,
            vertices,
            normals: start_of(start.normals, surfaces.normals.len()),
            uvs: start_of(start.uvs, surfaces.uvs.len()),
            colors: start_of(start.colors, surfaces.colors.len()),
        });
        let positions = &mut surfaces.positions[start.positions..];
        if *transform != DAffine3::IDENTITY {
            for point in &mut *positions {
                *point = place(transform, *point);
            }
            let normal_transform = normal_transform(&transform.matrix3);
            for normal in &mut surfaces.normals[start.normals..] {
                let moved = normal_transform * DVec3::from(normal.map(f64::from));
                *normal = moved.normalize_or_zero().to_array().map(|c| c as f32);
            }
        }
        if let Some(bad) = positions.iter().find(|point| point.iter().any(|c| !c.is_finite())) {
            let what = format!("a vertex lies at {bad:?}, which f32 can't hold");
            return Err(self.error(what, "make the object's scale and translation smaller"));
        }
        let mirrored = transform.matrix3.determinant() < 0.0;
        for triangle in &mut surfaces.triangles[start.triangles..] {
            let [a, b, c] = *triangle;
            let [b, c] = if mirrored { [c, b] } else { [b, c] };
            *triangle = [a + vertices, b + vertices, c + vertices];
        }
        Ok(())
    }

    /// Places spheres under a transform that keeps them spheres.
    ///
    /// # Errors
    /// A transform that isn't a similarity, a centre or radius that isn't finite in f32, a radius that isn't positive, more than
    /// 2^31 primitives, or no space for them.
    pub fn spheres(
        &mut self,
        balls: impl IntoIterator<Item = impl Borrow<Ball>>,
        transform: &DAffine3,
        material: u32,
    ) -> Result<()> {
        /// Placed at once.
        const BATCH: usize = 4096;
        let mut balls = balls.into_iter().peekable();
        if balls.peek().is_none() {
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
        let mut batch = Vec::with_capacity(BATCH);
        while balls.peek().is_some() {
            batch.clear();
            for ball in balls.by_ref().take(BATCH) {
                let Ball { center, radius } = *ball.borrow();
                let center = transform.transform_point3(center).to_array().map(|c| c as f32);
                let radius = (radius * scale) as f32;
                if !(center.iter().all(|c| c.is_finite()) && radius.is_finite() && radius > 0.0) {
                    return Err(self.error(
                        format!("a sphere has centre {center:?} and radius {radius}"),
                        "give finite numbers and a radius above 0",
                    ));
                }
                batch.push(Sphere { center, radius });
            }
            let room = self.surfaces.spheres.grow(batch.len()).map_err(|source| kept(&self.file, source))?;
            room.copy_from_slice(&batch);
            self.check_size(MeshSize { vertices: 0, triangles: 0 })?;
        }
        Ok(())
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
        self.surfaces.objects = header.objects();
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
        Scene { surfaces: self.surfaces, textures: self.textures, header, ..Scene::default() }
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
        self.check_size(MeshSize { vertices, triangles: mesh.triangles.len() })
    }

    /// Whether so much more can be numbered.
    fn check_size(&self, added: MeshSize) -> Result<()> {
        let limit = i32::MAX as usize;
        if self.surfaces.positions.len() + added.vertices > limit
            || self.surfaces.len() + added.triangles > limit
        {
            return Err(self.error(
                "more than 2^31 primitives or vertices".into(),
                "use a coarser mesh or fewer levels",
            ));
        }
        Ok(())
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

/// Where a mesh begins in each array.
struct Start {
    positions: usize,
    triangles: usize,
    normals: usize,
    uvs: usize,
    colors: usize,
}

/// Room for a mesh with so many normals behind what is there.
fn grow(surfaces: &mut Surfaces, size: MeshSize, normals: usize) -> io::Result<MeshMut<'_>> {
    Ok(MeshMut {
        positions: surfaces.positions.grow(size.vertices)?,
        triangles: surfaces.triangles.grow(size.triangles)?,
        normals: surfaces.normals.grow(normals)?,
        uvs: surfaces.uvs.grow(size.vertices)?,
    })
}

/// That the surfaces of a scene have no space.
fn kept(file: &Path, source: io::Error) -> Error {
    Error::scene(
        file,
        None,
        format!("its surfaces can't be kept: {source}"),
        "use coarser meshes or fewer levels, or free memory or disk",
    )
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
    if let Some(lens) = &mut camera.lens {
        lens.radius *= frame.scale;
        lens.focus *= frame.scale;
    }
    if camera.projection == super::camera::Projection::Orthographic {
        camera.right *= frame.scale;
        camera.up *= frame.scale;
    }
}
