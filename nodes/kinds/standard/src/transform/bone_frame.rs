use osteoflow_algorithms::point_times::PointTimes;
use osteoflow_algorithms::still_average::{Carries, MarkerMotion, MarkerPath, StillReport};
use osteoflow_geometry::{
    Cloud, Frame, Pose,
    nalgebra::{Isometry3, Point3},
};
use osteoflow_node::{Context, NodeError, params, schemars, serde};
use osteoflow_payloads::Flag;
use schemars::JsonSchema;
use serde::Deserialize;

/// Parameters of the nodes that carry data by a tracked marker.
#[params]
#[derive(Debug, Clone, Deserialize, JsonSchema)]
pub struct TrackingParams {
    /// Marker motion before a scan above which it is reported, unless the tracker's noise explains it. 0.1: half the point
    /// spacing of a scan.
    #[param(0.1, 0.0..=100.0)]
    pub flag_motion_above_mm: f64,
    /// Marker rotation before a scan above which it is reported, likewise. 0.03: moves a point at 200 mm by 0.1 mm.
    #[param(0.03, 0.0..=90.0)]
    pub flag_motion_above_deg: f64,
}

/// The pose of the bone's marker at the time of `what`, or the world itself where the bone carries no marker.
pub(crate) fn pose_at(
    world: &Frame,
    marker: Option<Pose>,
    tracked: Option<Flag>,
    what: &str,
    ctx: &Context,
) -> Result<Pose, NodeError> {
    if tracked == Some(Flag(false)) {
        return Ok(Pose::new(world, world, Isometry3::identity()));
    }
    let Some(pose) = marker else {
        let why = ctx.absent_reason("t_world_bone_marker").unwrap_or("nothing is wired to it");
        return Err(NodeError::new(format!(
            "the bone marker was not seen at the time of {what}: {why}; a pose from another time would be stale"
        )));
    };
    world.expect(&pose.to, "what is carried over")?;
    Ok(pose)
}

/// By what a cloud is carried.
pub(crate) struct Carried<'a> {
    pub(crate) marker: &'a str,
    /// Where the marker was while the cloud was taken.
    pub(crate) path: Option<&'a MarkerPath>,
    /// When each point was measured.
    pub(crate) times: Option<&'a PointTimes>,
    /// The motion of the cloud at its stamp.
    pub(crate) t_at_stamp: &'a Pose,
}

impl Carried<'_> {
    /// The carried cloud, and whether each point was carried by the marker's pose at its own time: `of` is the motion for a pose of the marker
    /// in the world.
    pub(crate) fn cloud(
        &self,
        cloud: &Cloud,
        of: impl Fn(&Isometry3<f64>) -> Isometry3<f64>,
    ) -> Result<(Cloud, bool), NodeError> {
        let Pose { to, isometry, .. } = self.t_at_stamp;
        let (Some(path), Some(times)) = (self.path, self.times) else {
            return Ok((cloud.transformed(to, isometry), false));
        };
        let at = |after_ns: &i64| path.at(cloud.stamp_ns, *after_ns).map(|pose| of(&pose));
        let motions: Result<Vec<Isometry3<f64>>, _> = times.after_ns.iter().map(at).collect();
        let motions = motions.map_err(|fault| {
            let (PointTimes { name, span_s: [from_s, to_s], .. }, marker) = (times, self.marker);
            NodeError::new(format!(
                "column \"{name}\" says that the points were measured {from_s:.3} s to {to_s:.3} s after the cloud's stamp, and where the \
                 {marker} marker was then is not known: {fault}; is the unit another one (point_times = \"ns\", or \"ignored\" where it is \
                 no time), were poses lost, or does the scan end later than the path (after_ms of `path`, path_s of \
                 transform.still_average)?"
            ))
        })?;
        Ok((cloud.transformed_each(to, isometry, |k| &motions[k]), true))
    }
}

/// How a marker moved about its pose, in the frame that the pose leads to; `None` where nothing is known.
pub(crate) fn marker_motion(
    marker: &str,
    carries: Carries,
    pose: &Pose,
    motion: Option<&StillReport>,
) -> Option<MarkerMotion> {
    let origin = pose.isometry * Point3::origin();
    motion.map(|motion| MarkerMotion::new(marker, carries, &origin, motion))
}

/// Reports a marker that moved `when`, before or after the scan was taken, by more than the parameters allow and than noise explains.
pub(crate) fn note_motion(
    marker: &str,
    motion: Option<&StillReport>,
    params: &TrackingParams,
    what: &str,
    when: &str,
    ctx: &mut Context,
) {
    let Some(motion) = motion else { return };
    let (limit_mm, limit_deg) = (params.flag_motion_above_mm, params.flag_motion_above_deg);
    let (moved_deg, explained_deg) = (motion.moved_rad.to_degrees(), motion.explained_rad.to_degrees());
    let by_mm = motion.moved_mm > limit_mm.max(motion.explained_mm);
    let by_deg = moved_deg > limit_deg.max(explained_deg);
    let moved = match (by_mm, by_deg) {
        (false, false) => return,
        (true, false) => format!("{:.2} mm", motion.moved_mm),
        (false, true) => format!("{moved_deg:.3} degrees"),
        (true, true) => format!("{:.2} mm and {moved_deg:.3} degrees", motion.moved_mm),
    };
    ctx.warn(format!(
        "the {marker} marker moved by {moved} over the {} samples {when} {what} was taken; the tracker's noise explains \
         {:.2} mm and {explained_deg:.3} degrees, and {limit_mm} mm and {limit_deg} degrees are allowed: {what} may be \
         smeared",
        motion.n, motion.explained_mm
    ));
}

#[cfg(test)]
mod tests {
    use super::*;
    use osteoflow_algorithms::still_average::still_average;
    use osteoflow_geometry::nalgebra::Vector3;

    /// The warnings about eleven samples, moved and turned in all by these amounts, with the noise of a tracker.
    fn warnings(shift_mm: f64, turn_deg: f64) -> Vec<String> {
        let mut ctx = Context::for_test("to_world");
        let sample = |k: u64| {
            let noise =
                |axis: u64, sd: f64| ((ctx.random(6 * k + axis) % 1001) as f64 / 500.0 - 1.0) * 3f64.sqrt() * sd;
            let at = k as f64 / 10.0;
            let shift = Vector3::new(noise(0, 0.03) + shift_mm * at, noise(1, 0.03), noise(2, 0.03));
            let turn = Vector3::new(noise(3, 0.0115), noise(4, 0.0115), noise(5, 0.0115) + turn_deg * at);
            Isometry3::new(shift, turn.map(f64::to_radians))
        };
        let poses: Vec<_> = (0..11).map(sample).collect();
        let motion = still_average(&poses, f64::INFINITY, f64::INFINITY).unwrap().report;
        note_motion("camera", Some(&motion), &TrackingParams::default(), "the scan", "before", &mut ctx);
        ctx.warnings().to_vec()
    }

    #[test]
    fn a_marker_that_shifts_or_turns_is_reported_with_what_noise_explains() {
        assert_eq!(warnings(0.0, 0.0), Vec::<String>::new());
        assert!(warnings(0.4, 0.0)[0].contains("moved by 0.4") && warnings(0.4, 0.0)[0].contains("smeared"));
        assert!(warnings(0.0, 0.2)[0].contains(" degrees over the 11 samples"), "{:?}", warnings(0.0, 0.2));
    }
}
