//! Values over a surface: constant, checkerboard, image, attribute of a mesh.

use glam::{Affine2, Vec3};
use serde::{Deserialize, Serialize};

/// Index into [`super::Scene::textures`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct TextureId(pub u32);

/// Index into [`super::Scene::images`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct ImageId(pub u32);

/// A linear sRGB value over texture coordinates. What is a scalar (roughness, opacity) has three equal channels.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Texture {
    /// The same everywhere.
    Constant(Vec3),
    /// Squares of half a unit of (transformed) texture space, as Mitsuba's `checkerboard`.
    Checkerboard {
        /// Value where both or neither fractional coordinates exceed ½.
        color0: TextureId,
        /// Value elsewhere.
        color1: TextureId,
        /// Applied to the surface's texture coordinates first.
        to_uv: Affine2,
    },
    /// A decoded image.
    Bitmap {
        /// The pixels.
        image: ImageId,
        /// Applied to the surface's texture coordinates first.
        to_uv: Affine2,
        /// Between texels.
        filter: FilterType,
        /// Beyond the unit square.
        wrap: WrapMode,
        /// Factor on every value (1 for most; an emitter's `scale` folds in here).
        scale: f32,
    },
    /// Values that the mesh itself has: an [`super::Attribute`], between vertices linear.
    MeshAttribute {
        /// The attribute's name.
        name: String,
        /// Factor on every value.
        scale: f32,
    },
}

/// How a bitmap is read between its texels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum FilterType {
    /// The nearest texel.
    Nearest,
    /// Linear between the four nearest.
    Bilinear,
}

/// How a bitmap continues beyond the unit square.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum WrapMode {
    /// Tiled.
    Repeat,
    /// Tiled, every other tile mirrored.
    Mirror,
    /// The border's texels go on.
    Clamp,
}

/// A decoded image in its smallest exact form, row 0 at the top of the picture. Texture coordinates (0, 0) are its top left
/// corner, v runs down, as Mitsuba has it; texel centres lie at half-integers.
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
    /// Row by row.
    pub texels: Texels,
}

impl Image {
    /// What it takes in memory.
    pub fn bytes(&self) -> usize {
        match &self.texels {
            Texels::Grey8 { data, .. } | Texels::Rgb8 { data, .. } => data.len(),
            Texels::Grey32(data) | Texels::Rgb32(data) => size_of_val(&**data),
        }
    }
}

/// The pixels of an [`Image`]; the number of values is width · height · channels.
#[derive(Clone, Debug, PartialEq)]
pub enum Texels {
    /// One 8-bit channel; decoded by the sRGB curve if `srgb`, else value / 255.
    Grey8 {
        /// Values are sRGB-encoded.
        srgb: bool,
        /// One a pixel.
        data: Vec<u8>,
    },
    /// Three 8-bit channels, likewise.
    Rgb8 {
        /// Values are sRGB-encoded.
        srgb: bool,
        /// Three a pixel.
        data: Vec<u8>,
    },
    /// One linear float channel.
    Grey32(Vec<f32>),
    /// Three linear float channels.
    Rgb32(Vec<f32>),
}
