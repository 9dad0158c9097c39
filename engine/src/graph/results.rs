use super::{
    grammar,
    tree::{Entry, Table, Value},
};
use crate::fault::Fault;

/// Writes nested tables under `[results]` as dotted keys: `[results.poses] a = ".."` is `"poses.a" = ".."`.
pub(super) fn flatten(table: &mut Table, faults: &mut Vec<Fault>) {
    let Some(results) = table.get_mut("results") else { return };
    let Value::Table(nested) = &mut results.value.value else { return };
    let mut flat: Vec<Entry> = Vec::new();
    for entry in collect(std::mem::take(nested), "") {
        match flat.iter().find(|other| other.key == entry.key) {
            None => flat.push(entry),
            Some(other) => faults.push(
                Fault::new(format!("result \"{}\" is given twice", entry.key))
                    .at(&entry.key_at, "the second")
                    .also(&other.key_at, "the first")
                    .help("keep one of them"),
            ),
        }
    }
    *nested = Table(flat);
}

fn collect(table: Table, prefix: &str) -> Vec<Entry> {
    let mut flat = Vec::new();
    for mut entry in table.0 {
        let key = format!("{prefix}{}", entry.key);
        match entry.value.value {
            Value::Table(inner) if !is_entry(&inner) => flat.extend(collect(inner, &format!("{key}."))),
            _ => {
                entry.key = key;
                flat.push(entry);
            }
        }
    }
    flat
}

/// Whether a table under `[results]` is an entry, not a group of entries.
fn is_entry(table: &Table) -> bool {
    table.keys().any(|key| grammar::has(&grammar::RESULT, key)) || table.0.is_empty()
}
