//! What lies beyond the scene: radiance by direction, and directions by radiance.

use super::environment::{Environment, Facing};
use super::luminance;
use crate::sampler::fraction;
use crate::texture::Textures;
use crate::warp::{UNIFORM_SPHERE_PDF, uniform_sphere};
use glam::{Vec2, Vec3};

/// The one background of a scene.
pub enum Background {
    /// The same radiance from everywhere.
    Constant(Vec3),
    /// An image all around.
    Environment(Box<Environment>),
}

impl Background {
    /// Radiance from the unit direction `wi`, and the density of [`Background::sample`] there, in solid angle. With `mis` the
    /// density leaves gaps where other sampling does better.
    #[inline(always)]
    pub fn at(&self, textures: &Textures, wi: Vec3, mis: bool) -> (Vec3, f32) {
        match self {
            Background::Constant(radiance) => (*radiance, UNIFORM_SPHERE_PDF),
            Background::Environment(environment) => environment.at(textures, wi, Facing::ANY, mis),
        }
    }

    /// A direction to light from, and what [`Background::at`] has there.
    #[inline(always)]
    pub fn sample(&self, textures: &Textures, u: Vec2, mis: bool) -> (Vec3, Vec3, f32) {
        match self {
            Background::Constant(radiance) => (uniform_sphere(u), *radiance, UNIFORM_SPHERE_PDF),
            Background::Environment(environment) => {
                let numbers = [u.x, u.y].map(|u| fraction(u, 0));
                environment.sample(textures, numbers, Facing::ANY, mis).unwrap_or((Vec3::Z, Vec3::ZERO, 0.0))
            }
        }
    }

    /// Luminance of the radiance, its mean over all directions.
    pub fn mean_luminance(&self) -> f32 {
        match self {
            Background::Constant(radiance) => luminance(*radiance),
            Background::Environment(environment) => environment.mean_luminance(),
        }
    }
}
