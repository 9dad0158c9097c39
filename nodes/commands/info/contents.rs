//! What a file or folder holds.

use super::{super::common::LogArgs, poses::poses};
use crate::app::{
    archive::{Entry, Index, Role, index_of},
    register::{PART_KEY, TARGET_PART},
};
use anyhow::{Result, anyhow, bail};
use osteoflow_algorithms::parts::{MAX_LISTED, Parts};
use osteoflow_algorithms::trust::room_span;
use osteoflow_formats::{
    FileError, PoseError,
    folder::ProcedureFolder,
    input,
    mcap_read::{Message, Recording, Topic as RecordedTopic},
    mesh_or_cloud::{MeshOrCloud, read_mesh_or_cloud},
    message_read::{MessageKind, read_cloud_head, read_pose_in_frame, read_transforms},
    picked_points::{PickedPoints, read_scene},
    plan_file::{plan_of_picked, read_plan},
    pose_file::read_pose,
    probe::{Kind, probe},
    region_file::read_region,
    volume::{SeriesFound, VoxelUnit, list_series, read_volume},
};
use osteoflow_geometry::{Frame, NamedPoint, Nearest, Pose, nalgebra::Point3};
use osteoflow_standard::parts::of_bone;
use serde::Serialize;
use serde_json::{Map, Value, json};
use std::{collections::BTreeSet, path::Path};

/// What a file or folder holds.
#[derive(Debug, Default)]
pub(super) struct Contents {
    kind: &'static str,
    /// One line that says what it is.
    pub(super) about: String,
    /// Keys of the JSON with their values, as far as they apply.
    pub(super) facts: Map<String, Value>,
    /// Names and values for the text.
    pub(super) lines: Vec<(&'static str, String)>,
    pub(super) topics: Vec<Topic>,
    pub(super) problems: Vec<String>,
    pub(super) notes: Vec<String>,
    /// Commands that would use it.
    pub(super) used_by: Vec<String>,
}

/// A topic of a recording.
#[derive(Debug, Serialize)]
pub(super) struct Topic {
    pub(super) name: String,
    pub(super) schema: String,
    pub(super) encoding: String,
    pub(super) n_messages: usize,
    /// Messages a second, from the first to the last.
    pub(super) rate_hz: Option<f64>,
    first_ns: Option<i64>,
    last_ns: Option<i64>,
    /// The frame of its first message, `parent -> child` for transforms.
    pub(super) frame: Option<String>,
    /// The frames of all its messages, `parent -> child` for transforms.
    frames: Vec<String>,
}

impl Contents {
    pub(super) fn new(kind: &'static str, about: impl ToString) -> Self {
        Self { kind, about: about.to_string(), ..Self::default() }
    }

    /// All of it as JSON.
    pub(super) fn to_json(&self) -> Value {
        let mut all = json!({ "kind": self.kind, "about": self.about });
        let Some(keys) = all.as_object_mut() else { return all };
        keys.extend(self.facts.clone());
        keys.extend((!self.topics.is_empty()).then(|| ("topics".to_owned(), json!(self.topics))));
        let lists = [("problems", &self.problems), ("notes", &self.notes), ("use", &self.used_by)];
        keys.extend(lists.map(|(key, list)| (key.to_owned(), json!(list))));
        all
    }

    /// Adds a fact: its key and value in the JSON, its name and value in the text.
    pub(super) fn with(
        mut self,
        key: &str,
        value: impl Serialize,
        name: &'static str,
        text: impl Into<String>,
    ) -> Self {
        self.facts.insert(key.into(), json!(value));
        self.lines.push((name, text.into()));
        self
    }

    fn with_count(self, key: &str, n: usize, name: &'static str) -> Self {
        self.with(key, n, name, n.to_string())
    }

    /// Adds a list, unless it is empty.
    pub(super) fn with_list(self, key: &str, list: Vec<String>, name: &'static str) -> Self {
        if list.is_empty() { self } else { self.with(key, &list, name, list.join(", ")) }
    }

    /// Adds the parts of a surface, or the clusters of a cloud, if there are several.
    fn with_parts(mut self, parts: &Parts) -> Self {
        let n = parts.list.len();
        let listed = &parts.list[..n.min(MAX_LISTED)];
        self.facts.insert("n_parts".into(), n.into());
        self.facts.insert("parts".into(), json!(listed));
        if n < 2 {
            return self;
        }
        let rest = if n > listed.len() {
            format!(", the {} largest of which are listed", listed.len())
        } else {
            String::new()
        };
        let gap = parts.gap_mm.map_or_else(String::new, |mm| format!(", gaps within each up to {mm:.2} mm"));
        self.lines.push(("parts", format!("{n}{gap}{rest}")));
        self.lines.extend(listed.iter().map(|part| ("", format!("{}: {}", part.number, part.describe()))));
        self
    }

    fn with_space(self, space: impl ToString) -> Self {
        self.with("space", space.to_string(), "space", space.to_string())
    }

    /// Adds the box around points: its edges, and its middle.
    fn with_box(self, points: impl IntoIterator<Item = Point3<f64>>) -> Self {
        let ends = points.into_iter().map(|p| (p, p)).reduce(|(a, b), (p, _)| (a.inf(&p), b.sup(&p)));
        let Some((min, max)) = ends else { return self };
        let (edges, centre) = (max - min, (min.coords + max.coords) * 0.5);
        let [x, y, z]: [f64; 3] = edges.into();
        let with_edges = self.with("extent_mm", [x, y, z], "extent", format!("{x:.2} x {y:.2} x {z:.2} mm"));
        let [x, y, z]: [f64; 3] = centre.into();
        with_edges.with("centre_mm", [x, y, z], "centre", format!("{x:.2}, {y:.2}, {z:.2} mm"))
    }

    fn with_verdict(self, results: &Value) -> Self {
        match results.pointer("/verdict/answer").and_then(Value::as_str) {
            Some(verdict) => self.with("verdict", verdict, "verdict", verdict),
            None => self,
        }
    }

    pub(super) fn noted(self, notes: Vec<String>) -> Self {
        Self { notes, ..self }
    }

    fn used_by<const N: usize>(self, commands: [String; N]) -> Self {
        Self { used_by: commands.into(), ..self }
    }
}

/// A run or a sweep as one file.
fn archived(file: &Path, index: Index) -> Contents {
    let Index { what, name, version, files, .. } = index;
    let what = what.name();
    let of = |which: &dyn Fn(&Entry) -> bool| {
        files.iter().filter(|entry| which(entry)).map(|entry| entry.path.clone()).collect::<Vec<_>>()
    };
    let (code, inputs_left_out) =
        (of(&|entry| matches!(entry.role, Role::Plugin | Role::Module)), of(&|entry| !entry.included));
    let inputs = of(&|entry| entry.role == Role::Input && entry.included);
    let (n_files, bytes) = (
        files.len() - inputs_left_out.len(),
        files.iter().filter(|entry| entry.included).map(|entry| entry.bytes).sum::<u64>(),
    );
    let plugins = if code.is_empty() { "" } else { " --allow-plugins" };
    let data = if inputs_left_out.is_empty() { "" } else { " --data DIR" };
    let shown = file.display();
    let used_by =
        [format!("osteoflow {what} {shown}{plugins}{data} --out again"), format!("osteoflow compare {shown} again")];
    Contents::new(
        "archive",
        format!("an archive of osteoflow export: a {what} of the graph {name}, by version {version}"),
    )
    .with_count("n_files", n_files, "files")
    .with("bytes", bytes, "unpacked", format!("{:.1} MB", bytes as f64 / 1e6))
    .with_list("code", code, "code")
    .with_list("inputs", inputs, "inputs")
    .with_list("inputs_left_out", inputs_left_out, "without")
    .used_by(used_by)
}

/// The contents of a file or folder.
///
/// # Errors
/// It is missing, or none of the known formats, or too damaged to be read in part.
pub(super) fn of(file: &Path, series: Option<&str>, log: &LogArgs) -> Result<Contents> {
    if file.is_dir() {
        return folder_of(file, series);
    }
    if let Some(index) = index_of(file)? {
        return Ok(archived(file, index));
    }
    if file.extension().is_some_and(|ending| ending == "toml") {
        return graph(file, &input::read(file)?);
    }
    Ok(match log.kind(file)? {
        Kind::Poses(format) => poses(file, format, log)?,
        Kind::Ct => volume(file, series)?,
        _ if series.is_some() => {
            let message = "--series is for a folder with DICOM series; leave it out";
            usage!("{}: {message}", file.display());
        }
        Kind::Recording => recording(file)?,
        Kind::Pose => pose(file)?,
        Kind::Points => points(file, read_scene(file)?),
        Kind::Plan => plan(file)?,
        Kind::Region => region(file)?,
        Kind::Results => {
            Contents::new("results", Kind::Results).with_verdict(&serde_json::from_slice(&input::read(file)?)?)
        }
        _ => shape(file, &input::read(file)?)?,
    })
}

/// A graph, a module, or the table of a folder of a procedure.
fn graph(file: &Path, bytes: &[u8]) -> Result<Contents> {
    let (name, text) = (file.display(), String::from_utf8_lossy(bytes));
    let table: toml::Table = match text.parse() {
        Ok(table) => table,
        Err(error) => {
            let problem = format!("it is not TOML: {}; osteoflow check {name} shows the place", error.message());
            let broken = Contents { problems: vec![problem], ..Contents::new("graph", "a graph, by its name") };
            return Ok(broken.used_by([format!("osteoflow check {name}")]));
        }
    };
    let is_graph = ["graph", "node", "extends", "module", "sweep"].iter().any(|key| table.contains_key(*key));
    if !is_graph {
        if file.file_name().is_some_and(|name| name == "procedure.toml") {
            let folder = file.parent().filter(|dir| !dir.as_os_str().is_empty()).unwrap_or(Path::new("."));
            return folder_of(folder, None);
        }
        bail!("{name}: a TOML file without [graph], [node.NAME] or extends, so no graph");
    }
    let title = table.get("graph").and_then(|graph| graph.get("name")?.as_str().map(str::to_owned));
    let nodes: Vec<String> = table
        .get("node")
        .and_then(toml::Value::as_table)
        .into_iter()
        .flatten()
        .map(|(node, of)| match of.get("kind").and_then(toml::Value::as_str) {
            Some(kind) => format!("{node} ({kind})"),
            None => node.clone(),
        })
        .collect();
    let files = match table.get("extends") {
        Some(toml::Value::String(file)) => vec![file.clone()],
        Some(toml::Value::Array(files)) => files.iter().filter_map(|f| f.as_str().map(str::to_owned)).collect(),
        _ => Vec::new(),
    };
    let about = match (table.contains_key("module"), table.contains_key("sweep"), files.is_empty()) {
        (true, ..) => "a module, which a graph uses as a node",
        (_, true, _) => "a graph with a sweep",
        (.., false) => "a graph that changes another",
        _ => "a graph",
    };
    let mut used_by =
        vec![format!("osteoflow run {name}"), format!("osteoflow check {name}"), format!("osteoflow graph {name}")];
    match (table.contains_key("module"), table.contains_key("sweep")) {
        (true, _) => used_by.drain(..1).for_each(drop),
        (_, true) => used_by.insert(0, format!("osteoflow sweep {name}")),
        _ => {}
    }
    let mut contents = Contents::new("graph", about);
    if let Some(title) = title {
        contents = contents.with("name", &title, "name", title.clone());
    }
    contents = contents.with_list("extends", files, "extends").with_count("n_nodes", nodes.len(), "nodes");
    contents.facts.insert("nodes".into(), json!(nodes));
    contents.lines.extend(nodes.into_iter().map(|node| ("", node)));
    Ok(Contents { used_by, ..contents })
}

fn shape(file: &Path, bytes: &[u8]) -> Result<Contents> {
    let name = file.display();
    Ok(match read_mesh_or_cloud(file, bytes, 1.0, "file")? {
        MeshOrCloud::Mesh(read) => {
            let parts = Parts::of_mesh(&read.mesh);
            let (_, of_parts) = of_bone(read.mesh.clone(), None)?;
            let of_parts = of_parts.into_iter().map(|note| note.replace(PART_KEY, TARGET_PART));
            Contents::new("mesh", format!("{} of triangles", Kind::Mesh))
                .with_count("n_points", read.mesh.vertices().len(), "points")
                .with_count("n_faces", read.mesh.faces().len(), "faces")
                .with_box(read.mesh.vertices().iter().copied())
                .with_space(read.space)
                .with_parts(&parts)
                .noted(read.notes.into_iter().chain(of_parts).collect())
                .used_by([
                    format!("osteoflow register {name} SCAN"),
                    format!("osteoflow run graphs/two_files.toml --set bone.path={name} --set scan.path=SCAN"),
                ])
        }
        MeshOrCloud::Cloud(read, notes) => {
            let normals = read.cloud.normals().is_some();
            let columns = read.cloud.extras().iter().map(|(column, _)| column.to_string()).collect();
            let of_room = room_span(read.cloud.points()).map(|mm| {
                format!(
                    "the points span {mm:.1} mm about the origin, near and far from it: small for a bone, but as a room has them in metres; if they are, \
                     give register --unit-mm 1000"
                )
            });
            let mut contents = Contents::new("cloud", Kind::Cloud);
            contents = contents.with_count("n_points", read.cloud.len(), "points");
            match read.n_dropped {
                0 => drop(contents.facts.insert("n_dropped".into(), 0.into())),
                n => contents = contents.with("n_dropped", n, "dropped", format!("{n}, not finite")),
            }
            contents
                .with_box(read.cloud.points().iter().copied())
                .with("normals", normals, "normals", if normals { "yes" } else { "no" })
                .with_space(read.space)
                .with_list("columns", columns, "columns")
                .with_parts(&Parts::of_points(read.cloud.points()))
                .noted(notes.into_iter().chain(of_room).collect())
                .used_by([
                    format!("osteoflow register BONE {name}"),
                    format!("osteoflow run graphs/two_files.toml --set bone.path=BONE --set scan.path={name}"),
                ])
        }
    })
}

fn points(file: &Path, read: PickedPoints) -> Contents {
    let name = file.display();
    let plan = plan_of_picked(file, &read, &[]);
    let planes = read.planes.iter().map(|plane| format!("plane {}", plane.name));
    let labels = planes.chain(read.rois.iter().map(|roi| format!("box {}", roi.name))).chain(names(&read.points));
    let lists =
        read.lists.iter().map(|list| format!("{} {:?} of {} points", list.kind, list.name, list.n_points)).collect();
    let contents = Contents::new("points", Kind::Points)
        .with_count("n_points", read.points.len(), "points")
        .with_box(read.points.iter().map(|point| point.position))
        .with_space(read.space)
        .with_list("labels", labels.collect(), "named")
        .with_list("lists", lists, "lists");
    let points = [
        format!("osteoflow register BONE SCAN --landmarks {name} POINTS_IN_SCAN"),
        format!("osteoflow convert {name} points.csv"),
    ];
    let (notes, mut used_by) = match plan {
        Ok(plan) => (plan.notes, vec![format!("osteoflow convert {name} plan.json")]),
        Err(error) if !read.planes.is_empty() => {
            (read.notes.into_iter().chain([format!("no plan yet: {error}")]).collect(), Vec::new())
        }
        Err(_) => (read.notes, Vec::new()),
    };
    used_by.extend(points.into_iter().filter(|_| !read.points.is_empty()));
    Contents { used_by, ..contents.noted(notes) }
}

fn names(points: &[NamedPoint]) -> impl Iterator<Item = String> {
    points.iter().map(|point| point.name.to_string())
}

fn pose(file: &Path) -> Result<Contents> {
    let read = read_pose(file, 1.0)?;
    let rows = osteoflow_geometry::matrix_rows(&read.isometry);
    let mut contents = Contents::new("pose", format!("{}, the translation in mm", Kind::Pose)).noted(read.notes);
    contents.facts.insert("matrix".into(), json!(rows));
    contents.lines.extend(rows.map(|row| ("", row.map(|c| format!("{c:>14.8}")).join(" "))));
    Ok(contents.used_by([format!("osteoflow register BONE SCAN --init {}", file.display())]))
}

fn region(file: &Path) -> Result<Contents> {
    let region = read_region(file)?;
    Ok(Contents::new("region", Kind::Region)
        .with_count("n_keep", region.keep.len(), "keep")
        .with_count("n_cut", region.cut.len(), "cut")
        .with_list("frames", vec![region.frame.to_string()], "frame")
        .used_by([format!("osteoflow register BONE SCAN --region {}", file.display())]))
}

fn plan(file: &Path) -> Result<Contents> {
    let read = read_plan(file)?;
    let plan = read.plan;
    let mut notes = read.notes;
    if plan.surface.is_none() {
        notes.push(format!(
            "{}: the plan does not say which surface it was drawn on; osteoflow convert {} OUT --bind BONE does",
            file.display(),
            file.display()
        ));
    }
    let labels = names(&plan.landmarks.points).chain(names(&plan.assessment.points));
    Ok(Contents::new("plan", Kind::Plan)
        .with_list("labels", labels.collect(), "named")
        .with_count("n_planes", plan.planes.planes.len(), "planes")
        .with_list("frames", vec![plan.landmarks.frame.to_string()], "frames")
        .noted(notes)
        .used_by([format!("osteoflow run graphs/fibula_recorded.toml --set plan.path={}", file.display())]))
}

fn recording(file: &Path) -> Result<Contents> {
    let (read, damaged) = match Recording::open(file, false) {
        Ok(read) => (read, None),
        // What can be read of a damaged file is shown, with what is wrong.
        Err(error) => match Recording::open(file, true) {
            Ok(read) => (read, Some(error.to_string())),
            Err(error) => bail!("{error}"),
        },
    };
    let (mut problems, notes) = match &damaged {
        None => (Vec::new(), read.notes.clone()),
        Some(error) if read.notes.is_empty() => (vec![error.clone()], Vec::new()),
        Some(_) => (read.notes.clone(), Vec::new()),
    };
    let mut notes = notes;
    notes.extend(carried_plugins(&read));
    let name = file.display();
    let is_run = read.metadata.keys().any(|key| key.starts_with("osteoflow"));
    let topics: Vec<Topic> = read.topics().iter().map(|topic| of_topic(&read, topic)).collect();
    let mut frames: Vec<String> = topics.iter().flat_map(|topic| topic.frames.clone()).collect();
    frames.sort();
    frames.dedup();
    let n_messages: usize = topics.iter().map(|topic| topic.n_messages).sum();
    if n_messages == 0 {
        problems.push("it holds no messages".into());
    }
    let used_by = match (is_run, &damaged) {
        (true, None) => vec![format!("osteoflow replay {name}"), format!("osteoflow digest {name}")],
        (true, Some(_)) => vec![format!("osteoflow recover {name} SAVED.mcap")],
        (false, _) if n_messages == 0 => Vec::new(),
        (false, _) if frames.is_empty() => {
            problems.push("no topic has clouds, transforms or poses of a schema that is read (foxglove.*, or sensor_msgs, tf2_msgs and geometry_msgs of ROS 2)".into());
            Vec::new()
        }
        (false, _) => uses_of(&read, &name.to_string(), damaged.is_some()),
    };
    let about = format!("{} with {n_messages} messages", if is_run { "a recording of a run" } else { "a recording" });
    let contents = Contents::new("recording", about).with_list("frames", frames, "frames");
    Ok(Contents { topics, problems, notes, used_by, ..contents })
}

/// The plugins whose text the recording of a run carries.
fn carried_plugins(read: &Recording) -> Option<String> {
    let (texts, plugins) = (read.metadata.get("osteoflow.plugin_texts")?, read.metadata.get("osteoflow.plugins")?);
    let n_late = read.metadata.get("osteoflow.late_plugin_texts").map_or(0, |texts| texts.len());
    let is_there = |about: &String| {
        let about: Value = serde_json::from_str(about).ok()?;
        texts.contains_key(about["sha256"].as_str()?).then_some(())
    };
    let files = plugins.iter().filter(|(_, about)| is_there(about).is_some()).map(|(path, _)| Path::new(path));
    let names: Vec<_> = files.filter_map(|path| Some(path.file_name()?.to_string_lossy().into_owned())).collect();
    Some(format!(
        "it carries the text of {} with their modules, {} files in all, which osteoflow replay runs with \
         --allow-plugins only",
        names.join(", "),
        texts.len() + n_late
    ))
}

fn of_topic(read: &Recording, topic: &osteoflow_formats::mcap_read::Topic) -> Topic {
    let messages = read.messages(&topic.name);
    let times = || messages.iter().map(|message| message.publish_time_ns);
    let (first_ns, last_ns) = (times().min(), times().max());
    let span_s = first_ns.zip(last_ns).map_or(0.0, |(first, last)| (last - first) as f64 * 1e-9);
    let rate_hz = (messages.len() > 1 && span_s > 0.0).then(|| (messages.len() - 1) as f64 / span_s);
    Topic {
        name: topic.name.clone(),
        schema: topic.schema_name.clone(),
        encoding: topic.message_encoding.clone(),
        n_messages: topic.n_messages,
        rate_hz,
        first_ns,
        last_ns,
        frame: messages.first().and_then(|message| frames(message).into_iter().next()),
        frames: Vec::from_iter(messages.iter().flat_map(frames).collect::<BTreeSet<_>>()),
    }
}

/// The frames of a message of a known schema.
fn frames(message: &Message) -> Vec<String> {
    let pair = |to: &Frame, from: &Frame| format!("{to} -> {from}");
    match MessageKind::of(&message.schema_name) {
        Some(MessageKind::Cloud) => read_cloud_head(message).map(|head| head.frame.to_string()).into_iter().collect(),
        Some(MessageKind::Transform | MessageKind::Transforms) => {
            let frames = |read: &Result<Nearest<Pose>, PoseError>| match read {
                Ok(pose) => pair(&pose.value.to, &pose.value.from),
                Err(PoseError::Lost(lost)) => pair(&lost.to, &lost.from),
                Err(PoseError::NotRigid { to, from, .. }) => pair(to, from),
            };
            read_transforms(message).map(|all| all.iter().map(frames).collect()).unwrap_or_default()
        }
        Some(MessageKind::Pose) => read_pose_in_frame(message).map(|tip| tip.frame.to_string()).into_iter().collect(),
        None => Vec::new(),
    }
}

/// The topics without which graphs/fibula_recorded.toml cannot run, with what is on them.
pub(super) const PROCEDURE: [(&str, MessageKind); 7] = [
    ("/camera/calibration", MessageKind::Cloud),
    ("/camera/scan", MessageKind::Cloud),
    ("/camera/laser_p1", MessageKind::Cloud),
    ("/camera/laser_p2", MessageKind::Cloud),
    ("/camera/laser_p3", MessageKind::Cloud),
    ("/tracker/camera_marker", MessageKind::Transform),
    ("/tracker/phantom_marker", MessageKind::Transform),
];

/// What says where the frames of a procedure have other names than in its graph.
fn renamed(read: &Recording) -> Vec<String> {
    let first = |topic: &str| read.messages(topic).iter().find_map(|message| frames(message).into_iter().next());
    let camera = first("/camera/scan").filter(|frame| frame != "camera");
    // A dot would separate keys.
    let key = |frame: &str| if frame.contains('.') { format!("frames.\"{frame}\"") } else { format!("frames.{frame}") };
    let mut sets: Vec<String> = camera.iter().map(|frame| format!("{}=camera", key(frame))).collect();
    for port in ["camera_marker", "phantom_marker", "bone_marker"] {
        let pair = first(&format!("/tracker/{port}"));
        let Some((to, from)) = pair.as_ref().and_then(|pair| pair.split_once(" -> ")) else { continue };
        if to != "world" {
            // What is touched is in this frame, too.
            let world = format!("{}=world", key(to));
            sets.extend((!sets.contains(&world)).then_some(world));
            sets.push(format!("out.{port}.parent={to}"));
        }
        if from != port {
            sets.extend([format!("{}={port}", key(from)), format!("out.{port}.child={from}")]);
        }
    }
    sets
}

/// Commands that can use a recording that is none of a run: all of a procedure, or else its clouds, or else its poses.
fn uses_of(read: &Recording, name: &str, is_damaged: bool) -> Vec<String> {
    let kind = |topic: &&RecordedTopic| MessageKind::of(&topic.schema_name).filter(|_| topic.n_messages > 0);
    let is_there = |(name, wanted): &(&str, MessageKind)| {
        read.topics().iter().any(|topic| topic.name == *name && kind(&topic) == Some(*wanted))
    };
    if PROCEDURE.iter().all(is_there) {
        let allow = if is_damaged { " --set recording.allow_truncated=true" } else { "" };
        let quote = |set: &str| if set.contains(['"', ' ']) { "'" } else { "" };
        let set = |set: &String| format!(" --set {0}recording.{set}{0}", quote(set));
        let renamed: String = renamed(read).iter().map(set).collect();
        return vec![format!("osteoflow run graphs/fibula_recorded.toml --set recording.path={name}{allow}{renamed}")];
    }
    let cloud = read.topics().iter().find(|topic| kind(topic) == Some(MessageKind::Cloud));
    let mut uses = Vec::new();
    if let Some(topic) = cloud.filter(|_| !is_damaged) {
        uses.push(format!("osteoflow convert {name} scan.ply --topic {}", topic.name));
        uses.push("osteoflow register BONE scan.ply".to_owned());
    }
    uses.push(format!("osteoflow view {name}"));
    uses
}

fn volume(file: &Path, series: Option<&str>) -> Result<Contents> {
    let read = match read_volume(file, series) {
        Ok(read) => read,
        Err(error) if series.is_none() && file.is_dir() => {
            return study(file).ok_or(error).map_err(Into::into);
        }
        Err(error) => return Err(error.into()),
    };
    let (volume, name) = (&read.volume, file.display());
    let m = &volume.t_lps_voxel;
    let edges: [f64; 3] = std::array::from_fn(|k| m.fixed_view::<3, 1>(0, k).norm());
    let at = |corner: usize| {
        let index = |k: usize| if corner >> k & 1 == 1 { volume.size[k] as f64 - 1.0 } else { 0.0 };
        m.transform_point(&Point3::new(index(0), index(1), index(2)))
    };
    let unit = if volume.unit == VoxelUnit::Hu { "HU" } else { "unknown" };
    let [nx, ny, nz] = volume.size;
    let about = format!(
        "{}, {nx} x {ny} x {nz} voxels of {:.3} x {:.3} x {:.3} mm, values in {unit}",
        Kind::Ct,
        edges[0],
        edges[1],
        edges[2]
    );
    let option = series.map_or_else(String::new, |series| format!(" --series {series}"));
    let set = series.map_or_else(String::new, |series| format!(" --set bone.series={series}"));
    let mut contents =
        Contents::new("ct", about).with_box((0..8).map(at)).with("source", &read.source, "source", &read.source);
    contents.facts.insert("size".into(), json!(volume.size));
    Ok(contents.with_space(if volume.is_oriented { "LPS" } else { "unknown" }).noted(read.notes.clone()).used_by([
        format!("osteoflow register {name} SCAN{option}"),
        format!("osteoflow convert {name} bone.stl --iso-hu HU{option}"),
        format!(
            "osteoflow run GRAPH --set bone.kind=surface.ct --set bone.path={name} --set bone.threshold_hu=HU{set}"
        ),
    ]))
}

/// The series of a folder of which several may be the CT; none if it holds no such folder.
fn study(folder: &Path) -> Option<Contents> {
    let all = list_series(folder).ok()?;
    let taken: Vec<&SeriesFound> = all.iter().filter(|series| series.why_not.is_none()).collect();
    if taken.len() < 2 {
        return None;
    }
    let name = folder.display();
    let mut contents = Contents::new("study", format!("a DICOM study, {} series of which may be the CT", taken.len()));
    for SeriesFound { name, choice, why_not } in &all {
        let line = match why_not {
            Some(why) => format!("{name}: no CT: {why}"),
            None => format!("{name}: --series {choice}"),
        };
        contents.lines.push(("series", line));
    }
    let rows = all.iter().map(|s| json!({ "name": s.name, "choice": s.choice, "why_not": s.why_not }));
    contents.facts.insert("series".into(), rows.collect());
    let choice = &taken[0].choice;
    Some(contents.used_by([
        format!("osteoflow info {name} --series {choice}"),
        format!("osteoflow register {name} SCAN --series {choice}"),
        format!("osteoflow convert {name} bone.stl --iso-hu HU --series {choice}"),
    ]))
}

fn folder_of(folder: &Path, series: Option<&str>) -> Result<Contents> {
    let name = folder.display();
    let kind = probe(folder)?.kind;
    if kind == Kind::Procedure {
        let read = ProcedureFolder::open(folder)?;
        let streams = read.streams()?;
        let mut roles: Vec<String> = streams.items.iter().map(|item| item.role.clone()).collect();
        roles.sort();
        roles.dedup();
        let about = format!("{kind}, {} items", streams.items.len());
        return Ok(Contents::new("procedure", about)
            .with_list("labels", roles, "named")
            .noted(streams.notes.into_iter().chain(streams.signs.into_iter().map(|(_, sign)| sign)).collect())
            .used_by([format!("osteoflow run graphs/fibula_folder.toml --set recording.path={name}")]));
    }
    if folder.join("manifest.json").is_file() {
        let results = osteoflow_engine::regular(folder.join("results.json")).and_then(std::fs::read).ok();
        let results: Option<Value> = results.and_then(|bytes| serde_json::from_slice(&bytes).ok());
        let mut problems = Vec::from_iter(results.is_none().then(|| "there is no readable results.json".to_owned()));
        let manifest = osteoflow_engine::regular(folder.join("manifest.json"))
            .and_then(std::fs::read)
            .map_err(|error| error.to_string());
        let manifest = manifest.and_then(|bytes| serde_json::from_slice::<Value>(&bytes).map_err(|e| e.to_string()));
        let mut used_by = Vec::new();
        match manifest {
            Ok(_) => used_by.push(format!("osteoflow report {name}")),
            Err(error) => problems.push(format!("manifest.json: {error}")),
        }
        if folder.join("run.mcap").is_file() {
            used_by.push(format!("osteoflow replay {name}/run.mcap"));
        }
        let contents = Contents::new("run", "a run").with_verdict(&results.unwrap_or_default());
        return Ok(Contents { problems, used_by, ..contents });
    }
    if kind == Kind::Recording {
        return recording(folder);
    }
    volume(folder, series).map_err(|error| match error.downcast_ref() {
        Some(FileError::Content { place, .. }) if place == "folder" => anyhow!(
            "{name}: a folder without procedure.toml, manifest.json or metadata.yaml (a ROS 2 bag), and no DICOM series: {error}; name a file or another folder"
        ),
        _ => error,
    })
}
