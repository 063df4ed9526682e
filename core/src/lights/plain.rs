//! Flat triangles that shine alike everywhere, the light that most scenes have: without branches, for loops over many surfaces.

use super::{LightSample, triangle};
use crate::geometry::{Place, place};
use crate::surface::Surface;
use glam::{Vec2, Vec3};

/// Such a light.
#[derive(Clone, Copy, Debug)]
pub struct Plain {
    /// Its vertices.
    pub corners: [Vec3; 3],
    /// Its area.
    pub area: f32,
    /// Its radiance.
    pub radiance: Vec3,
}

impl Plain {
    /// As [`super::Lights::sample`]; and whether light comes at all, without which the sample is meaningless.
    #[inline(always)]
    pub fn sample(&self, surface: &Surface, probability: f32, u: Vec2) -> (LightSample, bool) {
        let (b, density) = triangle::sample(self.corners, surface.position, u);
        let Place { position, error, normal, frame, .. } = place(self.corners, Vec3::ZERO, b);
        let pdf = density.at(surface.position, position, self.area, normal) * probability;
        from_surface(self.radiance, surface, &Surface { position, error, normal, frame, ..*surface }, pdf)
    }
}

/// Light from a point of a surface, and whether it comes.
#[inline(always)]
pub fn from_surface(radiance: Vec3, surface: &Surface, point: &Surface, pdf: f32) -> (LightSample, bool) {
    let wi = (point.position - surface.position).normalize();
    let shines = (pdf > 0.0) & (pdf < f32::INFINITY) & (point.frame.n.dot(wi) < 0.0);
    (LightSample { wi, weight: radiance / pdf, pdf, shadow_ray: surface.ray_to(point) }, shines)
}
