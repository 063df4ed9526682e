//! Compiles `render.proto` without protoc: protox parses it, tonic-prost-build writes the Rust.

use std::error::Error;

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo::rerun-if-changed=proto/render.proto");
    let descriptors = protox::compile(["render.proto"], ["proto"])?;
    // `bytes` fields arrive as slices of the receive buffer, not as copies.
    tonic_prost_build::configure().bytes(".").compile_fds(descriptors)?;
    Ok(())
}
