//! How far images are from each other, and whether chance explains it.
//!
//! Images are plain arrays here; whoever reads and writes files lives elsewhere. Nothing here knows how an image was rendered.

#![cfg_attr(test, allow(clippy::unwrap_used))]

pub mod flip;
mod flip_colour;
pub mod image;
pub mod metrics;
pub mod plot;
pub mod stats;
pub mod ztest;

pub use flip_colour::srgb_to_linear;
