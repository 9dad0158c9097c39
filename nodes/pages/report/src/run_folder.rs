//! The folder of a run: results, manifest, recording and the values on its wires.

use crate::ReportError;
use osteoflow_engine::{Recording, run::files};
use osteoflow_node::Registry;
use serde_json::Value as Json;
use std::path::Path;

/// The folder of a run to report on.
pub(crate) struct RunFolder {
    pub(crate) manifest: Json,
    pub(crate) results: Json,
    recording: Result<Recording, String>,
    has_recording: bool,
    registry: Registry,
}

/// Reads a JSON file of a folder.
pub(crate) fn json(path: &Path) -> Result<Json, ReportError> {
    let shown = || path.display().to_string();
    let text = osteoflow_engine::regular(path)
        .and_then(std::fs::read_to_string)
        .map_err(|source| ReportError::Read { path: shown(), source })?;
    serde_json::from_str(&text).map_err(|e| ReportError::Form { path: shown(), what: e.to_string() })
}

impl RunFolder {
    /// Opens a run's folder; a recording that is missing or damaged is reported by the methods that need it.
    pub(crate) fn open(dir: &Path, registry: &Registry) -> Result<Self, ReportError> {
        let manifest = json(&dir.join(files::MANIFEST))?;
        let results = match json(&dir.join(files::RESULTS)) {
            // A run that was refused or interrupted may have none; its manifest says why.
            Err(ReportError::Read { .. }) => Json::Null,
            results => results?,
        };
        let path = dir.join(files::RECORDING);
        let has_recording = path.is_file();
        let recording = match has_recording {
            true => Recording::open(&path).map_err(|e| e.to_string()),
            false => {
                Err(format!("the run was not recorded ({} is missing); run it without --no-record", files::RECORDING))
            }
        };
        let registry = recording.as_ref().map_or_else(|_| registry.clone(), |recording| recording.registry(registry));
        Ok(Self { manifest, results, recording, has_recording, registry })
    }

    /// What is wrong with the files of the run: a recording that is damaged or cannot be read, or results that are not
    /// those of the recording.
    pub(crate) fn fault(&self) -> Option<String> {
        let recording = match &self.recording {
            Ok(recording) => recording,
            Err(error) => return self.has_recording.then(|| error.clone()),
        };
        let damage = recording.truncated.as_ref().or(recording.unsound.as_ref());
        if let Some(damage) = damage {
            return Some(format!("{}: {damage}", files::RECORDING));
        }
        let differ = recording.results.as_ref().is_some_and(|results| *results != self.results);
        differ.then(|| format!("{} holds other results than {}", files::RESULTS, files::RECORDING))
    }

    /// The file of the recording.
    ///
    /// # Errors
    /// The reason why there is none.
    pub(crate) fn recording_path(&self) -> Result<&Path, String> {
        self.recording.as_ref().map(|recording| recording.path.as_path()).map_err(Clone::clone)
    }

    /// The payloads that the recording may have.
    pub(crate) fn registry(&self) -> &Registry {
        &self.registry
    }

    pub(crate) fn is_simulated(&self) -> bool {
        self.results["simulated"] == true
    }

    /// Names and kinds of the nodes, in topological order.
    pub(crate) fn nodes(&self) -> impl Iterator<Item = (&str, &str)> {
        let nodes = self.manifest["nodes"].as_array().into_iter().flatten();
        nodes.filter_map(|node| Some((node["name"].as_str()?, node["kind"].as_str()?)))
    }

    /// The wire that is connected to an input.
    pub(crate) fn wire_into(&self, node: &str, port: &str) -> Option<&str> {
        let links = self.manifest["links"].as_array()?;
        let link = links
            .iter()
            .find(|link| link["to"].as_str().and_then(|to| to.rsplit_once('.')).is_some_and(|to| to == (node, port)));
        link?["from"].as_str()
    }

    /// All nodes with these inputs wired.
    pub(crate) fn nodes_with(&self, ports: &[&str]) -> impl Iterator<Item = &str> {
        self.nodes().map(|(name, _)| name).filter(|node| ports.iter().all(|port| self.wire_into(node, port).is_some()))
    }

    /// The first node of a kind.
    pub(crate) fn node_of_kind(&self, kind: &str) -> Option<&str> {
        self.nodes().find(|(_, of)| *of == kind).map(|(name, _)| name)
    }

    /// The first value of a wire.
    ///
    /// # Errors
    /// The reason why there is none, and what to do about it.
    pub(crate) fn value<T: Clone + 'static>(&self, wire: &str) -> Result<T, String> {
        let recording = self.recording.as_ref().map_err(Clone::clone)?;
        if !recording.wires.contains_key(wire) {
            return Err(format!("the wire {wire} was not recorded; add \"{wire}\" to wires in [record] of the graph"));
        }
        let items = recording.items(wire, &self.registry).map_err(|e| e.to_string())?;
        let value = items.iter().find_map(|item| item.body.value()?.get::<T>().cloned());
        value.ok_or_else(|| format!("the wire {wire} carried no values"))
    }

    /// The first value of the wire that is connected to an input.
    pub(crate) fn input<T: Clone + 'static>(&self, node: &str, port: &str) -> Result<T, String> {
        let wire = self.wire_into(node, port).ok_or_else(|| format!("nothing is wired to {node}.{port}"))?;
        self.value(wire)
    }
}
