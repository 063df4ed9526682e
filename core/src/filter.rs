//! Pixel filters by importance sampling: a sample belongs to one pixel and lands where the filter puts it (Ernst, Stamminger
//! & Greiner 2006), so tiles never overlap and samples are added up plainly. Where a filter has negative lobes its magnitude is
//! sampled and the sample's weight carries the sign.

use crate::settings::Filter;
use crate::warp::inverse_linear;
use std::f32::consts::PI;

/// Intervals of the table along one axis.
const STEPS: usize = 256;

/// The distribution of sample positions along one axis of a separable filter. Between knots the filter is taken to be linear.
/// (Box and tent are exact; the others' error is below 4·10^-5 of the Gaussian at a point, 10^-4 of the peak of what has
/// negative lobes.)
pub struct FilterTable {
    radius: f32,
    /// The pixel itself: needs no table.
    is_box: bool,
    /// Density at the knots from −radius to radius, up to a factor.
    density: Vec<f32>,
    /// Its integral up to each knot, with steps of unit width.
    integral: Vec<f32>,
    /// The filter itself, where its magnitude is the density.
    signed: Option<Signed>,
}

/// As [`FilterTable::sample`] for the box filter.
#[inline(always)]
pub fn box_sample(pixel: u32, u: f32) -> (f32, f32) {
    (pixel as f32 + u, 1.0)
}

/// A filter with negative lobes.
struct Signed {
    /// At the knots.
    values: Vec<f32>,
    /// Its integral, as that of the density.
    integral: Vec<f32>,
}

impl FilterTable {
    /// Tabulates a filter.
    pub fn new(filter: Filter) -> Self {
        let radius = filter.radius();
        let knot = |i: usize| evaluate(filter, radius * (2.0 * i as f32 / STEPS as f32 - 1.0));
        let values: Vec<f32> = (0..=STEPS).map(knot).collect();
        let density: Vec<f32> = values.iter().map(|x| x.abs()).collect();
        let integral = integrals(&density);
        let signed = (values != density).then(|| Signed { integral: integrals(&values), values });
        Self { radius, is_box: filter == Filter::Box, density, integral, signed }
    }

    /// Whether it is the pixel itself, for which [`box_sample`] does.
    pub fn is_box(&self) -> bool {
        self.is_box
    }

    /// The position of a sample, in pixels from the left edge of the film, for the pixel `pixel` of a film of `size` pixels
    /// along this axis and a random number `u`; and its weight, which is 1 where the filter is nowhere negative, else 1 in the
    /// mean. What of the filter lies beyond the film is cut off: a border pixel is the mean over the part of its filter that
    /// lies on the film.
    #[inline(always)]
    pub fn sample(&self, pixel: u32, size: u32, u: f32) -> (f32, f32) {
        if self.is_box {
            return box_sample(pixel, u);
        }
        let centre = pixel as f32 + 0.5;
        let (low, high) = (-centre, size as f32 - centre);
        if self.radius <= low.abs().min(high) {
            let (x, weight) = self.invert(u * self.integral[STEPS]);
            let to_mean = self.signed.as_ref().map_or(1.0, |s| self.integral[STEPS] / s.integral[STEPS]);
            return (centre + x, weight * to_mean);
        }
        let between = |values: &[f32], integral: &[f32]| {
            let below = self.integral_to(low, values, integral);
            (below, self.integral_to(high, values, integral) - below)
        };
        let (below, mass) = between(&self.density, &self.integral);
        let (x, weight) = self.invert(below + u * mass);
        let to_mean = self.signed.as_ref().map_or(1.0, |s| mass / between(&s.values, &s.integral).1);
        ((centre + x).clamp(0.0, size as f32), weight * to_mean)
    }

    /// The integral of what is linear between `values` up to `x` pixels from the centre.
    fn integral_to(&self, x: f32, values: &[f32], integral: &[f32]) -> f32 {
        let at = ((x / self.radius + 1.0) * (0.5 * STEPS as f32)).clamp(0.0, STEPS as f32);
        let i = (at as usize).min(STEPS - 1);
        let f = at - i as f32;
        let (a, b) = (values[i], values[i + 1]);
        integral[i] + f * (a + 0.5 * f * (b - a))
    }

    /// The position where the integral of the density reaches `mass`, and the filter over the density there.
    #[inline(always)]
    fn invert(&self, mass: f32) -> (f32, f32) {
        let i = self.integral.partition_point(|&m| m <= mass).clamp(1, STEPS) - 1;
        let (a, b) = (self.density[i], self.density[i + 1]);
        let rest = mass - self.integral[i];
        let f = if a + b > 0.0 { inverse_linear(2.0 * rest / (a + b), a, b) } else { 0.0 };
        let x = self.radius * (2.0 * (i as f32 + f) / STEPS as f32 - 1.0);
        let weight = self.signed.as_ref().map_or(1.0, |signed| {
            let (low, high) = (signed.values[i], signed.values[i + 1]);
            let density = a + (b - a) * f;
            if density > 0.0 { (low + (high - low) * f) / density } else { 0.0 }
        });
        (x, weight)
    }
}

/// The integral of what is linear between `values`, up to each.
fn integrals(values: &[f32]) -> Vec<f32> {
    let mut integral = vec![0.0; values.len()];
    for i in 1..values.len() {
        integral[i] = integral[i - 1] + 0.5 * (values[i - 1] + values[i]);
    }
    integral
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
        Filter::Mitchell { b, c } => cubic(b, c, x.abs()),
        Filter::CatmullRom => cubic(0.0, 0.5, x.abs()),
        Filter::Lanczos { lobes } => {
            let sinc = |x: f32| if x.abs() < 1e-5 { 1.0 } else { libm::sinf(PI * x) / (PI * x) };
            if x.abs() < lobes { sinc(x) * sinc(x / lobes) } else { 0.0 }
        }
    }
}

/// The family of piecewise cubics of Mitchell & Netravali 1988, eq. 8, with their parameters B and C.
fn cubic(b: f32, c: f32, x: f32) -> f32 {
    let polynomial = |[c3, c2, c1, c0]: [f32; 4]| ((c3 * x + c2) * x + c1) * x + c0;
    if x < 1.0 {
        polynomial([12.0 - 9.0 * b - 6.0 * c, -18.0 + 12.0 * b + 6.0 * c, 0.0, 6.0 - 2.0 * b]) / 6.0
    } else if x < 2.0 {
        polynomial([-b - 6.0 * c, 6.0 * b + 30.0 * c, -12.0 * b - 48.0 * c, 8.0 * b + 24.0 * c]) / 6.0
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chi_square::{self, DRAWS, number};

    const ALL: [Filter; 7] = [
        Filter::Box,
        Filter::Tent { radius: 1.0 },
        Filter::Gaussian { stddev: 0.5 },
        Filter::Mitchell { b: 1.0 / 3.0, c: 1.0 / 3.0 },
        Filter::Mitchell { b: 0.2, c: 0.6 },
        Filter::CatmullRom,
        Filter::Lanczos { lobes: 3.0 },
    ];

    /// Positions with their weights follow the filter, also where the film cuts it: their share below any x is the filter's
    /// own integral, summed here with 2000 steps in f64. Fails if a border pixel's filter is not cut, or if weights have lost
    /// their sign or their mean of one.
    #[test]
    fn positions_follow_the_filter() {
        let size = 9;
        for filter in ALL {
            let table = FilterTable::new(filter);
            for pixel in [0, 1, 4, 8] {
                let centre = f64::from(pixel) + 0.5;
                let n = 20_000;
                let mut samples: Vec<(f32, f32)> =
                    (0..n).map(|i| table.sample(pixel, size, (i as f32 + 0.5) / n as f32)).collect();
                samples.sort_by(|a, b| a.0.total_cmp(&b.0));
                let (low, high) =
                    ((centre - f64::from(filter.radius())).max(0.0), (centre + f64::from(filter.radius())).min(9.0));
                let steps = 2000;
                let width = (high - low) / f64::from(steps);
                let density =
                    |i: i32| f64::from(evaluate(filter, (low + (f64::from(i) + 0.5) * width - centre) as f32));
                let total: f64 = (0..steps).map(density).sum();
                let (mut below, mut share, mut at) = (0.0, 0.0, 0);
                for i in 0..steps {
                    below += density(i) / total;
                    let x = low + (f64::from(i) + 1.0) * width;
                    while at < samples.len() && f64::from(samples[at].0) <= x {
                        share += f64::from(samples[at].1) / f64::from(n);
                        at += 1;
                    }
                    assert!((share - below).abs() < 2e-3, "{filter:?} pixel {pixel} at {x}: {share} for {below}");
                }
            }
        }
    }

    /// 10^6 positions a filter against the integral of its magnitude, in 64 cells, in the middle of the film and at its edge.
    /// Fails if positions between knots were even instead of following the slope.
    #[test]
    fn positions_pass_chi_square() {
        const CELLS: usize = 64;
        let cases: Vec<(Filter, u32)> = ALL.into_iter().flat_map(|filter| [(filter, 4), (filter, 0)]).collect();
        for &(filter, pixel) in &cases {
            let table = FilterTable::new(filter);
            let (size, centre) = (9, f64::from(pixel) + 0.5);
            let radius = f64::from(filter.radius());
            let (low, high) = ((centre - radius).max(0.0), centre + radius);
            let mut counts = [0.0; CELLS];
            for i in 0..DRAWS {
                let (x, _) = table.sample(pixel, size, number(i, 0));
                counts[(((f64::from(x) - low) / (high - low) * CELLS as f64) as usize).min(CELLS - 1)] += 1.0;
            }
            let steps = 1000;
            let at = |i: usize| low + (i as f64 + 0.5) / (CELLS * steps) as f64 * (high - low) - centre;
            let magnitude = |cell: usize| -> f64 {
                (cell * steps..(cell + 1) * steps).map(|i| f64::from(evaluate(filter, at(i) as f32)).abs()).sum()
            };
            let magnitudes: Vec<f64> = (0..CELLS).map(magnitude).collect();
            let total: f64 = magnitudes.iter().sum();
            let expected: Vec<f64> = magnitudes.iter().map(|m| m / total * DRAWS as f64).collect();
            if let Err(told) = chi_square::compare(&counts, &expected, cases.len()) {
                panic!("{filter:?} at pixel {pixel}: {told}");
            }
        }
    }

    /// Filters that are nowhere negative give every sample the same weight: exactly one.
    #[test]
    fn weights_are_where_a_filter_needs_them() {
        for filter in ALL {
            let table = FilterTable::new(filter);
            let negative = matches!(filter, Filter::Mitchell { .. } | Filter::CatmullRom | Filter::Lanczos { .. });
            let plain = (0..100).all(|i| table.sample(i % 9, 9, i as f32 / 100.0).1 == 1.0);
            assert_eq!(plain, !negative, "{filter:?}");
        }
    }

    /// Values of Mitsuba 3.9.1.
    #[test]
    fn filters_are_mitsubas() {
        let at = [0.0, 0.5, 1.0, 1.25, 1.75, 2.5];
        for (filter, values) in [
            (Filter::Mitchell { b: 1.0 / 3.0, c: 1.0 / 3.0 }, [0.88889, 0.53472, 0.05556, -0.02344, -0.01476, 0.0]),
            (Filter::Mitchell { b: 0.2, c: 0.6 }, [0.93333, 0.57083, 0.03333, -0.07031, -0.0276, 0.0]),
            (Filter::CatmullRom, [1.0, 0.5625, 0.0, -0.07031, -0.02344, 0.0]),
            (Filter::Lanczos { lobes: 3.0 }, [1.0, 0.60793, 0.0, -0.13287, -0.06779, 0.02432]),
        ] {
            for (x, value) in at.into_iter().zip(values) {
                assert!((evaluate(filter, x) - value).abs() < 1e-5, "{filter:?} at {x}: {}", evaluate(filter, x));
            }
        }
    }
}
