//! What a registration gives: the verdict, the pose, the reports of its nodes, and the files.

use super::{
    IDENTITY, PART_KEY, ReadStart, Register, RegisterInput, SOURCE_PART, Stop, TARGET_PART,
    files::{Form, space_of},
    steps,
    words::{converged, describe, short, stop_reason},
};
use crate::app::program::{NOTICE, about_command};
use anyhow::{Context, Result};
use osteoflow_algorithms::{
    icp::{IcpReport, IcpStep},
    mesh_query::MeshQuery,
    metrics::{distance_scale, rms_apart_mm},
    target::Target,
    trust,
};
use osteoflow_engine::run::{Outcome, RunReport};
use osteoflow_formats::{Space, pose_file::itk_text, scene_file::Scene};
use osteoflow_geometry::{
    Cloud, NamedPoint, Points, matrix_rows,
    nalgebra::{Isometry3, Translation3},
};
use osteoflow_standard::output::export::{DISTANCE, with_distance};
use serde::Serialize;
use serde_json::{Map, Value, json};
use std::path::{Path, PathBuf};

/// Error left by a `point_to_point` above which it is warned of, mm: the resolution of a tracker.
const LEFT_MM: f64 = 0.1;

/// Turn from the start above which it is warned of, degrees: a coarse fit is off by a few, and a bone that is nearly round has
/// stationary points all around its axis.
const TURNED_DEG: f64 = 30.0;

/// How a registration ended, with everything that is known of it.
pub struct Registration {
    /// The pose, source to target, also if it is refused.
    pub(super) pose: Option<Isometry3<f64>>,
    /// Where the method started.
    pub(super) init: Option<Isometry3<f64>>,
    /// The report of the start, if there is one.
    pub(crate) start_report: Option<Value>,
    /// The report of the method, if it has one, and as that of a built-in one.
    pub(crate) report: Option<Value>,
    pub(crate) icp_report: Option<IcpReport>,
    /// The steps of a built-in method.
    pub(crate) steps: Vec<IcpStep>,
    /// A doubt about the picked points.
    pub(super) doubt: Option<String>,
    pub(super) target: Option<Target>,
    pub(super) source: Option<Cloud>,
    /// The reports of the nodes `bone` and `scan`; null if they gave none.
    pub(super) bone_report: Value,
    pub(super) scan_report: Value,
    pub(super) has_estimated_normals: bool,
    /// Whether the prepared target is from the store.
    pub(super) is_stored: bool,
    /// The moved source with its residuals, if it is written.
    pub(super) moved: Option<Cloud>,
    /// The files that were written.
    pub(crate) written: Vec<PathBuf>,
    /// How many points are in each region, and a target that is far from the surface.
    pub(super) cropped: Vec<String>,
    /// What the readers of these should know.
    pub(super) notes_of_files: Vec<String>,
    /// Why a file could not be written.
    pub(crate) not_written: Option<anyhow::Error>,
    pub(crate) timings: Timings,
    /// Whether all repeats gave the same bits.
    pub(super) same_bits: bool,
    pub(crate) run: RunReport,
}

/// Times in ms: of reading once, of each repeat for the rest.
#[derive(Debug, Default, Serialize)]
pub(crate) struct Timings {
    #[serde(skip)]
    pub(crate) target_ms: f64,
    #[serde(skip)]
    pub(crate) source_ms: f64,
    #[serde(skip)]
    pub(crate) init_ms: f64,
    #[serde(skip)]
    pub(crate) start_ms: f64,
    #[serde(skip)]
    pub(crate) verdict_ms: f64,
    pub(crate) prep_target_ms: Vec<f64>,
    /// Zero: the methods sort the source and estimate its normals within `align_ms`.
    pub(crate) prep_source_ms: Vec<f64>,
    pub(crate) align_ms: Vec<f64>,
    /// Processor time of `align_ms`, where the platform measures it.
    pub(crate) cpu_ms: Vec<f64>,
}

impl Timings {
    /// Adds the times of a run.
    pub(super) fn add(&mut self, run: &RunReport, is_first: bool, cpu_ms: Option<f64>) {
        let busy_ms = |name: &str| {
            run.nodes.iter().find(|node| node.name == name).map_or(0.0, |node| node.busy.as_secs_f64() * 1e3)
        };
        if is_first {
            self.target_ms = busy_ms("bone");
            self.source_ms = busy_ms("scan");
            self.start_ms = busy_ms("coarse");
            self.verdict_ms = busy_ms("verdict");
        }
        self.prep_target_ms.push(busy_ms("ct_surface"));
        self.prep_source_ms.push(0.0);
        self.align_ms.push(busy_ms("icp"));
        self.cpu_ms.extend(cpu_ms);
    }

    /// Time to read all files.
    pub(crate) fn load_ms(&self) -> f64 {
        self.target_ms + self.source_ms + self.init_ms
    }
}

impl Registration {
    /// The pose, source to target; `None` if there is none or it is refused.
    pub fn pose(&self) -> Option<&Isometry3<f64>> {
        self.pose.as_ref().filter(|_| self.run.outcome == Outcome::Complete)
    }

    /// Why there is no pose.
    pub fn refusal(&self) -> Option<&str> {
        match &self.run.outcome {
            Outcome::Complete => None,
            Outcome::Refused(refusal) => Some(&refusal.reason),
            Outcome::Interrupted => Some("interrupted"),
        }
    }

    /// The refusal for a terminal: that of a plugin begins with its kind.
    pub(crate) fn refusal_text(&self, of: &Register) -> Option<String> {
        let reason = self.refusal()?;
        let by_plugin = matches!(&self.run.outcome, Outcome::Refused(refusal) if refusal.node == "icp" && !of.request.is_built_in());
        Some(if by_plugin { format!("{}: {reason}", of.kind_name) } else { reason.to_owned() })
    }

    /// Whether the user stopped it.
    pub fn is_interrupted(&self) -> bool {
        self.run.outcome == Outcome::Interrupted
    }

    /// Whether the method ended, so that there is something to show beside a refusal.
    pub(crate) fn has_ended(&self) -> bool {
        self.pose.is_some() && self.init.is_some() && !self.is_interrupted()
    }

    /// How the method ended, by its report.
    pub(crate) fn ended(&self) -> trust::Convergence {
        self.report.clone().and_then(|report| serde_json::from_value(report).ok()).unwrap_or_default()
    }

    /// Millimetres RMS and degrees by which the method moved the source from the start.
    pub(crate) fn moved_by(&self) -> Option<(f64, f64)> {
        let (pose, init, source) = (self.pose?, self.init?, self.source.as_ref()?);
        let turn_deg = pose.rotation.angle_to(&init.rotation).to_degrees();
        Some((rms_apart_mm(source.points(), &pose, &init), turn_deg))
    }

    /// The target in a few words.
    pub(crate) fn describe_target(&self) -> String {
        let Some(target) = &self.target else { return "not prepared".into() };
        let n = target.points().len();
        let points = match target.mesh().map(MeshQuery::mesh) {
            Some(mesh) => format!("{n} points sampled from {} faces", mesh.faces().len()),
            None if self.has_estimated_normals => format!("{n} points, their normals estimated"),
            None => format!("{n} points with normals"),
        };
        format!("{points}{}", if self.is_stored { ", prepared by an earlier run" } else { "" })
    }

    /// The source in a few words.
    pub(crate) fn describe_source(&self) -> String {
        let Some(source) = &self.source else { return "not read".into() };
        let holds = self.scan_report["holds"].as_str().unwrap_or("points");
        let normals = if source.normals().is_some() { " with normals" } else { "" };
        format!("{} {holds}{normals}", source.len())
    }

    /// The spaces that the files state.
    fn stated_spaces(&self) -> [Space; 2] {
        [&self.bone_report, &self.scan_report].map(|report| match report["space"].as_str() {
            Some("LPS") => Space::Lps,
            Some("RAS") => Space::Ras,
            _ => Space::Unknown,
        })
    }

    /// Warnings and notes of a registration that ended, one sentence each.
    pub(crate) fn warnings(&self, of: &Register) -> Vec<String> {
        let mut warnings: Vec<String> = self.doubt.iter().cloned().collect();
        // Without a bone or a scan, what other nodes say follows from that.
        if matches!(&self.run.outcome, Outcome::Refused(refusal) if FILES.contains(&refusal.node.as_str())) {
            return warnings;
        }
        let of_nodes = self.run.warnings.iter().filter(|warning| !FILES.contains(&warning.node.as_str()));
        warnings.extend(of_nodes.map(|warning| match warning.node.as_str() {
            "icp" => format!("{}: {}", of.method_name(), warning.message),
            _ => warning.message.clone(),
        }));
        if !self.has_ended() {
            return warnings;
        }
        match &self.icp_report {
            Some(report) if of.request.is_built_in() => warnings.extend(report_warnings(report, of.request.stop)),
            _ if self.ended().converged == Some(false) => {
                warnings.push(format!("not converged, by the report of {}", of.method_name()));
            }
            _ => {}
        }
        if let Some((_, turned_deg)) = self.moved_by().filter(|(_, deg)| *deg > TURNED_DEG) {
            let turned = format!("it turned the source by {turned_deg:.0} degrees from the start");
            warnings.push(format!("{turned}, so it may have converged to another minimum; is the start right?"));
        }
        if !self.same_bits {
            warnings.push("the repeats gave different poses, which only a time limit should cause".into());
        }
        warnings
    }

    /// Notes on the files, one sentence each.
    pub(crate) fn notes(&self, of: &Register) -> Vec<String> {
        let of_file = |node: &str, input: &RegisterInput, option: &str| {
            let of_node = self.run.warnings.iter().filter(|warning| warning.node == node);
            // The readers name a parameter, which is an option here.
            let note = |message: &str| {
                let part = if node == "bone" { TARGET_PART } else { SOURCE_PART };
                let message = message.replace("unit_mm = ", &format!("--{option}-unit-mm ")).replace(PART_KEY, part);
                format!("{}: {}", input.path.display(), message.replace("max_points = ", "--max-points "))
            };
            // The pose is in the numbers of the files; only a .tfm has a space, and asks for it.
            let of_node = of_node.filter(|warning| !warning.message.starts_with(Space::TAKEN_FOR_LPS));
            of_node.map(|warning| note(&warning.message)).collect::<Vec<_>>()
        };
        let request = &of.request;
        let of_source = ["scan", THIN].map(|node| of_file(node, &request.source, "source")).concat();
        let notes = [of.notes.clone(), of_file("bone", &request.target, "target"), of_source, self.cropped.clone()];
        [notes.concat(), self.notes_of_files.clone()].concat()
    }

    /// Everything as JSON, with every step if `with_trace`.
    pub(crate) fn to_json(&self, of: &Register, outcome: Value, with_trace: bool) -> Value {
        let (request, results) = (&of.request, &self.run.results);
        let mut out = Map::new();
        let mut put = |key: &str, value: Value| {
            out.insert(key.into(), value);
        };
        if let Some(verdict) = results.get("verdict").filter(|_| !request.no_verdict) {
            put("verdict", verdict.clone());
        }
        put("outcome", outcome);
        if let Some(reason) = self.refusal() {
            put("refused", json!({ "reason": reason }));
        }
        if let Some(pose) = self.pose() {
            put("T", json!(matrix_rows(pose).concat()));
        }
        if self.has_ended() {
            let report = self.report.clone().unwrap_or_default();
            if of.request.is_built_in() {
                put("undetermined", report["observability"]["undetermined"].clone());
            }
            for key in ["converged", "stop_reason", "iterations", "n_pairs", "rms_mm", "remaining_mm"] {
                put(key, report.get(key).cloned().unwrap_or_default());
            }
            put("same_bits", self.same_bits.into());
            if let Ok(Value::Object(timings)) = serde_json::to_value(&self.timings) {
                timings.into_iter().for_each(|(key, value)| put(&key, value));
            }
            if !request.no_verdict {
                put("verdict_ms", json!(self.timings.verdict_ms));
            }
            put("report", report);
            if with_trace && self.pose().is_some() {
                put("trace", json!(self.steps));
            }
        }
        let Timings { target_ms, source_ms, init_ms, .. } = self.timings;
        put("load_ms", json!(self.timings.load_ms()));
        // A surface is sampled when it is prepared.
        let load = json!({ "target_ms": target_ms, "sample_ms": 0.0, "source_ms": source_ms, "init_ms": init_ms });
        put("load", load);
        put("warnings", json!(self.warnings(of)));
        put("notes", json!(self.notes(of)));
        put("method", of.method_name().into());
        if let Some(plugin) = of.checked.plan.plugins.first() {
            put("plugin", json!(plugin));
        }
        put("pairing", of.pairing().into());
        put("stop", if request.stop == Stop::Fixed { "fixed" } else { "converge" }.into());
        put("params", of.params.clone());
        // Without the files, which a caller of the settings names.
        let is_file = |set: &&String| set.starts_with("bone.path=") || set.starts_with("scan.path=");
        put("settings", of.all.iter().filter(|set| !is_file(set)).cloned().collect());
        put("target", self.target_json(&request.target));
        put("source", self.source_json(&request.source));
        if let Some(init) = self.init.filter(|_| self.has_ended()) {
            let file = request.init.as_ref().filter(|file| file.as_os_str() != IDENTITY);
            let file = file.map(|file| file.display().to_string());
            put("init", json!({ "file": file, "matrix": matrix_rows(&init) }));
            put("start", self.start_json(of));
        }
        put("seed", of.checked.plan.seed.into());
        put("workers", crate::app::program::n_workers(request.workers).into());
        put("repeat", request.repeat.into());
        put("units", "mm, rad".into());
        put("notice", NOTICE.into());
        put("command", about_command());
        Value::Object(out)
    }

    fn start_json(&self, of: &Register) -> Value {
        let by = match &of.start {
            ReadStart::Pose(_) => return json!({ "by": "pose" }),
            ReadStart::Shape => "shape",
            ReadStart::Landmarks { .. } => "landmarks",
        };
        json!({ "by": by, "ms": self.timings.start_ms, "report": self.start_report })
    }

    fn target_json(&self, input: &RegisterInput) -> Value {
        let mesh = self.target.as_ref().and_then(Target::mesh).map(MeshQuery::mesh);
        json!({
            "file": input.path.display().to_string(),
            "n_points": self.target.as_ref().map(|target| target.points().len()),
            "n_faces": mesh.map(|mesh| mesh.faces().len()),
            "normals": self.target.as_ref().is_some_and(|target| target.normals().is_some()),
            "normals_estimated": self.has_estimated_normals,
            "from_store": self.is_stored,
        })
    }

    fn source_json(&self, input: &RegisterInput) -> Value {
        let source = self.source.as_ref();
        json!({
            "file": input.path.display().to_string(),
            "n_points": source.map(Cloud::len),
            "n_dropped": self.scan_report["n_dropped"],
            "normals": source.is_some_and(|source| source.normals().is_some()),
            "camera": source.and_then(|source| source.viewpoint).map(|view| view.translation.vector.as_slice().to_vec()),
        })
    }

    /// Writes the files that the request names; none without a pose.
    ///
    /// # Errors
    /// The space of a file has to be stated for a .tfm, or is stated twice; a file cannot be written.
    pub(super) fn write(&mut self, of: &Register) -> Result<()> {
        let (request, stated) = (&of.request, self.stated_spaces());
        let Some(pose) = self.pose().copied() else { return Ok(()) };
        let names = [&request.target.path, &request.source.path];
        if request.space.is_some() && stated.iter().all(|space| *space != Space::Unknown) {
            let names = names.map(|name| name.display().to_string()).join(" and ");
            usage!("{names} state their space; leave out --space");
        }
        let spaces = stated.map(|stated| space_of(stated, request.space));
        let files = of.files.with_known_spaces(names, spaces)?;
        let made_by = format!(
            "osteoflow {}, {}: {}; {NOTICE}",
            env!("CARGO_PKG_VERSION"),
            of.method_name(),
            match self.icp_report.as_ref().filter(|_| of.request.is_built_in()) {
                Some(report) => stop_reason(report.stop_reason),
                None => converged(self.ended().converged),
            }
        );
        let [target, source] =
            names.map(|name| name.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned()));
        let turns = spaces.map(|space| Isometry3::from_parts(Translation3::identity(), space.turn()));
        let pose_lps = turns[0] * pose * turns[1];
        let scene = |file: &Path| -> Result<Vec<u8>> {
            let (bone, scan) = self.target.as_ref().zip(self.source.as_ref()).context("a pose is between two files")?;
            let mesh = bone.mesh().map(|bone| bone.mesh().transformed("ct", &turns[0]));
            let scan = with_distance(&scan.transformed("scan", &turns[1]), &pose_lps, mesh.as_ref(), None)?;
            let in_ct = |points: &[NamedPoint]| Points::new("ct", points.to_vec()).transformed("ct", &turns[0]);
            let (end_mm, colours) = distance_scale();
            let scene = Scene {
                bone: mesh.as_ref(),
                bone_points: Some(&Cloud::new("ct", bone.point_column().clone())?.transformed("ct", &turns[0])),
                scan: Some((&scan, &pose_lps)),
                scale: (DISTANCE, end_mm, &colours),
                lists: vec![("landmarks", in_ct(of.pairs().unwrap_or_default()[0])), ("targets", in_ct(&of.targets))],
                planes: &[],
            };
            Ok(scene.bytes(file)?)
        };
        let text = |form| match form {
            Form::Json => format!("{}\n", self.to_json(of, json!({ "status": "done", "exit_code": 0 }), false)),
            Form::Itk => {
                let motion = format!("moves {source} to {target}, mm, LPS; the parameters are those of the inverse");
                itk_text(&pose_lps, &[motion, made_by.clone()])
            }
            Form::Text | Form::Scene => {
                let rows = matrix_rows(&pose).map(|row| row.map(|c| format!("{c:?}")).join(" ") + "\n").concat();
                format!("# takes {source} to {target}: 4 x 4, row by row, mm\n# {made_by}\n{rows}")
            }
        };
        let bytes = |form, file: &Path| if form == Form::Scene { scene(file) } else { Ok(text(form).into()) };
        self.notes_of_files = files.write(bytes, self.moved.as_ref(), || steps::csv(&self.steps))?;
        self.written = files.all().cloned().collect();
        Ok(())
    }
}

/// The nodes that read the files.
const FILES: [&str; 3] = ["bone", "scan", THIN];

/// The node that thins the source.
const THIN: &str = "thin";

impl Register {
    /// The name of the built-in method, or the kind of the plugin.
    pub(crate) fn method_name(&self) -> &str {
        if self.request.is_built_in() { &self.request.method } else { &self.kind_name }
    }

    /// Largest distance of a pair, mm, if the method states one.
    pub(crate) fn max_pair_distance_mm(&self) -> Option<f64> {
        self.params.get("max_pair_distance_mm").and_then(Value::as_f64)
    }

    pub(crate) fn pairing(&self) -> &str {
        self.params.get("pairing").and_then(Value::as_str).unwrap_or("cached")
    }
}

/// Warnings about a built-in method.
fn report_warnings(report: &IcpReport, stop: Stop) -> Vec<String> {
    let mut warnings = Vec::new();
    if !report.converged && stop == Stop::Converge {
        let left = report.remaining_mm.map_or_else(String::new, |mm| format!("; about {} mm remain", short(mm)));
        warnings.push(format!("not converged: {}{left}", stop_reason(report.stop_reason)));
    }
    for motion in &report.observability.undetermined {
        let motion = describe(motion);
        warnings.push(format!("the surfaces leave {motion} undetermined: along it the pose is that of the start"));
    }
    if let Some(left_mm) = report.left_mm.filter(|mm| *mm > LEFT_MM) {
        warnings.push(format!("point_to_plane would move this result by {left_mm:.2} mm; use --method point_to_plane"));
    }
    warnings
}
