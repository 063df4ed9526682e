//! A pane of glass as one sheet: light is reflected to and fro between its faces, and leaves as it came or as from a mirror.

use super::{Sample, fresnel, mirrored};
use glam::Vec3;

/// Its parameters.
#[derive(Clone, Copy, Debug)]
pub struct ThinDielectric {
    /// Index of refraction inside over outside.
    pub eta: f32,
    /// Factor on the reflection.
    pub specular_reflectance: Vec3,
    /// Factor on the transmission.
    pub specular_transmittance: Vec3,
}

impl ThinDielectric {
    /// The mirror direction with probability of the pane's reflectance, else straight on. With r of one face, the pane
    /// reflects r + (1−r)² r (1 + r² + r⁴ + …) = 2r/(1+r).
    #[inline]
    pub fn sample(&self, wo: Vec3, lobe: f32) -> Option<Sample> {
        let face = fresnel::dielectric(wo.z.abs(), self.eta).reflectance;
        let (wi, weight) = if lobe < 2.0 * face / (1.0 + face) {
            (mirrored(wo), self.specular_reflectance)
        } else {
            (-wo, self.specular_transmittance)
        };
        (wo.z != 0.0).then_some(Sample { wi, weight, pdf: f32::INFINITY, eta: 1.0 })
    }
}
