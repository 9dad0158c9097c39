//! The causes in words.

use super::cause::Cause;
use super::effect::Effect;
use crate::trust::Limits;
use osteoflow_verdict::{Answer, Reason};

/// A cause of a size in words, with the standard deviation of the size.
fn size(cause: Cause, values: &[f64], sd: Option<f64>) -> String {
    let (unit, by) = cause.unit();
    let value = by * cause.size(values);
    let least = if unit == "mm" { 2 } else { 1 };
    // As many digits as show the spread.
    let digits = if sd.is_some_and(|sd| sd * 10_f64.powi(least) < 1.0) { least + 1 } else { least } as usize;
    let spread = sd.map(|sd| format!(" +- {sd:.digits$}")).unwrap_or_default();
    let amount = format!("{:.digits$}{spread} {unit}", value.abs());
    let sign = |positive: &'static str, negative: &'static str| if value > 0.0 { positive } else { negative };
    match cause {
        Cause::Along => format!("the CT is {amount} {} along the bone", sign("too long", "too short")),
        Cause::Growth => format!("the CT is {amount} {} in all directions", sign("too large", "too small")),
        Cause::Shear => format!("the CT's slices are sheared by {amount}"),
        Cause::Across => format!("the CT is {amount} {} across the bone", sign("too wide", "too narrow")),
        Cause::Bend => format!("the bone is bent against the CT by {amount} over the scan"),
        Cause::Twist => format!("the bone is twisted against the CT by {amount} over half of the scan"),
        Cause::Offset => format!("the CT's surface is {amount} {} the bone's", sign("outside", "inside")),
        Cause::Step { .. } => format!("a part of the bone is displaced across it by {amount}"),
        Cause::CameraScale => format!("the camera measures {amount} {}", sign("too short", "too long")),
        Cause::CameraDepth => format!("the camera measures depths {amount} {}", sign("too short", "too long")),
        Cause::Film | Cause::FilmAlong | Cause::FilmAround => format!("a film of {amount} covers the bone"),
    }
}

/// What to check for a cause.
fn remedy(cause: Cause) -> &'static str {
    match cause {
        Cause::Along => "check the slice spacing of the CT",
        Cause::Growth => "check the voxel size of the CT and its date; a bone grows",
        Cause::Shear => "check the tilt of the CT's gantry",
        Cause::Across => "check the pixel spacing of the CT",
        Cause::Bend | Cause::Twist => "check whether the bone was bent, has healed or moved during the CT",
        Cause::Offset => "check the threshold of the CT's segmentation",
        Cause::Step { .. } => "check for a fracture or a loosened part, and scan the part that is cut",
        Cause::CameraScale | Cause::CameraDepth => "measure an object of known size with the camera",
        Cause::FilmAlong | Cause::FilmAround | Cause::Film => "clean the bone and scan again",
    }
}

/// The reason that a cause was measured, beside others that explain the same numbers.
pub(super) fn measured(
    (cause, values): (Cause, &[f64]),
    sd: f64,
    effect: Effect,
    others: &[(Cause, &[f64])],
) -> Reason {
    let mut reason = format!(
        "{}, which moves the targets by up to {:.1} mm and tilts a cut by up to {:.1} degrees",
        size(cause, values, Some(sd)),
        effect.mm,
        effect.deg
    );
    if cause.size(values).abs() > cause.largest() {
        let reason =
            format!("no bone, CT or camera differs as much as would explain the residuals: it would be that {reason}");
        let remedy = "check that the scan shows this bone, of this side, and crop what is not bone";
        return Reason::new(cause.name(), Answer::Doubtful, reason, remedy);
    }
    let mut remedy = remedy(cause).to_owned();
    if !others.is_empty() {
        let others: Vec<String> = others.iter().map(|(cause, values)| size(*cause, values, None)).collect();
        reason = format!("{reason}; or {}, which would look the same", others.join(", or "));
        remedy = format!("{remedy}; an object of known size, the stylus or the phantom decides");
    }
    Reason::new(cause.name(), Answer::Doubtful, reason, &remedy)
}

/// A cause that the data do not limit, with the size at which it would matter.
pub(super) fn assumption(cause: Cause, critical: f64, worst: Effect, limits: &Limits) -> String {
    let taken = match cause {
        Cause::Along => "the CT has the bone's length",
        Cause::Growth => "the CT has the bone's size",
        Cause::Shear => "the CT is not sheared",
        Cause::Across => "the CT has the bone's width",
        Cause::Bend => "the bone is not bent against the CT",
        Cause::Twist => "the bone is not twisted against the CT",
        Cause::Offset => "the CT's surface is the bone's",
        Cause::Step { .. } => "no part of the bone is displaced against the others",
        Cause::FilmAlong => "no film grows along the bone",
        Cause::FilmAround => "no film grows around the bone",
        Cause::Film => "no film covers the bone",
        Cause::CameraScale => "the camera's scale has not changed since its calibration",
        Cause::CameraDepth => "the camera's depth has not changed since its calibration",
    };
    let (unit, by) = cause.unit();
    let value = by * critical;
    let digits = if value < 1.0 { 2 } else { 1 };
    let size = match unit {
        "mm" => format!("{value:.digits$} mm"),
        "%" => format!("{value:.digits$} %"),
        _ => format!("{value:.digits$} degrees"),
    };
    let size = match cause {
        Cause::Along => format!("a stretch along it of more than {size}"),
        Cause::Growth => format!("a growth or shrinkage of more than {size}"),
        Cause::Shear => format!("a shear of more than {size}"),
        Cause::Across => format!("a stretch across it of more than {size}"),
        Cause::Bend => format!("a bend of more than {size} at the ends of the scan against its middle"),
        Cause::Twist => format!("a twist of more than {size} from the middle of the scan to an end"),
        Cause::Offset => format!("an offset of more than {size}"),
        Cause::Step { .. } => format!("a step of more than {size}"),
        Cause::FilmAlong => format!("one that grows by more than {size} from one end of the scan to the other"),
        Cause::FilmAround => format!("one that grows by more than {size} from one side of the scan to the other"),
        Cause::Film => format!("one of more than {size} on the side that was scanned"),
        Cause::CameraScale | Cause::CameraDepth => format!("a change of more than {size}"),
    };
    let does = if worst.deg / limits.max_tilt_deg >= worst.times * (1.0 - 1e-9) {
        format!("would tilt a cut by {} degrees", limits.max_tilt_deg)
    } else {
        format!("would move the targets by {} mm", limits.max_tre_mm.min(limits.max_offset_mm))
    };
    format!("{taken}: {size} {does}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_size_that_no_ct_has_names_tissue_and_another_bone_and_a_spacing_may_be_any() {
        let of = |cause: Cause, size: f64| measured((cause, &[size]), 1.0, Effect::default(), &[]);
        let grown = of(Cause::Growth, 0.04);
        assert!(grown.reason.starts_with("the CT is 4.0 +- 1.0 % too large in all directions"), "{}", grown.reason);
        let shrunk = of(Cause::Growth, -0.65);
        assert!(shrunk.reason.contains("it would be that the CT is 65.0 +- 1.0 % too small"), "{}", shrunk.reason);
        assert!(shrunk.remedy.contains("crop what is not bone"), "{}", shrunk.remedy);
        assert!(of(Cause::Along, 1.0).reason.starts_with("the CT is 100.0 +- 1.0 % too long along the bone"));
    }
}
