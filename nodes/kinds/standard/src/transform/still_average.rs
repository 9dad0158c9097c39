//! The kind `transform.still_average`.

use osteoflow_algorithms::marker_stream::Arrival;
use osteoflow_algorithms::still_average::{
    MarkerPath, StillAverage as Mean, StillError, StillReport, Wander, still_average,
};
use osteoflow_geometry::{Pose, StampNs, nalgebra::Isometry3};
use osteoflow_node::{
    Context, Describe, Inputs, Node, NodeError, Outputs, ParamError, params, schemars::JsonSchema, serde::Deserialize,
};
use std::collections::VecDeque;

/// Number of windows before the last whose samples show the tracker's noise.
const HISTORY: StampNs = 20;

/// Number of stamps, the newest, that show whether they are times of arrival.
const N_STAMPS: usize = 200;

/// A tracked pose, averaged over the time for which the marker has not moved.
///
/// One answer for each sample: the mean of the window before it. While the marker moved within the window, its older half is
/// dropped, so the average does not lag behind a moving marker.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "transform.still_average"
in   = { pose = "recording.camera_marker" }
window_ms = 500.0
"#,
    literature = ["Markley et al. 2007, eq. 13"]
)]
pub struct StillAverage {
    params: Params,
    /// The samples of the last [`HISTORY`] windows.
    history: VecDeque<(StampNs, Isometry3<f64>)>,
    /// The largest distance (mm) and angle (rad) between two poses of one stamp so far.
    contradiction: (f64, f64),
}

/// Parameters of [`StillAverage`].
#[params]
#[derive(Debug, Clone, Deserialize, JsonSchema)]
pub struct Params {
    /// Length of the window. 500: ten samples at 20 Hz, which leaves a third of the tracker's noise.
    #[param(500.0, 0.0..=60_000.0)]
    pub window_ms: f64,
    /// Maximum distance between the means of the window's halves for a marker at rest, unless its noise before explains more.
    /// 0.1: three times an optical tracker's noise.
    #[param(0.1, 0.0..=100.0)]
    pub still_mm: f64,
    /// Maximum rotation between these means, likewise. 0.05: five times an optical tracker's noise.
    #[param(0.05, 0.0..=90.0)]
    pub still_deg: f64,
    /// Length of the path. 6: a slow sweep by hand, 3 s before its stamp or after it.
    #[param(6.0, 0.0..=60.0)]
    pub path_s: f64,
}

/// Inputs of [`StillAverage`].
#[derive(Inputs)]
pub struct In {
    /// Samples of one marker.
    pose: Pose,
}

/// Outputs of [`StillAverage`].
#[derive(Outputs)]
pub struct Out {
    /// The averaged pose, at the sample's stamp.
    #[port(to = "pose.to", from = "pose.from")]
    pose: Pose,
    /// The motion of the marker over the whole window.
    motion: StillReport,
    /// The samples of the last seconds, at most 256: for `transform.to_world` and `transform.to_bone_marker`.
    path: MarkerPath,
}

impl Node for StillAverage {
    const KIND: &'static str = "transform.still_average";
    type Params = Params;
    type Inputs = In;
    type Outputs = Out;

    fn new(params: Params) -> Result<Self, ParamError> {
        Ok(Self { params, history: VecDeque::new(), contradiction: (0.0, 0.0) })
    }

    fn process(&mut self, i: In, ctx: &mut Context) -> Result<Out, NodeError> {
        let now_ns = ctx.stamp_ns();
        for (_, other) in self.history.iter().rev().take_while(|(stamp_ns, _)| *stamp_ns == now_ns) {
            let between = other.inverse() * i.pose.isometry;
            let (mm, rad) = (between.translation.vector.norm(), between.rotation.angle());
            self.contradiction = (self.contradiction.0.max(mm), self.contradiction.1.max(rad));
        }
        let window_ns = (self.params.window_ms * 1e6) as StampNs;
        self.history.push_back((now_ns, i.pose.isometry));
        let path_ns = (self.params.path_s * 1e9) as StampNs;
        let forgotten_ns = now_ns.saturating_sub(window_ns.saturating_mul(HISTORY).max(path_ns));
        while self.history.front().is_some_and(|(stamp_ns, _)| *stamp_ns < forgotten_ns) {
            self.history.pop_front();
        }
        let history = &*self.history.make_contiguous();
        let last = |for_ns: StampNs| {
            &history[history.partition_point(|(stamp_ns, _)| *stamp_ns < now_ns.saturating_sub(for_ns))..]
        };
        let window = last(window_ns);
        let path = MarkerPath::of(last(path_ns));
        let poses: Vec<Isometry3<f64>> = window.iter().map(|(_, pose)| *pose).collect();
        let wander = Wander::of(history, poses.len(), window_ns);
        let oldest_ns = window.first().map_or(now_ns, |(stamp_ns, _)| *stamp_ns);
        let (contradiction_mm, contradiction_rad) = self.contradiction;
        let stamps: Vec<StampNs> = history.iter().rev().take(N_STAMPS).rev().map(|(stamp_ns, _)| *stamp_ns).collect();
        let motion = StillReport {
            span_s: (now_ns - oldest_ns) as f64 / 1e9,
            until_ns: now_ns,
            contradiction_mm,
            contradiction_rad,
            late_s: Arrival::of(&stamps).map_or(0.0, |arrival| arrival.late_s),
            ..still_average(&poses, f64::INFINITY, f64::INFINITY)?.report.explained_by(&wander)
        };
        let isometry = self.still_part(&poses, &wander.of_halves())?.mean;
        Ok(Out { pose: Pose { isometry, ..i.pose }, motion, path })
    }
}

impl StillAverage {
    /// The mean of the newest part of the window in which the marker was at rest, or moved by no more than its noise.
    fn still_part(&self, mut poses: &[Isometry3<f64>], noise: &Wander) -> Result<Mean, StillError> {
        let limit_mm = self.params.still_mm.max(noise.mm);
        let limit_rad = self.params.still_deg.to_radians().max(noise.rad);
        loop {
            match still_average(poses, limit_mm, limit_rad) {
                Err(StillError::Moved { .. }) => poses = &poses[poses.len().div_ceil(2)..],
                answer => return answer,
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use osteoflow_geometry::nalgebra::Vector3;

    fn run(xs: &[f64]) -> Vec<f64> {
        let mut node = StillAverage::new(Params::default()).unwrap();
        let mut ctx = Context::for_test("average");
        let answer = |(k, x): (usize, &f64)| {
            ctx.begin(k as u64, k as i64 * 50_000_000);
            let pose = Pose::new("world", "marker", Isometry3::new(Vector3::x() * *x, Vector3::zeros()));
            node.process(In { pose }, &mut ctx).unwrap().pose.isometry.translation.x
        };
        xs.iter().enumerate().map(answer).collect()
    }

    #[test]
    fn a_still_marker_is_averaged_and_a_moving_one_is_not_held_back() {
        let noise: Vec<f64> = (0..11).map(|k| if k % 2 == 0 { 0.03 } else { -0.03 }).collect();
        let still = run(&noise);
        assert!(still[10].abs() < 0.01, "eleven samples of 0.03 mm leave {} mm", still[10]);
        let moving: Vec<f64> = (0..20).map(f64::from).collect();
        assert_eq!(run(&moving)[19], 19.0);
    }
}
