//! The kind `crop.polygon`.

use super::{In, Out};
use osteoflow_algorithms::roi;
use osteoflow_geometry::nalgebra::Point2;
use osteoflow_node::{Context, Describe, Node, NodeError, ParamError, schemars::JsonSchema, serde::Deserialize};

/// The points that the camera sees inside a polygon.
///
/// The corners are directions from the camera: `x / z`, `y / z` in its frame (x right, y down, z forward), so a polygon drawn
/// on the camera's image applies at any depth.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "crop.polygon"
in   = { cloud = "recording.scan" }
corners = [[-0.3, -0.1], [0.3, -0.1], [0.3, 0.1], [-0.3, 0.1]]
"#,
    literature = ["section 2.3 of the paper"]
)]
pub struct Polygon(Params);

/// Parameters of [`Polygon`].
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Params {
    /// The corners in order, three or more: `x / z` and `y / z`, without unit.
    pub corners: Vec<[f64; 2]>,
}

impl Node for Polygon {
    const KIND: &'static str = "crop.polygon";
    type Params = Params;
    type Inputs = In;
    type Outputs = Out;

    fn new(params: Params) -> Result<Self, ParamError> {
        if params.corners.len() < 3 {
            let message = format!("a polygon has at least 3 corners, but there are {}", params.corners.len());
            return Err(ParamError::new("corners", message));
        }
        Ok(Self(params))
    }

    fn process(&mut self, i: In, _ctx: &mut Context) -> Result<Out, NodeError> {
        let corners: Vec<Point2<f64>> = self.0.corners.iter().map(|&c| c.into()).collect();
        let chosen = roi::in_polygon(&i.cloud, &corners)?;
        i.cropped(chosen)
    }
}
