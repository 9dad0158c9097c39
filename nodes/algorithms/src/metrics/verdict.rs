use super::{CutsReport, TreReport};
use crate::trust::{Answer, Verdict};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What counts as a wrong answer.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct VerdictScoreParams {
    /// Wrong if the mean TRE of the assessment points is larger, mm. 1.5: half of what a cut may be off.
    #[schemars(range(min = 0.0, max = 1000.0))]
    pub max_tre_mm: f64,
    /// Wrong if a cut is displaced by more in the middle of the bone, mm.
    #[schemars(range(min = 0.0, max = 1000.0))]
    pub max_offset_mm: f64,
    /// Wrong if a cut is tilted by more, degrees.
    #[schemars(range(min = 0.0, max = 180.0))]
    pub max_tilt_deg: f64,
    /// Whether CT and scan are of the same bone and the landmarks in the planned order; otherwise every answer is wrong.
    pub is_sound: bool,
}

impl Default for VerdictScoreParams {
    fn default() -> Self {
        Self { max_tre_mm: 1.5, max_offset_mm: 1.5, max_tilt_deg: 0.5, is_sound: true }
    }
}

/// A verdict beside the truth.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct VerdictScore {
    /// The answer.
    pub answer: Answer,
    /// The rule of the worst reason; none of a trusted answer.
    pub rule: Option<String>,
    /// 1 if the registration is right, else 0.
    pub right: u8,
    /// 1 if the answer is trusted, else 0.
    pub trusted: u8,
    /// 1 if it is wrong and trusted, else 0.
    pub wrong_and_trusted: u8,
    /// 1 if it is right and not trusted, else 0.
    pub right_not_trusted: u8,
    /// The largest of error over limit: above 1 is wrong.
    pub times_limit: f64,
    /// Mean TRE, mm.
    pub tre_mm: f64,
    /// Largest displacement of a cut, mm.
    pub offset_mm: f64,
    /// Largest tilt of a cut, degrees.
    pub tilt_deg: f64,
    /// 1 if the predicted interval of 90 % holds the mean TRE of the assessment points, else 0; none without a prediction.
    pub interval_holds: Option<u8>,
    /// The same of the mean TRE at the cuts.
    pub cuts_interval_holds: Option<u8>,
}

/// Compares a verdict with the true error.
///
/// `cut_errors_mm` are the true displacements of the cuts' middles, for the predicted interval at the cuts.
pub fn verdict_score(
    verdict: &Verdict,
    tre: &TreReport,
    cuts: &CutsReport,
    cut_errors_mm: &[f64],
    params: &VerdictScoreParams,
) -> VerdictScore {
    let largest = |of: fn(&super::CutReport) -> f64| cuts.cuts.iter().map(|cut| of(cut).abs()).fold(0.0, f64::max);
    let (tre_mm, offset_mm) = (tre.mean_abs.norm, largest(|cut| cut.offset_mm));
    let tilt_deg = largest(|cut| cut.tilt_rad).to_degrees();
    let times_limit =
        (tre_mm / params.max_tre_mm).max(offset_mm / params.max_offset_mm).max(tilt_deg / params.max_tilt_deg);
    let right = params.is_sound && times_limit <= 1.0;
    let trusted = verdict.answer == Answer::Trusted;
    let holds = |interval: [f64; 2], value: f64| u8::from((interval[0]..=interval[1]).contains(&value));
    let predicted = verdict.predicted.as_ref().filter(|_| params.is_sound);
    let at_cuts = cut_errors_mm.iter().sum::<f64>() / cut_errors_mm.len().max(1) as f64;
    VerdictScore {
        answer: verdict.answer,
        rule: verdict.reasons.first().map(|reason| reason.rule.clone()),
        right: right.into(),
        trusted: trusted.into(),
        wrong_and_trusted: (!right && trusted).into(),
        right_not_trusted: (right && !trusted).into(),
        times_limit,
        tre_mm,
        offset_mm,
        tilt_deg,
        interval_holds: predicted.and_then(|p| p.assessment.as_ref()).map(|set| holds(set.interval_mm, tre_mm)),
        cuts_interval_holds: predicted.and_then(|p| p.all_cuts.as_ref()).map(|set| holds(set.interval_mm, at_cuts)),
    }
}
