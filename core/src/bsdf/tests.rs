//! Truths about every model: sampling follows the density, densities integrate to one, energy is kept, light may go either
//! way, and values are Mitsuba's.

mod mitsuba;
mod models;

use super::*;
use crate::chi_square::{self, DRAWS};
use crate::scene::Distribution::{Beckmann, Ggx};
use crate::warp::{around_z, uniform_sphere};
use models::{checked_models, extreme_models, facets, models, rough_glass};
use rayon::prelude::*;
use std::f64::consts::PI;

fn is_principled(closure: &Closure) -> bool {
    matches!(closure, Closure::Principled(_) | Closure::PrincipledThin(_))
}

fn deltas() -> Vec<(&'static str, Closure<'static>)> {
    let one = Vec3::ONE;
    let glass = |eta| Closure::Dielectric(Dielectric { eta, specular_reflectance: one, specular_transmittance: one });
    let metal = Conductor { eta: Vec3::new(0.2, 0.9, 1.1), k: Vec3::new(3.9, 2.5, 2.1), specular_reflectance: one };
    vec![
        ("glass", glass(1.5)),
        ("water to air", glass(0.75)),
        ("nothing", glass(1.0)),
        ("metal", Closure::Conductor(metal)),
    ]
}

fn views() -> impl Iterator<Item = Vec3> {
    [0.02f32, 0.3, 0.8, 1.0].into_iter().map(|cos: f32| around_z(cos, 0.3))
}

/// Views from above, and from below for models that answer there.
fn views_of(model: &Closure) -> impl Iterator<Item = Vec3> {
    let below = model.transmits();
    views().chain(views().map(|w| -w).filter(move |_| below))
}

fn grid(n: u32) -> impl Iterator<Item = Vec2> {
    (0..n * n).map(move |i| (Vec2::new((i / n) as f32, (i % n) as f32) + 0.5) / n as f32)
}

/// Three random numbers.
fn numbers(i: u64) -> (f32, Vec2) {
    let hash = |salt: u64| (crate::sampler::mix64(i * 4 + salt) >> 40) as f32 / 16_777_216.0;
    (hash(0), Vec2::new(hash(1), hash(2)))
}

/// Counts of sampled directions over 20 × 20 cells of the sphere, of equal angles, against the density's integral, by
/// chi-square with 10^6 samples a case, Šidák-corrected over all cases. Fails for a lobe exponent off by one in `pdf`, or for
/// GGX's density without its bound. Left out is what the grid of the integral is too coarse for: the narrowest lobe, and the
/// thin sheet's edge seen from near the horizon (both pass with 256 points a side of a cell, in minutes).
#[test]
fn sampling_follows_the_density() {
    let models = models().into_iter().filter(|(name, _)| *name != "roughplastic ggx 0.05");
    let of_model = |(name, model): (&'static str, Closure<'static>)| {
        let least = if name == "principledthin" { 0.1 } else { 0.0 };
        let views: Vec<Vec3> = views_of(&model).filter(|wo| wo.z.abs() > least).collect();
        views.into_iter().map(move |wo| (name, model, wo))
    };
    let cases: Vec<_> = models.flat_map(of_model).collect();
    cases.par_iter().for_each(|(name, model, wo)| check_density(name, model, *wo, cases.len()));
}

fn check_density(name: &str, model: &Closure, wo: Vec3, cases: usize) {
    const SIDE: usize = 20;
    const FINE: u32 = 64;
    let mut counts = [0.0; SIDE * SIDE];
    let cell = |w: Vec3| {
        let part = |x: f32| ((x * SIDE as f32) as usize).min(SIDE - 1);
        let turn = (w.y.atan2(w.x) / std::f32::consts::TAU).rem_euclid(1.0);
        part(w.z.clamp(-1.0, 1.0).acos() / std::f32::consts::PI) * SIDE + part(turn)
    };
    let n = DRAWS;
    let mut others = 0u32;
    for i in 0..n {
        let (lobe, u) = numbers(i);
        match model.sample(wo, lobe, u) {
            Some(sample) if !sample.is_delta() => counts[cell(sample.wi)] += 1.0,
            _ => others += 1,
        }
    }
    let expected = (0..SIDE * SIDE).map(|i| {
        let (row, column) = ((i / SIDE) as f32, (i % SIDE) as f32);
        let density = |u: Vec2| {
            let (sin, cos) = (std::f32::consts::PI * (row + u.x) / SIDE as f32).sin_cos();
            f64::from(model.eval(wo, around_z(cos, (column + u.y) / SIDE as f32)).pdf * sin)
        };
        let area = 2.0 * PI * PI / (SIDE * SIDE) as f64;
        area * grid(FINE).map(density).sum::<f64>() / f64::from(FINE * FINE) * n as f64
    });
    let expected: Vec<f64> = expected.collect();
    if let Err(told) = chi_square::compare(&counts, &expected, cases) {
        panic!("{name} seen at {}: {told}", wo.z);
    }
    let mass = expected.iter().sum::<f64>() / n as f64;
    let lost = f64::from(others) / n as f64;
    assert!((mass + lost - 1.0).abs() < 0.003, "{name} seen at {}: mass {mass}, others {lost}", wo.z);
}

/// The rest is rounding: the facet is found again from two rounded directions.
#[test]
fn sampled_weights_are_those_of_the_evaluation() {
    for (name, model) in models() {
        for (wo, u) in views_of(&model).flat_map(|wo| grid(20).map(move |u| (wo, u))) {
            let Some(sample) = model.sample(wo, u.x, Vec2::new(u.y, u.x)).filter(|s| !s.is_delta()) else { continue };
            let Evaluation { value, pdf } = model.eval(wo, sample.wi);
            assert!((pdf - sample.pdf).abs() <= 1e-3 * pdf, "{name} at {wo}: {sample:?} {pdf}");
            let off = (sample.weight * pdf - value).abs().max_element();
            assert!(off <= 2e-3 * value.max_element() + 1e-6, "{name} at {wo}: {sample:?} {value} {pdf}");
        }
    }
}

/// f(wi, wo) n(wi)² = f(wo, wi) n(wo)²: Veach 1997, eq. 5.13. Not so through a clear thin sheet, where Mitsuba shows a facet
/// to one of the two directions alone.
#[test]
fn light_may_go_either_way() {
    for (name, model) in models().into_iter().filter(|(name, _)| *name != "principledthin") {
        let eta = match &model {
            Closure::RoughDielectric(model) => model.eta,
            Closure::Principled(model) => model.eta,
            _ => 1.0,
        };
        let index2 = |w: Vec3| if w.z < 0.0 && model.transmits() { eta * eta } else { 1.0 };
        for (wo, u) in views_of(&model).flat_map(|wo| grid(12).map(move |u| (wo, u))) {
            let cos = 0.05 + 0.9 * u.x;
            for wi in [around_z(cos, u.y), around_z(-cos, u.y)] {
                let there = model.eval(wo, wi).value / wi.z.abs() * index2(wi);
                let back = model.eval(wi, wo).value / wo.z.abs() * index2(wo);
                let off = (there - back).abs().max_element();
                assert!(off <= 1e-3 * there.max_element() + 1e-5, "{name} {wo} {wi}: {there} {back}");
            }
        }
    }
}

/// The mean weight of samples, as power: refraction's weight carries the radiance scale 1/η², which is undone.
fn albedo(model: &Closure, wo: Vec3) -> f64 {
    let n = 40_000;
    let weights = (0..n).filter_map(|i| {
        let (lobe, u) = numbers(i);
        model.sample(wo, lobe, u).map(|s| f64::from(s.weight.max_element() * s.eta * s.eta))
    });
    weights.sum::<f64>() / n as f64
}

/// The principled models are exempt: Burley's diffuse part does not give up what the specular one takes.
#[test]
fn no_energy_is_made() {
    for (name, model) in models().into_iter().filter(|(_, model)| !is_principled(model)) {
        for wo in views_of(&model) {
            let albedo = albedo(&model, wo);
            assert!(albedo <= 1.0 + 5e-3, "{name} seen at {}: {albedo}", wo.z);
        }
    }
}

/// What mirrors and clear glass do not return is the light that would meet a second facet: nothing for smooth ones, and much
/// for rough ones, as single scattering has it (GGX at α = 1 keeps 31% of what comes straight down).
#[test]
fn lossless_facets_lose_only_what_is_scattered_twice() {
    for distribution in [Ggx, Beckmann] {
        for (alpha, least) in [(1e-4, 0.9995), (1e-3, 0.9995), (0.01, 0.993), (0.1, 0.84), (0.5, 0.6), (1.0, 0.3)] {
            let mirror = Closure::RoughConductor(RoughConductor {
                facets: facets(distribution, alpha, alpha),
                eta: Vec3::ZERO,
                k: Vec3::ONE,
                specular_reflectance: Vec3::ONE,
            });
            let glass = Closure::RoughDielectric(rough_glass(distribution, alpha, alpha, 1.5));
            for (model, sides) in [(mirror, &[1.0][..]), (glass, &[1.0, -1.0][..])] {
                for wo in sides.iter().flat_map(|side| [1.0, 0.5, 0.1].map(|cos| around_z(cos, 0.1) * *side)) {
                    let kept = albedo(&model, wo);
                    assert!(kept > least && kept < 1.002, "{distribution:?} {alpha} seen at {}: {kept}", wo.z);
                }
            }
        }
    }
}

/// A white furnace: what loses nothing by its model gives all of it back, at every angle and from either side. (Diffuse light
/// that a coat holds back comes out in the end, where `nonlinear` counts it in; how much it holds back is Mitsuba's fit, which is
/// a hundredth off for diamond.)
#[test]
fn lossless_models_give_everything_back() {
    let one = Vec3::ONE;
    let mirror = Conductor { eta: Vec3::ZERO, k: one, specular_reflectance: one };
    let pane = |eta| ThinDielectric { eta, specular_reflectance: one, specular_transmittance: one };
    let glass = |eta| Dielectric { eta, specular_reflectance: one, specular_transmittance: one };
    let models = [
        ("diffuse", Closure::Diffuse(Diffuse { reflectance: one }), 1e-5),
        ("mirror", Closure::Conductor(mirror), 1e-5),
        ("null", Closure::Null, 1e-5),
        ("glass", Closure::Dielectric(glass(1.5)), 1e-3),
        ("out of glass", Closure::Dielectric(glass(1.0 / 1.5)), 1e-3),
        ("pane", Closure::ThinDielectric(pane(1.5)), 1e-3),
        ("plastic", Closure::Plastic(Plastic::new(1.5, true, one, one)), 5e-3),
        ("plastic of diamond", Closure::Plastic(Plastic::new(2.4, true, one, one)), 3e-2),
    ];
    for (name, model, tolerance) in models {
        for cos in [0.02f32, 0.1, 0.3, 0.5, 0.8, 1.0] {
            for wo in [1.0, -1.0]
                .map(|side| around_z(cos, 0.3) * side)
                .into_iter()
                .filter(|wo| wo.z > 0.0 || model.transmits())
            {
                let kept = albedo(&model, wo);
                assert!((kept - 1.0).abs() < tolerance, "{name} seen at {}: {kept}", wo.z);
            }
        }
    }
}

/// Mitsuba computes in f32 with fused operations; 10^-4 is what differing roundings explain. For rough plastic both
/// tabulate integrals, each by its own quadrature: 10^-3.
#[test]
fn values_are_those_of_mitsuba() {
    let direction = |[theta, phi]: [f64; 2]| {
        let ((sin_theta, cos_theta), (sin, cos)) = (theta.to_radians().sin_cos(), phi.to_radians().sin_cos());
        Vec3::new((sin_theta * cos) as f32, (sin_theta * sin) as f32, cos_theta as f32)
    };
    let models = checked_models();
    assert_eq!(models.len(), mitsuba::VALUES.len());
    for ((name, model), (their_name, values)) in models.iter().zip(mitsuba::VALUES) {
        assert_eq!(name, their_name);
        let tolerance = if matches!(model, Closure::RoughPlastic(_)) { 1e-3 } else { 1e-4 };
        for ((wo, wi), theirs) in mitsuba::ANGLES.iter().zip(values) {
            let ours = model.eval(direction(*wo), direction(*wi)).value;
            let theirs = Vec3::from_array(*theirs);
            let off = (ours - theirs).abs().max_element();
            assert!(off <= tolerance * theirs.max_element() + 1e-9, "{name} {wo:?} {wi:?}: {ours}, Mitsuba {theirs}");
        }
    }
}

/// Extreme roughnesses, indices, angles and random numbers give finite, non-negative weights and unit directions.
#[test]
fn nothing_breaks_at_the_edges() {
    let edge = |i: u64| [0.0, f32::EPSILON, 0.25, 0.5, 0.999, 1.0 - f32::EPSILON / 2.0][i as usize % 6];
    extreme_models().par_iter().for_each(|(name, model)| {
        for cos in [0.0f32, 1e-30, 1e-6, 1e-3, 0.1, 0.5, 0.99999, 1.0] {
            for wo in [around_z(cos, 0.0), around_z(cos, 0.37), around_z(-cos, 0.77)] {
                let edges = (0..216u64).map(|i| (edge(i), Vec2::new(edge(i / 6), edge(i / 36))));
                for (lobe, u) in edges.chain((0..1000).map(numbers)) {
                    check_sample(name, model, wo, lobe, u);
                }
            }
        }
    });
}

fn check_sample(name: &str, model: &Closure, wo: Vec3, lobe: f32, u: Vec2) {
    let fine = |v: Vec3| v.is_finite() && v.min_element() >= 0.0;
    if let Some(sample) = model.sample(wo, lobe, u) {
        assert!(fine(sample.weight) && sample.pdf > 0.0, "{name} {wo} {lobe} {u}: {sample:?}");
        assert!((sample.wi.length() - 1.0).abs() < 1e-4, "{name} {wo} {lobe} {u}: {sample:?}");
        // A facet never gives back more than it gets; mixtures may, by the ratio of their densities.
        let power = sample.weight.max_element() * sample.eta * sample.eta;
        let single = matches!(model, Closure::RoughConductor(_) | Closure::RoughDielectric(_));
        assert!(!single || power <= 1.02, "{name} {wo} {lobe} {u}: {sample:?}");
        let Evaluation { value, pdf } = model.eval(wo, sample.wi);
        assert!(fine(value) && pdf >= 0.0 && pdf.is_finite(), "{name} {wo} {}: {value} {pdf}", sample.wi);
    }
    let wi = uniform_sphere(u);
    let Evaluation { value, pdf } = model.eval(wo, wi);
    assert!(fine(value) && pdf >= 0.0 && pdf.is_finite(), "{name} {wo} {wi}: {value} {pdf}");
}

/// What glass reflects and refracts adds up to one (refraction's weight carries the radiance scale 1/η²), and refraction is
/// reversible: it leads back along the same line.
#[test]
fn glass_keeps_energy_and_is_reversible() {
    for (name, model) in deltas().into_iter().filter(|(name, _)| *name != "metal") {
        for wo in views().flat_map(|w| [w, -w]) {
            let reflected = model.sample(wo, 0.0, Vec2::ZERO).unwrap();
            let refracted = model.sample(wo, 1.0 - f32::EPSILON, Vec2::ZERO).unwrap();
            for sample in [reflected, refracted] {
                let power = sample.weight.x * sample.eta * sample.eta;
                assert!((power - 1.0).abs() < 1e-5, "{name}: {sample:?}");
                assert!((sample.wi.length() - 1.0).abs() < 1e-5);
            }
            if refracted.wi.z * wo.z < 0.0 {
                let back = model.sample(refracted.wi, 1.0 - f32::EPSILON, Vec2::ZERO).unwrap();
                assert!((back.wi - wo).length() < 2e-3, "{name}: {wo} came back as {}", back.wi);
            }
        }
    }
}

/// Normal incidence: ((n−1)² + k²) / ((n+1)² + k²), and everything at grazing.
#[test]
fn metal_reflects_as_fresnel_says() {
    let Closure::Conductor(metal) = deltas()[3].1 else { unreachable!() };
    let at = |wo: Vec3| metal.sample(wo).unwrap().weight;
    let one = Vec3::ONE;
    let squared = |v: Vec3| v * v;
    let expected = (squared(metal.eta - one) + squared(metal.k)) / (squared(metal.eta + one) + squared(metal.k));
    assert!((at(Vec3::Z) - expected).abs().max_element() < 1e-5);
    assert!(at(around_z(1e-4, 0.0)).min_element() > 0.995);
}
