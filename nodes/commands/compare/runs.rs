//! Runs: what was set otherwise, and the numbers of their results.

use super::{
    Compare,
    otherwise::{self, Made, heads},
    published,
};
use crate::commands::common::{Exit, Format, Global, print_json, terminal, text_table::TextTable};
use anyhow::{Context, Result, bail};
use osteoflow_engine::run::files;
use osteoflow_report::summary::in_degrees;
use serde_json::{Value, json};
use std::{collections::BTreeMap, io::Write, path::Path};

/// The key of matrices, such as those of poses, in the paths of their numbers.
const MATRIX: &str = "matrix.";
/// Most numbers that are listed of runs without any that people publish.
const MAX_LISTED: usize = 20;

impl Compare {
    pub(super) fn runs(&self, global: &Global) -> Result<Exit> {
        let results = self.folders.iter().map(|dir| read(dir)).collect::<Result<Vec<_>>>()?;
        let numbers = |results| {
            let mut numbers = BTreeMap::new();
            collect(results, String::new(), &mut numbers);
            numbers
        };
        let runs: Vec<_> = results.iter().map(numbers).collect();
        let shared = runs[0].iter().filter(|(key, _)| runs.iter().all(|run| run.contains_key(*key)));
        let rows = shared.map(|(key, _)| (key.as_str(), runs.iter().map(|run| run[key]).collect::<Vec<_>>()));
        let rows: Vec<_> = rows.collect();
        if global.format == Format::Json {
            let rows = rows.iter().map(|(key, values)| {
                let differences: Vec<_> = values.iter().map(|v| v - values[0]).collect();
                json!({ "key": key, "values": values, "differences": differences })
            });
            print_json(
                &json!({ "outcome": Exit::Done.to_json(), "folders": self.names(), "numbers": rows.collect::<Value>() }),
            )?;
            return Ok(Exit::Done);
        }
        let mut out = terminal::stdout().lock();
        writeln!(out, "{}", self.legend())?;
        let made: Vec<_> = self.folders.iter().filter_map(|dir| made(dir)).collect();
        if made.len() == self.folders.len() {
            writeln!(out, "{}", otherwise::text(&made, Vec::new(), global.verbose == 0))?;
        }
        let published = self.published(&results);
        if let Some(published) = &published {
            writeln!(out, "{published}")?;
        }
        let n_differ = rows.iter().filter(|(_, values)| differ(values)).count();
        if n_differ == 0 {
            writeln!(out, "all {} shared numbers are equal", rows.len())?;
        }
        let is_brief = global.verbose == 0 && !self.all;
        if is_brief && (published.is_some() || n_differ == 0) {
            if n_differ > 0 {
                writeln!(out, "{n_differ} of {} shared numbers differ: --verbose lists them", rows.len())?;
            }
            return Ok(Exit::Done);
        }
        // Single numbers of a matrix are of no use to a reader.
        let is_shown = |key: &str, values: &[f64]| self.all || differ(values) && !key.contains(MATRIX);
        let shown: Vec<_> = rows.iter().filter(|(key, values)| is_shown(key, values)).collect();
        let n_listed = if is_brief { shown.len().min(MAX_LISTED) } else { shown.len() };
        if n_listed > 0 {
            writeln!(out, "{}", self.table(&shown[..n_listed]).lines())?;
        }
        if n_listed < shown.len() {
            writeln!(out, "and {} more numbers; --verbose lists them", shown.len() - n_listed)?;
        }
        let hidden = rows.iter().filter(|(key, values)| differ(values) && !is_shown(key, values)).count();
        if hidden > 0 {
            writeln!(out, "and {hidden} numbers in matrices; --all shows them")?;
        }
        Ok(Exit::Done)
    }

    /// The verdicts and the numbers that people publish; `None` if the runs have none of these numbers.
    fn published(&self, results: &[Value]) -> Option<String> {
        let rows = published::rows(results);
        let mut table = self.headed();
        if let Some(answers) = published::verdicts(results) {
            table.row("verdict", answers);
        }
        for row in &rows {
            let (digits, first) = (row.digits, row.values[0]);
            let values = row.values.iter().map(|value| value.map_or_else(|| "-".into(), |x| format!("{x:.digits$}")));
            let differences = row.values[1..].iter().map(|value| match (first, value) {
                (Some(first), Some(value)) => format!("{:+.digits$}", value - first),
                _ => "-".into(),
            });
            table.row(&row.name, values.chain(differences));
        }
        (!rows.is_empty()).then(|| table.lines())
    }

    /// Numbers by their paths, angles in degrees.
    fn table(&self, rows: &[&(&str, Vec<f64>)]) -> TextTable {
        let mut table = self.headed();
        for (key, values) in rows {
            let shown = |value: &f64| in_degrees(key, &json!(value)).1.as_f64().unwrap_or(*value);
            let values: Vec<_> = values.iter().map(shown).collect();
            let differences = values[1..].iter().map(|v| v - values[0]);
            let cells = values.iter().copied().chain(differences).map(|x| format!("{x:.6}"));
            table.row(in_degrees(key, &json!(0.0)).0, cells);
        }
        table
    }

    /// A table with a column for each run, and one for each difference from the first.
    fn headed(&self) -> TextTable {
        let n = self.folders.len();
        let heads: Vec<_> = heads(n).into_iter().chain((2..=n).map(|k| format!("[{k}] - [1]"))).collect();
        TextTable::new("", &heads.iter().map(String::as_str).collect::<Vec<_>>())
    }
}

fn differ(values: &[f64]) -> bool {
    values.iter().any(|v| v.to_bits() != values[0].to_bits())
}

fn read(dir: &Path) -> Result<Value> {
    let path = dir.join(files::RESULTS);
    if !path.exists() {
        bail!(
            "{} is not the folder of a run ({} is missing) or of a sweep (sweep.json is missing); name two folders that \
             `osteoflow run` or `osteoflow sweep` has left",
            dir.display(),
            files::RESULTS
        );
    }
    let text = osteoflow_engine::regular(&path)
        .and_then(std::fs::read_to_string)
        .with_context(|| format!("{} cannot be read", path.display()))?;
    serde_json::from_str(&text).with_context(|| format!("{} holds no results", path.display()))
}

/// How a run came about, where its manifest is there.
fn made(dir: &Path) -> Option<Made> {
    let about: Value =
        serde_json::from_slice(&osteoflow_engine::regular(dir.join(files::MANIFEST)).and_then(std::fs::read).ok()?)
            .ok()?;
    Some(Made { graph: about["resolved_graph"].as_str()?.to_owned(), about })
}

/// Collects all numbers by their paths; list items that have a name are named by it.
fn collect(at: &Value, path: String, numbers: &mut BTreeMap<String, f64>) {
    let below = |part: &str| if path.is_empty() { part.to_owned() } else { format!("{path}.{part}") };
    match at {
        Value::Number(number) => drop(numbers.insert(path, number.as_f64().unwrap_or(f64::NAN))),
        Value::Object(object) => object.iter().for_each(|(key, value)| collect(value, below(key), numbers)),
        Value::Array(items) => {
            for (index, item) in items.iter().enumerate() {
                let name = item.get("name").and_then(Value::as_str).map_or_else(|| index.to_string(), str::to_owned);
                collect(item, below(&name), numbers);
            }
        }
        _ => {}
    }
}
