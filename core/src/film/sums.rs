//! The compact, lossless form in which sums travel and are kept.
//!
//! A sum of f32 values in fixed point has zeros at both ends: above its magnitude, and below the last bit of its smallest
//! sample. Each `i128` becomes a head and the bytes between: the head's low half is the number of zero bytes left out at the
//! bottom, its high half the number of bytes kept, less one; the kept bytes are little endian and sign-extended. A zero
//! is [`ZERO`] alone. Typical sums take 8 bytes instead of 16.

use super::PixelSums;

/// The head of a zero: 15 bytes left out and 16 kept, which no other value has.
const ZERO: u8 = 0xff;
/// Bytes of an `i128`.
const WORD: usize = 16;

/// Bytes that are no sums.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SumsError {
    /// The bytes end inside a pixel.
    #[error("the sums end within pixel {0}")]
    Short(usize),
    /// Bytes follow the last pixel.
    #[error("{0} bytes follow the last pixel's sums")]
    Long(usize),
    /// A head that leaves out and keeps more bytes than a value has.
    #[error("a sum of pixel {0} claims to be longer than 16 bytes")]
    Head(usize),
}

/// The encoded sums of `pixels`, in their order.
pub fn encode(pixels: &[PixelSums]) -> Vec<u8> {
    // Grown to the typical size at once; a whole word is written each time and cut back, which beats a copy of variable length.
    let mut out = Vec::with_capacity(pixels.len() * 9 * 12 + WORD);
    for &sum in pixels.iter().flat_map(|p| p.0.iter().flatten()) {
        if sum == 0 {
            out.push(ZERO);
            continue;
        }
        let skipped = sum.trailing_zeros() / 8;
        let kept = sum >> (8 * skipped);
        // One bit more than the magnitude has: the sign.
        let bits = 129 - if kept < 0 { (!kept).leading_zeros() } else { kept.leading_zeros() };
        let len = bits.div_ceil(8) as usize;
        out.push(skipped as u8 | ((len - 1) as u8) << 4);
        let end = out.len() + len;
        out.extend_from_slice(&kept.to_le_bytes());
        out.truncate(end);
    }
    out
}

/// The sums of exactly `pixels` pixels. The values are any that fit; their meaning is checked by
/// [`super::TileSums::check`]. Memory is bounded by what `bytes` can hold.
///
/// # Errors
/// Too few or too many bytes, or a head that no encoder writes.
pub fn decode(bytes: &[u8], pixels: usize) -> Result<Vec<PixelSums>, SumsError> {
    // A pixel takes a byte a sum at least: a hostile count cannot make this allocate beyond 16 times the input.
    let shortest = PixelSums::default().0.as_flattened().len();
    if bytes.len() / shortest < pixels {
        return Err(SumsError::Short(bytes.len() / shortest));
    }
    let mut out = Vec::with_capacity(pixels);
    let mut rest = bytes;
    for pixel in 0..pixels {
        let mut sums = PixelSums::default();
        for sum in sums.0.as_flattened_mut() {
            let (&head, tail) = rest.split_first().ok_or(SumsError::Short(pixel))?;
            rest = tail;
            if head == ZERO {
                continue;
            }
            let (skipped, len) = (usize::from(head & 15), usize::from(head >> 4) + 1);
            if skipped + len > WORD {
                return Err(SumsError::Head(pixel));
            }
            let word = first_word(rest, len).ok_or(SumsError::Short(pixel))?;
            rest = &rest[len..];
            // Moved to the top and back, so that the sign fills what was left out above.
            let top = 8 * (WORD - len);
            *sum = (word << top) >> (top - 8 * skipped);
        }
        out.push(sums);
    }
    if rest.is_empty() { Ok(out) } else { Err(SumsError::Long(rest.len())) }
}

/// A little-endian word of which the lowest `len` bytes count; `None` if `bytes` has fewer.
#[inline]
fn first_word(bytes: &[u8], len: usize) -> Option<i128> {
    if let Some(word) = bytes.first_chunk::<WORD>() {
        return Some(i128::from_le_bytes(*word));
    }
    let mut word = [0; WORD];
    word[..len].copy_from_slice(bytes.get(..len)?);
    Some(i128::from_le_bytes(word))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn pixels() -> impl Strategy<Value = Vec<PixelSums>> {
        let sum = (any::<i128>(), 0u32..128, 0u32..128).prop_map(|(x, down, up)| (x >> down) << up);
        prop::collection::vec(prop::array::uniform4(prop::array::uniform3(sum)).prop_map(PixelSums), 0..5)
    }

    #[test]
    fn the_ends_of_the_range_come_back() {
        for x in [0, 1, -1, 127, 128, -128, -129, 255, 256, i128::MAX, i128::MIN, 1 << 126, -(1 << 120), 0xff << 119] {
            let pixel = PixelSums([[x; 3]; 4]);
            assert_eq!(decode(&encode(&[pixel]), 1), Ok(vec![pixel]), "{x}");
        }
    }

    #[test]
    fn a_head_that_no_encoder_writes_is_refused() {
        // 15 bytes left out and 2 kept.
        let mut bytes = vec![0x1f, 1, 1];
        bytes.extend([ZERO; 11]);
        assert_eq!(decode(&bytes, 1), Err(SumsError::Head(0)));
        bytes[0] = 0x1e;
        assert_eq!(decode(&bytes, 1).unwrap()[0].0[0][0], 0x0101 << 112);
    }

    #[test]
    fn a_typical_sum_takes_half() {
        let mut pixel = PixelSums::default();
        for i in 0..256u32 {
            let radiance = glam::Vec3::splat(0.1 + (i % 17) as f32 * 0.037);
            pixel.add(i, radiance, crate::film::scale_exponent(20.0)).unwrap();
        }
        assert!(encode(&[pixel]).len() <= 12 * 7, "{} bytes", encode(&[pixel]).len());
    }

    proptest! {
        #[test]
        fn what_is_encoded_comes_back(pixels in pixels()) {
            let bytes = encode(&pixels);
            prop_assert_eq!(decode(&bytes, pixels.len()), Ok(pixels.clone()));
            prop_assert!(decode(&bytes, pixels.len() + 1).is_err());
            if !pixels.is_empty() {
                prop_assert!(decode(&bytes, pixels.len() - 1).is_err());
                prop_assert!(decode(&bytes[..bytes.len() - 1], pixels.len()).is_err());
            }
        }

        #[test]
        fn hostile_bytes_are_read_or_refused(bytes in prop::collection::vec(any::<u8>(), 0..300), pixels in 0usize..40) {
            if let Ok(sums) = decode(&bytes, pixels) {
                prop_assert_eq!(sums.len(), pixels);
            }
            prop_assert!(decode(&bytes, usize::MAX).is_err());
        }
    }
}
