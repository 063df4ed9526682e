//! Whether it pays to reuse paths: a few blocks of the picture traced both ways.
//!
//! The answer is a function of scene and settings, less the crop, the seed, and how many samples there are: so it is the same
//! on every machine, and for every part of a picture and all samples that are added to it. Work is relative variance × cost, and
//! cost is counted in rays, not measured.

use super::{TraceTile, Tracer};
use crate::film::{Estimate, Film, REPLICATES};
use crate::filter::FilterTable;
use crate::integrator::Tally;
use crate::integrator::reuse::BLOCK;
use crate::settings::{Half, Settings, Window};
use rayon::prelude::*;
use std::sync::atomic::AtomicBool;

/// Blocks that are traced, at most: some thousand paths either way, a few hundredths of a second.
const BLOCKS: u32 = 64;
/// Samples a pixel: one for each replicate.
const SAMPLES: u32 = REPLICATES as u32;
/// Chooses samples that no picture has, unless one asks for this very seed: what decides is not part of what is decided on.
const SEED: u64 = 0x7069_6c6f_7421;

/// What a path costs at each surface besides its rays to other first surfaces, counted in those.
const SURFACE: f64 = 4.0;

/// Steps of this, less whole numbers, fill an interval evenly.
const GOLDEN_RATIO: f64 = 0.618_033_988_749_895;

/// Part of the squared mean of all pixels that is added to that of each: what is dark need not be known as well.
const DARK: f64 = 0.01;

/// Whether reusing paths makes less work of the same error.
pub(super) fn reuse_pays(tracer: &Tracer) -> bool {
    let settings = Settings { spp: SAMPLES, seed: SEED, half: Half::Both, ..tracer.settings.clone() };
    let mut pilot = Tracer {
        world: tracer.world.clone(),
        camera: tracer.camera.clone(),
        filter: FilterTable::new(settings.film.filter),
        settings,
        ..*tracer
    };
    let with = pilot.seen();
    pilot.reuses = false;
    let (Some(with), Some(without)) = (with, pilot.seen()) else { return false };
    // Both relative to the same means, so that rare and bright samples, which are the same ones, count alike in both.
    let means: Vec<f64> = with.blocks.iter().zip(&without.blocks).map(|(a, b)| 0.5 * (a.mean + b.mean)).collect();
    let mean = means.iter().sum::<f64>() / means.len() as f64;
    let work = |seen: &Seen| {
        let of_block =
            |(block, m): (&Block, &f64)| block.variance / (m * m + DARK * mean * mean).max(f64::MIN_POSITIVE);
        seen.blocks.iter().zip(&means).map(of_block).sum::<f64>() * seen.cost
    };
    work(&with) < work(&without)
}

/// What the pilot saw.
struct Seen {
    /// By block and channel.
    blocks: Vec<Block>,
    cost: f64,
}

/// Sums over a block's pixels of the means and of their variances.
#[derive(Clone, Copy, Default)]
struct Block {
    mean: f64,
    variance: f64,
}

impl Tracer {
    /// Traces the pilot's blocks, on the current rayon pool; none where a sample has no value, which the render will tell.
    fn seen(&self) -> Option<Seen> {
        let film = &self.settings.film;
        let (columns, rows) = (film.width.div_ceil(BLOCK[0]), film.height.div_ceil(BLOCK[1]));
        let count = columns.saturating_mul(rows).min(BLOCKS);
        let block = |n: u32| {
            // Evenly over the rows, and by the golden ratio over the columns.
            let row = (f64::from(n) + 0.5) / f64::from(count) * f64::from(rows);
            let column = (f64::from(n) * GOLDEN_RATIO).fract() * f64::from(columns);
            let (x0, y0) = (column as u32 * BLOCK[0], row as u32 * BLOCK[1]);
            let (x1, y1) = ((x0 + BLOCK[0]).min(film.width), (y0 + BLOCK[1]).min(film.height));
            self.seen_in(Window { x0, x1, y0, y1 })
        };
        let blocks = (0..count).into_par_iter().map(block).collect::<Option<Vec<_>>>()?;
        let cost = blocks.iter().map(|(_, cost)| cost).sum();
        Some(Seen { blocks: blocks.into_iter().flat_map(|(channels, _)| channels).collect(), cost })
    }

    /// Traces a block: what is seen in each channel, and its cost.
    fn seen_in(&self, tile: Window) -> Option<([Block; 3], f64)> {
        let never = AtomicBool::new(false);
        let unit = TraceTile { tracer: self, tile, samples: 0..SAMPLES, stop: &never };
        let (sums, Tally { surfaces, links }) = self.isa.dispatch(unit);
        let mut settings = self.settings.clone();
        settings.film.crop = tile;
        let mut part = Film::new(&settings);
        part.merge(&sums.ok()??);
        let mut channels = [Block::default(); 3];
        for (x, y) in (tile.y0..tile.y1).flat_map(|y| (tile.x0..tile.x1).map(move |x| (x, y))) {
            let Estimate { mean, variance, .. } = part.estimate(x, y);
            for (channel, (mean, variance)) in channels.iter_mut().zip(mean.into_iter().zip(variance)) {
                channel.mean += f64::from(mean);
                channel.variance += f64::from(variance);
            }
        }
        Some((channels, SURFACE * surfaces as f64 + links as f64))
    }
}
