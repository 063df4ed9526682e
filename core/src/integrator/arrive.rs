//! From rays to surfaces: what paths meet, and what shines there.

use super::rows::{NONE, WIDTH};
use super::wave::{State, Wave};
use super::{Estimator, HIDDEN_MAX, Origin};
use crate::bsdf::Closure;
use crate::bvh::Ray;
use crate::bvh::simd::{Kernel, Lanes};
use crate::geometry::{Hit, place};
use crate::sampler::{Sampler, Slot};
use crate::settings::{Offsets, SamplerKind};
use crate::shading::Shading;
use crate::surface::Surface;
use crate::witness::{Cause, Event, Witness};
use crate::world::World;
use glam::{Vec2, Vec3};

impl Estimator {
    /// Follows the rays in hand and gains what shines at their ends; leaves paths at a surface that is to scatter them, or
    /// at their ends.
    #[inline(always)]
    pub(super) fn arrive<'w, L: Lanes, W: Witness>(
        &self,
        lanes: L,
        world: &'w World,
        wave: &mut Wave<'w>,
        like: &Sampler,
        witness: &mut W,
    ) {
        let count = self.trace(lanes, world, wave, witness);
        world.geometry.prefetch(&wave.hits[..count]);
        let beyond = self.look_beyond(lanes, world, wave, count);
        let mut arrived = 0;
        for k in 0..count {
            let i = wave.owners[k];
            let Some(hit) = self.visible(lanes, world, wave, k) else {
                if !wave.sky.is_some[i] {
                    self.escape(lanes, world, wave, i, witness);
                }
                continue;
            };
            if wave.is_last[i] {
                self.end_of_last(lanes, world, wave, k, hit, witness);
                continue;
            }
            if let Hit::Triangle(hit) = hit {
                let b = Vec2::new(hit.u, hit.v);
                let point = world.geometry.triangle_point(hit.triangle, b);
                // They will be here when all points are computed.
                world.materials.prefetch(&world.textures, point.shape, point.uv);
                wave.triangles.set_corners(i, point.corners);
                wave.triangles.extra.set(i, point.shading);
                let surfaces = &mut wave.surfaces;
                surfaces.barycentric.set(i, b);
                surfaces.uv.set(i, point.uv);
                surfaces.shape[i] = point.shape;
                surfaces.instance[i] = NONE;
                surfaces.primitive[i] = hit.triangle;
                surfaces.light[i] = point.light.unwrap_or(NONE);
                let lambert = world.materials.lambert(point.shape);
                wave.is_two_sided[i] = lambert.is_some_and(|lambert| lambert.back.is_some());
            }
            // What is to be done yet moves to the front.
            (wave.owners[arrived], wave.hits[arrived], wave.rays[arrived]) = (i, Some(hit), wave.rays[k]);
            arrived += 1;
        }
        if let Some(beyond) = beyond {
            self.shine_beyond(lanes, beyond, wave, witness);
        }
        if arrived == 0 {
            return; // What branches have in common stays as it is.
        }
        lanes.run(Places(wave));
        lanes.run(Lobes(wave, *like));
        for k in 0..arrived {
            let i = wave.owners[k];
            match wave.hits[k] {
                Some(Hit::Triangle(_)) if wave.is_sure[i] => {}
                Some(hit) => {
                    let surface = lanes.run(At { world, ray: &wave.rays[k], hit });
                    wave.surfaces.set(i, &surface);
                    let lambert = world.materials.lambert(surface.shape);
                    let is_two_sided = lambert.is_some_and(|lambert| lambert.back.is_some());
                    wave.see_from(i, &surface.frame, is_two_sided);
                }
                None => {}
            }
            if self.offsets != Offsets::Exact {
                self.set_off(world, wave, i);
            }
            self.shade(lanes, world, wave, i, witness);
        }
    }

    /// Moves the starts of the rays that will leave the surface in hand.
    #[cold]
    #[inline(never)]
    fn set_off(&self, world: &World, wave: &mut Wave, i: usize) {
        let surface = wave.surfaces.at(i);
        let further = self.offsets.further_error(surface.position, surface.normal, world.origin);
        wave.surfaces.error.set(i, surface.error + further);
    }

    /// Finds what the rays in hand hit; how many of them may hit anything that matters.
    #[inline(always)]
    fn trace<L: Lanes, W: Witness>(&self, lanes: L, world: &World, wave: &mut Wave, witness: &mut W) -> usize {
        let mut count = 0;
        for i in 0..WIDTH {
            if wave.state[i] != State::Ray {
                continue;
            }
            let ray = wave.ray(i);
            if wave.is_last[i] && !self.without.blind_ends && !world.lights.may_meet(lanes, &ray) {
                wave.state[i] = State::End;
                witness.see(i, || Event::End(Cause::Dark));
                continue;
            }
            (wave.rays[count], wave.owners[count]) = (ray, i);
            count += 1;
        }
        world.geometry.closest_many(lanes, &wave.rays[..count], &mut wave.hits[..count]);
        count
    }

    /// What ray `k` of those traced meets; if emitters are hidden, the first surface that does not emit.
    #[inline(always)]
    fn visible<L: Lanes>(&self, lanes: L, world: &World, wave: &mut Wave, k: usize) -> Option<Hit> {
        let hit = wave.hits[k]?;
        let hidden = self.integrator.hide_emitters && wave.depth[wave.owners[k]] == 0;
        if hidden { self.behind_emitters(lanes, world, &mut wave.rays[k], hit) } else { Some(hit) }
    }

    #[inline(never)]
    fn behind_emitters<L: Lanes>(&self, lanes: L, world: &World, ray: &mut Ray, mut hit: Hit) -> Option<Hit> {
        for _ in 0..HIDDEN_MAX {
            let surface = world.geometry.surface(ray, hit);
            if surface.light.is_none() {
                return Some(hit);
            }
            *ray = surface.ray(ray.direction, ray.t_max - hit.t());
            hit = world.geometry.closest(lanes, ray)?;
        }
        None
    }

    /// The path has left the scene.
    #[inline(always)]
    fn escape<L: Lanes, W: Witness>(&self, lanes: L, world: &World, wave: &mut Wave, i: usize, witness: &mut W) {
        wave.state[i] = State::End;
        let hidden = wave.depth[i] == 0 && self.integrator.hide_emitters;
        let (from, wi) = (wave.from.at(i), wave.direction.at(i));
        if !hidden && let Some((radiance, mis)) = lanes.run(Beyond { estimator: self, world, from, wi }) {
            found(wave, i, radiance, mis, witness);
        }
        witness.see(i, || Event::End(Cause::Escaped));
    }

    /// The path's last ray has hit something, which matters if it shines.
    #[inline(always)]
    fn end_of_last<L: Lanes, W: Witness>(
        &self,
        lanes: L,
        world: &World,
        wave: &mut Wave,
        k: usize,
        hit: Hit,
        witness: &mut W,
    ) {
        let i = wave.owners[k];
        wave.state[i] = State::End;
        if !self.without.blind_ends && world.geometry.light_of(&hit).is_none() {
            witness.see(i, || Event::End(Cause::Dark));
            return;
        }
        let surface = lanes.run(At { world, ray: &wave.rays[k], hit });
        witness.see(i, || Event::Hit { depth: wave.depth[i], surface, throughput: wave.throughput.at(i) });
        self.shine(lanes, world, wave, i, &surface, witness);
        witness.see(i, || Event::End(Cause::Depth));
    }

    /// Gains what the surface emits.
    #[inline(always)]
    fn shine<L: Lanes, W: Witness>(
        &self,
        lanes: L,
        world: &World,
        wave: &mut Wave,
        i: usize,
        surface: &Surface,
        witness: &mut W,
    ) {
        let (from, wo) = (wave.from.at(i), -wave.direction.at(i));
        if let Some((radiance, mis)) = lanes.run(Emitted { estimator: self, world, surface, from, wo }) {
            found(wave, i, radiance, mis, witness);
        }
    }

    /// Gains what the surface in hand emits, and finds out how it scatters.
    #[inline(always)]
    fn shade<'w, L: Lanes, W: Witness>(
        &self,
        lanes: L,
        world: &'w World,
        wave: &mut Wave<'w>,
        i: usize,
        witness: &mut W,
    ) {
        witness.see(i, || {
            let (depth, surface, throughput) = (wave.depth[i], wave.surfaces.at(i), wave.throughput.at(i));
            Event::Hit { depth, surface, throughput }
        });
        if wave.surfaces.light[i] != NONE {
            let surface = wave.surfaces.at(i);
            self.shine(lanes, world, wave, i, &surface, witness);
        }
        wave.state[i] = State::Surface;
        wave.is_diffuse[i] = false;
        wave.is_coat[i] = false;
        let shape = wave.surfaces.shape[i];
        if let Some(lambert) = world.materials.lambert(shape) {
            let back = lambert.back.filter(|_| wave.is_turned[i]);
            let albedo = world.textures.constant(back.unwrap_or(lambert.front));
            if let Some(albedo) = albedo {
                wave.is_diffuse[i] = true;
                wave.albedo.set(i, albedo);
                return;
            }
        }
        let wo = -wave.direction.at(i);
        let lobe = if world.materials.has_lobes(shape) { wave.numbers.lobe[i] } else { 0.0 };
        let surface = wave.surfaces.at(i);
        let into = &mut wave.shadings[i];
        wave.numbers.lobe[i] = lanes.run(Shade { world, surface: &surface, wo, lobe, into });
        wave.frame.set(i, &into.frame);
        wave.wo.set(i, into.frame.to_local(wo));
        if let (Closure::Diffuse(diffuse), None) = (&into.closure, &into.tilt) {
            wave.is_diffuse[i] = true;
            wave.albedo.set(i, diffuse.reflectance);
        }
        wave.lay_out_coat(i);
    }
}

/// What a ray hit.
struct At<'a> {
    world: &'a World,
    ray: &'a Ray,
    hit: Hit,
}

impl Kernel for At<'_> {
    type Output = Surface;

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) -> Surface {
        self.world.geometry.surface(self.ray, self.hit)
    }
}

/// What a surface emits, and its weight; none where it does not.
struct Emitted<'a> {
    estimator: &'a Estimator,
    world: &'a World,
    surface: &'a Surface,
    from: Origin,
    wo: Vec3,
}

impl Kernel for Emitted<'_> {
    type Output = Option<(Vec3, f32)>;

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) -> Self::Output {
        let Self { estimator, world, surface, from, wo } = self;
        Some(estimator.emitted(world, surface, surface.light?, from, wo))
    }
}

/// What comes from beyond the scene, and its weight.
struct Beyond<'a> {
    estimator: &'a Estimator,
    world: &'a World,
    from: Origin,
    wi: Vec3,
}

impl Kernel for Beyond<'_> {
    type Output = Option<(Vec3, f32)>;

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) -> Self::Output {
        self.estimator.background(self.world, self.from, self.wi)
    }
}

/// Finds out how a surface scatters; what is left of the number `lobe`.
struct Shade<'a, 'w> {
    world: &'w World,
    surface: &'a Surface,
    wo: Vec3,
    lobe: f32,
    into: &'a mut Shading<'w>,
}

impl Kernel for Shade<'_, '_> {
    type Output = f32;

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) -> Self::Output {
        let Self { world, surface, wo, mut lobe, into } = self;
        *into = world.materials.at(&world.geometry, &world.textures, surface, wo, &mut lobe);
        lobe
    }
}

/// Gains light that the path found, of this weight beside light sampling.
#[inline(always)]
pub(super) fn found<W: Witness>(wave: &mut Wave, i: usize, radiance: Vec3, mis: f32, witness: &mut W) {
    let gained = wave.throughput.at(i) * wave.share[i] * (radiance * mis);
    let told = gained * wave.worth.at(i);
    witness.see(i, || Event::Emission { radiance, mis, pdf: wave.from.pdf[i], gained: told });
    wave.gain(i, gained);
}

/// Computes the points of all triangles, and how paths see them.
struct Places<'a, 'w>(&'a mut Wave<'w>);

impl Kernel for Places<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        let wave = self.0;
        for i in 0..WIDTH {
            let corners = wave.triangles.corners(i);
            let place = place(corners, wave.triangles.extra.at(i), wave.surfaces.barycentric.at(i));
            wave.surfaces.position.set(i, place.position);
            wave.surfaces.error.set(i, place.error);
            wave.surfaces.normal.set(i, place.normal);
            wave.surfaces.frame.set(i, &place.frame);
            wave.is_sure[i] = place.is_sure;
            // The shading frame, if the material bends nothing.
            wave.see_from(i, &place.frame, wave.is_two_sided[i]);
        }
    }
}

/// Draws the number of every path for what of its material answers.
struct Lobes<'a, 'w>(&'a mut Wave<'w>, Sampler);

impl Lobes<'_, '_> {
    #[inline(always)]
    fn draw(self, kind: SamplerKind) {
        let Self(wave, like) = self;
        for i in 0..WIDTH {
            wave.numbers.lobe[i] = wave.samplers.at(i, wave.depth[i], kind, &like).one(Slot::Lobe);
        }
    }
}

impl Kernel for Lobes<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        // A loop of its own for the usual kind, which becomes one of vectors.
        match self.1.kind() {
            SamplerKind::Sobol => self.draw(SamplerKind::Sobol),
            kind => self.draw(kind),
        }
    }
}
