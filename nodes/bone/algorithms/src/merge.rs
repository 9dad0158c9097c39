//! Merging several views of one bone into one cloud.

use crate::Refusal;
use nalgebra::{Point3, Vector3};
use osteoflow_geometry::Cloud;

/// All points of `clouds` in order, stamped with the latest of their times.
///
/// Normals and extra columns are kept if every cloud has them, the viewpoint if all clouds share it.
///
/// # Errors
/// [`Refusal`] if there is no cloud or the frames differ.
pub fn merge(clouds: &[Cloud]) -> Result<Cloud, Refusal> {
    let first = clouds.first().ok_or_else(|| Refusal::of("there is no cloud to merge; wire at least one"))?;
    if let Some((index, other)) = clouds.iter().enumerate().find(|(_, c)| c.frame != first.frame) {
        let (found, expected) = (&other.frame, &first.frame);
        return Err(Refusal::of(format!(
            "cloud {index} is in {found}, but the first is in {expected}; bring all into the bone's frame first"
        )));
    }
    let points: Vec<Point3<f64>> = clouds.iter().flat_map(|c| c.points()).copied().collect();
    let mut merged = Cloud::new(&first.frame, points).map_err(Refusal::of)?;
    if let Some(normals) = clouds.iter().map(Cloud::normals).collect::<Option<Vec<_>>>() {
        merged = merged.with_normals(normals.concat::<Vector3<f64>>()).map_err(Refusal::of)?;
    }
    for (name, _) in first.extras() {
        let column = |c: &Cloud| c.extras().iter().find(|(n, _)| n == name).map(|(_, values)| values.to_vec());
        if let Some(values) = clouds.iter().map(column).collect::<Option<Vec<_>>>() {
            merged = merged.with_extra(name.clone(), values.concat()).map_err(Refusal::of)?;
        }
    }
    merged.stamp_ns = clouds.iter().map(|c| c.stamp_ns).max().unwrap_or(0);
    merged.label = first.label.clone().filter(|_| clouds.iter().all(|c| c.label == first.label));
    merged.viewpoint = first.viewpoint.filter(|_| clouds.iter().all(|c| c.viewpoint == first.viewpoint));
    Ok(merged)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Isometry3;

    fn cloud(frame: &str, x: f64) -> Cloud {
        Cloud::new(frame, vec![Point3::new(x, 0.0, 0.0)]).unwrap().with_extra("intensity", vec![x]).unwrap()
    }

    #[test]
    fn points_and_shared_columns_are_kept_and_a_viewpoint_only_if_all_share_it() {
        let a = cloud("bone_marker", 1.0).at(5).seen_from(Isometry3::identity());
        let b = cloud("bone_marker", 2.0).at(3).seen_from(Isometry3::translation(1.0, 0.0, 0.0));
        let merged = merge(&[a.clone(), b]).unwrap();
        assert_eq!((merged.len(), merged.stamp_ns, merged.viewpoint), (2, 5, None));
        assert_eq!(&*merged.extras()[0].1, &[1.0, 2.0]);
        assert!(merge(&[a.clone(), a]).unwrap().viewpoint.is_some());
    }

    #[test]
    fn clouds_in_different_frames_are_refused_by_name() {
        let error = merge(&[cloud("bone_marker", 1.0), cloud("camera", 2.0)]).unwrap_err().to_string();
        assert!(error.contains("bone_marker") && error.contains("camera"), "{error}");
        assert!(merge(&[]).unwrap_err().to_string().starts_with("there is no cloud to merge"));
    }
}
