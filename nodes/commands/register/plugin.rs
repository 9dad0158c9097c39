//! Registration by a kind of a plugin: a graph of one node, whose inputs are given.

use super::{
    UsageError,
    align::{Fit, NoFit, Report},
    inputs::{SOURCE, TARGET},
};
use crate::app::{program, refusal_in_short};
use crate::commands::common::{plugins::PluginArgs, progress::Progress};
use anyhow::Result;
use clap::Args;
use osteoflow_algorithms::target::Target;
use osteoflow_engine::{
    check::{Checked, check_recorded},
    given::{Given, output, run_given},
    plan::PlanPlugin,
    plugin::{Kinds, Known},
    run::{Outcome, RunOptions},
};
use osteoflow_geometry::{Cloud, Pose, nalgebra::Isometry3};
use osteoflow_node::{Body, Item, Kind, OutputPorts, Value};
use osteoflow_payloads::Table;
use std::{
    num::NonZeroUsize,
    path::Path,
    sync::{Arc, atomic::AtomicBool},
};

/// Name of the node in messages.
pub(super) const NODE: &str = "register";
const POSE: &str = "t_target_source";
const REPORT: &str = "report";
/// Ports that a kind needs to be a registration.
const INPUTS: [&str; 3] = ["source", "target", "init"];

/// A plugin in place of a method.
#[derive(Debug, Args)]
pub(crate) struct ByPlugin {
    #[command(flatten)]
    plugins: PluginArgs,

    /// Which kind of --plugin registers, if it has several.
    #[arg(long, value_name = "STAGE.KIND", requires = "plugins", conflicts_with = "method")]
    kind: Option<String>,
}

fn has_output(kind: &Kind, name: &str) -> bool {
    matches!(&kind.description.outputs, OutputPorts::Fixed(ports) if ports.iter().any(|port| port.name == name))
}

/// A checked kind of a plugin.
#[derive(Debug, Clone)]
pub(super) struct PluginMethod {
    checked: Arc<Checked>,
    pub(super) kind: Arc<str>,
    workers: Option<NonZeroUsize>,
}

impl ByPlugin {
    /// The kinds, what is known of them, and the name of the one that registers; `None` if no plugin is named.
    ///
    /// # Errors
    /// [`UsageError`] if a library is refused, or has no registration, or several of which none is named.
    pub(super) fn find(&self) -> Result<Option<(Kinds, Known, String)>> {
        if self.plugins.files().is_empty() {
            return Ok(None);
        }
        let kinds = self.plugins.kinds_apart()?;
        let known = kinds.known();
        if let Some(refused) = known.refused.iter().find(|refused| refused.is_asked()) {
            return Err(UsageError(format!("{}: {}", refused.path.display(), refused.why)).into());
        }
        let of_plugins = known.registry.kinds().filter(|kind| known.of_kind(kind.description.kind).is_some());
        let registers = |kind: &&Kind| {
            let has = |name: &str| kind.description.inputs.iter().any(|port| port.name == name);
            INPUTS.iter().all(|name| has(name)) && has_output(kind, POSE)
        };
        let found: Vec<&Kind> = match &self.kind {
            None => of_plugins.filter(registers).collect(),
            Some(name) => of_plugins.filter(|kind| kind.description.kind == name.as_str()).collect(),
        };
        let names = |found: &[&Kind]| found.iter().map(|kind| kind.description.kind).collect::<Vec<_>>().join(", ");
        let message = match (&found[..], &self.kind) {
            ([one], _) => {
                let name = one.description.kind.to_owned();
                return Ok(Some((kinds, known, name)));
            }
            ([], Some(name)) => format!("--kind: the plugin has no kind \"{name}\"; osteoflow inspect lists its kinds"),
            ([], None) => format!(
                "--plugin: no kind of it is a registration, which has the inputs {} and the output {POSE}",
                INPUTS.join(", ")
            ),
            _ => format!("--plugin: several kinds of it register: {}; name one with --kind", names(&found)),
        };
        Err(UsageError(message).into())
    }
}

impl PluginMethod {
    /// Checks the kind's ports and the settings, each `KEY=VALUE`.
    ///
    /// # Errors
    /// [`osteoflow_engine::Faults`].
    pub(super) fn new(
        kinds: &Kinds,
        kind: &Kind,
        sets: &[String],
        seed: u64,
        workers: Option<NonZeroUsize>,
    ) -> Result<Self> {
        let name = kind.description.kind;
        let has_report = has_output(kind, REPORT);
        let report = if has_report { format!("{REPORT} = \"{NODE}.{REPORT}\"\n") } else { String::new() };
        let text = format!(
            r#"
            [graph]
            format = 1
            name = "{NODE}"
            seed = {seed}
            [node.mesh]
            kind = "surface.file"
            path = "target"
            frame = "{TARGET}"
            [node.target]
            kind = "surface.prepare"
            in = {{ mesh = "mesh.mesh" }}
            [node.source]
            kind = "acquire.cloud"
            path = "source"
            frame = "{SOURCE}"
            [node.init]
            kind = "coarse.global"
            in = {{ cloud = "source.cloud", surface = "target.target" }}
            [node.{NODE}]
            kind = "{name}"
            in = {{ source = "source.cloud", target = "target.target", init = "init.{POSE}" }}
            [results]
            {POSE} = "{NODE}.{POSE}"
            {report}"#
        );
        let sets: Vec<String> = sets.iter().map(|set| format!("{NODE}.{set}")).collect();
        let checked = check_recorded(&text, Path::new("register --plugin"), &sets, kinds)?;
        Ok(Self { checked: Arc::new(checked), kind: name.into(), workers })
    }

    /// The plugin's file, name and SHA-256.
    pub(super) fn plugin(&self) -> Option<&PlanPlugin> {
        self.checked.plan.plugins.first()
    }

    pub(super) fn register(
        &self,
        target: &Target,
        source: &Cloud,
        init: &Isometry3<f64>,
        cancelled: &Arc<AtomicBool>,
    ) -> Result<Fit, NoFit> {
        let refused = |why: String| NoFit::Refused(why);
        let plan = &self.checked.plan;
        let mut given = Given::default();
        let init = Pose::new(TARGET, SOURCE, *init);
        let items = [
            ("mesh.mesh", None),
            ("target.target", Some(Value::new::<Target, Table>(target.clone()))),
            ("source.cloud", Some(Value::new::<Cloud, Table>(source.clone()))),
            ("init.t_target_source", Some(Value::new::<Pose, Table>(init))),
        ];
        for (wire, value) in items {
            let items = value.map(|value| Item { number: 0, stamp_ns: 0, body: Body::Value(value) });
            output(plan, wire).and_then(|wire| given.add(plan, wire, items.into_iter().collect())).map_err(refused)?;
        }
        let options = RunOptions { record: false, ..program::options(self.workers, cancelled) };
        let of_node = |wire: &str| wire.starts_with(NODE);
        let ran = run_given(plan, &self.checked.registry, &options, &Progress::hidden(), given, &of_node);
        let (report, wires) = ran.map_err(|error| refused(error.to_string()))?;
        match &report.outcome {
            Outcome::Complete => {}
            Outcome::Interrupted => return Err(NoFit::Cancelled),
            Outcome::Refused(refusal) => return Err(refused(refusal_in_short(refusal, &report.results))),
        }
        let value = |port: &str| match wires.get(&format!("{NODE}.{port}"))?.last()?.body {
            Body::Value(ref value) => Some(value.clone()),
            Body::Empty(_) => None,
        };
        let pose = value(POSE).and_then(|value| value.get::<Pose>().cloned());
        let pose = pose.ok_or_else(|| refused(format!("node \"{NODE}\" gave no {POSE}")))?;
        let t_target_source = pose
            .expect(&TARGET.into(), &SOURCE.into())
            .map_err(|error| refused(format!("node \"{NODE}\": {error}")))?;
        let theirs = value(REPORT).map(|value| value.to_result());
        let warnings = report.warnings.into_iter().map(|warning| warning.message).collect();
        Ok(Fit { t_target_source, report: Report::Plugin { theirs, warnings }, steps: Vec::new() })
    }
}
