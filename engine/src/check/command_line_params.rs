use super::{
    faults,
    schema::{Files, Walker},
};
use crate::{
    fault::Faults,
    graph::{self, CommandLineParam},
};
use osteoflow_node::Description;
use serde_json::Value as Json;

/// Reads the parameters of a node outside a graph: `given` and the defaults. Names, types, ranges and faults are those
/// of a graph file. `owner` names the node in faults.
///
/// # Errors
/// [`Faults`]: every parameter that is unknown, of the wrong type, out of range or missing.
pub fn parameters(kind: &Description, owner: &str, given: &[CommandLineParam<'_>]) -> Result<Json, Faults> {
    let mut faults = Vec::new();
    let (table, at) = graph::table_of(given, &mut faults);
    let mut walker = Walker {
        root: &kind.params,
        owner: owner.into(),
        path: owner.into(),
        kind: kind.kind,
        kind_at: None,
        files: Files::Needed,
        faults,
        input_files: Vec::new(),
    };
    match walker.table(&kind.params, &table, &at, "", &[]) {
        Some(params) if walker.faults.is_empty() => Ok(Json::Object(params)),
        _ => Err(Faults(faults::add_uses(faults::sorted(walker.faults)))),
    }
}
