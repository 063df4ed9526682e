//! Rays through the hierarchy, whatever its leaves hold.
//!
//! A slab's entry and exit are `(side - origin) / direction`, with the reciprocal rounded once; the exit's reciprocal is
//! made larger by [`EXIT_PAD`] (Ize 2013) so that rounding never separates slabs that touch. Every step is monotonic in
//! `side`, so a ray that passes a box passes, and enters no later, every box that holds it. A leaf that reports no hit
//! nearer than its own box's entry, by the same arithmetic, therefore finds the same nearest hit in any order of
//! traversal.

use super::node::{Bvh8, Child, Leaf, Node};
use super::simd::{Floats, Lanes, StackMemory, prefetch};
use glam::Vec3;

/// A half-line, up to `t_max` directions from its origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// Where it starts. Finite.
    pub origin: Vec3,
    /// Where it goes: not zero, not necessarily of length one.
    pub direction: Vec3,
    /// The largest `t` of a hit at `origin + t * direction`; may be infinite.
    pub t_max: f32,
}

/// Bounds the relative rounding error between two slabs: three operations on each side make at most 6 units of 2^-24,
/// and the shear of the triangle test 3 more.
const EXIT_PAD: f32 = 1.0 + 16.0 / (1 << 24) as f32;

/// Direction components below this part of the largest one count as this part, which keeps reciprocals finite: 0 times
/// infinity would be NaN. Over any distance at which f32 still resolves the box, the ray moves by nothing.
const LEAST_DIRECTION: f32 = 1e-24;

/// The reciprocals of a ray's direction.
#[derive(Clone, Copy, Debug)]
pub struct Reciprocals {
    /// For the side where the ray enters a slab.
    pub entry: [f32; 3],
    /// For the side where it leaves.
    pub exit: [f32; 3],
    /// 0 where it enters at the lower side, 1 where at the upper.
    pub entry_side: [usize; 3],
}

impl Reciprocals {
    /// Of a direction that is not zero.
    #[inline(always)]
    pub fn new(direction: Vec3) -> Self {
        let d = direction.to_array();
        let largest = d[0].abs().max(d[1].abs()).max(d[2].abs());
        let least = (largest * LEAST_DIRECTION).max(f32::MIN_POSITIVE);
        let entry = d.map(|x| 1.0 / if x.abs() < least { least.copysign(x) } else { x });
        Self { entry, exit: entry.map(|r| r * EXIT_PAD), entry_side: entry.map(|r| usize::from(r < 0.0)) }
    }
}

/// A ray against eight boxes at once.
struct Slabs<L: Lanes> {
    origin: [L::X8; 3],
    entry: [L::X8; 3],
    exit: [L::X8; 3],
    entry_side: [usize; 3],
    zero: L::X8,
    lanes: L,
}

impl<L: Lanes> Slabs<L> {
    #[inline(always)]
    fn new(lanes: L, ray: &Ray) -> Self {
        let reciprocals = Reciprocals::new(ray.direction);
        let splat = |x: [f32; 3]| [L::X8::splat(lanes, x[0]), L::X8::splat(lanes, x[1]), L::X8::splat(lanes, x[2])];
        Self {
            origin: splat(ray.origin.to_array()),
            entry: splat(reciprocals.entry),
            exit: splat(reciprocals.exit),
            entry_side: reciprocals.entry_side,
            zero: L::X8::splat(lanes, 0.0),
            lanes,
        }
    }

    /// The slots whose boxes the ray passes between 0 and `t_max`, and where it enters each, at least +0.
    #[inline(always)]
    fn test(&self, node: &Node, t_max: L::X8) -> (u32, L::X8) {
        let side =
            |axis: usize, side: usize| L::X8::load(self.lanes, &node.bounds[axis][side & 1]).sub(self.origin[axis]);
        let [sx, sy, sz] = self.entry_side;
        let near_x = side(0, sx).mul(self.entry[0]);
        let near_y = side(1, sy).mul(self.entry[1]);
        let near_z = side(2, sz).mul(self.entry[2]);
        let far_x = side(0, sx ^ 1).mul(self.exit[0]);
        let far_y = side(1, sy ^ 1).mul(self.exit[1]);
        let far_z = side(2, sz ^ 1).mul(self.exit[2]);
        let near = near_x.max(near_y).max(near_z.max(self.zero));
        let far = far_x.min(far_y).min(far_z.min(t_max));
        (near.le(far), near)
    }
}

/// What the leaves of a hierarchy hold, met by one ray.
pub trait Leaves<L: Lanes> {
    /// Asks for the memory of a leaf that is soon looked into.
    fn prefetch(&self, leaf: Leaf);

    /// Looks for a hit up to `t_max` in a leaf, keeps it, and returns the `t` up to which hits still matter. No hit may be
    /// nearer than the entry into its own box.
    fn nearest(&mut self, lanes: L, leaf: Leaf, t_max: f32) -> f32;

    /// Whether anything in the leaf is hit up to the ray's own `t_max`.
    fn any(&mut self, lanes: L, leaf: Leaf) -> bool;
}

/// A postponed child and where the ray enters it: ordered by entry, since entries are not negative.
#[derive(Clone, Copy)]
struct Postponed(u64);

impl Postponed {
    #[inline(always)]
    fn new(entry: f32, child: Child) -> Self {
        Self(u64::from(entry.to_bits()) << 32 | u64::from(child.0))
    }
    #[inline(always)]
    fn entry(self) -> f32 {
        f32::from_bits((self.0 >> 32) as u32)
    }
    #[inline(always)]
    fn child(self) -> Child {
        Child(self.0 as u32)
    }
}

impl Bvh8 {
    /// Shows `leaves` every leaf that the ray may hit, roughly from near to far, up to the `t` they return.
    #[inline(always)]
    pub fn nearest<L: Lanes>(&self, lanes: L, ray: &Ray, leaves: &mut impl Leaves<L>) {
        let slabs = Slabs::new(lanes, ray);
        let mut memory = StackMemory::<Postponed, { Bvh8::STACK }>::new();
        let mut stack = memory.stack();
        let mut t_max = ray.t_max;
        let mut next = Child::ROOT;
        'visit: loop {
            if let Some(leaf) = next.as_leaf() {
                t_max = leaves.nearest(lanes, leaf, t_max);
            } else {
                let node = &self.nodes[next.0 as usize];
                let (mut hits, entry) = slabs.test(node, L::X8::splat(lanes, t_max));
                if hits.count_ones() == 1 {
                    next = node.children[hits.trailing_zeros() as usize & 7];
                    continue 'visit;
                }
                let entry = entry.store();
                let bottom = stack.len();
                while hits != 0 {
                    let slot = hits.trailing_zeros() as usize & 7;
                    hits &= hits - 1;
                    self.prefetch(node.children[slot], leaves);
                    stack.push(Postponed::new(entry[slot], node.children[slot]));
                    sift_down(stack.above(bottom));
                }
            }
            loop {
                let Some(top) = stack.pop() else { return };
                if top.entry() <= t_max {
                    next = top.child();
                    continue 'visit;
                }
            }
        }
    }

    /// Whether `leaves` report a hit anywhere on the ray; the first report ends the search.
    #[inline(always)]
    pub fn any<L: Lanes>(&self, lanes: L, ray: &Ray, leaves: &mut impl Leaves<L>) -> bool {
        let slabs = Slabs::new(lanes, ray);
        // What waits is a node and, in the low byte, which of its slots are still to be tried.
        let mut memory = StackMemory::<u64, { Bvh8::STACK }>::new();
        let mut stack = memory.stack();
        let t_max = L::X8::splat(lanes, ray.t_max);
        let mut node = &self.nodes[0];
        let mut index = 0;
        let mut hits = slabs.test(node, t_max).0;
        loop {
            if hits == 0 {
                let Some(top) = stack.pop() else { return false };
                index = top >> 8;
                node = &self.nodes[index as usize];
                hits = top as u32 & 0xff;
            }
            let child = node.children[hits.trailing_zeros() as usize & 7];
            hits &= hits - 1;
            if let Some(leaf) = child.as_leaf() {
                if leaves.any(lanes, leaf) {
                    return true;
                }
                continue;
            }
            if hits != 0 {
                self.prefetch(node.children[hits.trailing_zeros() as usize & 7], leaves);
                stack.push(index << 8 | u64::from(hits));
            }
            index = u64::from(child.0);
            node = &self.nodes[child.0 as usize];
            hits = slabs.test(node, t_max).0;
        }
    }

    #[inline(always)]
    fn prefetch<L: Lanes>(&self, child: Child, leaves: &impl Leaves<L>) {
        match child.as_leaf() {
            Some(leaf) => leaves.prefetch(leaf),
            None => prefetch(&self.nodes, child.0 as usize),
        }
    }
}

/// Moves the last item down to its place, so that entries fall towards the top of the stack.
#[inline(always)]
fn sift_down(run: &mut [Postponed]) {
    let mut at = run.len() - 1;
    let item = run[at];
    while at > 0 && run[at - 1].0 < item.0 {
        run[at] = run[at - 1];
        at -= 1;
    }
    run[at] = item;
}
