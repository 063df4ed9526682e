//! Integrators: what is estimated.

use super::Loader;
use super::document::{ObjectId, Span};
use super::plugins::{Build, Plugin, Takes, parameter, unmodelled};
use super::properties::Properties;
use crate::load::error::Result;
use crate::settings::{Film, Integrator, IntegratorKind, SamplerKind, Settings, Strategy, Without};

/// What a scene file says of how radiance is estimated.
#[derive(Clone, Copy)]
pub(crate) struct Estimator {
    integrator: Integrator,
    strategy: Strategy,
}

const MAX_DEPTH: super::Parameter = parameter(
    "max_depth",
    Takes::Integer(Some(-1)),
    "Longest path in segments; 1 is emitters alone, 2 direct light, -1 no limit.",
);
const RR_DEPTH: super::Parameter =
    parameter("rr_depth", Takes::Integer(Some(5)), "Depth from which on paths may end by Russian roulette.");
const HIDE_EMITTERS: super::Parameter =
    parameter("hide_emitters", Takes::Boolean(false), "Whether the camera itself sees no emitters.");

const SAMPLES_PER_PASS: super::Parameter =
    unmodelled("samples_per_pass", Takes::Integer(None), "tilecast plans passes itself");
const BLOCK_SIZE: super::Parameter =
    unmodelled("block_size", Takes::Integer(None), "the size of tiles is a setting of the renderer, not of the scene");
const TIMEOUT: super::Parameter = unmodelled("timeout", Takes::Float(None), "all samples are taken");

pub(crate) const PLUGINS: &[Plugin] = &[
    Plugin {
        name: "path",
        doc: "All light transport, by path tracing.",
        parameters: &[MAX_DEPTH, RR_DEPTH, HIDE_EMITTERS, SAMPLES_PER_PASS, BLOCK_SIZE, TIMEOUT],
        build: Build::Integrator(path),
    },
    Plugin {
        name: "direct",
        doc: "Emission and light scattered once.",
        parameters: &[
            HIDE_EMITTERS,
            SAMPLES_PER_PASS,
            BLOCK_SIZE,
            TIMEOUT,
            unmodelled(
                "shading_samples",
                Takes::Integer(Some(1)),
                "tilecast takes four of both, whatever the number; give more samples a pixel instead",
            ),
            unmodelled(
                "emitter_samples",
                Takes::Integer(Some(1)),
                "tilecast takes four light samples, or none for 0; give more samples a pixel instead",
            ),
            unmodelled(
                "bsdf_samples",
                Takes::Integer(Some(1)),
                "tilecast takes four BSDF samples, or none for 0; give more samples a pixel instead",
            ),
        ],
        build: Build::Integrator(direct),
    },
    Plugin {
        name: "whitted",
        doc: "Classic ray tracing (tilecast's own): direct light, perfect reflection and refraction.",
        parameters: &[MAX_DEPTH, HIDE_EMITTERS],
        build: Build::Integrator(whitted),
    },
];

impl Loader<'_> {
    /// The scene's integrator; without one, `path`.
    pub fn integrator(&mut self, found: &[(ObjectId, &Span)]) -> Result<Estimator> {
        let &[(id, _)] = found else {
            return match found.get(1) {
                Some((_, span)) => {
                    Err(self.document.error(span, "a scene can have only one integrator; keep one of them"))
                }
                None => {
                    self.assembly.note(None, "the scene names no integrator; it is rendered with 'path'");
                    Ok(Estimator::new(IntegratorKind::Path))
                }
            };
        };
        let document = self.document;
        self.made.insert(id);
        let properties = Properties::new(document, id, &mut self.assembly.notes)?;
        match properties.plugin.build {
            Build::Integrator(build) => build(self, &properties),
            _ => Err(super::misplaced(&properties)),
        }
    }
}

impl Estimator {
    fn new(kind: IntegratorKind) -> Self {
        let integrator = Integrator { kind, max_depth: None, rr_depth: 5, hide_emitters: false };
        Self { integrator, strategy: Strategy::Mis }
    }

    /// With film and samples these are all settings but the film's scale, which depends on the scene.
    pub fn settings(self, film: Film, spp: u32) -> Settings {
        Settings {
            film,
            spp,
            seed: 0,
            integrator: self.integrator,
            strategy: self.strategy,
            sampler: SamplerKind::Sobol,
            without: Without::default(),
            half: Default::default(),
            offsets: Default::default(),
            scale_exponent: 0,
        }
    }
}

fn path(_: &mut Loader, properties: &Properties) -> Result<Estimator> {
    let mut estimator = Estimator::new(IntegratorKind::Path);
    estimator.integrator.max_depth = max_depth(properties)?;
    estimator.integrator.rr_depth = properties.count("rr_depth", 1)?;
    estimator.integrator.hide_emitters = properties.boolean("hide_emitters");
    Ok(estimator)
}

fn whitted(_: &mut Loader, properties: &Properties) -> Result<Estimator> {
    let mut estimator = Estimator::new(IntegratorKind::Whitted);
    estimator.integrator.max_depth = max_depth(properties)?;
    estimator.integrator.hide_emitters = properties.boolean("hide_emitters");
    Ok(estimator)
}

fn direct(_: &mut Loader, properties: &Properties) -> Result<Estimator> {
    let mut estimator = Estimator::new(IntegratorKind::Direct);
    estimator.integrator.hide_emitters = properties.boolean("hide_emitters");
    let shared = properties.count("shading_samples", 0)?;
    let samples = |name: &str| match properties.get(name) {
        Some(_) => properties.count(name, 0),
        None => Ok(shared),
    };
    estimator.strategy = match (samples("emitter_samples")?, samples("bsdf_samples")?) {
        (0, 0) => {
            return Err(properties
                .wrong("bsdf_samples", "without emitter samples and BSDF samples nothing is seen; ask for one"));
        }
        (0, _) => Strategy::Bsdf,
        (_, 0) => Strategy::Light,
        _ => Strategy::Mis,
    };
    Ok(estimator)
}

/// −1 is no limit.
fn max_depth(properties: &Properties) -> Result<Option<u32>> {
    match properties.integer("max_depth")? {
        -1 => Ok(None),
        _ => match properties.count("max_depth", 1) {
            Ok(depth) => Ok(Some(depth)),
            Err(_) => {
                let message = "'max_depth' must be -1 for no limit, or at least 1; 1 sees emitters, 2 direct light";
                Err(properties.wrong("max_depth", message))
            }
        },
    }
}
