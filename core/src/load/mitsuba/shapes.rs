//! Shapes: surfaces with their material and light.

use super::Loader;
use super::document::{ObjectId, Tag};
use super::plugins::{Build, Parameter, Plugin, Takes, child, parameter, unmodelled};
use super::properties::Properties;
use crate::load::assembly::{MeshFormat, MeshSource};
use crate::load::error::Result;
use crate::load::mesh::{Placement, primitives};
use crate::load::placed::{PlacedGeometry, PlacedInstance, PlacedShape};
use glam::{DAffine3, DMat3, DVec3};
use std::sync::Arc;

const TO_WORLD: Parameter = parameter("to_world", Takes::Transform, "Object to world space.");
const FLIP_NORMALS: Parameter = parameter("flip_normals", Takes::Boolean(false), "Turn normals to the other side.");
const FACE_NORMALS: Parameter =
    parameter("face_normals", Takes::Boolean(false), "Shade with the faces' own normals; nothing looks smooth.");
const FILENAME: Parameter = parameter("filename", Takes::File, "The mesh.");
const BSDF: Parameter = child(Tag::Bsdf, "What it is made of; by default grey, or black if it shines.");
const EMITTER: Parameter = child(Tag::Emitter, "An area light makes it shine.");
const SILHOUETTE: Parameter =
    unmodelled("silhouette_sampling_weight", Takes::Float(Some(1.0)), "it is for differentiable rendering");

pub(crate) const PLUGINS: &[Plugin] = &[
    Plugin {
        name: "obj",
        doc: "A Wavefront OBJ file; its materials are not used.",
        parameters: &[
            FILENAME,
            TO_WORLD,
            FACE_NORMALS,
            FLIP_NORMALS,
            parameter("flip_tex_coords", Takes::Boolean(true), "Turn texture coordinates upside down."),
            BSDF,
            EMITTER,
            SILHOUETTE,
        ],
        build: Build::Shape(obj),
    },
    Plugin {
        name: "ply",
        doc: "A PLY file, text or binary.",
        parameters: &[
            FILENAME,
            TO_WORLD,
            FACE_NORMALS,
            FLIP_NORMALS,
            parameter("flip_tex_coords", Takes::Boolean(false), "Turn texture coordinates upside down."),
            BSDF,
            EMITTER,
            SILHOUETTE,
        ],
        build: Build::Shape(ply),
    },
    Plugin {
        name: "serialized",
        doc: "A mesh of a file of Mitsuba's own format.",
        parameters: &[
            FILENAME,
            parameter("shape_index", Takes::Integer(Some(0)), "Which of the file's meshes."),
            TO_WORLD,
            FACE_NORMALS,
            FLIP_NORMALS,
            BSDF,
            EMITTER,
            SILHOUETTE,
        ],
        build: Build::Shape(serialized),
    },
    Plugin {
        name: "rectangle",
        doc: "The square from (-1, -1, 0) to (1, 1, 0), normal +z.",
        parameters: &[TO_WORLD, FACE_NORMALS, FLIP_NORMALS, BSDF, EMITTER, SILHOUETTE],
        build: Build::Shape(rectangle),
    },
    Plugin {
        name: "cube",
        doc: "The cube from (-1, -1, -1) to (1, 1, 1).",
        parameters: &[TO_WORLD, FACE_NORMALS, FLIP_NORMALS, BSDF, EMITTER, SILHOUETTE],
        build: Build::Shape(cube),
    },
    Plugin {
        name: "sphere",
        doc: "A sphere, exactly round.",
        parameters: &[
            parameter("center", Takes::Vector(Some([0.0; 3])), "Its centre."),
            parameter("radius", Takes::Float(Some(1.0)), "Its radius."),
            TO_WORLD,
            FLIP_NORMALS,
            BSDF,
            EMITTER,
            SILHOUETTE,
        ],
        build: Build::Shape(sphere),
    },
    Plugin {
        name: "disk",
        doc: "The unit disk in the plane z = 0, normal +z, exactly round.",
        parameters: &[TO_WORLD, FLIP_NORMALS, BSDF, EMITTER, SILHOUETTE],
        build: Build::Shape(disk),
    },
    Plugin {
        name: "cylinder",
        doc: "A cylinder without caps, exactly round, normals outwards.",
        parameters: &[
            parameter("p0", Takes::Vector(Some([0.0; 3])), "Where its axis begins."),
            parameter("p1", Takes::Vector(Some([0.0, 0.0, 1.0])), "Where its axis ends."),
            parameter("radius", Takes::Float(Some(1.0)), "Its radius."),
            TO_WORLD,
            FLIP_NORMALS,
            BSDF,
            EMITTER,
            SILHOUETTE,
        ],
        build: Build::Shape(cylinder),
    },
    Plugin {
        name: "shapegroup",
        doc: "Shapes that are kept once and seen only where instances place them; none of them may shine.",
        parameters: &[child(Tag::Shape, "What is in it: no instances and no other groups.")],
        build: Build::Shape(misplaced_group),
    },
    Plugin {
        name: "instance",
        doc: "A shapegroup in its place.",
        parameters: &[TO_WORLD, child(Tag::Shape, "The shapegroup.")],
        build: Build::Shape(instance),
    },
];

/// Relative difference between its axes up to which a transformation counts as a similarity.
const SIMILARITY_TOLERANCE: f64 = 1e-4;

impl Loader<'_> {
    /// Adds the shape that an object describes to the scene.
    pub fn shape(&mut self, id: ObjectId) -> Result<()> {
        let document = self.document;
        let properties = Properties::new(document, id, &mut self.assembly.notes)?;
        self.made.insert(id);
        match properties.plugin.build {
            Build::Shape(build) => build(self, &properties),
            _ => Err(super::misplaced(&properties)),
        }
    }

    /// The group of shapes that an object describes, made once however often it is placed.
    fn group(&mut self, id: ObjectId) -> Result<usize> {
        if let Some(known) = self.groups.get(&id) {
            return Ok(*known);
        }
        let properties = Properties::new(self.document, id, &mut self.assembly.notes)?;
        self.made.insert(id);
        let outside = std::mem::take(&mut self.assembly.shapes);
        self.in_group = true;
        for (child, span) in properties.children(Tag::Shape) {
            if ["shapegroup", "instance"].contains(&self.document.object(child).plugin.as_str()) {
                let message = "a shapegroup can hold neither instances nor other groups; put their shapes into it";
                return Err(properties.error(span, message));
            }
            self.shape(child)?;
        }
        self.in_group = false;
        let shapes = std::mem::replace(&mut self.assembly.shapes, outside);
        if shapes.is_empty() {
            return Err(properties.error(&properties.object.span, "this shapegroup is empty; put shapes into it"));
        }
        self.assembly.groups.push(shapes);
        let group = self.assembly.groups.len() - 1;
        self.groups.insert(id, group);
        Ok(group)
    }

    /// Adds a shape of a geometry with the material and light that stand in it.
    fn add(&mut self, properties: &Properties, name: Option<&str>, geometry: PlacedGeometry) -> Result<()> {
        let light = properties.child(Tag::Emitter)?;
        if let Some((_, span)) = properties.children(Tag::Emitter).next().filter(|_| self.in_group) {
            let message =
                "a shape that shines cannot stand in a shapegroup: lights cannot be instanced; place it itself";
            return Err(properties.error(span, message));
        }
        let radiance = light.map(|light| self.area_light(light, properties)).transpose()?;
        let bsdf = match properties.child(Tag::Bsdf)? {
            Some(id) => self.bsdf(id)?,
            None => self.default_bsdf(light.is_some()),
        };
        let name = properties.object.id.as_deref().or(name).unwrap_or(properties.plugin.name).to_owned();
        self.assembly.shapes.push(PlacedShape { name, geometry, bsdf, radiance });
        Ok(())
    }

    fn mesh_file(&mut self, properties: &Properties, format: MeshFormat, flip_v: bool) -> Result<()> {
        let (name, span) = properties.file("filename")?;
        let path = self.locate(name, span)?;
        let source = self.assembly.mesh_file(path, format, self.document.place(span));
        let geometry = self.assembly.mesh(source, Placement { flip_v, ..placement(properties)? });
        self.add(properties, Some(name), geometry)
    }
}

fn placement(properties: &Properties) -> Result<Placement> {
    Ok(Placement {
        to_world: properties.transform("to_world")?,
        face_normals: properties.boolean("face_normals"),
        flip_normals: properties.boolean("flip_normals"),
        flip_v: false,
    })
}

fn obj(loader: &mut Loader, properties: &Properties) -> Result<()> {
    loader.mesh_file(properties, MeshFormat::Obj, properties.boolean("flip_tex_coords"))
}

fn ply(loader: &mut Loader, properties: &Properties) -> Result<()> {
    loader.mesh_file(properties, MeshFormat::Ply, properties.boolean("flip_tex_coords"))
}

fn serialized(loader: &mut Loader, properties: &Properties) -> Result<()> {
    let shape_index = properties.count("shape_index", 0)?;
    loader.mesh_file(properties, MeshFormat::Serialized { shape_index }, false)
}

fn rectangle(loader: &mut Loader, properties: &Properties) -> Result<()> {
    let source = MeshSource::Ready(Arc::new(primitives::rectangle()));
    let geometry = loader.assembly.mesh(source, placement(properties)?);
    loader.add(properties, None, geometry)
}

fn cube(loader: &mut Loader, properties: &Properties) -> Result<()> {
    let source = MeshSource::Ready(Arc::new(primitives::cube()));
    let geometry = loader.assembly.mesh(source, placement(properties)?);
    loader.add(properties, None, geometry)
}

fn sphere(loader: &mut Loader, properties: &Properties) -> Result<()> {
    let radius = properties.float_in("radius", f64::MIN_POSITIVE.., "above 0")?;
    let own = DAffine3::from_scale_rotation_translation(
        DVec3::splat(radius),
        glam::DQuat::IDENTITY,
        properties.vector("center")?,
    );
    let to_world = properties.transform("to_world")? * own;
    if !is_similarity(&to_world) {
        let message = "a sphere can be scaled only alike along all axes, and not sheared; use a mesh for an ellipsoid";
        return Err(properties.wrong("to_world", message));
    }
    // As in Mitsuba, a mirrored sphere is turned inside out.
    let flip_normals = properties.boolean("flip_normals") != (to_world.matrix3.determinant() < 0.0);
    loader.add(properties, None, PlacedGeometry::Sphere { to_world, flip_normals })
}

fn disk(loader: &mut Loader, properties: &Properties) -> Result<()> {
    let to_world = properties.transform("to_world")?;
    loader.add(properties, None, PlacedGeometry::Disk { to_world, flip_normals: properties.boolean("flip_normals") })
}

fn cylinder(loader: &mut Loader, properties: &Properties) -> Result<()> {
    let radius = properties.float_in("radius", f64::MIN_POSITIVE.., "above 0")?;
    let (p0, p1) = (properties.vector("p0")?, properties.vector("p1")?);
    let length = (p1 - p0).length();
    let Some(axis) = (p1 - p0).try_normalize() else {
        return Err(properties.wrong("p1", "'p0' and 'p1' are the same point, so the cylinder has no axis"));
    };
    let (s, t) = tangents(axis);
    let own = DAffine3 { matrix3: DMat3::from_cols(s * radius, t * radius, axis * length), translation: p0 };
    let to_world = properties.transform("to_world")? * own;
    let flip_normals = properties.boolean("flip_normals");
    loader.add(properties, None, PlacedGeometry::Cylinder { to_world, flip_normals })
}

/// A group is no shape itself: the scene passes it over, and only instances refer to it.
fn misplaced_group(_: &mut Loader, properties: &Properties) -> Result<()> {
    Err(super::misplaced(properties))
}

fn instance(loader: &mut Loader, properties: &Properties) -> Result<()> {
    let group = properties.child(Tag::Shape)?;
    let is_group = |id: &ObjectId| loader.document.object(*id).plugin == "shapegroup";
    let Some(group) = group.filter(is_group) else {
        let message = "an instance needs a shapegroup, and nothing else; refer to one by <ref id=\"…\"/>";
        return Err(properties.error(&properties.object.span, message));
    };
    let group = loader.group(group)?;
    let to_world = properties.transform("to_world")?;
    loader.assembly.instances.push(PlacedInstance { group, to_world });
    Ok(())
}

/// The two tangents that Mitsuba takes with a unit normal (Duff et al. 2017): texture coordinates begin there.
fn tangents(n: DVec3) -> (DVec3, DVec3) {
    let sign = 1f64.copysign(n.z);
    let a = -1.0 / (sign + n.z);
    let b = n.x * n.y * a;
    let s = DVec3::new(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x);
    (s, DVec3::new(b, sign + n.y * n.y * a, -n.y))
}

/// Whether a transformation keeps angles.
pub(super) fn is_similarity(transform: &DAffine3) -> bool {
    let m = transform.matrix3;
    let lengths = [m.x_axis, m.y_axis, m.z_axis].map(|axis| axis.length_squared());
    let off_diagonal = [m.x_axis.dot(m.y_axis), m.y_axis.dot(m.z_axis), m.z_axis.dot(m.x_axis)];
    let allowed = SIMILARITY_TOLERANCE * lengths[0];
    lengths.iter().all(|x| (x - lengths[0]).abs() <= allowed) && off_diagonal.iter().all(|x| x.abs() <= allowed)
}
