use super::{
    context::Check,
    parsed_nodes::ParsedNode,
    schema::{Files, files::tidy},
};
use crate::{
    fault::{Fault, Span},
    graph::{Entry, Table},
    panics,
};
use osteoflow_node::{BuildContext, Built, Kind, ParamError};

impl Check<'_> {
    /// Builds a node of the program's own, which opens nothing before it fires: what it refuses is a fault at the parameter, in the
    /// words of a run. Takes from a source which files it will read beside those of its parameters, and which ports have times.
    pub(super) fn build(&mut self, parsed_node: &mut ParsedNode<'_>, kind: &Kind, seed: u64) {
        let declared = parsed_node.declared.clone().into();
        let context = BuildContext { seed, declared, ..BuildContext::detached(parsed_node.name) };
        let built = panics::catch(|| kind.build(&parsed_node.params, &context));
        match built.unwrap_or_else(|panic| Err(ParamError::new("", panic))) {
            Ok(Built::Node(_)) => {}
            Ok(Built::Source(source)) => {
                if !parsed_node.input_files.is_empty() {
                    let files = panics::catch(|| source.files()).unwrap_or_default();
                    parsed_node.further_files = files.iter().map(|file| tidy(file)).collect();
                }
                for (output, port) in parsed_node.outputs.iter_mut().flatten().zip(&parsed_node.declared) {
                    output.is_timed = source.is_timed(port);
                }
            }
            // Something else gives its items.
            Err(_) if self.files == Files::Replaced && parsed_node.is_source() => {}
            Err(error) => {
                let (at, label) = place(parsed_node, &error);
                self.faults.push(Fault::new(error.in_node(parsed_node.name)).at(at, label));
            }
        }
    }
}

/// Where a refused parameter is set, or else the innermost table that it is missing in, with the label there.
fn place<'a>(parsed_node: &'a ParsedNode<'_>, error: &ParamError) -> (&'a Span, String) {
    let key = error.parameter.rsplit('.').next().unwrap_or_default();
    let missing = || format!("no {key} here");
    let found = error.paths().find_map(|path| Some((path, entry(parsed_node.table, path)?)));
    match found {
        Some((path, entry)) if path == error.parameter => (&entry.value.at, "refused".into()),
        Some((_, entry)) => (&entry.key_at, missing()),
        None if key.is_empty() => (parsed_node.begins_at(), "refused".into()),
        None => (parsed_node.begins_at(), missing()),
    }
}

fn entry<'a>(table: &'a Table, path: &str) -> Option<&'a Entry> {
    match path.split_once('.') {
        Some((key, rest)) => entry(table.get(key)?.value.as_table()?, rest),
        None => table.get(path),
    }
}
