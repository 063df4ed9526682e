//! Many rays through the hierarchy at once, in turns.
//!
//! A single ray waits most of its time: for memory, for the chain from a box test to the next node's address, and for
//! branches that no processor can guess. Here rays take turns of one node or one leaf, all nodes first and then all leaves, so
//! that what comes next is known; a node's eight tests end in a sort without branches; and what a ray needs in its next turn is
//! fetched during the others'. The leaves are shown in another order than to a single ray; the nearest hit is the same.

use super::node::{Bvh8, Child, WIDTH};
use super::simd::{Floats, Lanes, Stack, StackMemory, prefetch_lines};
use super::traverse::{Leaves, Ray, Slabs};

/// Rays under way at a time: enough to hide a miss of the second cache, few enough for their stacks to stay in the first.
const IN_FLIGHT: usize = 16;

/// A node may write eight entries past the top.
const ROOM: usize = Bvh8::STACK + WIDTH;

/// The bits of an entry's t that a path may use otherwise; without them it is a little nearer, which is on the safe side.
const ENTRY_BITS: u32 = !7;

/// A ray under way.
struct Flight<'m, V> {
    index: usize,
    slabs: Slabs,
    t_max: f32,
    /// What to look into in the next turn.
    next: Child,
    /// What [`Lanes::far_to_near`] gives, or for any hit a node and in the low byte the slots of it still to be tried.
    stack: Stack<'m, u64, ROOM>,
    leaves: V,
}

/// Who has a turn: indices of flights.
struct Turns {
    flights: [u8; IN_FLIGHT],
    count: usize,
}

impl Turns {
    const NONE: Turns = Turns { flights: [0; IN_FLIGHT], count: 0 };

    /// Adds a flight, or not, without a branch.
    #[inline(always)]
    fn add(&mut self, flight: u8, really: bool) {
        self.flights[self.count & (IN_FLIGHT - 1)] = flight;
        self.count += usize::from(really);
    }

    #[inline(always)]
    fn all(&self) -> impl Iterator<Item = u8> {
        self.flights[..self.count].iter().copied()
    }
}

/// What a search does with its rays; [`fly`] gives them their turns.
trait Search<L: Lanes> {
    type Leaves: Leaves<L>;

    fn bvh(&self) -> &Bvh8;
    /// A ray's leaves.
    fn start(&self, ray: &Ray) -> Self::Leaves;
    /// Looks into the node `flight.next`.
    fn node(&self, lanes: L, flight: &mut Flight<Self::Leaves>);
    /// Looks into a leaf; whether that ended the search.
    fn leaf(&self, lanes: L, flight: &mut Flight<Self::Leaves>, leaf: super::Leaf) -> bool;
    /// What comes next; none where there is nothing left.
    fn next(&self, flight: &mut Flight<Self::Leaves>) -> Option<Child>;
    /// Takes the result, which was found by a leaf that ended the search or not.
    fn finish(&mut self, flight: &Flight<Self::Leaves>, ended: bool);
}

/// Gives every ray its turns until all have ended.
#[inline(always)]
fn fly<L: Lanes, S: Search<L>>(lanes: L, rays: &[Ray], search: &mut S) {
    let mut memory = [const { StackMemory::new() }; IN_FLIGHT];
    let mut waiting = rays.iter().enumerate();
    let (mut nodes, mut leaves) = (Turns::NONE, Turns::NONE);
    let mut flights = Vec::with_capacity(IN_FLIGHT);
    for (memory, (index, ray)) in memory.iter_mut().zip(&mut waiting) {
        nodes.add(flights.len() as u8, true);
        let (slabs, leaves) = (Slabs::new(ray), search.start(ray));
        flights.push(Flight { index, slabs, t_max: ray.t_max, next: Child::ROOT, stack: memory.stack(), leaves });
    }
    // Lists are read and written in different memory, since a processor waits where wide loads meet narrow stores.
    let mut later = Turns::NONE;
    while nodes.count + leaves.count > 0 {
        for turn in nodes.all() {
            let flight = &mut flights[turn as usize];
            search.node(lanes, flight);
            after(turn, flight, search, &mut waiting, &mut later, &mut leaves, false);
        }
        nodes.count = 0;
        std::mem::swap(&mut nodes, &mut later);
        for turn in leaves.all() {
            let flight = &mut flights[turn as usize];
            let ended = flight.next.as_leaf().is_some_and(|leaf| search.leaf(lanes, flight, leaf));
            after(turn, flight, search, &mut waiting, &mut nodes, &mut later, ended);
        }
        leaves.count = 0;
        std::mem::swap(&mut leaves, &mut later);
    }
}

/// Finds out what a flight does in its next turn; the next waiting ray takes the place of one that has ended.
#[inline(always)]
fn after<'r, L: Lanes, S: Search<L>>(
    turn: u8,
    flight: &mut Flight<S::Leaves>,
    search: &mut S,
    waiting: &mut impl Iterator<Item = (usize, &'r Ray)>,
    nodes: &mut Turns,
    leaves: &mut Turns,
    ended: bool,
) {
    let next = if ended { None } else { search.next(flight) };
    if let Some(next) = next {
        flight.next = next;
        let leaf = next.as_leaf();
        prefetch_lines(match leaf {
            Some(leaf) => flight.leaves.address(leaf),
            None => search.bvh().nodes.as_ptr().wrapping_add(next.0 as usize).cast(),
        });
        nodes.add(turn, leaf.is_none());
        leaves.add(turn, leaf.is_some());
        return;
    }
    search.finish(flight, ended);
    if let Some((index, ray)) = waiting.next() {
        flight.index = index;
        flight.slabs = Slabs::new(ray);
        flight.t_max = ray.t_max;
        flight.next = Child::ROOT;
        flight.stack.clear();
        flight.leaves = search.start(ray);
        nodes.add(turn, true);
    }
}

struct Nearest<'a, F, G> {
    bvh: &'a Bvh8,
    start: F,
    finish: G,
}

impl<L: Lanes, V: Leaves<L>, F: Fn(&Ray) -> V, G: FnMut(usize, &V)> Search<L> for Nearest<'_, F, G> {
    type Leaves = V;

    #[inline(always)]
    fn bvh(&self) -> &Bvh8 {
        self.bvh
    }
    #[inline(always)]
    fn start(&self, ray: &Ray) -> V {
        (self.start)(ray)
    }
    #[inline(always)]
    fn node(&self, lanes: L, flight: &mut Flight<V>) {
        let node = &self.bvh.nodes[flight.next.0 as usize];
        let (near, far) = flight.slabs.node(lanes, node, flight.t_max);
        let (entries, count) = lanes.far_to_near(near, far, &node.children);
        flight.stack.push_first(entries, count);
    }
    #[inline(always)]
    fn leaf(&self, lanes: L, flight: &mut Flight<V>, leaf: super::Leaf) -> bool {
        let t_max = flight.leaves.nearest(lanes, &flight.slabs, leaf, flight.t_max);
        if t_max < flight.t_max {
            flight.t_max = t_max;
            // What lies behind the hit is dropped here, once, rather than found out with every turn.
            flight.stack.retain(|entry| f32::from_bits((entry >> 32) as u32 & ENTRY_BITS) <= t_max);
        }
        false
    }
    #[inline(always)]
    fn next(&self, flight: &mut Flight<V>) -> Option<Child> {
        flight.stack.pop().map(|entry| Child(entry as u32))
    }
    #[inline(always)]
    fn finish(&mut self, flight: &Flight<V>, _: bool) {
        (self.finish)(flight.index, &flight.leaves);
    }
}

struct Any<'a, F, G> {
    bvh: &'a Bvh8,
    start: F,
    finish: G,
}

impl<L: Lanes, V: Leaves<L>, F: Fn(&Ray) -> V, G: FnMut(usize, bool)> Search<L> for Any<'_, F, G> {
    type Leaves = V;

    #[inline(always)]
    fn bvh(&self) -> &Bvh8 {
        self.bvh
    }
    #[inline(always)]
    fn start(&self, ray: &Ray) -> V {
        (self.start)(ray)
    }
    #[inline(always)]
    fn node(&self, lanes: L, flight: &mut Flight<V>) {
        let node = &self.bvh.nodes[flight.next.0 as usize];
        let (near, far) = flight.slabs.node(lanes, node, flight.t_max);
        let hits = u64::from(near.le(far));
        flight.stack.push_if(u64::from(flight.next.0) << 8 | hits, hits != 0);
    }
    #[inline(always)]
    fn leaf(&self, lanes: L, flight: &mut Flight<V>, leaf: super::Leaf) -> bool {
        flight.leaves.any(lanes, &flight.slabs, leaf, flight.t_max)
    }
    #[inline(always)]
    fn next(&self, flight: &mut Flight<V>) -> Option<Child> {
        let top = flight.stack.pop()?;
        let slot = top.trailing_zeros() as usize;
        let rest = top & (top - 1);
        flight.stack.push_if(rest, rest & 0xff != 0);
        Some(self.bvh.nodes[(top >> 8) as usize].child(slot))
    }
    #[inline(always)]
    fn finish(&mut self, flight: &Flight<V>, ended: bool) {
        (self.finish)(flight.index, ended);
    }
}

impl Bvh8 {
    /// [`Bvh8::nearest`] of each ray with what `start` gives for it, which `finish` gets at the end with the ray's index.
    #[inline(always)]
    pub fn nearest_many<L: Lanes, V: Leaves<L>>(
        &self,
        lanes: L,
        rays: &[Ray],
        start: impl Fn(&Ray) -> V,
        finish: impl FnMut(usize, &V),
    ) {
        fly(lanes, rays, &mut Nearest { bvh: self, start, finish });
    }

    /// [`Bvh8::any`] of each ray with what `start` gives for it; `finish` gets the ray's index and answer.
    #[inline(always)]
    pub fn any_many<L: Lanes, V: Leaves<L>>(
        &self,
        lanes: L,
        rays: &[Ray],
        start: impl Fn(&Ray) -> V,
        finish: impl FnMut(usize, bool),
    ) {
        fly(lanes, rays, &mut Any { bvh: self, start, finish });
    }
}
