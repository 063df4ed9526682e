//! `tilecast launch`: starts workers by what people already run on their machines. One file a launcher; none of them sees a scene,
//! and what a launcher does can be done by hand with `tilecast worker`.

mod slurm;
mod ssh;

pub use slurm::{Scale, Slurm};
pub use ssh::{Host, Ssh};

/// By what.
pub enum Launch {
    /// Slurm's batch jobs.
    Slurm(Slurm),
    /// A remote shell.
    Ssh(Ssh),
}

/// Starts workers, and keeps them as they should be, until told to stop.
///
/// # Errors
/// What keeps all of them from working.
pub async fn run(launch: Launch) -> anyhow::Result<()> {
    match launch {
        Launch::Slurm(slurm) => slurm::run(slurm).await,
        Launch::Ssh(ssh) => ssh::run(ssh).await,
    }
}
