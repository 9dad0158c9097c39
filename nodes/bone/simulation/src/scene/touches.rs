//! The touches of the stylus: marks, assessment holes, and the stripped surface.

use super::{CALIBRATION_S, PALPATION_RATE_HZ, SCAN_S, Scene, TOUCH_EVERY_S, places::towards_camera};
use crate::SimulationError;
use crate::camera::Pixel;
use crate::draws::{Term, normal3, stream};
use crate::stylus::Stylus;
use crate::tracker::Tracker;
use nalgebra::{Point3, Vector3};
use osteoflow_geometry::{NamedPoint, Points, Pose};
use rand::RngExt;

/// The recorded touches of a procedure.
pub(super) struct Touches {
    pub(super) init: Points,
    pub(super) assessment: Points,
    pub(super) palpation: Points,
    pub(super) pivoting: Vec<Pose>,
    pub(super) marker: Vec<Pose>,
}

impl Default for Touches {
    fn default() -> Self {
        let none = || Points::new("world", Vec::new());
        Self { init: none(), assessment: none(), palpation: none(), pivoting: Vec::new(), marker: Vec::new() }
    }
}

impl Scene<'_> {
    /// Touches the marks, then the holes, then the surface.
    pub(super) fn touches(
        &self,
        tracker: &Tracker<'_>,
        spots: &Points,
        seen: &[Pixel],
    ) -> Result<Touches, SimulationError> {
        let params = &self.params.stylus;
        let tip = normal3(&mut stream(self.seed, Term::StylusCalibration, 0)) * params.tip_mm;
        let bias = normal3(&mut stream(self.seed, Term::PalpationBias, 0)) * params.palpation_bias_mm;
        // Pivoted beside the phantom, while the camera is carried to the bone.
        let dimple = self.phantom_path.at(CALIBRATION_S) * Point3::new(120.0, 0.0, 0.0);
        let mut tracked = match params.pivot_poses {
            0 => None,
            _ => Some(Stylus::calibrated(tracker, params, &dimple, (CALIBRATION_S + 2.0, SCAN_S - 2.0))?),
        };
        let towards_hand = towards_camera(self.anatomy, self.params);
        let mut touch = |name: &str, point_ct: &Point3<f64>, s: f64, error: Vector3<f64>| {
            let at = self.bone_path.at(s) * point_ct;
            let measured = match &mut tracked {
                None => at + tracker.drift(s) + tip + error,
                Some(stylus) => stylus.touch(&(at + error), &(self.bone_path.at(s) * towards_hand), s),
            };
            NamedPoint { stamp_ns: tracker.stamp(s), ..NamedPoint::new(name, measured) }
        };
        let mut rng = stream(self.seed, Term::StylusTouch, 0);
        let n_landmarks = self.plan.landmarks.points.len();
        let holes_s = self.touches_s + (n_landmarks + 1) as f64 * TOUCH_EVERY_S;
        let marks = [(&spots.points[..n_landmarks], self.touches_s), (&self.assessment.points[..], holes_s)];
        let [init, assessment] = marks.map(|(marks, first_s)| {
            let touched = marks.iter().enumerate().map(|(k, mark)| {
                let error = normal3(&mut rng) * params.touch_mm;
                touch(&mark.name, &mark.position, first_s + k as f64 * TOUCH_EVERY_S, error)
            });
            Points::new("world", touched.collect::<Vec<_>>())
        });

        let first_s = holes_s + (assessment.points.len() + 1) as f64 * TOUCH_EVERY_S;
        let t_ct_camera = self.t_ct_camera(SCAN_S);
        let mut place = stream(self.seed, Term::PalpationPlace, 0);
        let mut rng = stream(self.seed, Term::PalpationTouch, 0);
        let palpation = (0..params.n_palpated).map(|k| {
            let pixel = &seen[place.random_range(0..seen.len())];
            let error = bias + normal3(&mut rng) * params.palpation_mm;
            let s = first_s + k as f64 / PALPATION_RATE_HZ;
            touch(&(k + 1).to_string(), &(t_ct_camera * pixel.point()), s, error)
        });
        let palpation = Points::new("world", palpation.collect::<Vec<_>>());
        let (pivoting, marker) = tracked.map_or_else(Default::default, |stylus| (stylus.pivoting, stylus.touching));
        Ok(Touches { init, assessment, palpation, pivoting, marker })
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{RUNS, over_seeds, rms, small_and_exact};
    use super::*;
    use crate::{ProcedureParams, StylusParams};

    #[test]
    fn touches_share_the_error_of_the_tip_and_have_their_own_of_the_hand() {
        let stylus = StylusParams { tip_mm: 0.1, touch_mm: 0.2, n_palpated: 0, ..small_and_exact().stylus };
        let params = ProcedureParams { stylus, ..small_and_exact() };
        let off = over_seeds(&params, |scene, seen| {
            let tracker = Tracker { params: &params.tracker, seed: scene.seed, start_ns: 1 };
            let touched = scene.touches(&tracker, &scene.plan.landmarks, seen).unwrap();
            let truth = scene.plan.assessment.transformed("world", &scene.bone_path.at(scene.touches_s));
            let off = touched.assessment.points.iter().zip(truth.points.iter()).map(|(a, b)| a.position - b.position);
            off.collect::<Vec<_>>()
        });
        let fresh = off.iter().flat_map(|run| run.windows(2).map(|w| (w[1] - w[0]).norm_squared() / 6.0));
        let fresh = (fresh.sum::<f64>() / (RUNS * 4) as f64).sqrt();
        let all = rms(off.iter().flatten().flat_map(|d| [d.x, d.y, d.z]));
        assert!((fresh - 0.2).abs() < 0.01, "fresh {fresh} mm per axis");
        assert!((all - 0.1f64.hypot(0.2)).abs() < 0.012, "together {all} mm per axis");
    }

    #[test]
    fn palpated_points_have_a_common_and_an_independent_error() {
        let stylus = StylusParams { palpation_bias_mm: 0.3, palpation_mm: 0.25, ..small_and_exact().stylus };
        let params = ProcedureParams { stylus, ..small_and_exact() };
        let (common, fresh): (Vec<f64>, Vec<f64>) = over_seeds(&params, |scene, seen| {
            let tracker = Tracker { params: &params.tracker, seed: scene.seed, start_ns: 1 };
            let t_ct_world = scene.bone_path.at(scene.touches_s).inverse();
            let touched = scene.touches(&tracker, &scene.plan.landmarks, seen).unwrap().palpation;
            assert_eq!(touched.points.len(), 300);
            // The same draws give the pixels again; the nearest pixel need not be the one.
            let mut place = stream(scene.seed, Term::PalpationPlace, 0);
            let off: Vec<Vector3<f64>> = touched
                .points
                .iter()
                .map(|p| {
                    let truly = scene.t_ct_camera(SCAN_S) * seen[place.random_range(0..seen.len())].point();
                    t_ct_world * p.position - truly
                })
                .collect();
            let mean = off.iter().sum::<Vector3<f64>>() / 300.0;
            (rms(mean.iter().copied()), rms(off.iter().flat_map(|d| (d - mean).iter().copied().collect::<Vec<_>>())))
        })
        .into_iter()
        .unzip();
        // Four standard errors over 1,200 means are 8 %.
        assert!((rms(common) - 0.3).abs() < 0.025);
        assert!((rms(fresh) - 0.25).abs() < 0.003);
    }
}
