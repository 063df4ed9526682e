//! Probabilities of an image's cells, for each way that a surface may look.
//!
//! Cells lie in sectors, 16 by 16. A number chooses a strip of sectors, then a column of the cells in one row of that strip; another
//! number the sector of that strip, then a row of the cells in that sector. Only the sectors depend on where a surface looks, so that
//! tables of cells are there once. Numbers have 32 bits: 12 for strip or sector, whose probabilities are multiples of 2^-12, and
//! 20 for column or row. So all of it is exact, and neighbouring numbers stay neighbours.

use super::facing::{BLOCKS, Blocks, Facing};
use crate::bvh::simd::prefetch_line;

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
    /// For each [`Facing`].
    sectors: Vec<Sectors>,
    /// The rows of cells, of each strip a line whose parts are sectors.
    rows: Lines,
    /// The columns of cells, of each row a line whose parts are strips.
    columns: Lines,
}

/// Probabilities of strips, and of the sectors of each strip.
struct Sectors {
    strips: Ends,
    of_strips: [Ends; SECTORS],
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
        let mut columns = Lines::new(cells_down, Division::new(width, SECTORS));
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
            columns.add(&of_row);
        }
        let mut rows = Lines::new(SECTORS, Division::new(cells_down, SECTORS));
        for strip in 0..SECTORS {
            rows.add(&weights.rows.iter().map(|row| row[strip]).collect::<Vec<_>>());
        }
        let sectors = blocks.cosines.iter().map(|cosines| weights.sectors(cosines)).collect();
        (Self { floor, sectors, rows, columns }, weights.total as f32)
    }

    /// The row of cells that numbers choose; none where nothing shines that matters. Asks for what [`Tables::choose_column`] will
    /// read, ahead of time.
    #[inline(always)]
    pub fn choose_row(&self, facing: Facing, [x, y]: [u32; 2]) -> Option<Row> {
        let sectors = &self.sectors[facing.index()];
        let (strip, step) = sectors.strips.choose(x)?;
        let (sector, down) = sectors.of_strips[strip].choose(y)?;
        let (row, at) = self.rows.choose(strip, sector, down);
        prefetch_line(&self.columns.guide(row, strip)[0]);
        Some(Row { row: row as i32, at, strip: strip as u32, step })
    }

    /// The column, and where in it, from 0 to 1.
    #[inline(always)]
    pub fn choose_column(&self, Row { row, strip, step, .. }: Row) -> (i32, f32) {
        let (column, at) = self.columns.choose(row as usize, strip as usize, step);
        (column as i32, at)
    }

    /// Asks for what [`Tables::probability`] will read, ahead of time.
    #[inline(always)]
    pub fn prefetch(&self, column: usize, row: usize) {
        self.columns.prefetch(row, column);
    }

    /// The probability of a cell.
    #[inline(always)]
    pub fn probability(&self, facing: Facing, column: usize, row: usize) -> f32 {
        let (strip, sector) = (self.columns.parts.part(column), self.rows.parts.part(row));
        let sectors = &self.sectors[facing.index()];
        sectors.strips.probability(strip)
            * sectors.of_strips[strip].probability(sector)
            * (self.rows.probability(strip, sector, row) * self.columns.probability(row, strip, column))
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

    /// Probabilities of sectors where blocks are seen under these cosines.
    fn sectors(&self, cosines: &[f32]) -> Sectors {
        let mut sums = [[0.0; SECTORS]; SECTORS];
        for (block, (weight, &cosine)) in self.blocks.iter().zip(cosines).enumerate() {
            let (row, column) = (block / BLOCKS, block % BLOCKS);
            sums[column / (BLOCKS / SECTORS)][row / (BLOCKS / SECTORS)] += weight * f64::from(cosine);
        }
        Sectors {
            strips: Ends::new(&sums.map(|strip| strip.iter().sum())),
            of_strips: sums.map(|strip| Ends::new(&strip)),
        }
    }
}

/// Cumulative probabilities of sixteen items in [`SECTOR_STEPS`], without the first, which is 0.
struct Ends([u16; SECTORS]);

impl Ends {
    fn new(weights: &[f64; SECTORS]) -> Self {
        let cumulative = cumulate(weights, SECTOR_STEPS);
        Self(std::array::from_fn(|i| cumulative[i + 1] as u16))
    }

    /// The steps of an item, from the first to before the second; none behind the last item.
    #[inline(always)]
    fn span(&self, item: usize) -> Option<(u32, u32)> {
        let end = *self.0.get(item)?;
        Some((if item > 0 { self.0[item - 1].into() } else { 0 }, end.into()))
    }

    /// The item that a number falls on, and which of [`CELL_STEPS`] steps in it; none where none has a probability.
    #[inline(always)]
    fn choose(&self, number: u32) -> Option<(usize, u32)> {
        let step = (number / CELL_STEPS) as u16;
        let mut item = 0;
        for &end in &self.0 {
            item += usize::from(end <= step);
        }
        let (begin, end) = self.span(item)?;
        Some((item, (number - begin * CELL_STEPS) / (end - begin)))
    }

    #[inline(always)]
    fn probability(&self, item: usize) -> f32 {
        let (begin, end) = self.span(item).unwrap_or_default();
        share(end - begin, SECTOR_STEPS)
    }
}

/// Probabilities of the items of some lines, all divided alike; those of a part add up to one.
struct Lines {
    parts: Division,
    /// Cumulative, in [`CELL_STEPS`], one part of a line behind the other, each beginning with 0.
    cumulative: Vec<u32>,
    /// Where to look among them, [`GUIDE`] a part.
    guides: Vec<u16>,
}

impl Lines {
    /// No line yet, and room for so many.
    fn new(lines: usize, parts: Division) -> Self {
        Self {
            parts,
            cumulative: Vec::with_capacity(lines * (parts.items + SECTORS)),
            guides: Vec::with_capacity(lines * SECTORS * GUIDE),
        }
    }

    /// Adds a line of items with these weights.
    fn add(&mut self, weights: &[f64]) {
        for part in 0..SECTORS {
            let cumulative = cumulate(&weights[self.parts.first(part)..self.parts.first(part + 1)], CELL_STEPS);
            self.guides.extend(guide(&cumulative));
            self.cumulative.extend(cumulative);
        }
    }

    /// Where the cumulative probability before an item is, or behind the last one of its part.
    #[inline(always)]
    fn at(&self, line: usize, part: usize, item: usize) -> usize {
        line * (self.parts.items + SECTORS) + item + part
    }

    #[inline(always)]
    fn guide(&self, line: usize, part: usize) -> &[u16] {
        &self.guides[(line * SECTORS + part) * GUIDE..][..GUIDE]
    }

    /// The item of a part of a line that a step falls on, and where on it, in (0, 1).
    #[inline(always)]
    fn choose(&self, line: usize, part: usize, step: u32) -> (usize, f32) {
        let (first, end) = (self.parts.first(part), self.parts.first(part + 1));
        let cumulative = &self.cumulative[self.at(line, part, first)..=self.at(line, part, end)];
        let (item, at) = choose(cumulative, self.guide(line, part), step);
        (first + item, at)
    }

    /// Asks for what [`Lines::probability`] will read, ahead of time.
    #[inline(always)]
    fn prefetch(&self, line: usize, item: usize) {
        prefetch_line(&self.cumulative[self.at(line, self.parts.part(item), item)]);
    }

    /// The probability of an item in its part.
    #[inline(always)]
    fn probability(&self, line: usize, part: usize, item: usize) -> f32 {
        let at = self.at(line, part, item);
        share(self.cumulative[at + 1] - self.cumulative[at], CELL_STEPS)
    }
}

/// So many steps of so many, a power of two.
#[inline(always)]
fn share(steps: u32, of: u32) -> f32 {
    steps as f32 * (1.0 / of as f32)
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
        let ends = Ends::new(&weights);
        for strip in 0..SECTORS {
            let (begin, end) = (u64::from(cumulative[strip]), u64::from(cumulative[strip + 1]));
            assert_eq!(begin < end, weights[strip] > 0.0);
            for step in [0, 1, 77_777, u64::from(CELL_STEPS) - 1] {
                let first = begin * u64::from(CELL_STEPS) + step * (end - begin);
                for number in first..first + (end - begin) {
                    assert_eq!(ends.choose(number as u32), Some((strip, step as u32)));
                }
            }
        }
        assert_eq!(Ends::new(&[0.0; SECTORS]).choose(5), None);
    }
}
