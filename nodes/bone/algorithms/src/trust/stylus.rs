//! What a stylus says against a registration.

use super::Predicted;
use osteoflow_node_macros::params;
use osteoflow_verdict::{Answer, Reason};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Refused from this many times the largest error that raises no doubt.
const REFUSED_FROM: f64 = 3.0;

/// Standard normal quantiles: of the upper end of the predicted interval, and of the level at which a reading contradicts it.
const PREDICTED_SIGMAS: f64 = 1.645;
const CONTRARY_SIGMAS: f64 = 2.326;

/// The length of a three-dimensional Gaussian, in standard deviations of an axis, that one in a hundred exceeds.
const CONTRARY_LENGTH: f64 = 3.368;

/// Stated errors of the stylus.
#[params]
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct StylusErrors {
    /// Standard deviation, per axis, of the calibrated tip: all touches share it. 0.2: pivots of one electromagnetic stylus
    /// differ by 0.27 mm, those of an optical one by half as much.
    #[param(0.2, 0.0..=100.0)]
    pub tip_mm: f64,
    /// Standard deviation, per axis, of a single touch: the seat of the tip, and the tracked markers of stylus and bone. 0.25:
    /// a hole of 1 mm, and a marker's 0.06 mm with its attitude over 150 mm of stylus, twice.
    #[param(0.25, 0.0..=100.0)]
    pub touch_mm: f64,
}

/// The sign in the mean error that a stylus measured, mm; `None` if it is at most `max_mm`, and at most what the prediction and the
/// stylus' own error explain together in 99 of 100 sound procedures.
pub(super) fn stylus_reason(
    measured_mm: Option<f64>,
    predicted: Option<&Predicted>,
    max_mm: f64,
    errors: &StylusErrors,
) -> Option<Reason> {
    let mm = measured_mm?;
    if mm > max_mm {
        let answer = if mm > REFUSED_FROM * max_mm { Answer::Refused } else { Answer::Doubtful };
        let text =
            format!("the stylus finds the assessment points {mm:.1} mm (mean) from where the registration puts them");
        return Some(Reason::new("stylus", answer, text, "check bone, side and landmarks, and the stylus' tip"));
    }
    let [from_mm, to_mm] = predicted?.assessment.as_ref()?.interval_mm;
    let explained_mm = explained_mm(predicted?, errors)?;
    (mm > explained_mm).then(|| {
        let text = format!(
            "the stylus finds the assessment points {mm:.1} mm (mean) from where the registration puts them, which contradicts the \
             predicted error of {from_mm:.1} to {to_mm:.1} mm: both and the stylus' own error explain {explained_mm:.1} mm"
        );
        let remedy = "calibrate the stylus' tip again and touch the points again; if they stay off, then the CT's scale, the \
                      camera's calibration or the time of the poses is wrong, or the scan was taken of something on the bone";
        Reason::new("stylus", Answer::Doubtful, text, remedy)
    })
}

/// The mean reading that one in a hundred sound procedures exceeds, mm; `None` without a prediction at the points.
fn explained_mm(predicted: &Predicted, errors: &StylusErrors) -> Option<f64> {
    let set = predicted.assessment.as_ref()?;
    let registration_mm =
        set.mean_tre_mm + (set.interval_mm[1] - set.mean_tre_mm).max(0.0) * CONTRARY_SIGMAS / PREDICTED_SIGMAS;
    let tip_mm = CONTRARY_LENGTH * errors.tip_mm;
    // Independent from touch to touch, it adds its square to the mean.
    let touch_mm = 3.0_f64.sqrt() * errors.touch_mm;
    Some(registration_mm.hypot(tip_mm).hypot(touch_mm))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trust::PredictedSet;

    fn predicted(interval_mm: [f64; 2]) -> Predicted {
        let mean_tre_mm = (interval_mm[0] + interval_mm[1]) / 2.0;
        let set = PredictedSet { mean_tre_mm, interval_mm, interval_with_ct_bias_mm: interval_mm };
        Predicted { assessment: Some(set), ..Predicted::default() }
    }

    fn reason(mm: f64, interval_mm: [f64; 2]) -> Option<Reason> {
        stylus_reason(Some(mm), Some(&predicted(interval_mm)), 2.5, &StylusErrors::default())
    }

    #[test]
    fn a_reading_beyond_prediction_and_stylus_contradicts_both() {
        // 0.3 mm and 0.2 mm to the upper end give 0.58 mm at one in a hundred; with 0.67 mm of the tip and 0.43 mm of the touches 0.99 mm.
        assert_eq!((reason(0.5, [0.1, 0.5]), reason(0.98, [0.1, 0.5])), (None, None));
        let contrary = reason(2.4, [0.1, 0.5]).unwrap();
        assert_eq!((contrary.rule.as_str(), contrary.answer), ("stylus", Answer::Doubtful));
        let words = "2.4 mm (mean) from where the registration puts them, which contradicts the predicted error of 0.1 to 0.5 mm: both \
                     and the stylus' own error explain 1.0 mm";
        assert!(contrary.reason.ends_with(words), "{}", contrary.reason);
        assert!(reason(1.01, [0.1, 0.5]).is_some());
        // A wide prediction is not contradicted by what it allows.
        assert_eq!(reason(2.4, [0.8, 2.2]), None);
    }

    #[test]
    fn beyond_the_limit_it_is_told_with_any_prediction_or_none() {
        let rule = |mm| stylus_reason(Some(mm), None, 2.5, &StylusErrors::default()).map(|reason| reason.answer);
        assert_eq!((rule(2.5), rule(2.6), rule(7.6)), (None, Some(Answer::Doubtful), Some(Answer::Refused)));
        assert_eq!(reason(2.6, [0.5, 5.0]).unwrap().answer, Answer::Doubtful);
        assert_eq!(stylus_reason(None, Some(&predicted([0.1, 0.5])), 2.5, &StylusErrors::default()), None);
    }

    #[test]
    fn a_worse_stylus_explains_more() {
        let errors = StylusErrors { tip_mm: 0.8, touch_mm: 0.25 };
        assert_eq!(stylus_reason(Some(2.4), Some(&predicted([0.1, 0.5])), 2.5, &errors), None);
    }
}
