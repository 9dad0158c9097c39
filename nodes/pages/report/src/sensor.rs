//! The page of a sensor: how it errs, with pictures of each scan.

use crate::{
    chart::{Axis, Chart, Mark, Series},
    html::Page,
};
use osteoflow_algorithms::{
    sensor_error::{ScanErrors, SensorErrors},
    trust::Residual,
};

/// Number of points of a picture, and of bars of a histogram.
const N_SHOWN: usize = 600;
const N_BARS: usize = 40;

/// The page of a sensor's errors by its scans, with the text of its profile.
pub fn of_sensor(errors: &SensorErrors, scans: &[(&str, &ScanErrors)], profile: &str) -> String {
    let mut page = Page::new("How a sensor errs", false);
    page.section("Profile");
    page.code(profile);
    for (name, of) in [("distance (mm)", &errors.by_distance), ("tilt (deg)", &errors.by_tilt)] {
        let at: Vec<(f64, f64)> = of.iter().map(|[from, to, mm]| ((from + to) / 2.0, *mm)).collect();
        if at.is_empty() {
            page.missing(&format!("The noise against {name}"), "where the sensor stood is unknown");
            continue;
        }
        let dots = at.iter().map(|(x, mm)| (*x, *mm, format!("{mm:.3} mm"))).collect();
        let marks = vec![Mark::Line(at), Mark::Dots(dots), Mark::Reach(vec![(of[0][0], 0.0)])];
        draw(&mut page, &format!("noise against {name}"), [name, "noise (mm)"], vec![Series::unnamed(0, marks)]);
    }
    page.section("Scans");
    for (name, scan) in scans {
        let on = || scan.residuals.iter().filter(|(_, is_off)| !is_off).map(|(at, _)| at);
        let span = |k: usize| on().fold((f64::MAX, f64::MIN), |(a, b), at| (a.min(at.point[k]), b.max(at.point[k])));
        let mut axes = [0, 1, 2];
        axes.sort_by(|a, b| (span(*b).1 - span(*b).0).total_cmp(&(span(*a).1 - span(*a).0)));
        let reach_mm = on().map(|at| at.signed_mm.abs()).fold(1e-6, f64::max);
        let class = |name: &str, colour, is_in: &dyn Fn(f64, bool) -> bool| {
            let every = scan.residuals.len().div_ceil(N_SHOWN);
            let shown = scan.residuals.iter().step_by(every).filter(|(at, off)| is_in(at.signed_mm / reach_mm, *off));
            let dot =
                |(at, _): &(Residual, bool)| (at.point[axes[0]], at.point[axes[1]], format!("{:.2} mm", at.signed_mm));
            Series { name: name.into(), colour, marks: vec![Mark::Dots(shown.map(dot).collect())] }
        };
        let series = vec![
            class("inside", 0, &|r, off| !off && r < -0.25),
            class("slightly inside", 5, &|r, off| !off && (-0.25..0.0).contains(&r)),
            class("slightly outside", 4, &|r, off| !off && (0.0..0.25).contains(&r)),
            class("outside", 1, &|r, off| !off && r >= 0.25),
            class("outliers", 6, &|_, off| off),
        ];
        let title = format!("{name}: residuals in the part's frame; slight: up to {:.2} mm", 0.25 * reach_mm);
        draw(&mut page, &title, [axes[0], axes[1]].map(|k| ["x (mm)", "y (mm)", "z (mm)"][k]), series);
        let mut bars = [0.0; N_BARS];
        on().for_each(|at| bars[((at.signed_mm / reach_mm + 1.0) / 2.0 * (N_BARS as f64 - 1e-6)) as usize] += 1.0);
        let edge = |k: usize| (2.0 * k as f64 / N_BARS as f64 - 1.0) * reach_mm;
        let bars = bars.iter().enumerate().flat_map(|(k, n)| [(edge(k), 0.0, *n), (edge(k + 1), 0.0, *n)]).collect();
        let series = vec![Series::unnamed(0, vec![Mark::Band(bars)])];
        draw(&mut page, &format!("{name}: distances from the part"), ["residual (mm)", "points"], series);
    }
    page.finish("Scans of a known part.").0
}

fn draw(page: &mut Page, title: &str, [x, y]: [&str; 2], series: Vec<Series>) {
    let (x, y) = (Axis::Linear(x.into()), Axis::Linear(y.into()));
    let chart = Chart { title: title.into(), about: title.into(), x, y, series, note: String::new() };
    page.charts(title, &[chart], title);
}
