//! The kind `plane.last`.

use osteoflow_algorithms::{
    marker_stream::{Cause, MotionLimits, Sample, judge},
    trust,
};
use osteoflow_geometry::{Plane, PlanePlace, Planes};
use osteoflow_node::{Context, Describe, Emit, Inputs, NodeError, Outputs, function};

/// The cutting planes at the end of the recording, for the verdict.
///
/// Empty if the planes were never known, for example because the bone has no marker. The motion of the planes is judged as that
/// of a marker: after one that no hand makes, the planes are unknown, since the marker may have slipped.
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
    /// The planes at the last sample; unknown, with the reason, if the marker was lost by then, two of its poses contradict
    /// each other there, or it made a motion that no hand makes.
    #[port(frame = "planes")]
    planes: Emit<Planes>,
    /// The last planes that are known, with their stamp.
    #[port(frame = "planes")]
    known: Emit<Planes>,
}

#[function("plane.last")]
impl Last {
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

#[cfg(test)]
mod tests {
    use super::*;
    use osteoflow_geometry::nalgebra::{Isometry3, Vector3};
    use osteoflow_node::Function;

    /// The last planes and the last known ones, of a plane whose place at 20 Hz is this; `None` where its marker is lost.
    fn last(x: impl Fn(usize) -> Option<f64>, n: usize) -> (Result<f64, String>, f64) {
        let one = |k: usize| {
            let noise = 0.02 * ((k * 7919 % 101) as f64 / 50.0 - 1.0);
            let stamp_ns = 1_000_000_000 + 50_000_000 * k as i64;
            let at = |x: f64| Plane::new("cut", Isometry3::new(Vector3::new(x + noise, 0.0, 9.0), Vector3::zeros()));
            let planes = Planes::new("world", vec![at(x(k).unwrap_or(0.0))]).at(stamp_ns);
            Some(if x(k).is_some() { planes } else { planes.unknown("world", stamp_ns, "the marker is hidden") })
        };
        let mut ctx = Context::for_test("last");
        let i = In { planes: (0..n).map(one).collect() };
        let out = Last::process(&MotionLimits::default(), i, &mut ctx).unwrap();
        let (Emit::Value(planes), Emit::Value(known)) = (out.planes, out.known) else {
            panic!("planes that were known")
        };
        let x = |plane: &Plane| plane.isometry().map(|t| t.translation.x.round());
        let why = match &planes.planes[0].place {
            PlanePlace::Unknown(why) => Err(why.to_string()),
            PlanePlace::Known(_) => Ok(x(&planes.planes[0]).unwrap_or_default()),
        };
        (why, x(&known.planes[0]).unwrap_or_default())
    }

    #[test]
    fn the_last_planes_are_known_only_as_far_as_no_sign_speaks_against_them() {
        assert_eq!(last(|_| Some(0.0), 80), (Ok(0.0), 0.0));
        assert_eq!(last(|k| Some(15.0 * k.saturating_sub(40) as f64), 80), (Ok(585.0), 585.0), "carried at 300 mm/s");
        let (why, known) = last(|k| (k < 70).then_some(0.0), 80);
        assert_eq!((why.unwrap_err().as_str(), known), ("the marker is hidden", 0.0));
        let (why, known) = last(|k| Some(if k == 79 { 20.0 } else { 0.0 }), 80);
        assert!(why.unwrap_err().contains("no later ones confirm it") && known == 0.0);
        let (why, known) = last(|k| Some(if k < 40 { 0.0 } else { 80.0 }), 80);
        let why = why.unwrap_err();
        assert!(
            why.contains("moved the planes by 80.0 mm") && why.contains("faster than a hand") && known == 0.0,
            "{why}"
        );
    }
}
