//! Whether what a sampler draws follows the density it claims: Pearson's chi-square over cells, for tests.

/// Draws a case.
pub const DRAWS: u64 = 1_000_000;

/// The chance that any of a family's cases fails although all are right.
const LEVEL_OF_FAMILY: f64 = 1e-4;

/// Cells that expect fewer draws are counted together: chi-square takes counts for Gaussian.
const EXPECTED_LEAST: f64 = 5.0;

/// Draws and what is expected of them, cell by cell, for one of `cases`.
///
/// # Errors
/// What is told where they differ by more than chance allows.
pub fn compare(counts: &[f64], expected: &[f64], cases: usize) -> Result<(), String> {
    let (mut chi2, mut cells) = (0.0, 0.0);
    let mut rest = (0.0, 0.0);
    for (&count, &expected) in counts.iter().zip(expected) {
        if expected < EXPECTED_LEAST {
            rest = (rest.0 + count, rest.1 + expected);
        } else {
            chi2 += (count - expected) * (count - expected) / expected;
            cells += 1.0;
        }
    }
    if rest.1 >= EXPECTED_LEAST {
        chi2 += (rest.0 - rest.1) * (rest.0 - rest.1) / rest.1;
        cells += 1.0;
    } else if rest.0 > rest.1 + 30.0 {
        return Err(format!("{} draws where {} are expected", rest.0, rest.1));
    }
    let bound = quantile(cells, cases);
    if chi2 < bound { Ok(()) } else { Err(format!("χ² = {chi2} in {cells} cells, above {bound}")) }
}

/// What χ² with so many degrees of freedom exceeds with the chance that Šidák leaves each of `cases`, after Wilson & Hilferty
/// 1931.
pub fn quantile(freedom: f64, cases: usize) -> f64 {
    let level = -libm::expm1(libm::log1p(-LEVEL_OF_FAMILY) / cases as f64);
    let tail = |z: f64| 0.5 * libm::erfc(z * std::f64::consts::FRAC_1_SQRT_2);
    let (mut low, mut high) = (0.0, 20.0);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if tail(middle) > level { low = middle } else { high = middle }
    }
    let spread = 2.0 / (9.0 * freedom);
    freedom * (1.0 - spread + low * spread.sqrt()).powi(3)
}

/// Numbers in [0, 1): the `k`-th of draw `i`.
pub fn number(i: u64, k: u64) -> f32 {
    (crate::sampler::mix64(i * 8 + k) >> 40) as f32 / 16_777_216.0
}

/// χ² with 10 degrees of freedom exceeds 35.56 once in 10,000 times; with 100 it exceeds 161.3. (The approximation is weakest at few
/// cells.) Twice the density where half is due does not pass.
#[test]
fn quantiles_are_the_tables() {
    assert!((quantile(10.0, 1) - 35.56).abs() < 0.6, "{}", quantile(10.0, 1));
    assert!((quantile(100.0, 1) - 161.3).abs() < 0.3, "{}", quantile(100.0, 1));
    assert!(quantile(100.0, 1000) > quantile(100.0, 1));
    assert!(compare(&[500.0, 500.0], &[510.0, 490.0], 10).is_ok());
    assert!(compare(&[500.0, 500.0], &[667.0, 333.0], 10).is_err());
    assert!(compare(&[1000.0, 40.0], &[1000.0, 0.0], 10).is_err());
}
