//! What the principled models share: Schlick's Fresnel, the diffuse response, sheen and the clear coat of Burley 2012,
//! "Physically Based Shading at Disney", and 2015, "Extending the Disney BRDF to a BSDF with Integrated Subsurface
//! Scattering", in Mitsuba's variants.

use crate::texture::luminance;
use crate::warp::around_z;
use glam::{Vec2, Vec3};
use std::f32::consts::PI;

/// Roughness of the masking of the clear coat, whatever its gloss.
const CLEARCOAT_MASKING_ALPHA: f32 = 0.25;

/// a + (b − a) t, exact at both ends.
#[inline]
fn lerp(a: f32, b: f32, t: f32) -> f32 {
    a * (1.0 - t) + b * t
}

/// (1 − cos)⁵.
#[inline]
pub fn schlick_weight(cos: f32) -> f32 {
    let m = (1.0 - cos).clamp(0.0, 1.0);
    m * m * (m * m) * m
}

/// Schlick's share of the way from the reflectance at normal incidence to one, at a positive cosine; `eta` is the far side's
/// index over the near side's. Where it is below one the angle is that of the refracted direction.
#[inline]
pub fn schlick(cos: f32, eta: f32) -> f32 {
    if eta > 1.0 {
        return schlick_weight(cos);
    }
    let cos2_t = 1.0 - (1.0 - cos * cos) / (eta * eta);
    schlick_weight(cos2_t.max(0.0).sqrt())
}

/// Schlick's reflectance, `f0` at normal incidence.
#[inline]
pub fn schlick_fresnel(f0: Vec3, cos: f32, eta: f32) -> Vec3 {
    let t = schlick(cos, eta);
    f0 * (1.0 - t) + Vec3::splat(t)
}

/// Reflectance of a dielectric at normal incidence.
#[inline]
pub fn f0_of(eta: f32) -> f32 {
    let root = (eta - 1.0) / (eta + 1.0);
    root * root
}

/// The colour at luminance one, white for black.
#[inline]
pub fn tint(colour: Vec3) -> Vec3 {
    let luminance = luminance(colour);
    if luminance > 0.0 { colour / luminance } else { Vec3::ONE }
}

/// GGX roughnesses along the tangents.
#[inline]
pub fn alphas(roughness: f32, anisotropic: f32) -> Vec2 {
    let aspect = (1.0 - 0.9 * anisotropic).max(0.0).sqrt();
    let squared = roughness * roughness;
    Vec2::new(squared / aspect, squared * aspect).max(Vec2::splat(0.001))
}

/// What the diffuse lobe does over Lambert's 1/π: darkening and retro-reflection by roughness, towards a flat subsurface
/// look. Cosines are positive; `cos_d` is that between a direction and the half vector.
#[inline]
pub fn diffuse_response(roughness: f32, flatness: f32, cos_o: f32, cos_i: f32, cos_d: f32) -> f32 {
    let (fo, fi) = (schlick_weight(cos_o), schlick_weight(cos_i));
    let retro = 2.0 * roughness * cos_d * cos_d;
    let rough = (1.0 - 0.5 * fo) * (1.0 - 0.5 * fi) + retro * (fo + fi + fo * fi * (retro - 1.0));
    if flatness == 0.0 {
        return rough;
    }
    let fss90 = 0.5 * retro;
    let fss = lerp(1.0, fss90, fo) * lerp(1.0, fss90, fi);
    let flat = 1.25 * (fss * (1.0 / (cos_o + cos_i) - 0.5) + 0.5);
    lerp(rough, flat, flatness)
}

/// The sheen at grazing angles, of strength one.
#[inline]
pub fn sheen_response(base_color: Vec3, sheen_tint: f32, cos_d: f32) -> Vec3 {
    (Vec3::ONE * (1.0 - sheen_tint) + tint(base_color) * sheen_tint) * schlick_weight(cos_d)
}

/// The clear coat's facets: GTR with exponent one (Burley 2012, eq. 4), whose tail is longer than GGX's.
#[derive(Clone, Copy, Debug)]
pub struct Clearcoat {
    alpha2: f32,
}

impl Clearcoat {
    /// Roughness from 0.1 to 0.001 as `gloss` goes from 0 to 1.
    #[inline]
    pub fn new(gloss: f32) -> Self {
        let alpha = lerp(0.1, 0.001, gloss);
        Self { alpha2: alpha * alpha }
    }

    /// D(m).
    #[inline]
    pub fn density(self, m: Vec3) -> f32 {
        let tail = self.alpha2 - 1.0;
        // 1 − (1 − α²) cos² = sin² + α² cos², which keeps its digits near the pole.
        let spread = m.x * m.x + m.y * m.y + self.alpha2 * m.z * m.z;
        tail / (PI * libm::logf(self.alpha2) * spread)
    }

    /// Density of [`Self::sample`] over normals.
    #[inline]
    pub fn pdf(self, m: Vec3) -> f32 {
        self.density(m) * m.z.max(0.0)
    }

    /// A facet normal, by area.
    #[inline]
    pub fn sample(self, u: Vec2) -> Vec3 {
        let cos2 = (1.0 - libm::powf(self.alpha2, 1.0 - u.y)) / (1.0 - self.alpha2);
        around_z(cos2.clamp(0.0, 1.0).sqrt(), u.x)
    }

    /// G1 of both directions.
    #[inline]
    pub fn masking(wo: Vec3, wi: Vec3) -> f32 {
        let one = |cos: f32| {
            const ALPHA2: f32 = CLEARCOAT_MASKING_ALPHA * CLEARCOAT_MASKING_ALPHA;
            2.0 * cos / (cos + (cos * cos + ALPHA2 * (1.0 - cos * cos).max(0.0)).sqrt())
        };
        one(wo.z) * one(wi.z)
    }
}
