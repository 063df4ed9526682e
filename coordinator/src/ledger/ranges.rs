//! A set of sample indices, kept as ranges that grow together.

use std::ops::Range;

/// Sorted, disjoint, never touching.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Ranges(Vec<Range<u32>>);

impl Ranges {
    /// Adds indices of which none is in the set.
    pub fn insert(&mut self, range: Range<u32>) {
        let at = self.0.partition_point(|r| r.end < range.start);
        let touching = self.0[at..].iter().take_while(|r| r.start <= range.end).count();
        let merged = self.0[at..at + touching].iter().fold(range, |a, b| a.start.min(b.start)..a.end.max(b.end));
        self.0.splice(at..at + touching, [merged]);
    }

    /// Whether all of `range` is in the set.
    pub fn contains(&self, range: &Range<u32>) -> bool {
        let at = self.0.partition_point(|r| r.end < range.end);
        self.0.get(at).is_some_and(|r| r.start <= range.start && range.end <= r.end)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn it_is_the_set_of_what_was_inserted(order in Just((0u32..24).collect::<Vec<_>>()).prop_shuffle(), n in 0usize..24) {
            let mut ranges = Ranges::default();
            order[..n].iter().for_each(|&i| ranges.insert(i..i + 1));
            for start in 0..24 {
                for end in start + 1..25 {
                    let all = (start..end).all(|i| order[..n].contains(&i));
                    prop_assert_eq!(ranges.contains(&(start..end)), all, "{}..{} in {:?}", start, end, ranges);
                }
            }
            prop_assert!(ranges.0.windows(2).all(|pair| pair[0].end < pair[1].start));
        }
    }
}
