//! Groups of surfaces placed many times: a hierarchy over the places, and in each a ray in the group's own coordinates.
//!
//! A ray keeps its parameter t on the way into a group, since its direction is mapped and not made unit length. What is hit
//! does not depend on the hierarchy, for the reason that it does not among triangles: an instance counts only where the ray
//! passes its box, and is hit no nearer than the entry into it.

use super::{Geometry, Hit, Memory, Meshes};
use crate::bvh::simd::{Floats, Kernel, Lanes};
use crate::bvh::{Aabb, Built, Bvh8, Leaf, LeafCost, Leaves, Ray, Slabs};
use crate::frame::Frame;
use crate::scene::{Instance, Scene};
use crate::surface::{Surface, gamma};
use glam::{Affine3, Mat3, Vec3};

/// All groups of a scene and where they are.
pub struct Instances {
    groups: Vec<Geometry>,
    placed: Vec<Placed>,
    bvh: Bvh8,
    /// Indices into `placed` in the order of the hierarchy's leaves.
    order: Vec<u32>,
}

/// A group in its place.
struct Placed {
    group: u32,
    to_world: Affine3,
    to_group: Affine3,
    bounds: Aabb,
}

/// A whole group costs many nodes: none is looked into without its own box being passed.
const LEAF_COST: LeafCost = LeafCost { max_count: 1, block: 1, block_cost: 8.0 };

/// How far beyond the nearest hit so far a group is searched, as a factor: many roundings of f32.
const BEYOND: f32 = 1.0 + 1.0 / (1 << 16) as f32;

impl Instances {
    /// Of a scene that has some; shapes of groups are numbered after those that stand in the scene itself, group by group.
    pub fn new(scene: &Scene, meshes: &mut Meshes) -> Self {
        let mut first_shape = scene.shapes.len() as u32;
        let mut groups = Vec::with_capacity(scene.groups.len());
        for group in &scene.groups {
            groups.push(Geometry::level(meshes, &group.shapes, &vec![None; group.shapes.len()], first_shape));
            first_shape += group.shapes.len() as u32;
        }
        let boxes: Vec<Aabb> = groups.iter().map(Geometry::bounds_of_all).collect();
        let of_group = |instance: &Instance| boxes[instance.group.0 as usize];
        let instances = scene.instances.iter().filter(|instance| of_group(instance).min.x.is_finite());
        let mut placed: Vec<Placed> = instances.map(|instance| Placed::new(instance, of_group(instance))).collect();
        let reach = placed.iter().fold(Vec3::ZERO, |reach, p| reach.max(p.bounds.min.abs()).max(p.bounds.max.abs()));
        placed.iter_mut().for_each(|placed| placed.pad(reach));
        let bounds: Vec<Aabb> = placed.iter().map(|placed| placed.bounds).collect();
        let Built { bvh, order } = Built::new(&bounds, LEAF_COST);
        Self { groups, placed, bvh, order }
    }

    /// The nearest hit up to `ray.t_max`; of equally near ones that of the first instance.
    #[inline]
    pub fn closest<L: Lanes>(&self, lanes: L, ray: &Ray) -> Option<Hit> {
        lanes.run(Closest { instances: self, ray })
    }

    /// Whether anything is hit up to `ray.t_max`.
    #[inline]
    pub fn occluded<L: Lanes>(&self, lanes: L, ray: &Ray) -> bool {
        lanes.run(Occluded { instances: self, ray })
    }

    /// The surface where a ray hit the inside of an instance.
    pub fn surface(&self, ray: &Ray, instance: u32, hit: Hit) -> Surface {
        let placed = &self.placed[instance as usize];
        let local = self.groups[placed.group as usize].surface(&placed.ray(ray, ray.t_max), hit);
        Surface { instance: Some(instance), ..placed.surface(&local) }
    }

    /// As [`Geometry::tangents`].
    pub fn tangents(&self, instance: u32, surface: &Surface) -> (Vec3, Vec3) {
        let placed = &self.placed[instance as usize];
        let matrix = placed.to_world.matrix3;
        let position = placed.to_group.transform_point3(surface.position);
        let normal = (matrix.transpose() * surface.normal).normalize();
        let local = Surface { position, normal, instance: None, ..*surface };
        let (dpdu, dpdv) = self.groups[placed.group as usize].tangents(&local);
        (matrix * dpdu, matrix * dpdv)
    }

    /// The box around all of them.
    pub fn bounds(&self) -> Aabb {
        self.placed.iter().fold(Aabb::EMPTY, |all, placed| all.union(placed.bounds))
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.placed.len()
    }

    /// What the groups take in memory, and what their places do.
    pub fn memory(&self) -> Memory {
        let groups = self.groups.iter().map(Geometry::memory).fold(Memory::default(), Memory::plus);
        let places = size_of_val(&*self.placed) + size_of_val(&*self.order) + self.bvh.size().1;
        Memory { instances: groups.instances + places, ..groups }
    }
}

impl Placed {
    /// A group with this box, its own box not yet padded.
    fn new(instance: &Instance, inner: Aabb) -> Self {
        let Instance { group, to_world } = instance;
        // Inverted in f64: what is lost are the roundings of the result alone.
        let matrix = to_world.matrix3.as_dmat3().inverse();
        let translation = -(matrix * to_world.translation.as_dvec3());
        let to_group = Affine3 { matrix3: matrix.as_mat3(), translation: translation.as_vec3() };
        let (centre, half) = (0.5 * inner.min + 0.5 * inner.max, 0.5 * inner.max - 0.5 * inner.min);
        let (centre, half) = (to_world.transform_point3(centre), absolute(to_world.matrix3) * half);
        let bounds = Aabb { min: centre - half, max: centre + half };
        Self { group: group.0, to_world: *to_world, to_group, bounds }
    }

    /// Makes the box so much larger that a ray which hits the group up to rounding passes it, if it comes from no farther than
    /// `reach` away.
    fn pad(&mut self, reach: Vec3) {
        let (there, back) = (absolute(self.to_group.matrix3), absolute(self.to_world.matrix3));
        let corner = self.bounds.min.abs().max(self.bounds.max.abs());
        let pad = (back * (there * reach + self.to_group.translation.abs()) + corner) * gamma(16);
        (self.bounds.min, self.bounds.max) = (self.bounds.min - pad, self.bounds.max + pad);
    }

    /// A ray in the group's coordinates.
    #[inline(always)]
    fn ray(&self, ray: &Ray, t_max: f32) -> Ray {
        Ray {
            origin: self.to_group.transform_point3(ray.origin),
            direction: self.to_group.transform_vector3(ray.direction),
            t_max,
        }
    }

    /// A surface of the group in scene coordinates. Its error takes in that rays which leave it are rounded once more on their
    /// way back into the group.
    fn surface(&self, local: &Surface) -> Surface {
        let (matrix, inverse) = (self.to_world.matrix3, self.to_group.matrix3);
        let position = self.to_world.transform_point3(local.position);
        let (there, back) = (absolute(inverse), absolute(matrix));
        let lost = (there * position.abs() + self.to_group.translation.abs()) * gamma(6);
        let moved = (back * local.position.abs() + self.to_world.translation.abs()) * gamma(4);
        let normal = |n: Vec3| (inverse.transpose() * n).normalize();
        Surface {
            position,
            error: back * (local.error + lost) * (1.0 + gamma(4)) + moved,
            normal: normal(local.normal),
            frame: Frame::around(normal(local.frame.n)),
            ..*local
        }
    }
}

fn absolute(matrix: Mat3) -> Mat3 {
    Mat3::from_cols(matrix.x_axis.abs(), matrix.y_axis.abs(), matrix.z_axis.abs())
}

/// [`Instances::closest`] as compiled for a path.
struct Closest<'a> {
    instances: &'a Instances,
    ray: &'a Ray,
}

impl Kernel for Closest<'_> {
    type Output = Option<Hit>;

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) -> Self::Output {
        let Self { instances, ray } = self;
        let mut visit = Visit { instances, ray, nearest: None };
        instances.bvh.nearest(lanes, ray, &mut visit);
        visit.nearest.map(|(t, instance, hit)| hit.in_instance(t, instance))
    }
}

/// [`Instances::occluded`] as compiled for a path.
struct Occluded<'a> {
    instances: &'a Instances,
    ray: &'a Ray,
}

impl Kernel for Occluded<'_> {
    type Output = bool;

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) -> Self::Output {
        let Self { instances, ray } = self;
        instances.bvh.any(lanes, ray, &mut Visit { instances, ray, nearest: None })
    }
}

/// A ray among the instances.
struct Visit<'a> {
    instances: &'a Instances,
    ray: &'a Ray,
    /// Where, in which instance, and on what of its group.
    nearest: Option<(f32, u32, Hit)>,
}

impl Visit<'_> {
    /// The instances of a leaf whose box the ray passes up to `t_max`, and where it enters.
    #[inline(always)]
    fn passed<L: Lanes>(&self, lanes: L, slabs: &Slabs, leaf: Leaf, t_max: f32) -> impl Iterator<Item = (u32, f32)> {
        let order = &self.instances.order[leaf.first as usize..][..leaf.count as usize];
        order.iter().filter_map(move |&i| {
            let Aabb { min, max } = self.instances.placed[i as usize].bounds;
            let sides = [min.to_array(), max.to_array()];
            let (near, far) = slabs.spans(lanes, |axis, side| L::X4::splat(lanes, sides[side][axis]), t_max);
            (near.le(far) & 1 != 0).then(|| (i, near.store()[0]))
        })
    }

    #[inline(always)]
    fn group(&self, instance: u32, t_max: f32) -> (&Geometry, Ray) {
        let placed = &self.instances.placed[instance as usize];
        (&self.instances.groups[placed.group as usize], placed.ray(self.ray, t_max))
    }
}

impl<L: Lanes> Leaves<L> for Visit<'_> {
    #[inline(always)]
    fn nearest(&mut self, lanes: L, slabs: &Slabs, leaf: Leaf, t_max: f32) -> f32 {
        let mut best = self.nearest;
        for (i, entry) in self.passed(lanes, slabs, leaf, t_max) {
            // A little farther: the formulas of analytic shapes may find a hit nearer than their box, by rounding, and one that
            // is just as far as the nearest so far must not be lost.
            let (group, ray) = self.group(i, best.map_or(t_max, |(t, ..)| t) * BEYOND);
            let Some(hit) = group.closest_of_own(lanes, &ray, group.bvh.closest(lanes, &ray)) else { continue };
            let t = hit.t().max(entry);
            if t <= t_max && best.is_none_or(|(other, first, _)| (t, i) < (other, first)) {
                best = Some((t, i, hit));
            }
        }
        self.nearest = best;
        best.map_or(t_max, |(t, ..)| t)
    }

    #[inline(always)]
    fn address(&self, leaf: Leaf) -> *const u8 {
        self.instances.order.as_ptr().wrapping_add(leaf.first as usize).cast()
    }

    #[inline(always)]
    fn any(&mut self, lanes: L, slabs: &Slabs, leaf: Leaf, t_max: f32) -> bool {
        self.passed(lanes, slabs, leaf, t_max).any(|(i, _)| {
            let (group, ray) = self.group(i, t_max);
            group.occluded_by_own(lanes, &ray)
        })
    }
}

#[cfg(test)]
mod tests;
