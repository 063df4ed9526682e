//! At surfaces: light sampled there, and the ray that goes on.

use super::reuse::part;
use super::rows::{NONE, WIDTH};
use super::wave::{Rules, State, Wave};
use super::{BRANCHES, Estimator, power_heuristic};
use crate::bsdf::{Diffuse, Evaluation, Sample};
use crate::bvh::simd::{Kernel, Lanes};
use crate::lights::Plain;
use crate::sampler::{Sampler, Slot, units};
use crate::settings::{SamplerKind, Strategy};
use crate::shading::Shading;
use crate::witness::{Cause, Event, Witness};
use crate::world::World;
use glam::{Vec2, Vec3};

impl Estimator {
    /// Gains light that the surfaces in hand scatter, and gives their paths the next rays, or ends them.
    #[inline(always)]
    pub(super) fn scatter<L: Lanes, W: Witness>(
        &self,
        lanes: L,
        world: &World,
        wave: &mut Wave,
        like: &Sampler,
        branch: Option<u32>,
        witness: &mut W,
    ) {
        let chooses = world.lights.needs_choice();
        lanes.run(Draw { wave, like: *like, branch, chooses });
        let (mut count, mut has_coats) = (0, false);
        for i in 0..WIDTH {
            wave.chosen[count] = i;
            let is_chosen = wave.state[i] == State::Surface;
            count += usize::from(is_chosen);
            has_coats |= is_chosen & wave.is_coat[i];
        }
        wave.tally.surfaces += count as u64;
        self.choose_directions(lanes, wave, count, has_coats);
        let samples_lights = matches!(self.strategy, Strategy::Light | Strategy::Mis) && !world.lights.is_empty();
        if samples_lights {
            self.sample_lights(lanes, world, wave, count, has_coats);
        }
        self.reuse_choices(lanes, wave, count, witness);
        if samples_lights {
            self.gain_lights(lanes, world, wave, count, witness);
        }
        part(wave);
        lanes.run(Step(wave));
        for k in 0..count {
            self.go_on(wave, wave.chosen[k], witness);
        }
    }

    /// Next-event estimation: light from one point of one light.
    #[inline(always)]
    fn sample_lights<L: Lanes>(&self, lanes: L, world: &World, wave: &mut Wave, count: usize, has_coats: bool) {
        let with_bsdf = self.strategy == Strategy::Mis;
        self.face_sky(lanes, world, wave, count);
        let Kinds { plain, sky } = lanes.run(ChooseLights { world, wave, count });
        if plain > 0 {
            lanes.run(PlainLights(wave));
        }
        if sky > 0 {
            self.sample_sky(lanes, world, wave);
        }
        if plain + sky < count {
            lanes.run(OtherLights { world, wave, count, with_bsdf });
        }
        lanes.run(Evaluate(wave, with_bsdf));
        if has_coats {
            wave.evaluate_coats(lanes, count, with_bsdf);
        }
        for k in 0..count {
            let i = wave.chosen[k];
            let is_other = !wave.is_diffuse[i] && !wave.is_coat[i];
            if wave.lights.is_some[i] && is_other && !wave.seats[i].is_at_meeting() {
                let (shading, wo, wi) = (&wave.shadings[i], wave.wo.at(i), wave.towards_light(i));
                let evaluation = lanes.run(Eval { shading, wo, wi });
                weigh(wave, i, evaluation, with_bsdf);
            }
        }
    }

    /// Gains the light that was sampled, where the way is free.
    #[inline(always)]
    fn gain_lights<L: Lanes, W: Witness>(
        &self,
        lanes: L,
        world: &World,
        wave: &mut Wave,
        count: usize,
        witness: &mut W,
    ) {
        let mut rays = 0;
        for k in 0..count {
            let i = wave.chosen[k];
            if !wave.lights.is_some[i] {
                continue;
            }
            let lights = &wave.lights;
            if lights.value.at(i) == Vec3::ZERO {
                witness.see(i, || self.light_event(wave, i, false, Vec3::ZERO));
                continue;
            }
            let ray = crate::bvh::Ray {
                origin: lights.origin.at(i),
                direction: lights.direction.at(i),
                t_max: lights.t_max[i] * self.offsets.shadow_share(),
            };
            (wave.rays[rays], wave.owners[rays]) = (ray, i);
            rays += 1;
        }
        world.geometry.occluded_many(lanes, &wave.rays[..rays], &mut wave.occluded[..rays]);
        for k in 0..rays {
            let i = wave.owners[k];
            let visible = !wave.occluded[k];
            let seat = wave.seats[i];
            if seat.is_at_meeting()
                && let Some(groups) = &mut wave.groups
            {
                let gained = groups.light(seat, visible);
                witness.see(i, || self.light_event(wave, i, visible, gained));
                continue;
            }
            let all = wave.throughput.at(i) * wave.share[i] * wave.lights.value.at(i);
            let gained = if visible { all } else { Vec3::ZERO };
            witness.see(i, || self.light_event(wave, i, visible, gained * wave.worth.at(i)));
            wave.gain(i, gained);
        }
    }

    fn light_event(&self, wave: &Wave, i: usize, visible: bool, gained: Vec3) -> Event {
        let lights = &wave.lights;
        let (wi, pdf, bsdf_pdf, mis) = (lights.wi.at(i), lights.pdf[i], lights.bsdf_pdf[i], lights.mis[i]);
        Event::Light { wi, pdf, bsdf_pdf, mis, visible, gained }
    }

    /// Chooses a direction for every path. Mirrors and glass have theirs whatever the strategy.
    #[inline(always)]
    fn choose_directions<L: Lanes>(&self, lanes: L, wave: &mut Wave, count: usize, has_coats: bool) {
        let by_bsdf = matches!(self.strategy, Strategy::Bsdf | Strategy::Light | Strategy::Mis);
        if by_bsdf {
            lanes.run(Directions(wave));
            if has_coats {
                wave.sample_coats(lanes, count);
            }
        }
        for k in 0..count {
            let i = wave.chosen[k];
            if by_bsdf && (wave.is_diffuse[i] || wave.is_coat[i]) {
                continue;
            }
            if wave.is_diffuse[i] {
                wave.remember_diffuse(i);
            }
            let (lobe, u) = (wave.numbers.lobe[i], wave.numbers.direction.at(i));
            let shading = &wave.shadings[i];
            let sample = lanes.run(Continue { estimator: self, shading, wo: wave.wo.at(i), lobe, u });
            let frame = shading.frame;
            wave.next.set(i, sample.unwrap_or(NOWHERE), sample.is_some(), &frame);
        }
    }

    /// Says how a path goes on after [`Step`].
    #[inline(always)]
    fn go_on<W: Witness>(&self, wave: &mut Wave, i: usize, witness: &mut W) {
        let mut cause = None;
        if !wave.next.is_some[i] {
            cause = Some(Cause::Absorbed);
        } else {
            let next = &wave.next;
            let (wi, pdf, weight) = (next.wi.at(i), next.pdf[i], next.weight.at(i));
            witness.see(i, || Event::Continuation { wi, pdf, weight });
            let (survival, survived) = (wave.survival[i], wave.survived[i]);
            if survival < 1.0 {
                witness.see(i, || Event::Roulette { survival, survived });
            }
            if !survived {
                cause = Some(Cause::Roulette);
            } else if wave.throughput.at(i) == Vec3::ZERO {
                cause = Some(Cause::Absorbed);
            }
        }
        wave.state[i] = if cause.is_none() { State::Ray } else { State::End };
        if let Some(cause) = cause {
            witness.see(i, || Event::End(cause));
        }
    }
}

/// Weighs all paths by what their surfaces do, plays roulette, and makes the rays.
struct Step<'a, 'w>(&'a mut Wave<'w>);

impl Kernel for Step<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        let wave = self.0;
        let Rules { is_direct, is_whitted, max_depth, roulette } = wave.rules;
        for i in 0..WIDTH {
            let is_delta = wave.next.pdf[i] == f32::INFINITY;
            let throughput = wave.throughput.at(i) * wave.next.weight.at(i);
            let eta = wave.eta[i] * wave.next.eta[i];
            let depth = wave.depth[i] + 1;
            let is_last = is_direct | (is_whitted & !is_delta) | (depth.saturating_add(1) >= max_depth);
            let survival =
                if is_last { 1.0 } else { roulette.survival(throughput * wave.worth_to_all.at(i), eta, depth) };
            let plays = survival < 1.0;
            wave.survival[i] = survival;
            wave.survived[i] = !plays | (wave.numbers.roulette[i] < survival);
            wave.throughput.set(i, if plays { throughput / survival } else { throughput });
            wave.eta[i] = eta;
            wave.depth[i] = depth;
            wave.is_last[i] = is_last;
            let ray = wave.surfaces.at(i).ray(wave.next.wi.at(i), f32::INFINITY);
            wave.set_ray(i, &ray);
            wave.from.position.set(i, wave.surfaces.position.at(i));
            wave.from.normal.set(i, wave.surfaces.frame.n.at(i));
            wave.from.pdf[i] = wave.next.pdf[i];
        }
    }
}

/// Draws the numbers of all surfaces, those of one branch of the paths if they have several.
struct Draw<'a, 'w> {
    wave: &'a mut Wave<'w>,
    like: Sampler,
    branch: Option<u32>,
    /// Lights are chosen by a number of their own.
    chooses: bool,
}

impl Draw<'_, '_> {
    #[inline(always)]
    fn draw(self, kind: SamplerKind) {
        let Self { wave, like, branch, chooses } = self;
        let branches = if branch.is_some() { BRANCHES } else { 1 };
        let branch = branch.unwrap_or(0);
        let sampler = |wave: &Wave, i: usize| {
            let forked = wave.share[i] < 1.0;
            let whole = wave.samplers.at(i, wave.depth[i], kind, &like);
            whole.branch(if forked { branch } else { 0 }, if forked { branches } else { 1 })
        };
        for i in 0..WIDTH {
            let sampler = sampler(wave, i);
            wave.numbers.direction.set(i, sampler.two(Slot::Direction));
            let [x, y] = sampler.two_fractions(Slot::LightPoint);
            (wave.numbers.light_point[0][i], wave.numbers.light_point[1][i]) = (x, y);
            wave.numbers.roulette[i] = sampler.one(Slot::Roulette);
        }
        for i in 0..if chooses { WIDTH } else { 0 } {
            wave.numbers.light[i] = sampler(wave, i).one(Slot::Light);
        }
    }
}

impl Kernel for Draw<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        // A loop of its own for the usual kind, which becomes one of vectors.
        match self.like.kind() {
            SamplerKind::Sobol => self.draw(SamplerKind::Sobol),
            kind => self.draw(kind),
        }
    }
}

/// Chooses a light for every surface.
struct ChooseLights<'a, 'w> {
    world: &'a World,
    wave: &'a mut Wave<'w>,
    count: usize,
}

/// How many surfaces have chosen a plain light, and how many the image all around.
struct Kinds {
    plain: usize,
    sky: usize,
}

impl Kernel for ChooseLights<'_, '_> {
    type Output = Kinds;

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) -> Kinds {
        let Self { world, wave, count } = self;
        let mut kinds = Kinds { plain: 0, sky: 0 };
        let has_sky = world.lights.environment().is_some();
        let needs_choice = world.lights.needs_choice();
        wave.is_plain = [false; WIDTH];
        wave.sky.is_some = [false; WIDTH];
        for k in 0..count {
            let i = wave.chosen[k];
            wave.light[i] = NONE;
            wave.lights.is_some[i] = false;
            if !wave.is_diffuse[i] && wave.shadings[i].closure.is_delta() {
                continue;
            }
            let (position, normal) = (wave.surfaces.position.at(i), wave.surfaces.frame.n.at(i));
            let choice = if needs_choice { wave.numbers.light[i] } else { 0.0 };
            let u = units(wave.numbers.light_point(i));
            let Some(chosen) = world.lights.choose(position, normal, choice, u) else { continue };
            wave.lights.probability[i] = chosen.probability;
            wave.lights.u.set(i, chosen.u);
            wave.light[i] = chosen.light;
            if let Some(light) = world.lights.plain(&world.geometry, &world.textures, chosen.light) {
                wave.triangles.set_corners(i, light.corners);
                wave.triangles.extra.set(i, light.radiance);
                wave.triangles.area[i] = light.area;
                wave.is_plain[i] = true;
                kinds.plain += 1;
            } else if has_sky && world.lights.is_background(chosen.light) {
                wave.sky.is_some[i] = true;
                kinds.sky += 1;
            }
        }
        kinds
    }
}

/// Samples the lights that are neither plain nor the image all around.
struct OtherLights<'a, 'w> {
    world: &'a World,
    wave: &'a mut Wave<'w>,
    count: usize,
    with_bsdf: bool,
}

impl Kernel for OtherLights<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        let Self { world, wave, count, with_bsdf } = self;
        for k in 0..count {
            let i = wave.chosen[k];
            if wave.is_plain[i] || wave.sky.is_some[i] || wave.light[i] == NONE {
                continue;
            }
            let (light, probability, u) = (wave.light[i], wave.lights.probability[i], wave.lights.u.at(i));
            let chosen = crate::lights::Chosen { light, probability, u };
            let surface = wave.surfaces.at(i);
            let sample = world.lights.sample(&world.geometry, &world.textures, &surface, chosen, with_bsdf);
            wave.lights.is_some[i] = sample.is_some();
            if let Some(sample) = sample {
                wave.lights.set(i, &sample);
            }
        }
    }
}

/// What a surface does with light from a direction.
pub(super) struct Eval<'a> {
    pub shading: &'a Shading<'a>,
    pub wo: Vec3,
    pub wi: Vec3,
}

impl Kernel for Eval<'_> {
    type Output = Evaluation;

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) -> Evaluation {
        self.shading.eval(self.wo, self.wi)
    }
}

/// A direction for a path to go on.
struct Continue<'a> {
    estimator: &'a Estimator,
    shading: &'a Shading<'a>,
    wo: Vec3,
    lobe: f32,
    u: Vec2,
}

impl Kernel for Continue<'_> {
    type Output = Option<Sample>;

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) -> Self::Output {
        self.estimator.continuation(self.shading, self.wo, self.lobe, self.u)
    }
}

/// Samples the plain lights of all surfaces.
struct PlainLights<'a, 'w>(&'a mut Wave<'w>);

impl Kernel for PlainLights<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        let wave = self.0;
        for i in 0..WIDTH {
            let triangles = &wave.triangles;
            let light =
                Plain { corners: triangles.corners(i), area: triangles.area[i], radiance: triangles.extra.at(i) };
            let (sample, shines) = light.sample(&wave.surfaces.at(i), wave.lights.probability[i], wave.lights.u.at(i));
            wave.lights.is_some[i] = shines & wave.is_plain[i];
            wave.lights.set(i, &sample);
        }
    }
}

/// Evaluates all diffuse surfaces for the light that was sampled.
struct Evaluate<'a, 'w>(&'a mut Wave<'w>, bool);

impl Kernel for Evaluate<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        let Self(wave, with_bsdf) = self;
        for i in 0..WIDTH {
            let diffuse = Diffuse { reflectance: wave.albedo.at(i) };
            let evaluation = diffuse.eval(wave.wo.at(i), wave.towards_light(i));
            weigh(wave, i, evaluation, with_bsdf);
        }
    }
}

/// Chooses the directions of all diffuse surfaces.
struct Directions<'a, 'w>(&'a mut Wave<'w>);

impl Kernel for Directions<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        let wave = self.0;
        for i in 0..WIDTH {
            let diffuse = Diffuse { reflectance: wave.albedo.at(i) };
            let (sample, is_some) = diffuse.sample_flagged(wave.wo.at(i), wave.numbers.direction.at(i));
            wave.next.set(i, sample, is_some, &wave.frame.at(i));
        }
    }
}

/// What a surface makes of the light that was sampled for it.
#[inline(always)]
fn weigh(wave: &mut Wave, i: usize, evaluation: Evaluation, with_bsdf: bool) {
    weigh_if(wave, i, evaluation, with_bsdf, true);
}

/// The same, or what is there already, without a branch.
#[inline(always)]
pub(super) fn weigh_if(
    wave: &mut Wave,
    i: usize,
    Evaluation { value, pdf }: Evaluation,
    with_bsdf: bool,
    really: bool,
) {
    let lights = &mut wave.lights;
    let mis = if with_bsdf { power_heuristic(lights.pdf[i], pdf) } else { 1.0 };
    let value = value * lights.weight.at(i) * mis;
    lights.value.set(i, if really { value } else { lights.value.at(i) });
    lights.bsdf_pdf[i] = if really { pdf } else { lights.bsdf_pdf[i] };
    lights.mis[i] = if really { mis } else { lights.mis[i] };
}

/// No direction.
const NOWHERE: Sample = Sample { wi: Vec3::Z, weight: Vec3::ZERO, pdf: 0.0, eta: 1.0 };
