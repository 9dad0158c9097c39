//! The kind `crop.box`.

use super::{In, Out};
use osteoflow_algorithms::roi;
use osteoflow_geometry::{Region, nalgebra::Point3};
use osteoflow_node::{Context, Describe, Node, NodeError, ParamError, schemars::JsonSchema, serde::Deserialize};

/// The points in a box along the axes of the cloud's frame.
///
/// Without parameters and without a region, all points are kept.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "crop.box"
in   = { cloud = "recording.scan", region = "recording.region" }
min_mm = [-60.0, -40.0, 150.0]
max_mm = [60.0, 40.0, 250.0]
"#,
    literature = ["section 2.3 of the paper"]
)]
pub struct Box(Params);

/// Parameters of [`Box`].
#[derive(Debug, Clone, Default, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// The corner with the smallest x, y, z. Unset: no bound, so the recording's region alone decides.
    pub min_mm: Option<[f64; 3]>,
    /// The corner with the largest x, y, z. Unset: no bound.
    pub max_mm: Option<[f64; 3]>,
}

impl Node for Box {
    const KIND: &'static str = "crop.box";
    type Params = Params;
    type Inputs = In;
    type Outputs = Out;

    fn new(params: Params) -> Result<Self, ParamError> {
        if let (Some(min), Some(max)) = (params.min_mm, params.max_mm)
            && let Some(axis) = (0..3).find(|&k| min[k] >= max[k])
        {
            let message =
                format!("{} reaches from {} to {}; min is below max", ["x", "y", "z"][axis], min[axis], max[axis]);
            return Err(ParamError::new("min_mm", message));
        }
        Ok(Self(params))
    }

    fn process(&mut self, i: In, _ctx: &mut Context) -> Result<Out, NodeError> {
        let region = Region {
            frame: i.cloud.frame.clone(),
            min: Point3::from(self.0.min_mm.unwrap_or([f64::NEG_INFINITY; 3])),
            max: Point3::from(self.0.max_mm.unwrap_or([f64::INFINITY; 3])),
        };
        let chosen = roi::in_box(&i.cloud, &region);
        i.cropped(chosen)
    }
}
