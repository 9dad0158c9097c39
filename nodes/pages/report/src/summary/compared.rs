//! Paired comparisons: between the values of a factor within a sweep, and between two sweeps.

use super::{LEVEL, groups, or_reason, path, value, word};
use osteoflow_engine::sweep::{Column, Compare, Done, Spec};
use osteoflow_statistics::{Units, bland_altman, counted, holm, plural, tost, unit_means, wilcoxon};
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};

/// Significance level of each one-sided test of equivalence.
const ALPHA: f64 = 0.05;
/// Minimum number of units for a paired test: with fewer, its p cannot fall below 5 % (2 / 2⁶ = 3 %).
const MIN_PAIRS: usize = 6;

/// Runs of two sweeps cannot be paired unambiguously.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "the sweeps have no pairs: run {run} differs from another only in factors that one of them does not have (in both: {shared})"
)]
pub struct NoPairs {
    run: usize,
    shared: String,
}

/// Pairs of runs that differ in one factor only: of its reference value, and of another.
pub(crate) struct Pairs<'a> {
    pub(crate) first: String,
    pub(crate) second: String,
    pub(crate) columns: Vec<&'a Column>,
    pub(crate) runs: Vec<(&'a Done, &'a Done)>,
    margins: &'a [(String, f64)],
}

/// The comparisons that a sweep asks for.
pub(super) fn within(spec: &Spec, done: &[Done]) -> Vec<Value> {
    with_holm(pairs(spec, done).iter().flat_map(|pairs| compared(spec, pairs)).collect())
}

/// The pairs that a sweep asks to compare: each value of a factor against its reference value.
pub(crate) fn pairs<'a>(spec: &'a Spec, done: &'a [Done]) -> Vec<Pairs<'a>> {
    let mut out = Vec::new();
    for Compare { factor: name, to, margins } in &spec.compare {
        let side = |label: &Value| done.iter().filter(|d| d.value(name) == Some(label)).collect();
        let others = spec.factors.iter().find(|factor| factor.name == *name);
        let others = others.into_iter().flat_map(|factor| &factor.levels).filter(|level| level.label != *to);
        let base: Vec<&Done> = side(to);
        let key = |d: &Done| -> String {
            let others = d.values.iter().filter(|(of, _)| *of != name);
            others.map(|(of, value)| format!("{of}={value}\u{1f}")).collect()
        };
        // Where margins are given, only their columns are compared.
        let columns =
            spec.columns.iter().filter(|column| margins.is_empty() || margin(margins, &column.name).is_some());
        let columns: Vec<_> = columns.collect();
        for level in others {
            let runs = paired(&base, &side(&level.label), &key);
            out.push(Pairs { first: word(to), second: word(&level.label), columns: columns.clone(), runs, margins });
        }
    }
    out
}

/// Compares the columns of two sweeps under each setting of the first. A pair is a run of each with the same seed and the same
/// values of everything that both vary but the factors `apart`, in which the sweeps are to differ. `margins` are the largest differences, by column, that do not matter. p values are
/// not corrected yet: see [`with_holm`].
///
/// # Errors
/// If two runs of one sweep differ only in something that the other sweep does not have.
pub fn between(
    (a, spec, first): (&str, &Spec, &[Done]),
    (b, other, second): (&str, &Spec, &[Done]),
    apart: &[String],
    margins: &[(String, f64)],
) -> Result<Vec<Value>, NoPairs> {
    let mut shared = shared_names(spec, other);
    shared.retain(|name| !apart.contains(name));
    let key = |d: &Done| {
        let values = shared.iter().map(|name| d.value(name).map(word).unwrap_or_default());
        format!("{}\u{1f}{}", values.collect::<Vec<_>>().join("\u{1f}"), d.seed)
    };
    if let Some(run) = twice(first, &key).or(twice(second, &key)) {
        let shared = if shared.is_empty() { "none".into() } else { shared.join(", ") };
        return Err(NoPairs { run, shared });
    }
    let second: Vec<&Done> = second.iter().collect();
    let columns: Vec<_> = spec.columns.iter().collect();
    let mut comparisons = Vec::new();
    // The means over units need a single setting.
    for (setting, first) in groups(spec, first) {
        let (runs, columns) = (paired(&first, &second, &key), columns.clone());
        for mut comparison in compared(spec, &Pairs { first: a.into(), second: b.into(), columns, runs, margins }) {
            comparison["setting"] = json!(setting);
            comparisons.push(comparison);
        }
    }
    Ok(comparisons)
}

/// The names of factors and draws that both sweeps have.
fn shared_names(a: &Spec, b: &Spec) -> Vec<String> {
    let names = |spec: &Spec| -> Vec<String> {
        let factors = spec.factors.iter().map(|f| f.name.clone());
        factors.chain([spec.repeat_name.clone()]).chain(spec.draws.iter().map(|d| d.name.clone())).collect()
    };
    let of_b = names(b);
    names(a).into_iter().filter(|name| of_b.contains(name)).collect()
}

/// A run whose key another run of the list has too.
fn twice(done: &[Done], key: &dyn Fn(&Done) -> String) -> Option<usize> {
    let mut seen = BTreeSet::new();
    done.iter().find(|d| !seen.insert(key(d))).map(|d| d.run)
}

/// The runs of two lists that have the same key.
fn paired<'a>(first: &[&'a Done], second: &[&'a Done], key: &dyn Fn(&Done) -> String) -> Vec<(&'a Done, &'a Done)> {
    let of_first: BTreeMap<String, &Done> = first.iter().map(|d| (key(d), *d)).collect();
    second.iter().filter_map(|d| Some((*of_first.get(&key(d))?, *d))).collect()
}

/// Paired comparisons, column by column.
fn compared(spec: &Spec, pairs: &Pairs<'_>) -> Vec<Value> {
    let Pairs { first: a, second: b, columns, runs: pairs, margins } = pairs;
    let mut out = Vec::new();
    for column in columns {
        let with: Vec<_> = pairs.iter().filter_map(|(a, b)| Some((*b, value(a, column)?, value(b, column)?))).collect();
        if with.is_empty() {
            continue;
        }
        let rows: Vec<&Done> = with.iter().map(|(run, ..)| *run).collect();
        let differences: Vec<f64> = with.iter().map(|(_, a, b)| b - a).collect();
        let (unit, differences, note) = by_unit(spec, &rows, differences);
        let lost = pairs.len() - with.len();
        let lost = (lost > 0)
            .then(|| format!("{lost} of {} left out, with a run that has no value", counted(pairs.len(), "pair")));
        let notes: Vec<_> = note.into_iter().chain(lost).collect();
        let n = differences.len();
        out.push(json!({
            "column": column.name, "a": a, "b": b, "unit": unit, "n": n, "n_pairs": rows.len(),
            "mean_a": mean(with.iter().map(|(_, a, _)| *a)), "mean_b": mean(with.iter().map(|(.., b)| *b)),
            "mean_difference": mean(differences.iter().copied()),
            "wilcoxon": or_reason(wilcoxon(&differences)),
            "tost": margin(margins, &column.name).map_or(Value::Null, |margin| or_reason(tost(&differences, margin, ALPHA))),
            "bland_altman": or_reason(bland_altman(&differences, LEVEL)),
            "note": (!notes.is_empty()).then(|| notes.join("; ")),
        }));
    }
    out
}

/// The largest difference of a column that does not matter, if one is given.
fn margin(margins: &[(String, f64)], column: &str) -> Option<f64> {
    margins.iter().find(|(name, _)| name == column).map(|(_, margin)| *margin)
}

/// The mean differences by units: by the highest level of units that are enough for a test.
fn by_unit(spec: &Spec, rows: &[&Done], differences: Vec<f64>) -> (String, Vec<f64>, Option<String>) {
    for depth in 1..=spec.units.len() {
        let names: Vec<_> = spec.units[..depth].iter().map(String::as_str).collect();
        let paths: Vec<Vec<String>> =
            rows.iter().map(|run| path(spec, run)[..depth].join("\u{1f}")).map(|p| vec![p]).collect();
        let Ok(units) = Units::new(&[names.join(", ")], &paths) else { continue };
        let Ok(means) = unit_means(&units, &differences) else { continue };
        let last = depth == spec.units.len();
        if means.means.len() >= MIN_PAIRS || last {
            let highest = &spec.units[0];
            let n_highest: BTreeSet<_> = rows.iter().map(|run| path(spec, run)[0].clone()).collect();
            let note = (depth > 1).then(|| {
                let (tested, within) = (plural(&spec.units[depth - 1]), counted(n_highest.len(), highest));
                format!("tested over {tested} within {within}: says nothing of others")
            });
            return (spec.units[depth - 1].clone(), means.means, note);
        }
    }
    ("run".into(), differences, None)
}

/// Adds p values with Holm's correction over all comparisons.
pub fn with_holm(mut comparisons: Vec<Value>) -> Vec<Value> {
    let with: Vec<usize> = (0..comparisons.len()).filter(|&i| comparisons[i]["wilcoxon"]["p"].is_number()).collect();
    let p: Vec<f64> = with.iter().filter_map(|&i| comparisons[i]["wilcoxon"]["p"].as_f64()).collect();
    if let Ok(corrected) = holm(&p) {
        with.iter().zip(corrected).for_each(|(&i, p)| comparisons[i]["p_holm"] = p.into());
    }
    comparisons
}

fn mean(values: impl Iterator<Item = f64> + Clone) -> f64 {
    let n = values.clone().count() as f64;
    values.sum::<f64>() / n
}
