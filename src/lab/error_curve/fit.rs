//! A curve's slope and a rung's median. Pure numbers.

/// The slope of the line through the logarithms of (x, y), by least squares; `None` unless two x differ. What has no logarithm is left out.
pub(super) fn log_slope(points: &[(f64, f64)]) -> Option<f64> {
    let logs: Vec<(f64, f64)> = points
        .iter()
        .filter(|(x, y)| *x > 0.0 && *y > 0.0 && y.is_finite())
        .map(|&(x, y)| (libm::log(x), libm::log(y)))
        .collect();
    let n = logs.len() as f64;
    let (sum_x, sum_y) = logs.iter().fold((0.0, 0.0), |(a, b), (x, y)| (a + x, b + y));
    let (mean_x, mean_y) = (sum_x / n, sum_y / n);
    let (mut xx, mut xy) = (0.0, 0.0);
    for (x, y) in logs {
        xx += (x - mean_x) * (x - mean_x);
        xy += (x - mean_x) * (y - mean_y);
    }
    (xx > 0.0).then(|| xy / xx)
}

/// The middle one, of an even number the later of the two; NaN of none.
pub(super) fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slopes_are_those_of_powers() {
        let of = |power: f64| [2.0, 8.0, 32.0, 500.0].map(|x| (x, 0.3 * libm::pow(x, power)));
        for power in [-0.5, -0.72, 1.0] {
            assert!((log_slope(&of(power)).unwrap() - power).abs() < 1e-12);
        }
        // By hand: through (0, 0), (1, 1), (2, 0) the flat line is nearest.
        let e = std::f64::consts::E;
        assert!(log_slope(&[(1.0, 1.0), (e, e), (e * e, 1.0)]).unwrap().abs() < 1e-12);
        assert_eq!(log_slope(&[(4.0, 0.1), (4.0, 0.2)]), None);
        assert_eq!(log_slope(&[(4.0, 0.1), (8.0, 0.0), (9.0, f64::INFINITY)]), None);
        assert_eq!(log_slope(&[]), None);
    }

    #[test]
    fn medians_are_in_the_middle() {
        assert_eq!(median(vec![3.0, 1.0, 2.0]), 2.0);
        assert_eq!(median(vec![3.0, 1.0]), 3.0);
        assert!(median(Vec::new()).is_nan());
    }
}
