//! The graph of a bone and a scan: by the shape of the bone, or from pairs that were picked on both.

use crate::app::register::{
    TARGETS,
    two_files::{BY_SHAPE, FROM_PAIRS},
};
use anyhow::{Context, Result};
use osteoflow_formats::{Space, picked_points::write_mrk_json, pose_log::poses_csv::write_poses};
use osteoflow_geometry::{NamedPoint, Pose};
use std::{
    fs,
    path::{Path, PathBuf},
};
use tempfile::TempDir;

const BASE: &str = "two_files.toml";
const GRAPH: &str = "graph.toml";
/// The graph that starts at the pose of a file.
const AT_POSE: &str = r#"
extends = "two_files.toml"
remove = ["node.coarse.in", "node.verdict.in.start", "results.start"]
[node.coarse]
kind = "acquire.poses"
path = "start.csv"
out.t_target_source = { type = "geometry/Pose", to = "ct", from = "camera" }
"#;

/// The graph in a temporary folder.
#[derive(Debug)]
pub(crate) struct TwoFiles(TempDir);

impl TwoFiles {
    /// By shape alone.
    ///
    /// # Errors
    /// The system has no place for temporary files.
    pub(crate) fn new() -> Result<Self> {
        let folder = Self(tempfile::tempdir().context("a temporary folder cannot be made")?);
        for name in [BASE, GRAPH] {
            let path = folder.0.path().join(name);
            fs::write(&path, BY_SHAPE).with_context(|| format!("{} cannot be written", path.display()))?;
        }
        Ok(folder)
    }

    /// The graph file.
    pub(crate) fn graph(&self) -> PathBuf {
        self.0.path().join(GRAPH)
    }

    /// Starts the registration from pairs of points in bone and scan.
    ///
    /// # Errors
    /// A sentence for the user.
    pub(crate) fn start_from(&self, pairs: [&[NamedPoint]; 2]) -> Result<(), String> {
        let files = ["bone_points.mrk.json", "scan_points.mrk.json"].map(|name| self.0.path().join(name));
        for (file, points) in files.iter().zip(pairs) {
            write_mrk_json(file, points, Space::Lps).map_err(|error| error.to_string())?;
        }
        self.start_from_pairs(&files[0], &files[1])
    }

    /// Starts the registration from two files of picked points, matched by name.
    ///
    /// # Errors
    /// A sentence for the user.
    pub(super) fn start_from_pairs(&self, bone: &Path, scan: &Path) -> Result<(), String> {
        let mut graph: toml_edit::DocumentMut = FROM_PAIRS.parse().map_err(|error| format!("{error}"))?;
        graph["extends"] = BASE.into();
        for (node, path) in [("bone_points", bone), ("scan_points", scan)] {
            graph["node"][node]["path"] = path.display().to_string().into();
        }
        self.change(&graph.to_string())
    }

    /// The setting by which the error is predicted at these points, if there are any.
    ///
    /// # Errors
    /// A sentence for the user.
    pub(crate) fn targets(&self, points: &[NamedPoint]) -> Result<Option<String>, String> {
        let file = self.0.path().join("targets.mrk.json");
        if points.is_empty() {
            return Ok(None);
        }
        write_mrk_json(&file, points, Space::Lps).map_err(|error| error.to_string())?;
        Ok(Some(format!("{TARGETS}.path={}", toml::Value::from(file.display().to_string()))))
    }

    /// Starts the registration at a pose.
    ///
    /// # Errors
    /// A sentence for the user.
    pub(crate) fn start_at(&self, pose: Pose) -> Result<(), String> {
        write_poses(&self.0.path().join("start.csv"), &[pose]).map_err(|error| error.to_string())?;
        self.change(AT_POSE)
    }

    /// Replaces the graph in one step, as it is watched.
    fn change(&self, graph: &str) -> Result<(), String> {
        let next = self.0.path().join("next.toml");
        let written = fs::write(&next, graph).and_then(|()| fs::rename(&next, self.graph()));
        written.map_err(|error| format!("the graph cannot be changed: {error}"))
    }
}
