#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test, with its line")]

use super::*;
use osteoflow_geometry::{
    Anatomy, Planes,
    nalgebra::{Point3, Vector3},
};

fn plan() -> Value {
    json!({
        "units": "mm",
        "landmarks": { "P1": [1.1, 2.0, -900.3], "P2": [6.0, 0.7, -870.0], "P3": [1.5, 2.2, -875.1] },
        "assessment": { "M1": [0.1, 9.0, -860.0] },
        "planes": [{ "name": "distal", "matrix": [[1, 0, 0, 5.5], [0, 1, 0, 0], [0, 0, 1, -880.25], [0, 0, 0, 1]] }],
    })
}

fn known() -> SurgicalPlan {
    SurgicalPlan {
        landmarks: Points::new("ct", []),
        assessment: Points::new("ct", []),
        planes: Planes::new("ct", []),
        axes: None,
        anatomy: Some(Anatomy {
            malleolus_tip: Point3::new(0.0, 0.0, -1000.0),
            proximal: Vector3::z_axis(),
            lateral: -Vector3::x_axis(),
            posterior: Vector3::y_axis(),
        }),
        t_phantom_phantom_marker: None,
        t_camera_camera_marker_nominal: None,
        surface: None,
    }
}

fn save(picks: &Picks, what: &str, value: &Value) -> Result<Value, String> {
    let door = if what == "plan" { Door::SavePlan } else { Door::SavePairs };
    picks.save(door, value.to_string().as_bytes(), Known::default())
}

#[test]
fn a_plan_is_written_as_it_is_into_a_new_folder_each_time() {
    let dir = tempfile::tempdir().unwrap();
    let picks = Picks::new(dir.path().join("made/when/needed"));
    let first = save(&picks, "plan", &plan()).unwrap();
    let second = save(&picks, "plan", &plan()).unwrap();
    let names = |saved: &Value| -> Vec<String> {
        let files = saved["files"].as_array().unwrap().iter();
        files.map(|f| Path::new(f.as_str().unwrap()).strip_prefix(dir.path()).unwrap().display().to_string()).collect()
    };
    let all = ["plan.json", "landmarks.mrk.json", "assessment.mrk.json", "planes.mrk.json"];
    assert_eq!(names(&first), all.map(|name| format!("made/when/needed/picks-1/{name}")));
    assert_eq!(names(&second), all.map(|name| format!("made/when/needed/picks-2/{name}")));
    let message = first["message"].as_str().unwrap();
    assert!(message.starts_with("3 landmarks, 1 assessment points and 1 planes are saved in"), "{message}");
    assert!(message.contains("no anatomy, axes, phantom marker pose, nominal camera marker pose"), "{message}");
    let back = read_plan(Path::new(first["plan"].as_str().unwrap())).unwrap();
    assert_eq!(back.notes, [""; 0]);
    assert_eq!(back.plan.landmarks.points[0].position, Point3::new(1.1, 2.0, -900.3));
    assert_eq!(back.plan.planes.planes[0].isometry().unwrap().translation.z, -880.25);
    let slicer: Value = serde_json::from_slice(&fs::read(first["files"][1].as_str().unwrap()).unwrap()).unwrap();
    let markup = &slicer["markups"][0];
    assert_eq!(markup["coordinateSystem"], "LPS");
    assert_eq!(markup["controlPoints"][0]["position"], json!([1.1, 2.0, -900.3]));
}

#[test]
fn what_the_page_does_not_see_comes_from_the_known_plan_and_a_picked_tip_replaces_its() {
    let dir = tempfile::tempdir().unwrap();
    let picks = Picks::new(dir.path());
    let read = |saved: Value| read_plan(Path::new(saved["plan"].as_str().unwrap())).unwrap().plan;
    let whole = picks
        .save(Door::SavePlan, plan().to_string().as_bytes(), Known { plan: Some(&known()), made_for: None })
        .unwrap();
    assert!(!whole["message"].as_str().unwrap().contains("anatomy"), "{whole}");
    assert_eq!(read(whole).anatomy, known().anatomy);
    let mut moved = plan();
    moved["malleolus_tip"] = json!([1.0, 0.0, -1001.0]);
    let saved = read(
        picks
            .save(Door::SavePlan, moved.to_string().as_bytes(), Known { plan: Some(&known()), made_for: None })
            .unwrap(),
    );
    let expected = Anatomy { malleolus_tip: Point3::new(1.0, 0.0, -1001.0), ..known().anatomy.unwrap() };
    assert_eq!(saved.anatomy, Some(expected));
    // A tip alone is kept in the file, and the message says that the anatomy is not whole.
    let alone = save(&picks, "plan", &moved).unwrap();
    assert!(alone["message"].as_str().unwrap().contains("the plan gives no anatomy"), "{alone}");
    let text = fs::read_to_string(alone["plan"].as_str().unwrap()).unwrap();
    assert_eq!(serde_json::from_str::<Value>(&text).unwrap()["malleolus_tip"], json!([1.0, 0.0, -1001.0]));
}

#[test]
fn wrong_plans_are_refused_with_the_reason_and_leave_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("picks");
    let picks = Picks::new(&folder);
    let with = |pointer: &str, value: Value| {
        let mut plan = plan();
        *plan.pointer_mut(pointer).unwrap() = value;
        plan
    };
    let on_a_line = json!({ "P1": [0, 0, 0], "P2": [0.5, 0, 30], "P3": [0, 0, 60] });
    let mut unknown = plan();
    unknown["surgeon"] = json!("N. N.");
    for (plan, expected) in [
        (with("/landmarks/P2", json!([1.1, 2.0, -900.3])), "P1 and P2 are at the same place"),
        (with("/assessment/M1", json!([1.1, 2.0, -900.305])), "P1 and M1 are at the same place"),
        (with("/landmarks", on_a_line), "the points on the bone lie 0.24 mm (RMS) off a line, 1 mm is needed"),
        (with("/landmarks", json!({ "P1": [0, 0, 0], "P2": [9, 0, 0] })), "2 landmarks are picked; 3 are needed"),
        (with("/landmarks/P1", json!([null, 2.0, -900.3])), "key \"landmarks.P1\": 3 numbers are expected"),
        (with("/planes/0/matrix/0/0", json!(-1)), "mirror"),
        (with("/planes", json!([plan()["planes"][0], plan()["planes"][0]])), "the name distal is given twice"),
        (with("/assessment", json!({ "P1": [0, 0, 0] })), "the name P1 is given twice"),
        (with("/assessment", json!({ " ": [0, 0, 0] })), "\" \" is no name"),
        (with("/assessment", json!({ "a\nb": [0, 0, 0] })), "\"a\\nb\" is no name"),
        (with("/units", json!("m")), "key \"units\""),
        (unknown, "unknown keys: surgeon"),
    ] {
        let message = save(&picks, "plan", &plan).unwrap_err();
        assert!(message.contains(expected), "{message} lacks {expected}");
    }
    for (what, body, expected) in [
        (Door::SavePlan, &b"{"[..], "this is no JSON"),
        (Door::SavePlan, b"\xff", "no UTF-8"),
        (Door::SavePlan, br#"{"landmarks": {"P1": [1e999, 0, 0]}}"#, "out of range"),
        (Door::Region, b"{}", "this cannot be saved"),
        (Door::SavePairs, b"[]", "these are no picked pairs"),
    ] {
        let message = picks.save(what, body, Known::default()).unwrap_err();
        assert!(message.contains(expected), "{message} lacks {expected}");
    }
    assert!(
        picks.save(Door::SavePlan, &vec![b' '; MAX_BYTES + 1], Known::default()).unwrap_err().contains("are too long")
    );
    assert!(!folder.exists(), "nothing is left");
    // A folder that cannot be written: it is a file.
    fs::write(&folder, "").unwrap();
    let message = save(&picks, "plan", &plan()).unwrap_err();
    assert!(message.contains("cannot be written") && message.contains("--picks DIR"), "{message}");
}

#[test]
fn pairs_are_written_each_in_its_frame_and_those_that_do_not_fit_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let picks = Picks::new(dir.path());
    let list = |points: &[(&str, [f64; 3])]| -> Value {
        points.iter().map(|(name, p)| json!({ "name": name, "position": p })).collect()
    };
    let bone = [("P1", [0.0, 0.0, 0.0]), ("P2", [30.0, 0.0, 0.0]), ("P3", [0.0, 20.0, 0.0])];
    // A quarter turn about z and a shift.
    let scan = bone.map(|(name, [x, y, z])| (name, [5.0 - y, x - 7.0, z + 100.0]));
    let saved = save(&picks, "pairs", &json!({ "bone": list(&bone), "scan": list(&scan) })).unwrap();
    assert!(saved["fre_mm"].as_f64().unwrap() < 1e-9, "{saved}");
    let read = |k: usize| {
        let file = saved["files"][k].as_str().unwrap();
        osteoflow_formats::picked_points::read_picked_points(Path::new(file)).unwrap().points
    };
    assert_eq!(read(0)[1].position, Point3::new(30.0, 0.0, 0.0));
    assert_eq!((&*read(1)[2].name, read(1)[2].position), ("P3", Point3::new(-15.0, -7.0, 100.0)));

    let swapped = [("P1", scan[1].1), ("P2", scan[0].1), scan[2]];
    let doubted = save(&picks, "pairs", &json!({ "bone": list(&bone), "scan": list(&swapped) })).unwrap();
    let message = doubted["message"].as_str().unwrap();
    assert!(
        message.contains("P1 to P3 is 20.0 mm on the bone and 36.1 mm on the scan, were")
            || message.contains("were two points exchanged?"),
        "{message}"
    );
    for (bone, scan, expected) in [
        (list(&bone[..2]), list(&scan[..2]), "2 points are picked on the bone"),
        (list(&bone), list(&scan[..2]), "2 points are picked on the scan"),
        (list(&bone), list(&[scan[0], scan[1], ("P4", scan[2].1)]), "has no point of that name on the other side"),
        (list(&bone), list(&[scan[0], scan[1], ("P3", scan[1].1)]), "P2 and P3 are at the same place"),
        (list(&[bone[0], bone[1], ("P3", [60.0, 0.1, 0.0])]), list(&scan), "the points on the bone lie"),
    ] {
        let message = save(&picks, "pairs", &json!({ "bone": bone, "scan": scan })).unwrap_err();
        assert!(message.contains(expected), "{message} lacks {expected}");
    }
    let more = json!({ "bone": list(&bone), "scan": list(&scan), "more": 1 });
    assert!(save(&picks, "pairs", &more).unwrap_err().contains("unknown field `more`"));
}
