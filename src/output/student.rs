//! Student's distribution: how far a mean may be off in units of a standard error that is itself an estimate. Pure.

/// The chance that |t| of Student's distribution with so many degrees of freedom, above 0, is as large or larger: that of the normal distribution where they are infinite.
pub fn two_sided_p(t: f64, freedom: f64) -> f64 {
    // Beyond it the two are the same to more digits than the logarithms of gamma functions leave.
    if freedom > 1e7 {
        return libm::erfc(t.abs() * std::f64::consts::FRAC_1_SQRT_2);
    }
    let squared = t * t;
    // As a quotient that stays one where the square is infinite (DLMF 8.17, Abramowitz & Stegun 26.7.1).
    incomplete_beta(0.5 * freedom, 0.5, 1.0 / (1.0 + squared / freedom))
}

/// The degrees of freedom of a sum of estimated variances, each with its own: Welch 1947, "The generalization of 'Student's' problem when several different population variances
/// are involved". Infinite if all that aren't 0 are known exactly.
pub fn joint_freedom(variances: impl IntoIterator<Item = (f64, f64)>) -> f64 {
    let (mut sum, mut parts) = (0.0, 0.0);
    for (variance, freedom) in variances {
        if variance > 0.0 {
            sum += variance;
            parts += variance * (variance / freedom);
        }
    }
    sum * sum / parts
}

/// The regularised incomplete beta function by its continued fraction (DLMF 8.17.22, by Lentz's method).
fn incomplete_beta(a: f64, b: f64, x: f64) -> f64 {
    if x <= 0.0 || x >= 1.0 {
        return x.clamp(0.0, 1.0);
    }
    // On its own side of this the fraction converges fast.
    if x > (a + 1.0) / (a + b + 2.0) { 1.0 - fraction(b, a, 1.0 - x) } else { fraction(a, b, x) }
}

fn fraction(a: f64, b: f64, x: f64) -> f64 {
    let front = libm::exp(
        libm::lgamma(a + b) - libm::lgamma(a) - libm::lgamma(b) + a * libm::log(x) + b * libm::log1p(-x),
    ) / a;
    let (mut c, mut d) = (1.0, 1.0 / (1.0 - (a + b) * x / (a + 1.0)));
    let mut value = d;
    for m in 1..500 {
        let m = f64::from(m);
        let even = m * (b - m) * x / ((a + 2.0 * m - 1.0) * (a + 2.0 * m));
        let odd = -(a + m) * (a + b + m) * x / ((a + 2.0 * m) * (a + 2.0 * m + 1.0));
        let mut change = 1.0;
        for term in [even, odd] {
            d = 1.0 / (1.0 + term * d);
            c = 1.0 + term / c;
            change = c * d;
            value *= change;
        }
        if (change - 1.0).abs() < 1e-14 {
            break;
        }
    }
    front * value
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Freedom 1 and 2 have closed forms; the rest is what SciPy gives.
    #[test]
    fn tails_are_student_s() {
        for t in [1e-3_f64, 0.1, 1.0, 3.0, 50.0, 1e6] {
            let cauchy = std::f64::consts::FRAC_2_PI * libm::atan(1.0 / t);
            assert!((two_sided_p(t, 1.0) / cauchy - 1.0).abs() < 1e-12, "{t}");
            let root = (2.0 + t * t).sqrt();
            let of_two = 2.0 / (root * (root + t));
            assert!((two_sided_p(-t, 2.0) / of_two - 1.0).abs() < 1e-12, "{t}");
        }
        // Two-sided 5 % and 0.1 % points of the tables.
        for (freedom, t, p) in [
            (5.0, 2.570_582, 0.05),
            (30.0, 2.042_272, 0.05),
            (30.0, 3.645_959, 0.001),
            (3.0, 12.923_979, 0.001),
        ] {
            let found = two_sided_p(t, freedom);
            assert!((found / p - 1.0).abs() < 1e-5, "{freedom} {t}: {found}");
        }
        for freedom in [1.0, 2.5, 1e4, 1e9, f64::INFINITY] {
            assert_eq!((two_sided_p(0.0, freedom), two_sided_p(f64::INFINITY, freedom)), (1.0, 0.0));
        }
    }

    #[test]
    fn much_freedom_is_the_normal_distribution() {
        assert!((two_sided_p(1.959_963_984_540_054, f64::INFINITY) - 0.05).abs() < 1e-15);
        for (freedom, near) in [(1e5, 1e-5), (9.9e6, 1e-6), (1.1e7, 1e-12)] {
            let found = two_sided_p(-1.959_963_984_540_054, freedom);
            assert!((found - 0.05).abs() < near, "{freedom}: {found}");
        }
    }

    #[test]
    fn freedom_adds_for_equal_variances_and_is_the_least_where_one_rules() {
        assert!((joint_freedom([(0.25, 3.0), (0.25, 3.0)]) - 6.0).abs() < 1e-12);
        assert!((joint_freedom([(1.0, 3.0), (1e-9, 1.0)]) - 3.0).abs() < 1e-6);
        assert_eq!(joint_freedom([(0.5, 7.0), (0.0, 0.0)]), 7.0);
        assert_eq!(joint_freedom([(0.5, f64::INFINITY), (0.0, 3.0)]), f64::INFINITY);
        assert_eq!(joint_freedom([(0.5, f64::INFINITY), (0.5, 2.0)]), 8.0);
    }
}
