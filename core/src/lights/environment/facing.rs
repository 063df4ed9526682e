//! Which way surfaces look, and what of the image is in front of them.
//!
//! Normals go in groups by where they lie on the unfolded octahedron (Meyer et al. 2010, "On Floating-Point Normal Vectors"). For each
//! group the image is weighed by the cosine that its normals have there, and where it lies behind all of them its weight is
//! zero: product sampling (Clarberg & Akenine-Möller 2008, "Practical Product Importance Sampling for Direct
//! Illumination"), by sectors in place of wavelets.

use super::tables::{Division, SECTORS};
use glam::Vec3;
use rayon::prelude::*;
use std::f32::consts::{FRAC_PI_2, PI, TAU};

/// Groups of normals along each side of the unfolded octahedron.
const SIDE: usize = 8;

/// Blocks of the image along each side of a sector: what is behind a surface and what is not is told apart by blocks.
const FINE: usize = 4;

/// Blocks of the image along each side of it.
pub(super) const BLOCKS: usize = SECTORS * FINE;

/// No normal is farther from the nearest of the nine that stand for its group. (Half of half a group's side is 1/16 along either axis of the
/// plane, which on the octahedron's surface is at most 0.154, seen from a distance of at least 1/√3.)
const SPREAD: f32 = 0.27;

/// The least cosine that counts where there may be any: what some normals of a group see so low is not left to chance.
const COSINE_MIN: f32 = 0.02;

/// A group of normals, or any direction at all.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Facing(u16);

impl Facing {
    /// Light matters wherever it comes from.
    pub const ANY: Facing = Facing((SIDE * SIDE) as u16);

    /// The group of a unit normal in the image's space.
    #[inline(always)]
    pub(super) fn of(n: Vec3) -> Self {
        let sum = n.x.abs() + n.y.abs() + n.z.abs();
        let (x, y) = (n.x / sum, n.y / sum);
        let (x, y) = if n.z < 0.0 { folded(x, y) } else { (x, y) };
        let part = |x: f32| ((0.5 * x + 0.5) * SIDE as f32) as u16;
        Facing(part(y).min(SIDE as u16 - 1) * SIDE as u16 + part(x).min(SIDE as u16 - 1))
    }

    #[inline(always)]
    pub(super) fn index(self) -> usize {
        self.0 as usize
    }

    /// Normals that stand for the group.
    fn normals(self) -> [Vec3; 9] {
        let (column, row) = (usize::from(self.0) % SIDE, usize::from(self.0) / SIDE);
        std::array::from_fn(|k| {
            let at = |cell: usize, half: usize| (2 * cell + half) as f32 / SIDE as f32 - 1.0;
            let (x, y) = (at(column, k % 3), at(row, k / 3));
            let z = 1.0 - x.abs() - y.abs();
            let (x, y) = if z < 0.0 { folded(x, y) } else { (x, y) };
            Vec3::new(x, y, z).normalize()
        })
    }
}

/// The lower half of the octahedron to the corners of the square, or back.
#[inline(always)]
fn folded(x: f32, y: f32) -> (f32, f32) {
    ((1.0 - y.abs()).copysign(x), (1.0 - x.abs()).copysign(y))
}

/// Blocks of an image, as surfaces see them.
pub(super) struct Blocks {
    /// The cosine that counts at each block, row by row, for each [`Facing`].
    pub cosines: Vec<Vec<f32>>,
}

/// A block of an image.
struct Block {
    middle: Vec3,
    /// The sine of the angle from the middle to the farthest normals, behind it, for which something of the block is in front, a group's
    /// spread included; 1 where that is any.
    reach: f32,
}

impl Blocks {
    /// Those of an image with so many cells across and down. On the current rayon pool.
    pub fn new(across: usize, down: usize) -> Self {
        let (columns, rows) = (Division::new(across, BLOCKS), Division::new(down, BLOCKS));
        let at = |column: f32, row: f32| {
            let (turn, angle) = ((column + 0.5) / across as f32 * TAU, row / down as f32 * PI);
            let (sin, cos) = (libm::sinf(turn), libm::cosf(turn));
            Vec3::new(libm::sinf(angle) * sin, libm::cosf(angle), -libm::sinf(angle) * cos)
        };
        let block = |i: usize| {
            let (row, column) = (i / BLOCKS, i % BLOCKS);
            let (top, bottom) = (rows.first(row) as f32, rows.first(row + 1) as f32);
            let (left, right) = (columns.first(column) as f32, columns.first(column + 1) as f32);
            let middle = at(0.5 * (left + right), 0.5 * (top + bottom));
            let corners = [at(left, top), at(right, top), at(left, bottom), at(right, bottom)];
            let farthest = corners.map(|corner| middle.angle_between(corner)).into_iter().fold(0.0, f32::max);
            // Corners are farthest in blocks of up to a half turn.
            let is_wide = (right - left) / across as f32 > 0.5;
            let angle = if is_wide { FRAC_PI_2 } else { (farthest + SPREAD).min(FRAC_PI_2) };
            Block { middle, reach: libm::sinf(angle) }
        };
        let blocks: Vec<Block> = (0..BLOCKS * BLOCKS).map(block).collect();
        let cosines = |facing: u16| match Facing(facing) {
            Facing::ANY => vec![1.0; blocks.len()],
            group => {
                let normals = group.normals();
                blocks.iter().map(|block| block.cosine(&normals)).collect()
            }
        };
        Self { cosines: (0..=Facing::ANY.0).into_par_iter().map(cosines).collect() }
    }
}

impl Block {
    /// The cosine that counts for a group of normals.
    fn cosine(&self, normals: &[Vec3]) -> f32 {
        let (mut most, mut sum) = (-1.0_f32, 0.0);
        for normal in normals {
            let cosine = normal.dot(self.middle);
            most = most.max(cosine);
            sum += cosine.max(0.0);
        }
        if most > -self.reach { (sum / normals.len() as f32).max(COSINE_MIN) } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::warp::uniform_sphere;
    use glam::Vec2;

    /// Every normal is near one of those that stand for its group. Fails if lower halves are folded otherwise here than there.
    #[test]
    fn normals_stand_for_their_group() {
        for i in 0..200_000 {
            let u = Vec2::new((i % 401) as f32 / 401.0, (i / 401) as f32 / 499.0);
            let n = uniform_sphere(u);
            let nearest = Facing::of(n).normals().into_iter().map(|normal| normal.angle_between(n)).fold(PI, f32::min);
            assert!(nearest <= SPREAD, "{n} is {nearest} from its group");
        }
    }
}
