//! `tilecast submit`: sends a scene to a coordinator, waits for the image, and writes it here.

use crate::follow::{Line, follow};
use crate::output::Output;
use crate::picture::Picture;
use crate::report::{Report, Style};
use crate::seek::Goal;
use crate::stop::{on_signal, unless_stopped};
use anyhow::Context;
use std::sync::Arc;
use tilecast_proto::client::Client;
use tilecast_proto::limits::NAME_BYTES_MAX;
use tilecast_proto::transport::Connector;
use tilecast_proto::types::JobSpec;

/// What to render, where, and where to.
pub struct Submit {
    /// What.
    pub picture: Picture,
    /// When it is done.
    pub goal: Goal,
    /// Where.
    pub connector: Connector,
    /// Where to.
    pub output: Output,
    /// Side of a tile in pixels, or the coordinator's choice.
    pub tile: Option<u32>,
    /// How it tells of itself.
    pub style: Style,
}

/// Submits, waits, writes.
///
/// # Errors
/// Whatever keeps the image from being made or written.
pub async fn run(submit: Submit) -> anyhow::Result<()> {
    let stop = on_signal()?;
    let mut report = Report::new(submit.style);
    // Before loading: a scene may be large, and a wrong address is found at once.
    let client = unless_stopped(&stop, Client::connect(&submit.connector)).await??;
    let (picture, name) = (submit.picture.clone(), name(&submit.picture));
    let load = tokio::task::spawn_blocking(move || picture.load());
    let (scene, ready) = unless_stopped(&stop, load).await?.context("loading panicked")??;
    ready.tell(&mut report);
    unless_stopped(&stop, client.upload(&Arc::new(scene), &ready.blobs)).await??;
    let (scene, settings) = (ready.blobs.digest, ready.settings.clone());
    let samples = vec![ready.samples.clone()];
    let job = JobSpec { tile: submit.tile, samples, name, ..JobSpec::new(scene, settings) };
    let line = Line::new(&client, &ready, &submit.output, &stop, async || std::future::pending().await);
    follow(line, submit.goal, job, &mut report).await.map(|_| ())
}

/// The scene's file name, as far as a job's name may be long.
fn name(picture: &Picture) -> String {
    let mut name = picture.scene.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
    while name.len() > NAME_BYTES_MAX {
        name.pop();
    }
    name
}
