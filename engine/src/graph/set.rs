use super::{
    extends,
    merge::merge,
    parse::parse_value,
    tree::{Entry, Spanned, Table, Value},
};
use crate::fault::{Fault, SourceText, Span};
use std::{ops::Range, path::PathBuf, sync::Arc};

const TOP: [&str; 5] = ["graph", "node", "record", "results", "remove"];
const PREFIX: &str = "--set ";

/// Lays the command line's `--set KEY=VALUE` onto the graph, in their order.
pub(super) fn apply(table: &mut Table, sets: &[String], order: usize, faults: &mut Vec<Fault>) {
    if sets.is_empty() {
        return;
    }
    let lines: Vec<_> = sets.iter().map(|set| format!("{PREFIX}{set}")).collect();
    let dir = std::env::current_dir().unwrap_or_default();
    let name = PathBuf::from("command line");
    let source = Arc::new(SourceText { name, dir, text: lines.join("\n"), order, command_line: true });
    let mut start = 0;
    for line in &lines {
        match overlay(&source, start + PREFIX.len()..start + line.len(), table) {
            Ok(mut over) => {
                extends::remove(table, &mut over, faults);
                merge(table, over);
            }
            Err(fault) => faults.push(*fault),
        }
        start += line.len() + 1;
    }
}

/// One setting as a graph file would hold it.
fn overlay(source: &Arc<SourceText>, range: Range<usize>, table: &Table) -> Result<Table, Box<Fault>> {
    let text = &source.text[range.clone()];
    let span = Span::new(source, range.clone());
    let form = "write KEY=VALUE, such as icp.max_iterations=50 or graph.seed=7";
    let no_form = |label: &str| Box::new(Fault::new("--set takes KEY=VALUE").at(&span, label).help(form));
    let Some(equals) = text.find('=') else { return Err(no_form("no = here")) };
    let keys = keys(&text[..equals], range.start);
    if keys.iter().any(|(key, _)| key.is_empty()) {
        return Err(no_form("a part of the key is empty"));
    }
    if keys[0].0 == "extends" {
        let fault = Fault::new("extends belongs in a graph file").at(&span, "not on the command line");
        return Err(Box::new(fault.help("name another graph file instead")));
    }
    let mut path = keys;
    if !TOP.contains(&path[0].0.as_str()) {
        // `icp.max_iterations` is short for `node.icp.max_iterations`.
        let at = path[0].1.clone();
        path.insert(0, ("node".into(), at.start..at.start));
    }
    if path[0].0 == "results" {
        path = result_path(path, table);
    }
    let value = value(source, range.start + equals + 1..range.end);
    Ok(nest(source, &path, value))
}

type Key = (String, Range<usize>);

/// The parts of a dotted key; a part in quotes may hold dots.
fn keys(text: &str, offset: usize) -> Vec<Key> {
    let (mut keys, mut start, mut quote) = (Vec::new(), 0, None);
    let mut cut = |part: &str, start: usize| {
        let blank = part.len() - part.trim_start().len();
        let part = part.trim();
        let at = offset + start + blank..offset + start + blank + part.len();
        keys.push((part.trim_matches(['"', '\'']).to_owned(), at));
    };
    for (at, c) in text.char_indices() {
        match (c, quote) {
            ('"' | '\'', None) => quote = Some(c),
            (c, Some(q)) if c == q => quote = None,
            ('.', None) => {
                cut(&text[start..at], start);
                start = at + 1;
            }
            _ => {}
        }
    }
    cut(&text[start..], start);
    keys
}

/// The key of a result has dots of its own; only `all`, `optional` and `from` of an entry that is there go deeper.
fn result_path(path: Vec<Key>, table: &Table) -> Vec<Key> {
    let join = |keys: &[Key]| -> Key {
        let names: Vec<_> = keys.iter().map(|(key, _)| key.as_str()).collect();
        (names.join("."), keys[0].1.start..keys[keys.len() - 1].1.end)
    };
    let there = |key: &str| table.get("results").and_then(|r| r.value.as_table()).is_some_and(|r| r.get(key).is_some());
    match path.as_slice() {
        [results, keys @ .., (last, at)]
            if !keys.is_empty() && matches!(last.as_str(), "all" | "optional" | "from") && there(&join(keys).0) =>
        {
            vec![results.clone(), join(keys), (last.clone(), at.clone())]
        }
        [results, keys @ ..] if !keys.is_empty() => vec![results.clone(), join(keys)],
        _ => path,
    }
}

/// The value as TOML, or else the bare text.
fn value(source: &Arc<SourceText>, range: Range<usize>) -> Spanned {
    let text = &source.text[range.clone()];
    let blank = text.len() - text.trim_start().len();
    let range = range.start + blank..range.start + blank + text.trim().len();
    if let Some(value) = parse_value(source, range.clone()) {
        return value;
    }
    let at = Span::new(source, range);
    Spanned { value: Value::Text(at.text().to_owned()), at }
}

fn nest(source: &Arc<SourceText>, path: &[Key], value: Spanned) -> Table {
    let Some(((key, at), rest)) = path.split_first() else { return Table::default() };
    let key_at = Span::new(source, at.clone());
    let value = match rest {
        [] => value,
        _ => Spanned { value: Value::Table(nest(source, rest, value)), at: key_at.clone() },
    };
    Table(vec![Entry { key: key.clone(), key_at, value }])
}
