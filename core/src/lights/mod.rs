//! The lights of a scene: which to sample, where on it, and how likely that was.
//!
//! A light is what has one density: a triangle or analytic surface that emits, a point, a direction, the background.

mod alias;
mod background;
mod choice;
mod environment;
mod list;
mod plain;
mod spot;
#[cfg(test)]
mod tests;
mod tree;
mod triangle;

use crate::bvh::simd::Lanes;
use crate::bvh::{Boxes, Ray};
use crate::geometry::Geometry;
use crate::scene::Scene;
use crate::surface::Surface;
use crate::texture::Textures;
use background::Background;
use choice::Choice;
pub use environment::{Cell, Environment, Facing, Globe, Patch, Row};
use glam::{Vec2, Vec3};
use list::Light;
pub use plain::Plain;
use plain::from_surface;

/// All lights and their probabilities.
pub struct Lights {
    lights: Vec<Light>,
    choice: Choice,
    /// Whether one random number does for the choice and a coordinate on the light.
    one_number: bool,
    /// Around all that a ray can meet and that shines; none if that may be everywhere.
    reachable: Option<Boxes>,
    /// The background and the probability to choose it.
    background: Option<(Background, f32)>,
}

/// Light that reaches a surface along one ray, if nothing is in between.
#[derive(Clone, Copy, Debug)]
pub struct LightSample {
    /// Unit direction to the light.
    pub wi: Vec3,
    /// Radiance from there over its density: for delta lights, the irradiance across `wi` over the probability.
    pub weight: Vec3,
    /// Density in solid angle; [`f32::INFINITY`] for a light that no other sampling can find.
    pub pdf: f32,
    /// The ray that must be free.
    pub shadow_ray: Ray,
}

impl Lights {
    /// How many lights each shape will be, in order of shapes: its number of primitives if it emits. The returned indices
    /// are those of the first ones, as [`Geometry::new`] wants them.
    pub fn first_of_shapes(scene: &Scene) -> Vec<Option<u32>> {
        let mut next = 0u32;
        let mut first = Vec::with_capacity(scene.shapes.len());
        for shape in &scene.shapes {
            first.push(shape.radiance.map(|_| next));
            if shape.radiance.is_some() {
                next += match &shape.geometry {
                    crate::scene::Geometry::Mesh(id) => scene.meshes[id.0 as usize].triangles.len() as u32,
                    _ => 1,
                };
            }
        }
        first
    }

    /// Lists the lights of a scene, surfaces first.
    pub fn new(scene: &Scene, geometry: &Geometry, textures: &Textures) -> Self {
        let (listed, background) = list::list(scene, geometry, textures);
        let choice = Choice::new(&listed);
        let around = listed.iter().position(|l| matches!(l.light, Light::Background));
        let probability = around.map_or(0.0, |i| choice.probability(i as u32, Vec3::ZERO, Vec3::ZERO));
        let background = background.map(|background| (background, probability));
        let reachable = background.is_none().then(|| list::boxes(scene, geometry));
        let lights = listed.into_iter().map(|l| l.light).collect();
        Self { lights, one_number: choice.leaves_much(), choice, reachable, background }
    }

    /// Whether a ray may meet something that shines, as far as can be told at once.
    #[inline(always)]
    pub fn may_meet<L: Lanes>(&self, lanes: L, ray: &Ray) -> bool {
        self.reachable.as_ref().is_none_or(|boxes| boxes.meets(lanes, ray))
    }

    /// A light for a surface point at `position` with the shading normal `normal`, chosen by `choice` or by `u` alone; none where
    /// none can shine.
    #[inline(always)]
    pub fn choose(&self, position: Vec3, normal: Vec3, choice: f32, mut u: Vec2) -> Option<Chosen> {
        let chooser = if self.one_number { &mut u.x } else { &mut { choice } };
        let (light, probability) = self.choice.sample(chooser, position, normal)?;
        Some(Chosen { light, probability, u })
    }

    /// Whether [`Lights::choose`] needs a number of its own.
    #[inline(always)]
    pub fn needs_choice(&self) -> bool {
        !self.one_number
    }

    /// The light as one that [`Plain::sample`] does for, if it is.
    #[inline(always)]
    pub fn plain(&self, geometry: &Geometry, textures: &Textures, light: u32) -> Option<Plain> {
        match self.lights[light as usize] {
            Light::Triangle { triangle, area, radiance, is_plain: true } => {
                let (corners, radiance) = (geometry.vertices(triangle), textures.at_uv(radiance, Vec2::ZERO));
                Some(Plain { corners, area, radiance })
            }
            _ => None,
        }
    }

    /// Light to the surface from the light chosen, at its point chosen by what is left of `u`; none where none can come. With
    /// `mis` BSDF sampling looks for light too, and what it finds better may be left to it.
    #[inline(always)]
    pub fn sample(
        &self,
        geometry: &Geometry,
        textures: &Textures,
        surface: &Surface,
        Chosen { light, probability, u }: Chosen,
        mis: bool,
    ) -> Option<LightSample> {
        match self.lights[light as usize] {
            Light::Triangle { triangle, area, radiance, .. } => {
                let vertices = geometry.vertices(triangle);
                let (b, density) = triangle::sample(vertices, surface.position, u);
                let point = geometry.triangle_surface(triangle, b);
                let pdf = density.at(surface.position, point.position, area, point.normal) * probability;
                let (sample, shines) = from_surface(textures.at(radiance, &point), surface, &point, pdf);
                shines.then_some(sample)
            }
            Light::Analytic { index, radiance } => {
                let (point, pdf) = geometry.analytic(index).sample(surface.position, u)?;
                let point = geometry.analytic_point(index, point);
                let radiance = textures.at(radiance, &point);
                let (sample, shines) = from_surface(radiance, surface, &point, pdf * probability);
                shines.then_some(sample)
            }
            Light::Background => {
                let (background, _) = self.background.as_ref()?;
                let (wi, radiance, pdf) = background.sample(textures, u, mis);
                let pdf = pdf * probability;
                let shadow_ray = surface.ray(wi, f32::INFINITY);
                (pdf > 0.0).then(|| LightSample { wi, weight: radiance / pdf, pdf, shadow_ray })
            }
            Light::Point { position, intensity } => from_point(surface, position, probability, |_| intensity),
            Light::Spot(ref spot) => from_point(surface, spot.position, probability, |w| spot.intensity(textures, w)),
            Light::Directional { direction, irradiance } => Some(LightSample {
                wi: -direction,
                weight: irradiance / probability,
                pdf: f32::INFINITY,
                shadow_ray: surface.ray(-direction, f32::INFINITY),
            }),
        }
    }

    /// The image all around, if there is one, and the probability to choose it.
    #[inline(always)]
    pub fn environment(&self) -> Option<(&Environment, f32)> {
        match &self.background {
            Some((Background::Environment(environment), probability)) => Some((environment, *probability)),
            _ => None,
        }
    }

    /// Whether the light is what lies beyond the scene.
    #[inline(always)]
    pub fn is_background(&self, light: u32) -> bool {
        matches!(self.lights[light as usize], Light::Background)
    }

    /// Density in solid angle with which [`Lights::sample`] finds the emitting point `point` from a surface at `from` with the
    /// shading normal `normal`.
    #[inline(always)]
    pub fn pdf(&self, geometry: &Geometry, from: Vec3, normal: Vec3, point: &Surface, light: u32) -> f32 {
        let density = match self.lights[light as usize] {
            Light::Triangle { triangle, area, .. } => {
                triangle::pdf(geometry.vertices(triangle), from, point.position, area, point.normal)
            }
            Light::Analytic { index, .. } => geometry.analytic(index).pdf(from, point.position, point.normal),
            Light::Background | Light::Point { .. } | Light::Spot(_) | Light::Directional { .. } => 0.0,
        };
        density * self.choice.probability(light, from, normal)
    }

    /// Radiance that an emitting point sends towards `wo` (a unit vector): from the side of its shading normal.
    #[inline(always)]
    pub fn emitted(&self, textures: &Textures, point: &Surface, light: u32, wo: Vec3) -> Vec3 {
        match self.lights[light as usize] {
            Light::Triangle { radiance, .. } | Light::Analytic { radiance, .. } if point.frame.n.dot(wo) > 0.0 => {
                textures.at(radiance, point)
            }
            _ => Vec3::ZERO,
        }
    }

    /// Radiance from beyond the scene in the unit direction `wi`, and the density with which light sampling finds it; none
    /// where nothing shines there.
    #[inline(always)]
    pub fn background(&self, textures: &Textures, wi: Vec3, mis: bool) -> Option<(Vec3, f32)> {
        let (background, probability) = self.background.as_ref()?;
        let (radiance, pdf) = background.at(textures, wi, mis);
        Some((radiance, pdf * probability))
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.lights.len()
    }

    /// No light at all.
    pub fn is_empty(&self) -> bool {
        self.lights.is_empty()
    }
}

/// A light that was chosen.
#[derive(Clone, Copy, Debug)]
pub struct Chosen {
    /// Which.
    pub light: u32,
    /// How likely that was.
    pub probability: f32,
    /// Numbers for a point on it.
    pub u: Vec2,
}

/// Light from a point, of the intensity that it has in the direction to the surface.
#[inline(always)]
fn from_point(
    surface: &Surface,
    position: Vec3,
    probability: f32,
    intensity: impl FnOnce(Vec3) -> Vec3,
) -> Option<LightSample> {
    let towards = position - surface.position;
    let squared = towards.length_squared();
    if squared == 0.0 {
        return None;
    }
    let wi = towards / squared.sqrt();
    let weight = intensity(-wi) / (squared * probability);
    (weight != Vec3::ZERO).then(|| LightSample {
        wi,
        weight,
        pdf: f32::INFINITY,
        shadow_ray: surface.ray_to_point(position),
    })
}

/// Luminance of linear sRGB (ITU-R BT.709).
#[inline(always)]
pub fn luminance(rgb: Vec3) -> f32 {
    rgb.dot(Vec3::new(0.212_671, 0.715_160, 0.072_169))
}
