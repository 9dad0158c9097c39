//! The part of the residuals that noise does not explain.

use super::{Evidence, Limits, Residual, RuleParams};
use crate::sensor::{Sensor, SensorKind};
use osteoflow_verdict::{Answer, Reason};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Edge of a patch, mm: several patches around the visible side of a bone, a dozen points or more in each.
const PATCH_MM: f64 = 4.0;

/// Patches with fewer points are left out.
const MIN_POINTS: usize = 5;

/// The noise is estimated along the surface's normals, and a slanted surface has more: a share of it remains in the misfit.
const MISFIT_PER_NOISE: f64 = 0.15;

/// Mean residuals of patches, RMS over the points, without the part that the sensor's noise explains.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Misfit {
    /// Of all patches, mm.
    pub rms_mm: f64,
    /// Of the patches inside the surface, mm: soft tissue lies outside, another bone on both sides. Zero of an open surface, which has no
    /// inside.
    pub inward_mm: f64,
}

impl Misfit {
    /// The misfit of points on the surface.
    pub(super) fn new(on: &[Residual], noise_mm: f64) -> Self {
        let mut patches: BTreeMap<[i64; 3], (usize, f64)> = BTreeMap::new();
        for near in on {
            let key = std::array::from_fn(|k| (near.point[k] / PATCH_MM).floor() as i64);
            let (n, sum) = patches.entry(key).or_default();
            (*n, *sum) = (*n + 1, *sum + near.signed_mm);
        }
        let (mut n_points, mut squares, mut inward) = (0.0, 0.0, 0.0);
        for (n, sum) in patches.values().filter(|(n, _)| *n >= MIN_POINTS) {
            let n = *n as f64;
            n_points += n;
            // The noise of a mean of n is 1/n of its variance; half of it lies inside.
            squares += sum * sum / n - noise_mm * noise_mm;
            inward += sum.min(0.0).powi(2) / n - noise_mm * noise_mm / 2.0;
        }
        let rms = |squares: f64| if n_points > 0.0 { (squares.max(0.0) / n_points).sqrt() } else { 0.0 };
        Self { rms_mm: rms(squares), inward_mm: rms(inward) }
    }
}

/// A scan whose noise is this many times less than the stated sensor's was measured with another one.
const FINER: f64 = 4.0;

/// How a sensor is stated.
const STATE: &str = "(register: --sensor; in a graph: ct_surface.sensor.like)";

/// The sign that a scan is finer than the sensor that is stated for it: what that sensor's error would explain, this one's does not.
pub(super) fn sensor_reason(evidence: &Evidence) -> Option<Reason> {
    let sensor = evidence.sensor.as_ref().filter(|sensor| sensor.is_coarse())?;
    (FINER * evidence.noise_mm < sensor.noise_mm).then(|| {
        let reason = format!(
            "the scan has noise of {:.2} mm, and {} is stated with {:.2} mm; likely cause: another sensor, or a scan that was smoothed",
            evidence.noise_mm,
            sensor.words(),
            sensor.noise_mm
        );
        let remedy = format!("state the sensor that the scan was measured with {STATE}");
        Reason::new("sensor", Answer::Doubtful, reason, remedy)
    })
}

/// The sign that limits were stated, other than by default, below what the stated sensor attains, by which the answer is judged instead.
pub(super) fn limits_reason(sensor: &Sensor, stated: &Limits) -> Option<Reason> {
    let (usual, attains_mm) = (Limits::default(), sensor.attains_mm());
    let limits = [(stated.max_tre_mm, usual.max_tre_mm), (stated.max_offset_mm, usual.max_offset_mm)];
    let below = limits.into_iter().filter(|(mm, usual_mm)| mm != usual_mm && *mm < attains_mm).map(|(mm, _)| mm);
    let asked_mm = below.reduce(f64::min)?;
    let reason = format!(
        "the limits ask for {asked_mm:.1} mm, and {} errs by {attains_mm:.1} mm (95 %), so an answer that is right by the one may be \
         wrong by the other",
        sensor.words()
    );
    let remedy = format!(
        "measure with a finer sensor, state the errors that were measured of this one {STATE}, or ask for no less than it attains \
         (in a graph: verdict.rules.limits)"
    );
    Some(Reason::new("sensor", Answer::Doubtful, reason, remedy))
}

/// What is taken for granted of a coarse sensor: nothing but the scan's noise confirms it.
pub(super) fn sensor_assumption(sensor: &Sensor, limits: &Limits) -> Option<String> {
    sensor.is_coarse().then(|| {
        format!(
            "the scan was measured with {}, as stated: errors of {:.1} mm over patches are no sign against the answer, and an error of up to \
             {:.1} mm counts as right",
            sensor.words(),
            sensor.patch_mm,
            limits.max_tre_mm
        )
    })
}

/// The reason against a misfit that neither the noise nor the error of sensor and segmentation explains.
///
/// The inside of the surface decides between doubt and refusal: beyond what any segmentation and the stated sensor do, only another place
/// explains it.
pub(super) fn misfit_reason(evidence: &Evidence, rules: &RuleParams) -> Option<Reason> {
    let (misfit, noise_mm, sensor) = (&evidence.misfit, evidence.noise_mm, evidence.sensor.as_ref());
    let inside_mm = rules.max_inward_misfit_mm;
    // Zero, as someone asks for whom no scan may lie inside, is not widened by noise.
    let limit_mm = if inside_mm == 0.0 { 0.0 } else { inside_mm.hypot(noise_mm) };
    if misfit.inward_mm > limit_mm {
        let unstated = match sensor {
            Some(_) => String::new(),
            None => format!("if the sensor is coarser than structured light, state it {STATE}, and "),
        };
        let reason = format!(
            "parts of the scan lie inside the bone's surface by {:.2} mm (RMS of patches of 4 mm), which neither noise ({noise_mm:.2} \
             mm) nor the {inside_mm:.2} mm {} nor tissue explains; likely cause: another bone, its mirror image, or another place on it",
            misfit.inward_mm,
            match sensor {
                Some(sensor) => format!("of {} on a poor segmentation", sensor.words()),
                None => "of a poor segmentation".to_owned(),
            }
        );
        let remedy = format!("{unstated}check that scan and CT are of the same bone, side and patient");
        return Some(Reason::new("inward_misfit", Answer::Refused, reason, &remedy));
    }
    let explained_mm = rules.max_misfit_mm;
    (misfit.rms_mm > explained_mm + MISFIT_PER_NOISE * noise_mm).then(|| {
        let like = Sensor::nearest(noise_mm, misfit.rms_mm);
        let reason = format!(
            "scan and surface differ by {:.2} mm (RMS of patches of 4 mm; alike over {:.0} mm){}, beyond the noise of {noise_mm:.2} mm \
             and the {explained_mm:.2} mm of {} on a good segmentation; likely cause: the sensor's own error, the CT's segmentation, film on \
             the bone, or another bone of nearly this shape",
            misfit.rms_mm,
            evidence.surface_error.length_mm,
            match (sensor, like) {
                (None, SensorKind::DepthCamera | SensorKind::Ultrasound | SensorKind::Stylus) =>
                    format!(", as of {}", like.sensor().words()),
                _ => String::new(),
            },
            sensor.map_or_else(|| SensorKind::StructuredLight.sensor().words(), Sensor::words),
        );
        let remedy = match sensor {
            Some(_) => String::new(),
            None => format!("state the sensor if it is another one {STATE}, "),
        } + "clean the bone and scan again, and check that CT and scan are of one bone";
        Reason::new("misfit", Answer::Doubtful, reason, remedy)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_other_than_by_default_below_what_the_sensor_attains_are_doubtful_and_the_default_ones_are_not() {
        let camera = SensorKind::DepthCamera.sensor();
        let attains_mm = camera.attains_mm();
        let reason = |limits: Limits| limits_reason(&camera, &limits);
        let usual = Limits::default();
        assert!(usual.max_tre_mm < attains_mm && reason(usual.clone()).is_none());
        let mm = |max_tre_mm, max_offset_mm| Limits { max_tre_mm, max_offset_mm, ..Limits::default() };
        for limits in [mm(attains_mm, attains_mm), mm(attains_mm + 1.0, 1.5), Limits { max_tilt_deg: 0.1, ..usual }] {
            assert_eq!(reason(limits.clone()), None, "{limits:?}");
        }
        // Laxer than by default and stricter, the strictest of both.
        for (limits, asked) in
            [(mm(3.0, 1.5), "3.0"), (mm(1.5, 1.0), "1.0"), (mm(3.0, 0.5), "0.5"), (mm(9.0, 2.0), "2.0")]
        {
            let found = reason(limits.clone()).unwrap_or_else(|| panic!("{limits:?} is no sign"));
            let words = format!("the limits ask for {asked} mm, and a depth camera errs by {attains_mm:.1} mm (95 %)");
            assert!(found.reason.starts_with(&words) && found.answer == Answer::Doubtful, "{found:?}");
        }
        let fine = SensorKind::Laser.sensor();
        assert_eq!(limits_reason(&fine, &mm(0.5, 0.5)), None, "a laser attains {} mm", fine.attains_mm());
    }
}
