//! How errors are measured and told.

use serde::Serialize;

use crate::settings::ErrorMetric;

/// The quantile of 95 % of a normal distribution.
pub const QUANTILE: f64 = 1.645;
/// Keeps relMSE finite in black pixels.
pub const RELATIVE_EPSILON: f64 = 1e-2;

/// How far an image is from what it would be with infinitely many samples, as its own samples tell.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ErrorReached {
    /// √ mean (t − r)² over pixels and channels, as `compare` says it.
    pub rmse: f64,
    /// What the RMSE is below of with 95 % confidence.
    pub rmse_at_most: f64,
    /// mean (t − r)² / (r² + ε), as `compare` says it.
    pub rel_mse: f64,
    pub rel_mse_at_most: f64,
    /// Mean number of samples of a pixel.
    pub spp: f64,
}

/// By what a variance at a mean counts.
pub fn weight(metric: ErrorMetric, mean: f64) -> f64 {
    match metric {
        ErrorMetric::Rmse => 1.0,
        ErrorMetric::Relmse => 1.0 / (mean * mean + RELATIVE_EPSILON),
        ErrorMetric::Display => {
            let slope = encoding_slope(mean);
            slope * slope
        }
    }
}

/// How steep the sRGB curve (IEC 61966-2-1) is; what is brighter than white is white.
fn encoding_slope(linear: f64) -> f64 {
    if linear <= 0.003_130_8 { 12.92 } else { 1.055 / 2.4 * libm::pow(linear.min(1.0), 1.0 / 2.4 - 1.0) }
}

/// Sums of squared errors that are expected of pixels.
#[derive(Clone, Copy, Debug, Default)]
pub struct Moments {
    count: f64,
    sum: f64,
    squares: f64,
}

impl Moments {
    pub fn add(&mut self, value: f64) {
        self.count += 1.0;
        self.sum += value;
        self.squares += value * value;
    }

    /// The mean, and what the mean of the errors themselves is below of with 95 % confidence. A pixel's variance is known from a few batches only, and its error is
    /// one draw: both scatter by about as much as they are large (twice their squares for normal errors).
    pub fn estimate(&self) -> (f64, f64) {
        let mean = self.sum / self.count;
        let scatter = 3.0 * self.squares / (self.count * self.count);
        (mean, mean + QUANTILE * scatter.sqrt())
    }
}
