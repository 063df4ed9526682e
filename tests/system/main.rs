//! The whole system, as people meet it: the real program, its real processes, files in temporary folders, ports that the
//! system chooses. Nothing sleeps to wait for something else: what is waited for is looked at until it is there, or a deadline
//! has passed.
//!
//! One binary, so that the program is linked once. Its modules are the guide:

/// Who is let in, and how far.
mod access;
/// Files, flags and peers that are wrong: each a clear message, the right exit code, and nothing left behind.
mod bad_input;
/// What the program says and how it ends: JSON, exit codes, signals, jobs and workers from outside.
mod cli;
/// Coordinator and workers in one process and virtual time: whatever joins, leaves, dies or restarts.
#[cfg(test)] // Lets clippy know that `unwrap` is a test's here.
mod cluster;
/// Images against images: distances, verdicts, and what cannot be compared.
#[cfg(test)] // Lets clippy know that `unwrap` is a test's here.
mod compare;
/// What safety costs.
#[cfg(target_os = "linux")]
mod costs;
/// Thousands of workers.
#[cfg(target_os = "linux")]
mod crowd;
/// What deploy/ starts.
mod deploy;
/// One image, whatever computed it: threads, processes, tiles, instruction sets, losses.
mod digest;
/// What is in the written files.
mod exr;
/// Real processes killed, stopped and drained at random.
mod faults;
/// Peers that waste what they can get.
mod flood;
/// Processes and folders that are gone when a test is, however it ends.
mod harness;
/// Workers that ssh and Slurm start.
#[cfg(target_os = "linux")]
mod launch;
/// Workers that bring wrong sums on purpose.
#[cfg(test)]
mod liars;
/// Traces of units, for a collector.
mod otlp;
/// README and docs: their commands run, their flags exist.
#[cfg(target_os = "linux")]
mod pages;
/// Images gone on with, joined and interrupted.
#[cfg(test)] // Lets clippy know that `unwrap` is a test's here.
mod references;
/// Scenes on their way to many workers.
#[cfg(test)] // Lets clippy know that `unwrap` is a test's here.
mod sharing;
/// The viewer that tiles are sent to.
mod tev;
/// The live page, and what monitors ask.
#[cfg(test)] // Lets clippy know that `unwrap` is a test's here.
mod view;
