//! A unit of work: the samples of a tile, traced.

use crate::bvh::Ray;
use crate::bvh::simd::{Isa, Kernel, Lanes, Portable};
use crate::camera::Camera;
use crate::film::{RadianceError, TileSums};
use crate::filter::FilterTable;
use crate::integrator::Estimator;
use crate::sampler::Sampler;
use crate::settings::{Settings, SettingsError, Window};
use crate::witness::{Event, Nobody, Record, Witness};
use crate::world::World;
use glam::{Vec2, Vec3};
use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// A world and how to render it: ready to trace units of work, from any number of threads.
pub struct Tracer {
    world: Arc<World>,
    settings: Settings,
    camera: Camera,
    filter: FilterTable,
    isa: Isa,
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
    /// Joins a world with settings. `isa` chooses among instruction sets; all give the same bits.
    ///
    /// # Errors
    /// Settings outside their ranges.
    pub fn new(world: Arc<World>, settings: Settings, isa: Isa) -> Result<Self, SettingsError> {
        settings.validate()?;
        let camera = Camera::new(&world.sensor, &settings.film);
        let filter = FilterTable::new(settings.film.filter);
        Ok(Self { world, settings, camera, filter, isa })
    }

    /// Traces samples `samples` of every pixel of `tile`, on the calling thread. `None` if `stop` was set meanwhile.
    ///
    /// # Errors
    /// The first sample that is not finite or out of range.
    pub fn trace(&self, tile: Window, samples: Range<u32>, stop: &AtomicBool) -> Result<Option<TileSums>, SampleError> {
        self.isa.dispatch(TraceTile { tracer: self, tile, samples, stop })
    }

    /// Traces one sample again and tells what happened on its path: the very sample that [`Tracer::trace`] adds, its radiance
    /// as it goes to the film, be it fit for that or not.
    pub fn replay(&self, x: u32, y: u32, index: u32) -> (Vec3, Vec<Event>) {
        let mut record = Record::default();
        let radiance = self.sample(Portable, &self.estimator(), x, y, index, &mut record);
        (radiance, record.0)
    }

    fn estimator(&self) -> Estimator {
        let Settings { integrator, strategy, without, .. } = self.settings;
        Estimator { integrator, strategy, without }
    }

    /// One sample of one pixel: the same value wherever and whenever it is asked for.
    #[inline(always)]
    fn sample<L: Lanes>(
        &self,
        lanes: L,
        estimator: &Estimator,
        x: u32,
        y: u32,
        index: u32,
        witness: &mut impl Witness,
    ) -> Vec3 {
        let Settings { film, seed, sampler, spp, .. } = &self.settings;
        let sampler = Sampler::new(*sampler, *seed, x, y, index, *spp);
        let u = sampler.film();
        let (film_x, weight_x) = self.filter.sample(x, film.width, u.x);
        let (film_y, weight_y) = self.filter.sample(y, film.height, u.y);
        let camera_ray = self.camera.ray(Vec2::new(film_x, film_y), || sampler.lens());
        let ray = Ray { origin: camera_ray.origin, direction: camera_ray.direction, t_max: camera_ray.t_max };
        let weight = weight_x * weight_y;
        witness.see(|| Event::Camera { origin: ray.origin, direction: ray.direction, weight });
        estimator.radiance(lanes, &self.world, ray, sampler, witness) * weight
    }
}

/// The whole loop over a tile, compiled once for each instruction set.
struct TraceTile<'a> {
    tracer: &'a Tracer,
    tile: Window,
    samples: Range<u32>,
    stop: &'a AtomicBool,
}

impl Kernel for TraceTile<'_> {
    type Output = Result<Option<TileSums>, SampleError>;

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) -> Self::Output {
        let Self { tracer, tile, samples, stop } = self;
        let (estimator, scale_exponent) = (tracer.estimator(), tracer.settings.scale_exponent);
        let (mut sums, half) = (TileSums::new(tile, samples.clone()), tracer.settings.half);
        let positions = (tile.y0..tile.y1).flat_map(|y| (tile.x0..tile.x1).map(move |x| (x, y)));
        for ((x, y), pixel) in positions.zip(&mut sums.pixels) {
            if stop.load(Ordering::Relaxed) {
                return Ok(None);
            }
            for own in samples.clone() {
                let index = half.index(own);
                let radiance = tracer.sample(lanes, &estimator, x, y, index, &mut Nobody);
                pixel.add(index, radiance, scale_exponent).map_err(|error| SampleError { x, y, index, error })?;
            }
        }
        Ok(Some(sums))
    }
}
