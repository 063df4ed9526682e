//! Choosing among the visible normals of a Beckmann surface: the one distribution whose sampling needs a root finder.

use glam::{Vec2, Vec3};
use std::f32::consts::FRAC_2_SQRT_PI;

/// 1/√π.
const FRAC_1_SQRT_PI: f32 = 0.5 * FRAC_2_SQRT_PI;
/// Relative error of the random number that a root may answer for; f32 cannot do much better.
const TOLERANCE: f32 = 1e-5;
/// Newton's steps at most; two or three do.
const STEPS: usize = 10;

/// A facet normal (not of unit length) of the surface with roughness 1 as seen from `w` (w.z ≥ 0), by projected area.
///
/// Slopes are a Gaussian; those along `w` are seen in proportion to 1 − x tan θ, up to x = cot θ (Jakob 2014, "An Improved
/// Visible Normal Sampling Routine for the Beckmann Distribution"). The equation for x is solved in y = erfc(−x), where
/// it is concave: from the left of the root Newton's steps approach it from the left and cannot jump.
#[inline]
pub fn visible_normal(w: Vec3, u: Vec2) -> Vec3 {
    let u = u.clamp(Vec2::splat(3e-8), Vec2::splat(1.0 - 6e-8));
    let sin = Vec2::new(w.x, w.y).length();
    // The axis along w, from which x is measured; any will do for a view from straight above.
    let along = if sin > 0.0 { Vec2::new(w.x, w.y) / sin } else { Vec2::X };
    let slope = Vec2::new(slope_along(sin, w.z.max(0.0), u.x), gaussian(2.0 * u.y));
    let turned = along * slope.x + Vec2::new(-along.y, along.x) * slope.y;
    Vec3::new(-turned.x, -turned.y, 1.0)
}

/// The slope x along the view with ∫ up to x of (cos θ − t sin θ) exp(−t²)/√π dt = u · (the same up to cot θ).
#[inline]
fn slope_along(sin: f32, cos: f32, u: f32) -> f32 {
    if sin == 0.0 {
        return gaussian(2.0 * u);
    }
    let cot = cos / sin;
    // Twice the integral as a function of y, over cos θ + sin θ so that neither end is large.
    let measure = |y: f32, x: f32| cos * y + sin * FRAC_1_SQRT_PI * libm::expf(-x * x);
    let y_max = libm::erfcf(-cot);
    let target = u * measure(y_max, cot);
    // Exact for a view from the side.
    let mut y = y_max * libm::erfcf((-libm::logf(u)).sqrt());
    let mut x = gaussian(y);
    for _ in 0..STEPS {
        let excess = measure(y, x) - target;
        let slope = cos - x * sin;
        if excess.abs() <= TOLERANCE * target || slope <= 0.0 {
            break;
        }
        let next = (y - excess / slope).min(y_max);
        // A step from the right may leave the range; half way to the end is still left of where it came from.
        y = if next > 0.0 { next } else { 0.5 * y };
        x = gaussian(y);
    }
    x.min(cot)
}

/// The x with erfc(−x) = y, for 0 < y < 2: a fit by Giles 2010, "Approximating the erfinv function", whose
/// variable −ln(1 − (y−1)²) keeps the digits of a small y.
#[inline]
fn gaussian(y: f32) -> f32 {
    const CENTRE: [f32; 9] = [
        2.810_226_4e-8,
        3.432_739_4e-7,
        -3.523_387_7e-6,
        -4.391_506_5e-6,
        0.000_218_580_87,
        -0.001_253_725,
        -0.004_177_681_6,
        0.246_640_73,
        1.501_409_4,
    ];
    const TAIL: [f32; 9] = [
        -0.000_200_214_26,
        0.000_100_950_56,
        0.001_349_343_2,
        -0.003_673_428_4,
        0.005_739_507_7,
        -0.007_622_461_3,
        0.009_438_870_5,
        1.001_674,
        2.832_976_8,
    ];
    let horner = |coefficients: &[f32; 9], t: f32| coefficients.iter().fold(0.0, |sum, c| sum * t + c);
    let w = -libm::logf((y * (2.0 - y)).max(f32::MIN_POSITIVE));
    let scale = if w < 5.0 { horner(&CENTRE, w - 2.5) } else { horner(&TAIL, w.sqrt() - 3.0) };
    scale * (y - 1.0)
}
