//! The kind `coarse.global`.

use osteoflow_algorithms::{
    coarse::{CLEAR, GlobalParams, GlobalReport, global},
    target::Target,
};
use osteoflow_geometry::{Cloud, Points, Pose};
use osteoflow_node::{Context, Describe, Inputs, NodeError, Outputs, Unused, function};

/// Registration of the scan by shape alone, without landmarks.
///
/// docs/method/search.md has the method. Planes wider than the whole surface, such as a table, are left out. A shaft is nearly
/// a cylinder, so a short scan also fits well in wrong places. `clearness` in the report says how much worse the second best
/// place fits, from 0 (as well) to 1; a low one gives a warning. Of scans of one side of two real bones, all of 95 mm and more
/// were registered within 0.1 mm, 5 of 6 of 60 mm, and 6 of 12 of 40 mm and less; clearness was at least 0.4 for right answers
/// and at most 0.2 for wrong ones. On one core it takes 0.1 to 0.2 s for a shaft, 0.3 to 0.9 s for other shapes, and up to 2 s
/// among surroundings.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "coarse.global"
in   = { cloud = "to_bone.cloud", surface = "ct_surface.target" }
"#,
    literature = ["Besl & McKay 1992, section IV-B"]
)]
pub struct Global;

/// Inputs of [`Global`].
#[derive(Inputs)]
pub struct In {
    /// The planned landmarks that other kinds use.
    #[port(join = "once")]
    target: Unused<Points>,
    /// The located landmarks that other kinds use.
    #[port(join = "collect", n = 3)]
    source: Unused<Points>,
    /// The scan.
    cloud: Cloud,
    /// The CT surface.
    #[port(join = "once")]
    surface: Target,
}

/// Outputs of [`Global`].
#[derive(Outputs)]
pub struct Out {
    /// The coarse registration.
    #[port(to = "surface", from = "cloud")]
    t_target_source: Pose,
    /// The fit, and that of the best other answer.
    report: GlobalReport,
}

#[function("coarse.global")]
impl Global {
    fn process(params: &GlobalParams, i: In, ctx: &mut Context) -> Result<Out, NodeError> {
        let _ = (i.target, i.source);
        let fit = global(&i.surface, &i.cloud, params)?;
        if let Some(other) = fit.report.runner_up.as_ref().filter(|_| fit.report.clearness < CLEAR) {
            ctx.warn(format!(
                "the scan fits elsewhere nearly as well: {:.2} mm RMS against {:.2} mm, {:.0} mm and {:.0} degrees away; \
                 the answer may be wrong, so use landmarks (coarse.three_point), scan more of the bone, or crop the scan to it if \
                 surroundings are in it",
                other.score_mm,
                fit.report.score_mm,
                other.shift_mm,
                other.turn_rad.to_degrees()
            ));
        }
        if let Some(twin) = &fit.report.twin {
            ctx.warn(format!(
                "the surface looks the same {:.0} mm and {:.0} degrees away, by a symmetry of it, so its shape does not tell which of the two \
                 was scanned; where that matters, use landmarks (coarse.three_point)",
                twin.shift_mm,
                twin.turn_rad.to_degrees()
            ));
        }
        let pose = Pose::new(&i.surface.frame, &i.cloud.frame, fit.t_target_source).at(ctx.stamp_ns());
        Ok(Out { t_target_source: pose, report: fit.report })
    }
}
