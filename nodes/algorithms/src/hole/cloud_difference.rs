use super::spot::{Scene, find};
use super::{Hole, HoleError, HoleParams};
use osteoflow_geometry::Cloud;

/// The hole as the paper finds it: the reference scan minus the scan with the laser.
///
/// A reference point is missing where the laser scan has no point within a distance that follows the local spacing.
/// Both clouds in one frame. `O(n log n)`.
///
/// # Errors
/// [`HoleError`]: no hole, more than one, too sparse to resolve it, or scans that do not lie on each other.
///
/// # Source
/// Section 2.3 of the paper, where the missing set's largest cluster gives the spot.
pub fn cloud_difference(reference: &Cloud, cloud: &Cloud, params: &HoleParams) -> Result<Hole, HoleError> {
    let scene = Scene::new(reference, cloud, params)?;
    let missing = scene.without_neighbour();
    find(&scene, &missing, params)
}
