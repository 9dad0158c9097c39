//! Estimation of normals.

mod surface;

pub use surface::of_surface;
pub(crate) use surface::without_side;

use crate::Refusal;
use crate::kabsch::centroid;
use crate::nearest::Nearest;
use nalgebra::{Matrix3, Point3, Vector3};
use osteoflow_geometry::Cloud;
use osteoflow_node_macros::params;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::Deserialize;

/// Parameters of [`estimate`].
#[params]
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
pub struct NormalParams {
    /// Neighbours of a point, itself included. 24: averages depth noise of a quarter of the point spacing to 3 degrees.
    #[param(24, 3..=1000)]
    pub neighbours: u32,
    /// Maximum distance of a neighbour. 3: a quarter of a fibula's thickness, beyond which it bends away.
    #[param(3.0, 1e-3..=1e3)]
    pub max_distance_mm: f64,
}

/// The cloud with unit normals, each of the plane fitted to a point's neighbours, turned towards the camera.
///
/// Points without two neighbours off a line have no normal and are dropped; the second value is their number.
/// `O(n log n)`.
///
/// # Errors
/// [`Refusal`] if the cloud has no viewpoint, or no point has neighbours.
pub fn estimate(cloud: &Cloud, params: &NormalParams) -> Result<(Cloud, usize), Refusal> {
    let t_cloud_camera = cloud.viewpoint.ok_or_else(|| {
        Refusal::of(
            "the cloud has no viewpoint, so which side of the surface is outside is unknown; set it where it is read",
        )
    })?;
    let camera = Point3::from(t_cloud_camera.translation.vector);
    let tree = Nearest::new(cloud.points());
    let normals: Vec<Option<Vector3<f64>>> =
        cloud.points().par_iter().map(|point| normal(cloud.points(), &tree, point, &camera, params)).collect();
    let kept: Vec<usize> = (0..normals.len()).filter(|&i| normals[i].is_some()).collect();
    if kept.is_empty() {
        return Err(Refusal::of(format!(
            "no point has two neighbours within {} mm; is the cloud in mm, or too sparse?",
            params.max_distance_mm
        )));
    }
    let n_dropped = normals.len() - kept.len();
    let normals: Vec<Vector3<f64>> = normals.into_iter().flatten().collect();
    Ok((cloud.selected(&kept).with_normals(normals).map_err(Refusal::of)?, n_dropped))
}

fn normal(
    points: &[Point3<f64>],
    tree: &Nearest,
    point: &Point3<f64>,
    camera: &Point3<f64>,
    params: &NormalParams,
) -> Option<Vector3<f64>> {
    let limit = params.max_distance_mm * params.max_distance_mm;
    let around = tree.nearest_n(point, params.neighbours as usize);
    let near: Vec<Point3<f64>> = around.iter().filter(|(_, d)| *d <= limit).map(|(i, _)| points[*i]).collect();
    let normal = plane_normal(&near)?;
    Some(if normal.dot(&(camera - point)) < 0.0 { -normal } else { normal })
}

/// Points that spread across a line by less than this share of their spread along it are a trace: the plane through them is that of its
/// curve, not that of the surface.
const TRACE: f64 = 0.2;

/// The unit normal of the plane fitted to the points; `None` for points on a line.
pub(crate) fn plane_normal(points: &[Point3<f64>]) -> Option<Vector3<f64>> {
    normal_across(points, 1e-9)
}

/// The unit normal of the plane fitted to points of a surface; `None` for those of a trace along a line.
pub(crate) fn area_normal(points: &[Point3<f64>]) -> Option<Vector3<f64>> {
    normal_across(points, TRACE * TRACE)
}

/// `None` where the variance across a line is no more than this share of that along it.
fn normal_across(points: &[Point3<f64>], share: f64) -> Option<Vector3<f64>> {
    if points.len() < 3 {
        return None;
    }
    let centre = centroid(points);
    let scatter: Matrix3<f64> = points.iter().map(|p| (p - centre) * (p - centre).transpose()).sum();
    let eigen = scatter.symmetric_eigen();
    let mut order = [0, 1, 2];
    order.sort_by(|&i, &j| eigen.eigenvalues[i].total_cmp(&eigen.eigenvalues[j]));
    let flat = eigen.eigenvalues[order[1]] > share * eigen.eigenvalues[order[2]];
    flat.then(|| eigen.eigenvectors.column(order[0]).normalize())
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Isometry3;

    #[test]
    fn a_trace_along_a_curve_has_a_plane_and_no_normal_of_a_surface() {
        // Around a shaft of 8 mm: the plane of the arc is across the shaft, its normal along it.
        let arc = |k: i32, aside_mm: f64| {
            let turn = 0.02 * f64::from(k);
            Point3::new(8.0 * turn.cos(), 8.0 * turn.sin(), aside_mm)
        };
        let trace: Vec<_> = (-20..=20).map(|k| arc(k, 0.0)).collect();
        let plane = plane_normal(&trace).unwrap();
        assert!(plane.x.abs() < 1e-9 && plane.z.abs() > 0.999, "{plane}");
        assert_eq!(area_normal(&trace), None);
        let strokes: Vec<_> = (-20..=20).flat_map(|k| [-1.5, 0.0, 1.5].map(|z| arc(k, z))).collect();
        let normal = area_normal(&strokes).unwrap();
        assert!(normal.x.abs() > 0.999, "{normal}");
        assert_eq!(plane_normal(&strokes), Some(normal));
    }

    #[test]
    fn a_ball_has_normals_along_its_radius_towards_the_camera() {
        let camera = Point3::new(0.0, 0.0, 50.0);
        let points: Vec<Point3<f64>> = (0..4000)
            .map(|i| {
                let z: f64 = 0.4 + 0.6 * f64::from(i) / 4000.0;
                let turn = f64::from(i) * 2.399_963;
                let r = (1.0 - z * z).max(0.0).sqrt();
                Point3::new(10.0 * r * turn.cos(), 10.0 * r * turn.sin(), 10.0 * z)
            })
            .collect();
        let cloud = Cloud::new("camera", points).unwrap().seen_from(Isometry3::from(camera.coords));
        let (with, n_dropped) = estimate(&cloud, &NormalParams::default()).unwrap();
        assert_eq!(n_dropped, 0);
        for (p, n) in with.points().iter().zip(with.normals().unwrap()) {
            let off = n.angle(&p.coords);
            assert!(
                off < 0.06,
                "{off} rad at {p}: a one-sided rim neighbourhood of 1 mm on a ball of 10 mm tilts by 0.05"
            );
        }
    }

    #[test]
    fn a_cloud_too_sparse_or_without_a_camera_is_refused() {
        let cloud = Cloud::new("camera", vec![Point3::origin(), Point3::new(100.0, 0.0, 0.0)]).unwrap();
        let message = |cloud: &Cloud| estimate(cloud, &NormalParams::default()).unwrap_err().to_string();
        assert!(message(&cloud).starts_with("the cloud has no viewpoint"));
        let seen = cloud.seen_from(Isometry3::identity());
        assert!(message(&seen).starts_with("no point has two neighbours within 3 mm"));
    }
}
