//! Triangles in blocks of four, tested at once: watertight after Woop, Benthin & Wald 2013.
//!
//! The ray is sheared onto the axis where it is longest. The sign of an edge function `a*b - c*d` of two rounded
//! products is never wrong, only possibly zero, and zero counts as inside, so no ray passes between triangles that share
//! an edge. A hit counts only where the ray passes the triangle's own box ([`triangle_bounds`]), and is no nearer than the entry
//! into it (of what is cut into pieces, into the piece's); both change nothing but the rounding of triangles seen edge-on, and make the
//! answer independent of the tree.
//!
//! Whether a triangle lies ahead of the ray's origin is decided in f64 where f32 may be wrong: a ray that leaves a thin triangle, or starts
//! just before one, starts nearer to its plane than t is known.

use super::node::Leaf;
use super::pieces::References;
use super::simd::{Floats, Lanes};
use super::traverse::{Leaves, Ray, Slabs};
use super::{Aabb, TriangleHit};
use glam::Vec3;

/// The triangles of a block.
pub const BLOCK: usize = 4;

/// Up to four triangles. The vertices of unused lanes are NaN, which no test passes.
#[derive(Clone, Debug)]
#[repr(C, align(32))]
pub struct Block {
    /// `rows[axis][vertex][lane]`: the ray's choice of axes is a choice of rows.
    rows: [[[f32; BLOCK]; 3]; 3],
    /// What the lanes are of ([`References`]), with [`SLIVER`] set where it is a sliver.
    ids: [u32; BLOCK],
}

/// Two bits that no number has: as a float, an id with them is negative and finite, which an empty lane's is not.
const SLIVER: u32 = 0b11 << 30;

impl Block {
    /// Of at most four triangles or pieces, each its number and the triangle's vertices.
    pub fn new(triangles: impl Iterator<Item = (u32, [Vec3; 3])>) -> Self {
        let mut block = Block { rows: [[[f32::NAN; BLOCK]; 3]; 3], ids: [u32::MAX; BLOCK] };
        for (lane, (id, vertices)) in triangles.take(BLOCK).enumerate() {
            block.ids[lane] = if is_sliver(vertices) { id | SLIVER } else { id };
            for (axis, rows) in block.rows.iter_mut().enumerate() {
                for (row, vertex) in rows.iter_mut().zip(vertices) {
                    row[lane] = vertex[axis];
                }
            }
        }
        block
    }

    /// The vertices of a lane.
    fn triangle(&self, lane: usize) -> [Vec3; 3] {
        [0, 1, 2].map(|vertex| Vec3::from_array([0, 1, 2].map(|axis| self.rows[axis][vertex][lane])))
    }

    /// The number of a lane's triangle or piece.
    #[inline(always)]
    fn id(&self, lane: usize) -> u32 {
        self.ids[lane] & !SLIVER
    }

    /// The lanes of slivers.
    #[inline(always)]
    fn slivers<L: Lanes>(&self, lanes: L) -> u32 {
        L::X4::load(lanes, &self.ids.map(f32::from_bits)).lt(L::X4::splat(lanes, 0.0))
    }

    /// The numbers of the block's triangles; [`u32::MAX`] where there is none.
    #[cfg(test)]
    pub fn ids(&self) -> [u32; BLOCK] {
        self.ids.map(|id| if id == u32::MAX { id } else { id & !SLIVER })
    }
}

/// The shear moves a vertex by up to its distance along the ray times this, relative to the triangle's extent.
const EXTENT_PAD: f32 = 4.0 / (1 << 24) as f32;
/// One step of f32 at the vertex itself.
const VERTEX_PAD: f32 = 2.0 / (1 << 24) as f32;

/// What the numerator of t loses to rounding, relative to the cube of the triangle's size, if the ray starts on it: 6 · 138 units of
/// 2^-24 in the worst case (coordinates up to one size along the ray and two across it, each operation rounded once).
const DOUBT: f32 = 2048.0 / (1 << 24) as f32;
/// A triangle whose height is at most this part of its longest side is a sliver: a t that seems to lie behind the origin may lie ahead.
const THIN: f32 = 1.0 / 32.0;
/// How far off its triangle a ray may start, relative to its coordinates: 35 units of 2^-24 ([`crate::surface::Surface::ray`]).
const START: f32 = 64.0 / (1 << 24) as f32;

/// Whether a triangle is so thin that f32 may not know on which side of it a ray starts.
fn is_sliver([a, b, c]: [Vec3; 3]) -> bool {
    let [a, b, c] = [a, b, c].map(Vec3::as_dvec3);
    let longest2 = (b - a).length_squared().max((c - b).length_squared()).max((a - c).length_squared());
    (b - a).cross(c - a).length() <= f64::from(THIN) * longest2
}

/// The box of a triangle, padded so that a ray which passes the triangle up to rounding passes the box.
pub fn triangle_bounds(vertices: [Vec3; 3]) -> Aabb {
    let tight = Aabb::around(vertices);
    padded(tight, tight.extent())
}

/// A box of something of this extent that the test of triangles moves by rounding.
pub(super) fn padded(tight: Aabb, extent: f32) -> Aabb {
    let pad = |side: f32| extent * EXTENT_PAD + side.abs() * VERTEX_PAD;
    Aabb {
        min: Vec3::from_array(tight.min.to_array().map(|side| side - pad(side))),
        max: Vec3::from_array(tight.max.to_array().map(|side| side + pad(side))),
    }
}

/// The nearest hit of one ray so far, its barycentrics not yet divided.
#[derive(Clone, Copy)]
pub struct Nearest {
    t: f32,
    v: f32,
    w: f32,
    det: f32,
    triangle: u32,
}

impl Nearest {
    /// The hit; none where nothing was found.
    #[inline(always)]
    pub fn hit(&self) -> Option<TriangleHit> {
        (self.triangle != u32::MAX).then(|| TriangleHit {
            t: self.t,
            u: self.v / self.det,
            v: self.w / self.det,
            triangle: self.triangle,
        })
    }
}

/// A ray against the blocks of a mesh, of whose triangles some are in `PIECES` or none.
#[derive(Clone, Copy)]
pub struct Blocks<'a, const PIECES: bool> {
    blocks: &'a [Block],
    references: References<'a>,
    /// The axes, the one where the ray is longest last.
    axes: [usize; 3],
    /// The ray's origin along them.
    origin: [f32; 3],
    /// Its direction along x, y and z.
    direction: Vec3,
    /// How far off the surface it may have started.
    start: f32,
    /// What the first two coordinates lose a unit of the third.
    shear: [f32; 2],
    /// From the third coordinate to t.
    scale: f32,
    /// The nearest hit so far.
    pub nearest: Nearest,
}

/// Where a block was hit up to rounding.
struct Inside<V> {
    mask: u32,
    t: V,
    v: V,
    w: V,
    det: V,
}

/// The two axes after each, and it.
const NEXT_AXES: [[usize; 3]; 3] = [[1, 2, 0], [2, 0, 1], [0, 1, 2]];

impl<'a, const PIECES: bool> Blocks<'a, PIECES> {
    #[inline(always)]
    pub fn new(ray: &Ray, blocks: &'a [Block], references: References<'a>) -> Self {
        let (d, o) = (ray.direction.to_array(), ray.origin.to_array());
        let [x, y, z] = [d[0].abs(), d[1].abs(), d[2].abs()];
        // Without a branch: rays go anywhere.
        let longest = if (x > y) & (x > z) { 0 } else { 1 + usize::from(y <= z) };
        let axes = NEXT_AXES[longest];
        let [dx, dy, dz] = [d[axes[0]], d[axes[1]], d[axes[2]]];
        Self {
            blocks,
            references,
            axes,
            origin: [o[axes[0]], o[axes[1]], o[axes[2]]],
            direction: ray.direction,
            start: ray.origin.abs().max_element() * START,
            shear: [dx / dz, dy / dz],
            scale: 1.0 / dz,
            nearest: Nearest { t: ray.t_max, v: 0.0, w: 0.0, det: 1.0, triangle: u32::MAX },
        }
    }

    /// The block's vertices along axis `axes[k]`, relative to the origin.
    #[inline(always)]
    fn relative<L: Lanes>(&self, lanes: L, block: &Block, k: usize) -> [L::X4; 3] {
        let [a, b, c] = &block.rows[self.axes[k].min(2)];
        let o = L::X4::splat(lanes, self.origin[k]);
        [L::X4::load(lanes, a).sub(o), L::X4::load(lanes, b).sub(o), L::X4::load(lanes, c).sub(o)]
    }

    /// Tests a block; None where no lane is inside its edges.
    #[inline(always)]
    fn test<L: Lanes>(&self, lanes: L, slabs: &Slabs, block: &Block, t_max: f32) -> Option<Inside<L::X4>> {
        let [az, bz, cz] = self.relative(lanes, block, 2);
        let shear = |k: usize| {
            let [a, b, c] = self.relative(lanes, block, k);
            let s = L::X4::splat(lanes, self.shear[k]);
            [a.sub(s.mul(az)), b.sub(s.mul(bz)), c.sub(s.mul(cz))]
        };
        let [ax, bx, cx] = shear(0);
        let [ay, by, cy] = shear(1);
        let u = cx.mul(by).sub(cy.mul(bx));
        let v = ax.mul(cy).sub(ay.mul(cx));
        let w = bx.mul(ay).sub(by.mul(ax));
        let zero = L::X4::splat(lanes, 0.0);
        let inside = zero.le(u.min(v).min(w)) | u.max(v).max(w).le(zero);
        if inside == 0 {
            return None;
        }
        let det = u.add(v).add(w);
        let numerator = u.mul(az).add(v.mul(bz)).add(w.mul(cz));
        let t = numerator.div(det).mul(L::X4::splat(lanes, self.scale));
        // A zero `det` makes t NaN or infinite; t_max may be infinite too, so it is named.
        let not_flat = det.lt(zero) | zero.lt(det);
        let behind = inside & not_flat & block.slivers(lanes) & t.le(zero);
        let t = if behind == 0 {
            t
        } else {
            L::X4::load(lanes, &reconsidered(slabs.origin, self.direction, block, behind, t.store()))
        };
        let mask = inside & not_flat & zero.lt(t) & t.le(L::X4::splat(lanes, t_max));
        if mask == 0 {
            return None;
        }
        let InOwnBox { mut mask, t, near, size } = in_own_box(lanes, slabs, block, mask, t, t_max);
        let size = size.add(L::X4::splat(lanes, self.start));
        let bound = size.mul(size).mul(size).mul(L::X4::splat(lanes, DOUBT));
        let mut doubtful = mask & numerator.max(zero.sub(numerator)).le(bound);
        while doubtful != 0 {
            let lane = doubtful.trailing_zeros() as usize & (BLOCK - 1);
            doubtful &= doubtful - 1;
            // What is entered farther off than the ray may have started lies ahead.
            let begins_there = near.store()[lane] * self.direction.abs().max_element() <= self.start;
            if begins_there && ahead(slabs.origin, self.direction, block.triangle(lane)).is_none() {
                mask &= !(1 << lane);
            }
        }
        let t = if PIECES && mask != 0 {
            let entered = in_own_pieces(*slabs, self.references, block, mask, t.store());
            let t = L::X4::load(lanes, &entered);
            // What misses its piece is NaN now.
            mask &= t.le(L::X4::splat(lanes, t_max));
            t
        } else {
            t
        };
        (mask != 0).then_some(Inside { mask, t, v, w, det })
    }
}

/// The t of these lanes, where one is a piece not before the entry into its box; NaN where that is missed. It takes the ray by value, like
/// [`reconsidered`].
#[inline(never)]
fn in_own_pieces(
    slabs: Slabs,
    references: References,
    block: &Block,
    mut lanes: u32,
    mut t: [f32; BLOCK],
) -> [f32; BLOCK] {
    while lanes != 0 {
        let lane = lanes.trailing_zeros() as usize & (BLOCK - 1);
        lanes &= lanes - 1;
        if let Some(piece) = references.piece(block.id(lane)) {
            t[lane] = piece.entry(&slabs).map_or(f32::NAN, |entry| t[lane].max(entry));
        }
    }
    t
}

/// The t of these lanes, which f32 has at or behind the origin, as f64 has it where that is ahead, and no farther than the triangle. It takes
/// what it needs of the ray by value, so that the ray can stay in registers.
#[cold]
#[inline(never)]
fn reconsidered(origin: [f32; 3], direction: Vec3, block: &Block, mut lanes: u32, mut t: [f32; BLOCK]) -> [f32; BLOCK] {
    while lanes != 0 {
        let lane = lanes.trailing_zeros() as usize & (BLOCK - 1);
        lanes &= lanes - 1;
        let corners = block.triangle(lane);
        let farthest = corners.map(|corner| (corner - Vec3::from_array(origin)).abs().max_element());
        let is_near = |t: f32| t * direction.abs().max_element() <= farthest[0].max(farthest[1]).max(farthest[2]);
        if let Some(real) = ahead(origin, direction, corners).filter(|&t| is_near(t)) {
            t[lane] = real;
        }
    }
    t
}

/// The t, above 0, at which the ray meets the triangle's plane if that is ahead of its origin. Differences of f32 and their products are
/// all but exact in f64, so that for slivers of up to 1 : 10^8 this is right wherever the origin is off the plane by more than a
/// position's rounding.
#[cold]
#[inline(never)]
fn ahead(origin: [f32; 3], direction: Vec3, corners: [Vec3; 3]) -> Option<f32> {
    let [a, b, c] = corners.map(Vec3::as_dvec3);
    let normal = (b - a).cross(c - a);
    let (away, towards) = (normal.dot(a - Vec3::from_array(origin).as_dvec3()), normal.dot(direction.as_dvec3()));
    ((away > 0.0 && towards > 0.0) || (away < 0.0 && towards < 0.0))
        .then(|| ((away / towards) as f32).max(f32::MIN_POSITIVE))
}

/// Triangles whose own boxes the ray passes.
struct InOwnBox<V> {
    mask: u32,
    /// Not before the entry.
    t: V,
    /// The entry, at least 0.
    near: V,
    /// The boxes' longest sides.
    size: V,
}

/// Keeps the lanes whose own box the ray passes, and moves t up to the entry into it. This is rare: about once a ray.
#[inline(always)]
fn in_own_box<L: Lanes>(lanes: L, slabs: &Slabs, block: &Block, mask: u32, t: L::X4, t_max: f32) -> InOwnBox<L::X4> {
    let splat = |x: f32| L::X4::splat(lanes, x);
    let tight = |axis: usize| {
        let [a, b, c] = &block.rows[axis];
        let [a, b, c] = [L::X4::load(lanes, a), L::X4::load(lanes, b), L::X4::load(lanes, c)];
        [a.min(b).min(c), a.max(b).max(c)]
    };
    // The same as `triangle_bounds`.
    let sides = [tight(0), tight(1), tight(2)];
    let size = |axis: usize| sides[axis][1].sub(sides[axis][0]);
    let longest = size(0).max(size(1)).max(size(2));
    let extent = longest.mul(splat(EXTENT_PAD));
    let pad = |side: L::X4| extent.add(side.max(splat(0.0).sub(side)).mul(splat(VERTEX_PAD)));
    let apart = |[lower, upper]: [L::X4; 2]| [lower.sub(pad(lower)), upper.add(pad(upper))];
    let padded = [apart(sides[0]), apart(sides[1]), apart(sides[2])];
    let (near, far) = slabs.spans(lanes, |axis, side| padded[axis][side], f32::INFINITY);
    let t = t.max(near);
    InOwnBox { mask: mask & near.le(far) & t.le(splat(t_max)), t, near, size: longest }
}

impl<L: Lanes, const PIECES: bool> Leaves<L> for Blocks<'_, PIECES> {
    #[inline(always)]
    fn address(&self, leaf: Leaf) -> *const u8 {
        self.blocks.as_ptr().wrapping_add(leaf.first as usize).cast()
    }

    #[inline(always)]
    fn nearest(&mut self, lanes: L, slabs: &Slabs, leaf: Leaf, _: f32) -> f32 {
        let first = leaf.first as usize;
        for block in &self.blocks[first..first + leaf.count as usize] {
            let Some(inside) = self.test(lanes, slabs, block, self.nearest.t) else {
                continue;
            };
            let (t, v, w, det) = (inside.t.store(), inside.v.store(), inside.w.store(), inside.det.store());
            let mut mask = inside.mask;
            while mask != 0 {
                let lane = mask.trailing_zeros() as usize & (BLOCK - 1);
                mask &= mask - 1;
                let id = block.id(lane);
                let triangle = if PIECES { self.references.triangle(id) } else { id };
                let best = &mut self.nearest;
                if t[lane] < best.t || (t[lane] == best.t && triangle < best.triangle) {
                    *best = Nearest { t: t[lane], v: v[lane], w: w[lane], det: det[lane], triangle };
                }
            }
        }
        self.nearest.t
    }

    #[inline(always)]
    fn any(&mut self, lanes: L, slabs: &Slabs, leaf: Leaf, t_max: f32) -> bool {
        let first = leaf.first as usize;
        // A loop, since what iterators call is compiled for the oldest processor.
        for block in &self.blocks[first..first + leaf.count as usize] {
            if self.test(lanes, slabs, block, t_max).is_some() {
                return true;
            }
        }
        false
    }
}
