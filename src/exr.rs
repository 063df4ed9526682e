//! A film as OpenEXR. Channels are named as pbrt-v4 names them; attributes carry what renders the image again, bit for bit.

use crate::kept::Kept;
use crate::read::REPLICATES_ATTRIBUTE;
use crate::report::percent;
use anyhow::Context;
use exr::prelude::*;
use std::io::{Read, Seek, SeekFrom, Write};
use tilecast_core::film::file::Head;
use tilecast_core::film::{Estimate, REPLICATES};

/// What a channel takes of a pixel.
pub type Value = fn(&Estimate) -> f32;

/// What there is of a pixel, by channel. All are f32, the count too: readers such as pbrt's take files of one type. It is
/// exact up to 2^24; `tilecast:samples` is exact beyond.
pub const CHANNELS: [(&str, Value); 7] = [
    ("R", |e| e.mean[0]),
    ("G", |e| e.mean[1]),
    ("B", |e| e.mean[2]),
    ("Variance.R", |e| e.variance[0]),
    ("Variance.G", |e| e.variance[1]),
    ("Variance.B", |e| e.variance[2]),
    ("SampleCount", |e| e.count as f32),
];

/// Linear sRGB (ITU-R BT.709 primaries, D65).
const PRIMARIES: attribute::Chromaticities = attribute::Chromaticities {
    red: Vec2(0.64, 0.33),
    green: Vec2(0.30, 0.60),
    blue: Vec2(0.15, 0.06),
    white: Vec2(0.3127, 0.3290),
};

/// Bytes in which the file's attributes end for certain: ours are short, and there are no others.
const HEADER_BYTES_MAX: u64 = 64 << 10;

/// Writes the film: its window is the data window, the whole picture the display window. Equal films make equal files.
///
/// # Errors
/// Whatever writing fails with.
pub fn write(file: &mut (impl Read + Write + Seek), kept: &Kept) -> anyhow::Result<()> {
    let (film, settings) = (&kept.film, &kept.head.settings);
    let window = film.window;
    let size = Vec2(window.width() as usize, window.height() as usize);
    let mut planes = CHANNELS.map(|_| Vec::with_capacity(size.area()));
    for (x, y) in (window.y0..window.y1).flat_map(|y| (window.x0..window.x1).map(move |x| (x, y))) {
        let estimate = film.estimate(x, y);
        planes.iter_mut().zip(CHANNELS).for_each(|(plane, (_, value))| plane.push(value(&estimate)));
    }
    let channels =
        planes.into_iter().zip(CHANNELS).map(|(plane, (name, _))| AnyChannel::new(name, FlatSamples::F32(plane)));
    let mut attributes = LayerAttributes {
        layer_position: Vec2(i32::try_from(window.x0)?, i32::try_from(window.y0)?),
        software_name: Some(Text::from(concat!("tilecast ", env!("CARGO_PKG_VERSION")))),
        ..LayerAttributes::default()
    };
    for (name, value) in proof(kept)? {
        let value = Text::new_or_none(&value).with_context(|| format!("{name} is no plain text"))?;
        attributes.other.insert(Text::from(name), AttributeValue::Text(value));
    }
    let layer = Layer::new(size, attributes, Encoding::SMALL_LOSSLESS, AnyChannels::sort(channels.collect()));
    let mut image = Image::from_layer(layer);
    image.attributes.display_window =
        IntegerBounds::from_dimensions((settings.film.width as usize, settings.film.height as usize));
    image.attributes.chromaticities = Some(PRIMARIES);
    image.write().to_unbuffered(&mut *file)?;
    sort_attributes(file)
}

/// Brings the attributes into the order of their names; the library writes them in the order of a hash that differs from run
/// to run. Nothing moves but them: the header is as long as before.
fn sort_attributes(file: &mut (impl Read + Write + Seek)) -> anyhow::Result<()> {
    const MAGIC_AND_VERSION: u64 = 8;
    let mut header = Vec::new();
    file.seek(SeekFrom::Start(MAGIC_AND_VERSION))?;
    Read::by_ref(file).take(HEADER_BYTES_MAX).read_to_end(&mut header)?;
    let (mut attributes, mut rest) = (Vec::new(), header.as_slice());
    // An attribute is name, 0, type, 0, length of the value in four bytes, value; an empty name ends them.
    while rest.first().is_some_and(|&byte| byte != 0) {
        let end = attribute_end(rest).context("the image's header is longer than it can be")?;
        let (attribute, behind) = rest.split_at(end);
        attributes.push(attribute);
        rest = behind;
    }
    // A name is followed by its 0, so one that begins another comes first.
    attributes.sort_unstable();
    file.seek(SeekFrom::Start(MAGIC_AND_VERSION))?;
    file.write_all(&attributes.concat())?;
    Ok(file.flush()?)
}

/// Where the attribute that `bytes` begin with ends, if it does.
fn attribute_end(bytes: &[u8]) -> Option<usize> {
    let after_zero = |from: usize| Some(from + bytes.get(from..)?.iter().position(|&byte| byte == 0)? + 1);
    let length_at = after_zero(after_zero(0)?)?;
    let length = bytes.get(length_at..)?.first_chunk::<4>()?;
    let end = length_at.checked_add(4)?.checked_add(usize::try_from(u32::from_le_bytes(*length)).ok()?)?;
    (end <= bytes.len()).then_some(end)
}

/// What the bits of the image are a function of, and the digest that says which bits.
fn proof(kept: &Kept) -> anyhow::Result<[(&'static str, String); 9]> {
    let Head { engine, scene, settings, target } = &kept.head;
    // Of two halves of two replicates each, the variance has a degree of freedom less.
    let replicates = if kept.film.halves { REPLICATES - 1 } else { REPLICATES };
    let error = kept.film.relative_error(u64::MAX);
    Ok([
        ("tilecast:scene", scene.to_string()),
        ("tilecast:settings", serde_json::to_string(settings)?),
        ("tilecast:seed", settings.seed.to_string()),
        ("tilecast:samples", kept.shown()),
        ("tilecast:relative-error", error.map_or_else(|| "unknown".into(), |error| percent(&error))),
        ("tilecast:target", serde_json::to_string(target)?),
        (REPLICATES_ATTRIBUTE, replicates.to_string()),
        ("tilecast:engine", engine.clone()),
        ("tilecast:digest", kept.film.digest().to_string()),
    ])
}
