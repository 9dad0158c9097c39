//! The answer of `register`: text, JSON, files and warnings.

use super::{
    Params, Register, Stop,
    align::{Aligned, Ended, Report},
    files::{Form, OutFiles, itk_file},
    inputs::Inputs,
    judge,
    method::MethodParams,
    plugin::PluginMethod,
    start::OTHER_WAYS,
    trace, write_new,
};
use crate::app::{NOTICE, program::about_command};
use crate::commands::common::{Exit, Format, Global, terminal, text_table::TextTable, verdict_lines};
use anyhow::Result;
use osteoflow_algorithms::{
    coarse::CLEAR,
    icp::{IcpReport, StopReason, WeakDirection},
};
use osteoflow_geometry::{
    matrix_rows,
    nalgebra::{Isometry3, Vector3},
};
use serde_json::{Map, Value, json};
use std::{fmt::Write as _, io::Write};

/// Error left by a `point_to_point` above which it is warned of, mm: the resolution of a tracker.
const LEFT_MM: f64 = 0.1;

/// Turn from the start above which it is warned of, degrees: a coarse fit is off by a few, and a bone that is nearly round has
/// stationary points all around its axis.
const TURNED_DEG: f64 = 30.0;

/// Share of a motion above which it is named a shift or a turn alone.
const MOSTLY: f64 = 0.95;

/// The inputs of the answer.
pub(crate) struct Answer<'a> {
    pub(super) register: &'a Register,
    pub(super) params: &'a Params,
    pub(super) inputs: &'a Inputs,
    pub(super) files: &'a OutFiles,
    pub(super) workers: usize,
}

/// The answer as the program gives it.
pub(crate) struct Answered {
    pub(crate) exit: Exit,
    pub(crate) warnings: Vec<String>,
    pub(crate) json: Value,
}

impl Answer<'_> {
    /// Writes the files and returns the answer.
    pub(crate) fn answered(&self, ended: &Ended, with_trace: bool) -> Result<Answered> {
        let exit = match ended {
            Ended::Fit(aligned) if aligned.refusal().is_none() => Exit::Done,
            Ended::Fit(_) | Ended::Refused(_) => Exit::Refused,
            Ended::Interrupted => Exit::Interrupted,
        };
        let warnings = match ended {
            Ended::Fit(aligned) => self.warnings(aligned),
            _ => Vec::new(),
        };
        let json = self.json(ended, exit, &warnings, with_trace);
        if let (Ended::Fit(aligned), Exit::Done) = (ended, exit) {
            let text_of = |form| match form {
                Form::Json => format!("{json}\n"),
                Form::Text => self.matrix_file(aligned),
                Form::Itk => self.itk_file(aligned),
            };
            self.files.write(text_of, aligned.moved.as_ref())?;
            if let Some(file) = &self.register.trace {
                write_new(file, &trace::csv(&aligned.fit.steps))?;
            }
        }
        Ok(Answered { exit, warnings, json })
    }

    /// Prints the answer, writes the files, and returns the exit code.
    pub(super) fn write(&self, ended: &Ended, global: &Global) -> Result<Exit> {
        let Answered { exit, warnings, json } = self.answered(ended, global.verbose > 0)?;
        let mut err = terminal::stderr().lock();
        if !global.quiet {
            for warning in &warnings {
                writeln!(err, "{}: {warning}", global.paint_err("warning", "1;33"))?;
            }
        }
        match ended {
            Ended::Refused(why) => writeln!(err, "{}: {why}", global.paint_err("refused", "1;31"))?,
            Ended::Interrupted => writeln!(err, "{}: there is no pose", global.paint_err("interrupted", "1;33"))?,
            Ended::Fit(aligned) => {
                if let Some(why) = aligned.refusal() {
                    writeln!(err, "{}: {why}", global.paint_err("refused", "1;31"))?;
                }
            }
        }
        drop(err);
        let mut out = terminal::stdout().lock();
        match (global.format, ended) {
            // One line, so that the last line is the answer wherever others print before it.
            (Format::Json, _) => writeln!(out, "{json}")?,
            (Format::Text, Ended::Fit(aligned)) => write!(out, "{}", self.text(aligned, global))?,
            (Format::Text, _) => {}
        }
        Ok(exit)
    }

    fn warnings(&self, aligned: &Aligned) -> Vec<String> {
        let mut warnings: Vec<String> = aligned.doubt.iter().cloned().collect();
        // The verdict says so, where there is one.
        if aligned.judged.is_none() && aligned.started.shape().is_some_and(|start| start.clearness < CLEAR) {
            warnings.push(format!("the start by shape alone is not clear, and not judged; start from {OTHER_WAYS}"));
        }
        match &aligned.fit.report {
            Report::BuiltIn(report) => warnings.extend(self.warnings_of(report)),
            Report::Plugin { warnings: theirs, .. } => {
                warnings.extend(theirs.iter().map(|warning| format!("{}: {warning}", self.method())));
                if aligned.fit.report.ended().converged == Some(false) {
                    warnings.push(format!("not converged, by the report of {}", self.method()));
                }
            }
        }
        let turned_deg = aligned.fit.t_target_source.rotation.angle_to(&aligned.started.init.rotation).to_degrees();
        if turned_deg > TURNED_DEG {
            let turned = format!("it turned the source by {turned_deg:.0} degrees from the start");
            warnings.push(format!("{turned}, so it may have converged to another minimum; is the start right?"));
        }
        if !aligned.same_bits {
            warnings.push("the repeats gave different poses, which only a time limit should cause".into());
        }
        warnings
    }

    /// Warnings of a built-in method.
    fn warnings_of(&self, report: &IcpReport) -> Vec<String> {
        let mut warnings = Vec::new();
        if !report.converged && self.register.stop == Stop::Converge {
            let left = report.remaining_mm.map_or_else(String::new, |mm| format!("; about {} mm remain", short(mm)));
            warnings.push(format!("not converged: {}{left}", stop_reason(report.stop_reason)));
        }
        for motion in &report.observability.undetermined {
            let motion = describe(motion);
            warnings.push(format!("the surfaces leave {motion} undetermined: along it the pose is that of the start"));
        }
        if let Some(left_mm) = report.left_mm.filter(|mm| *mm > LEFT_MM) {
            let left = format!("it stopped {left_mm:.2} mm from where point_to_plane ends that starts there");
            warnings.push(format!("{left}; use --method point_to_plane"));
        }
        warnings
    }

    fn json(&self, ended: &Ended, exit: Exit, warnings: &[String], with_trace: bool) -> Value {
        let (asked, inputs) = (self.register, self.inputs);
        let mut out = Map::new();
        let mut put = |key: &str, value: Value| {
            out.insert(key.into(), value);
        };
        if let Some(verdict) = self.verdict(ended) {
            put("verdict", verdict);
        }
        put("outcome", exit.to_json());
        match ended {
            Ended::Refused(why) => put("refused", json!({ "reason": why })),
            Ended::Interrupted => put("refused", json!({ "reason": "interrupted" })),
            Ended::Fit(aligned) => {
                let fit = &aligned.fit;
                match aligned.refusal() {
                    None => put("T", json!(matrix_rows(&fit.t_target_source).concat())),
                    Some(why) => put("refused", json!({ "reason": why })),
                }
                let report = match &fit.report {
                    Report::BuiltIn(report) => {
                        put("undetermined", json!(report.observability.undetermined));
                        json!(report)
                    }
                    Report::Plugin { theirs, .. } => theirs.clone().unwrap_or_default(),
                };
                for key in ["converged", "stop_reason", "iterations", "n_pairs", "rms_mm", "remaining_mm"] {
                    put(key, report.get(key).cloned().unwrap_or_default());
                }
                put("same_bits", aligned.same_bits.into());
                if let Ok(Value::Object(timings)) = serde_json::to_value(&aligned.timings) {
                    timings.into_iter().for_each(|(key, value)| put(&key, value));
                }
                if let Some(judged) = &aligned.judged {
                    put("verdict_ms", json!(judged.ms));
                }
                put("report", report);
                if with_trace && exit == Exit::Done {
                    put("trace", json!(fit.steps));
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
        put("method", self.method().into());
        if let Some(plugin) = self.plugin().and_then(PluginMethod::plugin) {
            put("plugin", json!(plugin));
        }
        put("pairing", self.pairing().into());
        put("stop", asked.stop.name().into());
        put("params", self.params.as_json.clone());
        put("target", inputs.target.to_json(&asked.target));
        put("source", inputs.source.to_json(&asked.source));
        if let Ended::Fit(aligned) = ended {
            let file = asked.init.as_ref().map(|file| file.display().to_string());
            put("init", json!({ "file": file, "matrix": matrix_rows(&aligned.started.init) }));
            put("start", aligned.started.to_json());
        }
        put("seed", asked.seed.into());
        put("workers", self.workers.into());
        put("repeat", asked.repeat.into());
        put("units", "mm, rad".into());
        put("notice", NOTICE.into());
        put("command", about_command());
        Value::Object(out)
    }

    /// The verdict as JSON; `None` if none was asked for.
    fn verdict(&self, ended: &Ended) -> Option<Value> {
        match ended {
            Ended::Fit(aligned) => aligned.judged.as_ref().map(|judged| json!(judged.verdict)),
            _ if self.register.no_verdict => None,
            Ended::Refused(why) => Some(json!(judge::no_pose(why))),
            Ended::Interrupted => Some(json!(judge::interrupted())),
        }
    }

    fn plugin(&self) -> Option<&PluginMethod> {
        match &self.params.method {
            MethodParams::Plugin(plugin) => Some(plugin),
            _ => None,
        }
    }

    /// The name of the method, or the kind of the plugin.
    fn method(&self) -> &str {
        self.plugin().map_or(&self.register.method, |plugin| &plugin.kind)
    }

    fn pairing(&self) -> &str {
        self.params.as_json.get("pairing").and_then(Value::as_str).unwrap_or("cached")
    }

    /// The names of source and target, without their folders.
    fn names(&self) -> [String; 2] {
        [&self.register.source, &self.register.target]
            .map(|file| file.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned()))
    }

    /// Who made a file, and how the registration ended.
    fn made_by(&self, aligned: &Aligned) -> String {
        let ended = match &aligned.fit.report {
            Report::BuiltIn(report) => stop_reason(report.stop_reason),
            Report::Plugin { .. } => converged(aligned.fit.report.ended().converged),
        };
        format!("osteoflow {}, {}: {ended}; {NOTICE}", env!("CARGO_PKG_VERSION"), self.method())
    }

    /// The pose for 3D Slicer.
    fn itk_file(&self, aligned: &Aligned) -> String {
        let [source, target] = self.names();
        let comments = [
            format!(
                "moves {source} (frame source) to {target} (frame target), mm, LPS; the parameters are those of the inverse"
            ),
            self.made_by(aligned),
        ];
        itk_file(&aligned.fit.t_target_source, self.inputs.spaces(self.register.space), &comments)
    }

    /// The matrix as text, with comments.
    fn matrix_file(&self, aligned: &Aligned) -> String {
        let [source, target] = self.names();
        let mut out = format!("# takes {source} to {target}: 4 x 4, row by row, mm\n# {}\n", self.made_by(aligned));
        for row in matrix_rows(&aligned.fit.t_target_source) {
            let _ = writeln!(out, "{}", row.map(|c| format!("{c:?}")).join(" "));
        }
        out
    }

    fn text(&self, aligned: &Aligned, global: &Global) -> String {
        let (fit, inputs, asked) = (&aligned.fit, self.inputs, self.register);
        let mut out = String::new();
        if let Some(judged) = &aligned.judged {
            let lines = verdict_lines::text(&json!({ "verdict": judged.verdict }), global);
            lines.iter().for_each(|lines| out += &format!("{lines}\n"));
        }
        let is_given = aligned.refusal().is_none();
        if global.verbose > 0 && is_given {
            let _ = writeln!(out, "{}", trace::text(&fit.steps));
        }
        let _ = writeln!(out, "{NOTICE}\n");
        let _ = writeln!(out, "target  {}, {}", asked.target.display(), inputs.target.describe());
        let _ = writeln!(out, "source  {}, {}", asked.source.display(), inputs.source.describe());
        let _ = match self.plugin().and_then(PluginMethod::plugin) {
            Some(plugin) => writeln!(out, "method  {}, {}", self.method(), plugin.path.display()),
            None => writeln!(out, "method  {}, pairing {}", asked.method, self.pairing()),
        };
        let start = aligned.started.describe();
        let _ = writeln!(out, "{}", start.map_or_else(String::new, |start| format!("start   {start}\n")));
        if is_given {
            let _ = writeln!(out, "t_target_source, mm");
            for row in matrix_rows(&fit.t_target_source) {
                let _ = writeln!(out, "  {:>11.8} {:>11.8} {:>11.8} {:>13.6}", row[0], row[1], row[2], row[3]);
            }
            out.push('\n');
        }
        let _ = writeln!(
            out,
            "{}",
            summary(&fit.report, self.params, &self.moved(&fit.t_target_source, &aligned.started.init))
        );
        let (timings, started) = (&aligned.timings, &aligned.started);
        let columns: &[&str] = if asked.repeat > 1 { &["median", "least", "most ms"] } else { &["ms"] };
        let mut table = TextTable::new("time", columns);
        table.row("load", [format!("{:.1}", inputs.load.sum())]);
        if started.describe().is_some() {
            table.row("start", [format!("{:.1}", started.ms)]);
        }
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
        if let Some(judged) = &aligned.judged {
            table.row("verdict", [format!("{:.1}", judged.ms)]);
        }
        let _ = write!(out, "{}", table.lines());
        for file in self.files.all().chain(&asked.trace).filter(|_| is_given) {
            let _ = writeln!(out, "\n{} written", file.display());
        }
        out
    }

    /// The motion from the start: RMS over the source points in mm, and the turn.
    fn moved(&self, t_target_source: &Isometry3<f64>, init: &Isometry3<f64>) -> String {
        let points = self.inputs.source.cloud().points();
        let squares: f64 = points.iter().map(|p| (t_target_source * p - init * p).norm_squared()).sum();
        let rms_mm = (squares / points.len() as f64).sqrt();
        let turned = t_target_source.rotation.angle_to(&init.rotation).to_degrees();
        format!("{rms_mm:.3} mm RMS, {turned:.3} deg")
    }
}

/// What a plugin reports of its convergence.
fn converged(stated: Option<bool>) -> &'static str {
    match stated {
        Some(true) => "yes, by its report",
        Some(false) => "NO, by its report",
        None => "not reported",
    }
}

fn summary(report: &Report, params: &Params, moved: &str) -> String {
    let lines = match report {
        Report::BuiltIn(report) => built_in_lines(report, params, moved),
        Report::Plugin { theirs, .. } => {
            let fields = theirs.iter().filter_map(Value::as_object).flatten();
            let shown = fields.filter(|(key, value)| *key != "converged" && (value.is_number() || value.is_string()));
            let shown = shown
                .map(|(key, value)| (key.as_str(), value.as_str().map_or_else(|| value.to_string(), String::from)));
            let first = ("converged", converged(report.ended().converged).to_owned());
            std::iter::once(first).chain(shown).chain([("moved", moved.into())]).collect()
        }
    };
    lines.iter().fold("result\n".to_owned(), |out, (name, value)| out + &format!("  {name:<14}{value}\n"))
}

fn built_in_lines(report: &IcpReport, params: &Params, moved: &str) -> Vec<(&'static str, String)> {
    let within = params.method.max_pair_distance_mm().map_or_else(String::new, |mm| format!(", within {mm} mm"));
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
    lines.push(("moved", moved.into()));
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

fn stop_reason(reason: StopReason) -> &'static str {
    match reason {
        StopReason::Step => "the remaining distance is below stop_step_mm",
        StopReason::Residual => "the residual changed by less than stop_residual_mm",
        StopReason::Iterations => "max_iterations are used up",
        StopReason::Time => "stop_after_ms are used up",
        StopReason::Stalled => "no step lowers the residual any more",
        StopReason::Cancelled => "interrupted",
    }
}

/// A motion in the target's frame: a shift, a turn about the source's centroid, or both.
fn describe(motion: &WeakDirection) -> String {
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

/// Three digits after the point, or one significant digit for small numbers.
fn short(number: f64) -> String {
    match number.abs() {
        0.0 => "0".into(),
        small if small < 1e-3 => format!("{number:.0e}"),
        _ => format!("{number:.3}"),
    }
}
