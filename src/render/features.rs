//! What the first surface behind each pixel is, beside its light: for denoisers and compositing. Found on the way, without more rays.
//!
//! Sums live in planes of the film like light: what may be negative is shifted to where it isn't.

use glam::DVec3;

use super::film::Cell;
use crate::geometry::record::{Answer, Origin, RayRecord};
use crate::scene::{Color, Frame, Scene};
use crate::transport::surface::Interaction;

/// Planes of a film's pixel that hold features: albedo; normal; position; depth, number of the primitive, nothing.
pub const PLANES: usize = 4;

/// The features of pixels, row by row.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Features {
    /// Mean over all samples of what the first surface reflects and lets through; 0 of the background.
    pub albedo: Vec<[f32; 3]>,
    /// Mean over all samples of the shading normal on the viewer's side; 0 of the background.
    pub normal: Vec<[f32; 3]>,
    /// In world space, mean over the samples that hit something; 0 where none did.
    pub position: Vec<[f32; 3]>,
    /// Distance from where camera rays start in world units, mean over the samples that hit something; infinite where none did.
    pub depth: Vec<f32>,
    /// 1 + the number of the primitive that the first sample hit; 0 where it hit nothing.
    pub id: Vec<u32>,
}

/// What a camera ray's hit adds to the planes; `id` is the primitive's number in the whole scene.
pub fn of_hit(scene: &Scene, record: &RayRecord, answer: &Answer, id: u32) -> Option<[Color; PLANES]> {
    if record.bounce != 0 || record.made_by() != Origin::Camera || !answer.is_hit() {
        return None;
    }
    let hit = Interaction::new(scene, record, answer);
    let material = hit.material;
    let albedo = std::array::from_fn(|k| {
        let all = material.kd[k] * hit.diffuse_tint[k] + material.ks[k] + material.kr[k] + material.kt[k];
        (all + material.reflectivity).min(1.0)
    });
    let shifted = |v: DVec3| (v + DVec3::ONE).to_array();
    let number = if record.sample == 0 { f64::from(id) + 1.0 } else { 0.0 };
    Some([albedo, shifted(hit.normal), shifted(hit.position), [answer.t, number, 0.0]])
}

impl Features {
    /// Adds a pixel by its planes, of which `samples` were taken in all.
    pub fn push(&mut self, planes: &[Cell; PLANES], samples: u64, frame: &Frame) {
        let [albedo, normal, position, other] = planes;
        let share = if samples > 0 { albedo.count as f64 / samples as f64 } else { 0.0 };
        let of_all = |mean: Color, shift: f64| mean.map(|c| ((c - shift) * share) as f32);
        self.albedo.push(albedo.mean().map_or([0.0; 3], |mean| of_all(mean, 0.0)));
        self.normal.push(normal.mean().map_or([0.0; 3], |mean| of_all(mean, 1.0)));
        self.position.push(position.mean().map_or([0.0; 3], |mean| {
            frame.to_world(DVec3::from(mean) - DVec3::ONE).to_array().map(|c| c as f32)
        }));
        self.depth.push(other.mean().map_or(f32::INFINITY, |[t, ..]| (t / frame.scale) as f32));
        self.id.push((other.sum[1] >> 32) as u32);
    }
}
