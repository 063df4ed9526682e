//! How a scene is rendered: everything besides the scene that the bits of the image depend on.

use serde::{Deserialize, Serialize};

/// The most pixels along one side of a film; beyond it a size is taken for a mistake.
pub const FILM_SIDE_MAX: u32 = 1 << 16;

/// The settings of a job. With the scene's digest they determine every bit of the image.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// Size, window and pixel filter.
    pub film: Film,
    /// Samples a pixel, at least 1.
    pub spp: u32,
    /// Chooses among equally good sets of random numbers.
    pub seed: u64,
    /// What is estimated.
    pub integrator: Integrator,
    /// Where random directions come from.
    pub strategy: Strategy,
    /// Where random numbers come from.
    pub sampler: SamplerKind,
    /// Binary exponent of the film's fixed point: a radiance r is stored as round(r · 2^scale_exponent).
    pub scale_exponent: i32,
}

/// The picture's geometry.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Film {
    /// Pixels across the whole picture, at most [`FILM_SIDE_MAX`].
    pub width: u32,
    /// Pixels down the whole picture, likewise.
    pub height: u32,
    /// The part of it that is rendered. Its pixels have the very bits they have in the whole picture.
    pub crop: Window,
    /// How samples around a pixel's centre are weighted.
    pub filter: Filter,
}

/// A half-open rectangle of pixels, in the coordinates of the whole picture; y grows downwards.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Window {
    /// First column.
    pub x0: u32,
    /// First row.
    pub y0: u32,
    /// Behind the last column.
    pub x1: u32,
    /// Behind the last row.
    pub y1: u32,
}

impl Window {
    /// Columns.
    pub fn width(&self) -> u32 {
        self.x1 - self.x0
    }

    /// Rows.
    pub fn height(&self) -> u32 {
        self.y1 - self.y0
    }

    /// Pixels.
    pub fn area(&self) -> u64 {
        u64::from(self.width()) * u64::from(self.height())
    }

    /// Whether every pixel of `other` is one of this window's.
    pub fn contains(&self, other: &Window) -> bool {
        self.x0 <= other.x0 && self.y0 <= other.y0 && other.x1 <= self.x1 && other.y1 <= self.y1
    }
}

/// Pixel filters, separable; distances in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Filter {
    /// Constant over the pixel (radius ½).
    Box,
    /// Linear from the centre to `radius`.
    Tent {
        /// Where it reaches zero.
        radius: f32,
    },
    /// A Gaussian cut at four standard deviations and lowered to be zero there.
    Gaussian {
        /// Standard deviation.
        stddev: f32,
    },
}

/// What is estimated for each camera ray.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Integrator {
    /// Which light transport is counted.
    pub kind: IntegratorKind,
    /// Longest path in segments from the camera (1: emission seen directly; 2: direct light), or none. `direct` ignores it.
    pub max_depth: Option<u32>,
    /// From this depth on paths may end by Russian roulette.
    pub rr_depth: u32,
    /// Emitters are invisible to the camera itself.
    pub hide_emitters: bool,
}

/// Which light transport is counted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum IntegratorKind {
    /// All of it: the rendering equation, estimated along random paths.
    Path,
    /// Local illumination: emission and light scattered once.
    Direct,
    /// Classic ray tracing (Whitted 1980): direct light, and perfect reflection and refraction followed.
    Whitted,
}

/// Where the direction `wi` of the estimator L ≈ 1/N Σ f(wi, wo) Li(wi) |cos θ| / p(wi) comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Strategy {
    /// p = 1/2π over the hemisphere.
    Uniform,
    /// p = cos θ / π.
    Cosine,
    /// p as close to f·|cos θ| as the model allows.
    Bsdf,
    /// A point on an emitter; its area density turned into solid angle. Mirrors and glass still by the BSDF.
    Light,
    /// Light and BSDF joined by multiple importance sampling (Veach & Guibas 1995, power heuristic).
    Mis,
}

/// Where random numbers come from; each is a function of (seed, pixel, sample index, dimension).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum SamplerKind {
    /// A hash: every number independent.
    Independent,
    /// Owen-scrambled Sobol' points by hashing, padded (Burley 2020).
    Sobol,
}
