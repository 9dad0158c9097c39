//! Picking lists of CloudCompare and MeshLab, CSV and bare coordinates.

use super::{PickedPoints, collected::Collected};
use crate::{
    FileError, Space,
    columns::{Lines, Split, axes, has_words, name_axes, place, quoted_cells, twice},
    cursor::Cursor,
    scalar::number,
};
use std::path::Path;

/// The most elements of an XML file that are read.
pub(super) const MOST_NODES: u32 = 1 << 20;

/// The points in a `.pp` file of MeshLab.
pub(super) fn meshlab(path: &Path, bytes: &[u8]) -> Result<PickedPoints, FileError> {
    let cursor = Cursor::text(path, bytes)?;
    let text = String::from_utf8_lossy(cursor.rest());
    if text.contains("<!ENTITY") {
        return Err(cursor.header_fault("entities in XML are not read; MeshLab writes none"));
    }
    let options = roxmltree::ParsingOptions { allow_dtd: true, nodes_limit: MOST_NODES };
    let document = roxmltree::Document::parse_with_options(&text, options)
        .map_err(|error| cursor.fault_at(error.pos().row as usize, error.to_string()))?;
    let root = document.root_element();
    if !root.has_tag_name("PickedPoints") {
        let name = root.tag_name().name();
        return Err(cursor.fault(format!("the XML holds \"{name}\"; the PickedPoints of MeshLab are expected")));
    }
    let mut collected = Collected::default();
    for point in root.descendants().filter(|node| node.has_tag_name("point")) {
        let fault = |message| cursor.fault_at(document.text_pos_at(point.range().start).row as usize, message);
        match point.attribute("active") {
            Some("0" | "false") => {
                collected.n_skipped += 1;
                continue;
            }
            None | Some("1" | "true") => {}
            Some(other) => return Err(fault(format!("active is \"{other}\"; 0 or 1 is expected"))),
        }
        let value = |name: &str| {
            let text = point.attribute(name).ok_or_else(|| fault(format!("the point has no {name}")))?;
            number(text.trim()).ok_or_else(|| fault(format!("{name} is \"{text}\"; a number is expected")))
        };
        let position = [value("x")?, value("y")?, value("z")?];
        collected.push(point.attribute("name").unwrap_or_default(), position, Space::Unknown).map_err(fault)?;
    }
    Ok(collected.finish(Space::Unknown))
}

/// The points in a text: three numbers a line, with a label or an index before them, or columns that a heading names.
pub(super) fn list(path: &Path, bytes: &[u8]) -> Result<PickedPoints, FileError> {
    let cursor = Cursor::text(path, bytes)?;
    // CloudCompare begins the labels of points with the sign of a comment.
    let lines = Lines::read(cursor, is_labelled, |names, rows| rows.is_empty() && axes_named(names) == 3)?;
    let mut stated = lines.stated;
    let mut space = stated.space;
    let mut collected = Collected::default();
    collected.notes.extend(stated.note.take());
    let mut rows = &lines.rows[..];
    let Some((first, first_line)) = rows.first() else { return Ok(collected.finish(space)) };
    let split = Split::of(&cursor, rows, None)?;
    let first_cells = split_line(&split, first);
    let mut heading = if has_words(first) && axes_named(&first_cells) >= 2 {
        rows = &rows[1..];
        Some((first_cells.clone(), *first_line))
    } else {
        // A sentence about x, y and z is no heading.
        lines.heading.filter(|(names, _)| names.len() == first_cells.len())
    };
    let (mut named, mut own) = (None, [None; 2]);
    if let Some((names, line)) = &mut heading {
        let fault = |message: String| cursor.fault_at(*line, message);
        name_axes(names, &mut stated).map_err(fault)?;
        stated.check_unit(1.0).map_err(fault)?;
        twice(names, str::eq_ignore_ascii_case).map_err(|message| cursor.fault_at(*line, message))?;
        let label = ["label", "name", "id"].iter().find_map(|name| place(names, name));
        let axes = axes(&cursor, names, *line)?;
        // As `output.csv` writes them.
        own = [place(names, "frame"), place(names, "stamp_ns")];
        let is_unused = |k: &usize| !axes.contains(k) && label != Some(*k) && !own.contains(&Some(*k));
        let unused: Vec<&str> = (0..names.len()).filter(is_unused).map(|k| names[k].as_str()).collect();
        if !unused.is_empty() {
            collected.notes.push(format!("columns that were not read: {}", unused.join(", ")));
        }
        named = Some((label, axes));
    }
    let rows: Vec<(Vec<String>, usize)> = rows.iter().map(|(row, line)| (split_line(&split, row), *line)).collect();
    // Four numbers are an index and a point; the index is no name.
    let is_index = |(cells, _): &(Vec<String>, usize)| cells.len() == 4 && cells[0].parse::<u64>().is_ok();
    let is_indexed = named.is_none() && !rows.is_empty() && rows.iter().all(is_index);
    if is_indexed {
        collected.notes.push("the first of four numbers is taken for an index, not for a name".into());
    }
    let width = heading.map_or(first_cells.len(), |(names, _)| names.len());
    for (cells, line) in rows {
        let fault = |message: String| cursor.fault_at(line, message);
        let n = cells.len();
        // Blanks may be within a label, but numbers alone are more than a point.
        let label_may_grow = split.separator.is_none() && named.is_none() && n > 4 && number(&cells[0]).is_none();
        if n != width && !label_may_grow {
            return Err(fault(format!("{width} columns are expected, this line has {n}")));
        }
        let (label, axes) = match named {
            Some((label, axes)) => (label.map(|k| cells[k].clone()), axes),
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
        let [frame, stamp] = own.map(|column| column.map(|k| cells[k].as_str()).filter(|cell| !cell.is_empty()));
        if let Some(frame) = frame {
            collected.in_frame(frame).map_err(fault)?;
            // `ct` is LPS wherever this program writes it.
            space = if space == Space::Unknown { Space::of(&frame.into()) } else { space };
        }
        collected.push(label.as_deref().unwrap_or_default(), position, space).map_err(fault)?;
        if let (Some(stamp), Some(point)) = (stamp, collected.points.last_mut()) {
            let whole =
                stamp.parse().map_err(|_| fault(format!("stamp_ns is \"{stamp}\", a whole number is expected")));
            point.stamp_ns = whole?;
        }
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
    ["x", "y", "z"].iter().filter(|axis| place(names, axis).is_some()).count()
}

fn split_line(split: &Split, line: &str) -> Vec<String> {
    match split.separator {
        Some(separator) => {
            quoted_cells(split.without_trailing(line), separator).iter().map(|cell| cell.trim().to_owned()).collect()
        }
        None => line.split_ascii_whitespace().map(str::to_owned).collect(),
    }
}
