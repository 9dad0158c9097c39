//! The page of a sensor: how it errs, with pictures of each scan.

use crate::{
    cell::Cell,
    chart::{Axis, Chart, Mark, Series},
    html::Page,
};
use osteoflow_algorithms::{
    sensor_error::{ScanErrors, SensorErrors, TableRow},
    trust::Residual,
};

/// Number of points of a picture.
const N_SHOWN: usize = 600;
/// Number of bars of a histogram.
const N_BARS: usize = 40;

/// The page of a sensor's errors by its scans, with the keys of the profile and what is known of each, and the head of the profile.
pub fn of_sensor(
    errors: &SensorErrors,
    scans: &[(&str, &ScanErrors)],
    keys: &[(&'static str, String, String)],
    head: &[String],
) -> String {
    let mut page = Page::new("How a sensor errs", false);
    page.section("Values");
    head.iter().for_each(|line| page.text(line));
    let rows: Vec<Vec<Cell>> =
        keys.iter().map(|(key, value, about)| vec![Cell::word(*key), Cell::word(value), Cell::word(about)]).collect();
    page.table("Keys of the profile, mm, with 90 % intervals.", &["key", "value", "measured"], &rows);
    for (name, unit, of) in [("distance", "mm", &errors.by_distance), ("tilt", "deg", &errors.by_tilt)] {
        if of.is_empty() {
            page.missing(&format!("The noise against the {name}"), "it is unknown where the sensor stood");
            continue;
        }
        let at = |row: &TableRow| ((row.from + row.to) / 2.0, row.noise_mm);
        let dots = of.iter().map(|row| (at(row).0, row.noise_mm, format!("{} places", row.n))).collect();
        let marks =
            vec![Mark::Line(of.iter().map(at).collect()), Mark::Dots(dots), Mark::Reach(vec![(of[0].from, 0.0)])];
        let svg = chart(
            &format!("Noise against {name}"),
            [&format!("{name} ({unit})"), "noise (mm)"],
            vec![Series::unnamed(0, marks)],
        );
        page.figure(name, svg, &format!("Noise of single points against the {name}, medians of classes."));
    }
    page.section("Scans");
    for (name, scan) in scans {
        let mut sizes: Vec<f64> = scan.on.iter().map(|at| at.signed_mm.abs()).collect();
        let reach_mm = osteoflow_statistics::quantile(&mut sizes, 0.98).max(1e-6);
        let span = |k: usize| {
            scan.on.iter().fold((f64::MAX, f64::MIN), |(low, high), at| (at.point[k].min(low), at.point[k].max(high)))
        };
        let mut axes = [0, 1, 2];
        axes.sort_by(|a, b| (span(*b).1 - span(*b).0).total_cmp(&(span(*a).1 - span(*a).0)));
        let dot = |at: &Residual| (at.point[axes[0]], at.point[axes[1]], format!("{:.2} mm", at.signed_mm));
        let class = |name: &str, colour, low: f64, high: f64| {
            let is_in = |at: &&Residual| at.signed_mm >= low * reach_mm && at.signed_mm < high * reach_mm;
            let every = scan.on.len().div_ceil(N_SHOWN);
            let dots = scan.on.iter().step_by(every).filter(is_in).map(dot).collect();
            Series { name: name.into(), colour, marks: vec![Mark::Dots(dots)] }
        };
        let series = vec![
            class("inside", 0, f64::MIN, -0.4),
            class("slightly inside", 5, -0.4, 0.0),
            class("slightly outside", 4, 0.0, 0.4),
            class("outside", 1, 0.4, f64::MAX),
            Series {
                name: "outliers".into(),
                colour: 6,
                marks: vec![Mark::Dots(scan.off.iter().take(N_SHOWN).map(dot).collect())],
            },
        ];
        let labels = axes.map(|k| format!("{} (mm)", ["x", "y", "z"][k]));
        let svg = chart(name, [&labels[0], &labels[1]], series);
        let middle = 0.4 * reach_mm;
        page.figure(name, svg, &format!("{name}: residuals in the part's frame; slight: within {middle:.2} mm."));
        let mut bars = [0.0; N_BARS];
        let place = |mm: f64| ((mm / reach_mm + 1.0) / 2.0 * N_BARS as f64).clamp(0.0, N_BARS as f64 - 1.0) as usize;
        scan.on.iter().for_each(|at| bars[place(at.signed_mm)] += 1.0);
        let edge = |k: usize| (2.0 * k as f64 / N_BARS as f64 - 1.0) * reach_mm;
        let bars = bars.iter().enumerate().flat_map(|(k, n)| [(edge(k), 0.0, *n), (edge(k + 1), 0.0, *n)]).collect();
        let svg = chart(name, ["residual (mm)", "points"], vec![Series::unnamed(0, vec![Mark::Band(bars)])]);
        page.figure(
            &format!("{name}-histogram"),
            svg,
            &format!("{name}: residuals; the outermost bars hold all beyond."),
        );
    }
    page.finish("Residuals of scans of a known part.").0
}

fn chart(title: &str, [x, y]: [&str; 2], series: Vec<Series>) -> String {
    let (x, y) = (Axis::Linear(x.into()), Axis::Linear(y.into()));
    Chart { title: title.into(), about: title.into(), x, y, series, note: String::new() }.svg(false)
}
