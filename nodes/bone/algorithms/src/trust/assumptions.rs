//! What a verdict takes for granted.

use super::case::Case;
use super::checked::is_checked;
use super::rules::RuleParams;
use super::slid::slide_note;

/// What is taken for granted: one list for every way to a verdict. `is_predicted` says whether the verdict states an error;
/// `unseen` are the causes that the data do not limit, each with whether it is of camera or markers.
pub(super) fn assumptions(
    case: &Case<'_>,
    rules: &RuleParams,
    is_predicted: bool,
    unseen: &[(bool, String)],
) -> Vec<String> {
    let is_checked = is_checked(case.check, case.registered.source.stamp_ns, rules.max_check_mm);
    let left = unseen.iter().filter(|(is_of_devices, _)| !(is_checked && *is_of_devices));
    let mut all: Vec<&str> = case.untested.iter().copied().chain(left.map(|(_, text)| text.as_str())).collect();
    let are_sized = unseen.iter().any(|(is_of_devices, _)| *is_of_devices);
    if case.tracking.is_some() && (is_checked || !are_sized) {
        if !is_checked {
            all.push(
                "the camera marker has not moved on its camera since the calibration, and the camera measures lengths as it did then; \
                 a check piece read after the scan would show it (metrics.check_points)",
            );
        }
        all.push("the bone marker has not moved on the bone since the scan");
    }
    if unseen.is_empty() {
        all.push("the CT shows the bone at its true size, and its surface is not swollen or shrunk as a whole");
    }
    all.extend(case.assumptions);
    let is_planned = !case.assessment.is_empty() || case.planes.is_some();
    if case.tracking.is_none() && !is_planned {
        all.push("no plan or calibration was given, so only the scan and the surface were examined");
    }
    if case.registered.source.viewpoint.is_none() {
        all.push(
            "the scan does not say where the camera was, so it was not examined whether it lies on the side that the camera saw",
        );
    }
    if case.icp.is_none_or(|ended| ended.converged.is_none()) {
        all.push("the registration converged; no report says whether it did");
    }
    if case.measured_tre_mm.is_none() {
        all.push(match (is_predicted, is_planned) {
            (true, _) => "no point on the bone was measured with a stylus, so the error is predicted, not measured",
            (false, true) => "no point on the bone was measured with a stylus, and the error could not be predicted",
            (false, false) => {
                "no point on the bone was measured with a stylus and none is planned, so the error is neither measured nor predicted"
            }
        });
    }
    let note = case.slide.and_then(slide_note);
    all.into_iter().map(str::to_owned).chain(note).collect()
}
