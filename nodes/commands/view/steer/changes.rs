//! What the user changes on the page: settings on top of the graph file, until they are written into it.

use super::write_back;
use crate::app::{GraphArgs, with_causes};
use crate::commands::common::serve;
use osteoflow_engine::{
    Checked, Fault, Faults, Severity, check, check_text,
    plan::{Plan, PlanNode},
    plugin::Kinds,
};
use osteoflow_report::format::shell_word;
use osteoflow_viewer::Role;
use serde_json::{Value, json};
use std::{
    path::{Component, Path, PathBuf},
    sync::{Mutex, MutexGuard, PoisonError},
};

/// Attempts to check a change; each takes away the keys that the last one found unknown.
const MAX_ATTEMPTS: usize = 3;

/// The changes to a graph, shared by the thread that runs it and those that serve the page.
#[derive(Debug)]
pub(super) struct Changes {
    graph: GraphArgs,
    /// Why nothing can be written into the graph file.
    no_file: Option<&'static str>,
    /// Where the page saves what is picked on it.
    picks: PathBuf,
    edits: Mutex<Edits>,
}

#[derive(Debug, Clone, Default)]
struct Edits {
    /// Values by key, such as `icp.max_iterations`, in the order in which they were first set.
    values: Vec<(String, toml::Value)>,
    /// Keys of the file that a changed kind does not have, as `remove` takes them.
    removed: Vec<String>,
    /// Increases with each change.
    count: u64,
    /// Why nothing can be changed.
    fixed: Option<String>,
}

impl Changes {
    pub(super) fn new(graph: GraphArgs, no_file: Option<&'static str>, picks: PathBuf) -> Self {
        Self { graph, no_file, picks, edits: Mutex::default() }
    }

    fn edits(&self) -> MutexGuard<'_, Edits> {
        self.edits.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Increases with each change.
    pub(super) fn count(&self) -> u64 {
        self.edits().count
    }

    /// Refuses all further changes.
    pub(super) fn fix(&self, why: String) {
        self.edits().fixed = Some(why);
    }

    /// Whether nothing can be changed.
    pub(super) fn is_fixed(&self) -> bool {
        self.edits().fixed.is_some()
    }

    /// The graph as it is now, with the settings of the command line and those of the page.
    pub(super) fn graph(&self) -> GraphArgs {
        self.graph_with(&self.edits())
    }

    fn graph_with(&self, edits: &Edits) -> GraphArgs {
        let mut graph = self.graph.clone();
        graph.sets.extend(edits.sets());
        graph
    }

    fn kinds(&self) -> Result<Kinds, Problem> {
        self.graph.plugins.kinds_apart().map_err(Problem::Other)
    }

    fn check_with(&self, edits: &Edits, kinds: &Kinds) -> Result<Checked, Problem> {
        let GraphArgs { graph, sets, .. } = self.graph_with(edits);
        check(&graph, &sets, kinds).map_err(Problem::Faults)
    }

    /// Sets keys as the page asks, which anybody may do who has its address: no path outside of the folders of the graph and of the picks
    /// that the graph does not name without the page, and no code but that of its plugins. Of a role that only steers less, see
    /// [`steers`].
    ///
    /// # Errors
    /// As [`Self::set`].
    pub(super) fn ask(&self, values: &[(String, Value)], role: Role) -> Result<Value, String> {
        // A module is read to check it, so a text that may lead to one is looked at before.
        values.iter().try_for_each(|(key, value)| self.check_texts(key, value))?;
        let kinds = self.kinds().map_err(|problem| problem.to_string())?;
        let by_itself = check(&self.graph.graph, &self.graph.sets, &kinds).map(|checked| checked.plan).ok();
        let (plugins, files) =
            by_itself.as_ref().map(|plan| (plan.plugins.clone(), plan.input_files.clone())).unwrap_or_default();
        let permit = |checked: &Checked| {
            if role < Role::Write {
                steers(by_itself.as_ref(), checked, values)?;
            }
            let mut named = checked.plan.nodes.iter().flat_map(|node| node.files.iter().map(|file| (&node.name, file)));
            let outside = named.find(|(_, file)| !files.contains(file) && !self.is_inside(file));
            outside.map_or(Ok(()), |(node, file)| Err(self.outside(node, file)))
        };
        self.set_of(values, &kinds.only(&plugins), &permit)
    }

    /// Refuses a text that leads out of the folders of the graph and of the picks, from the graph or from the current folder.
    fn check_texts(&self, key: &str, value: &Value) -> Result<(), String> {
        match value {
            Value::String(text) => {
                let (from_graph, from_here) = (self.folder().join(text), Path::new(text));
                if self.is_inside(&from_graph) && (!from_here.is_file() || self.is_inside(from_here)) {
                    return Ok(());
                }
                Err(self.outside(key, from_here))
            }
            Value::Array(items) => items.iter().try_for_each(|item| self.check_texts(key, item)),
            Value::Object(entries) => entries.values().try_for_each(|item| self.check_texts(key, item)),
            _ => Ok(()),
        }
    }

    fn folder(&self) -> &Path {
        self.graph.graph.parent().unwrap_or(Path::new(""))
    }

    fn is_inside(&self, path: &Path) -> bool {
        let path = real(path);
        [self.folder(), &self.picks].into_iter().any(|allowed| path.starts_with(real(allowed)))
    }

    fn outside(&self, what: &str, path: &Path) -> String {
        let (path, folder) = (path.display(), real(self.folder()));
        format!(
            "{what}: {path} leads out of the graph's folder, {}, which the page may not; write it into the graph file, or start with --set",
            folder.display()
        )
    }

    /// Sets keys, all of them or none. A value of null takes a change back. Keys that a new kind does not have are taken away.
    ///
    /// # Errors
    /// A sentence for the user; nothing has changed then.
    pub(super) fn set(&self, values: &[(String, Value)]) -> Result<Value, String> {
        self.set_of(values, &self.kinds().map_err(|problem| problem.to_string())?, &|_| Ok(()))
    }

    fn set_of(
        &self,
        values: &[(String, Value)],
        kinds: &Kinds,
        permit: &dyn Fn(&Checked) -> Result<(), String>,
    ) -> Result<Value, String> {
        let mut edits = self.edits();
        if let Some(why) = &edits.fixed {
            return Err(why.clone());
        }
        let mut trial = edits.clone();
        for (key, value) in values {
            trial.set(key, value)?;
        }
        trial.removed.clear();
        for _ in 0..MAX_ATTEMPTS {
            let faults = match self.check_with(&trial, kinds) {
                Ok(checked) => {
                    permit(&checked)?;
                    trial.count += 1;
                    *edits = trial;
                    return Ok(self.describe_with(&edits));
                }
                Err(Problem::Faults(faults)) => faults,
                Err(Problem::Other(error)) => return Err(with_causes(&error)),
            };
            let unknown: Option<Vec<String>> = errors(&faults).map(|fault| fault.removes.clone()).collect();
            let Some(unknown) = unknown.filter(|all| all.iter().all(|key| !trial.removed.contains(key))) else {
                return Err(sentence(&faults));
            };
            trial.removed.extend(unknown);
        }
        Err("the graph has faults with this change".into())
    }

    /// Takes all changes back.
    ///
    /// # Errors
    /// A sentence for the user.
    pub(super) fn revert(&self) -> Result<Value, String> {
        let mut edits = self.edits();
        if let Some(why) = &edits.fixed {
            return Err(why.clone());
        }
        *edits = Edits { count: edits.count + 1, ..Edits::default() };
        Ok(self.describe_with(&edits))
    }

    /// Writes the changes into the graph file, whose comments and order stay. The file must then say what the page shows.
    ///
    /// # Errors
    /// A sentence for the user; the file is as it was.
    pub(super) fn write(&self) -> Result<Value, String> {
        let mut edits = self.edits();
        if let Some(why) = self.no_file {
            return Err(why.into());
        }
        if edits.values.is_empty() {
            return Err("nothing was changed".into());
        }
        let kinds = self.kinds().map_err(|problem| problem.to_string())?;
        let wanted = self.check_with(&edits, &kinds).map_err(|problem| problem.to_string())?.plan.resolved;
        let path = &self.graph.graph;
        let before = osteoflow_engine::regular(path)
            .and_then(std::fs::read_to_string)
            .map_err(|error| format!("{} cannot be read: {error}", path.display()))?;
        let text = write_back::edited(&before, path, &edits.values, &edits.removed)?;
        let written = check_text(&text, path, &self.graph.sets, &kinds);
        let written = written.map_err(|faults| format!("the file would have a fault: {}", sentence(&faults)))?;
        if written.plan.resolved != wanted {
            let message = "the file would not say what the page shows: a --set of the command line, or a module, sets the same key";
            return Err(format!("{message}; change {} by hand", path.display()));
        }
        write_back::replace(path, &before, &text)?;
        *edits = Edits { count: edits.count + 1, ..Edits::default() };
        Ok(self.describe_with(&edits))
    }

    /// Replaces the values of keys that were changed.
    pub(super) fn overlay(&self, all: &mut [(String, Value)]) {
        for (key, value) in &self.edits().values {
            let known = all.iter_mut().find(|(name, _)| name == key);
            known.into_iter().for_each(|(_, old)| *old = json!(value));
        }
    }

    /// The changes for the page: keys with their values, and the command that makes the same run.
    pub(super) fn describe(&self) -> Value {
        self.describe_with(&self.edits())
    }

    fn describe_with(&self, edits: &Edits) -> Value {
        let values: Vec<_> = edits.values.iter().map(|(key, value)| json!([key, value])).collect();
        let sets = edits.sets().map(|set| format!(" --set {}", shell_word(&set))).collect::<String>();
        json!({
            "values": values,
            "removed": edits.removed,
            "settings": sets.trim_start(),
            "fixed": edits.fixed,
            "no_file": self.no_file,
            "file": self.graph.graph.file_name().map(|name| name.to_string_lossy()),
        })
    }

    pub(super) fn path(&self) -> &Path {
        &self.graph.graph
    }
}

/// Refuses what is more than steering: of the nodes that the graph has by itself, numbers, switches, words of a choice, and kinds of the
/// same stage and role. A text that is free may be a path, an address or a wire.
fn steers(by_itself: Option<&Plan>, after: &Checked, values: &[(String, Value)]) -> Result<(), String> {
    let shown = serve::graph_json(&after.plan, &after.registry);
    let of =
        |list: &Value, name: &str| list.as_array().and_then(|all| all.iter().find(|row| row["name"] == name).cloned());
    for (key, value) in values.iter().filter(|(_, value)| has_text(value)) {
        let key_of = |node: &PlanNode| {
            let key = key.strip_prefix("node.").unwrap_or(key);
            key.strip_prefix(&*node.name)?.strip_prefix('.').map(str::to_owned)
        };
        let is_offered = |node: &PlanNode, param: &str| {
            let row = of(&shown["nodes"], &node.name)?;
            let words =
                if param == "kind" { row["kinds"].clone() } else { of(&row["params"], param)?["words"].clone() };
            let before = by_itself?.nodes.iter().find(|before| before.name == node.name)?;
            let is_alike = before.role == node.role && serve::stage(&before.kind) == serve::stage(&node.kind);
            Some(is_alike && words.as_array()?.contains(value))
        };
        let node = after.plan.nodes.iter().find_map(|node| Some((node, key_of(node)?)));
        if node.is_none_or(|(node, param)| is_offered(node, &param) != Some(true)) {
            return Err(format!(
                "{key}: {value} is no number, switch, word of a choice or kind that the page offers for a node, and needs the role write; \
                 this address may only steer; start again with --role write for one that may"
            ));
        }
    }
    Ok(())
}

fn has_text(value: &Value) -> bool {
    match value {
        Value::String(_) => true,
        Value::Array(items) => items.iter().any(has_text),
        Value::Object(entries) => entries.values().any(has_text),
        _ => false,
    }
}

/// A path without links, `.` and `..`, as far as it is there. The folder of `graph.toml` is the current one.
fn real(path: &Path) -> PathBuf {
    let path = if path == Path::new("") { Path::new(".") } else { path };
    let absolute = std::path::absolute(path).unwrap_or_else(|_| path.into());
    let mut out = PathBuf::new();
    for part in absolute.components() {
        match part {
            Component::ParentDir => drop(out.pop()),
            part => out.push(part),
        }
        out = out.canonicalize().unwrap_or(out);
    }
    out
}

impl Edits {
    /// The changes as `--set` takes them.
    fn sets(&self) -> impl Iterator<Item = String> {
        let removed = (!self.removed.is_empty()).then(|| {
            let keys: Vec<toml::Value> = self.removed.iter().map(|key| key.as_str().into()).collect();
            format!("remove={}", toml::Value::from(keys))
        });
        removed.into_iter().chain(self.values.iter().map(|(key, value)| format!("{key}={value}")))
    }

    fn set(&mut self, key: &str, value: &Value) -> Result<(), String> {
        let is_key =
            |part: &str| !part.is_empty() && part.chars().all(|c| c.is_alphanumeric() || matches!(c, '_' | '-' | '/'));
        if key.split('.').count() < 2 || !key.split('.').all(is_key) {
            return Err(format!("\"{key}\" is no key such as icp.max_iterations"));
        }
        let known = self.values.iter().position(|(of, _)| of == key);
        if value.is_null() {
            known.map(|at| self.values.remove(at));
            return Ok(());
        }
        let value = toml::Value::try_from(value).map_err(|error| format!("{key}: {error}"))?;
        match known {
            Some(at) => self.values[at].1 = value,
            None => self.values.push((key.into(), value)),
        }
        Ok(())
    }
}

/// Why a graph cannot be run.
#[derive(Debug)]
pub(super) enum Problem {
    Faults(Faults),
    Other(anyhow::Error),
}

impl std::fmt::Display for Problem {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Faults(faults) => f.write_str(&sentence(faults)),
            Self::Other(error) => f.write_str(&with_causes(error)),
        }
    }
}

fn errors(faults: &Faults) -> impl Iterator<Item = &Fault> {
    faults.0.iter().filter(|fault| fault.severity == Severity::Error)
}

/// The errors without their places, which the page does not show.
pub(super) fn sentence(faults: &Faults) -> String {
    let one = |fault: &Fault| {
        let more = fault.notes.iter().chain(&fault.help).map(|text| format!("; {text}"));
        fault.message.clone() + &more.collect::<String>()
    };
    errors(faults).map(one).collect::<Vec<_>>().join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::app::Plugins;

    #[test]
    fn the_folder_of_a_graph_in_the_current_one_does_not_hold_all_files() {
        let here = std::env::current_dir().unwrap().canonicalize().unwrap();
        for graph in ["graph.toml", "./graph.toml"] {
            let graph = GraphArgs { graph: graph.into(), sets: Vec::new(), plugins: Plugins::default() };
            let changes = Changes::new(graph, None, "picks".into());
            for inside in ["", "x.stl", "a/../x.stl", "picks/plan.json"] {
                assert!(changes.is_inside(Path::new(inside)) && changes.is_inside(&here.join(inside)), "{inside}");
            }
            for outside in ["/", "/etc/passwd", "..", "../x.stl", "a/../../x.stl"] {
                assert!(!changes.is_inside(Path::new(outside)), "{outside}");
            }
        }
    }
}
