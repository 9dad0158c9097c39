//! Signed distances of a registered scan from the surface.

use crate::target::Target;
use nalgebra::{Isometry3, Point3, Vector3};
use rayon::prelude::*;

/// A scan point beside the surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Residual {
    /// The registered scan point, in the target's frame, mm.
    pub point: Point3<f64>,
    /// The outward unit normal of the surface there.
    pub normal: Vector3<f64>,
    /// Signed distance along the normal, mm: positive outside.
    pub signed_mm: f64,
    /// Distance of the nearest point of the surface aside of the normal, mm: large past the border of an open surface.
    pub aside_mm: f64,
}

/// The signed distances of a registered scan.
#[derive(Debug, Clone, PartialEq)]
pub struct Residuals {
    /// The points within reach of the surface.
    pub near: Vec<Residual>,
    /// Number of points examined.
    pub n: usize,
}

impl Residuals {
    /// Distances of at most about `max_points` points, evenly through their order, within `reach_mm` of the surface.
    ///
    /// `None` if the target has no normals. `O(n log m)`.
    pub fn new(
        target: &Target,
        source: &[Point3<f64>],
        t_target_source: &Isometry3<f64>,
        reach_mm: f64,
        max_points: usize,
    ) -> Option<Self> {
        let normals = target.normals()?;
        let every = source.len().div_ceil(max_points.max(1)).max(1);
        let examined: Vec<Point3<f64>> = source.iter().step_by(every).copied().collect();
        let of = |p: &Point3<f64>| {
            let point = t_target_source * p;
            let (index, distance_mm) = target.nearest(&point, reach_mm)?;
            let normal = normals[index];
            let signed_mm = (point - target.points()[index]).dot(&normal);
            let aside_mm = (distance_mm * distance_mm - signed_mm * signed_mm).max(0.0).sqrt();
            Some(Residual { point, normal, signed_mm, aside_mm })
        };
        let near: Vec<Option<Residual>> = examined.par_iter().map(of).collect();
        Some(Self { near: near.into_iter().flatten().collect(), n: examined.len() })
    }

    /// Share of the examined points for which `is` holds.
    pub fn share(&self, is: impl Fn(&Residual) -> bool) -> f64 {
        self.near.iter().filter(|r| is(r)).count() as f64 / self.n.max(1) as f64
    }

    /// Quantile of the absolute distances of all examined points; infinite where that falls among those out of reach.
    pub fn quantile_mm(&self, share: f64) -> f64 {
        let mut distances: Vec<f64> = self.near.iter().map(|r| r.signed_mm.abs()).collect();
        distances.sort_by(f64::total_cmp);
        let at = (share * (self.n.max(1) - 1) as f64).round() as usize;
        distances.get(at).copied().unwrap_or(f64::INFINITY)
    }
}
