//! The hierarchy over analytic shapes.

use super::Analytic;
use crate::bvh::simd::Lanes;
use crate::bvh::{Aabb, Built, Bvh8, Leaf, LeafCost, Leaves, Ray, Slabs};

/// Boxes around analytic shapes, and the shapes in the order of its leaves.
pub struct AnalyticBvh {
    bvh: Bvh8,
    order: Vec<u32>,
}

/// One shape's formula costs about as much as a node.
const LEAF_COST: LeafCost = LeafCost { max_count: 2, block: 1, block_cost: 1.0 };

impl AnalyticBvh {
    /// Builds it over a list of shapes.
    pub fn build(shapes: &[Analytic]) -> Self {
        let bounds = |shape: &Analytic| {
            let (min, max) = shape.bounds();
            Aabb { min, max }
        };
        let Built { bvh, order } = Built::new(&shapes.iter().map(bounds).collect::<Vec<_>>(), LEAF_COST);
        Self { bvh, order }
    }

    /// What it takes in memory.
    pub fn bytes(&self) -> usize {
        self.bvh.size().1 + size_of_val(&*self.order)
    }

    /// The nearest hit up to `ray.t_max`, and the index of its shape; of equally near ones the first shape.
    #[inline(always)]
    pub fn closest<L: Lanes>(&self, lanes: L, shapes: &[Analytic], ray: &Ray) -> Option<(f32, u32)> {
        let mut visit = Visit { shapes, order: &self.order, ray, nearest: None };
        self.bvh.nearest(lanes, ray, &mut visit);
        visit.nearest
    }

    /// Whether any shape is hit up to `ray.t_max`.
    #[inline(always)]
    pub fn occluded<L: Lanes>(&self, lanes: L, shapes: &[Analytic], ray: &Ray) -> bool {
        self.bvh.any(lanes, ray, &mut Visit { shapes, order: &self.order, ray, nearest: None })
    }
}

struct Visit<'a> {
    shapes: &'a [Analytic],
    order: &'a [u32],
    ray: &'a Ray,
    nearest: Option<(f32, u32)>,
}

impl Visit<'_> {
    #[inline(always)]
    fn hits(&self, leaf: Leaf, t_max: f32) -> impl Iterator<Item = (f32, u32)> {
        self.order[leaf.first as usize..][..leaf.count as usize].iter().filter_map(move |&i| {
            self.shapes[i as usize].intersect(self.ray.origin, self.ray.direction, t_max).map(|t| (t, i))
        })
    }
}

impl<L: Lanes> Leaves<L> for Visit<'_> {
    #[inline(always)]
    fn nearest(&mut self, _: L, _: &Slabs, leaf: Leaf, t_max: f32) -> f32 {
        let first = |a: (f32, u32), b: (f32, u32)| if b < a { b } else { a };
        self.nearest = self.hits(leaf, t_max).chain(self.nearest).reduce(first);
        self.nearest.map_or(t_max, |(t, _)| t)
    }

    #[inline(always)]
    fn address(&self, leaf: Leaf) -> *const u8 {
        self.order.as_ptr().wrapping_add(leaf.first as usize).cast()
    }

    #[inline(always)]
    fn any(&mut self, _: L, _: &Slabs, leaf: Leaf, t_max: f32) -> bool {
        self.hits(leaf, t_max).next().is_some()
    }
}
