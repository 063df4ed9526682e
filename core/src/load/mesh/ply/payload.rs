//! The bytes behind a PLY file's header, number by number or in rows of equal length.

use super::Told;
use ply_rs_bw::ply::{ElementDef, Encoding, PropertyType, ScalarType};
use rayon::prelude::*;

/// The bytes behind the header.
pub struct Payload<'a> {
    encoding: Encoding,
    bytes: &'a [u8],
    at: usize,
}

const TRUNCATED: &str = "the file ends before its last vertex or face: it is truncated; copy or export it again";

impl<'a> Payload<'a> {
    pub fn new(encoding: Encoding, bytes: &'a [u8], at: usize) -> Self {
        Self { encoding, bytes, at }
    }

    /// The number of rows to make room for: the header's, unless the bytes left cannot hold as many.
    pub fn plausible(&self, count: usize) -> usize {
        count.min((self.bytes.len() - self.at) / 2)
    }

    /// The next number.
    pub fn scalar(&mut self, kind: &ScalarType) -> Told<f64> {
        if self.encoding == Encoding::Ascii {
            return self.word();
        }
        let size = size_of_scalar(kind);
        let Some(bytes) = self.bytes.get(self.at..self.at + size) else { return Err(TRUNCATED.into()) };
        self.at += size;
        Ok(decode(kind, bytes, self.encoding == Encoding::BinaryBigEndian))
    }

    /// Leaves out a property.
    pub fn skip(&mut self, kind: &PropertyType) -> Told<()> {
        match kind {
            PropertyType::Scalar(kind) => self.scalar(kind).map(|_| ()),
            PropertyType::List(count, kind) => {
                let count = self.scalar(count)?;
                (0..count as u64).try_for_each(|_| self.scalar(kind).map(|_| ()))
            }
        }
    }

    /// All rows of an element (a `what`). The properties `numbers` must be finite as 32-bit numbers; lists are left out.
    pub fn rows(&mut self, element: &ElementDef, what: &str, numbers: &[usize]) -> Told<Rows<'a>> {
        let kinds = || element.properties.values().map(|property| &property.data_type);
        let fault =
            |i: usize| format!("{what} {i} has a number that is not finite, or beyond 3e38; export the mesh again");
        let is_good = |row: Row| numbers.iter().all(|&property| (row.get(property) as f32).is_finite());
        let is_binary = self.encoding != Encoding::Ascii;
        if is_binary && let Some(layout) = kinds().map(scalar_of).collect::<Option<Vec<_>>>() {
            let rows = self.take_rows(element.count, layout).ok_or(TRUNCATED)?;
            return match rows.position_first(|row| !is_good(row)) {
                Some(i) => Err(fault(i)),
                None => Ok(rows),
            };
        }
        let width = element.properties.len();
        let mut table = Vec::with_capacity(self.plausible(element.count).saturating_mul(width));
        for i in 0..element.count {
            for kind in kinds() {
                table.push(match kind {
                    PropertyType::Scalar(kind) => self.scalar(kind)?,
                    PropertyType::List(..) => self.skip(kind).map(|()| 0.0)?,
                });
            }
            let row = &table[i * width..];
            if !numbers.iter().all(|&property| (row[property] as f32).is_finite()) {
                return Err(fault(i));
            }
        }
        Ok(Rows::table(table, width))
    }

    /// All rows of an element whose property `corners` is a list of three in each, and under which number the first corner
    /// is found in them; none if they are not all so, and nothing is read.
    pub fn triangles(
        &mut self,
        element: &ElementDef,
        corners: usize,
        numbers: &[usize],
    ) -> Told<Option<(Rows<'a>, usize)>> {
        if self.encoding == Encoding::Ascii {
            return Ok(None);
        }
        let mut layout = Vec::new();
        let mut index = ScalarType::Int;
        for (i, property) in element.properties.values().enumerate() {
            match &property.data_type {
                PropertyType::Scalar(kind) => layout.push((kind.clone(), 0)),
                PropertyType::List(count, kind) if i == corners => {
                    layout.push((count.clone(), 3 * size_of_scalar(kind)));
                    index = kind.clone();
                }
                PropertyType::List(..) => return Ok(None),
            }
        }
        let before = self.at;
        let rows = self.take_rows(element.count, layout);
        let Some(mut rows) = rows.filter(|rows| rows.position_first(|row| row.get(corners) != 3.0).is_none()) else {
            self.at = before;
            return Ok(None);
        };
        let bad = rows.position_first(|row| numbers.iter().any(|&property| !(row.get(property) as f32).is_finite()));
        if let Some(i) = bad {
            return Err(format!("face {i} has a number that is not finite, or beyond 3e38; export the mesh again"));
        }
        let first = rows.add_list_of_three(corners, &index);
        Ok(Some((rows, first)))
    }

    /// The next rows of these kinds of numbers, each with some bytes behind it that are left out; none if there are not as many.
    fn take_rows(&mut self, count: usize, layout: Vec<(ScalarType, usize)>) -> Option<Rows<'a>> {
        let mut stride = 0;
        let mut fields = Vec::with_capacity(layout.len() + 3);
        for (kind, behind) in layout {
            let size = size_of_scalar(&kind);
            fields.push((kind, stride));
            stride += size + behind;
        }
        let rest = &self.bytes[self.at..];
        let bytes = if stride == 0 { &rest[..0] } else { rest.get(..count.checked_mul(stride)?)? };
        self.at += bytes.len();
        Some(Rows(Kind::Bytes { bytes, stride, fields, is_big_endian: self.encoding == Encoding::BinaryBigEndian }))
    }

    /// The next word of a text file as a number.
    fn word(&mut self) -> Told<f64> {
        let rest = &self.bytes[self.at..];
        let Some(blanks) = rest.iter().position(|b| !b.is_ascii_whitespace()) else {
            return Err(TRUNCATED.into());
        };
        let word = &rest[blanks..];
        let len = word.iter().position(u8::is_ascii_whitespace).unwrap_or(word.len());
        self.at += blanks + len;
        let text = String::from_utf8_lossy(&word[..len.min(40)]);
        text.parse().map_err(|_| format!("'{text}' is not a number"))
    }

    /// Number and text of the line just read, in a text file.
    pub fn line(&self) -> Option<(usize, String)> {
        if self.encoding != Encoding::Ascii {
            return None;
        }
        let at = self.at.saturating_sub(1);
        let number = self.bytes[..at].iter().filter(|&&b| b == b'\n').count() + 1;
        let line = self.bytes.split(|&b| b == b'\n').nth(number - 1).unwrap_or_default();
        Some((number, String::from_utf8_lossy(&line[..line.len().min(1000)]).into_owned()))
    }
}

/// The rows of an element.
pub struct Rows<'a>(Kind<'a>);

enum Kind<'a> {
    /// As in the file, with kind and place of each property.
    Bytes { bytes: &'a [u8], stride: usize, fields: Vec<(ScalarType, usize)>, is_big_endian: bool },
    /// Read already.
    Table { values: Vec<f64>, width: usize },
}

/// One of the [`Rows`].
#[derive(Clone, Copy)]
pub struct Row<'a>(&'a Rows<'a>, usize);

impl Rows<'_> {
    /// Rows of `width` numbers.
    pub fn table(values: Vec<f64>, width: usize) -> Self {
        Self(Kind::Table { values, width })
    }

    fn len(&self) -> usize {
        match &self.0 {
            Kind::Bytes { bytes, stride, .. } => bytes.len().checked_div(*stride).unwrap_or(0),
            Kind::Table { values, width } => values.len().checked_div(*width).unwrap_or(0),
        }
    }

    /// Something of each row, on all processors.
    pub fn collect<T: Send>(&self, make: impl Fn(Row) -> T + Sync) -> Vec<T> {
        (0..self.len()).into_par_iter().map(|i| make(Row(self, i))).collect()
    }

    /// The first row of which something holds.
    fn position_first(&self, holds: impl Fn(Row) -> bool + Sync) -> Option<usize> {
        (0..self.len()).into_par_iter().position_first(|i| holds(Row(self, i)))
    }

    /// Adds three numbers that lie behind a property; they get the next numbers, of which it returns the first.
    fn add_list_of_three(&mut self, property: usize, kind: &ScalarType) -> usize {
        let Kind::Bytes { fields, .. } = &mut self.0 else { return 0 };
        let first = fields.len();
        let (count, at) = &fields[property];
        let at = at + size_of_scalar(count);
        fields.extend((0..3).map(|k| (kind.clone(), at + k * size_of_scalar(kind))));
        first
    }
}

impl Row<'_> {
    /// The number of a property.
    #[inline]
    pub fn get(&self, property: usize) -> f64 {
        match &self.0.0 {
            Kind::Bytes { bytes, stride, fields, is_big_endian } => {
                let (kind, offset) = &fields[property];
                decode(kind, &bytes[self.1 * stride + offset..], *is_big_endian)
            }
            Kind::Table { values, width } => values[self.1 * width + property],
        }
    }
}

/// The number that `bytes` begin with; they are long enough.
#[inline]
fn decode(kind: &ScalarType, bytes: &[u8], is_big_endian: bool) -> f64 {
    #[inline]
    fn array<const N: usize>(bytes: &[u8], is_big_endian: bool) -> [u8; N] {
        let mut array = [0; N];
        array.copy_from_slice(&bytes[..N]);
        if is_big_endian {
            array.reverse();
        }
        array
    }
    match kind {
        ScalarType::Char => f64::from(i8::from_le_bytes(array(bytes, is_big_endian))),
        ScalarType::UChar => f64::from(u8::from_le_bytes(array(bytes, is_big_endian))),
        ScalarType::Short => f64::from(i16::from_le_bytes(array(bytes, is_big_endian))),
        ScalarType::UShort => f64::from(u16::from_le_bytes(array(bytes, is_big_endian))),
        ScalarType::Int => f64::from(i32::from_le_bytes(array(bytes, is_big_endian))),
        ScalarType::UInt => f64::from(u32::from_le_bytes(array(bytes, is_big_endian))),
        ScalarType::Float => f64::from(f32::from_le_bytes(array(bytes, is_big_endian))),
        ScalarType::Double => f64::from_le_bytes(array(bytes, is_big_endian)),
    }
}

fn size_of_scalar(kind: &ScalarType) -> usize {
    match kind {
        ScalarType::Char | ScalarType::UChar => 1,
        ScalarType::Short | ScalarType::UShort => 2,
        ScalarType::Int | ScalarType::UInt | ScalarType::Float => 4,
        ScalarType::Double => 8,
    }
}

fn scalar_of(kind: &PropertyType) -> Option<(ScalarType, usize)> {
    match kind {
        PropertyType::Scalar(kind) => Some((kind.clone(), 0)),
        PropertyType::List(..) => None,
    }
}

/// A vertex index: none if the number is negative, fractional or too large.
pub fn integer(x: f64) -> Option<u32> {
    (x >= 0.0 && x <= f64::from(u32::MAX) && x == x.trunc()).then_some(x as u32)
}
