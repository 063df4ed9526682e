//! From two children a node to eight, by dynamic programming.
//!
//! Ylitie, Karras & Laine 2017, section 3.1: `cost[n][i]` is the least SAH cost of the primitives below binary node `n` as a forest of at
//! most `i + 1` trees that hang from one wide node.

use super::super::node::{Bvh8, Child, Leaf, Node, WIDTH};
use super::super::simd::settled;
use super::binary::{BinaryTree, Inner, Twig};
use super::{Built, LeafCost};
use rayon::prelude::*;

/// The costs of what is below as at most one tree, two, …
type Forests = [f32; WIDTH - 1];

/// The least cost of two twigs as `trees` trees together, from the costs of each, and how many of them the left one gets.
fn split([left, right]: &[Forests; 2], trees: usize) -> (f32, usize) {
    let mut best = (f32::INFINITY, 1);
    for of_left in 1..trees {
        let cost = left[of_left - 1] + right[trees - of_left - 1];
        if cost < best.0 {
            best = (cost, of_left);
        }
    }
    best
}

/// What was decided at an inner node.
#[derive(Clone, Copy)]
struct Choice {
    /// What is below as one tree costs this.
    cost: f32,
    /// The sum of half areas of the boxes below.
    content: f32,
    /// For two to eight trees, three bits each, how many of them the left one gets; then for two to seven, whether they cost less than one;
    /// then whether all of it is a leaf.
    bits: u32,
}

impl Choice {
    const NONE: Self = Self { cost: 0.0, content: 0.0, bits: 0 };
    const LESS: usize = 3 * (WIDTH - 1);
    const LEAF: usize = Self::LESS + WIDTH - 2;

    /// Of `trees` trees, how many the left twig gets.
    fn of_left(self, trees: usize) -> usize {
        (self.bits >> (3 * (trees - 2)) & 7) as usize
    }

    /// Whether `trees` trees, fewer than eight, cost less than one.
    fn is_opened(self, trees: usize) -> bool {
        trees > 1 && self.bits >> (Self::LESS + trees - 2) & 1 != 0
    }

    fn is_leaf(self) -> bool {
        self.bits >> Self::LEAF & 1 != 0
    }
}

/// A binary tree, and how to make a wide one of it.
pub struct Collapse<'a> {
    tree: BinaryTree<'a>,
    leaf: LeafCost,
    /// Of the inner nodes.
    choices: Vec<Choice>,
}

impl<'a> Collapse<'a> {
    /// The wide tree.
    pub fn run(tree: BinaryTree<'a>, leaf: LeafCost) -> Built {
        let mut choices = vec![Choice::NONE; tree.inner.len()];
        let top_nodes = tree.top_nodes();
        let (top, mut rest) = choices.split_at_mut(top_nodes);
        let mut parts = Vec::new();
        for part in tree.parts() {
            let (choices, others) = rest.split_at_mut(part.len());
            parts.push((part.start, choices));
            rest = others;
        }
        let collapse = Collapse { tree, leaf, choices: Vec::new() };
        // What hangs from the top is all that matters of the forests of a part.
        let mut roots: Vec<usize> = collapse.tree.inner[..top_nodes]
            .iter()
            .flat_map(|node| node.below)
            .filter_map(|twig| twig.index().err())
            .collect();
        roots.sort_unstable();
        let of_part = |(start, choices): (usize, &mut [Choice])| {
            let forests = collapse.decide(start, choices, &[]);
            let range = roots.partition_point(|&root| root < start)
                ..roots.partition_point(|&root| root < start + choices.len());
            let outside = |&root: &usize| (root, forests[root - start], choices[root - start].content);
            roots[range].iter().map(outside).collect::<Vec<_>>()
        };
        let outside: Vec<_> = parts.into_par_iter().map(of_part).collect::<Vec<_>>().concat();
        collapse.decide(0, top, &outside);
        let mut built = Collapse { choices, ..collapse }.emit();
        // The tree is gone: there is room for a copy.
        built.bvh.nodes = settled(built.bvh.nodes);
        built
    }

    /// Decides at the inner nodes from `start` on, for which `choices` has room. Of nodes elsewhere that hang from these, `outside` has forests
    /// and contents, in order. Gives the forests.
    fn decide(&self, start: usize, choices: &mut [Choice], outside: &[(usize, Forests, f32)]) -> Vec<Forests> {
        let mut forests = vec![[0.0; WIDTH - 1]; choices.len()];
        for index in (0..choices.len()).rev() {
            let Inner { bounds, below, .. } = &self.tree.inner[start + index];
            let below = below.map(|twig| match twig.index() {
                // A box is one tree, however many it may be.
                Ok(leaf) => ([self.leaf_cost(twig); WIDTH - 1], self.tree.boxes[leaf as usize].half_area()),
                Err(inner) if (start..start + choices.len()).contains(&inner) => {
                    (forests[inner - start], choices[inner - start].content)
                }
                Err(inner) => {
                    let at = outside.partition_point(|&(node, ..)| node < inner);
                    (outside[at].1, outside[at].2)
                }
            });
            let content = below[0].1 + below[1].1;
            let below = below.map(|(forests, _)| forests);
            let (as_node, of_left) = split(&below, WIDTH);
            let (as_node, as_leaf) = (as_node + bounds.half_area(), self.leaf_cost(Twig::inner(start + index)));
            let one = as_leaf.min(as_node);
            let mut bits = (of_left as u32) << (3 * (WIDTH - 2));
            let mut costs = [one; WIDTH - 1];
            for trees in 2..WIDTH {
                let (cost, of_left) = split(&below, trees);
                costs[trees - 1] = costs[trees - 2].min(cost);
                bits |= (of_left as u32) << (3 * (trees - 2));
                bits |= u32::from(costs[trees - 1] != one) << (Choice::LESS + trees - 2);
            }
            let is_leaf = self.tree.inner[start + index].count <= self.leaf.max_count && as_leaf <= one;
            bits |= u32::from(is_leaf) << Choice::LEAF;
            (choices[index], forests[index]) = (Choice { cost: one, content, bits }, costs);
        }
        forests
    }

    fn leaf_cost(&self, twig: Twig) -> f32 {
        let count = self.tree.count(twig);
        if count > self.leaf.max_count {
            return f32::INFINITY;
        }
        let blocks = count.div_ceil(self.leaf.block) as f32;
        self.tree.bounds(twig).half_area() * blocks * self.leaf.block_cost
    }

    /// The roots of the forest of at most `trees` trees.
    fn roots(&self, twig: Twig, trees: usize, out: &mut Vec<Twig>) {
        match twig.index() {
            Err(inner) if self.choices[inner].is_opened(trees) => self.roots_below(inner, trees, out),
            _ => out.push(twig),
        }
    }

    fn roots_below(&self, index: usize, trees: usize, out: &mut Vec<Twig>) {
        let [left, right] = self.tree.inner[index].below;
        let of_left = self.choices[index].of_left(trees);
        self.roots(left, of_left, out);
        self.roots(right, trees - of_left, out);
    }

    fn is_leaf(&self, twig: Twig) -> bool {
        twig.index().map_or_else(|inner| self.choices[inner].is_leaf(), |_| true)
    }

    /// The chance that a ray which passes the box hits something in it, by the cost of finding out. An any-hit traversal
    /// that goes down where this is largest ends soonest. The chance is a guess: `density` boxes lie behind any point
    /// of the surface, and half of what passes a primitive's box hits it.
    fn promise(&self, twig: Twig) -> f32 {
        let area = self.tree.bounds(twig).half_area();
        let (cost, content) = match twig.index() {
            Ok(leaf) => (self.leaf_cost(twig), self.tree.boxes[leaf as usize].half_area()),
            Err(inner) => (self.choices[inner].cost, self.choices[inner].content),
        };
        let density = 0.5 * content / area;
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
