//! The entries in which two graphs differ.

use crate::names::shortened;
use std::collections::BTreeSet;
use toml::{Table, Value};

/// An entry that only one of two graphs has, or in which they differ.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct EntryDifference {
    /// The table, such as `[node.icp]`.
    pub(crate) table: String,
    /// The key in the table, with dots; empty for the table itself.
    pub(crate) key: String,
    /// The values as TOML; `None` where the graph does not have it.
    pub(crate) values: [Option<String>; 2],
}

/// The differences of two graphs, as texts of graph files.
pub(crate) fn differences(a: &str, b: &str) -> Vec<EntryDifference> {
    let (Ok(a), Ok(b)) = (a.parse::<Table>(), b.parse::<Table>()) else { return by_lines(a, b) };
    let mut differences = Vec::new();
    compare(&mut Vec::new(), Some(&Value::Table(a)), Some(&Value::Table(b)), &mut differences);
    differences
}

/// Longest value of an entry, in characters.
const MAX_CHARACTERS: usize = 80;

/// The differences of two graphs in words, in which `names` are theirs. A graph names the folder of its plugins, which are compared by
/// themselves, and its own name is no setting.
pub(crate) fn in_words(a: &str, b: &str, [first, second]: [&str; 2]) -> impl Iterator<Item = String> {
    let differences = differences(a, b).into_iter();
    let differences =
        differences.filter(|entry| entry.table != "[plugins]" && (&*entry.table, &*entry.key) != ("[graph]", "name"));
    let shown = |value: Option<String>| value.map_or_else(|| "none".into(), |value| shortened(&value, MAX_CHARACTERS));
    differences.map(move |entry| match (entry.key.as_str(), entry.values) {
        ("", [Some(_), None]) => format!("{}: only in {first}", entry.table),
        ("", [None, Some(_)]) => format!("{}: only in {second}", entry.table),
        (key, [a, b]) => format!("{} {key}: {first} {}, {second} {}", entry.table, shown(a), shown(b)),
    })
}

/// The lines in which two graphs differ, where one has a number that TOML cannot hold: parameters may be greater than its integers.
fn by_lines(a: &str, b: &str) -> Vec<EntryDifference> {
    let (mut table, mut out) = ("", Vec::new());
    for (a, b) in a.lines().zip(b.lines()) {
        table = if a == b && a.starts_with('[') { a } else { table };
        if a != b {
            let [(key, a), (other, b)] = [a, b].map(|line| line.split_once(" = ").unwrap_or(("", line)));
            let key = if key == other { key } else { "" };
            out.push(EntryDifference {
                table: table.into(),
                key: key.into(),
                values: [Some(a.into()), Some(b.into())],
            });
        }
    }
    out
}

fn compare(path: &mut Vec<String>, a: Option<&Value>, b: Option<&Value>, out: &mut Vec<EntryDifference>) {
    match (a, b) {
        (Some(Value::Table(a)), Some(Value::Table(b))) => {
            let keys: BTreeSet<&String> = a.keys().chain(b.keys()).collect();
            for key in keys {
                path.push(key.clone());
                compare(path, a.get(key), b.get(key), out);
                path.pop();
            }
        }
        _ if a == b => {}
        _ => {
            let depth = match path.first().map(String::as_str) {
                Some("node") => 2,
                Some("sweep") => path.len().saturating_sub(1).clamp(1, 3),
                _ => 1,
            };
            let (table, key) = path.split_at(depth.min(path.len()));
            let value = |value: &Value| match value {
                Value::Table(_) if key.is_empty() => String::new(),
                value => value.to_string(),
            };
            let values = [a.map(value), b.map(value)];
            out.push(EntryDifference { table: format!("[{}]", table.join(".")), key: key.join("."), values });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_entry_that_differs_is_named_with_its_table() {
        let a = "[graph]\nseed = 1\n[node.a]\nmm = 4.0\nrules = { most = 1, least = 0 }\n[node.b]\nkind = \"x.y\"\n";
        let b = "[graph]\nseed = 1\n[node.a]\nmm = 5.0\nrules = { most = 1, least = 2 }\nn = 3\n";
        let entries = differences(a, b);
        let entries: Vec<_> =
            entries.iter().map(|d| (&*d.table, &*d.key, [d.values[0].as_deref(), d.values[1].as_deref()])).collect();
        let expected = [
            ("[node.a]", "mm", [Some("4.0"), Some("5.0")]),
            ("[node.a]", "n", [None, Some("3")]),
            ("[node.a]", "rules.least", [Some("0"), Some("2")]),
            ("[node.b]", "", [Some(""), None]),
        ];
        assert_eq!(entries, expected);
        assert_eq!(differences(a, a), Vec::new());
        let large = "[node.a]\nn = 18446744073709551615\nmm = 4.0\n";
        let entries = differences(large, &large.replace("4.0", "5.0"));
        assert_eq!((&*entries[0].table, &*entries[0].key, entries.len()), ("[node.a]", "mm", 1));
    }
}
