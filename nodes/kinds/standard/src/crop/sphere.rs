//! The kind `crop.sphere`.

use super::{In, Out};
use osteoflow_algorithms::roi;
use osteoflow_node::{Context, Describe, NodeError, function, schemars::JsonSchema, serde::Deserialize};

/// The points within a distance of a centre.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "crop.sphere"
in   = { cloud = "recording.scan" }
centre_mm = [0.0, 0.0, 200.0]
radius_mm = 80.0
"#,
    literature = ["section 2.3 of the paper"]
)]
pub struct Sphere;

/// Parameters of [`Sphere`].
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Params {
    /// The centre in the cloud's frame.
    pub centre_mm: [f64; 3],
    /// The radius.
    #[schemars(range(min = 1e-3, max = 1e6))]
    pub radius_mm: f64,
}

#[function("crop.sphere")]
impl Sphere {
    fn process(params: &Params, i: In, _ctx: &mut Context) -> Result<Out, NodeError> {
        let chosen = roi::in_sphere(&i.cloud, &params.centre_mm.into(), params.radius_mm);
        i.cropped(chosen)
    }
}
