//! Ray against geometry: a hierarchy of boxes eight wide, and triangles in it.
//!
//! [`Bvh8`] is the hierarchy and its traversals, generic over what the leaves hold ([`Leaves`]); [`TriangleBvh`] puts triangles
//! there, large ones that lie across the axes in [`pieces`]. [`simd`] holds the vectors. All paths of [`simd::Isa`] give the same
//! bits, and the hit that is found does not depend on the shape of the tree: the nearest, and of hits at the same `t` that of the
//! smallest triangle number. Where triangles are in pieces, it is the nearest of all pieces.
//!
//! Nothing here knows of shapes, materials or meshes: triangles are numbers with three vertices.

mod aabb;
mod boxes;
mod build;
mod node;
mod pieces;
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
use pieces::{Cut, Piece, References, cut};
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
    triangles: u32,
    /// Of triangles that are in pieces; none in most scenes.
    pieces: Vec<Piece>,
}

/// What a visit of a block costs, in visits of a node; measured.
const LEAF_COST: LeafCost = LeafCost { max_count: 2 * BLOCK as u32, block: BLOCK as u32, block_cost: 1.0 };

/// A tree over pieces has to cost at most this part of that over whole triangles: at 0.96 it is no faster.
const WORTH_CUTTING: f32 = 0.9;

impl TriangleBvh {
    /// Builds the hierarchy over triangles 0 to `count - 1`, on the current rayon pool.
    ///
    /// `vertices` gives the three vertices of a triangle, finite and not all on one line, and is asked a few times for each. Triangles
    /// are cut into pieces where that makes a better tree ([`pieces`]). The same triangles give the same tree on any number of threads. At
    /// most 2^28 triangles.
    pub fn build(count: u32, vertices: impl Fn(u32) -> [Vec3; 3] + Sync) -> Self {
        Self::build_with(count, &vertices, WORTH_CUTTING)
    }

    /// The same, with pieces where the tree then costs at most this part.
    fn build_with(count: u32, vertices: &(impl Fn(u32) -> [Vec3; 3] + Sync), worth: f32) -> Self {
        let boxes: Vec<Aabb> = (0..count).into_par_iter().map(|i| triangle_bounds(vertices(i))).collect();
        let whole = Built::new(&boxes, LEAF_COST);
        let cost = whole.sah_cost(LEAF_COST);
        // No second tree where cuts do not even promise half of what they have to make it cheaper by.
        let cut = cut(&boxes, whole.bvh.bounds(), 0.5 * (1.0 - worth) * cost, vertices);
        drop(boxes);
        if let Some(Cut { boxes, references, pieces }) = cut {
            let mut built = Built::new(&boxes, LEAF_COST);
            if built.sah_cost(LEAF_COST) <= worth * cost {
                built.order.iter_mut().for_each(|i| *i = references[*i as usize]);
                return Self::filled(built, count, pieces, vertices);
            }
        }
        Self::filled(whole, count, Vec::new(), vertices)
    }

    /// Puts the triangles into blocks, in the order of the nodes.
    fn filled(built: Built, triangles: u32, pieces: Vec<Piece>, vertices: impl Fn(u32) -> [Vec3; 3] + Sync) -> Self {
        let Built { mut bvh, order } = built;
        let mut runs: Vec<&[u32]> = Vec::with_capacity(order.len() / 2);
        bvh.map_leaves(|leaf| {
            let first = runs.len();
            runs.extend(order[leaf.first as usize..][..leaf.count as usize].chunks(BLOCK));
            Leaf { first: first as u32, count: (runs.len() - first) as u32 }
        });
        let references = References { triangles, pieces: &pieces };
        let block = |run: &&[u32]| Block::new(run.iter().map(|&i| (i, vertices(references.triangle(i)))));
        let mut blocks = with_room(runs.len());
        runs.par_iter().map(block).collect_into_vec(&mut blocks);
        Self { bvh, blocks, triangles, pieces }
    }

    fn references(&self) -> References<'_> {
        References { triangles: self.triangles, pieces: &self.pieces }
    }

    /// The ray against the triangles.
    #[inline(always)]
    fn against<const PIECES: bool>(&self, ray: &Ray) -> Blocks<'_, PIECES> {
        Blocks::new(ray, &self.blocks, self.references())
    }

    /// Runs the loop that this mesh needs.
    #[inline]
    fn trace<L: Lanes, S: Search>(&self, lanes: L, search: S) -> S::Output {
        if self.pieces.is_empty() {
            lanes.run(Trace::<_, false>(self, search))
        } else {
            lanes.run(Trace::<_, true>(self, search))
        }
    }

    /// The nearest hit with `0 < t <= ray.t_max`, on either side of a triangle.
    #[inline]
    pub fn closest<L: Lanes>(&self, lanes: L, ray: &Ray) -> Option<TriangleHit> {
        self.trace(lanes, Closest(ray))
    }

    /// Whether there is a hit with `0 < t <= ray.t_max`.
    #[inline]
    pub fn occluded<L: Lanes>(&self, lanes: L, ray: &Ray) -> bool {
        self.trace(lanes, Occluded(ray))
    }

    /// [`TriangleBvh::closest`] of many rays at once, the same hits to the bit: up to twice as fast for rays that go
    /// everywhere in a mesh larger than the caches, slower for neighbouring rays. `hits` is as long as `rays`; a
    /// hundred rays a call are enough.
    #[inline]
    pub fn closest_many<L: Lanes>(&self, lanes: L, rays: &[Ray], hits: &mut [Option<TriangleHit>]) {
        self.trace(lanes, ClosestMany { rays, hits });
    }

    /// [`TriangleBvh::occluded`] of many rays at once. `occluded` is as long as `rays`.
    #[inline]
    pub fn occluded_many<L: Lanes>(&self, lanes: L, rays: &[Ray], occluded: &mut [bool]) {
        self.trace(lanes, OccludedMany { rays, occluded });
    }

    /// Size and quality.
    pub fn stats(&self) -> Stats {
        let (nodes, node_bytes) = self.bvh.size();
        Stats {
            nodes,
            blocks: self.blocks.len(),
            bytes: node_bytes + size_of_val(self.blocks.as_slice()) + size_of_val(self.pieces.as_slice()),
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

/// What is asked of a mesh.
trait Search {
    type Output;

    /// The answer, where triangles are in `PIECES` or none is.
    fn of<L: Lanes, const PIECES: bool>(self, lanes: L, mesh: &TriangleBvh) -> Self::Output;
}

/// A search as compiled for a path, with triangles in `PIECES` or without.
struct Trace<'a, S, const PIECES: bool>(&'a TriangleBvh, S);

impl<S: Search, const PIECES: bool> Kernel for Trace<'_, S, PIECES> {
    type Output = S::Output;

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) -> S::Output {
        self.1.of::<L, PIECES>(lanes, self.0)
    }
}

/// [`TriangleBvh::closest`].
struct Closest<'a>(&'a Ray);

impl Search for Closest<'_> {
    type Output = Option<TriangleHit>;

    #[inline(always)]
    fn of<L: Lanes, const PIECES: bool>(self, lanes: L, mesh: &TriangleBvh) -> Self::Output {
        let mut blocks = mesh.against::<PIECES>(self.0);
        mesh.bvh.nearest(lanes, self.0, &mut blocks);
        blocks.nearest.hit()
    }
}

/// [`TriangleBvh::occluded`].
struct Occluded<'a>(&'a Ray);

impl Search for Occluded<'_> {
    type Output = bool;

    #[inline(always)]
    fn of<L: Lanes, const PIECES: bool>(self, lanes: L, mesh: &TriangleBvh) -> bool {
        mesh.bvh.any(lanes, self.0, &mut mesh.against::<PIECES>(self.0))
    }
}

/// [`TriangleBvh::closest_many`].
struct ClosestMany<'a> {
    rays: &'a [Ray],
    hits: &'a mut [Option<TriangleHit>],
}

impl Search for ClosestMany<'_> {
    type Output = ();

    #[inline(always)]
    fn of<L: Lanes, const PIECES: bool>(self, lanes: L, mesh: &TriangleBvh) {
        let start = |ray: &Ray| mesh.against::<PIECES>(ray);
        let finish = |index: usize, blocks: &Blocks<PIECES>| self.hits[index] = blocks.nearest.hit();
        mesh.bvh.nearest_many(lanes, self.rays, start, finish);
    }
}

/// [`TriangleBvh::occluded_many`].
struct OccludedMany<'a> {
    rays: &'a [Ray],
    occluded: &'a mut [bool],
}

impl Search for OccludedMany<'_> {
    type Output = ();

    #[inline(always)]
    fn of<L: Lanes, const PIECES: bool>(self, lanes: L, mesh: &TriangleBvh) {
        let start = |ray: &Ray| mesh.against::<PIECES>(ray);
        let finish = |index: usize, any| self.occluded[index] = any;
        mesh.bvh.any_many(lanes, self.rays, start, finish);
    }
}
