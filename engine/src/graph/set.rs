mod keys;

pub(crate) use keys::{SetKey, keys_set};

use super::{
    edit::{Edit, Step},
    extends::{Chain, Variant, tidy},
    grammar,
    merge::merge,
    parse::parse_value,
    tree::{Entry, Spanned, Table, Value},
};
use crate::fault::{Fault, SourceText, Span};
use std::{
    ops::Range,
    path::{Path, PathBuf},
    sync::{Arc, OnceLock},
};

const PREFIX: &str = "--set ";

/// Settings, each `KEY=VALUE`, and where they are written.
pub(crate) struct Sets<'a> {
    sets: &'a [String],
    name: PathBuf,
    /// The folder that relative paths are relative to.
    dir: PathBuf,
    /// The graph file, and the variants that settings of a run name.
    variants: Option<(&'a Path, &'a [Variant])>,
}

impl<'a> Sets<'a> {
    /// Settings of the command line.
    pub(crate) fn command_line(sets: &'a [String]) -> Self {
        Self { sets, name: "command line".into(), dir: std::env::current_dir().unwrap_or_default(), variants: None }
    }

    /// Settings of one run of the sweep in the graph file at `path`, whose factors have these variants.
    pub(crate) fn row(sets: &'a [String], path: &'a Path, variants: &'a [Variant]) -> Self {
        let dir = std::path::absolute(path).ok().and_then(|path| path.parent().map(Path::to_path_buf));
        let name = format!("[sweep] of {}", tidy(path).display()).into();
        Self { sets, name, dir: dir.unwrap_or_default(), variants: Some((path, variants)) }
    }

    /// The variant that a setting names, with its path.
    fn variant(&self, set: &str) -> Option<(PathBuf, &'a Variant)> {
        let (graph, variants) = self.variants?;
        let variant = variants.iter().find(|variant| variant.setting() == set)?;
        Some((graph.parent().unwrap_or(Path::new("")).join(&variant.file), variant))
    }
}

/// Applies settings to the graph in their order; returns the edits of nodes inside modules.
pub(super) fn apply(table: &mut Table, sets: &Sets<'_>, chain: &mut Chain<'_>) -> Vec<Edit> {
    let mut inside = Vec::new();
    if sets.sets.is_empty() {
        return inside;
    }
    let (source, ranges) = sets.source();
    for range in ranges {
        if let Some((path, variant)) = sets.variant(&source.text[range.clone()]) {
            chain.change(table, &path, variant);
            continue;
        }
        match Setting::read(&source, range, Some(table)) {
            Ok(Setting::Overlay(mut over)) => {
                chain.removed.take_from(table, &mut over, chain.faults);
                merge(table, over);
            }
            Ok(Setting::Edit(edit)) if edit.is_inside_a_module(table) => inside.push(edit),
            Ok(Setting::Edit(edit)) => chain.faults.extend(edit.apply(table).err().map(|fault| *fault)),
            Err(fault) => chain.faults.push(*fault),
        }
    }
    inside
}

impl Sets<'_> {
    /// The settings as one text, and the range of each `KEY=VALUE` in it.
    fn source(&self) -> (Arc<SourceText>, Vec<Range<usize>>) {
        let lines = self.sets.iter().map(|set| (PREFIX.to_owned(), set.as_str()));
        source(&self.name, &self.dir, lines)
    }
}

/// Lines, each of a prefix and a value, as one text, and the range of each value in it.
fn source<'l>(
    name: &Path,
    dir: &Path,
    lines: impl Iterator<Item = (String, &'l str)>,
) -> (Arc<SourceText>, Vec<Range<usize>>) {
    let (mut text, mut ranges) = (String::new(), Vec::new());
    for (prefix, value) in lines {
        if !text.is_empty() {
            text.push('\n');
        }
        text.push_str(&prefix);
        ranges.push(text.len()..text.len() + value.len());
        text.push_str(value);
    }
    let (name, dir, order) = (name.into(), dir.into(), usize::MAX);
    let (merged, line_starts) = (OnceLock::new(), OnceLock::new());
    (Arc::new(SourceText { name, dir, text, order, command_line: true, merged, used: None, line_starts }), ranges)
}

/// A parameter of a node that is not in a graph file, as given on the command line.
#[derive(Debug, Clone, Copy)]
pub enum CommandLineParam<'a> {
    /// `--set KEY=VALUE`.
    Set(&'a str),
    /// A dedicated option, such as `--max-iterations 50`.
    Option {
        /// The option without its dashes.
        option: &'a str,
        /// The parameter that it sets.
        key: &'a str,
        /// The value as a graph file would write it.
        value: &'a str,
    },
}

/// The table of a node that exists only on the command line; later settings override earlier ones. The span covers the
/// whole command line, for faults about missing parameters.
pub(crate) fn table_of(given: &[CommandLineParam<'_>], faults: &mut Vec<Fault>) -> (Table, Span) {
    let Sets { name, dir, .. } = Sets::command_line(&[]);
    let lines = given.iter().map(|given| match *given {
        CommandLineParam::Set(text) => (PREFIX.to_owned(), text),
        CommandLineParam::Option { option, value, .. } => (format!("--{option} "), value),
    });
    let (source, ranges) = source(&name, &dir, lines);
    let mut table = Table::default();
    for (given, range) in given.iter().zip(ranges) {
        match given {
            CommandLineParam::Set(_) => match Setting::read(&source, range, None) {
                Ok(Setting::Overlay(over)) => merge(&mut table, over),
                Ok(Setting::Edit(edit)) => faults.extend(edit.apply(&mut table).err().map(|fault| *fault)),
                Err(fault) => faults.push(*fault),
            },
            CommandLineParam::Option { option, key, .. } => {
                let key_at = Span::new(&source, range.start - "-- ".len() - option.len()..range.start - 1);
                let entry = Entry { key: (*key).into(), key_at, value: value(&source, range) };
                merge(&mut table, Table(vec![entry]));
            }
        }
    }
    (table, Span::new(&source, 0..0))
}

/// The effect of one `--set`.
enum Setting {
    /// Keys and a value, as a graph file would hold them.
    Overlay(Table),
    /// A change to a list: one item is replaced, or items are appended.
    Edit(Edit),
}

impl Setting {
    /// Without a graph, the key is that of a node's parameter.
    fn read(source: &Arc<SourceText>, range: Range<usize>, graph: Option<&Table>) -> Result<Self, Box<Fault>> {
        let text = &source.text[range.clone()];
        let span = Span::new(source, range.clone());
        let form = match graph {
            Some(_) => "write KEY=VALUE, such as icp.max_iterations=50 or graph.seed=7",
            None => "write KEY=VALUE, such as max_iterations=50",
        };
        let no_form = |label: &str| Box::new(Fault::new("--set takes KEY=VALUE").at(&span, label).help(form));
        let Some(equals) = text.find('=') else { return Err(no_form("no = here")) };
        let append = text[..equals].ends_with('+');
        let key_end = equals - usize::from(append);
        let mut path = Vec::new();
        for part in parts(&text[..key_end], range.start) {
            let (key, indices) = indices(source, part)?;
            if key.0.is_empty() {
                return Err(no_form("a part of the key is empty"));
            }
            path.push((key, indices));
        }
        let (first, at) = &path[0].0;
        if first == "extends" && graph.is_some() {
            let fault = Fault::new("extends belongs in a graph file").at(&span, "not on the command line");
            return Err(Box::new(fault.help("name another graph file instead")));
        }
        if first == "plugins" && graph.is_some() {
            let fault = Fault::new("plugins belongs in a graph file").at(&span, "not on the command line");
            return Err(Box::new(fault.help("name the library by --plugin FILE instead")));
        }
        if graph.is_some() && !grammar::has(&grammar::TOP, first) {
            // `icp.max_iterations` is short for `node.icp.max_iterations`.
            let key = ("node".into(), at.start..at.start);
            path.insert(0, (key, Vec::new()));
        }
        let value = value(source, range.start + equals + 1..range.end);
        if append || path.iter().any(|(_, indices)| !indices.is_empty()) {
            let key_at = Span::new(source, range.start..range.start + text[..key_end].trim_end().len());
            let steps = path.into_iter().flat_map(|(key, indices)| {
                std::iter::once(Step::Key(key.0, Span::new(source, key.1)))
                    .chain(indices.into_iter().map(|(n, at)| Step::Index(n, Span::new(source, at))))
            });
            return Ok(Self::Edit(Edit { steps: steps.collect(), append, value, key_at }));
        }
        let mut path: Vec<Key> = path.into_iter().map(|(key, _)| key).collect();
        if let Some(graph) = graph
            && path[0].0 == "results"
        {
            path = result_path(path, graph);
        }
        Ok(Self::Overlay(nest(source, &path, value)))
    }
}

type Key = (String, Range<usize>);
type Index = (usize, Range<usize>);

/// The parts of a dotted key as written; a part in quotes may hold dots.
fn parts(text: &str, offset: usize) -> Vec<Range<usize>> {
    let (mut parts, mut start, mut quote) = (Vec::new(), 0, None);
    let mut cut = |part: &str, start: usize| {
        let blank = part.len() - part.trim_start().len();
        parts.push(offset + start + blank..offset + start + blank + part.trim().len());
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
    parts
}

/// A part of a key and the indices after it: `rounds[1]`.
fn indices(source: &Arc<SourceText>, at: Range<usize>) -> Result<(Key, Vec<Index>), Box<Fault>> {
    let text = &source.text[at.clone()];
    let quoted = text.starts_with(['"', '\'']);
    let end = if quoted { text.rfind(['"', '\'']).map_or(text.len(), |q| q + 1) } else { text.len() };
    let bracket = text[if quoted { end } else { 0 }..].find('[').map(|b| b + if quoted { end } else { 0 });
    let key_end = bracket.unwrap_or(text.len());
    let key = (text[..key_end].trim().trim_matches(['"', '\'']).to_owned(), at.start..at.start + key_end);
    let mut found = Vec::new();
    let mut rest = key_end;
    while rest < text.len() {
        let close = text[rest..].find(']').map(|close| rest + close);
        let number = close.and_then(|close| text[rest..close].strip_prefix('[')?.trim().parse().ok());
        let (Some(close), Some(number)) = (close, number) else {
            let here = Span::new(source, at.start + rest..at.end);
            let fault = Fault::new("an item of a list is named by its number").at(&here, "no number in brackets");
            return Err(Box::new(fault.help("write list[0] for the first item, list[1] for the second")));
        };
        found.push((number, at.start + rest..at.start + close + 1));
        rest = close + 1;
    }
    Ok((key, found))
}

/// Splits the path of a result, whose key may contain dots; only `all`, `optional` and `from` of an existing entry are
/// separate parts.
fn result_path(path: Vec<Key>, table: &Table) -> Vec<Key> {
    let join = |keys: &[Key]| -> Key {
        let names: Vec<_> = keys.iter().map(|(key, _)| key.as_str()).collect();
        (names.join("."), keys[0].1.start..keys[keys.len() - 1].1.end)
    };
    let there = |key: &str| table.get("results").and_then(|r| r.value.as_table()).is_some_and(|r| r.get(key).is_some());
    match path.as_slice() {
        [results, keys @ .., (last, at)]
            if !keys.is_empty() && grammar::has(&grammar::RESULT, last) && there(&join(keys).0) =>
        {
            vec![results.clone(), join(keys), (last.clone(), at.clone())]
        }
        [results, keys @ ..] if !keys.is_empty() => vec![results.clone(), join(keys)],
        _ => path,
    }
}

/// The value of a setting as JSON.
pub(crate) fn setting_value(text: &str) -> serde_json::Value {
    let source = SourceText {
        name: "command line".into(),
        dir: PathBuf::new(),
        text: text.into(),
        order: usize::MAX,
        command_line: true,
        merged: OnceLock::new(),
        used: None,
        line_starts: OnceLock::new(),
    };
    value(&Arc::new(source), 0..text.len()).to_json()
}

/// The value parsed as TOML, otherwise the bare text.
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
