//! Cylinders, round or elliptic, without caps.

use super::{Point, area_to_solid_angle};
use crate::surface::gamma;
use glam::{Affine3, Mat3, Vec2, Vec3};
use std::f32::consts::TAU;

/// The side of the unit cylinder, x² + y² = 1 and 0 ≤ z ≤ 1, under an affine map.
#[derive(Clone, Debug)]
pub struct Cylinder {
    to_world: Affine3,
    to_object: Affine3,
    /// −1 if normals point inwards.
    orientation: f32,
    area: f32,
}

/// Steps of the integral of an elliptic cylinder's area; for a round one it is exact.
const AREA_STEPS: u32 = 256;

impl Cylinder {
    /// The unit cylinder, mapped.
    pub fn new(to_world: &Affine3, flip_normals: bool) -> Self {
        let orientation = if flip_normals { -1.0 } else { 1.0 };
        let mut cylinder = Self { to_world: *to_world, to_object: to_world.inverse(), orientation, area: 0.0 };
        let angles = (0..AREA_STEPS).map(|i| TAU * (i as f32 + 0.5) / AREA_STEPS as f32);
        let sum: f32 = angles.map(libm::sincosf).map(|(sin, cos)| cylinder.stretch(Vec2::new(cos, sin))).sum();
        cylinder.area = sum * TAU / AREA_STEPS as f32;
        cylinder
    }

    /// Area in the scene of a unit of angle and height at the point (cos φ, sin φ) of the rim.
    #[inline]
    fn stretch(&self, rim: Vec2) -> f32 {
        let matrix = &self.to_world.matrix3;
        (matrix.y_axis * rim.x - matrix.x_axis * rim.y).cross(matrix.z_axis).length()
    }

    /// Corners of a box around it, wider than rounding.
    pub fn bounds(&self) -> (Vec3, Vec3) {
        let (x, y) = (self.to_world.matrix3.x_axis, self.to_world.matrix3.y_axis);
        let reach = Vec3::from_array(std::array::from_fn(|i| (x[i] * x[i] + y[i] * y[i]).sqrt()));
        let (bottom, top) = (self.to_world.translation, self.to_world.translation + self.to_world.matrix3.z_axis);
        let reach = reach + (bottom.abs().max(top.abs()) + reach) * gamma(8);
        (bottom.min(top) - reach, bottom.max(top) + reach)
    }

    /// Surface area.
    pub fn area(&self) -> f32 {
        self.area
    }

    /// The smallest root in (0, t_max] between the ends, by the same steps as the sphere's.
    #[inline]
    pub fn intersect(&self, origin: Vec3, direction: Vec3, t_max: f32) -> Option<f32> {
        let o = self.to_object.transform_point3(origin);
        let d = self.to_object.transform_vector3(direction);
        let (f, across) = (Vec2::new(o.x, o.y), Vec2::new(d.x, d.y));
        let a = across.length_squared();
        let b = -f.dot(across);
        if a == 0.0 {
            return None;
        }
        let nearest = f + across * (b / a);
        let discriminant = 1.0 - nearest.length_squared();
        if discriminant < 0.0 {
            return None;
        }
        let q = b + (a * discriminant).sqrt().copysign(b);
        if q == 0.0 {
            return None;
        }
        let (t0, t1) = ((f.length_squared() - 1.0) / q, q / a);
        let (near, far) = if t0 < t1 { (t0, t1) } else { (t1, t0) };
        let valid = |t: &f32| *t > 0.0 && *t <= t_max && (0.0..=1.0).contains(&(o.z + t * d.z));
        Some(near).filter(valid).or(Some(far).filter(valid))
    }

    /// The point of the surface near `position`.
    #[inline]
    pub fn point(&self, position: Vec3) -> Point {
        let local = self.to_object.transform_point3(position);
        self.at(Vec2::new(local.x, local.y).normalize(), local.z)
    }

    /// ∂p/∂u runs around, ∂p/∂v along.
    pub fn tangents(&self, position: Vec3) -> (Vec3, Vec3) {
        let local = self.to_object.transform_point3(position);
        let rim = Vec2::new(local.x, local.y).normalize();
        let matrix = &self.to_world.matrix3;
        ((matrix.y_axis * rim.x - matrix.x_axis * rim.y) * TAU, matrix.z_axis)
    }

    /// A point uniform in angle and height.
    #[inline]
    pub fn sample(&self, from: Vec3, u: Vec2) -> Option<(Point, f32)> {
        let (sin, cos) = libm::sincosf(TAU * u.x);
        let point = self.at(Vec2::new(cos, sin), u.y);
        let pdf = self.pdf(from, point.position, point.normal);
        (pdf > 0.0).then_some((point, pdf))
    }

    /// The density of [`Cylinder::sample`] in solid angle.
    #[inline]
    pub fn pdf(&self, from: Vec3, point: Vec3, normal: Vec3) -> f32 {
        let local = self.to_object.transform_point3(point);
        let stretch = self.stretch(Vec2::new(local.x, local.y).normalize());
        area_to_solid_angle(1.0 / (TAU * stretch), from, point, normal)
    }

    /// The point at (cos φ, sin φ) and height z.
    #[inline]
    fn at(&self, rim: Vec2, z: f32) -> Point {
        let matrix = &self.to_world.matrix3;
        let (x, y, z_part) = (matrix.x_axis * rim.x, matrix.y_axis * rim.y, matrix.z_axis * z);
        let position = x + y + z_part + self.to_world.translation;
        let outward = self.to_object.matrix3.transpose() * rim.extend(0.0);
        let phi = libm::atan2f(rim.y, rim.x);
        // Rays are met in object space: what their origin loses on the way there counts too.
        let (there, back) = (self.to_object.matrix3, self.to_world.matrix3);
        let lost = absolute(there) * position.abs() + self.to_object.translation.abs();
        let error = x.abs() + y.abs() + z_part.abs() + self.to_world.translation.abs();
        Point {
            position,
            error: error * gamma(8) + absolute(back) * (lost + Vec3::ONE) * gamma(4),
            normal: outward.normalize() * self.orientation,
            uv: Vec2::new(if phi < 0.0 { phi + TAU } else { phi } / TAU, z),
        }
    }
}

fn absolute(matrix: Mat3) -> Mat3 {
    Mat3::from_cols(matrix.x_axis.abs(), matrix.y_axis.abs(), matrix.z_axis.abs())
}
