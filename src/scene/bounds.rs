//! The scene of its objects' bounding spheres: to look at what a structure of such spheres sees.

use glam::DVec3;

use super::mesh::{NONE, Part, Shading, Sphere};
use super::{Material, Scene, SceneHeader, Surfaces};
use crate::geometry::{bounding, round_up};

impl Scene {
    /// A sphere around each object, matt in the diffuse colour of its material, in the same frame and under the same lights and camera; and how many were left out
    /// because the camera is inside, where they would hide all others.
    pub fn bounding_spheres(&self) -> (Scene, usize) {
        let header = &self.header;
        let mut surfaces = Surfaces::default();
        let (mut parts, mut spheres) = (Vec::new(), Vec::new());
        let ends = header.parts.iter().skip(1).map(|part| part.first).chain([self.surfaces.len() as u32]);
        for (part, end) in header.parts.iter().zip(ends) {
            let sphere = around(&self.surfaces, part.first..end);
            let center = DVec3::from(sphere.center.map(f64::from));
            if header.camera.position.distance(center) <= f64::from(sphere.radius) {
                continue;
            }
            let first = spheres.len() as u32;
            let shading = Shading::Phong;
            let material = part.material;
            parts.push(Part {
                first,
                material,
                shading,
                vertices: NONE,
                normals: NONE,
                uvs: NONE,
                colors: NONE,
            });
            spheres.push(sphere);
            surfaces.objects.push(first);
        }
        surfaces.spheres = spheres.into();
        let left_out = header.parts.len() - parts.len();
        let matt = |material: &Material| Material { ka: material.kd, kd: material.kd, ..Material::default() };
        let materials = header.materials.iter().map(matt).collect();
        let header = SceneHeader { parts, materials, ..header.clone() };
        (Scene { surfaces, header, ..Scene::default() }, left_out)
    }
}

/// A sphere that holds these primitives, though its numbers are f32.
fn around(surfaces: &Surfaces, ids: std::ops::Range<u32>) -> Sphere {
    let balls = ids.flat_map(|id| surfaces.balls(id));
    let center = bounding::center(balls.clone()).map(|c| c as f32);
    let radius = bounding::radius(center.map(f64::from), balls) * (1.0 + 8.0 * f64::EPSILON);
    // Of a single point something must be left to see.
    Sphere { center, radius: round_up(radius).max(f32::MIN_POSITIVE) }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use crate::scene::load::{Budget, toml};

    #[test]
    fn each_object_becomes_its_sphere() {
        let text = br#"
            [camera]
            position = [0, 0, 8]
            look_at = [0, 0, 0]
            [[material]]
            name = "mirror"
            kd = [0.1, 0.2, 0.3]
            kr = 0.9
            [[light]]
            type = "point"
            position = [0, 8, 8]
            [[object]]
            type = "box"
            size = [1, 2, 2]
            material = "mirror"
            [[object]]
            type = "plane"
            size = 40
            material = "mirror"
            [[object]]
            type = "sphere"
            center = [3, 0, 0]
            radius = 0.5
            material = "mirror"
        "#;
        let scene = toml::parse(text, Path::new("a.toml"), Budget::of_bytes(1 << 20)).unwrap().scene;
        let (spheres, left_out) = scene.bounding_spheres();
        assert_eq!((left_out, spheres.header.parts.len()), (1, 2));
        let scale = scene.header.frame.scale as f32;
        let [around, ball] = spheres.surfaces.spheres[..] else { panic!("not two spheres") };
        assert_eq!(around.center, [0.0; 3]);
        assert!(around.radius >= 1.5 * scale && around.radius < 1.500_001 * scale, "{}", around.radius);
        assert_eq!(ball.center, [3.0 * scale, 0.0, 0.0]);
        assert!(ball.radius >= 0.5 * scale && ball.radius < 0.500_001 * scale, "{}", ball.radius);
        let material = &spheres.header.materials[spheres.header.parts[1].material as usize];
        assert_eq!((material.kd, material.kr), ([0.1, 0.2, 0.3], [0.0; 3]));
        assert_eq!(spheres.header.lights, scene.header.lights);
    }
}
