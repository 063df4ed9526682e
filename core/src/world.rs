//! A scene compiled for tracing.

use crate::geometry::{Geometry, Meshes};
use crate::lights::Lights;
use crate::scene::{Scene, Sensor};
use crate::shading::Materials;
use crate::texture::Textures;
use glam::{DVec3, Vec3};

/// A scene with its hierarchies and tables. It owns all it needs; the scene may be dropped.
pub struct World {
    /// What rays hit.
    pub geometry: Geometry,
    /// How it scatters.
    pub materials: Materials,
    /// Colours.
    pub textures: Textures,
    /// What shines.
    pub lights: Lights,
    /// Where the picture is taken from.
    pub sensor: Sensor,
    /// The scene's, as near as f32 has it: only distances that grow with coordinates need it.
    pub origin: Vec3,
}

impl World {
    /// Compiles a scene that [`Scene::validate`] has passed, on the current rayon pool.
    pub fn compile(scene: &Scene) -> Self {
        Self::consume(scene.clone())
    }

    /// As [`World::compile`], with less memory: meshes that nobody else holds are freed as soon as they are laid out.
    pub fn consume(mut scene: Scene) -> Self {
        let textures = Textures::new(&scene);
        let first_lights = Lights::first_of_shapes(&scene);
        let meshes = std::mem::take(&mut scene.meshes);
        let geometry = Geometry::lay_out(&scene, Meshes::new(&scene, meshes), &first_lights);
        let lights = Lights::new(&scene, &geometry, &textures);
        let materials = Materials::new(&scene);
        let origin = DVec3::from_array(scene.origin).as_vec3();
        Self { geometry, materials, textures, lights, sensor: scene.sensor, origin }
    }
}
