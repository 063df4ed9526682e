//! Ray against geometry: a hierarchy of boxes eight wide, and triangles in it.
//!
//! [`Bvh8`] is the hierarchy and its traversals, generic over what the leaves hold ([`Leaves`]); [`TriangleBvh`] puts triangles
//! there. [`simd`] holds the vectors. All paths of [`simd::Isa`] give the same bits, and the hit that is found does not
//! depend on the shape of the tree: the nearest, and of hits at the same `t` that of the smallest triangle number.
//!
//! Nothing here knows of shapes, materials or meshes: triangles are numbers with three vertices.

mod aabb;
mod boxes;
mod build;
mod node;
pub mod simd;
mod stream;
#[cfg(test)]
mod tests;
mod traverse;
mod triangle;

pub use aabb::Aabb;
pub use boxes::Boxes;
pub use build::{Built, LeafCost};
pub use node::{Bvh8, Child, Leaf, Node};
pub use traverse::{Leaves, Ray, Slabs};
pub use triangle::triangle_bounds;

use glam::Vec3;
use rayon::prelude::*;
use simd::{Kernel, Lanes, with_room};
use triangle::{BLOCK, Block, Blocks};

/// Where a ray meets a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TriangleHit {
    /// The hit is at `origin + t * direction`; above 0.
    pub t: f32,
    /// The barycentric weight of vertex 1.
    pub u: f32,
    /// The barycentric weight of vertex 2; vertex 0 has `1 - u - v`.
    pub v: f32,
    /// The triangle's number.
    pub triangle: u32,
}

/// A hierarchy over triangles, with its own copy of their positions.
#[derive(Clone, Debug)]
pub struct TriangleBvh {
    bvh: Bvh8,
    blocks: Vec<Block>,
}

/// What a visit of a block costs, in visits of a node; measured.
const LEAF_COST: LeafCost = LeafCost { max_count: 2 * BLOCK as u32, block: BLOCK as u32, block_cost: 1.0 };

impl TriangleBvh {
    /// Builds the hierarchy over triangles 0 to `count - 1`, on the current rayon pool.
    ///
    /// `vertices` gives the three vertices of a triangle, finite and not all on one line, and is asked twice for each.
    /// The same triangles give the same tree on any number of threads. At most 2^28 triangles.
    pub fn build(count: u32, vertices: impl Fn(u32) -> [Vec3; 3] + Sync) -> Self {
        let boxes: Vec<Aabb> = (0..count).into_par_iter().map(|i| triangle_bounds(vertices(i))).collect();
        let Built { mut bvh, order } = Built::new(&boxes, LEAF_COST);
        drop(boxes);
        // The triangles of each block, in the order of the nodes.
        let mut runs: Vec<&[u32]> = Vec::with_capacity(order.len() / 2);
        bvh.map_leaves(|leaf| {
            let first = runs.len();
            runs.extend(order[leaf.first as usize..][..leaf.count as usize].chunks(BLOCK));
            Leaf { first: first as u32, count: (runs.len() - first) as u32 }
        });
        let mut blocks = with_room(runs.len());
        let block = |run: &&[u32]| Block::new(run.iter().map(|&i| (i, vertices(i))));
        runs.par_iter().map(block).collect_into_vec(&mut blocks);
        Self { bvh, blocks }
    }

    /// The nearest hit with `0 < t <= ray.t_max`, on either side of a triangle.
    #[inline]
    pub fn closest<L: Lanes>(&self, lanes: L, ray: &Ray) -> Option<TriangleHit> {
        lanes.run(Closest { mesh: self, ray })
    }

    /// Whether there is a hit with `0 < t <= ray.t_max`.
    #[inline]
    pub fn occluded<L: Lanes>(&self, lanes: L, ray: &Ray) -> bool {
        lanes.run(Occluded { mesh: self, ray })
    }

    /// [`TriangleBvh::closest`] of many rays at once, the same hits to the bit: up to twice as fast for rays that go
    /// everywhere in a mesh larger than the caches, slower for neighbouring rays. `hits` is as long as `rays`; a
    /// hundred rays a call are enough.
    #[inline]
    pub fn closest_many<L: Lanes>(&self, lanes: L, rays: &[Ray], hits: &mut [Option<TriangleHit>]) {
        lanes.run(ClosestMany { mesh: self, rays, hits });
    }

    /// [`TriangleBvh::occluded`] of many rays at once. `occluded` is as long as `rays`.
    #[inline]
    pub fn occluded_many<L: Lanes>(&self, lanes: L, rays: &[Ray], occluded: &mut [bool]) {
        lanes.run(OccludedMany { mesh: self, rays, occluded });
    }

    /// Size and quality.
    pub fn stats(&self) -> Stats {
        let (nodes, node_bytes) = self.bvh.size();
        Stats {
            nodes,
            blocks: self.blocks.len(),
            bytes: node_bytes + size_of_val(self.blocks.as_slice()),
            sah_cost: self.bvh.sah_cost(1.0, |leaf| leaf.count as f32 * LEAF_COST.block_cost),
        }
    }
}

/// Size and quality of a hierarchy.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stats {
    /// How many nodes.
    pub nodes: usize,
    /// How many blocks of triangles.
    pub blocks: usize,
    /// What both take in memory.
    pub bytes: usize,
    /// The surface area heuristic: the cost of an average ray, in visits of a node.
    pub sah_cost: f32,
}

/// [`TriangleBvh::closest`] as compiled for a path.
struct Closest<'a> {
    mesh: &'a TriangleBvh,
    ray: &'a Ray,
}

impl Kernel for Closest<'_> {
    type Output = Option<TriangleHit>;

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) -> Self::Output {
        let mut blocks = Blocks::new(self.ray, &self.mesh.blocks);
        self.mesh.bvh.nearest(lanes, self.ray, &mut blocks);
        blocks.nearest.hit()
    }
}

/// [`TriangleBvh::occluded`] as compiled for a path.
struct Occluded<'a> {
    mesh: &'a TriangleBvh,
    ray: &'a Ray,
}

impl Kernel for Occluded<'_> {
    type Output = bool;

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) -> Self::Output {
        let mut blocks = Blocks::new(self.ray, &self.mesh.blocks);
        self.mesh.bvh.any(lanes, self.ray, &mut blocks)
    }
}

/// [`TriangleBvh::closest_many`] as compiled for a path.
struct ClosestMany<'a> {
    mesh: &'a TriangleBvh,
    rays: &'a [Ray],
    hits: &'a mut [Option<TriangleHit>],
}

impl Kernel for ClosestMany<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) {
        let start = |ray: &Ray| Blocks::new(ray, &self.mesh.blocks);
        let finish = |index: usize, blocks: &Blocks| self.hits[index] = blocks.nearest.hit();
        self.mesh.bvh.nearest_many(lanes, self.rays, start, finish);
    }
}

/// [`TriangleBvh::occluded_many`] as compiled for a path.
struct OccludedMany<'a> {
    mesh: &'a TriangleBvh,
    rays: &'a [Ray],
    occluded: &'a mut [bool],
}

impl Kernel for OccludedMany<'_> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) {
        let start = |ray: &Ray| Blocks::new(ray, &self.mesh.blocks);
        let finish = |index: usize, any| self.occluded[index] = any;
        self.mesh.bvh.any_many(lanes, self.rays, start, finish);
    }
}
