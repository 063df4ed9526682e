//! The tracer of tilecast: a scene in, exact partial sums out.
//!
//! The way of the data: `load` reads files into a plain [`scene::Scene`] and its default [`settings::Settings`];
//! [`world::World`] compiles the scene for tracing; [`trace::Tracer`] joins a world with settings and turns a unit of
//! work (a tile and a range of sample indices) into a [`film::TileSums`]; [`film::Film`] adds those up, exactly and in any
//! order. `examples/render.rs` is the whole way in one page.
//!
//! A unit of work is a pure function of (scene, settings, tile, sample range). Nothing here reads a clock, a thread
//! number or a global; nothing here knows of networks, processes or the command line, and nothing prints.

pub mod bsdf;
pub mod bvh;
pub mod camera;
#[cfg(test)]
mod chi_square;
pub mod film;
pub mod filter;
pub mod frame;
pub mod geometry;
pub mod integrator;
pub mod lights;
pub mod load;
pub mod sampler;
pub mod scene;
pub mod settings;
pub mod shading;
pub mod shape;
mod sobol;
pub mod surface;
pub mod texture;
pub mod trace;
pub mod trig;
pub mod warp;
pub mod witness;
pub mod world;

/// The engine's version. The bits of an image depend on it: workers of one job must have the same.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");
