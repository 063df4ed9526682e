//! Orthonormal frames: world space to local space, where the normal is +z.

use glam::Vec3;

/// Two tangents and a normal, mutually orthogonal and of unit length. It may be left-handed, where a side was turned over.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    /// Local x.
    pub s: Vec3,
    /// Local y.
    pub t: Vec3,
    /// Local z.
    pub n: Vec3,
}

impl Frame {
    /// Some frame around a unit normal, without branches or cancellation (Duff et al. 2017).
    #[inline(always)]
    pub fn around(n: Vec3) -> Self {
        let sign = 1.0f32.copysign(n.z);
        let a = -1.0 / (sign + n.z);
        let b = n.x * n.y * a;
        Self {
            s: Vec3::new(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x),
            t: Vec3::new(b, sign + n.y * n.y * a, -n.y),
            n,
        }
    }

    /// The right-handed frame around a unit normal whose s lies along `tangent`, made orthogonal (Gram & Schmidt); some frame
    /// if that has no direction across the normal.
    #[inline(always)]
    pub fn along(n: Vec3, tangent: Vec3) -> Self {
        match (tangent - n * n.dot(tangent)).try_normalize() {
            Some(s) => Self { s, t: n.cross(s), n },
            None => Self::around(n),
        }
    }

    /// World to local.
    #[inline(always)]
    pub fn to_local(&self, v: Vec3) -> Vec3 {
        Vec3::new(self.s.dot(v), self.t.dot(v), self.n.dot(v))
    }

    /// Local to world.
    #[inline(always)]
    pub fn to_world(&self, v: Vec3) -> Vec3 {
        self.s * v.x + self.t * v.y + self.n * v.z
    }

    /// The same tangents, the normal on the other side.
    #[inline(always)]
    pub fn turned_over(&self) -> Self {
        Self { n: -self.n, ..*self }
    }
}
