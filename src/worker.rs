//! `tilecast worker`: traces for a coordinator until it is told to stop.

use crate::LogFormat;
use crate::stop::on_signal;
use anyhow::Context;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;
use tilecast_core::bvh::simd::Isa;
use tilecast_proto::limits::NAME_BYTES_MAX;
use tilecast_proto::transport::Connector;
use tilecast_worker::WorkerConfig;
use tilecast_worker::scenes::SceneCache;
use tilecast_worker::shelf::Shelf;

/// When it is told to end, what is begun may be finished for so long: a worker is gone within 10 s.
const DRAIN: Duration = Duration::from_secs(8);

/// For whom, and with what.
pub struct Worker {
    /// The coordinator.
    pub connector: Connector,
    /// Threads that trace.
    pub threads: u32,
    /// What people call it.
    pub name: String,
    /// Instruction set.
    pub isa: Isa,
    /// End after so long: a scheduler would end it soon after.
    pub lifetime: Option<Duration>,
    /// A folder of scenes, shared with others.
    pub scene_cache: Option<PathBuf>,
    /// End when standard input does: it is a pipe from the process that started this one.
    pub exit_with_parent: bool,
    /// How its log is written.
    pub log: LogFormat,
}

/// Works.
///
/// # Errors
/// A refusal by the coordinator.
pub async fn run(worker: Worker) -> anyhow::Result<()> {
    let Worker { connector, threads, name, isa, lifetime, scene_cache, exit_with_parent, .. } = worker;
    let stop = on_signal()?;
    let scenes = scene_cache.map_or_else(|| Ok(SceneCache::default()), |folder| scenes(&folder))?;
    if exit_with_parent {
        // A thread of its own: reading standard input cannot be broken off.
        std::thread::spawn(|| {
            let _ = std::io::copy(&mut std::io::stdin().lock().take(u64::MAX), &mut std::io::sink());
            // A worker keeps nothing that matters.
            std::process::exit(0);
        });
    }
    let config = WorkerConfig { threads, isa, name, host: host(), cpu: cpu(), drain: DRAIN };
    let time_is_up = async {
        match lifetime {
            Some(lifetime) => tokio::time::sleep(lifetime.saturating_sub(DRAIN)).await,
            None => std::future::pending().await,
        }
    };
    let end = async {
        tokio::select! {
            () = stop.cancelled() => {}
            () = time_is_up => {}
        }
    };
    tilecast_worker::run(connector, config, Arc::new(scenes), end).await?;
    Ok(())
}

fn scenes(folder: &Path) -> anyhow::Result<SceneCache> {
    let shelf = Shelf::open(folder).with_context(|| format!("--scene-cache {}: cannot be made", folder.display()))?;
    Ok(SceneCache::with_shelf(shelf))
}

/// This machine's name, for people; empty where it cannot be had.
pub fn host() -> String {
    let from_system = std::fs::read_to_string("/proc/sys/kernel/hostname").ok();
    let from_environment = || std::env::var("HOSTNAME").or_else(|_| std::env::var("COMPUTERNAME")).ok();
    let name = from_system.or_else(from_environment).unwrap_or_default();
    name.trim().chars().take(NAME_BYTES_MAX / 4).collect()
}

/// This machine's processor, likewise.
pub fn cpu() -> String {
    let facts = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = facts.lines().find_map(|line| line.strip_prefix("model name")?.split_once(':'));
    let name = model.map_or(std::env::consts::ARCH, |(_, name)| name.trim());
    name.chars().take(NAME_BYTES_MAX / 4).collect()
}
