use super::{
    faults,
    schema::{Files, Walker},
};
use crate::{
    fault::{Fault, Faults},
    graph::{self, CommandLineParam},
};
use osteoflow_node::Description;
use serde_json::Value as Json;

/// Reads the parameters of a node outside a graph: `given` and the defaults. Names, types, ranges and faults are those
/// of a graph file. `owner` names the node in faults. Warnings come with the parameters.
///
/// # Errors
/// [`Faults`]: every parameter that is unknown, of the wrong type, out of range or missing.
pub fn parameters(
    kind: &Description,
    owner: &str,
    given: &[CommandLineParam<'_>],
) -> Result<(Json, Vec<Fault>), Faults> {
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
    let read = walker.table(&kind.params, &table, &at, "", &[]);
    let n_errors = walker.n_errors();
    let faults = faults::add_uses(faults::sorted(walker.faults));
    match read {
        Some(params) if n_errors == 0 => Ok((Json::Object(params), faults)),
        _ => Err(Faults(faults)),
    }
}
