//! Scattering models. Directions are local (the normal is +z) and point away from the surface: `wo` to the viewer, `wi` to
//! where the light comes from. A model's `eval`, `sample` and `pdf` stand together in its own file.
//!
//! A [`Closure`] is a model with its parameters looked up at one hit. What composes models (two sides, masks) is decided
//! before, in [`crate::shading`], so a closure is never nested.

mod conductor;
mod dielectric;
mod diffuse;
mod fresnel;
mod phong;

pub use conductor::Conductor;
pub use dielectric::Dielectric;
pub use diffuse::Diffuse;
pub use phong::Phong;

use glam::{Vec2, Vec3};

/// A scattering model at a hit.
#[derive(Clone, Copy, Debug)]
pub enum Closure {
    /// Lambert's.
    Diffuse(Diffuse),
    /// Smooth metal.
    Conductor(Conductor),
    /// Smooth glass.
    Dielectric(Dielectric),
    /// Lambert and a cosine lobe.
    Phong(Phong),
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

impl Closure {
    /// Scatters into finitely many directions only.
    #[inline]
    pub fn is_delta(&self) -> bool {
        match self {
            Closure::Diffuse(_) | Closure::Phong(_) => false,
            Closure::Conductor(_) | Closure::Dielectric(_) | Closure::Null => true,
        }
    }

    /// Value and density for a given direction; zero for what is a delta distribution.
    #[inline]
    pub fn eval(&self, wo: Vec3, wi: Vec3) -> Evaluation {
        match self {
            Closure::Diffuse(model) => model.eval(wo, wi),
            Closure::Phong(model) => model.eval(wo, wi),
            Closure::Conductor(_) | Closure::Dielectric(_) | Closure::Null => Evaluation::default(),
        }
    }

    /// A direction for the numbers `lobe` and `u`, or none where light is absorbed.
    #[inline]
    pub fn sample(&self, wo: Vec3, lobe: f32, u: Vec2) -> Option<Sample> {
        match self {
            Closure::Diffuse(model) => model.sample(wo, u),
            Closure::Conductor(model) => model.sample(wo),
            Closure::Dielectric(model) => model.sample(wo, lobe),
            Closure::Phong(model) => model.sample(wo, lobe, u),
            Closure::Null => Some(Sample { wi: -wo, weight: Vec3::ONE, pdf: f32::INFINITY, eta: 1.0 }),
        }
    }
}

/// Both directions on the side of the normal.
#[inline]
fn both_above(wo: Vec3, wi: Vec3) -> bool {
    wo.z > 0.0 && wi.z > 0.0
}

/// The mirror image of `w` in the normal.
#[inline]
fn mirrored(w: Vec3) -> Vec3 {
    Vec3::new(-w.x, -w.y, w.z)
}

#[cfg(test)]
mod tests;
