//! What a viewer makes of `run.mcap`: read with the libraries of viewers, not with ours.

mod file;

use crate::common::{WHITE, isometry, json, point, run, run_whole, shared_run};
use file::{Edge, File, median};
use osteoflow_algorithms::mesh_query::MeshQuery;
use osteoflow_geometry::{
    Mesh, SurfaceOrigin,
    nalgebra::{Isometry3, Point3, Vector3},
};

const GRAPH: &str = "graphs/fibula.toml";

/// The bone in the file as triangles, mm.
fn bone(file: &File) -> Mesh {
    let (_, scene) = file.scenes("/view/bone.mesh").pop().unwrap();
    let [entity] = &scene.entities[..] else { panic!("{} entities of the bone", scene.entities.len()) };
    assert_eq!(entity.frame_id, "ct");
    let triangles = &entity.triangles[0];
    let vertices: Vec<_> = triangles.points.iter().map(|p| Point3::new(p.x, p.y, p.z) * 1000.0).collect();
    let faces: Vec<_> = triangles.indices.chunks_exact(3).map(|f| [f[0], f[1], f[2]]).collect();
    Mesh::new("ct", SurfaceOrigin::User, vertices, faces).unwrap()
}

/// Median distance of the raw scan from the bone, mm, where the transforms in the file put it.
fn landing_mm(file: &File) -> f64 {
    let query = MeshQuery::new(&bone(file));
    let (time, frame, points) = file.clouds("/view/recording.scan").pop().unwrap();
    assert_eq!(frame, "camera");
    let t_world_ct = file.t_root("ct", time).unwrap();
    let t_ct_camera = t_world_ct.inverse() * file.t_root("camera", time).unwrap();
    let mut distances: Vec<f64> =
        points.iter().map(|p| query.closest_point(&(t_ct_camera * p)).unwrap().distance_mm).collect();
    distances.sort_by(f64::total_cmp);
    median(&distances)
}

#[test]
fn the_frames_of_a_run_are_one_tree_below_the_tracker_known_before_the_first_cloud() {
    let ran = shared_run(GRAPH, &[]);
    let file = File::read(&ran.dir.path().join("run.mcap"));
    assert_eq!(file.faults("world"), Vec::<String>::new());
    let first_cloud = file.first_time(|schema| ["foxglove.PointCloud", "foxglove.SceneUpdate"].contains(&schema));
    for edge in &file.edges {
        let first = file.edges.iter().filter(|other| other.child == edge.child).map(|other| other.time_ns).min();
        assert!(
            first.unwrap() < first_cloud,
            "{} is placed at {first:?}, the first cloud is at {first_cloud}",
            edge.child
        );
    }
    // Truth and starts have frames of their own, and stand where the results say.
    let parent = |child: &str| file.edges.iter().find(|edge| edge.child == child).map(|edge| edge.parent.as_str());
    assert_eq!(parent("ct"), Some("bone_marker"));
    assert_eq!(parent("camera"), Some("camera_marker"));
    assert_eq!(parent("ct (recording.t_ct_world_true)"), Some("world"));
    assert_eq!(parent("ct (coarse.t_target_source)"), Some("bone_marker"));
    assert_eq!(parent("camera (plan.t_camera_camera_marker_nominal)"), Some("camera_marker"));
    let (time, ..) = file.clouds("/view/recording.scan").pop().unwrap();
    let found = file.t_root("ct (planes_at_scan.t_ct_world)", time).unwrap().inverse();
    let expected = isometry(&ran.results["poses"]["t_ct_world"]["matrix"]);
    let off_mm = (found.inverse() * expected).translation.vector.norm();
    assert!(off_mm < 1e-6, "{off_mm} mm between the file and the results: metres and back");
    let layout = json(&ran.dir.path().join("layout.json"));
    let scene = &layout["configById"]["3D!run"];
    assert_eq!(scene["followTf"], "ct");
    let shown = scene["topics"].as_object().unwrap();
    assert!(file.topics().iter().filter(|topic| topic.starts_with("/view/")).all(|topic| shown.contains_key(topic)));
    let looked_at = point(&scene["cameraState"]["targetOffset"]) * 1000.0;
    let near = MeshQuery::new(&bone(&file)).closest_point(&looked_at).unwrap().distance_mm;
    assert!(
        near < 60.0,
        "the camera looks {near} mm past the bone; its box is 360 mm long, and its middle may be beside it"
    );
}

#[test]
fn the_raw_scan_lands_on_the_bone_and_a_broken_tree_is_seen() {
    let ran = shared_run(GRAPH, &[]);
    let mut file = File::read(&ran.dir.path().join("run.mcap"));
    let mesh = bone(&file);
    let (min, max) =
        mesh.vertices().iter().fold((mesh.vertices()[0], mesh.vertices()[0]), |(a, b), p| (a.inf(p), b.sup(p)));
    let length_mm = (max - min).norm();
    assert!((300.0..500.0).contains(&length_mm), "a fibula of {length_mm} mm; in metres it would be 0.4");
    // Noise of single tracker samples at a lever arm of 300 mm; 0.07 mm is what the fit leaves.
    let landed_mm = landing_mm(&file);
    assert!(landed_mm < 0.5, "the raw scan is {landed_mm} mm from the bone");

    let icp = |edge: &Edge| edge.child == "ct";
    let sound = file.edges.clone();
    file.edges.iter_mut().filter(|edge| icp(edge)).for_each(|edge| edge.t_parent_child = edge.t_parent_child.inverse());
    assert!(landing_mm(&file) > 5.0, "the edge of the CT stands the wrong way round: {} mm", landing_mm(&file));

    file.edges = sound.clone();
    let mut again = sound.iter().find(|edge| icp(edge)).unwrap().clone();
    again.parent = "world".into();
    file.edges.push(again);
    assert_eq!(file.faults("world"), ["ct has 2 parents: bone_marker, world"]);

    file.edges = sound.iter().filter(|edge| !icp(edge)).cloned().collect();
    let faults = file.faults("world");
    assert!(faults.iter().any(|fault| fault.starts_with("ct is shown, but not connected")), "{faults:?}");

    let turn = Edge { time_ns: 1, parent: "ct".into(), child: "world".into(), t_parent_child: Isometry3::identity() };
    file.edges = sound;
    file.edges.push(turn);
    assert!(file.faults("world").iter().any(|fault| fault.contains("circle")), "{:?}", file.faults("world"));
}

#[test]
fn every_kind_of_graph_leaves_one_tree() {
    for (graph, root) in [
        ("graphs/calibration.toml", "world"),
        ("graphs/two_files.toml", "ct"),
        ("graphs/fibula_folder.toml", "world"),
        ("graphs/variants/fibula_slide.toml", "world"),
        ("graphs/variants/fibula_stylus.toml", "world"),
        ("graphs/variants/fibula_modules.toml", "world"),
    ] {
        let ran = shared_run(graph, &[]);
        let file = File::read(&ran.dir.path().join("run.mcap"));
        assert_eq!(file.faults(root), Vec::<String>::new(), "{graph}");
        assert!(file.edges.len() > 1, "{graph}: no transforms");
    }
}

#[test]
fn planes_and_laser_points_are_entities_where_the_results_have_them() {
    let ran = shared_run(GRAPH, &[]);
    let file = File::read(&ran.dir.path().join("run.mcap"));
    let (_, scene) = file.scenes("/view/planes_at_scan.planes").pop().unwrap();
    let planes = ran.results["planes_at_scan"].as_array().unwrap();
    assert_eq!(scene.entities.len(), planes.len());
    for (entity, plane) in scene.entities.iter().zip(planes) {
        assert_eq!((entity.id.as_str(), entity.frame_id.as_str()), (plane["name"].as_str().unwrap(), "world"));
        assert_eq!(entity.texts[0].text, plane["name"].as_str().unwrap());
        let t = isometry(&plane["matrix"]);
        let square = file::pose(entity.triangles[0].pose.as_ref().unwrap());
        let off_mm = (square.translation.vector - t.translation.vector).norm();
        let arrow = file::pose(entity.arrows[0].pose.as_ref().unwrap());
        let off_rad = (arrow * Vector3::x()).angle(&(t * Vector3::z()));
        assert!(off_mm < 1e-6 && off_rad < 1e-6, "{}: {off_mm} mm, {off_rad} rad", entity.id);
        let corners = &entity.triangles[0].points;
        assert!(
            corners.iter().all(|c| c.z == 0.0 && c.x.abs() < 0.1 && c.y.abs() < 0.1),
            "{corners:?} is no square in m"
        );
        assert!(entity.triangles[0].color.as_ref().unwrap().a < 1.0, "the bone behind it is not seen");
    }
    let points = ran.results["laser_points"].as_array().unwrap();
    let spots: Vec<_> = file.scenes("/view/hole.point").into_iter().flat_map(|(_, scene)| scene.entities).collect();
    assert_eq!(spots.len(), points.len());
    let (scan, ..) = file.clouds("/view/recording.scan").pop().unwrap();
    let t_world_bone = file.t_root("bone_marker (to_bone.t_world_bone_marker)", scan).unwrap();
    for (spot, expected) in spots.iter().zip(points) {
        assert_eq!((spot.id.as_str(), spot.frame_id.as_str()), (expected["name"].as_str().unwrap(), "bone_marker"));
        let found = t_world_bone * file::pose(spot.spheres[0].pose.as_ref().unwrap()).translation;
        let off_mm = (found.translation.vector - point(&expected["position_mm"]).coords).norm();
        assert!(off_mm < 1e-6, "{}: {off_mm} mm", spot.id);
    }
}

#[test]
fn a_refused_run_shows_no_planes_and_says_why() {
    let ran = run(GRAPH, &["--set", "icp.max_iterations=1", "--set", "results.require=trusted"]);
    assert_eq!(ran.code, 3, "{}", ran.stderr);
    let file = File::read(&ran.dir.path().join("run.mcap"));
    for topic in file.topics().iter().filter(|topic| topic.starts_with("/view/") && topic.ends_with("planes")) {
        assert_eq!(file.scenes(topic).len(), 0, "{topic} is drawn");
    }
    assert_eq!(file.faults("world"), Vec::<String>::new());
    let said = |level: i32, words: &str| file.log().any(|log| log.level == level && log.message.contains(words));
    assert!(said(4, "the run is refused"), "{:?}", file.log().collect::<Vec<_>>());
    assert!(said(3, "pictures of planes are not drawn"));
}

#[test]
fn what_cannot_be_shown_with_the_rest_is_told() {
    // Without the warnings of nodes.
    let told = |file: &File| -> Vec<String> {
        let warnings = file.log().filter(|log| log.level == 3 && log.name != "hole");
        warnings.map(|log| log.message).collect()
    };
    // Nothing recorded joins the bone's marker to the camera.
    let wires = "record.wires=[\"to_bone.cloud\", \"calibration.*\"]";
    let ran = run_whole(GRAPH, &[&["--set", wires, "--set", "record.sources=false"], &WHITE[..]].concat());
    let file = File::read(&ran.dir.path().join("run.mcap"));
    assert_eq!(
        told(&file),
        [
            "frame bone_marker is not connected to camera: no wire in [record] has its pose; viewers cannot show to_bone.cloud \
          with the rest"
        ]
    );
    // The fit fails, and so the CT has no place; what was assumed before is not shown in its stead.
    let ran = run(GRAPH, &["--set", "icp.max_pair_distance_mm=0.000001"]);
    assert_eq!(ran.code, 3, "{}", ran.stderr);
    let file = File::read(&ran.dir.path().join("run.mcap"));
    assert_eq!(file.t_root("ct", u64::MAX), None);
    let told = told(&file);
    let why = "frame ct is not connected to world: icp.t_target_source gave no pose; viewers cannot show ";
    assert!(told.iter().any(|told| told.starts_with(why) && told.contains("bone.mesh")), "{told:?}");
    assert!(file.log().any(|log| log.level == 4 && log.name == "icp"), "the node that failed is named");
}
