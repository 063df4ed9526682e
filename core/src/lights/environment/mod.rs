//! Environment maps: an image around the scene, bilinear between texels, sampled in proportion to its luminance and the cosine that a
//! surface will see it under.
//!
//! Columns run around y; a column's centre is at (i + ½)/width of the turn. Rows run from +y to −y; the first and the last lie
//! *on* the poles, as Mitsuba's `envmap` has them. Four neighbouring texels span a *cell*: width · (height − 1) of them.
//!
//! Directions are found by choosing a cell ([`tables`]), the cosine taken into account by [`facing`], then bilinearly within the cell, over the
//! angle around and the height along y, so that the density in solid angle follows the interpolated luminance itself up to
//! the curvature of a cell's rows. Inverted cumulative sums keep neighbouring random numbers neighbours, which an alias table
//! would not, and whose stratification is worth more than its speed.

mod facing;
mod tables;

use super::luminance;
use crate::scene::Image;
use crate::texture::Textures;
use crate::trig::{atan2, sin_cos_turn};
use crate::warp::inverse_linear;
use facing::Blocks;
use glam::{Mat3, Vec2, Vec3};
use std::f32::consts::{PI, TAU};
use std::sync::Arc;
use tables::{Tables, weight};

pub use facing::Facing;
pub use tables::Row;

/// An environment map, ready for look-up and sampling.
pub struct Environment {
    image: Arc<Image>,
    scale: f32,
    /// The image's space to the scene's; orthogonal.
    to_world: Mat3,
    /// 1 − cos θ of each row of texels.
    heights: Vec<f32>,
    mean_luminance: f32,
    /// For light sampling alone: in proportion to luminance.
    alone: Tables,
    /// For light sampling joined with BSDF sampling: in proportion to what of the luminance exceeds its mean (Karlík et al.
    /// 2019, "MIS Compensation"). None if nothing does.
    compensated: Option<Tables>,
}

/// A cell, and a position in it.
#[derive(Clone, Copy, Debug)]
pub struct Cell {
    /// Column of its left texels.
    pub column: i32,
    /// Row of its upper texels.
    pub row: i32,
    /// Fractions of the cell, across and down, that linear in θ; for a cell that was chosen the numbers that are left.
    pub at: Vec2,
    /// 1 − cos θ; meaningless for a cell that was chosen.
    pub height: f32,
}

/// All that is read from memory about a cell.
#[derive(Clone, Copy, Debug)]
pub struct Patch {
    /// Radiance of its texels, unscaled: upper left and right, lower left and right.
    pub corners: [Vec3; 4],
    /// 1 − cos θ of the upper texels and of the lower ones.
    pub heights: Vec2,
    /// Probability to choose it.
    pub probability: f32,
}

/// An environment without its tables: without branches, for loops over many directions.
#[derive(Clone, Copy, Debug)]
pub struct Globe {
    to_world: Mat3,
    width: i32,
    /// Rows of texels, one more than of cells.
    rows: i32,
    scale: f32,
    /// What is taken from the luminance of every texel.
    floor: f32,
}

impl Environment {
    /// Prepares an image of at least 2×3 pixels.
    pub fn new(textures: &Textures, image: Arc<Image>, scale: f32, to_world: Mat3) -> Self {
        let rows = image.height as usize;
        let heights = (0..rows).map(|j| {
            let half_sine = libm::sin(0.5 * std::f64::consts::PI * j as f64 / (rows - 1) as f64);
            (2.0 * half_sine * half_sine) as f32
        });
        let heights: Vec<f32> = heights.collect();
        let texels = (0..rows * image.width as usize).map(|i| luminance(textures.texel(&image, i)).max(0.0));
        let texels: Vec<f32> = texels.collect();
        let blocks = Blocks::new(image.width as usize, rows - 1);
        let (alone, mean) = Tables::new(&texels, &heights, 0.0, &blocks);
        let (compensated, rest) = Tables::new(&texels, &heights, mean, &blocks);
        // What rounding leaves of an even image is no peak.
        let compensated = (rest > 1e-5 * mean).then_some(compensated);
        Self { image, scale, to_world, heights, mean_luminance: mean * scale, alone, compensated }
    }

    /// Luminance of the radiance, its mean over all directions.
    pub fn mean_luminance(&self) -> f32 {
        self.mean_luminance
    }

    #[inline(always)]
    fn tables(&self, mis: bool) -> &Tables {
        self.compensated.as_ref().filter(|_| mis).unwrap_or(&self.alone)
    }

    /// What it is but for its tables; `mis` chooses among those.
    #[inline(always)]
    pub fn globe(&self, mis: bool) -> Globe {
        let (width, rows) = (self.image.width as i32, self.image.height as i32);
        Globe { to_world: self.to_world, width, rows, scale: self.scale, floor: self.tables(mis).floor }
    }

    /// Which way a surface of this unit normal looks.
    #[inline(always)]
    pub fn facing(&self, n: Vec3) -> Facing {
        Facing::of(self.to_world.transpose() * n)
    }

    /// Radiance from `wi` and the density of [`Environment::sample`] there.
    #[inline(always)]
    pub fn at(&self, textures: &Textures, wi: Vec3, facing: Facing, mis: bool) -> (Vec3, f32) {
        let globe = self.globe(mis);
        let cell = globe.cell(wi);
        globe.radiance(&cell, &self.patch(textures, &cell, facing, mis))
    }

    /// A unit direction for two random numbers, fractions of 2^32, and what [`Environment::at`] has there; none where nothing shines.
    #[inline(always)]
    pub fn sample(
        &self,
        textures: &Textures,
        numbers: [u32; 2],
        facing: Facing,
        mis: bool,
    ) -> Option<(Vec3, Vec3, f32)> {
        let cell = self.choose_column(self.choose_row(numbers, facing, mis)?, mis);
        Some(self.globe(mis).direction(&cell, &self.patch(textures, &cell, facing, mis)))
    }

    /// The row of cells that two random numbers choose, fractions of 2^32; none where nothing shines on such a surface. Asks for what
    /// [`Environment::choose_column`] will read, ahead of time.
    #[inline(always)]
    pub fn choose_row(&self, numbers: [u32; 2], facing: Facing, mis: bool) -> Option<Row> {
        self.tables(mis).choose_row(facing, numbers)
    }

    /// The cell of that row.
    #[inline(always)]
    pub fn choose_column(&self, row: Row, mis: bool) -> Cell {
        let (column, x) = self.tables(mis).choose_column(row);
        Cell { column, row: row.row, at: Vec2::new(x, row.at), height: 0.0 }
    }

    /// Asks for what [`Environment::patch`] will read, ahead of time.
    #[inline(always)]
    pub fn prefetch(&self, textures: &Textures, cell: &Cell, mis: bool) {
        let (column, row, width) = (cell.column as usize, cell.row as usize, self.image.width as usize);
        for row in [row, row + 1] {
            textures.prefetch_texel(&self.image, row * width + column);
        }
        self.tables(mis).prefetch(column, row);
    }

    /// What the tables have about a cell.
    #[inline(always)]
    pub fn patch(&self, textures: &Textures, cell: &Cell, facing: Facing, mis: bool) -> Patch {
        let (column, row, width) = (cell.column as usize, cell.row as usize, self.image.width as usize);
        let next = if column + 1 == width { 0 } else { column + 1 };
        let texel = |x: usize, y: usize| textures.texel(&self.image, y * width + x);
        Patch {
            corners: [texel(column, row), texel(next, row), texel(column, row + 1), texel(next, row + 1)],
            heights: Vec2::new(self.heights[row], self.heights[row + 1]),
            probability: self.tables(mis).probability(facing, column, row),
        }
    }
}

impl Globe {
    /// Where a unit direction meets the image.
    #[inline(always)]
    pub fn cell(&self, wi: Vec3) -> Cell {
        let d = self.to_world.transpose() * wi;
        let width = self.width as f32;
        let around = atan2(d.x, -d.z) / TAU * width - 0.5;
        let around = if around < 0.0 { around + width } else { around };
        let column = (around as i32).min(self.width - 1);
        let sin2 = d.x * d.x + d.z * d.z;
        let down = atan2(sin2.sqrt(), d.y) / PI * (self.rows - 1) as f32;
        let row = (down as i32).min(self.rows - 2);
        // 1 − cos θ without cancellation.
        let from_pole = sin2 / (1.0 + d.y.abs());
        let height = if d.y > 0.0 { from_pole } else { 2.0 - from_pole };
        Cell { column, row, at: Vec2::new(around - column as f32, down - row as f32), height }
    }

    /// Radiance at a position in a cell, and the density of [`Globe::direction`] there.
    #[inline(always)]
    pub fn radiance(&self, cell: &Cell, patch: &Patch) -> (Vec3, f32) {
        let [top, bottom] = patch.heights.to_array();
        self.within(cell.at, ((cell.height - top) / (bottom - top)).clamp(0.0, 1.0), patch)
    }

    /// A unit direction within a cell that was chosen, and what [`Globe::radiance`] has there.
    #[inline(always)]
    pub fn direction(&self, cell: &Cell, patch: &Patch) -> (Vec3, Vec3, f32) {
        let [top, bottom] = patch.heights.to_array();
        let weight = |texel: Vec3| self.weight(texel).max(f32::MIN_POSITIVE);
        let [a, b, c, d] = patch.corners;
        let (a, b, c, d) = (weight(a), weight(b), weight(c), weight(d));
        let down = inverse_linear(cell.at.y, a + b, c + d);
        let across = inverse_linear(cell.at.x, a + (c - a) * down, b + (d - b) * down);
        let height = top + (bottom - top) * down;
        let (sin_phi, cos_phi) = sin_cos_turn((cell.column as f32 + 0.5 + across) / self.width as f32);
        let sin_theta = (height * (2.0 - height)).max(0.0).sqrt();
        let theta = atan2(sin_theta, 1.0 - height);
        let y = (theta / PI * (self.rows - 1) as f32 - cell.row as f32).clamp(0.0, 1.0);
        let (radiance, pdf) = self.within(Vec2::new(across, y), down, patch);
        let wi = self.to_world * Vec3::new(sin_theta * sin_phi, 1.0 - height, -sin_theta * cos_phi);
        (wi, radiance, pdf)
    }

    /// Radiance and density between four texels; `down` is linear in cos θ.
    #[inline(always)]
    fn within(&self, at: Vec2, down: f32, patch: &Patch) -> (Vec3, f32) {
        let [a, b, c, d] = patch.corners;
        let upper = a * (1.0 - at.x) + b * at.x;
        let lower = c * (1.0 - at.x) + d * at.x;
        let radiance = (upper * (1.0 - at.y) + lower * at.y) * self.scale;

        let (a, b, c, d) = (self.weight(a), self.weight(b), self.weight(c), self.weight(d));
        let mean = 0.25 * (a + b + c + d);
        let upper = a * (1.0 - at.x) + b * at.x;
        let lower = c * (1.0 - at.x) + d * at.x;
        let weight = upper * (1.0 - down) + lower * down;
        let solid_angle = TAU / self.width as f32 * (patch.heights.y - patch.heights.x);
        let pdf = patch.probability / solid_angle * (weight / mean);
        (radiance, if mean > 0.0 { pdf } else { 0.0 })
    }

    #[inline(always)]
    fn weight(&self, texel: Vec3) -> f32 {
        weight(luminance(texel), self.floor)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampler::{fraction, units};
    use crate::scene::{Scene, Texels};
    use crate::warp::uniform_sphere;
    use glam::Quat;

    fn environment(width: u32, height: u32, value: impl Fn(u32, u32) -> f32) -> (Environment, Textures) {
        let data = (0..width * height).flat_map(|i| [value(i % width, i / width); 3]).collect();
        let image = Arc::new(Image { width, height, texels: Texels::Rgb32(data) });
        let textures = Textures::new(&Scene::empty());
        let to_world = Mat3::from_quat(Quat::from_xyzw(0.1, 0.3, -0.2, 0.9).normalize());
        (Environment::new(&textures, image, 2.0, to_world), textures)
    }

    /// Some texels black, one very bright.
    fn uneven(x: u32, y: u32) -> f32 {
        match (x * 7 + y * 3) % 11 {
            0..=3 => 0.0,
            4 => 60.0,
            k => k as f32 * 0.1,
        }
    }

    fn grid(n: u32) -> impl Iterator<Item = Vec2> {
        (0..n * n).map(move |i| Vec2::new((i / n) as f32 + 0.5, (i % n) as f32 + 0.5) / n as f32)
    }

    /// The texel at a texel's own centre, with Mitsuba's orientation: u = 0 looks along −z, a quarter turn further along +x;
    /// the first row is +y. (3.9.1 gives these values.)
    #[test]
    fn texels_lie_where_mitsuba_has_them() {
        let (mut map, textures) = environment(4, 3, |x, y| (10 * y + x) as f32);
        map.to_world = Mat3::IDENTITY;
        let at = |d: Vec3| map.at(&textures, d.normalize(), Facing::ANY, false).0.x / 2.0;
        assert!((at(Vec3::new(1.0, 0.0, -1.0)) - 10.0).abs() < 1e-4);
        assert!((at(Vec3::new(1.0, 0.0, 1.0)) - 11.0).abs() < 1e-4);
        assert!((at(Vec3::new(-1.0, 0.0, -1.0)) - 13.0).abs() < 1e-4);
        assert!((at(Vec3::new(0.0, 0.0, -1.0)) - 11.5).abs() < 1e-4, "between the last column and the first");
        assert!((at(Vec3::new(1e-3, 1e3, -1e-3)) - 0.0).abs() < 1e-4);
        assert!((at(Vec3::new(1.0, 1.0, 1.0)) - (1.0 + 10.0 * 0.608_173_4)).abs() < 1e-3);
    }

    /// Numbers without end.
    fn random() -> impl Iterator<Item = [u32; 2]> {
        std::iter::successors(Some(0u64), |&x| Some(crate::sampler::mix64(x))).map(|x| [x as u32, (x >> 32) as u32])
    }

    /// The density is that of the samples (χ² over boxes of equal solid angle), whichever way a surface looks, and integrates to
    /// one. Fails if the height within a cell is taken for the angle, rows are weighed without their solid angle, or a sector is
    /// chosen by one facing and weighed by another.
    #[test]
    fn densities_are_those_of_the_samples() {
        let (map, textures) = environment(37, 20, uneven);
        let (small, _) = environment(5, 4, uneven);
        let normals = [Vec3::X, Vec3::new(0.3, -0.2, -0.9).normalize(), Vec3::new(-0.5, 0.8, 0.1).normalize()];
        let facings = normals.map(|n| map.facing(n));
        let cases =
            [(&small, Facing::ANY), (&map, Facing::ANY)].into_iter().chain(facings.map(|facing| (&map, facing)));
        for (map, facing, mis) in cases.flat_map(|(map, facing)| [(map, facing, false), (map, facing, true)]) {
            let boxes = 16usize;
            let index = |d: Vec3| {
                let (v, u) = (0.5 * (1.0 - d.z), atan2(d.y, d.x) / TAU + 0.5);
                ((v * boxes as f32) as usize).min(boxes - 1) * boxes + ((u * boxes as f32) as usize).min(boxes - 1)
            };
            let (mut seen, mut expected) = (vec![0.0; boxes * boxes], vec![0.0; boxes * boxes]);
            let (n, fine) = (1024, 2048);
            let mut differing = 0;
            for numbers in random().take(n * n) {
                let (wi, _, pdf) = map.sample(&textures, numbers, facing, mis).unwrap();
                seen[index(wi)] += 1.0;
                differing += usize::from((map.at(&textures, wi, facing, mis).1 - pdf).abs() > 0.01 * pdf);
            }
            // At an edge the neighbouring cell may be meant.
            assert!(differing < 10, "mis {mis}, {facing:?}: {differing} samples where the density is another");
            for u in grid(fine) {
                let d = uniform_sphere(u);
                let density = f64::from(map.at(&textures, d, facing, mis).1);
                expected[index(d)] += density * 4.0 * std::f64::consts::PI * (n * n) as f64 / f64::from(fine * fine);
            }
            let total: f64 = expected.iter().sum::<f64>() / (n * n) as f64;
            assert!((total - 1.0).abs() < 1e-3, "mis {mis}, {facing:?}: the density integrates to {total}");
            if let Err(told) = crate::chi_square::compare(&seen, &expected, 10) {
                panic!("mis {mis}, {facing:?}: {told}");
            }
        }
    }

    /// All light that is in front of a surface can be found, on images large and small. Fails if what is in front of some normals of a
    /// group alone is left out, or of some parts of a block.
    #[test]
    fn what_is_in_front_is_found() {
        for (width, height) in [(2, 3), (5, 4), (64, 32), (200, 111)] {
            let (map, textures) = environment(width, height, |_, _| 1.0);
            let mut directions = random().map(|numbers| uniform_sphere(units(numbers)));
            for _ in 0..100_000 {
                let (n, wi) = (directions.next().unwrap(), directions.next().unwrap());
                let wi = if n.dot(wi) < 0.0 { -wi } else { wi };
                let (_, pdf) = map.at(&textures, wi, map.facing(n), false);
                assert!(pdf > 0.0, "{width}×{height}: light from {wi} on a surface that looks to {n}");
            }
        }
    }

    /// Few samples fall behind a surface, and their weights vary little: with the cosine, on average by less than a seventh of what they
    /// vary without.
    #[test]
    fn surfaces_choose_what_is_in_front() {
        let (map, textures) = environment(64, 32, |x, y| 1.0 + libm::sinf((x * y) as f32 * 0.01) * 0.9);
        let mut ratios = Vec::new();
        for n in grid(7).map(uniform_sphere) {
            let relative_variance = |facing| {
                let count = 4096;
                let (mut sum, mut squares) = (0.0, 0.0);
                for numbers in random().take(count) {
                    let (wi, radiance, pdf) = map.sample(&textures, numbers, facing, false).unwrap();
                    let value = f64::from(luminance(radiance) * wi.dot(n).max(0.0) / pdf);
                    sum += value;
                    squares += value * value;
                }
                squares * count as f64 / (sum * sum) - 1.0
            };
            let (with, without) = (relative_variance(map.facing(n)), relative_variance(Facing::ANY));
            assert!(with < 0.4 * without, "for a surface that looks to {n}: {with}, {without}");
            ratios.push(with / without);
        }
        let mean = ratios.iter().sum::<f64>() / ratios.len() as f64;
        assert!(mean < 1.0 / 7.0, "{mean}");
    }

    /// Light sampling alone weighs every direction almost alike, and the compensated density is zero below the mean.
    #[test]
    fn bright_directions_are_found() {
        let (map, textures) = environment(64, 32, |x, y| 1.0 + libm::sinf((x * y) as f32 * 0.01) * 0.9);
        let weights = grid(64).map(|u| {
            let (_, radiance, pdf) =
                map.sample(&textures, [u.x, u.y].map(|u| fraction(u, 0)), Facing::ANY, false).unwrap();
            luminance(radiance) / pdf / (4.0 * PI * map.mean_luminance())
        });
        assert!(weights.into_iter().all(|w| (0.8..1.25).contains(&w)), "a weight is far from the mean");
        let (map, textures) = environment(8, 5, uneven);
        for d in grid(64).map(uniform_sphere) {
            let (radiance, pdf) = map.at(&textures, d, Facing::ANY, true);
            assert!(pdf > 0.0 || luminance(radiance) <= 4.0 * map.mean_luminance());
        }
    }
}
