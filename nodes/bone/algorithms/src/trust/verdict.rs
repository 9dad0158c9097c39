//! The verdict on a result.

use super::{Evidence, Predicted};
use serde::{Deserialize, Serialize};

/// How far a result can be trusted. Ordered from best to worst.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Answer {
    /// No sign contradicts the result.
    Trusted,
    /// The result may be right; the reasons say what speaks against it.
    Doubtful,
    /// The result is withheld.
    Refused,
}

impl Answer {
    /// `trusted`, `doubtful` or `refused`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Trusted => "trusted",
            Self::Doubtful => "doubtful",
            Self::Refused => "refused",
        }
    }
}

/// One sign against a result.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Reason {
    /// The rule, a name that does not change.
    pub rule: String,
    /// The best answer that the sign allows.
    pub answer: Answer,
    /// What is wrong, with numbers and the likely cause.
    pub reason: String,
    /// What to do about it.
    pub remedy: String,
}

impl Reason {
    /// A sign against a result.
    pub fn new(rule: &str, answer: Answer, reason: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self { rule: rule.into(), answer, reason: reason.into(), remedy: remedy.into() }
    }
}

/// The verdict on a result: the answer, its reasons, and what it rests on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Verdict {
    /// The worst answer of the reasons; trusted without any.
    pub answer: Answer,
    /// The verdict in a sentence, without the answer.
    pub sentence: String,
    /// Every sign against the result, worst first.
    pub reasons: Vec<Reason>,
    /// What the verdict cannot see and takes for granted.
    pub assumptions: Vec<String>,
    /// The predicted error, where it can be predicted.
    pub predicted: Option<Predicted>,
    /// The quantities behind the answer, where there was a registration.
    pub measured: Option<Evidence>,
}

impl Verdict {
    /// The verdict that these reasons allow.
    pub fn new(
        mut reasons: Vec<Reason>,
        assumptions: Vec<String>,
        predicted: Option<Predicted>,
        measured: Option<Evidence>,
    ) -> Self {
        reasons.sort_by_key(|reason| std::cmp::Reverse(reason.answer));
        let answer = reasons.first().map_or(Answer::Trusted, |reason| reason.answer);
        let sentence = match (&reasons[..], &predicted) {
            ([], Some(predicted)) => predicted.sentence(),
            ([], None) => "no sign against it was found".to_owned(),
            ([only], _) => only.reason.clone(),
            ([first, _], _) => format!("{}, and 1 more reason", first.reason),
            ([first, others @ ..], _) => format!("{}, and {} more reasons", first.reason, others.len()),
        };
        Self { answer, sentence, reasons, assumptions, predicted, measured }
    }
}
