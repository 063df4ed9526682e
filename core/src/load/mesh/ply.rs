//! PLY, text or binary of either byte order: vertices with normals and texture coordinates, faces of any number of corners,
//! attributes of both.
//!
//! `ply-rs-bw` reads the header; the payload is read here, straight into the mesh instead of into a map for each vertex, and
//! on all processors where every row has the same length.

mod columns;
mod payload;

use super::FileMesh;
use crate::load::error::{LoadError, Place, Result};
use crate::scene::Attribute;
use columns::{Channels, Columns};
use glam::{DVec3, Vec2};
use payload::{Payload, Row, Rows, integer};
use ply_rs_bw::parser::{Parser, Reader};
use ply_rs_bw::ply::{DefaultElement, ElementDef, PropertyDef, PropertyType, ScalarType};
use rayon::prelude::*;
use std::io::Cursor;

type Told<T> = std::result::Result<T, String>;

/// Reads a whole file; `name` is for messages. Of the attributes those are read that `wanted` names.
///
/// # Errors
/// A header that is none, a payload that ends early, indices out of range, numbers that are not finite, no faces.
pub(crate) fn parse(name: &str, bytes: &[u8], wanted: &[String]) -> Result<FileMesh> {
    let fail = |message: String| LoadError::at(Place::file(name), message);
    let mut reader = Reader::new(Cursor::new(bytes));
    let header = Parser::<DefaultElement>::new()
        .read_header(&mut reader)
        .map_err(|e| fail(format!("this is no PLY file, or its header is damaged ({e})")))?;
    let start = usize::try_from(reader.into_inner().position()).unwrap_or(usize::MAX).min(bytes.len());
    let mut payload = Payload::new(header.encoding, bytes, start);
    let mut mesh = FileMesh::default();
    for (kind, element) in &header.elements {
        let read = match kind.as_str() {
            "vertex" => vertices(&mut payload, element, wanted, &mut mesh),
            "face" => faces(&mut payload, element, wanted, &mut mesh),
            _ => skip(&mut payload, element),
        };
        read.map_err(|message| match payload.line() {
            Some((number, line)) => LoadError::at(Place::on_line(name, number, &line), message),
            None => fail(message),
        })?;
    }
    if mesh.triangles.is_empty() {
        return Err(fail("this PLY file has no faces; export the mesh with faces".into()));
    }
    let vertices = mesh.positions.len();
    match mesh.triangles.par_iter().position_first(|t| t.iter().any(|&i| i as usize >= vertices)) {
        Some(i) => Err(fail(format!(
            "triangle {i} refers to vertices {:?}, but there are only {vertices}, from 0; export the mesh again",
            mesh.triangles[i]
        ))),
        None => Ok(mesh),
    }
}

fn vertices(payload: &mut Payload, element: &ElementDef, wanted: &[String], mesh: &mut FileMesh) -> Told<()> {
    let columns = Columns::of(element, Attribute::AT_VERTICES);
    let Some([x, y, z]) = columns.position else {
        return Err("the vertices have no x, y and z".into());
    };
    let channels = columns.wanted(wanted);
    let rows = payload.rows(element, "vertex", &columns.numbers(&channels))?;
    mesh.positions = rows.collect(|row| DVec3::new(row.get(x), row.get(y), row.get(z)));
    if let Some([x, y, z]) = columns.normal {
        let unit = |row: Row| DVec3::new(row.get(x), row.get(y), row.get(z)).normalize_or_zero().as_vec3();
        mesh.normals = rows.collect(unit);
    }
    if let Some([u, v]) = columns.uv {
        mesh.uvs = rows.collect(|row| Vec2::new(row.get(u) as f32, row.get(v) as f32));
    }
    mesh.attributes.extend(channels.iter().map(|channels| channels.attribute(&rows)));
    mesh.attribute_names.extend(columns.attributes.into_iter().map(|channels| channels.name));
    Ok(())
}

fn faces(payload: &mut Payload, element: &ElementDef, wanted: &[String], mesh: &mut FileMesh) -> Told<()> {
    let is_corners = |(name, property): (&String, &PropertyDef)| {
        matches!(property.data_type, PropertyType::List(..)) && (name == "vertex_indices" || name == "vertex_index")
    };
    let Some(corners) = element.properties.iter().position(is_corners) else {
        return Err("the faces have no list 'vertex_indices'".into());
    };
    let columns = Columns::of(element, Attribute::ON_FACES);
    let channels = columns.wanted(wanted);
    if let Some((rows, first)) = payload.triangles(element, corners, &columns.numbers(&channels))? {
        mesh.triangles = rows.collect(|row| [0, 1, 2].map(|k| integer(row.get(first + k)).unwrap_or(u32::MAX)));
        mesh.attributes.extend(channels.iter().map(|channels| channels.attribute(&rows)));
    } else {
        polygons(payload, element, corners, &channels, mesh)?;
    }
    mesh.attribute_names.extend(columns.attributes.into_iter().map(|channels| channels.name));
    Ok(())
}

/// Faces of any number of corners, one by one. A face's attributes are those of each of its triangles.
fn polygons(
    payload: &mut Payload,
    element: &ElementDef,
    corners: usize,
    channels: &[Channels],
    mesh: &mut FileMesh,
) -> Told<()> {
    mesh.triangles.reserve_exact(payload.plausible(element.count));
    let width = element.properties.len();
    let mut table = Vec::new();
    let mut row = vec![0.0; width];
    for _ in 0..element.count {
        let before = mesh.triangles.len();
        for (i, property) in element.properties.values().enumerate() {
            match &property.data_type {
                PropertyType::List(count, index) if i == corners => face(payload, count, index, mesh)?,
                PropertyType::Scalar(kind) => row[i] = payload.scalar(kind)?,
                PropertyType::List(..) => payload.skip(&property.data_type)?,
            }
        }
        if !channels.is_empty() {
            (before..mesh.triangles.len()).for_each(|_| table.extend(&row));
        }
    }
    let rows = Rows::table(table, width);
    mesh.attributes.extend(channels.iter().map(|channels| channels.attribute(&rows)));
    Ok(())
}

/// A fan of triangles around the face's first corner.
fn face(payload: &mut Payload, count: &ScalarType, index: &ScalarType, mesh: &mut FileMesh) -> Told<()> {
    let count = payload.scalar(count)?;
    let mut corners = [0; 3];
    for i in 0..count as u64 {
        let corner = payload.scalar(index)?;
        // Mitsuba reads indices as unsigned; a negative or fractional one is refused here.
        let Some(corner) = integer(corner) else {
            return Err(format!("a face refers to vertex {corner}, which cannot be; export the mesh again"));
        };
        corners[i.min(2) as usize] = corner;
        if i >= 2 {
            mesh.triangles.push(corners);
            corners[1] = corners[2];
        }
    }
    mesh.incomplete_faces += usize::from(count < 3.0);
    Ok(())
}

fn skip(payload: &mut Payload, element: &ElementDef) -> Told<()> {
    if element.properties.is_empty() {
        return Ok(());
    }
    for _ in 0..element.count {
        element.properties.values().try_for_each(|property| payload.skip(&property.data_type))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    const VERTICES: &str = "element vertex 4\nproperty float x\nproperty float y\nproperty double z\n";
    const FACES: &str = "element face 1\nproperty list uchar int vertex_indices\nend_header\n";
    const SQUARE: &str = "0 0 0\n1 0 0\n1 1 0\n0 1 0\n";

    fn text(header: &str, body: &str) -> Vec<u8> {
        format!("ply\nformat ascii 1.0\ncomment made by hand\n{header}{body}").into_bytes()
    }

    #[test]
    fn text_with_normals_texture_coordinates_and_a_quad() {
        let header = format!(
            "{VERTICES}property float nx\nproperty float ny\nproperty float nz\nproperty uchar red\nproperty float s\n\
             property float t\n{FACES}"
        );
        let body = "0 0 0 0 3 4 255 .1 .2\n1 0 0 0 0 1 0 .3 .4\n1 1 0 0 0 1 0 .5 .6\n0 1 0 0 0 0 0 .7 .8\n4 0 1 2 3\n";
        let mesh = parse("a.ply", &text(&header, body), &[]).unwrap();
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
        assert_eq!(mesh.normals[0], Vec3::new(0.0, 0.6, 0.8));
        assert_eq!((mesh.normals[3], mesh.uvs[2]), (Vec3::ZERO, Vec2::new(0.5, 0.6)));
    }

    #[test]
    fn both_byte_orders_say_the_same() {
        let mut meshes = Vec::new();
        for big in [false, true] {
            let order = if big { "big" } else { "little" };
            let mut file = format!("ply\nformat binary_{order}_endian 1.0\n{VERTICES}{FACES}").into_bytes();
            for [x, y] in [[0.0f32, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]] {
                for value in [x, y] {
                    file.extend(if big { value.to_be_bytes() } else { value.to_le_bytes() });
                }
                file.extend(if big { 0.1f64.to_be_bytes() } else { 0.1f64.to_le_bytes() });
            }
            file.push(3);
            (0..3i32).for_each(|i| file.extend(if big { i.to_be_bytes() } else { i.to_le_bytes() }));
            meshes.push(parse("a.ply", &file, &[]).unwrap());
            file.pop();
            assert!(parse("a.ply", &file, &[]).unwrap_err().to_string().contains("truncated"));
        }
        assert_eq!(meshes[0], meshes[1]);
        assert_eq!(meshes[0].positions[2], DVec3::new(1.0, 1.0, 0.1));
    }

    #[test]
    fn each_fault_is_told() {
        let with = |body: &str| text(&format!("{VERTICES}{FACES}"), body);
        for (file, expected) in [
            (b"solid cube\n".to_vec(), "no PLY file"),
            (Vec::new(), "no PLY file"),
            (text(&format!("{VERTICES}end_header\n"), SQUARE), "no faces"),
            (text(&format!("{}{FACES}", VERTICES.replace(" z", " w")), SQUARE), "no x, y and z"),
            (with(&format!("{SQUARE}3 0 1 9\n")), "refers to vertices [0, 1, 9], but there are only 4"),
            (with(&format!("{SQUARE}3 0 1 -1\n")), "a.ply:15:1: a face refers to vertex -1"),
            (with("0 0 nan\n"), "a.ply:11:1: vertex 0 has a number that is not finite"),
            (with("0 0 zero\n"), "'zero' is not a number"),
            (with("0 0 0\n"), "truncated"),
        ] {
            let message = parse("a.ply", &file, &[]).unwrap_err().to_string();
            assert!(message.contains(expected), "{message}");
        }
    }

    #[test]
    fn a_header_that_promises_too_much_is_refused_quickly() {
        for element in ["vertex", "face", "other"] {
            let header = format!("element {element} 18446744073709551615\nproperty float x\nend_header\n");
            assert!(parse("a.ply", &text(&header, ""), &[]).is_err());
            let empty = format!("element {element} 18446744073709551615\nend_header\n");
            assert!(parse("a.ply", &text(&empty, ""), &[]).is_err());
        }
    }
}
