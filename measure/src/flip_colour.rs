//! The colour spaces of FLIP: linear sRGB, CIE XYZ, YCxCz and L*a*b* with Hunt's adjustment, all relative to the white (1, 1, 1).

/// Linear sRGB to XYZ, as FLIP's authors give it.
const TO_XYZ: [[f32; 3]; 3] = [
    [10_135_552.0 / 24_577_794.0, 8_788_810.0 / 24_577_794.0, 4_435_075.0 / 24_577_794.0],
    [2_613_072.0 / 12_288_897.0, 8_788_810.0 / 12_288_897.0, 887_015.0 / 12_288_897.0],
    [1_425_312.0 / 73_733_382.0, 8_788_810.0 / 73_733_382.0, 70_074_185.0 / 73_733_382.0],
];
/// Its inverse.
const FROM_XYZ: [[f32; 3]; 3] = [
    [3.241_003_2, -1.537_399, -0.498_615_9],
    [-0.969_224_3, 1.875_93, 0.041_554_226],
    [0.055_639_42, -0.204_011_2, 1.057_149],
];

fn times(m: &[[f32; 3]; 3], v: [f32; 3]) -> [f32; 3] {
    [0, 1, 2].map(|r| m[r][0] * v[0] + m[r][1] * v[1] + m[r][2] * v[2])
}

/// XYZ of a colour, each over that of white.
fn relative_xyz(rgb: [f32; 3]) -> [f32; 3] {
    let (xyz, white) = (times(&TO_XYZ, rgb), times(&TO_XYZ, [1.0; 3]));
    [0, 1, 2].map(|c| xyz[c] / white[c])
}

/// Luminance, by the rounded weights that the authors' program has for it.
pub fn luminance([r, g, b]: [f32; 3]) -> f32 {
    0.2126 * r + 0.7152 * g + 0.0722 * b
}

/// Linear sRGB to YCxCz, a linear relative of L*a*b*.
pub fn to_ycxcz(rgb: [f32; 3]) -> [f32; 3] {
    let [x, y, z] = relative_xyz(rgb);
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

/// The way back.
pub fn from_ycxcz([y, cx, cz]: [f32; 3]) -> [f32; 3] {
    let y = (y + 16.0) / 116.0;
    let white = times(&TO_XYZ, [1.0; 3]);
    times(&FROM_XYZ, [white[0] * (y + cx / 500.0), white[1] * y, white[2] * (y - cz / 200.0)])
}

/// Linear sRGB to L*a*b*, with chroma less visible in the dark (Hunt).
pub fn to_hunt_lab(rgb: [f32; 3]) -> [f32; 3] {
    const DELTA: f32 = 6.0 / 29.0;
    let f = |t: f32| if t > DELTA.powi(3) { libm::cbrtf(t) } else { t / (3.0 * DELTA * DELTA) + 4.0 / 29.0 };
    let [x, y, z] = relative_xyz(rgb).map(f);
    let l = 116.0 * y - 16.0;
    [l, 0.01 * l * 500.0 * (x - y), 0.01 * l * 200.0 * (y - z)]
}

/// The HyAB distance (Abasi et al. 2020), which holds for large differences too.
pub fn hyab(a: [f32; 3], b: [f32; 3]) -> f32 {
    let [l, a, b] = [0, 1, 2].map(|c| a[c] - b[c]);
    l.abs() + (a * a + b * b).sqrt()
}

/// A display's encoding of a linear value.
pub fn srgb_to_linear(c: f32) -> f32 {
    if c <= 0.04045 { c / 12.92 } else { libm::powf((c + 0.055) / 1.055, 2.4) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_inverse_is_one() {
        for rgb in [[1.0, 0.0, 0.0], [0.2, 0.7, 0.1], [0.0, 0.0, 1.0]] {
            let back = from_ycxcz(to_ycxcz(rgb));
            assert!((0..3).all(|c| (back[c] - rgb[c]).abs() < 2e-6), "{back:?} for {rgb:?}");
        }
    }
}
