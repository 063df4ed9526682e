//! The models that nest no other, with their parameters looked up.

use crate::bsdf::{
    Closure, Conductor, Dielectric, Diffuse, Microfacet, Phong, Plastic, Principled, PrincipledThin, RoughCoat,
    RoughConductor, RoughDielectric, RoughPlastic, ThinDielectric, alphas,
};
use crate::scene::{Bsdf, BsdfId, Distribution, TextureId};
use crate::surface::Surface;
use crate::texture::Textures;
use glam::{Vec2, Vec3};
use rayon::prelude::*;

/// What is tabulated for the rough plastics of a scene; equal coats share a table.
pub struct Coats {
    tables: Vec<RoughCoat>,
    /// The table of each BSDF; 0 for those that need none.
    of_bsdf: Vec<usize>,
}

impl Coats {
    /// The tables for these BSDFs, on the current rayon pool.
    pub fn new(bsdfs: &[Bsdf]) -> Self {
        let mut kinds: Vec<(Distribution, f32, f32)> = Vec::new();
        let mut index = |bsdf: &Bsdf| match bsdf {
            Bsdf::RoughPlastic { distribution, alpha, eta, .. } => {
                let kind = (*distribution, *alpha, *eta);
                kinds.iter().position(|k| *k == kind).unwrap_or_else(|| {
                    kinds.push(kind);
                    kinds.len() - 1
                })
            }
            _ => 0,
        };
        let of_bsdf = bsdfs.iter().map(&mut index).collect();
        let tables = kinds.into_par_iter().map(|(d, alpha, eta)| RoughCoat::new(d, alpha, eta)).collect();
        Self { tables, of_bsdf }
    }

    /// The table of a rough plastic.
    #[inline(always)]
    fn of(&self, id: BsdfId) -> &RoughCoat {
        &self.tables[self.of_bsdf[id.0 as usize]]
    }
}

/// The closure of a model that nests no other; `id` is its own.
#[inline(always)]
pub fn closure<'a>(bsdf: &Bsdf, coats: &'a Coats, id: BsdfId, textures: &Textures, surface: &Surface) -> Closure<'a> {
    let value = |id: &TextureId| textures.at(*id, surface);
    let scalar = |id: &TextureId| value(id).x;
    match bsdf {
        Bsdf::Diffuse { reflectance } => Closure::Diffuse(Diffuse { reflectance: value(reflectance) }),
        Bsdf::Conductor { eta, k, specular_reflectance } => Closure::Conductor(Conductor {
            eta: value(eta),
            k: value(k),
            specular_reflectance: value(specular_reflectance),
        }),
        Bsdf::RoughConductor { distribution, alpha_u, alpha_v, eta, k, specular_reflectance } => {
            Closure::RoughConductor(RoughConductor {
                facets: Microfacet::new(*distribution, Vec2::new(scalar(alpha_u), scalar(alpha_v))),
                eta: value(eta),
                k: value(k),
                specular_reflectance: value(specular_reflectance),
            })
        }
        Bsdf::Dielectric { eta, specular_reflectance, specular_transmittance } => Closure::Dielectric(Dielectric {
            eta: *eta,
            specular_reflectance: value(specular_reflectance),
            specular_transmittance: value(specular_transmittance),
        }),
        Bsdf::RoughDielectric { distribution, alpha_u, alpha_v, eta, specular_reflectance, specular_transmittance } => {
            Closure::RoughDielectric(RoughDielectric {
                facets: Microfacet::new(*distribution, Vec2::new(scalar(alpha_u), scalar(alpha_v))),
                eta: *eta,
                specular_reflectance: value(specular_reflectance),
                specular_transmittance: value(specular_transmittance),
            })
        }
        Bsdf::ThinDielectric { eta, specular_reflectance, specular_transmittance } => {
            Closure::ThinDielectric(ThinDielectric {
                eta: *eta,
                specular_reflectance: value(specular_reflectance),
                specular_transmittance: value(specular_transmittance),
            })
        }
        Bsdf::Plastic { eta, nonlinear, diffuse_reflectance, specular_reflectance } => {
            Closure::Plastic(Plastic::new(*eta, *nonlinear, value(diffuse_reflectance), value(specular_reflectance)))
        }
        Bsdf::RoughPlastic { nonlinear, diffuse_reflectance, specular_reflectance, .. } => {
            let (diffuse, specular) = (value(diffuse_reflectance), value(specular_reflectance));
            Closure::RoughPlastic(RoughPlastic::new(coats.of(id), *nonlinear, diffuse, specular))
        }
        Bsdf::Phong { diffuse_reflectance, specular_reflectance, exponent } => Closure::Phong(Phong {
            kd: value(diffuse_reflectance),
            ks: value(specular_reflectance),
            exponent: *exponent,
        }),
        Bsdf::Principled { .. } | Bsdf::PrincipledThin { .. } => principled(bsdf, value),
        Bsdf::Null => Closure::Null,
        Bsdf::TwoSided { .. }
        | Bsdf::Mask { .. }
        | Bsdf::BlendBsdf { .. }
        | Bsdf::BumpMap { .. }
        | Bsdf::NormalMap { .. } => unreachable!("{bsdf:?} nests others"),
    }
}

/// The closure of one of the principled models.
#[inline]
fn principled<'a>(bsdf: &Bsdf, value: impl Fn(&TextureId) -> Vec3) -> Closure<'a> {
    let scalar = |id: &TextureId| value(id).x;
    match bsdf {
        Bsdf::Principled {
            base_color,
            roughness,
            anisotropic,
            metallic,
            spec_trans,
            eta,
            spec_tint,
            sheen,
            sheen_tint,
            flatness,
            clearcoat,
            clearcoat_gloss,
        } => {
            let (roughness, spec_trans) = (scalar(roughness), scalar(spec_trans));
            Closure::Principled(Principled {
                base_color: value(base_color),
                roughness,
                metallic: scalar(metallic),
                spec_trans,
                eta: Principled::eta_for_facets(*eta, spec_trans),
                spec_tint: scalar(spec_tint),
                sheen: scalar(sheen),
                sheen_tint: scalar(sheen_tint),
                flatness: scalar(flatness),
                clearcoat: scalar(clearcoat),
                clearcoat_gloss: scalar(clearcoat_gloss),
                facets: Microfacet::new(Distribution::Ggx, alphas(roughness, scalar(anisotropic))),
            })
        }
        Bsdf::PrincipledThin {
            base_color,
            roughness,
            anisotropic,
            spec_trans,
            eta,
            spec_tint,
            sheen,
            sheen_tint,
            flatness,
            diff_trans,
        } => Closure::PrincipledThin(PrincipledThin {
            base_color: value(base_color),
            roughness: scalar(roughness),
            anisotropic: scalar(anisotropic),
            spec_trans: scalar(spec_trans),
            eta: scalar(eta),
            spec_tint: scalar(spec_tint),
            sheen: scalar(sheen),
            sheen_tint: scalar(sheen_tint),
            flatness: scalar(flatness),
            diff_trans: 0.5 * scalar(diff_trans),
        }),
        _ => unreachable!("{bsdf:?} is not principled"),
    }
}
