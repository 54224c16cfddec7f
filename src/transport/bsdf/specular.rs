//! The mirror and the refracted direction in the local frame, whose z is the normal on the viewer's side.

use glam::DVec3;

/// Where a mirror sends `wo`.
pub fn mirrored(wo: DVec3) -> DVec3 {
    DVec3::new(-wo.x, -wo.y, wo.z)
}

/// The direction behind the surface by Snell's law; `eta` is the index on this side over the one behind, `behind` the cosine
/// there.
pub fn refracted(wo: DVec3, eta: f64, behind: f64) -> DVec3 {
    DVec3::new(-eta * wo.x, -eta * wo.y, -behind).normalize()
}

/// Where a mirror with the unit normal `m` sends `wo`.
pub fn mirrored_by(wo: DVec3, m: DVec3) -> DVec3 {
    (m * (2.0 * wo.dot(m)) - wo).normalize()
}
