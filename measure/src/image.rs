//! Images to be compared: linear RGB, and the variance of each value where it is known.

/// An image, row by row from the top.
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    /// What messages call it.
    pub name: String,
    /// Pixels across.
    pub width: usize,
    /// Pixels down.
    pub height: usize,
    /// Linear sRGB.
    pub rgb: Vec<[f32; 3]>,
    /// Variance of each value as a mean of samples, if the image says it.
    pub variance: Option<Variance>,
}

/// How sure an image is of itself.
#[derive(Clone, Debug, PartialEq)]
pub struct Variance {
    /// Of each value.
    pub rgb: Vec<[f32; 3]>,
    /// Degrees of freedom of these estimates: replicates less one. `None` if the image does not say; they are taken for exact.
    pub freedom: Option<u32>,
}

/// Images that cannot be compared.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Mismatch {
    /// Other sizes.
    #[error("{a} has {}x{} pixels and {b} has {}x{}; render both with the same --size and --crop", a_size[0], a_size[1], b_size[0], b_size[1])]
    Size {
        /// The first.
        a: String,
        /// Its width and height.
        a_size: [usize; 2],
        /// The second.
        b: String,
        /// Its width and height.
        b_size: [usize; 2],
    },
    /// NaN or infinite.
    #[error("{name}: pixel ({x}, {y}) has the {channel} value {value}; metrics of such an image mean nothing")]
    NotFinite {
        /// Whose.
        name: String,
        /// Column.
        x: usize,
        /// Row.
        y: usize,
        /// Channel.
        channel: &'static str,
        /// What it is.
        value: String,
    },
    /// No pixels.
    #[error("{0} has no pixels")]
    Empty(String),
}

impl Image {
    /// Whether every value is a number. Infinite variances are allowed: so says an image of too few samples.
    ///
    /// # Errors
    /// The first value that is none.
    pub fn check(&self) -> Result<(), Mismatch> {
        if self.rgb.is_empty() {
            return Err(Mismatch::Empty(self.name.clone()));
        }
        let fault = |i: usize, channel, value: f32| Mismatch::NotFinite {
            name: self.name.clone(),
            x: i % self.width,
            y: i / self.width,
            channel,
            value: value.to_string(),
        };
        let channels = ["R", "G", "B"];
        for (i, pixel) in self.rgb.iter().enumerate() {
            if let Some(c) = pixel.iter().position(|v| !v.is_finite()) {
                return Err(fault(i, channels[c], pixel[c]));
            }
        }
        let variances = ["Variance.R", "Variance.G", "Variance.B"];
        for (i, pixel) in self.variance.iter().flat_map(|v| &v.rgb).enumerate() {
            if let Some(c) = pixel.iter().position(|v| v.is_nan() || *v < 0.0) {
                return Err(fault(i, variances[c], pixel[c]));
            }
        }
        Ok(())
    }
}

/// Whether the two can be compared.
///
/// # Errors
/// Why not.
pub fn comparable(a: &Image, b: &Image) -> Result<(), Mismatch> {
    a.check()?;
    b.check()?;
    if (a.width, a.height) != (b.width, b.height) {
        let [a_size, b_size] = [[a.width, a.height], [b.width, b.height]];
        return Err(Mismatch::Size { a: a.name.clone(), a_size, b: b.name.clone(), b_size });
    }
    Ok(())
}
