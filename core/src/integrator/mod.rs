//! The estimator: L ≈ 1/N Σ f(wi, wo) Li(wi) |cos θ| / p(wi), along one random path a sample.
//!
//! One loop serves every integrator and strategy. At each surface the path gains what is emitted there, light sampled by
//! next-event estimation, and one continuation; where the two ways to find a light compete, multiple importance sampling
//! weighs them (Veach & Guibas 1995). The integrators differ in where a path ends:
//!
//! - `path`: where it leaves the scene, at the depth limit, or by Russian roulette;
//! - `direct`: one segment after the first surface, so that light is scattered once;
//! - `whitted`: one segment after the first surface that is neither mirror nor glass.

mod arrive;
mod coats;
pub(crate) mod reuse;
pub(crate) mod rows;
mod scatter;
mod sky;
mod wave;

use crate::bsdf::Sample;
use crate::bvh::Ray;
use crate::bvh::simd::Lanes;
use crate::sampler::Sampler;
use crate::settings::{Integrator, IntegratorKind, Offsets, Strategy, Without};
use crate::shading::Shading;
use crate::surface::Surface;
use crate::warp::{UNIFORM_HEMISPHERE_PDF, cosine_hemisphere, cosine_hemisphere_pdf, uniform_hemisphere};
use crate::witness::Witness;
use crate::world::World;
use glam::{Vec2, Vec3};
use reuse::{GROUP, Groups};
use rows::WIDTH;
use wave::{Rules, State, Wave};

/// The largest probability to go on under Russian roulette, so that a path in a lossless scene ends some day.
const CONTINUATION_MAX: f32 = 0.95;

/// Samples of direct light a path under `direct`. What leads to the surface costs about as much as one of them and varies less; a
/// power of two keeps points in nets. (Under `path`, where a branch has many surfaces, it gained a fifth in the Cornell box and
/// lost a third in rooms: there a path never branches.)
const BRANCHES: u32 = 4;

/// Emitters in a row that a camera ray passes when they are hidden. A ray within the plane of one may meet it again and again.
const HIDDEN_MAX: u32 = 1 << 12;

/// Surfaces before early roulette. After the first alone it costs where that leads to bright light.
const EARLY_DEPTH: u32 = 2;
/// Early roulette lets a path go on with this many times its throughput. Measured from 1.5 to 3: less ends more paths than pays.
const EARLY_CONTRIBUTION: f32 = 2.5;

/// What is estimated, and how.
#[derive(Clone, Copy, Debug)]
pub struct Estimator {
    /// Which light transport is counted.
    pub integrator: Integrator,
    /// Where directions come from.
    pub strategy: Strategy,
    /// What saves work and shall not.
    pub without: Without,
    /// Where rays leave surfaces.
    pub offsets: Offsets,
    /// Whether paths are reused: only where [`reuse::is_possible`].
    pub reuses: bool,
}

/// How a ray came about: what weighs an emitter that it finds.
#[derive(Clone, Copy, Debug)]
struct Origin {
    /// Where it starts.
    position: Vec3,
    /// The shading normal there.
    normal: Vec3,
    /// Density of its direction, in solid angle; infinite where light sampling could not have found it.
    pdf: f32,
}

/// What a path is for.
#[derive(Clone, Copy, Debug)]
pub struct Tag {
    /// The pixel, by whoever counts pixels.
    pub pixel: u32,
    /// The sample's index.
    pub index: u32,
    /// Its weight.
    pub weight: f32,
}

/// What was done: an estimate of the cost that does not depend on the machine.
#[derive(Clone, Copy, Debug, Default)]
pub struct Tally {
    /// Surfaces that scattered paths.
    pub surfaces: u64,
    /// Rays that connected paths with the first surfaces of others.
    pub links: u64,
}

/// Where a path begins.
#[derive(Clone, Copy, Debug)]
pub struct Start {
    /// The camera's ray.
    pub ray: Ray,
    /// The random numbers.
    pub sampler: Sampler,
    /// Comes back with the path's radiance.
    pub tag: Tag,
    /// So many paths of the same group come next: of the same sample, in pixels that reuse each other's paths.
    pub more: u32,
}

/// Where paths come from, and where their radiance goes.
pub trait Paths {
    /// The next path, if there is one.
    fn start<L: Lanes>(&mut self, lanes: L) -> Option<Start>;
    /// Takes the radiance of a path that has ended.
    fn end(&mut self, tag: Tag, radiance: Vec3);
}

impl Estimator {
    /// Follows all paths there are, many at a time. Their samplers differ in nothing but seed, pixel and index; a path's radiance
    /// does not depend on those of other groups.
    #[inline(always)]
    pub fn follow<L: Lanes>(
        &self,
        lanes: L,
        world: &World,
        paths: &mut impl Paths,
        witness: &mut impl Witness,
    ) -> Tally {
        let mut first = paths.start(lanes);
        let Some(Start { sampler: like, tag, .. }) = first else { return Tally::default() };
        let branches = self.integrator.kind == IntegratorKind::Direct && !self.without.splitting;
        let mut wave = Wave::new(self.rules(), tag, branches);
        wave.groups = self.reuses.then(Groups::new);
        while self.refill(lanes, &mut wave, &mut first, paths, witness) {
            self.arrive(lanes, world, &mut wave, &like, witness);
            if !branches {
                self.meet(lanes, world, &mut wave, witness);
                self.scatter(lanes, world, &mut wave, &like, None, witness);
                continue;
            }
            wave.fork(1.0 / BRANCHES as f32);
            for branch in 0..BRANCHES {
                wave.begin_branch(branch, BRANCHES, witness);
                self.scatter(lanes, world, &mut wave, &like, Some(branch), witness);
                self.arrive(lanes, world, &mut wave, &like, witness);
            }
        }
        wave.tally
    }

    /// Hands over the radiance of paths that have ended, and begins others in their places, `first` before all; whether there are any.
    #[inline(always)]
    fn refill<L: Lanes>(
        &self,
        lanes: L,
        wave: &mut Wave,
        first: &mut Option<Start>,
        paths: &mut impl Paths,
        witness: &mut impl Witness,
    ) -> bool {
        let mut idle = 0;
        for i in 0..WIDTH {
            if wave.state[i] == State::End {
                wave.state[i] = State::Idle;
                let (seat, radiance) = (wave.seats[i], wave.radiance.at(i));
                match &mut wave.groups {
                    Some(groups) => groups.end(seat, radiance, |tag, radiance| paths.end(tag, radiance), witness),
                    None => paths.end(wave.tags[i], radiance),
                }
            }
            if wave.state[i] == State::Idle {
                wave.chosen[idle] = i;
                idle += 1;
            }
        }
        let room = if wave.groups.is_some() { GROUP } else { 1 };
        let (mut begun, mut more) = (0, 0);
        while (more > 0 || idle - begun >= room)
            && let Some(start) = first.take().or_else(|| paths.start(lanes))
        {
            let i = wave.chosen[begun];
            if let Some(groups) = &mut wave.groups {
                wave.seats[i] = groups.seat(i, start.tag, more > 0);
            }
            more = start.more;
            self.begin(wave, i, start);
            begun += 1;
        }
        idle < WIDTH || begun > 0
    }

    #[inline(always)]
    fn begin(&self, wave: &mut Wave, i: usize, Start { ray, sampler, tag, .. }: Start) {
        wave.tags[i] = tag;
        wave.samplers.set(i, &sampler);
        wave.begin(i, &ray, self.max_depth().is_some_and(|max| max <= 1));
    }

    /// The longest path, where it does not follow from the integrator.
    #[inline(always)]
    fn max_depth(&self) -> Option<u32> {
        self.integrator.max_depth.filter(|_| self.integrator.kind != IntegratorKind::Direct)
    }

    /// When paths end.
    #[inline(always)]
    fn rules(&self) -> Rules {
        let early_depth = if self.without.early_roulette { u32::MAX } else { EARLY_DEPTH };
        Rules {
            is_direct: self.integrator.kind == IntegratorKind::Direct,
            is_whitted: self.integrator.kind == IntegratorKind::Whitted,
            max_depth: self.max_depth().unwrap_or(u32::MAX),
            roulette: Roulette { early_depth, depth: self.integrator.rr_depth },
        }
    }

    /// Radiance from beyond the scene, and its weight.
    #[inline(always)]
    fn background(&self, world: &World, origin: Origin, wi: Vec3) -> Option<(Vec3, f32)> {
        let (radiance, pdf) = world.lights.background(&world.textures, wi, self.strategy == Strategy::Mis)?;
        Some((radiance, self.weight_of_hit(origin, pdf)))
    }

    /// Radiance emitted by the surface that was hit, and its weight.
    #[inline(always)]
    fn emitted(&self, world: &World, surface: &Surface, light: u32, origin: Origin, wo: Vec3) -> (Vec3, f32) {
        let emitted = world.lights.emitted(&world.textures, surface, light, wo);
        if emitted == Vec3::ZERO || self.strategy != Strategy::Mis || origin.pdf == f32::INFINITY {
            return (emitted, self.weight_of_hit(origin, 0.0));
        }
        let light_pdf = world.lights.pdf(&world.geometry, origin.position, origin.normal, surface, light);
        (emitted, self.weight_of_hit(origin, light_pdf))
    }

    /// The weight of a light that a ray hit: one where next-event estimation could not have found it or is not used.
    #[inline(always)]
    fn weight_of_hit(&self, origin: Origin, light_pdf: f32) -> f32 {
        match self.strategy {
            _ if origin.pdf == f32::INFINITY => 1.0,
            Strategy::Uniform | Strategy::Cosine | Strategy::Bsdf => 1.0,
            Strategy::Light => 0.0,
            Strategy::Mis => power_heuristic(origin.pdf, light_pdf),
        }
    }

    /// One direction to go on, by the strategy. Mirrors and glass have theirs whatever the strategy.
    #[inline(always)]
    fn continuation(&self, shading: &Shading, wo: Vec3, lobe: f32, u: Vec2) -> Option<Sample> {
        let delta_share = shading.closure.delta_share(wo);
        let (mut wi, mut pdf) = match self.strategy {
            _ if lobe < delta_share => return shading.sample(wo, lobe, u),
            Strategy::Bsdf | Strategy::Light | Strategy::Mis => return shading.sample(wo, lobe, u),
            Strategy::Uniform => (uniform_hemisphere(u), UNIFORM_HEMISPHERE_PDF),
            Strategy::Cosine => {
                let wi = cosine_hemisphere(u);
                (wi, cosine_hemisphere_pdf(wi.z))
            }
        };
        if shading.closure.transmits() {
            // Half of the directions on the other side.
            wi.z = if lobe < 0.5 { -wi.z } else { wi.z };
            pdf *= 0.5;
        }
        pdf *= 1.0 - delta_share;
        (pdf > 0.0).then(|| Sample { wi, weight: shading.eval(wo, wi).value / pdf, pdf, eta: 1.0 })
    }
}

/// The depths from which paths end by chance.
#[derive(Clone, Copy, Debug)]
struct Roulette {
    early_depth: u32,
    depth: u32,
}

impl Roulette {
    /// The probability of a path to go on.
    #[inline(always)]
    fn survival(self, throughput: Vec3, eta: f32, depth: u32) -> f32 {
        // The radiance scale of refraction (eta²) undoes itself when the path leaves the glass.
        let expected = throughput.max_element() * eta * eta;
        let early = if depth >= self.early_depth { EARLY_CONTRIBUTION * expected } else { 1.0 };
        if depth >= self.depth { early.min(expected).min(CONTINUATION_MAX) } else { early }
    }
}

/// Veach's power heuristic with β = 2, for one sample of each technique; `a` may be infinite.
#[inline(always)]
fn power_heuristic(a: f32, b: f32) -> f32 {
    if a == f32::INFINITY {
        return 1.0;
    }
    let ratio = b / a;
    1.0 / (1.0 + ratio * ratio)
}
