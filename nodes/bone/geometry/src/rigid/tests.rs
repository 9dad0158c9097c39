use super::*;
use proptest::prelude::*;

fn motion() -> Isometry3<f64> {
    Isometry3::new(Vector3::new(1.0, -2.0, 3.0), Vector3::new(0.3, -0.2, 0.9))
}

fn quaternion(scale: f64) -> Quaternion<f64> {
    motion().rotation.into_inner() * scale
}

/// A matrix with the upper left 3 x 3 of `motion` multiplied by `change` from the left.
fn changed(change: [f64; 9]) -> Matrix4<f64> {
    let mut matrix = motion().to_homogeneous();
    let rotation = Matrix3::from_row_slice(&change) * motion().rotation.to_rotation_matrix();
    matrix.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
    matrix
}

fn scaled(by: f64) -> Matrix4<f64> {
    changed([by, 0.0, 0.0, 0.0, by, 0.0, 0.0, 0.0, by])
}

#[test]
fn a_motion_survives_being_written_as_a_matrix() {
    let back = isometry_from_matrix(&motion().to_homogeneous()).unwrap();
    assert!((back.to_homogeneous() - motion().to_homogeneous()).amax() < 1e-14);
}

#[test]
fn a_matrix_that_is_no_rigid_motion_is_refused_by_name() {
    let with = |row: usize, column: usize, value: f64| {
        let mut matrix = motion().to_homogeneous();
        matrix[(row, column)] = value;
        matrix
    };
    for (matrix, expected) in [
        (with(0, 0, f64::NAN), "the matrix is not finite"),
        (with(2, 3, f64::INFINITY), "the matrix is not finite"),
        (motion().to_homogeneous().transpose(), "is the matrix written column by column?"),
        (scaled(0.0), "the matrix is zero"),
        (changed([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0]), "the matrix is a mirror image (determinant -1.000)"),
        (changed([0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]), "are two axes swapped"),
        (scaled(25.4), "off by 2.4e1 where 1e-3 is allowed, and its columns have lengths 25.4000, 25.4000, 25.4000"),
        (scaled(1e200), "is there a scale in it?"),
        (scaled(1e-200), "is there a scale in it?"),
        (scaled(1.0011), "off by 1.1e-3 where 1e-3 is allowed"),
        // A shear keeps the determinant.
        (changed([1.0, 0.01, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]), "off by 5.0e-3"),
        // A projection onto a plane.
        (changed([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0]), "off by 1.0e0"),
    ] {
        let message = nearest_isometry(&matrix).unwrap_err().to_string();
        assert!(message.contains(expected), "{expected}\n{message}");
    }
    let message = isometry_from_matrix(&scaled(1.0005)).unwrap_err().to_string();
    assert!(message.contains("off by 5.0e-4 where 1e-6 is allowed"), "{message}");
}

#[test]
fn a_quaternion_that_is_no_rotation_is_refused_by_name() {
    let nan = Quaternion::new(f64::NAN, 0.0, 0.0, 0.0);
    for (quaternion, expected) in [
        (nan, "the quaternion is not finite"),
        (quaternion(f64::INFINITY), "the quaternion is not finite"),
        (quaternion(0.0), "the quaternion is zero"),
        (quaternion(2.0), "has length 2 instead of 1, off by 1.0e0 where 1e-3 is allowed"),
        (quaternion(1.0011), "off by 1.1e-3"),
        (quaternion(0.9989), "off by 1.1e-3"),
        (quaternion(1e200), "instead of 1"),
    ] {
        let message = nearest_rotation(quaternion).unwrap_err().to_string();
        assert!(message.contains(expected), "{expected}\n{message}");
        assert!(exact_isometry(Vector3::zeros(), quaternion).is_err());
    }
    let message = exact_isometry(Vector3::zeros(), quaternion(1.0005)).unwrap_err().to_string();
    assert!(
        message.contains("off by 5.0e-4 where 1e-6 is allowed; it would move a point at 1 m by up to 2.0 mm"),
        "{message}"
    );
    let wild = Vector3::new(0.0, f64::NEG_INFINITY, 0.0);
    assert_eq!(exact_isometry(wild, quaternion(1.0)), Err(RigidError::NotFinite { what: "translation" }));
}

#[test]
fn the_limits_move_a_point_at_1_m_by_what_their_table_says() {
    // Half a turn about z takes x to its opposite: the displacement that a scale acts on is largest.
    let point = Vector3::x() * 1000.0;
    for (limit, of_matrix_mm, of_quaternion_mm) in [(EXACT_ROTATION, 0.001, 0.004), (ROUNDED_ROTATION, 1.0, 4.0)] {
        let turn = UnitQuaternion::from_scaled_axis(Vector3::z() * std::f64::consts::PI);
        let too_long = UnitQuaternion::new_unchecked(turn.into_inner() * (1.0 + limit));
        let off_mm = (too_long * point - turn * point).norm();
        assert!((off_mm / of_quaternion_mm - 1.0).abs() < 1e-3, "{off_mm} mm");
        assert!((Correction::of_quaternion(1.0 + limit).mm_at_1_m - of_quaternion_mm).abs() < 1e-9);
        let off_mm = ((1.0 + limit) * (turn * point) - turn * point).norm();
        assert!((off_mm / of_matrix_mm - 1.0).abs() < 1e-6, "{off_mm} mm");
        assert!((Correction::of_matrix(limit).mm_at_1_m - of_matrix_mm).abs() < 1e-9);
    }
}

#[test]
fn corrections_are_reported_once_with_the_largest() {
    let mut corrections = Corrections::default();
    for scale in [1.0, 1.0 + 1e-12, 1.0002, 0.9999] {
        let rotation = corrections.take(nearest_rotation(quaternion(scale)).unwrap());
        assert!(rotation.angle_to(&motion().rotation) < 1e-14);
    }
    assert!((corrections.largest().deviation - 2e-4).abs() < 1e-15);
    let note = "2 of 4 rotations are rounded, and the nearest rotation is used; the largest correction is 2.0e-4, 0.80 mm at 1 m";
    assert_eq!(corrections.note().as_deref(), Some(note));
    let mut sound = Corrections::default();
    sound.add(Correction::of_quaternion(1.0 - 1e-10));
    assert_eq!(sound.note(), None);
}

#[test]
fn a_direction_has_any_length_but_none_that_cannot_be_computed_with() {
    assert_eq!(direction(Vector3::new(0.0, -3.0, 0.0)), Ok(-Vector3::y_axis()));
    for bad in [0.0, 1e-9, 1e200, f64::INFINITY, f64::NAN] {
        assert!(direction(Vector3::x() * bad).is_err(), "{bad}");
    }
}

fn rounded(value: f64, decimals: i32) -> f64 {
    let unit = 10_f64.powi(decimals);
    (value * unit).round() / unit
}

prop_compose! {
    fn any_rotation()(q in prop::array::uniform4(-1.0..1.0_f64).prop_filter("short", |q| q.iter().map(|c| c * c).sum::<f64>() > 0.01))
        -> UnitQuaternion<f64> {
        UnitQuaternion::from_quaternion(Quaternion::from(q))
    }
}

proptest! {
    #[test]
    fn a_sound_rotation_passes_bit_for_bit_with_a_few_ulps_of_error(rotation in any_rotation(), ulps in -8_i32..8) {
        let written = rotation.into_inner() * (1.0 + f64::from(ulps) * f64::EPSILON);
        let back = exact_isometry(Vector3::zeros(), written).unwrap();
        prop_assert_eq!(back.rotation.into_inner(), written);
        prop_assert!(nearest_rotation(written).unwrap().correction.deviation < ROTATION_NOISE);
    }

    #[test]
    fn quaternions_of_three_decimals_are_always_within_the_limit(rotation in any_rotation()) {
        let written = Quaternion::from(rotation.coords.map(|c| rounded(c, 3)));
        let read = nearest_rotation(written).unwrap();
        prop_assert!((read.value.norm() - 1.0).abs() < 1e-15);
        // Half a unit in each of four components, twice as an angle.
        prop_assert!(read.value.angle_to(&rotation) <= 2.1e-3, "{} rad", read.value.angle_to(&rotation));
    }

    #[test]
    fn matrices_in_single_precision_or_of_four_decimals_give_the_nearest_rotation(rotation in any_rotation()) {
        let exact = rotation.to_homogeneous();
        for written in [exact.map(|c| f64::from(c as f32)), exact.map(|c| rounded(c, 4))] {
            let read = nearest_isometry(&written).unwrap();
            let off = (read.value.to_homogeneous() - written).fixed_view::<3, 3>(0, 0).into_owned().svd(false, false).singular_values[0];
            // The correction is the distance to the rotation that was taken, and no sound rotation is nearer.
            prop_assert!((off - read.correction.deviation).abs() < 1e-12, "{} and {}", off, read.correction.deviation);
            let from_exact = (exact - written).fixed_view::<3, 3>(0, 0).into_owned().svd(false, false).singular_values[0];
            prop_assert!(off <= from_exact + 1e-12, "{} and {}", off, from_exact);
        }
    }

    #[test]
    fn any_sixteen_numbers_are_a_rigid_motion_or_refused(numbers in prop::array::uniform16(any::<f64>())) {
        let mut matrix = Matrix4::from_row_slice(&numbers);
        matrix.set_row(3, &nalgebra::RowVector4::new(0.0, 0.0, 0.0, 1.0));
        if let Ok(read) = nearest_isometry(&matrix) {
            prop_assert!((read.value.rotation.norm() - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn a_scale_or_shear_beyond_the_limit_is_refused(rotation in any_rotation(), at in 0_usize..9, by in 0.0021..1.9_f64, up in any::<bool>()) {
        let mut change = Matrix3::identity();
        change[at] += if up { by } else { -by };
        let matrix = (change * rotation.to_rotation_matrix().matrix()).to_homogeneous();
        prop_assert!(nearest_isometry(&matrix).is_err());
    }
}
