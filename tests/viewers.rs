//! What a viewer makes of `run.mcap`: read with the libraries of viewers, not with ours.

pub(crate) mod file;

use crate::common::{WHITE, isometry, json, point, read_by_viewers, run, run_whole, shared_run};
use file::{Edge, File, median};
use osteoflow_algorithms::mesh_query::MeshQuery;
use osteoflow_formats::mesh_or_cloud::read_cloud;
use osteoflow_geometry::{
    Mesh, SurfaceOrigin,
    nalgebra::{Point3, Vector3},
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
    assert_eq!(file.faults("ct"), Vec::<String>::new());
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
    assert_eq!(parent("ct"), None, "the bone is at the top");
    assert_eq!(parent("bone_marker"), Some("ct"));
    assert_eq!(parent("world"), Some("bone_marker"));
    assert_eq!(parent("camera"), Some("camera_marker"));
    assert_eq!(parent("ct (recording.t_ct_world_true)"), Some("world"));
    assert_eq!(parent("ct (coarse.t_target_source)"), Some("bone_marker"));
    assert_eq!(parent("camera (plan.t_camera_camera_marker_nominal)"), Some("camera_marker"));
    let (time, ..) = file.clouds("/view/recording.scan").pop().unwrap();
    let world = file.t_root("world", time).unwrap();
    let found = file.t_root("ct (planes_at_scan.t_ct_world)", time).unwrap().inverse() * world;
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

    let icp = |edge: &Edge| edge.parent == "ct";
    let sound = file.edges.clone();
    file.edges.iter_mut().filter(|edge| icp(edge)).for_each(|edge| edge.t_parent_child = edge.t_parent_child.inverse());
    assert!(landing_mm(&file) > 5.0, "the edge of the CT stands the wrong way round: {} mm", landing_mm(&file));

    file.edges = sound.clone();
    let mut again = sound.iter().find(|edge| icp(edge)).unwrap().clone();
    again.parent = "camera".into();
    file.edges.push(again);
    assert_eq!(file.faults("ct")[0], "bone_marker has 2 parents: camera, ct");

    file.edges = sound.iter().filter(|edge| !icp(edge)).cloned().collect();
    let faults = file.faults("ct");
    assert!(faults.iter().any(|fault| fault.starts_with("bone_marker is shown, but not connected")), "{faults:?}");

    let turn = Edge { child: "ct".into(), parent: "world".into(), ..sound[0].clone() };
    file.edges = sound;
    file.edges.push(turn);
    assert!(file.faults("ct").iter().any(|fault| fault.contains("circle")), "{:?}", file.faults("ct"));
}

/// Largest distance of the scan from its place on the bone as it is drawn at a time, mm: the cloud by its frame at its own stamp, the
/// bone by its frame now, each by the newest transforms before, in the frame at the top of the tree.
pub(crate) fn off_its_place_mm(
    file: &File,
    topic: &str,
    time_ns: u64,
    place: &[Point3<f64>],
    root: Option<&str>,
) -> Option<f64> {
    let (stamp_ns, frame, points) = file.clouds(topic).into_iter().rfind(|(stamp_ns, ..)| *stamp_ns <= time_ns)?;
    // Seen from another frame than the top of the tree, if one is asked for.
    let seen = |frame: &str, time_ns: u64| {
        let t = file.t_top(frame, time_ns);
        root.map_or(t, |root| file.t_top(root, time_ns).inverse() * t)
    };
    let t_bone_cloud = seen("ct", time_ns).inverse() * seen(&frame, stamp_ns);
    assert_eq!(points.len(), place.len(), "{topic}");
    Some(points.iter().zip(place).map(|(p, place)| (t_bone_cloud * p - place).norm()).fold(0.0, f64::max))
}

/// The registered scan as it was exported, in the CT.
pub(crate) fn place_of_scan(run: &std::path::Path) -> Vec<Point3<f64>> {
    read_cloud(&run.join("export/scan.vtk"), 1.0, "ct").unwrap().cloud.points().to_vec()
}

/// Metres in 32-bit floats are 0.06 µm at a metre; what is allowed is a pixel of a screen.
pub(crate) const DRAWN_MM: f64 = 0.2;

#[test]
fn the_registered_scan_stays_on_its_place_on_the_bone_at_every_second_of_the_recording() {
    let ran = shared_run(GRAPH, &[]);
    let file = File::read(&ran.dir.path().join("run.mcap"));
    let place = place_of_scan(ran.dir.path());
    let (first, last) = file.times();
    let (mut n_drawn, mut worst_from_world) = (0, 0.0_f64);
    for time_ns in (first..=last).step_by(1_000_000_000) {
        for topic in ["/view/to_bone.cloud", "/run/registered"] {
            let Some(off_mm) = off_its_place_mm(&file, topic, time_ns, &place, None) else { continue };
            assert!(
                off_mm < DRAWN_MM,
                "{topic} is drawn {off_mm} mm beside its place, {} s in",
                (time_ns - first) as f64 / 1e9
            );
            n_drawn += 1;
        }
        let from_world = off_its_place_mm(&file, "/view/to_bone.cloud", time_ns, &place, Some("world"));
        worst_from_world = worst_from_world.max(from_world.unwrap_or(0.0));
    }
    assert!(n_drawn > 60, "drawn {n_drawn} times");
    assert!(
        worst_from_world > 20.0,
        "with the tracker at the top it would be {worst_from_world} mm off, as the bone has moved"
    );
    // Nothing begins before the run, and no chunk is without a message: a viewer's time line begins with the first.
    let bytes = std::fs::read(ran.dir.path().join("run.mcap")).unwrap();
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    for chunk in &summary.chunk_indexes {
        assert!(chunk.message_start_time >= first && chunk.message_end_time <= last, "{chunk:?}");
    }
    let channels: std::collections::BTreeMap<_, _> = summary.channels.iter().collect();
    for channel in channels.values() {
        let encoding = channel.message_encoding.as_str();
        assert!(["protobuf", "json", "cdr"].contains(&encoding), "{}: viewers do not know {encoding}", channel.topic);
        let schema = channel.schema.as_ref().unwrap();
        assert_eq!(encoding == "cdr", schema.encoding == "ros2msg", "{}", channel.topic);
        if schema.encoding == "jsonschema" {
            let read = read_by_viewers(&serde_json::from_slice(&schema.data).unwrap());
            assert_eq!(read, Ok(()), "{}", channel.topic);
        }
    }
}

#[test]
fn each_frame_is_placed_by_the_messages_of_one_topic() {
    for graph in [GRAPH, "graphs/calibration.toml", "graphs/variants/fibula_slide.toml"] {
        let ran = shared_run(graph, &[]);
        let file = File::read(&ran.dir.path().join("run.mcap"));
        let mut sources = std::collections::BTreeMap::<&str, std::collections::BTreeSet<&str>>::new();
        for edge in &file.edges {
            sources.entry(&edge.child).or_default().insert(&edge.topic);
        }
        assert!(sources.len() > 3, "{graph}");
        for (child, topics) in sources {
            assert_eq!(topics.len(), 1, "{graph}: {child} is placed by {topics:?}");
        }
    }
}

#[test]
fn the_layout_shows_what_the_page_shows_and_neither_truths_nor_frames() {
    let ran = shared_run(GRAPH, &[]);
    let layout = json(&ran.dir.path().join("layout.json"));
    let scene = &layout["configById"]["3D!run"];
    let topics = scene["topics"].as_object().unwrap();
    let mut visible: Vec<&str> =
        topics.iter().filter(|(_, of)| of["visible"] == true).map(|(topic, _)| &**topic).collect();
    visible.sort_unstable();
    let expected =
        ["/run/registered", "/view/bone.mesh", "/view/hole.point", "/view/laser_points.points", "/view/verdict.planes"];
    let expected: Vec<_> = expected.into_iter().filter(|topic| topics.contains_key(*topic)).collect();
    assert_eq!(visible, expected);
    assert!(scene["transforms"].as_object().unwrap().values().all(|frame| frame["visible"] == false));
    for (topic, of) in topics.iter().filter(|(_, of)| of["colorMode"] == "flat") {
        assert!(of["colorField"].is_string(), "{topic}: without a field viewers choose colours themselves");
    }
    let file = File::read(&ran.dir.path().join("run.mcap"));
    let verdicts = file.json("/run/verdict");
    assert_eq!(verdicts.last().unwrap()["answer"], ran.results["verdict"]["answer"]);
    assert_eq!(layout["configById"]["Indicator!run"]["path"], "/run/verdict.answer");
}

#[test]
fn every_kind_of_graph_leaves_one_tree() {
    for (graph, root) in [
        ("graphs/calibration.toml", "world"),
        ("graphs/two_files.toml", "ct"),
        ("graphs/fibula_folder.toml", "ct"),
        ("graphs/variants/fibula_slide.toml", "ct"),
        ("graphs/variants/fibula_stylus.toml", "ct"),
        ("graphs/variants/fibula_modules.toml", "ct"),
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
    let t_world_bone = file.t_root("world", scan).unwrap().inverse()
        * file.t_root("bone_marker (to_bone.t_world_bone_marker)", scan).unwrap();
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
    assert_eq!(file.json("/run/verdict").last().unwrap()["answer"], "refused");
    assert_eq!(file.faults("ct"), Vec::<String>::new());
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
    assert!(file.edges.iter().all(|edge| edge.parent != "ct" || edge.child.contains('(')), "the bone has no place");
    assert_eq!(file.clouds("/run/registered").len(), 0, "the scan is nowhere on the bone");
    let told = told(&file);
    let why = "frame bone_marker is not connected to ct: icp.t_target_source gave no pose; viewers cannot show ";
    assert!(told.iter().any(|told| told.starts_with(why) && told.contains("to_bone.cloud")), "{told:?}");
    assert!(file.log().any(|log| log.level == 4 && log.name == "icp"), "the node that failed is named");
}
