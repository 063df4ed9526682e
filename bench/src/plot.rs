//! Log-log plots as SVG, and the slopes of their curves.

use anyhow::{Context, anyhow};
use plotters::prelude::*;
use std::path::Path;

/// One curve: a name and its points (x, y), all positive.
pub struct Curve {
    /// For the legend.
    pub name: String,
    /// In the order of x.
    pub points: Vec<(f64, f64)>,
}

impl Curve {
    /// The slope of the straight line through log y over log x by least squares.
    pub fn slope(&self) -> f64 {
        let logs: Vec<(f64, f64)> = self.points.iter().map(|&(x, y)| (x.ln(), y.ln())).collect();
        let n = logs.len() as f64;
        let (mx, my) = (logs.iter().map(|p| p.0).sum::<f64>() / n, logs.iter().map(|p| p.1).sum::<f64>() / n);
        let (sxy, sxx) =
            logs.iter().fold((0.0, 0.0), |(a, b), p| (a + (p.0 - mx) * (p.1 - my), b + (p.0 - mx).powi(2)));
        sxy / sxx
    }
}

/// Curves that stay apart in print and for the colour-blind (Okabe & Ito 2008).
const COLOURS: [RGBColor; 6] = [
    RGBColor(213, 94, 0),
    RGBColor(0, 114, 178),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(0, 0, 0),
];

/// Draws curves with logarithmic axes into an SVG file.
///
/// # Errors
/// No points, or a file that cannot be written.
pub fn log_log(path: &Path, title: &str, x_label: &str, y_label: &str, curves: &[Curve]) -> anyhow::Result<()> {
    let points = || curves.iter().flat_map(|c| &c.points);
    let range = |of: fn(&(f64, f64)) -> f64, margin: f64| {
        let low = points().map(of).fold(f64::INFINITY, f64::min);
        let high = points().map(of).fold(0.0, f64::max);
        (low < f64::INFINITY).then_some((low / margin)..(high * margin)).context("nothing to plot")
    };
    let (x_range, y_range) = (range(|p| p.0, 1.1)?, range(|p| p.1, 1.5)?);
    let area = SVGBackend::new(path, (800, 560)).into_drawing_area();
    let plot = || -> Result<(), DrawingAreaErrorKind<std::io::Error>> {
        area.fill(&WHITE)?;
        let mut chart = ChartBuilder::on(&area)
            .caption(title, ("sans-serif", 18))
            .margin(12)
            .x_label_area_size(42)
            .y_label_area_size(72)
            .build_cartesian_2d(x_range.log_scale(), y_range.log_scale())?;
        chart
            .configure_mesh()
            .x_desc(x_label)
            .y_desc(y_label)
            .y_label_formatter(&|y| format!("{y:.0e}"))
            .light_line_style(TRANSPARENT)
            .draw()?;
        for (curve, colour) in curves.iter().zip(COLOURS.iter().cycle()) {
            let label = format!("{}: slope {:.2}", curve.name, curve.slope());
            chart
                .draw_series(LineSeries::new(curve.points.iter().copied(), colour.stroke_width(2)).point_size(3))?
                .label(label)
                .legend(|(x, y)| PathElement::new([(x, y), (x + 18, y)], colour.stroke_width(2)));
        }
        chart.configure_series_labels().background_style(WHITE.mix(0.8)).border_style(BLACK.mix(0.3)).draw()?;
        area.present()
    };
    plot().map_err(|e| anyhow!("cannot draw {}: {e}", path.display()))
}
