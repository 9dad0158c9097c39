//! The verdict on the results of a run as lines for a terminal.

use super::global::Global;
use crate::app::judged;
use osteoflow_engine::run::{Answer, Verdict};
use serde_json::Value;

/// Number of assumptions that are printed; the list begins with the most critical.
const N_ASSUMED: usize = 3;

/// The verdict of a node with each reason against the results once, and its most critical assumptions; with --verbose all. `None`
/// if nothing judged the results.
pub(crate) fn text(results: &Value, global: &Global) -> Option<String> {
    let n_assumed = if global.verbose > 0 { usize::MAX } else { N_ASSUMED };
    judged(results).map(|verdict| lines(&verdict, n_assumed, |text, style| global.paint_out(text, style)))
}

fn lines(verdict: &Verdict, n_assumed: usize, paint: impl Fn(&str, &str) -> String) -> String {
    let answer = verdict.answer();
    let style = match answer {
        Answer::Trusted => "1;32",
        Answer::Doubtful => "1;33",
        Answer::Refused => "1;31",
    };
    // A sentence that is made of the first reason gives way to the reason with its remedy.
    let sentence = verdict.sentence();
    let first = verdict.first().filter(|first| sentence.starts_with(&first.reason));
    let shown = first.map_or(sentence, ToString::to_string);
    let mut out = format!("verdict  {}: {shown}\n", paint(answer.name(), style));
    let others = verdict.against().filter(|reason| !first.is_some_and(|first| std::ptr::eq(first, *reason)));
    others.for_each(|reason| out += &format!("  - {reason}\n"));
    verdict.assumptions().take(n_assumed).for_each(|assumption| out += &format!("  assumed: {assumption}\n"));
    let chance = verdict
        .chance_of_being_wrong()
        .map(|chance| format!("chance of being wrong: {:.0} % (simulated)", 100.0 * chance));
    let more = match verdict.assumptions().count().saturating_sub(n_assumed) {
        0 => None,
        1 => Some("1 more assumption with --verbose".to_owned()),
        n => Some(format!("{n} more assumptions with --verbose")),
    };
    let last: Vec<String> = chance.into_iter().chain(more).collect();
    if !last.is_empty() {
        out += &format!("  {}\n", last.join("; "));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn reason(rule: &str, answer: &str, remedy: &str) -> Value {
        json!({ "rule": rule, "answer": answer, "reason": format!("{rule} is odd"), "remedy": remedy })
    }

    fn shown(verdict: Value, n_assumed: usize) -> String {
        let verdict = judged(&json!({ "verdict": verdict })).unwrap();
        lines(&verdict, n_assumed, |text, style| format!("<{style}>{text}</>"))
    }

    #[test]
    fn the_answer_is_coloured_and_each_reason_against_the_results_is_said_once() {
        let doubts =
            [reason("order", "trusted", ""), reason("overlap", "doubtful", "scan more"), reason("rms", "doubtful", "")];
        for (verdict, expected) in [
            (
                json!({ "answer": "trusted", "sentence": "it holds", "reasons": [reason("order", "trusted", "")] }),
                "verdict  <1;32>trusted</>: it holds\n",
            ),
            (
                json!({ "answer": "doubtful", "reasons": doubts }),
                "verdict  <1;33>doubtful</>: overlap is odd; scan more\n  - rms is odd\n",
            ),
            (
                json!({ "answer": "refused", "sentence": "no", "reasons": [reason("rms", "refused", "aim again")] }),
                "verdict  <1;31>refused</>: no\n  - rms is odd; aim again\n",
            ),
        ] {
            assert_eq!(shown(verdict, 3), expected);
        }
        let assumed =
            json!({ "answer": "trusted", "sentence": "it holds", "reasons": [], "assumptions": ["a", "b", "c"] });
        let all = "verdict  <1;32>trusted</>: it holds\n  assumed: a\n  assumed: b\n  assumed: c\n";
        assert_eq!(shown(assumed.clone(), 3), all);
        let stated =
            json!({ "answer": "trusted", "sentence": "it holds", "reasons": [], "chance_of_being_wrong": 0.034 });
        let chance = "  chance of being wrong: 3 % (simulated)\n";
        assert_eq!(shown(stated, 3), format!("verdict  <1;32>trusted</>: it holds\n{chance}"));
        let two =
            "verdict  <1;32>trusted</>: it holds\n  assumed: a\n  assumed: b\n  1 more assumption with --verbose\n";
        assert_eq!(shown(assumed.clone(), 2), two);
        assert!(shown(assumed, 1).ends_with("  assumed: a\n  2 more assumptions with --verbose\n"));
    }

    #[test]
    fn a_run_that_failed_or_that_nothing_judged_has_no_lines() {
        for rule in ["failure", "interrupted"] {
            let verdict = json!({ "answer": "refused", "reasons": [reason(rule, "refused", "run again")] });
            assert_eq!(judged(&json!({ "verdict": verdict })), None);
        }
        assert_eq!(judged(&json!({ "notice": "" })), None);
    }
}
