//! Pixel filters by importance sampling: a sample belongs to one pixel and lands where the filter puts it (Ernst, Stamminger
//! & Greiner 2006), so tiles never overlap and every sample weighs the same.

use crate::settings::Filter;
use crate::warp::inverse_linear;

/// Intervals of the table along one axis.
const STEPS: usize = 256;

/// The distribution of sample positions along one axis of a separable filter, as a density that is linear between knots.
/// (Box and tent are exact; the Gaussian's relative error is below 4·10^-5.)
pub struct FilterTable {
    radius: f32,
    /// Density at the knots from −radius to radius, up to a factor.
    density: Vec<f32>,
    /// Its integral up to each knot, with steps of unit width.
    integral: Vec<f32>,
}

impl FilterTable {
    /// Tabulates a filter.
    pub fn new(filter: Filter) -> Self {
        let radius = filter.radius();
        let knot = |i: usize| evaluate(filter, radius * (2.0 * i as f32 / STEPS as f32 - 1.0));
        let density: Vec<f32> = (0..=STEPS).map(knot).collect();
        let mut integral = vec![0.0; STEPS + 1];
        for i in 0..STEPS {
            integral[i + 1] = integral[i] + 0.5 * (density[i] + density[i + 1]);
        }
        Self { radius, density, integral }
    }

    /// The position of a sample, in pixels from the left edge of the film, for the pixel `pixel` of a film of `size` pixels
    /// along this axis and a random number `u`. What of the filter lies beyond the film is cut off: a border pixel is the
    /// mean over the part of its filter that lies on the film.
    #[inline]
    pub fn sample(&self, pixel: u32, size: u32, u: f32) -> f32 {
        let centre = pixel as f32 + 0.5;
        let (low, high) = (-centre, size as f32 - centre);
        if self.radius <= low.abs().min(high) {
            return centre + self.invert(u * self.integral[STEPS]);
        }
        let (below, above) = (self.integral_to(low), self.integral_to(high));
        (centre + self.invert(below + u * (above - below))).clamp(0.0, size as f32)
    }

    /// The integral of the density up to `x` pixels from the centre.
    fn integral_to(&self, x: f32) -> f32 {
        let at = ((x / self.radius + 1.0) * (0.5 * STEPS as f32)).clamp(0.0, STEPS as f32);
        let i = (at as usize).min(STEPS - 1);
        let f = at - i as f32;
        let (a, b) = (self.density[i], self.density[i + 1]);
        self.integral[i] + f * (a + 0.5 * f * (b - a))
    }

    /// The position where the integral reaches `mass`.
    #[inline]
    fn invert(&self, mass: f32) -> f32 {
        let i = self.integral.partition_point(|&m| m <= mass).clamp(1, STEPS) - 1;
        let (a, b) = (self.density[i], self.density[i + 1]);
        let rest = mass - self.integral[i];
        let f = if a + b > 0.0 { inverse_linear(2.0 * rest / (a + b), a, b) } else { 0.0 };
        self.radius * (2.0 * (i as f32 + f) / STEPS as f32 - 1.0)
    }
}

/// The filter at `x` pixels from the centre, up to a factor.
fn evaluate(filter: Filter, x: f32) -> f32 {
    match filter {
        Filter::Box => 1.0,
        Filter::Tent { radius } => (1.0 - (x / radius).abs()).max(0.0),
        Filter::Gaussian { stddev } => {
            let bell = |x: f32| libm::expf(-0.5 * (x / stddev) * (x / stddev));
            (bell(x) - bell(filter.radius())).max(0.0)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Positions follow the filter, also where the film cuts it: their share below any x is the filter's own integral,
    /// summed here with 2000 steps in f64. Fails if a border pixel's filter is not cut.
    #[test]
    fn positions_follow_the_filter() {
        let size = 9;
        for filter in [Filter::Box, Filter::Tent { radius: 1.0 }, Filter::Gaussian { stddev: 0.5 }] {
            let table = FilterTable::new(filter);
            for pixel in [0, 1, 4, 8] {
                let centre = f64::from(pixel) + 0.5;
                let n = 20_000;
                let mut positions: Vec<f64> =
                    (0..n).map(|i| f64::from(table.sample(pixel, size, (i as f32 + 0.5) / n as f32))).collect();
                positions.sort_by(f64::total_cmp);
                let (low, high) =
                    ((centre - f64::from(filter.radius())).max(0.0), (centre + f64::from(filter.radius())).min(9.0));
                let steps = 2000;
                let width = (high - low) / f64::from(steps);
                let density =
                    |i: i32| f64::from(evaluate(filter, (low + (f64::from(i) + 0.5) * width - centre) as f32));
                let total: f64 = (0..steps).map(density).sum();
                let mut below = 0.0;
                for i in 0..steps {
                    below += density(i) / total;
                    let x = low + (f64::from(i) + 1.0) * width;
                    let share = positions.partition_point(|&p| p <= x) as f64 / f64::from(n);
                    assert!((share - below).abs() < 2e-3, "{filter:?} pixel {pixel} at {x}: {share} for {below}");
                }
            }
        }
    }
}
