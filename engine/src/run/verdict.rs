//! The verdict on the results of a run: whether they can be trusted, and why not.

pub use osteoflow_verdict::{Answer, Reason};
use serde::de::DeserializeOwned;
use serde_json::{Map, Value as Json};

/// Rule of a reason that the engine gives: a node failed, a result is missing, or the graph was stuck.
pub const FAILURE: &str = "failure";
/// Rule of a reason that the engine gives: the run was stopped before its end.
pub const INTERRUPTED: &str = "interrupted";
/// Rule of a reason that the engine gives: the results are doubtful, and the graph requires trusted ones.
pub const REQUIRE: &str = "require";

/// What an answer may be.
const ANSWERS: &str = "\"trusted\", \"doubtful\" or \"refused\"";

/// A verdict, as in the key `verdict` of `results.json`.
#[derive(Debug, Clone, PartialEq)]
pub struct Verdict {
    answer: Answer,
    reasons: Vec<Reason>,
    json: Map<String, Json>,
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
        let answer = key(object, "answer", ANSWERS).map_err(|why| format!("its {why}"))?;
        let reasons: Vec<Json> = key(object, "reasons", "a list")?;
        let read =
            |(index, json)| reason(json).map_err(|why| format!("reason {} of {}: {why}", index + 1, reasons.len()));
        let reasons = reasons.iter().enumerate().map(read).collect::<Result<Vec<_>, _>>()?;
        key::<Option<String>>(object, "sentence", "a text")?;
        key::<Option<Vec<String>>>(object, "assumptions", "a list of texts")?;
        if let Some(worse) = reasons.iter().find(|reason| reason.answer > answer) {
            return Err(format!(
                "its answer is {answer}, but the answer of its rule \"{}\" is {}",
                worse.rule, worse.answer
            ));
        }
        let verdict = Self { answer, reasons, json: object.clone() };
        match verdict.answer > Answer::Trusted && verdict.against().next().is_none() {
            true => Err(format!("its answer is {answer}, but it gives no reason for that")),
            false => Ok(verdict),
        }
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
            (_, Some(first)) => first.sentence(self.against().count() - 1),
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
        self.against().find(|reason| reason.answer == self.answer).or_else(|| self.against().next())
    }

    /// The reasons that are not "trusted".
    pub fn against(&self) -> impl Iterator<Item = &Reason> {
        self.reasons.iter().filter(|reason| reason.answer > Answer::Trusted)
    }

    /// What the rules take for granted.
    pub fn assumptions(&self) -> impl Iterator<Item = &str> {
        self.json.get("assumptions").and_then(Json::as_array).into_iter().flatten().filter_map(Json::as_str)
    }

    /// The predicted errors, in the form of the node that gave the verdict; null if there are none.
    pub fn predicted(&self) -> &Json {
        self.json.get("predicted").unwrap_or(&Json::Null)
    }

    /// The chance that the answer is wrong, if the node states one.
    pub fn chance_of_being_wrong(&self) -> Option<f64> {
        self.json.get("chance_of_being_wrong").and_then(Json::as_f64)
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

/// Reads a reason.
fn reason(json: &Json) -> Result<Reason, String> {
    let Json::Object(object) = json else {
        return Err(format!("an object was expected, found {}", found(json)));
    };
    let text = |name: &str| key::<String>(object, name, "a text");
    let answer = key(object, "answer", ANSWERS)?;
    let reason = Reason { rule: text("rule")?, answer, reason: text("reason")?, remedy: text("remedy")? };
    match reason.reason.is_empty() || reason.rule.is_empty() {
        true => Err("\"rule\" and \"reason\" must not be empty".into()),
        false => Ok(reason),
    }
}

/// The key of an object, null if it is missing.
fn key<T: DeserializeOwned>(object: &Map<String, Json>, name: &str, expected: &str) -> Result<T, String> {
    let json = object.get(name).unwrap_or(&Json::Null);
    T::deserialize(json).map_err(|_| format!("\"{name}\" must be {expected}, found {}", found(json)))
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
