use super::{Exit, Format, Global, UsageError, out_dir, print_json, summary_table, text_table::TextTable};
use anyhow::{Context, Result};
use clap::Args;
use osteoflow_engine::sweep::{self, Done, Folder, Spec};
use osteoflow_report::summary;
use serde_json::{Value, json};
use std::{collections::BTreeMap, fs, io::Write, path::PathBuf};

/// Set the results of runs, or of sweeps, side by side.
///
/// Runs: every number of their results.json that they share, and how far the later ones are from the first. Sweeps: each
/// column of the first against those of the others, paired by factors, draws, repeat and seed that both have: paired
/// Wilcoxon with Holm's correction and effect size, limits of agreement, and equivalence where the first sweep states a
/// margin.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  osteoflow compare runs/fibula-20261121-120000 runs/fibula-20261121-120500
  osteoflow compare sweeps/camera sweeps/stylus
  osteoflow compare --all runs/a runs/b                  also numbers that are equal")]
pub(crate) struct Compare {
    /// Folders of runs, or of sweeps; all are compared with the first.
    #[arg(required = true, num_args = 2.., value_name = "DIR")]
    folders: Vec<PathBuf>,

    /// Of runs, show the numbers that are equal too.
    #[arg(long)]
    all: bool,
}

impl Compare {
    pub(crate) fn execute(&self, global: &Global) -> Result<Exit> {
        let is_sweep = |dir: &PathBuf| dir.join(sweep::DESIGN).is_file();
        match self.folders.iter().filter(|dir| is_sweep(dir)).count() {
            0 => self.runs(global),
            n if n == self.folders.len() => self.sweeps(global),
            _ => Err(UsageError("runs and sweeps cannot be compared; name folders of one sort".into()).into()),
        }
    }

    fn runs(&self, global: &Global) -> Result<Exit> {
        let read = |dir: &PathBuf| -> Result<BTreeMap<String, f64>> {
            let path = dir.join(out_dir::RESULTS);
            let text = fs::read_to_string(&path).with_context(|| format!("{} cannot be read", path.display()))?;
            let results = serde_json::from_str(&text).with_context(|| format!("{} is no results", path.display()))?;
            let mut numbers = BTreeMap::new();
            collect(&results, String::new(), &mut numbers);
            Ok(numbers)
        };
        let runs = self.folders.iter().map(read).collect::<Result<Vec<_>>>()?;
        let shared = runs[0].iter().filter(|(key, _)| runs.iter().all(|run| run.contains_key(*key)));
        let rows: Vec<_> = shared.map(|(key, _)| (key, runs.iter().map(|run| run[key]).collect::<Vec<_>>())).collect();
        let differing = |values: &[f64]| values.iter().any(|v| v.to_bits() != values[0].to_bits());
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
        let names = self.names();
        let heads: Vec<_> = (0..names.len())
            .map(|k| format!("[{}]", k + 1))
            .chain((1..names.len()).map(|k| format!("[{}] - [1]", k + 1)))
            .collect();
        let mut table = TextTable::new("", &heads.iter().map(String::as_str).collect::<Vec<_>>());
        for (key, values) in rows.iter().filter(|(_, values)| self.all || differing(values)) {
            let differences = values[1..].iter().map(|v| v - values[0]);
            table.row(key.as_str(), values.iter().copied().chain(differences).map(|x| format!("{x:.6}")));
        }
        let mut out = std::io::stdout().lock();
        for (k, name) in names.iter().enumerate() {
            writeln!(out, "[{}] {name}", k + 1)?;
        }
        match table.is_empty() {
            true => writeln!(out, "\nall {} numbers that they share are equal", rows.len())?,
            false => writeln!(out, "{}", table.lines())?,
        }
        Ok(Exit::Done)
    }

    fn sweeps(&self, global: &Global) -> Result<Exit> {
        let folders = self.folders.iter().map(|dir| Folder::open(dir)).collect::<Result<Vec<_>, _>>()?;
        let read = |folder: &Folder| -> Result<(Spec, Vec<Done>)> {
            Ok((folder.spec()?, folder.done()?.collect::<Result<Vec<_>, _>>()?))
        };
        let sweeps = folders.iter().map(read).collect::<Result<Vec<_>>>()?;
        let (spec, first) = &sweeps[0];
        let names = self.names();
        let mut comparisons = Vec::new();
        for ((other, done), name) in sweeps[1..].iter().zip(&names[1..]) {
            let found = summary::between((&names[0], spec, first), (name, other, done));
            comparisons.extend(found.map_err(|none| UsageError(none.to_string()))?);
        }
        if comparisons.is_empty() {
            let said = "no run of one has a pair in another; they need the same factors, repeats and seeds, and a column of one name";
            return Err(UsageError(said.into()).into());
        }
        let told = json!({ "folders": names, "comparisons": summary::with_holm(comparisons) });
        match global.format {
            Format::Json => {
                let mut told = told;
                told["outcome"] = Exit::Done.to_json();
                print_json(&told)?;
            }
            Format::Text => {
                writeln!(std::io::stdout(), "{}", summary_table::of_comparisons(&told).unwrap_or_default())?
            }
        }
        Ok(Exit::Done)
    }

    fn names(&self) -> Vec<String> {
        self.folders.iter().map(|dir| dir.display().to_string()).collect()
    }
}

/// Every number, by its path; of a list, items with a name by that.
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
