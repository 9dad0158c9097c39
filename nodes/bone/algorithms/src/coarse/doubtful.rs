//! Points of low confidence, confirmed by their distances to the others.

use super::CoarseSide;
use crate::Refusal;
use osteoflow_geometry::NamedPoint;

/// Parameters of [`confirm`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DoubtParams {
    /// Points of at least this confidence, and points without one, need no confirmation.
    pub min_confidence: f64,
    /// Maximum difference of a distance between the target and the source points, mm.
    pub max_side_difference_mm: f64,
}

/// Checks that each source point of low confidence has the distances to all others that the target points have.
///
/// A place along the bone is confirmed within `max_side_difference_mm`; across it less strictly, as the distances between
/// landmarks along a bone change little with it.
///
/// # Errors
/// [`Refusal`] with the first point that is not confirmed.
pub fn confirm(source: &[NamedPoint], sides: &[CoarseSide], params: &DoubtParams) -> Result<(), Refusal> {
    for point in source {
        let Some(confidence) = point.confidence.filter(|c| *c < params.min_confidence) else { continue };
        let disagrees = |side: &&CoarseSide| {
            (*side.from == *point.name || *side.to == *point.name)
                && side.difference_mm.abs() > params.max_side_difference_mm
        };
        let off: Vec<String> = sides
            .iter()
            .filter(disagrees)
            .map(|s| {
                let (from, to, target_mm, source_mm) = (&s.from, &s.to, s.target_mm, s.source_mm);
                format!("{from}-{to} is {source_mm:.1} mm in the scan and {target_mm:.1} mm in the plan")
            })
            .collect();
        if !off.is_empty() {
            return Err(Refusal::of(format!(
                "{} was located with a confidence of {confidence:.2} only ({} counts by itself), and the plan does not confirm \
                 it: {}, {} mm more or less is allowed; is the laser on, and its spot away from the silhouette and from other \
                 gaps?",
                point.name,
                params.min_confidence,
                off.join(", "),
                params.max_side_difference_mm
            )));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::three_point;
    use super::*;
    use nalgebra::{Isometry3, Point3, Vector3};

    const PARAMS: DoubtParams = DoubtParams { min_confidence: 0.4, max_side_difference_mm: 3.0 };

    fn planned() -> Vec<NamedPoint> {
        let points = [[0.0, 0.0, 100.0], [9.0, -6.0, 130.0], [-1.0, 1.0, 125.0]];
        points.iter().enumerate().map(|(k, p)| NamedPoint::new(format!("P{}", k + 1), Point3::from(*p))).collect()
    }

    /// Checks the planned points, the second one moved along the bone and located with this confidence.
    fn check(moved_mm: f64, confidence: Option<f64>) -> Result<(), Refusal> {
        let mut source = planned();
        let motion = Isometry3::new(Vector3::new(3.0, 4.0, 5.0), Vector3::new(0.1, 2.0, -0.4));
        source[1].position.z += moved_mm;
        source[1].confidence = confidence;
        source.iter_mut().for_each(|p| p.position = motion * p.position);
        let report = three_point(&planned(), &source).unwrap().report;
        confirm(&source, &report.sides, &PARAMS)
    }

    #[test]
    fn a_point_of_low_confidence_passes_only_where_its_distances_are_as_planned() {
        assert_eq!(check(2.0, Some(0.25)), Ok(()));
        let error = check(8.0, Some(0.25)).unwrap_err();
        assert!(error.to_string().starts_with("P2 was located with a confidence of 0.25 only"), "{error}");
        assert!(error.to_string().contains("P1-P2 is 39.5 mm in the scan and 31.9 mm in the plan"), "{error}");
    }

    #[test]
    fn points_of_sufficient_or_unknown_confidence_need_no_confirmation() {
        assert_eq!(check(8.0, Some(0.4)), Ok(()));
        assert_eq!(check(8.0, None), Ok(()));
    }
}
