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
    /// What saves work and shall not.
    #[serde(default)]
    pub without: Without,
    /// Which of a pixel's replicates are sampled.
    #[serde(default)]
    pub half: Half,
    /// Where rays leave surfaces.
    #[serde(default)]
    pub offsets: Offsets,
    /// Binary exponent of the film's fixed point: a radiance r is stored as round(r · 2^scale_exponent).
    pub scale_exponent: i32,
}

/// Ways to the same expected image with less work for the same error, each of them switched off where it is true: so that
/// what it gains can be measured. docs/performance.md has the measurements.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Without {
    /// A path branches at the first surface that scatters it.
    pub splitting: bool,
    /// Roulette starts at the second surface, where a path's throughput is low, whatever `rr_depth` says.
    pub early_roulette: bool,
    /// The last ray of a path is not traced where no light lies on it. The image is the same to the bit.
    pub blind_ends: bool,
    /// What a path finds from its second surface on counts for neighbouring pixels as well.
    /// What was rendered before there was such a thing was rendered without.
    #[serde(default = "yes")]
    pub path_reuse: bool,
    /// Directions to an environment map are chosen by the cosine at the surface as well. Older images were rendered without.
    #[serde(default = "yes")]
    pub environment_cosine: bool,
}

fn yes() -> bool {
    true
}

/// Which of a pixel's replicates are sampled. The halves of an image are independent of each other: what one of them shows may
/// decide how many samples the other one gets (docs/adaptive.md).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Half {
    /// All four.
    #[default]
    Both,
    /// The first two: of four samples in a row the first two.
    First,
    /// The last two.
    Second,
}

impl Half {
    /// The index, among all samples of a pixel, of this half's own sample number `own`.
    #[inline]
    pub fn index(self, own: u32) -> u32 {
        match self {
            Half::Both => own,
            Half::First => own / 2 * 4 + own % 2,
            Half::Second => own / 2 * 4 + own % 2 + 2,
        }
    }

    /// Its replicates.
    pub fn replicates(self) -> std::ops::Range<usize> {
        match self {
            Half::Both => 0..4,
            Half::First => 0..2,
            Half::Second => 2..4,
        }
    }
}

/// Where rays leave surfaces, and where those to lights end.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Offsets {
    /// Just outside the bound on the rounding error of the point that they leave.
    #[default]
    Exact,
    /// Where Mitsuba 3.9 has them: 9e-5 (1 + the largest coordinate) off the surface, and ending 9e-4 of the way before the light,
    /// so that relief of that size casts no shadow. For comparisons with images of Mitsuba's.
    Mitsuba,
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

    /// The pixels that are in both, if there are any.
    pub fn intersection(&self, other: &Window) -> Option<Window> {
        let (x0, y0) = (self.x0.max(other.x0), self.y0.max(other.y0));
        let (x1, y1) = (self.x1.min(other.x1), self.y1.min(other.y1));
        (x0 < x1 && y0 < y1).then_some(Window { x0, y0, x1, y1 })
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
    /// Mitchell & Netravali's piecewise cubics (1988), radius 2; negative lobes make samples' weights differ.
    Mitchell {
        /// Blur; their recommendation is ⅓.
        b: f32,
        /// Ringing; likewise.
        c: f32,
    },
    /// The cubic with B = 0, C = ½, which interpolates; likewise.
    CatmullRom,
    /// A sinc, windowed by the middle of a wider one; likewise.
    Lanczos {
        /// The number of lobes on each side, and the radius.
        lobes: f32,
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
    /// Emitters are invisible to the camera: its rays pass through shapes that emit, and the background is black to them.
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
    /// Owen-scrambled Sobol' points by hashing, padded: each decision of a path has its own (Burley 2020).
    Sobol,
    /// Likewise, but all decisions at one surface share points of seven coordinates.
    SobolJoint,
    /// Like `Sobol`, but the pixels along a Z curve share one sequence, so that neighbours err differently (Ahmed & Wonka 2020).
    /// The numbers depend on the samples a pixel asked for.
    SobolZ,
}

/// Settings outside their ranges.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SettingsError {
    /// A side of zero pixels or beyond [`FILM_SIDE_MAX`].
    #[error("the film is {0}×{1} pixels; each side must have 1 to 65536")]
    FilmSize(u32, u32),
    /// A crop window that is empty or not within the film.
    #[error("the crop window {0:?} is empty or not within the film")]
    Crop(Window),
    /// Fewer than one sample a pixel.
    #[error("0 samples a pixel make no picture; ask for at least 1")]
    NoSamples,
    /// More samples of a half than there are.
    #[error("half of the replicates can have at most 2^31 samples a pixel, not {0}")]
    HalfSamples(u32),
    /// A depth that sees nothing.
    #[error("a maximum depth of 0 sees nothing; 1 sees emitters, 2 direct light, leave it out for all light")]
    NoDepth,
    /// A filter without extent, or wider than the film may be.
    #[error("the pixel filter's radius is {0} pixels; it must lie above 0 and be at most 16")]
    FilterRadius(f32),
    /// A cubic filter whose parts do not fit together.
    #[error("the Mitchell filter's parameters B {b} and C {c} must both lie between 0 and 1")]
    FilterShape {
        /// B.
        b: f32,
        /// C.
        c: f32,
    },
    /// A fixed-point scale that no radiance needs.
    #[error("the film's scale exponent {0} is out of range")]
    Scale(i32),
}

/// The widest pixel filter: beyond it a radius is taken for a mistake.
pub const FILTER_RADIUS_MAX: f32 = 16.0;
/// f32 spans 2^-149 to 2^128; a scale beyond twice that holds no radiance.
const SCALE_EXPONENT_MAX: i32 = 512;

impl Settings {
    /// Whether a sample of a pixel is the same under both: they may differ in nothing but `spp`, and in that where no random
    /// number depends on it.
    pub fn same_samples(&self, other: &Settings) -> bool {
        let rounded = |settings: &Settings| match settings.sampler {
            SamplerKind::SobolZ => crate::sampler::curve_bits(settings.spp),
            SamplerKind::Independent | SamplerKind::Sobol | SamplerKind::SobolJoint => 0,
        };
        Settings { spp: 1, ..self.clone() } == Settings { spp: 1, ..other.clone() } && rounded(self) == rounded(other)
    }

    /// Checks every range.
    ///
    /// # Errors
    /// The first value out of range.
    pub fn validate(&self) -> Result<(), SettingsError> {
        let Film { width, height, crop, filter } = &self.film;
        let side = 1..=FILM_SIDE_MAX;
        let radius = filter.radius();
        let whole = Window { x0: 0, y0: 0, x1: *width, y1: *height };
        if !side.contains(width) || !side.contains(height) {
            Err(SettingsError::FilmSize(*width, *height))
        } else if crop.x0 >= crop.x1 || crop.y0 >= crop.y1 || !whole.contains(crop) {
            Err(SettingsError::Crop(*crop))
        } else if self.spp == 0 {
            Err(SettingsError::NoSamples)
        } else if self.half != Half::Both && self.spp > 1 << 31 {
            Err(SettingsError::HalfSamples(self.spp))
        } else if self.integrator.max_depth == Some(0) {
            Err(SettingsError::NoDepth)
        } else if !(radius > 0.0 && radius <= FILTER_RADIUS_MAX) {
            Err(SettingsError::FilterRadius(radius))
        } else if let Filter::Mitchell { b, c } = *filter
            && !((0.0..=1.0).contains(&b) && (0.0..=1.0).contains(&c))
        {
            Err(SettingsError::FilterShape { b, c })
        } else if self.scale_exponent.abs() > SCALE_EXPONENT_MAX {
            Err(SettingsError::Scale(self.scale_exponent))
        } else {
            Ok(())
        }
    }
}

impl Filter {
    /// Distance from the centre beyond which the filter is zero, along each axis, in pixels.
    pub fn radius(&self) -> f32 {
        match self {
            Filter::Box => 0.5,
            Filter::Tent { radius } => *radius,
            Filter::Gaussian { stddev } => 4.0 * stddev,
            Filter::Mitchell { .. } | Filter::CatmullRom => 2.0,
            Filter::Lanczos { lobes } => *lobes,
        }
    }
}
