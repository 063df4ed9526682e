//! A scene as content-addressed bytes: a manifest (everything small) that names each mesh and image by its BLAKE3 digest.
//!
//! The manifest's own digest is the scene's. A receiver fetches the parts it lacks, in any order. Numbers are little endian
//! and every value has one encoding, so equal scenes have equal digests on every machine.

use super::{Attribute, AttributeValues, Image, Mesh, Scene, SceneError, Texels};
use glam::{Vec2, Vec3};
use serde::{Deserialize, Serialize};
use std::fmt;
use std::sync::Arc;

/// A BLAKE3 hash.
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Digest(pub [u8; 32]);

impl Digest {
    /// The digest of `bytes`.
    pub fn of(bytes: &[u8]) -> Self {
        Self(*blake3::hash(bytes).as_bytes())
    }
}

impl fmt::Display for Digest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

impl fmt::Debug for Digest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

/// A scene ready to travel.
#[derive(Clone, Debug)]
pub struct SceneBlobs {
    /// Digest of `manifest`: the scene's.
    pub digest: Digest,
    /// Everything but the bulk.
    pub manifest: Vec<u8>,
    /// The bulk, by digest: [`Scene::part`] makes the bytes.
    pub parts: Vec<Digest>,
}

/// Bytes that are not the scene they claim to be.
#[derive(Debug, thiserror::Error)]
pub enum BlobError {
    /// The manifest does not decode.
    #[error("the scene manifest is damaged or of another version: {0}")]
    Manifest(String),
    /// A mesh or image does not decode.
    #[error("scene part {0} is damaged")]
    Part(Digest),
    /// It decodes, but describes no valid scene.
    #[error(transparent)]
    Scene(#[from] SceneError),
}

#[derive(Serialize, Deserialize)]
struct Manifest {
    scene: Scene,
    meshes: Vec<Digest>,
    images: Vec<Digest>,
}

impl Scene {
    /// The manifest and the digests of all parts; the parts' bytes are made, hashed and dropped one at a time.
    pub fn blobs(&self) -> SceneBlobs {
        let digests: Vec<Digest> =
            (0..self.meshes.len() + self.images.len()).map(|i| Digest::of(&self.part(i))).collect();
        let (meshes, images) = digests.split_at(self.meshes.len());
        let small = Scene { meshes: Vec::new(), images: Vec::new(), ..self.clone() };
        let manifest = Manifest { scene: small, meshes: meshes.to_vec(), images: images.to_vec() };
        // Postcard fails on maps and unsized sequences only, and a manifest has none.
        #[allow(clippy::expect_used)]
        let manifest = postcard::to_stdvec(&manifest).expect("a manifest is plain data");
        SceneBlobs { digest: Digest::of(&manifest), manifest, parts: digests }
    }

    /// The bytes of part `index` of [`SceneBlobs::parts`]: the meshes, then the images.
    pub fn part(&self, index: usize) -> Vec<u8> {
        match self.meshes.get(index) {
            Some(mesh) => mesh.encode(),
            None => self.images[index - self.meshes.len()].encode(),
        }
    }

    /// The digests of the parts that `manifest` names, each once.
    ///
    /// # Errors
    /// If the manifest does not decode.
    pub fn parts_of(manifest: &[u8]) -> Result<Vec<Digest>, BlobError> {
        let Manifest { mut meshes, images, .. } = decode_manifest(manifest)?;
        meshes.extend(images);
        meshes.sort_unstable();
        meshes.dedup();
        Ok(meshes)
    }

    /// The scene of a manifest; `part` gives the bytes of each digest. The result is validated.
    ///
    /// # Errors
    /// Damaged bytes, whatever `part` fails with, or a scene that breaks a rule of [`Scene::validate`].
    pub fn from_blobs<E: From<BlobError>>(
        manifest: &[u8],
        mut part: impl FnMut(&Digest) -> Result<Arc<[u8]>, E>,
    ) -> Result<Scene, E> {
        let Manifest { mut scene, meshes, images } = decode_manifest(manifest)?;
        for digest in &meshes {
            let mesh = Mesh::decode(&part(digest)?).ok_or(BlobError::Part(*digest))?;
            scene.meshes.push(Arc::new(mesh));
        }
        for digest in &images {
            let image = Image::decode(&part(digest)?).ok_or(BlobError::Part(*digest))?;
            scene.images.push(Arc::new(image));
        }
        scene.validate().map_err(BlobError::from)?;
        Ok(scene)
    }
}

fn decode_manifest(bytes: &[u8]) -> Result<Manifest, BlobError> {
    postcard::from_bytes(bytes).map_err(|e| BlobError::Manifest(e.to_string()))
}

impl Mesh {
    fn encode(&self) -> Vec<u8> {
        let mut out = Vec::new();
        for len in
            [self.positions.len(), self.normals.len(), self.uvs.len(), self.triangles.len(), self.attributes.len()]
        {
            out.extend((len as u64).to_le_bytes());
        }
        let vectors = self.positions.iter().chain(&self.normals).flat_map(|v| v.to_array());
        put_floats(&mut out, vectors.chain(self.uvs.iter().flat_map(|v| v.to_array())));
        self.triangles.iter().flatten().for_each(|i| out.extend(i.to_le_bytes()));
        self.attributes.iter().for_each(|attribute| attribute.encode(&mut out));
        out
    }

    fn decode(bytes: &[u8]) -> Option<Self> {
        let mut reader = Reader(bytes);
        let [positions, normals, uvs, triangles, attributes] =
            [reader.count(12)?, reader.count(12)?, reader.count(8)?, reader.count(12)?, reader.count(1)?];
        let mesh = Mesh {
            positions: reader.items(positions, |[x, y, z]| Vec3::from_array([x, y, z].map(f32::from_bits)))?,
            normals: reader.items(normals, |[x, y, z]| Vec3::from_array([x, y, z].map(f32::from_bits)))?,
            uvs: reader.items(uvs, |[u, v]| Vec2::from_array([u, v].map(f32::from_bits)))?,
            triangles: reader.items(triangles, |indices| indices)?,
            attributes: (0..attributes).map(|_| Attribute::decode(&mut reader)).collect::<Option<_>>()?,
        };
        reader.0.is_empty().then_some(mesh)
    }
}

impl Attribute {
    /// The name's length and the name, 1 or 3 for the numbers a value has, how many values, the numbers.
    fn encode(&self, out: &mut Vec<u8>) {
        out.extend((self.name.len() as u64).to_le_bytes());
        out.extend(self.name.as_bytes());
        let channels: u32 = match &self.values {
            AttributeValues::Scalars(_) => 1,
            AttributeValues::Colours(_) => 3,
        };
        out.extend(channels.to_le_bytes());
        out.extend((self.values.len() as u64).to_le_bytes());
        match &self.values {
            AttributeValues::Scalars(values) => put_floats(out, values.iter().copied()),
            AttributeValues::Colours(values) => put_floats(out, values.iter().flat_map(|v| v.to_array())),
        }
    }

    fn decode(reader: &mut Reader) -> Option<Self> {
        let len = reader.count(1)?;
        let name = String::from_utf8(reader.bytes(len)?.to_vec()).ok()?;
        let channels = reader.word()?;
        let values = match channels {
            1 => {
                let count = reader.count(4)?;
                AttributeValues::Scalars(reader.items(count, |[x]| f32::from_bits(x))?)
            }
            3 => {
                let count = reader.count(12)?;
                let colour = |[x, y, z]: [u32; 3]| Vec3::from_array([x, y, z].map(f32::from_bits));
                AttributeValues::Colours(reader.items(count, colour)?)
            }
            _ => return None,
        };
        Some(Attribute { name, values })
    }
}

/// First byte of an image's encoding.
const KIND_GREY8: u8 = 0;
const KIND_RGB8: u8 = 1;
const KIND_GREY32: u8 = 2;
const KIND_RGB32: u8 = 3;
/// Added to the first two for sRGB-encoded values.
const KIND_SRGB: u8 = 16;

impl Image {
    fn encode(&self) -> Vec<u8> {
        let srgb_bit = |srgb: bool| if srgb { KIND_SRGB } else { 0 };
        let kind = match &self.texels {
            Texels::Grey8 { srgb, .. } => KIND_GREY8 + srgb_bit(*srgb),
            Texels::Rgb8 { srgb, .. } => KIND_RGB8 + srgb_bit(*srgb),
            Texels::Grey32(_) => KIND_GREY32,
            Texels::Rgb32(_) => KIND_RGB32,
        };
        let mut out = vec![kind];
        out.extend(self.width.to_le_bytes());
        out.extend(self.height.to_le_bytes());
        match &self.texels {
            Texels::Grey8 { data, .. } | Texels::Rgb8 { data, .. } => out.extend(data),
            Texels::Grey32(data) | Texels::Rgb32(data) => put_floats(&mut out, data.iter().copied()),
        }
        out
    }

    fn decode(bytes: &[u8]) -> Option<Self> {
        let (&kind, rest) = bytes.split_first()?;
        let mut reader = Reader(rest);
        let (width, height) = (reader.word()?, reader.word()?);
        let srgb = kind & KIND_SRGB != 0;
        let texels = match kind & !KIND_SRGB {
            KIND_GREY8 => Texels::Grey8 { srgb, data: reader.0.to_vec() },
            KIND_RGB8 => Texels::Rgb8 { srgb, data: reader.0.to_vec() },
            KIND_GREY32 => Texels::Grey32(reader.items(reader.0.len() / 4, |[x]| f32::from_bits(x))?),
            KIND_RGB32 => Texels::Rgb32(reader.items(reader.0.len() / 4, |[x]| f32::from_bits(x))?),
            _ => return None,
        };
        Some(Image { width, height, texels })
    }
}

fn put_floats(out: &mut Vec<u8>, values: impl Iterator<Item = f32>) {
    values.for_each(|x| out.extend(x.to_bits().to_le_bytes()));
}

/// Reads little-endian words; `None` where the bytes end early.
struct Reader<'a>(&'a [u8]);

impl<'a> Reader<'a> {
    fn bytes(&mut self, len: usize) -> Option<&'a [u8]> {
        let (bytes, rest) = self.0.split_at_checked(len)?;
        self.0 = rest;
        Some(bytes)
    }

    fn word(&mut self) -> Option<u32> {
        let (word, rest) = self.0.split_first_chunk::<4>()?;
        self.0 = rest;
        Some(u32::from_le_bytes(*word))
    }

    /// A count of items of `size` bytes, refused if the bytes left could not hold them.
    fn count(&mut self, size: usize) -> Option<usize> {
        let (count, rest) = self.0.split_first_chunk::<8>()?;
        self.0 = rest;
        let count = usize::try_from(u64::from_le_bytes(*count)).ok()?;
        (count <= rest.len() / size).then_some(count)
    }

    fn items<T, const N: usize>(&mut self, count: usize, make: impl Fn([u32; N]) -> T) -> Option<Vec<T>> {
        let len = count.checked_mul(4 * N)?;
        let bytes = self.bytes(len)?;
        let word = |chunk: &[u8], i: usize| {
            let at = 4 * i;
            u32::from_le_bytes([chunk[at], chunk[at + 1], chunk[at + 2], chunk[at + 3]])
        };
        Some(bytes.chunks_exact(4 * N).map(|chunk| make(std::array::from_fn(|i| word(chunk, i)))).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Texture;

    fn scene() -> Scene {
        Scene {
            textures: vec![Texture::Constant(Vec3::ONE)],
            meshes: vec![Arc::new(Mesh {
                positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y],
                uvs: vec![Vec2::ZERO, Vec2::X, Vec2::Y],
                triangles: vec![[0, 1, 2]],
                attributes: vec![
                    Attribute { name: "vertex_a".into(), values: AttributeValues::Scalars(vec![1.0, -0.0, 3.0]) },
                    Attribute { name: "face_b".into(), values: AttributeValues::Colours(vec![Vec3::X]) },
                ],
                ..Mesh::default()
            })],
            images: vec![
                Arc::new(Image { width: 2, height: 1, texels: Texels::Grey8 { srgb: true, data: vec![1, 2] } }),
                Arc::new(Image { width: 1, height: 1, texels: Texels::Rgb32(vec![1.0, -0.0, 3.0]) }),
            ],
            origin: [1.0, 2.0, 3.0],
            ..Scene::empty()
        }
    }

    fn rebuild(scene: &Scene, spoil: impl Fn(Vec<u8>) -> Vec<u8>) -> Result<Scene, BlobError> {
        let blobs = scene.blobs();
        Scene::from_blobs(&blobs.manifest, |digest| {
            let i = blobs.parts.iter().position(|d| d == digest).ok_or(BlobError::Part(*digest))?;
            Ok(spoil(scene.part(i)).into())
        })
    }

    #[test]
    fn a_scene_comes_back_the_same() {
        let scene = scene();
        let back = rebuild(&scene, |bytes| bytes).unwrap();
        assert_eq!(back, scene);
        assert_eq!(back.blobs().digest, scene.blobs().digest);
    }

    #[test]
    fn every_truncation_is_refused() {
        let scene = scene();
        for cut in 1..20 {
            let result = rebuild(&scene, |mut bytes| {
                bytes.truncate(bytes.len() - cut.min(bytes.len()));
                bytes
            });
            assert!(result.is_err(), "{cut} bytes cut off");
        }
        let manifest = scene.blobs().manifest;
        for len in 0..manifest.len() {
            assert!(Scene::parts_of(&manifest[..len]).is_err(), "manifest of {len} bytes");
        }
    }
}
