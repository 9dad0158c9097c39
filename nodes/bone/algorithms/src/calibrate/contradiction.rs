//! Why a phantom's pose is refused.

use super::PhantomParams;
use super::contradicted::Contradiction;
use super::pairs::NEAR_SIGMAS;
use super::report::PhantomReport;
use super::shown::PhantomShown;
use crate::Refusal;

/// The mirror image fits clearly better if it leaves less than this share of the scan's own distances.
const CLEARLY_BETTER: f64 = 0.7;

/// A scale is off if it differs by more than this many of its standard deviations.
const SCALE_SIGMAS: f64 = 4.0;

/// Distances of a scan from the CAD, as [`PhantomReport::near_rms_mm`] and [`PhantomReport::capped_rms_mm`].
#[derive(Debug, Clone, Copy)]
pub(super) struct Misfit {
    pub(super) near_rms_mm: f64,
    pub(super) capped_rms_mm: f64,
}

/// What of a fit contradicts its scan, the likeliest cause first. `scaled` is the misfit of the scan in its estimated scale.
pub(super) fn contradiction(report: &PhantomReport, scaled: Option<Misfit>, params: &PhantomParams) -> Option<Refusal> {
    // What the noise does not explain of the nearest points, as an RMS over all.
    let noise_mm = report.noise_mm;
    let excess_mm = |near_rms_mm: f64| ((near_rms_mm / NEAR_SIGMAS).powi(2) - noise_mm.powi(2)).max(0.0).sqrt();
    let rms_mm = report.capped_rms_mm;
    let least_mm = scaled.map_or(rms_mm, |scaled| rms_mm.min(scaled.capped_rms_mm));
    if let Some(mirrored_mm) = report.mirrored_rms_mm.filter(|mirrored| *mirrored < CLEARLY_BETTER * least_mm) {
        return Some(Refusal::of(format!(
            "the mirror image of the phantom's scan fits its CAD ({mirrored_mm:.2} mm RMS), the scan itself does not \
             ({rms_mm:.2} mm); is an axis of the camera flipped, or the CAD mirrored?"
        )));
    }
    if let (Some(scale), Some(sd), Some(scaled)) = (report.scale, report.scale_sd, scaled) {
        let allowed = params.max_scale_error;
        let fits = scaled.capped_rms_mm < rms_mm && excess_mm(scaled.near_rms_mm) <= params.max_excess_mm;
        if fits && (scale - 1.0).abs() > allowed.max(SCALE_SIGMAS * sd) {
            let side = if scale > 1.0 { "too large" } else { "too small" };
            return Some(Refusal::of(format!(
                "the phantom's scan is {side} by {:.1} +- {:.1} %, {:.1} % is allowed; is the camera's own calibration right, the \
                 phantom printed to scale, and its CAD in mm?",
                (scale - 1.0).abs() * 100.0,
                sd * 100.0,
                allowed * 100.0
            )));
        }
    }
    if report.rms_mm > params.max_rms_mm {
        return Some(Refusal::of(format!(
            "the phantom's scan lies {:.2} mm (RMS) from its CAD, {} mm is allowed; is it this phantom, and the nominal pose \
             within a few mm and degrees?",
            report.rms_mm, params.max_rms_mm
        )));
    }
    if report.off_share > params.max_off_share {
        return Some(Refusal::of(format!(
            "{:.0} % of the phantom's scan lies more than {:.1} mm from its CAD, {:.0} % is allowed; is it this phantom, \
             cropped from what stands around it?",
            report.off_share * 100.0,
            3.0 * params.max_rms_mm,
            params.max_off_share * 100.0
        )));
    }
    let excess_mm = excess_mm(report.near_rms_mm);
    if excess_mm > params.max_excess_mm {
        return Some(Refusal::of(format!(
            "the phantom's scan lies {excess_mm:.2} mm (RMS) from its CAD beyond its own noise of {noise_mm:.2} mm, {} mm is \
             allowed; is it this phantom, undamaged, and the nominal pose within a few mm and degrees?",
            params.max_excess_mm
        )));
    }
    if let Some(refusal) = other_phantom(&report.shown, params) {
        return Some(refusal);
    }
    // A turn about either moves the other.
    let (moved_mm, moved_deg) = (report.moved_mm.min(report.moved_at_camera_mm), report.moved_rad.to_degrees());
    let (limit_mm, limit_deg) = (params.max_moved_mm, params.max_moved_deg);
    if moved_mm > limit_mm || moved_deg > limit_deg {
        return Some(Refusal::of(format!(
            "the phantom fits {moved_mm:.1} mm and {moved_deg:.1} degrees from its nominal pose, {limit_mm} mm and {limit_deg} \
             degrees are allowed; is the nominal pose of the camera's marker that of its support, and are the markers not \
             exchanged?"
        )));
    }
    None
}

/// Parts that phantom and CAD do not share, or that are elsewhere.
fn other_phantom(shown: &PhantomShown, params: &PhantomParams) -> Option<Refusal> {
    let place = |of: &Contradiction, limit: f64| {
        let [x, y, z] = of.at_mm.filter(|_| of.share > limit)?;
        let (percent, allowed, mm) = (of.share * 100.0, limit * 100.0, of.along_mm);
        Some((
            format!("{percent:.1} % of the phantom's scan, {allowed} % is allowed,"),
            mm,
            format!("({x:.0}, {y:.0}, {z:.0}) mm"),
        ))
    };
    if let Some((share, mm, at)) = place(&shown.through, params.max_through_share) {
        return Some(Refusal::of(format!(
            "{share} is seen through {mm:.1} mm of its CAD, about {at} of the phantom: the CAD has a part there that the phantom has \
             not; is it the CAD of this phantom, in this version?"
        )));
    }
    if let Some((share, mm, at)) = place(&shown.before, params.max_before_share) {
        return Some(Refusal::of(format!(
            "{share} is {mm:.1} mm before its CAD, about {at} of the phantom: the phantom has a part there that the CAD has not, or \
             something is before it; is it the CAD of this phantom, in this version? crop what is before it"
        )));
    }
    let off = |part: &&super::PhantomPart| part.off_mm.is_some_and(|mm| mm.abs() > params.max_part_off_mm);
    let part = shown.parts.iter().find(off)?;
    let (mm, [x, y, z]) = (part.off_mm.unwrap_or_default(), part.normal);
    Some(Refusal::of(format!(
        "the phantom's face with the normal ({x:.2}, {y:.2}, {z:.2}), at {:.1} mm, is {:.2} mm {} its place in the CAD, {} mm is allowed; is it \
         the CAD of this phantom, in this version, and the phantom whole?",
        part.at_mm,
        mm.abs(),
        if mm > 0.0 { "outside" } else { "inside" },
        params.max_part_off_mm
    )))
}
