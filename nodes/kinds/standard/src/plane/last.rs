//! The kind `plane.last`.

use osteoflow_algorithms::{
    marker_stream::{Cause, MotionLimits, Sample, judge},
    trust,
};
use osteoflow_geometry::{Plane, PlanePlace, Planes};
use osteoflow_node::{Context, Describe, Emit, Function, Inputs, NodeError, Outputs};

/// The cutting planes at the end of the recording.
///
/// For the verdict, which is given once. Empty if the planes were never known, for example because the bone has no
/// marker. The motion of the planes is judged as that of a marker: after one that no hand makes they are unknown, although the marker is
/// seen, since it may have slipped.
#[derive(Describe)]
#[describe(example = r#"
kind = "plane.last"
in   = { planes = "planes.planes" }
"#)]
pub struct Last;

/// Inputs of [`Last`].
#[derive(Inputs)]
pub struct In {
    /// The planes at each sample of the bone's marker.
    #[port(join = "collect")]
    planes: Vec<Option<Planes>>,
}

/// Outputs of [`Last`].
#[derive(Outputs)]
pub struct Out {
    /// The planes at the last sample; unknown, with the reason, if the marker was lost by then, two of its poses contradict each
    /// other there, or it made a motion that no hand makes.
    #[port(frame = "planes")]
    planes: Emit<Planes>,
    /// The last planes that are known, with their stamp.
    #[port(frame = "planes")]
    known: Emit<Planes>,
}

impl Function for Last {
    const KIND: &'static str = "plane.last";
    type Params = MotionLimits;
    type Inputs = In;
    type Outputs = Out;

    fn process(limits: &MotionLimits, i: In, _ctx: &mut Context) -> Result<Out, NodeError> {
        let planes: Vec<Planes> = i.planes.into_iter().flatten().collect();
        let pose = |planes: &Planes| planes.planes.iter().find_map(Plane::isometry).copied();
        let (known, samples): (Vec<&Planes>, Vec<Sample>) =
            planes.iter().filter_map(|planes| Some((planes, (planes.stamp_ns, pose(planes)?)))).unzip();
        let judged = judge(&samples, limits);
        let jump = judged.jumps.first();
        let n_before = jump.map_or(samples.len(), |(first, _)| *first);
        let confirmed = (0..n_before).rev().find(|k| judged.out[*k].is_none()).map(|k| known[k].clone());
        let is_last = planes.last().is_some_and(|last| last.planes.iter().any(is_known));
        let unconfirmed = judged.out.last().copied().flatten().filter(|_| is_last);
        let why = trust::planes_contradict(&planes)
            .or_else(|| jump.map(|(first, cause)| jumped(samples[*first].0, cause)))
            .or_else(|| unconfirmed.map(|cause| format!("of the last planes, {}", cause.words())));
        let last = if known.is_empty() { None } else { planes.last() };
        let last = last.map(|last| match &why {
            Some(why) => last.unknown(&last.frame, last.stamp_ns, why),
            None => last.clone(),
        });
        let or_empty = |planes: Option<Planes>| {
            planes.map_or_else(|| Emit::Empty("the planes were never known".into()), Emit::Value)
        };
        Ok(Out { planes: or_empty(last), known: or_empty(confirmed) })
    }
}

fn is_known(plane: &Plane) -> bool {
    matches!(plane.place, PlanePlace::Known(_))
}

fn jumped(stamp_ns: i64, cause: &Cause) -> String {
    format!(
        "by {stamp_ns} ns the bone's marker moved the planes by {:.1} mm and {:.1} degrees, faster than a hand moves it, and stayed there: \
             it slipped, was knocked, or its attitude is read wrongly on one side of that",
        cause.mm,
        cause.rad.to_degrees()
    )
}
