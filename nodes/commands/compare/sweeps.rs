//! Sweeps: what keeps them apart, and their columns in pairs of runs.

use super::{
    Compare,
    otherwise::{self, Made},
};
use crate::{
    app::UsageError,
    commands::common::{Exit, Format, Global, print_json, summary_table, terminal},
};
use anyhow::Result;
use osteoflow_engine::{
    names::nearest,
    sweep::{Done, Factor, Folder, Spec},
};
use osteoflow_report::summary::{self, word};
use serde_json::json;
use std::{collections::BTreeSet, io::Write, path::Path};

/// A sweep that is compared.
struct Swept {
    folder: Folder,
    spec: Spec,
    done: Vec<Done>,
}

impl Swept {
    fn read(dir: &Path) -> Result<Self> {
        let folder = Folder::open(dir)?;
        let (spec, done) = (folder.spec()?, folder.done()?.collect::<Result<Vec<_>, _>>()?);
        Ok(Self { folder, spec, done })
    }

    fn made(&self) -> Result<Made> {
        Ok(Made { graph: self.folder.graph()?, about: self.folder.about.clone() })
    }

    /// The values of a factor in its runs.
    fn values(&self, factor: &str) -> BTreeSet<String> {
        self.done.iter().filter_map(|run| run.value(factor)).map(word).collect()
    }

    /// The factors that `by` names, or that set the key `by`.
    fn factors_by<'s>(&'s self, by: &'s str) -> impl Iterator<Item = &'s Factor> {
        self.spec.factors.iter().filter(move |factor| factor.name == by || keys(factor).any(|key| key == by))
    }
}

/// The keys that the values of a factor set.
fn keys(factor: &Factor) -> impl Iterator<Item = &str> {
    let sets = factor.levels.iter().flat_map(|level| &level.sets);
    sets.filter_map(|set| Some(set.split_once('=')?.0.trim()))
}

/// The factors whose values differ, with the values in each sweep.
fn factors_apart(sweeps: &[Swept]) -> Vec<(String, Vec<String>)> {
    let mut names: Vec<&str> = Vec::new();
    for factor in sweeps.iter().flat_map(|sweep| &sweep.spec.factors) {
        if !names.contains(&&*factor.name) {
            names.push(&factor.name);
        }
    }
    let values = |sweep: &Swept, name: &str| {
        let factor = sweep.spec.factors.iter().find(|factor| factor.name == name);
        let labels = factor.map(|factor| factor.levels.iter().map(|level| word(&level.label)).collect::<Vec<_>>());
        otherwise::shown(labels.map(|labels| labels.join(", ")))
    };
    let rows = names.into_iter().map(|name| {
        let of_all: Vec<_> = sweeps.iter().map(|sweep| values(sweep, name)).collect();
        (format!("sweep.factor.{name}"), of_all)
    });
    rows.filter(|(_, values)| values.iter().any(|other| *other != values[0])).collect()
}

fn listed(values: &BTreeSet<String>) -> String {
    values.iter().map(String::as_str).collect::<Vec<_>>().join(", ")
}

impl Compare {
    pub(super) fn sweeps(&self, global: &Global) -> Result<Exit> {
        let sweeps = self.folders.iter().map(|dir| Swept::read(dir)).collect::<Result<Vec<_>>>()?;
        let first = &sweeps[0];
        let margins = self.margins_of(&first.spec)?;
        for Swept { folder, done, .. } in sweeps.iter().filter(|_| !global.quiet) {
            let (n, all) = (done.len(), folder.n_runs());
            if n < all {
                let dir = folder.dir().display();
                global.say("warning", format!("{dir} is not finished: it has {n} of {all} runs"))?;
            }
        }
        let made = sweeps.iter().map(Swept::made).collect::<Result<Vec<_>>>()?;
        let labels = self.labels(&sweeps, &made)?;
        let apart = self.by.iter().flat_map(|by| sweeps.iter().flat_map(|sweep| sweep.factors_by(by)));
        let apart: Vec<String> = apart.map(|factor| factor.name.clone()).collect();
        let mut comparisons = Vec::new();
        for (k, other) in sweeps.iter().enumerate().skip(1) {
            let (a, b) = (&*labels[0], &*labels[k]);
            let compared =
                summary::between((a, &first.spec, &first.done), (b, &other.spec, &other.done), &apart, &margins);
            let compared = compared.map_err(|none| UsageError(none.to_string()))?;
            if compared.is_empty() {
                return Err(UsageError(no_pairs(first, other, k + 1, &apart)).into());
            }
            comparisons.extend(compared);
        }
        let comparisons = json!({ "folders": self.names(), "comparisons": summary::with_holm(comparisons) });
        match global.format {
            Format::Json => {
                let mut answer = comparisons;
                answer["outcome"] = Exit::Done.to_json();
                print_json(&answer)?;
            }
            Format::Text => {
                let apart = otherwise::text(&made, factors_apart(&sweeps), global.verbose == 0);
                let table = summary_table::of_comparisons(&comparisons, global).unwrap_or_default();
                writeln!(terminal::stdout(), "{}\n{apart}\n{table}", self.legend())?;
            }
        }
        Ok(Exit::Done)
    }

    /// What the sweeps are called in the table: by their values of `--by`, else `[1]`, `[2]` and so on.
    fn labels(&self, sweeps: &[Swept], made: &[Made]) -> Result<Vec<String>> {
        let Some(by) = &self.by else { return Ok(otherwise::heads(sweeps.len())) };
        let usage = |why: String| UsageError(format!("--by {by}: {why}"));
        let set = otherwise::entries(made).into_iter().find(|(key, _)| key == by);
        let mut labels = Vec::new();
        for (k, sweep) in sweeps.iter().enumerate() {
            let levels: BTreeSet<_> = sweep.factors_by(by).flat_map(|factor| sweep.values(&factor.name)).collect();
            labels.push(match (levels.len(), &set) {
                (0, Some((_, values))) => values[k].clone(),
                (0, None) => {
                    let of_factors = sweeps.iter().flat_map(|sweep| &sweep.spec.factors).flat_map(keys);
                    let entries = otherwise::entries(made);
                    let known: BTreeSet<&str> = of_factors.chain(entries.iter().map(|(key, _)| key.as_str())).collect();
                    let known = known.iter().copied();
                    let help = nearest::help(by, known.clone())
                        .or_else(|| nearest::all("what is set otherwise or by a factor", known));
                    let help = help.unwrap_or_else(|| "nothing was set otherwise".into());
                    let why = "no factor of the sweeps sets it, and their graphs have it alike";
                    return Err(usage(format!("{why}; {help}")).into());
                }
                (1, _) => listed(&levels),
                (..) => {
                    let within = "compare them within the sweep, by [sweep.compare]";
                    return Err(
                        usage(format!("[{}] has several values of it: {}; {within}", k + 1, listed(&levels))).into()
                    );
                }
            });
        }
        match labels[1..].iter().position(|label| *label == labels[0]) {
            Some(k) => Err(usage(format!("it is {} in [1] and in [{}]", labels[0], k + 2)).into()),
            None => Ok(labels),
        }
    }
}

/// Why no run of two sweeps is a pair, and what would make them pairs.
fn no_pairs(first: &Swept, other: &Swept, number: usize, apart: &[String]) -> String {
    let mut why = Vec::new();
    let mut differ = |what: &str, a: &BTreeSet<String>, b: &BTreeSet<String>, remedy: &str| {
        if a.is_disjoint(b) && !a.is_empty() && !b.is_empty() {
            why.push(format!("{what} {} in [1] and {} in [{number}]{remedy}", listed(a), listed(b)));
        }
    };
    for factor in first.spec.factors.iter().filter(|factor| !apart.contains(&factor.name)) {
        let by = keys(factor).next().unwrap_or(&factor.name);
        let remedy = format!(", which --by {by} compares");
        differ(&format!("{} is", factor.name), &first.values(&factor.name), &other.values(&factor.name), &remedy);
    }
    let seeds = |of: &Swept| of.done.iter().map(|run| run.seed.to_string()).collect();
    differ("the seeds are", &seeds(first), &seeds(other), "");
    let columns = |of: &Swept| of.spec.columns.iter().map(|column| column.name.clone()).collect();
    differ("the columns are", &columns(first), &columns(other), "");
    let why = if why.is_empty() { "no setting, repeat and seed is in both".into() } else { why.join("; ") };
    format!(
        "no run of [1] matches a run of [{number}]: {why}; a pair has the same factors, repeat and seed, and a column of the same name"
    )
}
