//! Saves failed firings during a run.

use super::{
    bundle::{self, Bundle, Failure, Input, Node, Program},
    items,
};
use crate::{
    options::RunOptions,
    panics,
    plan::{Plan, PlanNode},
    plugin,
    runtime::{Failed, Tap},
};
use std::{
    io,
    path::{Path, PathBuf},
    sync::{
        Mutex, OnceLock, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
};

/// Maximum number of failures saved per node; further ones are counted.
const MAX_PER_NODE: u64 = 5;
/// The folder of a run's bundles, inside the folder of the run.
pub const FOLDER: &str = "repro";

/// Bundles saved by a run.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Saved {
    /// The bundles, in the order of the plan.
    pub bundles: Vec<SavedBundle>,
    /// Failures that were not saved because their node had reached the maximum, as node and count.
    pub more: Vec<(String, u64)>,
}

/// A bundle saved by a run.
#[derive(Debug, Clone, PartialEq)]
pub struct SavedBundle {
    /// The node.
    pub node: String,
    /// Number of the firing.
    pub item: u64,
    /// The bundle's folder.
    pub dir: PathBuf,
}

/// Tap that saves the failures of a run.
pub(crate) struct Saver<'a> {
    plan: &'a Plan,
    folder: PathBuf,
    out_dir: PathBuf,
    command: serde_json::Value,
    program: OnceLock<Program>,
    /// Number of failures so far, by node.
    failed: Vec<AtomicU64>,
    saved: Mutex<Vec<(usize, SavedBundle)>>,
}

impl<'a> Saver<'a> {
    /// Saves into the run's folder; `None` if the run has none.
    pub(crate) fn new(plan: &'a Plan, options: &RunOptions) -> Option<Self> {
        let out_dir = options.out_dir.as_ref()?;
        Some(Self {
            plan,
            folder: out_dir.join(FOLDER),
            out_dir: out_dir.clone(),
            command: options.command.clone(),
            program: OnceLock::new(),
            failed: plan.nodes.iter().map(|_| AtomicU64::new(0)).collect(),
            saved: Mutex::default(),
        })
    }

    /// Saves a failed firing, unless the node has reached the maximum.
    ///
    /// # Errors
    /// Why it could not be saved.
    fn save(&self, failed: &Failed<'_>) -> Result<(), String> {
        if self.failed[failed.node].fetch_add(1, Ordering::Relaxed) >= MAX_PER_NODE {
            return Ok(());
        }
        let name = &self.plan.nodes[failed.node].name;
        let written = panics::catch(|| self.write(failed));
        let dir = written.and_then(|written| written.map_err(|error| error.to_string()));
        let dir = dir.map_err(|why| format!("its item could not be saved as a repro bundle: {why}"))?;
        let bundle = SavedBundle { node: name.to_string(), item: failed.item, dir };
        self.saved.lock().unwrap_or_else(PoisonError::into_inner).push((failed.node, bundle));
        Ok(())
    }

    /// Bundles saved, and counts of failures not saved.
    pub(crate) fn finish(self) -> Saved {
        let mut saved = self.saved.into_inner().unwrap_or_else(PoisonError::into_inner);
        saved.sort_by_key(|(node, bundle)| (*node, bundle.item));
        let more = self.plan.nodes.iter().zip(&self.failed).filter_map(|(node, failed)| {
            let n = failed.load(Ordering::Relaxed).saturating_sub(MAX_PER_NODE);
            (n > 0).then(|| (node.name.to_string(), n))
        });
        Saved { more: more.collect(), bundles: saved.into_iter().map(|(_, bundle)| bundle).collect() }
    }

    /// Writes a bundle; it gets its name only once it is complete.
    fn write(&self, failed: &Failed<'_>) -> io::Result<PathBuf> {
        let plan = self.plan;
        std::fs::create_dir_all(&self.folder)?;
        let (part, dir) = self.free(&plan.nodes[failed.node].name, failed.item)?;
        let inputs = match failed.joined {
            Some(joined) => items::write(&part.join(bundle::INPUTS), plan, failed, joined)?,
            None => Vec::new(),
        };
        let program = self.program.get_or_init(|| Program::current(self.command.clone())).clone();
        let bundle = describe(plan, failed, inputs, &self.out_dir, program);
        let mut text = serde_json::to_string_pretty(&bundle)?;
        text.push('\n');
        std::fs::write(part.join(bundle::BUNDLE), text)?;
        std::fs::write(part.join(bundle::README), readme(&bundle, &dir))?;
        std::fs::rename(&part, &dir)?;
        Ok(dir)
    }

    /// A temporary folder and the final name. Names that a file system cannot represent may collide.
    fn free(&self, node: &str, item: u64) -> io::Result<(PathBuf, PathBuf)> {
        let plain = |c: char| if c.is_alphanumeric() || "-_.".contains(c) { c } else { '_' };
        let mut stem: String = node.chars().map(plain).take(100).collect();
        if stem.starts_with('.') {
            stem.insert(0, '_');
        }
        for n in 1u32.. {
            let name = if n == 1 { format!("{stem}-{item}") } else { format!("{stem}-{item}-{n}") };
            let (part, dir) = (self.folder.join(format!("{name}.part")), self.folder.join(name));
            match std::fs::create_dir(&part) {
                Ok(()) if dir.exists() => std::fs::remove_dir(&part)?,
                Ok(()) => return Ok((part, dir)),
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
                Err(error) => return Err(error),
            }
        }
        Err(io::Error::other("no name is left for the bundle"))
    }
}

impl Tap for Saver<'_> {
    fn failed(&self, failed: &Failed<'_>) -> Option<String> {
        self.save(failed).err()
    }
}

fn describe(plan: &Plan, failed: &Failed<'_>, inputs: Vec<Input>, out_dir: &Path, program: Program) -> Bundle {
    let node = &plan.nodes[failed.node];
    Bundle {
        format_version: bundle::FORMAT_VERSION,
        graph: plan.name.clone(),
        location: format!("{}:{}", node.location.file.display(), node.location.line),
        node: Node {
            name: node.name.to_string(),
            kind: node.kind.clone(),
            role: node.role,
            table: table(plan, node),
            written: node.written(),
            plugin: plugin::with_late_loads(&plan.plugins)
                .into_iter()
                .find(|plugin| plugin.kinds.iter().any(|kind| **kind == *node.kind)),
        },
        item: failed.item,
        stamp_ns: failed.stamp_ns,
        seed: plan.seed,
        inputs,
        failure: Failure { reason: failed.reason.into(), panicked: failed.panicked },
        injected: failed.injected,
        out_dir: std::path::absolute(out_dir).unwrap_or_else(|_| out_dir.into()),
        program,
    }
}

/// The node's table: its lines of the resolved graph, from its header to the next.
fn table(plan: &Plan, node: &PlanNode) -> String {
    let header = |line: &str| line.starts_with('[') && line.ends_with(']');
    let own = [format!("[node.{}]", node.name), format!("[node.\"{}\"]", node.name)];
    let mut lines = plan.resolved.lines().skip_while(|line| !own.iter().any(|own| own == line));
    let first = lines.next();
    let lines = first.into_iter().chain(lines.take_while(|line| !header(line) && !line.is_empty()));
    lines.map(|line| format!("{line}\n")).collect()
}

fn readme(bundle: &Bundle, dir: &Path) -> String {
    let Bundle { node, graph, item, location, failure, .. } = bundle;
    let how = if failure.panicked { "panicked" } else { "failed" };
    let injected = bundle
        .injected
        .map(|how| format!("The failure was injected for a test (run --inject ...={}).\n\n", how.name()));
    format!(
        "Node \"{}\" ({}) of graph \"{graph}\" {how} at item {item}, {location}:\n\n    {}\n\n{}\
         To see it fail again, alone:\n\n    osteoflow repro {}\n\n\
         repro.json   the node, its parameters, the firing, the failure\n\
         inputs.mcap  the items that its ports had joined, exactly; /view/... shows them in viewers; a source has none\n\n\
         If it does not fail again: {}.\n",
        node.name,
        node.kind,
        failure.reason.replace('\n', "\n    "),
        injected.unwrap_or_default(),
        dir.display(),
        bundle.why_not_again(),
    )
}
