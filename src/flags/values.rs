//! The values of flags: each read from text once, refused with what would be right.

use clap::ValueEnum;
use std::ops::Range;
use std::time::Duration;
use tilecast_core::bvh::simd::Isa;
use tilecast_core::settings::{FILM_SIDE_MAX, IntegratorKind, Offsets, SamplerKind, Strategy, Window, Without};

#[derive(Clone, Copy, ValueEnum)]
pub enum IntegratorName {
    /// All light transport
    Path,
    /// Light scattered once
    Direct,
    /// Direct light, and perfect reflection and refraction followed
    Whitted,
}

#[derive(Clone, Copy, ValueEnum)]
pub enum StrategyName {
    /// Uniform over the hemisphere
    Uniform,
    /// By the cosine
    Cosine,
    /// By the material
    Bsdf,
    /// Points on lights
    Light,
    /// Lights and material joined by multiple importance sampling
    Mis,
}

#[derive(Clone, Copy, ValueEnum)]
pub enum SamplerName {
    /// Owen-scrambled Sobol' points
    Sobol,
    /// Likewise, those of one surface in seven dimensions
    SobolJoint,
    /// Likewise, in an order that makes the error of neighbouring pixels differ
    SobolZ,
    /// Every number independent
    Independent,
}

#[derive(Clone, Copy, ValueEnum)]
pub enum OffsetsName {
    /// Just outside the rounding error of their starts
    Exact,
    /// Where Mitsuba 3 starts them, so that relief below half a millimetre in a room of metres casts no shadow
    Mitsuba,
}

#[derive(Clone, Copy, ValueEnum)]
pub enum SavingName {
    /// Four samples of direct light a path, under the integrator `direct`
    Splitting,
    /// Roulette from the second surface on
    EarlyRoulette,
    /// Not tracing a path's last ray where no light lies on it
    BlindEnds,
    /// Paths that count for neighbouring pixels, too, where a pilot finds that it pays
    PathReuse,
    /// Choosing directions to an environment map by the cosine at the surface as well
    EnvironmentCosine,
}

/// These switched off.
pub fn without(names: &[SavingName]) -> Without {
    let mut without = Without::default();
    for name in names {
        match name {
            SavingName::Splitting => without.splitting = true,
            SavingName::EarlyRoulette => without.early_roulette = true,
            SavingName::BlindEnds => without.blind_ends = true,
            SavingName::PathReuse => without.path_reuse = true,
            SavingName::EnvironmentCosine => without.environment_cosine = true,
        }
    }
    without
}

impl From<IntegratorName> for IntegratorKind {
    fn from(name: IntegratorName) -> Self {
        match name {
            IntegratorName::Path => Self::Path,
            IntegratorName::Direct => Self::Direct,
            IntegratorName::Whitted => Self::Whitted,
        }
    }
}

impl From<StrategyName> for Strategy {
    fn from(name: StrategyName) -> Self {
        match name {
            StrategyName::Uniform => Self::Uniform,
            StrategyName::Cosine => Self::Cosine,
            StrategyName::Bsdf => Self::Bsdf,
            StrategyName::Light => Self::Light,
            StrategyName::Mis => Self::Mis,
        }
    }
}

impl From<SamplerName> for SamplerKind {
    fn from(name: SamplerName) -> Self {
        match name {
            SamplerName::Sobol => Self::Sobol,
            SamplerName::SobolJoint => Self::SobolJoint,
            SamplerName::SobolZ => Self::SobolZ,
            SamplerName::Independent => Self::Independent,
        }
    }
}

impl From<OffsetsName> for Offsets {
    fn from(name: OffsetsName) -> Self {
        match name {
            OffsetsName::Exact => Self::Exact,
            OffsetsName::Mitsuba => Self::Mitsuba,
        }
    }
}

/// Longest path, or none. A struct, since clap gives `Option<Option<T>>` a meaning of its own.
#[derive(Clone, Copy)]
pub struct MaxDepth(pub Option<u32>);

/// `-1` or at least 1.
pub fn max_depth(text: &str) -> Result<MaxDepth, String> {
    match text.parse() {
        Ok(-1) => Ok(MaxDepth(None)),
        Ok(depth @ 1..) => u32::try_from(depth).map(|depth| MaxDepth(Some(depth))).map_err(|e| e.to_string()),
        Ok(0) => Err("0 sees nothing; 1 sees emitters, 2 direct light, -1 everything".into()),
        Ok::<i64, _>(_) | Err(_) => Err("write a number from 1, or -1 for no limit".into()),
    }
}

/// `A..B`, not empty.
pub fn samples(text: &str) -> Result<Range<u32>, String> {
    let parsed = text.split_once("..").and_then(|(a, b)| Some(a.parse().ok()?..b.parse().ok()?));
    parsed.filter(|range| !range.is_empty()).ok_or_else(|| "write A..B with A below B, such as 0..4096".into())
}

/// A relative error, above 0 and below 1.
pub fn error(text: &str) -> Result<f32, String> {
    let parsed: Option<f32> = text.parse().ok();
    parsed
        .filter(|error| *error > 0.0 && *error < 1.0)
        .ok_or_else(|| "write a number between 0 and 1: 0.02 is 2 %".into())
}

/// `NAME=VALUE`.
pub fn define(text: &str) -> Result<(String, String), String> {
    match text.split_once('=') {
        Some((name, value)) if !name.is_empty() => Ok((name.to_owned(), value.to_owned())),
        _ => Err("write NAME=VALUE".into()),
    }
}

/// `WxH`.
pub fn size(text: &str) -> Result<[u32; 2], String> {
    let sides = text.split_once(['x', 'X', '×']).and_then(|(w, h)| Some([w.parse().ok()?, h.parse().ok()?]));
    match sides {
        Some(sides) if sides.iter().all(|side| (1..=FILM_SIDE_MAX).contains(side)) => Ok(sides),
        Some(_) => Err(format!("each side must have 1 to {FILM_SIDE_MAX} pixels")),
        None => Err(format!("write WIDTHxHEIGHT in pixels, each from 1 to {FILM_SIDE_MAX}, as in 640x480")),
    }
}

/// `X0,Y0,X1,Y1`.
pub fn crop(text: &str) -> Result<Window, String> {
    let corners: Option<Vec<u32>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
    match corners.as_deref() {
        Some(&[x0, y0, x1, y1]) if x0 < x1 && y0 < y1 => Ok(Window { x0, y0, x1, y1 }),
        Some([_, _, _, _]) => Err("the window is empty: X0 < X1 and Y0 < Y1 must hold".into()),
        _ => Err("write X0,Y0,X1,Y1 in pixels, as in 100,100,164,164".into()),
    }
}

/// `X,Y`.
pub fn pixel(text: &str) -> Result<[u32; 2], String> {
    let position = text.split_once(',').and_then(|(x, y)| Some([x.trim().parse().ok()?, y.trim().parse().ok()?]));
    position.ok_or_else(|| "write X,Y in pixels, as in 12,34".into())
}

/// An instruction set of this processor.
pub fn isa(name: &str) -> Result<Isa, String> {
    let names = |isas: &[Isa]| isas.iter().map(|isa| isa.name()).collect::<Vec<_>>().join(", ");
    match Isa::from_name(name) {
        Some(isa) if isa.is_available() => Ok(isa),
        Some(_) => Err(format!("this processor has {} only", names(&Isa::available()))),
        None => Err(format!("'{name}' is none of {}", names(&Isa::ALL))),
    }
}

/// A share, from 0 to 1.
pub fn share(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(share) if (0.0..=1.0).contains(&share) => Ok(share),
        _ => Err("write a share from 0 to 1, as in 0.05".into()),
    }
}

/// A time: a number of seconds, or with a unit.
pub fn time(text: &str) -> Result<Duration, String> {
    let split = text.find(|c: char| !c.is_ascii_digit()).unwrap_or(text.len());
    let (number, unit) = text.split_at(split);
    let seconds = match unit {
        "" | "s" => Some(1),
        "m" => Some(60),
        "h" => Some(3600),
        "d" => Some(86_400),
        _ => None,
    };
    let product = seconds.and_then(|seconds: u64| number.parse::<u64>().ok()?.checked_mul(seconds));
    product.filter(|&s| s > 0).map(Duration::from_secs).ok_or("write a time as in 90s, 30m, 4h or 2d".into())
}

/// Where the viewer tev listens.
pub fn tev(text: &str) -> Result<String, String> {
    match text.rsplit_once(':') {
        Some((host, port)) if !host.is_empty() && port.parse::<u16>().is_ok() => Ok(text.to_owned()),
        None if !text.is_empty() => Ok(format!("{text}:{}", tilecast_coordinator::tev::PORT)),
        _ => Err("write HOST or HOST:PORT".into()),
    }
}

/// Where a collector of traces listens, as an address of gRPC.
pub fn otlp(text: &str) -> Result<String, String> {
    let host = match text.split_once("://") {
        None => text,
        Some(("http", host)) => host.trim_end_matches('/'),
        Some(_) => return Err("write HOST, HOST:PORT or http://HOST:PORT; for TLS run a collector beside it".into()),
    };
    match host.rsplit_once(':') {
        Some((name, port)) if !name.is_empty() && port.parse::<u16>().is_ok() => Ok(format!("http://{host}")),
        None if !host.is_empty() => Ok(format!("http://{host}:{}", tilecast_coordinator::otlp::PORT)),
        _ => Err("write HOST, HOST:PORT or http://HOST:PORT".into()),
    }
}
