//! What happens along a path, for those who want to see it.
//!
//! The integrator tells everything to a [`Witness`]. In renders that is [`Nobody`], and what would have been told is never
//! computed; in a replay it is a [`Record`]. Whoever watches changes no bit of the sample.

use crate::surface::Surface;
use glam::Vec3;

/// Something that happened, in the order of the path.
#[derive(Clone, Copy, Debug)]
pub enum Event {
    /// A ray left the camera.
    Camera {
        /// Where it starts.
        origin: Vec3,
        /// Unit direction.
        direction: Vec3,
        /// Weight of the sample by the pixel filter.
        weight: f32,
    },
    /// The path met a surface.
    Hit {
        /// Surfaces before this one.
        depth: u32,
        /// The point.
        surface: Surface,
        /// Product of all weights so far.
        throughput: Vec3,
    },
    /// What was met shines: a surface that emits, or the background.
    Emission {
        /// Radiance towards the path.
        radiance: Vec3,
        /// Its weight beside light sampling.
        mis: f32,
        /// Density of the direction that found it, in solid angle; infinite from cameras and mirrors.
        pdf: f32,
        /// What the sample gained: throughput · mis · radiance.
        gained: Vec3,
    },
    /// The path begins again at the last surface, with other random numbers.
    Branch {
        /// Counted from 1.
        number: u32,
        /// How many there are; each has so small a part in the sample.
        of: u32,
    },
    /// A light was sampled.
    Light {
        /// Unit direction to it.
        wi: Vec3,
        /// Density of the light's point, in solid angle; infinite for lights that only sampling finds.
        pdf: f32,
        /// Density with which the material would have found `wi`.
        bsdf_pdf: f32,
        /// Its weight beside BSDF sampling.
        mis: f32,
        /// Whether the way was free.
        visible: bool,
        /// What the sample gained.
        gained: Vec3,
    },
    /// A direction was chosen to go on.
    Continuation {
        /// Unit direction, in scene coordinates.
        wi: Vec3,
        /// Density in solid angle; infinite for mirrors and smooth glass.
        pdf: f32,
        /// f·|cos θ| / pdf.
        weight: Vec3,
    },
    /// Russian roulette was played.
    Roulette {
        /// Probability to go on.
        survival: f32,
        /// Whether the path goes on.
        survived: bool,
    },
    /// From here on the path is one of several for each pixel of a block: what it finds counts so much for its own.
    Shared {
        /// The weight, within `gained` of what follows.
        weight: Vec3,
    },
    /// The path is over.
    End(Cause),
    /// What the other paths of the block found for this pixel.
    Others {
        /// What the sample gained.
        gained: Vec3,
    },
}

/// Why a path ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// It left the scene.
    Escaped,
    /// Its last segment, as far as the integrator asks for one, leads to nothing that shines.
    Dark,
    /// It has as many segments as the integrator asks for.
    Depth,
    /// The material absorbed it.
    Absorbed,
    /// It lost at Russian roulette.
    Roulette,
}

/// Who watches paths.
pub trait Witness {
    /// Is told what happened on a path, by its number. `event` is called only by those who look.
    fn see(&mut self, path: usize, event: impl FnOnce() -> Event);
}

/// Nobody watches: nothing is computed for it.
#[derive(Clone, Copy, Debug)]
pub struct Nobody;

impl Witness for Nobody {
    #[inline(always)]
    fn see(&mut self, _: usize, _: impl FnOnce() -> Event) {}
}

/// Keeps all that happened on one path.
#[derive(Clone, Debug, Default)]
pub struct Record {
    /// Which.
    pub path: usize,
    /// What happened.
    pub events: Vec<Event>,
}

impl Witness for Record {
    fn see(&mut self, path: usize, event: impl FnOnce() -> Event) {
        if path == self.path {
            self.events.push(event());
        }
    }
}
