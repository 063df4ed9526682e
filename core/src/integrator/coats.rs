//! Rough plastics of many paths at once: what paint, varnish and plastic are made of in most scenes.

use super::rows::{Vec3s, WIDTH};
use super::scatter::weigh_if;
use super::wave::Wave;
use crate::bsdf::{Closure, Evaluation, Microfacet, SeenPlastic};
use crate::bvh::simd::{Kernel, Lanes};
use crate::scene::Distribution;
use crate::shading::Shading;
use glam::{Vec2, Vec3};

/// Rough plastics with GGX facets, as they are seen; meaningless where there is none. Their bases lie where Lambert's albedos would.
pub(super) struct Coats<const N: usize = WIDTH> {
    alpha: [f32; N],
    eta: [f32; N],
    specular: Vec3s<N>,
    enters: [f32; N],
    share: [f32; N],
    /// Local direction that was chosen.
    wi: Vec3s<N>,
    /// Share of light that would pass the coat from the direction in hand.
    leaves: [f32; N],
}

impl<const N: usize> Coats<N> {
    pub const NONE: Self = Self {
        alpha: [1.0; N],
        eta: [1.0; N],
        specular: Vec3s::ZERO,
        enters: [0.0; N],
        share: [0.0; N],
        wi: Vec3s::ZERO,
        leaves: [0.0; N],
    };

    /// Lays out the rough plastic of a surface seen from `wo`, and tells its base, if it is one that nothing bends.
    #[inline(always)]
    pub fn lay_out(&mut self, i: usize, shading: &Shading, wo: Vec3) -> Option<Vec3> {
        let (Closure::RoughPlastic(plastic), None) = (&shading.closure, &shading.tilt) else { return None };
        let seen = plastic.seen_from(wo);
        let alpha = seen.facets.round_ggx()?;
        (self.alpha[i], self.eta[i]) = (alpha, seen.eta);
        self.specular.set(i, seen.specular_reflectance);
        (self.enters[i], self.share[i]) = (seen.enters, seen.share);
        Some(seen.base)
    }

    /// Looks up how much light passes the coat at this cosine.
    #[inline(always)]
    pub fn look_up_leaves(&mut self, i: usize, shading: &Shading, cos: f32) {
        if let Closure::RoughPlastic(plastic) = &shading.closure {
            self.leaves[i] = plastic.transmittance(cos);
        }
    }

    /// As it was laid out, over this base.
    #[inline(always)]
    pub fn at(&self, i: usize, base: Vec3) -> SeenPlastic {
        SeenPlastic {
            facets: Microfacet::new(Distribution::Ggx, Vec2::splat(self.alpha[i])),
            eta: self.eta[i],
            base,
            specular_reflectance: self.specular.at(i),
            enters: self.enters[i],
            share: self.share[i],
        }
    }

    /// As [`SeenPlastic::eval`].
    #[inline(always)]
    pub fn eval(&self, i: usize, base: Vec3, wo: Vec3, wi: Vec3) -> Evaluation {
        self.at(i, base).eval(wo, wi, self.leaves[i])
    }
}

impl Wave<'_> {
    /// Lays out the rough plastic of the surface in hand, if it is one.
    #[inline(always)]
    pub fn lay_out_coat(&mut self, i: usize) {
        let wo = self.wo.at(i);
        if let Some(base) = self.coats.lay_out(i, &self.shadings[i], wo) {
            self.is_coat[i] = true;
            self.albedo.set(i, base);
        }
    }

    /// Looks up how much light passes the coats from local directions with these cosines.
    #[inline(always)]
    fn look_up_leaves(&mut self, count: usize, cos: impl Fn(&Self, usize) -> f32) {
        for k in 0..count {
            let i = self.chosen[k];
            if self.is_coat[i] {
                let cos = cos(self, i);
                self.coats.look_up_leaves(i, &self.shadings[i], cos);
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
            let evaluation = wave.coats.eval(i, wave.albedo.at(i), wave.wo.at(i), wave.towards_light(i));
            weigh_if(wave, i, evaluation, with_bsdf, wave.is_coat[i]);
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
            let wi = wave.coats.at(i, wave.albedo.at(i)).direction(
                wave.wo.at(i),
                wave.numbers.lobe[i],
                wave.numbers.direction.at(i),
            );
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
            let (sample, is_some) =
                wave.coats.at(i, wave.albedo.at(i)).sample(wave.wo.at(i), wave.coats.wi.at(i), wave.coats.leaves[i]);
            wave.next.set_if(i, sample, is_some, &wave.frame.at(i), wave.is_coat[i]);
        }
    }
}
