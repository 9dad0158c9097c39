use super::{
    extract::refused,
    tree::{Table, Value},
};
use crate::{
    fault::{Fault, Span},
    names::nearest,
};

/// Paths removed by `remove`, with the file that removed each; a fault about something missing points at it.
#[derive(Debug, Clone, Default)]
pub(crate) struct Removed {
    done: Vec<(String, Span)>,
    /// Paths inside modules, which are not read yet: the path, its place, and whether it was found.
    inside: Vec<(String, Span, bool)>,
}

impl Removed {
    /// Where `path`, such as `node.icp`, was removed.
    pub(crate) fn at(&self, path: &str) -> Option<&Span> {
        self.done.iter().rev().find(|(removed, _)| removed == path).map(|(_, at)| at)
    }

    /// Notes a path that is left out because of what is removed or replaced at `at`.
    pub(crate) fn leave_out(&mut self, path: &str, at: &Span) {
        self.done.push((path.into(), at.clone()));
    }

    /// Removes from `base` the paths listed in `remove` of `over`.
    pub(super) fn take_from(&mut self, base: &mut Table, over: &mut Table, faults: &mut Vec<Fault>) {
        let Some(entry) = over.remove("remove") else { return };
        let Value::Array(items) = &entry.value.value else {
            let takes = "remove takes a list such as [\"node.x\", \"results.y\"]";
            faults.push(refused(&entry.value, takes, "a list is needed"));
            return;
        };
        for item in items {
            match item.as_text() {
                Some(path) => self.take(base, path, &item.at, faults),
                None => faults.push(refused(item, "remove takes texts such as \"node.x\"", "a text is needed")),
            }
        }
    }

    fn take(&mut self, base: &mut Table, path: &str, at: &Span, faults: &mut Vec<Fault>) {
        let found = remove_path(base, path);
        if found {
            self.done.push((path.into(), at.clone()));
        }
        if node_of(path).is_some_and(|node| node.contains('/')) {
            self.inside.push((path.into(), at.clone(), found));
        } else if !found {
            faults.push(nothing_there(base, path, at));
        }
    }

    /// Removes from the nodes of a module, under their full names, the paths that the graph using it removes.
    pub(super) fn take_inside(&mut self, node: &str, nodes: &mut Table) {
        for (path, at, found) in &mut self.inside {
            let Some(within) = path.strip_prefix("node.") else { continue };
            let inside = within.strip_prefix(node).is_some_and(|rest| rest.starts_with('/'));
            if inside && remove_path(nodes, within) {
                *found = true;
                self.done.push((path.clone(), at.clone()));
            }
        }
    }

    /// Faults for paths inside modules that were to be removed and do not exist.
    pub(super) fn not_found(&self, flat: &Table, faults: &mut Vec<Fault>) {
        let missing = self.inside.iter().filter(|(_, _, found)| !found);
        faults.extend(missing.map(|(path, at, _)| nothing_there(flat, path, at)));
    }
}

/// The node that contains a path such as `node.a/b.key`.
fn node_of(path: &str) -> Option<&str> {
    path.strip_prefix("node.")?.split('.').next()
}

fn remove_path(table: &mut Table, path: &str) -> bool {
    if table.remove(path).is_some() {
        // Settings inside a module are removed with its node.
        let inside = format!("{path}/");
        table.0.retain(|entry| !entry.key.starts_with(&inside));
        return true;
    }
    // The key of a result contains dots, and a group of results is named by its common prefix.
    let group = format!("{path}.");
    let before = table.0.len();
    table.0.retain(|entry| !entry.key.starts_with(&group));
    if table.0.len() < before {
        return true;
    }
    path.match_indices('.').any(|(dot, _)| match table.get_mut(&path[..dot]) {
        Some(entry) => match &mut entry.value.value {
            Value::Table(inner) => remove_path(inner, &path[dot + 1..]),
            _ => false,
        },
        None => false,
    })
}

fn nothing_there(base: &Table, path: &str, at: &Span) -> Fault {
    let mut known = Vec::new();
    for entry in &base.0 {
        known.push(entry.key.clone());
        if let Value::Table(inner) = &entry.value.value {
            known.extend(inner.keys().map(|key| format!("{}.{key}", entry.key)));
            if entry.key == "node" {
                for node in &inner.0 {
                    let keys = node.value.as_table().into_iter().flat_map(Table::keys);
                    known.extend(keys.map(|key| format!("node.{}.{key}", node.key)));
                }
            }
        }
    }
    let message = format!("nothing to remove: the extended graph has no \"{path}\"");
    // A path without its first word most likely names a node.
    let near = known.iter().find(|known| known.strip_prefix("node.") == Some(path)).map(String::as_str);
    let near = near.or_else(|| nearest::name(path, known.iter().map(String::as_str)));
    let help = near.map(|near| format!("did you mean \"{near}\"?"));
    Fault::new(message).at(at, "not there").help_if(help).follows()
}
