//! A verdict beside the true error.

use super::{Answer, Limits, Verdict};
use crate::metrics::{CutReport, CutsReport, TreReport};
use osteoflow_node_macros::params;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What counts as a wrong answer.
#[params]
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
pub struct VerdictScoreParams {
    /// What is wrong whatever CT and scan are.
    pub limits: Limits,
    /// Whether CT and scan are of the same bone and the landmarks in the planned order; otherwise every answer is wrong.
    #[param(true)]
    pub is_sound: bool,
}

/// A verdict beside the truth.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct VerdictScore {
    /// The answer.
    pub answer: Answer,
    /// The rule of the worst reason; none of a trusted answer.
    pub rule: Option<String>,
    /// The rules of all reasons, the worst first.
    pub rules: String,
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
    /// Mean error at the cuts' middles, mm.
    pub cuts_tre_mm: f64,
    /// The predicted interval of 90 % of the mean TRE of the assessment points; none without a prediction.
    pub interval: Option<IntervalScore>,
    /// The same with the stated bias of the CT.
    pub interval_with_ct_bias: Option<IntervalScore>,
    /// The predicted interval of the mean error at the cuts.
    pub cuts_interval: Option<IntervalScore>,
    /// The same with the stated bias of the CT.
    pub cuts_interval_with_ct_bias: Option<IntervalScore>,
}

/// An interval beside the truth.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct IntervalScore {
    /// 1 if it holds the true value, else 0.
    pub holds: u8,
    /// Its width, mm.
    pub width_mm: f64,
    /// Its score: the width, and twenty times the distance by which the true value is outside, mm. The less the better; a wide
    /// interval pays for its width, a narrow one for its misses. Source: Winkler 1972; Gneiting and Raftery 2007, section 6.2.
    pub score_mm: f64,
}

impl IntervalScore {
    /// Rates an interval of 90 %.
    fn new([low, high]: [f64; 2], value: f64) -> Self {
        let outside = (low - value).max(value - high).max(0.0);
        let width_mm = high - low;
        Self { holds: u8::from(outside == 0.0), width_mm, score_mm: width_mm + 2.0 / MISSED_SHARE * outside }
    }
}

/// Share of the true values that an interval of 90 % misses.
const MISSED_SHARE: f64 = 0.1;

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
    let largest = |of: fn(&CutReport) -> f64| cuts.cuts.iter().map(|cut| of(cut).abs()).fold(0.0, f64::max);
    let (tre_mm, offset_mm) = (tre.mean_abs.norm, largest(|cut| cut.offset_mm));
    let tilt_deg = largest(|cut| cut.tilt_rad).to_degrees();
    let times_limit = params.limits.times(tre_mm, offset_mm, tilt_deg);
    let right = params.is_sound && times_limit <= 1.0;
    let trusted = verdict.answer == Answer::Trusted;
    let predicted = verdict.predicted.as_ref().filter(|_| params.is_sound);
    let points = predicted.and_then(|p| p.assessment.as_ref());
    let cuts = predicted.and_then(|p| p.all_cuts.as_ref());
    let cuts_tre_mm = cut_errors_mm.iter().sum::<f64>() / cut_errors_mm.len().max(1) as f64;
    VerdictScore {
        answer: verdict.answer,
        rule: verdict.reasons.first().map(|reason| reason.rule.clone()),
        rules: verdict.reasons.iter().map(|reason| reason.rule.as_str()).collect::<Vec<_>>().join(" "),
        right: right.into(),
        trusted: trusted.into(),
        wrong_and_trusted: (!right && trusted).into(),
        right_not_trusted: (right && !trusted).into(),
        times_limit,
        tre_mm,
        offset_mm,
        tilt_deg,
        cuts_tre_mm,
        interval: points.map(|set| IntervalScore::new(set.interval_mm, tre_mm)),
        interval_with_ct_bias: points.map(|set| IntervalScore::new(set.interval_with_ct_bias_mm, tre_mm)),
        cuts_interval: cuts.map(|set| IntervalScore::new(set.interval_mm, cuts_tre_mm)),
        cuts_interval_with_ct_bias: cuts.map(|set| IntervalScore::new(set.interval_with_ct_bias_mm, cuts_tre_mm)),
    }
}
