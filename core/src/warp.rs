//! Maps from the unit square to directions and points, each beside its density.

use crate::trig::{sin_cos_octant, sin_cos_turn};
use glam::{Vec2, Vec3};
use std::f32::consts::{FRAC_1_PI, FRAC_PI_4, PI};

/// Density of [`uniform_hemisphere`] in solid angle.
pub const UNIFORM_HEMISPHERE_PDF: f32 = 0.5 * FRAC_1_PI;
/// Density of [`uniform_sphere`] in solid angle.
pub const UNIFORM_SPHERE_PDF: f32 = 0.25 * FRAC_1_PI;

/// A direction with z ≥ 0, uniform in solid angle.
#[inline(always)]
pub fn uniform_hemisphere(u: Vec2) -> Vec3 {
    around_z(u.x, u.y)
}

/// A direction, uniform in solid angle.
#[inline(always)]
pub fn uniform_sphere(u: Vec2) -> Vec3 {
    around_z(1.0 - 2.0 * u.x, u.y)
}

/// The unit vector with this cosine to z, at the angle 2π·turn around it.
#[inline(always)]
pub fn around_z(cos_theta: f32, turn: f32) -> Vec3 {
    let sin_theta = (1.0 - cos_theta * cos_theta).max(0.0).sqrt();
    let (sin_phi, cos_phi) = sin_cos_turn(turn);
    Vec3::new(sin_theta * cos_phi, sin_theta * sin_phi, cos_theta)
}

/// A direction with z ≥ 0, its density proportional to the cosine.
#[inline(always)]
pub fn cosine_hemisphere(u: Vec2) -> Vec3 {
    let p = concentric_disk(u);
    Vec3::new(p.x, p.y, (1.0 - p.length_squared()).max(0.0).sqrt())
}

/// Density of [`cosine_hemisphere`] in solid angle.
#[inline(always)]
pub fn cosine_hemisphere_pdf(cos_theta: f32) -> f32 {
    cos_theta.max(0.0) * FRAC_1_PI
}

/// A point in the unit disk, uniform in area, neighbours staying neighbours (Shirley & Chiu 1997).
#[inline(always)]
pub fn concentric_disk(u: Vec2) -> Vec2 {
    let p = 2.0 * u - Vec2::ONE;
    // The axis that the point is nearer to, and its angle from there. Selected, not branched: it is as good as random.
    let across = p.x.abs() > p.y.abs();
    let (r, off) = if across { (p.x, p.y) } else { (p.y, p.x) };
    let (sin, cos) = sin_cos_octant(FRAC_PI_4 * (off / if r == 0.0 { 1.0 } else { r }));
    r * if across { Vec2::new(cos, sin) } else { Vec2::new(sin, cos) }
}

/// Barycentric coordinates (of vertices 1 and 2), uniform in area over a triangle (Heitz 2019, "A Low-Distortion Map
/// Between Triangle and Square").
#[inline(always)]
pub fn uniform_triangle(u: Vec2) -> Vec2 {
    if u.y > u.x {
        let x = 0.5 * u.x;
        Vec2::new(x, u.y - x)
    } else {
        let y = 0.5 * u.y;
        Vec2::new(u.x - y, y)
    }
}

/// A direction within a cone around z, uniform in solid angle; its density is 1 / (2π·`one_minus_cos_max`).
#[inline(always)]
pub fn uniform_cone(u: Vec2, one_minus_cos_max: f32) -> Vec3 {
    let height = u.x * one_minus_cos_max; // 1 − cos θ, kept apart so that narrow cones keep their digits
    let sin_theta = (height * (2.0 - height)).max(0.0).sqrt();
    let (sin_phi, cos_phi) = sin_cos_turn(u.y);
    Vec3::new(sin_theta * cos_phi, sin_theta * sin_phi, 1.0 - height)
}

/// Density of [`uniform_cone`] in solid angle.
#[inline(always)]
pub fn uniform_cone_pdf(one_minus_cos_max: f32) -> f32 {
    1.0 / (2.0 * PI * one_minus_cos_max)
}

/// The fraction x of [0, 1] below which a density that runs linearly from `a` to `b` has the share `u` of its mass: the map for a
/// density of (a + (b − a)·x) · 2/(a + b). Without cancellation; `a` and `b` are not negative and not both zero.
#[inline(always)]
pub fn inverse_linear(u: f32, a: f32, b: f32) -> f32 {
    let root = (a * a + (b - a) * (b + a) * u).max(0.0).sqrt();
    if a + root > 0.0 { (u * (a + b) / (a + root)).min(1.0) } else { 0.0 }
}
