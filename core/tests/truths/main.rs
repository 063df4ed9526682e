//! What must be true of the tracer: answers that are known, and what must not change them.

#![allow(clippy::unwrap_used)]

mod analytic;
mod build;
mod invariance;
mod offsets;
mod replay;
mod robust;
mod unbiased;
mod watertight;
