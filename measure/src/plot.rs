//! Log-log plots as SVG or PNG, and the slopes of their curves.

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

/// The letters of PNG files, and the width of those in SVG files: machines without a desktop have no fonts.
const FONT: &[u8] = include_bytes!("../fonts/DejaVuSans-ascii.ttf");
const FONT_NAME: &str = "sans-serif";
/// Pixels of a plot.
const SIZE: (u32, u32) = (800, 560);

/// What stands beside a plot.
#[derive(Clone, Copy, Debug)]
pub struct Labels<'a> {
    /// Above it.
    pub title: &'a str,
    /// Below it.
    pub x: &'a str,
    /// At its left.
    pub y: &'a str,
}

/// Draws curves with logarithmic axes into a file: PNG if its name says so, else SVG.
///
/// # Errors
/// No points, or a file that cannot be written.
pub fn log_log(path: &Path, labels: Labels, curves: &[Curve]) -> anyhow::Result<()> {
    let failed = |error: &dyn std::fmt::Display| anyhow!("cannot draw {}: {error}", path.display());
    // Registering the same font again changes nothing.
    let registered = plotters::style::register_font(FONT_NAME, FontStyle::Normal, FONT);
    registered.map_err(|_| failed(&"its font is broken"))?;
    if path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("png")) {
        let mut pixels = vec![0; 3 * SIZE.0 as usize * SIZE.1 as usize];
        draw(&BitMapBackend::with_buffer(&mut pixels, SIZE).into_drawing_area(), labels, curves)
            .map_err(|e| failed(&e))?;
        image::save_buffer(path, &pixels, SIZE.0, SIZE.1, image::ExtendedColorType::Rgb8).map_err(|e| failed(&e))
    } else {
        draw(&SVGBackend::new(path, SIZE).into_drawing_area(), labels, curves).map_err(|e| failed(&e))
    }
}

fn draw<B: DrawingBackend<ErrorType: 'static>>(
    area: &DrawingArea<B, plotters::coord::Shift>,
    labels: Labels,
    curves: &[Curve],
) -> anyhow::Result<()> {
    let points = || curves.iter().flat_map(|c| &c.points);
    let range = |of: fn(&(f64, f64)) -> f64, margin: f64| {
        let low = points().map(of).fold(f64::INFINITY, f64::min);
        let high = points().map(of).fold(0.0, f64::max);
        (low < f64::INFINITY).then_some((low / margin)..(high * margin)).context("nothing to plot")
    };
    let (x_range, y_range) = (range(|p| p.0, 1.1)?, range(|p| p.1, 1.5)?);
    area.fill(&WHITE)?;
    let mut chart = ChartBuilder::on(area)
        .caption(labels.title, (FONT_NAME, 18))
        .margin(12)
        .x_label_area_size(42)
        .y_label_area_size(72)
        .build_cartesian_2d(x_range.log_scale(), y_range.log_scale())?;
    chart
        .configure_mesh()
        .x_desc(labels.x)
        .y_desc(labels.y)
        .x_label_formatter(&|x| format!("{x:.6}").trim_end_matches('0').trim_end_matches('.').to_owned())
        .y_label_formatter(&|y| format!("{y:.0e}"))
        .light_line_style(TRANSPARENT)
        .draw()?;
    for (curve, colour) in curves.iter().zip(COLOURS.iter().cycle()) {
        let label = match curve.points.len() {
            0 | 1 => curve.name.clone(),
            _ => format!("{}: slope {:.2}", curve.name, curve.slope()),
        };
        chart
            .draw_series(LineSeries::new(curve.points.iter().copied(), colour.stroke_width(2)).point_size(3))?
            .label(label)
            .legend(|(x, y)| PathElement::new([(x, y), (x + 18, y)], colour.stroke_width(2)));
    }
    // Where rising and where falling curves leave room.
    let rises = curves.iter().any(|curve| curve.slope() > 0.0);
    chart
        .configure_series_labels()
        .position(if rises { SeriesLabelPosition::UpperLeft } else { SeriesLabelPosition::UpperRight })
        .background_style(WHITE.mix(0.8))
        .border_style(BLACK.mix(0.3))
        .draw()?;
    Ok(area.present()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slopes_are_exponents_and_both_kinds_of_file_are_drawn() {
        let points = (0..6).map(|i| (f64::from(1 << i), 3.0 / f64::from(1 << i))).collect();
        let curves = [Curve { name: "1/x".into(), points }];
        assert!((curves[0].slope() + 1.0).abs() < 1e-12);
        let folder = tempfile::tempdir().unwrap();
        let labels = Labels { title: "a title", x: "x", y: "y" };
        for (name, magic) in [("a.svg", b"<svg".as_slice()), ("a.png", b"\x89PNG")] {
            let path = folder.path().join(name);
            log_log(&path, labels, &curves).unwrap();
            assert!(std::fs::read(&path).unwrap().starts_with(magic), "{name}");
        }
        assert!(log_log(&folder.path().join("b.svg"), labels, &[]).is_err());
    }
}
