//! The kind `surface.prepare_cloud`.

use crate::NoParams;
use osteoflow_algorithms::{normals, target::Target};
use osteoflow_geometry::{Cloud, SurfaceOrigin};
use osteoflow_node::{Context, Describe, Inputs, Kept, Node, NodeError, Outputs, ParamError};
use osteoflow_payloads::Text;

/// The points of a surface prepared for registration, where there are no faces; their normals are estimated where missing.
///
/// Estimated normals point outwards if the surface is closed. Of an open one they agree with each other, but their side is a
/// guess: distances along them do not mind, but a source that knows its camera pairs with the side that faces it, so give
/// the cloud normals by cloud.normals there.
#[derive(Describe)]
#[describe(
    example = r#"
kind = "surface.prepare_cloud"
in   = { cloud = "ct_points.cloud" }
"#,
    literature = ["Hoppe et al. 1992, sections 3.2 and 3.3"]
)]
pub struct PrepareCloud;

/// Inputs of [`PrepareCloud`].
#[derive(Inputs)]
pub struct In {
    /// Points all over the surface.
    #[port(join = "once")]
    cloud: Cloud,
}

/// Outputs of [`PrepareCloud`].
#[derive(Outputs)]
pub struct Out {
    /// Points, normals, and the cells that they are found by.
    #[port(frame = "cloud")]
    target: Target,
    /// Where the surface comes from: `user`.
    ct_surface: Text,
}

impl Node for PrepareCloud {
    const KIND: &'static str = "surface.prepare_cloud";
    const KEPT: Kept = Kept::ByInputs;
    type Params = NoParams;
    type Inputs = In;
    type Outputs = Out;

    fn new(_: NoParams) -> Result<Self, ParamError> {
        Ok(Self)
    }

    fn process(&mut self, i: In, _ctx: &mut Context) -> Result<Out, NodeError> {
        let normals = match i.cloud.normal_column() {
            Some(given) => given.clone(),
            None => normals::of_surface(i.cloud.points())?.into(),
        };
        let origin = SurfaceOrigin::User;
        let target = Target::new(&i.cloud.frame, origin, i.cloud.point_column().clone(), Some(normals))?;
        target.prepare();
        Ok(Out { target, ct_surface: Text(origin.to_string().into()) })
    }
}
