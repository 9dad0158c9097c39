//! The kind `transform.to_world`.

use super::{Carried, TrackingParams, marker_motion, note_motion};
use osteoflow_algorithms::point_times::{POINT_TIME, PointTimeUnit, point_times};
use osteoflow_algorithms::still_average::{Carries, MarkerPath, StillReport, TakeMotion, TakeTime};
use osteoflow_geometry::{Cloud, Pose};
use osteoflow_node::{
    Context, Describe, Inputs, NodeError, Outputs, function, schemars, schemars::JsonSchema, serde::Deserialize,
};

/// The camera's cloud in the tracker's world.
///
/// `cloud_world = t_world_camera_marker * inverse(t_camera_camera_marker) * cloud_camera`, with the camera marker's pose at the
/// cloud's stamp. There is no result if the tracker did not see the marker for longer than `max_gap_ms` around it (500: a hand
/// that passes). A marker that moved before the scan by more than the tracker's noise explains is reported.
///
/// If points have times (a column `t`, `time`, `timestamp`, `offset_time` .. of the cloud) and `path` is wired, each point is
/// carried by the marker's pose at its own time. Else the marker's motion during the scan shears it: the verdict has its
/// effect.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "transform.to_world"
in   = { cloud = "crop.cloud", t_world_camera_marker = "camera_marker.pose", motion = "camera_marker.motion", path = "camera_marker.path", calibration = "calibration.t_camera_camera_marker" }
"#,
    literature = ["section 2.2 of the paper"]
)]
pub struct ToWorld;

/// Parameters of [`ToWorld`].
#[derive(Debug, Clone, Default, Deserialize, JsonSchema)]
#[serde(default)]
pub struct Params {
    /// The motion that is reported.
    #[serde(flatten)]
    pub tracking: TrackingParams,
    /// Time from the first point of a scan to the last, if its points have no times. None: not known, `rules.assumed_scan_s` of
    /// the verdict. Usual: structured light 0.1 to 1, a line swept by hand 1 to 5.
    #[schemars(range(min = 0.0, max = 60.0))]
    pub duration_s: Option<f64>,
    /// Which part of that time the stamp is. None: not known, the worst is assumed.
    pub stamp_at: Option<StampAt>,
    /// Unit of the times of points. `auto`: by the column's name (`t_ns`), or else the largest in which a scan takes at most 30
    /// s.
    pub point_times: PointTimeUnit,
}

/// Which part of the time of a scan its stamp is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum StampAt {
    /// Its first point.
    Start,
    /// Its middle.
    Middle,
    /// Its last point.
    End,
}

impl Params {
    /// The time of a scan whose points have none.
    fn stated_time(&self) -> Option<TakeTime> {
        let duration_s = self.duration_s?;
        let middle_s = self.stamp_at.map(|at| match at {
            StampAt::Start => duration_s / 2.0,
            StampAt::Middle => 0.0,
            StampAt::End => -duration_s / 2.0,
        });
        Some(TakeTime { duration_s, middle_s, undone: Vec::new() })
    }
}

/// Inputs of [`ToWorld`].
#[derive(Inputs)]
pub struct In {
    /// The camera's cloud.
    #[port(frame = "calibration.to")]
    pub(super) cloud: Cloud,
    /// The tracked marker on the camera.
    #[port(join = "interpolate", max_gap_ms = 500.0, from = "calibration.from")]
    pub(super) t_world_camera_marker: Pose,
    /// How the marker moved in the time before a sample, from `transform.still_average`.
    #[port(join = "latest")]
    pub(super) motion: Option<StillReport>,
    /// Where the marker was while the scan was taken, from `transform.still_average`: up to 1 s after the scan's stamp, or `after_ms`.
    #[port(join = "latest", after_ms = 1000.0)]
    pub(super) path: Option<MarkerPath>,
    /// `t_camera_camera_marker`, equation 1.
    #[port(join = "once", to = "cloud")]
    pub(super) calibration: Pose,
}

/// Outputs of [`ToWorld`].
#[derive(Outputs)]
pub struct Out {
    /// The cloud in the tracker's world.
    #[port(frame = "t_world_camera_marker.to")]
    pub(super) cloud: Cloud,
    /// The pose of the camera.
    #[port(to = "t_world_camera_marker.to", from = "cloud")]
    t_world_camera: Pose,
    /// How the camera's marker moved while the cloud was taken: for the verdict.
    pub(super) take_motion: TakeMotion,
}

#[function("transform.to_world")]
impl ToWorld {
    fn process(params: &Params, i: In, ctx: &mut Context) -> Result<Out, NodeError> {
        let t_world_camera = i.t_world_camera_marker.compose(&i.calibration.inverse())?;
        i.cloud.frame.expect(&t_world_camera.from, "the cloud")?;
        let what = i.cloud.label.as_deref().unwrap_or("the scan");
        let times = point_times(&i.cloud, params.point_times).unwrap_or_else(|no_times| {
            ctx.sign("point_times", format!("{what}: {no_times}"));
            None
        });
        let to_camera = i.calibration.isometry.inverse();
        let by =
            Carried { marker: "camera", path: i.path.as_ref(), times: times.as_ref(), t_at_stamp: &t_world_camera };
        let (mut cloud, is_undone) = by.cloud(&i.cloud, |marker| marker * to_camera)?;
        let mut take_motion = TakeMotion::new(what);
        take_motion.time = match times {
            None => params.stated_time(),
            Some(times) => {
                if times.name != POINT_TIME {
                    let seconds: Vec<f64> = times.after_ns.iter().map(|ns| *ns as f64 / 1e9).collect();
                    cloud = cloud.with_extra(POINT_TIME, seconds).map_err(|error| NodeError::new(error.to_string()))?;
                }
                let [from_s, to_s] = times.span_s;
                let undone = is_undone.then(|| "camera".to_owned()).into_iter().collect();
                Some(TakeTime { duration_s: to_s - from_s, middle_s: Some((from_s + to_s) / 2.0), undone })
            }
        };
        if !is_undone {
            note_motion("camera", i.motion.as_ref(), &params.tracking, what, "before", ctx);
        }
        let camera = marker_motion("camera", Carries::Data, &i.t_world_camera_marker, i.motion.as_ref());
        let take_motion = take_motion.seen_from(&t_world_camera.isometry).by(camera).during(
            "camera",
            Carries::Data,
            i.cloud.stamp_ns,
            i.path.as_ref(),
        );
        Ok(Out { cloud, take_motion, t_world_camera: t_world_camera.at(i.cloud.stamp_ns) })
    }
}
