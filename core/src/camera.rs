//! Cameras, compiled for a film: from a point on the film to a ray.

use crate::scene::{FovAxis, Sensor};
use crate::settings::Film;
use glam::{Mat3, Vec2, Vec3};

/// A pinhole camera for one film.
#[derive(Clone, Debug)]
pub struct Camera {
    position: Vec3,
    /// Columns: the camera's axes in the scene.
    axes: Mat3,
    /// Film pixels to the plane z = 1 of camera space: p · scale + offset.
    scale: Vec2,
    offset: Vec2,
    near_clip: f32,
    far_clip: f32,
}

/// A ray from the camera, between the clipping planes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraRay {
    /// On the near clipping plane.
    pub origin: Vec3,
    /// Of unit length.
    pub direction: Vec3,
    /// Distance to the far clipping plane.
    pub t_max: f32,
}

impl Camera {
    /// A sensor in front of a film.
    pub fn new(sensor: &Sensor, film: &Film) -> Self {
        let Sensor::Perspective { to_world, fov_degrees, fov_axis, principal_point_offset, near_clip, far_clip } =
            sensor;
        let (width, height) = (film.width as f32, film.height as f32);
        let tan_half = half_width_tangent(*fov_degrees, *fov_axis, width, height);
        // The film's x runs to the right of the picture, the camera's to its left; the film's y runs down, the camera's up.
        let scale = Vec2::splat(-2.0 * tan_half / width);
        let centre = Vec2::new((0.5 - principal_point_offset[0]) * width, (0.5 - principal_point_offset[1]) * height);
        Self {
            position: to_world.translation,
            axes: to_world.matrix3,
            scale,
            offset: -centre * scale,
            near_clip: *near_clip,
            far_clip: *far_clip,
        }
    }

    /// The ray through a point of the film, in pixels from its top left corner.
    #[inline]
    pub fn ray(&self, film: Vec2) -> CameraRay {
        let p = film * self.scale + self.offset;
        let local = Vec3::new(p.x, p.y, 1.0).normalize();
        let direction = (self.axes * local).normalize();
        let along_axis = 1.0 / local.z;
        CameraRay {
            origin: self.position + direction * (self.near_clip * along_axis),
            direction,
            t_max: (self.far_clip - self.near_clip) * along_axis,
        }
    }
}

/// The tangent of half the horizontal field of view.
fn half_width_tangent(fov_degrees: f32, axis: FovAxis, width: f32, height: f32) -> f32 {
    let tangent = libm::tan(0.5 * f64::from(fov_degrees).to_radians()) as f32;
    match axis {
        FovAxis::X => tangent,
        FovAxis::Y => tangent * width / height,
        FovAxis::Diagonal => tangent * width / (width * width + height * height).sqrt(),
        FovAxis::Smaller if width <= height => tangent,
        FovAxis::Larger if width >= height => tangent,
        FovAxis::Smaller | FovAxis::Larger => tangent * width / height,
    }
}
