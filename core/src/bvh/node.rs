//! The hierarchy: nodes of eight children, whatever their leaves hold.

use super::Aabb;

/// The children of a node.
pub const WIDTH: usize = 8;

/// A run of at most [`Leaf::MAX_COUNT`] items: of primitives in [`super::build::Built::order`], or of whatever the owner
/// of the hierarchy has put in their place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Leaf {
    /// The first item.
    pub first: u32,
    /// How many there are, at least one.
    pub count: u32,
}

impl Leaf {
    /// What the three bits of [`Child`] can count.
    pub const MAX_COUNT: u32 = 8;
    /// What the 28 bits of [`Child`] can index.
    pub const MAX_FIRST: u32 = (1 << 28) - 1;
}

/// What hangs below a slot of a node: a node (the top bit clear, its index), or a leaf (the top bit set, then three bits
/// of count less one, then 28 bits of first item).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(transparent)]
pub struct Child(pub(super) u32);

impl Child {
    const LEAF: u32 = 1 << 31;
    /// The root, which is always a node.
    pub(super) const ROOT: Child = Child(0);

    pub(super) fn node(index: u32) -> Self {
        assert!(index < Self::LEAF, "a hierarchy has fewer than 2^31 nodes");
        Child(index)
    }

    pub(super) fn leaf(leaf: Leaf) -> Self {
        assert!(leaf.first <= Leaf::MAX_FIRST && (1..=Leaf::MAX_COUNT).contains(&leaf.count));
        Child(Self::LEAF | (leaf.count - 1) << 28 | leaf.first)
    }

    /// The leaf, or none where it is a node.
    #[inline(always)]
    pub fn as_leaf(self) -> Option<Leaf> {
        (self.0 & Self::LEAF != 0).then_some(Leaf { first: self.0 & Leaf::MAX_FIRST, count: (self.0 >> 28 & 7) + 1 })
    }
}

/// Eight boxes and what is in them: four cache lines. The slots are in the order in which an any-hit traversal should
/// try them.
#[derive(Clone, Debug, PartialEq)]
#[repr(C, align(64))]
pub struct Node {
    /// `bounds[axis][0]` are the lower sides, `bounds[axis][1]` the upper ones. An empty slot's box is inside out, from +inf to
    /// -inf, which no ray hits.
    pub(super) bounds: [[[f32; WIDTH]; 2]; 3],
    /// What [`Child`] says; meaningless in empty slots.
    pub(super) children: [u32; WIDTH],
}

impl Node {
    pub(super) const EMPTY: Node =
        Node { bounds: [[[f32::INFINITY; WIDTH], [f32::NEG_INFINITY; WIDTH]]; 3], children: [0; WIDTH] };

    pub(super) fn set(&mut self, slot: usize, bounds: Aabb, child: Child) {
        for axis in 0..3 {
            self.bounds[axis][0][slot] = bounds.min[axis];
            self.bounds[axis][1][slot] = bounds.max[axis];
        }
        self.children[slot] = child.0;
    }

    /// The same boxes, and other children in the place of those.
    pub(super) fn moved(&self, other: impl Fn(Child) -> Child) -> Node {
        let mut node = self.clone();
        for slot in self.occupied() {
            node.children[slot] = other(self.child(slot)).0;
        }
        node
    }

    /// The slots that are not empty.
    pub(super) fn occupied(&self) -> impl Iterator<Item = usize> + '_ {
        (0..WIDTH).filter(|&slot| self.bounds[0][0][slot] <= self.bounds[0][1][slot])
    }

    #[inline(always)]
    pub(super) fn child(&self, slot: usize) -> Child {
        Child(self.children[slot & (WIDTH - 1)])
    }

    pub(super) fn slot_bounds(&self, slot: usize) -> Aabb {
        let side = |side: usize| glam::Vec3::from_array([0, 1, 2].map(|axis| self.bounds[axis][side][slot]));
        Aabb { min: side(0), max: side(1) }
    }
}

/// A hierarchy over boxes. Node 0 is the root, empty where there are no boxes. A traversal never holds more than
/// [`Bvh8::STACK`] postponed children.
#[derive(Clone, Debug, PartialEq)]
pub struct Bvh8 {
    pub(super) nodes: Vec<Node>,
}

impl Bvh8 {
    /// The stack of a traversal; the builder keeps every tree within it.
    pub(super) const STACK: usize = 192;

    /// Puts other runs of items in the place of the leaves' own, in the order of the nodes.
    pub fn map_leaves(&mut self, mut other: impl FnMut(Leaf) -> Leaf) {
        for node in &mut self.nodes {
            for slot in 0..WIDTH {
                if let Some(leaf) = node.child(slot).as_leaf() {
                    node.children[slot] = Child::leaf(other(leaf)).0;
                }
            }
        }
    }

    /// How many nodes there are, and how many bytes they take.
    pub fn size(&self) -> (usize, usize) {
        (self.nodes.len(), size_of_val(self.nodes.as_slice()))
    }

    /// The box of everything; empty where there is nothing.
    pub(super) fn bounds(&self) -> Aabb {
        self.nodes.first().map_or(Aabb::EMPTY, |root| {
            root.occupied().fold(Aabb::EMPTY, |all, slot| all.union(root.slot_bounds(slot)))
        })
    }

    /// What an average ray that hits the root's box costs by the surface area heuristic: the sum of area ratio times
    /// `node_cost` over nodes, and of area ratio times `leaf_cost` over leaves. 0 for an empty hierarchy.
    pub fn sah_cost(&self, node_cost: f32, leaf_cost: impl Fn(Leaf) -> f32) -> f32 {
        let area = self.bounds().half_area();
        if area <= 0.0 {
            return 0.0;
        }
        let below: f32 = self
            .nodes
            .iter()
            .flat_map(|node| node.occupied().map(move |slot| (node, slot)))
            .map(|(node, slot)| {
                let cost = node.child(slot).as_leaf().map_or(node_cost, &leaf_cost);
                node.slot_bounds(slot).half_area() * cost
            })
            .sum();
        node_cost + below / area
    }

    /// The most children that a traversal has to postpone: along the worst way down, all siblings at each level.
    pub(super) fn stack_need(&self) -> usize {
        let mut worst = 0;
        let mut open = vec![(0_usize, 0_usize)];
        while let Some((index, above)) = open.pop() {
            let node = &self.nodes[index];
            let need = above + node.occupied().count().saturating_sub(1);
            worst = worst.max(need + 1);
            open.extend(
                node.occupied()
                    .filter(|&slot| node.child(slot).as_leaf().is_none())
                    .map(|slot| (node.children[slot] as usize, need)),
            );
        }
        worst
    }
}
