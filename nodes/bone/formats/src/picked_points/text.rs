//! Picking lists of CloudCompare and MeshLab, CSV and bare coordinates.

use super::{Collected, PickedPoints};
use crate::{
    FileError, Space,
    cloud_text::{Split, has_words, heading_names},
    scalar::number,
    space::StatedSpace,
};
use std::path::Path;

/// The most elements of an XML file that are read.
const MOST_NODES: u32 = 1 << 20;

fn fault(path: &Path, line: usize, message: impl Into<String>) -> FileError {
    FileError::content(path, format!("line {line}"), message)
}

/// The cells of a line; quotes enclose a cell that holds the separator, and are doubled within it.
pub(super) fn cells(line: &str, separator: char) -> Vec<String> {
    let mut cells = vec![String::new()];
    let mut quoted = false;
    let mut chars = line.trim_end_matches(['\r', '\n']).chars().peekable();
    while let Some(c) = chars.next() {
        let last = cells.last_mut().expect("there is one");
        match c {
            '"' if quoted && chars.peek() == Some(&'"') => {
                chars.next();
                last.push('"');
            }
            '"' if quoted || last.trim().is_empty() => quoted = !quoted,
            c if c == separator && !quoted => cells.push(String::new()),
            c => last.push(c),
        }
    }
    cells
}

/// The points in a `.pp` file of MeshLab.
pub(super) fn meshlab(path: &Path, text: &str) -> Result<PickedPoints, FileError> {
    if text.contains("<!ENTITY") {
        return Err(FileError::content(path, "header", "entities in XML are not read; MeshLab writes none"));
    }
    let options = roxmltree::ParsingOptions { allow_dtd: true, nodes_limit: MOST_NODES };
    let document = roxmltree::Document::parse_with_options(text, options)
        .map_err(|error| fault(path, error.pos().row as usize, error.to_string()))?;
    let root = document.root_element();
    if !root.has_tag_name("PickedPoints") {
        let name = root.tag_name().name();
        return Err(fault(path, 1, format!("the XML holds \"{name}\"; the PickedPoints of MeshLab are expected")));
    }
    let mut collected = Collected::default();
    for point in root.descendants().filter(|node| node.has_tag_name("point")) {
        let line = document.text_pos_at(point.range().start).row as usize;
        match point.attribute("active") {
            Some("0" | "false") => {
                collected.n_skipped += 1;
                continue;
            }
            None | Some("1" | "true") => {}
            Some(other) => return Err(fault(path, line, format!("active is \"{other}\"; 0 or 1 is expected"))),
        }
        let value = |name: &str| {
            let text = point.attribute(name).ok_or_else(|| fault(path, line, format!("the point has no {name}")))?;
            number(text.trim()).ok_or_else(|| fault(path, line, format!("{name} is \"{text}\"; a number is expected")))
        };
        let position = [value("x")?, value("y")?, value("z")?];
        let name = point.attribute("name").unwrap_or_default();
        collected.push(name, position, Space::Unknown).map_err(|message| fault(path, line, message))?;
    }
    Ok(collected.finish(Space::Unknown))
}

/// The points in a text: three numbers a line, with a label or an index before them, or columns that a heading names.
pub(super) fn list(path: &Path, text: &str) -> Result<PickedPoints, FileError> {
    let mut stated = StatedSpace::default();
    let mut comment_heading = None;
    let mut rows: Vec<(&str, usize)> = Vec::new();
    for (line, number) in text.lines().zip(1..) {
        let line = line.trim_matches(' ').trim_end();
        match line.strip_prefix('#').or_else(|| line.strip_prefix("//")) {
            // CloudCompare begins the labels of points with this sign.
            Some(comment) if !is_labelled(comment) => {
                stated.take(comment).map_err(|message| fault(path, number, message))?;
                if rows.is_empty() && axes_named(&heading_names(comment)) == 3 {
                    comment_heading = Some((heading_names(comment), number));
                }
            }
            None if line.is_empty() => {}
            _ => rows.push((line, number)),
        }
    }
    let space = stated.space;
    let mut collected = Collected::default();
    collected.notes.extend(stated.note);
    let Some(&(first, first_number)) = rows.first() else { return Ok(collected.finish(space)) };
    let split = Split::of(&rows, None).map_err(|(number, message)| fault(path, number, message))?;
    let first_cells = split_line(&split, first);
    let mut rows = &rows[..];
    let heading = if has_words(first) && axes_named(&first_cells) >= 2 {
        rows = &rows[1..];
        Some((first_cells, first_number))
    } else {
        // A sentence about x, y and z is no heading.
        comment_heading.filter(|(names, _)| names.len() == first_cells.len())
    };
    let mut columns = None;
    if let Some((names, first_number)) = &heading {
        let first_number = *first_number;
        if let Some((k, name)) =
            names.iter().enumerate().find(|(k, name)| names[..*k].iter().any(|other| other.eq_ignore_ascii_case(name)))
        {
            return Err(fault(
                path,
                first_number,
                format!("column {} is called \"{name}\" as one before it is", k + 1),
            ));
        }
        let place = |name: &str| names.iter().position(|found| found.eq_ignore_ascii_case(name));
        let label = ["label", "name", "id"].iter().find_map(|name| place(name));
        let axis = |name: &str| {
            let message = || format!("no column is called \"{name}\"; there are: {}", names.join(", "));
            place(name).ok_or_else(|| fault(path, first_number, message()))
        };
        let axes = [axis("x")?, axis("y")?, axis("z")?];
        let unused: Vec<&str> =
            (0..names.len()).filter(|k| !axes.contains(k) && label != Some(*k)).map(|k| names[k].as_str()).collect();
        if !unused.is_empty() {
            collected.notes.push(format!("columns that were not read: {}", unused.join(", ")));
        }
        columns = Some((label, axes, names.len()));
    }
    // Four numbers are an index and a point; the index is no name.
    let is_index = |(line, _): &(&str, usize)| {
        let cells = split_line(&split, line);
        cells.len() == 4 && cells[0].parse::<u64>().is_ok()
    };
    let is_indexed = columns.is_none() && !rows.is_empty() && rows.iter().all(is_index);
    if is_indexed {
        collected.notes.push("the first of four numbers is taken for an index, not for a name".into());
    }
    let width = columns.map_or_else(|| split_line(&split, first).len(), |(_, _, n)| n);
    for &(line, line_number) in rows {
        let cells = split_line(&split, line);
        let fault = |message: String| fault(path, line_number, message);
        // Blanks may be within a label, but numbers alone are more than a point.
        let label_may_grow =
            split.separator.is_none() && columns.is_none() && cells.len() > 4 && number(&cells[0]).is_none();
        if cells.len() != width && !label_may_grow {
            return Err(fault(format!("{width} columns are expected, this line has {}", cells.len())));
        }
        let n = cells.len();
        let (label, axes) = match columns {
            Some((label, axes, _)) => (label.map(|k| cells[k].clone()), axes),
            None if n < 3 || (n > 4 && !label_may_grow) => {
                return Err(fault(format!("a label and three numbers are expected, this line has {n} columns")));
            }
            None if n == 3 || is_indexed => (None, [n - 3, n - 2, n - 1]),
            None => (Some(cells[..n - 3].join(" ")), [n - 3, n - 2, n - 1]),
        };
        let mut position = [0.0; 3];
        for (value, k) in position.iter_mut().zip(axes) {
            *value = split.number(&cells[k]).ok_or_else(|| fault(format!("\"{}\" is not a number", cells[k])))?;
        }
        collected.push(label.as_deref().unwrap_or_default(), position, space).map_err(fault)?;
    }
    Ok(collected.finish(space))
}

/// Whether `#` begins the label of a point, as in `#0,1,2,3`, and not a comment.
fn is_labelled(comment: &str) -> bool {
    let mut cells = comment.split([',', ';']);
    let is_label = cells.next().is_some_and(|label| label.parse::<u64>().is_ok());
    is_label && cells.clone().count() == 3 && cells.all(|cell| number(cell.trim()).is_some())
}

/// How many of x, y and z are among the names.
fn axes_named(names: &[String]) -> usize {
    ["x", "y", "z"].iter().filter(|axis| names.iter().any(|name| name.eq_ignore_ascii_case(axis))).count()
}

fn split_line(split: &Split, line: &str) -> Vec<String> {
    match split.separator {
        Some(separator) => {
            let line = if split.trailing { line.strip_suffix(separator).unwrap_or(line) } else { line };
            cells(line, separator).iter().map(|cell| cell.trim().to_owned()).collect()
        }
        None => line.split_ascii_whitespace().map(str::to_owned).collect(),
    }
}
