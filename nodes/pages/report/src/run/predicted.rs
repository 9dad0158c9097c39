//! The errors that a verdict predicts, as tables.

use crate::{
    cell::Cell,
    format::number,
    html::Page,
    summary::{TableRow, from_to},
};
use serde_json::Value as Json;

/// Tables of the predicted errors and of their terms, as far as `predicted` has them.
pub(super) fn tables(page: &mut Page, predicted: &Json) {
    let mut rows: Vec<TableRow> = Vec::new();
    rows.extend(row("assessment points, mean".into(), &predicted["assessment"]));
    rows.extend(row("cuts, mean".into(), &predicted["all_cuts"]));
    for (what, key) in [("point", "points"), ("cut", "cuts")] {
        match &predicted[key] {
            Json::Array(items) => rows.extend(items.iter().filter_map(|item| row(named(what, item), item))),
            other => rows.extend(row(key.into(), other)),
        }
    }
    page.rows("Errors predicted by the verdict; intervals as its node computes them.", &rows);
    let terms = predicted["terms"].as_array().into_iter().flatten();
    let terms: Vec<_> = terms.filter_map(|term| row(named("", term), term)).collect();
    page.rows("Terms of the predicted errors.", &terms);
}

fn named(what: &str, item: &Json) -> String {
    format!("{what} {}", item["name"].as_str().unwrap_or("?")).trim().to_owned()
}

/// The row of an error; `None` if it has no number.
fn row(name: String, of: &Json) -> Option<TableRow> {
    let numbers = [
        ("TRE (mm)", single(&of["tre_mm"]).or_else(|| single(&of["mean_tre_mm"]))),
        ("interval (mm)", interval(&of["interval_mm"])),
        ("interval with the bias of the CT (mm)", interval(&of["interval_with_ct_bias_mm"])),
        ("semi-axes of 90 % (mm)", semi_axes(&of["semi_axes_mm"])),
        ("tilt (\u{b0})", single(&of["tilt_deg"])),
    ];
    let cells: TableRow = numbers.into_iter().filter_map(|(head, cell)| Some((head.to_owned(), cell?))).collect();
    (!cells.is_empty()).then(|| [("error of".to_owned(), Cell::word(name))].into_iter().chain(cells).collect())
}

fn single(value: &Json) -> Option<Cell> {
    value.as_f64().map(Cell::Number)
}

fn interval(value: &Json) -> Option<Cell> {
    let (low, high) = (value.get(0)?.as_f64()?, value.get(1)?.as_f64()?);
    Some(Cell::word(from_to(low, high)))
}

fn semi_axes(value: &Json) -> Option<Cell> {
    let axes: Option<Vec<String>> = value.as_array()?.iter().map(|mm| mm.as_f64().map(number)).collect();
    Some(Cell::word(axes?.join("\u{a0}\u{d7}\u{a0}")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn shown(predicted: &Json) -> String {
        let mut page = Page::new("", false);
        tables(&mut page, predicted);
        page.finish("").0.replace("<wbr>", "")
    }

    #[test]
    fn what_is_predicted_is_shown_and_what_is_missing_is_left_out() {
        let html = shown(&json!({
            "points": [{ "name": "A1", "tre_mm": 0.5, "interval_mm": [0.25, 1.25] }, { "name": "A2" }, 3],
            "cuts": [{ "name": "cut_1", "tre_mm": 0.75, "interval_mm": [0.5, 1.5], "tilt_deg": 2.5 }],
            "assessment": { "mean_tre_mm": 0.625, "interval_mm": [0.375, 1.0], "interval_with_ct_bias_mm": [0.4, 1.75] },
            "all_cuts": { "mean_tre_mm": 0.875 },
            "terms": [{ "name": "landmarks", "tre_mm": 0.125 }],
        }));
        for text in [
            "point A1",
            "0.250\u{a0}to\u{a0}1.250<",
            "cut cut_1",
            "2.500",
            "0.400\u{a0}to\u{a0}1.750<",
            "0.875",
            "landmarks",
        ] {
            assert!(html.contains(text), "{text} is missing:\n{html}");
        }
        assert!(!html.contains("A2"), "it has no number");
        let object = shown(&json!({ "cuts": { "interval_mm": [0.5, 1.5] } }));
        assert!(object.contains("<td>cuts</td><td>0.500\u{a0}to\u{a0}1.500</td>"), "{object}");
        for nothing in
            [json!(null), json!({}), json!({ "points": "soon", "cuts": [[]], "assessment": { "interval_mm": [1] } })]
        {
            assert!(!shown(&nothing).contains("<table>"), "{nothing}");
        }
    }
}
