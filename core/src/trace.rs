//! A unit of work: the samples of a tile, traced.

mod pilot;

use crate::bvh::Ray;
use crate::bvh::simd::{Isa, Kernel, Lanes, Portable};
use crate::camera::{Camera, CameraRay};
use crate::film::{RadianceError, TileSums};
use crate::filter::{FilterTable, box_sample};
use crate::integrator::reuse::{BLOCK, is_possible};
use crate::integrator::rows::{Vec3s, WIDTH};
use crate::integrator::{Estimator, Paths, Start, Tag, Tally};
use crate::sampler::{Sampler, Samplers};
use crate::settings::{SamplerKind, Settings, SettingsError, Window};
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
    /// Whether paths are reused.
    reuses: bool,
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
    /// Joins a world with settings. `isa` chooses among instruction sets; all give the same bits. Where paths may be reused, a
    /// few samples tell whether that pays; the answer depends on nothing but the two.
    ///
    /// # Errors
    /// Settings outside their ranges.
    pub fn new(world: Arc<World>, settings: Settings, isa: Isa) -> Result<Self, SettingsError> {
        let mut tracer = Self::with_reuse(world, settings, isa, true)?;
        tracer.reuses = tracer.reuses && pilot::reuse_pays(&tracer);
        Ok(tracer)
    }

    /// As [`Tracer::new`], but paths are reused if `reuse` says so and they may be, pay it or not.
    ///
    /// # Errors
    /// Settings outside their ranges.
    pub fn with_reuse(world: Arc<World>, settings: Settings, isa: Isa, reuse: bool) -> Result<Self, SettingsError> {
        settings.validate()?;
        let camera = Camera::new(&world.sensor, &settings.film);
        let filter = FilterTable::new(settings.film.filter);
        let reuses = reuse && is_possible(&settings);
        Ok(Self { world, settings, camera, filter, isa, reuses })
    }

    /// Whether paths are reused.
    pub fn reuses(&self) -> bool {
        self.reuses
    }

    /// Traces samples `samples` of every pixel of `tile`, on the calling thread. `None` if `stop` was set meanwhile.
    ///
    /// # Errors
    /// The first sample that is not finite or out of range.
    pub fn trace(&self, tile: Window, samples: Range<u32>, stop: &AtomicBool) -> Result<Option<TileSums>, SampleError> {
        self.isa.dispatch(TraceTile { tracer: self, tile, samples, stop }).0
    }

    /// Traces one sample again and tells what happened on its path: the very sample that [`Tracer::trace`] adds, its radiance
    /// as it goes to the film, be it fit for that or not.
    pub fn replay(&self, x: u32, y: u32, index: u32) -> (Vec3, Vec<Event>) {
        let (mut starts, mut own) = (Vec::new(), 0);
        for [px, py] in self.block_of(x, y) {
            if [px, py] == [x, y] {
                own = starts.len();
            }
            let (ray, sampler, weight) = self.lens().ray(px, py, index, self.settings.sampler, false);
            starts.push(Start { ray, sampler, tag: Tag { pixel: starts.len() as u32, index, weight }, more: 0 });
        }
        let count = starts.len() as u32;
        (1..).zip(&mut starts).for_each(|(n, start)| start.more = count - n);
        let (Ray { origin, direction, .. }, weight) = (starts[own].ray, starts[own].tag.weight);
        let mut record = Record { path: own, events: Vec::new() };
        record.see(own, || Event::Camera { origin, direction, weight });
        let mut group = One { starts: starts.into_iter(), own: own as u32, radiance: Vec3::ZERO };
        self.estimator().follow(Portable, &self.world, &mut group, &mut record);
        (group.radiance * weight, record.events)
    }

    /// The pixels that reuse each other's paths with this one, itself among them.
    fn block_of(&self, x: u32, y: u32) -> impl Iterator<Item = [u32; 2]> {
        let ([across, down], film) = (self.block(), &self.settings.film);
        let (x0, y0) = (x / across * across, y / down * down);
        let (x1, y1) = ((x0 + across).min(film.width), (y0 + down).min(film.height));
        (y0..y1).flat_map(move |y| (x0..x1).map(move |x| [x, y]))
    }

    /// The size of the blocks of pixels that reuse each other's paths.
    fn block(&self) -> [u32; 2] {
        if self.reuses { BLOCK } else { [1, 1] }
    }

    fn estimator(&self) -> Estimator {
        let Settings { integrator, strategy, without, offsets, .. } = self.settings;
        Estimator { integrator, strategy, without, offsets, reuses: self.reuses }
    }

    #[inline(always)]
    fn lens(&self) -> Lens<'_> {
        let Settings { film, seed, spp, .. } = &self.settings;
        Lens {
            camera: self.camera.clone(),
            filter: &self.filter,
            size: [film.width, film.height],
            seed: *seed,
            spp: *spp,
        }
    }
}

/// Stands for a pixel outside of the tile, whose path is reused within it.
const OUTSIDE: u32 = u32::MAX;

/// What makes camera rays.
#[derive(Clone)]
struct Lens<'a> {
    camera: Camera,
    filter: &'a FilterTable,
    size: [u32; 2],
    seed: u64,
    spp: u32,
}

impl Lens<'_> {
    /// A pinhole and the box filter, which most renders have.
    fn is_simple(&self) -> bool {
        self.filter.is_box() && self.camera.is_pinhole()
    }

    /// The ray of a sample, its random numbers, and its weight. `kind` is the settings'; a caller that names it, or knows that
    /// all [`Lens::is_simple`], gets a loop without what that does not need.
    #[inline(always)]
    fn ray(&self, x: u32, y: u32, index: u32, kind: SamplerKind, is_simple: bool) -> (Ray, Sampler, f32) {
        let sampler = Sampler::new(kind, self.seed, x, y, index, self.spp);
        let u = sampler.film();
        let ((film_x, weight_x), (film_y, weight_y)) = if is_simple {
            (box_sample(x, u.x), box_sample(y, u.y))
        } else {
            (self.filter.sample(x, self.size[0], u.x), self.filter.sample(y, self.size[1], u.y))
        };
        let film = Vec2::new(film_x, film_y);
        let CameraRay { origin, direction, t_max } =
            if is_simple { self.camera.pinhole_ray(film) } else { self.camera.ray(film, || sampler.lens()) };
        (Ray { origin, direction, t_max }, sampler, weight_x * weight_y)
    }
}

/// A single path, and those that its pixel reuses.
struct One {
    starts: std::vec::IntoIter<Start>,
    own: u32,
    radiance: Vec3,
}

impl Paths for One {
    fn start<L: Lanes>(&mut self, _: L) -> Option<Start> {
        self.starts.next()
    }

    fn end(&mut self, tag: Tag, radiance: Vec3) {
        if tag.pixel == self.own {
            self.radiance = radiance;
        }
    }
}

/// The paths of a tile, in the order of its blocks of pixels, their samples, and the pixels of each.
struct TilePaths<'a> {
    tracer: &'a Tracer,
    stop: &'a AtomicBool,
    sums: TileSums,
    /// The pixels that reuse each other's paths, and the blocks of them that lie within the tile, wholly or in part.
    block: [u32; 2],
    blocks: Window,
    /// What comes next: the block, counted among those, and the index of the sample.
    next: (u32, u32),
    is_stopped: bool,
    /// The first sample without a value, as far as is known: its pixel and index.
    failed: Option<(u32, u32, RadianceError)>,
    /// Made ready in advance, many at a time.
    ready: Box<Ready<'a>>,
    /// Those of them that have not begun yet.
    waiting: Range<usize>,
}

/// Beginnings of paths.
struct Ready<'a> {
    lens: Lens<'a>,
    kind: SamplerKind,
    pixel: [u32; WIDTH],
    index: [u32; WIDTH],
    more: [u32; WIDTH],
    x: [u32; WIDTH],
    y: [u32; WIDTH],
    weight: [f32; WIDTH],
    origin: Vec3s,
    direction: Vec3s,
    t_max: [f32; WIDTH],
    samplers: Samplers<WIDTH>,
}

impl<'a> TilePaths<'a> {
    fn new(tracer: &'a Tracer, tile: Window, samples: Range<u32>, stop: &'a AtomicBool) -> Self {
        let next = (0, samples.start);
        let ready = Box::new(Ready {
            lens: tracer.lens(),
            kind: tracer.settings.sampler,
            pixel: [0; WIDTH],
            index: [0; WIDTH],
            more: [0; WIDTH],
            x: [0; WIDTH],
            y: [0; WIDTH],
            weight: [0.0; WIDTH],
            origin: Vec3s::ZERO,
            direction: Vec3s::ZERO,
            t_max: [0.0; WIDTH],
            samplers: Samplers::NONE,
        });
        let block @ [across, down] = tracer.block();
        let blocks = Window {
            x0: tile.x0 / across,
            y0: tile.y0 / down,
            x1: tile.x1.div_ceil(across),
            y1: tile.y1.div_ceil(down),
        };
        let sums = TileSums::new(tile, samples);
        Self { tracer, stop, sums, block, blocks, next, is_stopped: false, failed: None, ready, waiting: 0..0 }
    }

    /// Makes the next paths ready.
    #[inline(always)]
    fn make_ready<L: Lanes>(&mut self, lanes: L) {
        let (tile, samples, half) = (self.sums.tile, self.sums.samples.clone(), self.tracer.settings.half);
        let ([across, down], film) = (self.block, &self.tracer.settings.film);
        let mut count = 0;
        while count + (across * down) as usize <= WIDTH
            && u64::from(self.next.0) < self.blocks.area()
            && !samples.is_empty()
        {
            let (block, own) = self.next;
            if own == samples.start && self.stop.load(Ordering::Relaxed) {
                self.is_stopped = true;
                break;
            }
            let (column, row) = (block % self.blocks.width(), block / self.blocks.width());
            let (left, top) = ((self.blocks.x0 + column) * across, (self.blocks.y0 + row) * down);
            let begin = count;
            for y in top..(top + down).min(film.height) {
                for x in left..(left + across).min(film.width) {
                    let ready = &mut *self.ready;
                    let is_inside = (tile.x0..tile.x1).contains(&x) && (tile.y0..tile.y1).contains(&y);
                    let pixel = if is_inside { (y - tile.y0) * tile.width() + (x - tile.x0) } else { OUTSIDE };
                    (ready.x[count], ready.y[count]) = (x, y);
                    (ready.pixel[count], ready.index[count]) = (pixel, half.index(own));
                    count += 1;
                }
            }
            for i in begin..count {
                self.ready.more[i] = (count - 1 - i) as u32;
            }
            self.next = if own + 1 == samples.end { (block + 1, samples.start) } else { (block, own + 1) };
        }
        lanes.run(Cameras(&mut self.ready));
        self.waiting = 0..count;
    }

    /// When a sample begins among the others.
    fn order(&self, pixel: u32, index: u32) -> (u32, u32, u32) {
        let (tile, [across, down]) = (self.sums.tile, self.block);
        let (x, y) = (tile.x0 + pixel % tile.width(), tile.y0 + pixel / tile.width());
        let (column, row) = (x / across - self.blocks.x0, y / down - self.blocks.y0);
        (row * self.blocks.width() + column, index, pixel)
    }

    fn finish(self) -> Result<Option<TileSums>, SampleError> {
        if let Some((pixel, index, error)) = self.failed {
            let Window { x0, y0, x1, .. } = self.sums.tile;
            return Err(SampleError { x: x0 + pixel % (x1 - x0), y: y0 + pixel / (x1 - x0), index, error });
        }
        Ok((!self.is_stopped).then_some(self.sums))
    }
}

impl Paths for TilePaths<'_> {
    #[inline(always)]
    fn start<L: Lanes>(&mut self, lanes: L) -> Option<Start> {
        // Paths begin in order: when one has failed, whatever comes before it is under way.
        if self.failed.is_some() || self.is_stopped {
            return None;
        }
        if self.waiting.is_empty() {
            self.make_ready(lanes);
        }
        let i = self.waiting.next()?;
        let ready = &*self.ready;
        let ray = Ray { origin: ready.origin.at(i), direction: ready.direction.at(i), t_max: ready.t_max[i] };
        let Settings { sampler, spp, .. } = self.tracer.settings;
        let sampler = ready.samplers.at(i, 0, sampler, &Sampler::new(sampler, 0, 0, 0, 0, spp));
        Some(Start {
            ray,
            sampler,
            tag: Tag { pixel: ready.pixel[i], index: ready.index[i], weight: ready.weight[i] },
            more: ready.more[i],
        })
    }

    #[inline(always)]
    fn end(&mut self, Tag { pixel, index, weight }: Tag, radiance: Vec3) {
        if pixel == OUTSIDE {
            return;
        }
        let scale_exponent = self.tracer.settings.scale_exponent;
        let added = self.sums.pixels[pixel as usize].add(index, radiance * weight, scale_exponent);
        if let Err(error) = added
            && self.failed.is_none_or(|(other, its, _)| self.order(pixel, index) < self.order(other, its))
        {
            self.failed = Some((pixel, index, error));
        }
    }
}

/// Makes camera rays and samplers for the pixels and samples that are given.
struct Cameras<'a, 'b>(&'a mut Ready<'b>);

impl Cameras<'_, '_> {
    #[inline(always)]
    fn make(self, kind: SamplerKind, is_simple: bool) {
        let ready = self.0;
        let lens = ready.lens.clone();
        for i in 0..WIDTH {
            let (ray, sampler, weight) = lens.ray(ready.x[i], ready.y[i], ready.index[i], kind, is_simple);
            ready.origin.set(i, ray.origin);
            ready.direction.set(i, ray.direction);
            ready.t_max[i] = ray.t_max;
            ready.samplers.set(i, &sampler);
            ready.weight[i] = weight;
        }
    }
}

impl Kernel for Cameras<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        // A loop of its own for what is usual, which becomes one of vectors.
        match (self.0.kind, self.0.lens.is_simple()) {
            (SamplerKind::Sobol, true) => self.make(SamplerKind::Sobol, true),
            (kind, is_simple) => self.make(kind, is_simple),
        }
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
    type Output = (Result<Option<TileSums>, SampleError>, Tally);

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) -> Self::Output {
        let Self { tracer, tile, samples, stop } = self;
        let mut paths = TilePaths::new(tracer, tile, samples, stop);
        let tally = tracer.estimator().follow(lanes, &tracer.world, &mut paths, &mut Nobody);
        (paths.finish(), tally)
    }
}
