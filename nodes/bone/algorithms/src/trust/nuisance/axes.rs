//! The directions of a registered scan.

use super::cause::Mode;
use crate::axes::largest_first;
use crate::kabsch::centroid;
use nalgebra::{Matrix3, Point3, Vector3};

/// Places of a step are this far apart, mm.
const STEP_EVERY_MM: f64 = 8.0;

/// The directions of a registered scan, target's frame.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::trust) struct Axes {
    /// Centroid of the scan.
    pub(in crate::trust) centre: Point3<f64>,
    /// Unit direction of its longest extent: a shaft's axis.
    pub(in crate::trust) along: Vector3<f64>,
    /// Unit direction towards the camera, perpendicular to `along`; without a camera, the mean normal of the surface.
    pub(in crate::trust) towards: Vector3<f64>,
    /// `along` x `towards`.
    pub(in crate::trust) sideways: Vector3<f64>,
    /// Half of the extent along `along`, mm.
    pub(in crate::trust) half_mm: f64,
    /// Where the camera was.
    pub(in crate::trust) camera: Option<Point3<f64>>,
    /// The ends of the scan beyond which targets lie, mm from its centre along the axis.
    pub(super) beyond_mm: [Option<f64>; 2],
}

impl Axes {
    /// The directions of a scan whose points have these normals; `None` where it has none.
    pub(in crate::trust) fn new(
        points: &[Point3<f64>],
        normals: &[Vector3<f64>],
        camera: Option<Point3<f64>>,
    ) -> Option<Self> {
        let centre = centroid(points);
        let scatter: Matrix3<f64> = points.iter().map(|p| (p - centre) * (p - centre).transpose()).sum();
        let ([along, ..], _) = largest_first(&scatter);
        let mean: Vector3<f64> = normals.iter().sum();
        let view = camera.map_or(mean, |camera| camera - centre);
        let towards = (view - along * view.dot(&along)).try_normalize(1e-9)?;
        let mut far: Vec<f64> = points.iter().map(|p| (p - centre).dot(&along).abs()).collect();
        far.sort_by(f64::total_cmp);
        let half_mm = far[(far.len() - 1) * 98 / 100].max(1.0);
        let sideways = along.cross(&towards);
        Some(Self { centre, along, towards, sideways, half_mm, camera, beyond_mm: [None; 2] })
    }

    /// With the ends of the scan beyond which some of these targets lie.
    pub(super) fn with_targets<'p>(self, targets: impl Iterator<Item = &'p Point3<f64>>) -> Self {
        let shares: Vec<f64> = targets.map(|p| self.along_share(p)).collect();
        let end = |sign: f64| shares.iter().any(|share| share * sign > 1.0).then_some(sign * self.half_mm);
        Self { beyond_mm: [end(-1.0), end(1.0)], ..self }
    }

    /// Position along the axis, from -1 at one end of the scan to 1 at the other.
    pub(super) fn along_share(&self, p: &Point3<f64>) -> f64 {
        (p - self.centre).dot(&self.along) / self.half_mm
    }

    /// Places of a step, mm from the centre.
    pub(super) fn steps(&self) -> Vec<f64> {
        let n = ((self.half_mm - 0.5 * STEP_EVERY_MM) / STEP_EVERY_MM).floor().max(0.0) as i32;
        (-n..=n).map(|k| f64::from(k) * STEP_EVERY_MM).collect()
    }

    /// A step at a place.
    pub(super) fn step(&self, beyond_mm: f64) -> [Mode; 3] {
        [self.towards, self.sideways, self.along].map(|to| Mode::Step { beyond_mm, to })
    }

    /// A map of the camera's depth; none where it is not known where the camera was.
    pub(super) fn depth(&self, scale: f64, plane: Vector3<f64>, bend: Vector3<f64>) -> Vec<Mode> {
        self.camera.map(|camera| Mode::Depth { camera, scale, plane, bend }).into_iter().collect()
    }
}
