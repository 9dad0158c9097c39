//! The kind `plane.last`.

use osteoflow_algorithms::trust;
use osteoflow_geometry::{PlanePlace, Planes};
use osteoflow_node::{Context, Describe, Emit, Function, Inputs, NodeError, Outputs};

/// The cutting planes at the end of the recording.
///
/// For the verdict, which is given once. Empty if the planes were never known, for example because the bone has no
/// marker.
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
    /// The planes at the last sample; unknown, with the reason, if the marker was lost by then or two of its poses contradict each
    /// other there.
    #[port(frame = "planes")]
    planes: Emit<Planes>,
}

impl Function for Last {
    const KIND: &'static str = "plane.last";
    type Params = crate::NoParams;
    type Inputs = In;
    type Outputs = Out;

    fn process(_: &crate::NoParams, i: In, _ctx: &mut Context) -> Result<Out, NodeError> {
        let planes: Vec<Planes> = i.planes.into_iter().flatten().collect();
        let is_known = |planes: &Planes| planes.planes.iter().any(|p| matches!(p.place, PlanePlace::Known(_)));
        let contradiction = trust::planes_contradict(&planes);
        let last = if planes.iter().any(is_known) { planes.into_iter().next_back() } else { None };
        let last = last.map(|last| match &contradiction {
            Some(why) => last.unknown(&last.frame, last.stamp_ns, why),
            None => last,
        });
        Ok(Out { planes: last.map_or_else(|| Emit::Empty("the planes were never known".into()), Emit::Value) })
    }
}
