//! Scenes of a few surfaces, seen by one pixel, and the formulas of illumination written down once more.

use std::path::Path;

use glam::{DAffine3, DVec3};
use heliostat::image::Image;
use heliostat::scene::build::{Ball, SceneBuilder};
use heliostat::scene::light::LightShape;
use heliostat::scene::mesh::Mesh;
use heliostat::scene::{Camera, Color, Light, Material, SceneHeader, Shading, Texture};
use heliostat::settings::{Crop, ImageSettings, RunSettings};

pub const BLACK: Material = Material {
    ka: [0.0; 3],
    kd: [0.0; 3],
    ks: [0.0; 3],
    shininess: 32.0,
    kr: [0.0; 3],
    kt: [0.0; 3],
    ior: 1.5,
    reflectivity: 0.0,
    emission: [0.0; 3],
    one_sided: false,
    fresnel: false,
    texture: None,
    physical: None,
};

pub fn glowing(emission: Color) -> Material {
    Material { emission, ..BLACK }
}

pub fn v(x: f64, y: f64, z: f64) -> DVec3 {
    DVec3::new(x, y, z)
}

/// A scene in the making, with an image of one pixel unless the test wants another.
pub struct Tiny {
    pub builder: SceneBuilder,
    pub header: SceneHeader,
    pub image: ImageSettings,
}

impl Tiny {
    /// A camera at `eye` whose middle ray goes to `target`.
    pub fn new(eye: DVec3, target: DVec3) -> Self {
        let up = if (target - eye).cross(DVec3::Y).length() > 1e-6 { DVec3::Y } else { DVec3::NEG_Z };
        let camera = Camera::perspective(eye, target, up, 45.0).expect("a sound camera");
        let tiny = Tiny {
            builder: SceneBuilder::new(Path::new("tiny")),
            header: SceneHeader { camera, ..SceneHeader::default() },
            image: ImageSettings::default(),
        };
        tiny.sized(1, 1)
    }

    pub fn sized(mut self, width: u32, height: u32) -> Self {
        (self.image.width, self.image.height) = (width, height);
        self.image.crop = Crop { x0: 0, y0: 0, x1: width, y1: height };
        self
    }

    pub fn mesh(&mut self, mesh: Mesh, material: &Material, shading: Shading) {
        let material = self.builder.material(material.clone());
        self.builder.mesh(mesh, &DAffine3::IDENTITY, material, shading).expect("a sound mesh");
    }

    /// Two triangles; seen from where the corners go counter-clockwise is outside.
    pub fn quad(&mut self, corners: [DVec3; 4], material: &Material) {
        self.mesh(quad(corners), material, Shading::Flat);
    }

    /// A horizontal square at height `y`, facing up.
    pub fn level(&mut self, y: f64, material: &Material) {
        self.quad(square(y, 20.0), material);
    }

    /// A horizontal square at height `y` around (x, z), facing up, of half the side `half`.
    pub fn patch(&mut self, [x, y, z]: [f64; 3], half: f64, material: &Material) {
        self.quad(square(y, half).map(|corner| corner + v(x, 0.0, z)), material);
    }

    pub fn sphere(&mut self, center: DVec3, radius: f64, material: &Material) {
        let material = self.builder.material(material.clone());
        let ball = [Ball { center, radius }];
        self.builder.spheres(ball, &DAffine3::IDENTITY, material).expect("a sound sphere");
    }

    /// A horizontal square from -8 to 8 that shows where it is hit: its colour there is (x / 16 + 1/2, z / 16 + 1/2, 1).
    pub fn map(&mut self, y: f64) {
        let texels = vec![[0, 255, 255], [255, 255, 255], [0, 0, 255], [255, 0, 255]];
        let texture = self.builder.texture(Texture { width: 2, height: 2, texels: texels.into() });
        let mut mesh = quad(square(y, 8.0));
        // Between the centres of the texels, where bilinear interpolation is linear in (u, v).
        let axis = |c: f32| c / 32.0 + 0.5;
        mesh.uvs = mesh.positions.iter().map(|p| [axis(p[0]), axis(p[2])]).collect();
        let material = Material { ka: [1.0; 3], texture: Some(texture), ..BLACK };
        self.mesh(mesh, &material, Shading::Flat);
        self.header.ambient = [1.0; 3];
    }

    pub fn light(&mut self, light: &Light) {
        self.header.lights.push(light.clone());
    }

    pub fn render(self) -> Image {
        let scene = self.builder.finish(self.header);
        heliostat::render_alone(scene, self.image, RunSettings::default()).expect("an image")
    }

    /// The colour of the only pixel.
    pub fn color(self) -> Color {
        self.render().pixels[0].map(f64::from)
    }
}

pub fn quad(corners: [DVec3; 4]) -> Mesh {
    Mesh {
        positions: corners.map(|c| c.to_array().map(|c| c as f32)).to_vec(),
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        ..Mesh::default()
    }
}

pub fn square(y: f64, half: f64) -> [DVec3; 4] {
    [v(-half, y, half), v(half, y, half), v(half, y, -half), v(-half, y, -half)]
}

/// Where a map was hit, as (x, z).
pub fn mapped(color: Color) -> [f64; 2] {
    assert_eq!(color[2], 1.0, "the map isn't what was seen: {color:?}");
    [(color[0] - 0.5) * 16.0, (color[1] - 0.5) * 16.0]
}

pub fn shining(shape: LightShape) -> Light {
    Light { shape, diffuse: [1.0; 3], specular: [1.0; 3], ambient: [0.0; 3], falloff: None }
}

pub fn point_light(position: DVec3) -> Light {
    shining(LightShape::Point { position })
}

/// Directions at a point that is lit: all of unit length.
pub struct Around {
    pub normal: DVec3,
    pub to_light: DVec3,
    pub to_viewer: DVec3,
}

impl Around {
    pub fn new(at: DVec3, normal: DVec3, light: DVec3, eye: DVec3) -> Self {
        Around {
            normal: normal.normalize(),
            to_light: (light - at).normalize(),
            to_viewer: (eye - at).normalize(),
        }
    }

    pub fn cosine(&self) -> f64 {
        self.normal.dot(self.to_light)
    }

    /// kd (L·N) Id + ks (R·V)^α Is.
    pub fn phong(&self, material: &Material, light: &Light) -> Color {
        let reflected = 2.0 * self.cosine() * self.normal - self.to_light;
        let highlight = libm::pow(reflected.dot(self.to_viewer).max(0.0), material.shininess);
        [0, 1, 2].map(|k| {
            material.kd[k] * self.cosine() * light.diffuse[k] + material.ks[k] * highlight * light.specular[k]
        })
    }
}

pub fn sum(a: Color, b: Color) -> Color {
    [0, 1, 2].map(|k| a[k] + b[k])
}

pub fn product(a: Color, b: Color) -> Color {
    [0, 1, 2].map(|k| a[k] * b[k])
}

pub fn scaled(a: Color, factor: f64) -> Color {
    a.map(|c| c * factor)
}

/// Equal within one part in a million, and what the film's units and f32 lose.
#[track_caller]
pub fn assert_color(found: Color, expected: Color) {
    for k in 0..3 {
        let tolerance = 1e-6 * expected[k].abs() + 2e-9;
        assert!((found[k] - expected[k]).abs() <= tolerance, "found {found:?}, expected {expected:?}");
    }
}

/// Equal within what a map resolves: f32 colours and texture coordinates over 16 units.
#[track_caller]
pub fn assert_place(found: [f64; 2], expected: [f64; 2]) {
    for k in 0..2 {
        assert!((found[k] - expected[k]).abs() <= 4e-6, "found {found:?}, expected {expected:?}");
    }
}
