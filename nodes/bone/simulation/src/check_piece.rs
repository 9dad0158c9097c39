//! The printed check piece of a calibration: twelve holes on two steps, and a marker.

use crate::camera::DepthBias;
use crate::draws::{Term, normal3, stream};
use crate::params::CheckParams;
use crate::tracker::{Marker, Path, Tracker};
use nalgebra::{Isometry3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use osteoflow_geometry::{NamedPoint, Points, StampNs};

/// Columns and rows of holes and the height of every second one, mm: as large as the phantom, so that rotations show.
const X_MM: [f64; 4] = [-30.0, -10.0, 10.0, 30.0];
const Y_MM: [f64; 3] = [-20.0, 0.0, 20.0];
const STEP_MM: f64 = 12.0;

/// The holes by CAD, in the piece's frame, whose z points to the camera.
fn holes() -> Vec<Point3<f64>> {
    let place = |k: usize| {
        let (column, row) = (k % X_MM.len(), k / X_MM.len());
        Point3::new(X_MM[column], Y_MM[row], if (column + row).is_multiple_of(2) { 0.0 } else { STEP_MM })
    };
    (0..X_MM.len() * Y_MM.len()).map(place).collect()
}

/// `t_check_check_marker` by design: on an arm beside the plate.
fn t_check_marker() -> Isometry3<f64> {
    Isometry3::new(Vector3::new(62.0, 10.0, -8.0), Vector3::new(0.2, 0.4, -0.7))
}

/// Time and place of a scan of the piece.
pub(crate) struct PieceScan {
    /// `calibration` or `working`, the prefix of the holes' names.
    pub(crate) name: &'static str,
    pub(crate) s: f64,
    pub(crate) t_world_camera: Isometry3<f64>,
    /// From the camera to the plate.
    pub(crate) distance_mm: f64,
}

/// The holes of each scan as read from the cloud (frame `camera`) and as given by localiser and CAD (frame `world`).
pub(crate) fn read_holes(
    scans: &[PieceScan],
    tracker: &Tracker<'_>,
    bias: &DepthBias,
    params: &CheckParams,
    view_spread_rad: f64,
) -> Vec<(Points, Points)> {
    let seed = tracker.seed;
    let mut print = stream(params.print_seed.unwrap_or(seed), Term::CheckPrint, 0);
    let printed: Vec<Point3<f64>> = holes().iter().map(|hole| hole + normal3(&mut print) * params.print_mm).collect();
    let burst_s = tracker.params.burst_s;
    let read_scan = |(place, scan): (usize, &PieceScan)| {
        let mut rng = stream(seed, Term::CheckPlace, place as u64);
        let facing =
            UnitQuaternion::from_rotation_matrix(&Rotation3::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI));
        let held = UnitQuaternion::from_scaled_axis(normal3(&mut rng) * view_spread_rad);
        let aside = normal3(&mut rng) * 4.0;
        let t_camera_check = Translation3::from(Vector3::new(0.0, 0.0, scan.distance_mm) + aside) * held * facing;
        let stamp_ns: StampNs = tracker.stamp(scan.s);
        let named = |k: usize, at: Point3<f64>| NamedPoint {
            stamp_ns,
            ..NamedPoint::new(format!("{}_{}", scan.name, k + 1), at)
        };
        let mut reading = stream(seed, Term::CheckReading, place as u64);
        let read = printed.iter().enumerate().map(|(k, hole)| {
            let truth = t_camera_check * hole;
            let bent = truth + truth.coords.normalize() * bias.at(&truth);
            named(k, bent + normal3(&mut reading) * params.reading_mm)
        });
        // The mean of the marker's samples at this place.
        let path = Path::resting(scan.t_world_camera * t_camera_check);
        let samples = tracker.samples(
            Marker::Check,
            Some(place as u64),
            &path,
            |_| t_check_marker(),
            &[(scan.s - burst_s, scan.s + burst_s)],
        );
        let n = samples.len() as f64;
        let known = holes().into_iter().enumerate().map(|(k, hole)| {
            let in_marker = t_check_marker().inverse() * hole;
            let sum: Vector3<f64> = samples.iter().map(|pose| (pose.isometry * in_marker).coords).sum();
            named(k, Point3::from(sum / n))
        });
        let pair = (Points::new("camera", read.collect::<Vec<_>>()), Points::new("world", known.collect::<Vec<_>>()));
        (!samples.is_empty()).then_some(pair)
    };
    scans.iter().enumerate().filter_map(read_scan).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::params::{CameraParams, TrackerParams};

    #[test]
    fn a_read_hole_errs_by_print_and_reading() {
        let mut squares = Vec::new();
        for seed in 0..60 {
            let params = TrackerParams {
                placement_mm: 0.0,
                placement_deg: 0.0,
                noise_mm: 0.0,
                noise_deg: 0.0,
                drift_mm_per_min: 0.0,
                ..TrackerParams::default()
            };
            let tracker = Tracker { params: &params, seed, start_ns: 1 };
            let camera = CameraParams { depth_bias_mm: 0.0, ..CameraParams::default() };
            let t_world_camera = Isometry3::new(Vector3::new(300.0, -80.0, 900.0), Vector3::new(0.4, 2.0, -0.3));
            let scan = PieceScan { name: "working", s: 1.0, t_world_camera, distance_mm: 200.0 };
            let pairs = read_holes(&[scan], &tracker, &DepthBias::new(&camera, seed), &CheckParams::default(), 0.05);
            let (read, known) = &pairs[0];
            assert_eq!((read.points.len(), &*read.points[11].name), (12, "working_12"));
            squares.extend(
                read.points
                    .iter()
                    .zip(known.points.iter())
                    .map(|(a, b)| (t_world_camera * a.position - b.position).norm_squared() / 3.0),
            );
        }
        let spread = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
        // Four standard errors over 2,160 draws are 6 %.
        assert!((spread - 0.1f64.hypot(0.05)).abs() < 0.007, "{spread} mm per axis");
    }
}
