//! The light that a rough mirror scatters more than once, which a single-scattering lobe loses: Kulla and Conty, "Revisiting
//! Physically Based Shading at Imageworks", 2017. Reciprocal.
//!
//! The loss 1 - E(μ) of a lobe that reflects everything is kept in a table over √μ and the roughness, made once. Both are where it
//! is nearly linear: 33 cosines by 65 roughnesses, 34 kB, made in about 50 ms. The mean loss is that of the interpolated table exactly, so the
//! lobe and its compensation are off from 1 only by the table's error at μo: at most 0.005, below cosines of 0.02, and 0.00006 in the mean.

use std::f64::consts::TAU;
use std::sync::OnceLock;

use glam::DVec3;

use super::microfacet::Ggx;
use super::{diffuse, specular};

/// Steps over the square root of the cosine, and over the roughness.
const COSINES: usize = 32;
const ROUGHNESSES: usize = 64;
/// Quadrature over the visible microfacets: Gauss-Legendre would do no better on the kink at the horizon than midpoints.
const POLAR: usize = 48;
const AZIMUTHS: usize = 16;

struct Row {
    loss: [f64; COSINES + 1],
    /// ∫ loss 2μ dμ from 0 to each cosine, the last of which is the mean.
    sums: [f64; COSINES + 1],
}

/// The loss at one roughness.
#[derive(Clone, Copy, Debug)]
pub struct Loss {
    row: usize,
    /// Of the way to the next row.
    part: f64,
    /// Weighted by the cosine, in [0, 1).
    pub mean: f64,
}

impl Loss {
    pub fn new(roughness: f64) -> Self {
        let place = roughness.clamp(0.0, 1.0) * ROUGHNESSES as f64;
        let row = (place as usize).min(ROUGHNESSES - 1);
        let part = place - row as f64;
        let [low, high] = [&table()[row], &table()[row + 1]];
        let [low, high] = [low, high].map(|row| row.sums[COSINES]);
        Loss { row, part, mean: low + (high - low) * part }
    }

    /// Between what the two rows say.
    fn between(&self, of: impl Fn(&Row) -> f64) -> f64 {
        let [low, high] = [self.row, self.row + 1].map(|row| of(&table()[row]));
        low + (high - low) * self.part
    }

    /// At a cosine in [0, 1].
    pub fn at(&self, cosine: f64) -> f64 {
        let place = cosine.clamp(0.0, 1.0).sqrt() * COSINES as f64;
        let column = (place as usize).min(COSINES - 1);
        let across = place - column as f64;
        self.between(|row| row.loss[column] + (row.loss[column + 1] - row.loss[column]) * across)
    }

    /// Solid-angle density of [`sample`](Loss::sample).
    pub fn pdf(&self, cosine: f64) -> f64 {
        let column = ((cosine.clamp(0.0, 1.0).sqrt() * COSINES as f64) as usize).min(COSINES - 1);
        let share = self.between(|row| row.sums[column + 1] - row.sums[column]) / self.mean;
        share / (fourth_power(column + 1) - fourth_power(column)) * diffuse::pdf(cosine)
    }

    /// A direction of the lobe of multiple scattering, from two numbers in [0, 1): the cosine's step by its share of the loss, within
    /// it by the cosine. For a nearly smooth surface all of it is close to grazing.
    pub fn sample(&self, u: [f64; 2]) -> DVec3 {
        let wanted = u[0] * self.mean;
        let sum = |column: usize| self.between(|row| row.sums[column]);
        let (mut low, mut high) = (0, COSINES);
        while high - low > 1 {
            let middle = (low + high) / 2;
            if sum(middle) <= wanted { low = middle } else { high = middle }
        }
        let along = ((wanted - sum(low)) / (sum(high) - sum(low))).clamp(0.0, 1.0);
        // The square of a cosine that is sampled by its own value is uniform.
        let square = fourth_power(low) + (fourth_power(high) - fourth_power(low)) * along;
        let (sine, cosine) = libm::sincos(TAU * u[1]);
        let across = (1.0 - square).max(0.0).sqrt();
        DVec3::new(across * cosine, across * sine, square.sqrt())
    }
}

/// Of the root of a column's cosine.
fn fourth_power(column: usize) -> f64 {
    let root = column as f64 / COSINES as f64;
    root * root * (root * root)
}

fn table() -> &'static [Row] {
    static TABLE: OnceLock<Vec<Row>> = OnceLock::new();
    TABLE.get_or_init(|| (0..=ROUGHNESSES).map(|row| Row::new(row as f64 / ROUGHNESSES as f64)).collect())
}

impl Row {
    fn new(roughness: f64) -> Self {
        let root = |column: usize| column as f64 / COSINES as f64;
        let loss = std::array::from_fn(|column| match Ggx::new(roughness) {
            Some(ggx) => loss(ggx, root(column) * root(column), POLAR, AZIMUTHS),
            None => 0.0,
        });
        // ∫ loss 2μ dμ = ∫ loss 4t³ dt with μ = t², of each linear piece.
        let mut sums = [0.0; COSINES + 1];
        for column in 0..COSINES {
            let (a, b) = (root(column), root(column + 1));
            let third = fourth_power(column + 1) - fourth_power(column);
            let fourth = 0.8 * (b * fourth_power(column + 1) - a * fourth_power(column));
            let [left, right] = [loss[column], loss[column + 1]];
            let piece = (left * (b * third - fourth) + right * (fourth - a * third)) / (b - a);
            sums[column + 1] = sums[column] + piece;
        }
        Row { loss, sums }
    }
}

/// What the single-scattering lobe of a perfect mirror loses, seen from a direction with this cosine. The microfacets that lose
/// most are at the rim of what is visible, so the midpoints crowd there.
pub fn loss(ggx: Ggx, cosine: f64, polar: usize, azimuths: usize) -> f64 {
    let wo = DVec3::new((1.0 - cosine * cosine).sqrt(), 0.0, cosine);
    let (mut sum, mut weights) = (0.0, 0.0);
    for i in 0..polar {
        let v = (i as f64 + 0.5) / polar as f64;
        let weight = v * v;
        for j in 0..azimuths {
            // Half of all azimuths: the other half is its mirror image.
            let m = ggx.sample(wo, [1.0 - v * weight, (j as f64 + 0.5) / (2 * azimuths) as f64]);
            let wi = specular::mirrored_by(wo, m);
            sum += weight * if wi.z > 0.0 { 1.0 - ggx.passed(wo, wi) } else { 1.0 };
            weights += weight;
        }
    }
    sum / weights
}
