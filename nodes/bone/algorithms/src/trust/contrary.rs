//! What an independent registration says: by shape alone, and of the scan's mirror image.

use super::Residuals;
use super::evidence::{N_EXAMINED, Registered};
use crate::coarse::{self, GlobalParams};
use crate::icp::{self, IcpParams, Method};
use nalgebra::{Isometry3, Point3, Translation3};
use osteoflow_geometry::Cloud;
use serde::{Deserialize, Serialize};
use std::ops::ControlFlow;

/// Maximum distance of a pair while a pose is settled, mm.
const REACH_MM: f64 = 2.0;

/// Points no farther from the surface support a pose: this many times the noise, and at least this many mm, the error of a CT's
/// surface. A share of points does not mind where the others are, as tissue may be anywhere.
const SUPPORT_SIGMAS: f64 = 3.0;
const MIN_SUPPORT_MM: f64 = 0.2;

/// A registration by shape alone beside the one that is judged.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ShapeEvidence {
    /// Mean distance between both answers at the assessed points, mm.
    pub apart_mm: f64,
    /// Share of the scan on the surface by shape alone, within three times the noise and 0.2 mm.
    pub support: f64,
    /// That of the registration judged.
    pub judged_support: f64,
    /// Margin of the answer by shape over its runner-up; see [`coarse::GlobalReport`].
    pub clearness: f64,
    /// That of the scan's mirror image where it fits best, if it was tried.
    pub mirrored_support: Option<f64>,
}

/// The scan's mirror image and that of its camera.
pub fn mirrored(scan: &Cloud) -> Cloud {
    let flip = |p: &Point3<f64>| Point3::new(-p.x, p.y, p.z);
    let points: Vec<Point3<f64>> = scan.points().iter().map(flip).collect();
    let mirrored = Cloud::new(scan.frame.clone(), points).unwrap_or_else(|_| scan.clone());
    match scan.viewpoint {
        Some(viewpoint) => {
            let camera = flip(&(viewpoint * Point3::origin()));
            mirrored.seen_from(Isometry3::from_parts(Translation3::from(camera.coords), viewpoint.rotation))
        }
        None => mirrored,
    }
}

/// Share of the scan that lies on the surface at a pose.
pub(super) fn support(registered: &Registered<'_>, pose: &Isometry3<f64>, noise_mm: f64) -> f64 {
    let limit_mm = (SUPPORT_SIGMAS * noise_mm).max(MIN_SUPPORT_MM);
    let (target, points) = (registered.target, registered.source.points());
    let residuals = Residuals::new(target, points, pose, 2.0 * limit_mm, N_EXAMINED);
    residuals.map_or(0.0, |residuals| residuals.share(|near| near.signed_mm.abs() <= limit_mm))
}

/// The pose at which a point-to-plane registration from `start` comes to rest.
pub(super) fn settled(registered: &Registered<'_>, start: &Isometry3<f64>) -> Option<Isometry3<f64>> {
    let params = IcpParams { max_pair_distance_mm: REACH_MM, ..IcpParams::default() };
    let observer = &mut |_: &icp::IcpStep| ControlFlow::Continue(());
    let fit = icp::register(Method::PointToPlane, registered.target, registered.source, start, &params, observer);
    fit.ok().map(|fit| fit.t_target_source)
}

/// The registration by shape alone, settled, and its report.
pub(super) fn by_shape(registered: &Registered<'_>) -> Option<(Isometry3<f64>, coarse::GlobalReport)> {
    let fit = coarse::global(registered.target, registered.source, &GlobalParams::default()).ok()?;
    Some((settled(registered, &fit.t_target_source)?, fit.report))
}

/// The support of the scan's mirror image where it fits best.
pub(super) fn mirrored_support(registered: &Registered<'_>, noise_mm: f64) -> Option<f64> {
    let image = mirrored(registered.source);
    let fit = coarse::global(registered.target, &image, &GlobalParams::default()).ok()?;
    let image = Registered { source: &image, ..*registered };
    let pose = settled(&image, &fit.t_target_source)?;
    Some(support(&image, &pose, noise_mm))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::target::Target;
    use nalgebra::Vector3;
    use osteoflow_geometry::SurfaceOrigin;

    #[test]
    fn a_mirror_image_has_its_camera_mirrored_and_its_frame_kept() {
        let scan = Cloud::new("scan", vec![Point3::new(1.0, 2.0, 3.0), Point3::new(-4.0, 5.0, 6.0)]).unwrap();
        let image = mirrored(&scan);
        assert_eq!(image.points(), [Point3::new(-1.0, 2.0, 3.0), Point3::new(4.0, 5.0, 6.0)]);
        assert_eq!((image.frame.clone(), image.viewpoint), (scan.frame.clone(), None));
        let turn = Vector3::y() * 0.3;
        let seen = mirrored(&scan.seen_from(Isometry3::new(Vector3::new(200.0, -10.0, 50.0), turn)));
        assert_eq!(seen.viewpoint, Some(Isometry3::new(Vector3::new(-200.0, -10.0, 50.0), turn)));
    }

    #[test]
    fn support_is_the_share_within_three_times_the_noise_and_a_fifth_of_a_millimetre() {
        let grid: Vec<Point3<f64>> = (0..121).map(|k| Point3::new(f64::from(k % 11), f64::from(k / 11), 0.0)).collect();
        let normals = vec![Vector3::z(); grid.len()];
        let target = Target::new("ct", SurfaceOrigin::Exact, grid, Some(normals.into())).unwrap();
        // Above samples of the surface, at a limit, and 1 mm beyond its edge in its plane.
        let scan = [[5.0, 5.0, 0.2], [5.0, 6.0, -0.2], [4.0, 5.0, 0.21], [4.0, 4.0, -0.61], [11.0, 5.0, 0.0]];
        let source = Cloud::new("scan", scan.map(Point3::from).to_vec()).unwrap();
        let pose = Isometry3::identity();
        let registered = Registered { target: &target, source: &source, t_target_source: &pose, at: &[] };
        assert_eq!(support(&registered, &pose, 0.05), 0.4);
        assert_eq!(support(&registered, &pose, 0.08), 0.6);
        assert_eq!(support(&registered, &pose, 0.21), 0.8 + 0.2 * f64::from(2.0 * 0.63 > 1.0));
    }
}
