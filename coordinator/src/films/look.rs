//! Looking at a film in the making: the tiles that changed since one looked last, as estimates. Whoever looks keeps a number
//! and nothing else, so that who is slow gets fewer, later states, and costs no memory.

use super::{Films, lock};
use tilecast_core::film::Estimate;
use tilecast_core::settings::Window;
use tilecast_proto::types::JobId;

/// What changed.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Changes {
    /// The version that whoever has these tiles has: to be named the next time.
    pub version: u64,
    /// There was more than was asked for.
    pub more: bool,
    /// The tiles, by when they changed.
    pub tiles: Vec<Look>,
}

/// A tile as it is known.
#[derive(Clone, Debug, PartialEq)]
pub struct Look {
    /// Its pixels.
    pub window: Window,
    /// Samples of each of them.
    pub count: u64,
    /// Row by row.
    pub pixels: Vec<Estimate>,
}

impl Films {
    /// The version that a film has reached; `None` if it is not in memory.
    pub fn version(&self, job: JobId) -> Option<u64> {
        let canvas = self.canvas(job)?;
        let version = lock(&canvas).version();
        Some(version)
    }

    /// The tiles that changed after version `since`, up to `pixels_max` pixels, but one tile at least. The lock is held for a
    /// tile at a time, so that results go on being merged. A version that the film never had stands for none.
    pub fn changes(&self, job: JobId, since: u64, pixels_max: u64) -> Option<Changes> {
        let canvas = self.canvas(job)?;
        let (since, tiles) = {
            let canvas = lock(&canvas);
            let since = if since > canvas.version() { 0 } else { since };
            (since, canvas.changed_since(since))
        };
        let mut changes = Changes { version: since, ..Changes::default() };
        let mut room = pixels_max;
        for (version, tile) in tiles {
            let canvas = lock(&canvas);
            let window = canvas.tile(tile);
            if window.area() > room && !changes.tiles.is_empty() {
                changes.more = true;
                break;
            }
            room = room.saturating_sub(window.area());
            let at = |y: u32| (window.x0..window.x1).map(move |x| (x, y));
            let pixels: Vec<Estimate> =
                (window.y0..window.y1).flat_map(at).map(|(x, y)| canvas.film().estimate(x, y)).collect();
            // Units are whole tiles: all pixels have as many samples.
            let count = pixels.first().map_or(0, |pixel| pixel.count);
            changes.tiles.push(Look { window, count, pixels });
            // One that changed again meanwhile will be told again: that is harmless.
            changes.version = version;
        }
        Some(changes)
    }
}
