//! White noise.

use osteoflow_simulation::ProcedureParams;

/// The default procedure, but with white noise without outliers, by which the tables of one algorithm in the docs are drawn.
pub(crate) fn white_noise() -> ProcedureParams {
    let mut params = ProcedureParams::default();
    let camera = &mut params.camera;
    (camera.surface_error_mm, camera.edge_outliers) = (0.0, 0.0);
    let tracker = &mut params.tracker;
    (tracker.noise_lag1, tracker.step_mm, tracker.repeats) = (0.0, 0.0, 0.0);
    params
}
