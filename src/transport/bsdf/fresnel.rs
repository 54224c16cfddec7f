//! Snell's law and Fresnel's equations for unpolarised light. Pure numbers; knows no material.

/// What becomes of light that meets a smooth boundary between two dielectrics.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Boundary {
    /// The part that is reflected, in [0, 1].
    pub reflectance: f64,
    /// Cosine of the refracted direction with the normal behind the surface, in [0, 1].
    pub behind: f64,
}

/// The boundary as met at an angle of `cosine` in [0, 1]; `eta` is the index on this side over the one behind.
/// `None` where all is reflected.
pub fn dielectric(cosine: f64, eta: f64) -> Option<Boundary> {
    let sine2 = eta * eta * (1.0 - cosine * cosine);
    // Not a number where the index is beyond computing.
    if sine2 >= 1.0 || sine2.is_nan() {
        return None;
    }
    let behind = (1.0 - sine2).sqrt();
    let parallel = (eta * behind - cosine) / (eta * behind + cosine);
    let perpendicular = (eta * cosine - behind) / (eta * cosine + behind);
    Some(Boundary { reflectance: 0.5 * (parallel * parallel + perpendicular * perpendicular), behind })
}
