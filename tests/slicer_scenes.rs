//! Scenes for 3D Slicer that are written, as tests/clients/scene.py reads them: by the rules of Slicer's source, with no code of ours.

use crate::{
    common::{Ran, isometry, json, osteoflow, point, python::python_with, root, run_whole},
    slicer_plans::{markers, rules, shipped},
};
use osteoflow_formats::{
    Space,
    mesh_or_cloud::{read_cloud, read_mesh},
    picked_points::{read_scene, write_fcsv},
    pose_file::{itk_text, read_pose},
};
use osteoflow_geometry::{
    NamedPoint, SurfaceOrigin, isometry_from_matrix,
    nalgebra::{Isometry3, Matrix4, Point3},
};
use serde_json::Value;
use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    io::{Read as _, Write as _},
    path::{Path, PathBuf},
    process::Command,
};
use tempfile::TempDir;

/// What the other reader finds, in RAS.
#[derive(Debug)]
struct Found {
    scene: Value,
    dir: TempDir,
}

impl Found {
    /// Reads a scene; what is wrong with it, if it is refused.
    fn read(python: &Path, scene: &Path) -> Result<Self, String> {
        let dir = tempfile::tempdir().unwrap();
        let script = root().join("tests/clients/scene.py");
        let output = Command::new(python).arg(script).arg(scene).arg(dir.path()).output().unwrap();
        if !output.status.success() {
            return Err(String::from_utf8_lossy(&output.stderr).into_owned());
        }
        Ok(Self { scene: json(&dir.path().join("scene.json")), dir })
    }

    fn numbers(&self, file: &str) -> Vec<f64> {
        let bytes = fs::read(self.dir.path().join(file)).unwrap();
        bytes.chunks_exact(8).map(|eight| f64::from_le_bytes(eight.try_into().unwrap())).collect()
    }

    fn points(&self, model: &str) -> Vec<Point3<f64>> {
        self.numbers(&format!("{model}.points")).chunks_exact(3).map(Point3::from_slice).collect()
    }

    fn list(&self, name: &str) -> Vec<(String, Point3<f64>)> {
        let list = self.scene["lists"][name].as_object().unwrap();
        list.iter().map(|(label, at)| (label.clone(), point(at))).collect()
    }
}

fn ras(lps: &Point3<f64>) -> Point3<f64> {
    Point3::new(-lps.x, -lps.y, lps.z)
}

fn farthest(found: &[Point3<f64>], expected: &[Point3<f64>]) -> f64 {
    assert_eq!(found.len(), expected.len());
    found.iter().zip(expected).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max)
}

/// What a run says, in LPS.
struct Said {
    bone: Vec<Point3<f64>>,
    scan: Vec<Point3<f64>>,
    landmarks: Vec<(String, Point3<f64>)>,
    planes: BTreeMap<String, Isometry3<f64>>,
}

impl Said {
    /// The surface and the plan of the procedure in tests/data; the scan and the planes as the run has found them.
    fn by(ran: &Ran, plan: &Value) -> Self {
        let data = root().join("tests/data/procedure");
        let mesh = read_mesh(&data.join("bone.stl"), 1.0, "ct", SurfaceOrigin::User).unwrap().mesh;
        let bone = (0..mesh.faces().len()).flat_map(|face| mesh.corners(face)).collect();
        let out = ran.path("registered.csv");
        let mut convert = osteoflow();
        convert.arg("convert").arg(ran.path("run.mcap")).arg(&out).args(["--topic", "/run/registered"]);
        assert!(convert.output().unwrap().status.success());
        let scan = read_cloud(&out, 1.0, "ct").unwrap().cloud.points().to_vec();
        let landmarks = plan["landmarks"].as_object().unwrap();
        let landmarks = landmarks.iter().map(|(name, at)| (name.clone(), point(at))).collect();
        // The results have the planes where the tracker sees them.
        let t_ct_world = isometry(&ran.results["poses"]["t_ct_world"]["matrix"]);
        let planes = ran.results["planes_at_scan"].as_array().unwrap().iter();
        let planes = planes.map(|plane| {
            assert_eq!(plane["frame"], "world");
            (plane["name"].as_str().unwrap().to_owned(), t_ct_world * isometry(&plane["matrix"]))
        });
        Self { bone, scan, landmarks, planes: planes.collect() }
    }

    /// The largest distance of what is found from what is said, mm: of the bone, the scan, the landmarks, and the planes within 50 mm.
    fn off(&self, found: &Found) -> BTreeMap<&'static str, f64> {
        let of = |lps: &[Point3<f64>]| lps.iter().map(ras).collect::<Vec<_>>();
        let (names, places): (Vec<_>, Vec<_>) = found.list("landmarks").into_iter().unzip();
        let (expected, at): (Vec<_>, Vec<_>) = self.landmarks.iter().cloned().unzip();
        assert_eq!(names, expected);
        let planes = found.scene["planes"].as_object().unwrap();
        assert_eq!(planes.keys().collect::<BTreeSet<_>>(), self.planes.keys().collect());
        let reach = [[0.0, 0.0, 0.0], [50.0, 0.0, 0.0], [0.0, 50.0, 0.0], [0.0, 0.0, 50.0]].map(Point3::from);
        let of_plane = |(name, pose): (&String, &Isometry3<f64>)| {
            let found = isometry(&planes[name]);
            farthest(&reach.map(|at| found * at), &reach.map(|at| ras(&(pose * at))))
        };
        BTreeMap::from([
            ("bone", farthest(&found.points("bone"), &of(&self.bone))),
            ("scan", farthest(&found.points("scan"), &of(&self.scan))),
            ("landmarks", farthest(&places, &of(&at))),
            ("planes", self.planes.iter().map(of_plane).fold(0.0, f64::max)),
        ])
    }
}

/// The files of a scene, each by its name in the folder of the archive.
fn files(scene: &Path) -> Vec<(String, Vec<u8>)> {
    let mut archive = zip::ZipArchive::new(fs::File::open(scene).unwrap()).unwrap();
    let read = |k| {
        let mut entry = archive.by_index(k).unwrap();
        let mut bytes = Vec::new();
        entry.read_to_end(&mut bytes).unwrap();
        (entry.name().unwrap().strip_prefix("scene/").unwrap().to_owned(), bytes)
    };
    (0..zip::ZipArchive::new(fs::File::open(scene).unwrap()).unwrap().len()).map(read).collect()
}

/// A scene in which a text is another, the same number of times as it is listed.
fn changed(scene: &Path, changes: &[(&str, String, String)]) -> PathBuf {
    let out = scene.with_file_name("changed.mrb");
    let mut zip = zip::ZipWriter::new(fs::File::create(&out).unwrap());
    let mut left = changes.len();
    for (name, mut bytes) in files(scene) {
        for (_, old, new) in changes.iter().filter(|(of, ..)| *of == name) {
            let at =
                bytes.windows(old.len()).position(|part| part == old.as_bytes()).unwrap_or_else(|| panic!("{old}"));
            bytes.splice(at..at + old.len(), new.bytes());
            left -= 1;
        }
        zip.start_file(format!("scene/{name}"), zip::write::SimpleFileOptions::default()).unwrap();
        zip.write_all(&bytes).unwrap();
    }
    assert_eq!(left, 0);
    zip.finish().unwrap();
    out
}

const NEAR_MM: f64 = 1e-3;

#[test]
fn a_procedure_on_a_plan_of_3d_slicer_comes_out_as_a_scene_that_lies_where_the_results_say() {
    let Some(python) = python_with("a scene for 3D Slicer, read by another reader", &[], "numpy") else { return };
    let dir = tempfile::tempdir().unwrap();
    let (drawn, plan) = shipped("P");
    let [_, drawn] = drawn.save(dir.path());
    let rest = dir.path().join("markers.json");
    fs::write(&rest, markers(&plan)).unwrap();
    let set = [format!("plan.path={}", drawn.display()), format!("plan.rest={}", rest.display())];
    let arguments = ["--set", &set[0], "--set", &set[1], "--set", "export.scene=true"];
    let ran = run_whole("graphs/fibula_recorded.toml", &arguments);
    let scene = ran.path("export/scene.mrb");
    let (said, found) = (Said::by(&ran, &plan), Found::read(&python, &scene).unwrap());
    assert_eq!(said.planes.keys().collect::<Vec<_>>(), ["FibulaPlane0_A", "FibulaPlane0_B"]);
    let off = said.off(&found);
    assert!(off.values().all(|mm| *mm < NEAR_MM), "{off:?}");

    // Its colours are the distances that the exported scan has.
    assert_eq!(found.scene["models"]["scan"]["shown"], "distance_mm");
    let exported = read_cloud(&ran.path("export/scan.vtk"), 1.0, "ct").unwrap().cloud;
    let (name, distances) = &exported.extras()[0];
    assert_eq!((&**name, &found.numbers("scan.distance_mm")[..]), ("distance_mm", &distances[..]));
    assert!(distances.iter().any(|mm| *mm < -0.05) && distances.iter().any(|mm| *mm > 0.05));

    // This program's own reader finds the plan in it, too, and every file of markups follows the schema.
    let picked = read_scene(&scene).unwrap();
    assert_eq!((picked.space, picked.planes.len(), picked.points.len()), (Space::Lps, 2, 3));
    for plane in &picked.planes {
        let off = (plane.isometry().unwrap().to_homogeneous() - said.planes[&*plane.name].to_homogeneous()).amax();
        assert!(off < 1e-6, "{}: {off}", plane.name);
    }
    let validator = jsonschema::draft7::new(&rules()).unwrap();
    for (name, bytes) in files(&scene).iter().filter(|(name, _)| name.ends_with(".json")) {
        assert!(validator.is_valid(&serde_json::from_slice(bytes).unwrap()), "{name}");
    }
    let again = run_whole("graphs/fibula_recorded.toml", &arguments);
    assert_eq!(
        fs::read(&scene).unwrap(),
        fs::read(again.path("export/scene.mrb")).unwrap(),
        "the same run, the same bytes"
    );

    // What is wrong with a scene without failing to load is seen.
    let all = files(&scene);
    let text = |name: &str| String::from_utf8(all.iter().find(|(of, _)| of == name).unwrap().1.clone()).unwrap();
    let (mrml, tfm) = (text("scene.mrml"), text("Data/scan_to_ct.tfm"));
    let (_, rest) = mrml.split_once("matrixTransformToParent=\"").unwrap();
    let matrix = rest.split_once('"').unwrap().0;
    let numbers: Vec<f64> = matrix.split(' ').map(|n| n.parse().unwrap()).collect();
    let inverse = isometry_from_matrix(&Matrix4::from_row_slice(&numbers)).unwrap().inverse().to_homogeneous();
    let inverse = inverse.transpose().iter().map(f64::to_string).collect::<Vec<_>>().join(" ");
    let t_ct_scan = read_pose(&ran.path("export/scan_to_ct.tfm"), 1.0).unwrap().isometry;
    let of = |name, old: &str, new: &str| (name, old.to_owned(), new.to_owned());
    let swapped =
        [of("scene.mrml", matrix, &inverse), of("Data/scan_to_ct.tfm", &tfm, &itk_text(&t_ct_scan.inverse(), &[]))];
    let transform = mrml.split_once("transform:").unwrap().1.split_once(';').unwrap().0;
    let mirrored = |name| [of(name, "SPACE=LPS", "SPACE=RAS")];
    for (changes, what) in [
        (&swapped[..], "scan"),
        (&mirrored("Data/scan.vtk")[..], "scan"),
        (&[of("scene.mrml", &format!("transform:{transform};"), "")], "scan"),
        (&mirrored("Data/bone.stl"), "bone"),
        (&[of("Data/plane_1.mrk.json", "\"LPS\"", "\"RAS\"")], "planes"),
        (&[of("Data/landmarks.mrk.json", "\"LPS\"", "\"RAS\"")], "landmarks"),
        (
            &[of("Data/plane_1.mrk.json", "Plane0_A", "Plane0_B"), of("Data/plane_2.mrk.json", "Plane0_B", "Plane0_A")],
            "planes",
        ),
    ] {
        let off = said.off(&Found::read(&python, &changed(&scene, changes)).unwrap());
        let (wrong, right): (Vec<_>, Vec<_>) = off.iter().partition(|(name, _)| **name == what);
        assert!(wrong.iter().all(|(_, mm)| **mm > 1.0), "{changes:?}: {off:?}");
        assert!(right.iter().all(|(_, mm)| **mm < NEAR_MM), "{changes:?}: {off:?}");
    }
    for (changes, expected) in [
        (&swapped[..1], "the scene and the file of a transform say the same"),
        (&swapped[1..], "the scene and the file of a transform say the same"),
        (&[of("Data/plane_1.mrk.json", "\"mm\"", "\"um\"")], "coordinateUnits"),
        (&[of("scene.mrml", "distance_mm\" colorNodeID", "distance\" colorNodeID")], "shown in scalars"),
        (
            &[
                of("scene.mrml", "<MarkupsPlaneJsonStorage id", "<MarkupsJsonStorage id"),
                of("scene.mrml", "</MarkupsPlaneJsonStorage", "</MarkupsJsonStorage"),
            ],
            "startswith",
        ),
        (&[of("scene.mrml", "Data/bone.stl", "Data/bone2.stl")], "bone2.stl"),
    ] {
        let refused = Found::read(&python, &changed(&scene, changes)).unwrap_err();
        assert!(refused.contains(expected), "{expected}: {refused}");
    }
    // The scene of another patient, which is right in itself.
    let other = run_whole("graphs/fibula.toml", &["--set", "graph.seed=43", "--set", "export.scene=true"]);
    let other = Found::read(&python, &other.path("export/scene.mrb")).unwrap();
    assert_ne!(other.points("bone").len(), said.bone.len());
    assert_ne!(other.points("scan").len(), said.scan.len());
}

#[test]
fn a_refused_registration_is_a_scene_of_the_bone_and_the_plan_alone() {
    let Some(python) = python_with("a scene for 3D Slicer without a scan", &[], "numpy") else { return };
    let set = ["--no-record", "--set", "export.scene=true", "--set", "icp.max_pair_distance_mm=0.000001"];
    let ran = crate::common::run("graphs/fibula.toml", &set);
    assert_eq!(ran.code, 3, "{}", ran.stderr);
    let found = Found::read(&python, &ran.path("export/scene.mrb")).unwrap();
    assert_eq!(found.scene["models"].as_object().unwrap().keys().collect::<Vec<_>>(), ["bone"]);
    assert_eq!(found.scene["transforms"], serde_json::json!({}));
    assert_eq!((found.list("landmarks").len(), found.scene["planes"].as_object().unwrap().len()), (3, 2));
}

#[test]
fn two_files_are_registered_into_a_scene_in_the_space_that_is_said_of_them() {
    let Some(python) = python_with("a scene for 3D Slicer of two files", &[], "numpy") else { return };
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    let data = root().join("tests/data/folder");
    // Without what it states of its space.
    let mut bone = fs::read(data.join("bone.stl")).unwrap();
    bone[..80].fill(0);
    fs::write(at("bone.stl"), bone).unwrap();
    fs::copy(data.join("scan.ply"), at("scan.ply")).unwrap();
    fs::write(at("targets.csv"), "label,x,y,z\nT1,-80,-84,-950\n\"a \"\"b\"\", <c>\",-81,-85,-940\n").unwrap();
    let register = |target: &str, options: &[&str]| {
        let mut command = osteoflow();
        command.current_dir(dir.path()).args(["register", target, "scan.ply", "--camera", "0,0,0"]);
        let output = command.args(["--format", "json"]).args(options).output().unwrap();
        let answer = serde_json::from_slice::<Value>(&output.stdout).unwrap_or_default();
        (output.status.code(), answer, String::from_utf8_lossy(&output.stderr).into_owned())
    };
    let (code, _, said) = register("bone.stl", &["--out", "unknown.mrb"]);
    assert!(
        code == Some(2) && said.contains("unknown.mrb: a .mrb is always LPS, and bone.stl and scan.ply do not"),
        "{said}"
    );
    assert!(!at("unknown.mrb").exists());
    let mesh = read_mesh(&at("bone.stl"), 1.0, "ct", SurfaceOrigin::User).unwrap().mesh;
    let corners: Vec<_> = (0..mesh.faces().len()).flat_map(|face| mesh.corners(face)).collect();
    let scan = read_cloud(&at("scan.ply"), 1.0, "camera").unwrap().cloud.points().to_vec();
    for space in ["LPS", "RAS"] {
        let file = format!("{space}.mrb");
        let (code, answer, said) =
            register("bone.stl", &["--space", space, "--targets", "targets.csv", "--out", &file]);
        assert_eq!(code, Some(0), "{said}");
        let found = Found::read(&python, &at(&file)).unwrap();
        let numbers: Vec<f64> = serde_json::from_value(answer["T"].clone()).unwrap();
        let t_bone_scan = isometry_from_matrix(&Matrix4::from_row_slice(&numbers)).unwrap();
        let of = |numbers: &[Point3<f64>]| -> Vec<Point3<f64>> {
            numbers.iter().map(|p| if space == "RAS" { *p } else { ras(p) }).collect()
        };
        let moved: Vec<_> = scan.iter().map(|p| t_bone_scan * p).collect();
        let off = [("bone", &corners), ("scan", &moved)].map(|(name, at)| farthest(&found.points(name), &of(at)));
        assert!(off.iter().all(|mm| *mm < NEAR_MM), "{space}: {off:?}");
        let targets = found.list("targets");
        let expected = of(&[Point3::new(-81.0, -85.0, -940.0), Point3::new(-80.0, -84.0, -950.0)]);
        for (k, label) in ["a \"b\", <c>", "T1"].iter().enumerate() {
            let (_, at) = targets.iter().find(|(name, _)| name == label).unwrap();
            assert!((at - expected[k]).norm() < 1e-9, "{space} {label}: {at}");
        }
    }
    // Of a bone that is known by points there is no distance, and no colour that claims one.
    let csv: String = mesh.vertices().iter().map(|p| format!("{},{},{}\n", p.x, p.y, p.z)).collect();
    fs::write(at("points.csv"), format!("x,y,z\n{csv}")).unwrap();
    let (code, _, said) = register("points.csv", &["--space", "LPS", "--out", "points.mrb"]);
    assert_eq!(code, Some(0), "{said}");
    let found = Found::read(&python, &at("points.mrb")).unwrap();
    assert_eq!(found.scene["models"]["scan"], serde_json::json!({ "columns": [], "shown": null }));
    assert!(farthest(&found.points("bone"), &mesh.vertices().iter().map(ras).collect::<Vec<_>>()) < 1e-9);
}

#[test]
fn fiducials_as_text_are_what_3d_slicers_source_reads() {
    let Some(python) = python_with("fiducials of 3D Slicer as text, read by another reader", &[], "numpy") else {
        return;
    };
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("points.fcsv");
    let points = [
        NamedPoint::new("P1", Point3::new(1.5, -2.0, 3.25)),
        NamedPoint::new("a \"b\", c", Point3::new(-4.0, 5.0, 1.0 / 3.0)),
    ];
    for space in [Space::Lps, Space::Ras] {
        write_fcsv(&file, &points, space).unwrap();
        let script = "import json, sys; sys.path.insert(0, 'tests/clients'); import scene; print(json.dumps(scene.fcsv(open(sys.argv[1]).read())))";
        let output = Command::new(&python).current_dir(root()).args(["-c", script]).arg(&file).output().unwrap();
        let read: Value = serde_json::from_slice(&output.stdout)
            .unwrap_or_else(|_| panic!("{}", String::from_utf8_lossy(&output.stderr)));
        for expected in &points {
            assert_eq!(point(&read[&*expected.name]), ras(&expected.position), "{space} {}", expected.name);
        }
    }
}
