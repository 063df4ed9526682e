//! From a hit to the closure that scatters there: textures are looked up, sides and masks decided.

use crate::bsdf::{Closure, Conductor, Dielectric, Diffuse, Phong};
use crate::frame::Frame;
use crate::scene::{Bsdf, BsdfId, Shape};
use crate::surface::Surface;
use crate::texture::Textures;
use glam::Vec3;

/// The materials of a scene.
pub struct Materials {
    bsdfs: Vec<Bsdf>,
    of_shape: Vec<BsdfId>,
}

/// How light scatters at one hit.
#[derive(Clone, Copy, Debug)]
pub struct Shading {
    /// The model.
    pub closure: Closure,
    /// Its local space.
    pub frame: Frame,
}

impl Materials {
    /// The materials of these shapes.
    pub fn new(bsdfs: &[Bsdf], shapes: &[Shape]) -> Self {
        Self { bsdfs: bsdfs.to_vec(), of_shape: shapes.iter().map(|s| s.bsdf).collect() }
    }

    /// The closure at `surface`, seen from the direction `wo`. A mask answers at random, by `lobe`: with the probability of
    /// its opacity the surface is there, else nothing is. The mean over `lobe` is the mask's blend, and a path goes on in one
    /// way. The rest of `lobe` is handed back as a fresh number.
    #[inline]
    pub fn at(&self, textures: &Textures, surface: &Surface, wo: Vec3, lobe: &mut f32) -> Shading {
        let mut frame = surface.frame;
        let mut id = self.of_shape[surface.shape as usize];
        let value = |id| textures.at(id, surface.uv);
        loop {
            let closure = match &self.bsdfs[id.0 as usize] {
                Bsdf::TwoSided { front, back } => {
                    if frame.n.dot(wo) < 0.0 {
                        (id, frame) = (*back, frame.turned_over());
                    } else {
                        id = *front;
                    }
                    continue;
                }
                Bsdf::Mask { opacity, nested } => {
                    let opacity = value(*opacity).x.clamp(0.0, 1.0);
                    if *lobe < opacity {
                        *lobe /= opacity;
                        id = *nested;
                        continue;
                    }
                    *lobe = ((*lobe - opacity) / (1.0 - opacity)).min(1.0 - f32::EPSILON);
                    Closure::Null
                }
                Bsdf::Diffuse { reflectance } => Closure::Diffuse(Diffuse { reflectance: value(*reflectance) }),
                Bsdf::Conductor { eta, k, specular_reflectance } => Closure::Conductor(Conductor {
                    eta: value(*eta),
                    k: value(*k),
                    specular_reflectance: value(*specular_reflectance),
                }),
                Bsdf::Dielectric { eta, specular_reflectance, specular_transmittance } => {
                    Closure::Dielectric(Dielectric {
                        eta: *eta,
                        specular_reflectance: value(*specular_reflectance),
                        specular_transmittance: value(*specular_transmittance),
                    })
                }
                Bsdf::Phong { diffuse_reflectance, specular_reflectance, exponent } => Closure::Phong(Phong {
                    kd: value(*diffuse_reflectance),
                    ks: value(*specular_reflectance),
                    exponent: *exponent,
                }),
            };
            return Shading { closure, frame };
        }
    }
}
