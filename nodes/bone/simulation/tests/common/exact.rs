//! A procedure without errors.

use super::ProcedureParams;

/// The procedure without any error: no noise, nothing missing but the laser's hole, nothing mismounted. Intended
/// motions remain.
pub(crate) fn without_errors(mut params: ProcedureParams) -> ProcedureParams {
    let camera = &mut params.camera;
    (camera.depth_noise_mm, camera.depth_bias_mm, camera.unit_factor) = (0.0, 0.0, 1.0);
    (camera.surface_error_mm, camera.edge_outliers) = (0.0, 0.0);
    (camera.scale_percent, camera.depth_percent) = (0.0, 0.0);
    (camera.dropout, camera.specular_dropout, camera.n_patches, camera.n_pools) = (0.0, 0.0, 0, 0);
    let tracker = &mut params.tracker;
    (tracker.lost, tracker.drift_mm_per_min, tracker.late_s) = (0.0, 0.0, 0.0);
    (tracker.lost_run, tracker.noise_lag1, tracker.step_mm, tracker.repeats) = (0.0, 0.0, 0.0, 0.0);
    (tracker.placement_mm, tracker.placement_deg, tracker.noise_mm, tracker.noise_deg) = (0.0, 0.0, 0.0, 0.0);
    let laser = &mut params.laser;
    (laser.aim_across_mm, laser.aim_along_mm) = (0.0, 0.0);
    laser.swap.clear();
    let image = &mut params.image;
    (image.n_glare, image.reflection, image.noise_levels) = (0, 0.0, 0.0);
    let phantom = &mut params.phantom;
    (phantom.print_mm, phantom.print_deg, phantom.mounting_mm, phantom.mounting_deg) = (0.0, 0.0, 0.0, 0.0);
    (phantom.scan_scale, phantom.scan_mirrored) = (1.0, false);
    (phantom.marker_cad_wrong_mm, phantom.marker_cad_wrong_deg) = (0.0, 0.0);
    let stylus = &mut params.stylus;
    (stylus.tip_mm, stylus.touch_mm, stylus.dimple_mm) = (0.0, 0.0, 0.0);
    (stylus.palpation_bias_mm, stylus.palpation_mm) = (0.0, 0.0);
    (params.check.reading_mm, params.check.print_mm) = (0.0, 0.0);
    params.ruler = Default::default();
    (params.periosteum.grows_mm, params.periosteum.around_mm) = (0.0, 0.0);
    (params.periosteum.thickness_mm, params.tissue.share) = (0.0, 0.0);
    let motion = &mut params.motion;
    (motion.marker_slip_mm, motion.marker_slip_deg, motion.knock_mm, motion.knock_deg) = (0.0, 0.0, 0.0, 0.0);
    params
}
