//! Accuracy metrics of a registration. Each report states its formula, its n and its unit.

mod check_points;
mod cut_difference;
mod cuts;
mod distance_colour;
mod fre;
mod laser_spot;
mod paired;
mod pose_error;
mod quantile;
mod surface;
mod tre;

pub use check_points::{CheckReport, check_points};
pub use cut_difference::{
    CutDifferenceParams, CutDifferenceReport, CutVariant, DistanceSummary, EndReport, FragmentDifference,
    PlannedFragment, cut_difference, error_at_points, signed_distances,
};
pub use cuts::{CutReport, CutsReport, SegmentReport, achieved, cuts};
pub use distance_colour::{distance_colour, distance_outside, distance_scale};
pub use fre::{FrePoint, FreReport, fre};
pub use laser_spot::{LaserSpotReport, laser_spot};
pub use pose_error::{PoseErrorReport, pose_error, rms_apart_mm};
pub use surface::{SurfaceReport, surface_residual};
pub use tre::{TrePoint, TreReport, TreSummary, tre};

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shapes::{cuboid, shaft};
    use crate::{sample, target::Target};
    use nalgebra::{Isometry3, Matrix3, Point3, Vector3};
    use osteoflow_geometry::{Axes, NamedPoint, Plane, Planes, SurfaceOrigin};
    use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};

    #[test]
    fn points_at_two_poses_are_apart_by_their_rms_distance() {
        let points = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]].map(Point3::from);
        let turned = Isometry3::rotation(Vector3::z() * std::f64::consts::PI);
        assert!((rms_apart_mm(&points, &Isometry3::identity(), &turned) - 2.0_f64.sqrt()).abs() < 1e-12);
        assert_eq!(rms_apart_mm(&[], &Isometry3::identity(), &turned), 0.0);
    }

    fn named(points: &[[f64; 3]]) -> Vec<NamedPoint> {
        points.iter().enumerate().map(|(k, p)| NamedPoint::new(format!("M{}", k + 1), Point3::from(*p))).collect()
    }

    fn axes() -> Axes {
        Axes { frame: "ct".into(), centre: Point3::origin(), columns: Matrix3::identity() }
    }

    #[test]
    fn the_error_has_signs_along_the_axes() {
        let target = named(&[[0.0, 0.0, 0.0], [10.0, 0.0, 50.0]]);
        let source = named(&[[0.3, -0.4, 1.0], [9.7, 0.0, 48.0]]);
        let report = tre(&target, &source, &Isometry3::identity(), &axes()).unwrap();
        assert_eq!((report.points[0].z, report.points[1].z), (1.0, -2.0));
        assert!((report.points[0].transverse - 0.5).abs() < 1e-12 && report.points[1].axial == 2.0);
        assert!((report.mean_signed.z + 0.5).abs() < 1e-12 && (report.mean_abs.z - 1.5).abs() < 1e-12);
        assert!((report.rms.z - 2.5_f64.sqrt()).abs() < 1e-12 && report.max.z == 2.0);
        assert!((report.p95.z - 1.95).abs() < 1e-12 && report.n == 2);
        // Flipping the axes flips the sign.
        let turned = Axes { columns: Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0)), ..axes() };
        assert_eq!(tre(&target, &source, &Isometry3::identity(), &turned).unwrap().points[0].z, -1.0);
        let message = |target: &[NamedPoint], source: &[NamedPoint]| {
            tre(target, source, &Isometry3::identity(), &axes()).unwrap_err().to_string()
        };
        assert!(message(&target, &source[..1]).contains("is not among the measured points"));
        assert!(message(&[], &source).starts_with("there is no point"));
    }

    #[test]
    fn located_spots_are_compared_with_spots_and_marks_and_missing_ones_are_ignored() {
        let (spots, marks) = (named(&[[0.0; 3], [5.0; 3]]), named(&[[0.0, 0.0, -0.7], [5.0; 3]]));
        let moved = Isometry3::translation(0.0, 0.0, 9.0);
        let located = vec![NamedPoint::new("M1", Point3::new(0.1, 0.0, -8.8))];
        let report = laser_spot(&located, &spots, &marks, &moved, &axes()).unwrap();
        let (spot, mark) = (&report.to_spot.points[0], &report.to_mark.points[0]);
        assert!((spot.x - 0.1).abs() < 1e-12 && (spot.z - 0.2).abs() < 1e-12 && (mark.z - 0.9).abs() < 1e-12);
        assert_eq!((report.to_spot.n, report.to_mark.n), (1, 1));
        let stray = vec![NamedPoint::new("P9", Point3::origin())];
        let message = laser_spot(&stray, &spots, &marks, &moved, &axes()).unwrap_err().to_string();
        assert_eq!(message, "P9 is not among the true points (M1, M2); name both sets alike");
    }

    #[test]
    fn check_points_report_place_and_spread_of_the_errors() {
        let point = |k: usize, x: f64, z: f64| NamedPoint::new(format!("working_{k}"), Point3::new(x, 0.0, z));
        let known = vec![point(1, 0.0, 200.0), point(2, 10.0, 220.0)];
        let t_camera_world = Isometry3::translation(0.0, 5.0, 0.0);
        let mut read = vec![point(1, 0.0, 200.3), point(2, 10.5, 220.0)];
        read.iter_mut().for_each(|p| p.position.y += 5.0);
        let pose = Isometry3::translation(0.0, 0.0, 0.3);
        let report = check_points(&read, &known, &t_camera_world, Some(&pose)).unwrap();
        assert_eq!((report.place.as_str(), report.error.n), ("working", 2));
        assert!((report.mean_mm - 0.4).abs() < 1e-9 && (report.sd_mm - 0.2 / 2f64.sqrt()).abs() < 1e-9, "{report:?}");
        assert!((report.min_mm - 0.3).abs() < 1e-9 && (report.max_mm - 0.5).abs() < 1e-9);
        assert!((report.error.points[0].z - 0.3).abs() < 1e-9 && (report.error.points[1].x - 0.5).abs() < 1e-9);
        assert!((report.pose.unwrap().at_point_mm - 0.3).abs() < 1e-12 && (report.depth_mm - 210.15).abs() < 1e-9);
    }

    #[test]
    fn a_shift_of_planned_points_shows_in_the_tre_and_not_in_the_fre() {
        let target = named(&[[0.0, 0.0, 0.0], [9.0, 0.0, 20.0], [0.0, 7.0, 30.0]]);
        let moved = Isometry3::translation(0.0, 0.0, 5.0);
        let source: Vec<_> =
            target.iter().map(|p| NamedPoint::new(p.name.clone(), moved.inverse() * p.position)).collect();
        let report = fre(&target, &source, &moved).unwrap();
        assert!(report.rms_mm < 1e-12 && report.n == 3 && report.points.len() == 3);
        assert!((tre(&target, &source, &Isometry3::identity(), &axes()).unwrap().mean_signed.z + 5.0).abs() < 1e-12);
    }

    #[test]
    fn cuts_report_offset_tilt_roll_and_length() {
        let bone = cuboid([0.0; 3], [10.0, 12.0, 100.0]);
        let plane = |name: &str, z: f64| Plane::new(name, Isometry3::translation(4.0, 5.0, z));
        let planned = Planes::new("ct", vec![plane("lower", 20.0), plane("upper", 60.0)]);
        let motion = Isometry3::new(Vector3::new(3.0, 0.0, 2.0), Vector3::z() * 0.1);
        let report = cuts(&planned, &planned.transformed("ct", &motion), &axes(), Some(&bone)).unwrap();
        for cut in &report.cuts {
            assert!(
                (cut.offset_mm - 2.0).abs() < 1e-9 && cut.tilt_rad.abs() < 1e-7 && (cut.roll_rad - 0.1).abs() < 1e-9
            );
            assert!(
                (cut.at[0] - 5.0).abs() < 1e-9 && (cut.at[1] - 6.0).abs() < 1e-9,
                "the middle of the bone: {:?}",
                cut.at
            );
        }
        let segment = &report.segments[0];
        assert!((segment.planned_mm - 40.0).abs() < 1e-9 && segment.difference_mm.abs() < 1e-9);
        // A tilt about x through the plane's own origin moves the cut in the bone's middle, 1 mm away along y.
        let tilted = Planes::new(
            "ct",
            vec![
                Plane::new("lower", planned.planes[0].isometry().unwrap() * Isometry3::rotation(Vector3::x() * 0.05)),
                plane("upper", 60.0),
            ],
        );
        let report = cuts(&planned, &tilted, &axes(), Some(&bone)).unwrap();
        assert!((report.cuts[0].tilt_rad - 0.05).abs() < 1e-9);
        assert!((report.cuts[0].offset_mm - 0.05_f64.tan()).abs() < 1e-9, "{}", report.cuts[0].offset_mm);
        assert!((report.segments[0].difference_mm + 0.05_f64.tan()).abs() < 1e-9);
        let lost = planned.unknown("ct", 0, "marker lost");
        assert!(cuts(&planned, &lost, &axes(), None).unwrap_err().to_string().contains("marker lost"));
        let elsewhere = cuts(&planned, &planned.unknown("world", 0, ""), &axes(), None).unwrap_err().to_string();
        assert!(elsewhere.contains("world") && elsewhere.contains("ct"), "{elsewhere}");
    }

    #[test]
    fn the_surface_residual_does_not_depend_on_the_spacing_of_the_samples() {
        let samples = sample::surface(&shaft(), 20_000, &mut ChaCha8Rng::seed_from_u64(1));
        let source: Vec<_> = sample::surface(&shaft(), 3000, &mut ChaCha8Rng::seed_from_u64(2)).points;
        let target = Target::new("ct", SurfaceOrigin::Exact, samples.points, Some(samples.normals.into())).unwrap();
        let report = surface_residual(&target, &source, &Isometry3::identity(), 2.0).unwrap();
        assert!(report.rms_all_mm < 0.03 && report.inlier_share == 1.0 && report.n == 3000, "{report:?}");
        let mut spoilt = source;
        spoilt.extend((0..1000).map(|k| Point3::new(30.0, 0.0, f64::from(k) / 10.0)));
        let report = surface_residual(&target, &spoilt, &Isometry3::identity(), 2.0).unwrap();
        assert!((report.inlier_share - 0.75).abs() < 1e-12 && report.rms_all_mm > 5.0 && report.rms_kept_mm < 0.03);
        assert!(surface_residual(&target, &[], &Isometry3::identity(), 2.0).is_err());
    }
}
