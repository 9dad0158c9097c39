//! Fills the template of the page.

use super::{
    Experiment, Reproduction,
    ours::Ours,
    template::{Line, Number, Request, Table, Time, sections},
};
use crate::{
    ReportError,
    cell::Cell,
    chart::axis_label,
    citations::paper_title,
    summary::{TableRow, comparison, under_heads, units, word},
};
use osteoflow_engine::run::NodeStats;
use serde_json::Value;

/// The page, and how its numbers came about.
pub(super) struct Page<'a> {
    pub(super) reproduction: &'a Reproduction,
    pub(super) command: &'a str,
    pub(super) command_of: &'a dyn Fn(&str) -> String,
    pub(super) times: &'a [(String, Vec<NodeStats>)],
}

impl Page<'_> {
    /// The template with our numbers. Rows and sections about experiments that were not run are left out.
    pub(super) fn text(&self) -> Result<String, ReportError> {
        let was_run = |name: &str| self.reproduction.experiment(name).is_some();
        let is_shown =
            |line: &&Line| line.request.as_ref().is_none_or(|request| request.experiments().into_iter().all(was_run));
        // An item of a list belongs to the prose above it.
        let is_own = |line: &&Line| line.request.is_some() && !line.before.starts_with("- ");
        let mut out = String::new();
        for section in sections() {
            let is_titled = section.first().is_some_and(|line| line.before.starts_with("## "));
            let own: Vec<_> = section.iter().filter(is_own).collect();
            if is_titled && !own.is_empty() && !own.iter().any(is_shown) {
                continue;
            }
            for line in section.iter().filter(is_shown) {
                out += &match &line.request {
                    None => self.prose(line.before),
                    Some(request) => [line.before, &self.reply(line, request)?, line.after].concat(),
                };
                out.push('\n');
            }
        }
        Ok(out.trim_end().to_owned() + "\n")
    }

    /// A line without a request. A word in braces stands for a list or a name.
    fn prose(&self, line: &str) -> String {
        match line {
            "{outside}" => match self.reproduction.outside().as_slice() {
                [] => "None.".into(),
                all => format!("- {}", all.join("\n- ")),
            },
            "{commands}" => self.commands(),
            line => line.replace("{command}", self.command).replace("{paper}", paper_title()),
        }
    }

    fn reply(&self, line: &Line, request: &Request) -> Result<String, ReportError> {
        Ok(match request {
            Request::Number(number) => self.number(line, number),
            Request::Time(time) => self.time(line, time),
            Request::Pair(pair) => match self.reproduction.compared(pair)? {
                Err(none) => format!("Not compared: {none}."),
                Ok(comparisons) => comparison_table(&comparisons),
            },
            Request::Table(table) => {
                self.reproduction.experiment(&table.of).map(|of| settings(table, &of.summary)).unwrap_or_default()
            }
        })
    }

    fn number(&self, line: &Line, number: &Number) -> String {
        let ours = self.reproduction.ours(number).unwrap_or_else(|| Ours::none(&number.path));
        if !line.before.starts_with('|') {
            return format!("{}, n = {}", ours.text, ours.n);
        }
        let judgement = ours.value.and_then(|value| number.judgement(line.theirs(), value));
        let within = judgement.map_or_else(|| "-".into(), |judgement| judgement.text);
        cells([ours.text, ours.n, within, self.code_of(&number.of)])
    }

    /// What nodes took in one procedure, and its share of the time that the paper gives, such as `2.5 ± 0.4 min`.
    fn time(&self, line: &Line, time: &Time) -> String {
        let Some((_, nodes)) = self.times.iter().find(|(name, _)| *name == time.of) else {
            return cells(["**none**: the procedure was refused", "-"]);
        };
        if !time.nodes.iter().all(|name| nodes.iter().any(|node| node.name == *name)) {
            return cells([&*format!("**none**: a node of {} is missing", time.nodes.join(", ")), "-"]);
        }
        let own = nodes.iter().filter(|node| time.nodes.is_empty() || time.nodes.contains(&node.name));
        let ours_s: f64 = own.map(|node| node.busy.as_secs_f64()).sum();
        let words: Vec<_> = line.theirs().split(' ').collect();
        let unit_s = match words.last() {
            Some(&"min") => 60.0,
            Some(&"ms") => 1e-3,
            _ => 1.0,
        };
        let share = match words[0].parse::<f64>() {
            Ok(paper) => format!("{:.2} %", 100.0 * ours_s / (paper * unit_s)),
            Err(_) => "-".into(),
        };
        cells([format!("{:.1} ms", 1e3 * ours_s), share])
    }

    /// The command of each experiment, and the reasons for runs without results.
    fn commands(&self) -> String {
        let row = |of: &Experiment| {
            [of.name.clone(), self.code_of(&of.name), of.summary["n_runs"].to_string(), of.reasons.n.to_string()]
        };
        let experiments = &self.reproduction.experiments;
        let mut out = table(["experiment", "command", "runs", "without results"], experiments.iter().map(row));
        let refused = experiments.iter().filter(|of| of.reasons.n > 0);
        let refused: Vec<_> = refused.map(|of| format!("\n- {}: {}", of.name, of.reasons.text())).collect();
        if !refused.is_empty() {
            out += "\n\nA run without results is a procedure that was refused. The most frequent reasons; `runs.csv` of the \
                    experiment has all in full:\n";
            out += &refused.concat();
        }
        out
    }

    fn code_of(&self, experiment: &str) -> String {
        format!("`{}`", (self.command_of)(experiment))
    }
}

fn comparison_table(comparisons: &[Value]) -> String {
    let row = |of: &Value| {
        let mut row = TableRow::from([("measure".into(), Cell::word(axis_label(&word(&of["column"]))))]);
        row.extend(comparison(of));
        row
    };
    let (heads, rows) = under_heads(&comparisons.iter().map(row).collect::<Vec<_>>());
    table(heads, rows.iter().map(|cells| cells.iter().map(Cell::plain)))
}

/// A table with a row for every setting of an experiment.
fn settings(of: &Table, summary: &Value) -> String {
    let groups = summary["groups"].as_array().map(Vec::as_slice).unwrap_or_default();
    let names: Vec<&String> =
        groups.first().and_then(|g| g["setting"].as_object()).into_iter().flat_map(|s| s.keys()).collect();
    let rows = groups.iter().map(|group| {
        let setting = names.iter().map(|name| word(&group["setting"][name.as_str()]));
        let means = of.columns.iter().map(|column| {
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
        setting.chain(means).chain([units(&group["units"]) + &without]).collect::<Vec<_>>()
    });
    let heads = names.iter().map(|name| name.as_str()).chain(of.columns.iter().map(String::as_str)).chain(["n"]);
    table(heads, rows)
}

/// A table in Markdown.
fn table<H: AsRef<str>, C: AsRef<str>>(
    heads: impl IntoIterator<Item = H>,
    rows: impl IntoIterator<Item = impl IntoIterator<Item = C>>,
) -> String {
    let heads: Vec<H> = heads.into_iter().collect();
    let mut lines = vec![format!("| {} |", cells(&heads)), format!("|{}", " --- |".repeat(heads.len()))];
    lines.extend(rows.into_iter().map(|row| format!("| {} |", cells(row))));
    lines.join("\n")
}

/// Cells of a row. A bar would begin another cell, a line break another row.
fn cells<T: AsRef<str>>(cells: impl IntoIterator<Item = T>) -> String {
    let cells = cells.into_iter().map(|cell| cell.as_ref().replace('|', "\\|").replace('\n', " "));
    cells.collect::<Vec<_>>().join(" | ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bar_in_a_cell_begins_no_other_cell() {
        let out = table(["mean |.|", "n"], [["a\nb", "3"]]);
        assert_eq!(out, "| mean \\|.\\| | n |\n| --- | --- |\n| a b | 3 |");
    }

    #[test]
    fn rows_and_sections_about_experiments_that_were_not_run_are_left_out() {
        let page =
            Reproduction { experiments: Vec::new() }.page("osteoflow reproduce", &|_| String::new(), &[]).unwrap();
        let titles: Vec<_> = page.lines().filter_map(|line| line.strip_prefix("## ")).collect();
        let expected = ["Outside the paper's spread", "The command of each experiment", "How we read the paper"];
        assert_eq!(titles, expected);
        assert!(page.contains("Written by `osteoflow reproduce`") && page.contains(paper_title()), "{page}");
        assert!(page.contains("\nNone.\n") && !page.contains('{'), "{page}");
    }
}
