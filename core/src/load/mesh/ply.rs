//! PLY, text or binary of either byte order: vertices with normals and texture coordinates, faces of any number of corners.
//!
//! `ply-rs-bw` reads the header; the payload is read here, straight into the mesh instead of into a map for each vertex.

use super::FileMesh;
use crate::load::error::{LoadError, Place, Result};
use glam::{DVec3, Vec2};
use ply_rs_bw::parser::{Parser, Reader};
use ply_rs_bw::ply::{DefaultElement, ElementDef, Encoding, PropertyType, ScalarType};
use std::io::Cursor;

/// The names under which the columns of a vertex are found: x, y, z, nx, ny, nz, u, v.
const COLUMNS: [&[&str]; 8] = [
    &["x"],
    &["y"],
    &["z"],
    &["nx"],
    &["ny"],
    &["nz"],
    &["u", "s", "texture_u", "texture_s"],
    &["v", "t", "texture_v", "texture_t"],
];

/// Reads a whole file; `name` is for messages.
///
/// # Errors
/// A header that is none, a payload that ends early, indices out of range, numbers that are not finite, no faces.
pub(crate) fn parse(name: &str, bytes: &[u8]) -> Result<FileMesh> {
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
            "vertex" => vertices(&mut payload, element, &mut mesh),
            "face" => faces(&mut payload, element, &mut mesh),
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
    match mesh.triangles.iter().position(|t| t.iter().any(|&i| i as usize >= vertices)) {
        Some(i) => Err(fail(format!(
            "triangle {i} refers to vertices {:?}, but there are only {vertices}, from 0; export the mesh again",
            mesh.triangles[i]
        ))),
        None => Ok(mesh),
    }
}

fn vertices(payload: &mut Payload, element: &ElementDef, mesh: &mut FileMesh) -> std::result::Result<(), String> {
    // For each property the column it fills.
    let column_of = |property: &str| COLUMNS.iter().position(|names| names.contains(&property));
    let columns: Vec<Option<usize>> = element.properties.keys().map(|property| column_of(property)).collect();
    let has = |wanted: std::ops::Range<usize>| wanted.into_iter().all(|column| columns.contains(&Some(column)));
    if !has(0..3) {
        return Err("the vertices have no x, y and z".into());
    }
    let (normals, uvs) = (has(3..6), has(6..8));
    let count = payload.plausible(element.count);
    mesh.positions.reserve_exact(count);
    mesh.normals.reserve_exact(if normals { count } else { 0 });
    mesh.uvs.reserve_exact(if uvs { count } else { 0 });
    for i in 0..element.count {
        let mut row = [0.0; COLUMNS.len()];
        for (property, column) in element.properties.values().zip(&columns) {
            match (&property.data_type, column) {
                (PropertyType::Scalar(kind), Some(column)) => row[*column] = payload.scalar(kind)?,
                (kind, _) => skip_property(payload, kind)?,
            }
        }
        let [x, y, z, nx, ny, nz, u, v] = row;
        let position = DVec3::new(x, y, z);
        if !position.as_vec3().is_finite() || !row.iter().all(|x| x.is_finite()) {
            return Err(format!("vertex {i} has a number that is not finite, or beyond 3e38; export the mesh again"));
        }
        mesh.positions.push(position);
        if normals {
            mesh.normals.push(DVec3::new(nx, ny, nz).normalize_or_zero().as_vec3());
        }
        if uvs {
            mesh.uvs.push(Vec2::new(u as f32, v as f32));
        }
    }
    Ok(())
}

fn faces(payload: &mut Payload, element: &ElementDef, mesh: &mut FileMesh) -> std::result::Result<(), String> {
    mesh.triangles.reserve_exact(payload.plausible(element.count));
    let is_indices = |name: &str| name == "vertex_indices" || name == "vertex_index";
    if !element.properties.keys().any(|name| is_indices(name)) {
        return Err("the faces have no list 'vertex_indices'".into());
    }
    for _ in 0..element.count {
        for (name, property) in &element.properties {
            match &property.data_type {
                PropertyType::List(count, index) if is_indices(name) => face(payload, count, index, mesh)?,
                kind => skip_property(payload, kind)?,
            }
        }
    }
    Ok(())
}

/// A fan of triangles around the face's first corner.
fn face(
    payload: &mut Payload,
    count: &ScalarType,
    index: &ScalarType,
    mesh: &mut FileMesh,
) -> std::result::Result<(), String> {
    let count = payload.scalar(count)?;
    let mut corners = [0; 3];
    for i in 0..count as u64 {
        let corner = payload.scalar(index)?;
        // Mitsuba reads indices as unsigned; a negative or fractional one is refused here.
        if corner < 0.0 || corner > f64::from(u32::MAX) || corner != corner.trunc() {
            return Err(format!("a face refers to vertex {corner}, which cannot be; export the mesh again"));
        }
        corners[i.min(2) as usize] = corner as u32;
        if i >= 2 {
            mesh.triangles.push(corners);
            corners[1] = corners[2];
        }
    }
    mesh.incomplete_faces += usize::from(count < 3.0);
    Ok(())
}

fn skip(payload: &mut Payload, element: &ElementDef) -> std::result::Result<(), String> {
    if element.properties.is_empty() {
        return Ok(());
    }
    for _ in 0..element.count {
        element.properties.values().try_for_each(|property| skip_property(payload, &property.data_type))?;
    }
    Ok(())
}

fn skip_property(payload: &mut Payload, kind: &PropertyType) -> std::result::Result<(), String> {
    match kind {
        PropertyType::Scalar(kind) => payload.scalar(kind).map(|_| ()),
        PropertyType::List(count, kind) => {
            let count = payload.scalar(count)?;
            (0..count as u64).try_for_each(|_| payload.scalar(kind).map(|_| ()))
        }
    }
}

/// The bytes behind the header.
struct Payload<'a> {
    encoding: Encoding,
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Payload<'a> {
    fn new(encoding: Encoding, bytes: &'a [u8], at: usize) -> Self {
        Self { encoding, bytes, at }
    }

    /// The number of rows to make room for: the header's, unless the bytes left cannot hold as many.
    fn plausible(&self, count: usize) -> usize {
        count.min((self.bytes.len() - self.at) / 2)
    }

    /// The next number.
    fn scalar(&mut self, kind: &ScalarType) -> std::result::Result<f64, String> {
        if self.encoding == Encoding::Ascii {
            return self.word();
        }
        Ok(match kind {
            ScalarType::Char => f64::from(i8::from_le_bytes(self.take()?)),
            ScalarType::UChar => f64::from(u8::from_le_bytes(self.take()?)),
            ScalarType::Short => f64::from(i16::from_le_bytes(self.take()?)),
            ScalarType::UShort => f64::from(u16::from_le_bytes(self.take()?)),
            ScalarType::Int => f64::from(i32::from_le_bytes(self.take()?)),
            ScalarType::UInt => f64::from(u32::from_le_bytes(self.take()?)),
            ScalarType::Float => f64::from(f32::from_le_bytes(self.take()?)),
            ScalarType::Double => f64::from_le_bytes(self.take()?),
        })
    }

    /// The next `N` bytes, little end first.
    fn take<const N: usize>(&mut self) -> std::result::Result<[u8; N], String> {
        let Some(bytes) = self.bytes[self.at..].first_chunk::<N>() else {
            return Err("the file ends before its last vertex or face: it is truncated; copy or export it again".into());
        };
        self.at += N;
        let mut bytes = *bytes;
        if self.encoding == Encoding::BinaryBigEndian {
            bytes.reverse();
        }
        Ok(bytes)
    }

    /// The next word of a text file as a number.
    fn word(&mut self) -> std::result::Result<f64, String> {
        let rest = &self.bytes[self.at..];
        let Some(blanks) = rest.iter().position(|b| !b.is_ascii_whitespace()) else {
            return Err("the file ends before its last vertex or face: it is truncated; copy or export it again".into());
        };
        let word = &rest[blanks..];
        let len = word.iter().position(u8::is_ascii_whitespace).unwrap_or(word.len());
        self.at += blanks + len;
        let text = String::from_utf8_lossy(&word[..len.min(40)]);
        text.parse().map_err(|_| format!("'{text}' is not a number"))
    }

    /// Number and text of the line just read, in a text file.
    fn line(&self) -> Option<(usize, String)> {
        if self.encoding != Encoding::Ascii {
            return None;
        }
        let at = self.at.saturating_sub(1);
        let number = self.bytes[..at].iter().filter(|&&b| b == b'\n').count() + 1;
        let line = self.bytes.split(|&b| b == b'\n').nth(number - 1).unwrap_or_default();
        Some((number, String::from_utf8_lossy(&line[..line.len().min(1000)]).into_owned()))
    }
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
        let mesh = parse("a.ply", &text(&header, body)).unwrap();
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
            meshes.push(parse("a.ply", &file).unwrap());
            file.pop();
            assert!(parse("a.ply", &file).unwrap_err().to_string().contains("truncated"));
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
            let message = parse("a.ply", &file).unwrap_err().to_string();
            assert!(message.contains(expected), "{message}");
        }
    }

    #[test]
    fn a_header_that_promises_too_much_is_refused_quickly() {
        for element in ["vertex", "face", "other"] {
            let header = format!("element {element} 18446744073709551615\nproperty float x\nend_header\n");
            assert!(parse("a.ply", &text(&header, "")).is_err());
            let empty = format!("element {element} 18446744073709551615\nend_header\n");
            assert!(parse("a.ply", &text(&empty, "")).is_err());
        }
    }
}
