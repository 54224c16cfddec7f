//! Pixel filters by importance sampling: samples are distributed as the filter's magnitude (Ernst, Stamminger and Greiner 2006), so
//! that a sample belongs to one pixel only and tiles stay independent.

use std::sync::Arc;

use crate::settings::Filter;

/// Intervals of the tabulated distribution over the filter's half width.
const STEPS: usize = 512;

/// A separable filter f(x) f(y), ready to be sampled.
#[derive(Clone, Debug)]
pub struct FilterTable {
    filter: Filter,
    radius: f64,
    /// `distribution[i]`: the share of ∫|f| that lies below i / STEPS of the radius, over x >= 0.
    distribution: Arc<[f64]>,
    /// ∫|f| over x >= 0 and its negative lobes, for a filter normalised to 1/2 there.
    negative: f64,
}

impl FilterTable {
    pub fn new(filter: Filter) -> Self {
        let radius = match filter {
            Filter::Box => 0.5,
            Filter::Tent => 1.0,
            Filter::Gaussian => 1.5,
            Filter::Mitchell => 2.0,
        };
        let (mut magnitude, mut signed) = (0.0, 0.0);
        let mut distribution = vec![0.0];
        for step in 0..STEPS {
            let value = evaluate(filter, (step as f64 + 0.5) / STEPS as f64 * radius);
            magnitude += value.abs();
            signed += value;
            distribution.push(magnitude);
        }
        distribution.iter_mut().for_each(|value| *value /= magnitude);
        let negative = (magnitude - signed) / (2.0 * signed);
        FilterTable { filter, radius, distribution: distribution.into(), negative }
    }

    /// 1, or 2 where the filter has negative lobes.
    pub fn planes(&self) -> usize {
        if self.filter == Filter::Mitchell { 2 } else { 1 }
    }

    /// ∫ of the negative part of f(x) f(y), for f normalised to ∫∫ = 1.
    pub fn negative_mass(&self) -> f64 {
        // In one dimension the parts are 1 + n and -n; in two the mixed products are negative.
        2.0 * self.negative * (1.0 + self.negative)
    }

    /// Offset from the pixel's centre, in pixels, and the film plane: 1 where the filter is negative.
    pub fn sample(&self, u: [f64; 2]) -> ([f64; 2], u8) {
        let ((x, negative_x), (y, negative_y)) = (self.sample_axis(u[0]), self.sample_axis(u[1]));
        ([x, y], u8::from(negative_x != negative_y))
    }

    fn sample_axis(&self, u: f64) -> (f64, bool) {
        let side = 2.0 * u - 1.0;
        let magnitude = match self.filter {
            Filter::Box => 0.5 * side.abs(),
            Filter::Tent => 1.0 - (1.0 - side.abs()).sqrt(),
            Filter::Gaussian | Filter::Mitchell => self.invert(side.abs()),
        };
        let negative = self.planes() == 2 && evaluate(self.filter, magnitude) < 0.0;
        (if side < 0.0 { -magnitude } else { magnitude }, negative)
    }

    /// The distance below which the share `u` of the filter's magnitude lies.
    fn invert(&self, u: f64) -> f64 {
        let step = self.distribution.partition_point(|&share| share <= u).clamp(1, STEPS);
        let (low, high) = (self.distribution[step - 1], self.distribution[step]);
        let within = if high > low { (u - low) / (high - low) } else { 0.0 };
        ((step - 1) as f64 + within) / STEPS as f64 * self.radius
    }
}

/// f(x) for x >= 0, up to a factor.
fn evaluate(filter: Filter, x: f64) -> f64 {
    match filter {
        Filter::Box => 1.0,
        Filter::Tent => 1.0 - x,
        Filter::Gaussian => libm::exp(-2.0 * x * x) - libm::exp(-2.0 * 1.5 * 1.5),
        // Mitchell and Netravali 1988, "Reconstruction Filters in Computer Graphics", equation 8 with B = C = 1/3.
        Filter::Mitchell if x < 1.0 => (7.0 * x * x * x - 12.0 * x * x) / 6.0 + 16.0 / 18.0,
        Filter::Mitchell => (-7.0 / 3.0 * x * x * x + 12.0 * x * x - 20.0 * x) / 6.0 + 32.0 / 18.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALL: [Filter; 4] = [Filter::Box, Filter::Tent, Filter::Gaussian, Filter::Mitchell];

    /// Mean and variance over one axis of samples weighted by sign, against quadrature of the filter.
    #[test]
    fn samples_have_the_filters_moments() {
        for filter in ALL {
            let table = FilterTable::new(filter);
            let (mut zeroth, mut first, mut second) = (0.0, 0.0, 0.0);
            let n = 100_000;
            for i in 0..n {
                let (x, negative) = table.sample_axis((f64::from(i) + 0.5) / f64::from(n));
                assert!(x.abs() <= table.radius);
                let weight = if negative { -1.0 } else { 1.0 };
                zeroth += weight;
                first += weight * x;
                second += weight * x * x;
            }
            let (mut mass, mut spread) = (0.0, 0.0);
            for i in 0..n {
                let x = (f64::from(i) + 0.5) / f64::from(n) * table.radius;
                mass += evaluate(filter, x);
                spread += evaluate(filter, x) * x * x;
            }
            assert!((first / zeroth).abs() < 1e-9, "{filter:?}");
            assert!(
                (second / zeroth - spread / mass).abs() < 1e-3,
                "{filter:?} {second} {zeroth} {spread} {mass}"
            );
        }
    }

    #[test]
    fn only_mitchell_has_a_negative_plane_and_its_mass_is_what_is_sampled() {
        for filter in ALL {
            let table = FilterTable::new(filter);
            let n = 1500;
            let negatives = (0..n * n)
                .filter(|i| {
                    let u = [i % n, i / n].map(|k| (f64::from(k) + 0.5) / f64::from(n));
                    table.sample(u).1 == 1
                })
                .count();
            let mass = table.negative_mass();
            let share = mass / (1.0 + 2.0 * mass);
            assert!((negatives as f64 / f64::from(n * n) - share).abs() < 2e-3, "{filter:?}");
            assert_eq!(mass > 0.0, filter == Filter::Mitchell);
        }
    }
}
