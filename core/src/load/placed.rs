//! Shapes, emitters and sensors in f64 world space, before the scene has its origin.

use crate::camera::half_width_tangent;
use crate::scene::{BsdfId, Emitter, FovAxis, ImageId, Lens, Sensor, TextureId};
use glam::{Affine3, DAffine3, DMat3, DVec3, Vec3};

/// A [`crate::scene::Shape`] in world space.
pub(crate) struct PlacedShape {
    pub name: String,
    pub geometry: PlacedGeometry,
    pub bsdf: BsdfId,
    pub radiance: Option<TextureId>,
}

/// A [`crate::scene::Geometry`] in world space.
pub(crate) enum PlacedGeometry {
    /// What [`super::assembly::Assembly::mesh`] gave.
    Mesh(usize),
    Sphere {
        to_world: DAffine3,
        flip_normals: bool,
    },
    Disk {
        to_world: DAffine3,
        flip_normals: bool,
    },
    Cylinder {
        to_world: DAffine3,
        flip_normals: bool,
    },
}

impl PlacedGeometry {
    /// The box around an analytic shape; meshes have their own.
    pub fn bounds(&self) -> Option<(DVec3, DVec3)> {
        // Along each axis the ellipsoid reaches as far as the matrix' row is long, the disk as far as its first two columns, and
        // the cylinder is a disk moved along the third.
        let (to_world, z, along) = match self {
            PlacedGeometry::Mesh(_) => return None,
            PlacedGeometry::Sphere { to_world, .. } => (to_world, to_world.matrix3.z_axis, DVec3::ZERO),
            PlacedGeometry::Disk { to_world, .. } => (to_world, DVec3::ZERO, DVec3::ZERO),
            PlacedGeometry::Cylinder { to_world, .. } => (to_world, DVec3::ZERO, to_world.matrix3.z_axis),
        };
        let (x, y) = (to_world.matrix3.x_axis, to_world.matrix3.y_axis);
        let squares = x * x + y * y + z * z;
        let reach = DVec3::new(squares.x.sqrt(), squares.y.sqrt(), squares.z.sqrt());
        let centre = to_world.translation;
        Some((centre.min(centre + along) - reach, centre.max(centre + along) + reach))
    }
}

/// An [`crate::scene::Instance`] in world space.
pub(crate) struct PlacedInstance {
    /// Index into [`super::assembly::Assembly::groups`].
    pub group: usize,
    pub to_world: DAffine3,
}

/// The smallest box around a box that is mapped.
pub(crate) fn mapped_box((min, max): (DVec3, DVec3), to_world: &DAffine3) -> (DVec3, DVec3) {
    let m = to_world.matrix3;
    let half = 0.5 * max - 0.5 * min;
    let reach = m.x_axis.abs() * half.x + m.y_axis.abs() * half.y + m.z_axis.abs() * half.z;
    let centre = to_world.transform_point3(0.5 * min + 0.5 * max);
    (centre - reach, centre + reach)
}

/// An [`Emitter`] in world space.
pub(crate) enum PlacedEmitter {
    Constant {
        radiance: Vec3,
    },
    Envmap {
        image: ImageId,
        scale: f32,
        to_world: DMat3,
    },
    Point {
        position: DVec3,
        intensity: Vec3,
    },
    Spot {
        to_world: DAffine3,
        intensity: Vec3,
        cutoff_degrees: f32,
        beam_width_degrees: f32,
        texture: Option<TextureId>,
    },
    /// Its image's height follows from the image.
    Projector {
        to_world: DAffine3,
        irradiance: TextureId,
        scale: f32,
        fov_degrees: f32,
        fov_axis: FovAxis,
    },
    Directional {
        direction: DVec3,
        irradiance: Vec3,
    },
}

impl PlacedEmitter {
    /// `aspect` is a texture's width over its height.
    pub fn to_scene(&self, origin: DVec3, aspect: impl Fn(TextureId) -> f32) -> Emitter {
        match *self {
            PlacedEmitter::Constant { radiance } => Emitter::Constant { radiance },
            PlacedEmitter::Envmap { image, scale, ref to_world } => {
                Emitter::Envmap { image, scale, to_world: to_world.as_mat3() }
            }
            PlacedEmitter::Point { position, intensity } => {
                Emitter::Point { position: (position - origin).as_vec3(), intensity }
            }
            PlacedEmitter::Spot { ref to_world, intensity, cutoff_degrees, beam_width_degrees, texture } => {
                let to_world = moved(to_world, origin);
                Emitter::Spot { to_world, intensity, cutoff_degrees, beam_width_degrees, texture }
            }
            PlacedEmitter::Projector { ref to_world, irradiance, scale, fov_degrees, fov_axis } => {
                let aspect = aspect(irradiance);
                let half_width = half_width_tangent(fov_degrees, fov_axis, aspect, 1.0);
                let half_extent = [half_width, half_width / aspect];
                Emitter::Projector { to_world: moved(to_world, origin), irradiance, scale, half_extent }
            }
            PlacedEmitter::Directional { direction, irradiance } => {
                Emitter::Directional { direction: direction.normalize().as_vec3(), irradiance }
            }
        }
    }
}

/// A [`Sensor`] in world space.
pub(crate) struct PlacedSensor {
    pub to_world: DAffine3,
    pub projection: Projection,
    pub near_clip: f64,
    pub far_clip: f64,
}

/// How a sensor's rays spread.
pub(crate) enum Projection {
    Perspective { fov_degrees: f64, fov_axis: FovAxis, principal_point_offset: [f64; 2], lens: Option<Lens> },
    Orthographic,
}

impl PlacedSensor {
    pub fn to_scene(&self, origin: DVec3) -> Sensor {
        let to_world = moved(&self.to_world, origin);
        let (near_clip, far_clip) = (self.near_clip as f32, self.far_clip as f32);
        match self.projection {
            Projection::Perspective { fov_degrees, fov_axis, principal_point_offset, lens } => Sensor::Perspective {
                to_world,
                fov_degrees: fov_degrees as f32,
                fov_axis,
                principal_point_offset: principal_point_offset.map(|x| x as f32),
                near_clip,
                far_clip,
                lens,
            },
            Projection::Orthographic => Sensor::Orthographic { to_world, near_clip, far_clip },
        }
    }
}

/// A transformation to world space as one to the scene's coordinates.
pub(crate) fn moved(to_world: &DAffine3, origin: DVec3) -> Affine3 {
    let m = to_world.matrix3;
    Affine3::from_mat3_translation(m.as_mat3(), (to_world.translation - origin).as_vec3())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boxes_enclose_turned_spheres_and_disks() {
        let turned = DAffine3::from_rotation_x(std::f64::consts::FRAC_PI_4);
        let sphere = PlacedGeometry::Sphere { to_world: turned, flip_normals: false };
        let (min, max) = sphere.bounds().unwrap();
        assert!((max - DVec3::ONE).length() < 1e-12 && (min + DVec3::ONE).length() < 1e-12);
        let disk = PlacedGeometry::Disk { to_world: turned, flip_normals: false };
        let half = std::f64::consts::FRAC_1_SQRT_2;
        assert!((disk.bounds().unwrap().1 - DVec3::new(1.0, half, half)).length() < 1e-12);
    }
}
