//! How a job is laid out before anyone works on it: tiles in the order they are given out, and rounds of samples over the
//! whole image. Who works on what, and how units are cut from tiles and rounds, is the ledger's.

use std::ops::Range;
use tilecast_core::film::REPLICATES;
use tilecast_core::settings::{Settings, Window};
use tilecast_proto::limits::{TILE_SIDE_DEFAULT, TILE_SIDE_MAX};
use tilecast_proto::types::JobSpec;

/// Samples of the first round at the most: a picture after the first second, however many are to follow.
const FIRST_ROUND_MAX: u32 = 16;
/// The first round takes this part of all samples at the most. Each round sends the whole image once, so there should be few.
const FIRST_ROUND_SHARE: u32 = 32;
/// Tiles of a job: each costs the ledger some 100 bytes.
pub const TILES_MAX: u64 = 1 << 20;

/// A job's layout. Tiles are numbered row by row; the last of a row or column may be narrower.
#[derive(Clone, Debug)]
pub struct Plan {
    window: Window,
    side: u32,
    /// Tile numbers in the order they are given out: from the middle, where the subject tends to be, outwards.
    pub order: Vec<u32>,
    /// Sample indices, round by round; of each a tile has those that it wants.
    pub rounds: Vec<Range<u32>>,
    /// See [`JobSpec::samples`].
    samples: Vec<Range<u32>>,
}

/// A job that cannot be laid out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PlanError {
    /// Cut so fine that the ledger could not keep account of it.
    #[error(
        "tiles of {side} pixels would cut the picture in {tiles} pieces; at most {TILES_MAX} are possible, so ask for larger tiles"
    )]
    TooManyTiles {
        /// Of a tile.
        side: u32,
        /// How many there would be.
        tiles: u64,
    },
    /// Other than one range of samples for all tiles, or one for each.
    #[error("the job has {tiles} tiles and names the samples of {ranges}")]
    Ranges {
        /// There are.
        tiles: u64,
        /// There should be as many.
        ranges: usize,
    },
}

impl Plan {
    /// Lays out a job.
    ///
    /// # Errors
    /// More than [`TILES_MAX`] tiles, or samples that do not fit them.
    pub fn of(spec: &JobSpec) -> Result<Self, PlanError> {
        Self::new(&spec.settings, spec.tile, &spec.samples)
    }

    /// Lays out a job with tiles of `side` pixels.
    ///
    /// # Errors
    /// More than [`TILES_MAX`] tiles, or samples that do not fit them.
    pub fn new(settings: &Settings, side: Option<u32>, samples: &[Range<u32>]) -> Result<Self, PlanError> {
        let window = settings.film.crop;
        let side = side.unwrap_or(TILE_SIDE_DEFAULT).clamp(1, TILE_SIDE_MAX);
        let filled = || samples.iter().filter(|range| !range.is_empty());
        let start = filled().map(|range| range.start).min().unwrap_or(0);
        let end = filled().map(|range| range.end).max().unwrap_or(0);
        let mut plan = Self { window, side, order: Vec::new(), rounds: rounds(start..end), samples: samples.to_vec() };
        let tiles = u64::from(plan.columns()) * u64::from(window.height().div_ceil(side));
        if tiles > TILES_MAX {
            return Err(PlanError::TooManyTiles { side, tiles });
        }
        if samples.len() != 1 && samples.len() as u64 != tiles {
            return Err(PlanError::Ranges { tiles, ranges: samples.len() });
        }
        let mut order: Vec<u32> = (0..tiles as u32).collect();
        let centre = |low: u32, high: u32| i64::from(low) + i64::from(high);
        let middle = (centre(window.x0, window.x1), centre(window.y0, window.y1));
        order.sort_by_cached_key(|&index| {
            let tile = plan.tile(index);
            let (dx, dy) = (centre(tile.x0, tile.x1) - middle.0, centre(tile.y0, tile.y1) - middle.1);
            (dx * dx + dy * dy, index)
        });
        plan.order = order;
        Ok(plan)
    }

    /// The pixels of tile `index`.
    pub fn tile(&self, index: u32) -> Window {
        let (column, row) = (index % self.columns(), index / self.columns());
        let (x0, y0) = (self.window.x0 + column * self.side, self.window.y0 + row * self.side);
        Window { x0, y0, x1: (x0 + self.side).min(self.window.x1), y1: (y0 + self.side).min(self.window.y1) }
    }

    /// The samples that tile `index` is to have.
    pub fn wanted(&self, index: u32) -> Range<u32> {
        self.samples.get(index as usize).or(self.samples.first()).cloned().unwrap_or(0..0)
    }

    /// Samples of all pixels up to the end of each round.
    pub fn totals(&self) -> Vec<u64> {
        let until = |end: u32| {
            let of = |&index: &u32| {
                let Range { start, end: last } = self.wanted(index);
                self.tile(index).area() * u64::from(last.min(end).saturating_sub(start))
            };
            self.order.iter().map(of).sum()
        };
        self.rounds.iter().map(|round| until(round.end)).collect()
    }

    /// The number of the tile that has exactly these pixels.
    pub fn index_of(&self, tile: &Window) -> Option<u32> {
        if !self.window.contains(tile) {
            return None;
        }
        let (column, row) = ((tile.x0 - self.window.x0) / self.side, (tile.y0 - self.window.y0) / self.side);
        let index = row * self.columns() + column;
        (self.tile(index) == *tile).then_some(index)
    }

    fn columns(&self) -> u32 {
        self.window.width().div_ceil(self.side)
    }
}

/// Rounds that double what has been sampled: 8, 8, 16, 32, … The first is a power of two and every replicate has the same
/// share of each, so that after every whole round the error estimate is at its best. What is there already is not sampled again.
fn rounds(samples: Range<u32>) -> Vec<Range<u32>> {
    let Range { mut start, end: last } = samples;
    let share = (last / FIRST_ROUND_SHARE).max(1);
    let first = (1 << share.ilog2()).clamp(REPLICATES as u32, FIRST_ROUND_MAX);
    let ends = std::iter::successors(Some(first), |end| end.checked_mul(2)).take_while(|&end| end < last);
    let ends = ends.filter(|&end| end > start).chain([last]).collect::<Vec<_>>();
    ends.into_iter().map(|end| std::mem::replace(&mut start, end)..end).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ledger::tests::settings;
    use proptest::prelude::*;

    #[test]
    fn rounds_double() {
        assert_eq!(rounds(0..256), [0..8, 8..16, 16..32, 32..64, 64..128, 128..256]);
        assert_eq!(rounds(0..1), std::slice::from_ref(&(0..1)));
        assert_eq!(rounds(0..4), std::slice::from_ref(&(0..4)));
        assert_eq!(rounds(0..10), [0..4, 4..8, 8..10]);
        assert_eq!(rounds(100..600), [100..128, 128..256, 256..512, 512..600]);
        assert_eq!(rounds(0..u32::MAX).last(), Some(&(1 << 31..u32::MAX)));
    }

    #[test]
    fn the_middle_comes_first() {
        let plan = Plan::new(&settings(96, 96, 1), Some(32), std::slice::from_ref(&(0..1))).unwrap();
        assert_eq!(plan.tile(plan.order[0]), Window { x0: 32, y0: 32, x1: 64, y1: 64 });
    }

    #[test]
    fn a_job_cut_too_fine_is_refused() {
        assert!(Plan::new(&settings(2000, 2000, 1), Some(1), std::slice::from_ref(&(0..1))).is_err());
        assert!(Plan::new(&settings(96, 96, 1), Some(48), &[0..1, 0..2, 0..3]).is_err());
    }

    proptest! {
        /// Every pixel lies in one tile, every sample in one round, and tiles are found again.
        #[test]
        fn tiles_and_rounds_cover_everything_once(w in 1u32..90, h in 1u32..90, x in 0u32..9, side in 1u32..70, spp in 1u32..5000, from in 0u32..5000) {
            let from = from % spp;
            let mut settings = settings(w + x, h, spp);
            settings.film.crop.x0 = x;
            let plan = Plan::new(&settings, Some(side), std::slice::from_ref(&(from..spp))).unwrap();
            let mut hits = vec![0; ((w + x) * h) as usize];
            for &index in &plan.order {
                let tile = plan.tile(index);
                prop_assert_eq!(plan.index_of(&tile), Some(index));
                for y in tile.y0..tile.y1 {
                    for column in tile.x0..tile.x1 {
                        hits[(y * (w + x) + column) as usize] += 1;
                    }
                }
            }
            let inside = |i: usize| (i as u32 % (w + x)) >= x;
            prop_assert!(hits.iter().enumerate().all(|(i, &n)| n == i32::from(inside(i))));
            prop_assert_eq!(plan.rounds[0].start, from);
            prop_assert_eq!(plan.totals().pop(), Some(settings.film.crop.area() * u64::from(spp - from)));
            prop_assert!(plan.rounds.windows(2).all(|pair| pair[0].end == pair[1].start));
            prop_assert!(plan.rounds.iter().all(|round| round.start < round.end));
            prop_assert_eq!(plan.rounds[plan.rounds.len() - 1].end, spp);
            let outside = Window { x0: 0, y0: 0, x1: w + x + 1, y1: 1 };
            prop_assert_eq!(plan.index_of(&outside), None);
        }
    }
}
