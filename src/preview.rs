//! A film as PNG for people: clipped to [0, 1], sRGB curve, no exposure, no tone mapping.

use image::{ExtendedColorType, ImageEncoder, codecs::png::PngEncoder};
use std::io::Write;
use tilecast_core::film::Film;

/// Writes the film's window.
///
/// # Errors
/// Whatever writing fails with.
pub fn write(file: &mut impl Write, film: &Film) -> anyhow::Result<()> {
    let window = film.window;
    let mut bytes = Vec::with_capacity(3 * window.area() as usize);
    for (x, y) in (window.y0..window.y1).flat_map(|y| (window.x0..window.x1).map(move |x| (x, y))) {
        bytes.extend(film.estimate(x, y).mean.map(srgb8));
    }
    PngEncoder::new(file).write_image(&bytes, window.width(), window.height(), ExtendedColorType::Rgb8)?;
    Ok(())
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
