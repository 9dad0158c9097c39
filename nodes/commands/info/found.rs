//! What a file or folder is.

use crate::app::files::{is_volume, picked_points};
use anyhow::{Result, anyhow, bail};
use osteoflow_formats::{
    folder::ProcedureFolder,
    input,
    mcap_read::{Message, Recording},
    mesh_or_cloud::{MeshOrCloud, read_mesh_or_cloud},
    message_read::{read_cloud, read_pose_in_frame, read_transforms},
    picked_points::PickedPoints,
    plan_file::read_plan,
    pose_file::read_pose,
    volume::{VolumeOptions, VoxelUnit, read_volume},
};
use osteoflow_geometry::{NamedPoint, nalgebra::Point3};
use serde::Serialize;
use serde_json::Value;
use std::{fs, path::Path};

/// The bytes that an MCAP begins with.
const MCAP: &[u8] = b"\x89MCAP0\r\n";

/// The content of a file or folder. Keys that do not apply are left out.
#[derive(Debug, Default, Serialize)]
pub(super) struct Found {
    pub(super) kind: &'static str,
    /// One line that says what it is.
    pub(super) about: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    n_points: Option<usize>,
    #[serde(skip_serializing_if = "Option::is_none")]
    n_faces: Option<usize>,
    /// Points that are not finite.
    #[serde(skip_serializing_if = "Option::is_none")]
    n_dropped: Option<usize>,
    #[serde(skip_serializing_if = "Option::is_none")]
    extent_mm: Option<[f64; 3]>,
    /// The middle of the box around the points, mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    centre_mm: Option<[f64; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    normals: Option<bool>,
    /// Number of voxels along each axis.
    #[serde(skip_serializing_if = "Option::is_none")]
    size: Option<[usize; 3]>,
    /// LPS or RAS where the file states it.
    #[serde(skip_serializing_if = "Option::is_none")]
    space: Option<String>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    columns: Vec<String>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    labels: Vec<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    n_planes: Option<usize>,
    #[serde(skip_serializing_if = "Option::is_none")]
    matrix: Option<[[f64; 4]; 4]>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    frames: Vec<String>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(super) topics: Vec<Topic>,
    #[serde(skip_serializing_if = "Option::is_none")]
    verdict: Option<Value>,
    pub(super) problems: Vec<String>,
    pub(super) notes: Vec<String>,
    #[serde(rename = "use")]
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
}

impl Found {
    /// Names and values for the text.
    pub(super) fn lines(&self) -> Vec<(&'static str, String)> {
        let edges = |[x, y, z]: [f64; 3]| format!("{x:.2} x {y:.2} x {z:.2} mm");
        let mut lines = Vec::new();
        lines.extend(self.n_points.map(|n| ("points", n.to_string())));
        lines.extend(self.n_dropped.filter(|n| *n > 0).map(|n| ("dropped", format!("{n}, not finite"))));
        lines.extend(self.n_faces.map(|n| ("faces", n.to_string())));
        lines.extend(self.extent_mm.map(|mm| ("extent", edges(mm))));
        lines.extend(self.centre_mm.map(|[x, y, z]| ("centre", format!("{x:.2}, {y:.2}, {z:.2} mm"))));
        lines.extend(self.normals.map(|has| ("normals", if has { "yes" } else { "no" }.to_owned())));
        lines.extend(self.space.clone().map(|space| ("space", space)));
        lines.extend((!self.columns.is_empty()).then(|| ("columns", self.columns.join(", "))));
        lines.extend((!self.labels.is_empty()).then(|| ("named", self.labels.join(", "))));
        lines.extend(self.n_planes.map(|n| ("planes", n.to_string())));
        lines.extend((!self.frames.is_empty()).then(|| ("frames", self.frames.join(", "))));
        lines.extend(self.verdict.as_ref().and_then(Value::as_str).map(|verdict| ("verdict", verdict.to_owned())));
        for row in self.matrix.iter().flatten() {
            lines.push(("", row.map(|c| format!("{c:>14.8}")).join(" ")));
        }
        lines
    }

    fn with_points(mut self, points: &[Point3<f64>]) -> Self {
        self.n_points = Some(points.len());
        let Some(first) = points.first() else { return self };
        let (min, max) = points.iter().fold((*first, *first), |(a, b), p| (a.inf(p), b.sup(p)));
        self.extent_mm = Some((max - min).into());
        self.centre_mm = Some(((min.coords + max.coords) * 0.5).into());
        self
    }

    fn with_names(mut self, points: &[NamedPoint]) -> Self {
        self.labels.extend(points.iter().map(|point| point.name.to_string()));
        self
    }
}

/// Finds out what a file or folder holds.
///
/// # Errors
/// It is missing, or none of the known formats, or too damaged to be read in part.
pub(super) fn look(file: &Path) -> Result<Found> {
    if file.is_dir() {
        return folder(file);
    }
    if is_volume(file) {
        return volume(file);
    }
    let bytes = input::read(file)?;
    if bytes.is_empty() {
        bail!("{}: the file is empty", file.display());
    }
    if bytes.starts_with(MCAP) {
        return recording(file);
    }
    if bytes.starts_with(b"#Insight Transform File") || is_matrix(&bytes) {
        return pose(file);
    }
    if let Some(picked) = picked_points(file, &bytes) {
        return Ok(points(file, picked?));
    }
    if bytes.trim_ascii_start().starts_with(b"{") {
        return json(file, &bytes);
    }
    shape(file, &bytes)
}

/// Whether it is a text of 16 numbers that ends with the last row of a rigid motion.
fn is_matrix(bytes: &[u8]) -> bool {
    if bytes.len() > 4096 {
        return false;
    }
    let Ok(text) = std::str::from_utf8(bytes) else { return false };
    let lines = text.lines().filter(|line| !line.trim_start().starts_with(['#', '%']) && !line.trim().is_empty());
    let words: Vec<&str> =
        lines.flat_map(|line| line.split([' ', '\t', ',', ';', '[', ']'])).filter(|w| !w.is_empty()).collect();
    let numbers: Vec<f64> = words.iter().filter_map(|word| word.parse().ok()).collect();
    words.len() == 16 && numbers.len() == 16 && numbers[12..] == [0.0, 0.0, 0.0, 1.0]
}

fn shape(file: &Path, bytes: &[u8]) -> Result<Found> {
    let name = file.display();
    Ok(match read_mesh_or_cloud(file, bytes, 1.0, "file")? {
        MeshOrCloud::Mesh(read) => Found {
            kind: "mesh",
            about: "a surface of triangles".into(),
            n_faces: Some(read.mesh.faces().len()),
            space: Some(read.space.to_string()),
            notes: read.notes,
            used_by: vec![
                format!("osteoflow register {name} SCAN"),
                format!("osteoflow run graphs/two_files.toml --set bone.path={name} --set scan.path=SCAN"),
            ],
            ..Found::default()
        }
        .with_points(read.mesh.vertices()),
        MeshOrCloud::Cloud(read, notes) => Found {
            kind: "cloud",
            about: "a cloud of points".into(),
            n_dropped: Some(read.n_dropped),
            normals: Some(read.cloud.normals().is_some()),
            space: Some(read.space.to_string()),
            columns: read.cloud.extras().iter().map(|(column, _)| column.to_string()).collect(),
            notes,
            used_by: vec![
                format!("osteoflow register BONE {name}"),
                format!("osteoflow run graphs/two_files.toml --set bone.path=BONE --set scan.path={name}"),
            ],
            ..Found::default()
        }
        .with_points(read.cloud.points()),
    })
}

fn points(file: &Path, read: PickedPoints) -> Found {
    let name = file.display();
    let positions: Vec<Point3<f64>> = read.points.iter().map(|point| point.position).collect();
    let mut notes = read.notes;
    if read.n_skipped > 0 {
        notes.push(format!("{} points are not placed or not active, and were passed over", read.n_skipped));
    }
    let planes = read.planes.iter().map(|plane| format!("plane {}", plane.name));
    let labels = planes.chain(read.rois.iter().map(|roi| format!("box {}", roi.name))).collect();
    Found {
        kind: "points",
        about: "picked points".into(),
        labels,
        space: Some(read.space.to_string()),
        notes,
        used_by: vec![
            format!("osteoflow register BONE SCAN --landmarks {name} POINTS_IN_SCAN"),
            format!("osteoflow convert {name} points.csv"),
        ],
        ..Found::default()
    }
    .with_points(&positions)
    .with_names(&read.points)
}

fn pose(file: &Path) -> Result<Found> {
    let read = read_pose(file, 1.0)?;
    Ok(Found {
        kind: "pose",
        about: "a rigid motion, the translation in mm".into(),
        matrix: Some(osteoflow_geometry::matrix_rows(&read.isometry)),
        notes: read.notes,
        used_by: vec![format!("osteoflow register BONE SCAN --init {}", file.display())],
        ..Found::default()
    })
}

fn json(file: &Path, bytes: &[u8]) -> Result<Found> {
    let value: Value = serde_json::from_slice(bytes)
        .map_err(|error| anyhow!("{}: line {}: no JSON: {error}", file.display(), error.line()))?;
    if ["T", "t_target_source", "matrix"].iter().any(|key| value.get(key).is_some()) {
        return pose(file);
    }
    if value.get("verdict").is_some() && value.get("notice").is_some() {
        return Ok(Found {
            kind: "results",
            about: "results of a run".into(),
            verdict: value.pointer("/verdict/answer").cloned(),
            ..Found::default()
        });
    }
    let read = read_plan(file)?;
    let plan = read.plan;
    Ok(Found {
        kind: "plan",
        about: "a surgical plan".into(),
        n_planes: Some(plan.planes.planes.len()),
        frames: vec![plan.landmarks.frame.to_string()],
        notes: read.notes,
        used_by: vec![format!("osteoflow run graphs/fibula_recorded.toml --set plan.path={}", file.display())],
        ..Found::default()
    }
    .with_names(&plan.landmarks.points)
    .with_names(&plan.assessment.points))
}

fn recording(file: &Path) -> Result<Found> {
    let (read, damaged) = match Recording::open(file, false) {
        Ok(read) => (read, None),
        // What can be read of a damaged file is told, with what is wrong.
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
    let name = file.display();
    let is_run = read.metadata.keys().any(|key| key.starts_with("osteoflow"));
    let topics: Vec<Topic> = read.topics().iter().map(|topic| of_topic(&read, topic)).collect();
    let mut frames: Vec<String> = topics.iter().filter_map(|topic| topic.frame.clone()).collect();
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
        (false, _) => {
            let allow = if damaged.is_some() { " --set recording.allow_truncated=true" } else { "" };
            vec![format!("osteoflow run graphs/fibula_recorded.toml --set recording.path={name}{allow}")]
        }
    };
    let about =
        format!("{} with {n_messages} messages", if is_run { "a recording of a run" } else { "an MCAP recording" });
    Ok(Found { kind: "recording", about, frames, topics, problems, notes, used_by, ..Found::default() })
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
        frame: messages.first().and_then(frame),
    }
}

/// The frame of a message of a known schema.
fn frame(message: &Message) -> Option<String> {
    if let Ok(read) = read_cloud(message) {
        return Some(read.cloud.frame.to_string());
    }
    if let Some(Ok(pose)) = read_transforms(message).ok().and_then(|poses| poses.into_iter().next()) {
        return Some(format!("{} -> {}", pose.value.to, pose.value.from));
    }
    read_pose_in_frame(message).ok().map(|tip| tip.frame.to_string())
}

fn volume(file: &Path) -> Result<Found> {
    let read = read_volume(file, &VolumeOptions::default())?;
    let (volume, name) = (&read.volume, file.display());
    let m = &volume.t_lps_voxel;
    let edges: [f64; 3] = std::array::from_fn(|k| m.fixed_view::<3, 1>(0, k).norm());
    let at = |corner: usize| {
        let index = |k: usize| if corner >> k & 1 == 1 { volume.size[k] as f64 - 1.0 } else { 0.0 };
        m.transform_point(&Point3::new(index(0), index(1), index(2)))
    };
    let (min, max) = (1..8).fold((at(0), at(0)), |(a, b), corner| (a.inf(&at(corner)), b.sup(&at(corner))));
    let unit = if volume.unit == VoxelUnit::Hu { "HU" } else { "unknown" };
    let [nx, ny, nz] = volume.size;
    Ok(Found {
        kind: "ct",
        about: format!(
            "an image of {nx} x {ny} x {nz} voxels of {:.3} x {:.3} x {:.3} mm, values in {unit}",
            edges[0], edges[1], edges[2]
        ),
        extent_mm: Some((max - min).into()),
        centre_mm: Some(((min.coords + max.coords) * 0.5).into()),
        space: Some(if volume.is_oriented { "LPS" } else { "unknown" }.into()),
        size: Some(volume.size),
        notes: read.notes,
        used_by: vec![
            format!("osteoflow register {name} SCAN"),
            format!("osteoflow convert {name} bone.stl --iso-hu HU"),
            format!("osteoflow run GRAPH --set bone.kind=surface.ct --set bone.path={name} --set bone.threshold_hu=HU"),
        ],
        ..Found::default()
    })
}

fn folder(folder: &Path) -> Result<Found> {
    let name = folder.display();
    if folder.join("procedure.toml").is_file() {
        let read = ProcedureFolder::open(folder)?;
        let streams = read.streams()?;
        let mut roles: Vec<String> = streams.items.iter().map(|item| item.role.clone()).collect();
        roles.sort();
        roles.dedup();
        let about = format!("a procedure in files, {} items", streams.items.len());
        let used_by = vec![format!("osteoflow run graphs/fibula_folder.toml --set recording.path={name}")];
        let notes = streams.notes;
        return Ok(Found { kind: "procedure", about, labels: roles, notes, used_by, ..Found::default() });
    }
    if folder.join("manifest.json").is_file() {
        let results = fs::read(folder.join("results.json")).ok();
        let results: Option<Value> = results.and_then(|bytes| serde_json::from_slice(&bytes).ok());
        let verdict = results.as_ref().and_then(|results| results.pointer("/verdict/answer")).cloned();
        let mut problems =
            if results.is_none() { vec!["there is no readable results.json".into()] } else { Vec::new() };
        let manifest = fs::read(folder.join("manifest.json")).map_err(|error| error.to_string());
        let manifest = manifest.and_then(|bytes| serde_json::from_slice::<Value>(&bytes).map_err(|e| e.to_string()));
        let mut used_by = Vec::new();
        match manifest {
            Ok(_) => used_by.push(format!("osteoflow report {name}")),
            Err(error) => problems.push(format!("manifest.json: {error}")),
        }
        if folder.join("run.mcap").is_file() {
            used_by.push(format!("osteoflow replay {name}/run.mcap"));
        }
        return Ok(Found { kind: "run", about: "a run".into(), verdict, problems, used_by, ..Found::default() });
    }
    let is_recording = |entry: fs::DirEntry| entry.path().extension().is_some_and(|ending| ending == "mcap");
    if folder.join("metadata.yaml").is_file() || fs::read_dir(folder)?.flatten().any(is_recording) {
        return recording(folder);
    }
    volume(folder).map_err(|error| {
        anyhow!("{name}: a folder without procedure.toml, manifest.json or metadata.yaml (a ROS 2 bag), and no DICOM series: {error}; name a file or another folder")
    })
}
