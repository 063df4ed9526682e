//! Bump and normal maps: a shading frame bent from the surface's own, as Mitsuba bends it.

use crate::frame::Frame;
use crate::scene::Bend;
use glam::{Vec2, Vec3};

/// A bent frame and what it was bent from.
#[derive(Clone, Copy, Debug)]
pub struct Bent {
    /// The frame as bent.
    pub frame: Frame,
    /// The normal before.
    normal: Vec3,
    /// Squared roughness whose masking dims the horizon; 0 for none.
    alpha2: f32,
}

/// How a frame is bent, in its own space.
#[derive(Clone, Copy, Debug)]
pub struct Tilt {
    /// The normal before.
    normal: Vec3,
    alpha2: f32,
}

impl Bent {
    /// The same in the final frame, which is `self.frame` or that turned over.
    #[inline]
    pub fn seen_in(&self, frame: &Frame) -> Tilt {
        let normal = if frame.n.dot(self.frame.n) < 0.0 { -self.normal } else { self.normal };
        Tilt { normal: frame.to_local(normal), alpha2: self.alpha2 }
    }
}

impl Tilt {
    /// The factor on light from `wi`; none if it lies on different sides of the normal before and after.
    #[inline]
    pub fn factor(&self, wi: Vec3) -> Option<f32> {
        let cos = self.normal.dot(wi);
        if cos * wi.z <= 0.0 {
            return None;
        }
        let cos2 = (cos * cos).max(f32::MIN_POSITIVE);
        // G1 of GGX: 2 / (1 + √(1 + α² tan²)).
        Some(2.0 / (1.0 + (1.0 + self.alpha2 * (1.0 - cos2).max(0.0) / cos2).sqrt()))
    }
}

/// The frame bent to the normal `n`, given in the frame's own space with any length.
#[inline]
pub fn bent(frame: &Frame, wo: Vec3, n: Vec3, bend: Bend) -> Bent {
    let wo = frame.to_local(wo);
    let turned_away = bend.flip_invalid_normals && wo.z * wo.dot(n) <= 0.0;
    let n = if turned_away { Vec3::new(-n.x, -n.y, n.z) } else { n };
    let n = n.try_normalize().unwrap_or(Vec3::Z);
    let s = (Vec3::X - n * n.x).try_normalize().unwrap_or(Vec3::Y);
    let t = n.cross(s);
    let tan2 = (1.0 - n.z * n.z).max(0.0) / (n.z * n.z);
    Bent {
        frame: Frame { s: frame.to_world(s), t: frame.to_world(t), n: frame.to_world(n) },
        normal: frame.n,
        alpha2: if bend.use_shadowing_function { (0.125 * tan2).min(1.0) } else { 0.0 },
    }
}

/// The normal that a texel stores.
#[inline]
pub fn normal_of_texel(texel: Vec3) -> Vec3 {
    texel * 2.0 - Vec3::ONE
}

/// The normal, in the space of `frame`, of the surface raised by heights with these derivatives by the texture coordinates;
/// `du` and `dv` are the surface's own tangents (Blinn 1978, without the change of the normal). It is on the side of the geometric
/// normal.
#[inline]
pub fn normal_of_heights(frame: &Frame, geometric: Vec3, (du, dv): (Vec3, Vec3), heights: Vec2) -> Vec3 {
    let raised = |tangent: Vec3, height: f32| Vec3::new(frame.s.dot(tangent), frame.t.dot(tangent), height);
    let n = raised(du, heights.x).cross(raised(dv, heights.y));
    if n.dot(frame.to_local(geometric)) < 0.0 { -n } else { n }
}
