//! The runs of a registration, and what is taken from their wires.

use super::{
    FRAMES, ReadStart, Register, RegisterInput, TARGETS,
    answer::{Registration, Timings},
    files::moved_source,
    landmarks::{far_targets, off_surface, unseen},
    method::{POSE, REPORT},
};
use crate::app::{
    error::{Error, UsageError},
    program,
};
use anyhow::{Context, anyhow};
use osteoflow_algorithms::{icp::IcpTrace, target::Target};
use osteoflow_engine::{
    inputs::{WireInputs, output, run_with_inputs},
    plan::Plan,
    run::{Event, Observer, Outcome, Refusal, RunOptions, RunReport},
};
use osteoflow_formats::mesh_or_cloud::MeshOrCloud;
use osteoflow_geometry::{Cloud, NamedPoint, Points, Pose, nalgebra::Isometry3};
use osteoflow_node::{Body, Emission, Empty, Item, OutputPorts, Outputs, Payload, Value};
use osteoflow_payloads::{Json, Table};
use osteoflow_standard::{acquire::cloud, surface::any};
use std::{
    collections::BTreeMap,
    path::Path,
    sync::{Arc, Mutex, PoisonError, atomic::AtomicBool},
};

/// The node that registers.
const NODE: &str = "icp";
/// Wires of one run that the next is given, for registrations that are repeated.
const FIRST: [&str; 3] = ["bone", "scan", "coarse"];

type Wires = BTreeMap<String, Vec<Item>>;

impl Register {
    /// The plan of the run.
    pub fn plan(&self) -> &Plan {
        &self.checked.plan
    }

    /// The points in target and source from which it starts, if it starts from points.
    pub(crate) fn pairs(&self) -> Option<[&[NamedPoint]; 2]> {
        match &self.start {
            ReadStart::Landmarks { target, source } => Some([target, source]),
            ReadStart::Shape | ReadStart::Pose(_) => None,
        }
    }

    /// The pose from which it starts, if one is given.
    pub(crate) fn given_start(&self) -> Option<Pose> {
        match &self.start {
            ReadStart::Pose(pose) => Some(Pose::new(FRAMES[0], FRAMES[1], *pose)),
            ReadStart::Shape | ReadStart::Landmarks { .. } => None,
        }
    }

    /// As [`Self::run`], and gives the answer of the command as JSON, with every step if `with_trace`.
    ///
    /// # Errors
    /// [`Error`]; refused if the pose is, or if there is none.
    pub fn register(
        &self,
        observer: &dyn Observer,
        cancelled: &Arc<AtomicBool>,
        with_trace: bool,
    ) -> Result<serde_json::Value, Error> {
        let mut registration = self.run(observer, cancelled)?;
        if let Some(error) = registration.not_written.take() {
            return Err(error.into());
        }
        if registration.is_interrupted() {
            return Err(Error::Interrupted);
        }
        let (status, exit_code) = if registration.refusal().is_none() { ("done", 0) } else { ("refused", 3) };
        let outcome = serde_json::json!({ "status": status, "exit_code": exit_code });
        let answer = registration.to_json(self, outcome, with_trace);
        match registration.refusal() {
            Some(why) => Err(Error::Refused(why.to_owned(), answer)),
            None => Ok(answer),
        }
    }

    /// Registers, as often as the request says, and writes the files that it names.
    ///
    /// # Errors
    /// A node cannot be built. That there is no pose, or that a file cannot be written, is part of the answer.
    pub(crate) fn run(&self, observer: &dyn Observer, cancelled: &Arc<AtomicBool>) -> anyhow::Result<Registration> {
        let request = &self.request;
        let options = RunOptions { store: request.keep.store()?, ..program::options(request.workers, cancelled) };
        let mut timings = Timings { init_ms: self.init_ms, ..Timings::default() };
        let mut inputs = self.inputs();
        let mut first: Option<(RunReport, Wires)> = None;
        let mut same_bits = true;
        for _ in 0..request.repeat {
            let cpu = CpuOf { node: NODE, observer, began_ms: Mutex::default(), took_ms: Mutex::default() };
            let given = self.given(&inputs)?;
            let ran = run_with_inputs(self.plan(), &self.checked.registry, &options, &cpu, given, &|_| true);
            let (report, wires) = ran.map_err(program::run_error)?;
            timings.add(&report, first.is_none(), cpu.took_ms.into_inner().unwrap_or_else(PoisonError::into_inner));
            if report.outcome == Outcome::Interrupted {
                first = Some((report, wires));
                break;
            }
            let isometry = pose(&wires).map(|pose| pose.isometry);
            if let Some((_, first)) = &first {
                same_bits &= pose(first).map(|pose| pose.isometry) == isometry;
            }
            if first.is_none() {
                if request.repeat > 1 {
                    inputs = wires
                        .iter()
                        .filter(|(wire, _)| FIRST.contains(&node_of(wire)))
                        .map(|(wire, items)| (wire.clone(), items.clone()))
                        .collect();
                }
                first = Some((report, wires));
            }
            if isometry.is_none() {
                break;
            }
        }
        let (mut report, wires) = first.context("at least one registration is asked for")?;
        self.refuse_other_frames(&mut report, &wires);
        for input in [&request.target, &request.source] {
            name_as_stated(&mut report, &input.path);
        }
        let mut registration = self.registration(report, &wires, timings, same_bits)?;
        registration.not_written = match registration.write(self) {
            // What was asked for was wrong, which the files say only when they are read.
            Err(error) if error.is::<UsageError>() => return Err(error),
            written => written.err(),
        };
        Ok(registration)
    }

    /// Refuses a pose between other frames than those of the files, which nothing else notices where no verdict is asked for.
    fn refuse_other_frames(&self, report: &mut RunReport, wires: &Wires) {
        let Some(Err(error)) = pose(wires).map(|pose| pose.expect(&FRAMES[0].into(), &FRAMES[1].into())) else {
            return;
        };
        let node = self.plan().nodes.iter().find(|node| *node.name == *NODE);
        let location = node.map(|node| node.location.clone());
        if let (Outcome::Complete, Some(location)) = (&report.outcome, location) {
            let (node, kind, reason) = (NODE.to_owned(), self.kind_name.clone(), error.to_string());
            report.outcome = Outcome::Refused(Refusal { node, kind, item: None, location, reason, panicked: false });
        }
    }

    /// What replaces nodes: inputs in memory, a start that is given, and picked points.
    fn inputs(&self) -> Wires {
        let mut wires = Wires::new();
        let mut put = |wire: &str, body: Body| {
            wires.insert(wire.into(), vec![Item { number: 0, stamp_ns: 0, body }]);
        };
        let request = &self.request;
        if let Some(content) = in_frame(&request.target, FRAMES[0]) {
            bodies("bone", any::Out::from(content)).into_iter().for_each(|(wire, body)| put(&wire, body));
        }
        if let Some(content) = in_frame(&request.source, FRAMES[1]) {
            let (out, _) = cloud::Out::of(content, request.camera.map(|camera| camera.coords.into()));
            bodies("scan", out).into_iter().for_each(|(wire, body)| put(&wire, body));
        }
        if !self.targets.is_empty() {
            put(&format!("{TARGETS}.points"), body(Points::new(FRAMES[0], self.targets.clone())));
        }
        match &self.start {
            ReadStart::Shape => {}
            ReadStart::Pose(pose) => put("coarse.t_target_source", body(Pose::new(FRAMES[0], FRAMES[1], *pose))),
            ReadStart::Landmarks { target, source } => {
                let points = |points: &[NamedPoint], frame: &str| body(Points::new(frame, points.to_vec()));
                put("bone_points.points", points(target, FRAMES[0]));
                put("scan_points.points", points(source, FRAMES[1]));
            }
        }
        wires
    }

    fn given(&self, wires: &Wires) -> anyhow::Result<WireInputs> {
        let (plan, mut given) = (self.plan(), WireInputs::default());
        for (wire, items) in wires {
            let added = output(plan, wire).and_then(|id| given.add(plan, id, items.clone()));
            added.map_err(|message| anyhow!("{message}"))?;
        }
        Ok(given)
    }

    /// How many points are in each region of the request.
    fn cropped(&self, wires: &Wires) -> Vec<String> {
        let n_of = |wire: &str| value::<Cloud>(wires, wire).map(|cloud| cloud.len());
        let mut before = n_of("scan.cloud");
        let mut notes = Vec::new();
        for (node, option, _) in self.request.crops() {
            let after = n_of(&format!("{node}.cloud"));
            if let (Some(before), Some(after)) = (before, after) {
                notes.push(format!("{after} of {before} points are in the {option}"));
            }
            before = after;
        }
        notes
    }

    fn registration(
        &self,
        report: RunReport,
        wires: &Wires,
        timings: Timings,
        same_bits: bool,
    ) -> anyhow::Result<Registration> {
        let target: Option<Target> = value(wires, "ct_surface.target");
        let source: Option<Cloud> = value(wires, "scan.cloud");
        let pose = pose(wires).map(|pose| pose.isometry);
        let [picked, in_source] = self.pairs().unwrap_or_default();
        let is_done = report.outcome == Outcome::Complete;
        let method_report = last(wires, &format!("{NODE}.{REPORT}")).map(Value::to_result);
        let moved = match (&target, &source, &pose, &self.files.source) {
            (Some(target), Some(source), Some(pose), Some(_)) if is_done => {
                let cropped: Option<Cloud> = value(wires, "crop.cloud");
                // A plugin need not report its inliers.
                let reported = method_report.as_ref().map(|report| report["inliers_mm"].clone());
                let reported: Option<[f64; 2]> = reported.and_then(|mm| serde_json::from_value(mm).ok());
                let inliers_mm = reported.or_else(|| self.max_pair_distance_mm().map(|reach_mm| [-reach_mm, reach_mm]));
                Some(moved_source(target, source, pose, cropped.as_ref(), inliers_mm)?)
            }
            _ => None,
        };
        let [bone_report, scan_report] =
            ["bone.report", "scan.report"].map(|wire| value::<Json>(wires, wire).map(|json| (*json.0).clone()));
        let mut cropped = self.cropped(wires);
        cropped.extend(target.as_ref().and_then(|target| far_targets(target, &self.targets)));
        if let (Some(scan), Some(pose)) = (value::<Cloud>(wires, "thin.cloud"), pose) {
            let picks = if self.request.fiducials.is_some() { &[] } else { in_source };
            let of_picks = "only the other landmarks can confirm one that the surface does not";
            cropped.extend(unseen(picks, &scan, &Isometry3::identity(), of_picks));
            let of_targets = "the predicted errors hold if the bone is there as in the CT";
            cropped.extend(unseen(&self.targets, &scan, &pose, of_targets));
        }
        Ok(Registration {
            pose,
            init: value::<Pose>(wires, "coarse.t_target_source").map(|pose| pose.isometry),
            start_report: last(wires, "coarse.report").map(Value::to_result),
            report: method_report,
            icp_report: value(wires, &format!("{NODE}.{REPORT}")),
            steps: value::<IcpTrace>(wires, "icp.trace").map(|trace| trace.steps).unwrap_or_default(),
            doubt: target
                .as_ref()
                .filter(|_| self.request.fiducials.is_none())
                .and_then(|target| off_surface(target, source.as_ref(), picked, in_source)),
            has_estimated_normals: value::<Cloud>(wires, "bone.points").is_some_and(|cloud| cloud.normals().is_none()),
            is_stored: report.cached_answers.iter().any(|answer| answer.node == "ct_surface"),
            target,
            source,
            bone_report: bone_report.unwrap_or_default(),
            scan_report: scan_report.unwrap_or_default(),
            moved,
            cropped,
            written: Vec::new(),
            notes_of_files: Vec::new(),
            not_written: None,
            timings,
            same_bits,
            run: report,
        })
    }
}

/// Names a file in messages as the request does: a node knows its absolute path.
fn name_as_stated(report: &mut RunReport, path: &Path) {
    let (Ok(absolute), stated) = (std::path::absolute(path), path.display().to_string()) else { return };
    let absolute = absolute.display().to_string();
    let renamed = |text: &mut String| *text = text.replace(&absolute, &stated);
    report.warnings.iter_mut().for_each(|warning| renamed(&mut warning.message));
    if let Outcome::Refused(refusal) = &mut report.outcome {
        renamed(&mut refusal.reason);
    }
    rename_in(&mut report.results, &renamed);
}

fn rename_in(json: &mut serde_json::Value, renamed: &dyn Fn(&mut String)) {
    match json {
        serde_json::Value::String(text) => renamed(text),
        serde_json::Value::Array(values) => values.iter_mut().for_each(|value| rename_in(value, renamed)),
        serde_json::Value::Object(values) => values.values_mut().for_each(|value| rename_in(value, renamed)),
        _ => {}
    }
}

/// The content of a file in memory, in the frame that it has in the graph.
fn in_frame(input: &RegisterInput, frame: &str) -> Option<MeshOrCloud> {
    let mut content = input.content.clone()?;
    match &mut content {
        MeshOrCloud::Mesh(read) => read.mesh.frame = frame.into(),
        MeshOrCloud::Cloud(read, _) => read.cloud.frame = frame.into(),
    }
    Some(content)
}

/// What a source gives, by wire.
fn bodies<O: Outputs>(node: &str, outputs: O) -> Vec<(String, Body)> {
    let OutputPorts::Fixed(ports) = O::ports() else { return Vec::new() };
    let mut emissions = vec![Emission::Silent; ports.len()];
    outputs.put(&mut emissions);
    let body = |emission| match emission {
        Emission::Value(value) => Some(Body::Value(value)),
        Emission::Empty(reason) => Some(Body::Empty(Empty { node: node.into(), reason }.into())),
        Emission::PassedOn(_) | Emission::Silent => None,
    };
    let wires = ports.iter().map(|port| format!("{node}.{}", port.name));
    wires.zip(emissions).filter_map(|(wire, emission)| Some((wire, body(emission)?))).collect()
}

fn body<T: Payload<Table>>(value: T) -> Body {
    Body::Value(Value::new::<T, Table>(value))
}

fn node_of(wire: &str) -> &str {
    wire.split('.').next().unwrap_or(wire)
}

/// The last value of a wire.
fn last<'a>(wires: &'a Wires, wire: &str) -> Option<&'a Value> {
    wires.get(wire)?.last()?.body.value()
}

fn value<T: Payload<Table> + Clone>(wires: &Wires, wire: &str) -> Option<T> {
    last(wires, wire)?.get::<T>().cloned()
}

fn pose(wires: &Wires) -> Option<Pose> {
    value(wires, &format!("{NODE}.{POSE}"))
}

/// Measures the processor time of a node's firing, in which nothing else runs, and hands all events on.
struct CpuOf<'a> {
    node: &'static str,
    observer: &'a dyn Observer,
    began_ms: Mutex<Option<f64>>,
    took_ms: Mutex<Option<f64>>,
}

impl Observer for CpuOf<'_> {
    fn event(&self, event: &Event<'_>) {
        let set = |cell: &Mutex<Option<f64>>, ms| *cell.lock().unwrap_or_else(PoisonError::into_inner) = ms;
        match event {
            Event::Started { node } if *node == self.node => set(&self.began_ms, cpu_ms()),
            Event::Fired { node, .. } if *node == self.node => {
                let began_ms = *self.began_ms.lock().unwrap_or_else(PoisonError::into_inner);
                set(&self.took_ms, cpu_ms().zip(began_ms).map(|(now, began)| now - began));
            }
            _ => {}
        }
        self.observer.event(event);
    }
}

/// Processor time of the process, ms; `None` if the platform does not measure it.
#[cfg(unix)]
fn cpu_ms() -> Option<f64> {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    Some(time.tv_sec as f64 * 1e3 + time.tv_nsec as f64 / 1e6)
}

#[cfg(not(unix))]
fn cpu_ms() -> Option<f64> {
    None
}
