//! A matrix of camera and marker that was given: what tests it, and what is said where nothing does.

use super::*;
use crate::metrics::check_points;
use crate::still_average::TakeMotion;

/// Poses of the camera, turned about the bone by these angles, degrees.
fn camera_at(turn_deg: [f64; 3]) -> Isometry3<f64> {
    let middle = Vector3::new(0.0, 0.0, 60.0);
    let about = Isometry3::new(Vector3::zeros(), Vector3::from(turn_deg).map(f64::to_radians));
    let at = Isometry3::translation(200.0, 0.0, 0.0) * Isometry3::rotation(Vector3::y() * -std::f64::consts::FRAC_PI_2);
    Isometry3::from(middle) * about * at
}

/// A scan or a landmark that the camera's marker carried.
fn take(what: &str, turn_deg: [f64; 3]) -> TakeMotion {
    TakeMotion::new(what).seen_from(&camera_at(turn_deg))
}

struct Setup {
    turns_deg: Vec<[f64; 3]>,
    apart_mm: Option<f64>,
    reads_mm: &'static [f64],
    measured_tre_mm: Option<f64>,
    is_calibrated: bool,
    /// Whether the verdict has the motion of the markers, and the matrix.
    has_takes: bool,
    is_wired: bool,
    errors: PredictParams,
}

impl Default for Setup {
    fn default() -> Self {
        Self {
            turns_deg: vec![[0.0; 3]; 3],
            apart_mm: Some(0.15),
            reads_mm: &[],
            measured_tre_mm: None,
            is_calibrated: false,
            has_takes: true,
            is_wired: true,
            errors: PredictParams::default(),
        }
    }
}

impl Setup {
    fn judged(&self) -> Verdict {
        let (target, scan) = (target_of(&shaft()), scan_of(&shaft(), [15.0, 105.0], 2));
        let (marks, pose) = (marks(), Isometry3::identity());
        let at_scan = take("the scan", [0.0; 3]);
        let located: Vec<TakeMotion> = self.turns_deg.iter().map(|turn| take("P1", *turn)).collect();
        let takes = Takes { scan: Some(&at_scan), located: &located, apart_mm: self.apart_mm, ..Takes::default() };
        let takes = if self.has_takes { takes } else { Takes::default() };
        let reading = |mm: &f64| {
            let known = [NamedPoint::new("working_1", Point3::origin())];
            let read = [NamedPoint::new("working_1", Point3::new(*mm, 0.0, 0.0))];
            check_points(&read, &known, &pose, None).unwrap()
        };
        let check: Vec<_> = self.reads_mm.iter().map(reading).collect();
        let tracking =
            Tracking { camera_marker: Point3::new(200.0, 0.0, 60.0), phantom_marker: None, phantom_fit: None };
        let case = Case {
            landmarks: &marks,
            located: &marks,
            assessment: &marks,
            measured_tre_mm: self.measured_tre_mm,
            tracking: self.is_wired.then_some(&tracking),
            is_calibrated: self.is_calibrated,
            check: &check,
            takes,
            ..bare(&target, &scan, &pose)
        };
        judge(&case, &EvidenceParams::default(), &RuleParams::default(), &self.errors)
    }

    /// The rules that doubt it, and the term of the matrix in the predicted error, mm.
    fn rules_and_term(&self) -> (Vec<String>, f64) {
        let verdict = self.judged();
        let terms = &verdict.predicted.as_ref().unwrap().terms;
        let term =
            terms.iter().find(|term| term.name.starts_with("camera on its marker")).map_or(0.0, |term| term.tre_mm);
        (verdict.reasons.iter().map(|reason| reason.rule.clone()).collect(), term)
    }
}

#[test]
fn a_given_matrix_that_nothing_tests_is_doubted_and_widens_the_interval() {
    let (rules, mm) = Setup::default().rules_and_term();
    assert!(rules == ["hand_eye"] && mm > 30.0, "{rules:?} {mm}");
    let verdict = Setup::default().judged();
    assert_eq!(verdict.answer, Answer::Doubtful);
    let interval = verdict.predicted.unwrap().assessment.unwrap().interval_mm;
    assert!(interval[1] > 30.0, "{interval:?}");
    // A verdict to which the matrix is not wired, or no motion of the markers, believes it no more.
    for setup in [Setup { is_wired: false, ..Setup::default() }, Setup { has_takes: false, ..Setup::default() }] {
        let (rules, mm) = setup.rules_and_term();
        assert!(rules == ["hand_eye"] && mm > 30.0, "{rules:?} {mm}");
    }
    let of_two_files = Setup { is_wired: false, has_takes: false, ..Setup::default() };
    assert_eq!(of_two_files.rules_and_term(), (vec![], 0.0), "no marker, no matrix");
    // All landmarks at the scan's pose of the camera, however exact, test nothing; nor does one turn, about its own axis.
    let (_, one_axis) = Setup { turns_deg: vec![[0.0, 0.0, 30.0]; 3], ..Setup::default() }.rules_and_term();
    assert!(one_axis > 5.0, "{one_axis}");
}

#[test]
fn turns_of_the_camera_about_two_axes_test_a_given_matrix_by_how_far_the_scans_lie_apart() {
    let turned = |deg: f64, apart_mm| {
        let turns_deg = vec![[0.0, 0.0, deg], [0.0, deg, 0.0], [0.0, -deg, deg]];
        Setup { turns_deg, apart_mm, ..Setup::default() }.rules_and_term()
    };
    let (rules, mm) = turned(40.0, Some(0.1));
    assert!(rules.is_empty() && mm < 0.6, "{rules:?} {mm}");
    let (rules, small) = turned(4.0, Some(0.1));
    assert!(rules == ["hand_eye"] && small > 3.0 * mm, "{rules:?} {small}");
    // Scans whose distance is not known, or large, show less.
    let (_, unknown) = turned(40.0, None);
    let (_, apart) = turned(40.0, Some(0.4));
    assert!(unknown > apart && apart > 2.0 * mm, "{unknown} {apart}");
}

#[test]
fn a_check_piece_a_stylus_a_stated_error_or_a_calibration_in_the_run_answers_for_the_matrix() {
    let stated = || PredictParams { hand_eye_mm: 0.2, hand_eye_deg: 0.05, ..PredictParams::default() };
    for (what, setup, most_mm) in [
        ("a check piece", Setup { reads_mm: &[0.2], ..Setup::default() }, 0.4),
        ("a stylus", Setup { measured_tre_mm: Some(0.2), ..Setup::default() }, 0.4),
        ("its stated error", Setup { errors: stated(), ..Setup::default() }, 0.8),
        ("a phantom", Setup { is_calibrated: true, ..Setup::default() }, 0.0),
    ] {
        let (rules, mm) = setup.rules_and_term();
        assert!(rules.is_empty() && mm <= most_mm, "{what}: {rules:?} {mm}");
    }
    let is_assumed =
        |setup: Setup| setup.judged().assumptions[0].starts_with("t_camera_camera_marker is as given, to 0.2 mm");
    assert!(is_assumed(Setup { errors: stated(), ..Setup::default() }) && !is_assumed(Setup::default()));
    // One that reads 0.7 mm leaves as much, whatever another one and the stylus read.
    let setup = Setup { reads_mm: &[0.2, 0.7], measured_tre_mm: Some(0.1), ..Setup::default() };
    let (rules, mm) = setup.rules_and_term();
    assert!(mm > 0.6, "{rules:?} {mm}");
}
