//! Cameras, compiled for a film: from a point on the film to a ray.

use crate::scene::{FovAxis, Lens, Sensor};
use crate::settings::Film;
use crate::warp::concentric_disk;
use glam::{Mat3, Vec2, Vec3};

/// A camera for one film.
#[derive(Clone, Debug)]
pub struct Camera {
    position: Vec3,
    /// Columns: the camera's axes in the scene, of unit length where they carry directions.
    axes: Mat3,
    /// Film pixels to camera space: p · scale + offset, on the plane z = 1 (of a perspective camera) or on z = 0.
    scale: Vec2,
    offset: Vec2,
    near_clip: f32,
    far_clip: f32,
    projection: Projection,
}

#[derive(Clone, Copy, Debug)]
enum Projection {
    Pinhole,
    Lens(Lens),
    Orthographic,
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
        let (width, height) = (film.width as f32, film.height as f32);
        match sensor {
            Sensor::Perspective {
                to_world,
                fov_degrees,
                fov_axis,
                principal_point_offset,
                near_clip,
                far_clip,
                lens,
            } => {
                let tan_half = half_width_tangent(*fov_degrees, *fov_axis, width, height);
                let shift = Vec2::from_array(*principal_point_offset);
                let (scale, offset) = film_to_camera(tan_half, shift, width, height);
                let projection = lens.map_or(Projection::Pinhole, Projection::Lens);
                let (near_clip, far_clip) = (*near_clip, *far_clip);
                let axes = to_world.matrix3;
                Self { position: to_world.translation, axes, scale, offset, near_clip, far_clip, projection }
            }
            Sensor::Orthographic { to_world, near_clip, far_clip } => {
                let (scale, offset) = film_to_camera(1.0, Vec2::ZERO, width, height);
                let (near_clip, far_clip) = (*near_clip, *far_clip);
                let [x, y, z] = [to_world.matrix3.x_axis, to_world.matrix3.y_axis, to_world.matrix3.z_axis];
                let axes = Mat3::from_cols(x, y, z.normalize());
                let projection = Projection::Orthographic;
                Self { position: to_world.translation, axes, scale, offset, near_clip, far_clip, projection }
            }
        }
    }

    /// The ray through a point of the film, in pixels from its top left corner, and of the lens, in [0,1)².
    #[inline(always)]
    pub fn ray(&self, film: Vec2, lens: impl FnOnce() -> Vec2) -> CameraRay {
        let p = film * self.scale + self.offset;
        match self.projection {
            Projection::Pinhole => self.pinhole_ray(film),
            Projection::Lens(Lens { aperture_radius, focus_distance }) => {
                let on_lens = (concentric_disk(lens()) * aperture_radius).extend(0.0);
                self.through(on_lens, Vec3::new(p.x, p.y, 1.0) * focus_distance - on_lens)
            }
            Projection::Orthographic => self.through(p.extend(0.0), Vec3::Z),
        }
    }

    /// Whether it has no lens and a perspective.
    pub fn is_pinhole(&self) -> bool {
        matches!(self.projection, Projection::Pinhole)
    }

    /// As [`Camera::ray`] of a pinhole.
    #[inline(always)]
    pub fn pinhole_ray(&self, film: Vec2) -> CameraRay {
        let p = film * self.scale + self.offset;
        self.through(Vec3::ZERO, Vec3::new(p.x, p.y, 1.0))
    }

    /// The ray from a point on the plane z = 0 of camera space in a direction of positive z.
    #[inline(always)]
    fn through(&self, from: Vec3, towards: Vec3) -> CameraRay {
        let local = towards.normalize();
        let direction = (self.axes * local).normalize();
        let along_axis = 1.0 / local.z;
        CameraRay {
            origin: self.position + self.axes * from + direction * (self.near_clip * along_axis),
            direction,
            t_max: (self.far_clip - self.near_clip) * along_axis,
        }
    }
}

/// Scale and offset from film pixels to a plane of camera space on which the film is 2·`half_width` wide. The film's x runs to
/// the right of the picture, the camera's to its left; the film's y runs down, the camera's up. `shift` is added to film
/// coordinates, in parts of the film.
fn film_to_camera(half_width: f32, shift: Vec2, width: f32, height: f32) -> (Vec2, Vec2) {
    let scale = Vec2::splat(-2.0 * half_width / width);
    let centre = Vec2::new((0.5 - shift.x) * width, (0.5 - shift.y) * height);
    (scale, -centre * scale)
}

/// The tangent of half the horizontal field of view.
pub(crate) fn half_width_tangent(fov_degrees: f32, axis: FovAxis, width: f32, height: f32) -> f32 {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::{Filter, Window};
    use glam::Affine3;

    const LENS: Lens = Lens { aperture_radius: 0.3, focus_distance: 4.0 };

    fn to_world() -> Affine3 {
        Affine3 { matrix3: Mat3::from_rotation_y(30f32.to_radians()), translation: Vec3::new(1.0, 2.0, 3.0) }
    }

    fn perspective(lens: Option<Lens>) -> Camera {
        let sensor = Sensor::Perspective {
            to_world: to_world(),
            fov_degrees: 50.0,
            fov_axis: FovAxis::X,
            principal_point_offset: [0.0; 2],
            near_clip: 0.5,
            far_clip: 20.0,
            lens,
        };
        Camera::new(&sensor, &film())
    }

    fn film() -> Film {
        Film { width: 200, height: 100, crop: Window { x0: 0, y0: 0, x1: 200, y1: 100 }, filter: Filter::Box }
    }

    /// What Mitsuba 3.9.1 answers for the film position (¼, ¾) and the lens sample (0.9, 0.2).
    #[test]
    fn rays_are_mitsubas() {
        let orthographic = Sensor::Orthographic { to_world: to_world(), near_clip: 0.5, far_clip: 20.0 };
        let vec = Vec3::new;
        for (camera, origin, direction, t_max) in [
            (
                perspective(None),
                vec(1.350_958_6, 1.941_711_5, 3.374_724_1),
                vec(0.679_219_6, -0.112_807_18, 0.725_213_9),
                20.151_634,
            ),
            (
                perspective(Some(LENS)),
                vec(1.502_174, 1.825_041_8, 3.287_42),
                vec(0.645_760_9, -0.081_605_9, 0.759_166_2),
                19.891_105,
            ),
            (
                Camera::new(&orthographic, &film()),
                vec(1.683_012_7, 1.750_000_1, 3.183_012_7),
                vec(0.5, 0.0, 0.866_025_4),
                19.5,
            ),
        ] {
            let ray = camera.ray(Vec2::new(50.0, 75.0), || Vec2::new(0.9, 0.2));
            assert!((ray.origin - origin).length() < 1e-5, "{camera:?}: {ray:?}");
            assert!((ray.direction - direction).length() < 1e-6, "{camera:?}: {ray:?}");
            assert!((ray.t_max - t_max).abs() < 2e-5, "{camera:?}: {ray:?}");
        }
    }

    /// Rays of one film position through the whole lens meet where the pinhole's crosses the plane in focus.
    #[test]
    fn a_lens_focuses() {
        let film = Vec2::new(30.0, 80.0);
        let axis = to_world().matrix3.z_axis;
        let at_focus = |ray: CameraRay| {
            let depth = (ray.origin - to_world().translation).dot(axis);
            ray.origin + ray.direction * ((LENS.focus_distance - depth) / ray.direction.dot(axis))
        };
        let focus = at_focus(perspective(None).ray(film, || Vec2::ZERO));
        for i in 0..64 {
            let u = Vec2::new((i % 8) as f32, (i / 8) as f32) / 8.0;
            let ray = perspective(Some(LENS)).ray(film, || u);
            assert!((at_focus(ray) - focus).length() < 1e-5, "{u}: {} not {focus}", at_focus(ray));
        }
    }
}
