use super::{
    grammar::REQUIRE,
    tree::{Entry, Spanned, Table, Value},
};

/// Merges `over` into `base`, key by key; values other than tables replace.
///
/// An input or a result given as a text, or an input as a list of texts, is short for a table with that `from` and is merged as one: a variant that
/// names another producer keeps the join, and a variant that changes the capacity keeps the producer.
pub(super) fn merge(base: &mut Table, over: Table) {
    merge_at(base, over, &mut Vec::new());
}

/// Merges tables of nodes by name, by the rules of [`merge`].
pub(super) fn merge_nodes(base: &mut Table, over: Table) {
    merge_at(base, over, &mut vec!["node".into()]);
}

fn merge_at(base: &mut Table, over: Table, path: &mut Vec<String>) {
    for entry in over.0 {
        let Some(old) = base.get_mut(&entry.key) else {
            base.0.push(entry);
            continue;
        };
        path.push(entry.key.clone());
        let (old_is_table, new_is_table) = (old.value.as_table().is_some(), entry.value.as_table().is_some());
        if old_is_table != new_is_table && has_short_form(path) {
            let mut value = entry.value;
            let short = if old_is_table { &mut value } else { &mut old.value };
            if let Value::Text(_) | Value::Outside(_) | Value::Array(_) = short.value {
                short.lengthen("from");
            }
            merge_values(old, value, path);
        } else if old_is_table && new_is_table {
            merge_values(old, entry.value, path);
        } else {
            *old = entry;
        }
        path.pop();
    }
}

fn merge_values(old: &mut Entry, new: Spanned, path: &mut Vec<String>) {
    match (&mut old.value.value, new.value) {
        (Value::Table(base), Value::Table(over)) => merge_at(base, over, path),
        (_, value) => old.value = Spanned { value, at: new.at },
    }
}

fn has_short_form(path: &[String]) -> bool {
    match path {
        [node, _, inputs, _] => node == "node" && inputs == "in",
        [results, key] => results == "results" && key != REQUIRE,
        _ => false,
    }
}
