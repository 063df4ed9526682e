//! From two children a node to eight, by dynamic programming.
//!
//! Ylitie, Karras & Laine 2017, section 3.1: `cost[n][i]` is the least SAH cost of the primitives below binary node `n` as a forest of at
//! most `i + 1` trees that hang from one wide node.

use super::super::node::{Bvh8, Child, Leaf, Node, WIDTH};
use super::super::simd::settled;
use super::binary::{BinaryTree, Inner, Twig};
use super::{Built, LeafCost};

/// The least cost of two twigs as `trees` trees together, from the costs of each, and how many of them the left one gets.
fn split([left, right]: &[[f32; WIDTH - 1]; 2], trees: usize) -> (f32, usize) {
    let mut best = (f32::INFINITY, 1);
    for of_left in 1..trees {
        let cost = left[of_left - 1] + right[trees - of_left - 1];
        if cost < best.0 {
            best = (cost, of_left);
        }
    }
    best
}

/// A binary tree with the costs of all ways to make a wide one of it.
pub struct Collapse<'a> {
    tree: BinaryTree<'a>,
    /// Of the inner nodes.
    cost: Vec<[f32; WIDTH - 1]>,
    /// The sum of half areas of the boxes below each inner node.
    content: Vec<f32>,
    leaf: LeafCost,
}

impl<'a> Collapse<'a> {
    /// The wide tree.
    pub fn run(tree: BinaryTree<'a>, leaf: LeafCost) -> Built {
        let cost = vec![[0.0; WIDTH - 1]; tree.inner.len()];
        let content = vec![0.0; tree.inner.len()];
        let mut collapse = Collapse { tree, cost, content, leaf };
        for index in (0..collapse.cost.len()).rev() {
            collapse.cost[index] = collapse.forests(index);
            let below = collapse.tree.inner[index].below;
            collapse.content[index] = below.map(|twig| collapse.content(twig)).iter().sum();
        }
        let mut built = collapse.emit();
        // The tree is gone: there is room for a copy.
        built.bvh.nodes = settled(built.bvh.nodes);
        built
    }

    fn leaf_cost(&self, twig: Twig) -> f32 {
        let count = self.tree.count(twig);
        if count > self.leaf.max_count {
            return f32::INFINITY;
        }
        let blocks = count.div_ceil(self.leaf.block) as f32;
        self.tree.bounds(twig).half_area() * blocks * self.leaf.block_cost
    }

    /// The costs of what is below as at most one tree, two, …: a box is one tree, however many it may be.
    fn costs(&self, twig: Twig) -> [f32; WIDTH - 1] {
        twig.index().map_or_else(|inner| self.cost[inner], |_| [self.leaf_cost(twig); WIDTH - 1])
    }

    fn content(&self, twig: Twig) -> f32 {
        twig.index().map_or_else(|inner| self.content[inner], |leaf| self.tree.boxes[leaf as usize].half_area())
    }

    fn forests(&self, index: usize) -> [f32; WIDTH - 1] {
        let Inner { bounds, below, .. } = &self.tree.inner[index];
        let below = below.map(|twig| self.costs(twig));
        let as_node = split(&below, WIDTH).0 + bounds.half_area();
        let mut cost = [self.leaf_cost(Twig::inner(index)).min(as_node); WIDTH - 1];
        for trees in 2..WIDTH {
            cost[trees - 1] = cost[trees - 2].min(split(&below, trees).0);
        }
        cost
    }

    /// The roots of the forest of at most `trees` trees.
    fn roots(&self, twig: Twig, trees: usize, out: &mut Vec<Twig>) {
        match twig.index() {
            Err(inner) if trees > 1 && self.cost[inner][trees - 1] != self.cost[inner][0] => {
                self.roots_below(inner, trees, out);
            }
            _ => out.push(twig),
        }
    }

    fn roots_below(&self, index: usize, trees: usize, out: &mut Vec<Twig>) {
        let [left, right] = self.tree.inner[index].below;
        let of_left = split(&[self.costs(left), self.costs(right)], trees).1;
        self.roots(left, of_left, out);
        self.roots(right, trees - of_left, out);
    }

    fn is_leaf(&self, twig: Twig) -> bool {
        let count = self.tree.count(twig);
        count == 1 || count <= self.leaf.max_count && self.leaf_cost(twig) <= self.costs(twig)[0]
    }

    /// The chance that a ray which passes the box hits something in it, by the cost of finding out. An any-hit traversal
    /// that goes down where this is largest ends soonest. The chance is a guess: `density` boxes lie behind any point
    /// of the surface, and half of what passes a primitive's box hits it.
    fn promise(&self, twig: Twig) -> f32 {
        let area = self.tree.bounds(twig).half_area();
        let cost = if self.is_leaf(twig) { self.leaf_cost(twig) } else { self.costs(twig)[0] };
        let density = 0.5 * self.content(twig) / area;
        density / (1.0 + density) * area / cost
    }

    /// Appends the boxes below: few, so that calls do not go deep.
    fn append(&self, twig: Twig, order: &mut Vec<u32>) {
        match twig.index() {
            Ok(leaf) => order.push(leaf),
            Err(inner) => self.tree.inner[inner].below.iter().for_each(|&below| self.append(below, order)),
        }
    }

    fn leaf_at(&self, twig: Twig, order: &mut Vec<u32>) -> Leaf {
        let first = order.len() as u32;
        self.append(twig, order);
        Leaf { first, count: order.len() as u32 - first }
    }

    fn emit(self) -> Built {
        let mut nodes = vec![Node::EMPTY];
        let mut order = Vec::with_capacity(self.tree.boxes.len());
        let mut open = vec![(self.tree.root, 0)];
        let mut roots = Vec::with_capacity(WIDTH);
        let mut promising = Vec::with_capacity(WIDTH);
        while let Some((twig, wide)) = open.pop() {
            roots.clear();
            match twig.index() {
                Err(inner) if !self.is_leaf(twig) => self.roots_below(inner, WIDTH, &mut roots),
                // Only the root of the whole tree: a node with one leaf.
                _ => roots.push(twig),
            }
            promising.clear();
            promising.extend(roots.iter().map(|&twig| (self.promise(twig), twig)));
            promising.sort_by(|(a, _), (b, _)| b.total_cmp(a));
            let opened = open.len();
            for (slot, &(_, below)) in promising.iter().enumerate() {
                let child = if self.is_leaf(below) {
                    Child::leaf(self.leaf_at(below, &mut order))
                } else {
                    // The nodes below one node lie side by side.
                    nodes.push(Node::EMPTY);
                    open.push((below, nodes.len() - 1));
                    Child::node(nodes.len() as u32 - 1)
                };
                nodes[wide].set(slot, self.tree.bounds(below), child);
            }
            open[opened..].reverse();
        }
        Built { bvh: Bvh8 { nodes }, order }
    }
}
