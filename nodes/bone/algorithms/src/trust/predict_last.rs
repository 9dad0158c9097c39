//! The error of the planes as last followed, after the bone has turned.

use super::{Cut, Interval, PredictParams, Predicted, Takes};
use crate::still_average::BonePose;
use nalgebra::{Isometry3, Point3};
use osteoflow_geometry::{Plane, Planes};
use serde::{Deserialize, Serialize};

/// The predicted error of the planes as last followed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PredictedLast {
    /// Angle by which the bone's marker has turned since the scan, degrees.
    pub turned_deg: f64,
    /// At each cut, in the middle of the bone.
    pub cuts: Vec<PredictedLastCut>,
}

/// The predicted error of a cut as last followed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PredictedLastCut {
    /// Its name.
    pub name: String,
    /// RMS error, mm.
    pub tre_mm: f64,
    /// The interval that holds the error with 90 %, mm.
    pub interval_mm: Interval,
}

/// The error of the cuts at the last pose of the bone's marker; `None` where that or the one at the scan is not known.
///
/// At the scan the marker's error cancels, as planes are carried back by the pose that brought the scan. Later it does not: the
/// error at the scan is turned with the bone, and remains as far as it was turned, `2 sin(turn / 2)` of it; and the last pose has its own
/// noise. Both act over the lever arm from the marker to the cut.
pub(super) fn predict_last(
    predicted: &Predicted,
    cuts: &[Cut],
    takes: &Takes<'_>,
    planned: Option<&Planes>,
    t_target_source: &Isometry3<f64>,
    errors: &PredictParams,
) -> Option<PredictedLast> {
    let at_scan = takes.scan?.bone.as_ref().map(BonePose::isometry)?;
    let at_last = bone_at_last(takes, planned, t_target_source)?;
    let turned_rad = at_last.rotation.angle_to(&at_scan.rotation);
    let remains = 1.0 + (2.0 * (turned_rad / 2.0).sin()).powi(2);
    let marker = t_target_source * Point3::origin();
    let cut = |(cut, at): (&Cut, &super::PredictedPoint)| {
        let arm_mm = (cut.middle.position - marker).norm();
        let turn_mm = arm_mm * errors.marker_deg.to_radians();
        // A turn moves a point along the two axes across its arm.
        let more = remains * (3.0 * errors.marker_mm.powi(2) + 2.0 * turn_mm.powi(2));
        let tre_mm = (at.tre_mm.powi(2) + more).sqrt();
        let grown = tre_mm / at.tre_mm.max(f64::MIN_POSITIVE);
        PredictedLastCut { name: at.name.clone(), tre_mm, interval_mm: at.interval_mm.map(|mm| mm * grown) }
    };
    let cuts: Vec<PredictedLastCut> = cuts.iter().zip(&predicted.cuts).map(cut).collect();
    Some(PredictedLast { turned_deg: turned_rad.to_degrees(), cuts })
}

/// The pose of the bone's marker at the last planes that followed it.
pub(super) fn bone_at_last(
    takes: &Takes<'_>,
    planned: Option<&Planes>,
    t_target_source: &Isometry3<f64>,
) -> Option<Isometry3<f64>> {
    let first = |planes: &Planes| planes.planes.iter().find_map(Plane::isometry).copied();
    let t_world_target = first(takes.last?)? * first(planned?)?.inverse();
    Some(t_world_target * t_target_source)
}

impl PredictedLast {
    /// What the predicted error leaves out where the bone has been turned since.
    pub(super) fn note(&self) -> Option<String> {
        let worst = self.cuts.iter().max_by(|a, b| a.tre_mm.total_cmp(&b.tre_mm)).filter(|_| self.turned_deg > 1.0)?;
        let [from_mm, to_mm] = worst.interval_mm;
        Some(format!(
            "the predicted error is that of the scan's instant; the bone has turned by {:.0} degrees since, and with the errors of its \
             marker the last planes have {from_mm:.1} to {to_mm:.1} mm (90 %, {})",
            self.turned_deg, worst.name
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::still_average::TakeMotion;
    use crate::trust::PredictedPoint;
    use nalgebra::Vector3;
    use osteoflow_geometry::NamedPoint;

    /// The error of a cut 200 mm from the marker, which was 0.3 mm at the scan, after the bone was turned.
    fn last(turn_deg: f64) -> PredictedLast {
        let scan = Isometry3::new(Vector3::new(10.0, 20.0, 30.0), Vector3::new(0.1, 0.2, 0.3));
        let at_scan = TakeMotion::new("scan").on_bone(Some(&scan));
        let registration = Isometry3::new(Vector3::new(0.0, 0.0, -200.0), Vector3::new(0.5, 0.0, 0.0));
        let planned = Planes::new("ct", vec![Plane::new("a", Isometry3::identity())]);
        let turned = scan * Isometry3::rotation(Vector3::y() * turn_deg.to_radians());
        let world = turned * registration.inverse();
        let followed = Planes::new("world", vec![Plane::new("a", world)]);
        let takes = Takes { scan: Some(&at_scan), last: Some(&followed), ..Takes::default() };
        let cut = Cut { middle: NamedPoint::new("a", Point3::origin()), normal: Vector3::z() };
        let point = PredictedPoint {
            name: "a".into(),
            tre_mm: 0.3,
            interval_mm: [0.1, 0.5],
            semi_axes_mm: [0.0; 3],
            directions: [[0.0; 3]; 3],
        };
        let predicted = Predicted { cuts: vec![point], ..Predicted::default() };
        predict_last(&predicted, &[cut], &takes, Some(&planned), &registration, &PredictParams::default()).unwrap()
    }

    #[test]
    fn the_error_of_the_last_planes_grows_with_the_turn_since_the_scan() {
        // 0.06 mm along three axes and 0.08 mm of the attitude along two are 0.154 mm.
        let still = last(0.0);
        assert!(still.turned_deg < 1e-5 && still.note().is_none(), "{still:?}");
        assert!((still.cuts[0].tre_mm - 0.3_f64.hypot(0.1540)).abs() < 1e-3, "{still:?}");
        // Turned by a third of a circle, three times the variance is added to that of the last pose.
        let turned = last(120.0);
        assert!((turned.turned_deg - 120.0).abs() < 1e-9);
        assert!((turned.cuts[0].tre_mm - 0.3_f64.hypot(2.0 * 0.1540)).abs() < 1e-3, "{turned:?}");
        assert!(turned.cuts[0].interval_mm[1] > 0.5 && turned.note().unwrap().contains("turned by 120 degrees since"));
        let errors: Vec<f64> = [0.0, 5.0, 30.0, 90.0].map(|deg| last(deg).cuts[0].tre_mm).into();
        assert!(errors.is_sorted(), "{errors:?}");
    }
}
