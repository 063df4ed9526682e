//! Whether two ways to render have the same mean, pixel by pixel.

use rayon::prelude::*;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use tilecast_core::bvh::simd::Isa;
use tilecast_core::film::Film;
use tilecast_core::scene::Scene;
use tilecast_core::settings::Settings;
use tilecast_core::trace::Tracer;
use tilecast_core::world::World;

/// One block is the whole picture, so that the first surfaces that reuse each other's paths are far apart.
pub const SIDE: u32 = 4;
const VALUES: usize = (3 * SIDE * SIDE) as usize;
/// Renders that tell mean and spread.
const RENDERS: u64 = 16;

/// A way to render: the job, and whether paths are reused.
pub type Way = (Settings, bool);

/// A scene that looks alike in two ways.
pub struct Case {
    pub what: String,
    pub scene: Scene,
    pub ways: [Way; 2],
}

/// Every scene looks alike in its two ways, up to chance, and all of them together do.
pub fn all_look_alike(cases: impl Iterator<Item = Case>) {
    let (mut sum, mut count) = (0.0, 0.0);
    for Case { what, scene, ways } in cases {
        scene.validate().unwrap();
        let squares = difference(&what, &Arc::new(World::compile(&scene)), &ways);
        assert!(squares < 5.0, "{what}: z of {}", squares.sqrt());
        sum += squares;
        count += 1.0;
    }
    let mean = sum / count;
    assert!(mean < 1.35, "z² of {mean} on the average");
}

/// Mean of a few renders, with every other seed from `first` on, and the variance of that mean, by pixel and channel.
fn averaged(world: &Arc<World>, &(ref job, reuse): &Way, first: u64) -> Vec<[f64; 2]> {
    let never = AtomicBool::new(false);
    let renders: Vec<Vec<f64>> = (0..RENDERS)
        .into_par_iter()
        .map(|seed| {
            let job = Settings { seed: 2 * seed + first, ..job.clone() };
            let tracer = Tracer::with_reuse(world.clone(), job.clone(), Isa::detect(), reuse).unwrap();
            assert_eq!(tracer.reuses(), reuse);
            let mut film = Film::new(&job);
            film.merge(&tracer.trace(job.film.crop, 0..job.spp, &never).unwrap().unwrap());
            let pixels = (0..SIDE).flat_map(|y| (0..SIDE).map(move |x| (x, y)));
            pixels.flat_map(|(x, y)| film.estimate(x, y).mean.map(f64::from)).collect()
        })
        .collect();
    let n = RENDERS as f64;
    let of_value = |i: usize| {
        let mean = renders.iter().map(|values| values[i]).sum::<f64>() / n;
        let spread = renders.iter().map(|values| (values[i] - mean).powi(2)).sum::<f64>();
        [mean, spread / (n * (n - 1.0))]
    };
    (0..VALUES).map(of_value).collect()
}

/// The mean of z² over pixels and channels of renders in two ways, one if they differ by chance alone (and a little more since
/// variances are estimated). What chance does not touch must be the same.
pub fn difference(what: &str, world: &Arc<World>, [one, other]: &[Way; 2]) -> f64 {
    let (with, without) = (averaged(world, one, 0), averaged(world, other, 1));
    let mut squares = 0.0;
    for (i, ([a, va], [b, vb])) in with.into_iter().zip(without).enumerate() {
        // Rounding, where nothing else differs.
        let z = (a - b) / (va + vb + (1e-6 * (a + b)).powi(2) + 1e-30).sqrt();
        assert!(z.abs() < 9.0, "{what}, value {i}: {a} with, {b} without, z {z}");
        squares += z * z;
    }
    squares / VALUES as f64
}
