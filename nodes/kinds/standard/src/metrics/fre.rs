//! The kind `metrics.fre`.

use crate::transform::points::in_one_list;
use osteoflow_algorithms::metrics::{FreReport, fre};
use osteoflow_geometry::{Points, Pose};
use osteoflow_node::{Context, Describe, Inputs, NodeError, Outputs, function};

/// Fiducial registration error: the residual of a registration at the landmarks, which does not predict the accuracy elsewhere.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "metrics.fre"
in   = { planned = "plan.landmarks", located = { from = "hole.point", n = 3 }, t_ct_bone_marker = "icp.t_target_source" }
"#,
    literature = ["Fitzpatrick 2009, Fiducial registration error and target registration error are uncorrelated"]
)]
pub struct Fre;

/// Inputs of [`Fre`].
#[derive(Inputs)]
pub struct In {
    /// The planned landmarks.
    #[port(join = "once")]
    planned: Points,
    /// The landmarks as located.
    #[port(join = "collect", n = 3, frame = "t_ct_bone_marker.from")]
    located: Vec<Points>,
    /// The registration.
    #[port(join = "once", to = "planned", from = "located")]
    t_ct_bone_marker: Pose,
}

/// Outputs of [`Fre`].
#[derive(Outputs)]
pub struct Out {
    /// Per landmark, and their RMS.
    report: FreReport,
}

#[function("metrics.fre")]
impl Fre {
    fn process(_: &crate::NoParams, i: In, _ctx: &mut Context) -> Result<Out, NodeError> {
        let located = in_one_list(&i.located)?;
        let t_ct_bone_marker = i.t_ct_bone_marker.expect(&i.planned.frame, &located.frame)?;
        Ok(Out { report: fre(&i.planned.points, &located.points, &t_ct_bone_marker)? })
    }
}
