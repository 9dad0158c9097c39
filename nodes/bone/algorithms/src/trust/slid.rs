//! What a slide profile says against a registration.

use crate::slide::SlideReport;
use osteoflow_verdict::{Answer, Reason};

/// Movements by a slide that are noted: along the bone, mm, and around it, rad. More than point-to-point leaves of a sound start.
const NOTED_MM: f64 = 1.5;
const NOTED_RAD: f64 = 2.0 * std::f64::consts::PI / 180.0;

/// The signs in a slide profile: a place that the residuals do not determine, and another that fits as well.
pub(super) fn slide_reasons(report: &SlideReport) -> Vec<Reason> {
    let remedy = "scan a longer stretch, or one with more shape";
    if !report.determined {
        let reason = format!("the scan does not determine its place on the bone: {}", report.undetermined().join("; "));
        return vec![Reason::new("slide", Answer::Refused, reason, remedy)];
    }
    let rival = report.runner_up.as_ref().filter(|other| !other.is_told_apart);
    let reason = |words| Reason::new("slide", Answer::Doubtful, words, remedy);
    rival.map(|other| reason(other.words(report.residual_mm))).into_iter().collect()
}

/// What a verdict takes for granted where the slide went far from the registration before it.
pub(super) fn slide_note(report: &SlideReport) -> Option<String> {
    let is_far = report.moved_along_mm.abs() > NOTED_MM || report.moved_turn_rad.abs() > NOTED_RAD;
    is_far.then(|| {
        format!(
            "the place that the slide profile found is the right one: the registration before it ended {:.1} mm along the bone and \
             {:.1} degrees around it from there",
            report.moved_along_mm.abs(),
            report.moved_turn_rad.abs().to_degrees()
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::slide::{Other, SlideProfile};

    fn report() -> SlideReport {
        let profile = SlideProfile {
            offsets: vec![-1.0, 0.0, 1.0],
            others: vec![0.0; 3],
            residual_mm: vec![0.2, 0.1, 0.2],
            excess_mm: vec![0.17, 0.0, 0.17],
            interval: [-0.2, 0.2],
            is_undetermined: false,
        };
        SlideReport {
            determined: true,
            modes: vec!["slides along the bone: ..".into(), "turns about the bone: ..".into()],
            axis: [0.0, 0.0, 1.0],
            middle_mm: [0.0; 3],
            radius_mm: 6.0,
            moved_along_mm: -0.4,
            moved_turn_rad: 0.01,
            moved_mm: 0.4,
            residual_mm: 0.1,
            sigma_mm: 0.1,
            noise_mm: 0.05,
            n_cells: 30,
            along: profile.clone(),
            around: profile,
            runner_up: None,
        }
    }

    fn rival(is_told_apart: bool) -> Option<Other> {
        let (along_mm, turn_rad, apart_mm) = (14.0, 0.0, 14.0);
        Some(Other { along_mm, turn_rad, apart_mm, residual_mm: 0.11, excess_mm: 0.045, sigmas: 1.2, is_told_apart })
    }

    #[test]
    fn an_undetermined_place_is_refused_and_a_rival_that_fits_as_well_is_doubtful() {
        assert_eq!(slide_reasons(&report()), []);
        assert_eq!(slide_reasons(&SlideReport { runner_up: rival(true), ..report() }), []);
        let reasons = slide_reasons(&SlideReport { runner_up: rival(false), ..report() });
        assert_eq!((reasons.len(), reasons[0].answer), (1, Answer::Doubtful));
        assert!(reasons[0].reason.starts_with("the scan fits as well 14 mm along the bone"), "{reasons:?}");
        let around = SlideProfile { is_undetermined: true, ..report().around };
        let reasons = slide_reasons(&SlideReport { determined: false, around, runner_up: rival(false), ..report() });
        assert_eq!((reasons.len(), reasons[0].answer), (1, Answer::Refused));
        assert!(reasons[0].reason.ends_with("on the bone: turns about the bone: .."), "{reasons:?}");
    }

    #[test]
    fn a_far_movement_is_noted_with_its_length() {
        assert_eq!(slide_note(&report()), None);
        let note =
            |moved_along_mm, moved_turn_rad| slide_note(&SlideReport { moved_along_mm, moved_turn_rad, ..report() });
        assert_eq!((note(NOTED_MM, NOTED_RAD), note(0.0, 1.9_f64.to_radians())), (None, None));
        let turned = note(0.3, -2.1_f64.to_radians()).unwrap();
        assert!(turned.ends_with("ended 0.3 mm along the bone and 2.1 degrees around it from there"), "{turned}");
        let note = slide_note(&SlideReport { moved_along_mm: -6.9, ..report() }).unwrap();
        assert!(note.contains("ended 6.9 mm along the bone and 0.6 degrees around it"), "{note}");
    }
}
