//! `compare`: runs, or sweeps, with each other.

mod otherwise;
mod published;
mod runs;
mod sweeps;

use super::common::{Exit, Format, Global, print_json, terminal};
use crate::app::{UsageError, archive::is_archive, same};
use anyhow::Result;
use clap::Args;
use osteoflow_engine::sweep::{self, Spec};
use serde_json::json;
use std::{io::Write, path::PathBuf};

/// Compare the results of runs, or of sweeps.
///
/// First what was set otherwise. Runs: the errors that are published, with their differences from the first run; with --verbose
/// every number of results.json that they share and that differs. Sweeps: each column of
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
  osteoflow compare sweeps/mine sweeps/built_in --by icp.kind      two methods, each with a sweep of its own
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

    /// For sweeps, the key or the factor in which they are to differ, such as icp.kind: it does not take part in the pairing, and the
    /// table names the sweeps by its values.
    #[arg(long, value_name = "KEY")]
    by: Option<String>,

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
            0 if self.by.is_some() => {
                let why = "--by is for sweeps; of two runs, what was set otherwise is said without it";
                Err(UsageError(why.into()).into())
            }
            0 => self.runs(global),
            n if n == self.folders.len() => self.sweeps(global),
            _ => {
                let of = |dir: &PathBuf| {
                    format!("{} is {}", dir.display(), if is_sweep(dir) { "a sweep" } else { "no sweep" })
                };
                let found = self.folders.iter().map(of).collect::<Vec<_>>().join(", ");
                usage!("runs and sweeps cannot be compared with each other: {found}; name folders of one kind");
            }
        }
    }

    fn same(&self, global: &Global) -> Result<Exit> {
        let [first, second] = &self.folders[..] else {
            usage!("two are compared by --same; name a folder or an archive, and another");
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

    /// The margins given, and those of the first sweep for other columns.
    fn margins_of(&self, spec: &Spec) -> Result<Vec<(String, f64)>> {
        for (name, _) in &self.margins {
            if !spec.columns.iter().any(|column| column.name == *name) {
                let known: Vec<_> = spec.columns.iter().map(|column| column.name.as_str()).collect();
                let known = known.join(", ");
                usage!("--margin: the first sweep has no column {name}; it has {known}");
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
