//! Rays through the hierarchy, whatever its leaves hold.
//!
//! A slab's entry and exit are `(side - origin) / direction`, with the reciprocal rounded once; the exit's reciprocal is
//! made larger by [`EXIT_PAD`] (Ize 2013) so that rounding never separates slabs that touch. Every step is monotonic in
//! `side`, so a ray that passes a box passes, and enters no later, every box that holds it. A leaf that reports no hit
//! nearer than its own box's entry, by the same arithmetic, therefore finds the same nearest hit in any order of
//! traversal.

use super::node::{Bvh8, Child, Leaf, Node};
use super::simd::{Floats, Lanes, StackMemory, prefetch, prefetch_lines};
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

/// A ray made ready for boxes.
#[derive(Clone, Copy, Debug)]
pub struct Slabs {
    /// The ray's origin.
    pub origin: [f32; 3],
    /// Reciprocals of the direction for the sides where the ray enters.
    pub entry: [f32; 3],
    /// Reciprocals for the sides where it leaves.
    pub exit: [f32; 3],
    /// 0 where it enters at the lower side, 1 where at the upper.
    pub entry_side: [usize; 3],
}

impl Slabs {
    /// Of a ray whose direction is not zero.
    #[inline(always)]
    pub fn new(ray: &Ray) -> Self {
        let d = ray.direction.to_array();
        let [x, y, z] = [d[0].abs(), d[1].abs(), d[2].abs()];
        let larger = |a: f32, b: f32| if a > b { a } else { b };
        let least = larger(larger(larger(x, y), z) * LEAST_DIRECTION, f32::MIN_POSITIVE);
        // Reciprocals do not wait for what is hardly ever needed.
        let entry = if x >= least && y >= least && z >= least {
            [1.0 / d[0], 1.0 / d[1], 1.0 / d[2]]
        } else {
            bounded_reciprocals(d, least)
        };
        Self {
            origin: ray.origin.to_array(),
            entry,
            exit: [entry[0] * EXIT_PAD, entry[1] * EXIT_PAD, entry[2] * EXIT_PAD],
            entry_side: [usize::from(entry[0] < 0.0), usize::from(entry[1] < 0.0), usize::from(entry[2] < 0.0)],
        }
    }

    /// Where the ray enters `N` boxes, at least +0, and where it leaves them, at most `t_max`; it misses those that it
    /// leaves before it enters. `side` gives the lower (0) or upper (1) sides along an axis.
    #[inline(always)]
    pub fn spans<const N: usize, V: Floats<N>>(
        &self,
        token: V::Token,
        side: impl Fn(usize, usize) -> V,
        t_max: f32,
    ) -> (V, V) {
        let splat = |x: f32| V::splat(token, x);
        let entry = |axis: usize| {
            let side = side(axis, self.entry_side[axis] & 1);
            side.sub(splat(self.origin[axis])).mul(splat(self.entry[axis]))
        };
        let exit = |axis: usize| {
            let side = side(axis, self.entry_side[axis] & 1 ^ 1);
            side.sub(splat(self.origin[axis])).mul(splat(self.exit[axis]))
        };
        let near = entry(0).max(entry(1)).max(entry(2).max(splat(0.0)));
        let far = exit(0).min(exit(1)).min(exit(2).min(splat(t_max)));
        (near, far)
    }

    /// [`Slabs::spans`] of the children of a node.
    #[inline(always)]
    pub(super) fn node<L: Lanes>(&self, lanes: L, node: &Node, t_max: f32) -> (L::X8, L::X8) {
        self.spans(lanes, |axis, side| L::X8::load(lanes, &node.bounds[axis][side]), t_max)
    }
}

/// Reciprocals where components below `least` count as that.
#[cold]
#[inline(never)]
fn bounded_reciprocals(direction: [f32; 3], least: f32) -> [f32; 3] {
    direction.map(|x| 1.0 / if x.abs() < least { least.copysign(x) } else { x })
}

/// What the leaves of a hierarchy hold, met by one ray.
pub trait Leaves<L: Lanes> {
    /// Where the leaf's items begin in memory, to be fetched ahead.
    fn address(&self, leaf: Leaf) -> *const u8;

    /// Looks for a hit up to `t_max` in a leaf, keeps it, and returns the `t` up to which hits still matter. A hit may not
    /// be nearer than the ray's entry into the box that the hierarchy was built from, by [`Slabs::spans`].
    fn nearest(&mut self, lanes: L, slabs: &Slabs, leaf: Leaf, t_max: f32) -> f32;

    /// Whether anything in the leaf is hit up to `t_max`, under the same rule.
    fn any(&mut self, lanes: L, slabs: &Slabs, leaf: Leaf, t_max: f32) -> bool;
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
        let slabs = Slabs::new(ray);
        let mut memory = StackMemory::<Postponed, { Bvh8::STACK }>::new();
        let mut stack = memory.stack();
        let mut t_max = ray.t_max;
        let mut next = Child::ROOT;
        'visit: loop {
            if let Some(leaf) = next.as_leaf() {
                t_max = leaves.nearest(lanes, &slabs, leaf, t_max);
            } else {
                let node = &self.nodes[next.0 as usize];
                let (near, far) = slabs.node(lanes, node, t_max);
                let mut hits = near.le(far);
                if hits.count_ones() == 1 {
                    next = node.child(hits.trailing_zeros() as usize);
                    continue 'visit;
                }
                let entries = near.store();
                let bottom = stack.len();
                while hits != 0 {
                    let slot = hits.trailing_zeros() as usize & 7;
                    hits &= hits - 1;
                    self.prefetch(node.child(slot), leaves);
                    stack.push(Postponed::new(entries[slot], node.child(slot)));
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
        let slabs = Slabs::new(ray);
        // What waits is a node and, in the low byte, which of its slots are still to be tried.
        let mut memory = StackMemory::<u64, { Bvh8::STACK }>::new();
        let mut stack = memory.stack();
        let hits_of = |node: &Node| {
            let (near, far) = slabs.node(lanes, node, ray.t_max);
            near.le(far)
        };
        let mut node = &self.nodes[0];
        let mut index = 0;
        let mut hits = hits_of(node);
        loop {
            if hits == 0 {
                let Some(top) = stack.pop() else { return false };
                index = top >> 8;
                node = &self.nodes[index as usize];
                hits = top as u32 & 0xff;
            }
            let child = node.child(hits.trailing_zeros() as usize);
            hits &= hits - 1;
            if let Some(leaf) = child.as_leaf() {
                if leaves.any(lanes, &slabs, leaf, ray.t_max) {
                    return true;
                }
                continue;
            }
            if hits != 0 {
                self.prefetch(node.child(hits.trailing_zeros() as usize), leaves);
                stack.push(index << 8 | u64::from(hits));
            }
            index = u64::from(child.0);
            node = &self.nodes[child.0 as usize];
            hits = hits_of(node);
        }
    }

    #[inline(always)]
    fn prefetch<L: Lanes>(&self, child: Child, leaves: &impl Leaves<L>) {
        match child.as_leaf() {
            Some(leaf) => prefetch_lines(leaves.address(leaf)),
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
