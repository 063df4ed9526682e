//! Frames of tev's protocol: u32 length of all of it, u8 operation, and what belongs to that, little-endian, without padding;
//! texts end with a zero. A viewer answers nothing.

use tilecast_core::film::Estimate;
use tilecast_core::settings::Window;

/// The layers: the image, and the standard errors of its means.
const CHANNELS: [&str; 6] = ["R", "G", "B", "error.R", "error.G", "error.B"];

const CREATE: u8 = 4;
/// The third kind of update: channels with offsets and strides.
const UPDATE: u8 = 6;

/// One frame, without its length.
pub struct Frame(Vec<u8>);

/// A tile's channels, one after the other.
pub struct Channels(Vec<f32>);

impl Channels {
    /// In the order of [`CHANNELS`].
    pub fn of(pixels: &[Estimate]) -> Self {
        let means = (0..3).flat_map(|c| pixels.iter().map(move |pixel| pixel.mean[c]));
        let errors = (0..3).flat_map(|c| pixels.iter().map(move |pixel| pixel.variance[c].sqrt()));
        Self(means.chain(errors).collect())
    }
}

impl Frame {
    /// A new image, which the viewer shows at once.
    pub fn create(name: &str, width: u32, height: u32) -> Self {
        let mut frame = Self(vec![CREATE, 1]);
        frame.text(name);
        frame.number(width);
        frame.number(height);
        frame.channels();
        frame
    }

    /// Pixels of a tile; `film` is where the image begins.
    pub fn update(name: &str, film: Window, tile: Window, Channels(data): &Channels) -> Self {
        let mut frame = Self(vec![UPDATE, 0]);
        frame.text(name);
        frame.channels();
        [tile.x0 - film.x0, tile.y0 - film.y0, tile.width(), tile.height()].into_iter().for_each(|n| frame.number(n));
        (0..CHANNELS.len() as u64).for_each(|c| frame.long(c * tile.area()));
        CHANNELS.iter().for_each(|_| frame.long(1));
        data.iter().for_each(|value| frame.0.extend(value.to_le_bytes()));
        frame
    }

    /// Appends it to what is on its way.
    pub fn put(&self, out: &mut Vec<u8>) {
        // A tile has 256 × 256 pixels at the most: 1.5 MB.
        out.extend((self.0.len() as u32 + 4).to_le_bytes());
        out.extend(&self.0);
    }

    fn channels(&mut self) {
        self.number(CHANNELS.len() as u32);
        CHANNELS.iter().for_each(|name| self.text(name));
    }

    fn text(&mut self, text: &str) {
        self.0.extend(text.as_bytes());
        self.0.push(0);
    }

    /// An i32 of tev's; ours are never negative and far below 2^31.
    fn number(&mut self, n: u32) {
        self.0.extend(n.to_le_bytes());
    }

    fn long(&mut self, n: u64) {
        self.0.extend(n.to_le_bytes());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Byte for byte as tev's own `IpcPacket` has them.
    #[test]
    fn frames_are_what_tev_reads() {
        let mut bytes = Vec::new();
        Frame::create("a b", 3, 2).put(&mut bytes);
        let names = b"R\0G\0B\0error.R\0error.G\0error.B\0";
        let expected = [&[52, 0, 0, 0, 4, 1][..], b"a b\0", &[3, 0, 0, 0, 2, 0, 0, 0, 6, 0, 0, 0], names].concat();
        assert_eq!(bytes, expected);

        bytes.clear();
        let (film, tile) = (Window { x0: 10, y0: 20, x1: 40, y1: 50 }, Window { x0: 12, y0: 21, x1: 14, y1: 22 });
        let pixel = |mean: f32| Estimate { mean: [mean, 0.5, 0.25], variance: [4.0, 9.0, 16.0], count: 8 };
        Frame::update("i", film, tile, &Channels::of(&[pixel(1.0), pixel(2.0)])).put(&mut bytes);
        let long = |n: u64| n.to_le_bytes();
        let data: Vec<u8> = [1.0f32, 2.0, 0.5, 0.5, 0.25, 0.25, 2.0, 2.0, 3.0, 3.0, 4.0, 4.0]
            .iter()
            .flat_map(|value| value.to_le_bytes())
            .collect();
        let expected = [
            &[202, 0, 0, 0, 6, 0][..],
            b"i\0",
            &[6, 0, 0, 0],
            names,
            &[2, 0, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0, 1, 0, 0, 0],
            &[0, 2, 4, 6, 8, 10].map(long).concat(),
            &[1; 6].map(long).concat(),
            &data,
        ]
        .concat();
        assert_eq!(bytes.len(), 202);
        assert_eq!(bytes, expected);
    }
}
