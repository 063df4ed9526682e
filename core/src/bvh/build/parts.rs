//! A binary tree over many boxes, built in parts.

use super::super::Aabb;
use super::binary::{BinaryTree, Inner, REINSERTED, Twig, whole};
use super::cut::cut;
use rayon::prelude::*;

/// How parts are made.
#[derive(Clone, Copy)]
pub struct Sizes {
    /// The most boxes of a part.
    pub boxes: usize,
    /// Trees into which a part is opened, so that what is above is made of all parts: large boxes, which no cut suits, come together there.
    pub trees: usize,
}

impl Sizes {
    /// A part takes some megabytes while it is built. By the surface area heuristic an interior costs 2 % more with 64 trees, 7 % with one;
    /// with more than these there is nothing to gain.
    pub const USUAL: Self = Self { boxes: 1 << 16, trees: 256 };
}

/// Opens the root and then always the largest node that hangs from those, until there are so many trees or all are boxes. The opened
/// nodes are not needed any more.
fn open(tree: &BinaryTree, count: usize) -> Vec<Twig> {
    let mut trees = vec![tree.root];
    let area = |twig: &Twig| twig.index().map_or_else(|inner| tree.inner[inner].bounds.half_area(), |_| -1.0);
    while trees.len() < count {
        let largest = (0..trees.len()).max_by(|&a, &b| area(&trees[a]).total_cmp(&area(&trees[b])));
        let Some((at, Err(inner))) = largest.map(|at| (at, trees[at].index())) else { break };
        trees.swap_remove(at);
        trees.extend(tree.inner[inner].below);
    }
    trees
}

/// A good tree over finite boxes whose areas are finite, too, in parts if they are many: the same on any number of threads.
pub fn binary_tree(boxes: &[Aabb], sizes: Sizes) -> BinaryTree<'_> {
    if boxes.len() <= sizes.boxes {
        return whole(boxes, REINSERTED);
    }
    let mut order: Vec<u32> = (0..boxes.len() as u32).collect();
    let parts = cut(boxes, &mut order, sizes.boxes).into_par_iter().map(|indices| {
        let own: Vec<Aabb> = indices.iter().map(|&i| boxes[i as usize]).collect();
        let part = whole(&own, REINSERTED).among(boxes, indices);
        let trees = open(&part, sizes.trees);
        (part, trees)
    });
    let parts: Vec<(BinaryTree, Vec<Twig>)> = parts.collect();
    drop(order);
    let tops = parts.iter().flat_map(|(part, trees)| trees.iter().map(|&twig| part.bounds(twig)));
    let tops: Vec<Aabb> = tops.collect();
    let top = whole(&tops, 1.0);
    let top_nodes = top.inner.len();
    let mut tree = BinaryTree::over(boxes, top_nodes + parts.iter().map(|(part, _)| part.inner.len()).sum::<usize>());
    tree.inner.extend(top.inner);
    let mut roots = Vec::with_capacity(tops.len());
    // A part is gone as soon as it has its place.
    for (part, trees) in parts {
        let first = tree.inner.len();
        tree.starts.push(first);
        roots.extend(trees.iter().map(|twig| twig.after(first)));
        let placed = |node: Inner| Inner { below: node.below.map(|twig| twig.after(first)), ..node };
        tree.inner.extend(part.inner.into_iter().map(placed));
    }
    let root = |twig: Twig| twig.index().map_or_else(Twig::inner, |top| roots[top as usize]);
    for node in &mut tree.inner[..top_nodes] {
        node.below = node.below.map(root);
    }
    tree.root = root(top.root);
    tree.counted()
}
