use super::*;
use crate::fragment::tests::{planes, prism};
use crate::joined::joined;
use crate::shapes::{cuboid, shaft};
use osteoflow_geometry::SurfaceOrigin;

fn tilted(z: f64, lean: f64) -> Isometry3<f64> {
    Isometry3::translation(0.0, 0.0, z) * Isometry3::rotation(Vector3::new(lean, 0.7 * lean, 0.0))
}

fn against(bone: &Mesh, places: [Isometry3<f64>; 2], slip: &Isometry3<f64>) -> CutVariant {
    let params = CutDifferenceParams::default();
    PlannedFragment::new(bone, &planes(places), &params).unwrap().against(slip).unwrap()
}

fn all(difference: &FragmentDifference) -> [&DistanceSummary; 3] {
    [&difference.vertices, &difference.surface, &difference.walls]
}

#[test]
fn a_slide_along_a_prism_shows_in_place_at_its_ends_and_not_when_aligned() {
    let slip = Isometry3::translation(0.0, 0.0, 2.0);
    let bones = [
        cuboid([-5.0, -6.0, 0.0], [5.0, 6.0, 160.0]),
        prism(6.0, 12, [0.0, 160.0], 2, false),
        prism(6.0, 12, [0.0, 160.0], 641, false),
    ];
    for bone in &bones {
        let result = against(bone, [tilted(60.0, 0.0), tilted(94.0, 0.0)], &slip);
        for summary in all(&result.aligned) {
            assert!(summary.max_mm < 1e-6, "{summary:?}");
        }
        let [vertices, surface, walls] = all(&result.in_place);
        for summary in [vertices, surface] {
            assert!((summary.max_mm - 2.0).abs() < 1e-6, "{summary:?}");
        }
        assert!(walls.max_mm <= 2.0 && walls.max_mm > 1.8 && walls.mean_mm < surface.mean_mm);
        // 2 mm at both ends are all there is: of two pieces, 36 mm of wall and two faces each, 2 mm and a face differ.
        assert!(result.volume_difference_mm3.abs() < 1e-4, "{}", result.volume_difference_mm3);
        let [low, high] = &result.ends[..] else { panic!("two ends") };
        assert!((low.offset_mm - 2.0).abs() < 1e-9 && (low.longer_mm + 2.0).abs() < 1e-9);
        assert!((high.offset_mm - 2.0).abs() < 1e-9 && (high.longer_mm - 2.0).abs() < 1e-9);
        assert!(low.tilt_rad < 1e-7 && (result.pose_error.at_point_mm - 2.0).abs() < 1e-9);
    }
}

#[test]
fn the_surface_in_place_differs_by_the_faces_and_walls_that_a_slide_exposes() {
    // Of each box, 2 mm of wall rise 0 to 2 mm above the other's end, where that is nearer than the other's rim: all of
    // it.
    let bone = cuboid([-5.0, -6.0, 0.0], [5.0, 6.0, 160.0]);
    let params = CutDifferenceParams { n_samples: 100_000, ..CutDifferenceParams::default() };
    let planned = planes([tilted(60.0, 0.0), tilted(94.0, 0.0)]);
    let slide = Isometry3::translation(0.0, 0.0, 2.0);
    let result = PlannedFragment::new(&bone, &planned, &params).unwrap().against(&slide).unwrap();
    let (wall, face) = (44.0 * 34.0, 120.0);
    // Each fragment has one face 2 mm off and 2 mm of wall 1 mm off on the average; its other face lies inside the
    // other fragment, up to 2 mm from its end and no farther from its walls.
    let depth: f64 = {
        let n = 400;
        let at = |k: i32, half: f64| (f64::from(k) + 0.5) / f64::from(n) * 2.0 * half - half;
        let nearest = |x: f64, y: f64| (5.0 - x.abs()).min(6.0 - y.abs()).min(2.0);
        let sum: f64 = (0..n).flat_map(|i| (0..n).map(move |j| nearest(at(i, 5.0), at(j, 6.0)))).sum();
        sum / f64::from(n * n)
    };
    let expected = (face * 2.0 + 44.0 * 2.0 * 1.0 + face * depth) / (wall + 2.0 * face);
    let result = result.in_place.surface.mean_mm;
    assert!((result - expected).abs() < 0.01 * expected, "{result} mm, {expected} mm expected: 200,000 samples");
}

#[test]
fn the_meshing_of_the_bone_does_not_matter() {
    let slip = Isometry3::new(Vector3::new(0.6, -0.3, 1.5), Vector3::new(0.01, -0.02, 0.05));
    let result = [3, 41, 641].map(|rings| {
        against(&prism(6.0, 24, [0.0, 160.0], rings, false), [tilted(60.0, 0.2), tilted(94.0, -0.1)], &slip)
    });
    for finer in &result[1..] {
        for (a, b) in [(&result[0].in_place, &finer.in_place), (&result[0].aligned, &finer.aligned)] {
            assert!((a.vertices.mean_mm - b.vertices.mean_mm).abs() < 1e-6 * a.vertices.n as f64 / 1000.0 + 2e-3);
            assert!((a.vertices.max_mm - b.vertices.max_mm).abs() < 1e-6);
            assert!((a.surface.mean_mm - b.surface.mean_mm).abs() < 0.03 * a.surface.mean_mm, "samples differ");
        }
        assert!((result[0].executed_volume_mm3 - finer.executed_volume_mm3).abs() < 1e-5);
    }
}

#[test]
fn moving_everything_leaves_the_report_unchanged() {
    let bone = shaft();
    let places = [tilted(40.0, 0.2), tilted(74.0, -0.1)];
    let slip = Isometry3::new(Vector3::new(0.4, 0.3, 2.5), Vector3::new(0.01, 0.02, -0.06));
    let here = against(&bone, places, &slip);
    for motion in [
        Isometry3::new(Vector3::new(300.0, -200.0, 900.0), Vector3::new(0.4, -2.0, 1.0)),
        Isometry3::new(Vector3::new(-10.0, 20.0, -1500.0), Vector3::new(3.0, 0.2, 0.0)),
    ] {
        let there =
            against(&bone.transformed("ct", &motion), places.map(|p| motion * p), &(motion * slip * motion.inverse()));
        for (a, b) in all(&here.in_place)
            .iter()
            .chain(&all(&here.aligned))
            .zip(all(&there.in_place).iter().chain(&all(&there.aligned)))
        {
            // A grid line that grazes a face is met or missed by rounding.
            assert!(a.n.abs_diff(b.n) <= 3, "{} {}", a.n, b.n);
            assert!((a.mean_mm - b.mean_mm).abs() < 1e-3 && (a.max_mm - b.max_mm).abs() < 1e-3, "{a:?} {b:?}");
            assert!((a.sd_mm - b.sd_mm).abs() < 1e-3 && (a.p95_mm - b.p95_mm).abs() < 1e-3);
        }
        assert!((here.ends[0].offset_mm - there.ends[0].offset_mm).abs() < 1e-6);
    }
}

#[test]
fn flipped_normals_change_only_the_sign_of_the_offset() {
    let bone = shaft();
    let turn = Isometry3::rotation(Vector3::x() * std::f64::consts::PI);
    let slip = Isometry3::translation(0.2, 0.0, 1.0);
    let places = [tilted(40.0, 0.2), tilted(74.0, -0.1)];
    let (result, turned) = (against(&bone, places, &slip), against(&bone, places.map(|p| p * turn), &slip));
    assert!((result.ends[0].offset_mm + turned.ends[0].offset_mm).abs() < 1e-9);
    assert!((result.ends[0].longer_mm - turned.ends[0].longer_mm).abs() < 1e-9);
    assert!(
        (result.aligned.surface.mean_mm - turned.aligned.surface.mean_mm).abs() < 0.02 * result.aligned.surface.mean_mm
    );
}

#[test]
fn a_hollow_bone_is_compared_inside_too() {
    let bone = joined(&[prism(6.0, 24, [0.0, 160.0], 81, false), prism(3.0, 24, [-5.0, 165.0], 81, true)]);
    let result = against(&bone, [tilted(60.0, 0.1), tilted(94.0, 0.0)], &Isometry3::translation(0.0, 0.0, 1.0));
    assert!(result.aligned.surface.max_mm < 1e-6 && result.volume_difference_mm3.abs() < 1e-3);
    assert!((result.in_place.surface.max_mm - 1.0).abs() < 1e-2, "{:?}", result.in_place.surface);
}

#[test]
fn the_measured_error_is_that_of_the_points_and_its_absence_has_a_reason() {
    let bone = shaft();
    let places = planes([tilted(40.0, 0.2), tilted(74.0, -0.1)]);
    let error = Isometry3::new(Vector3::new(0.3, -0.2, 2.0), Vector3::new(0.01, 0.0, 0.03));
    let named = |at: &Isometry3<f64>| -> Vec<NamedPoint> {
        [[6.0, 0.0, 20.0], [0.0, 6.0, 50.0], [-6.0, 1.0, 80.0], [1.0, -6.0, 100.0]]
            .iter()
            .enumerate()
            .map(|(k, p)| NamedPoint::new(format!("M{k}"), at * Point3::from(*p)))
            .collect()
    };
    // Touched without error, carried to CT by a registration that errs.
    let t_ct_world_true = Isometry3::new(Vector3::new(100.0, 0.0, -50.0), Vector3::new(0.5, 0.5, 0.0));
    let measured = named(&t_ct_world_true.inverse());
    let result = error_at_points(&named(&Isometry3::identity()), &measured, &(error * t_ct_world_true));
    assert!((result.clone().unwrap().to_homogeneous() - error.to_homogeneous()).amax() < 1e-9);
    let params = CutDifferenceParams::default();
    let result = cut_difference(&bone, &places, &error, result.map_err(|e| e.to_string()), &params).unwrap();
    let paper = result.paper.unwrap();
    assert!((paper.aligned.surface.mean_mm - result.truth.aligned.surface.mean_mm).abs() < 1e-6);
    assert!((paper.pose_error.rotation_rad - error.rotation.angle()).abs() < 1e-9);
    // The planes are carried by the inverse: a registration that puts points 2 mm too high cuts 2 mm too low.
    assert!((result.truth.ends[0].offset_mm + 2.0).abs() < 0.3, "{}", result.truth.ends[0].offset_mm);

    let none = error_at_points(&[], &[], &error).map_err(|e| e.to_string());
    let result = cut_difference(&bone, &places, &error, none, &params).unwrap();
    assert!(result.paper.is_none() && result.no_paper.unwrap().contains("no point"));
    let gone = cut_difference(&bone, &places, &Isometry3::translation(0.0, 0.0, 900.0), Err("none".into()), &params);
    assert!(gone.unwrap_err().to_string().starts_with("plane_1 does not cut the bone"));
}

#[test]
fn a_map_is_positive_outside_and_negative_inside() {
    let query = MeshQuery::new(&cuboid([0.0; 3], [10.0; 3]));
    let result = signed_distances(&[Point3::new(5.0, 5.0, 12.0), Point3::new(5.0, 5.0, 9.0)], &query);
    assert!((result[0] - 2.0).abs() < 1e-12 && (result[1] + 1.0).abs() < 1e-12);
}

#[test]
fn the_grid_meets_a_surface_where_its_lines_do() {
    let mesh = cuboid([0.0; 3], [3.0, 2.0, 1.0]);
    let mut points = on_grid(&mesh, &Isometry3::identity(), 1.0);
    // A line through an edge meets both of its faces.
    points.sort_by(|a, b| (a.x, a.y, a.z).partial_cmp(&(b.x, b.y, b.z)).unwrap());
    points.dedup();
    // 3 x 2 on two sides, 2 x 1 on two, 3 x 1 on two.
    assert_eq!(points.len(), 2 * (6 + 2 + 3));
    assert!(points.iter().all(|p| p.coords.iter().any(|c| (c - c.round()).abs() < 1e-12)));
    let flat = Mesh::new("ct", SurfaceOrigin::Exact, vec![Point3::origin(); 3], vec![[0, 1, 2]]).unwrap();
    assert!(on_grid(&flat, &Isometry3::identity(), 1.0).is_empty());
}
