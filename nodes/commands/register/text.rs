//! The answer of `register` as text.

use crate::{
    app::{
        program::NOTICE,
        register::{
            Register, Registration, cells,
            words::{converged, describe, short, stop_reason},
        },
    },
    commands::common::{Global, text_table::TextTable, verdict_lines},
};
use osteoflow_algorithms::{
    coarse::{CoarseReport, GlobalReport},
    icp::{IcpReport, IcpStep},
    trust::PredictedPoint,
};
use osteoflow_geometry::matrix_rows;
use osteoflow_report::summary::word;
use osteoflow_statistics::quantile;
use serde_json::Value;
use std::fmt::Write as _;

/// The verdict, the inputs, the pose if it is given, what the method reports, and the times.
pub(super) fn text(registration: &Registration, checked: &Register, global: &Global) -> String {
    let (mut out, request) = (String::new(), &checked.request);
    if let Some(lines) = verdict_lines::text(&registration.run.results, global) {
        out += &format!("{lines}\n");
    }
    if global.verbose > 0 && registration.pose().is_some() {
        let _ = writeln!(out, "{}", steps(&registration.steps));
    }
    let _ = writeln!(out, "{NOTICE}\n");
    let _ = writeln!(out, "target  {}, {}", request.target.path.display(), registration.describe_target());
    let _ = writeln!(out, "source  {}, {}", request.source.path.display(), registration.describe_source());
    let _ = match checked.plan().plugins.first() {
        Some(plugin) => writeln!(out, "method  {}, {}", checked.method_name(), plugin.path.display()),
        None => writeln!(out, "method  {}, pairing {}", checked.method_name(), checked.pairing()),
    };
    let start = registration.start_report.as_ref().and_then(start);
    let _ = writeln!(out, "{}", start.as_ref().map_or_else(String::new, |start| format!("start   {start}\n")));
    if let Some(pose) = registration.pose() {
        let _ = writeln!(out, "t_target_source, mm");
        for row in matrix_rows(pose) {
            let _ = writeln!(out, "  {:>11.8} {:>11.8} {:>11.8} {:>13.6}", row[0], row[1], row[2], row[3]);
        }
        out.push('\n');
        out += &predicted(&registration.run.results["verdict"]["predicted"]["points"]);
    }
    let _ = writeln!(out, "{}", result(registration, checked));
    out += &times(registration, checked, start.is_some(), global);
    for file in &registration.written {
        let _ = writeln!(out, "\n{} written", file.display());
    }
    out
}

/// The predicted error at each target, as a table; nothing without targets.
fn predicted(points: &Value) -> String {
    let points: Vec<PredictedPoint> = serde_json::from_value(points.clone()).unwrap_or_default();
    let mut table = TextTable::new("predicted, mm", &["RMS", "90 % from", "to", "ellipsoid of 90 %"]);
    for PredictedPoint { name, tre_mm, interval_mm: [from, to], semi_axes_mm: [a, b, c], .. } in &points {
        let axes = format!("{a:.2} x {b:.2} x {c:.2}");
        table.row(name, [*tre_mm, *from, *to].map(|mm| format!("{mm:.2}")).into_iter().chain([axes]));
    }
    if points.is_empty() { String::new() } else { format!("{}\n", table.lines()) }
}

/// What the parts took: a line, or with --verbose or --repeat a table.
fn times(registration: &Registration, checked: &Register, has_start: bool, global: &Global) -> String {
    let (request, timings) = (&checked.request, &registration.timings);
    let mut rows = vec![("load", vec![timings.load_ms()])];
    if has_start {
        rows.push(("start", vec![timings.start_ms]));
    }
    rows.extend([
        ("prep_target", timings.prep_target_ms.clone()),
        ("prep_source", timings.prep_source_ms.clone()),
        ("align", timings.align_ms.clone()),
        ("cpu of align", timings.cpu_ms.clone()),
    ]);
    if !request.no_verdict {
        rows.push(("verdict", vec![timings.verdict_ms]));
    }
    rows.retain(|(_, ms)| !ms.is_empty());
    if global.verbose == 0 && request.repeat == 1 {
        // The processor time is part of align.
        let parts: Vec<_> = rows.iter().filter(|(name, _)| *name != "cpu of align").collect();
        let all: f64 = parts.iter().map(|(_, ms)| ms[0]).sum();
        let parts: Vec<_> = parts.iter().map(|(name, ms)| format!("{name} {:.1}", ms[0])).collect();
        return format!("time    {all:.0} ms: {}\n", parts.join(", "));
    }
    let columns: &[&str] = if request.repeat > 1 { &["median", "least", "most ms"] } else { &["ms"] };
    let mut table = TextTable::new("time", columns);
    for (name, ms) in &mut rows {
        // Measured once, unlike the repeats.
        let n = if ms.len() > 1 || request.repeat == 1 { columns.len() } else { 1 };
        let cells = [0.5, 0.0, 1.0].map(|q| quantile(ms, q));
        table.row(*name, cells.iter().take(n).map(|ms| format!("{ms:.1}")));
    }
    table.lines()
}

/// Where the start is from, by its report.
fn start(report: &Value) -> Option<String> {
    if let Ok(report) = serde_json::from_value::<GlobalReport>(report.clone()) {
        return Some(match (&report.runner_up, &report.twin) {
            (Some(other), _) => format!(
                "by shape alone: the next best place, {:.0} mm and {:.0} degrees away, fits {:.0} % worse (clearness {:.2})",
                other.shift_mm,
                other.turn_rad.to_degrees(),
                100.0 * (other.score_mm / report.score_mm.max(f64::MIN_POSITIVE) - 1.0),
                report.clearness
            ),
            (None, Some(twin)) => format!(
                "by shape alone: the scan fits where the surface looks the same only, such as {:.0} mm and {:.0} degrees away",
                twin.shift_mm,
                twin.turn_rad.to_degrees()
            ),
            (None, None) => "by shape alone: the scan fits in one place only".into(),
        });
    }
    let report: CoarseReport = serde_json::from_value(report.clone()).ok()?;
    Some(format!("{} landmarks, {:.2} mm RMS apart after their fit", report.pairs.len(), report.fre_mm))
}

fn result(registration: &Registration, checked: &Register) -> String {
    let moved = registration
        .moved_by()
        .map_or_else(String::new, |(rms_mm, turn_deg)| format!("{rms_mm:.3} mm RMS, {turn_deg:.3} deg"));
    let lines = match registration.icp_report.as_ref().filter(|_| checked.request.is_built_in()) {
        Some(report) => built_in_lines(report, checked, moved),
        None => {
            let fields = registration.report.as_ref().and_then(Value::as_object).into_iter().flatten();
            let shown = fields.filter(|(key, value)| *key != "converged" && (value.is_number() || value.is_string()));
            let shown = shown.map(|(key, value)| (key.as_str(), word(value)));
            let first = ("converged", converged(registration.ended().converged).to_owned());
            std::iter::once(first).chain(shown).chain([("moved", moved)]).collect()
        }
    };
    lines.iter().fold("result\n".to_owned(), |out, (name, value)| out + &format!("  {name:<14}{value}\n"))
}

fn built_in_lines(report: &IcpReport, checked: &Register, moved: String) -> Vec<(&'static str, String)> {
    let within = checked.max_pair_distance_mm().map_or_else(String::new, |mm| format!(", within {mm} mm"));
    let mut lines = vec![
        ("converged", format!("{}: {}", if report.converged { "yes" } else { "NO" }, stop_reason(report.stop_reason))),
        ("steps", report.iterations.to_string()),
        ("pairs", format!("{} of {}{within}", report.n_pairs, report.n_source)),
        ("residual", format!("{:.4} mm RMS, {:.4} mm between the points", report.rms_mm, report.point_rms_mm)),
    ];
    lines.extend(report.remaining_mm.map(|mm| ("remaining", format!("{} mm", short(mm)))));
    lines.extend(
        report.left_mm.map(|mm| ("along normals", format!("point_to_plane from there ends {} mm away", short(mm)))),
    );
    lines.push(("moved", moved));
    let free = &report.observability.undetermined;
    let weakest = &report.observability.weakest;
    lines.push((
        "undetermined",
        if free.is_empty() {
            let (motion, residual) = (describe(weakest), short(weakest.residual_per_mm));
            format!("nothing; weakest is {motion}, {residual} mm per mm")
        } else {
            free.iter().map(describe).collect::<Vec<_>>().join("; ")
        },
    ));
    lines
}

/// The steps as a text table.
fn steps(steps: &[IcpStep]) -> String {
    let Some(first) = steps.first() else { return "no step was taken\n".into() };
    let names: Vec<_> = cells(first).keys().filter(|key| *key != "iteration").cloned().collect();
    let names: Vec<_> = names.iter().map(String::as_str).collect();
    let mut table = TextTable::new("steps", &names);
    for step in steps {
        let cells = cells(step);
        let row = names.iter().map(|name| match cells.get(*name) {
            Some(Value::Number(number)) if number.is_f64() => six_digits(number.as_f64().unwrap_or(f64::NAN)),
            Some(Value::Bool(true)) => "yes".into(),
            None | Some(Value::Null | Value::Bool(false)) => "-".into(),
            Some(other) => word(other),
        });
        table.row(step.iteration.to_string(), row);
    }
    table.lines()
}

/// Six digits after the point, or scientific notation for small numbers.
fn six_digits(number: f64) -> String {
    if number != 0.0 && number.abs() < 1e-4 { format!("{number:.2e}") } else { format!("{number:.6}") }
}
