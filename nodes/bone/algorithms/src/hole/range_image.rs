use super::image::{Grid, seen};
use super::scene::{Scene, no_viewpoint};
use super::spot::{Missing, find};
use super::{Hole, HoleParams};
use crate::Refusal;
use nalgebra::{Isometry3, Point3};
use osteoflow_geometry::Cloud;

/// The hole in the image grid of the camera that took the scan with the laser.
///
/// Both scans are projected into that image, `x / z` and `y / z`, in cells that follow the spacing of the scan's
/// points. A camera samples its image evenly, however slanted the surface, so one cell size suits all of it. A
/// reference point is missing if its cell and most of the surrounding cells that the reference fills are empty. The
/// search continues as in [`cloud_difference`](super::cloud_difference()).
///
/// # Errors
/// [`Refusal`]: no hole, more than one, too sparse to resolve it, scans that do not coincide, or a laser scan
/// without a viewpoint.
pub fn range_image(reference: &Cloud, cloud: &Cloud, params: &HoleParams) -> Result<Hole, Refusal> {
    let t_camera_cloud = cloud.viewpoint.ok_or_else(no_viewpoint)?.inverse();
    let scene = Scene::new(reference, cloud, params)?;
    let missing = missing(&scene, &t_camera_cloud).ok_or_else(no_viewpoint)?;
    find(&scene, &missing, params)
}

/// `None` if the scan is not in front of the camera.
fn missing(scene: &Scene, t_camera_cloud: &Isometry3<f64>) -> Option<Missing> {
    let image = |p: &Point3<f64>| seen(&(t_camera_cloud * p));
    let of_cloud: Vec<Point3<f64>> = scene.cloud.points.iter().filter_map(image).collect();
    let of_reference: Vec<Option<Point3<f64>>> = scene.reference.points.iter().map(image).collect();
    let laser = Grid::over(&of_cloud)?;
    let full = laser.with(of_reference.iter().flatten());
    let is_missing = |i: &usize| {
        let Some(place) = of_reference[*i].and_then(|p| laser.place(&p)) else { return false };
        !laser.is_filled(place) && mostly_empty(&laser, &full, place)
    };
    let indices: Vec<usize> = (0..scene.reference.len()).filter(is_missing).collect();
    let margin_mm = indices.iter().map(|&i| scene.spacing_mm(i)).sum::<f64>() / indices.len().max(1) as f64 / 2.0;
    Some(Missing { indices, margin_mm, alone_is_enough: true })
}

/// Whether more than half of the cells in the 3 × 3 neighbourhood that the reference fills are empty in the laser scan.
fn mostly_empty(laser: &Grid, full: &Grid, [x, y]: [usize; 2]) -> bool {
    let (mut n_full, mut n_empty) = (0, 0);
    for row in y.saturating_sub(1)..(y + 2).min(full.size[1]) {
        for column in x.saturating_sub(1)..(x + 2).min(full.size[0]) {
            if full.is_filled([column, row]) {
                n_full += 1;
                n_empty += i32::from(!laser.is_filled([column, row]));
            }
        }
    }
    2 * n_empty > n_full
}
