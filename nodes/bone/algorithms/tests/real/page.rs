//! The tables of docs/method/real-data.md.

use super::{Outcome, Start, is_slow};
use osteoflow_algorithms::trust::Answer;
use std::{collections::BTreeMap, fmt::Write as _, fs, path::PathBuf};

/// Columns that are counts, between the two that say which row it is and the others.
const COUNTS: [&str; 9] = [
    "Starts",
    "Right",
    "trusted",
    "doubtful",
    "refused",
    "Interval holds",
    "Wrong: trusted",
    "doubtful",
    "refused, none",
];

/// A row: the pair, how it started, and what came of it.
struct Row {
    name: [String; 2],
    counts: [usize; COUNTS.len()],
    /// Errors of the right poses, signs of the right and wrong ones that are not trusted, and processor time.
    rest: [String; 4],
}

impl Row {
    fn of(name: [String; 2], all: &[&Outcome]) -> Self {
        let n = |is: &dyn Fn(&Outcome) -> bool| all.iter().filter(|outcome| is(outcome)).count();
        let answered = |is_right: bool, answer: Answer| n(&|o| o.is_right == is_right && o.answer() == Some(answer));
        let right = n(&|o| o.is_right);
        let [trusted, doubtful, refused] =
            [Answer::Trusted, Answer::Doubtful, Answer::Refused].map(|answer| answered(true, answer));
        let (wrong_trusted, wrong_doubtful) = (answered(false, Answer::Trusted), answered(false, Answer::Doubtful));
        let wrong_refused = all.len() - right - wrong_trusted - wrong_doubtful;
        let held = n(&|o| o.is_right && o.is_held());
        let mm = |is_right: bool| {
            let mut mm: Vec<f64> = all.iter().filter(|o| o.is_right == is_right).map(|o| o.error_mm).collect();
            mm.sort_by(f64::total_cmp);
            match (mm.first(), mm.last()) {
                (Some(least), Some(most)) if most - least < 0.005 => format!("{most:.2}"),
                (Some(least), Some(most)) => format!("{least:.2} to {most:.2}"),
                _ => String::new(),
            }
        };
        let mut cpu_s: Vec<f64> = all.iter().map(|o| o.cpu_s).collect();
        cpu_s.sort_by(f64::total_cmp);
        // A mirrored scan has no true place.
        let wrong_mm = if all.iter().all(|o| o.is_mirrored) { String::new() } else { mm(false) };
        Self {
            name,
            counts: [all.len(), right, trusted, doubtful, refused, held, wrong_trusted, wrong_doubtful, wrong_refused],
            rest: [mm(true), wrong_mm, signs(all), format!("{:.1}", cpu_s[cpu_s.len() / 2])],
        }
    }

    fn cells(&self) -> impl Iterator<Item = String> {
        self.name.iter().cloned().chain(self.counts.iter().map(usize::to_string)).chain(self.rest.iter().cloned())
    }
}

/// The signs of the answers that are not trusted, each with the number of answers, the most frequent first.
fn signs(all: &[&Outcome]) -> String {
    let mut signs: BTreeMap<&str, usize> = BTreeMap::new();
    for verdict in all.iter().filter_map(|o| o.verdict.as_ref().ok()) {
        for reason in &verdict.reasons {
            *signs.entry(&reason.rule).or_default() += 1;
        }
    }
    let mut signs: Vec<(&str, usize)> = signs.into_iter().collect();
    signs.sort_by_key(|(_, n)| std::cmp::Reverse(*n));
    signs.iter().map(|(rule, n)| format!("`{rule}` {n}")).collect::<Vec<_>>().join(", ")
}

fn rows(all: &[Outcome]) -> Vec<Row> {
    let mut groups: Vec<([String; 2], Vec<&Outcome>)> = Vec::new();
    for outcome in all {
        let start = match outcome.start {
            Start::Shape => "by shape alone".to_owned(),
            Start::Near { deg, mm } => format!("{deg} degrees and {mm} mm off"),
        };
        let mirrored = if outcome.is_mirrored { ", mirrored" } else { "" };
        let name = [format!("{}{mirrored}", outcome.pair), start];
        match groups.iter_mut().find(|(other, _)| *other == name) {
            Some((_, group)) => group.push(outcome),
            None => groups.push((name, vec![outcome])),
        }
    }
    groups.sort_by_key(|(_, group)| group[0].is_mirrored);
    groups.into_iter().map(|(name, group)| Row::of(name, &group)).collect()
}

fn table(rows: &[Row]) -> String {
    let rest = ["Error of right, mm", "of wrong, mm", "Signs", "CPU, s"];
    let head: Vec<&str> = ["Pair", "Start"].into_iter().chain(COUNTS).chain(rest).collect();
    let mut table = format!("| {} |\n|{}\n", head.join(" | "), "---|".repeat(head.len()));
    for row in rows {
        writeln!(table, "| {} |", row.cells().collect::<Vec<_>>().join(" | ")).unwrap();
    }
    table
}

/// Compares the counts of a table of the page with these outcomes: equal with `SLOW_TESTS`, else no fewer. `UPDATE` writes it.
pub(super) fn compare(name: &str, all: &[Outcome]) {
    if all.is_empty() {
        return;
    }
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../docs/method/real-data.md");
    let page = fs::read_to_string(&path).unwrap();
    let mark = format!("<!-- {name} -->\n");
    let start = page.find(&mark).unwrap() + mark.len();
    let end = start + page[start..].find("\n<!-- end -->").unwrap() + 1;
    let rows = rows(all);
    println!("{}", table(&rows));
    if is_slow() && std::env::var_os("UPDATE").is_some() {
        fs::write(path, format!("{}{}{}", &page[..start], table(&rows), &page[end..])).unwrap();
        return;
    }
    let written: Vec<Vec<&str>> = page[start..end]
        .lines()
        .skip(2)
        .map(|line| line.trim_matches('|').split('|').map(str::trim).collect())
        .collect();
    let advice = "`UPDATE=1 SLOW_TESTS=1 cargo test --release -p osteoflow-algorithms --test suite real::` writes it";
    assert!(!is_slow() || written.len() == rows.len(), "{name}: {} rows of {}; {advice}", written.len(), rows.len());
    for row in &rows {
        let of_page = written.iter().find(|cells| cells[..2] == row.name).unwrap_or_else(|| {
            panic!("docs/method/real-data.md has no row {:?}; {advice}", row.name);
        });
        for (k, (head, count)) in COUNTS.iter().zip(row.counts).enumerate() {
            let there: usize = of_page[2 + k].parse().unwrap();
            let is_so = if is_slow() { there == count } else { there >= count };
            assert!(is_so, "{:?}, {head}: {count}, and {there} in docs/method/real-data.md; {advice}", row.name);
        }
    }
}
