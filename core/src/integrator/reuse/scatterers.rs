//! Sixteen ways to scatter, evaluated side by side.

use super::super::coats::Coats;
use super::super::rows::Vec3s;
use super::super::scatter::Eval;
use super::GROUP;
use crate::bsdf::{Diffuse, Evaluation};
use crate::bvh::simd::{Kernel, Lanes};
use crate::shading::Shading;
use glam::Vec3;

/// How light scatters at one surface or several, for as many pairs of directions.
pub(super) struct Scatterers {
    kind: [Kind; GROUP],
    has_coats: bool,
    has_others: bool,
    pub wo: Vec3s<GROUP>,
    albedo: Vec3s<GROUP>,
    coats: Coats<GROUP>,
    /// Local directions to be evaluated, and what comes of them.
    pub wi: Vec3s<GROUP>,
    pub value: Vec3s<GROUP>,
    pub pdf: [f32; GROUP],
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    /// Nothing scatters, or into finitely many directions only.
    None,
    Diffuse,
    Coat,
    Other,
}

impl Scatterers {
    pub fn new() -> Self {
        Self {
            kind: [Kind::None; GROUP],
            has_coats: false,
            has_others: false,
            wo: Vec3s::ZERO,
            albedo: Vec3s::ZERO,
            coats: Coats::NONE,
            wi: Vec3s::ZERO,
            value: Vec3s::ZERO,
            pdf: [0.0; GROUP],
        }
    }

    pub fn clear(&mut self) {
        self.kind = [Kind::None; GROUP];
        (self.has_coats, self.has_others) = (false, false);
    }

    /// Takes Lambert's reflector.
    #[inline(always)]
    pub fn set_diffuse(&mut self, k: usize, wo: Vec3, albedo: Vec3) {
        self.kind[k] = Kind::Diffuse;
        self.wo.set(k, wo);
        self.albedo.set(k, albedo);
    }

    /// Takes any other model.
    #[inline(always)]
    pub fn set(&mut self, k: usize, wo: Vec3, shading: &Shading) {
        self.wo.set(k, wo);
        if let Some(base) = self.coats.lay_out(k, shading, wo) {
            self.albedo.set(k, base);
            (self.kind[k], self.has_coats) = (Kind::Coat, true);
        } else {
            (self.kind[k], self.has_others) = (Kind::Other, true);
        }
    }

    /// Evaluates all of them. `shadings` are theirs, or one that is the same for all.
    #[inline(always)]
    pub fn evaluate<L: Lanes>(&mut self, lanes: L, shadings: &[Shading]) {
        lanes.run(Diffuses(self));
        let shading = |k: usize| &shadings[k.min(shadings.len() - 1)];
        if self.has_coats {
            for k in 0..GROUP {
                if self.kind[k] == Kind::Coat {
                    self.coats.look_up_leaves(k, shading(k), self.wi.at(k).z);
                }
            }
            lanes.run(Coated(self));
        }
        if self.has_others {
            for k in 0..GROUP {
                if self.kind[k] == Kind::Other {
                    let evaluation = lanes.run(Eval { shading: shading(k), wo: self.wo.at(k), wi: self.wi.at(k) });
                    self.value.set(k, evaluation.value);
                    self.pdf[k] = evaluation.pdf;
                }
            }
        }
    }
}

struct Diffuses<'a>(&'a mut Scatterers);

impl Kernel for Diffuses<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        let all = self.0;
        for k in 0..GROUP {
            let diffuse = Diffuse { reflectance: all.albedo.at(k) };
            let Evaluation { value, pdf } = diffuse.eval(all.wo.at(k), all.wi.at(k));
            let is_some = all.kind[k] as u8 == Kind::Diffuse as u8;
            all.value.set(k, if is_some { value } else { Vec3::ZERO });
            all.pdf[k] = if is_some { pdf } else { 0.0 };
        }
    }
}

struct Coated<'a>(&'a mut Scatterers);

impl Kernel for Coated<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) {
        let all = self.0;
        for k in 0..GROUP {
            let Evaluation { value, pdf } = all.coats.eval(k, all.albedo.at(k), all.wo.at(k), all.wi.at(k));
            let is_some = all.kind[k] as u8 == Kind::Coat as u8;
            all.value.set(k, if is_some { value } else { all.value.at(k) });
            all.pdf[k] = if is_some { pdf } else { all.pdf[k] };
        }
    }
}
