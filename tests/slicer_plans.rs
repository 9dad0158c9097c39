//! Plans drawn in 3D Slicer with BoneReconstructionPlanner, in the form in which 3D Slicer saves them, and the markups that we write.

use crate::common::{isometry, json, osteoflow, root, run_whole};
use osteoflow_formats::{
    Space,
    picked_points::{read_scene, write_mrk_json, write_planes_mrk_json, write_roi_mrk_json},
    plan_file::{PlanRole, plan_of_picked, read_plan},
};
use osteoflow_geometry::{
    NamedPoint, Planes, SurgicalPlan,
    nalgebra::{Isometry3, Matrix4, Point3, Vector3, Vector4},
};
use serde_json::{Value, json};
use std::{fs, io::Write as _, path::Path};

const TURNED: Vector4<f64> = Vector4::new(-1.0, -1.0, 1.0, 1.0);

fn rows(matrix: &Matrix4<f64>) -> Vec<f64> {
    matrix.transpose().iter().copied().collect()
}

/// A plane of three points as `vtkMRMLMarkupsPlaneJsonStorageNode` writes it; `t_lps_plane` in units of `unit_mm`.
fn saved(name: &str, t_lps_plane: &Isometry3<f64>, space: Space, units: (Value, f64)) -> Value {
    let mut pose = t_lps_plane.to_homogeneous();
    pose.fixed_view_mut::<3, 1>(0, 3).scale_mut(1.0 / units.1);
    let (base, object) = match space {
        Space::Ras => (Matrix4::from_diagonal(&TURNED) * pose, Matrix4::identity()),
        _ => (pose, Matrix4::from_diagonal(&TURNED)),
    };
    let column = |k: usize| base.fixed_view::<3, 1>(0, k).into_owned();
    let point = |k: usize, at: Vector3<f64>| {
        json!({ "id": (k + 1).to_string(), "label": format!("{name}-{}", k + 1), "position": at.as_slice(), "selected": true,
                "locked": false, "visibility": false, "positionStatus": "defined" })
    };
    let corners = [column(3), column(3) + column(0) * 20.0 / units.1, column(3) + column(1) * 20.0 / units.1];
    let orientation: Vec<f64> = base.fixed_view::<3, 3>(0, 0).transpose().iter().copied().collect();
    json!({
        "type": "Plane", "coordinateSystem": space.to_string(), "coordinateUnits": units.0, "locked": true,
        "fixedNumberOfControlPoints": false, "labelFormat": "%N-%d", "lastUsedControlPointNumber": 3, "planeType": "threePoints",
        "sizeMode": "auto", "autoScalingFactor": 1.0, "center": column(3).as_slice(), "normal": column(2).as_slice(),
        "objectToBase": rows(&object), "baseToNode": rows(&base), "orientation": orientation, "size": [40.0, 40.0, 0.0],
        "planeBounds": [-20.0, 20.0, -20.0, 20.0], "controlPoints": corners.iter().enumerate().map(|(k, at)| point(k, *at)).collect::<Vec<_>>(),
        "measurements": [], "display": { "visibility": true, "opacity": 1.0 }
    })
}

fn file(markups: &[Value]) -> String {
    let schema = "https://raw.githubusercontent.com/slicer/slicer/master/Modules/Loadable/Markups/Resources/Schema/markups-schema-v1.0.3.json#";
    json!({ "@schema": schema, "markups": markups }).to_string()
}

fn list(kind: &str, labels: &[(&str, [f64; 3])]) -> Value {
    let points: Vec<Value> = labels
        .iter()
        .map(|(label, at)| json!({ "label": label, "position": at, "positionStatus": "defined" }))
        .collect();
    json!({ "type": kind, "coordinateSystem": "LPS", "coordinateUnits": "mm", "controlPoints": points })
}

/// A scene: nodes of markups with the transforms above them, and other elements.
#[derive(Clone, Default)]
pub(crate) struct Scene {
    /// Name, transform and content.
    nodes: Vec<(String, Option<&'static str>, Value)>,
    others: String,
}

impl Scene {
    /// Each file by its name.
    fn files(&self) -> Vec<(String, String)> {
        let mut text = format!(
            "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<MRML version=\"Slicer4.4.0\" userTags=\"\">\n{}\n",
            self.others
        );
        let mut files = Vec::new();
        for (k, (name, transform, markup)) in self.nodes.iter().enumerate() {
            let kind = markup["type"].as_str().unwrap();
            let transform = transform.map_or_else(String::new, |id| format!("transform:{id};"));
            text += &format!(
                " <Markups{kind} id=\"node{k}\" name=\"{name}\" references=\"display:display{k};storage:storage{k};{transform}\"></Markups{kind}>\n \
                 <MarkupsJsonStorage id=\"storage{k}\" name=\"MarkupsJsonStorage\" fileName=\"Data/{k}%20of%20{name}.mrk.json\"></MarkupsJsonStorage>\n"
            );
            files.push((format!("Data/{k} of {name}.mrk.json"), file(std::slice::from_ref(markup))));
        }
        files.push(("planned.mrml".into(), text + "</MRML>\n"));
        files
    }

    /// The scene in a folder and as an archive beside it.
    pub(crate) fn save(&self, dir: &Path) -> [std::path::PathBuf; 2] {
        fs::create_dir_all(dir.join("Data")).unwrap();
        let mut zip = zip::ZipWriter::new(fs::File::create(dir.join("planned.mrb")).unwrap());
        for (name, text) in self.files() {
            fs::write(dir.join(&name), &text).unwrap();
            zip.start_file(format!("planned/{name}"), zip::write::SimpleFileOptions::default()).unwrap();
            zip.write_all(text.as_bytes()).unwrap();
        }
        zip.finish().unwrap();
        ["planned.mrml", "planned.mrb"].map(|name| dir.join(name))
    }

    fn plan(&self) -> Result<(SurgicalPlan, Vec<String>), String> {
        let dir = tempfile::tempdir().unwrap();
        let [scene, archive] = self.save(dir.path());
        let read = |path: &Path| {
            read_scene(path).and_then(|picked| plan_of_picked(path, &picked, &[])).map(|read| (read.plan, read.notes))
        };
        let shown = |path: &Path, text: String| text.replace(&format!("{}/", path.parent().unwrap().display()), "");
        let (beside, inside) = (read(&scene), read(&archive));
        // A folder and an archive are read alike, notes and refusals too.
        match (beside, inside) {
            (Ok((a, notes)), Ok((b, _))) => {
                assert_eq!(a, b);
                Ok((a, notes))
            }
            (Err(a), Err(b)) => {
                let inside = shown(&archive, b.to_string())
                    .replace("planned.mrb/planned/", "")
                    .replace("planned.mrb", "planned.mrml");
                assert_eq!(shown(&scene, a.to_string()), inside);
                Err(shown(&scene, a.to_string()))
            }
            (a, b) => panic!("{a:?}\n{b:?}"),
        }
    }

    fn with(mut self, others: &str) -> Self {
        self.others += others;
        self
    }

    /// The same with a change to the file of node `k`.
    fn changed(&self, k: usize, change: impl Fn(&mut Value)) -> Self {
        let mut scene = self.clone();
        change(&mut scene.nodes[k].2);
        scene
    }

    fn below(&self, transform: &'static str) -> Self {
        let mut scene = self.clone();
        scene.nodes.iter_mut().for_each(|node| node.1 = Some(transform));
        scene
    }
}

const MM: fn() -> (Value, f64) = || (json!("mm"), 1.0);

/// The cuts of the shipped plan: the first is the distal end of a segment, the second the proximal one.
fn cuts() -> [Isometry3<f64>; 2] {
    let plan = json(&root().join("tests/data/procedure/plan.json"));
    [0, 1].map(|k| isometry(&plan["planes"][k]["matrix"]))
}

fn planned(space: Space, units: (Value, f64)) -> Scene {
    let [a, b] = cuts();
    let node = |name: &str, pose| (name.to_owned(), None, saved(name, pose, space, units.clone()));
    Scene { nodes: vec![node("FibulaPlane0_A", &a), node("FibulaPlane0_B", &b)], others: String::new() }
}

/// The largest distance of planes from the cuts, mm, at their origins and at the ends of vectors of 100 mm on them; and whether both
/// normals are as drawn.
fn off(planes: &Planes, expected: &[Isometry3<f64>; 2]) -> (f64, bool) {
    assert_eq!(planes.planes.iter().map(|p| &*p.name).collect::<Vec<_>>(), ["FibulaPlane0_A", "FibulaPlane0_B"]);
    let reach = [Point3::origin(), Point3::new(100.0, 0.0, 0.0), Point3::new(0.0, 100.0, 0.0)];
    let of = |(k, expected): (usize, &Isometry3<f64>)| {
        let plane = planes.planes[k].isometry().unwrap();
        let heights = reach.map(|at| (expected.inverse() * (plane * at)).z.abs());
        heights.into_iter().fold((plane * Point3::origin() - expected * Point3::origin()).norm(), f64::max)
    };
    let as_they_are = (0..2).all(|k| planes.planes[k].normal().unwrap().dot(&(expected[k] * Vector3::z())) > 0.999_999);
    (expected.iter().enumerate().map(of).fold(0.0, f64::max), as_they_are)
}

#[track_caller]
fn assert_planned(scene: &Scene, expected: &[Isometry3<f64>; 2]) -> Vec<String> {
    let (plan, notes) = scene.plan().unwrap_or_else(|error| panic!("{error}"));
    let (mm, as_they_are) = off(&plan.planes, expected);
    assert!(mm < 1e-6 && as_they_are, "{mm} mm, normals as drawn: {as_they_are}");
    notes
}

#[test]
fn one_plan_is_read_in_either_space_and_in_every_way_of_stating_a_unit() {
    let metres = || json!(["m", "UCUM", "meter"]);
    for space in [Space::Lps, Space::Ras] {
        for units in [
            MM(),
            (json!(["mm", "UCUM", "millimeter"]), 1.0),
            (json!(["mm", "UCUM"]), 1.0),
            (metres(), 1000.0),
            (json!("um"), 1e-3),
            (Value::Null, 1.0),
        ] {
            assert_planned(&planned(space, units), &cuts());
        }
    }
    let numeric = |scene: Scene, system: Value| {
        let both = scene.changed(0, |m| m["coordinateSystem"] = system.clone());
        both.changed(1, |m| m["coordinateSystem"] = system.clone())
    };
    assert_planned(&numeric(planned(Space::Ras, MM()), json!(0)), &cuts());
    assert_planned(&numeric(planned(Space::Lps, MM()), json!("1")), &cuts());
    // Slicer takes a file that states nothing for LPS.
    let notes = assert_planned(&numeric(planned(Space::Lps, MM()), Value::Null), &cuts());
    assert!(notes.iter().any(|note| note.contains("states no space")), "{notes:?}");
    // A file of six digits, without the matrices, or with control points alone.
    for keys in [
        &["baseToNode", "objectToBase"][..],
        &["orientation"],
        &["center", "normal", "orientation", "baseToNode", "objectToBase"],
    ] {
        let strip = |m: &mut Value| keys.iter().for_each(|key| drop(m.as_object_mut().unwrap().remove(*key)));
        assert_planned(&planned(Space::Ras, MM()).changed(0, strip).changed(1, strip), &cuts());
    }
}

#[test]
fn what_contradicts_itself_or_leaves_a_side_open_is_refused_by_name() {
    let whole = planned(Space::Lps, MM());
    let negated = |m: &mut Value, key: &str| {
        let numbers: Vec<f64> = m[key].as_array().unwrap().iter().map(|n| -n.as_f64().unwrap()).collect();
        m[key] = json!(numbers);
    };
    let swapped = |scene: &Scene, a: usize, b: usize| {
        let mut scene = scene.clone();
        let (first, second) = (scene.nodes[a].2.clone(), scene.nodes[b].2.clone());
        (scene.nodes[a].2, scene.nodes[b].2) = (second, first);
        scene
    };
    let turned = |k: usize| {
        let mut scene = whole.clone();
        let over = cuts()[k] * Isometry3::rotation(Vector3::x() * std::f64::consts::PI);
        scene.nodes[k].2 = saved("any", &over, Space::Lps, MM());
        scene
    };
    let renamed = |k: usize, name: &str| {
        let mut scene = whole.clone();
        scene.nodes[k].0 = name.into();
        scene
    };
    let mut copied = whole.clone();
    copied.nodes.push(copied.nodes[0].clone());
    let mut left_over = copied.clone();
    left_over.nodes[2].0 = "FibulaPlane0_A_1".into();
    let mut alone = whole.clone();
    alone.nodes.pop();
    let mirrored = |m: &mut Value| m["coordinateSystem"] = json!("RAS");
    for (scene, expected) in [
        // Its normal, its matrices or its center alone changed: programs would take one or another.
        (
            whole.changed(0, |m| negated(m, "normal")),
            "markups[0].normal: center and normal are not those of its matrices, orientation and control points: 0.000 mm and 180.000 degrees off",
        ),
        (whole.changed(1, |m| negated(m, "orientation")), "markups[0].orientation: "),
        (whole.changed(1, |m| m["center"][2] = json!(-850.0)), "markups[0].normal: "),
        (whole.changed(1, |m| m["controlPoints"][1]["position"][2] = json!(-850.0)), "markups[0].normal: "),
        (whole.changed(0, |m| m["baseToNode"][11] = json!(-880.0)), "markups[0].normal: "),
        (whole.changed(0, |m| m["baseToNode"][0] = json!(3.0)), "markups[0].baseToNode: "),
        // All of it changed alike.
        (turned(0), "\"FibulaPlane0_A\": its normal leads away from \"FibulaPlane0_B\"; is it turned over?"),
        (turned(1), "\"FibulaPlane0_B\": its normal leads towards \"FibulaPlane0_A\"; is it turned over?"),
        (
            swapped(&whole, 0, 1),
            "\"FibulaPlane0_A\": both normals lead from \"FibulaPlane0_B\" to \"FibulaPlane0_A\"; are they swapped, or both turned over?",
        ),
        (copied, "two planes are called \"FibulaPlane0_A\"; rename one of them in 3D Slicer"),
        (left_over, "\"FibulaPlane0_A_1\": \"FibulaPlane0_A\" is the same plane of the same segment"),
        (
            alone,
            "segment 0 has no other plane, so that it is not known which side of this one is kept; name the two planes",
        ),
        (renamed(1, "FibulaPlane1_B"), "segment 0 has no other plane"),
        (renamed(0, "mandibularPlane"), "segment 0 has no other plane"),
        (
            whole.changed(0, |m| m["coordinateUnits"] = json!(["mm", "DCM", "millimeter"])),
            "coordinateUnits: [\"mm\",\"DCM\",\"millimeter\"]: a code, \"UCUM\" and a meaning are expected",
        ),
        (
            whole.changed(0, |m| m["coordinateUnits"] = json!({ "code": "mm" })),
            "coordinateUnits: {\"code\":\"mm\"}: a text, or a list",
        ),
        (whole.changed(0, |m| m["coordinateUnits"] = json!("furlong")), "coordinateUnits: the unit is \"furlong\""),
    ] {
        let error = scene.plan().map_or_else(|error| error, |(plan, _)| panic!("{expected}\n{plan:?}"));
        assert!(error.contains(expected), "{expected}\n{error}");
    }
    // Both files called RAS are turned about z as a whole, which nothing in the scene contradicts; a run warns of planes far from the bone.
    let (plan, _) = whole.changed(0, mirrored).changed(1, mirrored).plan().unwrap();
    assert!(off(&plan.planes, &cuts()).0 > 100.0, "a wrong statement of the space is no small error");
    let notes = whole.changed(0, mirrored).plan().unwrap().1;
    assert!(notes.iter().any(|note| note.contains("mm apart, which is no segment of a fibula")), "{notes:?}");
    // Metres that are called mm leave no segment.
    let notes = planned(Space::Lps, (json!("mm"), 1000.0)).plan().unwrap().1;
    assert!(
        notes
            .iter()
            .any(|note| note.contains("0.034 mm apart, which is no segment of a fibula; are the lengths metres?")),
        "{notes:?}"
    );
}

fn transform(id: &str, attributes: &str) -> String {
    format!(" <LinearTransform id=\"{id}\" name=\"{id} of mine\" {attributes}></LinearTransform>\n")
}

fn matrix(motion_lps: &Isometry3<f64>) -> String {
    let turned = Matrix4::from_diagonal(&TURNED);
    let ras = turned * motion_lps.to_homogeneous() * turned;
    rows(&ras).iter().map(|c| format!("{c:?}")).collect::<Vec<_>>().join(" ")
}

#[test]
fn transforms_above_planes_are_applied_unless_they_move_the_bone_too_and_others_are_refused() {
    let (first, second) = (
        Isometry3::new(Vector3::new(5.0, -7.0, 30.0), Vector3::new(0.1, 0.2, -0.4)),
        Isometry3::new(Vector3::new(-90.0, 3.0, 8.0), Vector3::new(0.0, 1.0, 0.3)),
    );
    let moved = |motion: Isometry3<f64>| cuts().map(|cut| motion * cut);
    let to_parent = |motion: &Isometry3<f64>| format!("matrixTransformToParent=\"{}\"", matrix(motion));
    let whole = planned(Space::Ras, MM());
    let notes = assert_planned(&whole.below("T1").with(&transform("T1", &to_parent(&first))), &moved(first));
    assert!(
        notes.iter().any(|note| note.ends_with("transform \"T1 of mine\" is applied to what is below it")),
        "{notes:?}"
    );
    let from_parent = format!("matrixTransformFromParent=\"{}\"", matrix(&first.inverse()));
    assert_planned(&whole.below("T1").with(&transform("T1", &from_parent)), &moved(first));
    // One above the other, as both ways of referring to it.
    for above in ["references=\"transform:T2;\"", "transformNodeRef=\"T2\""] {
        let both = transform("T1", &format!("{above} {}", to_parent(&first))) + &transform("T2", &to_parent(&second));
        assert_planned(&whole.below("T1").with(&both), &moved(second * first));
        // The bone's surface is below the outer one: places are those of its file.
        let shape =
            format!("{both} <Model id=\"M1\" name=\"fibula\" references=\"transform:T2;storage:S;\"></Model>\n");
        let notes = assert_planned(&whole.below("T1").with(&shape), &moved(first));
        assert!(notes.iter().any(|note| note.contains("moves \"fibula\" too, so it is not applied")), "{notes:?}");
    }
    // Copies in a scene view are as the scene once was.
    let view = format!(
        " <SceneView id=\"V\" name=\"before\">\n{} <MarkupsPlane id=\"x\" name=\"FibulaPlane0_A\" references=\"storage:gone;\"/></SceneView>\n",
        transform("T1", &to_parent(&second))
    );
    assert_planned(&whole.below("T1").with(&(transform("T1", &to_parent(&first)) + &view)), &moved(first));
    // A file of the transform is exact, and counts before what the scene says of it in six digits.
    let dir = tempfile::tempdir().unwrap();
    let stored = whole
        .below("T1")
        .with(&transform("T1", &format!("references=\"storage:TS;\" {}", to_parent(&second))))
        .with(" <TransformStorage id=\"TS\" fileName=\"Data/t.tfm\"/>\n");
    let [scene, archive] = stored.save(dir.path());
    fs::write(dir.path().join("Data/t.tfm"), osteoflow_formats::pose_file::itk_text(&first, &[])).unwrap();
    let read = |path: &Path| read_scene(path).and_then(|picked| plan_of_picked(path, &picked, &[]));
    assert!(off(&read(&scene).unwrap().plan.planes, &moved(first)).0 < 1e-6);
    let missing = read(&archive).unwrap_err().to_string();
    assert!(missing.contains("planned/Data/t.tfm: archive: the scene names it, and: "), "{missing}");
    fs::write(dir.path().join("Data/t.tfm"), b"\x89HDF\r\n\x1a\n").unwrap();
    let of_six_digits = read(&scene).unwrap();
    assert!(off(&of_six_digits.plan.planes, &moved(second)).0 < 1e-6);
    assert!(
        of_six_digits
            .notes
            .iter()
            .any(|note| note.contains("stored as HDF5, which is not read; its six digits in the scene are taken"))
    );
    for (others, expected) in [
        (String::new(), "node \"FibulaPlane0_A\": its transform T1 is not in the scene"),
        (
            transform("T1", "references=\"storage:TS;\""),
            "node \"T1 of mine\": the transform is not linear, or has no matrix; harden it",
        ),
        (" <BSplineTransform id=\"T1\" name=\"bent\"/>".into(), "node \"bent\": the transform is not linear"),
        (transform("T1", "matrixTransformToParent=\"2 0 0 0 0 2 0 0 0 0 2 0 0 0 0 1\""), "is not a rotation"),
        (transform("T1", "matrixTransformToParent=\"-1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1\""), "mirror image"),
        (transform("T1", "matrixTransformToParent=\"1 0 0\""), "16 numbers are expected in its matrix"),
        (transform("T1", &format!("transformNodeRef=\"T1\" {}", to_parent(&first))), "in a ring"),
    ] {
        let error = whole
            .below("T1")
            .with(&others)
            .plan()
            .map_or_else(|error| error, |(plan, _)| panic!("{expected}\n{plan:?}"));
        assert!(error.contains(expected), "{expected}\n{error}");
    }
}

#[test]
fn a_scene_of_a_stranger_reads_nothing_outside_of_it_and_no_more_than_it_may() {
    let dir = tempfile::tempdir().unwrap();
    let whole = planned(Space::Lps, MM());
    for name in ["../0.mrk.json", "/etc/passwd", "C:/0.mrk.json", "Data%2F..%2F..%2F0.mrk.json", "..%5C0.mrk.json"] {
        let files = whole.files();
        let text = &files.last().unwrap().1;
        let text = text.replace("Data/0%20of%20FibulaPlane0_A.mrk.json", name);
        fs::write(dir.path().join("a.mrml"), text).unwrap();
        let error = read_scene(&dir.path().join("a.mrml")).unwrap_err().to_string();
        assert!(
            error.contains("leads out of the scene's folder, and is not followed; save the scene as .mrb"),
            "{error}"
        );
    }
    let archive = |entries: &[(&str, Vec<u8>)]| {
        let path = dir.path().join("b.mrb");
        let mut zip = zip::ZipWriter::new(fs::File::create(&path).unwrap());
        for (name, bytes) in entries {
            zip.start_file(
                *name,
                zip::write::SimpleFileOptions::default().compression_method(zip::CompressionMethod::Deflated),
            )
            .unwrap();
            zip.write_all(bytes).unwrap();
        }
        zip.finish().unwrap();
        read_scene(&path).map_or_else(|error| error.to_string(), |picked| format!("{picked:?}"))
    };
    let scene = |file: &str| {
        format!("<MRML><MarkupsPlane id=\"a\" name=\"a\" references=\"storage:b;\"/><MarkupsJsonStorage id=\"b\" fileName=\"{file}\"/></MRML>").into_bytes()
    };
    let too_much = archive(&[("s/s.mrml", scene("big")), ("s/big", vec![b' '; (256 << 20) + 1])]);
    assert!(
        too_much.contains("b.mrb/s/big: size: it has 268435457 bytes, and at most 268435456 are read"),
        "{too_much}"
    );
    // The same entry again and again counts each time.
    let again: String =
        (0..40).map(|k| format!("<MarkupsPlane id=\"a{k}\" name=\"a{k}\" references=\"storage:b;\"/>")).collect();
    let again = format!("<MRML>{again}<MarkupsJsonStorage id=\"b\" fileName=\"big\"/></MRML>").into_bytes();
    let plane = file(&[saved("a", &cuts()[0], Space::Lps, MM())]).into_bytes();
    let padded = [vec![b' '; 20 << 20], plane].concat();
    let again = archive(&[("s/s.mrml", again), ("s/big", padded)]);
    assert!(again.contains("s/big: size: it has "), "{again}");
    let entities = b"<!DOCTYPE a [<!ENTITY b \"c\">]><MRML>&b;</MRML>".to_vec();
    assert!(archive(&[("s/s.mrml", entities)]).contains("scene: XML with DTD detected"));
    assert!(archive(&[("s/s.mrml", scene("gone"))]).contains("s/gone: archive: the scene names it, and: "));
    let two = file(&[saved("a", &cuts()[0], Space::Lps, MM()), saved("b", &cuts()[0], Space::Lps, MM())]).into_bytes();
    let other = file(&[list("Fiducial", &[("a", [1.0, 2.0, 3.0])])]).into_bytes();
    for (bytes, found) in [(two, "Plane, Plane"), (other, "Fiducial")] {
        let said = archive(&[("s/s.mrml", scene("f")), ("s/f", bytes)]);
        assert!(
            said.contains(&format!("s/f: markups: the scene has one markup of type Plane there, and the file {found}")),
            "{said}"
        );
    }
}

/// The shipped plan as a scene: cuts, landmarks and assessment points, with what else such a scene has.
///
/// Its landmarks are the list `screws`, with the labels `{before}1` to `{before}3`.
pub(crate) fn shipped(before: &str) -> (Scene, Value) {
    let plan = json(&root().join("tests/data/procedure/plan.json"));
    let mut scene = planned(Space::Ras, MM());
    let points = |key: &str| {
        let points = plan[key].as_object().unwrap().iter();
        points.map(|(name, at)| (name.as_str(), [0, 1, 2].map(|k| at[k].as_f64().unwrap()))).collect::<Vec<_>>()
    };
    let mut add = |name: &str, markup: Value| scene.nodes.push((name.into(), None, markup));
    let labels: Vec<(String, [f64; 3])> =
        points("landmarks").iter().map(|(name, at)| (format!("{before}{}", &name[1..]), *at)).collect();
    add("screws", list("Fiducial", &labels.iter().map(|(label, at)| (label.as_str(), *at)).collect::<Vec<_>>()));
    add("Assessment", list("Fiducial", &points("assessment")));
    add("teeth", list("Fiducial", &[("1", [1.0, 2.0, 3.0])]));
    add("mandibularPlane", saved("mandibularPlane", &Isometry3::identity(), Space::Lps, MM()));
    add("fibulaLine", list("Line", &[("fibulaLine-1", [0.0; 3]), ("fibulaLine-2", [1.0; 3])]));
    // The extension calls a measured length so, once for each way of measuring.
    add("S0", list("Line", &[("S0-1", [0.0; 3])]));
    add("S0", list("Line", &[("S0-1", [5.0; 3])]));
    (scene, plan)
}

/// What of a plan is not drawn in 3D Slicer, as a file.
pub(crate) fn markers(plan: &Value) -> String {
    let keys = ["phantom_marker_in_phantom", "camera_marker_nominal_C_T_Mc", "pca_axes_columns_xyz"];
    Value::Object(keys.iter().map(|key| ((*key).to_owned(), plan[*key].clone())).collect()).to_string()
}

#[test]
fn a_plan_of_a_scene_drives_a_procedure_to_the_planes_of_the_same_plan_in_json() {
    let dir = tempfile::tempdir().unwrap();
    let [scene, archive] = shipped("").0.save(dir.path());
    let full = root().join("tests/data/procedure/plan.json");
    let converted = |input: &Path, name: &str, options: &[&str]| {
        let out = dir.path().join(name);
        let output = osteoflow().arg("convert").args([input, &out]).args(options).output().unwrap();
        (String::from_utf8(output.stdout).unwrap(), String::from_utf8(output.stderr).unwrap(), out)
    };
    let map = ["--map", "screws=landmarks", "--map", "screws:1=landmarks", "--rest", full.to_str().unwrap()];
    let (done, notes, plan) = converted(&archive, "plan.json", &map);
    assert!(done.contains("plan.json: a surgical plan: 2 planes, 3 landmarks, 5 assessment points"), "{done}{notes}");
    assert!(notes.contains("\"1\" is a label in several lists; their points are called LIST:LABEL"), "{notes}");
    assert!(
        notes.contains("taken from it: axes, ") && notes.contains("axes and anatomy are right on the same CT only"),
        "{notes}"
    );
    assert!(
        notes.contains("not part of the plan: mandibularPlane, teeth:1, fibulaLine, S0, S0; --map NAME=ROLE"),
        "{notes}"
    );
    let (_, _, same) = converted(&scene, "same.json", &map);
    assert_eq!(fs::read(&plan).unwrap(), fs::read(same).unwrap(), "the folder and the archive give the same plan");

    // Landmarks of the recording are located as P1, P2 and P3.
    let mut renamed = json(&plan);
    let landmarks = renamed["landmarks"].as_object().unwrap().iter().zip(["P1", "P2", "P3"]);
    renamed["landmarks"] =
        landmarks.map(|((_, at), name)| (name.to_owned(), at.clone())).collect::<serde_json::Map<_, _>>().into();
    fs::write(&plan, renamed.to_string()).unwrap();
    let graph = "graphs/fibula_recorded.toml";
    let by = |path: &Path| {
        run_whole(
            graph,
            &[
                "--no-record",
                "--set",
                "verdict.rules.attitude_stated=true",
                "--set",
                &format!("plan.path={}", path.display()),
            ],
        )
    };
    let (of_json, of_scene) = (by(&full), by(&plan));
    for key in ["planes_at_scan", "planes"] {
        let planes = |results: &Value| {
            results[key].as_array().unwrap().iter().map(|plane| isometry(&plane["matrix"])).collect::<Vec<_>>()
        };
        let (expected, found) = (planes(&of_json.results), planes(&of_scene.results));
        assert_eq!((expected.len(), found.len()), (2, 2));
        for (k, (expected, found)) in expected.iter().zip(&found).enumerate() {
            let reach = [Point3::origin(), Point3::new(50.0, 0.0, 0.0), Point3::new(0.0, 0.0, 50.0)];
            let mm = reach.map(|at| (expected * at - found * at).norm()).into_iter().fold(0.0, f64::max);
            assert!(mm < 1e-3, "{key} {k}: {mm} mm");
        }
    }
    // The node takes the archive itself; a scene that names files beside it would leave them out of what a run records.
    let names =
        |path: &Path| read_plan(path).map(|read| read.plan.planes.planes.len()).map_err(|error| error.to_string());
    assert_eq!(names(&archive), Ok(2));
    let refused = names(&scene).unwrap_err();
    assert!(refused.contains("a scene names further files") && refused.contains("save it as .mrb"), "{refused}");
}

#[test]
fn info_says_what_a_scene_holds_and_roles_that_fit_nothing_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let [scene, archive] = shipped("").0.save(dir.path());
    for path in [&scene, &archive] {
        let output = osteoflow().arg("info").arg(path).output().unwrap();
        let text = String::from_utf8(output.stdout).unwrap();
        for expected in [
            "picked points",
            "plane FibulaPlane0_A, plane FibulaPlane0_B, plane mandibularPlane",
            "Fiducial \"screws\" of 3 points",
            "Line \"fibulaLine\" of 2 points",
            "plan.json",
        ] {
            assert!(text.contains(expected), "{expected}\n{text}");
        }
    }
    let picked = read_scene(&archive).unwrap();
    let plan = |name: &str, role: PlanRole| plan_of_picked(&archive, &picked, &[(name.into(), role)]);
    for (name, role, expected) in [
        ("screw", PlanRole::Landmarks, "\"screw\": nothing is called so; there are: FibulaPlane0_A, "),
        ("screws", PlanRole::Plane, "\"screws\": points are no plane; give it another role"),
        ("FibulaPlane0_A", PlanRole::Landmarks, "\"FibulaPlane0_A\": a plane has no points"),
        ("FibulaPlane0_A", PlanRole::Ignored, "\"FibulaPlane0_B\": segment 0 has no other plane"),
    ] {
        let error = plan(name, role).unwrap_err().to_string();
        assert!(error.contains(expected), "{expected}\n{error}");
    }
    let mapped = |roles: [(&str, PlanRole); 2]| {
        let roles = roles.map(|(name, role)| (name.to_owned(), role));
        plan_of_picked(&archive, &picked, &roles).map(|read| read.plan.planes.planes).map_err(|error| error.to_string())
    };
    let (a, b) = ("FibulaPlane0_A", "FibulaPlane0_B");
    let exchanged = mapped([(b, PlanRole::PlaneReversed), (a, PlanRole::PlaneReversed)]).unwrap();
    for (plane, cut) in exchanged.iter().zip([cuts()[1], cuts()[0]]) {
        let apart = plane.isometry().unwrap().translation.vector - cut.translation.vector;
        assert!(apart.norm() < 1e-6 && plane.normal().unwrap().dot(&(cut * Vector3::z())) < -0.999_999, "{plane:?}");
    }
    let refused = mapped([(b, PlanRole::Plane), (a, PlanRole::Plane)]).unwrap_err();
    assert!(refused.contains("\"FibulaPlane0_B\": both normals lead from \"FibulaPlane0_A\""), "{refused}");
    let refused = osteoflow()
        .arg("convert")
        .args([&root().join("tests/data/procedure/bone.stl"), &dir.path().join("a.ply")])
        .args(["--map", "a=plane"])
        .output()
        .unwrap();
    assert!(
        String::from_utf8(refused.stderr)
            .unwrap()
            .contains("--map is for points and planes that become a plan (.json)")
    );
}

#[cfg(unix)]
#[test]
fn the_page_for_users_of_the_planner_runs_as_it_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let (scene, plan) = shipped("P");
    scene.save(at);
    fs::write(at.join("markers.json"), markers(&plan)).unwrap();
    let data = root().join("tests/data/procedure");
    fs::copy(data.join("bone.stl"), at.join("bone.stl")).unwrap();
    crate::common::copy_folder(&root().join("graphs"), &at.join("graphs"));
    fs::create_dir_all(at.join("tests/data")).unwrap();
    crate::common::copy_folder(&data, &at.join("tests/data/procedure"));
    let done = crate::common::page::Page::open("docs/use/slicer-plans.md", at, None).follow(|_| 0, |_, _, _| {});
    assert!(done.len() >= 4 && at.join("plan.json").exists());
    let run = &done.iter().find(|done| done.command.contains("run graphs/fibula_recorded.toml")).unwrap().printed;
    assert!(run.contains("verdict  trusted") && run.contains("  FibulaPlane0_B "), "{run}");
    let bind = osteoflow()
        .arg("convert")
        .arg(at.join("planned.mrb"))
        .arg(at.join("b.json"))
        .arg("--bind")
        .arg(at.join("bone.stl"))
        .output()
        .unwrap();
    assert!(String::from_utf8(bind.stderr).unwrap().contains("a plan (.json) is bound; make one by osteoflow convert"));
}

/// The rules of markups-schema-v1.0.3 of 3D Slicer (583e9b37) for what we write.
pub(crate) fn rules() -> Value {
    let numbers = |n: usize| json!({ "type": "array", "items": { "type": "number" }, "minItems": n, "maxItems": n });
    let text = || json!({ "type": "string" });
    let flag = || json!({ "type": "boolean" });
    let point = json!({ "type": "object", "properties": {
        "id": text(), "label": text(), "description": text(), "associatedNodeID": text(), "position": numbers(3), "orientation": numbers(9),
        "selected": flag(), "locked": flag(), "visibility": flag(),
        "positionStatus": { "enum": ["undefined", "preview", "defined"] } }, "additionalProperties": false });
    let markup = json!({ "type": "object", "required": ["type"], "additionalProperties": false, "properties": {
        "type": { "enum": ["Fiducial", "Line", "Angle", "Curve", "ClosedCurve", "Plane", "ROI"] },
        "coordinateSystem": { "enum": ["LPS", "RAS"] }, "coordinateUnits": { "enum": ["mm", "um"] },
        "name": text(), "description": text(), "roiType": text(), "insideOut": flag(), "planeType": text(), "sizeMode": text(), "autoScalingSizeFactor": { "type": "number" },
        "center": numbers(3), "normal": numbers(3), "size": numbers(3), "planeBounds": numbers(4), "objectToBase": numbers(16),
        "baseToNode": numbers(16), "orientation": numbers(9), "controlPoints": { "type": "array", "items": point } } });
    json!({ "type": "object", "required": ["@schema", "markups"], "properties": {
        "@schema": { "type": "string", "pattern": "markups-schema-v1\\.[0-9]+\\.[0-9]+\\.json#*$" }, "markups": { "type": "array", "items": markup } } })
}

#[test]
fn every_markups_file_that_is_written_follows_the_schema_and_loads_as_what_was_written() {
    let dir = tempfile::tempdir().unwrap();
    let [planes, points, roi] = ["planes", "points", "roi"].map(|name| dir.path().join(format!("{name}.mrk.json")));
    write_planes_mrk_json(&planes, &cuts().map(|pose| ("cut".into(), pose))).unwrap();
    write_mrk_json(&points, &[NamedPoint::new("P1", Point3::new(1.0, -2.0, 3.0))], Space::Ras).unwrap();
    write_roi_mrk_json(&roi, "region", &Point3::new(-1.0, -1.0, -1.0), &Point3::new(1.0, 2.0, 3.0)).unwrap();
    let validator = jsonschema::draft7::new(&rules()).unwrap();
    for path in [&planes, &points, &roi] {
        let errors: Vec<String> =
            validator.iter_errors(&json(path)).map(|error| format!("{}: {error}", error.instance_path())).collect();
        assert_eq!(errors, [""; 0], "{}", path.display());
    }
    let mut two = json(&planes);
    two["markups"][0]["size"] = json!([50.0, 50.0]);
    assert!(!validator.is_valid(&two), "the rules ask for three sizes");
    // As 3D Slicer reads it: the first two rows of both matrices are negated in LPS, and a node is baseToNode times objectToBase, in RAS.
    for (markup, expected) in json(&planes)["markups"].as_array().unwrap().iter().zip(cuts()) {
        let turned = Matrix4::from_diagonal(&TURNED);
        let of = |key: &str| {
            let numbers: Vec<f64> = markup[key].as_array().unwrap().iter().map(|n| n.as_f64().unwrap()).collect();
            turned * Matrix4::from_row_slice(&numbers)
        };
        let lps = turned * of("baseToNode") * of("objectToBase");
        assert!((lps - expected.to_homogeneous()).amax() < 1e-9, "{lps}");
        assert_eq!((&markup["planeType"], &markup["sizeMode"]), (&json!("pointNormal"), &json!("absolute")));
    }
}
