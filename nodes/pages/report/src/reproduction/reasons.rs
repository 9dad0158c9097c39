//! The reasons for runs without results, abbreviated and counted.

use osteoflow_engine::sweep::Done;

/// Maximum number of reasons shown; runs.csv has all.
const MAX_REASONS: usize = 3;

/// The reasons for runs of an experiment without results.
#[derive(Debug, Default, PartialEq)]
pub(super) struct Reasons {
    /// Number of runs without results.
    pub(super) n: usize,
    /// The full reason of the first of them, with its run.
    pub(super) first: Option<(usize, String)>,
    /// The abbreviated reasons with their numbers of runs, most frequent first.
    common: Vec<(String, usize)>,
}

impl Reasons {
    pub(super) fn of(runs: &[Done]) -> Self {
        let mut reasons = Self::default();
        for run in runs.iter().filter(|run| !run.is_complete()) {
            let reason = run.reason.as_deref().unwrap_or(&run.status);
            reasons.n += 1;
            reasons.first.get_or_insert_with(|| (run.run, reason.to_owned()));
            let short = short(reason);
            match reasons.common.iter_mut().find(|(known, _)| *known == short) {
                Some((_, n)) => *n += 1,
                None => reasons.common.push((short, 1)),
            }
        }
        // Stable: equally frequent reasons keep their order.
        reasons.common.sort_by_key(|(_, n)| std::cmp::Reverse(*n));
        reasons
    }

    /// Formats the reasons as `no hole of 2 mm radius (5 runs)`, most frequent first.
    pub(super) fn text(&self) -> String {
        let one = |(reason, n): &(String, usize)| format!("{reason} ({})", osteoflow_statistics::counted(*n, "run"));
        let mut all: Vec<_> = self.common.iter().take(MAX_REASONS).map(one).collect();
        let rest: usize = self.common.iter().skip(MAX_REASONS).map(|(_, n)| n).sum();
        if rest > 0 {
            all.push(format!("others ({})", osteoflow_statistics::counted(rest, "run")));
        }
        all.join("; ")
    }
}

/// The part after the node's name, without the numbers of the run: the first part that is a sentence rather than the name of
/// a point or a file.
fn short(reason: &str) -> String {
    let after =
        reason.split_once("node \"").and_then(|(_, rest)| rest.split_once(": ")).map_or(reason, |(_, rest)| rest);
    // Of a result that its verdict refuses, the reason of the verdict.
    let after = after.strip_prefix("the result is refused: ").unwrap_or(after);
    let mut parts = after.split(": ");
    let part = parts.clone().find(|part| part.contains(' ')).or_else(|| parts.next()).unwrap_or(after);
    let part = part.split(';').next().unwrap_or(part);
    part.split(", at [").next().unwrap_or(part).trim().to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::Value;

    fn run(run: usize, reason: Option<&str>) -> Done {
        let status = if reason.is_some() { "refused" } else { "complete" };
        Done {
            run,
            seed: 0,
            values: Vec::new(),
            status: status.into(),
            reason: reason.map(str::to_owned),
            warnings: Vec::new(),
            results: Value::Null,
        }
    }

    #[test]
    fn reasons_are_counted_without_the_numbers_of_each_run_and_the_most_frequent_is_first() {
        let hole = |point: &str, n: usize| {
            format!(
                "graphs/fibula.toml:69: node \"hole\", item 0: {point}: no hole of 2 mm radius: {n} points have no partner; is the \
                 laser on?"
            )
        };
        let short = "graphs/a.toml:3: node \"ct_surface\": the surface is open; close it";
        let alike =
            "graphs/a.toml:3: node \"hole\", item 0: P1: 2 holes look alike, at [1.0, 2.0, 3.0] and [4.0, 5.0, 6.0] mm";
        let judged =
            "graphs/a.toml:9: node \"judge\", item 0: the result is refused: the landmarks are swapped; aim again";
        let runs = [
            None,
            Some(short.into()),
            Some(hole("P2", 75)),
            Some(hole("P3", 103)),
            Some(alike.to_owned()),
            Some(judged.to_owned()),
            Some(judged.replace("item 0", "item 1")),
        ];
        let runs: Vec<_> = runs.iter().enumerate().map(|(k, reason)| run(k, reason.as_deref())).collect();
        let reasons = Reasons::of(&runs);
        assert_eq!((reasons.n, &reasons.first), (6, &Some((1, short.to_owned()))));
        let expected = "no hole of 2 mm radius (2 runs); the landmarks are swapped (2 runs); the surface is open (1 run); \
                        others (1 run)";
        assert_eq!(reasons.text(), expected);
        assert_eq!(Reasons::of(&runs[..1]), Reasons::default());
    }
}
