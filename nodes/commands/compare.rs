use super::common::{Exit, Format, Global, print_json, summary_table, terminal, text_table::TextTable};
use crate::app::{UsageError, archive::is_archive, same};
use anyhow::{Context, Result};
use clap::Args;
use osteoflow_engine::{
    run::files,
    sweep::{self, Done, Folder, Spec},
};
use osteoflow_report::summary;
use serde_json::{Value, json};
use std::{collections::BTreeMap, fs, io::Write, path::PathBuf};

/// The key of matrices, such as those of poses, in the paths of their numbers.
const MATRIX: &str = "matrix.";

/// Compare the results of runs, or of sweeps.
///
/// Runs: every number of their results.json that they share, with its difference from the first run. Sweeps: each column of
/// the first against those of the others, paired by the factors, draws, repeat and seed that both have: paired Wilcoxon with
/// Holm's correction and effect size, limits of agreement, and equivalence within the margins given here or in the first
/// sweep's [sweep.compare].
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  osteoflow compare runs/fibula-20261121-120000 runs/fibula-20261121-120500
  osteoflow compare --all runs/a runs/b                  also numbers that are equal
  osteoflow compare sweeps/camera sweeps/stylus
  osteoflow compare sweeps/camera sweeps/stylus --margin tre_true_mm=0.5
  osteoflow compare S.zip again                          whether a rerun gave the same, and if not, why")]
pub(crate) struct Compare {
    /// Folders of runs, or of sweeps; all are compared with the first.
    #[arg(required = true, num_args = 2.., value_name = "DIR")]
    folders: Vec<PathBuf>,

    /// Say whether the second is the same as the first, and if not, which values differ, and which input, plugin, module, package,
    /// interpreter or program does. Exit code 0 if all values are equal, 4 if not. Archives of `osteoflow export` are always
    /// compared so.
    #[arg(long)]
    same: bool,

    /// For runs, also show the numbers that are equal, and those in matrices.
    #[arg(long)]
    all: bool,

    /// For sweeps, the largest difference of a column that does not matter, for the test of equivalence.
    #[arg(long = "margin", value_name = "COLUMN=SIZE", value_parser = margin)]
    margins: Vec<(String, f64)>,
}

impl Compare {
    pub(crate) fn execute(&self, global: &Global) -> Result<Exit> {
        if self.same || self.folders.iter().any(|path| is_archive(path)) {
            return self.same(global);
        }
        let is_sweep = |dir: &PathBuf| dir.join(sweep::DESIGN).is_file();
        match self.folders.iter().filter(|dir| is_sweep(dir)).count() {
            0 => self.runs(global),
            n if n == self.folders.len() => self.sweeps(global),
            _ => Err(UsageError("runs and sweeps cannot be compared with each other; name folders of one kind".into())
                .into()),
        }
    }

    fn same(&self, global: &Global) -> Result<Exit> {
        let [first, second] = &self.folders[..] else {
            return Err(
                UsageError("two are compared by --same; name a folder or an archive, and another".into()).into()
            );
        };
        let found = same(first, second)?;
        let exit = if found.is_equal() { Exit::Done } else { Exit::Differs };
        if global.format == Format::Json {
            let mut answer = json!(found);
            (answer["outcome"], answer["equal"], answer["folders"]) =
                (exit.to_json(), found.is_equal().into(), json!(self.names()));
            print_json(&answer)?;
            return Ok(exit);
        }
        let mut out = terminal::stdout().lock();
        writeln!(out, "{}", self.legend())?;
        for (file, is_equal) in &found.files {
            writeln!(out, "{file}: {}", if *is_equal { "equal, byte for byte" } else { "not the same bytes" })?;
        }
        found.values.iter().try_for_each(|value| writeln!(out, "  {value}"))?;
        if found.n_values > found.values.len() {
            writeln!(out, "  and {} more", found.n_values - found.values.len())?;
        }
        for note in found.notes.iter().chain(&found.causes) {
            writeln!(out, "{note}")?;
        }
        match found.n_values {
            0 => writeln!(out, "equal")?,
            n => writeln!(out, "{n} values differ")?,
        }
        Ok(exit)
    }

    fn runs(&self, global: &Global) -> Result<Exit> {
        let read = |dir: &PathBuf| -> Result<BTreeMap<String, f64>> {
            let path = dir.join(files::RESULTS);
            let text = fs::read_to_string(&path).with_context(|| format!("{} cannot be read", path.display()))?;
            let results =
                serde_json::from_str(&text).with_context(|| format!("{} holds no results", path.display()))?;
            let mut numbers = BTreeMap::new();
            collect(&results, String::new(), &mut numbers);
            Ok(numbers)
        };
        let runs = self.folders.iter().map(read).collect::<Result<Vec<_>>>()?;
        let shared = runs[0].iter().filter(|(key, _)| runs.iter().all(|run| run.contains_key(*key)));
        let rows: Vec<_> = shared.map(|(key, _)| (key, runs.iter().map(|run| run[key]).collect::<Vec<_>>())).collect();
        let differing = |values: &[f64]| values.iter().any(|v| v.to_bits() != values[0].to_bits());
        // Single numbers of a matrix are of no use to a reader.
        let shown = |key: &str, values: &[f64]| self.all || differing(values) && !key.contains(MATRIX);
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
        for (key, values) in rows.iter().filter(|(key, values)| shown(key, values)) {
            let differences = values[1..].iter().map(|v| v - values[0]);
            table.row(key.as_str(), values.iter().copied().chain(differences).map(|x| format!("{x:.6}")));
        }
        let mut out = terminal::stdout().lock();
        writeln!(out, "{}", self.legend())?;
        match rows.iter().any(|(_, values)| differing(values)) {
            true => writeln!(out, "{}", table.lines())?,
            false => writeln!(out, "all {} shared numbers are equal", rows.len())?,
        }
        let hidden = rows.iter().filter(|(key, values)| differing(values) && !shown(key, values)).count();
        if hidden > 0 {
            writeln!(out, "and {hidden} numbers in matrices; --all shows them")?;
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
        let margins = self.margins_of(spec)?;
        for (folder, (_, done)) in folders.iter().zip(&sweeps).filter(|_| !global.quiet) {
            let (n, all) = (done.len(), folder.n_runs());
            if n < all {
                let word = global.paint_err("warning", "1;33");
                let dir = folder.dir().display();
                writeln!(terminal::stderr(), "{word}: {dir} is not finished: it has {n} of {all} runs")?;
            }
        }
        let mut comparisons = Vec::new();
        for (k, (other, done)) in sweeps.iter().enumerate().skip(1) {
            let compared = summary::between(("[1]", spec, first), (&format!("[{}]", k + 1), other, done), &margins);
            comparisons.extend(compared.map_err(|none| UsageError(none.to_string()))?);
        }
        if comparisons.is_empty() {
            let message = "no run of one sweep matches a run of another; they need the same factors, repeats and seeds, and a column of the same name";
            return Err(UsageError(message.into()).into());
        }
        let comparisons = json!({ "folders": self.names(), "comparisons": summary::with_holm(comparisons) });
        match global.format {
            Format::Json => {
                let mut answer = comparisons;
                answer["outcome"] = Exit::Done.to_json();
                print_json(&answer)?;
            }
            Format::Text => {
                let table = summary_table::of_comparisons(&comparisons).unwrap_or_default();
                writeln!(terminal::stdout(), "{}\n{table}", self.legend())?;
            }
        }
        Ok(Exit::Done)
    }

    /// The margins given, and those of the first sweep for other columns.
    fn margins_of(&self, spec: &Spec) -> Result<Vec<(String, f64)>> {
        for (name, _) in &self.margins {
            if !spec.columns.iter().any(|column| column.name == *name) {
                let known: Vec<_> = spec.columns.iter().map(|column| column.name.as_str()).collect();
                let known = known.join(", ");
                return Err(
                    UsageError(format!("--margin: the first sweep has no column {name}; it has {known}")).into()
                );
            }
        }
        let own = spec.compare.iter().flat_map(|compare| &compare.margins);
        Ok(self.margins.iter().chain(own).cloned().collect())
    }

    /// The paths behind `[1]`, `[2]` and so on, one per line.
    fn legend(&self) -> String {
        self.names().iter().enumerate().map(|(k, name)| format!("[{}] {name}\n", k + 1)).collect()
    }

    fn names(&self) -> Vec<String> {
        self.folders.iter().map(|dir| dir.display().to_string()).collect()
    }
}

/// Parses `COLUMN=SIZE`.
fn margin(text: &str) -> Result<(String, f64), String> {
    let (name, size) = text.split_once('=').ok_or("expected COLUMN=SIZE, such as tre_true_mm=0.5")?;
    let size: f64 = size.trim().parse().map_err(|_| format!("\"{size}\" is no number"))?;
    if !(size.is_finite() && size > 0.0) {
        return Err("the size of a margin must be above zero".into());
    }
    Ok((name.trim().into(), size))
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
