use super::tree::{Entry, Table, Value};
use crate::fault::{Fault, SourceText, Span};
use std::{ops::Range, sync::Arc};
use toml::de::Error;

/// The syntax faults of a text, without those that only follow from an earlier one.
pub(super) fn faults(errors: &[Error], source: &Arc<SourceText>, tree: &Table) -> Vec<Fault> {
    if !errors.is_empty()
        && let Some(fault) = other_kind(source)
    {
        return vec![fault];
    }
    let mut faults: Vec<Fault> = Vec::new();
    let mut lost: Vec<Range<usize>> = Vec::new();
    // An unclosed bracket swallows the rest of the text, so it is the only fault reported.
    for error in errors.iter().filter(|error| is_unclosed(error)) {
        let end = error.span().unwrap_or_default().start;
        let Some(open) = opened(tree, end) else { continue };
        if lost.iter().any(|lost| lost.contains(&open.range.start)) {
            continue;
        }
        let bracket = if open.text().starts_with('[') { ("list", "]") } else { ("table", "}") };
        let at = Span::new(source, open.range.start..open.range.start + 1);
        let fault = Fault::new(format!("this is not TOML: a {} is opened and never closed", bracket.0));
        faults.push(fault.at(&at, format!("its {} is missing", bracket.1)).hides(&open));
        lost.push(open.range);
    }
    for error in errors {
        let range = error.span().unwrap_or_default();
        if lost.iter().any(|lost| lost.start <= range.start && range.start <= lost.end) {
            continue;
        }
        let at = Span::new(source, range);
        let (fault, swallows) = match error.message() {
            "duplicate key" => duplicate(&at, tree),
            message => (wording(message, &at), None),
        };
        let hidden = swallows.map_or(at, |range| Span::new(source, range));
        lost.extend((!hidden.range.is_empty()).then(|| hidden.range.clone()));
        faults.push(fault.hides(&hidden));
    }
    let first_line = source.text.lines().position(|line| !line.trim().is_empty() && !line.trim().starts_with('#'));
    let is_of_first_line =
        faults.first().and_then(Fault::location).map(|at| at.line) == first_line.map(|line| line + 1);
    if faults.len() > MANY && is_of_first_line {
        let n = faults.len() - 1;
        let fault =
            faults.swap_remove(0).note(format!("{n} more follow; is it a graph? osteoflow info says what a file is"));
        return vec![fault];
    }
    faults
}

/// Number of syntax faults from which on a text whose first line is one of them is of another format.
const MANY: usize = 5;

/// The fault of a text that was never TOML.
fn other_kind(source: &Arc<SourceText>) -> Option<Fault> {
    let start = source.text.len() - source.text.trim_start().len();
    let what = match source.text.as_bytes().get(start)? {
        b'{' => "JSON",
        b'<' => "HTML or XML",
        _ => return None,
    };
    let at = Span::new(source, start..start + 1);
    let fault = Fault::new(format!("this is {what}, and a graph is written in TOML")).at(&at, format!("begins {what}"));
    Some(
        fault
            .help("begin with [graph] and format = 1; osteoflow new examples DIR writes graphs to begin from")
            .hides(&at),
    )
}

fn is_unclosed(error: &Error) -> bool {
    error.message().starts_with("unclosed array,") || error.message().starts_with("unclosed inline table")
}

/// The outermost list or inline table that is still open at `end`, with the text that it swallows.
fn opened(tree: &Table, end: usize) -> Option<Span> {
    let mut best: Option<Span> = None;
    visit(tree, &mut Vec::new(), &mut |entry, _| {
        let at = &entry.value.at;
        let close = match &entry.value.value {
            Value::Array(_) if at.text().starts_with('[') => ']',
            Value::Table(_) if at.text().starts_with('{') => '}',
            _ => return,
        };
        // The parser gives up on some at the next header, on others at the end of the file.
        let open = at.range.end >= end || !at.text().trim_end().ends_with(close);
        if open && at.range.start < end && best.as_ref().is_none_or(|b| at.range.start < b.range.start) {
            best = Some(Span::new(&at.source, at.range.start..at.range.end.max(end)));
        }
    });
    best
}

fn wording(message: &str, at: &Span) -> Fault {
    let (what, expected) = message.split_once(", expected ").unwrap_or((message, ""));
    if what == "string values must be quoted" {
        return match at.text().trim() {
            "" => Fault::new("this is not TOML: a value is missing").at(at, "no value here"),
            text => {
                let fault =
                    Fault::new("this is not TOML: a text needs quotes").at(at, "neither a number nor in quotes");
                fault.help(format!("write {text:?}"))
            }
        };
    }
    // `kind = icp.point_to_point`: a word that begins like a number of TOML.
    let bare = at.text().trim();
    if what.starts_with("invalid float") || what.starts_with("invalid integer") || what.starts_with("invalid boolean") {
        let is_word = bare.starts_with(|c: char| c.is_ascii_alphabetic()) && !bare.contains(['"', '\'', '[', '{']);
        if is_word {
            let fault = Fault::new("this is not TOML: a text needs quotes").at(at, "neither a number nor in quotes");
            return fault.help(format!("write {bare:?}"));
        }
    }
    let label = if expected.is_empty() { String::new() } else { format!("expected {expected}") };
    Fault::new(format!("this is not TOML: {what}")).at(at, label).help_if(decimal_comma(at))
}

/// The number with a decimal comma at which the parser stopped.
fn decimal_comma(at: &Span) -> Option<String> {
    let is_of_number = |c: char| c.is_ascii_digit() || c == '-';
    let (before, after) = at.source.text.split_at_checked(at.range.start)?;
    let fraction = after.strip_prefix(',')?;
    let whole = &before[before.trim_end_matches(is_of_number).len()..];
    let fraction: String = fraction.chars().take_while(char::is_ascii_digit).collect();
    let both = !whole.is_empty() && !fraction.is_empty();
    both.then(|| format!("a decimal comma? write {whole}.{fraction}"))
}

/// The fault of a duplicate key or table, and the text that is dropped because of it. The tree holds the first key.
fn duplicate(at: &Span, tree: &Table) -> (Fault, Option<Range<usize>>) {
    let key = at.text().trim_matches(['"', '\'']);
    if let Some(header) = header_of(at) {
        let message = match header.strip_prefix("[node.") {
            Some(_) => format!("two nodes are called \"{key}\""),
            None => format!("the table {header} is opened twice"),
        };
        let text = &at.source.text;
        let fault = Fault::new(message).at(at, "the second").help("keep one of them, or give it another name");
        let first = text.find(header).filter(|first| *first < at.range.start);
        let first = first.map(|first| first + at.range.start - line_start(text, at.range.start));
        let fault = match first {
            Some(start) => fault.also(&Span::new(&at.source, start..start + at.range.len()), "the first"),
            None => fault,
        };
        let end = text[at.range.end..].find("\n[").map_or(text.len(), |next| at.range.end + next);
        return (fault, Some(at.range.start..end));
    }
    let mut path = Vec::new();
    let first = first_of(tree, key, at, &mut path);
    let (message, help) = match path.as_slice() {
        [node, name, inputs] if node == "node" && inputs == "in" => (
            format!("node \"{name}\": input \"{key}\" is given two producers"),
            "an input has one producer; let a node of its own bring two wires together",
        ),
        _ => (format!("\"{key}\" is given twice"), "keep one of them"),
    };
    let fault = Fault::new(message).at(at, "the second").help(help);
    match &first {
        Some(first) => (fault.also(first, "the first"), None),
        None => (fault, None),
    }
}

/// The table header, such as `[node.icp]`, of the table that contains the place.
fn header_of(at: &Span) -> Option<&str> {
    let text = &at.source.text;
    let line = text[line_start(text, at.range.start)..].lines().next()?;
    line.starts_with('[').then(|| line.split_inclusive(']').next().unwrap_or(line))
}

fn line_start(text: &str, offset: usize) -> usize {
    text[..offset].rfind('\n').map_or(0, |at| at + 1)
}

/// The last key of that name before `at`; `path` is set to the path of its table.
fn first_of(table: &Table, key: &str, at: &Span, path: &mut Vec<String>) -> Option<Span> {
    let mut best: Option<(Span, Vec<String>)> = None;
    visit(table, &mut Vec::new(), &mut |entry, path| {
        let before = entry.key == key && entry.key_at.range.end <= at.range.start;
        if before && best.as_ref().is_none_or(|(span, _)| span.range.start <= entry.key_at.range.start) {
            best = Some((entry.key_at.clone(), path.to_vec()));
        }
    });
    let (span, found) = best?;
    *path = found;
    Some(span)
}

fn visit(table: &Table, path: &mut Vec<String>, see: &mut impl FnMut(&Entry, &[String])) {
    for entry in &table.0 {
        see(entry, path);
        if let Value::Table(inner) = &entry.value.value {
            path.push(entry.key.clone());
            visit(inner, path, see);
            path.pop();
        }
    }
}
