//! The kind `surface.prepare`.

use osteoflow_algorithms::{
    field::{ClosestPointField, FieldParams},
    mesh_query::MeshQuery,
    sample,
    target::Target,
};
use osteoflow_geometry::Mesh;
use osteoflow_node::{
    Context, Describe, Inputs, Kept, Node, NodeError, Outputs, ParamError, schemars::JsonSchema, serde::Deserialize,
};
use osteoflow_payloads::Text;

/// A surface prepared for registration: points drawn evenly by area, their normals, what finds them, and the surface itself.
///
/// Prepared once and shared by all who register onto it. The draw is seeded by the run.
#[derive(Describe)]
#[describe(example = r#"
kind = "surface.prepare"
in   = { mesh = "bone.mesh" }
n_points = 150000
"#)]
pub struct Prepare(Params);

/// Fewer points are no surface.
const MIN_POINTS: usize = 100;
/// More do not fit into memory beside all else.
const MAX_POINTS: usize = 10_000_000;

/// Parameters of [`Prepare`].
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields, crate = "osteoflow_node::serde")]
#[schemars(crate = "osteoflow_node::schemars")]
pub struct Params {
    /// How many points are drawn. 150000: one in 0.3 mm on a whole fibula, as dense as a structured-light scan.
    #[schemars(range(min = MIN_POINTS, max = MAX_POINTS))]
    pub n_points: usize,
    /// How far apart they lie, mm: one for each square of this edge, whatever the surface's size, in the place of
    /// `n_points`. 0: as many as that says.
    #[schemars(range(min = 0.0, max = 100.0))]
    pub spacing_mm: f64,
    /// Whether a closest-point field of the surface is made, for registration with `pairing = "field"`. Off: it takes
    /// about half a second and some megabytes, and is kept between runs.
    pub field: bool,
}

impl Default for Params {
    fn default() -> Self {
        Self { n_points: 150_000, spacing_mm: 0.0, field: false }
    }
}

impl Params {
    fn n_points_on(&self, mesh: &Mesh) -> usize {
        if self.spacing_mm == 0.0 {
            return self.n_points;
        }
        let n = (mesh.area_mm2() / (self.spacing_mm * self.spacing_mm)).round();
        (n as usize).clamp(MIN_POINTS, MAX_POINTS)
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
    /// Points, normals, the cells that they are found by, the surface, and its field where asked for.
    #[port(frame = "mesh")]
    target: Target,
    /// Where the surface comes from: `exact`, `simulated_ct` or `user`.
    ct_surface: Text,
}

impl Node for Prepare {
    const KIND: &'static str = "surface.prepare";
    const KEPT: Kept = Kept::ByInputsAndSeed;
    type Params = Params;
    type Inputs = In;
    type Outputs = Out;

    fn new(params: Params) -> Result<Self, ParamError> {
        Ok(Self(params))
    }

    fn process(&mut self, i: In, ctx: &mut Context) -> Result<Out, NodeError> {
        let samples = sample::surface(&i.mesh, self.0.n_points_on(&i.mesh), &mut ctx.rng());
        let target = Target::new(&i.mesh.frame, i.mesh.origin, samples.points, Some(samples.normals.into()))?;
        let mesh = MeshQuery::new(&i.mesh);
        let mut target = target.with_mesh(mesh.clone());
        if self.0.field {
            target = target.with_field(ClosestPointField::of_mesh(&mesh, &FieldParams::default())?);
        }
        target.prepare();
        Ok(Out { target, ct_surface: Text(i.mesh.origin.to_string().into()) })
    }
}
