//! From boxes to a hierarchy: a binary tree by obvhs, collapsed to eight children a node by dynamic programming.
//!
//! The binary tree is PLOC's (Meister & Bittner 2018), improved by reinsertion (Meister & Bittner 2018b), with one
//! primitive a leaf. The collapse is that of Ylitie, Karras & Laine 2017, section 3.1: `cost[n][i]` is the least SAH
//! cost of the primitives below binary node `n` as a forest of at most `i + 1` trees that hang from one wide node.

use super::Aabb;
use super::node::{Bvh8, Child, Leaf, Node, WIDTH};
use super::simd::settled;
use obvhs::bvh2::{Bvh2, reinsertion::ReinsertionOptimizer};
use obvhs::ploc::{PlocBuilder, PlocSearchDistance, SortPrecision};

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

/// A hierarchy whose leaves are runs of `order`.
pub struct Built {
    /// The nodes.
    pub bvh: Bvh8,
    /// Indices into the boxes it was built from.
    pub order: Vec<u32>,
}

impl Built {
    /// Builds the hierarchy over finite `boxes`, fewer than 2^31: the same tree for the same boxes on any number of threads.
    pub fn new(boxes: &[Aabb], leaf: LeafCost) -> Built {
        if boxes.is_empty() {
            let nodes = vec![Node::EMPTY];
            return Built { bvh: Bvh8 { nodes }, order: Vec::new() };
        }
        let all = boxes.iter().fold(Aabb::EMPTY, |all, &b| all.union(b));
        if (all.half_area() * boxes.len() as f32).is_finite() {
            let built = Collapse::run(binary_tree(boxes), leaf);
            if built.bvh.stack_need() <= Bvh8::STACK {
                return built;
            }
        }
        // Boxes whose sizes grow geometrically make chains, and areas beyond f32 cannot be compared. A balanced tree is
        // worse to trace and never deep.
        Collapse::run(balanced_tree(boxes), leaf)
    }
}

/// What hangs below an inner node of the binary tree: another one, or a box. The highest bit says which.
#[derive(Clone, Copy)]
struct Twig(u32);

impl Twig {
    const IS_BOX: u32 = 1 << 31;

    fn inner(index: usize) -> Self {
        Self(index as u32)
    }

    fn leaf(index: u32) -> Self {
        Self(index | Self::IS_BOX)
    }

    /// The index of the box or, failing that, of the inner node.
    fn index(self) -> Result<u32, usize> {
        if self.0 & Self::IS_BOX == 0 { Err(self.0 as usize) } else { Ok(self.0 & !Self::IS_BOX) }
    }
}

/// An inner node.
struct Inner {
    bounds: Aabb,
    below: [Twig; 2],
    /// How many boxes are below.
    count: u32,
}

/// A binary tree over boxes, one a leaf. It is the largest thing while a scene is compiled, so leaves are no nodes: they are the
/// boxes that are there anyway.
struct BinaryTree<'a> {
    boxes: &'a [Aabb],
    /// Parents before children.
    inner: Vec<Inner>,
    root: Twig,
}

impl<'a> BinaryTree<'a> {
    /// A tree that hangs from nothing yet.
    fn over(boxes: &'a [Aabb]) -> Self {
        Self { boxes, inner: Vec::with_capacity(boxes.len() - 1), root: Twig::inner(0) }
    }

    /// Hangs a twig from an inner node, left (0) or right (1), or from nothing: the root.
    fn hang(&mut self, twig: Twig, parent: Option<(usize, usize)>) {
        match parent {
            Some((parent, side)) => self.inner[parent].below[side] = twig,
            None => self.root = twig,
        }
    }

    /// A new inner node whose twigs come later; its index.
    fn grow(&mut self, bounds: Aabb, parent: Option<(usize, usize)>) -> usize {
        let index = self.inner.len();
        self.hang(Twig::inner(index), parent);
        self.inner.push(Inner { bounds, below: [Twig::inner(0); 2], count: 0 });
        index
    }

    /// Counts what is below, when all is hung.
    fn counted(mut self) -> Self {
        for index in (0..self.inner.len()).rev() {
            self.inner[index].count = self.inner[index].below.map(|twig| self.count(twig)).iter().sum();
        }
        self
    }

    fn bounds(&self, twig: Twig) -> Aabb {
        match twig.index() {
            Ok(leaf) => self.boxes[leaf as usize],
            Err(inner) => self.inner[inner].bounds,
        }
    }

    fn count(&self, twig: Twig) -> u32 {
        twig.index().map_or_else(|inner| self.inner[inner].count, |_| 1)
    }
}

/// The share of the nodes, from the top, that reinsertion looks at in its first pass. A fifth took a million triangles twice as long
/// to build and traced no faster.
const REINSERTED: f32 = 0.05;

fn binary_tree(boxes: &[Aabb]) -> BinaryTree<'_> {
    let indices = (0..boxes.len() as u32).collect();
    let mut tree = PlocBuilder::new().build(PlocSearchDistance::Medium, boxes, indices, SortPrecision::U64, 1);
    ReinsertionOptimizer::default().run(&mut tree, REINSERTED, None);
    parents_first(boxes, &tree)
}

impl obvhs::Boundable for Aabb {
    fn aabb(&self) -> obvhs::aabb::Aabb {
        obvhs::aabb::Aabb::new(self.min.into(), self.max.into())
    }
}

fn parents_first<'a>(boxes: &'a [Aabb], from: &Bvh2) -> BinaryTree<'a> {
    let mut tree = BinaryTree::over(boxes);
    // What waits is a node of obvhs and where it hangs.
    let mut open = vec![(0_u32, None)];
    while let Some((index, parent)) = open.pop() {
        let node = &from.nodes[index as usize];
        if node.is_leaf() {
            tree.hang(Twig::leaf(from.primitive_indices[node.first_index as usize]), parent);
        } else {
            let bounds = Aabb { min: node.aabb().min.into(), max: node.aabb().max.into() };
            let inner = tree.grow(bounds, parent);
            open.extend([(node.first_index + 1, Some((inner, 1))), (node.first_index, Some((inner, 0)))]);
        }
    }
    tree.counted()
}

/// A tree of depth log2 of the boxes: halves by the centre along the longest axis.
fn balanced_tree(boxes: &[Aabb]) -> BinaryTree<'_> {
    let mut order: Vec<u32> = (0..boxes.len() as u32).collect();
    let mut tree = BinaryTree::over(boxes);
    let mut open = vec![(0, boxes.len(), None)];
    while let Some((start, end, parent)) = open.pop() {
        let run = &mut order[start..end];
        if let [leaf] = run {
            tree.hang(Twig::leaf(*leaf), parent);
            continue;
        }
        let bounds = run.iter().fold(Aabb::EMPTY, |all, &i| all.union(boxes[i as usize]));
        let axis = (bounds.max - bounds.min).max_position();
        // Half of each, so that the sum cannot overflow.
        let centre = |i: &u32| boxes[*i as usize].min[axis] * 0.5 + boxes[*i as usize].max[axis] * 0.5;
        let middle = run.len() / 2;
        run.select_nth_unstable_by(middle, |a, b| centre(a).total_cmp(&centre(b)).then(a.cmp(b)));
        let inner = tree.grow(bounds, parent);
        open.extend([(start + middle, end, Some((inner, 1))), (start, start + middle, Some((inner, 0)))]);
    }
    tree.counted()
}

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

struct Collapse<'a> {
    tree: BinaryTree<'a>,
    /// Of the inner nodes.
    cost: Vec<[f32; WIDTH - 1]>,
    /// The sum of half areas of the boxes below each inner node.
    content: Vec<f32>,
    leaf: LeafCost,
}

impl<'a> Collapse<'a> {
    fn run(tree: BinaryTree<'a>, leaf: LeafCost) -> Built {
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
