//! What must be true of the tracer: answers that are known, and what must not change them.

#![allow(clippy::unwrap_used)]

mod analytic;
mod build;
mod closed;
mod invariance;
mod means;
mod offsets;
mod precise;
mod replay;
mod reuse;
mod robust;
mod savings;
mod sums;
mod unbiased;
mod watertight;
