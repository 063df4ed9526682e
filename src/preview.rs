//! A film as PNG for people: clipped to [0, 1], sRGB curve, no exposure, no tone mapping.

use image::{ExtendedColorType, ImageEncoder, codecs::png::PngEncoder};
use std::io::Write;
use tilecast_core::film::{Estimate, Film};

/// Relative errors from [`ERROR_LOW`] to [`ERROR_LOW`] times this are drawn from black to white, by their logarithm.
const ERROR_SPAN: f64 = 1e4;
/// See [`ERROR_SPAN`].
const ERROR_LOW: f64 = 1e-4;

/// Writes the film's window.
///
/// # Errors
/// Whatever writing fails with.
pub fn write(file: &mut impl Write, film: &Film) -> anyhow::Result<()> {
    draw(file, film, |estimate| estimate.mean.map(srgb8))
}

/// Writes the estimated errors of the pixels, relative to their means and a hundredth of the picture's: black for 0.01 %, grey for
/// 1 %, white for 100 %.
///
/// # Errors
/// Whatever writing fails with.
pub fn write_errors(file: &mut impl Write, film: &Film) -> anyhow::Result<()> {
    let sum = |values: [f32; 3]| values.iter().map(|&v| f64::from(v)).sum::<f64>();
    let total: f64 = pixels(film).map(|(x, y)| sum(film.estimate(x, y).mean.map(|m| m * m))).sum();
    let floor = (1e-4 * total / film.window.area() as f64).max(f64::MIN_POSITIVE);
    draw(file, film, |estimate| {
        let power = sum(estimate.mean.map(|m| m * m)).max(floor);
        let error = (sum(estimate.variance) / power).sqrt();
        let place = ((error / ERROR_LOW).ln() / ERROR_SPAN.ln()).clamp(0.0, 1.0);
        [(255.0 * place).round() as u8; 3]
    })
}

fn draw(file: &mut impl Write, film: &Film, colour: impl Fn(Estimate) -> [u8; 3]) -> anyhow::Result<()> {
    let bytes: Vec<u8> = pixels(film).flat_map(|(x, y)| colour(film.estimate(x, y))).collect();
    let window = film.window;
    PngEncoder::new(file).write_image(&bytes, window.width(), window.height(), ExtendedColorType::Rgb8)?;
    Ok(())
}

fn pixels(film: &Film) -> impl Iterator<Item = (u32, u32)> {
    let window = film.window;
    (window.y0..window.y1).flat_map(move |y| (window.x0..window.x1).map(move |x| (x, y)))
}

/// A linear value by the curve of sRGB (IEC 61966-2-1), in 255ths.
fn srgb8(linear: f32) -> u8 {
    let linear = linear.clamp(0.0, 1.0);
    let encoded = if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 };
    (encoded * 255.0).round() as u8
}

#[cfg(test)]
mod tests {
    use super::srgb8;

    #[test]
    fn the_curve_has_its_known_points() {
        assert_eq!([-1.0, 0.0, 0.002, 0.214_04, 0.5, 1.0, 9.0].map(srgb8), [0, 0, 7, 127, 188, 255, 255]);
    }
}
