//! The kind `cloud.downsample`.

use super::{In, Out};
use osteoflow_algorithms::downsample;
use osteoflow_node::{Context, Describe, NodeError, function, params, schemars::JsonSchema, serde::Deserialize};

/// A cloud with fewer points: one in each cell of a grid, every n-th, or a given number.
///
/// The four steps are applied in the order of their parameters; each is off by default.
#[derive(Describe)]
#[describe(example = r#"
kind = "cloud.downsample"
in   = { cloud = "to_bone.cloud" }
n_points = 2000
pick     = "random"
"#)]
pub struct Downsample;

/// Parameters of [`Downsample`].
#[params]
#[derive(Debug, Clone, Deserialize, JsonSchema)]
pub struct Params {
    /// One point is kept in each cube of this edge: the one nearest to the mean. 0: no grid.
    #[param(0.0, 0.0..=1000.0)]
    pub cell_mm: f64,
    /// Then every n-th point is kept, in order. 1: all.
    #[param(1, 1..=1_000_000)]
    pub every: usize,
    /// Then, of a larger cloud, every n-th point is kept, with the least n that leaves no more than this; a warning says so. 0:
    /// all. 100000 is ample for a registration: the mean of as many residuals of 0.1 mm is known to 0.0003 mm, a twentieth of
    /// the error that the surface leaves.
    #[param(0, 0..=100_000_000)]
    pub max_points: usize,
    /// Then this number of points is kept, in order; a cloud with fewer keeps all, with a warning. 0: all.
    #[param(0, 0..=100_000_000)]
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

#[function("cloud.downsample")]
impl Downsample {
    fn process(params: &Params, i: In, ctx: &mut Context) -> Result<Out, NodeError> {
        let thinned =
            if params.cell_mm > 0.0 { i.cloud.selected(&downsample::voxel(&i.cloud, params.cell_mm)) } else { i.cloud };
        let thinned =
            if params.every > 1 { thinned.selected(&downsample::every(&thinned, params.every)) } else { thinned };
        let (n_max, n_all) = (params.max_points, thinned.len());
        let thinned = if n_max > 0 && n_all > n_max {
            let every = n_all.div_ceil(n_max);
            let fewer = thinned.selected(&downsample::every(&thinned, every));
            ctx.warn(format!(
                "1 in {every} of {n_all} points is used, {} in all: more would move the pose by less than its standard error; \
                 max_points = 0 takes all",
                fewer.len()
            ));
            fewer
        } else {
            thinned
        };
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

#[cfg(test)]
mod tests {
    use super::*;
    use osteoflow_geometry::{Cloud, nalgebra::Point3};
    use osteoflow_node::Function;

    #[test]
    fn of_more_points_than_the_maximum_every_nth_is_kept_and_a_warning_says_so() {
        let thinned = |n: u32, max_points: usize| {
            let points: Vec<_> = (0..n).map(|k| Point3::new(f64::from(k), 0.0, 0.0)).collect();
            let (cloud, mut ctx) = (Cloud::new("camera", points).expect("a cloud"), Context::for_test("thin"));
            let params = Params { max_points, ..Params::default() };
            let out = Downsample::process(&params, In { cloud }, &mut ctx).expect("a cloud");
            let xs: Vec<f64> = out.cloud.points().iter().map(|p| p.x).collect();
            (xs, ctx.take_warnings())
        };
        assert_eq!(thinned(10, 10), ((0..10).map(f64::from).collect(), Vec::new()));
        assert_eq!(thinned(10, 0).0.len(), 10);
        let (xs, warnings) = thinned(11, 4);
        assert_eq!(xs, [0.0, 3.0, 6.0, 9.0]);
        assert!(warnings[0].starts_with("1 in 3 of 11 points is used, 4 in all"), "{warnings:?}");
    }
}
