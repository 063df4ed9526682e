//! A bare OBJ file with its MTL materials as a whole scene: the camera is framed on it, and the sky lights it unless it
//! shines itself.
//!
//! What MTL says is turned into physics as far as it goes:
//! - `Kd`, `map_Kd`: Lambert. A map is multiplied by `Kd` (by 1 if that is black, which exporters write beside maps).
//! - `Ks`, `Ns`: with a highlight, [`Bsdf::Phong`], unless `illum` is 0 or 1; both scaled down alike where Kd + Ks exceeds 1.
//! - `Ke`: an area light of that radiance.
//! - `illum` 4, 6, 7 or 9 (the models with refraction) and `d` below 1 or a `Tf`: [`Bsdf::Dielectric`] of index `Ni` (1.5 if not
//!   given); what goes through is multiplied by `Tf`.
//! - else `d` below 1, `Tr` or `map_d`: [`Bsdf::Mask`].
//! - Everything but glass has two sides. A file without normals is shaded flat.

mod mtl;

use super::assembly::{Assembly, MeshSource};
use super::error::{LoadError, Place, Result, did_you_mean};
use super::folder::{self, Folder, TEXT_BYTES_MAX};
use super::mesh::Placement;
use super::mesh::obj::{self, ObjFile};
use super::placed::{PlacedEmitter, PlacedSensor, PlacedShape, Projection};
use super::{LoadOptions, Loaded, Note, image};
use crate::scene::{Bsdf, BsdfId, FilterType, FovAxis, Texture, TextureId, WrapMode};
use crate::settings::{Film, Filter, Integrator, IntegratorKind, SamplerKind, Settings, Strategy, Window, Without};
use glam::{Affine2, DAffine3, DMat3, DVec3, Vec2, Vec3};
use mtl::{Map, Material};
use std::collections::HashMap;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The picture, 3 : 2.
const SIZE: [u32; 2] = [768, 512];
/// Samples a pixel.
const SPP: u32 = 64;
/// Field of view across the picture's height.
const FOV_DEGREES: f64 = 35.0;
/// The camera looks from the right, in front and above: a three-quarter view. y is up.
const VIEWED_FROM: DVec3 = DVec3::new(0.55, 0.42, 0.72);
/// Room left around the object, as a share of the picture.
const MARGIN: f64 = 0.05;
/// Of surfaces that no material is named for.
const GREY: f64 = 0.5;
/// Of glass that says nothing of it.
const GLASS_IOR: f64 = 1.5;

/// Loads an OBJ file.
///
/// # Errors
/// Whatever is wrong with it or the files it names.
pub(crate) fn load(path: &Path, options: &LoadOptions) -> Result<Loaded> {
    if let Some((name, _)) = options.defines.first() {
        let message = format!("-D {name}: an OBJ file has no ${name} to set; only Mitsuba scenes have such parameters");
        return Err(LoadError::at(Place::file(path.display().to_string()), message));
    }
    let folder = Folder::of(path)?;
    let file = obj::parse(&path.display().to_string(), &folder::read_scene_file(path)?)?;
    let mut loader =
        Loader { assembly: Assembly::new(folder), materials: HashMap::new(), name: path.display().to_string() };
    loader.libraries(&file)?;
    let parts = parts_by_material(&file);
    loader.shapes(&file, parts)?;
    let mut assembly = loader.assembly;
    if assembly.shapes.iter().all(|shape| shape.radiance.is_none()) {
        assembly.emitters.push(PlacedEmitter::Constant { radiance: Vec3::ONE });
    }
    assembly.finish(framed, settings())
}

struct Loader {
    assembly: Assembly,
    materials: HashMap<String, Material>,
    /// Of the OBJ file, for messages.
    name: String,
}

/// Triangles of one material, the name and line of its first use; none before any `usemtl`.
struct Part<'a> {
    material: Option<(&'a str, usize)>,
    triangles: Vec<Range<usize>>,
}

/// In the order of first use.
fn parts_by_material(file: &ObjFile) -> Vec<Part<'_>> {
    let mut parts: Vec<Part> = vec![Part { material: None, triangles: Vec::new() }];
    let mut by_name: HashMap<&str, usize> = HashMap::new();
    let mut current = 0;
    let mut start = 0;
    for usage in &file.uses {
        parts[current].triangles.push(start..usage.first_triangle);
        start = usage.first_triangle;
        current = *by_name.entry(&usage.name).or_insert_with(|| {
            parts.push(Part { material: Some((&usage.name, usage.line)), triangles: Vec::new() });
            parts.len() - 1
        });
    }
    parts[current].triangles.push(start..file.triangle_count());
    parts.iter_mut().for_each(|part| part.triangles.retain(|range| !range.is_empty()));
    parts.retain(|part| !part.triangles.is_empty());
    parts
}

impl Loader {
    fn note(&mut self, line: usize, text: String) {
        let place = Some(Place::on_line(self.name.as_str(), line, ""));
        self.assembly.notes.push(Note { place, text });
    }

    /// Reads the material libraries; one that is missing is noted.
    fn libraries(&mut self, file: &ObjFile) -> Result<()> {
        for (named, line) in &file.libraries {
            let place = Place::on_line(self.name.as_str(), *line, &format!("mtllib {named}"));
            let fail = |message: String| LoadError::at(place.clone(), message);
            // One name with blanks, or several without.
            let whole = self.assembly.folder.locate(Path::new(""), &named.replace('\\', "/")).map_err(fail)?;
            let paths = match self.assembly.folder.has(&whole) {
                true => vec![whole],
                false => {
                    let names = named.split_whitespace().map(|name| name.replace('\\', "/"));
                    let located = names.map(|name| self.assembly.folder.locate(Path::new(""), &name).map_err(fail));
                    located.collect::<Result<Vec<PathBuf>>>()?
                }
            };
            for path in paths {
                if !self.assembly.folder.has(&path) {
                    let text = format!(
                        "there is no material file '{}'; its materials are grey",
                        self.assembly.folder.name_of(&path)
                    );
                    self.note(*line, text);
                    continue;
                }
                let bytes = self.assembly.folder.read(&path, TEXT_BYTES_MAX).map_err(fail)?;
                self.library(&path, &String::from_utf8_lossy(&bytes))?;
            }
        }
        Ok(())
    }

    fn library(&mut self, path: &Path, text: &str) -> Result<()> {
        let from = path.parent().unwrap_or(Path::new(""));
        let mtl::Library { materials, unmodelled } = mtl::parse(&self.assembly.folder.name_of(path), from, text)?;
        for (statement, place) in unmodelled {
            self.assembly.note(Some(place), format!("'{statement}' of materials has no effect here"));
        }
        for material in materials {
            self.materials.entry(material.name.clone()).or_insert(material);
        }
        Ok(())
    }

    fn shapes(&mut self, file: &ObjFile, parts: Vec<Part>) -> Result<()> {
        let placement = Placement { flip_v: true, face_normals: !file.has_normals(), ..Placement::IDENTITY };
        for part in parts {
            let name = part.material.map_or("unnamed", |(name, _)| name);
            let material = self.material(part.material);
            let (bsdf, radiance) = self.surface(&material)?;
            let source = MeshSource::Ready(Arc::new(file.mesh(&part.triangles)));
            let geometry = self.assembly.mesh(source, placement);
            self.assembly.shapes.push(PlacedShape { name: name.into(), geometry, bsdf, radiance });
        }
        Ok(())
    }

    /// A material by its name; grey if there is none.
    fn material(&mut self, usage: Option<(&str, usize)>) -> Material {
        let Some((name, line)) = usage else { return Material::new("") };
        if let Some(material) = self.materials.get(name) {
            return material.clone();
        }
        let hint = did_you_mean(name, self.materials.keys().map(String::as_str));
        if !self.materials.is_empty() {
            self.note(line, format!("no material is called '{name}'{hint}; it is grey"));
        }
        Material::new(name)
    }

    /// What scatters, and what shines.
    fn surface(&mut self, material: &Material) -> Result<(BsdfId, Option<TextureId>)> {
        let shines = material.emission.max_element() > 0.0;
        let radiance = shines.then(|| self.assembly.constant(material.emission));
        let refracts = matches!(material.illumination, Some(4 | 6 | 7 | 9));
        let bsdf = if refracts && (material.opacity < 1.0 || material.transmission.is_some()) {
            self.glass(material)
        } else {
            let opaque = self.opaque(material)?;
            let two_sided = self.assembly.bsdf(Bsdf::TwoSided { front: opaque, back: opaque });
            self.masked(material, two_sided)?
        };
        Ok((bsdf, radiance))
    }

    fn glass(&mut self, material: &Material) -> BsdfId {
        let eta = material.ior.filter(|ior| *ior > 0.0).unwrap_or(GLASS_IOR) as f32;
        let specular_reflectance = self.assembly.constant(DVec3::ONE);
        let filter = material.transmission.unwrap_or(DVec3::ONE).min(DVec3::ONE);
        let specular_transmittance = self.assembly.constant(filter);
        self.assembly.bsdf(Bsdf::Dielectric { eta, specular_reflectance, specular_transmittance })
    }

    fn opaque(&mut self, material: &Material) -> Result<BsdfId> {
        let mut diffuse = material.diffuse.unwrap_or(DVec3::splat(GREY));
        if material.diffuse_map.is_some() && (material.diffuse.is_none() || diffuse == DVec3::ZERO) {
            diffuse = DVec3::ONE;
        }
        let highlight = !matches!(material.illumination, Some(0 | 1)) && material.specular.max_element() > 0.0;
        let specular = if highlight { material.specular } else { DVec3::ZERO };
        let too_much = (diffuse + specular).max_element().max(1.0);
        let (diffuse, specular) = (diffuse / too_much, specular / too_much);
        let diffuse = match &material.diffuse_map {
            Some(map) => self.bitmap(map, diffuse.max_element() as f32, false)?,
            None => self.assembly.constant(diffuse),
        };
        let bsdf = match highlight {
            false => Bsdf::Diffuse { reflectance: diffuse },
            true => Bsdf::Phong {
                diffuse_reflectance: diffuse,
                specular_reflectance: self.assembly.constant(specular),
                exponent: material.exponent as f32,
            },
        };
        Ok(self.assembly.bsdf(bsdf))
    }

    fn masked(&mut self, material: &Material, nested: BsdfId) -> Result<BsdfId> {
        let opacity = match &material.opacity_map {
            Some(map) => self.bitmap(map, material.opacity as f32, true)?,
            None if material.opacity < 1.0 => self.assembly.constant(DVec3::splat(material.opacity)),
            None => return Ok(nested),
        };
        Ok(self.assembly.bsdf(Bsdf::Mask { opacity, nested }))
    }

    /// An image beside the MTL file, or else beside the OBJ file.
    fn bitmap(&mut self, map: &Map, scale: f32, scalar: bool) -> Result<TextureId> {
        let fail = |message: String| LoadError::at(map.place.clone(), message);
        let folder = &self.assembly.folder;
        let beside = folder.locate(&map.from, &map.name).map_err(fail)?;
        let path = match folder.has(&beside) {
            true => beside,
            false => folder.locate(Path::new(""), &map.name).map_err(fail)?,
        };
        let usage = image::Use { raw: scalar, scalar };
        let image = self.assembly.image(path, usage, map.place.clone());
        // The file's v counts from the bottom, the scene's from the top: v' = 1 − (s (1 − v) + o).
        let (s, o) = (map.scale, map.offset);
        let to_uv = Affine2::from_scale_angle_translation(
            Vec2::new(s.x as f32, s.y as f32),
            0.0,
            Vec2::new(o.x as f32, (1.0 - s.y - o.y) as f32),
        );
        let wrap = if map.clamp { WrapMode::Clamp } else { WrapMode::Repeat };
        Ok(self.assembly.texture(Texture::Bitmap { image, to_uv, filter: FilterType::Bilinear, wrap, scale }))
    }
}

/// A camera that sees all of a box, from [`VIEWED_FROM`].
fn framed(bounds: Option<(DVec3, DVec3)>) -> PlacedSensor {
    let (min, max) = bounds.unwrap_or((-DVec3::ONE, DVec3::ONE));
    let center = (min + max) * 0.5;
    let forward = -VIEWED_FROM.normalize();
    let left = DVec3::Y.cross(forward).normalize();
    let up = forward.cross(left);
    let tan_y = libm::tan(0.5 * FOV_DEGREES.to_radians()) * (1.0 - MARGIN);
    let tan_x = tan_y * f64::from(SIZE[0]) / f64::from(SIZE[1]);
    // Each corner must lie within the pyramid of view: |x| ≤ (distance + z) tan, and likewise for y.
    let corners = (0..8).map(|i| {
        let pick = |bit: i32, low: f64, high: f64| if i & bit == 0 { low } else { high };
        DVec3::new(pick(1, min.x, max.x), pick(2, min.y, max.y), pick(4, min.z, max.z)) - center
    });
    let needed = corners.map(|c| {
        let (x, y, z) = (c.dot(left).abs(), c.dot(up).abs(), c.dot(forward));
        (x / tan_x).max(y / tan_y) - z
    });
    let extent = (max - min).length();
    let distance = needed.fold(0.5 * extent, f64::max).max(f64::MIN_POSITIVE.sqrt());
    PlacedSensor {
        to_world: DAffine3 { matrix3: DMat3::from_cols(left, up, forward), translation: center - forward * distance },
        projection: Projection::Perspective {
            fov_degrees: FOV_DEGREES,
            fov_axis: FovAxis::Y,
            principal_point_offset: [0.0; 2],
            lens: None,
        },
        near_clip: distance * 1e-3,
        far_clip: (distance + extent) * 10.0,
    }
}

fn settings() -> Settings {
    let [width, height] = SIZE;
    let crop = Window { x0: 0, y0: 0, x1: width, y1: height };
    Settings {
        film: Film { width, height, crop, filter: Filter::Gaussian { stddev: 0.5 } },
        spp: SPP,
        seed: 0,
        integrator: Integrator { kind: IntegratorKind::Path, max_depth: None, rr_depth: 5, hide_emitters: false },
        strategy: Strategy::Mis,
        sampler: SamplerKind::Sobol,
        without: Without::default(),
        half: Default::default(),
        offsets: Default::default(),
        scale_exponent: 0,
    }
}
