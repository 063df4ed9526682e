//! Vectors and what is made of them, coordinate by coordinate in rows: over these, compilers make vectors of loops.

use super::Origin;
use crate::bsdf::Sample;
use crate::frame::Frame;
use crate::lights::{Facing, LightSample};
use crate::surface::Surface;
use glam::{Vec2, Vec3};

/// Paths under way at a time.
pub(crate) const WIDTH: usize = 128;

/// Stands for "none".
pub(super) const NONE: u32 = u32::MAX;

/// Points of the plane.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
pub(crate) struct Vec2s<const N: usize = WIDTH> {
    x: [f32; N],
    y: [f32; N],
}

impl<const N: usize> Vec2s<N> {
    pub const ZERO: Self = Self { x: [0.0; N], y: [0.0; N] };

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
pub(crate) struct Vec3s<const N: usize = WIDTH> {
    x: [f32; N],
    y: [f32; N],
    z: [f32; N],
}

impl<const N: usize> Vec3s<N> {
    pub const ZERO: Self = Self { x: [0.0; N], y: [0.0; N], z: [0.0; N] };

    #[inline(always)]
    pub fn at(&self, i: usize) -> Vec3 {
        Vec3::new(self.x[i], self.y[i], self.z[i])
    }

    #[inline(always)]
    pub fn set(&mut self, i: usize, v: Vec3) {
        (self.x[i], self.y[i], self.z[i]) = (v.x, v.y, v.z);
    }
}

/// How the rays in hand came about: what weighs an emitter that they find.
pub(super) struct Origins {
    /// Where they start.
    pub position: Vec3s,
    /// The shading normal there.
    pub normal: Vec3s,
    /// Density of the direction, in solid angle; infinite where light sampling could not have found it.
    pub pdf: [f32; WIDTH],
    /// Which way the surface looks that is in hand, or that the rays come from.
    pub facing: [Facing; WIDTH],
}

impl Origins {
    #[inline(always)]
    pub fn at(&self, i: usize) -> Origin {
        Origin { position: self.position.at(i), normal: self.normal.at(i), pdf: self.pdf[i] }
    }
}

/// Surface points, as [`Surface`].
pub(super) struct Surfaces {
    pub position: Vec3s,
    pub error: Vec3s,
    pub normal: Vec3s,
    pub frame: Frames,
    pub uv: Vec2s,
    pub barycentric: Vec2s,
    pub shape: [u32; WIDTH],
    pub instance: [u32; WIDTH],
    pub primitive: [u32; WIDTH],
    pub light: [u32; WIDTH],
}

pub(super) struct Frames<const N: usize = WIDTH> {
    pub s: Vec3s<N>,
    pub t: Vec3s<N>,
    pub n: Vec3s<N>,
}

impl<const N: usize> Frames<N> {
    pub const ZERO: Self = Self { s: Vec3s::ZERO, t: Vec3s::ZERO, n: Vec3s::ZERO };

    #[inline(always)]
    pub fn at(&self, i: usize) -> Frame {
        Frame { s: self.s.at(i), t: self.t.at(i), n: self.n.at(i) }
    }

    #[inline(always)]
    pub fn set(&mut self, i: usize, frame: &Frame) {
        self.s.set(i, frame.s);
        self.t.set(i, frame.t);
        self.n.set(i, frame.n);
    }
}

impl Surfaces {
    #[inline(always)]
    pub fn at(&self, i: usize) -> Surface {
        let some = |x: u32| (x != NONE).then_some(x);
        Surface {
            position: self.position.at(i),
            error: self.error.at(i),
            normal: self.normal.at(i),
            frame: self.frame.at(i),
            uv: self.uv.at(i),
            barycentric: self.barycentric.at(i),
            shape: self.shape[i],
            instance: some(self.instance[i]),
            primitive: self.primitive[i],
            light: some(self.light[i]),
        }
    }

    #[inline(always)]
    pub fn set(&mut self, i: usize, surface: &Surface) {
        self.position.set(i, surface.position);
        self.error.set(i, surface.error);
        self.normal.set(i, surface.normal);
        self.frame.set(i, &surface.frame);
        self.uv.set(i, surface.uv);
        self.barycentric.set(i, surface.barycentric);
        self.shape[i] = surface.shape;
        self.instance[i] = surface.instance.unwrap_or(NONE);
        self.primitive[i] = surface.primitive;
        self.light[i] = surface.light.unwrap_or(NONE);
    }
}

/// Triangles: vertices, and an interpolated normal or the radiance of a light.
pub(super) struct Triangles {
    pub corners: [Vec3s; 3],
    pub extra: Vec3s,
    pub area: [f32; WIDTH],
}

impl Triangles {
    #[inline(always)]
    pub fn corners(&self, i: usize) -> [Vec3; 3] {
        [self.corners[0].at(i), self.corners[1].at(i), self.corners[2].at(i)]
    }

    #[inline(always)]
    pub fn set_corners(&mut self, i: usize, [a, b, c]: [Vec3; 3]) {
        self.corners[0].set(i, a);
        self.corners[1].set(i, b);
        self.corners[2].set(i, c);
    }
}

/// What light sampling finds, as [`crate::lights::LightSample`], and what becomes of it.
pub(super) struct LightSamples {
    pub probability: [f32; WIDTH],
    pub u: Vec2s,
    /// There is light.
    pub is_some: [bool; WIDTH],
    pub wi: Vec3s,
    pub weight: Vec3s,
    pub pdf: [f32; WIDTH],
    pub origin: Vec3s,
    pub direction: Vec3s,
    pub t_max: [f32; WIDTH],
    /// What the surface makes of it, and how likely it would have chosen the direction.
    pub value: Vec3s,
    pub bsdf_pdf: [f32; WIDTH],
    pub mis: [f32; WIDTH],
}

impl LightSamples {
    #[inline(always)]
    pub fn set(&mut self, i: usize, sample: &LightSample) {
        self.set_if(i, sample, true);
    }

    /// Keeps a sample, or the one that is there, without a branch.
    #[inline(always)]
    pub fn set_if(&mut self, i: usize, sample: &LightSample, really: bool) {
        let or = |new: Vec3, old: Vec3| if really { new } else { old };
        self.wi.set(i, or(sample.wi, self.wi.at(i)));
        self.weight.set(i, or(sample.weight, self.weight.at(i)));
        self.pdf[i] = if really { sample.pdf } else { self.pdf[i] };
        self.origin.set(i, or(sample.shadow_ray.origin, self.origin.at(i)));
        self.direction.set(i, or(sample.shadow_ray.direction, self.direction.at(i)));
        self.t_max[i] = if really { sample.shadow_ray.t_max } else { self.t_max[i] };
    }
}

impl Numbers {
    #[inline(always)]
    pub fn light_point(&self, i: usize) -> [u32; 2] {
        [self.light_point[0][i], self.light_point[1][i]]
    }
}

/// Directions to go on, as [`crate::bsdf::Sample`].
pub(super) struct Samples {
    pub is_some: [bool; WIDTH],
    pub wi: Vec3s,
    pub weight: Vec3s,
    pub pdf: [f32; WIDTH],
    pub eta: [f32; WIDTH],
}

impl Samples {
    /// Keeps a direction of the frame's space, or that there is none.
    #[inline(always)]
    pub fn set(&mut self, i: usize, sample: Sample, is_some: bool, frame: &Frame) {
        self.set_if(i, sample, is_some, frame, true);
    }

    /// Keeps a direction, or the one that is there, without a branch.
    #[inline(always)]
    pub fn set_if(&mut self, i: usize, sample: Sample, is_some: bool, frame: &Frame, really: bool) {
        let wi = frame.to_world(sample.wi);
        self.is_some[i] = if really { is_some } else { self.is_some[i] };
        self.wi.set(i, if really { wi } else { self.wi.at(i) });
        self.weight.set(i, if really { sample.weight } else { self.weight.at(i) });
        self.pdf[i] = if really { sample.pdf } else { self.pdf[i] };
        self.eta[i] = if really { sample.eta } else { self.eta[i] };
    }
}

/// Random numbers of a surface.
pub(super) struct Numbers {
    pub lobe: [f32; WIDTH],
    pub direction: Vec2s,
    pub light: [f32; WIDTH],
    /// Fractions of 2^32.
    pub light_point: [[u32; WIDTH]; 2],
    pub roulette: [f32; WIDTH],
}

/// What branches of a path have in common, kept while one of them goes on.
pub(super) struct Stem {
    pub throughput: Vec3s,
    pub eta: [f32; WIDTH],
    pub depth: [u32; WIDTH],
    pub lobe: [f32; WIDTH],
}
