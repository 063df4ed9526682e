//! Points that shine in some directions only: Mitsuba's `spot` and `projector`.

use super::luminance;
use crate::scene::TextureId;
use crate::texture::Textures;
use glam::{Affine3, Mat3, Vec2, Vec3};
use std::f32::consts::PI;

/// A point light with a direction.
#[derive(Clone, Copy, Debug)]
pub struct Spot {
    pub position: Vec3,
    /// Unit axis in the scene.
    pub axis: Vec3,
    /// Scene directions to the light's own, where +z is its axis.
    to_local: Mat3,
    beam: Beam,
}

#[derive(Clone, Copy, Debug)]
enum Beam {
    /// A cone, constant within `beam_width`, falling linearly with the angle to zero at `cutoff` (radians).
    Cone { intensity: Vec3, cutoff: f32, beam_width: f32, texture: Option<TextureId> },
    /// An image thrown onto the plane z = 1, whose half width and height are `extent`.
    Image { irradiance: TextureId, scale: f32, extent: Vec2 },
}

impl Spot {
    /// A cone around +z; angles in degrees.
    pub fn cone(
        to_world: &Affine3,
        intensity: Vec3,
        [cutoff, beam_width]: [f32; 2],
        texture: Option<TextureId>,
    ) -> Self {
        let [cutoff, beam_width] = [cutoff, beam_width].map(f32::to_radians);
        Self::new(to_world, Beam::Cone { intensity, cutoff, beam_width, texture })
    }

    /// A projector along +z.
    pub fn image(to_world: &Affine3, irradiance: TextureId, scale: f32, half_extent: [f32; 2]) -> Self {
        Self::new(to_world, Beam::Image { irradiance, scale, extent: Vec2::from_array(half_extent) })
    }

    fn new(to_world: &Affine3, beam: Beam) -> Self {
        Self {
            position: to_world.translation,
            axis: to_world.matrix3.z_axis.normalize(),
            to_local: to_world.matrix3.inverse(),
            beam,
        }
    }

    /// Radiant intensity in the direction `w` (W·sr⁻¹).
    #[inline]
    pub fn intensity(&self, textures: &Textures, w: Vec3) -> Vec3 {
        let local = self.to_local * w;
        if local.z <= 0.0 {
            return Vec3::ZERO;
        }
        let plane = Vec2::new(local.x, local.y) / local.z; // at z = 1
        match self.beam {
            Beam::Cone { intensity, cutoff, beam_width, texture } => {
                let angle = libm::atanf(plane.length());
                if angle >= cutoff {
                    return Vec3::ZERO;
                }
                let falloff = if angle <= beam_width { 1.0 } else { (cutoff - angle) / (cutoff - beam_width) };
                let uv = Vec2::splat(0.5) + plane * (0.5 / libm::tanf(cutoff));
                intensity * falloff * texture.map_or(Vec3::ONE, |id| textures.at_uv(id, uv))
            }
            Beam::Image { irradiance, scale, extent } => {
                let across = plane / extent;
                if across.x.abs() > 1.0 || across.y.abs() > 1.0 {
                    return Vec3::ZERO;
                }
                // The plane z = 1 shall get π times the image: E = I cos³θ there.
                let cos2 = 1.0 / (1.0 + plane.length_squared());
                let uv = Vec2::splat(0.5) - across * 0.5;
                textures.at_uv(irradiance, uv) * (PI * scale / (cos2 * cos2.sqrt()))
            }
        }
    }

    /// Luminance of all that it sends out.
    pub fn power(&self, textures: &Textures) -> f32 {
        match self.beam {
            Beam::Cone { intensity, cutoff, beam_width, texture } => {
                let mean = texture.map_or(Vec3::ONE, |id| textures.mean(id));
                // The falling part counts half.
                let solid_angle = 2.0 * PI * (1.0 - 0.5 * (libm::cosf(cutoff) + libm::cosf(beam_width)));
                luminance(intensity * mean) * solid_angle
            }
            Beam::Image { irradiance, scale, extent } => {
                luminance(textures.mean(irradiance)) * scale * PI * 4.0 * extent.x * extent.y
            }
        }
    }

    /// The largest angle to its axis in which it shines.
    pub fn half_angle(&self) -> f32 {
        match self.beam {
            Beam::Cone { cutoff, .. } => cutoff,
            Beam::Image { extent, .. } => libm::atanf(extent.length()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Scene, Texture};
    use crate::warp::uniform_sphere;
    use glam::Quat;

    fn textures() -> Textures {
        let (black, white) = (Texture::Constant(Vec3::ZERO), Texture::Constant(Vec3::splat(3.0)));
        let to_uv = glam::Affine2::from_translation(Vec2::new(0.0, 0.25));
        let quarters = Texture::Checkerboard { color0: TextureId(0), color1: TextureId(1), to_uv };
        Textures::new(&Scene { textures: vec![black, white, quarters], ..Scene::empty() })
    }

    fn to_world() -> Affine3 {
        let rotation = Mat3::from_quat(Quat::from_xyzw(0.1, 0.3, -0.2, 0.9).normalize());
        Affine3 { matrix3: rotation, translation: Vec3::new(1.0, 2.0, 3.0) }
    }

    /// Mitsuba 3.9.1 for a cutoff of 40° and a beam of 25°: full inside, ⅔ at 30°, nothing at 40.1°.
    #[test]
    fn a_spot_falls_off_with_the_angle() {
        let spot = Spot::cone(&to_world(), Vec3::splat(2.0), [40.0, 25.0], None);
        for (degrees, expected) in [(0.0, 2.0), (24.9, 2.0), (30.0, 4.0 / 3.0), (39.9, 0.4 / 30.0), (40.1, 0.0)] {
            let (sin, cos) = libm::sincosf(f32::to_radians(degrees));
            let w = to_world().matrix3 * Vec3::new(0.8 * sin, 0.6 * sin, cos);
            assert!((spot.intensity(&textures(), w).x - expected).abs() < 1e-4, "at {degrees}°");
        }
    }

    /// Power is intensity over all directions: exact for an image, within the stated approximation for a spot's edge.
    #[test]
    fn power_is_the_integral_of_intensity() {
        let textures = textures();
        let cone = Spot::cone(&to_world(), Vec3::ONE, [50.0, 40.0], Some(TextureId(1)));
        let image = Spot::image(&to_world(), TextureId(2), 0.5, [0.7, 0.4]);
        for spot in [cone, image] {
            let n = 500;
            let sum: f64 = (0..n * n)
                .map(|i| Vec2::new((i / n) as f32 + 0.5, (i % n) as f32 + 0.5) / n as f32)
                .map(|u| f64::from(luminance(spot.intensity(&textures, uniform_sphere(u)))))
                .sum();
            let power = 4.0 * std::f64::consts::PI * sum / f64::from(n * n);
            let claimed = f64::from(spot.power(&textures));
            assert!((power - claimed).abs() < 0.02 * claimed, "{spot:?}: {power}, not {claimed}");
        }
    }
}
