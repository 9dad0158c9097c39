//! What an independent registration says: by shape alone, and of the scan's mirror image.

use super::{Residuals, evidence::Registered};
use crate::coarse::{self, GlobalParams};
use crate::icp::{self, IcpParams, Method};
use nalgebra::{Isometry3, Point3, Translation3};
use osteoflow_geometry::Cloud;
use serde::{Deserialize, Serialize};
use std::ops::ControlFlow;

/// Maximum distance of a pair while a pose is settled, and counted for a point in a score, mm.
pub(super) const REACH_MM: f64 = 2.0;

/// A registration by shape alone beside the one that is judged.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ShapeEvidence {
    /// Mean distance between both answers at the assessed points, mm.
    pub apart_mm: f64,
    /// RMS distance of the scan from the surface by shape alone, with distances limited to 2 mm, mm.
    pub score_mm: f64,
    /// That of the registration judged, mm.
    pub judged_score_mm: f64,
    /// Margin of the answer by shape over its runner-up; see [`coarse::GlobalReport`].
    pub clearness: f64,
    /// RMS distance of the scan's mirror image from the surface, where it was tried, mm.
    pub mirrored_score_mm: Option<f64>,
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

/// RMS distance from the surface, with distances limited to [`REACH_MM`].
pub(super) fn score_mm(residuals: &Residuals) -> f64 {
    let limit = REACH_MM * REACH_MM;
    let near: f64 = residuals.near.iter().map(|near| near.signed_mm.powi(2).min(limit)).sum();
    ((near + limit * (residuals.n - residuals.near.len()) as f64) / residuals.n.max(1) as f64).sqrt()
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

/// The score of the scan's mirror image where it fits best.
pub(super) fn mirrored_score_mm(registered: &Registered<'_>) -> Option<f64> {
    let image = mirrored(registered.source);
    let fit = coarse::global(registered.target, &image, &GlobalParams::default()).ok()?;
    let image = Registered { source: &image, ..*registered };
    let pose = settled(&image, &fit.t_target_source)?;
    Some(score_mm(&Residuals::new(
        registered.target,
        image.source.points(),
        &pose,
        REACH_MM,
        super::evidence::N_EXAMINED,
    )?))
}
