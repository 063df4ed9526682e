//! Whether chance explains how two images differ.

use crate::image::{Image, Variance};
use crate::stats::{sidak, two_sided_p, two_sided_quantile};

/// The level of every interval and verdict.
pub const LEVEL: f64 = 0.05;

/// The mean difference of one channel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bias {
    /// mean(a − b).
    pub difference: f64,
    /// Half the width of its 95 % confidence interval.
    pub interval: f64,
    /// As a part of the reference's mean; NaN for a black one.
    pub relative: f64,
    /// P of such a difference, or a larger one, by chance.
    pub p: f64,
}

/// Where a bias's interval comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// The images' own variances.
    Variances,
    /// The spread of the differences over the pixels: right if the images differ by chance alone, else too wide.
    Spread,
}

/// How single values differ, in units of their errors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ZTest {
    /// Values tested: those that are not certain in both images.
    pub tested: usize,
    /// Values that differ though both images are certain of them.
    pub certain_and_different: usize,
    /// Share of the tested within their 95 % intervals: 0.95 if chance explains the differences.
    pub within: f64,
    /// The smallest p of all.
    pub smallest_p: f64,
    /// What it may not go below: 0.05, corrected for so many tests (Šidák).
    pub allowed_p: f64,
    /// √ of the mean z²: 1 if the errors are as large as claimed, for images of very many replicates.
    pub rms: f64,
}

impl ZTest {
    /// Whether single values differ by more than chance.
    pub fn differs(&self) -> bool {
        self.certain_and_different > 0 || self.smallest_p < self.allowed_p
    }
}

/// The bias of `a` against `b`, by channel, and where its interval comes from.
pub fn bias(a: &Image, b: &Image) -> ([Bias; 3], Source) {
    let n = b.rgb.len() as f64;
    let known = (a.variance.as_ref().zip(b.variance.as_ref())).map(|(a, b)| summed(a, b));
    let known = known.filter(|variances| variances.iter().all(|v| v.is_finite()));
    let source = if known.is_some() { Source::Variances } else { Source::Spread };
    let bias = |c: usize| {
        let differences = || a.rgb.iter().zip(&b.rgb).map(move |(a, b)| f64::from(a[c]) - f64::from(b[c]));
        let difference = differences().sum::<f64>() / n;
        let spread = differences().map(|d| (d - difference).powi(2)).sum::<f64>();
        let alone = known.map_or(spread * n / (n - 1.0).max(1.0), |v| v[c]);
        let together =
            if spread > 0.0 { squares(differences().map(|d| d - difference), b.width) / spread } else { 1.0 };
        let error = (alone * together.max(1.0)).sqrt() / n;
        let p = if difference == 0.0 { 1.0 } else { two_sided_p(difference / error, f64::INFINITY) };
        let mean = b.rgb.iter().map(|v| f64::from(v[c])).sum::<f64>() / n;
        let interval = error * two_sided_quantile(LEVEL, f64::INFINITY);
        Bias { difference, interval, relative: difference / mean, p }
    };
    ([0, 1, 2].map(bias), source)
}

/// Pixels of squares of this side may err alike, as those do that tilecast makes of the same paths (4×4, wherever a crop begins).
const SQUARE: usize = 8;

/// Σ over squares of (Σ of the values in it)²: over Σ of the values' squares about one where each pixel errs by itself.
fn squares(values: impl Iterator<Item = f64>, width: usize) -> f64 {
    let mut sums = vec![0.0; width.div_ceil(SQUARE)];
    let mut total = 0.0;
    for (i, value) in values.enumerate() {
        let (x, y) = (i % width, i / width);
        if x == 0 && y % SQUARE == 0 {
            total += sums.iter().map(|s| s * s).sum::<f64>();
            sums.fill(0.0);
        }
        sums[x / SQUARE] += value;
    }
    total + sums.iter().map(|s| s * s).sum::<f64>()
}

/// Sums over the pixels of both variances.
fn summed(a: &Variance, b: &Variance) -> [f64; 3] {
    let mut sums = [0.0; 3];
    for (a, b) in a.rgb.iter().zip(&b.rgb) {
        (0..3).for_each(|c| sums[c] += f64::from(a[c]) + f64::from(b[c]));
    }
    sums
}

/// Tests every value of two images by Welch's t (1947), with Satterthwaite's degrees of freedom where the images say theirs.
/// `None` if one of them does not say its variances.
pub fn ztest(a: &Image, b: &Image) -> Option<ZTest> {
    let (va, vb) = (a.variance.as_ref()?, b.variance.as_ref()?);
    let (mut tested, mut certain_and_different, mut within, mut squares, mut smallest_p) = (0, 0, 0, 0.0, 1.0f64);
    for i in 0..a.rgb.len() {
        for c in 0..3 {
            let [x, y] = [a.rgb[i][c], b.rgb[i][c]].map(f64::from);
            let [u, v] = [va.rgb[i][c], vb.rgb[i][c]].map(f64::from);
            if u + v == 0.0 {
                certain_and_different += usize::from(x != y);
                continue;
            }
            if !(u + v).is_finite() {
                continue;
            }
            let z = (x - y) / (u + v).sqrt();
            let p = two_sided_p(z, freedom((u, va.freedom), (v, vb.freedom)));
            tested += 1;
            within += usize::from(p >= LEVEL);
            squares += z * z;
            smallest_p = smallest_p.min(p);
        }
    }
    let n = (tested as f64).max(1.0);
    let allowed_p = sidak(LEVEL, n);
    let (within, rms) = (within as f64 / n, (squares / n).sqrt());
    Some(ZTest { tested, certain_and_different, within, smallest_p, allowed_p, rms })
}

/// Degrees of freedom of the sum of two estimated variances (Satterthwaite 1946).
fn freedom((u, of_u): (f64, Option<u32>), (v, of_v): (f64, Option<u32>)) -> f64 {
    let part = |v: f64, freedom: Option<u32>| freedom.map_or(0.0, |k| v * v / f64::from(k.max(1)));
    (u + v).powi(2) / (part(u, of_u) + part(v, of_v))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sums of hashed numbers: near enough to normal, with a mean and a spread of our choice.
    fn noise(seed: u64, i: usize) -> f64 {
        let hash = |k: u64| {
            let mut x = seed ^ (i as u64 * 12 + k).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            for _ in 0..3 {
                x = (x ^ x >> 31).wrapping_mul(0xd6e8_feb8_6659_fd93);
            }
            (x >> 11) as f64 / (1u64 << 53) as f64
        };
        (0..12).map(hash).sum::<f64>() - 6.0
    }

    /// An image of `replicates` normal replicates a pixel around `mean`.
    fn image(seed: u64, mean: f64, replicates: u32) -> Image {
        image_of_squares(seed, mean, replicates, 1)
    }

    /// The same, with one noise for all pixels of a square.
    fn image_of_squares(seed: u64, mean: f64, replicates: u32, side: usize) -> Image {
        let (count, width) = (40_000, 200);
        let (mut rgb, mut variances) = (Vec::new(), Vec::new());
        for i in 0..count {
            let i = i % width / side + i / width / side * width;
            let k = replicates as usize;
            let parts: Vec<f64> = (0..k).map(|r| mean + 0.3 * noise(seed, i * k + r)).collect();
            let m = parts.iter().sum::<f64>() / k as f64;
            let v = parts.iter().map(|p| (p - m).powi(2)).sum::<f64>() / (k * (k - 1)) as f64;
            rgb.push([m as f32; 3]);
            variances.push([v as f32; 3]);
        }
        let variance = Some(Variance { rgb: variances, freedom: Some(replicates - 1) });
        Image { name: "noise".into(), width, height: count / width, rgb, variance }
    }

    /// The interval of the bias holds zero nineteen times in twenty where pixels err alike. Seen to fail, with half of them, when each
    /// counts by itself.
    #[test]
    fn pixels_that_err_together_are_not_many() {
        let held = (0..100).filter(|seed| {
            let [a, b] = [1000, 2000].map(|other| image_of_squares(seed + other, 1.0, 4, 4));
            let bias = bias(&a, &b).0[0];
            bias.difference.abs() < bias.interval
        });
        let held = held.count();
        assert!((88..=99).contains(&held), "{held} of 100");
    }

    /// Equal means: 95 % within. Fails (89 %) if Student's t with the images' degrees of freedom is taken for normal. A bias of a
    /// hundredth of a pixel's error shows in the mean over 40,000 of them.
    #[test]
    fn chance_is_told_from_a_difference() {
        let (a, b) = (image(1, 1.0, 4), image(2, 1.0, 4));
        let test = ztest(&a, &b).unwrap();
        // Welch's test is slightly conservative for so few replicates; 40,000 pixels leave ±0.2 %.
        assert!((0.945..0.965).contains(&test.within), "{test:?}");
        assert!(!test.differs(), "{test:?}");
        let (biases, source) = bias(&a, &b);
        assert_eq!(source, Source::Variances);
        assert!(biases[0].p > 0.01 && biases[0].difference.abs() < 2.0 * biases[0].interval, "{biases:?}");
        let shifted = image(3, 1.005, 4);
        assert!(bias(&shifted, &b).0[0].p < 0.001);
        let far = image(3, 2.0, 4);
        assert!(ztest(&far, &b).unwrap().within < 0.5);
        assert_eq!(ztest(&Image { variance: None, ..a }, &b), None);
    }
}
