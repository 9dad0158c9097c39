//! The kind `surface.simulated_phantom`.

use crate::constant::Constant;
use osteoflow_geometry::Mesh;
use osteoflow_node::{Context, Describe, NodeError, Outputs};
use osteoflow_simulation::phantom;

/// The built-in calibration phantom's CAD.
#[derive(Describe)]
#[describe(example = r#"
kind = "surface.simulated_phantom"
"#)]
pub struct SimulatedPhantom;

/// Outputs of [`SimulatedPhantom`].
#[derive(Outputs)]
pub struct Out {
    /// The CAD's surface, once.
    #[port(frame = "@phantom")]
    mesh: Mesh,
}

impl Constant for SimulatedPhantom {
    const KIND: &'static str = "surface.simulated_phantom";
    type Params = crate::NoParams;
    type Outputs = Out;

    fn read(_: &crate::NoParams, _ctx: &mut Context) -> Result<Out, NodeError> {
        Ok(Out { mesh: phantom::mesh() })
    }
}
