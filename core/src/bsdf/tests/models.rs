//! The models under test, with their parameters.

use super::super::*;
use crate::scene::Distribution::{self, Beckmann, Ggx};

pub const GLASS: f32 = 1.5046 / 1.000277;
pub const PLASTIC: f32 = 1.49 / 1.000277;

pub fn grey(x: f32) -> Vec3 {
    Vec3::splat(x)
}

pub fn facets(distribution: Distribution, u: f32, v: f32) -> Microfacet {
    Microfacet::new(distribution, Vec2::new(u, v))
}

pub fn gold(distribution: Distribution, u: f32, v: f32) -> RoughConductor {
    RoughConductor {
        facets: facets(distribution, u, v),
        eta: Vec3::new(0.14, 0.37, 1.44),
        k: Vec3::new(3.98, 2.38, 1.6),
        specular_reflectance: Vec3::ONE,
    }
}

pub fn rough_glass(distribution: Distribution, u: f32, v: f32, eta: f32) -> RoughDielectric {
    RoughDielectric {
        facets: facets(distribution, u, v),
        eta,
        specular_reflectance: Vec3::ONE,
        specular_transmittance: Vec3::ONE,
    }
}

/// Coats live as long as the tests.
pub fn coat(distribution: Distribution, alpha: f32, eta: f32) -> &'static RoughCoat {
    Box::leak(Box::new(RoughCoat::new(distribution, alpha, eta)))
}

pub fn principled() -> Principled {
    Principled {
        base_color: grey(0.5),
        roughness: 0.5,
        metallic: 0.0,
        spec_trans: 0.0,
        eta: 1.5,
        spec_tint: 0.0,
        sheen: 0.0,
        sheen_tint: 0.0,
        flatness: 0.0,
        clearcoat: 0.0,
        clearcoat_gloss: 0.0,
        facets: facets(Ggx, 0.25, 0.25),
    }
}

pub fn thin() -> PrincipledThin {
    PrincipledThin {
        base_color: grey(0.5),
        roughness: 0.5,
        anisotropic: 0.0,
        spec_trans: 0.0,
        eta: 1.5,
        spec_tint: 0.0,
        sheen: 0.0,
        sheen_tint: 0.0,
        flatness: 0.0,
        diff_trans: 0.0,
    }
}

/// Mitsuba's map from `specular` to the index.
fn eta_of_specular(specular: f32) -> f32 {
    2.0 / (1.0 - (0.08 * specular).sqrt()) - 1.0
}

fn checked_principled() -> Vec<(&'static str, Closure<'static>)> {
    let pink = Vec3::new(0.9, 0.6, 0.7);
    let metal = Principled {
        base_color: Vec3::new(0.9, 0.6, 0.2),
        metallic: 0.8,
        roughness: 0.3,
        spec_tint: 0.4,
        eta: eta_of_specular(0.5),
        facets: Microfacet::new(Ggx, alphas(0.3, 0.7)),
        ..principled()
    };
    let coated = Principled {
        base_color: Vec3::new(0.1, 0.6, 0.3),
        roughness: 0.6,
        clearcoat: 0.8,
        clearcoat_gloss: 0.3,
        sheen: 0.7,
        sheen_tint: 0.5,
        flatness: 0.6,
        eta: eta_of_specular(0.8),
        facets: Microfacet::new(Ggx, alphas(0.6, 0.0)),
        ..principled()
    };
    let glassy = Principled {
        base_color: pink,
        roughness: 0.4,
        spec_trans: 0.7,
        eta: 1.4,
        metallic: 0.1,
        spec_tint: 0.3,
        facets: Microfacet::new(Ggx, alphas(0.4, 0.0)),
        ..principled()
    };
    let rare = Principled {
        base_color: pink,
        metallic: 0.5,
        eta: 0.8,
        spec_tint: 0.3,
        clearcoat: 1.0,
        clearcoat_gloss: 0.2,
        ..principled()
    };
    let sheet = PrincipledThin {
        base_color: Vec3::new(0.7, 0.2, 0.1),
        roughness: 0.45,
        spec_tint: 0.3,
        anisotropic: 0.5,
        spec_trans: 0.6,
        diff_trans: 0.35,
        eta: 1.33,
        sheen: 0.4,
        sheen_tint: 0.3,
        flatness: 0.2,
    };
    vec![
        ("principled default", Closure::Principled(Principled { eta: eta_of_specular(0.5), ..principled() })),
        ("principled metal", Closure::Principled(metal)),
        ("principled coat", Closure::Principled(coated)),
        ("principled glass", Closure::Principled(glassy)),
        ("principled thin eta", Closure::Principled(rare)),
        ("principledthin", Closure::PrincipledThin(sheet)),
        ("principledthin diffuse", Closure::PrincipledThin(PrincipledThin { diff_trans: 0.6, ..thin() })),
    ]
}

/// The models of the same name in [`super::mitsuba::VALUES`].
pub fn checked_models() -> Vec<(&'static str, Closure<'static>)> {
    let (brown, blue) = (Vec3::new(0.1, 0.27, 0.36), Vec3::new(0.1, 0.27, 0.86));
    let (orange, sky) = (Vec3::new(0.9, 0.5, 0.2), Vec3::new(0.3, 0.6, 0.8));
    let dense = 1.9 / 1.000277;
    let tinted = RoughConductor { specular_reflectance: orange, ..gold(Ggx, 0.1, 0.5) };
    let tinted_glass = RoughDielectric {
        specular_reflectance: orange,
        specular_transmittance: sky,
        ..rough_glass(Beckmann, 0.2, 0.5, GLASS)
    };
    let metal = Closure::RoughConductor;
    let glass = |distribution, alpha, eta| Closure::RoughDielectric(rough_glass(distribution, alpha, alpha, eta));
    let rough_plastic = |distribution, alpha, eta, nonlinear, diffuse, specular| {
        Closure::RoughPlastic(RoughPlastic::new(coat(distribution, alpha, eta), nonlinear, diffuse, specular))
    };
    let mut models = vec![
        ("roughconductor ggx 0.3", metal(gold(Ggx, 0.3, 0.3))),
        ("roughconductor beckmann 0.1", metal(gold(Beckmann, 0.1, 0.1))),
        ("roughconductor ggx 0.1 0.5", metal(tinted)),
        ("roughconductor beckmann 0.6 0.2", metal(gold(Beckmann, 0.6, 0.2))),
        ("roughdielectric ggx 0.4", glass(Ggx, 0.4, GLASS)),
        ("roughdielectric beckmann 0.2 0.5", Closure::RoughDielectric(tinted_glass)),
        ("roughdielectric ggx out of glass", glass(Ggx, 0.4, 1.0 / 1.5)),
        ("plastic", Closure::Plastic(Plastic::new(PLASTIC, false, brown, Vec3::ONE))),
        ("plastic nonlinear", Closure::Plastic(Plastic::new(dense, true, blue, Vec3::ONE))),
        ("roughplastic beckmann 0.1", rough_plastic(Beckmann, 0.1, PLASTIC, false, brown, Vec3::ONE)),
        ("roughplastic ggx 0.3 nonlinear", rough_plastic(Ggx, 0.3, dense, true, blue, orange)),
        ("roughplastic ggx 0.05", rough_plastic(Ggx, 0.05, PLASTIC, false, grey(0.5), Vec3::ONE)),
        ("roughplastic beckmann 0.7", rough_plastic(Beckmann, 0.7, PLASTIC, false, grey(0.5), Vec3::ONE)),
    ];
    models.extend(checked_principled());
    models
}

/// Every model that is not a delta distribution.
pub fn models() -> Vec<(&'static str, Closure<'static>)> {
    let mut models = vec![
        ("diffuse", Closure::Diffuse(Diffuse { reflectance: grey(0.8) })),
        ("phong 1", Closure::Phong(Phong { kd: grey(0.3), ks: grey(0.7), exponent: 1.0 })),
        ("phong 50", Closure::Phong(Phong { kd: grey(0.5), ks: grey(0.4), exponent: 50.0 })),
        ("roughconductor ggx 1", Closure::RoughConductor(gold(Ggx, 1.0, 1.0))),
        ("roughconductor beckmann 1", Closure::RoughConductor(gold(Beckmann, 1.0, 1.0))),
    ];
    models.extend(checked_models());
    models
}

/// Models at the ends of their parameters.
pub fn extreme_models() -> Vec<(String, Closure<'static>)> {
    let mut cases: Vec<(String, Closure)> = Vec::new();
    for distribution in [Ggx, Beckmann] {
        for (u, v) in [(0.0, 0.0), (1e-4, 1.0), (1.0, 1e-4), (0.3, 0.3), (5.0, 5.0)] {
            cases.push((format!("metal {distribution:?} {u} {v}"), Closure::RoughConductor(gold(distribution, u, v))));
            for eta in [1.0, 1.0 + 1e-6, 1.0 - 1e-6, 1.0 + 3e-5, 1.001, 1.5, 0.6, 3.0] {
                let model = Closure::RoughDielectric(rough_glass(distribution, u, v, eta));
                cases.push((format!("glass {distribution:?} {u} {v} {eta}"), model));
            }
        }
    }
    for eta in [1.0, 1.0 + 1e-6, 1.5, 0.6] {
        for (diffuse, specular) in [(0.0, 1.0), (1.0, 0.0), (0.0, 0.0), (0.9, 0.9)] {
            let model = Plastic::new(eta, true, grey(diffuse), grey(specular));
            cases.push((format!("plastic {eta} {diffuse} {specular}"), Closure::Plastic(model)));
            let model = RoughPlastic::new(coat(Ggx, 1e-4, eta), true, grey(diffuse), grey(specular));
            cases.push((format!("roughplastic {eta} {diffuse} {specular}"), Closure::RoughPlastic(model)));
        }
        let pane = ThinDielectric { eta, specular_reflectance: Vec3::ONE, specular_transmittance: Vec3::ONE };
        cases.push((format!("pane {eta}"), Closure::ThinDielectric(pane)));
        for (roughness, spec_trans, metallic) in [(0.0, 0.0, 0.0), (0.0, 1.0, 0.0), (1.0, 0.5, 0.5), (0.0, 0.5, 1.0)] {
            let model = Principled {
                base_color: Vec3::new(0.0, 0.5, 1.0),
                eta: Principled::eta_for_facets(eta, spec_trans),
                facets: Microfacet::new(Ggx, alphas(roughness, 1.0)),
                roughness,
                spec_trans,
                metallic,
                spec_tint: 1.0,
                sheen: 1.0,
                sheen_tint: 1.0,
                flatness: 1.0,
                clearcoat: 1.0,
                clearcoat_gloss: 1.0,
            };
            cases.push((format!("principled {eta} {roughness} {spec_trans} {metallic}"), Closure::Principled(model)));
            let model = PrincipledThin { roughness, spec_trans, eta, anisotropic: 1.0, diff_trans: metallic, ..thin() };
            cases.push((format!("thin {eta} {roughness} {spec_trans} {metallic}"), Closure::PrincipledThin(model)));
        }
    }
    cases
}
