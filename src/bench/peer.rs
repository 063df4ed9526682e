//! Mitsuba 3 as a peer: one Python process that keeps the scene loaded and renders when it is told to.

use anyhow::{Context, bail};
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

/// What its curves are called.
pub const NAME: &str = "mitsuba";
/// Its side of the conversation.
const SCRIPT: &str = include_str!("mitsuba.py");

/// A running Mitsuba; it ends when this is dropped, since its input does.
pub struct Mitsuba {
    process: Child,
    orders: ChildStdin,
    answers: BufReader<ChildStdout>,
}

impl Mitsuba {
    /// Starts it and has it load a scene.
    ///
    /// # Errors
    /// No such Python, no Mitsuba in it, or a scene that it does not take.
    pub fn start(python: &str, scene: &Path) -> anyhow::Result<Self> {
        let mut command = Command::new(python);
        command.arg("-c").arg(SCRIPT).arg(scene).stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut process =
            command.spawn().with_context(|| format!("--peer: {python} cannot be started; name it with --python"))?;
        let (Some(orders), Some(answers)) = (process.stdin.take(), process.stdout.take()) else {
            bail!("--peer: {python} has no input or output");
        };
        let mut mitsuba = Self { process, orders, answers: BufReader::new(answers) };
        mitsuba.answer().context("--peer: Mitsuba did not load the scene (pip install mitsuba)")?;
        Ok(mitsuba)
    }

    /// Renders into `image`; the seconds of rendering alone.
    ///
    /// # Errors
    /// Mitsuba has ended.
    pub fn render(&mut self, spp: u32, seed: u32, image: &Path) -> anyhow::Result<f64> {
        writeln!(self.orders, "{spp} {seed} {}", image.display())?;
        self.orders.flush()?;
        self.answer().context("Mitsuba failed; what it says stands above")
    }

    fn answer(&mut self) -> anyhow::Result<f64> {
        let mut line = String::new();
        self.answers.read_line(&mut line)?;
        line.trim().parse().context("it ended without an answer")
    }
}

impl Drop for Mitsuba {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}
