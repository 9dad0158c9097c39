//! The kind `crop.slab`.

use super::{In, Out};
use osteoflow_algorithms::roi;
use osteoflow_geometry::{
    direction,
    nalgebra::{Point3, Unit, Vector3},
};
use osteoflow_node::{Context, Describe, Node, NodeError, ParamError, schemars::JsonSchema, serde::Deserialize};

/// The points between two planes across the bone.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "crop.slab"
in   = { cloud = "to_ct.cloud" }
origin_mm = [0.0, 0.0, 0.0]
direction = [0.0, 0.0, 1.0]
from_mm = -50.0
to_mm = 50.0
"#,
    literature = ["section 2.3 of the paper"]
)]
pub struct Slab {
    params: Params,
    origin: Point3<f64>,
    direction: Unit<Vector3<f64>>,
}

/// Parameters of [`Slab`].
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Params {
    /// The point of height 0, in the cloud's frame.
    pub origin_mm: [f64; 3],
    /// The direction along the bone, of any length.
    pub direction: [f64; 3],
    /// The lower height along the direction.
    pub from_mm: f64,
    /// The upper height.
    pub to_mm: f64,
}

impl Node for Slab {
    const KIND: &'static str = "crop.slab";
    type Params = Params;
    type Inputs = In;
    type Outputs = Out;

    fn new(params: Params) -> Result<Self, ParamError> {
        let direction =
            direction(params.direction.into()).map_err(|error| ParamError::new("direction", error.to_string()))?;
        if params.from_mm >= params.to_mm {
            return Err(ParamError::new("from_mm", "from_mm is below to_mm"));
        }
        Ok(Self { origin: params.origin_mm.into(), direction, params })
    }

    fn process(&mut self, i: In, _ctx: &mut Context) -> Result<Out, NodeError> {
        let Params { from_mm, to_mm, .. } = self.params;
        let chosen = roi::in_slab(&i.cloud, &self.origin, &self.direction, from_mm, to_mm);
        i.cropped(chosen)
    }
}
