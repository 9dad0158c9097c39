//! What the data of a registration say about it.

use super::contrary::{self, Support};
use super::spread::normal_matrix;
use super::surface_error::{CELL_MM, MEDIAN_SIGMAS};
use super::{Inside, Misfit, Pattern, Residual, Residuals, ShapeEvidence, Spread, SurfaceError};
use crate::coarse::{self, GlobalReport};
use crate::sensor::Sensor;
use crate::sensor_noise::sensor_noise_mm;
use crate::target::{Side, Target};
use nalgebra::{Isometry3, Point3};
use osteoflow_geometry::Cloud;
use osteoflow_node_macros::params;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Number of scan points that are examined: residuals of one region are correlated, so more say little more.
pub(super) const N_EXAMINED: usize = 5000;

/// Residuals are searched within this distance, mm.
pub(super) const SEARCH_MM: f64 = 8.0;

/// Points inside the surface by more than this many robust standard deviations, and outside by more than that many, are not on
/// it: soft tissue lies outside.
const GATE_SIGMAS: f64 = 5.0;
const OUTSIDE_SIGMAS: f64 = 2.5;

/// What a stated sensor errs over patches is as often this many standard deviations as points are outliers.
const OFF_SIGMAS: f64 = 2.5;
/// The noise is estimated across the surface, and one at a slant has more: this share of it remains in the misfit.
const NOISE_LEFT: f64 = 0.3;

/// Two answers no farther apart than this, mm, are one place.
const TWINS_MM: f64 = 1.0;

/// A quarter of a Gaussian's absolute values are below this many standard deviations.
const QUARTER_SIGMAS: f64 = 0.318_639_363_964_375_15;

/// A registered scan and the points at which its error matters.
#[derive(Debug, Clone, Copy)]
pub struct Registered<'a> {
    /// The surface.
    pub target: &'a Target,
    /// The scan.
    pub source: &'a Cloud,
    /// The registration.
    pub t_target_source: &'a Isometry3<f64>,
    /// Points of the target's frame at which the error matters: assessment points and cuts. Without any, the scan's own.
    pub at: &'a [Point3<f64>],
}

/// What is examined.
#[params]
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
pub struct EvidenceParams {
    /// Whether the scan is also registered by shape alone, as a second opinion. true: it notices landmarks that are swapped,
    /// displaced or of another bone, in about 0.15 s of one core.
    #[param(true)]
    pub shape: bool,
    /// When the scan's mirror image is registered, too; `if_raised`: if another sign is. `if_raised`: it names the cause, and
    /// no mirrored bone passes the other signs.
    #[param(When::IfRaised)]
    pub mirror: When,
}

/// When something is examined.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum When {
    /// In every registration.
    Always,
    /// Where another sign is raised.
    IfRaised,
    /// In none.
    Never,
}

/// What the data of a registration say about it. Lengths in mm.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Evidence {
    /// The sensor's noise across the surface, from the scan alone; from its residuals where its points are too sparse to tell.
    pub noise_mm: f64,
    /// Median distance of the scan from the surface.
    pub median_mm: f64,
    /// 90th percentile of the distances; none where more than a tenth of the scan is beyond 8 mm.
    pub p90_mm: Option<f64>,
    /// Share of the scan on the surface: inside by at most 5, outside by at most 2.5 robust standard deviations.
    pub on_surface: f64,
    /// Share of the scan that lies inside the surface, by more than four times the noise and 0.3 mm.
    pub inside: f64,
    /// Patches of 4 mm of the scan that lie inside the surface by as much; none of an open surface, which has no inside.
    pub inside_patches: Inside,
    /// Share that lies outside by as much.
    pub outside: f64,
    /// The residuals that noise does not explain.
    pub misfit: Misfit,
    /// The error between scan and surface that these residuals have.
    pub surface_error: SurfaceError,
    /// Share of the scan on the surface whose surface faces away from the camera; none without a viewpoint.
    pub facing_away: Option<f64>,
    /// RMS spread of the registration at the points that matter, by a jackknife over cells of 10 mm, or of twice the length of
    /// the surface's error.
    pub spread_mm: Option<f64>,
    /// The motion that is least certain; where nothing holds it, without a size.
    pub pattern: Option<Pattern>,
    /// Mean distance, at the points that matter, to the pose at which a point-to-plane registration settles from this one.
    pub unsettled_mm: Option<f64>,
    /// The registration by shape alone, if it was made.
    pub shape: Option<ShapeEvidence>,
    /// What the scan was measured with, if it is stated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sensor: Option<Sensor>,
}

/// The evidence, and the spread that it rests on.
pub struct Examined {
    /// The numbers.
    pub evidence: Evidence,
    /// The spread of the pose; none where the scan leaves a motion undetermined.
    pub spread: Option<Spread>,
    /// The motion, in the target's frame, to the pose at which a point-to-plane registration settles from the one examined.
    pub to_settled: Option<Isometry3<f64>>,
    /// Which points lie on the surface at the better of the pose examined and that by shape alone.
    supported: Option<Support>,
    /// The report of the registration by shape alone, if it was made.
    pub(super) by_shape: Option<GlobalReport>,
    /// The sensor's noise from the scan alone; 0 where its points are too sparse to tell.
    pub(super) sensor_mm: f64,
}

impl Examined {
    /// Adds the support of the scan's mirror image.
    pub fn examine_mirrored(&mut self, registered: &Registered<'_>) {
        let Some((shape, best)) = self.evidence.shape.as_mut().zip(self.supported.as_ref()) else { return };
        let searched = self.by_shape.as_ref().and_then(|report| report.searched);
        if let Some(mirrored) = contrary::mirrored_support(registered, self.evidence.noise_mm, searched) {
            shape.mirrored_support = Some(mirrored.share());
            shape.mirrored_margin_sd = Some(mirrored.margin_sd(best, registered.source.points()));
        }
    }
}

impl Evidence {
    /// Examines a registration, which started by shape alone if there is a report of it.
    ///
    /// `None` if the target has no normals. The result does not depend on the number of threads.
    ///
    /// # Source
    /// Jackknife over groups: Quenouille 1956; the equivalent clustered sandwich: White 1980, Liang and Zeger 1986, with the
    /// small-sample correction of Bell and McCaffrey 2002 (CR3).
    pub fn examine(
        registered: &Registered<'_>,
        params: &EvidenceParams,
        start: Option<&GlobalReport>,
    ) -> Option<Examined> {
        let Registered { target, source, t_target_source, .. } = *registered;
        let residuals = Residuals::new(target, source.points(), t_target_source, SEARCH_MM, N_EXAMINED)?;
        let sensor_mm = sensor_noise_mm(source.points());
        let stated_mm = target.sensor().map(|sensor| sensor.noise_mm);
        let noise_mm =
            sensor_mm.or(stated_mm).unwrap_or_else(|| (residuals.quantile_mm(0.5) / MEDIAN_SIGMAS).min(SEARCH_MM));
        let sigma_mm = (residuals.quantile_mm(0.25) / QUARTER_SIGMAS).max(noise_mm);
        // A sensor that errs by more than tissue is thick errs on both sides.
        let outside = if target.sensor().is_some_and(Sensor::is_coarse) { GATE_SIGMAS } else { OUTSIDE_SIGMAS };
        let gate = -GATE_SIGMAS * sigma_mm..=outside * sigma_mm;
        let on: Vec<Residual> = residuals.near.iter().filter(|near| gate.contains(&near.signed_mm)).copied().collect();
        let off_mm = (4.0 * noise_mm).max(0.3).max(target.sensor().map_or(0.0, |sensor| OFF_SIGMAS * sensor.patch_mm));
        let is_open = target.is_open();
        let mut misfit = Misfit::new(&on, noise_mm);
        if is_open {
            misfit.inward_mm = 0.0;
        }
        let surface_error = SurfaceError::new(&on);
        let rough_mm = (misfit.rms_mm.powi(2) - (NOISE_LEFT * noise_mm).powi(2)).max(0.0).sqrt();
        let spread = Spread::new(&on, surface_error.cell_mm(CELL_MM)).or_else(|| Spread::new(&on, CELL_MM));
        let spread = spread.map(|spread| spread.widened(rough_mm));
        let points: Vec<Point3<f64>> = on.iter().map(|near| near.point).collect();
        let pattern = match &spread {
            Some(spread) => Pattern::largest(&spread.covariance, &points),
            None => Pattern::free(&normal_matrix(&on), &points),
        };
        let at = points_that_matter(registered);
        let apart = |other: &Isometry3<f64>| {
            let motion = other * t_target_source.inverse();
            at.iter().map(|p| (motion * p - p).norm()).sum::<f64>() / at.len() as f64
        };
        let rms = |square: &dyn Fn(&Point3<f64>) -> f64| {
            (at.iter().map(square).sum::<f64>() / at.len() as f64).max(0.0).sqrt()
        };
        let settled = contrary::settled(registered);
        let shape = params.shape.then(|| contrary::by_shape(registered, start, settled.as_ref())).flatten();
        let by_shape = shape.as_ref().map(|(_, report)| report.clone());
        let mut supported = None;
        let mut evidence = Evidence {
            noise_mm,
            median_mm: residuals.quantile_mm(0.5),
            p90_mm: Some(residuals.quantile_mm(0.9)).filter(|mm| mm.is_finite()),
            on_surface: on.len() as f64 / residuals.n.max(1) as f64,
            inside: residuals.share(|near| near.signed_mm < -off_mm),
            inside_patches: match is_open {
                true => Inside { share: 0.0, depth_mm: 0.0 },
                false => Inside::new(&residuals.near, residuals.n, off_mm),
            },
            outside: 1.0 - residuals.share(|near| near.signed_mm <= off_mm),
            misfit,
            surface_error,
            facing_away: facing_away(registered, &on),
            spread_mm: spread.as_ref().map(|spread| rms(&|p| spread.at(p).trace())),
            pattern,
            unsettled_mm: settled.as_ref().map(apart),
            shape: None,
            sensor: target.sensor().cloned(),
        };
        // A surface that looks the same from there is not another place.
        let nearest_image = |pose: &Isometry3<f64>, has_twin: bool| {
            let is_asked = has_twin && registered.at.is_empty() && apart(pose) > TWINS_MM;
            let symmetry = is_asked.then(|| coarse::symmetry(target, &(pose * t_target_source.inverse()))).flatten()?;
            Some(symmetry.inverse() * pose)
        };
        evidence.shape = shape.map(|(pose, report)| {
            let [best, judged] = [&pose, t_target_source].map(|pose| Support::new(registered, pose, noise_mm));
            let shape = ShapeEvidence {
                apart_mm: nearest_image(&pose, report.twin.is_some())
                    .map_or_else(|| apart(&pose), |image| apart(&image)),
                support: best.share(),
                judged_support: judged.share(),
                margin_sd: best.margin_sd(&judged, source.points()),
                clearness: report.clearness,
                mirrored_support: None,
                mirrored_margin_sd: None,
            };
            supported = Some(if best.share() > judged.share() { best } else { judged });
            shape
        });
        let to_settled = settled.map(|settled| settled * t_target_source.inverse());
        Some(Examined { evidence, spread, to_settled, supported, by_shape, sensor_mm: sensor_mm.unwrap_or(0.0) })
    }
}

/// The points at which the error matters; without any, some of the scan's own.
pub(super) fn points_that_matter(registered: &Registered<'_>) -> Vec<Point3<f64>> {
    if !registered.at.is_empty() {
        return registered.at.to_vec();
    }
    let points = registered.source.points();
    points.iter().step_by((points.len() / 50).max(1)).map(|p| registered.t_target_source * p).collect()
}

/// Share of the points whose surface faces away from the camera; the smaller one where the side of its normals is unknown.
fn facing_away(registered: &Registered<'_>, on: &[Residual]) -> Option<f64> {
    let camera = registered.t_target_source * (registered.source.viewpoint? * Point3::origin());
    let away = on.iter().filter(|near| near.normal.dot(&(camera - near.point)) < 0.0).count();
    let share = away as f64 / on.len().max(1) as f64;
    Some(match registered.target.side() {
        Side::Outward | Side::Stated => share,
        Side::Inward => 1.0 - share,
        Side::Unknown => share.min(1.0 - share),
    })
}
