//! What may be wrong beside the pose: how large it is, how large it may be, or from which size it would matter.
//!
//! A registration estimates six numbers. Each way in which the world departs from a rigid copy of the CT is a few numbers more,
//! with a prior: it is fitted beside the six, and is then *measured*, *bounded* by the data, or *unseen* by them.

mod cause;
mod effect;
mod fit;
mod model;
mod words;

use super::Limits;
use super::evidence::Registered;
use super::predict::{Deformation, Where};
use cause::{Axes, Cause};
use model::Model;
use nalgebra::Point3;
use osteoflow_verdict::Reason;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Number of points of the scan that are fitted.
const N_FITTED: usize = 2000;

/// What may be wrong beside the pose in a sound procedure, as standard deviations, and when it counts as measured.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct NuisanceParams {
    /// Standardised score from which a cause is measured. 5: the largest of all causes in sound scans under simulated errors of
    /// real scanners was 4.7 where its effect mattered.
    #[schemars(range(min = 0.0, max = 1000.0))]
    pub min_score: f64,
    /// Stretch of the CT along the bone, across it, or in all directions, percent. 0.5: a spacing in DICOM is rounded to less, and
    /// a table that lags by half a slice in 100 is as much.
    #[schemars(range(min = 0.001, max = 100.0))]
    pub stretch_percent: f64,
    /// Shear of the CT's slices, as by a tilt of the gantry, degrees. 0.1: scanners state a tilt to as much, and it is corrected or
    /// it is many degrees.
    #[schemars(range(min = 0.001, max = 90.0))]
    pub shear_deg: f64,
    /// Bend of the bone against the CT, mm at the ends of the scan against its middle. 0.1: a fibula without load.
    #[schemars(range(min = 0.001, max = 100.0))]
    pub bend_mm: f64,
    /// Twist of the bone against the CT, degrees from the middle of the scan to its ends. 0.1: a fibula without load.
    #[schemars(range(min = 0.001, max = 90.0))]
    pub twist_deg: f64,
    /// Offset of the CT's surface, as by a segmentation's threshold, mm. 0.2: a quarter of a voxel of 0.8 mm.
    #[schemars(range(min = 0.001, max = 100.0))]
    pub offset_mm: f64,
    /// Film on the bone, mm. 0.3: what remains after cleaning.
    #[schemars(range(min = 0.001, max = 100.0))]
    pub film_mm: f64,
    /// Displacement of a part of the bone across it, mm. 0.1: a bone in one piece.
    #[schemars(range(min = 0.001, max = 100.0))]
    pub step_mm: f64,
    /// Scale of the camera and of its depth against the calibration, percent. 0.2: the drift of a structured-light camera that
    /// warms up.
    #[schemars(range(min = 0.001, max = 100.0))]
    pub camera_percent: f64,
    /// Scale of the camera from which it is told, percent. 1.5: less is a stretch of the CT as well, which moves the cuts less.
    #[schemars(range(min = 0.0, max = 100.0))]
    pub min_camera_percent: f64,
    /// Bend from which it is told, mm. 0.3: less is the curvature of a camera's field.
    #[schemars(range(min = 0.0, max = 100.0))]
    pub min_bend_mm: f64,
    /// Curvature of the camera's depth over the scan, mm at its ends against its middle. 0.1: a calibrated structured-light camera.
    #[schemars(range(min = 0.001, max = 100.0))]
    pub curvature_mm: f64,
}

impl Default for NuisanceParams {
    fn default() -> Self {
        Self {
            min_score: 5.0,
            stretch_percent: 0.5,
            shear_deg: 0.1,
            bend_mm: 0.1,
            twist_deg: 0.1,
            offset_mm: 0.2,
            film_mm: 0.3,
            step_mm: 0.1,
            camera_percent: 0.2,
            min_camera_percent: 1.5,
            min_bend_mm: 0.3,
            curvature_mm: 0.1,
        }
    }
}

impl NuisanceParams {
    /// Prior standard deviation of a cause's parameters.
    fn prior(&self, cause: Cause) -> f64 {
        match cause {
            Cause::Along | Cause::Growth | Cause::Across => self.stretch_percent / 100.0,
            Cause::Shear => self.shear_deg.to_radians(),
            Cause::Bend => self.bend_mm,
            Cause::Twist => self.twist_deg.to_radians(),
            Cause::Offset => self.offset_mm,
            Cause::FilmAlong | Cause::FilmAround | Cause::Film => self.film_mm,
            Cause::Step { .. } => self.step_mm,
            Cause::CameraScale | Cause::CameraDepth => self.camera_percent / 100.0,
        }
    }

    /// The least size of a cause that is told.
    fn least(&self, cause: Cause) -> f64 {
        match cause {
            Cause::CameraScale => self.min_camera_percent / 100.0,
            Cause::Bend => self.min_bend_mm,
            _ => 0.0,
        }
    }
}

/// What the data say of a cause.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum NuisanceState {
    /// It is there, and large enough to matter at the targets.
    Measured,
    /// The data limit it; the limit is part of the predicted error.
    Bounded,
    /// The data do not limit it: an assumption.
    Unseen,
}

/// A cause of error beside the pose.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Nuisance {
    /// Its name.
    pub name: String,
    /// What the data say of it.
    pub state: NuisanceState,
    /// Its size, in `unit`; none where it was not fitted.
    pub estimate: Option<f64>,
    /// Standard deviation of the size, from the data and the prior.
    pub sd: f64,
    /// The unit of `estimate`, `sd` and `critical`.
    pub unit: String,
    /// The direction in which it acts, unit vector of the target's frame, where it has one.
    pub axis: Option<[f64; 3]>,
    /// The place where it acts, target's frame, mm, where it has one.
    pub at: Option<[f64; 3]>,
    /// Largest error of mean TRE and cuts, mm: of its size if measured, of its bound of 90 % if bounded, of its prior's if unseen.
    pub effect_mm: f64,
    /// Largest tilt of a cut by as much, degrees.
    pub effect_deg: f64,
    /// The size at which the answer would be beyond the first of the limits.
    pub critical: f64,
}

/// What is known of the causes.
pub(super) struct Nuisances {
    /// Each cause.
    pub list: Vec<Nuisance>,
    /// The sign against the registration that a cause was measured.
    pub reason: Option<Reason>,
    /// What is taken for granted, the most critical first.
    pub assumptions: Vec<String>,
    /// What the causes may do to the answer, for the predicted error.
    pub deformation: Option<Deformation>,
}

impl Nuisances {
    /// Examines what may be wrong beside the pose. `None` where the target has no normals or the scan leaves the pose undetermined.
    pub(super) fn examine(
        registered: &Registered<'_>,
        place: &Where<'_>,
        noise_mm: f64,
        cell_mm: f64,
        limits: &Limits,
        params: &NuisanceParams,
    ) -> Option<Self> {
        let Registered { target, source, t_target_source, .. } = *registered;
        let normals = target.normals()?;
        let every = source.len().div_ceil(N_FITTED).max(1);
        let all: Vec<Point3<f64>> = source.points().iter().step_by(every).map(|p| t_target_source * p).collect();
        let (mut points, mut seen) = (Vec::new(), Vec::new());
        for p in all {
            if let Some((index, _)) = target.nearest(&p, fit::REACH_MM) {
                points.push(p);
                seen.push(normals[index]);
            }
        }
        let camera = source.viewpoint.map(|viewpoint| t_target_source * (viewpoint * Point3::origin()));
        let axes = Axes::new(&points, &seen, camera)?;
        let problem = fit::Problem { target, normals, points: &points, axes: &axes, noise_mm, cell_mm };
        Some(Model::new(problem, place, limits, params)?.judge())
    }
}
