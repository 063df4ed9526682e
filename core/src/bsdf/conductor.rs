//! A smooth metal: a mirror that absorbs what Fresnel's equations say.

use super::{Sample, fresnel, mirrored};
use glam::Vec3;

/// Its parameters.
#[derive(Clone, Copy, Debug)]
pub struct Conductor {
    /// Real part of the index of refraction.
    pub eta: Vec3,
    /// Imaginary part.
    pub k: Vec3,
    /// Factor on the reflection.
    pub specular_reflectance: Vec3,
}

impl Conductor {
    /// The mirror direction.
    #[inline(always)]
    pub fn sample(&self, wo: Vec3) -> Option<Sample> {
        (wo.z > 0.0).then(|| Sample {
            wi: mirrored(wo),
            weight: self.specular_reflectance * fresnel::conductor(wo.z, self.eta, self.k),
            pdf: f32::INFINITY,
            eta: 1.0,
        })
    }
}
