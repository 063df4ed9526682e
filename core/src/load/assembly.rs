//! A scene in the making, whatever format it comes from: what refers to files waits here until all are read at once.
//!
//! Formats fill an [`Assembly`] in f64 world space; [`Assembly::finish`] reads meshes and images in parallel, moves the scene
//! so that its centre is the origin, rounds to f32 and validates.

use super::error::{LoadError, Place, Result, did_you_mean};
use super::folder::{Folder, IMAGE_BYTES_MAX, MESH_BYTES_MAX};
use super::mesh::{self, FileMesh, Placement, obj, ply, serialized};
use super::placed::{PlacedEmitter, PlacedGeometry, PlacedInstance, PlacedSensor, PlacedShape, mapped_box, moved};
use super::{Loaded, Note, image};
use crate::film::scale_exponent;
use crate::scene::{
    AttributeValues, Bsdf, BsdfId, Geometry, Group, GroupId, Image, ImageId, Instance, Mesh, MeshId, Scene, Shape,
    Texture, TextureId,
};
use crate::settings::Settings;
use glam::{DAffine3, DVec3};
use rayon::prelude::*;
use std::collections::{BTreeSet, HashMap};
use std::path::PathBuf;
use std::sync::Arc;

/// A scene in the making.
pub(crate) struct Assembly {
    pub folder: Folder,
    pub notes: Vec<Note>,
    pub shapes: Vec<PlacedShape>,
    /// Shapes of groups, each in its group's own space.
    pub groups: Vec<Vec<PlacedShape>>,
    pub instances: Vec<PlacedInstance>,
    pub emitters: Vec<PlacedEmitter>,
    textures: Vec<Texture>,
    bsdfs: Vec<Bsdf>,
    constants: HashMap<[u32; 3], TextureId>,
    meshes: Vec<PlacedMesh>,
    mesh_files: Vec<MeshFile>,
    mesh_file_ids: HashMap<(PathBuf, MeshFormat), usize>,
    /// What textures show of meshes.
    pub shown_attributes: Vec<ShownAttribute>,
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

/// An attribute of meshes that a texture shows.
pub(crate) struct ShownAttribute {
    pub name: String,
    /// As one number, not as a colour.
    pub is_number: bool,
    /// Where the texture names it.
    pub place: Place,
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
            groups: Vec::new(),
            instances: Vec::new(),
            emitters: Vec::new(),
            textures: Vec::new(),
            bsdfs: Vec::new(),
            constants: HashMap::new(),
            meshes: Vec::new(),
            mesh_files: Vec::new(),
            mesh_file_ids: HashMap::new(),
            shown_attributes: Vec::new(),
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
        self.check_attributes(&files)?;
        let file_of = |source: &MeshSource| match source {
            MeshSource::File(i) => files[*i].clone(),
            MeshSource::Ready(mesh) => mesh.clone(),
        };
        let space = self.space(&file_of);
        let origin = space.origin;
        let placed: Vec<_> = (&self.meshes, &space.of_meshes)
            .into_par_iter()
            .map(|(placed, origin)| mesh::to_scene(&file_of(&placed.source), &placed.placement, *origin))
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
        let sensor = sensor(space.bounds);
        let aspect = |id: TextureId| match self.textures.get(id.0 as usize) {
            Some(Texture::Bitmap { image, .. }) => {
                let image = &images[image.0 as usize];
                image.width as f32 / image.height as f32
            }
            _ => 1.0,
        };
        let emitters = self.emitters.iter().map(|emitter| emitter.to_scene(origin, aspect)).collect();
        let mut kept = Kept { ids: vec![None; meshes.len()], meshes: Vec::new() };
        let shapes = std::mem::take(&mut self.shapes);
        let shapes = self.kept_shapes(shapes, &meshes, origin, &mut kept);
        let groups = std::mem::take(&mut self.groups).into_iter().zip(&space.of_groups);
        let groups = groups
            .map(|(shapes, origin)| Group { shapes: self.kept_shapes(shapes, &meshes, *origin, &mut kept) })
            .collect();
        let instance = |PlacedInstance { group, to_world }: &PlacedInstance| {
            let to_world = *to_world * DAffine3::from_translation(space.of_groups[*group]);
            Instance { group: GroupId(index(*group)), to_world: moved(&to_world, origin) }
        };
        let instances = self.instances.iter().map(instance).collect();
        let scene = Scene {
            sensor: sensor.to_scene(origin),
            shapes,
            groups,
            instances,
            bsdfs: self.bsdfs,
            textures: self.textures,
            emitters,
            meshes: kept.meshes,
            images: images.into_iter().map(Arc::new).collect(),
            origin: origin.to_array(),
        };
        scene.validate().map_err(|e| LoadError::new(e.to_string()))?;
        settings.scale_exponent = scale_exponent(scene.brightest_radiance());
        settings.validate().map_err(|e| LoadError::new(e.to_string()))?;
        Ok(Loaded { scene, settings, notes: self.notes, substitutions: Vec::new() })
    }

    fn read_meshes(&self) -> Result<Vec<Arc<FileMesh>>> {
        let wanted: Vec<String> = self.shown_attributes.iter().map(|shown| shown.name.clone()).collect();
        let read = |file: &MeshFile| {
            let bytes = self.read(&file.path, MESH_BYTES_MAX, &file.place)?;
            let name = self.folder.name_of(&file.path);
            let mesh = match file.format {
                MeshFormat::Ply => ply::parse(&name, &bytes, &wanted)?,
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

    /// Whether some mesh has each attribute that a texture shows, as a number where it shows a number.
    fn check_attributes(&self, files: &[Arc<FileMesh>]) -> Result<()> {
        for ShownAttribute { name, is_number, place } in &self.shown_attributes {
            let known = || files.iter().flat_map(|file| &file.attribute_names).map(String::as_str);
            if !known().any(|other| other == name) {
                let hint = did_you_mean(name, known());
                let list: Vec<&str> = known().collect::<BTreeSet<_>>().into_iter().collect();
                let list =
                    if list.is_empty() { "there is none".into() } else { format!("there are {}", list.join(", ")) };
                let message = format!("no mesh of this scene has an attribute '{name}'{hint}; {list}");
                return Err(LoadError::at(place.clone(), message));
            }
            let mut attributes = files.iter().flat_map(|file| &file.attributes).filter(|a| a.name == *name);
            if *is_number && attributes.any(|a| matches!(a.values, AttributeValues::Colours(_))) {
                let message = format!("the attribute '{name}' has three numbers; here one is wanted, so name another");
                return Err(LoadError::at(place.clone(), message));
            }
        }
        Ok(())
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

    /// Where everything lies: bounds in world space, and the origins that coordinates are taken from.
    fn space(&self, file_of: &(impl Fn(&MeshSource) -> Arc<FileMesh> + Sync)) -> Space {
        let of_meshes: Vec<_> = self
            .meshes
            .par_iter()
            .map(|placed| mesh::bounds(&file_of(&placed.source), &placed.placement.to_world))
            .collect();
        let join = |a: (DVec3, DVec3), b: (DVec3, DVec3)| (a.0.min(b.0), a.1.max(b.1));
        let of_shape = |shape: &PlacedShape| match shape.geometry {
            PlacedGeometry::Mesh(i) => of_meshes[i],
            ref analytic => analytic.bounds(),
        };
        let of_shapes = |shapes: &[PlacedShape]| shapes.iter().filter_map(of_shape).reduce(join);
        let centre = |bounds: Option<(DVec3, DVec3)>| bounds.map_or(DVec3::ZERO, |(min, max)| min + (max - min) * 0.5);
        let of_groups: Vec<_> = self.groups.iter().map(|shapes| of_shapes(shapes)).collect();
        let of_instances = self
            .instances
            .iter()
            .filter_map(|instance| of_groups[instance.group].map(|bounds| mapped_box(bounds, &instance.to_world)));
        let bounds = of_shapes(&self.shapes).into_iter().chain(of_instances).reduce(join);
        let mut origins = vec![centre(bounds); self.meshes.len()];
        for (shapes, bounds) in self.groups.iter().zip(&of_groups) {
            for shape in shapes {
                if let PlacedGeometry::Mesh(i) = shape.geometry {
                    origins[i] = centre(*bounds);
                }
            }
        }
        Space {
            bounds,
            origin: centre(bounds),
            of_groups: of_groups.into_iter().map(centre).collect(),
            of_meshes: origins,
        }
    }

    /// Shapes with an origin; those without any triangle are left out, and the meshes of the others are kept.
    fn kept_shapes(
        &mut self,
        placed: Vec<PlacedShape>,
        meshes: &[Arc<Mesh>],
        origin: DVec3,
        kept: &mut Kept,
    ) -> Vec<Shape> {
        let mut shapes = Vec::with_capacity(placed.len());
        for shape in placed {
            let geometry = match &shape.geometry {
                PlacedGeometry::Mesh(i) if meshes[*i].triangles.is_empty() => {
                    let text = format!("shape '{}' has no triangle with an area and is left out", shape.name);
                    self.notes.push(Note { place: None, text });
                    continue;
                }
                PlacedGeometry::Mesh(i) => Geometry::Mesh(*kept.ids[*i].get_or_insert_with(|| {
                    kept.meshes.push(meshes[*i].clone());
                    MeshId(index(kept.meshes.len() - 1))
                })),
                PlacedGeometry::Sphere { to_world, flip_normals } => {
                    Geometry::Sphere { to_world: moved(to_world, origin), flip_normals: *flip_normals }
                }
                PlacedGeometry::Disk { to_world, flip_normals } => {
                    Geometry::Disk { to_world: moved(to_world, origin), flip_normals: *flip_normals }
                }
                PlacedGeometry::Cylinder { to_world, flip_normals } => {
                    Geometry::Cylinder { to_world: moved(to_world, origin), flip_normals: *flip_normals }
                }
            };
            shapes.push(Shape { name: shape.name, geometry, bsdf: shape.bsdf, radiance: shape.radiance });
        }
        shapes
    }
}

/// Where a scene lies.
struct Space {
    /// Around all surfaces, in world space.
    bounds: Option<(DVec3, DVec3)>,
    /// The zero of the scene's coordinates, in world space.
    origin: DVec3,
    /// The zero of each group's coordinates, in the group's space.
    of_groups: Vec<DVec3>,
    /// The zero of the coordinates that each mesh is in.
    of_meshes: Vec<DVec3>,
}

/// The meshes that shapes are made of, and their new indices.
struct Kept {
    ids: Vec<Option<MeshId>>,
    meshes: Vec<Arc<Mesh>>,
}

/// Lists of the scene are shorter than 2^32: XML and OBJ files that could name more are refused for their size.
fn index(i: usize) -> u32 {
    u32::try_from(i).unwrap_or(u32::MAX)
}

/// All results, or the error of the first that failed, whichever thread met it first.
fn first_error<T>(results: Vec<Result<T>>) -> Result<Vec<T>> {
    results.into_iter().collect()
}
