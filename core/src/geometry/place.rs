//! Points of triangles from their corners: straight arithmetic, for loops over many of them.

use crate::frame::Frame;
use crate::surface::gamma;
use glam::{Vec2, Vec3};

/// Squared sine of the angle at vertex 0 below which f64 has to find the normal: a cross product in f32 is off by its rounding
/// over that sine, and a ray that leaves close to the plane of a normal so far off meets its own triangle again.
const SLIVER: f32 = 0.05;

/// A point of a triangle, computed.
#[derive(Clone, Copy, Debug)]
pub struct Place {
    /// As in [`crate::surface::Surface`].
    pub position: Vec3,
    /// As in [`crate::surface::Surface`].
    pub error: Vec3,
    /// As in [`crate::surface::Surface`].
    pub normal: Vec3,
    /// As in [`crate::surface::Surface`].
    pub frame: Frame,
    /// The normal is good; else [`place_of_sliver`] has to find it.
    pub is_sure: bool,
}

/// The point with barycentric coordinates `b`. Without branches and calls, for loops over many points.
#[inline(always)]
pub fn place(corners: [Vec3; 3], shading: Vec3, b: Vec2) -> Place {
    let (normal, is_sure) = face_normal(corners);
    place_with(corners, shading, b, normal, is_sure)
}

/// As [`place`], for triangles whose normal is hard to find.
#[cold]
#[inline(never)]
pub fn place_of_sliver(corners: [Vec3; 3], shading: Vec3, b: Vec2) -> Place {
    place_with(corners, shading, b, sliver_normal(corners), true)
}

#[inline(always)]
fn place_with([p0, p1, p2]: [Vec3; 3], shading: Vec3, b: Vec2, normal: Vec3, is_sure: bool) -> Place {
    let parts = [p0 * (1.0 - b.x - b.y), p1 * b.x, p2 * b.y];
    Place {
        position: parts[0] + parts[1] + parts[2],
        error: (parts[0].abs() + parts[1].abs() + parts[2].abs()) * gamma(7),
        normal,
        frame: Frame::around(shading.try_normalize().unwrap_or(normal)),
        is_sure,
    }
}

/// The unit normal of a triangle, and whether it is good; else [`sliver_normal`] has to find it.
#[inline(always)]
pub(super) fn face_normal([p0, p1, p2]: [Vec3; 3]) -> (Vec3, bool) {
    let (a, b) = (p1 - p0, p2 - p0);
    let normal = a.cross(b);
    let squared = normal.length_squared();
    // The bound on the length keeps its square far from what f32 cannot hold.
    let is_sure = (squared > SLIVER * a.length_squared() * b.length_squared()) & (squared > 1e-34) & (squared < 1e34);
    (normal.normalize(), is_sure)
}

/// The unit normal of a triangle, for any corners; triangles without area have some unit vector.
fn sliver_normal(corners: [Vec3; 3]) -> Vec3 {
    let [p0, p1, p2] = corners.map(Vec3::as_dvec3);
    let (a, b) = (p1 - p0, p2 - p0);
    let longest = if a.length_squared() > b.length_squared() { a } else { b };
    let normal = a.cross(b).try_normalize().or_else(|| Some(longest.try_normalize()?.any_orthonormal_vector()));
    normal.map_or(Vec3::Z, |n| n.as_vec3())
}
