//! Vectors, coordinate by coordinate in rows: what compilers turn loops over many of them into vector instructions for.

use super::wave::WIDTH;
use glam::{Vec2, Vec3};

/// Points of the plane.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
pub(crate) struct Vec2s {
    x: [f32; WIDTH],
    y: [f32; WIDTH],
}

impl Vec2s {
    pub const ZERO: Self = Self { x: [0.0; WIDTH], y: [0.0; WIDTH] };

    #[inline(always)]
    pub fn at(&self, i: usize) -> Vec2 {
        Vec2::new(self.x[i], self.y[i])
    }

    #[inline(always)]
    pub fn set(&mut self, i: usize, v: Vec2) {
        (self.x[i], self.y[i]) = (v.x, v.y);
    }
}

/// Vectors of space.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
pub(crate) struct Vec3s {
    x: [f32; WIDTH],
    y: [f32; WIDTH],
    z: [f32; WIDTH],
}

impl Vec3s {
    pub const ZERO: Self = Self { x: [0.0; WIDTH], y: [0.0; WIDTH], z: [0.0; WIDTH] };

    #[inline(always)]
    pub fn at(&self, i: usize) -> Vec3 {
        Vec3::new(self.x[i], self.y[i], self.z[i])
    }

    #[inline(always)]
    pub fn set(&mut self, i: usize, v: Vec3) {
        (self.x[i], self.y[i], self.z[i]) = (v.x, v.y, v.z);
    }
}
