//! Scattering models. Directions are local (the normal is +z) and point away from the surface: `wo` to the viewer, `wi` to
//! where the light comes from. A model's `eval`, `sample` and `pdf` stand together in its own file.
//!
//! A [`Closure`] is a model with its parameters looked up at one hit. What composes models (two sides, masks) is decided
//! before, in [`crate::shading`], so a closure is never nested.

mod beckmann;
mod conductor;
mod dielectric;
mod diffuse;
mod disney;
mod fresnel;
mod microfacet;
mod phong;
mod plastic;
mod principled;
mod principledthin;
mod roughconductor;
mod roughdielectric;
mod roughplastic;
mod thindielectric;

pub use conductor::Conductor;
pub use dielectric::Dielectric;
pub use diffuse::Diffuse;
pub use disney::alphas;
pub use microfacet::Microfacet;
pub use phong::Phong;
pub use plastic::Plastic;
pub use principled::Principled;
pub use principledthin::PrincipledThin;
pub use roughconductor::RoughConductor;
pub use roughdielectric::RoughDielectric;
pub use roughplastic::{RoughCoat, RoughPlastic, SeenPlastic};
pub use thindielectric::ThinDielectric;

use glam::{Vec2, Vec3};

/// A scattering model at a hit. It borrows what is tabulated once a material.
#[derive(Clone, Copy, Debug)]
pub enum Closure<'a> {
    /// Lambert's.
    Diffuse(Diffuse),
    /// Smooth metal.
    Conductor(Conductor),
    /// Rough metal.
    RoughConductor(RoughConductor),
    /// Smooth glass.
    Dielectric(Dielectric),
    /// Rough glass.
    RoughDielectric(RoughDielectric),
    /// A pane of smooth glass.
    ThinDielectric(ThinDielectric),
    /// Lambert under a smooth coat.
    Plastic(Plastic),
    /// Lambert under a rough coat.
    RoughPlastic(RoughPlastic<'a>),
    /// Lambert and a cosine lobe.
    Phong(Phong),
    /// Burley's.
    Principled(Principled),
    /// Burley's for thin sheets.
    PrincipledThin(PrincipledThin),
    /// Nothing there: light goes straight through.
    Null,
}

/// What a model does with light from `wi`, and how likely it would have chosen `wi` itself.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Evaluation {
    /// f(wi, wo) · |cos θi|.
    pub value: Vec3,
    /// Density of [`Closure::sample`] at `wi`, in solid angle.
    pub pdf: f32,
}

/// A direction chosen by a model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Where the light would come from.
    pub wi: Vec3,
    /// f(wi, wo) · |cos θi| / pdf.
    pub weight: Vec3,
    /// Density in solid angle; [`f32::INFINITY`] for a delta distribution (mirror, glass, nothing).
    pub pdf: f32,
    /// Index of refraction on wi's side over that on wo's side; 1 unless refracted.
    pub eta: f32,
}

impl Sample {
    /// The direction is one of finitely many: light sampling can never find it.
    #[inline]
    pub fn is_delta(&self) -> bool {
        self.pdf == f32::INFINITY
    }
}

impl Closure<'_> {
    /// Scatters into finitely many directions only.
    #[inline(always)]
    pub fn is_delta(&self) -> bool {
        use Closure::{Conductor, Dielectric, Null, ThinDielectric};
        matches!(self, Conductor(_) | Dielectric(_) | ThinDielectric(_) | Null)
    }

    /// The share of numbers `lobe`, from zero on, for which [`Closure::sample`] chooses one of finitely many directions:
    /// all for a mirror, those of its coat for smooth plastic.
    #[inline(always)]
    pub fn delta_share(&self, wo: Vec3) -> f32 {
        match self {
            Closure::Plastic(model) => model.mirror_share(wo),
            Closure::RoughDielectric(model) if model.is_straight() => 1.0,
            _ if self.is_delta() => 1.0,
            _ => 0.0,
        }
    }

    /// [`Closure::eval`] may be positive for directions on opposite sides.
    #[inline(always)]
    pub fn transmits(&self) -> bool {
        match self {
            Closure::RoughDielectric(_) | Closure::PrincipledThin(_) => true,
            Closure::Principled(model) => model.transmits(),
            _ => false,
        }
    }

    /// Value and density for a given direction; zero for what is a delta distribution.
    #[inline(always)]
    pub fn eval(&self, wo: Vec3, wi: Vec3) -> Evaluation {
        match self {
            Closure::Diffuse(model) => model.eval(wo, wi),
            Closure::RoughConductor(model) => model.eval(wo, wi),
            Closure::RoughDielectric(model) => model.eval(wo, wi),
            Closure::Plastic(model) => model.eval(wo, wi),
            Closure::RoughPlastic(model) => model.eval(wo, wi),
            Closure::Phong(model) => model.eval(wo, wi),
            Closure::Principled(model) => model.eval(wo, wi),
            Closure::PrincipledThin(model) => model.eval(wo, wi),
            Closure::Conductor(_) | Closure::Dielectric(_) | Closure::ThinDielectric(_) | Closure::Null => {
                Evaluation::default()
            }
        }
    }

    /// A direction for the numbers `lobe` and `u`, or none where light is absorbed.
    #[inline(always)]
    pub fn sample(&self, wo: Vec3, lobe: f32, u: Vec2) -> Option<Sample> {
        match self {
            Closure::Diffuse(model) => model.sample(wo, u),
            Closure::Conductor(model) => model.sample(wo),
            Closure::RoughConductor(model) => model.sample(wo, u),
            Closure::Dielectric(model) => model.sample(wo, lobe),
            Closure::RoughDielectric(model) => model.sample(wo, lobe, u),
            Closure::ThinDielectric(model) => model.sample(wo, lobe),
            Closure::Plastic(model) => model.sample(wo, lobe, u),
            Closure::RoughPlastic(model) => model.sample(wo, lobe, u),
            Closure::Phong(model) => model.sample(wo, lobe, u),
            Closure::Principled(model) => model.sample(wo, lobe, u),
            Closure::PrincipledThin(model) => model.sample(wo, lobe, u),
            Closure::Null => Some(Sample { wi: -wo, weight: Vec3::ONE, pdf: f32::INFINITY, eta: 1.0 }),
        }
    }
}

/// Both directions on the side of the normal.
#[inline(always)]
fn both_above(wo: Vec3, wi: Vec3) -> bool {
    (wo.z > 0.0) & (wi.z > 0.0)
}

/// The mirror image of `w` in the normal.
#[inline]
fn mirrored(w: Vec3) -> Vec3 {
    Vec3::new(-w.x, -w.y, w.z)
}

#[cfg(test)]
mod tests;
