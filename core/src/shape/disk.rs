//! Disks and ellipses.

use super::{Point, area_to_solid_angle};
use crate::surface::gamma;
use crate::warp::concentric_disk;
use glam::{Affine3, Vec2, Vec3};
use std::f32::consts::{PI, TAU};

/// The unit disk in z = 0 under an affine map.
#[derive(Clone, Debug)]
pub struct Disk {
    to_world: Affine3,
    to_object: Affine3,
    /// Unit normal in the scene.
    normal: Vec3,
    area: f32,
}

impl Disk {
    /// The unit disk, mapped.
    pub fn new(to_world: &Affine3, flip_normals: bool) -> Self {
        let across = to_world.matrix3.x_axis.cross(to_world.matrix3.y_axis);
        let to_object = to_world.inverse();
        // The normal is that of the surface's two sides which the map's own z axis is on.
        let outward = if across.dot(to_world.matrix3.z_axis) < 0.0 { -across } else { across };
        let normal = outward.normalize() * if flip_normals { -1.0 } else { 1.0 };
        Self { to_world: *to_world, to_object, normal, area: PI * across.length() }
    }

    /// Corners of a box around it, wider than rounding.
    pub fn bounds(&self) -> (Vec3, Vec3) {
        let (x, y) = (self.to_world.matrix3.x_axis, self.to_world.matrix3.y_axis);
        let reach = Vec3::from_array(std::array::from_fn(|i| (x[i] * x[i] + y[i] * y[i]).sqrt()));
        let centre = self.to_world.translation;
        let reach = reach + (centre.abs() + reach) * gamma(8);
        (centre - reach, centre + reach)
    }

    /// Unit normal.
    pub fn normal(&self) -> Vec3 {
        self.normal
    }

    /// Surface area.
    pub fn area(&self) -> f32 {
        self.area
    }

    /// Where the ray crosses the plane, if within the rim.
    #[inline(always)]
    pub fn intersect(&self, origin: Vec3, direction: Vec3, t_max: f32) -> Option<f32> {
        let o = self.to_object.transform_point3(origin);
        let d = self.to_object.transform_vector3(direction);
        let t = -o.z / d.z;
        let (x, y) = (o.x + t * d.x, o.y + t * d.y);
        (t > 0.0 && t <= t_max && x * x + y * y <= 1.0).then_some(t)
    }

    /// The point of the disk's plane nearest to `position`.
    #[inline(always)]
    pub fn point(&self, position: Vec3) -> Point {
        let local = self.to_object.transform_point3(position);
        self.at(Vec2::new(local.x, local.y))
    }

    /// Outwards and around; at the centre some direction is the first.
    pub fn tangents(&self, position: Vec3) -> (Vec3, Vec3) {
        let local = self.to_object.transform_point3(position);
        let r = (local.x * local.x + local.y * local.y).sqrt();
        let (cos, sin) = if r > 0.0 { (local.x / r, local.y / r) } else { (1.0, 0.0) };
        let matrix = &self.to_world.matrix3;
        let around = (matrix.y_axis * cos - matrix.x_axis * sin) * (TAU * r.max(f32::EPSILON));
        (matrix.x_axis * cos + matrix.y_axis * sin, around)
    }

    /// A point uniform over the area.
    #[inline(always)]
    pub fn sample(&self, from: Vec3, u: Vec2) -> Option<(Point, f32)> {
        let point = self.at(concentric_disk(u));
        let pdf = area_to_solid_angle(1.0 / self.area, from, point.position, point.normal);
        (pdf > 0.0).then_some((point, pdf))
    }

    /// The point at object coordinates (x, y, 0).
    #[inline(always)]
    fn at(&self, local: Vec2) -> Point {
        let (x, y) = (self.to_world.matrix3.x_axis * local.x, self.to_world.matrix3.y_axis * local.y);
        let phi = libm::atan2f(local.y, local.x);
        Point {
            position: x + y + self.to_world.translation,
            error: (x.abs() + y.abs() + self.to_world.translation.abs()) * gamma(8),
            normal: self.normal,
            uv: Vec2::new(local.length(), if phi < 0.0 { phi + TAU } else { phi } / TAU),
        }
    }
}
