//! The kind `plan.landmarks`.

use osteoflow_algorithms::{
    landmarks::{RecipeParams, paper_recipe},
    mesh_query::MeshQuery,
};
use osteoflow_geometry::{Anatomy, Mesh, Points, direction};
use osteoflow_node::{
    Context, Describe, Inputs, Node, NodeError, Outputs, ParamError, schemars::JsonSchema, serde::Deserialize,
};

/// The landmarks P1..P3 by the paper's recipe, on any bone whose malleolus and sides are known.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "plan.landmarks"
in   = { mesh = "bone.mesh" }
malleolus_tip_mm = [-92.7, -85.2, -1054.9]
proximal  = [0.0, 0.0, 1.0]
lateral   = [-1.0, 0.0, 0.0]
posterior = [0.0, 1.0, 0.0]
"#,
    literature = ["section 2.3 of the paper"]
)]
pub struct Landmarks {
    anatomy: Anatomy,
    recipe: RecipeParams,
}

/// Parameters of [`Landmarks`].
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Params {
    /// The tip of the lateral malleolus, in the surface's frame.
    pub malleolus_tip_mm: [f64; 3],
    /// Towards the knee, of any length.
    pub proximal: [f64; 3],
    /// Away from the body's middle, of any length.
    pub lateral: [f64; 3],
    /// Towards the back, of any length.
    pub posterior: [f64; 3],
    /// Distances along the bone.
    #[serde(default)]
    pub recipe: RecipeParams,
}

/// Inputs of [`Landmarks`].
#[derive(Inputs)]
pub struct In {
    /// The bone's surface.
    #[port(join = "once")]
    mesh: Mesh,
}

/// Outputs of [`Landmarks`].
#[derive(Outputs)]
pub struct Out {
    /// P1, P2, P3 on the surface.
    #[port(frame = "mesh")]
    landmarks: Points,
}

impl Node for Landmarks {
    const KIND: &'static str = "plan.landmarks";
    type Params = Params;
    type Inputs = In;
    type Outputs = Out;

    fn new(params: Params) -> Result<Self, ParamError> {
        let unit =
            |name: &str, v: [f64; 3]| direction(v.into()).map_err(|error| ParamError::new(name, error.to_string()));
        let anatomy = Anatomy {
            malleolus_tip: params.malleolus_tip_mm.into(),
            proximal: unit("proximal", params.proximal)?,
            lateral: unit("lateral", params.lateral)?,
            posterior: unit("posterior", params.posterior)?,
        };
        Ok(Self { anatomy, recipe: params.recipe })
    }

    fn process(&mut self, i: In, _ctx: &mut Context) -> Result<Out, NodeError> {
        let points = paper_recipe(&MeshQuery::new(&i.mesh), &self.anatomy, &self.recipe)?;
        Ok(Out { landmarks: Points::new(&i.mesh.frame, points) })
    }
}
