//! JSON as tables, whatever a graph has put into it.

use crate::{cell::Cell, html::Page};
use serde_json::{Map, Value as Json};

/// Longer lists are told by their length; the file has them.
const MOST_ROWS: usize = 40;

/// All results: lists of like things as tables, everything else by its key.
pub(crate) fn results(page: &mut Page, results: &Json) {
    let Some(results) = results.as_object() else {
        return page.missing("The results", "the run left no results.json");
    };
    let mut rows = Vec::new();
    let mut lists = Vec::new();
    results.iter().for_each(|(key, value)| walk(key, value, &mut rows, &mut lists));
    for (path, items) in lists {
        objects(page, &path.replace('_', " ").replace('.', ": "), &items);
    }
    let head = ["result", "value"].map(String::from);
    page.fold(&format!("All single results ({})", rows.len()));
    page.table("Every result that is one number or word, by its path in results.json.", &head, &rows);
    page.unfold();
}

/// Keys and values below a path, and the lists of objects.
fn walk(path: &str, value: &Json, rows: &mut Vec<Vec<Cell>>, lists: &mut Vec<(String, Vec<Map<String, Json>>)>) {
    match value {
        Json::Object(object) => object.iter().for_each(|(key, v)| walk(&format!("{path}.{key}"), v, rows, lists)),
        Json::Array(items) if !items.is_empty() && items.iter().all(Json::is_object) => {
            lists.push((path.into(), items.iter().filter_map(Json::as_object).cloned().collect()));
        }
        // Matrices and long columns are for programs.
        Json::Array(items) if items.len() > 6 || items.iter().any(Json::is_array) => {}
        other => rows.push(vec![Cell::Code(path.into()), Cell::of(other)]),
    }
}

/// An object with the keys of objects in it as `a.b`, without what is no cell.
fn flat(object: &Map<String, Json>) -> Map<String, Json> {
    let mut out = Map::new();
    for (key, value) in object {
        match value {
            Json::Object(inner) => {
                out.extend(flat(inner).into_iter().map(|(inner, value)| (format!("{key}.{inner}"), value)));
            }
            Json::Array(items) if items.len() > 3 || items.iter().any(|item| !item.is_number()) => {}
            other => drop(out.insert(key.clone(), other.clone())),
        }
    }
    out
}

/// A table with a row for each object.
pub(crate) fn objects(page: &mut Page, caption: &str, items: &[Map<String, Json>]) {
    let items: Vec<_> = items.iter().map(flat).collect();
    let mut keys: Vec<&String> = Vec::new();
    for key in items.iter().flat_map(Map::keys) {
        if !keys.contains(&key) {
            keys.push(key);
        }
    }
    keys.retain(|key| items.iter().any(|item| item.get(*key).is_some_and(|value| !value.is_null())));
    let head: Vec<String> = keys.iter().map(|key| key.replace('_', " ")).collect();
    let row =
        |item: &Map<String, Json>| keys.iter().map(|key| Cell::of(item.get(*key).unwrap_or(&Json::Null))).collect();
    let rows: Vec<Vec<Cell>> = items.iter().take(MOST_ROWS).map(row).collect();
    let cut =
        if items.len() > MOST_ROWS { format!(", the first {MOST_ROWS} of {}", items.len()) } else { String::new() };
    page.table(&format!("{caption}{cut}."), &head, &rows);
}
