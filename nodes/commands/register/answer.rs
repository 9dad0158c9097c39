//! How a registration is told.

use super::{
    Params, Register, Stop,
    align::{Aligned, Ended},
    inputs::Inputs,
    trace, write_new,
};
use crate::commands::{Exit, Format, Global, result_table::NOTICE, running::about_command, text_table::TextTable};
use anyhow::Result;
use osteoflow_algorithms::icp::{IcpReport, StopReason, WeakDirection};
use osteoflow_geometry::{
    matrix_rows,
    nalgebra::{Isometry3, Vector3},
};
use serde_json::{Map, Value, json};
use std::{fmt::Write as _, io::Write, path::Path};

/// What a `point_to_point` may leave without a word, mm: what a tracker can tell.
const LEFT_MM: f64 = 0.1;

/// A start is doubted where the registration turned the source by more, degrees: a coarse fit is off by a few, and a bone
/// that is nearly round about its axis has places to rest all around it.
const TURNED_DEG: f64 = 30.0;

/// A motion is called a shift or a turn where so much of it is.
const MOSTLY: f64 = 0.95;

/// What was registered, and how.
pub(super) struct About<'a> {
    pub(super) register: &'a Register,
    pub(super) params: &'a Params,
    pub(super) inputs: &'a Inputs,
    pub(super) workers: usize,
}

impl About<'_> {
    /// Answers, writes the files asked for, and says how the command ends.
    pub(super) fn tell(&self, ended: &Ended, global: &Global) -> Result<Exit> {
        let exit = match ended {
            Ended::Fit(_) => Exit::Done,
            Ended::Refused(_) => Exit::Refused,
            Ended::Interrupted => Exit::Interrupted,
        };
        let warnings = match ended {
            Ended::Fit(aligned) => self.warnings(aligned),
            _ => Vec::new(),
        };
        let json = self.json(ended, exit, &warnings, global.verbose > 0);
        if let Ended::Fit(aligned) = ended {
            if let Some(file) = &self.register.out {
                let is_json = file.extension().is_some_and(|end| end.eq_ignore_ascii_case("json"));
                let text = if is_json { format!("{json}\n") } else { self.matrix_file(aligned) };
                write_new(file, &text)?;
            }
            if let Some(file) = &self.register.trace {
                write_new(file, &trace::csv(&aligned.fit.trace.steps))?;
            }
        }
        let mut err = std::io::stderr().lock();
        if !global.quiet {
            for warning in &warnings {
                writeln!(err, "{}: {warning}", global.paint_err("warning", "1;33"))?;
            }
        }
        match ended {
            Ended::Refused(why) => writeln!(err, "{}: {why}", global.paint_err("refused", "1;31"))?,
            Ended::Interrupted => writeln!(err, "{}: there is no pose", global.paint_err("interrupted", "1;33"))?,
            Ended::Fit(_) => {}
        }
        drop(err);
        let mut out = std::io::stdout().lock();
        match (global.format, ended) {
            // One line, so that the last line is the answer wherever others print before it.
            (Format::Json, _) => writeln!(out, "{json}")?,
            (Format::Text, Ended::Fit(aligned)) => write!(out, "{}", self.text(aligned, global.verbose > 0))?,
            (Format::Text, _) => {}
        }
        Ok(exit)
    }

    /// What makes the pose doubtful.
    fn warnings(&self, aligned: &Aligned) -> Vec<String> {
        let report = &aligned.fit.report;
        let mut warnings = Vec::new();
        if !report.converged && self.register.stop == Stop::Converge {
            let left =
                report.remaining_mm.map_or_else(String::new, |mm| format!("; about {} mm are left to go", short(mm)));
            warnings.push(format!("not converged: {}{left}", why(report.stop_reason)));
        }
        for motion in &report.observability.undetermined {
            let motion = in_words(motion);
            warnings
                .push(format!("the surfaces leave {motion} undetermined: along it the pose says what the start said"));
        }
        if let Some(left_mm) = report.left_mm.filter(|mm| *mm > LEFT_MM) {
            let said = format!("it came to rest, but a step along the normals would still move it by {left_mm:.2} mm");
            warnings.push(format!("{said}; try --method point_to_plane"));
        }
        let turned_deg = aligned.fit.t_target_source.rotation.angle_to(&self.inputs.init.rotation).to_degrees();
        if turned_deg > TURNED_DEG {
            let said = format!("it turned the source by {turned_deg:.0} degrees from where it started");
            warnings.push(format!("{said}, farther than it can be trusted to find back; is --init right?"));
        }
        if !aligned.same_bits {
            warnings.push("the repeats gave different poses, which only a limit of time should do".into());
        }
        warnings
    }

    fn json(&self, ended: &Ended, exit: Exit, warnings: &[String], with_trace: bool) -> Value {
        let (asked, inputs) = (self.register, self.inputs);
        let mut out = Map::new();
        let mut put = |key: &str, value: Value| {
            out.insert(key.into(), value);
        };
        put("outcome", exit.to_json());
        match ended {
            Ended::Refused(why) => put("refused", json!({ "reason": why })),
            Ended::Interrupted => put("refused", json!({ "reason": "it was interrupted before its end" })),
            Ended::Fit(aligned) => {
                let (fit, report) = (&aligned.fit, &aligned.fit.report);
                put("T", json!(matrix_rows(&fit.t_target_source).concat()));
                put("converged", report.converged.into());
                put("stop_reason", json!(report.stop_reason));
                put("iterations", report.iterations.into());
                put("n_pairs", report.n_pairs.into());
                put("rms_mm", json!(report.rms_mm));
                put("remaining_mm", json!(report.remaining_mm));
                put("undetermined", json!(report.observability.undetermined));
                put("same_bits", aligned.same_bits.into());
                if let Ok(Value::Object(timings)) = serde_json::to_value(&aligned.timings) {
                    timings.into_iter().for_each(|(key, value)| put(&key, value));
                }
                put("report", json!(report));
                if with_trace {
                    put("trace", json!(fit.trace.steps));
                }
            }
        }
        let load = &inputs.load;
        put("load_ms", json!(load.sum()));
        put(
            "load",
            json!({
                "target_ms": load.target, "sample_ms": load.sample, "source_ms": load.source, "init_ms": load.init,
            }),
        );
        put("warnings", json!(warnings));
        put("notes", json!(inputs.notes));
        put("method", asked.method.as_str().into());
        put("pairing", self.pairing().into());
        put("stop", asked.stop.word().into());
        put("params", self.params.as_json.clone());
        put("target", inputs.target.to_json(&asked.target));
        put("source", inputs.source.to_json(&asked.source));
        put(
            "init",
            json!({
                "file": asked.init.as_ref().map(|file| file.display().to_string()),
                "matrix": matrix_rows(&inputs.init),
            }),
        );
        put("seed", asked.seed.into());
        put("workers", self.workers.into());
        put("repeat", asked.repeat.into());
        put("units", "mm, rad".into());
        put("notice", NOTICE.into());
        put("command", about_command());
        Value::Object(out)
    }

    fn pairing(&self) -> &str {
        self.params.as_json.get("pairing").and_then(Value::as_str).unwrap_or_default()
    }

    /// The matrix as text that this command and others read.
    fn matrix_file(&self, aligned: &Aligned) -> String {
        let (asked, version) = (self.register, env!("CARGO_PKG_VERSION"));
        let name = |file: &Path| file.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
        let (source, target) = (name(&asked.source), name(&asked.target));
        let mut out = format!("# takes {source} to {target}: 4 x 4, row by row, mm\n");
        let ended = why(aligned.fit.report.stop_reason);
        let _ = writeln!(out, "# osteoflow {version}, {}: {ended}; {NOTICE}", asked.method);
        for row in matrix_rows(&aligned.fit.t_target_source) {
            let _ = writeln!(out, "{}", row.map(|c| format!("{c:?}")).join(" "));
        }
        out
    }

    fn text(&self, aligned: &Aligned, with_trace: bool) -> String {
        let (fit, inputs, asked) = (&aligned.fit, self.inputs, self.register);
        let mut out = String::new();
        if with_trace {
            let _ = writeln!(out, "{}", trace::text(&fit.trace.steps));
        }
        let _ = writeln!(out, "{NOTICE}\n");
        let _ = writeln!(out, "target  {}, {}", asked.target.display(), inputs.target.in_words());
        let _ = writeln!(out, "source  {}, {}", asked.source.display(), inputs.source.in_words());
        let _ = writeln!(out, "method  {}, pairing {}\n", asked.method, self.pairing());
        let _ = writeln!(out, "t_target_source, mm");
        for row in matrix_rows(&fit.t_target_source) {
            let _ = writeln!(out, "  {:>11.8} {:>11.8} {:>11.8} {:>13.6}", row[0], row[1], row[2], row[3]);
        }
        let _ = writeln!(out, "\n{}", how_it_ended(&fit.report, self.params, &self.moved(&fit.t_target_source)));
        let timings = &aligned.timings;
        let columns: &[&str] = if asked.repeat > 1 { &["median", "least", "most ms"] } else { &["ms"] };
        let mut table = TextTable::new("time", columns);
        table.row("load", [format!("{:.1}", inputs.load.sum())]);
        let rows = [
            ("prep_target", &timings.prep_target_ms),
            ("prep_source", &timings.prep_source_ms),
            ("align", &timings.align_ms),
            ("cpu of align", &timings.cpu_ms),
        ];
        for (name, ms) in rows.into_iter().filter(|(_, ms)| !ms.is_empty()) {
            let mut ms = ms.clone();
            ms.sort_by(f64::total_cmp);
            let cells = [median(&ms), ms[0], ms[ms.len() - 1]];
            table.row(name, cells.iter().take(columns.len()).map(|ms| format!("{ms:.1}")));
        }
        let _ = write!(out, "{}", table.lines());
        for file in asked.out.iter().chain(&asked.trace) {
            let _ = writeln!(out, "\n{} written", file.display());
        }
        out
    }

    /// How far the registration moved the source from where it started: RMS of its points in mm, and the turn.
    fn moved(&self, t_target_source: &Isometry3<f64>) -> String {
        let (points, init) = (self.inputs.source.cloud().points(), &self.inputs.init);
        let squares: f64 = points.iter().map(|p| (t_target_source * p - init * p).norm_squared()).sum();
        let rms_mm = (squares / points.len() as f64).sqrt();
        let turned = t_target_source.rotation.angle_to(&init.rotation).to_degrees();
        format!("{rms_mm:.3} mm RMS, {turned:.3} deg")
    }
}

fn how_it_ended(report: &IcpReport, params: &Params, moved: &str) -> String {
    let mut lines = vec![
        ("converged", format!("{}: {}", if report.converged { "yes" } else { "NO" }, why(report.stop_reason))),
        ("steps", report.iterations.to_string()),
        ("pairs", format!("{} of {}, within {} mm", report.n_pairs, report.n_source, params.icp.max_pair_distance_mm)),
        ("residual", format!("{:.4} mm RMS, {:.4} mm between the points", report.rms_mm, report.point_rms_mm)),
    ];
    lines.extend(report.remaining_mm.map(|mm| ("left to go", format!("{} mm", short(mm)))));
    lines.extend(report.left_mm.map(|mm| ("along normals", format!("{} mm would still be gone", short(mm)))));
    lines.push(("moved by it", moved.into()));
    let free = &report.observability.undetermined;
    let weakest = &report.observability.weakest;
    lines.push((
        "left free",
        if free.is_empty() {
            let (motion, held) = (in_words(weakest), short(weakest.residual_per_mm));
            format!("nothing; held least is {motion}, by {held} mm per mm")
        } else {
            free.iter().map(in_words).collect::<Vec<_>>().join("; ")
        },
    ));
    lines.iter().fold("how it ended\n".to_owned(), |out, (name, said)| out + &format!("  {name:<14}{said}\n"))
}

/// Why it stopped, in words.
fn why(reason: StopReason) -> &'static str {
    match reason {
        StopReason::Step => "less is left to go than stop_step_mm",
        StopReason::Residual => "the residual changed by less than stop_residual_mm",
        StopReason::Iterations => "max_iterations are used up",
        StopReason::Time => "stop_after_ms are used up",
        StopReason::Stalled => "no step lowers the residual any more",
        StopReason::Cancelled => "it was interrupted",
    }
}

/// A motion in the target's frame: a shift, a turn about the source's centroid, or both.
fn in_words(motion: &WeakDirection) -> String {
    let (shift, turn) = (Vector3::from(motion.translation), Vector3::from(motion.rotation));
    let axis = |v: &Vector3<f64>| {
        let unit = v.try_normalize(0.0).unwrap_or_default();
        format!("({:.2}, {:.2}, {:.2})", unit.x, unit.y, unit.z)
    };
    if shift.norm() > MOSTLY {
        format!("a shift along {}", axis(&shift))
    } else if turn.norm() > MOSTLY {
        format!("a turn about {}", axis(&turn))
    } else {
        format!("a shift along {} with a turn about {}", axis(&shift), axis(&turn))
    }
}

fn median(sorted: &[f64]) -> f64 {
    let middle = sorted.len() / 2;
    if sorted.len().is_multiple_of(2) { (sorted[middle - 1] + sorted[middle]) / 2.0 } else { sorted[middle] }
}

/// Few digits, whatever the size.
fn short(number: f64) -> String {
    match number.abs() {
        0.0 => "0".into(),
        small if small < 1e-3 => format!("{number:.0e}"),
        _ => format!("{number:.3}"),
    }
}
