//! Distributions, as far as error bars need them.

/// P(Z ≤ z) of the normal distribution.
pub fn normal_cdf(z: f64) -> f64 {
    0.5 * libm::erfc(-z / std::f64::consts::SQRT_2)
}

/// P(|T| ≥ |t|) of Student's distribution with `freedom` degrees of freedom; infinitely many make it the normal one.
pub fn two_sided_p(t: f64, freedom: f64) -> f64 {
    if t.is_infinite() {
        return 0.0;
    }
    if freedom > 1e7 {
        return libm::erfc(t.abs() / std::f64::consts::SQRT_2);
    }
    // Abramowitz & Stegun 26.7.1: 1 − A(t|ν) is an incomplete beta function.
    incomplete_beta(0.5 * freedom, 0.5, freedom / (freedom + t * t))
}

/// The t > 0 with P(|T| ≥ t) = `p`.
pub fn two_sided_quantile(p: f64, freedom: f64) -> f64 {
    let (mut low, mut high) = (0.0, 1.0);
    while two_sided_p(high, freedom) > p && high < 1e12 {
        high *= 2.0;
    }
    for _ in 0..100 {
        let middle = 0.5 * (low + high);
        if two_sided_p(middle, freedom) > p {
            low = middle;
        } else {
            high = middle;
        }
    }
    0.5 * (low + high)
}

/// The level for one of `count` independent tests that together keep the level `alpha` (Šidák 1967).
pub fn sidak(alpha: f64, count: f64) -> f64 {
    -libm::expm1(libm::log1p(-alpha) / count)
}

/// Regularised incomplete beta function by its continued fraction (Lentz's method; DLMF 8.17.22).
fn incomplete_beta(a: f64, b: f64, x: f64) -> f64 {
    if x <= 0.0 || x >= 1.0 {
        return x.clamp(0.0, 1.0);
    }
    if x > (a + 1.0) / (a + b + 2.0) {
        return 1.0 - incomplete_beta(b, a, 1.0 - x);
    }
    let ln_beta = libm::lgamma(a) + libm::lgamma(b) - libm::lgamma(a + b);
    let front = libm::exp(a * x.ln() + b * libm::log1p(-x) - ln_beta) / a;
    const TINY: f64 = 1e-300;
    let away = |v: f64| if v.abs() < TINY { TINY } else { v };
    let (mut f, mut c, mut d) = (1.0, 1.0, 0.0);
    for i in 0..500 {
        let m = f64::from(i / 2);
        let numerator = match i {
            0 => 1.0,
            i if i % 2 == 0 => m * (b - m) * x / ((a + 2.0 * m - 1.0) * (a + 2.0 * m)),
            _ => -(a + m) * (a + b + m) * x / ((a + 2.0 * m) * (a + 2.0 * m + 1.0)),
        };
        d = 1.0 / away(1.0 + numerator * d);
        c = away(1.0 + numerator / c);
        f *= c * d;
        if (1.0 - c * d).abs() < 1e-15 {
            break;
        }
    }
    front * (f - 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Tables of Student's t: Abramowitz & Stegun 26.10.
    #[test]
    fn quantiles_are_those_of_the_tables() {
        for (freedom, p, t) in
            [(1.0, 0.05, 12.706), (3.0, 0.05, 3.182), (3.0, 0.01, 5.841), (10.0, 0.05, 2.228), (120.0, 0.01, 2.617)]
        {
            assert!((two_sided_quantile(p, freedom) - t).abs() < 6e-4, "{freedom} {p}");
        }
        assert!((two_sided_quantile(0.05, f64::INFINITY) - 1.959_964).abs() < 1e-6);
        assert!((normal_cdf(1.0) - 0.841_344_746).abs() < 1e-9);
        assert!((two_sided_p(0.0, 3.0) - 1.0).abs() < 1e-12);
    }
}
