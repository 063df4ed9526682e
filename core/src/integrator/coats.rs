//! Rough plastics of many paths at once: what paint, varnish and plastic are made of in most scenes.

use super::rows::{Vec3s, WIDTH};
use super::scatter::weigh_if;
use super::wave::Wave;
use crate::bsdf::{Closure, Microfacet, SeenPlastic};
use crate::bvh::simd::{Kernel, Lanes};
use crate::scene::Distribution;
use glam::Vec2;

/// Rough plastics with GGX facets, as the paths see them.
pub(super) struct Coats {
    /// The path is at one, and nothing bends it; else the rest is meaningless. (Its base lies where a Lambert's albedo would.)
    pub is_some: [bool; WIDTH],
    alpha: [f32; WIDTH],
    eta: [f32; WIDTH],
    specular: Vec3s,
    enters: [f32; WIDTH],
    share: [f32; WIDTH],
    /// Local direction that was chosen.
    wi: Vec3s,
    /// Share of light that would pass the coat from the direction in hand.
    leaves: [f32; WIDTH],
}

impl Coats {
    pub const NONE: Self = Self {
        is_some: [false; WIDTH],
        alpha: [1.0; WIDTH],
        eta: [1.0; WIDTH],
        specular: Vec3s::ZERO,
        enters: [0.0; WIDTH],
        share: [0.0; WIDTH],
        wi: Vec3s::ZERO,
        leaves: [0.0; WIDTH],
    };
}

impl Wave<'_> {
    /// Lays out the rough plastic of the surface in hand, if it is one.
    #[inline(always)]
    pub fn lay_out_coat(&mut self, i: usize) {
        let (Closure::RoughPlastic(plastic), None) = (&self.shadings[i].closure, &self.shadings[i].tilt) else {
            return;
        };
        let seen = plastic.seen_from(self.wo.at(i));
        let Some(alpha) = seen.facets.round_ggx() else { return };
        let coats = &mut self.coats;
        coats.is_some[i] = true;
        (coats.alpha[i], coats.eta[i]) = (alpha, seen.eta);
        coats.specular.set(i, seen.specular_reflectance);
        (coats.enters[i], coats.share[i]) = (seen.enters, seen.share);
        self.albedo.set(i, seen.base);
    }

    #[inline(always)]
    fn coat(&self, i: usize) -> SeenPlastic {
        let coats = &self.coats;
        SeenPlastic {
            facets: Microfacet::new(Distribution::Ggx, Vec2::splat(coats.alpha[i])),
            eta: coats.eta[i],
            base: self.albedo.at(i),
            specular_reflectance: coats.specular.at(i),
            enters: coats.enters[i],
            share: coats.share[i],
        }
    }

    /// Looks up how much light passes the coats from local directions with these cosines.
    #[inline(always)]
    fn look_up_leaves(&mut self, count: usize, cos: impl Fn(&Self, usize) -> f32) {
        for k in 0..count {
            let i = self.chosen[k];
            if self.coats.is_some[i]
                && let Closure::RoughPlastic(plastic) = &self.shadings[i].closure
            {
                self.coats.leaves[i] = plastic.transmittance(cos(self, i));
            }
        }
    }

    /// Evaluates all of them for the light that was sampled.
    #[inline(always)]
    pub fn evaluate_coats<L: Lanes>(&mut self, lanes: L, count: usize, with_bsdf: bool) {
        self.look_up_leaves(count, |wave, i| wave.towards_light(i).z);
        lanes.run(Evaluate(self, with_bsdf));
    }

    /// Chooses directions for all of them.
    #[inline(always)]
    pub fn sample_coats<L: Lanes>(&mut self, lanes: L, count: usize) {
        lanes.run(Directions(self));
        self.look_up_leaves(count, |wave, i| wave.coats.wi.at(i).z);
        lanes.run(Weights(self));
    }
}

struct Evaluate<'a, 'w>(&'a mut Wave<'w>, bool);

impl Kernel for Evaluate<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        let Self(wave, with_bsdf) = self;
        for i in 0..WIDTH {
            let evaluation = wave.coat(i).eval(wave.wo.at(i), wave.towards_light(i), wave.coats.leaves[i]);
            weigh_if(wave, i, evaluation, with_bsdf, wave.coats.is_some[i]);
        }
    }
}

struct Directions<'a, 'w>(&'a mut Wave<'w>);

impl Kernel for Directions<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        let wave = self.0;
        for i in 0..WIDTH {
            let wi = wave.coat(i).direction(wave.wo.at(i), wave.numbers.lobe[i], wave.numbers.direction.at(i));
            wave.coats.wi.set(i, wi);
        }
    }
}

struct Weights<'a, 'w>(&'a mut Wave<'w>);

impl Kernel for Weights<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        let wave = self.0;
        for i in 0..WIDTH {
            let (sample, is_some) = wave.coat(i).sample(wave.wo.at(i), wave.coats.wi.at(i), wave.coats.leaves[i]);
            wave.next.set_if(i, sample, is_some, &wave.frame.at(i), wave.coats.is_some[i]);
        }
    }
}
