//! Triangles as lights: uniform over the directions they fill, or over their area where that does not pay.

use crate::shape::area_to_solid_angle;
use crate::trig::{atan2, sin_cos_turn};
use crate::warp::uniform_triangle;
use glam::{Vec2, Vec3};
use std::f32::consts::FRAC_1_PI;

/// Below about this solid angle the area density is almost as good and found in half the time: in the Cornell box the error of
/// all light grows by 2 %, the time falls by 12 %.
const SMALL: f32 = 0.25;
/// Outside of these f32 cannot tell the triangle's angles: below it is too small, above it fills nearly a hemisphere and its sides'
/// planes coincide (Pharr, Jakob & Humphreys 2023, §6.5.4).
const SOLID_ANGLES: std::ops::Range<f32> = 3e-4..6.22;

/// A point of the triangle to light `from` from: the barycentric coordinates of vertices 1 and 2, and the density.
#[inline(always)]
pub fn sample(vertices: [Vec3; 3], from: Vec3, u: Vec2) -> (Vec2, Density) {
    let corners = Corners::new(vertices, from);
    let on_sphere = barycentric(vertices, from, corners.sample(u));
    (if corners.density.is_even { on_sphere } else { uniform_triangle(u) }, corners.density)
}

/// The density of [`sample`] in solid angle at a `point` of the triangle, whose area and unit normal are given.
#[inline(always)]
pub fn pdf(vertices: [Vec3; 3], from: Vec3, point: Vec3, area: f32, normal: Vec3) -> f32 {
    Corners::new(vertices, from).density.at(from, point, area, normal)
}

/// How points are spread over a triangle.
#[derive(Clone, Copy, Debug)]
pub struct Density {
    /// Over its solid angle, or else over its area.
    is_even: bool,
    /// The solid angle, meaningless if not even.
    solid_angle: f32,
}

impl Density {
    /// In solid angle, at a point of the triangle seen from `from`, with its area and unit normal.
    #[inline(always)]
    pub fn at(&self, from: Vec3, point: Vec3, area: f32, normal: Vec3) -> f32 {
        let by_area = area_to_solid_angle(1.0 / area, from, point, normal);
        if self.is_even { 1.0 / self.solid_angle } else { by_area }
    }
}

/// A triangle as a point sees it.
struct Corners {
    /// Directions to the vertices, of unit length where points are spread over the solid angle.
    directions: [Vec3; 3],
    density: Density,
}

impl Corners {
    /// The solid angle is that of Van Oosterom & Strackee 1983: tan(Ω/2) = |a·(b×c)| / (1 + a·b + b·c + c·a).
    #[inline(always)]
    fn new(vertices: [Vec3; 3], from: Vec3) -> Self {
        let [a, b, c] = [vertices[0] - from, vertices[1] - from, vertices[2] - from];
        // From afar: Ω = area · cos θ / d² = |a·(b×c)| / 2d³ with the nearest corner's distance d.
        let volume = a.dot((b - a).cross(c - a));
        let nearest2 = a.length_squared().min(b.length_squared()).min(c.length_squared());
        let is_small = volume * volume < 4.0 * SMALL * SMALL * (nearest2 * nearest2 * nearest2);
        let directions @ [a, b, c] = [a.normalize_or_zero(), b.normalize_or_zero(), c.normalize_or_zero()];
        let volume = a.dot(b.cross(c)).abs();
        let sum = 1.0 + a.dot(b) + b.dot(c) + c.dot(a);
        let solid_angle = 2.0 * atan2(volume, sum);
        let is_in_range = SOLID_ANGLES.contains(&solid_angle);
        Self { directions, density: Density { is_even: !is_small & is_in_range, solid_angle } }
    }

    /// A direction uniform over the spherical triangle of this area (Arvo 1995, "Stratified Sampling of Spherical Triangles").
    #[inline(always)]
    fn sample(&self, u: Vec2) -> Vec3 {
        let ([a, b, c], area) = (self.directions, self.density.solid_angle);
        // The angle α at a, between the planes of its two sides.
        let (to_b, to_c) = (orthogonal(b, a), orthogonal(c, a));
        let (cos_alpha, sin_alpha) = (to_b.dot(to_c), to_b.cross(to_c).length());
        // Move c along its side to c', so that a, b, c' has the area u.x · area.
        let (sin_part, cos_part) = sin_cos_turn(u.x * (area * (0.5 * FRAC_1_PI)));
        let (s, t) = (sin_part * cos_alpha - cos_part * sin_alpha, cos_part * cos_alpha + sin_part * sin_alpha);
        let (p, q) = (t - cos_alpha, s + sin_alpha * a.dot(b));
        let denominator = (q * s + p * t) * sin_alpha;
        let cos_side = if denominator == 0.0 { a.dot(c) } else { ((q * t - p * s) * cos_alpha - q) / denominator };
        let cos_side = cos_side.clamp(-1.0, 1.0);
        let moved = a * cos_side + to_c * (1.0 - cos_side * cos_side).max(0.0).sqrt();
        // Then a point on the arc from b to c'.
        let z = 1.0 - u.y * (1.0 - moved.dot(b));
        b * z + orthogonal(moved, b) * (1.0 - z * z).max(0.0).sqrt()
    }
}

/// The unit vector of `v` across `axis`.
#[inline(always)]
fn orthogonal(v: Vec3, axis: Vec3) -> Vec3 {
    (v - axis * v.dot(axis)).normalize_or_zero()
}

/// Where a direction meets the triangle's plane, brought inside against rounding.
#[inline(always)]
fn barycentric([p0, p1, p2]: [Vec3; 3], from: Vec3, direction: Vec3) -> Vec2 {
    let (e1, e2) = (p1 - p0, p2 - p0);
    let across = direction.cross(e2);
    let determinant = across.dot(e1);
    let s = from - p0;
    let b1 = (s.dot(across) / determinant).clamp(0.0, 1.0);
    let b2 = (direction.dot(s.cross(e1)) / determinant).clamp(0.0, 1.0);
    let inside = Vec2::new(b1, b2) / (b1 + b2).max(1.0);
    if determinant == 0.0 { Vec2::splat(1.0 / 3.0) } else { inside }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TRIANGLE: [Vec3; 3] = [Vec3::new(0.3, 0.2, 0.1), Vec3::new(2.0, 0.4, -0.5), Vec3::new(0.1, 1.5, 0.7)];

    /// Any function over the triangle has the same integral by both densities: E[f/pdf] of the spherical samples is that of
    /// area samples, near and far; and `pdf` is the density that `sample` names. Fails if a corner's angle is wrong.
    #[test]
    fn integrals_are_those_by_area() {
        let [p0, p1, p2] = TRIANGLE;
        let across = (p1 - p0).cross(p2 - p0);
        let (area, normal) = (0.5 * across.length(), across.normalize());
        for from in [Vec3::new(1.0, 0.6, 0.8), Vec3::new(0.0, 0.1, 0.4), Vec3::new(-3.0, 2.0, 5.0)] {
            let at = |b: Vec2| p0 + (p1 - p0) * b.x + (p2 - p0) * b.y;
            let functions: [fn(Vec2) -> f32; 3] = [|_| 1.0, |b| b.x, |b| b.y * b.y];
            let (mut spherical, mut flat) = ([0.0; 3], [0.0; 3]);
            let n = 400;
            for i in 0..n * n {
                let u = Vec2::new((i / n) as f32 + 0.5, (i % n) as f32 + 0.5) / n as f32;
                let (b, density) = sample(TRIANGLE, from, u);
                let again = pdf(TRIANGLE, from, at(b), area, normal);
                let density = density.at(from, at(b), area, normal);
                assert!((density - again).abs() <= 1e-5 * again, "{density}, {again}");
                let by_area = uniform_triangle(u);
                let area_density = area_to_solid_angle(1.0 / area, from, at(by_area), normal);
                for (k, f) in functions.iter().enumerate() {
                    spherical[k] += f64::from(f(b) / again);
                    flat[k] += f64::from(f(by_area) / area_density);
                }
            }
            for (a, b) in spherical.iter().zip(flat) {
                assert!((a - b).abs() < 0.003 * b, "from {from}: {spherical:?}, {flat:?}");
            }
        }
    }

    #[test]
    fn tiny_triangles_are_sampled_by_area() {
        assert!(!sample(TRIANGLE, Vec3::splat(300.0), Vec2::splat(0.3)).1.is_even);
    }
}
