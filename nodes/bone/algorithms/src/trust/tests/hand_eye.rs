//! A matrix of camera and marker that was given: what tests it, and what is said where nothing does.

use super::*;
use crate::metrics::check_points;
use crate::still_average::{Carries, MarkerMotion, TakeMotion, still_average};

/// Poses of the camera, turned about the bone by these angles, degrees.
fn camera_at(turn_deg: [f64; 3]) -> Isometry3<f64> {
    let middle = Vector3::new(0.0, 0.0, 60.0);
    let about = Isometry3::new(Vector3::zeros(), Vector3::from(turn_deg).map(f64::to_radians));
    let at = Isometry3::translation(200.0, 0.0, 0.0) * Isometry3::rotation(Vector3::y() * -std::f64::consts::FRAC_PI_2);
    Isometry3::from(middle) * about * at
}

/// A scan or a landmark that the camera's marker carried.
fn take(what: &str, turn_deg: [f64; 3]) -> TakeMotion {
    let still = still_average(&[Isometry3::identity(); 3], 1e9, 1e9).unwrap().report;
    let motion = MarkerMotion::new("camera", Carries::Data, &Point3::origin(), &still);
    TakeMotion::new(what).by(Some(motion)).seen_from(Some(&camera_at(turn_deg)))
}

struct Given {
    turns_deg: Vec<[f64; 3]>,
    apart_mm: Option<f64>,
    read_mm: Option<f64>,
    measured_tre_mm: Option<f64>,
    tracking: Option<Tracking>,
    errors: PredictParams,
}

impl Default for Given {
    fn default() -> Self {
        let tracking = Tracking {
            camera_marker: Point3::new(200.0, 0.0, 60.0),
            phantom_marker: None,
            phantom_fit: None,
            is_given: true,
        };
        let errors = PredictParams::default();
        Self {
            turns_deg: vec![[0.0; 3]; 3],
            apart_mm: Some(0.15),
            read_mm: None,
            measured_tre_mm: None,
            tracking: Some(tracking),
            errors,
        }
    }
}

impl Given {
    fn judged(&self) -> Verdict {
        let (target, scan) = (target_of(&shaft()), scan_of(&shaft(), [15.0, 105.0], 2));
        let (marks, pose) = (marks(), Isometry3::identity());
        let at_scan = take("the scan", [0.0; 3]);
        let located: Vec<TakeMotion> = self.turns_deg.iter().map(|turn| take("P1", *turn)).collect();
        let takes = Takes { scan: Some(&at_scan), located: &located, apart_mm: self.apart_mm, ..Takes::default() };
        let check = self.read_mm.map(|mm| {
            let known = [NamedPoint::new("working_1", Point3::origin())];
            let read = [NamedPoint::new("working_1", Point3::new(mm, 0.0, 0.0))];
            check_points(&read, &known, &pose, None).unwrap()
        });
        let check: Vec<_> = check.into_iter().collect();
        let case = Case {
            landmarks: &marks,
            located: &marks,
            assessment: &marks,
            measured_tre_mm: self.measured_tre_mm,
            tracking: self.tracking.as_ref(),
            check: &check,
            takes,
            ..bare(&target, &scan, &pose)
        };
        judge(&case, &EvidenceParams::default(), &RuleParams::default(), &self.errors)
    }

    /// The rules that doubt it, and the term of the matrix in the predicted error, mm.
    fn told(&self) -> (Vec<String>, f64) {
        let verdict = self.judged();
        let terms = &verdict.predicted.as_ref().unwrap().terms;
        let term =
            terms.iter().find(|term| term.name.starts_with("camera on its marker")).map_or(0.0, |term| term.tre_mm);
        (verdict.reasons.iter().map(|reason| reason.rule.clone()).collect(), term)
    }
}

#[test]
fn a_given_matrix_that_nothing_tests_is_doubted_and_widens_the_interval() {
    let (rules, mm) = Given::default().told();
    assert!(rules == ["hand_eye"] && mm > 30.0, "{rules:?} {mm}");
    let verdict = Given::default().judged();
    assert_eq!(verdict.answer, Answer::Doubtful);
    let interval = verdict.predicted.unwrap().assessment.unwrap().interval_mm;
    assert!(interval[1] > 30.0, "{interval:?}");
    // A verdict that is not told of the matrix at all believes it no more.
    let (rules, mm) = Given { tracking: None, ..Given::default() }.told();
    assert!(rules == ["hand_eye"] && mm > 30.0, "{rules:?} {mm}");
    // All landmarks at the scan's pose of the camera, however exact, test nothing; nor does one turn, about its own axis.
    let (_, one_axis) = Given { turns_deg: vec![[0.0, 0.0, 30.0]; 3], ..Given::default() }.told();
    assert!(one_axis > 5.0, "{one_axis}");
}

#[test]
fn turns_of_the_camera_about_two_axes_test_a_given_matrix_by_how_far_the_scans_lie_apart() {
    let turned = |deg: f64, apart_mm| {
        let turns_deg = vec![[0.0, 0.0, deg], [0.0, deg, 0.0], [0.0, -deg, deg]];
        Given { turns_deg, apart_mm, ..Given::default() }.told()
    };
    let (rules, mm) = turned(40.0, Some(0.1));
    assert!(rules.is_empty() && mm < 0.6, "{rules:?} {mm}");
    let (rules, small) = turned(4.0, Some(0.1));
    assert!(rules == ["hand_eye"] && small > 3.0 * mm, "{rules:?} {small}");
    // Scans whose distance is not told, or large, show less.
    let (_, not_told) = turned(40.0, None);
    let (_, apart) = turned(40.0, Some(0.4));
    assert!(not_told > apart && apart > 2.0 * mm, "{not_told} {apart}");
}

#[test]
fn a_check_piece_a_stylus_a_stated_error_or_a_calibration_in_the_run_answers_for_the_matrix() {
    let stated = PredictParams { hand_eye_mm: 0.2, hand_eye_deg: 0.05, ..PredictParams::default() };
    let phantom = Given::default().tracking.map(|tracking| Tracking { is_given: false, ..tracking });
    for (what, given, most_mm) in [
        ("a check piece", Given { read_mm: Some(0.2), ..Given::default() }, 0.4),
        ("a stylus", Given { measured_tre_mm: Some(0.2), ..Given::default() }, 0.4),
        ("its stated error", Given { errors: stated, ..Given::default() }, 0.8),
        ("a phantom", Given { tracking: phantom, ..Given::default() }, 0.0),
    ] {
        let (rules, mm) = given.told();
        assert!(rules.is_empty() && mm <= most_mm, "{what}: {rules:?} {mm}");
    }
    let is_told =
        |given: Given| given.judged().assumptions[0].starts_with("t_camera_camera_marker is as given, to 0.2 mm");
    let stated = PredictParams { hand_eye_mm: 0.2, hand_eye_deg: 0.05, ..PredictParams::default() };
    assert!(is_told(Given { errors: stated, ..Given::default() }) && !is_told(Given::default()));
    // One that reads 0.7 mm leaves as much.
    let (rules, mm) = Given { read_mm: Some(0.7), ..Given::default() }.told();
    assert!(mm > 0.6, "{rules:?} {mm}");
}
