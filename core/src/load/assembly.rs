//! A scene in the making, whatever format it comes from: what refers to files waits here until all are read at once.
//!
//! Formats fill an [`Assembly`] in f64 world space; [`Assembly::finish`] reads meshes and images in parallel, moves the scene
//! so that its centre is the origin, rounds to f32 and validates.

use super::error::{LoadError, Place, Result};
use super::folder::{Folder, IMAGE_BYTES_MAX, MESH_BYTES_MAX};
use super::mesh::{self, FileMesh, Placement, obj, ply, serialized};
use super::placed::{PlacedEmitter, PlacedGeometry, PlacedSensor, PlacedShape, moved};
use super::{Loaded, Note, image};
use crate::film::scale_exponent;
use crate::scene::{Bsdf, BsdfId, Geometry, Image, ImageId, Mesh, MeshId, Scene, Shape, Texture, TextureId};
use crate::settings::Settings;
use glam::DVec3;
use rayon::prelude::*;
use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::Arc;

/// A scene in the making.
pub(crate) struct Assembly {
    pub folder: Folder,
    pub notes: Vec<Note>,
    pub shapes: Vec<PlacedShape>,
    pub emitters: Vec<PlacedEmitter>,
    textures: Vec<Texture>,
    bsdfs: Vec<Bsdf>,
    constants: HashMap<[u32; 3], TextureId>,
    meshes: Vec<PlacedMesh>,
    mesh_files: Vec<MeshFile>,
    mesh_file_ids: HashMap<(PathBuf, MeshFormat), usize>,
    images: Vec<ImageFile>,
    image_ids: HashMap<(PathBuf, image::Use), ImageId>,
}

/// Where a mesh comes from.
#[derive(Clone)]
pub(crate) enum MeshSource {
    /// What [`Assembly::mesh_file`] gave.
    File(usize),
    Ready(Arc<FileMesh>),
}

struct PlacedMesh {
    source: MeshSource,
    placement: Placement,
}

/// Formats of mesh files.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum MeshFormat {
    Obj,
    Ply,
    /// One mesh of a file of several.
    Serialized {
        shape_index: u32,
    },
}

struct MeshFile {
    path: PathBuf,
    format: MeshFormat,
    /// Who named it first.
    place: Place,
}

struct ImageFile {
    path: PathBuf,
    usage: image::Use,
    place: Place,
}

impl Assembly {
    pub fn new(folder: Folder) -> Self {
        Self {
            folder,
            notes: Vec::new(),
            shapes: Vec::new(),
            emitters: Vec::new(),
            textures: Vec::new(),
            bsdfs: Vec::new(),
            constants: HashMap::new(),
            meshes: Vec::new(),
            mesh_files: Vec::new(),
            mesh_file_ids: HashMap::new(),
            images: Vec::new(),
            image_ids: HashMap::new(),
        }
    }

    pub fn note(&mut self, place: Option<Place>, text: impl Into<String>) {
        self.notes.push(Note { place, text: text.into() });
    }

    /// A texture of one colour, the same id for the same colour.
    pub fn constant(&mut self, rgb: DVec3) -> TextureId {
        let rgb = rgb.as_vec3();
        let bits = rgb.to_array().map(f32::to_bits);
        if let Some(id) = self.constants.get(&bits) {
            return *id;
        }
        let id = self.texture(Texture::Constant(rgb));
        self.constants.insert(bits, id);
        id
    }

    pub fn texture(&mut self, texture: Texture) -> TextureId {
        self.textures.push(texture);
        TextureId(index(self.textures.len() - 1))
    }

    pub fn texture_of(&self, id: TextureId) -> Option<&Texture> {
        self.textures.get(id.0 as usize)
    }

    pub fn bsdf(&mut self, bsdf: Bsdf) -> BsdfId {
        self.bsdfs.push(bsdf);
        BsdfId(index(self.bsdfs.len() - 1))
    }

    pub fn bsdf_of(&self, id: BsdfId) -> Option<&Bsdf> {
        self.bsdfs.get(id.0 as usize)
    }

    /// An image file, the same id for the same file used in the same way. `place` is who names it.
    pub fn image(&mut self, path: PathBuf, usage: image::Use, place: Place) -> ImageId {
        *self.image_ids.entry((path.clone(), usage)).or_insert_with(|| {
            self.images.push(ImageFile { path, usage, place });
            ImageId(index(self.images.len() - 1))
        })
    }

    /// A mesh file, the same source for the same file. `place` is who names it.
    pub fn mesh_file(&mut self, path: PathBuf, format: MeshFormat, place: Place) -> MeshSource {
        MeshSource::File(*self.mesh_file_ids.entry((path.clone(), format)).or_insert_with(|| {
            self.mesh_files.push(MeshFile { path, format, place });
            self.mesh_files.len() - 1
        }))
    }

    /// A mesh in its place.
    pub fn mesh(&mut self, source: MeshSource, placement: Placement) -> PlacedGeometry {
        self.meshes.push(PlacedMesh { source, placement });
        PlacedGeometry::Mesh(self.meshes.len() - 1)
    }

    /// Reads the files and makes the scene; `sensor` may be framed on the bounds (in world space) of what there is.
    ///
    /// # Errors
    /// Whatever is wrong with a mesh or image, or a value beyond its range.
    pub fn finish(
        mut self,
        sensor: impl FnOnce(Option<(DVec3, DVec3)>) -> PlacedSensor,
        mut settings: Settings,
    ) -> Result<Loaded> {
        let (files, images) = rayon::join(|| self.read_meshes(), || self.read_images());
        let (files, images) = (files?, images?);
        let file_of = |source: &MeshSource| match source {
            MeshSource::File(i) => files[*i].clone(),
            MeshSource::Ready(mesh) => mesh.clone(),
        };
        let bounds = self.bounds(&file_of);
        let origin = bounds.map_or(DVec3::ZERO, |(min, max)| min + (max - min) * 0.5);
        let placed: Vec<_> = self
            .meshes
            .par_iter()
            .map(|placed| mesh::to_scene(&file_of(&placed.source), &placed.placement, origin))
            .collect();
        let mut meshes = Vec::with_capacity(placed.len());
        for (result, placed) in placed.into_iter().zip(&self.meshes) {
            let (mesh, degenerate) = result.map_err(|m| LoadError::at(self.place_of(&placed.source), m))?;
            let incomplete = file_of(&placed.source).incomplete_faces;
            if degenerate + incomplete > 0 {
                let place = Some(self.place_of(&placed.source));
                let text = format!("{} degenerate triangles (without area) are left out", degenerate + incomplete);
                self.notes.push(Note { place, text });
            }
            meshes.push(Arc::new(mesh));
        }
        let sensor = sensor(bounds);
        let aspect = |id: TextureId| match self.textures.get(id.0 as usize) {
            Some(Texture::Bitmap { image, .. }) => {
                let image = &images[image.0 as usize];
                image.width as f32 / image.height as f32
            }
            _ => 1.0,
        };
        let emitters = self.emitters.iter().map(|emitter| emitter.to_scene(origin, aspect)).collect();
        let (shapes, meshes) = self.shapes_and_meshes(meshes, origin);
        let scene = Scene {
            sensor: sensor.to_scene(origin),
            shapes,
            bsdfs: self.bsdfs,
            textures: self.textures,
            emitters,
            meshes,
            images: images.into_iter().map(Arc::new).collect(),
            origin: origin.to_array(),
        };
        scene.validate().map_err(|e| LoadError::new(e.to_string()))?;
        settings.scale_exponent = scale_exponent(scene.brightest_radiance());
        settings.validate().map_err(|e| LoadError::new(e.to_string()))?;
        Ok(Loaded { scene, settings, notes: self.notes })
    }

    fn read_meshes(&self) -> Result<Vec<Arc<FileMesh>>> {
        let read = |file: &MeshFile| {
            let bytes = self.read(&file.path, MESH_BYTES_MAX, &file.place)?;
            let name = self.folder.name_of(&file.path);
            let mesh = match file.format {
                MeshFormat::Ply => ply::parse(&name, &bytes)?,
                MeshFormat::Serialized { shape_index } => {
                    let fail = |message: String| LoadError::at(file.place.clone(), format!("'{name}' {message}"));
                    serialized::parse(&bytes, shape_index).map_err(fail)?
                }
                MeshFormat::Obj => {
                    let file = obj::parse(&name, &bytes)?;
                    drop(bytes);
                    file.whole()
                }
            };
            Ok(Arc::new(mesh))
        };
        first_error(self.mesh_files.par_iter().map(read).collect())
    }

    fn read_images(&self) -> Result<Vec<Image>> {
        let read = |file: &ImageFile| {
            let bytes = self.read(&file.path, IMAGE_BYTES_MAX, &file.place)?;
            let named = self.folder.name_of(&file.path);
            let fail = |message: String| LoadError::at(file.place.clone(), format!("the image '{named}' {message}"));
            image::decode(&file.path, &bytes, file.usage).map_err(fail)
        };
        first_error(self.images.par_iter().map(read).collect())
    }

    fn read(&self, path: &std::path::Path, limit: u64, place: &Place) -> Result<Vec<u8>> {
        self.folder.read(path, limit).map_err(|message| LoadError::at(place.clone(), message))
    }

    /// The file a mesh comes from.
    fn place_of(&self, source: &MeshSource) -> Place {
        match source {
            MeshSource::File(i) => Place::file(self.folder.name_of(&self.mesh_files[*i].path)),
            MeshSource::Ready(_) => Place::file("a shape of the scene"),
        }
    }

    /// The box around all surfaces in world space.
    fn bounds(&self, file_of: &(impl Fn(&MeshSource) -> Arc<FileMesh> + Sync)) -> Option<(DVec3, DVec3)> {
        let of_meshes: Vec<_> = self
            .meshes
            .par_iter()
            .map(|placed| mesh::bounds(&file_of(&placed.source), &placed.placement.to_world))
            .collect();
        let of_shapes = self.shapes.iter().map(|shape| shape.geometry.bounds());
        let join = |a: (DVec3, DVec3), b: (DVec3, DVec3)| (a.0.min(b.0), a.1.max(b.1));
        of_meshes.into_iter().chain(of_shapes).flatten().reduce(join)
    }

    /// The shapes and the meshes that have triangles left; shapes without any are left out.
    fn shapes_and_meshes(&mut self, meshes: Vec<Arc<Mesh>>, origin: DVec3) -> (Vec<Shape>, Vec<Arc<Mesh>>) {
        let mut kept = Vec::new();
        let mut ids = vec![None; meshes.len()];
        let mut shapes = Vec::new();
        for shape in std::mem::take(&mut self.shapes) {
            let geometry = match &shape.geometry {
                PlacedGeometry::Mesh(i) if meshes[*i].triangles.is_empty() => {
                    let text = format!("shape '{}' has no triangle with an area and is left out", shape.name);
                    self.notes.push(Note { place: None, text });
                    continue;
                }
                PlacedGeometry::Mesh(i) => Geometry::Mesh(*ids[*i].get_or_insert_with(|| {
                    kept.push(meshes[*i].clone());
                    MeshId(index(kept.len() - 1))
                })),
                PlacedGeometry::Sphere { to_world, flip_normals } => {
                    Geometry::Sphere { to_world: moved(to_world, origin), flip_normals: *flip_normals }
                }
                PlacedGeometry::Disk { to_world, flip_normals } => {
                    Geometry::Disk { to_world: moved(to_world, origin), flip_normals: *flip_normals }
                }
            };
            shapes.push(Shape { name: shape.name, geometry, bsdf: shape.bsdf, radiance: shape.radiance });
        }
        (shapes, kept)
    }
}

/// Lists of the scene are shorter than 2^32: XML and OBJ files that could name more are refused for their size.
fn index(i: usize) -> u32 {
    u32::try_from(i).unwrap_or(u32::MAX)
}

/// All results, or the error of the first that failed, whichever thread met it first.
fn first_error<T>(results: Vec<Result<T>>) -> Result<Vec<T>> {
    results.into_iter().collect()
}
