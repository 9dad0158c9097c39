//! The causes in words.

use super::axes::Axes;
use super::cause::{Cause, Unit};
use super::effect::Effect;
use crate::trust::Limits;
use crate::trust::predict::Where;
use osteoflow_verdict::{Answer, Reason};

/// A size with its unit, and its standard deviation.
fn amount(unit: Unit, size: f64, sd: Option<f64>) -> String {
    let (name, by) = unit.of();
    let (value, sd) = (by * size.abs(), sd.map(|sd| by * sd));
    let least = if name == "mm" { 2 } else { 1 };
    // As many digits as show the spread.
    let digits = if sd.is_some_and(|sd| sd * 10_f64.powi(least) < 1.0) { least + 1 } else { least } as usize;
    let spread = sd.map(|sd| format!(" +- {sd:.digits$}")).unwrap_or_default();
    format!("{value:.digits$}{spread} {name}")
}

/// A cause of a size.
fn found(cause: &Cause, size: f64, sd: Option<f64>) -> String {
    let text = cause.found.replace("{}", &amount(cause.unit, size, sd));
    let Some((before, rest)) = text.split_once('[') else { return text };
    let Some((words, after)) = rest.split_once(']') else { return text };
    let (positive, negative) = words.split_once('|').unwrap_or((words, words));
    format!("{before}{}{after}", if size > 0.0 { positive } else { negative })
}

/// The reason that a cause was measured, beside others that explain the same numbers.
pub(super) fn measured(cause: &Cause, size: f64, sd: f64, effect: Effect, others: &[(&Cause, f64)]) -> Reason {
    let mut reason = format!(
        "{}, which moves the targets by up to {:.1} mm and tilts a cut by up to {:.1} degrees",
        found(cause, size, Some(sd)),
        effect.mm,
        effect.deg
    );
    if size.abs() * cause.unit.of().1 > cause.largest {
        let reason =
            format!("no bone, CT or camera differs as much as would explain the residuals: it would be that {reason}");
        let remedy = "check that the scan shows this bone, of this side, and crop what is not bone";
        return Reason::new(cause.name, Answer::Doubtful, reason, remedy);
    }
    let mut remedy = cause.remedy.to_owned();
    if !others.is_empty() {
        let others: Vec<String> = others.iter().map(|(cause, size)| found(cause, *size, None)).collect();
        reason = format!("{reason}; or {}, which would look the same", others.join(", or "));
        remedy = format!("{remedy}; an object of known size, the stylus or the phantom decides");
    }
    Reason::new(cause.name, Answer::Doubtful, reason, &remedy)
}

/// A deformation that is there and harmless.
pub(super) fn note(cause: &Cause, size: f64, sd: f64) -> String {
    format!("{}, which the answer bears; {}", found(cause, size, Some(sd)), cause.remedy)
}

/// A cause that the data do not limit, with the size at which it would matter.
pub(super) fn assumption(
    cause: &Cause,
    critical: f64,
    worst: Effect,
    limits: &Limits,
    axes: &Axes,
    at: &Where<'_>,
) -> String {
    let [taken, size] = cause.taken;
    let value = cause.unit.of().1 * critical;
    let digits = if value < 1.0 { 2 } else { 1 };
    let size = size.replace("{}", &format!("{value:.digits$} {}", cause.unit.of().0));
    let does = if worst.deg / limits.max_tilt_deg >= worst.times * (1.0 - 1e-9) {
        format!("would tilt a cut by {} degrees", limits.max_tilt_deg)
    } else {
        format!("would move the targets by {} mm", limits.max_tre_mm.min(limits.max_offset_mm))
    };
    match (cause.name, beyond(axes, at)) {
        ("beyond", Some(where_)) => format!("{where_} beyond the scan; there the bone is taken as in the CT: {size} {does}"),
        _ => format!("{taken}: {size} {does}"),
    }
}

/// How far targets lie beyond the scan.
fn beyond(axes: &Axes, at: &Where<'_>) -> Option<String> {
    let distance = |p| (axes.along_share(p).abs() - 1.0) * axes.half_mm;
    let of = |what: &str, mm: Vec<f64>| {
        let mm: Vec<f64> = mm.into_iter().filter(|mm| *mm > 0.0).collect();
        let (from, to) = (mm.iter().copied().fold(f64::INFINITY, f64::min), mm.iter().copied().fold(0.0, f64::max));
        (!mm.is_empty()).then(|| match mm.len() {
            1 => format!("{what} lie up to {to:.0} mm"),
            _ => format!("{what} lie {from:.0} to {to:.0} mm"),
        })
    };
    let cuts = of("cuts", at.cuts.iter().map(|cut| distance(&cut.middle.position)).collect());
    cuts.or_else(|| of("points", at.limited.iter().map(distance).collect()))
}
