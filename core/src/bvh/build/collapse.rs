//! From two children a node to eight, by dynamic programming.
//!
//! Ylitie, Karras & Laine 2017, section 3.1: `cost[n][i]` is the least SAH cost of the primitives below binary node `n` as a forest of at
//! most `i + 1` trees that hang from one wide node.

use super::super::node::{Bvh8, Child, Leaf, Node, WIDTH};
use super::super::simd::with_room;
use super::binary::{BinaryTree, Twig};
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

/// What matters of a twig to what is above it.
#[derive(Clone, Copy)]
struct Summary {
    forests: Forests,
    /// The sum of half areas of the boxes below.
    content: f32,
}

/// What was decided at an inner node, and what of its [`Summary`] is needed afterwards.
#[derive(Clone, Copy)]
struct Choice {
    /// What is below as one tree costs this.
    cost: f32,
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

/// A binary tree, and what its leaves cost.
struct Costs<'a> {
    tree: BinaryTree<'a>,
    leaf: LeafCost,
}

impl Costs<'_> {
    /// Decides at every inner node: in all parts at once, then above them.
    fn choices(&self) -> Vec<Choice> {
        let mut choices = vec![Choice::NONE; self.tree.inner.len()];
        let (top, mut rest) = choices.split_at_mut(self.tree.top_nodes());
        let mut parts = Vec::new();
        for part in self.tree.parts() {
            let (own, others) = rest.split_at_mut(part.len());
            parts.push((part.start, own));
            rest = others;
        }
        // What hangs from the top is all that is asked of a part.
        let below_top = self.tree.inner[..top.len()].iter().flat_map(|node| node.below);
        let mut roots: Vec<usize> = below_top.filter_map(|twig| twig.index().err()).collect();
        roots.sort_unstable();
        let of_part = |(start, own): (usize, &mut [Choice])| {
            let below = |end: usize| roots.partition_point(|&root| root < end);
            let roots = &roots[below(start)..below(start + own.len())];
            let summaries = self.decide(start, own, &[]);
            roots.iter().map(|&root| (root, summaries[root - start])).collect::<Vec<_>>()
        };
        let of_parts = parts.into_par_iter().map(of_part).collect::<Vec<_>>().concat();
        self.decide(0, top, &of_parts);
        choices
    }

    /// Decides at the inner nodes from `start` on, for which `choices` has room. What hangs from them is among them, or in order in
    /// `elsewhere`.
    fn decide(&self, start: usize, choices: &mut [Choice], elsewhere: &[(usize, Summary)]) -> Vec<Summary> {
        let mut summaries = vec![Summary { forests: [0.0; WIDTH - 1], content: 0.0 }; choices.len()];
        for index in (0..choices.len()).rev() {
            let below = self.tree.inner[start + index].below.map(|twig| match twig.index() {
                // A box is one tree, however many it may be.
                Ok(leaf) => Summary {
                    forests: [self.leaf_cost(twig); WIDTH - 1],
                    content: self.tree.boxes[leaf as usize].half_area(),
                },
                Err(inner) if (start..start + summaries.len()).contains(&inner) => summaries[inner - start],
                Err(inner) => elsewhere[elsewhere.partition_point(|&(node, _)| node < inner)].1,
            });
            (choices[index], summaries[index]) = self.choose(Twig::inner(start + index), below);
        }
        summaries
    }

    /// Decides at an inner node.
    fn choose(&self, twig: Twig, below: [Summary; 2]) -> (Choice, Summary) {
        let content = below[0].content + below[1].content;
        let below = below.map(|twig| twig.forests);
        let (as_node, of_left) = split(&below, WIDTH);
        let (as_node, as_leaf) = (as_node + self.tree.bounds(twig).half_area(), self.leaf_cost(twig));
        let cost = as_leaf.min(as_node);
        let mut bits = (of_left as u32) << (3 * (WIDTH - 2));
        let mut forests = [cost; WIDTH - 1];
        for trees in 2..WIDTH {
            let (together, of_left) = split(&below, trees);
            forests[trees - 1] = forests[trees - 2].min(together);
            bits |= (of_left as u32) << (3 * (trees - 2));
            bits |= u32::from(forests[trees - 1] != cost) << (Choice::LESS + trees - 2);
        }
        let is_leaf = self.tree.count(twig) <= self.leaf.max_count && as_leaf <= cost;
        bits |= u32::from(is_leaf) << Choice::LEAF;
        (Choice { cost, content, bits }, Summary { forests, content })
    }

    fn leaf_cost(&self, twig: Twig) -> f32 {
        let count = self.tree.count(twig);
        if count > self.leaf.max_count {
            return f32::INFINITY;
        }
        self.tree.bounds(twig).half_area() * self.leaf.of(count)
    }
}

/// Branches of at most so many boxes, emitted one beside another: many more than there are processors, and long enough each.
pub const GRAIN: u32 = 1 << 14;

/// The wide tree that costs least, emitted in branches of at most `grain` boxes.
pub fn collapsed(tree: BinaryTree, leaf: LeafCost, grain: u32) -> Built {
    let costs = Costs { tree, leaf };
    let choices = costs.choices();
    let collapse = Collapse { costs, choices };
    let top = collapse.emit(collapse.costs.tree.root, grain);
    let branches: Vec<Branch> = top.cut.par_iter().map(|&(twig, _)| collapse.emit(twig, 0)).collect();
    // The tree is not needed any more: there is room for a copy.
    drop(collapse);
    joined(top, &branches)
}

/// Part of a wide tree: its root is the first node, and nodes and order are counted from the part's own beginning.
struct Branch {
    nodes: Vec<Node>,
    order: Vec<u32>,
    /// What is to be emitted yet, and the nodes for which it is the root.
    cut: Vec<(Twig, usize)>,
}

/// The tree whose top has these branches.
fn joined(top: Branch, branches: &[Branch]) -> Built {
    // All nodes of a branch but its root, which has its place already.
    let (mut first_nodes, mut first_items) = (vec![top.nodes.len()], vec![top.order.len()]);
    for (i, branch) in branches.iter().enumerate() {
        first_nodes.push(first_nodes[i] + branch.nodes.len() - 1);
        first_items.push(first_items[i] + branch.order.len());
    }
    let placed = |branch: usize, index: usize| {
        let (node, item) = (first_nodes[branch] as u32, first_items[branch] as u32);
        branches[branch].nodes[index].moved(|child| match child.as_leaf() {
            Some(leaf) => Child::leaf(Leaf { first: leaf.first + item, ..leaf }),
            None => Child::node(child.0 + node - 1),
        })
    };
    let mut nodes = with_room(first_nodes[branches.len()]);
    let node = |i: usize| match first_nodes.partition_point(|&first| first <= i).checked_sub(1) {
        None => top.nodes[i].clone(),
        Some(branch) => placed(branch, i - first_nodes[branch] + 1),
    };
    (0..first_nodes[branches.len()]).into_par_iter().map(node).collect_into_vec(&mut nodes);
    for (branch, &(_, root)) in top.cut.iter().enumerate() {
        nodes[root] = placed(branch, 0);
    }
    let mut order = Vec::with_capacity(first_items[branches.len()]);
    order.extend(top.order);
    branches.iter().for_each(|branch| order.extend(&branch.order));
    Built { bvh: Bvh8 { nodes }, order }
}

/// A binary tree, and how to make a wide one of it.
struct Collapse<'a> {
    costs: Costs<'a>,
    /// Of the inner nodes.
    choices: Vec<Choice>,
}

impl Collapse<'_> {
    /// The roots of the forest of at most `trees` trees.
    fn roots(&self, twig: Twig, trees: usize, out: &mut Vec<Twig>) {
        match twig.index() {
            Err(inner) if self.choices[inner].is_opened(trees) => self.roots_below(inner, trees, out),
            _ => out.push(twig),
        }
    }

    fn roots_below(&self, index: usize, trees: usize, out: &mut Vec<Twig>) {
        let [left, right] = self.costs.tree.inner[index].below;
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
        let area = self.costs.tree.bounds(twig).half_area();
        let (cost, content) = match twig.index() {
            Ok(leaf) => (self.costs.leaf_cost(twig), self.costs.tree.boxes[leaf as usize].half_area()),
            Err(inner) => (self.choices[inner].cost, self.choices[inner].content),
        };
        let density = 0.5 * content / area;
        density / (1.0 + density) * area / cost
    }

    /// Appends the boxes below: few, so that calls do not go deep.
    fn append(&self, twig: Twig, order: &mut Vec<u32>) {
        match twig.index() {
            Ok(leaf) => order.push(leaf),
            Err(inner) => self.costs.tree.inner[inner].below.iter().for_each(|&below| self.append(below, order)),
        }
    }

    fn leaf_at(&self, twig: Twig, order: &mut Vec<u32>) -> Leaf {
        let first = order.len() as u32;
        self.append(twig, order);
        Leaf { first, count: order.len() as u32 - first }
    }

    /// The wide tree below a twig, but for what is below twigs of at most `grain` boxes.
    fn emit(&self, root: Twig, grain: u32) -> Branch {
        let mut branch = Branch { nodes: vec![Node::EMPTY], order: Vec::new(), cut: Vec::new() };
        let mut open = vec![(root, 0)];
        let mut roots = Vec::with_capacity(WIDTH);
        let mut promising = Vec::with_capacity(WIDTH);
        while let Some((twig, wide)) = open.pop() {
            if self.costs.tree.count(twig) <= grain {
                branch.cut.push((twig, wide));
                continue;
            }
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
                    Child::leaf(self.leaf_at(below, &mut branch.order))
                } else {
                    // The nodes below one node lie side by side.
                    branch.nodes.push(Node::EMPTY);
                    open.push((below, branch.nodes.len() - 1));
                    Child::node(branch.nodes.len() as u32 - 1)
                };
                branch.nodes[wide].set(slot, self.costs.tree.bounds(below), child);
            }
            open[opened..].reverse();
        }
        branch
    }
}
