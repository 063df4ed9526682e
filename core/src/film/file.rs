//! A film as a file: exact sums with the sample ranges that made them, so that it can be gone on with, joined with others,
//! and proved. The coordinator's snapshots are such files; docs/film.md describes the bytes.
//!
//! Records (see [`super::records`]): the [`Head`]; any number of [`Part`]s, each a tile with its sample ranges and sums; an
//! end that counts the parts and bears the BLAKE3 digest of all payloads before it. Whatever is cut off, changed or forged
//! is refused when it is read, before anything is added up.

use super::ranges::Ranges;
use super::records::{Kind, RecordError, RecordReader, RecordWriter};
use super::{Film, PixelSums, bounded, sums};
use crate::scene::Digest;
use crate::settings::{Half, Settings, SettingsError, Window};
use serde::{Deserialize, Serialize};
use std::io::{self, Read, Write};
use std::ops::Range;

/// What a film file begins with.
pub const KIND: Kind = *b"tilecast film 04";
/// Pixels of a part, so that its record stays within [`super::records::RECORD_BYTES_MAX`].
pub const PART_PIXELS_MAX: u64 = 1 << 16;
/// Sample ranges of a part; a film in the making has a few, one that was patched together some more.
pub const PART_RANGES_MAX: usize = 1 << 16;

/// What the bits of a film are a function of, besides its sample ranges.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Head {
    /// [`crate::VERSION`] of the tracer.
    pub engine: String,
    /// The scene.
    pub scene: Digest,
    /// Everything else. The ranges of the parts say which samples are there; `spp` is what was asked for.
    pub settings: Settings,
    /// What decided how many samples each tile has; `None` if they were asked for. With it the image is the mean of the
    /// means of both halves.
    pub target: Option<Target>,
}

/// An error at which an image is done.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Target {
    /// The relative error of the whole, see [`Film::relative_error`].
    Image(f32),
    /// In 95 % of the picture, the error of a pixel relative to its mean.
    Pixels(f32),
}

/// The sums of a tile.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Part {
    /// Its pixels: at most [`PART_PIXELS_MAX`], within the crop window.
    pub tile: Window,
    /// The replicates they belong to; indices are that half's own.
    pub half: Half,
    /// The sample indices that every pixel of it has received.
    pub samples: Ranges,
    /// Row by row.
    pub pixels: Vec<PixelSums>,
    /// Who traced them, where that is kept apart; 0 for anybody. Parts of different contributors may have the same tile.
    pub contributor: u64,
}

#[derive(Serialize, Deserialize)]
struct PartHead {
    tile: Window,
    half: Half,
    samples: Vec<Range<u32>>,
    contributor: u64,
}

#[derive(Serialize, Deserialize)]
struct End {
    parts: u64,
    digest: Digest,
}

/// Records begin with what they are.
const TAG_HEAD: u8 = 0;
const TAG_PART: u8 = 1;
const TAG_END: u8 = 2;

/// A file that is no film.
#[derive(Debug, thiserror::Error)]
pub enum FilmFileError {
    /// It cannot be read, or is damaged.
    #[error(transparent)]
    Record(#[from] RecordError),
    /// A record that no writer makes.
    #[error("record {0} of it makes no sense")]
    Nonsense(u64),
    /// It ends before the record that says that it is complete.
    #[error("it is incomplete: its end is missing")]
    NoEnd,
    /// Settings out of range.
    #[error("its settings are invalid: {0}")]
    Settings(#[from] SettingsError),
    /// Indices of the two kinds cannot be compared.
    #[error("it has samples of halves and of all replicates, and nobody can say which are the same")]
    Mixed,
    /// The same samples twice.
    #[error("it has samples {samples:?} of tile {tile:?} twice")]
    Overlap {
        /// Where.
        tile: Window,
        /// Which.
        samples: Range<u32>,
    },
}

/// Writes a film part by part.
#[derive(Debug)]
pub struct FilmWriter<W> {
    records: RecordWriter<W>,
    parts: u64,
    hasher: blake3::Hasher,
}

impl<W: Write> FilmWriter<W> {
    /// Begins a file.
    ///
    /// # Errors
    /// Whatever `out` fails with.
    pub fn new(out: W, head: &Head) -> io::Result<Self> {
        let mut writer = Self { records: RecordWriter::new(out, KIND)?, parts: 0, hasher: blake3::Hasher::new() };
        writer.put(&tagged(TAG_HEAD, head)?)?;
        Ok(writer)
    }

    /// Appends a part.
    ///
    /// # Errors
    /// Whatever `out` fails with.
    pub fn part(&mut self, part: &Part) -> io::Result<()> {
        let Part { tile, half, samples, pixels, contributor } = part;
        let samples = samples.as_slice().to_vec();
        let head = PartHead { tile: *tile, half: *half, samples, contributor: *contributor };
        let mut payload = tagged(TAG_PART, &head)?;
        payload.append(&mut sums::encode(pixels));
        self.parts += 1;
        self.put(&payload)
    }

    /// Writes the end; gives `out` back, to be flushed.
    ///
    /// # Errors
    /// Whatever `out` fails with.
    pub fn finish(mut self) -> io::Result<W> {
        let end = End { parts: self.parts, digest: Digest(*self.hasher.finalize().as_bytes()) };
        self.put(&tagged(TAG_END, &end)?)?;
        Ok(self.records.into_inner())
    }

    fn put(&mut self, payload: &[u8]) -> io::Result<()> {
        self.hasher.update(payload);
        self.records.put(payload)
    }
}

fn tagged(tag: u8, value: &impl Serialize) -> io::Result<Vec<u8>> {
    postcard::to_extend(value, vec![tag]).map_err(io::Error::other)
}

/// Reads a whole film. The parts are valid each by itself; [`assemble`] adds them up.
///
/// # Errors
/// Anything that is not exactly what [`FilmWriter`] writes.
pub fn read(input: impl Read) -> Result<(Head, Vec<Part>), FilmFileError> {
    let mut records = RecordReader::new(input, KIND)?;
    let (mut head, mut parts, mut hasher) = (None, Vec::new(), blake3::Hasher::new());
    for index in 0.. {
        let payload = records.read()?.ok_or(FilmFileError::NoEnd)?;
        let nonsense = FilmFileError::Nonsense(index);
        let Some((&tag, rest)) = payload.split_first() else { return Err(nonsense) };
        match (tag, &head) {
            (TAG_HEAD, None) => {
                let found: Head = whole(rest).ok_or(nonsense)?;
                found.settings.validate()?;
                head = Some(found);
            }
            (TAG_PART, Some(head)) => parts.push(part(rest, &head.settings).ok_or(nonsense)?),
            (TAG_END, Some(_)) => {
                let end: End = whole(rest).ok_or(FilmFileError::Nonsense(index))?;
                let agrees = end.parts == parts.len() as u64 && end.digest.0 == *hasher.finalize().as_bytes();
                if !agrees || records.read()?.is_some() {
                    return Err(nonsense);
                }
                break;
            }
            _ => return Err(nonsense),
        }
        hasher.update(&payload);
    }
    Ok((head.ok_or(FilmFileError::NoEnd)?, parts))
}

/// A value that takes all of `bytes`.
fn whole<'a, T: Deserialize<'a>>(bytes: &'a [u8]) -> Option<T> {
    let (value, rest) = postcard::take_from_bytes(bytes).ok()?;
    rest.is_empty().then_some(value)
}

fn part(bytes: &[u8], settings: &Settings) -> Option<Part> {
    let (PartHead { tile, half, samples, contributor }, rest) = postcard::take_from_bytes(bytes).ok()?;
    let filled = tile.x0 < tile.x1 && tile.y0 < tile.y1 && settings.film.crop.contains(&tile);
    if !filled || tile.area() > PART_PIXELS_MAX || samples.is_empty() || samples.len() > PART_RANGES_MAX {
        return None;
    }
    let samples = Ranges::from_sorted(samples)?;
    let pixels = sums::decode(rest, usize::try_from(tile.area()).ok()?).ok()?;
    bounded(tile, samples.count(), &pixels).then_some(Part { tile, half, samples, pixels, contributor })
}

/// Adds parts up to a film.
///
/// # Errors
/// A sample of a pixel that two parts have.
pub fn assemble(settings: &Settings, parts: &[Part]) -> Result<Film, FilmFileError> {
    let of_both = parts.iter().filter(|part| part.half == Half::Both).count();
    if of_both != 0 && of_both != parts.len() {
        return Err(FilmFileError::Mixed);
    }
    let mut film = Film::new(settings);
    for half in [Half::Both, Half::First, Half::Second] {
        let own = || parts.iter().filter(|part| part.half == half);
        if let Some((tile, samples)) = overlap(own().map(|part| (part.tile, &part.samples))) {
            return Err(FilmFileError::Overlap { tile, samples });
        }
        film.half = half;
        own().for_each(|part| film.add(part.tile, part.samples.as_slice(), &part.pixels));
    }
    film.half = settings.half;
    Ok(film)
}

/// Pixels and samples that two of these have, whatever their tiles are.
pub fn overlap<'a>(parts: impl IntoIterator<Item = (Window, &'a Ranges)>) -> Option<(Window, Range<u32>)> {
    // From top to bottom; those that reach down to where the sweep is are compared with the next.
    let mut order: Vec<(Window, &Ranges)> = parts.into_iter().collect();
    order.sort_by_key(|(tile, _)| (tile.y0, tile.x0));
    let mut active: Vec<(Window, &Ranges)> = Vec::new();
    for (tile, samples) in order {
        active.retain(|(other, _)| other.y1 > tile.y0);
        for (other, theirs) in &active {
            let both =
                Window { x0: tile.x0.max(other.x0), y0: tile.y0, x1: tile.x1.min(other.x1), y1: tile.y1.min(other.y1) };
            if both.x0 < both.x1
                && let Some(range) = samples.as_slice().iter().find_map(|range| theirs.common(range))
            {
                return Some((both, range));
            }
        }
        active.push((tile, samples));
    }
    None
}

#[cfg(test)]
// One range is meant where one stands.
#[allow(clippy::single_range_in_vec_init)]
mod tests {
    use super::*;
    use crate::film::TileSums;
    use crate::settings::{Film as Pixels, Filter, Integrator, IntegratorKind, SamplerKind, Strategy};
    use glam::Vec3;

    fn settings() -> Settings {
        let crop = Window { x0: 1, y0: 0, x1: 5, y1: 4 };
        Settings {
            film: Pixels { width: 6, height: 4, crop, filter: Filter::Box },
            spp: 12,
            seed: 3,
            integrator: Integrator { kind: IntegratorKind::Path, max_depth: None, rr_depth: 5, hide_emitters: false },
            strategy: Strategy::Mis,
            sampler: SamplerKind::Sobol,
            without: Default::default(),
            half: Half::Both,
            offsets: Default::default(),
            scale_exponent: 60,
        }
    }

    /// Sums as a tracer would make them: a function of pixel and sample alone.
    fn traced(tile: Window, samples: Range<u32>) -> TileSums {
        let mut sums = TileSums::new(tile, samples.clone());
        let positions = (tile.y0..tile.y1).flat_map(|y| (tile.x0..tile.x1).map(move |x| (x, y)));
        for ((x, y), pixel) in positions.zip(&mut sums.pixels) {
            for i in samples.clone() {
                pixel.add(i, Vec3::new(x as f32, y as f32 * 0.3, i as f32 * 0.7), 60).unwrap();
            }
        }
        sums
    }

    fn part(tile: [u32; 4], ranges: &[Range<u32>]) -> Part {
        let [x0, y0, x1, y1] = tile;
        let tile = Window { x0, y0, x1, y1 };
        let mut film = Film::new(&settings());
        ranges.iter().for_each(|range| film.merge(&traced(tile, range.clone())));
        let samples = Ranges::from_sorted(ranges.to_vec()).unwrap();
        Part { tile, half: Half::Both, samples, pixels: film.tile(tile), contributor: 0 }
    }

    fn parts() -> Vec<Part> {
        vec![part([1, 0, 3, 4], &[0..4, 8..12]), part([1, 0, 3, 4], &[4..8]), part([3, 0, 5, 4], &[0..12])]
    }

    fn file(parts: &[Part]) -> Vec<u8> {
        let head = Head { engine: "1".into(), scene: Digest([7; 32]), settings: settings(), target: None };
        let mut writer = FilmWriter::new(Vec::new(), &head).unwrap();
        parts.iter().for_each(|part| writer.part(part).unwrap());
        writer.finish().unwrap()
    }

    #[test]
    fn a_film_comes_back_and_its_parts_make_the_whole() {
        let (head, back) = read(file(&parts()).as_slice()).unwrap();
        assert_eq!(back, parts());
        assert_eq!((head.scene, head.settings.clone()), (Digest([7; 32]), settings()));
        let mut whole = Film::new(&settings());
        whole.merge(&traced(settings().film.crop, 0..12));
        assert_eq!(assemble(&head.settings, &back).unwrap(), whole);
    }

    #[test]
    fn what_is_taken_out_was_never_there() {
        let [a, b] = [part([1, 0, 3, 4], &[0..4, 8..12]), part([3, 0, 5, 4], &[0..12])];
        let mut film = assemble(&settings(), &[a.clone(), b.clone()]).unwrap();
        film.remove(b.tile, b.samples.as_slice(), &b.pixels);
        assert_eq!(film, assemble(&settings(), &[a]).unwrap());
    }

    #[test]
    fn the_same_sample_twice_is_refused_whatever_the_tiles() {
        for other in [part([2, 2, 4, 3], &[11..12]), part([4, 3, 5, 4], &[0..1]), part([1, 0, 5, 4], &[5..6])] {
            let mut parts = parts();
            parts.push(other);
            let error = assemble(&settings(), &parts).unwrap_err();
            assert!(matches!(error, FilmFileError::Overlap { .. }), "{error}");
        }
    }

    /// Every cut and every changed byte; the frame's own tests say why, this one that the reader asks it.
    #[test]
    fn damage_is_refused() {
        let whole = file(&parts());
        for len in 0..whole.len() {
            assert!(read(&whole[..len]).is_err(), "cut at {len}");
        }
        for at in 0..whole.len() {
            let mut changed = whole.clone();
            changed[at] ^= 1;
            assert!(read(changed.as_slice()).is_err(), "byte {at}");
        }
        assert!(read([whole.as_slice(), b"more"].concat().as_slice()).is_err());
    }

    #[test]
    fn what_no_writer_makes_is_refused() {
        let outside = Part { tile: Window { x0: 0, y0: 0, x1: 2, y1: 1 }, ..part([1, 0, 3, 1], &[0..1]) };
        let mut unbounded = part([1, 0, 2, 1], &[0..1]);
        unbounded.pixels[0].0[0][0] = i128::MAX;
        let short = Part { tile: Window { x0: 1, y0: 0, x1: 3, y1: 2 }, ..part([1, 0, 3, 1], &[0..1]) };
        for bad in [outside, unbounded, short] {
            assert!(matches!(read(file(&[bad]).as_slice()), Err(FilmFileError::Nonsense(1))));
        }
    }
}
