//! The keys that settings assign, so that two settings of one key can be detected.

use super::{PREFIX, Sets, Setting, Step, Table, Value, Variant};
use crate::fault::Span;
use std::{fmt, path::Path};

/// A key that a setting assigns, split into its parts: `scan.calls[0]` is node, scan, calls, [0].
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct SetKey(Vec<String>);

impl SetKey {
    /// Its parts; a key under `[results]` is a single part.
    pub(crate) fn parts(&self) -> &[String] {
        &self.0
    }

    /// Whether setting this key later discards the earlier value entirely. Setting an item of a list keeps the other
    /// items.
    pub(crate) fn overrides(&self, earlier: &Self) -> bool {
        let meets = self.0.iter().zip(&earlier.0).all(|(a, b)| a == b);
        meets && self.0.get(earlier.0.len()).is_none_or(|part| !part.starts_with(['[', '+']))
    }
}

impl fmt::Display for SetKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let parts = self.0.strip_prefix(&["node".to_owned()]).unwrap_or(&self.0);
        for (index, part) in parts.iter().enumerate() {
            let dot = if index == 0 || part.starts_with(['[', '+']) { "" } else { "." };
            write!(f, "{dot}{part}")?;
        }
        Ok(())
    }
}

/// The keys that settings assign, each `KEY=VALUE`, with their places on the command line. A table assigns the keys of
/// its leaves. Settings that cannot be parsed are skipped.
pub(crate) fn keys_set(sets: &[String]) -> Vec<(SetKey, Span)> {
    let (source, ranges) = Sets::command_line(sets).source();
    let mut out = Vec::new();
    for range in ranges {
        let at = Span::new(&source, range.start - PREFIX.len()..range.end);
        match Setting::read(&source, range, Some(&Table::default())) {
            Ok(Setting::Overlay(table)) => leaves(&table, &[], &mut |key| out.push((SetKey(key), at.clone()))),
            Ok(Setting::Edit(edit)) => {
                let part = |step: &Step| match step {
                    Step::Key(key, _) => key.clone(),
                    Step::Index(index, _) => format!("[{index}]"),
                };
                let mut key: Vec<_> = edit.steps.iter().map(part).collect();
                key.extend(edit.append.then(|| format!("+={}", edit.value.at.text())));
                out.push((SetKey(key), at));
            }
            Err(_) => {}
        }
    }
    out
}

impl Variant {
    /// The keys that it sets or removes; its own name is none.
    pub(crate) fn keys(&self) -> Vec<SetKey> {
        let mut table = self.table(Path::new(&self.file), &mut Vec::new());
        table.0.retain(|entry| entry.key != "extends" && entry.key != "plugins");
        let mut keys = Vec::new();
        leaves(&table, &[], &mut |key| keys.push(SetKey(key)));
        keys.retain(|SetKey(key)| *key != ["graph", "name"] && *key != ["graph", "format"]);
        keys
    }
}

/// The keys of the leaves; those that `remove` names are set, too.
fn leaves(table: &Table, above: &[String], found: &mut impl FnMut(Vec<String>)) {
    for entry in &table.0 {
        let key = [above, std::slice::from_ref(&entry.key)].concat();
        match &entry.value.value {
            Value::Table(inner) => leaves(inner, &key, found),
            Value::Array(items) if above.is_empty() && entry.key == "remove" => {
                let removed = items.iter().filter_map(|item| item.as_text());
                removed.for_each(|path| {
                    found(match path.strip_prefix("results.") {
                        Some(result) => vec!["results".into(), result.into()],
                        None => path.split('.').map(str::to_owned).collect(),
                    })
                });
            }
            _ => found(key),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn key(set: &str) -> SetKey {
        keys_set(&[set.to_owned()]).remove(0).0
    }

    #[test]
    fn a_key_is_recognised_in_every_form() {
        let keys: Vec<_> =
            keys_set(&["a.b=1".into(), "node.c={ d = 2, e.f = [3] }".into(), "no setting".into(), "g.h[1].i=4".into()])
                .into_iter()
                .map(|(key, at)| (key.to_string(), at.text().to_owned()))
                .collect();
        let expected = [
            ("a.b", "--set a.b=1"),
            ("c.d", "--set node.c={ d = 2, e.f = [3] }"),
            ("c.e.f", "--set node.c={ d = 2, e.f = [3] }"),
            ("g.h[1].i", "--set g.h[1].i=4"),
        ];
        assert_eq!(keys, expected.map(|(key, at)| (key.to_owned(), at.to_owned())));
        assert_eq!(key("a.b=1"), key("node.a={ b = 2 }"));
        assert_eq!(key("results.x.y=a.b").parts(), ["results", "x.y"]);
    }

    #[test]
    fn setting_an_item_of_a_list_keeps_the_others() {
        for (earlier, later, overridden) in [
            ("a.b=1", "a.b=2", true),
            ("a.b=1", "a.c=2", false),
            ("a.b=1", "a.bc=2", false),
            ("a.b=[1, 2]", "a.b[0]=2", false),
            ("a.b[0]=2", "a.b=[1, 2]", true),
            ("a.b[0]=2", "a.b[1]=2", false),
            ("a.b=[1]", "a.b+=[2]", false),
            ("a.b+=[1]", "a.b+=[2]", false),
            ("a.b=\"x\"", "a.b.c=2", true),
        ] {
            assert_eq!(key(later).overrides(&key(earlier)), overridden, "{later} after {earlier}");
        }
    }
}
