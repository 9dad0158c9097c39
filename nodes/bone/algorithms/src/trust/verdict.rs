//! The verdict on a result.

use super::{Evidence, Nuisance, Predicted};
use osteoflow_verdict::{Answer, Reason};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

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
    /// Chance that the answer is wrong, beyond the limits: of simulated answers with such signs, half of all being wrong. Refused answers
    /// have one, too.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub chance_of_being_wrong: Option<f64>,
    /// What that chance is of: what speaks against the answer, by name, each 0 where nothing does.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub signs: BTreeMap<String, f64>,
    /// What may be wrong beside the pose: measured, bounded by the data, or unseen by them.
    #[serde(default)]
    pub nuisances: Vec<Nuisance>,
    /// Why the answer holds for the planes at the scan, and not for those that followed the bone's marker since; none if it holds for both.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub trust_ends: Option<String>,
}

impl Verdict {
    /// The verdict that these reasons allow.
    pub fn new(
        mut reasons: Vec<Reason>,
        assumptions: Vec<String>,
        predicted: Option<Predicted>,
        measured: Option<Evidence>,
        nuisances: Vec<Nuisance>,
    ) -> Self {
        reasons.sort_by_key(|reason| std::cmp::Reverse(reason.answer));
        let answer = reasons.first().map_or(Answer::Trusted, |reason| reason.answer);
        let sentence = match (&reasons[..], &predicted) {
            ([], Some(predicted)) => predicted.sentence(),
            ([], None) => "no sign against it was found".to_owned(),
            ([first, others @ ..], _) => first.sentence(others.len()),
        };
        let (chance_of_being_wrong, signs, trust_ends) = (None, BTreeMap::new(), None);
        Self {
            answer,
            sentence,
            reasons,
            assumptions,
            predicted,
            measured,
            chance_of_being_wrong,
            signs,
            nuisances,
            trust_ends,
        }
    }
}
