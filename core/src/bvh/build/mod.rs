//! From boxes to a hierarchy: a binary tree, collapsed to eight children a node.
//!
//! Of many boxes, neighbours are put together to parts of some ten thousand ([`cut`]); the binary tree of each part is built by itself, in
//! a processor's cache and beside others, and its upper nodes are built anew with those of all others ([`parts`]).

mod binary;
mod collapse;
mod cut;
mod parts;
#[cfg(test)]
mod tests;

use super::Aabb;
use super::node::{Bvh8, Node};
use binary::balanced_tree;
use collapse::{GRAIN, collapsed};
use parts::{Sizes, binary_tree};

/// What a leaf costs and may hold.
#[derive(Clone, Copy, Debug)]
pub struct LeafCost {
    /// The most primitives of a leaf.
    pub max_count: u32,
    /// How many primitives are tested at once.
    pub block: u32,
    /// What such a test costs, in visits of a node.
    pub block_cost: f32,
}

impl LeafCost {
    /// What a leaf of so many primitives costs, in visits of a node.
    fn of(&self, count: u32) -> f32 {
        count.div_ceil(self.block) as f32 * self.block_cost
    }
}

/// A hierarchy whose leaves are runs of `order`.
pub struct Built {
    /// The nodes.
    pub bvh: Bvh8,
    /// Indices into the boxes it was built from.
    pub order: Vec<u32>,
}

impl Built {
    /// [`Bvh8::sah_cost`] where leaves cost this.
    pub fn sah_cost(&self, leaf: LeafCost) -> f32 {
        self.bvh.sah_cost(1.0, |run| leaf.of(run.count))
    }

    /// Builds the hierarchy over finite `boxes`, fewer than 2^31: the same tree for the same boxes on any number of threads.
    pub fn new(boxes: &[Aabb], leaf: LeafCost) -> Built {
        if boxes.is_empty() {
            let nodes = vec![Node::EMPTY];
            return Built { bvh: Bvh8 { nodes }, order: Vec::new() };
        }
        let all = boxes.iter().fold(Aabb::EMPTY, |all, &b| all.union(b));
        if (all.half_area() * boxes.len() as f32).is_finite() {
            let built = collapsed(binary_tree(boxes, Sizes::USUAL), leaf, GRAIN);
            if built.bvh.stack_need() <= Bvh8::STACK {
                return built;
            }
        }
        // Boxes whose sizes grow geometrically make chains, and areas beyond f32 cannot be compared. A balanced tree is
        // worse to trace and never deep.
        collapsed(balanced_tree(boxes), leaf, GRAIN)
    }
}
