//! Spheres.

use super::{Point, area_to_solid_angle};
use crate::frame::Frame;
use crate::surface::gamma;
use crate::trig::atan2;
use crate::warp::{UNIFORM_SPHERE_PDF, uniform_cone, uniform_cone_pdf, uniform_sphere};
use glam::{Affine3, Mat3, Vec2, Vec3};
use std::f32::consts::{PI, TAU};

/// A sphere with an orientation for its texture coordinates.
#[derive(Clone, Debug)]
pub struct Sphere {
    centre: Vec3,
    radius: f32,
    /// Scene to object directions, without scale.
    rotation: Mat3,
    /// −1 if normals point inwards.
    orientation: f32,
}

impl Sphere {
    /// The unit sphere under a similarity.
    pub fn new(to_world: &Affine3, flip_normals: bool) -> Self {
        let radius = to_world.matrix3.z_axis.length();
        Self {
            centre: to_world.translation,
            radius,
            rotation: to_world.matrix3.transpose() * (1.0 / radius),
            orientation: if flip_normals { -1.0 } else { 1.0 },
        }
    }

    /// Corners of a box around it, wider than rounding.
    pub fn bounds(&self) -> (Vec3, Vec3) {
        let reach = Vec3::splat(self.radius) + (self.centre.abs() + Vec3::splat(self.radius)) * gamma(4);
        (self.centre - reach, self.centre + reach)
    }

    /// 4πr².
    pub fn area(&self) -> f32 {
        2.0 * TAU * self.radius * self.radius
    }

    /// The smallest root in (0, t_max], without cancellation: the discriminant is taken from the distance between the centre
    /// and the ray, and the second root from the first (Haines, Günther & Akenine-Möller 2019, "Precision Improvements for
    /// Ray/Sphere Intersection").
    #[inline(always)]
    pub fn intersect(&self, origin: Vec3, direction: Vec3, t_max: f32) -> Option<f32> {
        let f = origin - self.centre;
        let a = direction.length_squared();
        let b = -f.dot(direction);
        let nearest = f + direction * (b / a);
        let discriminant = self.radius * self.radius - nearest.length_squared();
        if discriminant < 0.0 {
            return None;
        }
        let c = f.length_squared() - self.radius * self.radius;
        let q = b + (a * discriminant).sqrt().copysign(b);
        if q == 0.0 {
            return None;
        }
        let (t0, t1) = (c / q, q / a);
        let (near, far) = if t0 < t1 { (t0, t1) } else { (t1, t0) };
        let valid = |t: f32| t > 0.0 && t <= t_max;
        if valid(near) { Some(near) } else { Some(far).filter(|&t| valid(t)) }
    }

    /// The point of the surface nearest to `position`.
    #[inline(always)]
    pub fn point(&self, position: Vec3) -> Point {
        let outward = (position - self.centre).normalize();
        let on_surface = self.centre + outward * self.radius;
        let local = self.rotation * outward;
        let phi = atan2(local.y, local.x);
        let u = if phi < 0.0 { phi + TAU } else { phi } / TAU;
        let rho = (local.x * local.x + local.y * local.y).sqrt();
        let theta = atan2(rho, local.z);
        Point {
            position: on_surface,
            error: (self.centre.abs() + Vec3::splat(self.radius)) * gamma(6),
            normal: outward * self.orientation,
            uv: Vec2::new(u, theta / PI),
        }
    }

    /// ∂p/∂u runs along the circle of latitude, ∂p/∂v from pole to pole; at the poles some direction is the first.
    pub fn tangents(&self, position: Vec3) -> (Vec3, Vec3) {
        let local = self.rotation * (position - self.centre);
        let rho = (local.x * local.x + local.y * local.y).sqrt();
        let (cos_phi, sin_phi) = if rho > 0.0 { (local.x / rho, local.y / rho) } else { (1.0, 0.0) };
        let to_world = self.rotation.transpose();
        // At the poles ∂p/∂u vanishes; its direction is kept.
        let along = Vec3::new(-sin_phi, cos_phi, 0.0) * rho.max(f32::EPSILON * self.radius);
        let down = Vec3::new(local.z * cos_phi, local.z * sin_phi, -rho);
        (to_world * along * TAU, to_world * down * PI)
    }

    /// From outside: a direction uniform in the cone that the sphere fills, and the point met there first. From inside: a
    /// point uniform over the surface.
    #[inline(always)]
    pub fn sample(&self, from: Vec3, u: Vec2) -> Option<(Point, f32)> {
        let Some(one_minus_cos) = self.cone(from) else {
            let point = self.point(self.centre + uniform_sphere(u) * self.radius);
            let pdf = self.pdf(from, point.position, point.normal);
            return (pdf > 0.0).then_some((point, pdf));
        };
        let towards = self.centre - from;
        let distance = towards.length();
        let local = uniform_cone(u, one_minus_cos);
        // The angle α at the centre between `from` and the point: law of sines in the triangle of from, centre and point.
        let sin_theta2 = local.x * local.x + local.y * local.y;
        let distance_along = distance * local.z;
        let chord = (self.radius * self.radius - distance * distance * sin_theta2).max(0.0).sqrt();
        let direction = Frame::around(towards / distance).to_world(local);
        let point = self.point(from + direction * (distance_along - chord));
        Some((point, uniform_cone_pdf(one_minus_cos)))
    }

    /// The density of [`Sphere::sample`] in solid angle.
    #[inline(always)]
    pub fn pdf(&self, from: Vec3, point: Vec3, normal: Vec3) -> f32 {
        match self.cone(from) {
            Some(one_minus_cos) => uniform_cone_pdf(one_minus_cos),
            None => area_to_solid_angle(UNIFORM_SPHERE_PDF / (self.radius * self.radius), from, point, normal),
        }
    }

    /// 1 − cos of the half angle that the sphere fills seen from `from`; none from inside or on it.
    #[inline(always)]
    fn cone(&self, from: Vec3) -> Option<f32> {
        let sin2 = self.radius * self.radius / (self.centre - from).length_squared();
        // So near to the surface the cone's rim cannot be told from the horizon.
        (sin2 < 1.0 - 1e-4).then(|| sin2 / (1.0 + (1.0 - sin2).sqrt()))
    }
}
