//! The slide profile: where along a bone and around it a scan fits, and the best of these places.
//!
//! A shaft is nearly a cylinder. An ICP may end slid along it and spun about it, at a stationary point that only its own
//! residual sees. [`slide`] looks for the minima within some centimetres, registers the scan at the best, and records how the
//! residual grows along the bone and around it from there: whether the minimum is the only one, how deep and how wide it is.

mod axis;
mod compare;
mod profile;
mod report;
mod search;
mod surface;
#[cfg(test)]
mod tests;

pub use report::{Other, SlideProfile, SlideReport};

use crate::Refusal;
use crate::sensor_noise::sensor_noise_mm;
use crate::target::Target;
use axis::LongAxis;
use nalgebra::{Isometry3, Point3};
use osteoflow_geometry::Cloud;
use osteoflow_node_macros::params;
use profile::Motion;
use schemars::JsonSchema;
use search::Minimum;
use serde::Deserialize;
use surface::{Loss, Scene};

/// Minimum number of scan points.
const MIN_POINTS: usize = 200;

/// The start and its surroundings are looked through again about a better place at most this often.
const MAX_ROUNDS: usize = 3;

/// A minimum at least this far from the centre of the search is searched about again: it lies near the edge of the window.
const RECENTRE_SHARE: f64 = 0.5;

/// Extent of a slide profile, and what it takes for undetermined.
#[params]
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
pub struct SlideParams {
    /// How far along the bone minima are searched, both ways. 30: three times the largest error of a mark ruled from the
    /// malleolus (section 3.2.3 of the paper).
    #[param(30.0, 1.0..=200.0)]
    pub along_mm: f64,
    /// How far around the bone minima are searched, both ways. 60: twice the error of a coarse fit by three marks on a bent
    /// bone.
    #[param(60.0, 1.0..=180.0)]
    pub around_deg: f64,
    /// Noise floor of the scan. 0.07: as of the ICP.
    #[param(0.07, 0.001..=10.0)]
    pub noise_mm: f64,
    /// Undetermined along the bone if the residuals do not tell the result from a place this far away. 10: the error of a ruled
    /// mark, to which the scan would add nothing.
    #[param(10.0, 0.1..=200.0)]
    pub undetermined_mm: f64,
    /// Undetermined around the bone, likewise. 30.
    #[param(30.0, 0.1..=180.0)]
    pub undetermined_deg: f64,
}

/// The best place of a scan along and around the bone.
#[derive(Debug, Clone, PartialEq)]
pub struct SlideFit {
    /// The motion that takes the scan onto the surface.
    pub t_target_source: Isometry3<f64>,
    /// The profile about it, and the other minima.
    pub report: SlideReport,
}

/// Registers a scan at its best place along and around a bone, and measures how well its residuals determine that place.
///
/// The minima within `along_mm` and `around_deg` of `t_target_source` are looked for from a grid of starts on a coarse map; each is
/// registered by point-to-plane, and the one with the smallest robust residual is iterated to the end with all points. The
/// answer thus depends on the start only through what is within reach. If the residuals do not tell it from a place farther
/// away than `undetermined_mm` or `undetermined_deg`, the scan is registered where it started instead, and the report says
/// `determined = false`. The result does not depend on the number of threads. About half a second of
/// one core.
///
/// # Errors
/// [`Refusal`] if the scan is too small or away from the surface, or the surface has no normals.
///
/// # Source
/// Profiles of a cost over one unknown with the others fitted: as profile likelihoods. Two places are told apart by the mean
/// difference of their squared residuals, as Vuong 1989, with a variance over clusters as Liang and Zeger 1986. Gelfand et al.
/// 2003 for the motions that leave a surface on itself; theirs are of the normal matrix at one pose, while the profile also
/// shows what lies some millimetres off.
pub fn slide(
    target: &Target,
    source: &Cloud,
    t_target_source: &Isometry3<f64>,
    params: &SlideParams,
) -> Result<SlideFit, Refusal> {
    check(target, source, t_target_source, params)?;
    let sensor_mm = sensor_noise_mm(source.points()).unwrap_or(params.noise_mm);
    let seen = Scene::new(target, source);
    let start = search::settled(target, source, t_target_source, params).unwrap_or(*t_target_source);
    let axis = LongAxis::new(&seen, &start).ok_or_else(|| off_surface(target, source, t_target_source))?;

    let mut minima = search::minima(&seen, &axis, &start, params)?;
    for _ in 1..MAX_ROUNDS {
        let [along_mm, turn_rad] = axis.offset(&seen, &start, &minima[0].pose);
        let is_inside = along_mm.abs() <= RECENTRE_SHARE * params.along_mm
            && turn_rad.abs() <= RECENTRE_SHARE * params.around_deg.to_radians();
        let again = if is_inside { break } else { search::minima(&seen, &axis, &minima[0].pose, params)? };
        let is_same = seen.apart_mm(&again[0].pose, &minima[0].pose) < search::SAME_MM;
        minima.extend(again);
        search::sort(&seen, params, &mut minima);
        minima = search::distinct(&seen, minima, search::SAME_MM);
        if is_same {
            break;
        }
    }

    let at = |minima: &[Minimum], pose: &Isometry3<f64>| {
        let axis = LongAxis::new(&seen, pose).unwrap_or_else(|| axis.clone());
        let sigma_mm = seen.scale_mm(pose).max(params.noise_mm);
        let loss = Loss::new(sigma_mm);
        let profiles = Motion::ALL.map(|motion| profile::along(&seen, &axis, pose, motion, &loss, minima, params));
        (axis, sigma_mm, profiles)
    };
    let best = search::finished(target, source, &minima[0].pose, params)?;
    let (mut pose, mut found) = (best, at(&minima, &best));
    let is_open = found.2.each_ref().map(|profile| profile.is_undetermined);
    if is_open.contains(&true) {
        pose = search::beside(&seen, &axis, &start, &best, is_open, params)?;
        found = at(&minima, &pose);
        for (profile, is_open) in found.2.iter_mut().zip(is_open) {
            profile.is_undetermined |= is_open;
        }
    }
    let (axis, sigma_mm, [along, around]) = found;
    let is_open = along.is_undetermined && around.is_undetermined;
    let turn_is_told = is_open && profile::turn_is_told(&seen, &axis, &pose, &Loss::new(sigma_mm), params);
    let report = report::report(&report::Parts {
        seen: &seen,
        axis: &axis,
        given: t_target_source,
        pose: &pose,
        minima: &minima,
        sigma_mm,
        sensor_mm,
        along,
        around,
        turn_is_told,
    });
    Ok(SlideFit { t_target_source: pose, report })
}

fn check(
    target: &Target,
    source: &Cloud,
    t_target_source: &Isometry3<f64>,
    params: &SlideParams,
) -> Result<(), Refusal> {
    let positive = [
        ("along_mm", params.along_mm),
        ("around_deg", params.around_deg),
        ("noise_mm", params.noise_mm),
        ("undetermined_mm", params.undetermined_mm),
        ("undetermined_deg", params.undetermined_deg),
    ];
    for (name, value) in positive {
        if !(value.is_finite() && value > 0.0) {
            return Err(Refusal::of(format!("{name} is {value}, but it must be a positive number")));
        }
    }
    if !t_target_source.to_homogeneous().iter().all(|c| c.is_finite()) {
        return Err(Refusal::of("the pose to begin with is not finite"));
    }
    if target.normals().is_none() {
        let reason = "the target has no normals, which the profile needs; sample it from a mesh or estimate them";
        return Err(Refusal::of(reason));
    }
    let n = source.points().len();
    if n < MIN_POINTS {
        return Err(Refusal::of(format!(
            "the scan has {n} points, {MIN_POINTS} are needed for a profile; is the region of interest around the bone?"
        )));
    }
    Ok(())
}

fn off_surface(target: &Target, source: &Cloud, t_target_source: &Isometry3<f64>) -> Refusal {
    let seen = Scene::new(target, source);
    let n_near = seen.n_near(t_target_source);
    let centroid: Point3<f64> = t_target_source * seen.centroid;
    let nearest_mm = target.nearest(&centroid, 1e9).map_or(f64::INFINITY, |(_, mm)| mm);
    let (n, needed) = (seen.n(), seen.n() / axis::MIN_NEAR_PART);
    Refusal::of(format!(
        "{n_near} of {n} scan points lie within {:.0} mm of the surface, {needed} are needed; the scan's centroid is \
         {nearest_mm:.0} mm away from it: is t_target_source right, and are both in mm?",
        surface::REACH_MM
    ))
}
