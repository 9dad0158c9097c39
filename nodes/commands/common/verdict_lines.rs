//! The verdict on the results of a run as lines for a terminal.

use super::global::Global;
use crate::app::judged;
use osteoflow_engine::run::{Answer, Verdict};
use serde_json::Value;

/// The verdict of a node, with a line for each reason against the results; with --verbose also what it assumes. `None` if
/// nothing judged the results.
pub(crate) fn text(results: &Value, global: &Global) -> Option<String> {
    judged(results).map(|verdict| lines(&verdict, global.verbose > 0, |text, style| global.paint_out(text, style)))
}

fn lines(verdict: &Verdict, assumptions: bool, paint: impl Fn(&str, &str) -> String) -> String {
    let answer = verdict.answer();
    let style = match answer {
        Answer::Trusted => "1;32",
        Answer::Doubtful => "1;33",
        Answer::Refused => "1;31",
    };
    let mut out = format!("verdict  {}: {}\n", paint(answer.name(), style), verdict.sentence());
    verdict.against().for_each(|reason| out += &format!("  - {reason}\n"));
    if assumptions {
        verdict.assumptions().for_each(|assumption| out += &format!("  assumed: {assumption}\n"));
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

    fn shown(verdict: Value, assumptions: bool) -> String {
        let verdict = judged(&json!({ "verdict": verdict })).unwrap();
        lines(&verdict, assumptions, |text, style| format!("<{style}>{text}</>"))
    }

    #[test]
    fn the_answer_is_coloured_and_each_reason_against_the_results_has_a_line() {
        let doubts =
            [reason("order", "trusted", ""), reason("overlap", "doubtful", "scan more"), reason("rms", "doubtful", "")];
        for (verdict, expected) in [
            (
                json!({ "answer": "trusted", "sentence": "it holds", "reasons": [reason("order", "trusted", "")] }),
                "verdict  <1;32>trusted</>: it holds\n",
            ),
            (
                json!({ "answer": "doubtful", "reasons": doubts }),
                "verdict  <1;33>doubtful</>: overlap is odd, and 1 more reason\n  - overlap is odd; scan more\n  - rms is odd\n",
            ),
            (
                json!({ "answer": "refused", "sentence": "no", "reasons": [reason("rms", "refused", "aim again")] }),
                "verdict  <1;31>refused</>: no\n  - rms is odd; aim again\n",
            ),
        ] {
            assert_eq!(shown(verdict, false), expected);
        }
        let assumed = json!({ "answer": "trusted", "sentence": "it holds", "reasons": [], "assumptions": ["a", "b"] });
        assert_eq!(shown(assumed.clone(), false).lines().count(), 1);
        assert_eq!(shown(assumed, true), "verdict  <1;32>trusted</>: it holds\n  assumed: a\n  assumed: b\n");
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
