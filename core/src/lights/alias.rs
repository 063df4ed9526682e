//! Choice among weighted items in constant time (Walker 1974; Vose 1991).

/// The largest number below 1.
const BELOW_ONE: f32 = 1.0 - 0.5 * f32::EPSILON;

/// A table over weighted items.
pub struct AliasTable {
    /// For each bin: the share of it that is the item's own, and the item that has the rest.
    bins: Vec<(f32, u32)>,
    probabilities: Vec<f32>,
}

impl AliasTable {
    /// Items are chosen in proportion to `weights`, none of them negative.
    pub fn new(weights: &[f32]) -> Self {
        let total: f64 = weights.iter().map(|&w| f64::from(w)).sum();
        if total <= 0.0 {
            return Self { bins: Vec::new(), probabilities: vec![0.0; weights.len()] };
        }
        let n = weights.len() as f64;
        let mut scaled: Vec<f64> = weights.iter().map(|&w| f64::from(w) * n / total).collect();
        let mut bins: Vec<(f32, u32)> = (0..weights.len()).map(|i| (1.0, i as u32)).collect();
        let (mut small, mut large): (Vec<usize>, Vec<usize>) = (0..weights.len()).partition(|&i| scaled[i] < 1.0);
        while let (Some(s), Some(&l)) = (small.pop(), large.last()) {
            bins[s] = (scaled[s] as f32, l as u32);
            scaled[l] -= 1.0 - scaled[s];
            if scaled[l] < 1.0 {
                large.pop();
                small.push(l);
            }
        }
        let probabilities = weights.iter().map(|&w| (f64::from(w) / total) as f32).collect();
        Self { bins, probabilities }
    }

    /// An item and its probability; none if no item has weight. What is left of `u` is a fresh number.
    #[inline(always)]
    pub fn sample(&self, u: &mut f32) -> Option<(u32, f32)> {
        let at = *u * self.bins.len() as f32;
        let bin = (at as usize).min(self.bins.len().checked_sub(1)?);
        let (share, alias) = self.bins[bin];
        let at = at - bin as f32;
        let (item, rest) = if at < share { (bin as u32, at / share) } else { (alias, (at - share) / (1.0 - share)) };
        *u = rest.min(BELOW_ONE);
        let probability = self.probabilities[item as usize];
        (probability > 0.0).then_some((item, probability))
    }

    /// The probability of an item.
    #[inline(always)]
    pub fn probability(&self, item: u32) -> f32 {
        self.probabilities[item as usize]
    }
}
