//! The summary of a sweep as tables for a terminal.

use super::{global::Global, text_table::TextTable};
use osteoflow_report::{
    Cell,
    summary::{TableRow, about_few, comparison, in_degrees, statistics, under_heads, units, word},
};
use osteoflow_statistics::plural;
use serde_json::Value;

/// Columns of the page and the file that a terminal has no room for.
const LEFT_OUT: [&str; 2] = ["mean |.|", "min"];
/// And those that only --verbose shows.
const VERBOSE: [&str; 3] = ["RMS", "median", "n"];
/// Columns of comparisons that only --verbose shows.
const VERBOSE_COMPARED: [&str; 4] = ["n", "p", "effect", "unit"];
/// Most rows of statistics, and of comparisons beside them, so that both fit on a screen.
const MAX_ROWS: usize = 20;
const MAX_COMPARED: usize = 6;
/// Most rows of comparisons alone.
const MAX_COMPARED_ALONE: usize = 18;

/// The statistics of each column under each setting, and the comparisons.
pub(crate) fn text(summary: &Value, global: &Global) -> String {
    let is_brief = global.verbose == 0;
    let mut parts = Vec::new();
    let simulated = if summary["simulated"] == true { "SIMULATED, " } else { "" };
    let of = units(&summary["units"]);
    let counts = [Some(of).filter(|of| !of.is_empty()), verdicts(summary).map(|counts| format!("verdicts: {counts}"))];
    let counts: Vec<_> = counts.into_iter().flatten().collect();
    let counts = if counts.is_empty() { String::new() } else { format!("{}\n", counts.join("; ")) };
    parts.push(format!("{simulated}{}\n{counts}", summary["notice"].as_str().unwrap_or_default()));
    parts.push(of_groups(summary, is_brief));
    let few = if is_brief { few_in_short(summary) } else { about_few(summary) };
    parts.extend(few.map(|about| about + "\n"));
    parts.extend(comparisons(summary, is_brief, MAX_COMPARED));
    parts.join("\n")
}

/// A block of a table: a column of the sweep, with a row for each setting.
struct Block {
    name: String,
    rows: Vec<Row>,
}

struct Row {
    name: String,
    cells: TableRow,
    remark: String,
}

/// One table: below each column its settings.
fn of_groups(summary: &Value, is_brief: bool) -> String {
    let groups: Vec<&Value> = summary["groups"].as_array().into_iter().flatten().collect();
    let settings = groups.first().and_then(|group| group["setting"].as_object()).into_iter().flatten();
    let settings: Vec<_> = settings.map(|(name, _)| name.as_str()).collect();
    let mut blocks: Vec<Block> = Vec::new();
    for group in &groups {
        let columns = group["columns"].as_object().into_iter().flatten();
        let columns = columns.map(|(name, of)| in_degrees(name, of));
        let points = group["points"].as_object().into_iter().flatten().flat_map(|(measure, axes)| {
            let axes = axes.as_object().into_iter().flatten();
            axes.map(move |(axis, of)| {
                let (measure, of) = in_degrees(measure, of);
                (format!("{measure} {axis}"), of)
            })
        });
        let points = points.filter(|_| !is_brief);
        for (name, of) in columns.chain(points) {
            let row = row(group, &of, is_brief);
            match blocks.iter_mut().find(|block| block.name == name) {
                Some(block) => block.rows.push(row),
                None => blocks.push(Block { name, rows: vec![row] }),
            }
        }
    }
    // A setting of which no run has results stands in the first block, so that it is not overlooked.
    for (index, group) in groups.iter().enumerate() {
        if let Some(block) =
            blocks.first_mut().filter(|_| group["columns"].as_object().is_none_or(serde_json::Map::is_empty))
        {
            let row = Row { cells: Vec::new(), ..row(group, &Value::Null, is_brief) };
            block.rows.insert(index.min(block.rows.len()), row);
        }
    }
    let mut hidden = Vec::new();
    if is_brief {
        let mut n_rows = 0;
        let has_head = usize::from(!settings.is_empty());
        let n_shown = blocks.iter().take_while(|block| {
            n_rows += block.rows.len() + has_head;
            n_rows <= MAX_ROWS
        });
        let n_shown = n_shown.count().max(1).min(blocks.len());
        hidden.extend(blocks.drain(n_shown..).map(|block| block.name));
        if let [block] = &mut blocks[..]
            && block.rows.len() > MAX_ROWS
        {
            hidden.push(format!("{} more settings", block.rows.len() - MAX_ROWS));
            block.rows.truncate(MAX_ROWS);
        }
        let has_points = groups.iter().any(|group| group["points"].as_object().is_some_and(|of| !of.is_empty()));
        hidden.extend(has_points.then(|| "the points".to_owned()));
    }
    if blocks.is_empty() {
        return "no numbers: name those that are wanted in [sweep.columns], such as tre_mm = \"metrics.tre_true_mm.mean_abs.norm\"\n".into();
    }
    let title = if settings.is_empty() { "statistics".to_owned() } else { settings.join(", ") };
    let mut out = lines(&title, blocks, !settings.is_empty());
    if !hidden.is_empty() {
        out += &format!("  with --verbose: {}\n", hidden.join(", "));
    }
    out
}

fn row(group: &Value, of: &Value, is_brief: bool) -> Row {
    let setting = group["setting"].as_object().into_iter().flatten();
    let setting: Vec<_> = setting.map(|(_, value)| word(value)).collect();
    let mut remarks = Vec::new();
    let mut cells = statistics(of);
    // The lowest level, by its name: what the values are of.
    let levels = of["n_units"].as_array().map(Vec::as_slice).unwrap_or_default();
    // The number of independent values is that of the highest level, and no other number beside the runs or the lowest level.
    match levels {
        [] | [_] => cells.retain(|(head, _)| head != "n"),
        [highest, ..] if !is_brief => cells
            .iter_mut()
            .filter(|(head, _)| head == "n")
            .for_each(|(head, _)| *head = plural(&word(&highest["name"]))),
        _ => {}
    }
    if let Some(level) = levels.last() {
        cells.insert(0, (plural(&word(&level["name"])), Cell::Word(word(&level["n"]))));
    } else {
        cells.insert(0, ("runs".into(), Cell::Word(word(&of["n"]))));
    }
    let (of_group, of_column) = (units(&group["units"]), units(&of["n_units"]));
    cells.retain_mut(|(head, cell)| {
        // If some runs have no results, a column has fewer units than its setting.
        let below = head.starts_with("below ");
        if below && is_brief {
            let share = &of["share_below"];
            remarks.push(format!("{} of {} {head}", share["n_hits"], share["n"]));
        } else if below {
            remarks.push(format!("{head}: {}", cell.plain()));
        }
        if is_brief && head == INTERVAL {
            // What is said of few units stands below the table.
            let text = cell.plain();
            *cell = Cell::Word(text.split(" (few").next().unwrap_or_default().to_owned());
            *head = "95 % interval".into();
        }
        !below
            && head != "of"
            && !LEFT_OUT.contains(&head.as_str())
            && !(is_brief && (VERBOSE.contains(&head.as_str()) || head.starts_with("SD within")))
    });
    if !is_brief && of_group != of_column && !of_column.is_empty() {
        remarks.push(format!("of {of_column}"));
    }
    let answers = group["verdicts"].as_object();
    let n = |answer: &str| answers.and_then(|answers| answers.get(answer)?.as_u64()).unwrap_or_default();
    match is_brief {
        false => remarks.extend(verdicts(group)),
        true => remarks.extend(
            ["doubtful", "refused"]
                .into_iter()
                .filter(|answer| n(answer) > 0)
                .map(|answer| format!("{} {answer}", n(answer))),
        ),
    }
    Row { name: setting.join(", "), cells, remark: remarks.join("; ") }
}

/// Head of the column of intervals in the statistics.
const INTERVAL: &str = "95 % interval of the mean";

/// The number of runs with each verdict in words; `None` if no run has one.
fn verdicts(of: &Value) -> Option<String> {
    let counts = of["verdicts"].as_object()?;
    let judged: u64 = counts.values().filter_map(Value::as_u64).sum();
    let mut words: Vec<_> = counts.iter().map(|(answer, n)| format!("{n} {answer}")).collect();
    let without = of["n_runs"].as_u64().unwrap_or_default().saturating_sub(judged);
    words.extend((without > 0).then(|| format!("{without} without a verdict")));
    (judged > 0).then(|| words.join(", "))
}

/// That intervals of few units are too narrow, by their name.
fn few_in_short(summary: &Value) -> Option<String> {
    about_few(summary)?;
    let level = summary["units"].as_array()?.first()?;
    let (n, name) = (level["n"].as_u64()?, word(&level["name"]));
    let share = match n {
        2 => ": such an interval holds the mean of all in about 50 % of cases",
        3 => ": such an interval holds the mean of all in about 75 % of cases",
        4 => ": such an interval holds the mean of all in about 88 % of cases",
        _ => "",
    };
    Some(format!("{n} {} are few{share}", plural(&name)))
}

/// The comparisons alone, if there are any.
pub(crate) fn of_comparisons(summary: &Value, global: &Global) -> Option<String> {
    comparisons(summary, global.verbose == 0, MAX_COMPARED_ALONE)
}

fn comparisons(summary: &Value, is_brief: bool, max_rows: usize) -> Option<String> {
    let comparisons = summary["comparisons"].as_array().filter(|all| !all.is_empty())?;
    let n_shown = if is_brief { comparisons.len().min(max_rows) } else { comparisons.len() };
    let mut blocks: Vec<Block> = Vec::new();
    let mut notes: Vec<String> = Vec::new();
    for c in &comparisons[..n_shown] {
        let setting = c["setting"].as_object().into_iter().flatten();
        let setting: String = setting.map(|(name, value)| format!(" at {name} = {}", word(value))).collect();
        let (column, of) = in_degrees(&word(&c["column"]), c);
        let mut cells = comparison(&of);
        let remark = cells.pop_if(|(head, _)| head == "remark").map(|(_, cell)| cell.plain()).unwrap_or_default();
        if is_brief {
            let counted =
                osteoflow_statistics::counted(of["n"].as_u64().unwrap_or_default() as usize, &word(&of["unit"]));
            cells.insert(0, ("of".into(), Cell::Word(counted)));
            cells.retain_mut(|(head, _)| {
                *head = match head.as_str() {
                    "mean of first" => "first".into(),
                    "mean of second" => "second".into(),
                    "95 % limits of agreement" => "95 % limits".into(),
                    _ => std::mem::take(head),
                };
                !VERBOSE_COMPARED.contains(&head.as_str())
            });
        }
        let (name, remark) = match is_brief {
            true => (format!("{column}{setting}"), String::new()),
            false => (format!("{column}{setting}"), remark.clone()),
        };
        if is_brief {
            let note = [&c["note"], &c["wilcoxon"]["none"]].into_iter().filter_map(Value::as_str);
            notes.extend(note.filter(|note| !notes.iter().any(|n| n == note)).map(str::to_owned).collect::<Vec<_>>());
        }
        let pair = format!("{} -> {}", word(&c["a"]), word(&c["b"]));
        let row = Row { name, cells, remark };
        match blocks.iter_mut().find(|block| block.name == pair) {
            Some(block) => block.rows.push(row),
            None => blocks.push(Block { name: pair, rows: vec![row] }),
        }
    }
    let mut out = lines("second against first, paired", blocks, true);
    notes.iter().for_each(|note| out += &format!("  {note}\n"));
    if n_shown < comparisons.len() {
        out += &format!("  {} more comparisons with --verbose\n", comparisons.len() - n_shown);
    }
    Some(out)
}

/// A table of blocks. Where each has several rows, its name stands above them.
fn lines(title: &str, blocks: Vec<Block>, has_heads: bool) -> String {
    let rows: Vec<TableRow> = blocks.iter().flat_map(|block| block.rows.iter().map(|row| row.cells.clone())).collect();
    let (heads, cells) = under_heads(&rows);
    let mut table = TextTable::new(title, &heads.iter().map(String::as_str).collect::<Vec<_>>());
    let mut cells = cells.into_iter();
    for block in blocks {
        if has_heads {
            table.row(&block.name, []);
        }
        for Row { name, remark, .. } in block.rows {
            let name = if has_heads { format!("  {name}") } else { block.name.clone() };
            let cells = cells.next().unwrap_or_default();
            table.row(name, cells.iter().map(Cell::plain).chain(Some(remark).filter(|remark| !remark.is_empty())));
        }
    }
    table.lines()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::commands::common::global::Format;
    use clap::ColorChoice;
    use serde_json::json;

    fn shown(summary: &Value, verbose: u8) -> String {
        text(summary, &Global { format: Format::Text, quiet: false, verbose, color: ColorChoice::Never })
    }

    #[test]
    fn verdicts_are_counted_at_each_setting_that_is_not_trusted_whole_and_in_all() {
        let summary = |verdicts: [Value; 3]| {
            let [a, b, all] = verdicts;
            let columns = json!({ "tre_mm": { "n": 3, "mean": 1.5 } });
            let group = |icp: &str, verdicts: Value| json!({ "setting": { "icp": icp }, "n_runs": 3, "verdicts": verdicts, "columns": columns });
            json!({ "notice": "", "n_runs": 6, "verdicts": all, "groups": [group("p", a), group("q", b)] })
        };
        let counts = |trusted: u64, doubtful: u64, refused: u64| json!({ "trusted": trusted, "doubtful": doubtful, "refused": refused });
        let of = summary([counts(3, 0, 0), counts(0, 1, 1), counts(3, 1, 1)]);
        let brief = shown(&of, 0);
        assert!(brief.contains("verdicts: 3 trusted, 1 doubtful, 1 refused, 1 without a verdict\n"), "{brief}");
        assert!(brief.contains("    p        3  1.500   –    –    –\n"), "{brief}");
        let q = "    q        3  1.500   –    –    –  1 doubtful; 1 refused\n";
        assert!(brief.contains(q), "{brief}");
        assert!(shown(&of, 1).contains("  –  3 trusted, 0 doubtful, 0 refused\n"), "{}", shown(&of, 1));
        // Summaries of earlier versions count none.
        for nothing in [counts(0, 0, 0), Value::Null] {
            assert!(!shown(&summary([nothing.clone(), nothing.clone(), nothing]), 1).contains("verdict"));
        }
    }

    #[test]
    fn one_table_has_a_block_for_each_column_and_what_has_no_room_is_named() {
        let column = |mean: f64| json!({ "n": 4, "mean": mean, "n_units": [{ "name": "bone", "n": 4 }] });
        let group = |icp: usize| {
            let columns = json!({ "tre_mm": column(0.5), "tilt_rad": column(0.25), "rms_mm": column(0.125) });
            json!({ "setting": { "icp": icp }, "n_runs": 4, "columns": columns })
        };
        let of = |n: usize| json!({ "notice": "", "n_runs": 4 * n, "groups": (0..n).map(group).collect::<Vec<_>>() });
        let brief = shown(&of(8), 0);
        assert_eq!(brief.matches("icp ").count(), 1, "{brief}");
        assert!(brief.contains("  tre_mm\n    0           4  0.500   –    –    –\n"), "{brief}");
        assert!(brief.contains("  tilt_deg\n    0           4  14.32   –    –    –\n"), "{brief}");
        assert!(brief.contains("  with --verbose: rms_mm\n"), "{brief}");
        assert!(shown(&of(30), 0).contains("with --verbose: tilt_deg, rms_mm, 10 more settings\n"));
        assert!(shown(&of(30), 1).contains("  rms_mm\n"));
    }
}
