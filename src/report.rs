//! What a render says while it goes on: a bar, lines, JSON, or nothing. People's text goes to stderr, JSON to stdout.

use crate::kept::Kept;
use crate::picture::Ready;
use crate::seek::Goal;
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;
use serde_json::Value;
use std::io::Write;
use std::path::Path;
use std::time::{Duration, Instant};
use tilecast_core::film::RelativeError;
use tilecast_core::film::file::Target;
use tilecast_core::settings::Settings;
use tilecast_proto::types::Progress;

/// How to say it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Style {
    /// A bar that moves, for a terminal.
    Bar,
    /// Lines now and then, for a log.
    Lines,
    /// One JSON object a line, for programs.
    Json,
    /// Nothing.
    Quiet,
}

/// Lines come when a tenth more is done, but not before this.
const LINE_PAUSE_MIN: Duration = Duration::from_secs(1);
/// And at the latest after this.
const LINE_PAUSE_MAX: Duration = Duration::from_secs(60);
/// JSON progress is for programs that show it: once a second is enough for that.
const JSON_PAUSE: Duration = Duration::from_secs(1);
/// Steps of the bar.
const BAR_STEPS: u64 = 10_000;

/// What is told, as JSON has it.
#[derive(Serialize)]
#[serde(tag = "event", rename_all = "snake_case")]
enum Event<'a> {
    Listening {
        address: &'a str,
    },
    Viewing {
        url: &'a str,
    },
    Note {
        text: &'a str,
    },
    Substituted {
        text: &'a str,
    },
    Warning {
        text: &'a str,
    },
    Started {
        scene: &'a str,
        width: u32,
        height: u32,
        /// Absent if an error or a time decides.
        spp: Option<u32>,
        target_error: Option<f32>,
        target_pixel_error: Option<f32>,
        seconds_target: Option<f64>,
        samples: Option<[u32; 2]>,
        seed: u64,
        settings: &'a Settings,
        output: &'a str,
    },
    Progress {
        samples_done: u64,
        samples_total: u64,
        samples_per_second: f64,
        seconds_left: Option<f64>,
        workers: u32,
        #[serde(flatten)]
        error: ErrorFields,
    },
    Finished {
        digest: &'a str,
        /// A whole number where all pixels have as many.
        spp: Value,
        samples: &'a str,
        /// For this image, over all pixels: those of a pilot and of an interrupted run too, those of a film it went on with not.
        samples_traced: u64,
        seconds: f64,
        samples_per_second: f64,
        #[serde(flatten)]
        error: ErrorFields,
        output: &'a str,
    },
}

/// The estimated relative error, and its 95 % confidence interval.
#[derive(Serialize)]
pub struct ErrorFields {
    relative_error: Option<f32>,
    relative_error_low: Option<f32>,
    relative_error_high: Option<f32>,
}

impl From<Option<RelativeError>> for ErrorFields {
    fn from(error: Option<RelativeError>) -> Self {
        Self {
            relative_error: error.map(|e| e.value),
            relative_error_low: error.map(|e| e.low),
            relative_error_high: error.map(|e| e.high),
        }
    }
}

/// A relative error as people read it, with its 95 % confidence interval.
pub fn percent(RelativeError { value, low, high }: &RelativeError) -> String {
    format!("{:.2} % ({:.2} to {:.2})", 100.0 * value, 100.0 * low, 100.0 * high)
}

/// Tells what happens.
pub struct Report {
    style: Style,
    bar: ProgressBar,
    /// When progress was told last, and which fraction it was.
    told: (Instant, f64),
    /// Samples that earlier jobs of the same image have made, and how many it will take in all.
    expected: (u64, Option<u64>),
}

impl Report {
    /// Nothing told yet.
    pub fn new(style: Style) -> Self {
        Self { style, bar: ProgressBar::hidden(), told: (Instant::now(), 0.0), expected: (0, None) }
    }

    /// The page is served.
    pub fn viewing(&mut self, url: &str) {
        match self.style {
            Style::Json => print(&Event::Viewing { url }),
            Style::Quiet => {}
            Style::Bar | Style::Lines => eprintln!("to look on: {url}"),
        }
    }

    /// A coordinator serves.
    pub fn listening(&mut self, address: &str) {
        match self.style {
            Style::Json => print(&Event::Listening { address }),
            Style::Quiet => {}
            Style::Bar | Style::Lines => {
                eprintln!("listening on {address}; start workers with: tilecast worker --connect {}", reached(address));
            }
        }
    }

    /// Something the scene's author should know.
    pub fn note(&mut self, text: &str) {
        self.say(&Event::Note { text }, || format!("note: {text}"));
    }

    /// Something of the scene was replaced or left out.
    pub fn substituted(&mut self, text: &str) {
        self.say(&Event::Substituted { text }, || format!("substituted: {text}"));
    }

    /// Something went wrong that does not end the render.
    pub fn warning(&mut self, text: &str) {
        self.say(&Event::Warning { text }, || format!("warning: {text}"));
    }

    /// Rendering begins.
    pub fn started(&mut self, ready: &Ready, goal: Goal, output: &Path) {
        let Ready { settings, samples, .. } = ready;
        let Settings { film, spp, seed, .. } = settings;
        let counted = goal == Goal::Samples;
        let (width, height) = (film.crop.width(), film.crop.height());
        let (scene, output) = (ready.blobs.digest.to_string(), output.display().to_string());
        let event = Event::Started {
            scene: &scene,
            width,
            height,
            spp: counted.then_some(*spp),
            target_error: if let Goal::Error(Target::Image(error)) = goal { Some(error) } else { None },
            target_pixel_error: if let Goal::Error(Target::Pixels(error)) = goal { Some(error) } else { None },
            seconds_target: if let Goal::Time(time) = goal { Some(time.as_secs_f64()) } else { None },
            samples: counted.then_some([samples.start, samples.end]),
            seed: *seed,
            settings,
            output: &output,
        };
        self.say(&event, || {
            let until = match (goal, samples.start) {
                (Goal::Samples, 0) => format!("{spp} samples each"),
                (Goal::Samples, start) => format!("samples {start} to {} each", samples.end),
                (Goal::Error(Target::Image(error)), _) => format!("to a relative error of {} %", 100.0 * error),
                (Goal::Error(Target::Pixels(error)), _) => {
                    format!("until 95 % of them are known to {} %", 100.0 * error)
                }
                (Goal::Time(time), _) => format!("for {}", duration(time.as_secs_f64())),
            };
            format!("rendering {width}x{height} pixels, {until}")
        });
        if self.style == Style::Bar {
            let style = ProgressStyle::with_template("{bar:40} {msg}").unwrap_or_else(|_| ProgressStyle::default_bar());
            self.bar = ProgressBar::new(BAR_STEPS).with_style(style);
        }
    }

    /// Another job for the same image begins; `before` samples are done, `total` are expected in the end.
    pub fn expect(&mut self, before: f64, total: Option<f64>) {
        self.expected = (before as u64, total.map(|total| total as u64));
    }

    /// Some more is done.
    pub fn progress(&mut self, progress: &Progress) {
        let &Progress { workers, relative_error, samples_per_second, .. } = progress;
        let rate = if samples_per_second > 0.0 { samples_per_second } else { mean_rate(progress) };
        let (before, expected) = self.expected;
        let samples_done = before + progress.samples_done;
        let samples_total = expected.unwrap_or(0).max(before + progress.samples_total);
        let fraction = samples_done as f64 / samples_total as f64;
        let left = (rate > 0.0).then(|| (samples_total - samples_done.min(samples_total)) as f64 / rate);
        let (pause, step) = (self.told.0.elapsed(), fraction - self.told.1);
        let due = match self.style {
            Style::Quiet => false,
            Style::Bar => true,
            Style::Json => pause >= JSON_PAUSE,
            Style::Lines => pause >= LINE_PAUSE_MAX || (pause >= LINE_PAUSE_MIN && step >= 0.1),
        };
        if !due {
            return;
        }
        self.told = (Instant::now(), fraction);
        match self.style {
            Style::Json => print(&Event::Progress {
                samples_done,
                samples_total,
                samples_per_second: rate,
                seconds_left: left,
                workers,
                error: relative_error.into(),
            }),
            Style::Bar => {
                self.bar.set_position((fraction * BAR_STEPS as f64) as u64);
                self.bar.set_message(line(fraction, rate, left, relative_error));
            }
            _ => eprintln!("{}", line(fraction, rate, left, relative_error)),
        }
    }

    /// The image is written, after `elapsed`; `progress` is that of what was rendered for it, if anything was.
    pub fn written(&mut self, kept: &Kept, elapsed: Duration, progress: Option<&Progress>, output: &Path) {
        self.bar.finish_and_clear();
        let (digest, output, samples) = (kept.film.digest().to_string(), output.display().to_string(), kept.shown());
        let (spp, seconds, rate) = (kept.spp(), elapsed.as_secs_f64(), progress.map_or(0.0, mean_rate));
        let relative_error = kept.film.relative_error(u64::MAX);
        let event = Event::Finished {
            digest: &digest,
            spp: if spp.fract() == 0.0 { Value::from(spp as u64) } else { Value::from(spp) },
            samples: &samples,
            samples_traced: self.expected.0 + progress.map_or(0, |progress| progress.samples_done),
            seconds,
            samples_per_second: rate,
            error: relative_error.into(),
            output: &output,
        };
        self.say(&event, || {
            let error = relative_error.map_or_else(String::new, |e| format!(", relative error {}", percent(&e)));
            let rate = if rate > 0.0 { format!(" ({:.2} Msamples/s)", rate / 1e6) } else { String::new() };
            format!("wrote {output}: {spp} samples a pixel in {seconds:.1} s{rate}{error}\ndigest {digest}")
        });
    }

    fn say(&self, event: &Event, text: impl FnOnce() -> String) {
        match self.style {
            Style::Quiet => {}
            Style::Json => print(event),
            Style::Bar | Style::Lines => self.bar.suspend(|| eprintln!("{}", text())),
        }
    }
}

/// Samples a second since the first unit was given out.
fn mean_rate(progress: &Progress) -> f64 {
    let seconds = progress.running.as_secs_f64();
    if seconds > 0.0 { (progress.samples_done - progress.samples_found) as f64 / seconds } else { 0.0 }
}

fn line(fraction: f64, rate: f64, left: Option<f64>, error: Option<RelativeError>) -> String {
    let left = left.map_or_else(String::new, |s| format!(", {} left", duration(s)));
    let error = error.map_or_else(String::new, |e| format!(", relative error {}", percent(&e)));
    format!("{:3.0} %, {:.2} Msamples/s{left}{error}", 100.0 * fraction, rate / 1e6)
}

/// Seconds as people say them.
fn duration(seconds: f64) -> String {
    match Duration::try_from_secs_f64(seconds.ceil()).unwrap_or(Duration::MAX).as_secs() {
        s @ 0..60 => format!("{s} s"),
        s @ 60..3600 => format!("{} min {} s", s / 60, s % 60),
        s => format!("{} h {} min", s / 3600, s / 60 % 60),
    }
}

/// One JSON object as a line. Who no longer reads does not hear the rest; the image is written all the same.
pub fn print(event: &impl Serialize) {
    if let Ok(text) = serde_json::to_string(event) {
        let _ = writeln!(std::io::stdout().lock(), "{text}");
    }
}

/// How workers reach an address that is listened on.
fn reached(address: &str) -> String {
    match address.strip_prefix("0.0.0.0:").or_else(|| address.strip_prefix("[::]:")) {
        // All addresses of this machine: none of them is known to be the right one.
        Some(port) => format!("HOST:{port} --certs DIR, where HOST is this machine as they see it"),
        None => address.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn durations_read_well() {
        assert_eq!([0.2, 59.0, 61.0, 7260.5].map(duration), ["1 s", "59 s", "1 min 1 s", "2 h 1 min"]);
    }
}
