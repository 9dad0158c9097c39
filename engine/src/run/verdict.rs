//! The verdict on the results of a run: whether they can be trusted, and why not.

use serde_json::{Map, Value as Json};
use std::fmt;

/// Rule of a reason that the engine gives: a node failed, a result is missing, or the graph was stuck.
pub const FAILURE: &str = "failure";
/// Rule of a reason that the engine gives: the run was stopped before its end.
pub const INTERRUPTED: &str = "interrupted";
/// Rule of a reason that the engine gives: the results are doubtful, and the graph requires trusted ones.
pub const REQUIRE: &str = "require";

/// Answer of a verdict, or of one of its reasons; a greater one is worse.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Answer {
    /// Nothing speaks against the results.
    Trusted,
    /// Something speaks against the results, but does not exclude them.
    Doubtful,
    /// The results must not be used.
    Refused,
}

impl Answer {
    /// Every answer, the best first.
    pub const ALL: [Self; 3] = [Self::Trusted, Self::Doubtful, Self::Refused];

    /// `trusted`, `doubtful` or `refused`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Trusted => "trusted",
            Self::Doubtful => "doubtful",
            Self::Refused => "refused",
        }
    }
}

impl fmt::Display for Answer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// A verdict, as in the key `verdict` of `results.json`.
#[derive(Debug, Clone, PartialEq)]
pub struct Verdict {
    answer: Answer,
    reasons: Vec<Reason>,
    json: Map<String, Json>,
}

/// What one rule says about the results.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Reason {
    /// Name of the rule.
    pub rule: String,
    /// Its answer.
    pub answer: Answer,
    /// What was found.
    pub reason: String,
    /// What to do about it; may be empty.
    pub remedy: String,
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.reason)?;
        if self.remedy.is_empty() { Ok(()) } else { write!(f, "; {}", self.remedy) }
    }
}

impl Verdict {
    /// Reads a verdict.
    ///
    /// # Errors
    /// What is wrong: a key is missing or has another type, or the answer contradicts the reasons.
    pub fn read(json: &Json) -> Result<Self, String> {
        let Json::Object(object) = json else {
            return Err(format!("an object was expected, found {}", found(json)));
        };
        let reasons = object.get("reasons").unwrap_or(&Json::Null);
        let Json::Array(list) = reasons else {
            return Err(format!("\"reasons\" must be a list, found {}", found(reasons)));
        };
        let answer = answer(object).map_err(|why| format!("its {why}"))?;
        let reasons = list.iter().enumerate().map(|(index, reason)| {
            Reason::read(reason).map_err(|why| format!("reason {} of {}: {why}", index + 1, list.len()))
        });
        let reasons = reasons.collect::<Result<Vec<_>, _>>()?;
        match object.get("sentence") {
            None | Some(Json::Null | Json::String(_)) => {}
            Some(other) => return Err(format!("\"sentence\" must be a text, found {}", found(other))),
        }
        match object.get("assumptions") {
            None | Some(Json::Null) => {}
            Some(Json::Array(texts)) if texts.iter().all(Json::is_string) => {}
            Some(other) => return Err(format!("\"assumptions\" must be a list of texts, found {}", found(other))),
        }
        if let Some(worse) = reasons.iter().find(|reason| reason.answer > answer) {
            return Err(format!(
                "its answer is {answer}, but the answer of its rule \"{}\" is {}",
                worse.rule, worse.answer
            ));
        }
        if answer > Answer::Trusted && reasons.iter().all(|reason| reason.answer == Answer::Trusted) {
            return Err(format!("its answer is {answer}, but it gives no reason for that"));
        }
        Ok(Self { answer, reasons, json: object.clone() })
    }

    /// The verdict in the content of a `results.json`; `None` if it has none that can be read.
    pub fn of(results: &Json) -> Option<Self> {
        Self::read(results.get("verdict")?).ok()
    }

    /// The answer.
    pub fn answer(&self) -> Answer {
        self.answer
    }

    /// One sentence about the answer. If the verdict has none, it is composed of the first reason.
    pub fn sentence(&self) -> String {
        match (self.json.get("sentence").and_then(Json::as_str), self.first()) {
            (Some(sentence), _) if !sentence.is_empty() => sentence.into(),
            (_, Some(first)) => match self.reasons.iter().filter(|r| r.answer > Answer::Trusted).count() {
                0 | 1 => first.reason.clone(),
                2 => format!("{}, and 1 more reason", first.reason),
                n => format!("{}, and {} more reasons", first.reason, n - 1),
            },
            _ => "nothing speaks against the results".into(),
        }
    }

    /// What the rules say.
    pub fn reasons(&self) -> &[Reason] {
        &self.reasons
    }

    /// The first reason for the answer: with this answer, or else the first that is not "trusted"; `None` if the answer
    /// is "trusted".
    pub fn first(&self) -> Option<&Reason> {
        let against = || self.reasons.iter().filter(|reason| reason.answer > Answer::Trusted);
        against().find(|reason| reason.answer == self.answer).or_else(|| against().next())
    }

    /// What the rules take for granted.
    pub fn assumptions(&self) -> impl Iterator<Item = &str> {
        self.json.get("assumptions").and_then(Json::as_array).into_iter().flatten().filter_map(Json::as_str)
    }

    /// The predicted errors, in the form of the node that gave the verdict; null if there are none.
    pub fn predicted(&self) -> &Json {
        self.json.get("predicted").unwrap_or(&Json::Null)
    }

    /// Whether a node judged the results. If not, the run failed or was stopped.
    pub fn is_judged(&self) -> bool {
        !matches!(self.reasons.as_slice(), [only] if only.rule == FAILURE || only.rule == INTERRUPTED)
    }

    /// The verdict as JSON, with every key that it was given.
    pub(crate) fn into_json(self) -> Json {
        self.json.into()
    }

    /// The verdict with the answer refused, and a reason for that before the others.
    pub(crate) fn refused(mut self, reason: &Json) -> Self {
        self.json.insert("answer".into(), Answer::Refused.name().into());
        if let Some(Json::Array(reasons)) = self.json.get_mut("reasons") {
            reasons.insert(0, reason.clone());
        }
        self
    }
}

impl Reason {
    fn read(json: &Json) -> Result<Self, String> {
        let Json::Object(object) = json else {
            return Err(format!("an object was expected, found {}", found(json)));
        };
        let text = |key: &str| match object.get(key) {
            Some(Json::String(text)) => Ok(text.clone()),
            other => Err(format!("\"{key}\" must be a text, found {}", found(other.unwrap_or(&Json::Null)))),
        };
        let reason =
            Self { rule: text("rule")?, answer: answer(object)?, reason: text("reason")?, remedy: text("remedy")? };
        match reason.reason.is_empty() || reason.rule.is_empty() {
            true => Err("\"rule\" and \"reason\" must not be empty".into()),
            false => Ok(reason),
        }
    }
}

fn answer(of: &Map<String, Json>) -> Result<Answer, String> {
    let given = of.get("answer").unwrap_or(&Json::Null);
    let answer = Answer::ALL.into_iter().find(|answer| given.as_str() == Some(answer.name()));
    answer.ok_or_else(|| format!("\"answer\" must be \"trusted\", \"doubtful\" or \"refused\", found {}", found(given)))
}

/// Describes a value in a message.
fn found(json: &Json) -> String {
    match json {
        Json::Null => "nothing".into(),
        Json::Bool(_) | Json::Number(_) => json.to_string(),
        Json::String(text) if text.chars().count() <= 40 => format!("{text:?}"),
        Json::String(_) => "a text".into(),
        Json::Array(items) => format!("a list of {}", items.len()),
        Json::Object(_) => "an object".into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn reason(answer: &str) -> Json {
        json!({ "rule": "order", "answer": answer, "reason": "two landmarks are swapped", "remedy": "aim again" })
    }

    #[test]
    fn a_verdict_is_read_only_if_it_agrees_with_its_reasons() {
        let with = |answer: &str, reasons: Json| json!({ "answer": answer, "reasons": reasons });
        for (given, answer) in [
            (with("trusted", json!([])), Answer::Trusted),
            (with("trusted", json!([reason("trusted")])), Answer::Trusted),
            (with("doubtful", json!([reason("trusted"), reason("doubtful")])), Answer::Doubtful),
            (with("refused", json!([reason("doubtful")])), Answer::Refused),
            (
                json!({ "answer": "trusted", "sentence": null, "reasons": [], "assumptions": ["a"], "more": 1 }),
                Answer::Trusted,
            ),
        ] {
            assert_eq!(Verdict::read(&given).map(|verdict| verdict.answer()), Ok(answer), "{given}");
        }
        let mut no_remedy = reason("doubtful");
        no_remedy.as_object_mut().unwrap().remove("remedy");
        for (given, expected) in [
            (json!(null), "an object was expected, found nothing"),
            (json!(1.5), "an object was expected, found 1.5"),
            (json!(["trusted"]), "an object was expected, found a list of 1"),
            (
                with("maybe", json!([])),
                "its \"answer\" must be \"trusted\", \"doubtful\" or \"refused\", found \"maybe\"",
            ),
            (
                json!({ "reasons": [] }),
                "its \"answer\" must be \"trusted\", \"doubtful\" or \"refused\", found nothing",
            ),
            (json!({ "answer": "trusted" }), "\"reasons\" must be a list, found nothing"),
            (with("refused", json!("no")), "\"reasons\" must be a list, found \"no\""),
            (with("refused", json!(["no"])), "reason 1 of 1: an object was expected, found \"no\""),
            (with("doubtful", json!([reason("doubtful"), reason("bad")])), "reason 2 of 2: \"answer\" must be"),
            (with("doubtful", json!([no_remedy])), "reason 1 of 1: \"remedy\" must be a text, found nothing"),
            (
                with("trusted", json!([reason("doubtful")])),
                "its answer is trusted, but the answer of its rule \"order\" is doubtful",
            ),
            (
                with("doubtful", json!([reason("refused")])),
                "its answer is doubtful, but the answer of its rule \"order\" is refused",
            ),
            (with("doubtful", json!([])), "its answer is doubtful, but it gives no reason for that"),
            (with("refused", json!([reason("trusted")])), "its answer is refused, but it gives no reason for that"),
            (json!({ "answer": "trusted", "reasons": [], "sentence": 1 }), "\"sentence\" must be a text, found 1"),
            (
                json!({ "answer": "trusted", "reasons": [], "assumptions": [1] }),
                "\"assumptions\" must be a list of texts",
            ),
        ] {
            let message = Verdict::read(&given).unwrap_err();
            assert!(message.starts_with(expected), "{given}\n{message}\nlacks\n{expected}");
        }
    }

    #[test]
    fn a_sentence_is_composed_of_the_first_reason_for_the_answer() {
        let other = json!({ "rule": "rms", "answer": "refused", "reason": "the RMS is 3 mm", "remedy": "" });
        for (answer, reasons, expected) in [
            ("trusted", vec![reason("trusted")], "nothing speaks against the results"),
            ("doubtful", vec![reason("trusted"), reason("doubtful")], "two landmarks are swapped"),
            ("refused", vec![reason("doubtful"), other.clone()], "the RMS is 3 mm, and 1 more reason"),
            (
                "refused",
                vec![reason("doubtful"), reason("doubtful"), other.clone()],
                "the RMS is 3 mm, and 2 more reasons",
            ),
        ] {
            let verdict = Verdict::read(&json!({ "answer": answer, "reasons": reasons })).unwrap();
            assert_eq!(verdict.sentence(), expected);
        }
        let verdict = json!({ "answer": "refused", "sentence": "the scan is too small", "reasons": [other] });
        assert_eq!(Verdict::read(&verdict).unwrap().sentence(), "the scan is too small");
        assert_eq!(Verdict::read(&verdict).unwrap().first().unwrap().to_string(), "the RMS is 3 mm");
    }
}
