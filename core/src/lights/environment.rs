//! Environment maps: an image around the scene, bilinear between texels, sampled in proportion to its luminance.
//!
//! Columns run around y; a column's centre is at (i + ½)/width of the turn. Rows run from +y to −y; the first and the last lie
//! *on* the poles, as Mitsuba's `envmap` has them. Four neighbouring texels span a *cell*: width · (height − 1) of them.
//!
//! Directions are found by two choices (a row of cells, a cell of it), then bilinearly within the cell, over the angle around
//! and the height along y, so that the density in solid angle is the interpolated luminance itself up to the curvature of a
//! cell's rows. Inverted cumulative sums keep neighbouring random numbers neighbours, which an alias table would not, and whose
//! stratification is worth more than its speed.

use super::luminance;
use crate::bvh::simd::prefetch_line;
use crate::scene::Image;
use crate::texture::Textures;
use crate::trig::{atan2, sin_cos_turn};
use crate::warp::inverse_linear;
use glam::{Mat3, Vec2, Vec3};
use std::f32::consts::{PI, TAU};
use std::sync::Arc;

/// Random numbers are multiples of 2^-24. Choices have probabilities that are such multiples too, which makes them exact.
const STEPS: u32 = 1 << 24;

/// Entries of a guide, each for an equal part of the steps: what a choice falls on is then a few items away at most, on average
/// (Chen & Asau 1974), where a binary search would touch memory in many places.
const GUIDE: usize = 128;

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
    alone: Distribution,
    /// For light sampling joined with BSDF sampling: in proportion to what of the luminance exceeds its mean (Karlík et al.
    /// 2019, "MIS Compensation"). None if nothing does.
    compensated: Option<Distribution>,
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

/// Probabilities of cells.
struct Distribution {
    /// What is taken from the luminance of every texel.
    floor: f32,
    /// Cumulative probabilities of rows of cells, in steps.
    rows: Vec<u32>,
    /// Where to look among them.
    row_guide: Vec<u32>,
    /// Those of the cells in each row, width + 1 a row.
    columns: Vec<u32>,
    /// Where to look among those of each row, [`GUIDE`] a row.
    column_guides: Vec<u32>,
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
        let (alone, mean) = Distribution::new(&texels, &heights, 0.0);
        let (compensated, rest) = Distribution::new(&texels, &heights, mean);
        // What rounding leaves of an even image is no peak.
        let compensated = (rest > 1e-5 * mean).then_some(compensated);
        Self { image, scale, to_world, heights, mean_luminance: mean * scale, alone, compensated }
    }

    /// Luminance of the radiance, its mean over all directions.
    pub fn mean_luminance(&self) -> f32 {
        self.mean_luminance
    }

    #[inline(always)]
    fn distribution(&self, mis: bool) -> &Distribution {
        self.compensated.as_ref().filter(|_| mis).unwrap_or(&self.alone)
    }

    /// What it is but for its tables; `mis` chooses among those.
    #[inline(always)]
    pub fn globe(&self, mis: bool) -> Globe {
        let (width, rows) = (self.image.width as i32, self.image.height as i32);
        Globe { to_world: self.to_world, width, rows, scale: self.scale, floor: self.distribution(mis).floor }
    }

    /// Radiance from `wi` and the density of [`Environment::sample`] there.
    #[inline(always)]
    pub fn at(&self, textures: &Textures, wi: Vec3, mis: bool) -> (Vec3, f32) {
        let globe = self.globe(mis);
        let cell = globe.cell(wi);
        globe.radiance(&cell, &self.patch(textures, &cell, mis))
    }

    /// A unit direction for two random numbers, and what [`Environment::at`] has there.
    #[inline(always)]
    pub fn sample(&self, textures: &Textures, u: Vec2, mis: bool) -> (Vec3, Vec3, f32) {
        let (row, u) = self.choose_row(u, mis);
        let cell = self.choose_column(row, u, mis);
        self.globe(mis).direction(&cell, &self.patch(textures, &cell, mis))
    }

    /// The row of cells that a random number chooses, and what is left of it. Asks for what [`Environment::choose_column`] will
    /// read, ahead of time.
    #[inline(always)]
    pub fn choose_row(&self, u: Vec2, mis: bool) -> (i32, Vec2) {
        let distribution = self.distribution(mis);
        let (row, v) = choose(&distribution.rows, &distribution.row_guide, u.y);
        prefetch_line(&distribution.column_guides[row * GUIDE + part(step(u.x))]);
        (row as i32, Vec2::new(u.x, v))
    }

    /// The cell of that row that the other number chooses, and what is left of both.
    #[inline(always)]
    pub fn choose_column(&self, row: i32, u: Vec2, mis: bool) -> Cell {
        let (distribution, width, row) = (self.distribution(mis), self.image.width as usize, row as usize);
        let columns = &distribution.columns[row * (width + 1)..][..width + 1];
        let (column, x) = choose(columns, &distribution.column_guides[row * GUIDE..][..GUIDE], u.x);
        Cell { column: column as i32, row: row as i32, at: Vec2::new(x, u.y), height: 0.0 }
    }

    /// Asks for what [`Environment::patch`] will read, ahead of time.
    #[inline(always)]
    pub fn prefetch(&self, textures: &Textures, cell: &Cell, mis: bool) {
        let (column, row, width) = (cell.column as usize, cell.row as usize, self.image.width as usize);
        for row in [row, row + 1] {
            textures.prefetch_texel(&self.image, row * width + column);
        }
        prefetch_line(&self.distribution(mis).columns[row * (width + 1) + column]);
    }

    /// What the tables have about a cell.
    #[inline(always)]
    pub fn patch(&self, textures: &Textures, cell: &Cell, mis: bool) -> Patch {
        let (column, row, width) = (cell.column as usize, cell.row as usize, self.image.width as usize);
        let next = if column + 1 == width { 0 } else { column + 1 };
        let texel = |x: usize, y: usize| textures.texel(&self.image, y * width + x);
        Patch {
            corners: [texel(column, row), texel(next, row), texel(column, row + 1), texel(next, row + 1)],
            heights: Vec2::new(self.heights[row], self.heights[row + 1]),
            probability: self.distribution(mis).probability(column, row, width),
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

/// What of a luminance counts above a floor.
#[inline(always)]
fn weight(luminance: f32, floor: f32) -> f32 {
    (luminance - floor).max(0.0)
}

impl Distribution {
    /// Probabilities for texels of these luminances less `floor`, and the mean over all directions of that.
    fn new(texels: &[f32], heights: &[f32], floor: f32) -> (Self, f32) {
        let width = texels.len() / heights.len();
        let mut distribution =
            Self { floor, rows: Vec::new(), row_guide: Vec::new(), columns: Vec::new(), column_guides: Vec::new() };
        let mut row_weights = Vec::with_capacity(heights.len() - 1);
        let mut weights = vec![0.0; width];
        for (row, pair) in heights.windows(2).enumerate() {
            let at = |x: usize, y: usize| f64::from(weight(texels[(row + y) * width + x % width], floor));
            for (x, sum) in weights.iter_mut().enumerate() {
                *sum = 0.25 * (at(x, 0) + at(x + 1, 0) + at(x, 1) + at(x + 1, 1));
            }
            let across = weights.iter().sum::<f64>() / width as f64;
            row_weights.push(across * 0.5 * f64::from(pair[1] - pair[0])); // heights span 0 to 2
            let cumulative = cumulate(&weights);
            distribution.column_guides.extend(guide(&cumulative));
            distribution.columns.extend(cumulative);
        }
        distribution.rows = cumulate(&row_weights);
        distribution.row_guide = guide(&distribution.rows).collect();
        (distribution, row_weights.iter().sum::<f64>() as f32)
    }

    #[inline(always)]
    fn probability(&self, column: usize, row: usize, width: usize) -> f32 {
        let at = row * (width + 1) + column;
        let share = |steps: u32| steps as f32 * (1.0 / STEPS as f32);
        share(self.rows[row + 1] - self.rows[row]) * share(self.columns[at + 1] - self.columns[at])
    }
}

/// Cumulative probabilities in steps, from 0 to [`STEPS`]; every positive weight has at least one step. All zero if no weight
/// is positive.
fn cumulate(weights: &[f64]) -> Vec<u32> {
    let total: f64 = weights.iter().sum();
    let positive = weights.iter().filter(|&&w| w > 0.0).count();
    let to_share = f64::from(STEPS) - positive as f64;
    let (mut sum, mut seen) = (0.0, 0);
    let mut cumulative = vec![0; weights.len() + 1];
    for (i, &weight) in weights.iter().enumerate().filter(|_| positive > 0) {
        sum += weight;
        seen += u32::from(weight > 0.0);
        let share = if seen as usize == positive { to_share } else { (to_share * (sum / total)).floor().min(to_share) };
        cumulative[i + 1] = share as u32 + seen;
    }
    cumulative
}

/// For each of [`GUIDE`] equal parts of the steps, the item that its first step falls on.
fn guide(cumulative: &[u32]) -> impl Iterator<Item = u32> {
    let last = cumulative.len() - 2;
    (0..GUIDE).map(move |part| {
        let step = (part * (STEPS as usize / GUIDE)) as u32;
        (cumulative.partition_point(|&c| c <= step).max(1) - 1).min(last) as u32
    })
}

/// The step that a random number is.
#[inline(always)]
fn step(u: f32) -> u32 {
    ((u * STEPS as f32) as u32).min(STEPS - 1)
}

/// The part of a guide that a step is in.
#[inline(always)]
fn part(step: u32) -> usize {
    step as usize / (STEPS as usize / GUIDE)
}

/// The item that `u` falls on, and where on it, in (0, 1).
#[inline(always)]
fn choose(cumulative: &[u32], guide: &[u32], u: f32) -> (usize, f32) {
    let step = step(u);
    let mut item = guide[part(step)] as usize;
    while item + 2 < cumulative.len() && cumulative[item + 1] <= step {
        item += 1;
    }
    let width = (cumulative[item + 1] - cumulative[item]).max(1);
    (item, ((step - cumulative[item].min(step)) as f32 + 0.5) / width as f32)
}

#[cfg(test)]
mod tests {
    use super::*;
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

    /// Guides change nothing but time: every step falls on the item that a binary search finds. Fails if a guide begins behind
    /// the item of its first step.
    #[test]
    fn guides_lead_to_the_item() {
        for weights in
            [vec![0.0; 5], vec![1.0], vec![0.0, 3.0, 0.0], (0..999).map(|i| f64::from(i % 7 / 5 * i)).collect()]
        {
            let cumulative = cumulate(&weights);
            let guide: Vec<u32> = guide(&cumulative).collect();
            for step in
                (0..STEPS).step_by(997).chain([1, STEPS - 1]).chain(cumulative.iter().map(|&c| c.min(STEPS - 1)))
            {
                let searched = cumulative.partition_point(|&c| c <= step).clamp(1, cumulative.len() - 1) - 1;
                assert_eq!(
                    choose(&cumulative, &guide, step as f32 / STEPS as f32).0,
                    searched,
                    "step {step} of {}",
                    weights.len()
                );
            }
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
        let at = |d: Vec3| map.at(&textures, d.normalize(), false).0.x / 2.0;
        assert!((at(Vec3::new(1.0, 0.0, -1.0)) - 10.0).abs() < 1e-4);
        assert!((at(Vec3::new(1.0, 0.0, 1.0)) - 11.0).abs() < 1e-4);
        assert!((at(Vec3::new(-1.0, 0.0, -1.0)) - 13.0).abs() < 1e-4);
        assert!((at(Vec3::new(0.0, 0.0, -1.0)) - 11.5).abs() < 1e-4, "between the last column and the first");
        assert!((at(Vec3::new(1e-3, 1e3, -1e-3)) - 0.0).abs() < 1e-4);
        assert!((at(Vec3::new(1.0, 1.0, 1.0)) - (1.0 + 10.0 * 0.608_173_4)).abs() < 1e-3);
    }

    /// The density is that of the samples (χ² over boxes of equal solid angle), and integrates to one. Fails if the height
    /// within a cell is taken for the angle, or rows are weighed without their solid angle.
    #[test]
    fn densities_are_those_of_the_samples() {
        for mis in [false, true] {
            let (map, textures) = environment(5, 4, uneven);
            let boxes = 16usize;
            let index = |d: Vec3| {
                let (v, u) = (0.5 * (1.0 - d.z), atan2(d.y, d.x) / TAU + 0.5);
                ((v * boxes as f32) as usize).min(boxes - 1) * boxes + ((u * boxes as f32) as usize).min(boxes - 1)
            };
            let (mut seen, mut expected) = (vec![0.0; boxes * boxes], vec![0.0; boxes * boxes]);
            let (n, fine) = (1024, 2048);
            let mut sampler = 0u64;
            for _ in 0..n * n {
                sampler = crate::sampler::mix64(sampler);
                let u = Vec2::new((sampler as u32 >> 8) as f32, (sampler >> 40) as f32) / STEPS as f32;
                seen[index(map.sample(&textures, u, mis).0)] += 1.0;
            }
            for u in grid(fine) {
                let d = uniform_sphere(u);
                expected[index(d)] +=
                    f64::from(map.at(&textures, d, mis).1) * 4.0 * std::f64::consts::PI * f64::from(n * n)
                        / f64::from(fine * fine);
            }
            let total: f64 = expected.iter().sum::<f64>() / f64::from(n * n);
            assert!((total - 1.0).abs() < 1e-3, "mis {mis}: the density integrates to {total}");
            if let Err(told) = crate::chi_square::compare(&seen, &expected, 2) {
                panic!("mis {mis}: {told}");
            }
            let stray = seen.iter().zip(&expected).any(|(&s, &e)| e == 0.0 && s > 0.0);
            assert!(!stray, "mis {mis}: samples where the density is zero");
        }
    }

    /// Light sampling alone weighs every direction almost alike, and the compensated density is zero below the mean.
    #[test]
    fn bright_directions_are_found() {
        let (map, textures) = environment(64, 32, |x, y| 1.0 + libm::sinf((x * y) as f32 * 0.01) * 0.9);
        let weights = grid(64).map(|u| {
            let (_, radiance, pdf) = map.sample(&textures, u, false);
            luminance(radiance) / pdf / (4.0 * PI * map.mean_luminance())
        });
        assert!(weights.into_iter().all(|w| (0.8..1.25).contains(&w)), "a weight is far from the mean");
        let (map, textures) = environment(8, 5, uneven);
        for d in grid(64).map(uniform_sphere) {
            let (radiance, pdf) = map.at(&textures, d, true);
            assert!(pdf > 0.0 || luminance(radiance) <= 4.0 * map.mean_luminance());
        }
    }
}
