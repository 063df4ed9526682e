//! Probabilities of an image's cells, for each way that a surface may look.
//!
//! Cells lie in sectors, 16 by 16. A number chooses a strip of sectors, then a column of the cells in one row of that strip; another
//! number the sector of that strip, then a row of the cells in that sector. Only the sectors depend on where a surface looks, so that
//! tables of cells are there once. Numbers have 32 bits: 12 for strip or sector, whose probabilities are multiples of 2^-12, and
//! 20 for column or row. So all of it is exact, and neighbouring numbers stay neighbours.

use super::facing::{BLOCKS, Blocks, Facing};
use crate::bvh::simd::prefetch_line;
use rayon::prelude::*;

/// Sectors across, and down.
pub(super) const SECTORS: usize = 16;

/// Steps of the probability of a strip, and of a sector in it.
const SECTOR_STEPS: u32 = 1 << 12;
/// Steps of the probability of a row of cells in a sector, and of a column of cells in a row of a strip.
const CELL_STEPS: u32 = 1 << 20;

/// Entries of a guide, each for an equal part of the steps: what a choice falls on is then a few items away at most, on average
/// (Chen & Asau 1974), where a binary search would touch memory in many places.
const GUIDE: usize = 8;

/// How items in a row are divided into parts.
#[derive(Clone, Copy, Debug)]
pub(super) struct Division {
    items: usize,
    parts: usize,
}

impl Division {
    pub fn new(items: usize, parts: usize) -> Self {
        Self { items, parts }
    }

    /// The first item of a part, or of those behind it.
    #[inline(always)]
    pub fn first(self, part: usize) -> usize {
        (part * self.items).div_ceil(self.parts)
    }

    /// The part of an item.
    #[inline(always)]
    pub fn part(self, item: usize) -> usize {
        item * self.parts / self.items
    }
}

/// Probabilities of cells.
pub(super) struct Tables {
    /// What is taken from the luminance of every texel.
    pub floor: f32,
    /// Cells across, and down, in sectors.
    across: Division,
    down: Division,
    /// For each [`Facing`].
    sectors: Vec<Sectors>,
    /// Cumulative probabilities of the rows of each sector, one sector of a strip behind the other, each beginning with 0.
    rows: Vec<u32>,
    /// Where to look among them.
    row_guides: Vec<u16>,
    /// Those of the columns of each strip, in one row of cells behind the other, each beginning with 0.
    columns: Vec<u32>,
    /// Where to look among them.
    column_guides: Vec<u16>,
}

/// Cumulative probabilities of strips, and of the sectors of each strip, in steps; without the first, which is 0.
#[derive(Clone)]
struct Sectors {
    strips: [u16; SECTORS],
    of_strips: [[u16; SECTORS]; SECTORS],
}

/// What was chosen of a cell: its row, and what chooses its column.
#[derive(Clone, Copy, Debug)]
pub struct Row {
    /// Which.
    pub row: i32,
    /// Where in it, from 0 to 1.
    pub at: f32,
    /// The strip.
    pub strip: u32,
    /// The step that chooses a column of it.
    pub step: u32,
}

/// What an image weighs: sums over its cells.
struct Weights {
    /// Of each row of cells in each strip.
    rows: Vec<[f64; SECTORS]>,
    /// Of blocks.
    blocks: Vec<f64>,
    total: f64,
}

impl Tables {
    /// Probabilities for texels of these luminances less `floor`, in rows at these 1 − cos θ, and the mean over all directions of that.
    pub fn new(texels: &[f32], heights: &[f32], floor: f32, blocks: &Blocks) -> (Self, f32) {
        let (width, cells_down) = (texels.len() / heights.len(), heights.len() - 1);
        let (across, down) = (Division::new(width, SECTORS), Division::new(cells_down, SECTORS));
        let mut columns = Vec::with_capacity(cells_down * (width + SECTORS));
        let mut column_guides = Vec::with_capacity(cells_down * SECTORS * GUIDE);
        let mut weights =
            Weights { rows: Vec::with_capacity(cells_down), blocks: vec![0.0; BLOCKS * BLOCKS], total: 0.0 };
        let mut of_row = vec![0.0; width];
        for (row, pair) in heights.windows(2).enumerate() {
            let at = |x: usize, y: usize| f64::from(weight(texels[(row + y) * width + x % width], floor));
            let share = 0.5 * f64::from(pair[1] - pair[0]) / width as f64; // heights span 0 to 2
            for (x, sum) in of_row.iter_mut().enumerate() {
                *sum = 0.25 * (at(x, 0) + at(x + 1, 0) + at(x, 1) + at(x + 1, 1)) * share;
            }
            weights.add(row, cells_down, &of_row);
            for strip in 0..SECTORS {
                let cumulative = cumulate(&of_row[across.first(strip)..across.first(strip + 1)], CELL_STEPS);
                column_guides.extend(guide(&cumulative));
                columns.extend(cumulative);
            }
        }
        let mut rows = Vec::with_capacity(SECTORS * (cells_down + SECTORS));
        let mut row_guides = Vec::with_capacity(SECTORS * SECTORS * GUIDE);
        for strip in 0..SECTORS {
            let of_strip: Vec<f64> = weights.rows.iter().map(|row| row[strip]).collect();
            for sector in 0..SECTORS {
                let cumulative = cumulate(&of_strip[down.first(sector)..down.first(sector + 1)], CELL_STEPS);
                row_guides.extend(guide(&cumulative));
                rows.extend(cumulative);
            }
        }
        let sectors = Facing::all().into_par_iter().map(|facing| weights.sectors(facing, blocks)).collect();
        let mean = weights.total as f32;
        (Self { floor, across, down, sectors, rows, row_guides, columns, column_guides }, mean)
    }

    /// The row of cells that numbers choose; none where nothing shines that matters. Asks for what [`Tables::choose_column`] will read, ahead of time.
    #[inline(always)]
    pub fn choose_row(&self, facing: Facing, [x, y]: [u32; 2]) -> Option<Row> {
        let sectors = &self.sectors[facing.index()];
        let (strip, step) = choose_sector(&sectors.strips, x)?;
        let (sector, down) = choose_sector(&sectors.of_strips[strip], y)?;
        let begin = strip * (self.down.items + SECTORS) + self.down.first(sector) + sector;
        let end = strip * (self.down.items + SECTORS) + self.down.first(sector + 1) + sector;
        let guide = &self.row_guides[(strip * SECTORS + sector) * GUIDE..][..GUIDE];
        let (row, at) = choose(&self.rows[begin..=end], guide, down);
        let row = self.down.first(sector) + row;
        prefetch_line(&self.column_guides[(row * SECTORS + strip) * GUIDE]);
        Some(Row { row: row as i32, at, strip: strip as u32, step })
    }

    /// The column, and where in it, from 0 to 1.
    #[inline(always)]
    pub fn choose_column(&self, Row { row, strip, step, .. }: Row) -> (i32, f32) {
        let (row, strip) = (row as usize, strip as usize);
        let begin = row * (self.across.items + SECTORS) + self.across.first(strip) + strip;
        let end = row * (self.across.items + SECTORS) + self.across.first(strip + 1) + strip;
        let guide = &self.column_guides[(row * SECTORS + strip) * GUIDE..][..GUIDE];
        let (column, at) = choose(&self.columns[begin..=end], guide, step);
        ((self.across.first(strip) + column) as i32, at)
    }

    /// Asks for what [`Tables::probability`] will read, ahead of time.
    #[inline(always)]
    pub fn prefetch(&self, column: usize, row: usize) {
        prefetch_line(&self.columns[self.column(self.across.part(column), column, row)]);
    }

    /// The probability of a cell.
    #[inline(always)]
    pub fn probability(&self, facing: Facing, column: usize, row: usize) -> f32 {
        let (strip, sector) = (self.across.part(column), self.down.part(row));
        let sectors = &self.sectors[facing.index()];
        let of = |cumulative: &[u16; SECTORS], i: usize| cumulative[i] - if i > 0 { cumulative[i - 1] } else { 0 };
        let (of_strip, of_sector) = (of(&sectors.strips, strip), of(&sectors.of_strips[strip], sector));
        let at = strip * (self.down.items + SECTORS) + row + sector;
        let of_row = self.rows[at + 1] - self.rows[at];
        let at = self.column(strip, column, row);
        let of_column = self.columns[at + 1] - self.columns[at];
        let share = |steps: u32, of: u32| steps as f32 * (1.0 / of as f32);
        share(of_strip.into(), SECTOR_STEPS)
            * share(of_sector.into(), SECTOR_STEPS)
            * (share(of_row, CELL_STEPS) * share(of_column, CELL_STEPS))
    }

    /// Where the tables have the cumulative probability before a column.
    #[inline(always)]
    fn column(&self, strip: usize, column: usize, row: usize) -> usize {
        row * (self.across.items + SECTORS) + column + strip
    }
}

impl Weights {
    /// Adds a row of cells to blocks.
    fn add(&mut self, row: usize, rows: usize, cells: &[f64]) {
        let (across, block_row) = (Division::new(cells.len(), BLOCKS), Division::new(rows, BLOCKS).part(row));
        let mut strips = [0.0; SECTORS];
        for block in 0..BLOCKS {
            let sum: f64 = cells[across.first(block)..across.first(block + 1)].iter().sum();
            self.blocks[block_row * BLOCKS + block] += sum;
            strips[block / (BLOCKS / SECTORS)] += sum;
            self.total += sum;
        }
        self.rows.push(strips);
    }

    /// Probabilities of sectors for surfaces that look this way.
    fn sectors(&self, facing: Facing, blocks: &Blocks) -> Sectors {
        let mut sums = [[0.0; SECTORS]; SECTORS];
        let mut add = |(block, weight): (usize, f64)| {
            let (row, column) = (block / BLOCKS, block % BLOCKS);
            sums[column / (BLOCKS / SECTORS)][row / (BLOCKS / SECTORS)] += weight;
        };
        if facing == Facing::ANY {
            self.blocks.iter().copied().enumerate().for_each(&mut add);
        } else {
            let cosines = blocks.cosines(facing).map(f64::from);
            self.blocks.iter().zip(cosines).map(|(weight, cosine)| weight * cosine).enumerate().for_each(&mut add);
        }
        let ends = |weights: &[f64; SECTORS]| {
            let cumulative = cumulate(weights, SECTOR_STEPS);
            std::array::from_fn(|i| cumulative[i + 1] as u16)
        };
        Sectors { strips: ends(&sums.map(|strip| strip.iter().sum())), of_strips: sums.map(|strip| ends(&strip)) }
    }
}

/// What of a luminance counts above a floor.
#[inline(always)]
pub(super) fn weight(luminance: f32, floor: f32) -> f32 {
    (luminance - floor).max(0.0)
}

/// Cumulative probabilities in steps, from 0 to `steps`; every positive weight has at least one step. All zero if no weight is
/// positive.
fn cumulate(weights: &[f64], steps: u32) -> Vec<u32> {
    let total: f64 = weights.iter().sum();
    let positive = weights.iter().filter(|&&w| w > 0.0).count();
    let to_share = f64::from(steps) - positive as f64;
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
fn guide(cumulative: &[u32]) -> impl Iterator<Item = u16> {
    let last = cumulative.len().saturating_sub(2);
    (0..GUIDE).map(move |part| {
        let step = (part * (CELL_STEPS as usize / GUIDE)) as u32;
        (cumulative.partition_point(|&c| c <= step).max(1) - 1).min(last) as u16
    })
}

/// The strip or sector that a number falls on, and which of [`CELL_STEPS`] steps in it; none where none has a probability.
#[inline(always)]
fn choose_sector(ends: &[u16; SECTORS], number: u32) -> Option<(usize, u32)> {
    let step = (number / CELL_STEPS) as u16;
    let mut chosen = 0;
    for &end in ends {
        chosen += usize::from(end <= step);
    }
    let end = *ends.get(chosen)?;
    let begin = if chosen > 0 { ends[chosen - 1] } else { 0 };
    Some((chosen, (number - u32::from(begin) * CELL_STEPS) / u32::from(end - begin)))
}

/// The item that a step falls on, and where on it, in (0, 1).
#[inline(always)]
fn choose(cumulative: &[u32], guide: &[u16], step: u32) -> (usize, f32) {
    let mut item = usize::from(guide[step as usize / (CELL_STEPS as usize / GUIDE)]);
    while item + 2 < cumulative.len() && cumulative[item + 1] <= step {
        item += 1;
    }
    let width = (cumulative[item + 1] - cumulative[item]).max(1);
    (item, ((step - cumulative[item].min(step)) as f32 + 0.5) / width as f32)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Guides change nothing but time: every step falls on the item that a binary search finds. Fails if a guide begins behind
    /// the item of its first step.
    #[test]
    fn guides_lead_to_the_item() {
        for weights in
            [vec![0.0; 5], vec![1.0], vec![0.0, 3.0, 0.0], (0..999).map(|i| f64::from(i % 7 / 5 * i)).collect()]
        {
            let cumulative = cumulate(&weights, CELL_STEPS);
            let guide: Vec<u16> = guide(&cumulative).collect();
            for step in (0..CELL_STEPS)
                .step_by(97)
                .chain([1, CELL_STEPS - 1])
                .chain(cumulative.iter().map(|&c| c.min(CELL_STEPS - 1)))
            {
                let searched = cumulative.partition_point(|&c| c <= step).clamp(1, cumulative.len() - 1) - 1;
                assert_eq!(choose(&cumulative, &guide, step).0, searched, "step {step} of {}", weights.len());
            }
        }
    }

    /// Every strip has as many numbers as its probability says, and each of its steps the same number of them. Fails if what is
    /// left of a number is scaled by a float.
    #[test]
    fn sectors_use_numbers_up() {
        let weights: [f64; SECTORS] = std::array::from_fn(|i| [0.0, 1.0, 1e-9, 70.0][i % 4]);
        let cumulative = cumulate(&weights, SECTOR_STEPS);
        let ends: [u16; SECTORS] = std::array::from_fn(|i| cumulative[i + 1] as u16);
        for strip in 0..SECTORS {
            let (begin, end) = (u64::from(cumulative[strip]), u64::from(cumulative[strip + 1]));
            assert_eq!(begin < end, weights[strip] > 0.0);
            for step in [0, 1, 77_777, u64::from(CELL_STEPS) - 1] {
                let first = begin * u64::from(CELL_STEPS) + step * (end - begin);
                for number in first..first + (end - begin) {
                    assert_eq!(choose_sector(&ends, number as u32), Some((strip, step as u32)));
                }
            }
        }
        assert_eq!(choose_sector(&[0; SECTORS], 5), None);
    }
}
