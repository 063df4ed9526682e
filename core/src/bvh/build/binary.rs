//! Binary trees over boxes, one a leaf.
//!
//! The usual one is PLOC's (Meister & Bittner 2018), improved by reinsertion (Meister & Bittner 2018b), both by obvhs.

use super::super::Aabb;
use super::cut::halve;
use obvhs::bvh2::{Bvh2, reinsertion::ReinsertionOptimizer};
use obvhs::ploc::{PlocBuilder, PlocSearchDistance, SortPrecision};
use std::ops::Range;

/// What hangs below an inner node of the binary tree: another one, or a box. The highest bit says which.
#[derive(Clone, Copy)]
pub struct Twig(u32);

impl Twig {
    const IS_BOX: u32 = 1 << 31;

    pub fn inner(index: usize) -> Self {
        Self(index as u32)
    }

    fn leaf(index: u32) -> Self {
        Self(index | Self::IS_BOX)
    }

    /// The same, where so many inner nodes come before.
    pub fn after(self, inner: usize) -> Self {
        self.index().map_or_else(|own| Self::inner(own + inner), |_| self)
    }

    /// The index of the box or, failing that, of the inner node.
    pub fn index(self) -> Result<u32, usize> {
        if self.0 & Self::IS_BOX == 0 { Err(self.0 as usize) } else { Ok(self.0 & !Self::IS_BOX) }
    }
}

/// An inner node.
pub struct Inner {
    pub bounds: Aabb,
    pub below: [Twig; 2],
    /// How many boxes are below.
    pub count: u32,
}

/// A binary tree over boxes, one a leaf. Leaves are no nodes: they are the boxes that are there anyway.
pub struct BinaryTree<'a> {
    pub boxes: &'a [Aabb],
    /// Parents before children.
    pub inner: Vec<Inner>,
    pub root: Twig,
    /// Where in `inner` parts begin: nodes that hang from a part's nodes are the part's own. Those before the first part join the parts.
    pub starts: Vec<usize>,
}

impl<'a> BinaryTree<'a> {
    /// A tree that hangs from nothing yet, with room for its nodes.
    pub fn over(boxes: &'a [Aabb], nodes: usize) -> Self {
        Self { boxes, inner: Vec::with_capacity(nodes), root: Twig::inner(0), starts: Vec::new() }
    }

    /// The same tree, of which the boxes are those of these indices among others.
    pub fn among<'b>(mut self, boxes: &'b [Aabb], indices: &[u32]) -> BinaryTree<'b> {
        let renamed = |twig: Twig| twig.index().map_or(twig, |leaf| Twig::leaf(indices[leaf as usize]));
        self.inner.iter_mut().for_each(|node| node.below = node.below.map(renamed));
        BinaryTree { boxes, inner: self.inner, root: renamed(self.root), starts: self.starts }
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

    /// Counts what is below, when all is hung; in parts that is done already.
    pub fn counted(mut self) -> Self {
        for index in (0..self.top_nodes()).rev() {
            self.inner[index].count = self.inner[index].below.map(|twig| self.count(twig)).iter().sum();
        }
        self
    }

    /// How many nodes join the parts.
    pub fn top_nodes(&self) -> usize {
        self.starts.first().copied().unwrap_or(self.inner.len())
    }

    /// The nodes of each part.
    pub fn parts(&self) -> impl Iterator<Item = Range<usize>> + '_ {
        let ends = self.starts.iter().skip(1).copied().chain([self.inner.len()]);
        self.starts.iter().copied().zip(ends).map(|(start, end)| start..end)
    }

    pub fn bounds(&self, twig: Twig) -> Aabb {
        match twig.index() {
            Ok(leaf) => self.boxes[leaf as usize],
            Err(inner) => self.inner[inner].bounds,
        }
    }

    pub fn count(&self, twig: Twig) -> u32 {
        twig.index().map_or_else(|inner| self.inner[inner].count, |_| 1)
    }
}

/// The share of the nodes, from the top, that reinsertion looks at in its first pass, where there are many: twice as many take a fifth
/// longer, and rays need hardly fewer steps.
pub const REINSERTED: f32 = 0.1;

/// A good tree over finite boxes whose areas are finite, too, with this share of its nodes tried elsewhere: the same on any number of threads.
pub fn whole(boxes: &[Aabb], reinserted: f32) -> BinaryTree<'_> {
    let indices = (0..boxes.len() as u32).collect();
    let mut tree = PlocBuilder::new().build(PlocSearchDistance::Medium, boxes, indices, SortPrecision::U64, 1);
    ReinsertionOptimizer::default().run(&mut tree, reinserted, None);
    parents_first(boxes, &tree)
}

impl obvhs::Boundable for Aabb {
    fn aabb(&self) -> obvhs::aabb::Aabb {
        obvhs::aabb::Aabb::new(self.min.into(), self.max.into())
    }
}

fn parents_first<'a>(boxes: &'a [Aabb], from: &Bvh2) -> BinaryTree<'a> {
    let mut tree = BinaryTree::over(boxes, boxes.len() - 1);
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
pub fn balanced_tree(boxes: &[Aabb]) -> BinaryTree<'_> {
    let mut order: Vec<u32> = (0..boxes.len() as u32).collect();
    let mut tree = BinaryTree::over(boxes, boxes.len() - 1);
    let mut open = vec![(0, boxes.len(), None)];
    while let Some((start, end, parent)) = open.pop() {
        let run = &mut order[start..end];
        if let [leaf] = run {
            tree.hang(Twig::leaf(*leaf), parent);
            continue;
        }
        let bounds = run.iter().fold(Aabb::EMPTY, |all, &i| all.union(boxes[i as usize]));
        let middle = halve(boxes, run, (bounds.max - bounds.min).max_position());
        let inner = tree.grow(bounds, parent);
        open.extend([(start + middle, end, Some((inner, 1))), (start, start + middle, Some((inner, 0)))]);
    }
    tree.counted()
}
