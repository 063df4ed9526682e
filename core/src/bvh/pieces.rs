//! Large triangles that lie across the axes, cut into pieces before the tree is built (Ernst & Greiner 2007, Karras & Aila 2013).
//!
//! The box of a wall that stands askew holds half of the room, and every ray in it would test the wall. Cut in halves again and again, the
//! wall is in boxes that lie along it. A piece is a box and a triangle's number; the triangle itself stays whole, so that nothing comes
//! apart. A hit counts only where the ray passes the piece's box, and is no nearer than the entry into it ([`Piece::entry`]): what is found
//! does not depend on the order in which pieces are tried.

use super::simd::{Floats, Lanes, Portable};
use super::triangle::padded;
use super::{Aabb, Slabs};
use glam::{DVec3, Vec3};
use rayon::prelude::*;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Part of a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Piece {
    /// The triangle's number.
    pub triangle: u32,
    /// A box of the part, padded like a triangle's.
    pub bounds: Aabb,
}

impl Piece {
    /// Where the ray enters the piece's box, if it passes it.
    pub fn entry(&self, slabs: &Slabs) -> Option<f32> {
        type Four = <Portable as Lanes>::X4;
        let side = |axis: usize, side: usize| Four::splat(Portable, [self.bounds.min, self.bounds.max][side][axis]);
        let (near, far) = slabs.spans(Portable, side, f32::INFINITY);
        (near.le(far) != 0).then(|| near.store()[0])
    }
}

/// What the numbers in blocks of triangles refer to: triangles or, from their number on, pieces.
#[derive(Clone, Copy, Debug)]
pub struct References<'a> {
    /// How many triangles there are.
    pub triangles: u32,
    pub pieces: &'a [Piece],
}

impl<'a> References<'a> {
    /// The piece; none where a number is a triangle's.
    #[inline(always)]
    pub fn piece(self, reference: u32) -> Option<&'a Piece> {
        reference.checked_sub(self.triangles).map(|i| &self.pieces[i as usize])
    }

    /// The number of the triangle.
    #[inline(always)]
    pub fn triangle(self, reference: u32) -> u32 {
        self.piece(reference).map_or(reference, |piece| piece.triangle)
    }
}

/// All triangles, some of them in pieces.
pub struct Cut {
    /// The boxes of whole triangles and of pieces.
    pub boxes: Vec<Aabb>,
    /// What each box is of: the number of a triangle or, from the number of triangles on, that of a piece and this.
    pub references: Vec<u32>,
    pub pieces: Vec<Piece>,
}

/// So many pieces more than triangles at most: a share of the triangles.
const MORE: f32 = 0.3;
/// What a cut has to save, in parts of half the area of everything ([`fog`]); or one part by the number of triangles, if that is more, so that a
/// surface which is as coarse everywhere is left alone.
const LEAST_SAVED: f64 = 1e-5;

fn volume(bounds: Aabb) -> f64 {
    (bounds.max - bounds.min).as_dvec3().element_product()
}

/// How much else a box may hold besides a flat thing in it: its volume, as an area.
fn fog(bounds: Aabb) -> f64 {
    let side = libm::cbrt(volume(bounds));
    side * side
}

/// A box that may be cut in two.
#[derive(Clone, Copy)]
struct Halves {
    saved: f64,
    halves: [Aabb; 2],
}

/// The best cut through the middle of the box of a triangle's part.
fn halves(triangle: [Vec3; 3], bounds: Aabb) -> Halves {
    let part = Polygon::new(triangle.map(Vec3::as_dvec3)).within(bounds);
    let extent = Aabb::around(triangle).extent();
    let middle = bounds.centre();
    let cut = |axis: usize| {
        let half = |side: f64| {
            let half = padded(part.clipped(axis, f64::from(middle[axis]), side).bounds(), extent);
            Aabb { min: half.min.max(bounds.min), max: half.max.min(bounds.max) }
        };
        let halves = [half(1.0), half(-1.0)];
        let are_there = halves.iter().all(|half| half.min.cmple(half.max).all());
        let saved = if are_there { fog(bounds) - fog(halves[0]) - fog(halves[1]) } else { 0.0 };
        Halves { saved, halves }
    };
    let better = |a: Halves, b: Halves| if b.saved > a.saved { b } else { a };
    better(better(cut(0), cut(1)), cut(2))
}

/// A convex polygon: a triangle, and what planes across the axes leave of it.
struct Polygon {
    corners: [DVec3; Self::MOST],
    count: usize,
}

impl Polygon {
    /// Three, and one more for each plane, six of a box and one through it; and some to spare, should rounding bend an edge.
    const MOST: usize = 16;

    fn new([a, b, c]: [DVec3; 3]) -> Self {
        let mut corners = [DVec3::ZERO; Self::MOST];
        corners[..3].copy_from_slice(&[a, b, c]);
        Self { corners, count: 3 }
    }

    /// What lies within a box.
    fn within(self, bounds: Aabb) -> Self {
        (0..3).fold(self, |part, axis| {
            part.clipped(axis, f64::from(bounds.min[axis]), -1.0).clipped(axis, f64::from(bounds.max[axis]), 1.0)
        })
    }

    /// What lies below a plane across an axis (`side` 1) or above it (-1): Sutherland & Hodgman 1974.
    fn clipped(&self, axis: usize, plane: f64, side: f64) -> Self {
        let mut part = Self { corners: [DVec3::ZERO; Self::MOST], count: 0 };
        let mut add = |corner: DVec3| {
            part.corners[part.count] = corner;
            part.count += 1;
        };
        let outside = |corner: DVec3| (corner[axis] - plane) * side;
        for i in 0..self.count {
            let (p, q) = (self.corners[i], self.corners[(i + 1) % self.count]);
            let (at_p, at_q) = (outside(p), outside(q));
            if at_p <= 0.0 {
                add(p);
            }
            if (at_p < 0.0 && at_q > 0.0) || (at_p > 0.0 && at_q < 0.0) {
                add(p + (q - p) * (at_p / (at_p - at_q)));
            }
        }
        part
    }

    /// Its box, rounded outwards.
    fn bounds(&self) -> Aabb {
        let Aabb { min, max } = Aabb::around(self.corners[..self.count].iter().map(|corner| corner.as_vec3()));
        Aabb {
            min: Vec3::from_array(min.to_array().map(f32::next_down)),
            max: Vec3::from_array(max.to_array().map(f32::next_up)),
        }
    }
}

/// Cuts what is worth it; none where nothing is, or where all cuts save less than `promised`, in parts of half the area of `all`: about what a
/// tree may cost less. `boxes` are those of the triangles, whose vertices `vertices` gives.
pub fn cut(boxes: &[Aabb], all: Aabb, promised: f32, vertices: impl Fn(u32) -> [Vec3; 3] + Sync) -> Option<Cut> {
    let count = boxes.len();
    let area = f64::from(all.half_area());
    let least = area * LEAST_SAVED.max(1.0 / count as f64);
    let is_worth = |halves: &Halves| halves.saved > least;
    // No cut saves more than all.
    let least_volume = least * least.sqrt();
    let first =
        |i: usize| (volume(boxes[i]) > least_volume).then(|| halves(vertices(i as u32), boxes[i])).filter(is_worth);
    let found: Vec<(usize, Halves)> = (0..count).into_par_iter().filter_map(|i| Some((i, first(i)?))).collect();
    if found.is_empty() {
        return None;
    }
    let mut pieces: Vec<Piece> = found.iter().map(|&(i, _)| Piece { triangle: i as u32, bounds: boxes[i] }).collect();
    let mut cuts: Vec<Halves> = found.into_iter().map(|(_, halves)| halves).collect();
    // Bits of positive numbers are in their order. Of cuts that save as much, the first is made first.
    let rank = |piece: usize, halves: &Halves| (halves.saved.to_bits(), Reverse(piece));
    let mut waiting: BinaryHeap<_> = cuts.iter().enumerate().map(|(piece, halves)| rank(piece, halves)).collect();
    let mut saved = 0.0;
    let most = pieces.len() + (count as f32 * MORE) as usize;
    while pieces.len() < most
        && let Some((_, Reverse(piece))) = waiting.pop()
    {
        let Piece { triangle, .. } = pieces[piece];
        let [below, above] = cuts[piece].halves;
        saved += cuts[piece].saved;
        let other = pieces.len();
        pieces[piece].bounds = below;
        pieces.push(Piece { triangle, bounds: above });
        cuts.push(cuts[piece]);
        for piece in [piece, other] {
            cuts[piece] = halves(vertices(triangle), pieces[piece].bounds);
            waiting.extend(is_worth(&cuts[piece]).then(|| rank(piece, &cuts[piece])));
        }
    }
    (saved >= area * f64::from(promised)).then(|| Cut::new(boxes, pieces))
}

impl Cut {
    /// Of the boxes of whole triangles, and of pieces of some of them.
    fn new(boxes: &[Aabb], pieces: Vec<Piece>) -> Self {
        let mut is_whole = vec![true; boxes.len()];
        pieces.iter().for_each(|piece| is_whole[piece.triangle as usize] = false);
        let count = boxes.len() as u32;
        let mut references: Vec<u32> = (0..count).filter(|&i| is_whole[i as usize]).collect();
        references.extend((count..).take(pieces.len()));
        let bounds = |&i: &u32| i.checked_sub(count).map_or_else(|| boxes[i as usize], |i| pieces[i as usize].bounds);
        Self { boxes: references.iter().map(bounds).collect(), references, pieces }
    }
}

#[cfg(test)]
mod tests {
    use super::super::simd::{Isa, Kernel};
    use super::super::tests::noise3;
    use super::super::triangle::{Block, Blocks};
    use super::super::{Leaf, Leaves, Ray, triangle_bounds};
    use super::*;

    const WALLS: u32 = 100;
    const COUNT: u32 = 20_000;

    /// Walls of two triangles each through small triangles everywhere, turned by an angle around y.
    fn room(angle: f32) -> Vec<[Vec3; 3]> {
        let turn = glam::Mat3::from_rotation_y(angle);
        let wall = |i: u32| {
            let corner = |x: f32, y: f32| turn * Vec3::new(x, y, (2 * i) as f32 / WALLS as f32 - 0.5);
            let [a, b, c, d] = [corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)];
            [[a, b, c], [a, c, d]]
        };
        let small = (WALLS..COUNT).map(|i| {
            let [p, q, r] = [1, 2, 3].map(|seed| noise3(seed, i as usize));
            [p, p + q * 0.01, p + r * 0.01]
        });
        (0..WALLS / 2).flat_map(wall).chain(small).collect()
    }

    fn cut_room(room: &[[Vec3; 3]]) -> Option<Cut> {
        let boxes: Vec<Aabb> = room.iter().map(|&triangle| triangle_bounds(triangle)).collect();
        let all = boxes.iter().fold(Aabb::EMPTY, |all, &bounds| all.union(bounds));
        cut(&boxes, all, 0.0, |i| room[i as usize])
    }

    /// A wall along the axes stays whole; one across them is in pieces, which hold every point of it and are not more than may be. All
    /// else stays whole.
    #[test]
    fn walls_across_the_axes_are_cut() {
        assert!(cut_room(&room(0.0)).is_none());
        let room = room(0.6);
        let Cut { boxes, references, pieces } = cut_room(&room).expect("pieces");
        assert!(boxes.len() - room.len() <= room.len() * 3 / 10, "{} pieces", pieces.len());
        assert!(pieces.iter().all(|piece| piece.triangle < WALLS));
        assert!(references.iter().copied().eq(WALLS..COUNT + pieces.len() as u32), "whole ones, then pieces");
        assert!(boxes[(COUNT - WALLS) as usize..].iter().eq(pieces.iter().map(|piece| &piece.bounds)));
        for (wall, &[a, b, c]) in (0..WALLS).zip(&room) {
            for i in 0..100 {
                let weights = noise3(4, i).abs();
                let weights = weights / weights.element_sum();
                let point = a * weights.x + b * weights.y + c * weights.z;
                let holds = |b: Aabb| point.cmpge(b.min).all() && point.cmple(b.max).all();
                let is_held = pieces.iter().any(|piece| piece.triangle == wall && holds(piece.bounds));
                assert!(is_held, "{point} of wall {wall} is in no piece");
            }
        }
    }

    /// The nearest hit of a triangle's piece.
    struct Hit<'a>(&'a Block, References<'a>, Ray);

    impl Kernel for Hit<'_> {
        type Output = Option<f32>;

        #[inline(always)]
        fn run<L: Lanes>(self, lanes: L) -> Option<f32> {
            let mut blocks = Blocks::<true>::new(&self.2, std::slice::from_ref(self.0), self.1);
            blocks.nearest(lanes, &Slabs::new(&self.2), Leaf { first: 0, count: 1 }, f32::INFINITY);
            blocks.nearest.hit().map(|hit| hit.t)
        }
    }

    /// A hit is no nearer than the entry into the piece's box, and is none where the box is missed.
    #[test]
    fn hits_lie_in_the_box_of_a_piece() {
        let triangle = [Vec3::new(-9.0, -9.0, 1.0), Vec3::new(9.0, -9.0, 1.0), Vec3::new(0.0, 9.0, 1.0)];
        let block = Block::new([(1, triangle)].into_iter());
        let piece = |z: f32| Piece {
            triangle: 0,
            bounds: Aabb { min: Vec3::new(-1.0, -1.0, z), max: Vec3::new(1.0, 1.0, z + 1.0) },
        };
        for (x, z, expected) in [(0.0, 0.5, Some(1.0)), (0.0, 2.0, Some(2.0)), (0.0, -2.0, None), (1.5, 0.5, None)] {
            let references = References { triangles: 1, pieces: &[piece(z)] };
            let ray = Ray { origin: Vec3::new(x, 0.0, 0.0), direction: Vec3::Z, t_max: f32::INFINITY };
            for isa in Isa::available() {
                assert_eq!(isa.dispatch(Hit(&block, references, ray)), expected, "x {x}, z {z} on {}", isa.name());
            }
        }
    }

    /// A surface that is as coarse everywhere stays whole, whatever its direction.
    #[test]
    fn even_surfaces_stay_whole() {
        let point = |i: u32, j: u32| {
            let (x, y) = (i as f32 / 40.0, j as f32 / 40.0);
            Vec3::new(x, y + 0.3 * x, 0.5 * libm::sinf(3.0 * x) + y)
        };
        let squares = (0..40).flat_map(|i| (0..40).map(move |j| [point(i, j), point(i + 1, j), point(i, j + 1)]));
        assert!(cut_room(&squares.collect::<Vec<_>>()).is_none());
    }
}
