//! What a simulated procedure promises, measured from its clouds and streams against the exact surface.

use crate::common::shared::simulate;
use crate::common::white::white_noise;
use osteoflow_algorithms::hole::{HoleParams, cloud_difference};
use osteoflow_algorithms::mesh_query::MeshQuery;
use osteoflow_geometry::nalgebra::{Isometry3, Point3};
use osteoflow_geometry::{Cloud, Mesh, Pose, StampNs, SurfaceOrigin};
use osteoflow_simulation::{
    CameraParams, CtParams, Procedure, ProcedureParams, SimulationError, Subject, TrackerParams, ct_surface, plan,
};

fn without_errors() -> ProcedureParams {
    crate::common::exact::without_errors(ProcedureParams::default())
}

/// The pose of a stream at a moment, interpolated between its neighbours as a node would.
fn at(stream: &[Pose], stamp_ns: StampNs) -> Isometry3<f64> {
    let next = stream.iter().position(|p| p.stamp_ns >= stamp_ns).expect("the stream reaches the moment");
    let (a, b) = (&stream[next - 1], &stream[next]);
    let share = (stamp_ns - a.stamp_ns) as f64 / (b.stamp_ns - a.stamp_ns) as f64;
    Pose::interpolate(a, b, share).unwrap().isometry
}

/// Greatest distance of a cloud's points from a surface, mm.
fn worst_off(cloud: &Cloud, t_surface_cloud: &Isometry3<f64>, surface: &Mesh) -> f64 {
    let surface = MeshQuery::new(surface);
    cloud
        .points()
        .iter()
        .map(|p| surface.closest_point(&(t_surface_cloud * p)).unwrap().distance_mm)
        .fold(0.0, f64::max)
}

/// Errors of a cloud along its rays (mm, positive away from the camera) with the cosine of the incidence.
fn along_rays(cloud: &Cloud, t_surface_camera: &Isometry3<f64>, surface: &Mesh) -> Vec<(f64, f64)> {
    let surface = MeshQuery::new(surface);
    let camera = Point3::from(t_surface_camera.translation.vector);
    cloud
        .points()
        .iter()
        .filter_map(|p| {
            let ray = t_surface_camera * p.coords.normalize();
            // A ray just beside an edge of the outline may miss the mesh by rounding.
            let hit = surface.cast_ray(&camera, &ray)?;
            Some((p.coords.norm() - hit.distance_mm, -ray.dot(&hit.normal)))
        })
        .collect()
}

fn t_ct_camera(procedure: &Procedure) -> Isometry3<f64> {
    procedure.truth.t_world_ct_at_scan.isometry.inverse() * procedure.truth.t_world_camera_at_scan.isometry
}

fn rms(values: impl IntoIterator<Item = f64>) -> f64 {
    let (sum, n) = values.into_iter().fold((0.0, 0usize), |(sum, n), v| (sum + v * v, n + 1));
    (sum / n as f64).sqrt()
}

#[test]
fn without_errors_the_streams_alone_carry_every_cloud_onto_its_surface() {
    for seed in [1, 2] {
        let procedure = simulate(&without_errors(), seed);
        let scan = procedure.scan.stamp_ns;
        let truth = &procedure.truth;
        assert_eq!(procedure.scan.len(), 20_000);

        // Equation 1, from the streams at the calibration; the phantom's own pose is checked by its scan.
        let calibration = procedure.phantom_scan.stamp_ns;
        let t_c_p = truth.t_camera_phantom.isometry;
        let t_w_mp = at(&procedure.phantom_marker, calibration);
        let t_w_mc = at(&procedure.camera_marker, calibration);
        let t_c_mc = t_c_p * procedure.t_phantom_phantom_marker.isometry * t_w_mp.inverse() * t_w_mc;
        let off = t_c_mc.inverse() * truth.t_camera_camera_marker.isometry;
        assert!(off.translation.vector.norm() < 1e-9 && off.rotation.angle() < 1e-9, "equation 1 is off by {off}");
        assert!(worst_off(&procedure.phantom_scan, &t_c_p.inverse(), &procedure.phantom) < 1e-9);

        // camera -> camera marker -> world -> bone marker -> ct, each from its stream at the cloud's moment.
        for cloud in procedure.laser.iter().chain([&procedure.scan]) {
            let t_world_camera = at(&procedure.camera_marker, cloud.stamp_ns) * t_c_mc.inverse();
            let t_ct_world = truth.t_ct_bone_marker.isometry * at(&procedure.bone_marker, cloud.stamp_ns).inverse();
            let off = worst_off(cloud, &(t_ct_world * t_world_camera), &truth.bone);
            assert!(off < 1e-8, "{off} mm off the bone");
        }
        let end = procedure.bone_marker.last().unwrap();
        let t_world_ct = end.isometry * truth.t_ct_bone_marker.isometry.inverse();
        let moved = t_world_ct.inverse() * truth.t_world_ct_after_motion.isometry;
        assert!(moved.translation.vector.norm() < 1e-9, "the truth after the motion is the stream's: {moved}");
        let between = truth.t_world_ct_at_scan.isometry.inverse() * truth.t_world_ct_after_motion.isometry;
        assert!((between.rotation.angle().to_degrees() - 7.0).abs() < 1e-9);
        assert_eq!(truth.t_world_bone_marker_at_scan.stamp_ns, scan);

        for (touched, planned) in [
            (&procedure.stylus_init, &procedure.plan.landmarks),
            (&procedure.stylus_assessment, &procedure.plan.assessment),
        ] {
            assert_eq!(touched.points.len(), planned.points.len());
            for (touch, plan) in touched.points.iter().zip(planned.points.iter()) {
                assert_eq!(touch.name, plan.name);
                let marker = at(&procedure.bone_marker, touch.stamp_ns);
                let off = truth.t_ct_bone_marker.isometry * marker.inverse() * touch.position - plan.position;
                assert!(off.norm() < 1e-8, "{} is touched {} mm away", plan.name, off.norm());
            }
        }
    }
}

#[test]
fn a_laser_scan_lacks_the_disc_around_the_spot_and_nothing_else() {
    let procedure = simulate(&without_errors(), 3);
    let t_ct_camera = t_ct_camera(&procedure);
    assert_eq!(procedure.laser.len(), 3);
    for (cloud, spot) in procedure.laser.iter().zip(procedure.truth.laser_spots_ct.points.iter()) {
        assert_eq!(cloud.label.as_deref(), Some(&*spot.name));
        let from_spot = |cloud: &Cloud| -> Vec<f64> {
            cloud.points().iter().map(|p| (t_ct_camera * p - spot.position).norm()).collect()
        };
        let (with, without) = (from_spot(cloud), from_spot(&procedure.scan));
        let nearest = with.iter().copied().fold(f64::MAX, f64::min);
        // The grid is 0.2 mm fine and slanted by up to 72 degrees.
        assert!((2.0..2.4).contains(&nearest), "the nearest point is {nearest} mm from the spot {}", spot.name);
        let in_disc = without.iter().filter(|d| **d < 2.0).count();
        assert!(in_disc > 50, "{in_disc} points of the full scan lie in the disc of {}", spot.name);
        let ring = |distances: &[f64]| distances.iter().filter(|d| (2.0..4.0).contains(*d)).count() as f64;
        let kept = ring(&with) / ring(&without);
        assert!((0.9..1.1).contains(&kept), "{kept} of the points beside the disc are kept");
    }
}

#[test]
fn depth_noise_is_as_large_as_asked_for_and_grows_with_incidence() {
    let mut params = without_errors();
    params.camera.depth_noise_mm = 0.05;
    let procedure = simulate(&params, 4);
    let errors = along_rays(&procedure.scan, &t_ct_camera(&procedure), &procedure.truth.bone);
    assert!(errors.len() > 19_900);
    for (low, high) in [(0.31, 0.5), (0.5, 0.7), (0.7, 0.85), (0.85, 1.0)] {
        let of_band: Vec<f64> =
            errors.iter().filter(|(_, cos)| (low..high).contains(cos)).map(|(e, cos)| e * cos).collect();
        assert!(of_band.len() > 500, "{} points between cosines {low} and {high}", of_band.len());
        let spread = rms(of_band.iter().copied());
        // Four standard errors.
        let tolerance = 4.0 * 0.05 / (2.0 * of_band.len() as f64).sqrt();
        assert!((spread - 0.05).abs() < tolerance, "{spread} mm between cosines {low} and {high}");
        let mean = of_band.iter().sum::<f64>() / of_band.len() as f64;
        assert!(mean.abs() < 4.0 * 0.05 / (of_band.len() as f64).sqrt(), "mean {mean} mm");
    }
    let steepest = errors.iter().map(|(_, cos)| *cos).fold(1.0, f64::min);
    assert!(steepest >= 72f64.to_radians().cos() - 1e-9, "seen at {} degrees", steepest.acos().to_degrees());
}

#[test]
fn depth_bias_is_smooth_belongs_to_the_camera_and_is_as_large_as_asked_for() {
    let mut params = without_errors();
    params.camera.depth_bias_mm = 0.05;
    params.camera.n_points = 1000;
    let mut squares = Vec::new();
    for seed in 0..30 {
        let procedure = simulate(&params, seed);
        let t_ct_camera = t_ct_camera(&procedure);
        let errors = along_rays(&procedure.scan, &t_ct_camera, &procedure.truth.bone);
        squares.push(rms(errors.iter().map(|(e, _)| *e)).powi(2));
        // Neighbours in the cloud that are 2 mm apart or less err alike: the slope of 0.05 mm over 60 mm waves.
        let points = procedure.scan.points();
        if errors.len() == points.len() {
            for k in 1..points.len() {
                let apart = (points[k] - points[k - 1]).norm();
                let step = (errors[k].0 - errors[k - 1].0).abs();
                assert!(apart > 2.0 || step < 0.05, "{step} mm over {apart} mm");
            }
        }
    }
    let spread = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
    // About six waves cross a field of view, so 30 runs hold some 180 independent values: 4 standard errors are 21 %.
    assert!((0.04..0.06).contains(&spread), "{spread} mm");
}

#[test]
fn the_same_seed_gives_the_same_bits_on_any_number_of_threads() {
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| Procedure::simulate(&ProcedureParams::default(), 42).unwrap())
    };
    let (one, five) = (on(1), on(5));
    assert_eq!(one, five);
}

#[test]
fn another_seed_is_another_procedure_on_the_same_bone() {
    let [one, other] = [1, 2].map(|seed| Procedure::simulate(&ProcedureParams::default(), seed).unwrap());
    assert_ne!(one.scan, other.scan);
    assert_ne!(one.truth.t_world_ct_at_scan, other.truth.t_world_ct_at_scan);
    assert_eq!(one.truth.bone, other.truth.bone);
    assert_eq!(one.plan, other.plan);
}

#[test]
fn switching_one_term_off_leaves_the_others_draws_as_they_were() {
    let full = simulate(&ProcedureParams::default(), 7);
    let with = |change: fn(&mut ProcedureParams)| {
        let mut params = ProcedureParams::default();
        change(&mut params);
        simulate(&params, 7)
    };
    let no_tracker_noise = with(|p| p.tracker.noise_mm = 0.0);
    assert_eq!(no_tracker_noise.scan, full.scan);
    assert_eq!(no_tracker_noise.stylus_palpation, full.stylus_palpation);
    let stamps = |poses: &[Pose]| poses.iter().map(|p| p.stamp_ns).collect::<Vec<_>>();
    assert_eq!(stamps(&no_tracker_noise.bone_marker), stamps(&full.bone_marker), "the same samples are lost");
    assert_ne!(no_tracker_noise.bone_marker, full.bone_marker);

    let no_depth_noise = with(|p| p.camera.depth_noise_mm = 0.0);
    assert_eq!(no_depth_noise.camera_marker, full.camera_marker);
    assert_eq!(no_depth_noise.scan.len(), full.scan.len());
    let turned = no_depth_noise.scan.points().iter().zip(full.scan.points());
    let worst = turned.map(|(a, b)| a.coords.normalize().cross(&b.coords.normalize()).norm()).fold(0.0, f64::max);
    assert!(worst < 1e-12, "the same pixels give points; one ray turned by {worst}");

    let no_lost = with(|p| p.tracker.lost = 0.0);
    let kept: Vec<&Pose> =
        no_lost.bone_marker.iter().filter(|p| full.bone_marker.iter().any(|q| q.stamp_ns == p.stamp_ns)).collect();
    assert_eq!(kept, full.bone_marker.iter().collect::<Vec<_>>());
    assert!(no_lost.bone_marker.len() > full.bone_marker.len());
}

#[test]
fn the_marker_is_followed_at_every_cloud_and_touch_and_the_bone_comes_to_rest() {
    let procedure = simulate(&ProcedureParams::default(), 5);
    let near = |stream: &[Pose], stamp_ns: StampNs| stream.iter().any(|p| (p.stamp_ns - stamp_ns).abs() < 200_000_000);
    let touches = [&procedure.stylus_init, &procedure.stylus_assessment, &procedure.stylus_palpation];
    let mut moments: Vec<StampNs> = procedure.laser.iter().map(|c| c.stamp_ns).collect();
    moments.push(procedure.scan.stamp_ns);
    assert!(moments.iter().all(|s| near(&procedure.camera_marker, *s)));
    moments.extend(touches.iter().flat_map(|t| t.points.iter().map(|p| p.stamp_ns)));
    assert_eq!(moments.len(), 4 + 3 + 5 + 300);
    assert!(moments.iter().all(|s| near(&procedure.bone_marker, *s)));
    assert!(near(&procedure.camera_marker, procedure.phantom_scan.stamp_ns));
    assert!(near(&procedure.phantom_marker, procedure.phantom_scan.stamp_ns));
    for stream in [&procedure.camera_marker, &procedure.phantom_marker, &procedure.bone_marker] {
        assert!(stream.windows(2).all(|w| w[0].stamp_ns < w[1].stamp_ns));
        assert!(stream[0].stamp_ns > 1_750_000_000_000_000_000);
    }
    let last_touch = moments.iter().copied().max().unwrap();
    let end = procedure.bone_marker.last().unwrap();
    assert!(end.stamp_ns - last_touch > 5_000_000_000, "2 s of motion and 3 s of rest follow the last touch");
    let rest: Vec<&Pose> = procedure.bone_marker.iter().filter(|p| end.stamp_ns - p.stamp_ns < 2_900_000_000).collect();
    let spread = rest.iter().map(|p| (p.isometry.translation.vector - end.isometry.translation.vector).norm());
    assert!(spread.fold(0.0, f64::max) < 0.4, "white noise of 0.03 mm alone");
    // An outlier may be farther off than the region's margin.
    let procedure = simulate(&white_noise(), 5);
    let region = procedure.region.as_ref().unwrap();
    assert!(procedure.scan.points().iter().all(|p| region.contains(p)));
}

#[test]
fn a_bone_and_a_camera_that_move_between_scans_still_meet_in_the_markers_frame() {
    let mut params = without_errors();
    params.motion.bone_between_scans_mm = 4.0;
    params.motion.bone_between_scans_deg = 2.0;
    params.motion.camera_between_scans_mm = 3.0;
    params.motion.camera_between_scans_deg = 1.0;
    let procedure = simulate(&params, 9);
    let t_c_mc = procedure.truth.t_camera_camera_marker.isometry;
    let at_scan = at(&procedure.bone_marker, procedure.scan.stamp_ns);
    for (k, cloud) in procedure.laser.iter().enumerate() {
        let marker = at(&procedure.bone_marker, cloud.stamp_ns);
        assert!((marker.rotation.angle_to(&at_scan.rotation)).to_degrees() > 0.1, "the bone has turned");
        let t_world_camera = at(&procedure.camera_marker, cloud.stamp_ns) * t_c_mc.inverse();
        let t_ct_world = procedure.truth.t_ct_bone_marker.isometry * marker.inverse();
        assert!(worst_off(cloud, &(t_ct_world * t_world_camera), &procedure.truth.bone) < 1e-8);
        let truly = t_ct_world.inverse() * procedure.truth.laser_spots_ct.points[k].position;
        assert!((truly - procedure.truth.laser_spots_world.points[k].position).norm() < 1e-8);
        assert!((t_ct_world * procedure.truth.t_world_ct_at_laser[k].isometry).translation.vector.norm() < 1e-8);
    }
    // All motion comes between the clouds: each burst is still.
    for cloud in procedure.laser.iter().chain([&procedure.scan]) {
        let burst: Vec<&Pose> =
            procedure.bone_marker.iter().filter(|p| (p.stamp_ns - cloud.stamp_ns).abs() < 600_000_000).collect();
        assert!(burst.len() > 20 && burst.iter().all(|p| p.isometry == burst[0].isometry));
    }
}

#[test]
fn with_surroundings_the_region_still_holds_the_bone_and_a_crop_takes_most_of_the_rest_away() {
    let mut params = without_errors();
    params.camera.surroundings = true;
    let procedure = simulate(&params, 11);
    let bone = MeshQuery::new(&procedure.truth.bone);
    let t_ct_camera = t_ct_camera(&procedure);
    let region = procedure.region.as_ref().unwrap();
    let (mut on_bone, mut beside, mut beside_within) = (0, 0, 0);
    for p in procedure.scan.points() {
        if bone.closest_point(&(t_ct_camera * p)).unwrap().distance_mm < 1e-8 {
            on_bone += 1;
            assert!(region.contains(p), "the bone's point {p} lies outside the region");
        } else {
            beside += 1;
            beside_within += usize::from(region.contains(p));
        }
    }
    assert!(on_bone > 2_000 && beside > 8_000, "{on_bone} points on the bone, {beside} beside it");
    assert!(beside_within < beside / 4, "{beside_within} of {beside} points beside the bone are left by the region");
    // The holes are on the bone, and palpation keeps to it.
    for (cloud, spot) in procedure.laser.iter().zip(procedure.truth.laser_spots_ct.points.iter()) {
        let nearest = cloud.points().iter().map(|p| (t_ct_camera * p - spot.position).norm()).fold(f64::MAX, f64::min);
        assert!((2.0..2.8).contains(&nearest), "{nearest} mm");
    }
    for touch in procedure.stylus_palpation.points.iter() {
        let t_ct_world = procedure.truth.t_world_ct_at_touches.isometry.inverse();
        assert!(bone.closest_point(&(t_ct_world * touch.position)).unwrap().distance_mm < 1e-8);
    }
}

#[test]
fn a_measured_bone_can_be_simulated_on() {
    const NAME: &str = "a_measured_bone_can_be_simulated_on";
    for name in ["TLEM2_CT_fibula_r", "MC22_fibula_r"] {
        let Some((bone, anatomy)) = crate::common::measured_bone(name) else {
            println!("skipped: {NAME}: no development data");
            return;
        };
        let plan = plan(&bone, &anatomy).unwrap();
        let subject = Subject { surface: MeshQuery::new(&bone), plan, notes: Vec::new() };
        let exact = Procedure::simulate_for(&subject, &without_errors(), 1).unwrap();
        assert_eq!(exact.scan.len(), 20_000);
        assert!(worst_off(&exact.scan, &t_ct_camera(&exact), &bone) < 1e-8);
        let ct = ct_surface(&bone, &CtParams::default(), 1).unwrap();
        assert_eq!(ct.origin, SurfaceOrigin::SimulatedCt);
        let surface = MeshQuery::new(&bone);
        let off = rms(ct.vertices().iter().map(|v| surface.closest_point(v).unwrap().distance_mm));
        assert!((0.02..0.15).contains(&off), "{off} mm between {name} and its CT surface");
    }
}

#[test]
fn what_cannot_be_simulated_is_refused_with_the_reason() {
    let refused = |change: fn(&mut ProcedureParams)| {
        let mut params = ProcedureParams::default();
        params.camera.n_points = 1000;
        change(&mut params);
        Procedure::simulate(&params, 1).unwrap_err()
    };
    let hidden = refused(|p| p.camera.view_azimuth_deg = -90.0);
    assert!(hidden.to_string().starts_with("the laser spot on P1 is hidden from the camera"), "{hidden}");
    let away = refused(|p| (p.camera.scan_from_mm, p.camera.scan_to_mm) = (400.0, 440.0));
    assert!(away.to_string().starts_with("the bone has no section 420 mm from the malleolus tip"), "{away}");
    let wrong = refused(|p| p.camera.dropout = f64::NAN);
    assert!(wrong.to_string().starts_with("camera.dropout is not finite"), "{wrong}");
    let wrong = refused(|p| p.tracker = TrackerParams { burst_s: 3.0, ..TrackerParams::default() });
    assert_eq!(wrong.to_string(), "tracker.burst_s is 3, but must be between 0.1 and 1.9");

    let params =
        ProcedureParams { camera: CameraParams { n_points: 1000, ..CameraParams::default() }, ..without_errors() };
    let good = simulate(&params, 1);
    let on = |change: fn(&mut osteoflow_geometry::SurgicalPlan)| {
        let mut plan = good.plan.clone();
        change(&mut plan);
        let subject = Subject { surface: MeshQuery::new(&good.truth.bone), plan, notes: Vec::new() };
        Procedure::simulate_for(&subject, &params, 1).unwrap_err()
    };
    assert!(on(|p| p.anatomy = None).to_string().starts_with("the plan has no anatomy"));
    assert!(matches!(on(|p| p.landmarks.frame = "world".into()), SimulationError::Frame(_)));
    let two = on(|p| p.landmarks.points = p.landmarks.points[..2].to_vec().into());
    assert!(two.to_string().starts_with("the plan has 2 landmarks, but at least 3 are needed"), "{two}");
}

#[test]
fn a_surgeon_who_points_again_leaves_fewer_holes_that_cannot_be_found() {
    let n_procedures = if std::env::var_os("SLOW_TESTS").is_some() { 30 } else { 5 };
    // Holes that are not found even where the plan may confirm them.
    let lost = |max_attempts| {
        let mut params = ProcedureParams::default();
        params.bone.shape_seed = 3;
        params.laser.max_attempts = max_attempts;
        let subject = crate::common::shared::built_in(&params.bone);
        let of_seed = |seed| {
            let Procedure { scan, laser, .. } = Procedure::simulate_for(subject, &params, seed).unwrap();
            laser.iter().filter(|cloud| cloud_difference(&scan, cloud, &HoleParams::default()).is_err()).count()
        };
        (1..=n_procedures).map(of_seed).sum::<usize>()
    };
    let (once, thrice) = (lost(1), lost(3));
    let n_holes = 3 * n_procedures as usize;
    assert!(once * 18 >= n_holes, "{once} of {n_holes} holes are not found, so that there is something to mend");
    assert!(thrice * 3 <= once * 2, "{thrice} of {n_holes} holes are not found in three attempts, {once} in one");
}
