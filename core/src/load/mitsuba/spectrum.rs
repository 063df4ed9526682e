//! Spectra as linear sRGB, as Mitsuba's `*_rgb` variants turn them.

use super::cie::{FIRST_NM, LAST_NM, OBSERVER, STEP_NM};
use glam::{DMat3, DVec3};

/// CIE XYZ to linear sRGB (D65 white), ITU-R BT.709; written row by row.
const XYZ_TO_SRGB: DMat3 = DMat3::from_cols_array_2d(&[
    [3.240479, -0.969256, 0.055648],
    [-1.537150, 1.875991, -0.204043],
    [-0.498535, 0.041556, 1.057311],
]);
/// The integral of ȳ over the tabulated range.
const Y_INTEGRAL: f64 = 106.750_259_399_414_06;
/// The integral of D65 · ȳ over that of ȳ: with it, D65 has luminance 1.
const D65_LUMINANCE: f64 = 98.99741751876255;
/// Points at which a spectrum is evaluated.
const STEPS: u32 = 1000;

/// Luminance of a linear sRGB colour, with the weights Mitsuba uses.
pub(crate) fn luminance(rgb: DVec3) -> f64 {
    rgb.dot(DVec3::new(0.212671, 0.715160, 0.072169))
}

/// Linear sRGB of a light with the same power at every wavelength: illuminant E, which is reddish beside D65 white.
pub(crate) fn flat_emission(value: f64) -> DVec3 {
    XYZ_TO_SRGB * DVec3::splat(value)
}

/// Linear sRGB, not below 0, of a spectrum of light; `pairs` are wavelengths in nm, increasing, and values.
pub(crate) fn emission(pairs: &[(f64, f64)]) -> DVec3 {
    integrate(pairs, |_| 1.0).max(DVec3::ZERO)
}

/// Linear sRGB, not below 0, of what `pairs` make of daylight (D65).
pub(crate) fn under_daylight(pairs: &[(f64, f64)]) -> DVec3 {
    integrate(pairs, |d65| d65 / D65_LUMINANCE).max(DVec3::ZERO)
}

fn integrate(pairs: &[(f64, f64)], illuminant: impl Fn(f64) -> f64) -> DVec3 {
    let mut xyz = DVec3::ZERO;
    for i in 0..STEPS {
        let nm = FIRST_NM + f64::from(i) / f64::from(STEPS - 1) * (LAST_NM - FIRST_NM);
        let Some(value) = interpolate(pairs, nm) else { continue };
        let [x, y, z, d65] = observer(nm);
        xyz += DVec3::new(x, y, z) * (value * illuminant(d65));
    }
    XYZ_TO_SRGB * (xyz * ((LAST_NM - FIRST_NM) / f64::from(STEPS) / Y_INTEGRAL))
}

/// The value at a wavelength, linear between pairs; none beyond them.
fn interpolate(pairs: &[(f64, f64)], nm: f64) -> Option<f64> {
    let next = pairs.partition_point(|(wavelength, _)| *wavelength <= nm).min(pairs.len() - 1).max(1);
    let ((w0, v0), (w1, v1)) = (pairs[next - 1], pairs[next]);
    (w0..=w1).contains(&nm).then(|| v0 + (v1 - v0) * (nm - w0) / (w1 - w0))
}

/// x̄, ȳ, z̄ and D65 at a wavelength within the table.
fn observer(nm: f64) -> [f64; 4] {
    let t = (nm - FIRST_NM) / STEP_NM;
    let i = (t as usize).min(OBSERVER.len() - 2);
    let fraction = t - i as f64;
    std::array::from_fn(|k| (1.0 - fraction) * OBSERVER[i][k] + fraction * OBSERVER[i + 1][k])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn assert_near(rgb: DVec3, expected: [f64; 3]) {
        let error = ((rgb - DVec3::from(expected)) / DVec3::from(expected)).abs().max_element();
        assert!(error < 1e-5, "{rgb} is not {expected:?}");
    }

    /// All numbers from Mitsuba 3.9.1, `spectrum_list_to_srgb`.
    #[test]
    fn spectra_have_mitsubas_colours() {
        let luminaire = [(400.0, 0.0), (500.0, 8.0), (600.0, 15.6), (700.0, 18.4)];
        assert_near(emission(&luminaire), [20.710836, 10.854634, 2.771152]);
        let flat = [(400.0, 0.78), (500.0, 0.78), (600.0, 0.78), (700.0, 0.78)];
        assert_near(under_daylight(&flat), [0.776367, 0.779809, 0.776029]);
        assert_near(under_daylight(&[(300.0, 1.0), (900.0, 1.0)]), [0.9989853, 0.9988737, 0.9988016]);
        assert_near(emission(&[(300.0, 1.0), (900.0, 1.0)]), [1.2048837, 0.9482282, 0.9092668]);
        assert_near(under_daylight(&[(400.0, 0.5), (700.0, 0.6)]), [0.5780858, 0.5475237, 0.5110587]);
        assert_near(flat_emission(2.0), [2.4095879, 1.8965820, 1.8178321]);
        assert_eq!(emission(&[(850.0, 0.5), (900.0, 0.6)]), DVec3::ZERO);
    }
}
