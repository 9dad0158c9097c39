//! The page of the paper's numbers and ours, as Markdown.

use super::{
    Reproduction,
    ours::Ours,
    published::{ExperimentPair, Judged, PublishedNumber, RULE, Table},
};
use crate::{
    cell::Cell,
    chart::axis_label,
    citations::paper_title,
    summary::{TableRow, comparison, under_heads, units, word},
};
use serde_json::Value;

/// Returns the command that computes the numbers of an experiment.
type Command<'a> = &'a dyn Fn(&str) -> String;

/// The whole page.
pub(super) fn text(reproduction: &Reproduction, command: &str, again: Command<'_>) -> String {
    let mut out = Markdown::default();
    out.line("# The paper's numbers and ours\n");
    out.line(&format!("Written by `{command}`; not edited by hand.\n"));
    out.line(
        "**SIMULATED; research use only, not for clinical use.** Every number of ours comes from the simulated procedure \
         ([simulation.md](simulation.md)), whose error terms were set from their sources and not from the numbers below. n \
         counts units: starts on one scan of one bone are n = 1 bone. Values are mean ± SD (least to greatest); \
         [statistics.md](statistics.md) has the formulas, and explains why an interval of two or three bones, as in each sweep's \
         `summary.json`, says little.\n",
    );
    out.line(&format!(
        "Sections, figures and tables are those of *{}*; its numbers and their definitions are here, its text is not.\n",
        paper_title()
    ));
    out.line(&format!("{RULE}\n"));
    rows(&mut out, reproduction, again);
    out.line("\n## Outside the paper's spread\n");
    match reproduction.outside().as_slice() {
        [] => out.line("None."),
        all => all.iter().for_each(|line| out.line(&format!("- {line}"))),
    }
    out.line("");
    independent(&mut out, reproduction, again);
    for (index, comparisons) in &reproduction.paired {
        paired(&mut out, &reproduction.published.pair[*index], comparisons);
    }
    times(&mut out, reproduction);
    commands(&mut out, reproduction, again);
    readings(&mut out, reproduction);
    for table in &reproduction.published.table {
        if let Some(of) = reproduction.experiment(&table.experiment) {
            out.line(&format!("## {}\n", table.title));
            out.line(&format!("`graphs/paper/{}.toml`; SIMULATED; mean ± SD.\n", table.experiment));
            settings(&mut out, table, &of.summary);
            out.line("");
        }
    }
    out.0.truncate(out.0.trim_end().len());
    out.line("");
    out.0
}

fn rows(out: &mut Markdown, reproduction: &Reproduction, again: Command<'_>) {
    out.head(["section", "what", "paper", "ours", "n", "within the paper's spread", "command", "remark"]);
    for row in &reproduction.published.row {
        if reproduction.experiment(&row.experiment).is_none() {
            continue;
        }
        let ours = reproduction.of_row(row).unwrap_or_else(|| Ours::none(&row.ours));
        let (judged, command) = (judged(row, &ours), code(&again(&row.experiment)));
        out.row([&row.section, &row.what, &row.theirs, &ours.text, &ours.n, &judged, &command, &row.remark]);
    }
}

fn independent(out: &mut Markdown, reproduction: &Reproduction, again: Command<'_>) {
    out.line("## Another implementation's numbers and ours\n");
    out.line(
        "Computed by an independent implementation of the same method on real bones with an exact CT surface; for a bone of \
         your own: `osteoflow reproduce --bone BONE.stl --plan PLAN.json`, and for an exact CT surface and plain steps where \
         procedures are repeated, `--only accuracy_camera --set bone.exact=true --set \
         icp.kind=icp.published --set icp.reading=mean_change_1e-5 --set icp.max_iterations=250 --set icp.max_pair_distance_mm=8`. Their text does not say by which number a fragment \
         counts, its mean distance or its greatest: both of ours stand beside it.\n",
    );
    out.head(["what", "theirs", "ours", "n", "within their range", "command"]);
    for row in &reproduction.published.independent {
        if reproduction.experiment(&row.experiment).is_none() {
            continue;
        }
        let ours = reproduction.of_row(row).unwrap_or_else(|| Ours::none(&row.ours));
        let command = code(&again(&row.experiment));
        out.row([&row.what, &row.theirs, &ours.text, &ours.n, &judged(row, &ours), &command]);
    }
    out.line("");
}

fn judged(row: &PublishedNumber, ours: &Ours) -> String {
    match ours.value.and_then(|value| row.judged(value)) {
        Some(Judged::Within(text) | Judged::Outside(text)) => text,
        None => "-".into(),
    }
}

/// The paired comparison of two experiments.
fn paired(out: &mut Markdown, pair: &ExperimentPair, comparisons: &Result<Vec<Value>, String>) {
    let ExperimentPair { first, second, margin_mm, margin_reason, .. } = pair;
    out.line(&format!("## {} ({})\n", pair.title, pair.section));
    out.line(&format!(
        "`osteoflow compare OUT/{first} OUT/{second}`; SIMULATED. Procedures of the same bone and seed are a pair; first is \
         {first}, second {second}, the difference second minus first, in mm. Limits of agreement by Bland and Altman, p by \
         Wilcoxon's signed ranks, corrected by Holm over these rows, effect: rank-biserial; equivalent by two one-sided tests \
         at 5 % on either side, within {margin_mm} mm ({margin_reason}).\n",
    ));
    match comparisons {
        Err(none) => out.line(&format!("Not compared: {none}.")),
        Ok(comparisons) => {
            let row = |of: &Value| {
                let mut row = TableRow::from([("measure".into(), Cell::word(axis_label(&word(&of["column"]))))]);
                row.extend(comparison(of));
                row
            };
            let (heads, cells) = under_heads(&comparisons.iter().map(row).collect::<Vec<_>>());
            out.head(&heads);
            cells.iter().for_each(|cells| out.row(cells.iter().map(Cell::plain)));
        }
    }
    out.line("");
}

/// The paper's times with the share that computing has in them.
fn times(out: &mut Markdown, reproduction: &Reproduction) {
    let times = reproduction.published.time.iter();
    let shown: Vec<_> = times.filter(|time| reproduction.experiment(&time.experiment).is_some()).collect();
    if shown.is_empty() {
        return;
    }
    out.line("## Times\n");
    out.line(
        "What the program computes in one simulated procedure on one thread, beside the time that the paper gives; the rest of \
         that time is not software's. Computing times differ from machine to machine and run to run.\n",
    );
    out.head(["section", "what", "paper", "computing time of ours", "share of the paper's", "the rest"]);
    for time in shown {
        let Some(fact) = reproduction.published.fact(&time.fact) else { continue };
        let nodes = reproduction.times.iter().find(|(name, _)| *name == time.experiment).map(|(_, nodes)| nodes);
        let (ours, share) = match nodes.map(|nodes| time.computed_s(nodes)) {
            Some(Some(ours_s)) => {
                let share = time.seconds(fact).map(|paper_s| format!("{:.2} %", 100.0 * ours_s / paper_s));
                (format!("{:.1} ms", 1e3 * ours_s), share.unwrap_or_else(|| "-".into()))
            }
            Some(None) => (format!("**none**: a node of {} is missing", time.nodes.join(", ")), "-".into()),
            None => ("**none**: the procedure was refused".into(), "-".into()),
        };
        out.row([&fact.section, &fact.what, &format!("{} {}", fact.text(0), fact.unit), &ours, &share, &time.rest]);
    }
    out.line("");
}

fn commands(out: &mut Markdown, reproduction: &Reproduction, again: Command<'_>) {
    out.line("## The command of each experiment\n");
    out.head(["experiment", "command", "runs", "without results"]);
    for of in &reproduction.experiments {
        let (runs, without) = (of.summary["n_runs"].to_string(), of.reasons.n.to_string());
        out.row([&of.name, &code(&again(&of.name)), &runs, &without]);
    }
    out.line("");
    let refusing: Vec<_> = reproduction.experiments.iter().filter(|of| of.reasons.n > 0).collect();
    if refusing.is_empty() {
        return;
    }
    out.line(
        "A run without results is a procedure that was refused. The most frequent reasons; `runs.csv` of the experiment has \
         all in full:\n",
    );
    refusing.iter().for_each(|of| out.line(&format!("- {}: {}", of.name, of.reasons.text())));
    out.line("");
}

fn readings(out: &mut Markdown, reproduction: &Reproduction) {
    out.line("## How we read the paper\n");
    for reading in &reproduction.published.reading {
        out.line(&format!("**{}** {}", reading.question, reading.reading));
        for shown in &reading.shows {
            if reproduction.experiment(&shown.experiment).is_some() {
                let ours = reproduction.ours(&shown.experiment, &shown.ours, &shown.setting, None);
                let ours = ours.unwrap_or_else(|| Ours::none(&shown.ours));
                out.line(&format!("- {}: {}, n = {}", shown.name, ours.text, ours.n));
            }
        }
        out.line("");
    }
}

/// A table with a row for every setting of an experiment.
fn settings(out: &mut Markdown, table: &Table, summary: &Value) {
    let groups = summary["groups"].as_array().map(Vec::as_slice).unwrap_or_default();
    let names: Vec<_> =
        groups.first().and_then(|g| g["setting"].as_object()).into_iter().flat_map(|s| s.keys()).collect();
    let head = names.iter().map(|name| name.as_str()).chain(table.columns.iter().map(String::as_str)).chain(["n"]);
    out.head(head);
    for group in groups {
        let setting = names.iter().map(|name| word(&group["setting"][name.as_str()]));
        let cells = table.columns.iter().map(|column| {
            let of = &group["columns"][column];
            match (of["mean"].as_f64(), of["sd"].as_f64()) {
                (Some(mean), Some(sd)) => format!("{mean:.2} ± {sd:.2}"),
                (Some(mean), None) => format!("{mean:.2}"),
                _ => "-".into(),
            }
        });
        let without = match group["n_without_results"].as_u64().unwrap_or_default() {
            0 => String::new(),
            n => format!("; {n} without results"),
        };
        out.row(setting.chain(cells).chain([units(&group["units"]) + &without]));
    }
}

fn code(text: &str) -> String {
    format!("`{text}`")
}

/// Markdown under construction.
#[derive(Default)]
struct Markdown(String);

impl Markdown {
    fn line(&mut self, text: &str) {
        self.0.push_str(text);
        self.0.push('\n');
    }

    fn head<T: AsRef<str>>(&mut self, heads: impl IntoIterator<Item = T>) {
        let heads: Vec<T> = heads.into_iter().collect();
        self.row(&heads);
        self.line(&format!("|{}", " --- |".repeat(heads.len())));
    }

    /// Adds a row of a table.
    fn row<T: AsRef<str>>(&mut self, cells: impl IntoIterator<Item = T>) {
        // A bar would begin another cell, a line break another row.
        let cells: Vec<_> =
            cells.into_iter().map(|cell| cell.as_ref().replace('|', "\\|").replace('\n', " ")).collect();
        self.line(&format!("| {} |", cells.join(" | ")));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bar_in_a_cell_begins_no_other_cell() {
        let mut out = Markdown::default();
        out.head(["mean |.|", "n"]);
        out.row(["a\nb", "3"]);
        assert_eq!(out.0, "| mean \\|.\\| | n |\n| --- | --- |\n| a b | 3 |\n");
    }
}
