//! The lights of a scene one by one, and where and how far each shines.

use super::background::Background;
use super::environment::Environment;
use super::luminance;
use super::spot::Spot;
use crate::bvh::{Aabb, Boxes};
use crate::geometry::Geometry;
use crate::scene::{Emitter, Scene, Texture, TextureId};
use crate::texture::Textures;
use glam::Vec3;
use std::f32::consts::PI;

/// What has one density.
pub enum Light {
    /// A triangle that emits; a plain one is flat and shines alike everywhere.
    Triangle { triangle: u32, area: f32, radiance: TextureId, is_plain: bool },
    /// An analytic surface that emits.
    Analytic { index: u32, radiance: TextureId },
    /// What lies beyond the scene.
    Background,
    /// A point that shines in some directions.
    Spot(Box<Spot>),
    /// A point that shines alike in all directions.
    Point { position: Vec3, intensity: Vec3 },
    /// Parallel light.
    Directional { direction: Vec3, irradiance: Vec3 },
}

/// Where a finite light is, where to and how strongly it shines: bounds on all its points (Conty Estevez & Kulla 2018, §4).
#[derive(Clone, Copy, Debug)]
pub struct Reach {
    /// Around all its points.
    pub bounds: Aabb,
    /// Unit axis of the cone of its normals.
    pub axis: Vec3,
    /// Cosine of the half angle of that cone; −1 for all directions.
    pub cos_normals: f32,
    /// Cosine of the angle to a normal up to which it emits.
    pub cos_emission: f32,
    /// The largest radiant intensity's luminance.
    pub intensity: f32,
}

/// A light and how bright it is.
pub struct Listed {
    /// The light.
    pub light: Light,
    /// Luminance of the power into the scene.
    pub power: f32,
    /// None for lights beyond the scene.
    pub reach: Option<Reach>,
}

/// All lights of a scene, surfaces first in order of shapes and primitives; and its background.
pub fn list(scene: &Scene, geometry: &Geometry, textures: &Textures) -> (Vec<Listed>, Option<Background>) {
    let mut lights = Vec::new();
    for (i, shape) in scene.shapes.iter().enumerate() {
        let Some(radiance) = shape.radiance else { continue };
        let brightness = luminance(textures.mean(radiance));
        let is_even = matches!(scene.textures[radiance.0 as usize], Texture::Constant(_));
        lights.extend(geometry.primitives(i).map(|p| surface(geometry, p, radiance, brightness, is_even)));
    }
    let (_, radius) = geometry.bounding_ball();
    let mut background = None;
    for emitter in &scene.emitters {
        let (listed, around) = beyond_surfaces(scene, textures, emitter, PI * radius * radius);
        lights.push(listed);
        background = around.or(background);
    }
    (lights, background)
}

/// Boxes around the shapes that emit, as the hierarchy has them.
pub fn boxes(scene: &Scene, geometry: &Geometry) -> Boxes {
    let around = |i: usize| geometry.primitives(i).fold(Aabb::EMPTY, |all, p| all.union(geometry.padded_bounds(p)));
    let shapes = scene.shapes.iter().enumerate();
    Boxes::new(shapes.filter(|(_, shape)| shape.radiance.is_some()).map(|(i, _)| around(i)).collect())
}

fn surface(geometry: &Geometry, primitive: u32, radiance: TextureId, brightness: f32, is_even: bool) -> Listed {
    let area = geometry.area(primitive);
    let light = match geometry.analytic_index(primitive) {
        Some(index) => Light::Analytic { index, radiance },
        None => {
            let is_plain = is_even && geometry.is_plain(primitive);
            Light::Triangle { triangle: primitive, area, radiance, is_plain }
        }
    };
    let (axis, cos_normals) = geometry.normal_cone(primitive);
    let power = PI * area * brightness;
    // What faces all ways shows a quarter of its area to each (Cauchy), what is flat shows all of it ahead.
    let intensity = if cos_normals > -1.0 { area * brightness } else { 0.25 * area * brightness };
    let bounds = geometry.bounds(primitive);
    Listed { light, power, reach: Some(Reach { bounds, axis, cos_normals, cos_emission: 0.0, intensity }) }
}

/// A light without a surface; `across` is the area that the scene shows to light from far away.
fn beyond_surfaces(scene: &Scene, textures: &Textures, emitter: &Emitter, across: f32) -> (Listed, Option<Background>) {
    let around = |background: Background| {
        let power = 4.0 * PI * across * background.mean_luminance();
        (Listed { light: Light::Background, power, reach: None }, Some(background))
    };
    let spot = |spot: Spot| {
        let power = spot.power(textures);
        let cone = libm::cosf(spot.half_angle());
        let intensity = power / (2.0 * PI * (1.0 - cone));
        let reach = at_point(spot.position, spot.axis, cone, 1.0, intensity);
        (Listed { light: Light::Spot(Box::new(spot)), power, reach: Some(reach) }, None)
    };
    match *emitter {
        Emitter::Constant { radiance } => around(Background::Constant(radiance)),
        Emitter::Envmap { image, scale, to_world } => {
            let image = scene.images[image.0 as usize].clone();
            around(Background::Environment(Box::new(Environment::new(textures, image, scale, to_world))))
        }
        Emitter::Point { position, intensity } => {
            let brightness = luminance(intensity);
            let reach = at_point(position, Vec3::Z, -1.0, 0.0, brightness);
            let light = Light::Point { position, intensity };
            (Listed { light, power: 4.0 * PI * brightness, reach: Some(reach) }, None)
        }
        Emitter::Spot { ref to_world, intensity, cutoff_degrees, beam_width_degrees, texture } => {
            spot(Spot::cone(to_world, intensity, [cutoff_degrees, beam_width_degrees], texture))
        }
        Emitter::Projector { ref to_world, irradiance, scale, half_extent } => {
            spot(Spot::image(to_world, irradiance, scale, half_extent))
        }
        Emitter::Directional { direction, irradiance } => {
            let light = Light::Directional { direction, irradiance };
            (Listed { light, power: across * luminance(irradiance), reach: None }, None)
        }
    }
}

fn at_point(position: Vec3, axis: Vec3, cos_normals: f32, cos_emission: f32, intensity: f32) -> Reach {
    Reach { bounds: Aabb { min: position, max: position }, axis, cos_normals, cos_emission, intensity }
}
