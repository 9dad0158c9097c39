//! Plans that are bound to their surface, and those that are not: what a shift of all landmarks says.

use crate::common::case::{Case, GRAPH};
use crate::common::{Ran, data, json, osteoflow, point, root};
use osteoflow_algorithms::mesh_query::MeshQuery;
use osteoflow_formats::{mesh_or_cloud::read_mesh, plan_file::read_plan};
use osteoflow_geometry::{
    SurfaceOrigin,
    nalgebra::{Rotation3, Unit, Vector3},
};
use serde_json::{Value, json};
use std::{
    fs,
    path::{Path, PathBuf},
};

/// A case with a folder for its plans, and the graph without stylus readings.
struct Plans {
    case: Case,
    dir: tempfile::TempDir,
    plan: Value,
}

impl Plans {
    fn of(case: Case) -> Self {
        let dir = tempfile::tempdir().unwrap();
        let base = root().join(GRAPH);
        let graph = format!("extends = {base:?}\nremove = [\"node.verdict.in.measured\"]\n");
        fs::write(dir.path().join("unmeasured.toml"), graph).unwrap();
        let plan = json(&case.plan);
        Self { case, dir, plan }
    }

    /// Writes a plan and runs with it.
    fn run(&self, plan: &Value, arguments: &[&str]) -> Ran {
        let (file, graph) = (self.dir.path().join("plan.json"), self.dir.path().join("unmeasured.toml"));
        fs::write(&file, plan.to_string()).unwrap();
        self.case.with_graph(graph.to_str().unwrap(), &file, &[&["--no-record"], arguments].concat())
    }

    fn proximal(&self) -> Vector3<f64> {
        point(&self.plan["proximal"]).coords.normalize()
    }

    /// The unbound plan, all of it moved.
    fn displaced(&self, by: Vector3<f64>) -> Value {
        let mut plan = self.plan.clone();
        plan.as_object_mut().unwrap().remove("surface");
        for points in ["landmarks", "assessment"] {
            plan[points].as_object_mut().unwrap().values_mut().for_each(|at| *at = moved(at, by));
        }
        plan["malleolus_tip"] = moved(&plan["malleolus_tip"], by);
        for plane in plan["planes"].as_array_mut().unwrap() {
            // A plane is its matrix, or has a name beside it.
            let matrix = if plane.is_array() { plane } else { &mut plane["matrix"] };
            for k in 0..3 {
                matrix[k][3] = (matrix[k][3].as_f64().unwrap() + by[k]).into();
            }
        }
        plan
    }

    /// The plan with landmarks that were planned elsewhere on the bone, as if all had been aimed wrong.
    fn aimed_off(&self, by: Vector3<f64>) -> Value {
        let bone = MeshQuery::new(&read_mesh(&self.case.bone, 1.0, "ct", SurfaceOrigin::User).unwrap().mesh);
        let mut plan = self.plan.clone();
        for at in plan["landmarks"].as_object_mut().unwrap().values_mut() {
            let on_bone = bone.closest_point(&point(&moved(at, by))).unwrap().point;
            *at = json!(on_bone.coords.as_slice());
        }
        plan
    }
}

fn moved(at: &Value, by: Vector3<f64>) -> Value {
    json!((point(at) + by).coords.as_slice())
}

fn answer(ran: &Ran) -> &str {
    ran.results["verdict"]["answer"].as_str().unwrap_or_else(|| panic!("no verdict: {}", ran.stderr))
}

fn reason<'a>(ran: &'a Ran, rule: &str) -> Option<&'a str> {
    let reasons = ran.results["verdict"]["reasons"].as_array().unwrap();
    reasons.iter().find(|reason| reason["rule"] == rule).and_then(|reason| reason["reason"].as_str())
}

fn assumes(ran: &Ran, words: &str) -> bool {
    let assumptions = ran.results["verdict"]["assumptions"].as_array().unwrap();
    assumptions.iter().any(|text| text.as_str().unwrap().contains(words))
}

/// What a bound plan's file has in `surface`, written by the command.
fn bind(plan: &Path, bone: &Path, out: &Path) -> std::process::Output {
    osteoflow().arg("convert").arg(plan).arg(out).arg("--bind").arg(bone).output().unwrap()
}

#[test]
fn a_displaced_plan_is_doubtful_unless_it_is_bound_or_confirmed_and_aiming_is_a_note() {
    for case in Case::all("a_displaced_plan_is_doubtful_unless_it_is_bound_or_confirmed_and_aiming_is_a_note") {
        let plans = Plans::of(case);
        let along = plans.proximal();
        for mm in [5.0, -8.0] {
            let ran = plans.run(&plans.displaced(along * mm), &[]);
            assert_eq!((ran.code, answer(&ran)), (0, "doubtful"), "{mm} mm: {}", ran.results["verdict"]);
            let reason = reason(&ran, "plan_shift").unwrap_or_else(|| panic!("{}", ran.results["verdict"]));
            for words in
                ["all were aimed wrong by this shift", "drawn in another series", "of it along the bone towards"]
            {
                assert!(reason.contains(words), "{mm} mm: {reason}");
            }
        }
        let confirmed = plans.run(&plans.displaced(along * 8.0), &["--set", "plan.confirm=true"]);
        assert_eq!(reason(&confirmed, "plan_shift"), None);
        assert!(assumes(&confirmed, "as confirm = true says"), "{}", confirmed.results["verdict"]);
        // In its place, unbound, it is trusted, with what would not be seen.
        let ran = plans.run(&plans.displaced(Vector3::zeros()), &[]);
        assert_eq!(answer(&ran), "trusted", "{}", ran.results["verdict"]);
        assert!(assumes(&ran, "to which nothing binds it"), "{}", ran.results["verdict"]);

        // Bound, all landmarks 8 mm off are aimed there: the pose does not follow them, and they contradict the surface.
        let (file, bound) = (plans.dir.path().join("aimed.json"), plans.dir.path().join("bound.json"));
        fs::write(&file, plans.aimed_off(along * 8.0).to_string()).unwrap();
        let done = bind(&file, &plans.case.bone, &bound);
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
        let ran = plans.run(&json(&bound), &[]);
        assert_eq!(answer(&ran), "doubtful", "{}", ran.results["verdict"]);
        assert!(reason(&ran, "landmarks_contradict").is_some(), "{}", ran.results["verdict"]);
        assert!(assumes(&ran, "so they were aimed there"), "{}", ran.results["verdict"]);
        let found = crate::common::isometry(&ran.results["poses"]["t_ct_world"]["matrix"]);
        let truth = plans.case.t_world_ct().inverse();
        for p in plans.case.assessment() {
            let off = (found * p - truth * p).norm();
            assert!(off < 1.5, "{off} mm, where landmarks that are aimed well leave 0.5 mm");
        }
    }
}

#[test]
fn two_landmarks_that_are_off_are_no_displaced_plan() {
    let plans = Plans::of(Case::shipped());
    let mut plan = plans.displaced(Vector3::zeros());
    let off = plans.aimed_off(plans.proximal() * 7.0);
    for name in ["P1", "P2"] {
        plan["landmarks"][name] = off["landmarks"][name].clone();
    }
    let ran = plans.run(&plan, &[]);
    assert_eq!(reason(&ran, "plan_shift"), None, "{}", ran.results["verdict"]);
    assert!(assumes(&ran, "but not all the same way"), "{}", ran.results["verdict"]);
}

#[test]
fn a_plan_that_is_bound_to_another_surface_is_refused_by_what_differs() {
    let plans = Plans::of(Case::shipped());
    // By the file alone: which of both is right is not measured.
    let mut plan = plans.plan.clone();
    plan["surface"] = json!({ "sha256": "0123456789abcdef".repeat(4) });
    let ran = plans.run(&plan, &[]);
    let text = reason(&ran, "plan").unwrap_or_else(|| panic!("{}", ran.results["verdict"]));
    assert_eq!(answer(&ran), "doubtful");
    let hash = plans.plan["surface"]["sha256"].as_str().unwrap();
    assert!(text.contains("0123456789ab") && text.contains(&hash[..12]), "both are named: {text}");
    // By points: the surface is measured to be elsewhere.
    let turn = Rotation3::from_axis_angle(&Unit::new_normalize(Vector3::x()), 0.02);
    let points = plans.plan["surface"]["points"].as_array().unwrap().iter();
    plan["surface"] =
        json!({ "points": points.map(|at| json!((turn * point(at)).coords.as_slice())).collect::<Vec<_>>() });
    let ran = plans.run(&plan, &[]);
    let text = reason(&ran, "plan").unwrap_or_else(|| panic!("{}", ran.results["verdict"]));
    assert_eq!((ran.code, answer(&ran)), (3, "refused"));
    assert!(text.contains("of the 12 points by which the plan knows its surface lie off this one"), "{text}");
    assert_eq!(ran.stderr.matches("drawn on another surface").count(), 0, "stdout has the reason: {}", ran.stderr);
}

#[test]
fn each_surface_that_the_plan_may_have_been_drawn_on_binds_it() {
    let plans = Plans::of(Case::shipped());
    let (dir, bone) = (plans.dir.path(), &plans.case.bone);
    let at = |name: &str| dir.join(name);
    fs::write(at("unbound.json"), plans.displaced(Vector3::zeros()).to_string()).unwrap();
    // Written by another program with other digits, the surface is the same by its points.
    let done = osteoflow().arg("convert").arg(bone).arg(at("bone.obj")).output().unwrap();
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    for (name, of) in [("stl.json", bone.clone()), ("obj.json", at("bone.obj"))] {
        let done = bind(&at("unbound.json"), &of, &at(name));
        let said = String::from_utf8_lossy(&done.stdout).into_owned();
        assert!(done.status.success() && said.contains("bound to"), "{said}{}", String::from_utf8_lossy(&done.stderr));
        let ran = plans.run(&json(&at(name)), &[]);
        assert_eq!(answer(&ran), "trusted", "{name}: {}", ran.results["verdict"]);
        assert!(!assumes(&ran, "nothing binds it"), "{name}: {}", ran.results["verdict"]);
    }
    // `surface.any` in the place of `surface.file`.
    let ran = plans.run(&json(&at("stl.json")), &["--set", "bone.kind=surface.any"]);
    assert!(answer(&ran) == "trusted" && !assumes(&ran, "nothing binds it"), "{}", ran.results["verdict"]);
}

#[test]
fn binding_keeps_the_plan_and_refuses_what_it_does_not_fit() {
    let plans = Plans::of(Case::shipped());
    let (dir, bone) = (plans.dir.path(), &plans.case.bone);
    let at = |name: &str| -> PathBuf { dir.join(name) };
    let mut plan = plans.displaced(Vector3::zeros());
    plan["comment"] = "drawn by hand".into();
    plan["surgeon"] = "N. N.".into();
    fs::write(at("plan.json"), plan.to_string()).unwrap();
    assert!(bind(&at("plan.json"), bone, &at("bound.json")).status.success());
    let mut bound = json(&at("bound.json"));
    let key = bound.as_object_mut().unwrap().remove("surface").unwrap();
    assert_eq!(bound, plan, "all else is as it was");
    assert_eq!(key["points"].as_array().unwrap().len(), 12);
    assert_eq!(key["sha256"].as_str().unwrap(), osteoflow_formats::input::sha256(bone).unwrap());
    assert_eq!(read_plan(&at("bound.json")).unwrap().plan.surface.unwrap().points.len(), 12);

    let refused = |plan: &str, bone: &Path, out: &str, words: &str| {
        let done = bind(&at(plan), bone, &at(out));
        let stderr = String::from_utf8_lossy(&done.stderr).into_owned();
        assert!(!done.status.success() && stderr.contains(words), "{words}\n{stderr}");
    };
    refused("plan.json", bone, "bound.json", "exists already");
    refused("plan.json", bone, "bound.toml", "a plan is written as .json");
    refused("plan.json", &plans.case.phantom, "other.json", "planned points lie off the surface");
    refused("plan.json", &plans.case.plan, "other.json", "plan.json");
    fs::write(at("markups.json"), json!({ "markups": [] }).to_string()).unwrap();
    refused("markups.json", bone, "other.json", "a plan (.json) is bound; make one by osteoflow convert");
    assert!(!at("other.json").exists() && !at("bound.toml").exists());
}

#[test]
fn a_dicom_series_binds_by_its_frame_of_reference_or_its_surface() {
    let test = "a_dicom_series_binds_by_its_frame_of_reference_or_its_surface";
    let Some(series) = data(test, "medical/tlem2r_distal_ct_dicom") else { return };
    let Some(plan) = data(test, "recordings/procedure_dev.plan.json") else { return };
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("bound.json");
    let done = osteoflow()
        .arg("convert")
        .args([&plan, &out])
        .arg("--bind")
        .arg(&series)
        .args(["--iso-hu", "600"])
        .output()
        .unwrap();
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let key = &json(&out)["surface"];
    assert!(key.get("sha256").is_none() && key["points"].as_array().unwrap().len() == 12, "{key}");
    let uid = key["frame_of_reference_uid"].as_str().unwrap().to_owned();
    // In a run: with this series, whose surface is another bone's part here, the frame of reference binds; with the bone's file, which
    // states none, the points are compared.
    let plans = Plans::of(Case::development(test).unwrap());
    let mut plan = plans.plan.clone();
    plan["surface"] = json!({ "frame_of_reference_uid": uid });
    let sets =
        ["bone.kind=surface.ct".to_owned(), "bone.threshold_hu=600".into(), format!("bone.path={}", series.display())];
    let sets: Vec<&str> = sets.iter().flat_map(|set| ["--set", set]).collect();
    let ran = plans.run(&plan, &sets);
    assert!(!assumes(&ran, "nothing binds it") && reason(&ran, "plan_shift").is_none(), "{}", ran.results["verdict"]);
    plan["surface"] = json!({ "frame_of_reference_uid": format!("{uid}.1") });
    let ran = plans.run(&plan, &sets);
    let text = reason(&ran, "plan").unwrap_or_else(|| panic!("{}", ran.results["verdict"]));
    assert!(text.contains(&format!("frame of reference is {uid}.1, the surface's {uid}")), "{text}");
    let ran = plans.run(&plan, &[]);
    assert!(assumes(&ran, "nothing binds it"), "the file states no frame: {}", ran.results["verdict"]);
}

#[test]
fn an_unbound_plan_is_the_first_assumption_where_no_landmark_could_show_a_shift() {
    let plans = Plans::of(Case::shipped());
    let graph = plans.dir.path().join("no_points.toml");
    let base = root().join("graphs/fibula_no_points.toml");
    fs::write(&graph, format!("extends = {base:?}\nremove = [\"node.verdict.in.measured\"]\n")).unwrap();
    let first = |plan: &Value| {
        let file = plans.dir.path().join("plan.json");
        fs::write(&file, plan.to_string()).unwrap();
        let ran = plans.case.with_graph(graph.to_str().unwrap(), &file, &["--no-record"]);
        ran.results["verdict"]["assumptions"][0].as_str().unwrap_or_else(|| panic!("{}", ran.stderr)).to_owned()
    };
    let unbound = first(&plans.displaced(Vector3::new(0.0, 0.0, 5.0)));
    let words = "the plan was drawn on this surface, to which nothing binds it, and no landmark would show that it is displaced";
    assert!(unbound.starts_with(words), "{unbound}");
    assert!(!first(&plans.plan).contains("the plan was drawn"), "the shipped plan is bound");
}
