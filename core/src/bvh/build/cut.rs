//! Boxes in parts of neighbours.

use super::super::Aabb;

/// Planes that are tried along the axis where the centres lie farthest apart, and one.
const BINS: usize = 32;
/// Each side of a cut gets one of so many boxes at least: a part that is small is not worth its while.
const SIDE: usize = 8;

/// Boxes that a bin holds.
#[derive(Clone, Copy)]
struct Bin {
    bounds: Aabb,
    count: usize,
}

impl Bin {
    const EMPTY: Self = Self { bounds: Aabb::EMPTY, count: 0 };

    fn with(self, other: Self) -> Self {
        Self { bounds: self.bounds.union(other.bounds), count: self.count + other.count }
    }
}

/// Cuts `order`, indices of finite boxes, into parts of at most `most` by planes where the surface area heuristic likes it best
/// (Wald 2007), and puts each part's indices together. The same on any number of threads.
pub fn cut<'o>(boxes: &[Aabb], order: &'o mut [u32], most: usize) -> Vec<&'o mut [u32]> {
    if order.len() <= most {
        return vec![order];
    }
    let middle = split(boxes, order);
    let (left, right) = order.split_at_mut(middle);
    let (mut left, right) = rayon::join(|| cut(boxes, left, most), || cut(boxes, right, most));
    left.extend(right);
    left
}

/// Parts the indices in two, and says where the second begins.
fn split(boxes: &[Aabb], order: &mut [u32]) -> usize {
    let centre = |i: u32| boxes[i as usize].centre();
    let centres = Aabb::around(order.iter().map(|&i| centre(i)));
    let extent = centres.max - centres.min;
    let axis = extent.max_position();
    let to_bins = BINS as f32 / extent[axis];
    let bin = |i: u32| (((centre(i)[axis] - centres.min[axis]) * to_bins) as usize).min(BINS - 1);
    let mut bins = [Bin::EMPTY; BINS];
    for &i in &*order {
        let bin = &mut bins[bin(i)];
        *bin = bin.with(Bin { bounds: boxes[i as usize], count: 1 });
    }
    let Some(plane) = best_plane(&bins) else { return halve(boxes, order, axis) };
    let mut middle = 0;
    for at in 0..order.len() {
        if bin(order[at]) < plane {
            order.swap(at, middle);
            middle += 1;
        }
    }
    middle
}

/// Parts the indices in two of equal number by the centres along an axis, and says where the second begins.
pub fn halve(boxes: &[Aabb], order: &mut [u32], axis: usize) -> usize {
    let middle = order.len() / 2;
    let centre = |i: u32| boxes[i as usize].centre()[axis];
    order.select_nth_unstable_by(middle, |&a, &b| centre(a).total_cmp(&centre(b)).then(a.cmp(&b)));
    middle
}

/// The first bin behind the best plane that leaves enough on each side.
fn best_plane(bins: &[Bin; BINS]) -> Option<usize> {
    let mut behind = [Bin::EMPTY; BINS + 1];
    for i in (0..BINS).rev() {
        behind[i] = behind[i + 1].with(bins[i]);
    }
    let least = behind[0].count / SIDE;
    let cost = |bin: &Bin| bin.bounds.half_area() * bin.count as f32;
    let mut before = Bin::EMPTY;
    let mut best = (f32::INFINITY, None);
    for plane in 1..BINS {
        before = before.with(bins[plane - 1]);
        let both = cost(&before) + cost(&behind[plane]);
        if before.count > least && behind[plane].count > least && both < best.0 {
            best = (both, Some(plane));
        }
    }
    best.1
}
