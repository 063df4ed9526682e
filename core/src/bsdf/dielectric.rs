//! A smooth interface between transparent media: reflects or refracts, chosen by Fresnel's reflectance.

use super::{Sample, fresnel, mirrored};
use glam::Vec3;

/// Its parameters.
#[derive(Clone, Copy, Debug)]
pub struct Dielectric {
    /// Index of refraction inside over outside.
    pub eta: f32,
    /// Factor on the reflection.
    pub specular_reflectance: Vec3,
    /// Factor on the transmission.
    pub specular_transmittance: Vec3,
}

impl Dielectric {
    /// The mirror direction with probability of the reflectance, else the refracted one. Radiance that crosses the interface
    /// is scaled by the square of the ratio of indices: light bundles widen or narrow (Veach 1997, §5.2).
    #[inline(always)]
    pub fn sample(&self, wo: Vec3, lobe: f32) -> Option<Sample> {
        let interface = fresnel::dielectric(wo.z, self.eta);
        if wo.z == 0.0 {
            None
        } else if lobe < interface.reflectance {
            let weight = self.specular_reflectance;
            Some(Sample { wi: mirrored(wo), weight, pdf: f32::INFINITY, eta: 1.0 })
        } else {
            let scale = 1.0 / interface.eta;
            let wi = Vec3::new(-wo.x * scale, -wo.y * scale, interface.cos_transmitted);
            let weight = self.specular_transmittance * (scale * scale);
            Some(Sample { wi, weight, pdf: f32::INFINITY, eta: interface.eta })
        }
    }
}
