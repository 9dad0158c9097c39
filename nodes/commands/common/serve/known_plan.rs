//! The plan of a recorded run, with what its wires do not carry: the anatomy.

use super::picks;
use crate::app::registry;
use anyhow::{Result, bail};
use osteoflow_engine::{
    Checked, Recording, check_recorded,
    plan::{Plan, PlanNode},
};
use osteoflow_formats::plan_file::{read_plan, read_plan_of};
use osteoflow_geometry::{Points, SurgicalPlan};
use osteoflow_node::FilePath;
use osteoflow_simulation::Subject;
use osteoflow_standard::plan::simulated;
use serde_json::Value;
use std::path::Path;

/// The plan that a recorded run read, if it can be had again and its landmarks are still the recorded ones. A file that was named
/// on the command line is recorded without its folder, and not found.
pub(crate) fn of(recording: &Recording) -> Option<SurgicalPlan> {
    with_landmarks(recording).into_iter().find_map(|(node, shown)| picks::if_the_same(again(&node)?, &shown))
}

/// The plan in a file, for a recorded run.
///
/// # Errors
/// It cannot be read, or its landmarks are not those of the run.
pub(crate) fn given(file: &Path, recording: Option<&Recording>) -> Result<SurgicalPlan> {
    let plan = read_plan(file)?.plan;
    let shown = recording.map(with_landmarks).unwrap_or_default();
    if !shown.is_empty() && !shown.iter().any(|(_, shown)| picks::if_the_same(plan.clone(), shown).is_some()) {
        bail!("{} is not the plan of this run: its landmarks are others", file.display());
    }
    Ok(plan)
}

/// The nodes that gave plans, with the landmarks that were recorded.
fn with_landmarks(recording: &Recording) -> Vec<(PlanNode, Points)> {
    let Some(checked) = graph(recording) else { return Vec::new() };
    let plans = checked.plan.nodes.iter().filter(|node| node.kind.starts_with("plan."));
    let shown = plans.filter_map(|node| {
        let items = recording.items(&format!("{}.landmarks", node.name), &checked.registry).ok()?;
        let points = items.iter().find_map(|item| item.body.value()?.get::<Points>().cloned());
        Some((node.clone(), points?))
    });
    shown.collect()
}

/// The graph of a recording, if this program has its kinds.
pub(super) fn graph(recording: &Recording) -> Option<Checked> {
    let known = recording.registry(&registry());
    check_recorded(&recording.run.graph, &recording.run.graph_file, &[], &known).ok()
}

/// The plan that a graph reads.
pub(crate) fn of_graph(plan: &Plan) -> Option<SurgicalPlan> {
    plan.nodes.iter().find_map(again)
}

/// The plan that the procedure of a graph was made for, if the graph reads another one.
pub(crate) fn made_for(plan: &Plan) -> Option<SurgicalPlan> {
    let of = |node: &PlanNode| Some(read_plan(Path::new(node.params["made_for"].as_str()?)).ok()?.plan);
    plan.nodes.iter().filter(|node| node.kind == "plan.file").find_map(of)
}

/// The plan that a node gives.
fn again(node: &PlanNode) -> Option<SurgicalPlan> {
    match &*node.kind {
        "plan.file" => {
            let read = read_plan(Path::new(node.params["path"].as_str()?)).ok()?;
            Some(read.completed_by(node.params["rest"].as_str().map(Path::new)).ok()?.plan)
        }
        "plan.simulated" => simulated_plan(&node.params),
        _ => None,
    }
}

fn simulated_plan(params: &Value) -> Option<SurgicalPlan> {
    let simulated::Params { own, bone, displaced } = serde_json::from_value(params.clone()).ok()?;
    let plan = match (&own.bone_file, &own.plan_file) {
        (Some(FilePath(file)), Some(FilePath(plan))) => {
            read_plan_of(plan, &file.file_stem()?.to_string_lossy()).ok()?.plan
        }
        _ => Subject::built_in(&bone).ok()?.plan,
    };
    osteoflow_simulation::displaced(plan, &displaced).ok()
}
