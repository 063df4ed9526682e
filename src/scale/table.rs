//! What scaling came to: as Markdown, CSV, JSON and a plot.

use anyhow::Context;
use serde::Serialize;
use std::path::{Path, PathBuf};
use tilecast_coordinator::scaling::Simulated;
use tilecast_measure::plot::{Curve, Labels, log_log};

/// See the module.
pub struct Sheet {
    /// What was rendered.
    pub title: String,
    /// Of every image.
    pub digest: String,
    /// Renders a row, of which medians are told.
    pub repeats: u32,
    /// Megabytes a second of the coordinator's line beyond what was measured.
    pub line: f64,
    /// Measured, from few workers to many.
    pub rows: Vec<Row>,
    /// Simulated.
    pub beyond: Vec<Beyond>,
}

/// A number of workers that was measured.
pub struct Row {
    /// Threads of all workers.
    pub workers: u32,
    /// From submission to end.
    pub seconds: f64,
    /// Shares of all threads' time: tracing, before the first unit, after the last one.
    pub tracing: f64,
    /// See `tracing`.
    pub start: f64,
    /// See `tracing`.
    pub tail: f64,
    /// Seconds of the coordinator.
    pub merging: f64,
    /// Units.
    pub units: f64,
    /// Seconds that the simulation says.
    pub simulated: Option<f64>,
}

/// A number of workers that was simulated.
pub struct Beyond {
    /// Threads of all workers.
    pub workers: u32,
    /// How it went.
    pub simulated: Simulated,
}

/// A row of CSV and JSON.
#[derive(Serialize)]
struct Line {
    workers: u32,
    measured: bool,
    seconds: f64,
    speedup: f64,
    efficiency: f64,
    tracing: f64,
    start: f64,
    waiting: f64,
    tail: f64,
    merging_seconds: Option<f64>,
    merge_share: Option<f64>,
    line_share: Option<f64>,
    units: f64,
    simulated_seconds: Option<f64>,
}

#[derive(Serialize)]
struct Whole<'a> {
    title: &'a str,
    digest: &'a str,
    repeats: u32,
    serial_share: Option<f64>,
    saturates_first: Option<String>,
    rows: Vec<Line>,
}

impl Sheet {
    /// Writes PREFIX.csv, .json, .md and .svg.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn write(&self, prefix: &Path) -> anyhow::Result<()> {
        let path = |extension: &str| -> PathBuf { prefix.with_extension(extension) };
        let put = |path: &Path, text: String| {
            std::fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))
        };
        put(&path("csv"), self.csv())?;
        let whole = Whole {
            title: &self.title,
            digest: &self.digest,
            repeats: self.repeats,
            serial_share: self.serial_share(),
            saturates_first: self.saturated(),
            rows: self.lines(),
        };
        put(&path("json"), serde_json::to_string_pretty(&whole)? + "\n")?;
        put(&path("md"), self.markdown() + "\n")?;
        log_log(&path("svg"), Labels { title: &self.title, x: "threads", y: "speedup" }, &self.curves())
    }

    /// All for people.
    pub fn markdown(&self) -> String {
        let mut out = vec![
            format!("{}; medians of {} renders each, interleaved; every digest {}.", self.title, self.repeats, self.digest),
            String::new(),
            "| threads | seconds | speedup | efficiency | tracing | start | waiting | tail | merging, s | simulated, s |".into(),
            "|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|".into(),
        ];
        let percent = |share: f64| format!("{:.1} %", 100.0 * share);
        for line in self.lines() {
            out.push(format!(
                "| {}{} | {:.2} | {:.2} | {:.3} | {} | {} | {} | {} | {} | {} |",
                line.workers,
                if line.measured { "" } else { " (simulated)" },
                line.seconds,
                line.speedup,
                line.efficiency,
                percent(line.tracing),
                percent(line.start),
                percent(line.waiting),
                percent(line.tail),
                line.merging_seconds.map_or_else(String::new, |s| format!("{s:.2}")),
                line.simulated_seconds.map_or_else(String::new, |s| format!("{s:.2}")),
            ));
        }
        if let Some(share) = self.serial_share() {
            out.push(format!(
                "\nAmdahl's law fits the measured times best with a serial share of {:.2} %.",
                100.0 * share
            ));
        }
        if let Some(first) = self.saturated() {
            out.push(format!("\n{first}"));
        }
        out.join("\n")
    }

    fn csv(&self) -> String {
        let mut out = String::from(
            "threads,measured,seconds,speedup,efficiency,tracing,start,waiting,tail,merging_seconds,merge_share,line_share,\
             units,simulated_seconds\n",
        );
        let maybe = |value: Option<f64>| value.map_or_else(String::new, |value| value.to_string());
        for line in self.lines() {
            let Line { workers, measured, seconds, speedup, efficiency, tracing, start, waiting, tail, units, .. } =
                line;
            let [merging, merge, full, simulated] =
                [line.merging_seconds, line.merge_share, line.line_share, line.simulated_seconds].map(maybe);
            out += &format!(
                "{workers},{measured},{seconds},{speedup},{efficiency},{tracing},{start},{waiting},{tail},{merging},{merge},\
                 {full},{units},{simulated}\n"
            );
        }
        out
    }

    fn lines(&self) -> Vec<Line> {
        // Speedups are relative to one thread, or to as few as were measured.
        let base = self.rows.first().map_or(0.0, |row| row.seconds * f64::from(row.workers));
        let measured = self.rows.iter().map(|row| Line {
            workers: row.workers,
            measured: true,
            seconds: row.seconds,
            speedup: base / row.seconds,
            efficiency: base / row.seconds / f64::from(row.workers),
            tracing: row.tracing,
            start: row.start,
            waiting: (1.0 - row.tracing - row.start - row.tail).max(0.0),
            tail: row.tail,
            merging_seconds: Some(row.merging),
            merge_share: None,
            line_share: None,
            units: row.units,
            simulated_seconds: row.simulated,
        });
        let beyond = self.beyond.iter().map(|Beyond { workers, simulated }| {
            let total = simulated.seconds * f64::from(*workers);
            Line {
                workers: *workers,
                measured: false,
                seconds: simulated.seconds,
                speedup: base / simulated.seconds,
                efficiency: base / total,
                tracing: simulated.tracing / total,
                start: 0.0,
                waiting: simulated.waiting / total,
                tail: simulated.tail / total,
                merging_seconds: None,
                merge_share: Some(simulated.merge_share),
                line_share: Some(simulated.line_share),
                units: simulated.units as f64,
                simulated_seconds: None,
            }
        });
        measured.chain(beyond).collect()
    }

    /// The s of T(n) = T(1) · (s + (1 − s)/n) that fits the measured times best, by least squares of T(n)·n; `None` for one
    /// number of workers.
    fn serial_share(&self) -> Option<f64> {
        let base = self.rows.first().map(|row| row.seconds * f64::from(row.workers))?;
        let points = self.rows.iter().map(|row| {
            let n = f64::from(row.workers);
            // n T(n)/T(1) − 1 = s (n − 1).
            (n - 1.0, n * row.seconds / base - 1.0)
        });
        let (xy, xx) = points.fold((0.0, 0.0), |(xy, xx), (x, y)| (xy + x * y, xx + x * x));
        (xx > 0.0 && self.rows.len() > 1).then(|| (xy / xx).clamp(0.0, 1.0))
    }

    /// What keeps more workers from helping, where they first have less than half of their time to trace.
    fn saturated(&self) -> Option<String> {
        let last = self.beyond.last()?;
        let half = |b: &&Beyond| b.simulated.tracing < 0.5 * b.simulated.seconds * f64::from(b.workers);
        let Some(Beyond { workers, simulated }) = self.beyond.iter().find(half) else {
            return Some(format!("Nothing is saturated up to {} threads.", last.workers));
        };
        let (merge, line) = (simulated.merge_share, simulated.line_share);
        let what = if merge > 0.8 && merge >= line {
            "the coordinator's merging"
        } else if line > 0.8 {
            "the coordinator's line"
        } else {
            "the job itself: its units are too few and too short to go round (its tail)"
        };
        Some(format!(
            "From {workers} threads on, less than half of the time is spent tracing; what is saturated first is {what} \
             (merging {:.0} %, line of {} MB/s {:.0} % of the time).",
            100.0 * merge,
            self.line,
            100.0 * line
        ))
    }

    fn curves(&self) -> Vec<Curve> {
        let lines = self.lines();
        let of = |measured: bool| {
            lines
                .iter()
                .filter(move |line| line.measured == measured)
                .map(|line| (f64::from(line.workers), line.speedup))
        };
        let most = lines.iter().map(|line| f64::from(line.workers)).fold(1.0, f64::max);
        let mut curves = vec![
            Curve { name: "measured".into(), points: of(true).collect() },
            Curve { name: "ideal".into(), points: vec![(1.0, 1.0), (most, most)] },
        ];
        if !self.beyond.is_empty() {
            let joint = of(true).next_back();
            curves.push(Curve { name: "simulated".into(), points: joint.into_iter().chain(of(false)).collect() });
        }
        curves
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(workers: u32, seconds: f64) -> Row {
        Row { workers, seconds, tracing: 0.9, start: 0.0, tail: 0.05, merging: 0.1, units: 10.0, simulated: None }
    }

    #[test]
    fn the_serial_share_is_found_again() {
        let times = |n: u32| 10.0 * (0.1 + 0.9 / f64::from(n));
        let rows = [1, 2, 4, 8].map(|n| row(n, times(n)));
        let sheet = Sheet {
            title: String::new(),
            digest: String::new(),
            repeats: 1,
            line: 125.0,
            rows: rows.into(),
            beyond: Vec::new(),
        };
        assert!((sheet.serial_share().unwrap() - 0.1).abs() < 1e-9);
        let lines = sheet.lines();
        assert!((lines[1].speedup - 1.0 / 0.55).abs() < 1e-9 && (lines[0].efficiency - 1.0).abs() < 1e-12);
        assert_eq!(sheet.csv().lines().count(), 5);
    }
}
