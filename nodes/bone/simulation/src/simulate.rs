//! Simulates a whole procedure.

use crate::scene::Scene;
use crate::{Procedure, ProcedureParams, ScanStream, SimulationError, StreamParams, Subject, phantom, ranges};

impl Procedure {
    /// A procedure on the built-in bone. The same parameters and seed give the same bits on any number of threads.
    ///
    /// # Errors
    /// [`SimulationError`] if a parameter is out of range or nothing is visible.
    pub fn simulate(params: &ProcedureParams, seed: u64) -> Result<Self, SimulationError> {
        Self::simulate_for(&Subject::built_in(&params.bone)?, params, seed)
    }

    /// A procedure on a subject, which can be reused, calibrated with the built-in phantom. `params.bone` is not used.
    ///
    /// The built-in marker poses are used if the plan has none.
    ///
    /// # Errors
    /// As [`Procedure::simulate`]; and if the plan has no anatomy, fewer than three landmarks or no assessment point,
    /// or is in another frame than the bone.
    pub fn simulate_for(subject: &Subject, params: &ProcedureParams, seed: u64) -> Result<Self, SimulationError> {
        params.check()?;
        Scene::new(&subject.surface, &subject.plan, &phantom::mesh(), params, seed)?.run()
    }

    /// Scans of the moving bone in the procedure of the same subject, parameters and seed.
    ///
    /// # Errors
    /// As [`Procedure::simulate_for`].
    pub fn stream_for(
        subject: &Subject,
        params: &ProcedureParams,
        stream: &StreamParams,
        seed: u64,
    ) -> Result<ScanStream, SimulationError> {
        params.check()?;
        ranges::check("stream", stream)?;
        Scene::new(&subject.surface, &subject.plan, &phantom::mesh(), params, seed)?.stream(stream)
    }
}
