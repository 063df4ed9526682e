//! From boxes to a hierarchy: a binary tree by obvhs, collapsed to eight children a node by dynamic programming.
//!
//! The binary tree is PLOC's (Meister & Bittner 2018), improved by reinsertion (Meister & Bittner 2018b), with one
//! primitive a leaf. The collapse is that of Ylitie, Karras & Laine 2017, section 3.1: `cost[n][i]` is the least SAH
//! cost of the primitives below binary node `n` as a forest of at most `i + 1` trees that hang from one wide node.

use super::Aabb;
use super::node::{Bvh8, Child, Leaf, Node, WIDTH};
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
    /// Builds the hierarchy over finite `boxes`: the same tree for the same boxes on any number of threads.
    pub fn new(boxes: &[Aabb], leaf: LeafCost) -> Built {
        if boxes.is_empty() {
            let nodes = vec![Node::EMPTY];
            return Built { bvh: Bvh8 { nodes }, order: Vec::new() };
        }
        let all = boxes.iter().fold(Aabb::EMPTY, |all, &b| all.union(b));
        if (all.half_area() * boxes.len() as f32).is_finite() {
            let built = Collapse::run(&binary_tree(boxes), leaf);
            if built.bvh.stack_need() <= Bvh8::STACK {
                return built;
            }
        }
        // Boxes whose sizes grow geometrically make chains, and areas beyond f32 cannot be compared. A balanced tree is
        // worse to trace and never deep.
        Collapse::run(&balanced_tree(boxes), leaf)
    }
}

/// A node of the binary tree.
struct Binary {
    bounds: Aabb,
    /// The two children, or one primitive twice.
    below: [u32; 2],
    /// How many primitives are below; 1 makes it a leaf.
    count: u32,
}

/// Nodes in an order that has parents before children; node 0 is the root.
type BinaryTree = Vec<Binary>;

fn binary_tree(boxes: &[Aabb]) -> BinaryTree {
    let indices = (0..boxes.len() as u32).collect();
    let mut tree = PlocBuilder::new().build(PlocSearchDistance::Medium, boxes, indices, SortPrecision::U64, 1);
    ReinsertionOptimizer::default().run(&mut tree, 0.2, None);
    parents_first(&tree)
}

impl obvhs::Boundable for Aabb {
    fn aabb(&self) -> obvhs::aabb::Aabb {
        obvhs::aabb::Aabb::new(self.min.into(), self.max.into())
    }
}

fn parents_first(tree: &Bvh2) -> BinaryTree {
    let mut nodes: BinaryTree = Vec::with_capacity(tree.nodes.len());
    // What waits is a node of obvhs and where its new index goes.
    let mut open = vec![(0_u32, None)];
    while let Some((from, parent)) = open.pop() {
        let node = &tree.nodes[from as usize];
        let index = nodes.len() as u32;
        if let Some((parent, side)) = parent {
            let parent: &mut Binary = &mut nodes[parent as usize];
            parent.below[side] = index;
        }
        let below = if node.is_leaf() {
            [tree.primitive_indices[node.first_index as usize]; 2]
        } else {
            open.push((node.first_index + 1, Some((index, 1))));
            open.push((node.first_index, Some((index, 0))));
            [0; 2]
        };
        nodes.push(Binary {
            bounds: Aabb { min: node.aabb().min.into(), max: node.aabb().max.into() },
            below,
            count: u32::from(node.is_leaf()),
        });
    }
    for index in (0..nodes.len()).rev() {
        if nodes[index].count == 0 {
            nodes[index].count = nodes[index].below.map(|child| nodes[child as usize].count).iter().sum();
        }
    }
    nodes
}

/// A tree of depth log2 of the boxes: halves by the centre along the longest axis.
fn balanced_tree(boxes: &[Aabb]) -> BinaryTree {
    let mut order: Vec<u32> = (0..boxes.len() as u32).collect();
    let mut nodes: BinaryTree = Vec::with_capacity(2 * boxes.len());
    let mut open = vec![(0, boxes.len(), None)];
    while let Some((start, end, parent)) = open.pop() {
        let index = nodes.len() as u32;
        if let Some((parent, side)) = parent {
            let parent: &mut Binary = &mut nodes[parent as usize];
            parent.below[side] = index;
        }
        let run = &mut order[start..end];
        let bounds = run.iter().fold(Aabb::EMPTY, |all, &i| all.union(boxes[i as usize]));
        let count = run.len() as u32;
        let below = [run[0]; 2];
        if run.len() > 1 {
            let axis = (bounds.max - bounds.min).max_position();
            // Half of each, so that the sum cannot overflow.
            let centre = |i: &u32| boxes[*i as usize].min[axis] * 0.5 + boxes[*i as usize].max[axis] * 0.5;
            let middle = run.len() / 2;
            run.select_nth_unstable_by(middle, |a, b| centre(a).total_cmp(&centre(b)).then(a.cmp(b)));
            open.push((start + middle, end, Some((index, 1))));
            open.push((start, start + middle, Some((index, 0))));
        }
        nodes.push(Binary { bounds, below, count });
    }
    nodes
}

struct Collapse<'a> {
    tree: &'a [Binary],
    cost: Vec<[f32; WIDTH - 1]>,
    /// The sum of half areas of the boxes below each binary node.
    content: Vec<f32>,
    leaf: LeafCost,
}

impl Collapse<'_> {
    fn run(tree: &[Binary], leaf: LeafCost) -> Built {
        let cost = vec![[0.0; WIDTH - 1]; tree.len()];
        let content = vec![0.0; tree.len()];
        let mut collapse = Collapse { tree, cost, content, leaf };
        for (index, node) in tree.iter().enumerate().rev() {
            collapse.cost[index] = collapse.forests(index);
            collapse.content[index] = match node.count {
                1 => node.bounds.half_area(),
                _ => node.below.map(|child| collapse.content[child as usize]).iter().sum(),
            };
        }
        collapse.emit()
    }

    fn leaf_cost(&self, index: usize) -> f32 {
        let node = &self.tree[index];
        if node.count > self.leaf.max_count {
            return f32::INFINITY;
        }
        let blocks = node.count.div_ceil(self.leaf.block) as f32;
        node.bounds.half_area() * blocks * self.leaf.block_cost
    }

    /// The least cost of the node's two children as `trees` trees together, and how many of them the left one gets.
    fn split(&self, index: usize, trees: usize) -> (f32, usize) {
        let [left, right] = self.tree[index].below.map(|child| &self.cost[child as usize]);
        let mut best = (f32::INFINITY, 1);
        for of_left in 1..trees {
            let cost = left[of_left - 1] + right[trees - of_left - 1];
            if cost < best.0 {
                best = (cost, of_left);
            }
        }
        best
    }

    fn forests(&self, index: usize) -> [f32; WIDTH - 1] {
        let node = &self.tree[index];
        if node.count == 1 {
            return [self.leaf_cost(index); WIDTH - 1];
        }
        let as_node = self.split(index, WIDTH).0 + node.bounds.half_area();
        let mut cost = [self.leaf_cost(index).min(as_node); WIDTH - 1];
        for trees in 2..WIDTH {
            cost[trees - 1] = cost[trees - 2].min(self.split(index, trees).0);
        }
        cost
    }

    /// The roots of the forest of at most `trees` trees.
    fn roots(&self, index: usize, trees: usize, out: &mut Vec<usize>) {
        let cost = &self.cost[index];
        if trees == 1 || self.tree[index].count == 1 || cost[trees - 1] == cost[0] {
            out.push(index);
        } else {
            self.roots_of_children(index, trees, out);
        }
    }

    fn roots_of_children(&self, index: usize, trees: usize, out: &mut Vec<usize>) {
        let of_left = self.split(index, trees).1;
        let [left, right] = self.tree[index].below.map(|child| child as usize);
        self.roots(left, of_left, out);
        self.roots(right, trees - of_left, out);
    }

    fn is_leaf(&self, index: usize) -> bool {
        let count = self.tree[index].count;
        count == 1 || count <= self.leaf.max_count && self.leaf_cost(index) <= self.cost[index][0]
    }

    /// The chance that a ray which passes the box hits something in it, by the cost of finding out. An any-hit traversal
    /// that goes down where this is largest ends soonest. The chance is a guess: `density` boxes lie behind any point
    /// of the surface, and half of what passes a primitive's box hits it.
    fn promise(&self, index: usize) -> f32 {
        let area = self.tree[index].bounds.half_area();
        let cost = if self.is_leaf(index) { self.leaf_cost(index) } else { self.cost[index][0] };
        let density = 0.5 * self.content[index] / area;
        density / (1.0 + density) * area / cost
    }

    /// Appends the primitives below the node.
    fn leaf_at(&self, index: usize, order: &mut Vec<u32>) -> Leaf {
        let first = order.len() as u32;
        let mut open = vec![index];
        while let Some(index) = open.pop() {
            let node = &self.tree[index];
            if node.count == 1 {
                order.push(node.below[0]);
            } else {
                open.extend(node.below.iter().rev().map(|&child| child as usize));
            }
        }
        Leaf { first, count: order.len() as u32 - first }
    }

    fn emit(&self) -> Built {
        let mut nodes = vec![Node::EMPTY];
        let mut order = Vec::with_capacity(self.tree[0].count as usize);
        let mut open = vec![(0, 0)];
        let mut roots = Vec::with_capacity(WIDTH);
        while let Some((index, wide)) = open.pop() {
            roots.clear();
            if self.is_leaf(index) {
                // Only the root of the whole tree: a node with one leaf.
                roots.push(index);
            } else {
                self.roots_of_children(index, WIDTH, &mut roots);
            }
            roots.sort_by(|&a, &b| self.promise(b).total_cmp(&self.promise(a)));
            let opened = open.len();
            for (slot, &below) in roots.iter().enumerate() {
                let child = if self.is_leaf(below) {
                    Child::leaf(self.leaf_at(below, &mut order))
                } else {
                    // The nodes below one node lie side by side.
                    nodes.push(Node::EMPTY);
                    open.push((below, nodes.len() - 1));
                    Child::node(nodes.len() as u32 - 1)
                };
                nodes[wide].set(slot, self.tree[below].bounds, child);
            }
            open[opened..].reverse();
        }
        nodes.shrink_to_fit();
        Built { bvh: Bvh8 { nodes }, order }
    }
}
