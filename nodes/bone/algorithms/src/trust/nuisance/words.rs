//! The causes in words.

use super::axes::Axes;
use super::cause::{Cause, Of, Unit};
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

/// A cause that the data do not limit.
pub(super) struct Unseen {
    pub(super) cause: &'static Cause,
    /// The chance that it puts the answer beyond the limits, times how far.
    pub(super) danger: f64,
    /// From which size.
    pub(super) critical: f64,
    /// What a parameter of 1 does at worst.
    pub(super) worst: Effect,
}

/// What is taken for granted, the most dangerous first, each with the sizes from which it would be wrong and what shows it; and whether it is of
/// camera or markers.
pub(super) fn assumptions(
    mut unseen: Vec<Unseen>,
    limits: &Limits,
    axes: &Axes,
    at: &Where<'_>,
) -> Vec<(bool, String)> {
    unseen.sort_by(|a, b| b.danger.total_cmp(&a.danger));
    let of = |of: Of| {
        let own: Vec<&Unseen> = unseen.iter().filter(|unseen| unseen.cause.of == of).collect();
        let tilts = |unseen: &&&Unseen| unseen.worst.deg / limits.max_tilt_deg >= unseen.worst.times * (1.0 - 1e-9);
        let sizes = |unseen: &&Unseen| {
            let value = unseen.cause.unit.of().1 * unseen.critical;
            let digits = if value < 0.095 { 3 } else { 1 + usize::from(value < 1.0) };
            unseen.cause.wrong.replace("{}", &format!("{value:.digits$} {}", unseen.cause.unit.of().0))
        };
        let part = |own: Vec<&&Unseen>, does: String| {
            let mut sizes: Vec<String> = own.into_iter().map(sizes).collect();
            let last = sizes.pop()?;
            let or = if sizes.is_empty() { "" } else { " or " };
            Some(format!("{does}: {}{or}{last}", sizes.join(", ")))
        };
        let moved_mm = limits.max_tre_mm.min(limits.max_offset_mm);
        let parts = [
            part(own.iter().filter(tilts).collect(), format!("Tilts a cut by {} degrees", limits.max_tilt_deg)),
            part(own.iter().filter(|unseen| !tilts(unseen)).collect(), format!("Moves the targets by {moved_mm} mm")),
        ];
        let parts: Vec<String> = parts.into_iter().flatten().collect();
        let has = |name: &str| own.iter().any(|unseen| unseen.cause.name == name);
        let [taken, shown] = of.words(has);
        let beyond = beyond(axes, at).filter(|_| has("beyond"));
        let beyond = beyond.map(|places| format!(", also {places}")).unwrap_or_default();
        let danger = own.iter().map(|unseen| unseen.danger).sum::<f64>();
        let text = format!("{taken}{beyond}. {}. Shown by: {shown}", parts.join(". "));
        (!own.is_empty()).then_some((danger, of == Of::Devices, text))
    };
    let mut all: Vec<(f64, bool, String)> = Of::ALL.into_iter().filter_map(of).collect();
    all.sort_by(|a, b| b.0.total_cmp(&a.0));
    all.into_iter().map(|(_, is_of_devices, text)| (is_of_devices, text)).collect()
}

/// How far targets lie beyond the scan: "15 to 47 mm beyond the scan, where cuts lie".
fn beyond(axes: &Axes, at: &Where<'_>) -> Option<String> {
    let distance = |p| (axes.along_share(p).abs() - 1.0) * axes.half_mm;
    let of = |what: &str, mm: Vec<f64>| {
        let mm: Vec<f64> = mm.into_iter().filter(|mm| *mm > 0.0).collect();
        let (from, to) = (mm.iter().copied().fold(f64::INFINITY, f64::min), mm.iter().copied().fold(0.0, f64::max));
        let from = if mm.len() > 1 { format!("{from:.0} to ") } else { String::new() };
        (!mm.is_empty()).then(|| format!("{from}{to:.0} mm beyond the scan, where {what} lie"))
    };
    let cuts = of("cuts", at.cuts.iter().map(|cut| distance(&cut.middle.position)).collect());
    cuts.or_else(|| of("points", at.limited.iter().map(distance).collect()))
}
