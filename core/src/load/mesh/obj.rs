//! Wavefront OBJ: positions, normals, texture coordinates, faces, and the names of materials.
//!
//! Own code rather than the `tobj` crate: errors name the line and show it, and only positions are f64. Polygons become
//! fans; groups, objects, smoothing, lines and curves are passed over; `#` begins a comment.

use super::FileMesh;
use crate::load::error::{LoadError, Place, Result, did_you_mean};
use glam::{DVec3, Vec2, Vec3};
use std::ops::Range;

/// A corner without normal or texture coordinate has this index there.
const NONE: u32 = u32::MAX;

/// An OBJ file, faces in triangles.
#[derive(Debug, Default)]
pub(crate) struct ObjFile {
    positions: Vec<DVec3>,
    uvs: Vec<Vec2>,
    normals: Vec<Vec3>,
    /// Position, texture coordinate and normal of each corner; three corners a triangle.
    corners: Vec<[u32; 3]>,
    incomplete_faces: usize,
    /// `usemtl`, in order.
    pub uses: Vec<Use>,
    /// `mtllib`, in order: names and lines.
    pub libraries: Vec<(String, usize)>,
}

/// `usemtl`: from `first_triangle` on the material `name` is used.
#[derive(Debug)]
pub(crate) struct Use {
    pub name: String,
    pub line: usize,
    pub first_triangle: usize,
}

/// Reads a whole file; `name` is for messages.
///
/// # Errors
/// The first line that cannot be read, index out of range or number that is not finite; a file without faces.
pub(crate) fn parse(name: &str, bytes: &[u8]) -> Result<ObjFile> {
    let mut file = ObjFile::default();
    for (i, line) in bytes.split(|&b| b == b'\n').enumerate() {
        file.line(line, i + 1)
            .map_err(|message| LoadError::at(Place::on_line(name, i + 1, &String::from_utf8_lossy(line)), message))?;
    }
    if file.corners.is_empty() {
        let message = match file.positions.is_empty() {
            true => "this OBJ file has no vertices and no faces; is it an OBJ file?",
            false => "this OBJ file has vertices but no faces; export it with faces",
        };
        return Err(LoadError::at(Place::file(name), message));
    }
    Ok(file)
}

impl ObjFile {
    fn line(&mut self, line: &[u8], number: usize) -> std::result::Result<(), String> {
        let line = line.split(|&b| b == b'#').next().unwrap_or_default();
        let mut words = line.split(|b| b.is_ascii_whitespace()).filter(|word| !word.is_empty());
        match words.next() {
            Some(b"v") => {
                let position = DVec3::from(floats(&mut words)?);
                // Beyond f32, lengths and areas would overflow.
                if !position.as_vec3().is_finite() {
                    return Err(
                        "this position is not finite, or beyond 3e38; correct it or export the mesh again".into()
                    );
                }
                self.positions.push(position);
            }
            Some(b"vt") => {
                let [u, v] = floats(&mut words)?;
                self.uvs.push(Vec2::new(u as f32, v as f32));
            }
            Some(b"vn") => self.normals.push(DVec3::from(floats(&mut words)?).normalize_or_zero().as_vec3()),
            Some(b"f") => self.face(words)?,
            Some(b"usemtl") => self.uses.push(Use {
                name: rest_of(line, b"usemtl"),
                line: number,
                first_triangle: self.corners.len() / 3,
            }),
            Some(b"mtllib") => self.libraries.push((rest_of(line, b"mtllib"), number)),
            Some(word) if !SKIPPED.contains(&word) => {
                let word = String::from_utf8_lossy(&word[..word.len().min(40)]).into_owned();
                let known = ["v", "vt", "vn", "f", "usemtl", "mtllib"].into_iter();
                let known = known.chain(SKIPPED.iter().filter_map(|word| std::str::from_utf8(word).ok()));
                return Err(format!(
                    "OBJ files have no '{word}' lines{}; is it an OBJ file?",
                    did_you_mean(&word, known)
                ));
            }
            _ => {}
        }
        Ok(())
    }

    /// A fan of triangles around the face's first corner.
    fn face<'a>(&mut self, words: impl Iterator<Item = &'a [u8]>) -> std::result::Result<(), String> {
        let (mut first, mut last, mut count) = ([NONE; 3], [NONE; 3], 0);
        for word in words {
            let corner = self.corner(word)?;
            match count {
                0 => first = corner,
                1 => {}
                _ => self.corners.extend([first, last, corner]),
            }
            last = corner;
            count += 1;
        }
        self.incomplete_faces += usize::from(count < 3);
        match self.corners.len() <= NONE as usize {
            true => Ok(()),
            false => Err("this file has more than a billion triangles; split it".into()),
        }
    }

    /// `v`, `v/vt`, `v//vn` or `v/vt/vn`; negative indices count back from the latest.
    fn corner(&self, word: &[u8]) -> std::result::Result<[u32; 3], String> {
        let shown = || String::from_utf8_lossy(&word[..word.len().min(40)]).into_owned();
        let lists = [
            ("position", self.positions.len()),
            ("texture coordinate", self.uvs.len()),
            ("normal", self.normals.len()),
        ];
        let mut corner = [NONE; 3];
        let mut parts = word.split(|&b| b == b'/');
        for (i, (slot, (what, len))) in corner.iter_mut().zip(lists).enumerate() {
            let Some(part) = parts.next() else { break };
            if part.is_empty() && i > 0 {
                continue;
            }
            let index =
                parse_index(part).ok_or_else(|| format!("'{}' is not a corner such as 1, 1/2 or 1/2/3", shown()))?;
            let zero_based = if index > 0 { index - 1 } else { len as i64 + index };
            *slot = match u32::try_from(zero_based) {
                Ok(found) if (found as usize) < len && index != 0 => found,
                _ => {
                    return Err(format!(
                        "this face refers to {what} {index}, but only {len} of them precede it; correct the index or \
                         export the mesh again"
                    ));
                }
            };
        }
        if corner[0] == NONE || parts.next().is_some() {
            return Err(format!("'{}' is not a corner such as 1, 1/2 or 1/2/3", shown()));
        }
        Ok(corner)
    }

    /// Triangles in the file.
    pub fn triangle_count(&self) -> usize {
        self.corners.len() / 3
    }

    /// Whether any face has normals.
    pub fn has_normals(&self) -> bool {
        self.corners.iter().any(|corner| corner[2] != NONE)
    }

    /// All triangles as a mesh.
    pub fn whole(&self) -> FileMesh {
        self.mesh(std::slice::from_ref(&(0..self.triangle_count())))
    }

    /// Some of the triangles as a mesh, one vertex for each combination of position, texture coordinate and normal, in
    /// order of first use.
    pub fn mesh(&self, triangles: &[Range<usize>]) -> FileMesh {
        let corners = || triangles.iter().flat_map(|range| &self.corners[3 * range.start..3 * range.end]);
        let has_uvs = corners().any(|corner| corner[1] != NONE);
        let has_normals = corners().any(|corner| corner[2] != NONE);
        let mut mesh = FileMesh { incomplete_faces: self.incomplete_faces, ..FileMesh::default() };
        // For each position the vertices made of it, as a list through `next`.
        let mut first = vec![NONE; self.positions.len()];
        let mut made: Vec<([u32; 3], u32)> = Vec::new();
        let indices = corners().map(|corner| {
            let mut at = first[corner[0] as usize];
            while at != NONE && made[at as usize].0 != *corner {
                at = made[at as usize].1;
            }
            if at == NONE {
                at = made.len() as u32;
                made.push((*corner, std::mem::replace(&mut first[corner[0] as usize], at)));
            }
            at
        });
        let indices: Vec<u32> = indices.collect();
        mesh.triangles = indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect();
        mesh.positions = made.iter().map(|(corner, _)| self.positions[corner[0] as usize]).collect();
        if has_uvs {
            mesh.uvs = made.iter().map(|(c, _)| self.uvs.get(c[1] as usize).copied().unwrap_or_default()).collect();
        }
        if has_normals {
            mesh.normals =
                made.iter().map(|(c, _)| self.normals.get(c[2] as usize).copied().unwrap_or_default()).collect();
        }
        mesh
    }
}

/// Lines that say nothing about triangles.
const SKIPPED: &[&[u8]] = &[
    b"g",
    b"o",
    b"s",
    b"mg",
    b"l",
    b"p",
    b"vp",
    b"cstype",
    b"deg",
    b"bmat",
    b"step",
    b"curv",
    b"curv2",
    b"surf",
    b"parm",
    b"trim",
    b"hole",
    b"scrv",
    b"sp",
    b"end",
    b"con",
    b"bevel",
    b"c_interp",
    b"d_interp",
    b"lod",
    b"usemap",
    b"maplib",
    b"shadow_obj",
    b"trace_obj",
    b"ctech",
    b"stech",
    b"call",
    b"csh",
];

/// The text behind a keyword: names may contain blanks.
fn rest_of(line: &[u8], keyword: &[u8]) -> String {
    let text = String::from_utf8_lossy(line);
    let keyword = String::from_utf8_lossy(keyword);
    text.trim().strip_prefix(&*keyword).unwrap_or_default().trim().to_owned()
}

/// The next `N` words as finite numbers.
fn floats<'a, const N: usize>(words: &mut impl Iterator<Item = &'a [u8]>) -> std::result::Result<[f64; N], String> {
    let mut numbers = [0.0; N];
    for number in &mut numbers {
        let word = words.next().ok_or_else(|| format!("{N} numbers are needed here"))?;
        let text = std::str::from_utf8(word).unwrap_or("?");
        let x: f64 = text.parse().map_err(|_| {
            let shown: String = text.chars().take(40).collect();
            format!("'{shown}' is not a number")
        })?;
        if !x.is_finite() {
            return Err(format!("{x} is not a finite number; correct it or export the mesh again"));
        }
        *number = x;
    }
    Ok(numbers)
}

fn parse_index(digits: &[u8]) -> Option<i64> {
    std::str::from_utf8(digits).ok()?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mesh(text: &str) -> FileMesh {
        let file = parse("a.obj", text.as_bytes()).unwrap();
        file.whole()
    }

    fn message(text: &str) -> String {
        parse("a.obj", text.as_bytes()).unwrap_err().to_string()
    }

    const SQUARE: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 1\nvn 0 0 2\n";

    /// As Mitsuba 3.9.1 numbers and splits them.
    #[test]
    fn polygons_become_fans_and_vertices_keep_the_order_of_use() {
        let mesh = mesh("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv -1 .5 0\nf 5 1 2 3 4 # five\n");
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3], [0, 3, 4]]);
        assert_eq!(mesh.positions[0], DVec3::new(-1.0, 0.5, 0.0));
        assert!(mesh.normals.is_empty() && mesh.uvs.is_empty());
    }

    #[test]
    fn vertices_are_split_where_texture_coordinates_or_normals_differ() {
        let mesh = mesh(&format!("{SQUARE}f 1/1/1 2/1/1 3/1/1\nf 1/2/1 -2/1/1 -1//1\nf 1 2\n"));
        assert_eq!(mesh.triangles, [[0, 1, 2], [3, 2, 4]]);
        assert_eq!(mesh.uvs[3], Vec2::ONE);
        assert_eq!(mesh.uvs[4], Vec2::ZERO);
        assert_eq!(mesh.normals, [Vec3::Z; 5]);
        assert_eq!(mesh.incomplete_faces, 1);
    }

    #[test]
    fn materials_and_libraries_keep_their_names() {
        let file = parse(
            "a.obj",
            format!("mtllib my file.mtl\n{SQUARE}usemtl red one\nf 1 2 3\nusemtl b\nf 1 3 4\n").as_bytes(),
        );
        let file = file.unwrap();
        assert_eq!(file.libraries, [("my file.mtl".to_owned(), 1)]);
        assert_eq!((file.uses[0].name.as_str(), file.uses[1].first_triangle), ("red one", 1));
        assert_eq!(file.mesh(std::slice::from_ref(&(1..2))).triangles, [[0, 1, 2]]);
    }

    #[test]
    fn each_fault_is_told_with_its_line() {
        for (text, expected) in [
            ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n", "a.obj:4:1: this face refers to position 4, but only 3"),
            ("v 0 0 0\nf 0 1 1\n", "a.obj:2:1: this face refers to position 0"),
            ("v 0 0 0\nf -2 1 1\n", "a.obj:2:1: this face refers to position -2"),
            ("v 0 0 0\nf 1/1 1 1\n", "refers to texture coordinate 1, but only 0"),
            ("v 0 0 0\nf 1//9 1 1\n", "refers to normal 9"),
            ("v 0 0 0\nf 1 1 x\n", "'x' is not a corner"),
            ("v 0 0 0\nf 1 1 1///1\n", "not a corner"),
            ("v 0 0 nan\n", "a.obj:1:1: NaN is not a finite number"),
            ("v 0 0 1e60\n", "beyond 3e38"),
            ("v 0 0\n", "3 numbers are needed"),
            ("v 0 0 zero\n", "'zero' is not a number"),
            ("v 0 0 0\n", "no faces"),
            ("", "no vertices and no faces"),
            ("<scene/>\n", "no '<scene/>' lines"),
        ] {
            let message = message(text);
            assert!(message.contains(expected), "{text:?}: {message}");
        }
    }
}
