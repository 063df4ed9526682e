//! From a hit to the closure that scatters there: textures are looked up, sides, masks and blends decided, frames bent.

mod bend;
mod simple;

use crate::bsdf::{Closure, Evaluation, Sample};
use crate::frame::Frame;
use crate::geometry::Geometry;
use crate::scene::{Bsdf, BsdfId, Scene, Texture, TextureId};
use crate::surface::Surface;
use crate::texture::Textures;
use bend::{Bent, Tilt, bent, normal_of_heights, normal_of_texel};
use glam::{Vec2, Vec3};
use simple::{Coats, closure};

/// The materials of a scene.
pub struct Materials {
    bsdfs: Vec<Bsdf>,
    of_shape: Vec<BsdfId>,
    /// Whether something in the BSDF of each shape is chosen at random.
    has_lobes: Vec<bool>,
    /// The shapes that are plainly Lambert's.
    lambert: Vec<Option<Lambert>>,
    /// The bitmaps that may be looked up on each shape.
    bitmaps: Vec<Vec<TextureId>>,
    /// Whether each BSDF needs tangents that follow the texture coordinates.
    oriented: Vec<bool>,
    coats: Coats,
}

/// A reflector after Lambert with nothing around it but, perhaps, two sides.
#[derive(Clone, Copy, Debug)]
pub struct Lambert {
    /// The albedo where the normal is.
    pub front: TextureId,
    /// The albedo of the other side; none where that is black.
    pub back: Option<TextureId>,
}

/// How light scatters at one hit.
#[derive(Clone, Copy, Debug)]
pub struct Shading<'a> {
    /// The model.
    pub closure: Closure<'a>,
    /// Its local space.
    pub frame: Frame,
    /// How a bump or normal map has bent that from the surface's own.
    pub(crate) tilt: Option<Tilt>,
}

impl Shading<'_> {
    /// As [`Closure::eval`], bent.
    #[inline(always)]
    pub fn eval(&self, wo: Vec3, wi: Vec3) -> Evaluation {
        let Some(tilt) = &self.tilt else { return self.closure.eval(wo, wi) };
        match tilt.factor(wi) {
            None => Evaluation::default(),
            Some(factor) => {
                let Evaluation { value, pdf } = self.closure.eval(wo, wi);
                Evaluation { value: value * factor, pdf }
            }
        }
    }

    /// As [`Closure::sample`], bent.
    #[inline(always)]
    pub fn sample(&self, wo: Vec3, lobe: f32, u: Vec2) -> Option<Sample> {
        let sample = self.closure.sample(wo, lobe, u)?;
        let Some(tilt) = &self.tilt else { return Some(sample) };
        tilt.factor(sample.wi).map(|factor| Sample { weight: sample.weight * factor, ..sample })
    }
}

impl Materials {
    /// The materials of a scene's shapes.
    pub fn new(scene: &Scene) -> Self {
        let mut oriented = Vec::with_capacity(scene.bsdfs.len());
        for bsdf in &scene.bsdfs {
            oriented.push(is_oriented(scene, bsdf, &oriented));
        }
        Self {
            bsdfs: scene.bsdfs.clone(),
            of_shape: scene.levels().flatten().map(|s| s.bsdf).collect(),
            has_lobes: scene.levels().flatten().map(|s| has_lobes(scene, s.bsdf)).collect(),
            lambert: scene.levels().flatten().map(|s| lambert(scene, s.bsdf)).collect(),
            bitmaps: scene.levels().flatten().map(|s| bitmaps(scene, s.bsdf)).collect(),
            oriented,
            coats: Coats::new(&scene.bsdfs),
        }
    }

    /// Whether [`Materials::at`] and what it gives need a random number `lobe` on a shape.
    #[inline(always)]
    pub fn has_lobes(&self, shape: u32) -> bool {
        self.has_lobes[shape as usize]
    }

    /// What [`Materials::at`] would find out step by step, for shapes that are plainly Lambert's.
    #[inline(always)]
    pub fn lambert(&self, shape: u32) -> Option<&Lambert> {
        self.lambert[shape as usize].as_ref()
    }

    /// Asks for the texels that may be looked up on a shape, ahead of time.
    #[inline(always)]
    pub fn prefetch(&self, textures: &Textures, shape: u32, uv: Vec2) {
        for id in &self.bitmaps[shape as usize] {
            textures.prefetch(*id, uv);
        }
    }

    /// The closure at `surface`, seen from the direction `wo`. A mask answers at random, by `lobe`: with the probability of
    /// its opacity the surface is there, else nothing is. A blend chooses one of its two likewise. The mean over `lobe` is
    /// the mixture, and a path goes on in one way. The rest of `lobe` is handed back as a fresh number.
    #[inline(always)]
    pub fn at(
        &self,
        geometry: &Geometry,
        textures: &Textures,
        surface: &Surface,
        wo: Vec3,
        lobe: &mut f32,
    ) -> Shading<'_> {
        let mut id = self.of_shape[surface.shape as usize];
        let mut frame = surface.frame;
        if self.oriented[id.0 as usize] {
            frame = Frame::along(frame.n, geometry.tangents(surface).0);
        }
        let upright = frame;
        let mut tilt: Option<Bent> = None;
        loop {
            match &self.bsdfs[id.0 as usize] {
                Bsdf::TwoSided { front, back } => {
                    if frame.n.dot(wo) < 0.0 {
                        (id, frame) = (*back, frame.turned_over());
                    } else {
                        id = *front;
                    }
                }
                Bsdf::Mask { opacity, nested } => {
                    if !happens(lobe, textures.at(*opacity, surface).x) {
                        return Shading { closure: Closure::Null, frame, tilt: tilt.map(|bent| bent.seen_in(&frame)) };
                    }
                    id = *nested;
                }
                Bsdf::BlendBsdf { weight, nested } => {
                    id = nested[usize::from(happens(lobe, textures.at(*weight, surface).x))];
                }
                Bsdf::BumpMap { texture, scale, bend, nested } => {
                    let heights = textures.gradient(*texture, surface.uv) * *scale;
                    let normal = normal_of_heights(&upright, surface.normal, geometry.tangents(surface), heights);
                    let map = bent(&frame, wo, normal, *bend);
                    (id, frame, tilt) = (*nested, map.frame, Some(map));
                }
                Bsdf::NormalMap { normalmap, bend, nested } => {
                    let normal = normal_of_texel(textures.at(*normalmap, surface));
                    let map = bent(&frame, wo, normal, *bend);
                    (id, frame, tilt) = (*nested, map.frame, Some(map));
                }
                simple => {
                    let closure = closure(simple, &self.coats, id, textures, surface);
                    return Shading { closure, frame, tilt: tilt.map(|bent| bent.seen_in(&frame)) };
                }
            }
        }
    }
}

/// The bitmaps that a BSDF and those in it read.
fn bitmaps(scene: &Scene, id: BsdfId) -> Vec<TextureId> {
    let bsdf = &scene.bsdfs[id.0 as usize];
    let is_bitmap = |id: &TextureId| matches!(scene.textures[id.0 as usize], Texture::Bitmap { .. });
    let nested = bsdf.nested().into_iter().flat_map(|id| bitmaps(scene, id));
    bsdf.textures().into_iter().filter(is_bitmap).chain(nested).collect()
}

/// Decides an event of this probability by `lobe`, and makes a fresh number of what is left of it.
#[inline(always)]
fn happens(lobe: &mut f32, probability: f32) -> bool {
    let probability = probability.clamp(0.0, 1.0);
    let happens = *lobe < probability;
    *lobe = if happens { *lobe / probability } else { (*lobe - probability) / (1.0 - probability) };
    *lobe = lobe.min(1.0 - f32::EPSILON);
    happens
}

/// The BSDF as Lambert's, if it is that.
fn lambert(scene: &Scene, bsdf: BsdfId) -> Option<Lambert> {
    let albedo = |id: BsdfId| match scene.bsdfs[id.0 as usize] {
        Bsdf::Diffuse { reflectance } => Some(reflectance),
        _ => None,
    };
    match scene.bsdfs[bsdf.0 as usize] {
        Bsdf::TwoSided { front, back } => Some(Lambert { front: albedo(front)?, back: Some(albedo(back)?) }),
        _ => Some(Lambert { front: albedo(bsdf)?, back: None }),
    }
}

/// Whether a BSDF makes any choice but that of a direction.
fn has_lobes(scene: &Scene, bsdf: BsdfId) -> bool {
    match &scene.bsdfs[bsdf.0 as usize] {
        Bsdf::Diffuse { .. } | Bsdf::Conductor { .. } | Bsdf::RoughConductor { .. } | Bsdf::Null => false,
        Bsdf::TwoSided { front, back } => has_lobes(scene, *front) || has_lobes(scene, *back),
        Bsdf::BumpMap { nested, .. } | Bsdf::NormalMap { nested, .. } => has_lobes(scene, *nested),
        _ => true,
    }
}

/// Whether a BSDF needs tangents that follow the texture coordinates, given the same of those before it.
fn is_oriented(scene: &Scene, bsdf: &Bsdf, oriented: &[bool]) -> bool {
    let inner = |id: &BsdfId| oriented[id.0 as usize];
    let constant = |id: &TextureId| match &scene.textures[id.0 as usize] {
        Texture::Constant(value) => Some(value.x),
        _ => None,
    };
    match bsdf {
        Bsdf::RoughConductor { alpha_u, alpha_v, .. } | Bsdf::RoughDielectric { alpha_u, alpha_v, .. } => {
            alpha_u != alpha_v && (constant(alpha_u).is_none() || constant(alpha_u) != constant(alpha_v))
        }
        Bsdf::Principled { anisotropic, .. } | Bsdf::PrincipledThin { anisotropic, .. } => {
            constant(anisotropic) != Some(0.0)
        }
        Bsdf::BumpMap { .. } | Bsdf::NormalMap { .. } => true,
        Bsdf::Mask { nested, .. } => inner(nested),
        Bsdf::TwoSided { front, back } => inner(front) || inner(back),
        Bsdf::BlendBsdf { nested, .. } => nested.iter().any(inner),
        _ => false,
    }
}
#[cfg(test)]
mod tests;
