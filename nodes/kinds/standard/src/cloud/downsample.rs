//! The kind `cloud.downsample`.

use super::{In, Out};
use osteoflow_algorithms::downsample;
use osteoflow_node::{Context, Describe, Function, NodeError, schemars::JsonSchema, serde::Deserialize};

/// A cloud with fewer points: one in each cell of a grid, every n-th, or a given number.
///
/// The three steps are applied in this order; each is off by default.
#[derive(Describe)]
#[describe(example = r#"
kind = "cloud.downsample"
in   = { cloud = "to_bone.cloud" }
n_points = 2000
pick     = "random"
"#)]
pub struct Downsample;

/// Parameters of [`Downsample`].
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// One point is kept in each cube of this edge: the one nearest to the mean. 0: no grid.
    #[schemars(range(min = 0.0, max = 1000.0))]
    pub cell_mm: f64,
    /// Then every n-th point is kept, in order. 1: all.
    #[schemars(range(min = 1, max = 1_000_000))]
    pub every: usize,
    /// Then this number of points is kept, in order. 0: all. A cloud with fewer keeps all, with a warning.
    #[schemars(range(min = 0, max = 100_000_000))]
    pub n_points: usize,
    /// The points that are kept. `stride`: at even steps through the cloud's order. `random`: drawn from the run's seed, with
    /// equal probability for every set.
    pub pick: Pick,
}

/// The choice of a given number of points.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Pick {
    /// At even steps through the cloud's order.
    #[default]
    Stride,
    /// Drawn from the run's seed.
    Random,
}

impl Default for Params {
    fn default() -> Self {
        Self { cell_mm: 0.0, every: 1, n_points: 0, pick: Pick::Stride }
    }
}

impl Function for Downsample {
    const KIND: &'static str = "cloud.downsample";
    type Params = Params;
    type Inputs = In;
    type Outputs = Out;

    fn process(params: &Params, i: In, ctx: &mut Context) -> Result<Out, NodeError> {
        let thinned = i.cloud.selected(&downsample::voxel(&i.cloud, params.cell_mm));
        let thinned = thinned.selected(&downsample::every(&thinned, params.every));
        let (n, found) = (params.n_points, thinned.len());
        if n == 0 {
            return Ok(Out { cloud: thinned });
        }
        if n > found {
            ctx.warn(format!("{n} points are asked for, but there are {found}: all are kept"));
        }
        let kept = match params.pick {
            Pick::Stride => downsample::evenly(&thinned, n),
            Pick::Random => downsample::drawn(&thinned, n, &mut ctx.rng()),
        };
        Ok(Out { cloud: thinned.selected(&kept) })
    }
}
