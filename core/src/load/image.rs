//! Image files as [`Image`]s: PNG, JPEG, TGA, Radiance HDR and OpenEXR.
//!
//! 8-bit pixels stay as they are, with a flag if they are sRGB-encoded; 16-bit ones become linear floats. Alpha is dropped,
//! as Mitsuba's `bitmap` does. Every decoder works within limits of size.

use super::mitsuba::spectrum::luminance;
use crate::scene::{Image, Texels};
use exr::image::{AnyChannel, FlatSamples};
use glam::DVec3;
use image::{DynamicImage, ImageFormat, ImageReader, Limits};
use std::io::Cursor;
use std::panic::AssertUnwindSafe;
use std::path::Path;

/// The most pixels along one side of an image file: beyond it a size is taken for a fault of the file.
const SIDE_MAX: usize = 1 << 15;
/// The most bytes that decoding one image may take.
const DECODED_BYTES_MAX: u64 = 4 << 30;
/// Channels in an EXR file; renderers write some dozens.
const EXR_CHANNELS_MAX: usize = 1024;

/// How an image will be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Use {
    /// Values are taken as they are, not decoded from sRGB.
    pub raw: bool,
    /// One number a pixel: colours become luminance.
    pub scalar: bool,
}

/// Decodes a file's bytes; `path` says what it claims to be.
///
/// # Errors
/// A message that completes "the image '…'".
pub(crate) fn decode(path: &Path, bytes: &[u8], usage: Use) -> Result<Image, String> {
    // Decoders of hostile bytes by others: a fault of theirs must not end the program.
    let decoded = std::panic::catch_unwind(AssertUnwindSafe(|| match bytes.starts_with(&EXR_MAGIC) {
        true => decode_exr(bytes),
        false => decode_others(path, bytes, usage.raw),
    }));
    let mut image = decoded.unwrap_or_else(|_| Err("makes its decoder fail: the file is damaged".into()))?;
    if usage.scalar {
        image.texels = to_scalar(image.texels);
    }
    if let Texels::Grey32(values) | Texels::Rgb32(values) = &image.texels
        && let Some(i) = values.iter().position(|x| !x.is_finite())
    {
        let pixel = i / (values.len() / (image.width as usize * image.height as usize));
        let (x, y) = (pixel % image.width as usize, pixel / image.width as usize);
        return Err(format!("has a value that is not finite at pixel ({x}, {y}); repair it in an image editor"));
    }
    Ok(image)
}

const EXR_MAGIC: [u8; 4] = [0x76, 0x2f, 0x31, 0x01];

/// Marks of HDR files: that of Radiance, and that of Ward's small library, which Mitsuba and others write.
const HDR_MARKS: [&[u8]; 2] = [b"#?RADIANCE", b"#?RGBE"];

fn decode_others(path: &Path, bytes: &[u8], raw: bool) -> Result<Image, String> {
    // The decoder knows the first mark only; behind it the files are the same.
    let marked = bytes.strip_prefix(HDR_MARKS[1]).map(|rest| [HDR_MARKS[0], rest].concat());
    let bytes = marked.as_deref().unwrap_or(bytes);
    let by_name = path.extension().and_then(ImageFormat::from_extension);
    let format = match image::guess_format(bytes) {
        Ok(format) => format,
        // TGA files have no mark of their own.
        Err(_) if by_name == Some(ImageFormat::Tga) => ImageFormat::Tga,
        Err(_) => return Err("is no image of a known kind; there are PNG, JPEG, TGA, HDR and EXR".into()),
    };
    let srgb = !raw;
    if format == ImageFormat::Jpeg {
        return decode_jpeg(bytes, srgb);
    }
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    let mut limits = Limits::default();
    limits.max_image_width = Some(SIDE_MAX as u32);
    limits.max_image_height = Some(SIDE_MAX as u32);
    limits.max_alloc = Some(DECODED_BYTES_MAX);
    reader.limits(limits);
    let decoded = reader.decode().map_err(|e| format!("cannot be decoded: {e}"))?;
    let (width, height) = (decoded.width(), decoded.height());
    if width == 0 || height == 0 {
        return Err("has no pixels".into());
    }
    let texels = match decoded {
        DynamicImage::ImageLuma8(image) => Texels::Grey8 { srgb, data: image.into_raw() },
        DynamicImage::ImageRgb8(image) => Texels::Rgb8 { srgb, data: image.into_raw() },
        image @ DynamicImage::ImageLumaA8(_) => Texels::Grey8 { srgb, data: image.into_luma8().into_raw() },
        image @ DynamicImage::ImageRgba8(_) => Texels::Rgb8 { srgb, data: image.into_rgb8().into_raw() },
        image @ (DynamicImage::ImageLuma16(_) | DynamicImage::ImageLumaA16(_)) => {
            Texels::Grey32(from_16_bit(&image.into_luma16().into_raw(), srgb))
        }
        image @ (DynamicImage::ImageRgb16(_) | DynamicImage::ImageRgba16(_)) => {
            Texels::Rgb32(from_16_bit(&image.into_rgb16().into_raw(), srgb))
        }
        image => Texels::Rgb32(image.into_rgb32f().into_raw()),
    };
    Ok(Image { width, height, texels })
}

/// With a decoder of its own: that of `image` rounds halved colour up each time it doubles it, which makes photographs bluer, by
/// 0.4 of 255 on average.
fn decode_jpeg(bytes: &[u8], srgb: bool) -> Result<Image, String> {
    use jpeg_decoder::PixelFormat;
    let fail = |e: jpeg_decoder::Error| format!("cannot be decoded: {e}");
    let mut decoder = jpeg_decoder::Decoder::new(bytes);
    decoder.set_max_decoding_buffer_size(usize::try_from(DECODED_BYTES_MAX).unwrap_or(usize::MAX));
    decoder.read_info().map_err(fail)?;
    let info = decoder.info().ok_or("has no header")?;
    if usize::from(info.width.max(info.height)) > SIDE_MAX {
        return Err(format!("has {}×{} pixels, more than it may have", info.width, info.height));
    }
    let data = decoder.decode().map_err(fail)?;
    let texels = match info.pixel_format {
        PixelFormat::L8 => Texels::Grey8 { srgb, data },
        PixelFormat::RGB24 => Texels::Rgb8 { srgb, data },
        PixelFormat::L16 | PixelFormat::CMYK32 => {
            return Err("has neither one nor three colours of 8 bits; save it as RGB".into());
        }
    };
    Ok(Image { width: info.width.into(), height: info.height.into(), texels })
}

fn from_16_bit(values: &[u16], srgb: bool) -> Vec<f32> {
    let decode = |x: f64| if srgb { srgb_to_linear(x) } else { x };
    let table: Vec<f32> = (0..=u16::MAX).map(|i| decode(f64::from(i) / f64::from(u16::MAX)) as f32).collect();
    values.iter().map(|&i| table[usize::from(i)]).collect()
}

/// The sRGB curve (IEC 61966-2-1).
fn srgb_to_linear(x: f64) -> f64 {
    if x <= 0.04045 { x / 12.92 } else { libm::pow((x + 0.055) / 1.055, 2.4) }
}

/// The first layer's R, G and B, or its only other channel (Y).
fn decode_exr(bytes: &[u8]) -> Result<Image, String> {
    use exr::prelude::{ReadChannels, ReadLayers};
    let fail = |e: exr::error::Error| format!("cannot be decoded: {e}");
    let meta = exr::meta::MetaData::read_from_buffered(Cursor::new(bytes), false).map_err(fail)?;
    for header in &meta.headers {
        let (size, channels) = (header.layer_size, header.channels.list.len());
        let decoded = (size.0 as u64).saturating_mul(size.1 as u64).saturating_mul(4 * channels as u64);
        if size.0 > SIDE_MAX || size.1 > SIDE_MAX || channels > EXR_CHANNELS_MAX || decoded > DECODED_BYTES_MAX {
            return Err(format!("has {}×{} pixels and {channels} channels, more than it may have", size.0, size.1));
        }
    }
    let reader = exr::prelude::read().no_deep_data().largest_resolution_level().all_channels();
    let image = reader.first_valid_layer().all_attributes().non_parallel().from_buffered(Cursor::new(bytes));
    let layer = image.map_err(fail)?.layer_data;
    let channels = &layer.channel_data.list;
    let find = |name: &str| channels.iter().find(|channel| channel.name.eq_case_insensitive(name));
    let texels = match [find("R"), find("G"), find("B")] {
        [Some(r), Some(g), Some(b)] => {
            let [r, g, b] = [r, g, b].map(samples);
            Texels::Rgb32(r.zip(g).zip(b).flat_map(|((r, g), b)| [r, g, b]).collect())
        }
        _ => match find("Y").or(channels.first().filter(|_| channels.len() == 1)) {
            Some(y) => Texels::Grey32(samples(y).collect()),
            None => return Err("has neither channels R, G and B nor a single one".into()),
        },
    };
    let side = |n: usize| u32::try_from(n).map_err(|_| "is too large".to_owned());
    Ok(Image { width: side(layer.size.0)?, height: side(layer.size.1)?, texels })
}

fn samples(channel: &AnyChannel<FlatSamples>) -> Box<dyn Iterator<Item = f32> + '_> {
    match &channel.sample_data {
        FlatSamples::F16(values) => Box::new(values.iter().map(|x| x.to_f32())),
        FlatSamples::F32(values) => Box::new(values.iter().copied()),
        FlatSamples::U32(values) => Box::new(values.iter().map(|&x| x as f32)),
    }
}

fn to_scalar(texels: Texels) -> Texels {
    match texels {
        Texels::Rgb8 { srgb, data } if data.chunks_exact(3).all(|p| p[0] == p[1] && p[1] == p[2]) => {
            Texels::Grey8 { srgb, data: data.chunks_exact(3).map(|p| p[0]).collect() }
        }
        Texels::Rgb8 { srgb, data } => {
            let decode = |byte: u8| {
                let x = f64::from(byte) / 255.0;
                if srgb { srgb_to_linear(x) } else { x }
            };
            let table: Vec<f64> = (0..=u8::MAX).map(decode).collect();
            let linear = |p: &[u8]| DVec3::from_array([p[0], p[1], p[2]].map(|byte| table[usize::from(byte)]));
            Texels::Grey32(data.chunks_exact(3).map(|p| luminance(linear(p)) as f32).collect())
        }
        Texels::Rgb32(data) => {
            let value = |p: &[f32]| luminance(DVec3::new(p[0].into(), p[1].into(), p[2].into())) as f32;
            Texels::Grey32(data.chunks_exact(3).map(value).collect())
        }
        grey => grey,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{ImageBuffer, Luma, Rgb, Rgba};

    const COLOUR: Use = Use { raw: false, scalar: false };

    fn encode(image: impl Into<DynamicImage>, format: ImageFormat) -> Vec<u8> {
        let mut bytes = Cursor::new(Vec::new());
        image.into().write_to(&mut bytes, format).unwrap();
        bytes.into_inner()
    }

    fn load(name: &str, bytes: &[u8], usage: Use) -> Result<Image, String> {
        decode(Path::new(name), bytes, usage)
    }

    #[test]
    fn eight_bits_stay_eight_bits_top_row_first() {
        let pixels = ImageBuffer::from_fn(1, 2, |_, y| Rgb([255 * (1 - y as u8), 0, 7]));
        for (name, format) in [("a.png", ImageFormat::Png), ("a.tga", ImageFormat::Tga)] {
            let image = load(name, &encode(pixels.clone(), format), COLOUR).unwrap();
            assert_eq!(image.texels, Texels::Rgb8 { srgb: true, data: vec![255, 0, 7, 0, 0, 7] }, "{name}");
        }
        let raw = load("a.png", &encode(pixels, ImageFormat::Png), Use { raw: true, scalar: false }).unwrap();
        assert!(matches!(raw.texels, Texels::Rgb8 { srgb: false, .. }));
    }

    #[test]
    fn alpha_is_dropped() {
        let pixels: ImageBuffer<Rgba<u8>, _> = ImageBuffer::from_pixel(1, 1, Rgba([1, 2, 3, 4]));
        let image = load("a.png", &encode(pixels, ImageFormat::Png), COLOUR).unwrap();
        assert_eq!(image.texels, Texels::Rgb8 { srgb: true, data: vec![1, 2, 3] });
    }

    /// 32768 of 65535 is 0.2140 in linear light, as Mitsuba 3.9.1 has it (in half floats: 0.21399).
    #[test]
    fn sixteen_bits_become_linear_floats() {
        let pixels: ImageBuffer<Luma<u16>, Vec<u16>> = ImageBuffer::from_pixel(1, 1, Luma([32768]));
        let bytes = encode(pixels, ImageFormat::Png);
        let Texels::Grey32(values) = load("a.png", &bytes, COLOUR).unwrap().texels else { panic!("not grey floats") };
        assert!((values[0] - 0.21404).abs() < 1e-4, "{}", values[0]);
        let raw = load("a.png", &bytes, Use { raw: true, scalar: false }).unwrap();
        assert_eq!(raw.texels, Texels::Grey32(vec![32768.0 / 65535.0]));
    }

    /// (128, 64, 200) has linear luminance 0.12425652 in Mitsuba 3.9.1.
    #[test]
    fn colours_used_as_numbers_become_luminance() {
        let scalar = Use { raw: false, scalar: true };
        let colour = ImageBuffer::from_pixel(1, 1, Rgb([128u8, 64, 200]));
        let Texels::Grey32(values) = load("a.png", &encode(colour, ImageFormat::Png), scalar).unwrap().texels else {
            panic!("not grey floats")
        };
        assert!((values[0] - 0.12425652).abs() < 1e-6, "{}", values[0]);
        let grey = ImageBuffer::from_pixel(1, 1, Rgb([9u8, 9, 9]));
        let image = load("a.png", &encode(grey, ImageFormat::Png), scalar).unwrap();
        assert_eq!(image.texels, Texels::Grey8 { srgb: true, data: vec![9] });
    }

    #[test]
    fn exr_floats_come_exactly() {
        let mut file = Cursor::new(Vec::new());
        let pixels = |p: exr::math::Vec2<usize>| (p.x() as f32, 2.5f32, -(p.y() as f32));
        let channels = exr::image::SpecificChannels::rgb(pixels);
        use exr::prelude::WritableImage;
        exr::image::Image::from_channels((2, 2), channels).write().to_buffered(&mut file).unwrap();
        let bytes = file.into_inner();
        let image = load("a.exr", &bytes, COLOUR).unwrap();
        let expected = vec![0.0, 2.5, -0.0, 1.0, 2.5, -0.0, 0.0, 2.5, -1.0, 1.0, 2.5, -1.0];
        assert_eq!(image.texels, Texels::Rgb32(expected));
        for len in (0..bytes.len()).step_by(7) {
            assert!(load("a.exr", &bytes[..len], COLOUR).is_err(), "{len} bytes");
        }
    }

    #[test]
    fn what_is_no_image_or_too_large_is_refused() {
        assert!(load("a.png", b"hello", COLOUR).unwrap_err().contains("no image of a known kind"));
        assert!(load("a.tga", b"hello", COLOUR).is_err());
        let mut png = encode(ImageBuffer::from_pixel(1, 1, Luma([0u8])), ImageFormat::Png);
        png.truncate(40);
        assert!(load("a.png", &png, COLOUR).unwrap_err().contains("cannot be decoded"));
        let wide: ImageBuffer<Luma<u8>, Vec<u8>> = ImageBuffer::new(SIDE_MAX as u32 + 1, 1);
        assert!(load("a.png", &encode(wide, ImageFormat::Png), COLOUR).unwrap_err().contains("cannot be decoded"));
    }
}
