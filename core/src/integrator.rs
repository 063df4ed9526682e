//! The estimator: L ≈ 1/N Σ f(wi, wo) Li(wi) |cos θ| / p(wi), along one random path a sample.
//!
//! One loop serves every integrator and strategy. At each surface the path gains what is emitted there, light sampled by
//! next-event estimation, and one continuation; where the two ways to find a light compete, multiple importance sampling
//! weighs them (Veach & Guibas 1995). The integrators differ in where a path ends:
//!
//! - `path`: where it leaves the scene, at the depth limit, or by Russian roulette;
//! - `direct`: one segment after the first surface, so that light is scattered once;
//! - `whitted`: one segment after the first surface that is neither mirror nor glass.

use crate::bsdf::Sample;
use crate::bvh::Ray;
use crate::bvh::simd::Lanes;
use crate::sampler::{Sampler, Slot};
use crate::settings::{Integrator, IntegratorKind, Strategy, Without};
use crate::shading::Shading;
use crate::surface::Surface;
use crate::warp::{UNIFORM_HEMISPHERE_PDF, cosine_hemisphere, cosine_hemisphere_pdf, uniform_hemisphere};
use crate::witness::{Cause, Event, Witness};
use crate::world::World;
use glam::{Vec2, Vec3};

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
/// Early roulette lets a path go on with this many times its throughput. Measured from 1 to 3: less gains more where paths are
/// long, and loses where they are cut by a depth limit anyway.
const EARLY_CONTRIBUTION: f32 = 1.5;

/// What is estimated, and how.
#[derive(Clone, Copy, Debug)]
pub struct Estimator {
    /// Which light transport is counted.
    pub integrator: Integrator,
    /// Where directions come from.
    pub strategy: Strategy,
    /// What saves work and shall not.
    pub without: Without,
}

/// How the ray in hand came about: what weighs an emitter that it finds.
#[derive(Clone, Copy, Debug)]
struct Origin {
    /// Where it starts.
    position: Vec3,
    /// The shading normal there.
    normal: Vec3,
    /// Density of its direction, in solid angle; infinite where light sampling could not have found it.
    pdf: f32,
}

/// A path as far as it has come.
#[derive(Clone, Copy, Debug)]
struct Path {
    ray: Ray,
    origin: Origin,
    /// Segments so far.
    depth: u32,
    /// f |cos θ| / p of all its surfaces.
    throughput: Vec3,
    /// Its part in the sample: less than one behind a [`Fan`].
    share: f32,
    /// Product of the relative indices of refraction.
    eta: f32,
    /// The ray in hand is the last: only what it finds shining matters.
    is_last: bool,
    sampler: Sampler,
}

impl Path {
    /// What the sample gains by light that the path found, of this weight beside light sampling.
    #[inline(always)]
    fn gain(&self, radiance: Vec3, mis: f32, witness: &mut impl Witness) -> Vec3 {
        let gained = self.throughput * self.share * (radiance * mis);
        witness.see(|| Event::Emission { radiance, mis, pdf: self.origin.pdf, gained });
        gained
    }
}

/// A surface that scatters a path.
#[derive(Clone, Copy, Debug)]
struct Vertex<'w> {
    surface: Surface,
    shading: Shading<'w>,
    /// Local.
    wo: Vec3,
    /// A random number for what of the closure answers.
    lobe: f32,
}

/// The branches of a path at the surface whose direct light is sampled several times. Their random numbers are those of so many
/// times the samples, well distributed among all branches of all samples.
#[derive(Clone, Copy, Debug)]
struct Fan<'w> {
    path: Path,
    vertex: Vertex<'w>,
    /// The next one.
    branch: u32,
}

impl<'w> Fan<'w> {
    #[inline(always)]
    fn next(&mut self) -> Option<(Path, Vertex<'w>)> {
        let branch = self.branch;
        self.branch += 1;
        // Shifted, so that each of them is as even over [0, 1) as the first, and together they are more so.
        let lobe = self.vertex.lobe + branch as f32 * (1.0 / BRANCHES as f32);
        let lobe = if lobe >= 1.0 { lobe - 1.0 } else { lobe };
        let sampler = self.path.sampler.branch(branch, BRANCHES);
        let path = Path { share: 1.0 / BRANCHES as f32, sampler, ..self.path };
        (branch < BRANCHES).then_some((path, Vertex { lobe, ..self.vertex }))
    }
}

impl Estimator {
    /// Radiance along a camera ray.
    #[inline(always)]
    pub fn radiance<L: Lanes>(
        &self,
        lanes: L,
        world: &World,
        ray: Ray,
        sampler: Sampler,
        witness: &mut impl Witness,
    ) -> Vec3 {
        let mut radiance = Vec3::ZERO;
        let mut path = Path {
            ray,
            origin: Origin { position: ray.origin, normal: Vec3::ZERO, pdf: f32::INFINITY },
            depth: 0,
            throughput: Vec3::ONE,
            share: 1.0,
            eta: 1.0,
            is_last: self.max_depth().is_some_and(|max| max <= 1),
            sampler,
        };
        let mut fan: Option<Fan> = None;
        let mut next = self.arrive(lanes, world, &mut path, &mut radiance, witness);
        loop {
            if let (Some(vertex), None) = (next, &fan)
                && self.integrator.kind == IntegratorKind::Direct
                && !self.without.splitting
                && !vertex.shading.closure.is_delta()
            {
                fan = Some(Fan { path, vertex, branch: 0 });
                next = None;
            }
            let vertex = match (next, &mut fan) {
                (Some(vertex), _) => vertex,
                (None, None) => return radiance,
                (None, Some(fan)) => {
                    let Some((from, vertex)) = fan.next() else { return radiance };
                    witness.see(|| Event::Branch { number: fan.branch, of: BRANCHES });
                    path = from;
                    vertex
                }
            };
            next = match self.scatter(lanes, world, &vertex, &mut path, &mut radiance, witness) {
                Ok(()) => self.arrive(lanes, world, &mut path, &mut radiance, witness),
                Err(cause) => {
                    witness.see(|| Event::End(cause));
                    None
                }
            };
        }
    }

    /// The longest path, where it does not follow from the integrator.
    #[inline(always)]
    fn max_depth(&self) -> Option<u32> {
        self.integrator.max_depth.filter(|_| self.integrator.kind != IntegratorKind::Direct)
    }

    /// Follows the path's ray and gains what shines there; the surface that is to scatter it, or none at the path's end.
    #[inline(always)]
    fn arrive<'w, L: Lanes>(
        &self,
        lanes: L,
        world: &'w World,
        path: &mut Path,
        radiance: &mut Vec3,
        witness: &mut impl Witness,
    ) -> Option<Vertex<'w>> {
        let hidden = path.depth == 0 && self.integrator.hide_emitters;
        let surface = match next_surface(lanes, world, &mut path.ray, hidden, path.is_last && !self.without.blind_ends)
        {
            Next::Surface(surface) => surface,
            Next::Dark => {
                witness.see(|| Event::End(Cause::Dark));
                return None;
            }
            Next::Background => {
                if !hidden && let Some((emitted, mis)) = self.background(world, path.origin, path.ray.direction) {
                    *radiance += path.gain(emitted, mis, witness);
                }
                witness.see(|| Event::End(Cause::Escaped));
                return None;
            }
        };
        witness.see(|| Event::Hit { depth: path.depth, surface, throughput: path.throughput });
        let wo = -path.ray.direction;
        if let Some(light) = surface.light {
            let (emitted, mis) = self.emitted(world, &surface, light, path.origin, wo);
            *radiance += path.gain(emitted, mis, witness);
        }
        if path.is_last {
            witness.see(|| Event::End(Cause::Depth));
            return None;
        }
        path.sampler.at_surface(path.depth);
        let mut lobe = if world.materials.has_lobes(surface.shape) { path.sampler.one(Slot::Lobe) } else { 0.0 };
        let shading = world.materials.at(&world.geometry, &world.textures, &surface, wo, &mut lobe);
        let wo = shading.frame.to_local(wo);
        Some(Vertex { surface, shading, wo, lobe })
    }

    /// Gains light that the surface scatters, and gives the path its next ray, or says why it ends.
    #[inline(always)]
    fn scatter<L: Lanes>(
        &self,
        lanes: L,
        world: &World,
        vertex: &Vertex,
        path: &mut Path,
        radiance: &mut Vec3,
        witness: &mut impl Witness,
    ) -> Result<(), Cause> {
        let Vertex { surface, shading, wo, lobe } = vertex;
        if matches!(self.strategy, Strategy::Light | Strategy::Mis) && !shading.closure.is_delta() {
            *radiance += self.direct(lanes, world, vertex, path, witness);
        }
        let next = self.continuation(shading, *wo, *lobe, path.sampler.two(Slot::Direction)).ok_or(Cause::Absorbed)?;
        let wi = shading.frame.to_world(next.wi);
        witness.see(|| Event::Continuation { wi, pdf: next.pdf, weight: next.weight });
        path.throughput *= next.weight;
        path.eta *= next.eta;
        path.depth += 1;
        path.is_last = match self.integrator.kind {
            IntegratorKind::Path => false,
            IntegratorKind::Direct => true,
            IntegratorKind::Whitted => !next.is_delta(),
        } || self.max_depth().is_some_and(|max| path.depth + 1 >= max);
        if !path.is_last {
            let survival = self.survival(path);
            if survival < 1.0 {
                let survived = path.sampler.one(Slot::Roulette) < survival;
                witness.see(|| Event::Roulette { survival, survived });
                if !survived {
                    return Err(Cause::Roulette);
                }
                path.throughput /= survival;
            }
        }
        path.ray = surface.ray(wi, f32::INFINITY);
        path.origin = Origin { position: surface.position, normal: surface.frame.n, pdf: next.pdf };
        if path.throughput == Vec3::ZERO { Err(Cause::Absorbed) } else { Ok(()) }
    }

    /// The probability of a path to go on.
    #[inline(always)]
    fn survival(&self, path: &Path) -> f32 {
        // The radiance scale of refraction (eta²) undoes itself when the path leaves the glass.
        let expected = path.throughput.max_element() * path.eta * path.eta;
        let is_early = path.depth >= EARLY_DEPTH && !self.without.early_roulette;
        let early = if is_early { EARLY_CONTRIBUTION * expected } else { 1.0 };
        if path.depth >= self.integrator.rr_depth { early.min(expected).min(CONTINUATION_MAX) } else { early }
    }

    /// Next-event estimation: light from one point of one light, if the way is free, times the throughput.
    #[inline(always)]
    fn direct<L: Lanes>(
        &self,
        lanes: L,
        world: &World,
        Vertex { surface, shading, wo, .. }: &Vertex,
        path: &Path,
        witness: &mut impl Witness,
    ) -> Vec3 {
        let (choice, u) = (|| path.sampler.one(Slot::Light), path.sampler.two(Slot::LightPoint));
        let with_bsdf = self.strategy == Strategy::Mis;
        let Some(light) = world.lights.sample(&world.geometry, &world.textures, surface, choice, u, with_bsdf) else {
            return Vec3::ZERO;
        };
        let scattered = shading.eval(*wo, shading.frame.to_local(light.wi));
        let mis = if with_bsdf { power_heuristic(light.pdf, scattered.pdf) } else { 1.0 };
        let contribution = scattered.value * light.weight * mis;
        let visible = contribution != Vec3::ZERO && !world.geometry.occluded(lanes, &light.shadow_ray);
        let gained = if visible { path.throughput * path.share * contribution } else { Vec3::ZERO };
        let (wi, pdf, bsdf_pdf) = (light.wi, light.pdf, scattered.pdf);
        witness.see(|| Event::Light { wi, pdf, bsdf_pdf, mis, visible, gained });
        gained
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

/// Where a ray leads to.
enum Next {
    Surface(Surface),
    Background,
    /// To nothing that shines, which is all that the last ray of a path needs to know.
    Dark,
}

/// What a ray meets; if emitters are `hidden`, the first surface that does not emit. Of the `last` ray of a path only what
/// shines matters: most of them pass all lights by, which is found out without tracing them.
#[inline(always)]
fn next_surface<L: Lanes>(lanes: L, world: &World, ray: &mut Ray, hidden: bool, last: bool) -> Next {
    if last && !world.lights.may_meet(lanes, ray) {
        return Next::Dark;
    }
    for _ in 0..HIDDEN_MAX {
        let Some(hit) = world.geometry.closest(lanes, ray) else { return Next::Background };
        if last && world.geometry.light_of(&hit).is_none() {
            return Next::Dark;
        }
        let surface = world.geometry.surface(ray, hit);
        if !hidden || surface.light.is_none() {
            return Next::Surface(surface);
        }
        *ray = surface.ray(ray.direction, ray.t_max - hit.t());
    }
    Next::Dark
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
