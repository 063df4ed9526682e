//! What was measured, as CSV, JSON, plots and a few sentences.

use super::{OURS, peer};
use serde::Serialize;
use std::fmt::Write;
use std::path::Path;
use tilecast_measure::plot::{Curve, Labels, log_log};

/// Renders of one scene at one sample count.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Its name.
    pub scene: String,
    /// Whose.
    pub renderer: String,
    /// Samples a pixel.
    pub spp: u32,
    /// Median.
    pub seconds: f64,
    /// Mean.
    pub mse: f64,
    /// Mean.
    pub relmse: f64,
}

/// All of them.
#[derive(Default)]
pub struct Table {
    /// In the order of measurement.
    pub rows: Vec<Row>,
}

/// What errors are plotted against.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum X {
    /// Time.
    Seconds,
    /// Samples a pixel.
    Samples,
}

/// The end of a measurement of one scene.
#[derive(Serialize)]
struct Summary {
    scene: String,
    slopes: Vec<Slope>,
    /// Mitsuba's time over ours at the same relMSE, in the middle of the errors that both reach.
    peer_time_at_equal_error: Option<f64>,
}

#[derive(Serialize)]
struct Slope {
    renderer: String,
    /// Exponent of relMSE over samples.
    over_samples: f64,
    /// Exponent of relMSE over seconds.
    over_seconds: f64,
}

impl Row {
    /// For the log.
    pub fn line(&self) -> String {
        let Self { scene, renderer, spp, seconds, mse, relmse } = self;
        format!("{scene}: {renderer} {spp} spp, {seconds:.3} s, MSE {mse:.3e}, relMSE {relmse:.3e}")
    }
}

impl Table {
    /// One line a row.
    pub fn csv(&self) -> String {
        let mut text = String::from("scene,renderer,spp,seconds,mse,relmse\n");
        for Row { scene, renderer, spp, seconds, mse, relmse } in &self.rows {
            // A string takes all.
            let _ = writeln!(text, "{scene},{renderer},{spp},{seconds:.4},{mse:.6e},{relmse:.6e}");
        }
        text
    }

    /// Rows and summaries.
    ///
    /// # Errors
    /// None that is known.
    pub fn json(&self) -> serde_json::Result<String> {
        serde_json::to_string_pretty(&serde_json::json!({ "rows": self.rows, "scenes": self.summaries() }))
    }

    /// A line a scene and curve, for people.
    pub fn summary(&self) -> String {
        let mut text = String::new();
        for Summary { scene, slopes, peer_time_at_equal_error } in self.summaries() {
            for Slope { renderer, over_samples, over_seconds } in slopes {
                let _ = writeln!(
                    text,
                    "{scene}: {renderer}'s relMSE falls as spp^{over_samples:.2}, time^{over_seconds:.2}"
                );
            }
            if let Some(ratio) = peer_time_at_equal_error {
                let _ = writeln!(text, "{scene}: at equal error {} takes {ratio:.2} times as long", peer::NAME);
            }
        }
        text
    }

    /// Draws a scene's curves.
    ///
    /// # Errors
    /// A file that cannot be written, or no error above zero.
    pub fn plot(&self, scene: &str, x: X, path: &Path) -> anyhow::Result<()> {
        let curves: Vec<Curve> = [OURS, peer::NAME].into_iter().filter_map(|r| self.curve(scene, r, x)).collect();
        let (x, title) = match x {
            X::Seconds => ("seconds", format!("{scene}: error against time")),
            X::Samples => ("samples a pixel", format!("{scene}: error against samples")),
        };
        log_log(path, Labels { title: &title, x, y: "relMSE" }, &curves)
    }

    fn summaries(&self) -> Vec<Summary> {
        let mut scenes: Vec<&str> = self.rows.iter().map(|row| row.scene.as_str()).collect();
        scenes.dedup();
        let summary = |scene: &str| {
            let slope = |renderer: &str| {
                let (samples, seconds) =
                    (self.curve(scene, renderer, X::Samples)?, self.curve(scene, renderer, X::Seconds)?);
                (samples.points.len() > 1).then(|| Slope {
                    renderer: renderer.to_owned(),
                    over_samples: samples.slope(),
                    over_seconds: seconds.slope(),
                })
            };
            let ours = self.curve(scene, OURS, X::Seconds);
            let theirs = self.curve(scene, peer::NAME, X::Seconds);
            Summary {
                scene: scene.to_owned(),
                slopes: [OURS, peer::NAME].into_iter().filter_map(slope).collect(),
                peer_time_at_equal_error: ours.zip(theirs).and_then(|(ours, theirs)| time_ratio(&ours, &theirs)),
            }
        };
        scenes.into_iter().map(summary).collect()
    }

    fn curve(&self, scene: &str, renderer: &str, x: X) -> Option<Curve> {
        let rows = self.rows.iter().filter(|row| row.scene == scene && row.renderer == renderer && row.relmse > 0.0);
        let at = |row: &Row| if x == X::Seconds { row.seconds } else { f64::from(row.spp) };
        let points: Vec<(f64, f64)> = rows.map(|row| (at(row), row.relmse)).collect();
        (!points.is_empty()).then(|| Curve { name: renderer.to_owned(), points })
    }
}

/// The second's time over the first's at the middle (of logarithms) of the errors that both have; `None` if there are none.
fn time_ratio(first: &Curve, second: &Curve) -> Option<f64> {
    let range = |curve: &Curve| {
        let errors = || curve.points.iter().map(|p| p.1);
        (errors().fold(f64::INFINITY, f64::min), errors().fold(0.0, f64::max))
    };
    let ((low_a, high_a), (low_b, high_b)) = (range(first), range(second));
    let (low, high) = (low_a.max(low_b), high_a.min(high_b));
    let error = (low < high).then(|| (low * high).sqrt())?;
    Some(time_at(second, error)? / time_at(first, error)?)
}

/// The time at which a curve passes an error, by straight lines between the logarithms of its points.
fn time_at(curve: &Curve, error: f64) -> Option<f64> {
    curve.points.windows(2).find_map(|pair| {
        let [(t0, e0), (t1, e1)] = [pair[0], pair[1]].map(|(t, e)| (t.ln(), e.ln()));
        let s = (error.ln() - e0) / (e1 - e0);
        (0.0..=1.0).contains(&s).then(|| (t0 + s * (t1 - t0)).exp())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_renderer_half_as_fast_takes_twice_as_long() {
        let curve = |speed: f64| Curve {
            name: String::new(),
            points: (0..8).map(|i| (f64::from(1 << i) / speed, 1.0 / f64::from(1 << i))).collect(),
        };
        let ratio = time_ratio(&curve(2.0), &curve(1.0)).expect("errors that both have");
        assert!((ratio - 2.0).abs() < 1e-9, "{ratio}");
        let worse = Curve { name: String::new(), points: vec![(1.0, 9.0), (2.0, 8.0)] };
        assert_eq!(time_ratio(&curve(1.0), &worse), None);
    }
}
