//! Angles: polynomial kernels that are short enough to be inlined, the same on every processor.
//!
//! The polynomials are those of Moshier's Cephes library (`sinf`, `cosf`, `atanf`), good to about 1e-7 of the result;
//! only `+ - * /` and selections are used, so every instruction set gives the same bits.

use std::f32::consts::{FRAC_PI_2, FRAC_PI_4, PI};

/// Sine and cosine of an angle between −π/4 and π/4.
#[inline(always)]
pub fn sin_cos_octant(x: f32) -> (f32, f32) {
    let x2 = x * x;
    let sin = ((-1.951_529_6e-4 * x2 + 8.332_161e-3) * x2 - 0.166_666_55) * x2 * x + x;
    let cos = ((2.443_315_7e-5 * x2 - 1.388_731_6e-3) * x2 + 4.166_664_6e-2) * (x2 * x2) - 0.5 * x2 + 1.0;
    (sin, cos)
}

/// Sine and cosine of 2π·turn, for a turn from 0 to a few.
#[inline(always)]
pub fn sin_cos_turn(turn: f32) -> (f32, f32) {
    let quarters = turn * 4.0;
    let nearest = (quarters + 0.5) as i32;
    // Exact: both are close to each other.
    let (sin, cos) = sin_cos_octant((quarters - nearest as f32) * FRAC_PI_2);
    let (sin, cos) = if nearest & 1 == 0 { (sin, cos) } else { (cos, sin) };
    let negated = |x: f32, quarter: i32| f32::from_bits(x.to_bits() ^ ((quarter as u32 & 2) << 30));
    (negated(sin, nearest), negated(cos, nearest + 1))
}

/// The angle of the point (x, y), between −π and π.
#[inline(always)]
pub fn atan2(y: f32, x: f32) -> f32 {
    let (ax, ay) = (x.abs(), y.abs());
    let (small, large) = if ay > ax { (ax, ay) } else { (ay, ax) };
    // tan(a − π/4) = (tan a − 1) / (tan a + 1), so that one division does for both ranges.
    let beyond = small > 0.414_213_57 * large;
    let (num, den, base) = if beyond { (small - large, small + large, FRAC_PI_4) } else { (small, large, 0.0) };
    let z = num / if den == 0.0 { 1.0 } else { den };
    let z2 = z * z;
    let series = (((8.053_744_5e-2 * z2 - 0.138_776_86) * z2 + 0.199_777_11) * z2 - 0.333_329_5) * z2 * z + z;
    let octant = base + series;
    let quadrant = if ay > ax { FRAC_PI_2 - octant } else { octant };
    let half = if x < 0.0 { PI - quadrant } else { quadrant };
    half.copysign(y)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    /// Against f64, over the whole range: within two units of the last place of one. Fails for a swapped quadrant.
    #[test]
    fn sines_and_cosines_are_right() {
        for i in 0..100_000 {
            let turn = i as f32 / 80_000.0;
            let (sin, cos) = sin_cos_turn(turn);
            let angle = f64::from(turn) * TAU;
            assert!((f64::from(sin) - libm::sin(angle)).abs() < 2e-7, "sin at {turn}: {sin}");
            assert!((f64::from(cos) - libm::cos(angle)).abs() < 2e-7, "cos at {turn}: {cos}");
        }
    }

    /// Against f64 all around, on circles of any size: a relative error of 3e-7, and exact on the axes. Fails for a range that is
    /// put together wrongly.
    #[test]
    fn angles_are_right() {
        for i in 0..100_000 {
            let angle = TAU * (f64::from(i) / 100_000.0 - 0.5);
            let radius = [1e-20, 0.3, 1e20][i as usize % 3];
            let (x, y) = ((radius * libm::cos(angle)) as f32, (radius * libm::sin(angle)) as f32);
            let truth = libm::atan2(f64::from(y), f64::from(x));
            let found = f64::from(atan2(y, x));
            assert!((found - truth).abs() <= 3e-7 * truth.abs(), "({x}, {y}): {found}, not {truth}");
        }
        assert_eq!([atan2(0.0, 1.0), atan2(1.0, 0.0), atan2(0.0, -1.0), atan2(0.0, 0.0)], [0.0, FRAC_PI_2, PI, 0.0]);
    }
}
