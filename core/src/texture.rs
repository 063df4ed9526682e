//! Textures, compiled for look-up: the one place where a texture is evaluated.

mod attribute;

use crate::bvh::simd::prefetch_line;
use crate::scene::{FilterType, Image, Scene, Texels, Texture, TextureId, WrapMode};
use crate::surface::Surface;
use attribute::Attributes;
use glam::{Affine2, Vec2, Vec3};
use std::sync::Arc;

/// All textures of a scene.
pub struct Textures {
    textures: Vec<Texture>,
    images: Vec<Arc<Image>>,
    attributes: Attributes,
    /// sRGB decoding of a byte (IEC 61966-2-1).
    srgb: [f32; 256],
}

impl Textures {
    /// Takes over a scene's textures.
    pub fn new(scene: &Scene) -> Self {
        Self {
            textures: scene.textures.clone(),
            images: scene.images.clone(),
            attributes: Attributes::new(scene),
            srgb: std::array::from_fn(|i| srgb_to_linear(i as f64 / 255.0) as f32),
        }
    }

    /// What they take in memory, images shared with the scene included.
    pub fn bytes(&self) -> usize {
        self.images.iter().map(|image| image.bytes()).sum::<usize>() + self.attributes.bytes()
    }

    /// The value, where it is the same everywhere.
    #[inline(always)]
    pub fn constant(&self, id: TextureId) -> Option<Vec3> {
        match &self.textures[id.0 as usize] {
            Texture::Constant(rgb) => Some(*rgb),
            _ => None,
        }
    }

    /// The value at a point of a surface, linear sRGB.
    #[inline(always)]
    pub fn at(&self, id: TextureId, surface: &Surface) -> Vec3 {
        self.value(id, surface.uv, Some(surface))
    }

    /// Asks for the texels that [`Textures::at`] will read, ahead of time.
    #[inline(always)]
    pub fn prefetch(&self, id: TextureId, uv: Vec2) {
        let Texture::Bitmap { image, to_uv, wrap, .. } = &self.textures[id.0 as usize] else { return };
        let image = &self.images[image.0 as usize];
        let p = texels(image, to_uv, uv) - Vec2::splat(0.5);
        let [column, _] = neighbours(floor(p.x), image.width, *wrap);
        for row in neighbours(floor(p.y), image.height, *wrap) {
            self.prefetch_texel(image, row * image.width as usize + column);
        }
    }

    /// Asks for the pixel of this index, ahead of time.
    #[inline(always)]
    pub(crate) fn prefetch_texel(&self, image: &Image, i: usize) {
        match &image.texels {
            Texels::Grey8 { data, .. } => prefetch_line(&data[i]),
            Texels::Rgb8 { data, .. } => prefetch_line(&data[3 * i]),
            Texels::Grey32(data) => prefetch_line(&data[i]),
            Texels::Rgb32(data) => prefetch_line(&data[3 * i]),
        }
    }

    /// The value at texture coordinates `uv` of what is no surface (a light's beam), linear sRGB.
    #[inline(always)]
    pub fn at_uv(&self, id: TextureId, uv: Vec2) -> Vec3 {
        self.value(id, uv, None)
    }

    #[inline(always)]
    fn value(&self, id: TextureId, uv: Vec2, surface: Option<&Surface>) -> Vec3 {
        match &self.textures[id.0 as usize] {
            Texture::Constant(rgb) => *rgb,
            varying => self.varying(id, varying, uv, surface),
        }
    }

    #[inline(always)]
    fn varying(&self, id: TextureId, texture: &Texture, uv: Vec2, surface: Option<&Surface>) -> Vec3 {
        match texture {
            Texture::Constant(rgb) => *rgb,
            Texture::Checkerboard { color0, color1, to_uv } => {
                // Only the squares are transformed, not the textures in them.
                let square = to_uv.transform_point2(uv);
                let high = |x: f32| x - x.floor() > 0.5;
                self.value(if high(square.x) == high(square.y) { *color0 } else { *color1 }, uv, surface)
            }
            Texture::Bitmap { image, to_uv, filter, wrap, scale } => {
                self.bitmap(&self.images[image.0 as usize], to_uv, *filter, *wrap, uv) * *scale
            }
            Texture::MeshAttribute { scale, .. } => {
                surface.map_or(Vec3::ZERO, |surface| self.attributes.at(id.0, surface) * *scale)
            }
        }
    }

    #[inline(always)]
    fn bitmap(&self, image: &Image, to_uv: &Affine2, filter: FilterType, wrap: WrapMode, uv: Vec2) -> Vec3 {
        let p = texels(image, to_uv, uv);
        match filter {
            FilterType::Nearest => {
                let (x, y) = (wrapped(floor(p.x), image.width, wrap), wrapped(floor(p.y), image.height, wrap));
                self.texel(image, y as usize * image.width as usize + x as usize)
            }
            FilterType::Bilinear => {
                let Cell { upper, lower, at } = self.cell(image, wrap, p);
                let upper = upper[0] * (1.0 - at.x) + upper[1] * at.x;
                let lower = lower[0] * (1.0 - at.x) + lower[1] * at.x;
                upper * (1.0 - at.y) + lower * at.y
            }
        }
    }

    /// The derivative of the luminance by the texture coordinates, for heights: that of the interpolation between a
    /// bitmap's texels, zero for what is flat but for its steps.
    pub fn gradient(&self, id: TextureId, uv: Vec2) -> Vec2 {
        let Texture::Bitmap { image, to_uv, filter: FilterType::Bilinear, wrap, scale } = &self.textures[id.0 as usize]
        else {
            return Vec2::ZERO;
        };
        let image = &self.images[image.0 as usize];
        let size = Vec2::new(image.width as f32, image.height as f32);
        let Cell { upper, lower, at } = self.cell(image, *wrap, to_uv.transform_point2(uv) * size);
        let ([a, b], [c, d]) = (upper.map(luminance), lower.map(luminance));
        let by_texel = Vec2::new((b - a) * (1.0 - at.y) + (d - c) * at.y, (c - a) * (1.0 - at.x) + (d - b) * at.x);
        to_uv.matrix2.transpose() * (by_texel * size) * *scale
    }

    /// The four texels around the position `p`, in texels.
    #[inline(always)]
    fn cell(&self, image: &Image, wrap: WrapMode, p: Vec2) -> Cell {
        let p = p - Vec2::splat(0.5);
        let corner = Vec2::new(floor(p.x), floor(p.y));
        let [left, right] = neighbours(corner.x, image.width, wrap);
        let [upper, lower] = neighbours(corner.y, image.height, wrap);
        let (upper, lower) = (upper * image.width as usize, lower * image.width as usize);
        Cell {
            upper: [self.texel(image, upper + left), self.texel(image, upper + right)],
            lower: [self.texel(image, lower + left), self.texel(image, lower + right)],
            at: p - corner,
        }
    }

    /// The pixel of this index, linear.
    #[inline(always)]
    pub(crate) fn texel(&self, image: &Image, i: usize) -> Vec3 {
        let decode = |byte: u8, srgb: bool| if srgb { self.srgb[byte as usize] } else { f32::from(byte) / 255.0 };
        match &image.texels {
            Texels::Grey8 { srgb, data } => Vec3::splat(decode(data[i], *srgb)),
            Texels::Rgb8 { srgb, data } => {
                let texel = &data[3 * i..3 * i + 3];
                Vec3::new(decode(texel[0], *srgb), decode(texel[1], *srgb), decode(texel[2], *srgb))
            }
            Texels::Grey32(data) => Vec3::splat(data[i]),
            Texels::Rgb32(data) => Vec3::from_slice(&data[3 * i..3 * i + 3]),
        }
    }

    /// A typical value: the mean over the unit square of the texture (for weighing lights, not for shading).
    pub fn mean(&self, id: TextureId) -> Vec3 {
        match &self.textures[id.0 as usize] {
            Texture::Constant(rgb) => *rgb,
            Texture::Checkerboard { color0, color1, .. } => 0.5 * (self.mean(*color0) + self.mean(*color1)),
            Texture::Bitmap { image, scale, .. } => {
                let image = &self.images[image.0 as usize];
                let pixels = image.width as usize * image.height as usize;
                let sum: glam::DVec3 = (0..pixels).map(|i| self.texel(image, i).as_dvec3()).sum();
                (sum / pixels as f64).as_vec3() * *scale
            }
            Texture::MeshAttribute { scale, .. } => self.attributes.mean(id.0) * *scale,
        }
    }
}

/// Texture coordinates in texels of an image.
#[inline(always)]
fn texels(image: &Image, to_uv: &Affine2, uv: Vec2) -> Vec2 {
    let uv = to_uv.transform_point2(uv);
    Vec2::new(uv.x * image.width as f32, uv.y * image.height as f32)
}

/// Four texels, and where between them a position lies.
struct Cell {
    upper: [Vec3; 2],
    lower: [Vec3; 2],
    at: Vec2,
}

/// Luminance of linear sRGB, with Mitsuba's weights.
#[inline(always)]
pub fn luminance(rgb: Vec3) -> f32 {
    rgb.dot(Vec3::new(0.212_671, 0.715_160, 0.072_169))
}

/// The largest integer up to `x`, without a call where the processor has no instruction for it.
#[inline(always)]
fn floor(x: f32) -> f32 {
    if x.abs() < 1e9 {
        let truncated = x as i32 as f32;
        if truncated > x { truncated - 1.0 } else { truncated }
    } else {
        x.floor()
    }
}

/// A texel coordinate and the next one, both brought into 0..size.
#[inline(always)]
fn neighbours(x: f32, size: u32, wrap: WrapMode) -> [usize; 2] {
    let i = wrapped(x, size, wrap);
    let next = if wrap != WrapMode::Repeat || x.abs() >= EXACT {
        wrapped(x + 1.0, size, wrap)
    } else if i + 1 == size {
        0
    } else {
        i + 1
    };
    [i as usize, next as usize]
}

/// Integers below this have a next one that is exact, too.
const EXACT: f32 = (1 << 24) as f32;

/// A texel coordinate brought into 0..size. What is not finite becomes 0.
#[inline(always)]
fn wrapped(x: f32, size: u32, wrap: WrapMode) -> u32 {
    let n = i64::from(size);
    let i = x as i64;
    if (0..n).contains(&i) {
        return i as u32; // No division: this is the rule.
    }
    let inside = match wrap {
        // That of i32 takes half as long.
        WrapMode::Repeat => match (i32::try_from(i), i32::try_from(n)) {
            (Ok(i), Ok(n)) => i64::from(i.rem_euclid(n)),
            _ => i.rem_euclid(n),
        },
        WrapMode::Clamp => i.clamp(0, n - 1),
        WrapMode::Mirror => {
            let j = i.rem_euclid(2 * n);
            if j < n { j } else { 2 * n - 1 - j }
        }
    };
    inside as u32
}

/// The sRGB curve, decoding.
pub fn srgb_to_linear(x: f64) -> f64 {
    if x <= 0.04045 { x / 12.92 } else { libm::pow((x + 0.055) / 1.055, 2.4) }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A texel and the next one, by the definition of each mode, far beyond both edges and where f32 has no next integer. Fails where
    /// the last texel of a repeated image is followed by one beyond it.
    #[test]
    fn neighbours_are_brought_into_the_image() {
        for size in [1_u32, 2, 3, 689, 4096] {
            let n = f64::from(size);
            let repeated = |x: f64| x - (x / n).floor() * n;
            let clamped = |x: f64| x.clamp(0.0, n - 1.0);
            let mirrored = |x: f64| {
                let x = x - (x / (2.0 * n)).floor() * 2.0 * n;
                if x < n { x } else { 2.0 * n - 1.0 - x }
            };
            for x in (-3000..3000).map(|i| i as f32).chain([-3e9, 3e9, 16_777_214.0, 16_777_215.0, 16_777_216.0]) {
                let both = [f64::from(x), f64::from(x + 1.0)];
                let check = |wrap, expected: [f64; 2]| {
                    assert_eq!(neighbours(x, size, wrap).map(|i| i as f64), expected, "{x} of {size}, {wrap:?}");
                };
                check(WrapMode::Repeat, both.map(repeated));
                check(WrapMode::Clamp, both.map(clamped));
                check(WrapMode::Mirror, both.map(mirrored));
            }
        }
    }
}
