//! Distances between an image and its reference.

use crate::flip;
use crate::image::Image;

/// Added to r² in relMSE, in units of the reference's mean squared: dark pixels must not decide alone.
const RELATIVE_FLOOR: f64 = 0.01;

/// Distances over all pixels and channels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Metrics {
    /// Mean of (x − r)².
    pub mse: f64,
    /// Mean of (x − r)² / (r² + 0.01 · mean(r)²).
    pub relmse: f64,
    /// Mean of |x − r|.
    pub mae: f64,
    /// 10 log₁₀ (peak² / MSE) in dB; the peak is the reference's brightest value. Infinite for equal images.
    pub psnr: f64,
}

/// The mean FLIP of the pair.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FlipMeans {
    /// As displayed: values clamped to 0…1, sRGB (Andersson et al. 2020).
    pub ldr: f64,
    /// The worst over all exposures that show something (Andersson et al. 2021).
    pub hdr: f64,
}

/// Distances of `image` from `reference`, which must be comparable.
pub fn metrics(image: &Image, reference: &Image) -> Metrics {
    let mut sums = [0.0f64; 3];
    let (mut peak, floor) = (0.0f64, RELATIVE_FLOOR * mean(reference).powi(2));
    for (x, r) in values(image).zip(values(reference)) {
        let d = x - r;
        let scale = r * r + floor;
        sums[0] += d * d;
        sums[1] += if d == 0.0 { 0.0 } else { d * d / scale };
        sums[2] += d.abs();
        peak = peak.max(r);
    }
    let n = (3 * reference.rgb.len()) as f64;
    let [mse, relmse, mae] = sums.map(|sum| sum / n);
    Metrics { mse, relmse, mae, psnr: 10.0 * libm::log10(peak * peak / mse) }
}

/// Both variants of FLIP at the pixels a degree that its authors take for usual.
pub fn flip_means(image: &Image, reference: &Image) -> FlipMeans {
    let mean = |map: Vec<f32>| map.iter().map(|&v| f64::from(v)).sum::<f64>() / map.len() as f64;
    let size = [reference.width, reference.height];
    FlipMeans {
        ldr: mean(flip::ldr(size, &reference.rgb, &image.rgb)),
        hdr: mean(flip::hdr(size, &reference.rgb, &image.rgb)),
    }
}

/// The mean over pixels and channels.
pub fn mean(image: &Image) -> f64 {
    values(image).sum::<f64>() / (3 * image.rgb.len()) as f64
}

fn values(image: &Image) -> impl Iterator<Item = f64> {
    image.rgb.iter().flatten().map(|&v| f64::from(v))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(rgb: Vec<[f32; 3]>) -> Image {
        Image { name: "test".into(), width: rgb.len(), height: 1, rgb, variance: None }
    }

    /// By hand: differences 1, −1, 0 of two pixels, mean of the reference 2. Fails if the two are exchanged.
    #[test]
    fn distances_are_those_found_by_hand() {
        let reference = image(vec![[1.0, 2.0, 3.0], [1.0, 2.0, 3.0]]);
        let other = image(vec![[2.0, 1.0, 3.0], [1.0, 2.0, 3.0]]);
        let Metrics { mse, relmse, mae, psnr } = metrics(&other, &reference);
        assert!((mse - 2.0 / 6.0).abs() < 1e-12 && (mae - 2.0 / 6.0).abs() < 1e-12);
        assert!((relmse - (1.0 / 1.04 + 1.0 / 4.04) / 6.0).abs() < 1e-12);
        assert!((psnr - 10.0 * libm::log10(27.0)).abs() < 1e-12);
        assert_eq!(metrics(&reference, &reference).psnr, f64::INFINITY);
    }
}
