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

/// The part that a conductor of index `eta` + i `k` reflects, in [0, 1], as met at an angle of `cosine` in [0, 1] from vacuum.
pub fn conductor(cosine: f64, eta: f64, k: f64) -> f64 {
    let cosine2 = cosine * cosine;
    let sine2 = 1.0 - cosine2;
    let (eta2, k2) = (eta * eta, k * k);
    let t0 = eta2 - k2 - sine2;
    let a2_plus_b2 = (t0 * t0 + 4.0 * eta2 * k2).sqrt();
    let t1 = a2_plus_b2 + cosine2;
    let t2 = 2.0 * cosine * (0.5 * (a2_plus_b2 + t0)).max(0.0).sqrt();
    let perpendicular = (t1 - t2) / (t1 + t2);
    let t3 = cosine2 * a2_plus_b2 + sine2 * sine2;
    let t4 = t2 * sine2;
    // Both are 0 where nothing at all is behind the surface.
    let parallel = if t3 + t4 > 0.0 { perpendicular * ((t3 - t4) / (t3 + t4)) } else { perpendicular };
    0.5 * (parallel + perpendicular)
}

/// The mean of [`conductor`] over the hemisphere, weighted by the cosine: Gauss-Jacobi with three nodes. Off by less than 0.002.
pub fn conductor_mean(eta: f64, k: f64) -> f64 {
    const NODES: [[f64; 2]; 3] = [
        [0.212_340_538_239_153, 0.139_653_959_802_908],
        [0.590_533_135_559_265, 0.458_482_212_719_172],
        [0.911_412_040_487_296, 0.401_863_827_477_918],
    ];
    NODES.iter().map(|&[cosine, weight]| weight * conductor(cosine, eta, k)).sum::<f64>().min(1.0)
}
