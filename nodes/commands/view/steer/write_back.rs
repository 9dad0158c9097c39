//! Changes written into the text of a graph file, whose comments and order stay.

use osteoflow_engine::durable;
use std::{fs, io::Write, path::Path};
use toml_edit::{Array, DocumentMut, Item, Table, TableLike};

/// The text with these values set and these keys removed.
///
/// # Errors
/// A sentence for the user: the text is no TOML, or something that is no table is where a table must be.
pub(super) fn edited(
    text: &str,
    path: &Path,
    values: &[(String, toml::Value)],
    removed: &[String],
) -> Result<String, String> {
    let mut document: DocumentMut =
        text.parse().map_err(|error| format!("{} cannot be read: {error}", path.display()))?;
    for key in removed {
        let parts: Vec<&str> = key.split('.').collect();
        if !remove(document.as_table_mut(), &parts) {
            // It is in a file that this one extends.
            let list = document.entry("remove").or_insert_with(|| Array::new().into());
            let list = list.as_array_mut().ok_or("`remove` is no list")?;
            list.push(key.as_str());
        }
    }
    for (key, value) in values {
        let (first, rest) = key.split_once('.').ok_or_else(|| format!("\"{key}\" has no dot"))?;
        // A node's name may be short for node.NAME, as on the command line.
        let of_node = !["graph", "node", "record", "results", "module", "sweep"].contains(&first);
        let parts: Vec<&str> = of_node.then_some("node").into_iter().chain([first]).chain(rest.split('.')).collect();
        set(document.as_table_mut(), &parts, &near(value, path))?;
    }
    Ok(document.to_string())
}

/// A path below the graph file's folder is relative to it, as in a graph that is moved with its files.
fn near(value: &toml::Value, graph: &Path) -> toml::Value {
    let folder = graph.canonicalize().ok().and_then(|graph| graph.parent().map(Path::to_owned));
    let relative =
        value.as_str().map(Path::new).filter(|path| path.is_absolute()).zip(folder).and_then(|(path, folder)| {
            path.canonicalize().ok()?.strip_prefix(folder).ok()?.to_str().map(str::to_owned)
        });
    relative.map_or_else(|| value.clone(), toml::Value::String)
}

fn remove(table: &mut dyn TableLike, parts: &[&str]) -> bool {
    match parts {
        [] => false,
        [last] => table.remove(last).is_some(),
        [first, rest @ ..] => {
            table.get_mut(first).and_then(Item::as_table_like_mut).is_some_and(|inner| remove(inner, rest))
        }
    }
}

fn set(table: &mut dyn TableLike, parts: &[&str], value: &toml::Value) -> Result<(), String> {
    let (first, rest) = parts.split_first().ok_or("a key is empty")?;
    if rest.is_empty() {
        let value: toml_edit::Value = value.to_string().parse().map_err(|error| format!("{first}: {error}"))?;
        match table.get_mut(first).and_then(Item::as_value_mut) {
            Some(old) => {
                // The comment behind the old value stays.
                let decor = old.decor().clone();
                *old = value;
                *old.decor_mut() = decor;
            }
            None => {
                table.insert(first, Item::Value(value));
            }
        }
        return Ok(());
    }
    let inner = table.entry(first).or_insert_with(|| {
        let mut inner = Table::new();
        // [node] itself is written only if it has keys of its own.
        inner.set_implicit(true);
        Item::Table(inner)
    });
    let inner = inner.as_table_like_mut().ok_or_else(|| format!("{first} is no table"))?;
    set(inner, rest, value)
}

/// Replaces the file if it still has the text that was read.
///
/// # Errors
/// A sentence for the user; the file is as it was.
pub(super) fn replace(path: &Path, before: &str, text: &str) -> Result<(), String> {
    let fault = |error: std::io::Error| format!("{} cannot be written: {error}", path.display());
    // A link is followed: the file itself is replaced, and keeps its permissions.
    let path = path.canonicalize().map_err(fault)?;
    let mut part = durable::Part::new(&path).map_err(fault)?;
    part.file().write_all(text.as_bytes()).map_err(fault)?;
    let permissions = fs::metadata(&path).map_err(fault)?.permissions();
    if permissions.readonly() {
        return Err(format!("{} is read-only", path.display()));
    }
    part.file().set_permissions(permissions).map_err(fault)?;
    if fs::read_to_string(&path).map_err(fault)? != before {
        return Err(format!("{} was changed by another program meanwhile; write again", path.display()));
    }
    part.replace().map_err(fault)
}

#[cfg(test)]
mod tests {
    use super::*;

    const GRAPH: &str = r#"# A graph.
extends = "base.toml"

[node.icp]                     # fine
kind = "icp.point_to_plane"    # or another
in   = { source = "a.b" }
max_pair_distance_mm = 5.0     # twice the coarse error
trim_fraction = 0.1

# The end.
[results]
icp = "icp.report"
"#;

    fn edit(values: &[(&str, toml::Value)], removed: &[&str]) -> Result<String, String> {
        let values: Vec<_> = values.iter().map(|(key, value)| ((*key).to_owned(), value.clone())).collect();
        let removed: Vec<_> = removed.iter().map(|key| (*key).to_owned()).collect();
        edited(GRAPH, Path::new("/nonexistent/graph.toml"), &values, &removed)
    }

    #[test]
    fn only_the_changed_values_change() {
        let text =
            edit(&[("icp.kind", "icp.symmetric".into()), ("icp.max_pair_distance_mm", 3.5.into())], &[]).unwrap();
        let expected = GRAPH
            .replace("\"icp.point_to_plane\"    #", "\"icp.symmetric\"    #")
            .replace("= 5.0     #", "= 3.5     #");
        assert_eq!(text, expected);
    }

    #[test]
    fn new_keys_are_added_to_their_tables_and_foreign_ones_are_removed_by_name() {
        let values = [("icp.max_iterations", 7.into()), ("coarse.max_fre_mm", 2.0.into()), ("graph.seed", 3.into())];
        let text = edit(&values, &["node.icp.trim_fraction", "node.coarse.min_confidence"]).unwrap();
        let read: toml::Table = text.parse().unwrap();
        assert_eq!(read["node"]["icp"].get("trim_fraction"), None);
        assert_eq!(read["node"]["icp"]["max_iterations"].as_integer(), Some(7));
        assert_eq!(read["node"]["coarse"]["max_fre_mm"].as_float(), Some(2.0));
        assert_eq!(read["graph"]["seed"].as_integer(), Some(3));
        assert_eq!(read["remove"].as_array().unwrap(), &["node.coarse.min_confidence".into()]);
        for kept in ["# A graph.", "# or another", "# twice the coarse error", "# The end."] {
            assert!(text.contains(kept), "{text}");
        }
    }

    #[test]
    fn a_value_where_a_table_must_be_is_refused() {
        assert_eq!(edit(&[("icp.kind.name", 1.into())], &[]).unwrap_err(), "kind is no table");
        assert!(edited("a = [", Path::new("g.toml"), &[], &[]).unwrap_err().contains("g.toml cannot be read"));
    }

    #[test]
    fn a_file_that_changed_meanwhile_or_is_read_only_stays_as_it_is() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("graph.toml");
        fs::write(&path, "a = 1\n").unwrap();
        assert!(replace(&path, "a = 0\n", "b = 1\n").unwrap_err().contains("another program"));
        assert_eq!(fs::read_to_string(&path).unwrap(), "a = 1\n");
        replace(&path, "a = 1\n", "b = 1\n").unwrap();
        let mut permissions = fs::metadata(&path).unwrap().permissions();
        permissions.set_readonly(true);
        fs::set_permissions(&path, permissions).unwrap();
        assert!(replace(&path, "b = 1\n", "c = 1\n").unwrap_err().contains("read-only"));
        assert_eq!(fs::read_to_string(&path).unwrap(), "b = 1\n");
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 1, "no side file is left");
    }
}
