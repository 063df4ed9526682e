//! Reference images: Mitsuba's mean of every pixel and the variance of that mean.

use exr::prelude::{FlatSamples, read_first_flat_layer_from_file};
use glam::DVec3;
use std::path::Path;

/// An image and how sure it is, row by row.
pub struct Reference {
    /// Pixels across.
    pub width: usize,
    /// Pixels down.
    pub height: usize,
    /// Mean radiance.
    pub mean: Vec<DVec3>,
    /// Variance of that mean.
    pub variance: Vec<DVec3>,
}

impl Reference {
    /// Reads channels `R`, `G`, `B` and `Variance.R` … of an EXR.
    ///
    /// # Errors
    /// A file that is not there, no EXR, or lacks one of them as 32-bit floats.
    pub fn read(path: &Path) -> Result<Self, String> {
        let image = read_first_flat_layer_from_file(path)
            .map_err(|error| format!("no reference {}: {error}; make_references.py makes it", path.display()))?;
        let channels = &image.layer_data.channel_data.list;
        let channel = |name: &str| match channels.iter().find(|channel| channel.name.eq(name)).map(|c| &c.sample_data) {
            Some(FlatSamples::F32(values)) => Ok(values.as_slice()),
            _ => Err(format!("{} has no 32-bit channel {name}", path.display())),
        };
        let colour = |names: [&str; 3]| -> Result<Vec<DVec3>, String> {
            let [r, g, b] = names.map(channel);
            let (r, g, b) = (r?, g?, b?);
            Ok((0..r.len()).map(|i| DVec3::new(r[i].into(), g[i].into(), b[i].into())).collect())
        };
        Ok(Self {
            width: image.layer_data.size.width(),
            height: image.layer_data.size.height(),
            mean: colour(["R", "G", "B"])?,
            variance: colour(["Variance.R", "Variance.G", "Variance.B"])?,
        })
    }
}
