//! Mitsuba's own mesh files, `.serialized`: several meshes, each compressed by zlib, and a list of where they begin.
//!
//! All numbers are little endian. A mesh: `u16` 0x041C, `u16` version (3 or 4), then compressed: `u32` flags, for version 4
//! a name that ends with 0, `u64` vertices, `u64` triangles, then positions, normals, texture coordinates, colours (each if
//! flagged), triangles. At the file's end: where each mesh begins (`u32` in version 3, `u64` in version 4), `u32` meshes.

use super::FileMesh;
use flate2::bufread::ZlibDecoder;
use glam::{DVec3, Vec2};
use std::io::{BufReader, Read};

const MAGIC: u16 = 0x041c;
const NORMALS: u32 = 0x1;
const TEXTURE_COORDINATES: u32 = 0x2;
const COLOURS: u32 = 0x8;
const DOUBLE_PRECISION: u32 = 0x2000;
/// The longest name of a mesh.
const NAME_BYTES_MAX: u64 = 1 << 16;
/// Rows to make room for before they are read: a header may promise what the file does not hold.
const RESERVED_MAX: u64 = 1 << 20;

/// Reads the mesh at an index of a whole file.
///
/// # Errors
/// A message that completes "the file …": no such format or mesh, data that end early, indices out of range, numbers that
/// are not finite.
pub(crate) fn parse(bytes: &[u8], shape_index: u32) -> Result<FileMesh, String> {
    let damaged = || "is damaged: its list of meshes makes no sense; copy or export it again".to_owned();
    let (magic, version) = header(bytes, 0).ok_or_else(damaged)?;
    if magic != MAGIC || !(version == 3 || version == 4) {
        return Err("is no serialized mesh of Mitsuba's, version 3 or 4".into());
    }
    let count_at = bytes.len().checked_sub(4).ok_or_else(damaged)?;
    let count = u32::from_le_bytes(array(bytes, count_at).ok_or_else(damaged)?);
    if shape_index >= count {
        return Err(format!("has {count} meshes; there is none of index {shape_index}, they count from 0"));
    }
    let entry = if version == 3 { 4 } else { 8 };
    let back = (count - shape_index) as usize * entry;
    let at = count_at.checked_sub(back).ok_or_else(damaged)?;
    let start = match version {
        3 => u32::from_le_bytes(array(bytes, at).ok_or_else(damaged)?).into(),
        _ => u64::from_le_bytes(array(bytes, at).ok_or_else(damaged)?),
    };
    let start = usize::try_from(start).ok().filter(|start| *start < count_at).ok_or_else(damaged)?;
    match header(bytes, start) {
        Some((MAGIC, inner)) if inner == version => {}
        _ => return Err(damaged()),
    }
    Stream(BufReader::new(ZlibDecoder::new(&bytes[start + 4..count_at]))).mesh(version)
}

fn header(bytes: &[u8], at: usize) -> Option<(u16, u16)> {
    Some((u16::from_le_bytes(array(bytes, at)?), u16::from_le_bytes(array(bytes, at.checked_add(2)?)?)))
}

fn array<const N: usize>(bytes: &[u8], at: usize) -> Option<[u8; N]> {
    bytes.get(at..)?.first_chunk().copied()
}

/// The uncompressed bytes of a mesh.
struct Stream<'a>(BufReader<ZlibDecoder<&'a [u8]>>);

impl Stream<'_> {
    fn mesh(mut self, version: u16) -> Result<FileMesh, String> {
        let flags = u32::from_le_bytes(self.take()?);
        if version == 4 {
            self.skip_name()?;
        }
        let (vertices, triangles) = (u64::from_le_bytes(self.take()?), u64::from_le_bytes(self.take()?));
        if vertices > u64::from(u32::MAX) || triangles > u64::from(u32::MAX) {
            return Err(format!("has a mesh of {vertices} vertices and {triangles} triangles, more than 2^32"));
        }
        let double = flags & DOUBLE_PRECISION != 0;
        let mut mesh = FileMesh { positions: self.rows(vertices, double, DVec3::from_array)?, ..FileMesh::default() };
        if flags & NORMALS != 0 {
            let unit = |n: [f64; 3]| DVec3::from_array(n).normalize_or_zero().as_vec3();
            mesh.normals = self.rows(vertices, double, unit)?;
        }
        if flags & TEXTURE_COORDINATES != 0 {
            mesh.uvs = self.rows(vertices, double, |[u, v]| Vec2::new(u as f32, v as f32))?;
        }
        if flags & COLOURS != 0 {
            self.rows(vertices, double, |_: [f64; 3]| ())?;
        }
        mesh.triangles.reserve(triangles.min(RESERVED_MAX) as usize);
        for i in 0..triangles {
            let mut corners = [0; 3];
            for corner in &mut corners {
                *corner = u32::from_le_bytes(self.take()?);
            }
            if corners.iter().any(|&corner| u64::from(corner) >= vertices) {
                return Err(format!("has a triangle {i} of the vertices {corners:?}, but only {vertices}, from 0"));
            }
            mesh.triangles.push(corners);
        }
        Ok(mesh)
    }

    fn skip_name(&mut self) -> Result<(), String> {
        for _ in 0..NAME_BYTES_MAX {
            if self.take::<1>()? == [0] {
                return Ok(());
            }
        }
        Err("has a mesh with a name without an end".into())
    }

    /// Rows of numbers, which must be finite as 32-bit ones.
    fn rows<const N: usize, T>(
        &mut self,
        count: u64,
        double: bool,
        make: impl Fn([f64; N]) -> T,
    ) -> Result<Vec<T>, String> {
        let mut rows = Vec::with_capacity(count.min(RESERVED_MAX) as usize);
        for i in 0..count {
            let mut row = [0.0; N];
            for x in &mut row {
                *x = if double { f64::from_le_bytes(self.take()?) } else { f32::from_le_bytes(self.take()?).into() };
                if !(*x as f32).is_finite() {
                    return Err(format!("has a number that is not finite, or beyond 3e38, at vertex {i}"));
                }
            }
            rows.push(make(row));
        }
        Ok(rows)
    }

    fn take<const N: usize>(&mut self) -> Result<[u8; N], String> {
        let mut bytes = [0; N];
        let read = self.0.read_exact(&mut bytes);
        read.map_err(|e| format!("is damaged or truncated ({e}); copy or export it again"))?;
        Ok(bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flate2::Compression;
    use flate2::write::ZlibEncoder;
    use glam::Vec3;
    use std::io::Write;

    /// A file of two meshes, a triangle each, the second 10 farther along z.
    fn file(version: u16, double: bool, last_corner: u32) -> Vec<u8> {
        let mut file = Vec::new();
        let mut starts = Vec::new();
        for z in [0.0, 10.0] {
            starts.push(file.len());
            file.extend(MAGIC.to_le_bytes());
            file.extend(version.to_le_bytes());
            let mut mesh = Vec::new();
            let precision = if double { DOUBLE_PRECISION } else { 0x1000 };
            mesh.extend((NORMALS | TEXTURE_COORDINATES | COLOURS | precision).to_le_bytes());
            if version == 4 {
                mesh.extend(b"a name\0");
            }
            mesh.extend(3u64.to_le_bytes());
            mesh.extend(1u64.to_le_bytes());
            let positions: [f64; 9] = [0.0, 0.0, z, 1.0, 0.0, z, 0.0, 1.0, z];
            let normals = [0.0, 0.0, 2.0].repeat(3);
            let uvs = [0.0, 0.25, 1.0, 0.25, 0.0, 1.25];
            for x in positions.iter().chain(&normals).chain(&uvs).chain(&[0.5; 9]) {
                match double {
                    true => mesh.extend(x.to_le_bytes()),
                    false => mesh.extend((*x as f32).to_le_bytes()),
                }
            }
            [0, 1, last_corner].iter().for_each(|corner| mesh.extend(corner.to_le_bytes()));
            let mut encoder = ZlibEncoder::new(&mut file, Compression::fast());
            encoder.write_all(&mesh).unwrap();
            encoder.finish().unwrap();
        }
        for start in starts {
            match version {
                3 => file.extend((start as u32).to_le_bytes()),
                _ => file.extend((start as u64).to_le_bytes()),
            }
        }
        file.extend(2u32.to_le_bytes());
        file
    }

    #[test]
    fn both_versions_and_precisions_say_the_same() {
        for (version, double) in [(3, false), (3, true), (4, false), (4, true)] {
            let mesh = parse(&file(version, double, 2), 1).unwrap();
            assert_eq!(
                mesh.positions,
                [DVec3::new(0.0, 0.0, 10.0), DVec3::new(1.0, 0.0, 10.0), DVec3::new(0.0, 1.0, 10.0)]
            );
            assert_eq!((mesh.normals[2], mesh.uvs[2]), (Vec3::Z, Vec2::new(0.0, 1.25)));
            assert_eq!(mesh.triangles, [[0, 1, 2]]);
        }
        assert_eq!(parse(&file(4, false, 2), 0).unwrap().positions[0], DVec3::ZERO);
    }

    #[test]
    fn each_fault_is_told() {
        let fault = |bytes: &[u8], index| parse(bytes, index).unwrap_err();
        let good = file(4, false, 2);
        assert!(fault(&good, 2).contains("has 2 meshes; there is none of index 2"));
        assert!(fault(&file(4, false, 3), 0).contains("[0, 1, 3], but only 3"));
        assert!(fault(b"ply\nformat", 0).contains("no serialized mesh"));
        assert!(fault(b"", 0).contains("damaged"));
        for len in 0..good.len() {
            assert!(parse(&good[..len], 1).is_err(), "{len} bytes");
        }
        for i in 0..good.len() {
            let mut bits = good.clone();
            bits[i] ^= 0x55;
            let _ = parse(&bits, 0); // whatever it says, it does not panic
        }
    }
}
