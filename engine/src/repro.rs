//! Runs a failed node again, alone, on the item at which it failed.
//!
//! A run saves the item of a failure as a *repro bundle*, a folder `repro/<node>-<item>/` with three files:
//!
//! - `repro.json`: the node with its parameters, the firing (item, stamp, seed), what its ports brought, the failure,
//!   and the program that failed ([`Bundle`]);
//! - `inputs.mcap`: the joined items, bit for bit: one channel `/exact/<port>` for each port that brought items, in the
//!   encoding of recordings; a source has none, it is called from its start instead;
//! - `README.txt`: a description for human readers, with the next steps.

mod bundle;
mod items;
mod save;
#[cfg(test)]
mod tests;

pub use bundle::{BUNDLE, INPUTS};
pub use bundle::{Bundle, Failure, Given, Input, Node, Program, ReproError, Shown};
pub(crate) use save::Saver;
pub use save::{FOLDER, Saved, SavedBundle};

use crate::{
    activity::{self, Doing, Name},
    check::{CheckedNode, check_node},
    graph::{
        plugins::NamedPlugin,
        written::{self, remove_unwritten, sets_kind},
    },
    panics,
    plan::PlanPlugin,
    plugin::{Kinds, Known},
    runtime::{self, emission_fault, planned_failure},
    temporary,
};
use osteoflow_node::{
    Body, BuildContext, Built, Context, DeclaredPort, Emission, Empty, Joined, PayloadType, PortPayload, Registry,
    Role, Slot, StampNs,
};
use std::{
    path::Path,
    sync::Arc,
    time::{Duration, Instant},
};

/// Report of a repro.
#[derive(Debug)]
pub struct ReproReport {
    /// The bundle that was run again.
    pub bundle: Bundle,
    /// The kind that ran.
    pub kind: String,
    /// Whether the node was changed by settings.
    pub is_changed: bool,
    /// How it failed this time; `None` if it did not fail.
    pub failure: Option<Failure>,
    /// Whether it is the failure of the bundle.
    pub same: bool,
    /// For a source: number of answers before the call that failed, or before its end.
    pub n_calls: u64,
    /// Warnings of the node.
    pub warnings: Vec<String>,
    /// Differences between this program and the one that failed.
    pub differences: Vec<String>,
    /// Duration of the firing.
    pub took: Duration,
}

/// Runs the node of a bundle again on its item, with settings of the node, such as another kind. With `backtrace`, the process's
/// panic hook also runs.
///
/// # Errors
/// [`ReproError`] if the bundle cannot be read or its node cannot be built here.
pub fn repro(
    dir: &Path,
    kinds: impl Into<Kinds>,
    program: Program,
    backtrace: bool,
    sets: &[String],
) -> Result<ReproReport, ReproError> {
    let bundle = Bundle::open(dir)?;
    let node = &bundle.node;
    let kinds = kinds.into().recorded_by(node.plugin.as_slice()).with_moved(node.plugin.as_slice());
    let of = |plugin: &PlanPlugin| NamedPlugin {
        interpreter: plugin.interpreter.clone(),
        ..NamedPlugin::file(&plugin.path)
    };
    // The plugin of a kind that is exchanged is not needed.
    let is_exchanged = sets.iter().any(|set| sets_kind(set, &node.name));
    let named: Vec<_> = node.plugin.iter().filter(|_| !is_exchanged).map(of).collect();
    let known = kinds.with(&named);
    let registry = &known.registry;
    if let Some(refused) = known.refused.iter().find(|refused| refused.is_asked()) {
        return Err(ReproError::Unfit(format!("plugin {} is refused: {}", refused.path.display(), refused.why)));
    }
    let CheckedNode { kind: kind_name, params, declared, place } = checked(node, sets, is_exchanged, &known)?;
    let unfit = |message: String| ReproError::Unfit(format!("node \"{}\" cannot be built here: {message}", node.name));
    let kind = registry.kind(kind_name).ok_or_else(|| unfit(format!("there is no kind \"{kind_name}\"")))?;
    if kind.description.role != node.role {
        let role = if node.role == Role::Node { "a node with inputs" } else { "a source" };
        return Err(unfit(format!("it was {role}, which {kind_name} is not")));
    }
    let declared: Arc<[DeclaredPort]> = declared.into();
    let outputs: Vec<_> = kind.description.outputs.payloads(&declared).collect();
    let joins = kind.description.inputs.iter().map(|port| port.join).collect();
    let (full_name, name) = (node.name.as_str().into(), Name::of(&node.name));
    let build_context = BuildContext { node: full_name, seed: bundle.seed, declared: declared.clone(), joins, place };
    let under = activity::begin(name, Doing::Building, 0);
    let built = panics::catch(|| registry.build(kind, &params, &build_context)).map_err(unfit)?;
    let built = built.map_err(|error| unfit(error.to_string()))?;
    drop(under);
    let built = planned_failure(built, &node.name, bundle.item, bundle.injected.filter(|_| !is_exchanged));
    // Files that the node writes go to a temporary folder.
    let no_folder = |error| ReproError::Files(format!("no folder can be made for what the node writes: {error}"));
    let scratch = temporary::folder("repro").map_err(no_folder)?;
    let context = Context::new(node.name.clone(), bundle.seed, Arc::default(), declared.clone());
    let mut context = context.with_out_dir(Some(Arc::from(scratch.path())));
    if backtrace {
        panics::show();
    }

    let began = Instant::now();
    let mut n_calls = 0;
    let _under = activity::begin(name, Doing::Firing, bundle.item);
    let mut failed = match built {
        Built::Node(mut built) => {
            let mut joined = joined(&bundle, dir, kind, registry, &mut context)?;
            let mut out = vec![Emission::Silent; outputs.len()];
            let answered = panics::catch(|| built.fire(&mut joined, &mut out, &mut context));
            let floors = vec![StampNs::MIN; outputs.len()];
            failure(answered, &outputs, &floors, &out, Role::Node, bundle.stamp_ns).err()
        }
        Built::Source(mut source) => {
            let mut floors = vec![StampNs::MIN; outputs.len()];
            let mut stamp_ns = StampNs::MIN;
            loop {
                context.begin(n_calls, runtime::stamp_or_zero(stamp_ns));
                let mut out = vec![Emission::Silent; outputs.len()];
                let mut more = true;
                let answered = panics::catch(|| source.next(&mut out, &mut context).map(|answer| more = answer));
                stamp_ns = context.stamp_ns();
                if let Err(failed) = failure(answered, &outputs, &floors, &out, Role::Source, stamp_ns) {
                    break Some(failed);
                }
                if !more || n_calls == bundle.item {
                    break None;
                }
                n_calls += 1;
                let silent = out.iter().any(|emission| matches!(emission, Emission::Silent));
                let given = floors.iter_mut().zip(&out);
                given.for_each(|(floor, emission)| {
                    if silent || !matches!(emission, Emission::Silent) {
                        *floor = stamp_ns.max(*floor);
                    }
                });
            }
        }
    };
    let took = began.elapsed();
    if let Some(failed) = &mut failed {
        let (here, there) = (scratch.path().display().to_string(), bundle.out_dir.display().to_string());
        failed.reason = failed.reason.replace(&here, &there);
    }
    let then = node.plugin.as_ref().filter(|_| !is_exchanged);
    let now = then.zip(known.of_kind(&node.kind)).map(|(then, now)| {
        let mut now = now.in_plan(Vec::new());
        now.loads.add_variables_of(&then.loads);
        now
    });
    let (then, now) = (bundle.program.provenance(then), program.provenance(now.as_ref()));
    let differences = then.differences(&now, ["the bundle", "this program"]);
    let same_program = bundle.program.sha256 == program.sha256 && program.sha256.is_some();
    let at_call = node.role == Role::Node || n_calls == bundle.item;
    let same = at_call && failed.as_ref().is_some_and(|failed| failed.is(&bundle.failure, same_program));
    let warnings = context.take_warnings();
    let kind = kind_name.to_owned();
    let is_changed = !sets.is_empty();
    Ok(ReproReport { bundle, kind, is_changed, failure: failed, same, n_calls, warnings, differences, took })
}

/// The node of a bundle with settings; of one whose kind is exchanged, what its user did not write goes with the kind.
fn checked(node: &Node, sets: &[String], is_exchanged: bool, known: &Known) -> Result<CheckedNode, ReproError> {
    let name = &node.name;
    let own = format!("\"node.{name}.");
    let is_of_node = |set: &&String| {
        let removed = set.split_once('=').filter(|(key, _)| key.trim() == "remove").map(|(_, keys)| keys);
        removed.map_or(written::sets(set, name), |keys| keys.matches('"').count() == 2 * keys.matches(&own).count())
    };
    if let Some(other) = sets.iter().find(|set| !is_of_node(set)) {
        let message = format!("--set {other}: a bundle has one node, \"{name}\"; set {name}.KEY");
        return Err(ReproError::Unfit(message));
    }
    let mut table: toml::Table = node
        .table
        .parse()
        .map_err(|error| ReproError::Files(format!("the table of the node in the bundle cannot be read: {error}")))?;
    let own = table.get_mut("node").and_then(|nodes| nodes.get_mut(name)).and_then(toml::Value::as_table_mut);
    if let (true, Some(own)) = (is_exchanged, own) {
        remove_unwritten(own, &node.written);
    }
    check_node(format!("{table}\n[graph]\nformat = 1\n"), sets, known)
        .map_err(|faults| ReproError::Unfit(format!("node \"{name}\" cannot be built here\n{faults}")))
}

/// Items that the ports brought, in the order of the kind's ports, and the stamp of the firing.
fn joined(
    bundle: &Bundle,
    dir: &Path,
    kind: &osteoflow_node::Kind,
    registry: &Registry,
    context: &mut Context,
) -> Result<Joined, ReproError> {
    let mut items = items::read(&dir.join(bundle::INPUTS), registry)?;
    context.begin(bundle.item, bundle.stamp_ns);
    let mut slots = Vec::new();
    for port in &kind.description.inputs {
        let name = port.name;
        let kind = kind.description.kind;
        let input = bundle.inputs.iter().find(|input| input.port == port.name);
        let Some(input) = input else {
            if port.optional {
                let reason = "the node that failed had no such input".into();
                let empty = Arc::new(Empty { node: bundle.node.name.as_str().into(), reason });
                context.note_absent(port.name, empty.clone());
                slots.push(Slot::Absent(empty));
                continue;
            }
            let hint =
                "which the bundle lacks; run it with the program that saved it, or set a kind with the same inputs";
            return Err(ReproError::Unfit(format!("{kind} has an input \"{name}\" here, {hint}")));
        };
        let mut came = items.remove(port.name).unwrap_or_default();
        if came.len() != input.items.len() {
            let (n, expected) = (came.len(), input.items.len());
            let fault =
                format!("input \"{name}\" has {n} items in inputs.mcap, {expected} expected; the bundle is damaged");
            return Err(ReproError::Files(fault));
        }
        let is_other = |ty: &&PayloadType| port.payload.ty().is_some_and(|takes| takes != *ty);
        if let Some(other) = came.iter().filter_map(|item| item.body.value()).map(|value| value.ty()).find(is_other) {
            let takes = port.payload.name();
            return Err(ReproError::Unfit(format!("input \"{name}\" of {kind} takes {takes}, but got {}", other.name)));
        }
        let empty = came.iter().find_map(|item| match &item.body {
            Body::Empty(empty) => Some(empty.clone()),
            Body::Value(_) => None,
        });
        empty.iter().for_each(|empty| context.note_absent(port.name, empty.clone()));
        slots.push(match (input.given, empty) {
            (Given::Items, _) => Slot::Items(came),
            (Given::Absent, Some(empty)) => Slot::Absent(empty),
            _ if came.len() == 1 => Slot::Item(came.remove(0)),
            _ => return Err(ReproError::Files(format!("input \"{name}\" has no item; the bundle is damaged"))),
        });
    }
    Ok(Joined { slots, is_spent: false })
}

/// How the firing failed, if it did: an error, a panic, or emissions that violate what every node promises.
fn failure(
    answered: Result<Result<(), osteoflow_node::NodeError>, String>,
    outputs: &[(&str, PortPayload)],
    floors: &[StampNs],
    out: &[Emission],
    role: Role,
    stamp_ns: StampNs,
) -> Result<(), Failure> {
    match answered {
        Err(reason) => Err(Failure { reason, panicked: true }),
        Ok(Err(error)) => Err(Failure { reason: error.message, panicked: false }),
        Ok(Ok(())) => {
            let mut emissions = outputs.iter().zip(floors).zip(out);
            let fault = emissions.find_map(|(((name, payload), floor), emission)| {
                let fault = emission_fault(payload, *floor, emission, role != Role::Node, stamp_ns)?;
                Some(format!("output {name} {fault}"))
            });
            fault.map_or(Ok(()), |reason| Err(Failure { reason, panicked: false }))
        }
    }
}
