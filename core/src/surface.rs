//! A point on a surface with what shading needs, and rays that leave it.

use crate::bvh::Ray;
use crate::frame::Frame;
use crate::settings::Offsets;
use glam::{Vec2, Vec3};

/// Half the distance from 1 to the next f32: the relative error of one rounded operation.
const UNIT_ROUNDOFF: f32 = f32::EPSILON * 0.5;

/// Bound on the relative error of `n` rounded operations in a row (Higham 2002, §3.1).
#[inline(always)]
pub const fn gamma(n: u32) -> f32 {
    let nu = n as f32 * UNIT_ROUNDOFF;
    nu / (1.0 - nu)
}

/// Where a shadow ray ends, as a share of the way to its target. A small and far sphere is met with an error that grows with
/// the distance, not with the sphere: without a margin it would cast a shadow on itself.
pub(crate) const SHADOW_END: f32 = 1.0 - 1e-4;

/// Mitsuba's distance of rays from the surfaces that they leave, over 1 + the largest coordinate (`RayEpsilon` of its
/// `math.h`).
const MITSUBA_OFFSET: f32 = 1500.0 * UNIT_ROUNDOFF;
/// What Mitsuba leaves out of the way to a light, as a share of it (`ShadowEpsilon`, likewise).
const MITSUBA_SHADOW_GAP: f32 = 10.0 * MITSUBA_OFFSET;

impl Offsets {
    /// What is added to the error of a point, so that rays leave it where these offsets have them; `origin` is the scene's.
    #[inline(always)]
    pub(crate) fn further_error(self, position: Vec3, normal: Vec3, origin: Vec3) -> Vec3 {
        match self {
            Offsets::Exact => Vec3::ZERO,
            Offsets::Mitsuba => normal.abs() * (MITSUBA_OFFSET * (1.0 + (position + origin).abs().max_element())),
        }
    }

    /// The share of a shadow ray that is traced.
    #[inline(always)]
    pub(crate) fn shadow_share(self) -> f32 {
        match self {
            Offsets::Exact => 1.0,
            Offsets::Mitsuba => 1.0 - MITSUBA_SHADOW_GAP,
        }
    }
}

/// A point on a surface.
#[derive(Clone, Copy, Debug)]
pub struct Surface {
    /// Where it is, in scene coordinates.
    pub position: Vec3,
    /// Bound on the distance of `position` from the true surface, along each axis.
    pub error: Vec3,
    /// Unit normal of the surface itself.
    pub normal: Vec3,
    /// Shading frame: its normal may be interpolated.
    pub frame: Frame,
    /// Texture coordinates.
    pub uv: Vec2,
    /// On a triangle, the weights of its vertices 1 and 2.
    pub barycentric: Vec2,
    /// Index of the shape: those of groups come behind the scene's own.
    pub shape: u32,
    /// The instance of a group that it is in.
    pub instance: Option<u32>,
    /// The primitive: a triangle or an analytic shape, as [`crate::geometry::Geometry`] numbers them in the scene or group.
    pub primitive: u32,
    /// The light that this point is part of, if it emits.
    pub light: Option<u32>,
}

impl Surface {
    /// A ray from here into the direction `w`. It starts so far off the surface, on the side that `w` points to, that it
    /// cannot meet the surface again by rounding (Pharr, Jakob & Humphreys 2023, §6.8).
    #[inline(always)]
    pub fn ray(&self, w: Vec3, t_max: f32) -> Ray {
        Ray { origin: self.offset(w), direction: w, t_max }
    }

    /// A ray from here to just before another point; t = 1 is there.
    #[inline(always)]
    pub fn ray_to(&self, target: &Surface) -> Ray {
        let towards = target.position - self.position;
        let origin = self.offset(towards);
        let direction = target.offset(-towards) - origin;
        Ray { origin, direction, t_max: SHADOW_END }
    }

    /// A ray from here to a point that is on no surface; t = 1 is there.
    #[inline(always)]
    pub fn ray_to_point(&self, target: Vec3) -> Ray {
        let origin = self.offset(target - self.position);
        Ray { origin, direction: target - origin, t_max: 1.0 }
    }

    /// The point moved off the surface to the side of `w`, by at least its error.
    #[inline(always)]
    fn offset(&self, w: Vec3) -> Vec3 {
        offset(self.position, self.error, self.normal, w)
    }
}

/// The point moved off its surface to the side of `w`, by at least its error.
#[inline(always)]
pub(crate) fn offset(position: Vec3, error: Vec3, normal: Vec3, w: Vec3) -> Vec3 {
    // The sum below is rounded, perhaps backwards: by one step of f32 along each axis at most.
    let distance = normal.abs().dot(error + position.abs() * gamma(4));
    position + normal * distance.copysign(w.dot(normal))
}
