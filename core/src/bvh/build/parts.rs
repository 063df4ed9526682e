//! A binary tree over many boxes, built in parts.

use super::super::Aabb;
use super::binary::{BinaryTree, Inner, REINSERTED, Twig, whole};
use super::cut::cut;
use rayon::prelude::*;

/// The most boxes of a part: some megabytes while it is built.
pub const BOXES_MAX: usize = 1 << 16;
/// Trees into which a part is opened, so that what is above is made of all parts: large boxes, which no cut suits, come together there. With
/// 64 rays through an interior cost 2 % more, with one 7 %; with more than these there is nothing to gain.
const TREES: usize = 256;

/// A part of the boxes, built by itself.
struct Part {
    /// As in [`BinaryTree`]; those that were opened are not needed any more.
    inner: Vec<Inner>,
    /// What it was opened into, and their boxes.
    trees: Vec<(Twig, Aabb)>,
}

impl Part {
    fn new(boxes: &[Aabb], indices: &[u32]) -> Self {
        let own: Vec<Aabb> = indices.iter().map(|&i| boxes[i as usize]).collect();
        let tree = whole(&own, REINSERTED);
        let mut trees = open(&tree);
        let mut inner = tree.inner;
        let name = |twig: &mut Twig| *twig = twig.of_box(|i| indices[i as usize]);
        inner.iter_mut().flat_map(|node| &mut node.below).for_each(name);
        trees.iter_mut().map(|(twig, _)| twig).for_each(name);
        Self { inner, trees }
    }
}

/// Opens the root and then always the largest node that hangs from those, until there are [`TREES`] or all are boxes.
fn open(tree: &BinaryTree) -> Vec<(Twig, Aabb)> {
    let mut trees = vec![(tree.root, tree.bounds(tree.root))];
    let area =
        |(_, (twig, bounds)): &(usize, &(Twig, Aabb))| twig.index().map_or_else(|_| bounds.half_area(), |_| -1.0);
    while trees.len() < TREES {
        let largest = trees.iter().enumerate().max_by(|a, b| area(a).total_cmp(&area(b)));
        let Some((at, Err(inner))) = largest.map(|(at, (twig, _))| (at, twig.index())) else { break };
        trees.swap_remove(at);
        trees.extend(tree.inner[inner].below.map(|twig| (twig, tree.bounds(twig))));
    }
    trees
}

/// A good tree over finite boxes whose areas are finite, too, in parts of at most `most`: the same on any number of threads.
pub fn binary_tree(boxes: &[Aabb], most: usize) -> BinaryTree<'_> {
    if boxes.len() <= most {
        return whole(boxes, REINSERTED);
    }
    let mut order: Vec<u32> = (0..boxes.len() as u32).collect();
    let parts = cut(boxes, &mut order, most);
    let parts: Vec<Part> = parts.into_par_iter().map(|indices| Part::new(boxes, indices)).collect();
    drop(order);
    let tops: Vec<Aabb> = parts.iter().flat_map(|part| part.trees.iter().map(|&(_, bounds)| bounds)).collect();
    let top = whole(&tops, 1.0);
    let mut roots = Vec::with_capacity(tops.len());
    let mut tree = BinaryTree::over(boxes);
    tree.inner.reserve(top.inner.len() + parts.iter().map(|part| part.inner.len()).sum::<usize>());
    tree.inner.extend(top.inner);
    let top_nodes = tree.inner.len();
    // A part is gone as soon as it has its place.
    for Part { inner, trees } in parts {
        let first = tree.inner.len();
        tree.starts.push(first);
        roots.extend(trees.iter().map(|(twig, _)| twig.after(first)));
        tree.inner
            .extend(inner.into_iter().map(|node| Inner { below: node.below.map(|twig| twig.after(first)), ..node }));
    }
    let root = |twig: Twig| twig.index().map_or_else(Twig::inner, |top| roots[top as usize]);
    for node in &mut tree.inner[..top_nodes] {
        node.below = node.below.map(root);
    }
    tree.root = root(top.root);
    tree.counted(top_nodes)
}
