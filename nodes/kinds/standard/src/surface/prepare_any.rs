//! The kind `surface.prepare_any`.

use super::{prepare, prepare_cloud};
use osteoflow_algorithms::target::Target;
use osteoflow_geometry::{Cloud, Mesh};
use osteoflow_node::{CachePolicy, Context, Describe, Function, Inputs, NodeError, Outputs};

/// A surface, or points of it, prepared for registration.
///
/// A surface is prepared as by `surface.prepare`, which has the same parameters. Points are prepared as by
/// `surface.prepare_cloud`: all of them are used, and missing normals are estimated.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "surface.prepare_any"
in   = { mesh = "bone.mesh", points = "bone.points" }
"#,
    literature = ["Hoppe et al. 1992, sections 3.2 and 3.3"]
)]
pub struct PrepareAny;

/// Inputs of [`PrepareAny`].
#[derive(Inputs)]
pub struct In {
    /// The surface.
    #[port(join = "once", frame = "points")]
    mesh: Option<Mesh>,
    /// Points all over the surface.
    #[port(join = "once", frame = "mesh")]
    points: Option<Cloud>,
}

/// Outputs of [`PrepareAny`].
#[derive(Outputs)]
pub struct Out {
    /// Points, normals, the grid that finds them, and the surface if there is one.
    #[port(frame = "mesh")]
    target: Target,
}

impl Function for PrepareAny {
    const KIND: &'static str = "surface.prepare_any";
    const CACHE: CachePolicy = CachePolicy::ByInputsAndSeed;
    type Params = prepare::Params;
    type Inputs = In;
    type Outputs = Out;

    fn process(params: &prepare::Params, i: In, ctx: &mut Context) -> Result<Out, NodeError> {
        let target = match (&i.mesh, &i.points) {
            (Some(mesh), None) => params.prepare(mesh, ctx)?,
            (None, Some(points)) => prepare_cloud::prepare(points)?,
            (None, None) => return Err(NodeError::new("there is neither a surface nor points of one")),
            (Some(_), Some(_)) => {
                return Err(NodeError::new("there are a surface and points of one; wire one of them"));
            }
        };
        Ok(Out { target })
    }
}
