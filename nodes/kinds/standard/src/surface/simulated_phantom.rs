//! The kind `surface.simulated_phantom`.

use osteoflow_geometry::Mesh;
use osteoflow_node::{Context, Describe, NodeError, Outputs, ParamError, Source};
use osteoflow_simulation::phantom;

/// The built-in calibration phantom's CAD.
#[derive(Describe)]
#[describe(example = r#"
kind = "surface.simulated_phantom"
"#)]
pub struct SimulatedPhantom {
    done: bool,
}

/// Outputs of [`SimulatedPhantom`].
#[derive(Outputs)]
pub struct Out {
    /// The CAD's surface, once.
    #[port(frame = "@phantom")]
    mesh: Mesh,
}

impl Source for SimulatedPhantom {
    const KIND: &'static str = "surface.simulated_phantom";
    const CONSTANT: bool = true;
    type Params = crate::NoParams;
    type Outputs = Out;

    fn new(_: crate::NoParams) -> Result<Self, ParamError> {
        Ok(Self { done: false })
    }

    fn next(&mut self, _ctx: &mut Context) -> Result<Option<Out>, NodeError> {
        Ok((!std::mem::replace(&mut self.done, true)).then(|| Out { mesh: phantom::mesh() }))
    }
}
