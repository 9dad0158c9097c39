use super::*;
use crate::coarse::{GlobalReport, RunnerUp};
use crate::sensor::{SensorKind, SensorParams};
use crate::trust::contrary::BETTER;
use crate::trust::{Inside, Misfit, Pattern, ShapeEvidence, SurfaceError};

/// The evidence of a right registration.
fn evidence() -> Evidence {
    Evidence {
        noise_mm: 0.05,
        median_mm: 0.04,
        p90_mm: Some(0.1),
        on_surface: 0.95,
        inside: 0.0,
        inside_patches: Inside { share: 0.0, depth_mm: 0.0 },
        outside: 0.02,
        misfit: Misfit { rms_mm: 0.05, inward_mm: 0.02 },
        surface_error: SurfaceError { noise_mm: 0.05, level_mm: 0.04, length_mm: 3.0 },
        facing_away: Some(0.01),
        spread_mm: Some(0.2),
        pattern: None,
        unsettled_mm: Some(0.01),
        shape: Some(shape(0.1, 0.9, 0.9, 0.6)),
        sensor: None,
    }
}

fn shape(apart_mm: f64, support: f64, judged_support: f64, clearness: f64) -> ShapeEvidence {
    let (mirrored_support, mirrored_margin_sd) = (None, None);
    ShapeEvidence { apart_mm, support, judged_support, margin_sd: 0.0, clearness, mirrored_support, mirrored_margin_sd }
}

/// The signs in evidence, as text.
fn signs(evidence: &Evidence) -> Vec<String> {
    text(&data_reasons(evidence, &RuleParams::default(), true))
}

fn text(reasons: &[Reason]) -> Vec<String> {
    reasons.iter().map(|r| format!("{} {:?}: {}", r.rule, r.answer, r.reason)).collect()
}

fn has(evidence: &Evidence, rule: &str) -> bool {
    let reasons = data_reasons(evidence, &RuleParams::default(), true);
    reasons.iter().any(|reason| reason.rule == rule)
}

#[test]
fn each_sign_in_the_data_is_told_with_its_numbers() {
    assert_eq!(signs(&evidence()), Vec::<String>::new());
    let all = Evidence {
        on_surface: 0.25,
        facing_away: Some(0.4),
        misfit: Misfit { rms_mm: 1.5, inward_mm: 0.95 },
        inside_patches: Inside { share: 0.4, depth_mm: 1.1 },
        shape: Some(shape(12.0, 0.8, 0.5, 0.1)),
        ..evidence()
    };
    let beside = Evidence {
        misfit: Misfit { rms_mm: 0.3, inward_mm: 0.02 },
        shape: Some(shape(12.0, 0.6, 0.5, 0.6)),
        ..evidence()
    };
    let told = [signs(&all), signs(&beside)].concat().join("\n");
    super::super::tests::golden("data_reasons.txt", &told);
}

#[test]
fn a_quantity_at_its_limit_is_no_sign_and_one_beyond_is() {
    let with = |rms_mm, inward_mm| Evidence { misfit: Misfit { rms_mm, inward_mm }, noise_mm: 0.4, ..evidence() };
    let limit = 0.2 + 0.15 * 0.4;
    // Beside noise of 0.4 mm, 0.57 mm are 0.696 mm.
    assert!(!has(&with(limit, 0.69), "misfit") && !has(&with(limit, 0.69), "inward_misfit"));
    assert!(has(&with(0.27, 0.69), "misfit") && has(&with(limit, 0.7), "inward_misfit"));
    // A stated sensor's error takes the place of the limits that it exceeds; nobody's refusal at zero is widened.
    let told = |rms_mm, inward_mm, patch_mm: Option<f64>, max_inward_misfit_mm| {
        let rules = RuleParams { max_inward_misfit_mm, ..RuleParams::default() };
        let sensor = SensorParams { patch_mm, ..SensorParams::default() }.sensor();
        let rules = sensor.as_ref().map_or(rules.clone(), |sensor| rules.of(sensor));
        misfit_reason(&Evidence { sensor, ..with(rms_mm, inward_mm) }, &rules).map(|reason| reason.rule)
    };
    assert_eq!(told(0.75, 0.5, Some(0.7), 0.57), None);
    assert_eq!(told(0.77, 0.5, Some(0.7), 0.57).as_deref(), Some("misfit"));
    assert_eq!(told(0.25, 0.1, Some(0.05), 0.57), None, "the segmentation's error is left");
    assert_eq!(told(0.27, 0.1, Some(0.05), 0.57).as_deref(), Some("misfit"));
    // Half of 1.2 mm inside is 0.85 mm, with the noise 0.94 mm.
    assert_eq!(told(1.2, 0.93, Some(1.2), 0.57), None);
    assert_eq!(told(1.2, 0.95, Some(1.2), 0.57).as_deref(), Some("inward_misfit"));
    for patch_mm in [None, Some(1.2)] {
        assert_eq!(told(0.01, 0.01, patch_mm, 0.0).as_deref(), Some("inward_misfit"));
    }

    // With a coarse sensor less may be off the surface.
    let off = |kind: SensorKind, on_surface| {
        let rules = RuleParams::default().of(&kind.sensor());
        data_reasons(&Evidence { on_surface, ..evidence() }, &rules, true)
            .iter()
            .any(|reason| reason.rule == "on_surface")
    };
    assert!(off(SensorKind::DepthCamera, 0.79) && !off(SensorKind::DepthCamera, 0.81) && !off(SensorKind::Laser, 0.36));
    // A fine scan is not excused by a coarse sensor; a fine sensor excuses nothing.
    let stated = |kind: SensorKind, noise_mm| {
        let all = Evidence { sensor: Some(kind.sensor()), noise_mm, ..evidence() };
        data_reasons(&all, &RuleParams::default(), true).first().map(|reason| reason.rule.clone())
    };
    assert_eq!(stated(SensorKind::DepthCamera, 0.07).as_deref(), Some("sensor"));
    assert_eq!(stated(SensorKind::DepthCamera, 0.08), None);
    assert_eq!(stated(SensorKind::Laser, 0.001), None);

    let with = |share| Evidence { inside_patches: Inside { share, depth_mm: 1.0 }, ..evidence() };
    assert!(!has(&with(0.1), "inside") && has(&with(0.11), "inside"));

    let with = |on_surface, away| Evidence { on_surface, facing_away: Some(away), ..evidence() };
    assert!(!has(&with(0.35, 0.2), "on_surface") && !has(&with(0.35, 0.2), "facing_away"));
    assert!(has(&with(0.34, 0.2), "on_surface") && has(&with(0.35, 0.21), "facing_away"));
}

#[test]
fn a_registration_by_shape_contradicts_if_it_fits_better_or_as_well_and_clearly() {
    let told = |apart_mm, support, judged, clearness, is_placed| {
        let evidence = Evidence { shape: Some(shape(apart_mm, support, judged, clearness)), ..evidence() };
        data_reasons(&evidence, &RuleParams::default(), is_placed).first().map(|reason| reason.answer)
    };
    let answer = |apart_mm, support, judged, clearness| told(apart_mm, support, judged, clearness, true);
    assert_eq!(answer(1.5, 0.9, 0.5, 0.6), None);
    assert_eq!(answer(1.6, 0.9, 0.5, 0.0), Some(Answer::Refused));
    // Better by 0.1 at most: as well, if it is clear.
    assert_eq!(answer(1.6, BETTER, 0.0, 0.3), Some(Answer::Doubtful));
    assert_eq!(answer(1.6, 0.55, 0.5, 0.29), None);
    // Worse by less than 0.1.
    assert_eq!(answer(1.6, 0.45, 0.5, 0.3), Some(Answer::Doubtful));
    assert_eq!(answer(1.6, 0.0, BETTER, 0.3), None);
    assert_eq!(answer(1.6, 0.3, 0.5, 0.3), None);
    // Without landmarks nothing tells which of two places is right, clear or not.
    assert_eq!(told(1.6, 0.55, 0.5, 0.0, false), Some(Answer::Doubtful));
    assert_eq!([told(1.6, 0.3, 0.5, 0.0, false), told(1.5, 0.55, 0.5, 0.0, false)], [None, None]);
}

#[test]
fn another_order_of_landmarks_is_a_sign_only_if_it_fits_much_better() {
    let reason = |best_other_fre_mm| {
        let best_other = vec!["P1".to_owned(), "P3".to_owned(), "P2".to_owned()];
        order_reason(&OrderEvidence { fre_mm: 2.5, best_other_fre_mm, best_other })
    };
    assert_eq!((reason(1.8), reason(2.5), reason(2.6)), (None, None, None));
    assert!(reason(1.7).is_some());
    let words = "the landmarks fit better in another order: P1, P3, P2 by 0.4 mm (RMS), as named 2.5 mm";
    assert_eq!(reason(0.4).unwrap().reason, words);
}

#[test]
fn a_start_by_shape_is_doubtful_below_its_clearness() {
    let runner_up = Some(RunnerUp { score_mm: 0.25, middle_mm: [40.0, -1.0, 7.0], shift_mm: 31.0, turn_rad: 0.5 });
    let start = GlobalReport {
        n_tried: 9,
        n_refined: 3,
        score_mm: 0.2,
        middle_mm: [9.0, -1.0, 7.0],
        t_target_source: None,
        runner_up,
        twin: None,
        clearness: 0.2,
        searched: None,
    };
    let words = "it started by shape alone, and the scan fits nearly as well 31 mm and 29 degrees away, with its middle at (40, -1, 7) mm \
                 instead of (9, -1, 7) mm (0.25 mm RMS against 0.20 mm)";
    let said = |has_surroundings| start_reason(&start, 0.3, has_surroundings, false).unwrap();
    assert_eq!(text(&[said(false)]), [format!("start Doubtful: {words}")]);
    assert!(said(false).remedy.starts_with("start from landmarks"), "{:?}", said(false));
    let cluttered = said(true);
    assert!(
        cluttered.reason.starts_with("surroundings such as skin or drape are in the scan")
            && cluttered.reason.ends_with(words),
        "{cluttered:?}"
    );
    assert!(cluttered.remedy.starts_with("crop the scan to the bone"), "{cluttered:?}");
    assert_eq!(start_reason(&start, 0.2, true, true), None);
    assert_eq!(start_reason(&start, 0.1, true, true), None);
    assert_eq!(start_reason(&GlobalReport { runner_up: None, ..start.clone() }, 0.3, true, true), None);
    // Where the surface looks the same from there, it is doubtful if something is planned on it, and else assumed.
    let symmetric = GlobalReport { twin: start.runner_up.clone(), runner_up: None, clearness: 1.0, ..start };
    assert_eq!(start_reason(&symmetric, 0.3, false, false), None);
    assert!(
        start_reason(&symmetric, 0.3, false, true).unwrap().reason.contains("nearly as well 31 mm and 29 degrees away")
    );
    assert_eq!(start_reason(&symmetric, 0.1, false, true), None);
    assert!(twin_assumption(&symmetric).unwrap().contains("the same 31 mm and 29 degrees away, by a symmetry of it"));
}

#[test]
fn the_mirror_image_is_named_if_it_fits_better_by_a_tenth() {
    let reason = |support, judged_support, mirrored_support| {
        let shape = ShapeEvidence { mirrored_support, ..shape(5.0, support, judged_support, 0.5) };
        mirror_reason(&Evidence { shape: Some(shape), ..evidence() }).map(|reason| (reason.answer, reason.reason))
    };
    let words = "the scan's mirror image fits better (80 % of it on the surface, against 50 %); likely cause: a mirrored CT, or the \
                 other leg";
    assert_eq!(reason(0.5, 0.4, Some(0.8)), Some((Answer::Refused, words.to_owned())));
    assert!(reason(0.4, 0.5, Some(0.61)).is_some() && reason(0.4, 0.5, Some(0.59)).is_none());
    assert_eq!((reason(0.0, 0.0, Some(BETTER)), reason(0.5, 0.4, None)), (None, None));
    // By a tenth, and by three standard deviations of the comparison.
    let shape =
        |sd| ShapeEvidence { mirrored_support: Some(0.8), mirrored_margin_sd: Some(sd), ..shape(5.0, 0.5, 0.4, 0.5) };
    assert!(shape(0.09).is_mirror_better() && !shape(0.11).is_mirror_better());
    // Better by one standard deviation, of a coarse sensor; of few points, no worse by a tenth.
    let told = |mirrored_support: f64, is_sparse| {
        let mirrored_support = Some(mirrored_support);
        let evidence = Evidence { shape: Some(ShapeEvidence { mirrored_support, ..shape(0.15) }), ..evidence() };
        side_reason(&evidence, is_sparse).map(|reason| (reason.answer, reason.rule))
    };
    let doubt = Some((Answer::Doubtful, "mirrored".to_owned()));
    assert_eq!([told(0.64, false), told(0.66, false)], [None, doubt.clone()]);
    assert_eq!([told(0.39, true), told(0.41, true)], [None, doubt]);
    let shape = |sd| ShapeEvidence { support: 0.7, margin_sd: sd, ..shape(0.0) };
    assert!(shape(0.09).is_better() && !shape(0.11).is_better());
}

#[test]
fn a_spread_is_a_sign_by_its_chance_and_named_by_the_larger_cause() {
    let rules = RuleParams { max_beyond_limits: 0.25, ..RuleParams::default() };
    let reason = |beyond_limits, unsettled_mm| {
        // A fault of 0.2 is another's sign.
        let predicted = Predicted {
            beyond_limits: beyond_limits + 0.2,
            beyond_by: vec![beyond_limits, 0.2],
            ..Predicted::default()
        };
        let evidence = Evidence { unsettled_mm, spread_mm: Some(0.5), ..evidence() };
        spread_reason(Some(&predicted), &evidence, &rules).map(|reason| format!("{}: {}", reason.rule, reason.reason))
    };
    assert_eq!((reason(0.25, Some(2.0)), reason(0.1, None)), (None, None));
    let spread = "spread: the residuals leave the assessment points and cuts uncertain by 0.50 mm (RMS): a chance of 40 % of an \
                  error beyond the limits";
    assert_eq!((reason(0.4, None).unwrap(), reason(0.4, Some(0.5)).unwrap()), (spread.to_owned(), spread.to_owned()));
    let unsettled = "unsettled: the registration rests 0.6 mm from where the scan fits best nearby: a chance of 40 % of an error \
                     beyond the limits";
    assert_eq!(reason(0.4, Some(0.6)).unwrap(), unsettled);
    let open = spread_reason(None, &evidence(), &rules).unwrap();
    assert_eq!((open.rule.as_str(), open.answer), ("spread", Answer::Doubtful));
    assert_eq!(open.reason, "the scan leaves a motion of the bone undetermined");
    let pattern = Pattern {
        slide_mm: 1.2,
        spin_deg: 0.1,
        across_mm: 0.0,
        tilt_deg: 0.0,
        rms_mm: Some(1.2),
        shares: [0.9, 0.1, 0.0, 0.0],
    };
    let slides = |rms_mm| Evidence { pattern: Some(Pattern { rms_mm, ..pattern }), ..evidence() };
    let open = spread_reason(None, &slides(None), &rules).unwrap().reason;
    assert!(open.ends_with("undetermined: nothing holds the scan where it slides along its long axis"), "{open}");
    let predicted = Predicted { beyond_limits: 0.4, beyond_by: vec![0.4], ..Predicted::default() };
    let wide = spread_reason(Some(&predicted), &slides(Some(1.2)), &rules).unwrap().reason;
    assert!(wide.ends_with("limits; least certain: the scan slides along its long axis by 1.2 mm"), "{wide}");
}
