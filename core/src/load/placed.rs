//! Shapes, emitters and sensors in f64 world space, before the scene has its origin.

use crate::scene::{BsdfId, Emitter, FovAxis, Sensor, TextureId};
use glam::{Affine3, DAffine3, DVec3, Vec3};

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
}

impl PlacedGeometry {
    /// The box around an analytic shape; meshes have their own.
    pub fn bounds(&self) -> Option<(DVec3, DVec3)> {
        // Along each axis the ellipsoid reaches as far as the matrix' row is long, the disk as far as its first two columns.
        let (to_world, z) = match self {
            PlacedGeometry::Mesh(_) => return None,
            PlacedGeometry::Sphere { to_world, .. } => (to_world, to_world.matrix3.z_axis),
            PlacedGeometry::Disk { to_world, .. } => (to_world, DVec3::ZERO),
        };
        let (x, y) = (to_world.matrix3.x_axis, to_world.matrix3.y_axis);
        let squares = x * x + y * y + z * z;
        let reach = DVec3::new(squares.x.sqrt(), squares.y.sqrt(), squares.z.sqrt());
        Some((to_world.translation - reach, to_world.translation + reach))
    }
}

/// An [`Emitter`] in world space.
pub(crate) enum PlacedEmitter {
    Constant { radiance: Vec3 },
    Point { position: DVec3, intensity: Vec3 },
    Directional { direction: DVec3, irradiance: Vec3 },
}

impl PlacedEmitter {
    pub fn to_scene(&self, origin: DVec3) -> Emitter {
        match *self {
            PlacedEmitter::Constant { radiance } => Emitter::Constant { radiance },
            PlacedEmitter::Point { position, intensity } => {
                Emitter::Point { position: (position - origin).as_vec3(), intensity }
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
    pub fov_degrees: f64,
    pub fov_axis: FovAxis,
    pub principal_point_offset: [f64; 2],
    pub near_clip: f64,
    pub far_clip: f64,
}

impl PlacedSensor {
    pub fn to_scene(&self, origin: DVec3) -> Sensor {
        Sensor::Perspective {
            to_world: to_f32(&(DAffine3::from_translation(-origin) * self.to_world)),
            fov_degrees: self.fov_degrees as f32,
            fov_axis: self.fov_axis,
            principal_point_offset: self.principal_point_offset.map(|x| x as f32),
            near_clip: self.near_clip as f32,
            far_clip: self.far_clip as f32,
            lens: None,
        }
    }
}

/// Rounds every number.
pub(crate) fn to_f32(transform: &DAffine3) -> Affine3 {
    Affine3::from_mat3_translation(transform.matrix3.as_mat3(), transform.translation.as_vec3())
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
