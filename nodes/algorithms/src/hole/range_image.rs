use super::spot::{Scene, find};
use super::{Hole, HoleError, HoleParams};
use osteoflow_geometry::Cloud;

/// The hole in the image grid of the camera that took the scan with the laser.
///
/// # Errors
/// [`HoleError`]: no hole, more than one, too sparse to resolve it, scans that do not lie on each other, or a laser scan
/// without a viewpoint.
pub fn range_image(reference: &Cloud, cloud: &Cloud, params: &HoleParams) -> Result<Hole, HoleError> {
    if cloud.viewpoint.is_none() {
        return Err(HoleError::NoViewpoint);
    }
    let scene = Scene::new(reference, cloud, params)?;
    let missing = scene.without_neighbour();
    find(&scene, &missing, params)
}
