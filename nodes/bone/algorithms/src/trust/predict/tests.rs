use super::*;
use nalgebra::UnitQuaternion;

fn named(name: &str, position: [f64; 3]) -> NamedPoint {
    NamedPoint::new(name, Point3::from(position))
}

fn diagonal(sd: [f64; 6]) -> Matrix6<f64> {
    Matrix6::from_diagonal(&Vector6::from(sd).map(|sd| sd * sd))
}

fn cut(name: &str, position: [f64; 3]) -> Cut {
    Cut { middle: named(name, position), normal: Vector3::z() }
}

fn spread(sd: [f64; 6]) -> Spread {
    Spread {
        covariance: diagonal(sd),
        centre: Point3::new(10.0, 20.0, 60.0),
        bias: diagonal([2.0, 0.1, 3.0, 0.01, 0.001, 0.04]),
        n_cells: 20,
    }
}

fn tracking() -> Tracking {
    Tracking {
        camera_marker: Point3::new(-150.0, 40.0, 300.0),
        phantom_marker: Some(Point3::new(80.0, -30.0, 90.0)),
        phantom_fit: Some((diagonal([0.02, 0.03, 0.01, 1e-4, 2e-4, 3e-4]), Point3::new(70.0, 0.0, 50.0))),
    }
}

/// All errors of a seeded case.
fn predicted() -> Predicted {
    predicted_with(&PredictParams::default())
}

fn predicted_with(errors: &PredictParams) -> Predicted {
    let points = [named("P1", [12.0, 20.0, 30.0]), named("P2", [10.0, 27.0, 95.0])];
    let cuts = [cut("a", [9.0, 20.0, 40.0]), cut("b", [10.0, 21.0, 110.0]), cut("c", [10.0, 20.0, 60.0])];
    let limited = points.each_ref().map(|p| p.position);
    let at = Where { points: &points, cuts: &cuts, limited: &limited };
    let to_settled = Isometry3::new(Vector3::new(0.1, -0.2, 0.3), Vector3::new(0.002, 0.001, -0.003));
    let spread = spread([0.1, 0.2, 0.3, 0.002, 0.001, 0.004]);
    let limits = Limits { max_tre_mm: 0.8, max_offset_mm: 0.9, max_tilt_deg: 0.4 };
    predict(&spread, &to_settled, None, Some(&tracking()), &[], &at, &limits, errors)
}

#[test]
fn devices_twice_as_bad_leave_what_twice_the_stated_errors_predict() {
    let stated = PredictParams::default();
    let twice = PredictParams {
        marker_mm: 2.0 * stated.marker_mm,
        marker_deg: 2.0 * stated.marker_deg,
        print_mm: 2.0 * stated.print_mm,
        print_deg: 2.0 * stated.print_deg,
        ..stated.clone()
    };
    let told = predicted().devices_twice_mm.unwrap();
    let expected = predicted_with(&twice).assessment.unwrap().interval_mm;
    assert!(
        told.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9),
        "{told:?} instead of {expected:?}, rounding alone"
    );
    assert!(told[1] > predicted().assessment.unwrap().interval_mm[1] + 0.1, "{told:?}");
    let text = predicted().devices_assumption(&stated).unwrap();
    let words = format!("would leave {:.1} to {:.1} mm at the assessment points", expected[0], expected[1]);
    assert!(text.starts_with("markers are tracked to 0.06 mm") && text.contains(&words), "{text}");
    let untracked = Predicted { devices_twice_mm: None, ..predicted() };
    assert_eq!(untracked.devices_assumption(&stated), None);
}

#[test]
fn each_source_of_error_is_carried_to_the_points() {
    // RMS over the points of s² + t² |arm|² for a shift of variance s² and a turn of t² about each axis, by hand.
    let terms = predicted().terms;
    let positions =
        [[12.0, 20.0, 30.0], [10.0, 27.0, 95.0], [9.0, 20.0, 40.0], [10.0, 21.0, 110.0], [10.0, 20.0, 60.0]];
    let rms = |square: &dyn Fn(Vector3<f64>) -> f64| {
        (positions.iter().map(|p| square(Vector3::from(*p))).sum::<f64>() / 5.0).sqrt()
    };
    let isotropic = |about: [f64; 3], mm: f64, deg: f64| {
        let about = Vector3::from(about);
        rms(&|p| 3.0 * mm * mm + 2.0 * (deg.to_radians() * (p - about).norm()).powi(2))
    };
    let about = |sd: [f64; 6], about: [f64; 3]| {
        rms(&|p| {
            let arm = p - Vector3::from(about);
            let turned: f64 = (0..3).map(|k| (Vector3::ith(k, sd[3 + k]).cross(&arm)).norm_squared()).sum();
            sd[..3].iter().map(|sd| sd * sd).sum::<f64>() + turned
        })
    };
    let centre = [10.0, 20.0, 60.0];
    let axis = UnitQuaternion::new(Vector3::new(0.002, 0.001, -0.003));
    let settled = rms(&|p| {
        // The turn to first order.
        let arm = p - Vector3::from(centre);
        let shift = axis * Vector3::from(centre) - Vector3::from(centre) + Vector3::new(0.1, -0.2, 0.3);
        (shift + Vector3::new(0.002, 0.001, -0.003).cross(&arm)).norm_squared()
    });
    let (camera, phantom) = ([-150.0, 40.0, 300.0], [80.0, -30.0, 90.0]);
    // The bias of 0.1 mm exceeds the spread in x and z, and where it turns about y not at all: its excess is of variances
    // 0.2² - 0.1², 0.3² - 0.3² = 0 and, of the turns, 0.004² - 0.004² = 0.
    let expected = [
        ("registration", about([0.1, 0.2, 0.3, 0.002, 0.001, 0.004], centre)),
        ("camera marker at the scan", isotropic(camera, 0.06, 0.023)),
        ("camera marker at the calibration", isotropic(camera, 0.06, 0.023)),
        ("phantom marker", isotropic(phantom, 0.06, 0.023)),
        ("phantom", isotropic(phantom, 0.05, 0.03)),
        ("phantom's fit", about([0.02, 0.03, 0.01, 1e-4, 2e-4, 3e-4], [70.0, 0.0, 50.0])),
        ("not settled", settled),
        ("stated bias of the CT", 0.03_f64.sqrt()),
    ];
    assert_eq!(terms.len(), expected.len());
    for (term, (name, tre_mm)) in terms.iter().zip(expected) {
        assert_eq!(term.name, name);
        assert!((term.tre_mm - tre_mm).abs() < 1e-9, "{name}: {} instead of {tre_mm} mm, rounding alone", term.tre_mm);
    }
}

#[test]
fn a_prediction_has_the_same_numbers_as_ever() {
    let predicted = predicted();
    let points = predicted.points.iter().chain(&predicted.cuts);
    let mut text: Vec<String> = points
        .map(|p| {
            // The sign of an axis is arbitrary.
            let directions = p.directions.map(|axis| axis.map(f64::abs));
            format!("{} {:.8} {:.8?} {:.8?} {directions:.6?}", p.name, p.tre_mm, p.interval_mm, p.semi_axes_mm)
        })
        .collect();
    for set in [predicted.assessment.as_ref().unwrap(), predicted.all_cuts.as_ref().unwrap()] {
        let (mean, ct) = (set.mean_tre_mm, set.interval_with_ct_bias_mm);
        text.push(format!("{mean:.8} {:.8?} {ct:.8?}", set.interval_mm));
    }
    text.push(format!("{:.5}", predicted.beyond_limits));
    super::super::tests::golden("prediction.txt", &text.join("\n"));
    let sentence = "predicted mean error 0.3 to 1.2 mm at the assessment points, 0.3 to 1.2 mm at the cuts (90 %)";
    assert_eq!(predicted.sentence(), sentence);
    assert_eq!(Predicted { all_cuts: None, assessment: None, ..predicted }.sentence(), "no sign against it was found");
}

#[test]
fn the_mean_error_of_a_gaussian_shift_is_that_of_maxwell() {
    // 4000 draws know a mean to 0.7 %, and a spread to 1.1 %: three standard deviations.
    let place = [named("P", [10.0, 20.0, 60.0])];
    let at = Where { points: &place, cuts: &[], limited: &[] };
    let spread = Spread { bias: Matrix6::zeros(), ..spread([0.5, 0.5, 0.5, 0.0, 0.0, 0.0]) };
    let predicted =
        predict(&spread, &Isometry3::identity(), None, None, &[], &at, &Limits::default(), &PredictParams::default());
    let set = predicted.assessment.unwrap();
    let mean = 0.5 * (8.0 / std::f64::consts::PI).sqrt();
    assert!((set.mean_tre_mm / mean - 1.0).abs() < 0.02, "{} instead of {mean} mm", set.mean_tre_mm);
    let point = &predicted.points[0];
    assert!((point.tre_mm - 0.75_f64.sqrt()).abs() < 1e-12, "rounding alone: {point:?}");
    assert_eq!((set.interval_mm, point.interval_mm), (set.interval_with_ct_bias_mm, set.interval_mm));
    assert_eq!(predicted.all_cuts, None);
    // The share of a Maxwell distribution within 2.5003 standard deviations is 90 %.
    assert!(point.semi_axes_mm.iter().all(|mm| (mm - 0.5 * ELLIPSOID_SIGMAS).abs() < 1e-12), "{point:?}");
}

#[test]
fn the_ellipsoid_has_its_longest_axis_first() {
    let (axes, directions) = ellipsoid(&Matrix3::from_diagonal(&Vector3::new(1.0, 9.0, 4.0)));
    assert_eq!(axes, [3.0, 2.0, 1.0].map(|sd| ELLIPSOID_SIGMAS * sd));
    assert_eq!(directions.map(|axis| axis.map(f64::abs)), [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]);
}

#[test]
fn a_draw_is_beyond_the_limits_if_it_exceeds_one_of_them() {
    let centre = Point3::new(1.0, 2.0, 3.0);
    let cuts = [cut("a", [1.0, 2.0, 3.0]), cut("b", [3.0, 2.0, 3.0])];
    let limited = [centre, Point3::new(3.0, 2.0, 3.0)];
    let at = Where { points: &[], cuts: &cuts, limited: &limited };
    let limits = Limits { max_tre_mm: 2.0, max_offset_mm: 1.0, max_tilt_deg: 60.0 };
    let outputs = Outputs::new(&at, &centre, None);
    let share = |draws: &[[f64; 6]]| {
        let poses = DMatrix::from_fn(6, draws.len(), |row, column| draws[column][row]);
        let weights = vec![1.0 / draws.len() as f64; draws.len()];
        let draws =
            Draws { columns: &outputs.of_pose * poses, weights, of: vec![0; draws.len()], scale_sigma: SCALE_SIGMA };
        draws.beyond_limits(&outputs, &limits)[0]
    };
    let shifted = |x: f64, z: f64| [x, 0.0, z, 0.0, 0.0, 0.0];
    assert_eq!(share(&[shifted(2.0, 0.0), shifted(0.0, -1.0), shifted(0.0, 1.0)]), 0.0);
    assert_eq!(share(&[shifted(2.5, 0.0), shifted(0.0, -1.25), shifted(2.0, 0.0), shifted(0.0, 0.5)]), 0.5);
    // A turn of 0.5 rad about y moves the second cut by 1 mm along its normal, and one of 1.1 rad about x tilts both by 63
    // degrees.
    let turned = |x: f64, y: f64, z: f64| [0.0, 0.0, 0.0, x, y, z];
    assert_eq!(share(&[turned(0.0, 0.5, 0.0), turned(1.0, 0.0, 0.0)]), 0.0);
    assert_eq!(share(&[turned(0.0, -0.6, 0.0), turned(0.0, 0.5, 0.0)]), 0.5);
    assert_eq!(share(&[turned(1.1, 0.0, 0.0), turned(0.0, 0.0, 2.0)]), 0.5);
    // The mean error over both points is half the second's: 2 mm for a turn of 2 rad about z, at the limit, and 2.2 mm for 2.2.
    assert_eq!(share(&[turned(0.0, 0.0, 2.0), turned(0.0, 0.0, 2.2)]), 0.5);
}

/// 1 mm along x for each 50 mm above the centre.
fn lever(p: &Point3<f64>) -> DMatrix<f64> {
    DMatrix::from_column_slice(3, 1, &[(p.z - 60.0) / 50.0, 0.0, 0.0])
}

/// The prediction at the centre and 50 mm above it of a deformation that may be each of these: weight, mean and standard deviation.
fn deformed(of: &[[f64; 3]]) -> Predicted {
    let numbers: Vec<_> = of
        .iter()
        .map(|[_, mean, sd]| (DVector::from_element(1, *mean), DMatrix::from_element(1, 1, sd * sd)))
        .collect();
    let components = of.iter().zip(&numbers);
    let components =
        components.map(|([weight, ..], (mean, covariance))| Component { weight: *weight, mean, covariance }).collect();
    let deformation = Deformation { components, at: Box::new(lever) };
    let place = [named("middle", [10.0, 20.0, 60.0]), named("end", [10.0, 20.0, 110.0])];
    let cuts = [Cut { middle: named("across", [10.0, 20.0, 60.0]), normal: Vector3::x() }];
    let limited = [place[0].position];
    let at = Where { points: &place, cuts: &cuts, limited: &limited };
    let spread = Spread { bias: Matrix6::zeros(), ..spread([0.01, 0.01, 0.01, 0.0, 0.0, 0.0]) };
    let limits = Limits { max_tre_mm: 9.0, max_offset_mm: 9.0, max_tilt_deg: 0.5 };
    let deformation = (!of.is_empty()).then_some(&deformation);
    predict(&spread, &Isometry3::identity(), deformation, None, &[], &at, &limits, &PredictParams::default())
}

#[test]
fn a_deformation_widens_the_error_where_it_acts_and_nowhere_else() {
    let (rigid, wide) = (deformed(&[]), deformed(&[[1.0, 0.0, 0.4]]));
    // A posterior has the spread of the registration in itself, which is not counted twice.
    assert!((rigid.points[0].tre_mm - (3.0 * 0.01_f64.powi(2)).sqrt()).abs() < 1e-9 && wide.points[0].tre_mm < 1e-9);
    assert!((wide.points[1].tre_mm - 0.4).abs() < 1e-9, "{}", wide.points[1].tre_mm);
    assert!(wide.points[1].interval_mm[1] > 0.6 && rigid.points[1].interval_mm[1] < 0.1);
    // A slope of 0.4 / 50 is 0.46 degrees: 0.5 degrees are exceeded by 28 % of a Gaussian.
    assert_eq!(rigid.beyond_limits, 0.0);
    assert!((wide.beyond_limits - 0.276).abs() < 0.03, "{}", wide.beyond_limits);
}

#[test]
fn what_is_known_of_a_deformation_is_no_error_about_zero() {
    // A slope of 0.6 / 50 is 0.69 degrees, whose sign matters to no limit and whose spread is small.
    for mean in [-0.6, 0.6] {
        let known = deformed(&[[1.0, mean, 0.05]]);
        assert!(known.beyond_limits > 0.99, "{}", known.beyond_limits);
        let [from_mm, to_mm] = known.points[1].interval_mm;
        // 0.6 mm with a fifth as the error of all errors.
        assert!((0.35..0.48).contains(&from_mm) && (0.72..0.9).contains(&to_mm), "{from_mm} to {to_mm}");
    }
}

#[test]
fn the_chance_is_the_sum_over_what_may_be_at_fault_and_the_interval_holds_all_of_it() {
    let (sound, fault) = ([0.9, 0.0, 0.01], [0.1, 2.0, 0.01]);
    let both = deformed(&[sound, fault]);
    assert_eq!(both.beyond_by.len(), 2);
    assert!(both.beyond_by[0] == 0.0 && (both.beyond_by[1] - 0.1).abs() < 1e-9, "{:?}", both.beyond_by);
    assert!((both.beyond_limits - 0.1).abs() < 1e-9, "{}", both.beyond_limits);
    // The upper end lies among the draws of the fault, of which half are above it.
    let upper_mm = both.points[1].interval_mm[1];
    assert!((1.5..2.5).contains(&upper_mm), "{upper_mm}");
    assert!(deformed(&[[1.0, 0.0, 0.01]]).points[1].interval_mm[1] < 0.1);
}
