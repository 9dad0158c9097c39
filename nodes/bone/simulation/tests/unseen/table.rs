//! The table of verdicts.

use super::faults::{FAMILIES, Family};
use super::run::{Errors, Outcome, critical, named};
use osteoflow_algorithms::trust::{Answer, Verdict};
use std::collections::BTreeMap;
use std::fmt::Write;

/// Median and number of values, as two cells.
fn median(mut values: Vec<f64>) -> String {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).map_or("- | 0".to_owned(), |median| format!("{median:.2} | {}", values.len()))
}

/// The interval of 90 % and the error that is predicted: of the assessment points, of the cuts.
fn predicted(verdict: &Verdict) -> [Option<([f64; 2], f64)>; 2] {
    let of = verdict.predicted.as_ref();
    let [points, cuts] = [of.and_then(|p| p.assessment.as_ref()), of.and_then(|p| p.all_cuts.as_ref())];
    [points, cuts].map(|set| set.map(|set| (set.interval_mm, set.mean_tre_mm)))
}

/// Of trusted answers: predicted error, and whether the interval holds the true one.
fn held(all: &[&Outcome], which: usize) -> Vec<(f64, bool)> {
    let trusted = all.iter().filter(|o| o.answer() == Answer::Trusted).filter_map(|o| o.judged.as_ref());
    let mut held: Vec<(f64, bool)> = trusted
        .filter_map(|(Errors { tre_mm, cuts_mm, .. }, verdict)| {
            let ([from, to], size) = predicted(verdict)[which]?;
            Some((size, (from..=to).contains(&[*tre_mm, *cuts_mm][which])))
        })
        .collect();
    held.sort_by(|a, b| a.0.total_cmp(&b.0));
    held
}

fn share(held: &[(f64, bool)]) -> String {
    let n = held.iter().filter(|(_, is_held)| *is_held).count();
    if held.is_empty() {
        "-".to_owned()
    } else {
        format!("{:.0} % of {}", 100.0 * n as f64 / held.len() as f64, held.len())
    }
}

/// The number of all, right and wrong by answer, and of the wrong and trusted those that are covered.
fn row(name: &str, all: &[&Outcome]) -> String {
    let n = |is_wrong: bool, answer: Answer| {
        all.iter().filter(|o| o.is_wrong() == is_wrong && o.answer() == answer).count()
    };
    let missed = || all.iter().filter(|o| o.is_wrong() && o.answer() == Answer::Trusted);
    let [points, cuts] = [0, 1].map(|which| share(&held(all, which)));
    format!(
        "| {name} | {} | {} | {} | {} | {} | {} | {} | {} | {points} | {cuts} | {:.0} |",
        all.len(),
        n(false, Answer::Trusted),
        n(false, Answer::Doubtful),
        n(false, Answer::Refused),
        n(true, Answer::Refused),
        n(true, Answer::Doubtful),
        n(true, Answer::Trusted),
        missed().filter(|o| o.is_covered()).count(),
        all.iter().map(|o| o.judge_ms).sum::<f64>() / all.len().max(1) as f64,
    )
}

fn quarters(name: &str, all: &[&Outcome]) -> String {
    let of = |which: usize| {
        let held = held(all, which);
        let part = |k: usize| share(&held[k * held.len() / 4..(k + 1) * held.len() / 4]);
        (0..4).map(part).collect::<Vec<_>>().join(" | ")
    };
    format!("| {name}, assessment points | {} |\n| {name}, cuts | {} |", of(0), of(1))
}

/// Medians over sound answers.
fn sound(all: &[&Outcome]) -> String {
    let verdicts = || all.iter().filter_map(|o| o.judged.as_ref()).map(|(_, verdict)| verdict);
    let mut text = String::new();
    let mut sizes: BTreeMap<(&str, &str), Vec<f64>> = BTreeMap::new();
    for text in verdicts().filter_map(|v| v.assumptions.iter().find(|text| critical(text).is_some())) {
        let (size, unit) = critical(text).unwrap();
        sizes.entry((named(text), unit)).or_default().push(size);
    }
    for ((what, unit), sizes) in sizes {
        writeln!(text, "| first critical size, {what}, {unit} | {} |", median(sizes)).unwrap();
    }
    for (which, name) in ["assessment points", "cuts"].into_iter().enumerate() {
        let ends: Vec<f64> = verdicts().filter_map(|v| Some(predicted(v)[which]?.0[1])).collect();
        writeln!(text, "| upper end of the interval, {name}, mm | {} |", median(ends)).unwrap();
    }
    text
}

pub(super) fn markdown(all: &[Outcome], n: u64, base: u64) -> String {
    let of = |is: &dyn Fn(Family) -> bool| all.iter().filter(|o| is(o.family)).collect::<Vec<&Outcome>>();
    let foreign = of(&|family| !matches!(family, Family::Sound | Family::Priors));
    let mut text = format!(
        "\n{n} of each family, seed {base:016x}, simulated.\n\n\
         | family | n | right: trusted | doubtful | refused | wrong: refused | doubtful | trusted | of these covered | \
         TRE in the interval, of trusted | cuts in it | judge, CPU ms |\n|---|---|---|---|---|---|---|---|---|---|---|---|\n"
    );
    for family in FAMILIES {
        writeln!(text, "{}", row(&format!("{family:?}"), &of(&|f| f == family))).unwrap();
    }
    writeln!(text, "{}\n", row("all but Sound and Priors", &foreign)).unwrap();
    writeln!(text, "| in the interval, by quarter of the predicted error | first | second | third | hardest |")
        .unwrap();
    writeln!(text, "|---|---|---|---|---|").unwrap();
    writeln!(text, "{}", quarters("all", &of(&|_| true))).unwrap();
    for (name, family) in [("sound", Family::Sound), ("priors", Family::Priors)] {
        writeln!(text, "{}", quarters(name, &of(&|f| f == family))).unwrap();
    }
    writeln!(text, "{}\n", quarters("foreign", &foreign)).unwrap();
    writeln!(text, "| of sound ones | median | n |\n|---|---|---|").unwrap();
    write!(text, "{}", sound(&of(&|family| family == Family::Sound))).unwrap();
    text
}
