//! The kind `cloud.downsample`.

use osteoflow_algorithms::downsample;
use osteoflow_geometry::Cloud;
use osteoflow_node::{
    Context, Describe, Inputs, Node, NodeError, Outputs, ParamError, schemars::JsonSchema, serde::Deserialize,
};

/// A cloud with fewer points: one in each cell of a grid, or every n-th.
#[derive(Describe)]
#[describe(example = r#"
kind = "cloud.downsample"
in   = { cloud = "to_bone.cloud" }
cell_mm = 0.5
"#)]
pub struct Downsample(Params);

/// Parameters of [`Downsample`].
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields, crate = "osteoflow_node::serde")]
#[schemars(crate = "osteoflow_node::schemars")]
pub struct Params {
    /// One point is kept in each cube of this edge: the one nearest to the mean. 0: no grid.
    #[schemars(range(min = 0.0, max = 1000.0))]
    pub cell_mm: f64,
    /// Then every n-th point is kept, in order. 1: all.
    #[schemars(range(min = 1, max = 1_000_000))]
    pub every: usize,
}

impl Default for Params {
    fn default() -> Self {
        Self { cell_mm: 0.0, every: 1 }
    }
}

/// Inputs of [`Downsample`].
#[derive(Inputs)]
pub struct In {
    /// The cloud.
    cloud: Cloud,
}

/// Outputs of [`Downsample`].
#[derive(Outputs)]
pub struct Out {
    /// The points that were kept.
    #[port(frame = "cloud")]
    cloud: Cloud,
}

impl Node for Downsample {
    const KIND: &'static str = "cloud.downsample";
    type Params = Params;
    type Inputs = In;
    type Outputs = Out;

    fn new(params: Params) -> Result<Self, ParamError> {
        Ok(Self(params))
    }

    fn process(&mut self, i: In, _ctx: &mut Context) -> Result<Out, NodeError> {
        let thinned = i.cloud.selected(&downsample::voxel(&i.cloud, self.0.cell_mm));
        Ok(Out { cloud: thinned.selected(&downsample::every(&thinned, self.0.every)) })
    }
}
