//! Tables of arbitrary JSON results.

use crate::{cell::Cell, chart::axis_label, degrees::in_degrees, format::number, html::Page};
use nalgebra::{Isometry3, Matrix4};
use osteoflow_geometry::isometry_from_matrix;
use serde::Deserialize;
use serde_json::{Map, Value as Json};

/// A table of more columns is turned if it has few rows.
const MAX_COLUMNS: usize = 10;
/// Longer lists are shown by their length only.
const MAX_ROWS: usize = 40;

/// Keys of a verdict that every verdict has.
const VERDICT: [&str; 5] = ["answer", "sentence", "reasons", "assumptions", "predicted"];

/// All results: lists of similar objects as tables, everything else by key.
pub(crate) fn results(page: &mut Page, results: &Json) {
    let Some(results) = results.as_object() else {
        return page.missing("The results", "the run has no results.json");
    };
    let mut tables = ResultTables::default();
    for (key, value) in results {
        match (key.as_str(), value) {
            // The head of the page shows the verdict.
            ("verdict", Json::Object(verdict)) => {
                let others = verdict.iter().filter(|(key, _)| !VERDICT.contains(&key.as_str()));
                others.for_each(|(key, value)| tables.walk(&format!("verdict.{key}"), value));
            }
            _ => tables.walk(key, value),
        }
    }
    let laser_points = named(results.get("laser_points"));
    for (path, mut items) in tables.lists {
        if path == "holes" && items.len() == laser_points.len() {
            // A hole's report has no name; the points of the same scans have, in the same order.
            items.iter_mut().zip(&laser_points).for_each(|(hole, point)| {
                *hole = point.iter().chain(&*hole).map(|(key, value)| (key.clone(), value.clone())).collect();
            });
        }
        objects(page, &path.replace('_', " ").replace('.', ": "), &items);
    }
    if !tables.poses.is_empty() {
        let title = format!("Poses ({})", tables.poses.len());
        let caption = "Every pose t_to_from by its path in results.json: the position of the origin of one frame in the other, \
                       and the rotation between their axes.";
        let head = ["pose", "to", "from", "x (mm)", "y (mm)", "z (mm)", "rotation (\u{b0})", "about"];
        page.folded_table(&title, caption, &head, &tables.poses);
    }
    let title = format!("All single results ({})", tables.singles.len());
    let caption = "Every result that is one number or word, by its path in results.json.";
    page.folded_table(&title, caption, &["result", "value"], &tables.singles);
}

/// Name, frame and position of each point.
fn named(points: Option<&Json>) -> Vec<Map<String, Json>> {
    let keys = ["name", "frame", "position_mm"];
    let point = |point: &Json| keys.iter().filter_map(|key| Some(((*key).into(), point.get(key)?.clone()))).collect();
    points.and_then(Json::as_array).into_iter().flatten().map(point).collect()
}

/// Results by form.
#[derive(Default)]
struct ResultTables {
    /// Rows of key and value.
    singles: Vec<Vec<Cell>>,
    /// Lists of objects by path.
    lists: Vec<(String, Vec<Map<String, Json>>)>,
    /// Rows of poses.
    poses: Vec<Vec<Cell>>,
}

impl ResultTables {
    /// Collects the values below a path.
    fn walk(&mut self, path: &str, value: &Json) {
        match value {
            Json::Object(object) => match pose(path, object) {
                Some(row) => self.poses.push(row),
                None => object.iter().for_each(|(key, value)| self.walk(&format!("{path}.{key}"), value)),
            },
            Json::Array(items) if !items.is_empty() && items.iter().all(Json::is_object) => {
                self.lists.push((path.into(), items.iter().filter_map(Json::as_object).cloned().collect()));
            }
            // Long lists of numbers are for programs.
            Json::Array(items) if items.len() > 6 || items.iter().any(Json::is_array) => {}
            other => {
                let (path, value) = in_degrees(path, other);
                self.singles.push(vec![Cell::Code(path), Cell::of(&value)]);
            }
        }
    }
}

/// The row of a pose; `None` if the object is not a pose.
fn pose(path: &str, object: &Map<String, Json>) -> Option<Vec<Cell>> {
    let frame = |key: &str| Some(Cell::Code(object.get(key)?.as_str()?.into()));
    let pose = rigid(object.get("matrix")?)?;
    let mut cells = vec![Cell::Code(path.into()), frame("to")?, frame("from")?];
    cells.extend(pose.translation.vector.iter().map(|x| Cell::Number(*x)));
    cells.push(Cell::Number(pose.rotation.angle().to_degrees()));
    let about = pose.rotation.axis().map(|axis| axis.iter().map(|x| number(*x)).collect::<Vec<_>>().join(", "));
    cells.push(Cell::word(about.unwrap_or_default()));
    Some(cells)
}

/// The rigid motion of the rows of a matrix.
fn rigid(matrix: &Json) -> Option<Isometry3<f64>> {
    let rows = <[[f64; 4]; 4]>::deserialize(matrix).ok()?;
    isometry_from_matrix(&Matrix4::from_fn(|row, column| rows[row][column])).ok()
}

/// The object with the keys of nested objects as `a.b`, without values that do not fit a cell.
fn flat(object: &Map<String, Json>) -> Map<String, Json> {
    let mut out = Map::new();
    for (key, value) in object {
        match value {
            Json::Array(_) if key == "matrix" => out.extend(placed(value)),
            Json::Object(inner) => {
                out.extend(flat(inner).into_iter().map(|(inner, value)| (format!("{key}.{inner}"), value)));
            }
            Json::Array(items) if items.len() > 3 || items.iter().any(|item| !item.is_number()) => {}
            other => out.extend([in_degrees(key, other)]),
        }
    }
    out
}

/// Origin and z axis of a pose, which for a plane is its normal; nothing if the value is no pose.
fn placed(matrix: &Json) -> Map<String, Json> {
    let Some(pose) = rigid(matrix) else { return Map::new() };
    let list = |v: &nalgebra::Vector3<f64>| Json::from(v.as_slice());
    let axis = pose.rotation * nalgebra::Vector3::z();
    Map::from_iter([("origin_mm".to_owned(), list(&pose.translation.vector)), ("normal".to_owned(), list(&axis))])
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
    let head: Vec<String> = keys.iter().map(|key| axis_label(key)).collect();
    let row =
        |item: &Map<String, Json>| keys.iter().map(|key| Cell::of(item.get(*key).unwrap_or(&Json::Null))).collect();
    let rows: Vec<Vec<Cell>> = items.iter().take(MAX_ROWS).map(row).collect();
    let cut = if items.len() > MAX_ROWS { format!(", the first {MAX_ROWS} of {}", items.len()) } else { String::new() };
    let caption = format!("{caption}{cut}.");
    // Few objects of many values are read from top to bottom: beside each other the values would not fit the page.
    if head.len() > MAX_COLUMNS && rows.len() < head.len() / 2 {
        let turned: Vec<Vec<Cell>> = (1..head.len())
            .map(|k| std::iter::once(Cell::word(&head[k])).chain(rows.iter().map(|row| row[k].clone())).collect())
            .collect();
        let first = std::iter::once(head[0].clone());
        let head: Vec<String> = first.chain(rows.iter().map(|row| row[0].plain())).collect();
        return page.table(&caption, &head, &turned);
    }
    page.table(&caption, &head, &rows);
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn planes_have_poses_and_holes_have_the_names_of_their_points() {
        let plane = [[1.0, 0.0, 0.0, 10.5], [0.0, 0.0, 1.0, -2.0], [0.0, -1.0, 0.0, 3.0], [0.0, 0.0, 0.0, 1.0]];
        let mut page = Page::new("", false);
        results(
            &mut page,
            &json!({
                "planes": [{ "name": "plane_1", "frame": "world", "matrix": plane }, { "name": "plane_2", "unknown": "lost" }],
                "laser_points": [{ "name": "P1", "position_mm": [7.25, 1.5, -8.5], "confidence": 1.0 }],
                "holes": [{ "n_hole": 72 }],
            }),
        );
        let html = page.finish("").0.replace("<wbr>", "");
        let table = |caption: &str| {
            let end = html.find(caption).unwrap_or_else(|| panic!("no table {caption}:\n{html}"));
            html[end..].split("</table>").next().unwrap().to_owned()
        };
        let planes = table("planes");
        for text in ["origin (mm)", "10.5", "normal", "plane_2", "lost"] {
            assert!(planes.contains(text), "{text} is missing:\n{planes}");
        }
        let holes = table("holes");
        assert!(holes.contains("P1") && holes.contains("7.25") && holes.contains("72"), "{holes}");
    }

    #[test]
    fn angles_are_in_degrees_and_few_objects_of_many_values_are_read_downwards() {
        let mut page = Page::new("", false);
        let many = |name: &str| {
            let name = [("name".to_owned(), json!(name))];
            let values = name.into_iter().chain((0..12).map(|k| (format!("value_{k}"), json!(k))));
            values.collect::<Map<_, _>>()
        };
        results(
            &mut page,
            &json!({
                "cuts": [{ "name": "plane_1", "tilt_rad": std::f64::consts::FRAC_PI_2 }],
                "step_rad": 0.5_f64.to_radians(),
                "turned_rad": [std::f64::consts::PI, 0.0, 0.0],
                "holes_like": [many("P1"), many("P2")],
            }),
        );
        let html = page.finish("").0.replace("<wbr>", "");
        for text in ["tilt (\u{b0})", ">90<", "step_deg", "turned_deg", "180", "0.5"] {
            assert!(html.contains(text), "{text} is missing:\n{html}");
        }
        assert!(!html.contains("rad<") && !html.contains("_rad"), "{html}");
        let turned = &html[html.find("holes like").unwrap()..];
        let head = &turned[..turned.find("</thead>").unwrap()];
        // The first column of each object is its head, and each value has a row.
        assert_eq!(head.matches("<th ").count(), 3, "{head}");
        assert_eq!(turned[..turned.find("</table>").unwrap()].matches("<tr>").count(), 13, "{turned}");
    }

    #[test]
    fn a_pose_is_shown_as_origin_and_rotation_and_a_stamp_to_the_nanosecond() {
        let quarter = [[0.0, -1.0, 0.0, 10.5], [1.0, 0.0, 0.0, -2.0], [0.0, 0.0, 1.0, 3.0], [0.0, 0.0, 0.0, 1.0]];
        let mut page = Page::new("", false);
        results(
            &mut page,
            &json!({
                "poses": { "t_ct_world": { "to": "ct", "from": "world", "matrix": quarter } },
                "scan": { "stamp_ns": 1_700_000_000_123_456_789_i64, "matrix": [[1.0]] },
            }),
        );
        let html = page.finish("").0.replace("<wbr>", "");
        for text in ["Poses (1)", "poses.t_ct_world", "10.50", "\u{2212}2<", "90.00<", "0, 0, 1", "1700000000123456789"]
        {
            assert!(html.contains(text), "{text} is missing:\n{html}");
        }
    }
}
