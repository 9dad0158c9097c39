//! The kind `surface.prepare`.

use osteoflow_algorithms::{mesh_query::MeshQuery, sample, target::Target};
use osteoflow_geometry::Mesh;
use osteoflow_node::{
    CachePolicy, Context, Describe, Function, Inputs, NodeError, Outputs, schemars::JsonSchema, serde::Deserialize,
};
use osteoflow_payloads::Text;

/// A surface prepared for registration: points sampled uniformly by area, their normals, a search grid, and the surface itself.
///
/// Prepared once and shared by all registrations onto it. Sampling is seeded by the run.
#[derive(Describe)]
#[describe(example = r#"
kind = "surface.prepare"
in   = { mesh = "bone.mesh" }
n_points = 150000
"#)]
pub struct Prepare;

/// Minimum number of points.
const MIN_POINTS: usize = 100;
/// Maximum number of points, for the memory they take.
const MAX_POINTS: usize = 10_000_000;

/// Parameters of [`Prepare`].
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// Number of points. 150000: one in 0.3 mm on a whole fibula, as dense as a structured-light scan.
    #[schemars(range(min = MIN_POINTS, max = MAX_POINTS))]
    pub n_points: usize,
    /// Spacing of the points, mm: one for each square of this edge, whatever the surface's size, instead of `n_points`.
    /// 0: `n_points` decides.
    #[schemars(range(min = 0.0, max = 100.0))]
    pub spacing_mm: f64,
}

impl Default for Params {
    fn default() -> Self {
        Self { n_points: 150_000, spacing_mm: 0.0 }
    }
}

impl Params {
    /// Samples a surface and prepares it.
    pub(super) fn prepare(&self, mesh: &Mesh, ctx: &mut Context) -> Result<Target, NodeError> {
        let samples = sample::surface(mesh, self.n_points_on(mesh.area_mm2())?, &mut ctx.rng());
        let target = Target::new(&mesh.frame, mesh.origin, samples.points, Some(samples.normals.into()))?;
        let target = target.with_mesh(MeshQuery::new(mesh));
        target.prepare();
        Ok(target)
    }

    /// Number of points on a surface of this area.
    fn n_points_on(&self, area_mm2: f64) -> Result<usize, NodeError> {
        if self.spacing_mm == 0.0 {
            return Ok(self.n_points);
        }
        let n = (area_mm2 / (self.spacing_mm * self.spacing_mm)).round();
        if (MIN_POINTS as f64..=MAX_POINTS as f64).contains(&n) {
            return Ok(n as usize);
        }
        Err(NodeError::new(format!(
            "spacing_mm = {} asks for {n} points on {area_mm2:.0} mm2, {MIN_POINTS} to {MAX_POINTS} are possible; set \
             another spacing_mm, or n_points",
            self.spacing_mm
        )))
    }
}

/// Inputs of [`Prepare`].
#[derive(Inputs)]
pub struct In {
    /// The surface.
    #[port(join = "once")]
    mesh: Mesh,
}

/// Outputs of [`Prepare`].
#[derive(Outputs)]
pub struct Out {
    /// Points, normals, the grid that finds them, and the surface.
    #[port(frame = "mesh")]
    target: Target,
    /// Where the surface comes from: `exact`, `simulated_ct` or `user`.
    ct_surface: Text,
}

impl Function for Prepare {
    const KIND: &'static str = "surface.prepare";
    const CACHE: CachePolicy = CachePolicy::ByInputsAndSeed;
    type Params = Params;
    type Inputs = In;
    type Outputs = Out;

    fn process(params: &Params, i: In, ctx: &mut Context) -> Result<Out, NodeError> {
        let target = params.prepare(&i.mesh, ctx)?;
        Ok(Out { target, ct_surface: Text(i.mesh.origin.to_string().into()) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_are_as_far_apart_as_asked_for_whatever_the_surfaces_size_or_refused() {
        let n = |spacing_mm, area_mm2| Params { spacing_mm, ..Params::default() }.n_points_on(area_mm2);
        assert_eq!(n(0.25, 14_309.0).unwrap(), 228_944);
        assert_eq!(n(0.25, 2.0 * 14_309.0).unwrap(), 457_888);
        assert_eq!(n(0.0, 14_309.0).unwrap(), 150_000);
        for spacing in [0.01, 50.0] {
            let message = n(spacing, 14_309.0).unwrap_err().to_string();
            assert!(message.contains("mm2, 100 to 10000000 are possible"), "{message}");
        }
    }
}
