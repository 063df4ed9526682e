//! Settings, to and from the wire.

use super::{WireError, window};
use crate::wire;
use tilecast_core::settings::{
    FILM_SIDE_MAX, Film, Filter, Half, Integrator, IntegratorKind, Offsets, SamplerKind, Settings, Strategy, Without,
};

impl From<&Settings> for wire::Settings {
    fn from(settings: &Settings) -> Self {
        let Film { width, height, crop, filter } = settings.film;
        let Integrator { kind, max_depth, rr_depth, hide_emitters } = settings.integrator;
        let filter = match filter {
            Filter::Box => wire::filter::Kind::Box(wire::BoxFilter {}),
            Filter::Tent { radius } => wire::filter::Kind::Tent(wire::TentFilter { radius }),
            Filter::Gaussian { stddev } => wire::filter::Kind::Gaussian(wire::GaussianFilter { stddev }),
            Filter::Mitchell { b, c } => wire::filter::Kind::Mitchell(wire::MitchellFilter { b, c }),
            Filter::CatmullRom => wire::filter::Kind::CatmullRom(wire::CatmullRomFilter {}),
            Filter::Lanczos { lobes } => wire::filter::Kind::Lanczos(wire::LanczosFilter { lobes }),
        };
        let kind = match kind {
            IntegratorKind::Path => wire::IntegratorKind::Path,
            IntegratorKind::Direct => wire::IntegratorKind::Direct,
            IntegratorKind::Whitted => wire::IntegratorKind::Whitted,
        };
        let strategy = match settings.strategy {
            Strategy::Uniform => wire::Strategy::Uniform,
            Strategy::Cosine => wire::Strategy::Cosine,
            Strategy::Bsdf => wire::Strategy::Bsdf,
            Strategy::Light => wire::Strategy::Light,
            Strategy::Mis => wire::Strategy::Mis,
        };
        let sampler = match settings.sampler {
            SamplerKind::Independent => wire::Sampler::Independent,
            SamplerKind::Sobol => wire::Sampler::Sobol,
            SamplerKind::SobolJoint => wire::Sampler::SobolJoint,
            SamplerKind::SobolZ => wire::Sampler::SobolZ,
        };
        let half = match settings.half {
            Half::Both => wire::Half::Both,
            Half::First => wire::Half::First,
            Half::Second => wire::Half::Second,
        };
        let offsets = match settings.offsets {
            Offsets::Exact => wire::Offsets::Exact,
            Offsets::Mitsuba => wire::Offsets::Mitsuba,
        };
        let Without { splitting, early_roulette, blind_ends, path_reuse, environment_cosine } = settings.without;
        Self {
            width,
            height,
            crop: Some(crop.into()),
            filter: Some(wire::Filter { kind: Some(filter) }),
            spp: settings.spp,
            seed: settings.seed,
            integrator: Some(wire::Integrator { kind: kind.into(), max_depth, rr_depth, hide_emitters }),
            strategy: strategy.into(),
            sampler: sampler.into(),
            scale_exponent: settings.scale_exponent,
            half: half.into(),
            offsets: offsets.into(),
            without: Some(wire::Without { splitting, early_roulette, blind_ends, path_reuse, environment_cosine }),
        }
    }
}

impl TryFrom<wire::Settings> for Settings {
    type Error = WireError;

    fn try_from(message: wire::Settings) -> Result<Self, WireError> {
        let integrator = message.integrator.ok_or(WireError::Missing("settings.integrator"))?;
        let filter = message.filter.and_then(|f| f.kind).ok_or(WireError::Missing("settings.filter"))?;
        let settings = Settings {
            film: Film {
                width: message.width,
                height: message.height,
                crop: window(message.crop, FILM_SIDE_MAX, "settings.crop")?,
                filter: match filter {
                    wire::filter::Kind::Box(_) => Filter::Box,
                    wire::filter::Kind::Tent(tent) => Filter::Tent { radius: tent.radius },
                    wire::filter::Kind::Gaussian(gaussian) => Filter::Gaussian { stddev: gaussian.stddev },
                    wire::filter::Kind::Mitchell(wire::MitchellFilter { b, c }) => Filter::Mitchell { b, c },
                    wire::filter::Kind::CatmullRom(_) => Filter::CatmullRom,
                    wire::filter::Kind::Lanczos(lanczos) => Filter::Lanczos { lobes: lanczos.lobes },
                },
            },
            spp: message.spp,
            seed: message.seed,
            integrator: Integrator {
                kind: integrator_kind(integrator.kind)?,
                max_depth: integrator.max_depth,
                rr_depth: integrator.rr_depth,
                hide_emitters: integrator.hide_emitters,
            },
            strategy: strategy(message.strategy)?,
            sampler: sampler(message.sampler)?,
            without: message.without.map_or_else(Without::default, |wire| Without {
                splitting: wire.splitting,
                early_roulette: wire.early_roulette,
                blind_ends: wire.blind_ends,
                path_reuse: wire.path_reuse,
                environment_cosine: wire.environment_cosine,
            }),
            half: half(message.half)?,
            offsets: offsets(message.offsets)?,
            scale_exponent: message.scale_exponent,
        };
        settings.validate()?;
        Ok(settings)
    }
}

fn integrator_kind(value: i32) -> Result<IntegratorKind, WireError> {
    match wire::IntegratorKind::try_from(value) {
        Ok(wire::IntegratorKind::Path) => Ok(IntegratorKind::Path),
        Ok(wire::IntegratorKind::Direct) => Ok(IntegratorKind::Direct),
        Ok(wire::IntegratorKind::Whitted) => Ok(IntegratorKind::Whitted),
        Ok(wire::IntegratorKind::Unspecified) | Err(_) => {
            Err(WireError::Enum { field: "settings.integrator.kind", value })
        }
    }
}

fn strategy(value: i32) -> Result<Strategy, WireError> {
    match wire::Strategy::try_from(value) {
        Ok(wire::Strategy::Uniform) => Ok(Strategy::Uniform),
        Ok(wire::Strategy::Cosine) => Ok(Strategy::Cosine),
        Ok(wire::Strategy::Bsdf) => Ok(Strategy::Bsdf),
        Ok(wire::Strategy::Light) => Ok(Strategy::Light),
        Ok(wire::Strategy::Mis) => Ok(Strategy::Mis),
        Ok(wire::Strategy::Unspecified) | Err(_) => Err(WireError::Enum { field: "settings.strategy", value }),
    }
}

fn half(value: i32) -> Result<Half, WireError> {
    match wire::Half::try_from(value) {
        Ok(wire::Half::Both) => Ok(Half::Both),
        Ok(wire::Half::First) => Ok(Half::First),
        Ok(wire::Half::Second) => Ok(Half::Second),
        Ok(wire::Half::Unspecified) | Err(_) => Err(WireError::Enum { field: "settings.half", value }),
    }
}

fn offsets(value: i32) -> Result<Offsets, WireError> {
    match wire::Offsets::try_from(value) {
        Ok(wire::Offsets::Exact) => Ok(Offsets::Exact),
        Ok(wire::Offsets::Mitsuba) => Ok(Offsets::Mitsuba),
        Ok(wire::Offsets::Unspecified) | Err(_) => Err(WireError::Enum { field: "settings.offsets", value }),
    }
}

fn sampler(value: i32) -> Result<SamplerKind, WireError> {
    match wire::Sampler::try_from(value) {
        Ok(wire::Sampler::Independent) => Ok(SamplerKind::Independent),
        Ok(wire::Sampler::Sobol) => Ok(SamplerKind::Sobol),
        Ok(wire::Sampler::SobolJoint) => Ok(SamplerKind::SobolJoint),
        Ok(wire::Sampler::SobolZ) => Ok(SamplerKind::SobolZ),
        Ok(wire::Sampler::Unspecified) | Err(_) => Err(WireError::Enum { field: "settings.sampler", value }),
    }
}
