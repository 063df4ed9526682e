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
use crate::settings::{Integrator, IntegratorKind, Strategy};
use crate::shading::Shading;
use crate::surface::Surface;
use crate::warp::{UNIFORM_HEMISPHERE_PDF, cosine_hemisphere, cosine_hemisphere_pdf, uniform_hemisphere};
use crate::witness::{Cause, Event, Witness};
use crate::world::World;
use glam::{Vec2, Vec3};

/// The largest probability to go on under Russian roulette, so that a path in a lossless scene ends some day.
const CONTINUATION_MAX: f32 = 0.95;

/// Emitters in a row that a camera ray passes when they are hidden. A ray within the plane of one may meet it again and again.
const HIDDEN_MAX: u32 = 1 << 12;

/// What is estimated, and how.
#[derive(Clone, Copy, Debug)]
pub struct Estimator {
    /// Which light transport is counted.
    pub integrator: Integrator,
    /// Where directions come from.
    pub strategy: Strategy,
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

impl Estimator {
    /// Radiance along a camera ray.
    #[inline(always)]
    pub fn radiance<L: Lanes>(
        &self,
        lanes: L,
        world: &World,
        mut ray: Ray,
        sampler: &mut Sampler,
        witness: &mut impl Witness,
    ) -> Vec3 {
        let mut radiance = Vec3::ZERO;
        let mut throughput = Vec3::ONE;
        let mut origin = Origin { position: ray.origin, normal: Vec3::ZERO, pdf: f32::INFINITY };
        let mut eta = 1.0;
        let max_depth = self.integrator.max_depth.filter(|_| self.integrator.kind != IntegratorKind::Direct);
        let mut last_segment = max_depth.is_some_and(|max| max <= 1);
        for depth in 0.. {
            let hidden = depth == 0 && self.integrator.hide_emitters;
            let surface = match next_surface(lanes, world, &mut ray, hidden, last_segment) {
                Next::Surface(surface) => surface,
                Next::Dark => {
                    witness.see(|| Event::End(Cause::Dark));
                    break;
                }
                Next::Background => {
                    if !hidden && let Some((emitted, mis)) = self.background(world, origin, ray.direction) {
                        let gained = throughput * (emitted * mis);
                        radiance += gained;
                        witness.see(|| Event::Emission { radiance: emitted, mis, pdf: origin.pdf, gained });
                    }
                    witness.see(|| Event::End(Cause::Escaped));
                    break;
                }
            };
            witness.see(|| Event::Hit { depth, surface, throughput });
            let wo = -ray.direction;
            if let Some(light) = surface.light {
                let (emitted, mis) = self.emitted(world, &surface, light, origin, wo);
                let gained = throughput * (emitted * mis);
                radiance += gained;
                witness.see(|| Event::Emission { radiance: emitted, mis, pdf: origin.pdf, gained });
            }
            if last_segment {
                witness.see(|| Event::End(Cause::Depth));
                break;
            }

            sampler.at_surface(depth);
            let mut lobe = if world.materials.has_lobes(surface.shape) { sampler.one(Slot::Lobe) } else { 0.0 };
            let shading = world.materials.at(&world.geometry, &world.textures, &surface, wo, &mut lobe);
            let wo = shading.frame.to_local(wo);
            if matches!(self.strategy, Strategy::Light | Strategy::Mis) && !shading.closure.is_delta() {
                let hit = (&surface, &shading, wo);
                radiance += self.direct(lanes, world, hit, throughput, sampler, witness);
            }

            let Some(next) = self.continuation(&shading, wo, lobe, sampler.two(Slot::Direction)) else {
                witness.see(|| Event::End(Cause::Absorbed));
                break;
            };
            let wi = shading.frame.to_world(next.wi);
            witness.see(|| Event::Continuation { wi, pdf: next.pdf, weight: next.weight });
            throughput *= next.weight;
            eta *= next.eta;
            last_segment = match self.integrator.kind {
                IntegratorKind::Path => false,
                IntegratorKind::Direct => true,
                IntegratorKind::Whitted => !next.is_delta(),
            } || max_depth.is_some_and(|max| depth + 2 >= max);
            if depth + 1 >= self.integrator.rr_depth && !last_segment {
                // The radiance scale of refraction (eta²) undoes itself when the path leaves the glass.
                let survival = (throughput.max_element() * eta * eta).min(CONTINUATION_MAX);
                let survived = sampler.one(Slot::Roulette) < survival;
                witness.see(|| Event::Roulette { survival, survived });
                if !survived {
                    witness.see(|| Event::End(Cause::Roulette));
                    break;
                }
                throughput /= survival;
            }
            if throughput == Vec3::ZERO {
                witness.see(|| Event::End(Cause::Absorbed));
                break;
            }
            ray = surface.ray(wi, f32::INFINITY);
            origin = Origin { position: surface.position, normal: surface.frame.n, pdf: next.pdf };
        }
        radiance
    }

    /// Next-event estimation: light from one point of one light, if the way is free, times the throughput.
    #[inline(always)]
    fn direct<L: Lanes>(
        &self,
        lanes: L,
        world: &World,
        (surface, shading, wo): (&Surface, &Shading, Vec3),
        throughput: Vec3,
        sampler: &Sampler,
        witness: &mut impl Witness,
    ) -> Vec3 {
        let (choice, u) = (|| sampler.one(Slot::Light), sampler.two(Slot::LightPoint));
        let with_bsdf = self.strategy == Strategy::Mis;
        let Some(light) = world.lights.sample(&world.geometry, &world.textures, surface, choice, u, with_bsdf) else {
            return Vec3::ZERO;
        };
        let scattered = shading.eval(wo, shading.frame.to_local(light.wi));
        let mis = if with_bsdf { power_heuristic(light.pdf, scattered.pdf) } else { 1.0 };
        let contribution = scattered.value * light.weight * mis;
        let visible = contribution != Vec3::ZERO && !world.geometry.occluded(lanes, &light.shadow_ray);
        let gained = if visible { throughput * contribution } else { Vec3::ZERO };
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
