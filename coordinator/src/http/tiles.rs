//! Tiles of a film as the page takes them: the means in full, and their standard errors to two digits.
//!
//! ```text
//! u32 format, u32 whether there is more, u64 version, u32 x0 y0 x1 y1 of the film, u32 step, u32 tiles; for each tile:
//! u32 x y of its first pixel, u32 width height in pixels that are sent, u64 samples a pixel,
//! f32 means, u16 standard errors (the upper halves of f32), both channel by channel, and zeros to the next multiple of 4
//! ```
//! All is little-endian. Of films too large for a browser every step-th pixel of every step-th row is sent.

use super::Inner;
use super::guard::told;
use crate::films::look::{Changes, Look};
use crate::service::{Shared, bring_back};
use axum::extract::{Path, State};
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use std::sync::Arc;
use tilecast_core::film::Estimate;
use tilecast_core::settings::Window;
use tilecast_proto::types::JobId;
use tonic::Status;

/// Changes with the format.
const FORMAT: u32 = 1;
/// Pixels in one answer: some 5 MB, and a few dozen milliseconds of work.
const PIXELS_MAX: u64 = 256 << 10;
/// Pixels of a film that are sent to a browser, which keeps them all.
const SHOWN_MAX: u64 = 16 << 20;

/// The tiles that changed since a version of the film.
pub async fn tiles(State(site): State<Arc<Inner>>, Path((job, instance, since)): Path<(u64, String, u64)>) -> Response {
    if instance != format!("{:x}", site.shared.instance) {
        return (StatusCode::CONFLICT, "the coordinator was started again\n").into_response();
    }
    let shared = Arc::clone(&site.shared);
    let encode = async || tokio::task::spawn_blocking(move || encoded(&shared, JobId(job), since)).await;
    match site.pace.work(encode).await {
        Ok(Ok(bytes)) => ([(header::CONTENT_TYPE, "application/octet-stream")], bytes).into_response(),
        Ok(Err(status)) => told(&status),
        Err(_) => StatusCode::INTERNAL_SERVER_ERROR.into_response(),
    }
}

/// A film that had to go comes back from the store, as for whoever fetches it.
fn encoded(shared: &Shared, job: JobId, since: u64) -> Result<Vec<u8>, Status> {
    bring_back(shared, job)?;
    let window = shared.with_ledger(|ledger, _| ledger.spec(job))?.settings.film.crop;
    let changes = shared.films.changes(job, since, PIXELS_MAX);
    let dropped = || Status::not_found(format!("the film of job {job} was dropped to make room"));
    Ok(encode(window, &changes.ok_or_else(dropped)?))
}

fn encode(film: Window, changes: &Changes) -> Vec<u8> {
    let step = step(film);
    let pixels: usize = changes.tiles.iter().map(|tile| tile.pixels.len()).sum();
    let mut out = Vec::with_capacity(64 + 32 * changes.tiles.len() + 18 * pixels);
    let mut put = |word: u32| out.extend(word.to_le_bytes());
    [FORMAT, u32::from(changes.more), changes.version as u32, (changes.version >> 32) as u32]
        .into_iter()
        .chain([film.x0, film.y0, film.x1, film.y1, step, changes.tiles.len() as u32])
        .for_each(&mut put);
    changes.tiles.iter().for_each(|tile| put_tile(&mut out, film, step, tile));
    out
}

fn put_tile(out: &mut Vec<u8>, film: Window, step: u32, tile: &Look) {
    let Window { x0, y0, x1, y1 } = tile.window;
    // The first pixel of the grid, which begins where the film does.
    let first = |low: u32, origin: u32| origin + (low - origin).next_multiple_of(step);
    let (x, y) = (first(x0, film.x0), first(y0, film.y0));
    let len = |first: u32, end: u32| end.saturating_sub(first).div_ceil(step);
    let mut put = |word: u32| out.extend(word.to_le_bytes());
    [x, y, len(x, x1), len(y, y1), tile.count as u32, (tile.count >> 32) as u32].into_iter().for_each(&mut put);
    let width = tile.window.width() as usize;
    let rows = (y..y1).step_by(step as usize).map(|y| (y - y0) as usize * width);
    let shown: Vec<&Estimate> = rows
        .flat_map(|row| (x..x1).step_by(step as usize).map(move |x| row + (x - x0) as usize))
        .map(|i| &tile.pixels[i])
        .collect();
    for c in 0..3 {
        shown.iter().for_each(|pixel| out.extend(pixel.mean[c].to_le_bytes()));
    }
    for c in 0..3 {
        shown.iter().for_each(|pixel| out.extend(upper_half(pixel.variance[c].sqrt()).to_le_bytes()));
    }
    out.resize(out.len().next_multiple_of(4), 0);
}

/// Sign, exponent and the first 7 bits of the mantissa, rounded.
fn upper_half(x: f32) -> u16 {
    // Up to the largest finite one this cannot carry into the sign; infinity has no mantissa to round.
    if x.is_finite() { ((x.to_bits() + 0x8000) >> 16) as u16 } else { (x.to_bits() >> 16) as u16 }
}

/// The smallest step that leaves few enough pixels.
fn step(film: Window) -> u32 {
    (1..).find(|&step| film.area() / (u64::from(step) * u64::from(step)) <= SHOWN_MAX).unwrap_or(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn look(window: Window) -> Look {
        let at = |y: u32| (window.x0..window.x1).map(move |x| (x, y));
        let pixel =
            |(x, y): (u32, u32)| Estimate { mean: [x as f32, y as f32, 7.5], variance: [4.0, 2.25, 1e-6], count: 9 };
        Look { window, count: 9, pixels: (window.y0..window.y1).flat_map(at).map(pixel).collect() }
    }

    fn word(bytes: &[u8], at: usize) -> u32 {
        u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap())
    }

    #[test]
    fn a_tile_is_laid_out_as_the_page_reads_it() {
        let film = Window { x0: 10, y0: 20, x1: 20, y1: 30 };
        let window = Window { x0: 13, y0: 20, x1: 16, y1: 21 };
        let bytes = encode(film, &Changes { version: 1 << 33 | 5, more: true, tiles: vec![look(window)] });
        let words: Vec<u32> = (0..16).map(|i| word(&bytes, 4 * i)).collect();
        assert_eq!(words, [1, 1, 5, 2, 10, 20, 20, 30, 1, 1, 13, 20, 3, 1, 9, 0]);
        let floats: Vec<f32> = (16..25).map(|i| f32::from_bits(word(&bytes, 4 * i))).collect();
        assert_eq!(floats, [13.0, 14.0, 15.0, 20.0, 20.0, 20.0, 7.5, 7.5, 7.5]);
        let half =
            |i: usize| f32::from_bits(u32::from(u16::from_le_bytes([bytes[100 + 2 * i], bytes[101 + 2 * i]])) << 16);
        assert_eq!((half(0), half(3)), (2.0, 1.5));
        assert!((half(6) / 1e-3 - 1.0).abs() < 1.0 / 256.0, "{}", half(6));
        // 9 halves and 2 bytes of zeros.
        assert_eq!(bytes.len(), 100 + 20);
    }

    #[test]
    fn a_large_film_is_thinned_by_whole_steps_of_one_grid() {
        let film = Window { x0: 1, y0: 0, x1: 8193, y1: 4096 };
        assert_eq!(step(film), 2);
        let bytes =
            encode(film, &Changes { tiles: vec![look(Window { x0: 4, y0: 3, x1: 8, y1: 6 })], ..Changes::default() });
        let words: Vec<u32> = (8..14).map(|i| word(&bytes, 4 * i)).collect();
        assert_eq!(words, [2, 1, 5, 4, 2, 1], "the pixels (5, 4) and (7, 4)");
        assert_eq!([16, 17].map(|i| f32::from_bits(word(&bytes, 4 * i))), [5.0, 7.0]);
    }

    #[test]
    fn errors_are_rounded_and_never_change_sign_or_become_finite() {
        assert_eq!(upper_half(f32::INFINITY), 0x7f80);
        assert_eq!(upper_half(0.0), 0);
        assert_eq!(upper_half(f32::MAX), 0x7f80);
        assert_eq!(upper_half(1.0039063), 0x3f81);
    }
}
