//! Sums do not stall, and need no order.

use crate::build::{long, settings};
use glam::Vec3;
use proptest::prelude::*;
use tilecast_core::film::{self, Film, PixelSums, REPLICATES, TileSums};
use tilecast_core::settings::{Settings, Strategy as Directions, Window};

fn one_pixel(brightest: f32) -> Settings {
    Settings { scale_exponent: film::scale_exponent(brightest), ..settings(1, 4, Directions::Mis) }
}

/// The sums of so many samples of a value, alike in all replicates: each made by doubling, which is what merging does.
fn repeated(value: f32, count: u32, scale_exponent: i32) -> TileSums {
    let mut twice = PixelSums::default();
    (0..REPLICATES as u32).for_each(|i| twice.add(i, Vec3::splat(value), scale_exponent).unwrap());
    let mut sums = TileSums::new(Window { x0: 0, y0: 0, x1: 1, y1: 1 }, 0..count);
    let mut left = count / REPLICATES as u32;
    while left > 0 {
        if left & 1 == 1 {
            sums.pixels[0].merge(&twice);
        }
        twice.merge(&twice.clone());
        left >>= 1;
    }
    sums
}

/// A billion samples of v have the mean v, to the bit, and no variance, for v from 10^-12 to 1 times the brightest radiance. Added one
/// by one in the long form; a million of them in the short one. Seen to fail for sums in f32, which stall at 2^24 times v.
#[test]
fn a_billion_samples_do_not_stall() {
    for brightest in [1e-12f32, 1e-3, 1.0, 1e12] {
        for share in [1e-12f32, 3.3e-9, 1.7e-5, 0.3, 1.0] {
            let (value, settings) = (brightest * share, one_pixel(brightest));
            let check = |sums: &TileSums| {
                let mut film = Film::new(&settings);
                film.merge(sums);
                let estimate = film.estimate(0, 0);
                assert_eq!(estimate.mean, [value; 3], "{} samples of {value} beside {brightest}", sums.samples.end);
                assert_eq!(estimate.variance, [0.0; 3]);
                assert!(sums.check());
            };
            check(&repeated(value, 1_000_000_000, settings.scale_exponent));
            let singly = if long() { 1_000_000_000 } else { 1_000_000 };
            let mut sums = TileSums::new(settings.film.crop, 0..singly);
            (0..singly).for_each(|i| sums.pixels[0].add(i, Vec3::splat(value), settings.scale_exponent).unwrap());
            check(&sums);
            assert_eq!(sums, repeated(value, singly, settings.scale_exponent));
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(if long() { 10_000 } else { 200 }))]

    /// Samples of all magnitudes, cut into units anyhow, merged in any order into any number of films which are joined in any order:
    /// equal bits. Seen to fail for sums in f32 and in f64.
    #[test]
    fn merging_needs_no_order_and_no_grouping(
        values in prop::collection::vec((-1f32..1.0, -40i32..1), 64),
        cuts in prop::collection::btree_set(1u32..63, 0..12),
        order in Just((0..64usize).collect::<Vec<_>>()).prop_shuffle(),
        groups in 1usize..6,
    ) {
        let settings = one_pixel(1.0);
        let unit = |range: std::ops::Range<u32>| {
            let mut unit = TileSums::new(settings.film.crop, range.clone());
            for i in range {
                let (mantissa, exponent) = values[i as usize];
                unit.pixels[0].add(i, Vec3::splat(libm::ldexpf(mantissa, exponent)), settings.scale_exponent).unwrap();
            }
            unit
        };
        let mut whole = Film::new(&settings);
        whole.merge(&unit(0..64));
        let ends: Vec<u32> = [0].into_iter().chain(cuts).chain([64]).collect();
        let mut units: Vec<TileSums> = ends.windows(2).map(|w| unit(w[0]..w[1])).collect();
        units.sort_by_key(|unit| order[unit.samples.start as usize]);
        let mut films = vec![Film::new(&settings); groups];
        for unit in &units {
            films[order[unit.samples.start as usize] % groups].merge(unit);
        }
        let mut joined = Film::new(&settings);
        films.iter().rev().for_each(|film| joined.join(film));
        prop_assert_eq!(joined.digest(), whole.digest());
        prop_assert!(joined == whole);
    }
}
