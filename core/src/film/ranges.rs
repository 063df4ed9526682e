//! A set of sample indices, kept as ranges that grow together.

use std::ops::Range;

/// Sorted, disjoint, never touching.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Ranges(Vec<Range<u32>>);

impl Ranges {
    /// The set of these ranges; `None` unless they are sorted, not empty, and neither overlap nor touch.
    pub fn from_sorted(ranges: Vec<Range<u32>>) -> Option<Self> {
        let filled = ranges.iter().all(|r| r.start < r.end);
        let apart = ranges.windows(2).all(|pair| pair[0].end < pair[1].start);
        (filled && apart).then_some(Self(ranges))
    }

    /// Adds indices of which none is in the set.
    pub fn insert(&mut self, range: Range<u32>) {
        let at = self.0.partition_point(|r| r.end < range.start);
        let touching = self.0[at..].iter().take_while(|r| r.start <= range.end).count();
        let merged = self.0[at..at + touching].iter().fold(range, |a, b| a.start.min(b.start)..a.end.max(b.end));
        self.0.splice(at..at + touching, [merged]);
    }

    /// Takes indices out that are all in the set.
    pub fn remove(&mut self, range: &Range<u32>) {
        let at = self.0.partition_point(|r| r.end < range.end);
        let Some(around) = self.0.get(at).cloned() else { return };
        let rest = [around.start..range.start, range.end..around.end];
        self.0.splice(at..=at, rest.into_iter().filter(|r| r.start < r.end));
    }

    /// Whether all of `range` is in the set.
    pub fn contains(&self, range: &Range<u32>) -> bool {
        let at = self.0.partition_point(|r| r.end < range.end);
        self.0.get(at).is_some_and(|r| r.start <= range.start && range.end <= r.end)
    }

    /// Whether any of `range` is in the set.
    pub fn overlaps(&self, range: &Range<u32>) -> bool {
        let at = self.0.partition_point(|r| r.end <= range.start);
        self.0.get(at).is_some_and(|r| r.start < range.end)
    }

    /// The first run of indices of `range` that are in the set.
    pub fn common(&self, range: &Range<u32>) -> Option<Range<u32>> {
        let at = self.0.partition_point(|r| r.end <= range.start);
        let common = self.0.get(at).map(|r| r.start.max(range.start)..r.end.min(range.end))?;
        (!common.is_empty()).then_some(common)
    }

    /// The first run of indices from `start` on, below `end`, that is not in the set; empty at `end` if there is none.
    pub fn gap(&self, start: u32, end: u32) -> Range<u32> {
        let at = self.0.partition_point(|r| r.end <= start);
        let (start, next) = match self.0.get(at) {
            Some(r) if r.start <= start => (r.end, self.0.get(at + 1)),
            next => (start, next),
        };
        let start = start.min(end);
        start..next.map_or(end, |r| r.start.clamp(start, end))
    }

    /// The ranges, in order.
    pub fn as_slice(&self) -> &[Range<u32>] {
        &self.0
    }

    /// Indices in the set.
    pub fn count(&self) -> u64 {
        self.0.iter().map(|r| u64::from(r.end - r.start)).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn it_is_the_set_of_what_was_inserted(
            order in Just((0u32..24).collect::<Vec<_>>()).prop_shuffle(),
            n in 0usize..24,
            gone in 0usize..24,
        ) {
            let mut ranges = Ranges::default();
            order[..n].iter().for_each(|&i| ranges.insert(i..i + 1));
            let gone = gone.min(n);
            order[..gone].iter().for_each(|&i| ranges.remove(&(i..i + 1)));
            let there = &order[gone..n];
            for start in 0..24 {
                for end in start + 1..25 {
                    let all = (start..end).all(|i| there.contains(&i));
                    let any = (start..end).any(|i| there.contains(&i));
                    prop_assert_eq!(ranges.contains(&(start..end)), all, "{}..{} in {:?}", start, end, ranges);
                    prop_assert_eq!(ranges.common(&(start..end)).is_some(), any);
                    prop_assert_eq!(ranges.overlaps(&(start..end)), any, "{}..{} in {:?}", start, end, ranges);
                    let first = (start..end).find(|i| !there.contains(i)).unwrap_or(end);
                    let behind = (first..end).find(|i| there.contains(i)).unwrap_or(end);
                    prop_assert_eq!(ranges.gap(start, end), first..behind, "{}..{} in {:?}", start, end, ranges);
                }
            }
            prop_assert_eq!(ranges.count(), there.len() as u64);
            prop_assert_eq!(Ranges::from_sorted(ranges.0.clone()), Some(ranges));
        }
    }
}
