//! Picking by hand on the page, as a person does it: clicks, drags, keys and touches in a browser, and the files that come of it. Also the
//! camera and the frames that the page draws.

use crate::common::browser::Browser;
use crate::common::served::Served;
use crate::common::{osteoflow, root, shared_run, skips_slow};
use osteoflow_algorithms::mesh_query::MeshQuery;
use osteoflow_engine::Recording;
use osteoflow_formats::{picked_points::read_picked_points, plan_file::read_plan};
use osteoflow_geometry::{
    Cloud, Mesh, NamedPoint, Points, isometry_from_matrix,
    nalgebra::{Isometry3, Matrix4, Point3, Vector3},
};
use osteoflow_node::Body;
use rand_chacha::{
    ChaCha8Rng,
    rand_core::{Rng, SeedableRng},
};
use serde_json::{Value, json};
use std::{
    fs,
    path::{Path, PathBuf},
    time::Duration,
};

/// Accuracy that is wanted of a click, mm.
const WANTED_MM: f64 = 0.2;
/// Rounding of double precision, a metre from the origin, mm.
const ROUNDING_MM: f64 = 1e-9;

/// `osteoflow view` of a run.
fn view(run: &Path, picks: &Path) -> Served {
    view_with(run, picks, &[])
}

fn view_with(run: &Path, picks: &Path, more: &[&str]) -> Served {
    let view = ["view", run.to_str().unwrap(), "--picks", picks.to_str().unwrap()];
    Served::start(&[&view, more].concat())
}

fn run(dir: &Path, graph: &str, sets: &[String]) -> PathBuf {
    let out = dir.join("run");
    let mut command = osteoflow();
    command.args(["run", graph, "--quiet", "--out"]).arg(&out);
    sets.iter().for_each(|set| {
        command.args(["--set", set]);
    });
    let output = command.output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{graph}: {}", String::from_utf8_lossy(&output.stderr));
    out
}

/// The first value of a recorded wire.
pub(crate) fn value<T: Clone + 'static>(run: &Path, wire: &str) -> T {
    let recording = Recording::open(&run.join("run.mcap")).unwrap();
    let items = recording.items(wire, &osteoflow_standard::registry()).unwrap();
    let found = items.iter().find_map(|item| match &item.body {
        Body::Value(value) => value.get::<T>().cloned(),
        Body::Empty(_) => None,
    });
    found.unwrap()
}

fn open(browser: &mut Browser, served: &Served, what: &str) {
    browser.events.clear();
    let size = json!({ "width": 1000, "height": 800, "deviceScaleFactor": 1, "mobile": false });
    browser.call("Emulation.setDeviceMetricsOverride", size);
    browser.call("Page.navigate", json!({ "url": served.page }));
    browser.wait_until("document.readyState === 'complete' && typeof osteoflow === 'object'");
    browser.wait_until(&format!("osteoflow.scene.drawn.get({what:?})?.object.visible === true"));
}

/// Clicks the middle of an element, once what comes over the stream moves it no more.
pub(crate) fn press(browser: &mut Browser, selector: &str) {
    let middle = format!(
        "(() => {{ const part = document.querySelector({selector:?}); part.scrollIntoView({{ block: 'center' }}); \
         const box = part.getBoundingClientRect(); return [box.left + box.width / 2, box.top + box.height / 2]; }})()"
    );
    let mut found = browser.evaluate(&middle);
    loop {
        std::thread::sleep(Duration::from_millis(150));
        let again = browser.evaluate(&middle);
        if std::mem::replace(&mut found, again.clone()) == again {
            break;
        }
    }
    browser.click(serde_json::from_value(found).unwrap());
}

/// The view of the bone, and that of the scan beside it.
pub(crate) const BONE: &str = "osteoflow.scene";
pub(crate) const SCAN: &str = "osteoflow.beside.scene";

/// Where a point is in the window by the camera of the page, mm in the shown frame.
pub(crate) fn projected(browser: &mut Browser, p: &Point3<f64>) -> [f64; 2] {
    projected_in(browser, BONE, p)
}

pub(crate) fn projected_in(browser: &mut Browser, view: &str, p: &Point3<f64>) -> [f64; 2] {
    let expression = format!(
        "(() => {{ const {{ camera, renderer }} = {view}; camera.updateMatrixWorld(); \
         const by = (e, v) => [0, 1, 2, 3].map((r) => e[r] * v[0] + e[4 + r] * v[1] + e[8 + r] * v[2] + e[12 + r] * v[3]); \
         const v = by(camera.projectionMatrix.elements, by(camera.matrixWorldInverse.elements, [{}, {}, {}, 1])); \
         const box = renderer.domElement.getBoundingClientRect(); \
         return [box.left + ((v[0] / v[3] + 1) / 2) * box.width, box.top + ((1 - v[1] / v[3]) / 2) * box.height]; }})()",
        p.x / 1e3,
        p.y / 1e3,
        p.z / 1e3
    );
    serde_json::from_value(browser.evaluate(&expression)).unwrap()
}

/// Turns the view to a point, as a person turns it, seen from a direction; `mm` fill its height.
pub(crate) fn look(browser: &mut Browser, at: &Point3<f64>, from: &Vector3<f64>, mm: f64) {
    let expression = format!(
        "osteoflow.picking.lookFrom({:?}, {:?}, {mm}, [0, 0, 1])",
        at.coords.as_slice(),
        from.normalize().as_slice()
    );
    browser.evaluate(&expression);
    browser.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))");
}

fn points(value: &Value) -> Vec<NamedPoint> {
    let all = value.as_array().unwrap().iter();
    all.map(|p| {
        let position: [f64; 3] = serde_json::from_value(p["position"].clone()).unwrap();
        NamedPoint::new(p["name"].as_str().unwrap(), position.into())
    })
    .collect()
}

/// The points of a group on the page.
pub(crate) fn picked(browser: &mut Browser, group: &str) -> Vec<NamedPoint> {
    points(&browser.evaluate(&format!("osteoflow.picking.history.now.{group}")))
}

pub(crate) fn text(browser: &mut Browser, id: &str) -> String {
    browser.evaluate(&format!("document.getElementById({id:?}).textContent")).as_str().unwrap().to_owned()
}

/// Waits until what is picked on is shown, seen from where it is looked at first.
fn wait_for_focus(browser: &mut Browser) {
    browser.wait_until(
        "osteoflow.scene.focus !== null && osteoflow.scene.isLookedAt && [...osteoflow.scene.drawn.keys()].some((name) => name.startsWith('picked'))",
    );
}

/// The sentence of an element that is shown.
pub(crate) fn wait_for_text(browser: &mut Browser, id: &str, part: &str) {
    browser.wait_until(&format!(
        "!document.getElementById({id:?}).hidden && document.getElementById({id:?}).textContent.includes({part:?})"
    ));
}

/// The landmarks of the plan as the page got them, and the surface they were planned on.
fn planned(run: &Path) -> (Vec<NamedPoint>, MeshQuery) {
    (value::<Points>(run, "plan.landmarks").points.to_vec(), MeshQuery::new(&value::<Mesh>(run, "bone.mesh")))
}

/// Shows a place of the bone from outside, and clicks it.
fn click_place(browser: &mut Browser, bone: &MeshQuery, place: &Point3<f64>) {
    look(browser, place, &bone.closest_point(place).unwrap().normal, 60.0);
    let at = projected(browser, place);
    browser.click(at);
}

#[test]
fn landmarks_clicked_where_the_plan_has_them_are_those_and_the_saved_plan_runs_from_the_command_line() {
    let dir = tempfile::tempdir().unwrap();
    let run_dir = shared_run("graphs/fibula.toml", &[]).dir.path();
    let picks = dir.path().join("picks");
    let served = view(run_dir, &picks);
    let Some(mut browser) = Browser::start("landmarks_clicked_where_the_plan_has_them") else { return };
    let browser = &mut browser;
    let (plan, bone) = planned(run_dir);
    open(browser, &served, "bone.mesh");
    press(browser, "#pick-plan");
    wait_for_focus(browser);
    assert_eq!(picked(browser, "landmarks"), plan, "picking begins with the plan that is shown");
    browser.screenshot("1-plan");

    // Nothing is mirrored: numbers are those of the CT, and from the front the patient's left is on the right.
    let [x, y, z]: [f64; 3] = plan[0].position.coords.into();
    wait_for_text(browser, "pick-points", &format!("L {x:.2} P {y:.2} S {z:.2}"));
    look(browser, &plan[0].position, &-Vector3::y(), 60.0);
    let place = projected(browser, &plan[0].position);
    let left = projected(browser, &(plan[0].position + Vector3::x() * 5.0));
    let up = projected(browser, &(plan[0].position + Vector3::z() * 5.0));
    assert!(left[0] - place[0] > 30.0 && place[1] - up[1] > 30.0, "{place:?} {left:?} {up:?}");

    // Delete them all, by a click on each mark and the key.
    for point in &plan {
        click_place(browser, &bone, &point.position);
        assert_eq!(browser.evaluate("osteoflow.picking.selected.name"), &*point.name);
        browser.key("Delete", false);
    }
    assert_eq!(picked(browser, "landmarks"), []);
    wait_for_text(browser, "pick-next", "click the bone to set a landmark");

    // A drag beside the bone turns the view and picks nothing.
    let before = browser.evaluate("osteoflow.scene.camera.position.toArray()");
    browser.drag([100.0, 300.0], [160.0, 330.0]);
    assert_ne!(browser.evaluate("osteoflow.scene.camera.position.toArray()"), before);
    assert_eq!(picked(browser, "landmarks"), []);

    // The third by a finger.
    let mut off_mm: Vec<f64> = Vec::new();
    for (k, point) in plan.iter().enumerate() {
        if k < 2 {
            click_place(browser, &bone, &point.position);
        } else {
            look(browser, &point.position, &bone.closest_point(&point.position).unwrap().normal, 60.0);
            let at = projected(browser, &point.position);
            browser.tap(at);
        }
        let clicked = picked(browser, "landmarks");
        assert_eq!(clicked.len(), k + 1, "{}", text(browser, "pick-problem"));
        assert_eq!(clicked[k].name, point.name);
        off_mm.push((clicked[k].position - point.position).norm());
    }
    println!("clicked landmarks are {off_mm:.4?} mm from those of the plan");
    assert!(off_mm.iter().all(|mm| *mm < WANTED_MM), "{off_mm:?} mm");
    let on_surface = |browser: &mut Browser| {
        let all = picked(browser, "landmarks");
        all.iter().map(|p| bone.closest_point(&p.position).unwrap().distance_mm).fold(0.0, f64::max)
    };
    let mm = on_surface(browser);
    println!("they are {mm:e} mm off the surface");
    assert!(mm < ROUNDING_MM, "{mm} mm off the surface");
    // With three there is nothing that a stray click could set.
    assert_eq!(browser.evaluate("osteoflow.picking.armed"), Value::Null);
    browser.screenshot("2-clicked");

    // Moved by a drag, along the surface; undone, done again, undone by keys.
    let clicked = picked(browser, "landmarks");
    click_place(browser, &bone, &clicked[1].position);
    let at = projected(browser, &clicked[1].position);
    browser.drag(at, [at[0] + 25.0, at[1] - 40.0]);
    let moved = picked(browser, "landmarks");
    let (way_mm, off_mm) = ((moved[1].position - clicked[1].position).norm(), on_surface(browser));
    assert!((2.0..8.0).contains(&way_mm) && off_mm < ROUNDING_MM, "moved by {way_mm} mm, {off_mm} mm off the surface");
    let to = projected(browser, &moved[1].position);
    let px = (to[0] - at[0] - 25.0).hypot(to[1] - at[1] + 40.0);
    assert!(px < 1.5, "the mark follows the pointer to {px} pixels");
    assert_eq!([&moved[0], &moved[2]], [&clicked[0], &clicked[2]]);
    assert_eq!(browser.evaluate("osteoflow.scene.controls.enabled"), true, "the view can be turned again");
    browser.key("z", true);
    assert_eq!(picked(browser, "landmarks"), clicked);
    browser.key("y", true);
    assert_eq!(picked(browser, "landmarks"), moved);
    browser.key("z", true);
    // Arrow keys: half a millimetre along the surface.
    browser.evaluate("osteoflow.picking.select('landmarks', 'P2')");
    browser.key("ArrowUp", false);
    let nudged = picked(browser, "landmarks");
    let (way_mm, off_mm) = ((nudged[1].position - clicked[1].position).norm(), on_surface(browser));
    assert!((0.4..0.6).contains(&way_mm) && off_mm < ROUNDING_MM, "{way_mm} mm, {off_mm} mm");
    assert!(nudged[1].position.z > clicked[1].position.z, "up in the view is up the bone");
    browser.key("z", true);
    assert_eq!(picked(browser, "landmarks"), clicked);

    // The rulers: the distance from the malleolus along the bone, and the sides.
    let rulers = text(browser, "pick-rulers");
    let side = (clicked[1].position - clicked[0].position).norm();
    assert!(
        rulers.contains("tip to P1, along the bone100.") || rulers.contains("tip to P1, along the bone99.9"),
        "{rulers}"
    );
    assert!(
        rulers.contains(&format!("P1 to P2 (along the bone){side:.1} (30."))
            || rulers.contains(&format!("P1 to P2 (along the bone){side:.1} (29.9")),
        "{rulers}"
    );
    assert!(
        rulers.contains("tip of the plan; along the bone: the plan's proximal direction; coordinates are LPS"),
        "{rulers}"
    );

    // An assessment point by hand, with another name, and a plane by numbers.
    press(browser, "[data-group=assessment]");
    let place = bone.closest_point(&(clicked[0].position + Vector3::new(-20.0, 0.0, -20.0))).unwrap().point;
    click_place(browser, &bone, &place);
    assert_eq!(picked(browser, "assessment").last().unwrap().name.as_ref(), "M6");
    browser.evaluate("(() => { const name = document.querySelector('#pick-points li[data-name=M6] input'); name.value = 'hole'; name.onchange(); })()");
    assert_eq!(picked(browser, "assessment").last().unwrap().name.as_ref(), "hole");
    // The procedure has measured nothing at it.
    browser.evaluate("osteoflow.picking.select('assessment', 'hole')");
    press(browser, "#picking button[title=Delete]");
    assert_eq!(picked(browser, "assessment").len(), 5);
    let planes_before = browser.evaluate("osteoflow.picking.history.now.planes");
    let set = |browser: &mut Browser, key: &str, number: f64| {
        browser.evaluate(&format!(
            "(() => {{ const part = document.querySelector('#pick-planes fieldset[data-name=plane_1] input[type=number][data-key=\"{key}\"]'); part.value = '{number}'; part.onchange(); }})()"
        ));
    };
    set(browser, "mm", 150.0);
    set(browser, "0", 12.0);
    set(browser, "1", -7.0);
    set(browser, "mm", 152.5);
    browser.screenshot("3-planes");

    // Saved by the button.
    press(browser, "#pick-save");
    wait_for_text(browser, "pick-saved", "3 landmarks, 5 assessment points and 2 planes are saved in");
    browser.screenshot("4-saved");
    let folder = picks.join("picks-1");
    let read = read_plan(&folder.join("plan.json")).unwrap();
    assert_eq!(read.notes, [""; 0]);
    let saved = read.plan;
    assert_eq!(saved.landmarks.points.to_vec(), clicked, "to the last digit");
    assert_eq!(saved.assessment.points.to_vec(), picked(browser, "assessment"));
    let points = osteoflow_algorithms::trust::fingerprint(bone.mesh().vertices());
    assert_eq!(saved.surface.unwrap().points, points, "bound to the surface that it was picked on");
    let slicer = read_picked_points(&folder.join("landmarks.mrk.json")).unwrap();
    assert_eq!((slicer.points, slicer.space), (clicked.clone(), osteoflow_formats::Space::Lps));
    assert_eq!(read_picked_points(&folder.join("planes.mrk.json")).unwrap().planes.len(), 2);
    // The anatomy and the poses are those of the plan that was shown.
    let anatomy = saved.anatomy.unwrap();
    assert!(saved.t_phantom_phantom_marker.is_some() && saved.t_camera_camera_marker_nominal.is_some());
    let axes = value::<osteoflow_geometry::Axes>(run_dir, "plan.axes").columns;
    let off = (saved.axes.unwrap().columns - axes).amax();
    assert!(off < 1e-12, "the axes are off by {off}");
    // The plane is where its numbers say: 152.5 mm above the tip, leaning 12 degrees lateral and -7 posterior.
    let plane = saved.planes.planes[0].isometry().unwrap();
    let middle = osteoflow_algorithms::section::middle(bone.mesh(), plane, Some(60.0)).unwrap();
    let height = (middle - anatomy.malleolus_tip).dot(&anatomy.proximal);
    assert!((height - 152.5).abs() < 0.01, "{height} mm");
    let normal = plane.rotation * Vector3::z();
    let lean = |to: &Vector3<f64>| {
        let across = (to - anatomy.proximal.into_inner() * to.dot(&anatomy.proximal)).normalize();
        (normal.dot(&across) / normal.dot(&anatomy.proximal)).atan().to_degrees()
    };
    assert!((lean(&anatomy.lateral) - 12.0).abs() < 1e-6, "{}", lean(&anatomy.lateral));
    assert!(
        (lean(&anatomy.posterior) + 7.0).abs() < 0.5,
        "{}; posterior is not quite across lateral",
        lean(&anatomy.posterior)
    );
    // The other one is as it was.
    let other: [f64; 3] = serde_json::from_value(planes_before[1]["origin"].clone()).unwrap();
    assert_eq!(saved.planes.planes[1].isometry().unwrap().translation.vector, Vector3::from(other));
    // Loaded again, it is what was saved; another file is refused with the reason, and changes nothing.
    let load = |browser: &mut Browser, text: &str| {
        let text = json!(text);
        browser.evaluate(&format!(
            "(() => {{ const files = new DataTransfer(); files.items.add(new File([{text}], 'plan.json')); const input = \
             document.getElementById('pick-load'); input.files = files.files; input.dispatchEvent(new Event('change')); }})()"
        ));
    };
    press(browser, "#picking button[title^='take the plan']");
    for (other, said) in [
        ("[1]", "plan.json is not loaded: an object is expected"),
        ("{", "plan.json is not loaded: it is no JSON"),
        (r#"{ "landmarks": { "P1": [1, 2] } }"#, "landmarks.P1: 3 numbers are expected, found [1,2]"),
        (r#"{ "units": "m", "landmarks": { "P1": [1, 2, 3] } }"#, "lengths in mm are expected, found m"),
        ("{}", "it has no landmarks, assessment points or planes"),
    ] {
        let before = browser.evaluate("osteoflow.picking.history.now");
        load(browser, other);
        wait_for_text(browser, "pick-next", said);
        assert_eq!(browser.evaluate("osteoflow.picking.history.now"), before, "{said}");
    }
    load(browser, &fs::read_to_string(folder.join("plan.json")).unwrap());
    browser.wait_until("!document.getElementById('pick-next').textContent.includes('is not loaded')");
    assert_eq!(picked(browser, "landmarks"), clicked);
    assert_eq!(picked(browser, "assessment"), saved.assessment.points.to_vec());
    let origin = browser.evaluate("osteoflow.picking.history.now.planes[0].origin");
    let origin: [f64; 3] = serde_json::from_value(origin).unwrap();
    assert!((Vector3::from(origin) - plane.translation.vector).norm() < 1e-9);
    assert_eq!(browser.complaints(&served.page), Vec::<String>::new());

    // The saved plan in a run from the command line is what it says.
    let plan_file = folder.join("plan.json");
    let path = format!("plan.path={:?}", plan_file.display().to_string());
    let sets = ["plan.kind=plan.file".to_owned(), path, "recording.camera.n_points=8000".to_owned()];
    let again = run(&dir.path().join("again"), "graphs/fibula.toml", &sets);
    assert_eq!(value::<Points>(&again, "plan.landmarks").points.to_vec(), clicked);
    let results: Value = serde_json::from_slice(&fs::read(again.join("results.json")).unwrap()).unwrap();
    assert_eq!(results["verdict"]["answer"], "trusted");
    assert_eq!(results["coarse"]["pairs"].as_array().unwrap().len(), 3);
    let digest = |run: &Path| {
        let output = osteoflow().args(["digest", "--format", "json"]).arg(run).output().unwrap();
        let answer: Value = serde_json::from_slice(&output.stdout).unwrap();
        answer["files"][0]["digest"].clone()
    };
    let twice = run(&dir.path().join("twice"), "graphs/fibula.toml", &sets);
    assert_eq!(digest(&again), digest(&twice));
}

#[test]
fn the_page_asks_the_surface_what_the_program_asks() {
    if skips_slow("the_page_asks_the_surface_what_the_program_asks") {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let run_dir = shared_run("graphs/two_files.toml", &[]).dir.path();
    let served = view(run_dir, &dir.path().join("picks"));
    let Some(mut browser) = Browser::start("the_page_asks_the_surface") else { return };
    let browser = &mut browser;
    let bone = MeshQuery::new(&value::<Mesh>(run_dir, "bone.mesh"));
    open(browser, &served, "bone.mesh");
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let mut number = |low: f64, high: f64| low + (high - low) * f64::from(rng.next_u32()) / f64::from(u32::MAX);
    let vertices = bone.mesh().vertices().to_vec();
    let rays: Vec<[[f64; 3]; 2]> = (0..500)
        .map(|_| {
            let target = vertices[number(0.0, vertices.len() as f64 - 1.0) as usize];
            let from = target + Vector3::new(number(-80.0, 80.0), number(-80.0, 80.0), number(-80.0, 80.0));
            let aim = target + Vector3::new(number(-3.0, 3.0), number(-3.0, 3.0), number(-3.0, 3.0)) - from;
            [from.coords.into(), aim.into()]
        })
        .collect();
    let asked = json!(rays).to_string();
    let answers = browser.evaluate(&format!(
        "(() => {{ const surface = osteoflow.picking.surface(); return {asked}.map(([from, aim]) => [surface.cast(from, aim)?.point ?? null, surface.closest(from).point]); }})()"
    ));
    let (mut worst_mm, mut n_hit) = (0.0_f64, 0);
    for ([from, aim], answer) in rays.iter().zip(answers.as_array().unwrap()) {
        let point = |k: usize| -> Option<[f64; 3]> { serde_json::from_value(answer[k].clone()).unwrap() };
        let hit = bone.cast_ray(&(*from).into(), &(*aim).into());
        assert_eq!(point(0).is_some(), hit.is_some(), "{from:?} {aim:?}");
        if let (Some(ours), Some(hit)) = (point(0), hit) {
            worst_mm = worst_mm.max((Point3::from(ours) - hit.point).norm());
            n_hit += 1;
        }
        let closest = bone.closest_point(&(*from).into()).unwrap();
        let mm = (Point3::from(point(1).unwrap()) - Point3::from(*from)).norm();
        worst_mm = worst_mm.max((mm - closest.distance_mm).abs());
    }
    println!("{n_hit} of 500 rays hit, {worst_mm:e} mm between the page and the program");
    assert!(n_hit > 200 && worst_mm < ROUNDING_MM, "{n_hit} hits, {worst_mm} mm");
    assert_eq!(browser.complaints(&served.page), Vec::<String>::new());
}

#[test]
fn what_cannot_be_picked_or_saved_says_why() {
    if skips_slow("what_cannot_be_picked_or_saved_says_why") {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let run_dir = shared_run("graphs/fibula.toml", &[]).dir.path();
    // A file, where the folder should be.
    let picks = dir.path().join("picks");
    fs::write(&picks, "").unwrap();
    let served = view(run_dir, &picks);
    let Some(mut browser) = Browser::start("what_cannot_be_picked") else { return };
    let browser = &mut browser;
    let (plan, bone) = planned(run_dir);
    open(browser, &served, "bone.mesh");
    // Outside the mode a click picks nothing.
    browser.click([400.0, 400.0]);
    assert_eq!(browser.evaluate("osteoflow.picking.history.isEdited"), false);
    browser.evaluate("document.getElementById('view').focus()");
    browser.key("p", false);
    wait_for_focus(browser);
    assert_eq!(browser.evaluate("osteoflow.picking.bone().wire"), "bone.mesh", "never the phantom");
    assert_eq!(browser.evaluate("osteoflow.scene.drawn.get('phantom.mesh').object.visible"), false);

    // A folder that cannot be written.
    press(browser, "#pick-save");
    wait_for_text(browser, "pick-problem", "not saved: ");
    let said = text(browser, "pick-problem");
    assert!(said.contains("cannot be written") && said.contains("--picks DIR"), "{said}");

    // Beside the bone there is nothing to pick.
    press(browser, "[data-group=landmarks]");
    look(browser, &plan[0].position, &bone.closest_point(&plan[0].position).unwrap().normal, 60.0);
    browser.click([40.0, 400.0]);
    wait_for_text(browser, "pick-problem", "there is no bone under the pointer");

    // From the other side the near face is picked, not the landmark behind the bone; its mark there takes no click.
    let behind = -bone.closest_point(&plan[0].position).unwrap().normal;
    look(browser, &plan[0].position, &behind, 60.0);
    let at = projected(browser, &plan[0].position);
    browser.click(at);
    let picked_now = picked(browser, "landmarks");
    assert_eq!(picked_now.len(), 4, "{}", text(browser, "pick-problem"));
    let near = &picked_now[3];
    let nearer_mm = (near.position - plan[0].position).dot(&behind);
    assert!(nearer_mm > 3.0 && bone.closest_point(&near.position).unwrap().distance_mm < ROUNDING_MM, "{nearer_mm} mm");

    // A name that is taken, and one that is empty.
    for (name, said) in
        [("P1", "there is a point P1 already"), ("M1", "there is a point M1 already"), (" ", "a point needs a name")]
    {
        browser.evaluate(&format!("osteoflow.picking.rename('landmarks', 'P4', {name:?})"));
        wait_for_text(browser, "pick-problem", said);
    }
    assert_eq!(picked(browser, "landmarks"), picked_now);

    // A number alone is no name: an object of JSON would order it by itself.
    browser.evaluate("osteoflow.picking.rename('landmarks', 'P4', '4')");
    press(browser, "#pick-save");
    wait_for_text(browser, "pick-problem", "not saved: 4: a name needs a letter, such as P4");
    browser.key("z", true);

    // Two landmarks are too few.
    for name in ["P1", "P2"] {
        browser.evaluate(&format!("osteoflow.picking.select('landmarks', '{name}')"));
        browser.key("Delete", false);
    }
    press(browser, "#pick-save");
    wait_for_text(browser, "pick-problem", "not saved: 2 of 3 landmarks are picked");
    browser.key("z", true);
    browser.key("z", true);
    assert_eq!(picked(browser, "landmarks"), picked_now);

    // A bone that is hidden cannot be picked on.
    browser.evaluate("(() => { osteoflow.scene.drawn.get('bone.mesh').shown = false; osteoflow.scene.redraw(); })()");
    browser.wait_until("!osteoflow.scene.drawn.get('bone.mesh').object.visible");
    press(browser, "[data-group=landmarks]");
    browser.click([at[0], at[1] + 60.0]);
    wait_for_text(browser, "pick-problem", "bone.mesh is not shown");
    assert_eq!(picked(browser, "landmarks"), picked_now);
    browser.evaluate("(() => { osteoflow.scene.drawn.get('bone.mesh').shown = true; osteoflow.scene.redraw(); })()");

    // The same surface again changes nothing; another one is said, and points that are far from it are not saved.
    let replace = |shift: f64| {
        format!(
            "(() => {{ const item = osteoflow.picking.shown.items.get('bone.mesh'); const rows = item.columns.vertices.rows.slice().map((x) => x + {shift}); \
             osteoflow.picking.item('bone.mesh', 'geometry/Mesh', {{ ...item, columns: {{ ...item.columns, vertices: {{ width: 3, rows }} }} }}); }})()"
        )
    };
    browser.evaluate(&replace(0.0));
    assert_eq!(browser.evaluate("osteoflow.picking.warning"), "");
    browser.evaluate(&replace(30.0));
    wait_for_text(browser, "pick-next", "the surface was replaced by another");
    press(browser, "#pick-save");
    wait_for_text(browser, "pick-problem", "mm off the surface");
    assert!(!picks.is_dir(), "nothing was saved");

    // A jump in the recording keeps what was picked.
    browser.evaluate("(() => { const time = document.getElementById('time'); time.value = '0'; time.onchange(); })()");
    browser.wait_until(
        "osteoflow.scene.drawn.get('bone.mesh')?.object.visible && osteoflow.scene.drawn.has('picked on the bone')",
    );
    assert_eq!(picked(browser, "landmarks"), picked_now);
    assert_eq!(browser.complaints(&served.page), Vec::<String>::new());
}

#[test]
fn a_bone_without_a_plan_gets_one_with_a_picked_tip_and_says_what_it_lacks() {
    if skips_slow("a_bone_without_a_plan_gets_one_with_a_picked_tip_and_says_what_it_lacks") {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let run_dir = shared_run("graphs/two_files.toml", &[]).dir.path();
    let picks = dir.path().join("picks");
    let served = view(run_dir, &picks);
    let Some(mut browser) = Browser::start("a_bone_without_a_plan") else { return };
    let browser = &mut browser;
    let bone = MeshQuery::new(&value::<Mesh>(run_dir, "bone.mesh"));
    open(browser, &served, "bone.mesh");
    press(browser, "#pick-plan");
    wait_for_focus(browser);
    // This bone is along z, and its malleolus is its lowest point.
    let tip = *bone.mesh().vertices().iter().min_by(|a, b| a.z.total_cmp(&b.z)).unwrap();
    let front = |height: f64| {
        let start = Point3::new(tip.x, tip.y - 100.0, tip.z + height);
        bone.closest_point(&start).unwrap().point
    };
    let side = bone.closest_point(&(front(130.0) + Vector3::new(50.0, 10.0, 0.0))).unwrap().point;
    for place in [front(100.0), side, front(125.0)] {
        click_place(browser, &bone, &place);
    }
    wait_for_text(
        browser,
        "pick-rulers",
        "no tip of the malleolus: pick it for heights; along the bone: the long axis of the surface",
    );
    press(browser, "[data-group=tip]");
    wait_for_text(browser, "pick-next", "click the tip of the malleolus");
    look(browser, &tip, &Vector3::new(0.0, -1.0, -0.3), 60.0);
    let at = projected(browser, &(tip + Vector3::new(0.0, 0.0, 0.5)));
    browser.click(at);
    let picked_tip = picked(browser, "tip")[0].position;
    assert!((picked_tip - tip).norm() < 4.0, "{picked_tip} is not {tip}");
    wait_for_text(browser, "pick-rulers", "tip as picked; along the bone: the long axis of the surface");
    let along: [f64; 3] = serde_json::from_value(browser.evaluate("osteoflow.picking.bearings().along")).unwrap();
    let along = Vector3::from(along);
    assert!(along.z > 0.99, "away from the malleolus: {along}");
    let landmarks = picked(browser, "landmarks");
    let mm = (landmarks[0].position - picked_tip).dot(&along);
    wait_for_text(browser, "pick-rulers", &format!("tip to P1, along the bone{mm:.1} mm"));
    press(browser, "#picking .row button:nth-of-type(4)");
    browser.wait_until("osteoflow.picking.history.now.planes.length === 1");
    // A slider that moves is one step to undo.
    let slid = browser.evaluate(
        "(() => { const range = document.querySelector('#pick-planes input[type=range]'); const before = osteoflow.picking.history.before.length; \
         for (const value of ['140', '145', '150']) { range.value = value; range.oninput(); } range.onchange(); \
         return osteoflow.picking.history.before.length - before; })()",
    );
    assert_eq!(slid, 1);
    // A plane beyond the end of the bone is named, and not saved.
    browser.evaluate("osteoflow.picking.placePlane('plane_1', { mm: 2000 }, null)");
    press(browser, "#pick-save");
    wait_for_text(browser, "pick-problem", "plane_1 does not meet the bone");
    browser.key("z", true);
    // Without anatomy the angles are named after the axes of the CT.
    assert!(text(browser, "pick-planes").contains("leans to L") && text(browser, "pick-planes").contains("leans to P"));
    browser.screenshot("7-no-plan");
    press(browser, "#pick-save");
    wait_for_text(
        browser,
        "pick-saved",
        "the plan gives no anatomy, axes, phantom marker pose, nominal camera marker pose",
    );
    let file = picks.join("picks-1/plan.json");
    let plan = read_plan(&file).unwrap().plan;
    assert_eq!(plan.landmarks.points.to_vec(), landmarks);
    let cut =
        osteoflow_algorithms::section::middle(bone.mesh(), plan.planes.planes[0].isometry().unwrap(), None).unwrap();
    let mm = (cut - picked_tip).dot(&along);
    assert!((mm - 150.0).abs() < 0.01, "the cut is {mm} mm above the tip");
    let written: Value = serde_json::from_slice(&fs::read(&file).unwrap()).unwrap();
    assert_eq!(written["malleolus_tip"], json!(picked_tip.coords.as_slice()));
    assert_eq!(written["proximal"], json!(along.as_slice()));

    // Three landmarks on a line are refused by what would register by them.
    for (name, height) in [("P1", 100.0), ("P2", 115.0), ("P3", 130.0)] {
        browser.evaluate(&format!("osteoflow.picking.select('landmarks', '{name}')"));
        browser.evaluate(&format!(
            "(() => {{ const {{ picking }} = osteoflow; picking.history.set(picking.moved('landmarks', '{name}', {:?})); picking.changed(); }})()",
            [picked_tip.x, picked_tip.y, picked_tip.z + height]
        ));
    }
    browser.evaluate(
        "(() => { const { picking } = osteoflow; const surface = picking.surface(); picking.fault = () => null; })()",
    );
    press(browser, "#pick-save");
    wait_for_text(browser, "pick-problem", "not saved: the points lie on a line");
    assert!(!picks.join("picks-2").exists());
    assert_eq!(browser.complaints(&served.page), Vec::<String>::new());
}

#[test]
fn three_pairs_picked_on_bone_and_scan_start_the_registration_from_the_command_line() {
    let dir = tempfile::tempdir().unwrap();
    let run_dir = shared_run("graphs/two_files.toml", &[]).dir.path();
    let picks = dir.path().join("picks");
    let served = view(run_dir, &picks);
    let Some(mut browser) = Browser::start("three_pairs_picked") else { return };
    let browser = &mut browser;
    let bone = MeshQuery::new(&value::<Mesh>(run_dir, "bone.mesh"));
    let scan = value::<Cloud>(run_dir, "scan.cloud");
    // Three places that the scan shows, by the registration of the run: this is what a person recognises on both.
    let results =
        |run: &Path| -> Value { serde_json::from_slice(&fs::read(run.join("results.json")).unwrap()).unwrap() };
    let pose = |value: &Value| -> Isometry3<f64> {
        let rows: Vec<Vec<f64>> = serde_json::from_value(value["matrix"].clone()).unwrap();
        isometry_from_matrix(&Matrix4::from_row_slice(&rows.concat())).unwrap()
    };
    let truth = pose(&results(run_dir)["t_ct_camera"]);
    let mut along: Vec<Point3<f64>> = scan.points().to_vec();
    along.sort_by(|a, b| (truth * a).z.total_cmp(&(truth * b).z));
    let n = along.len();
    let marks = [along[n / 10], along[n / 2], along[n * 9 / 10]];
    open(browser, &served, "bone.mesh");
    browser.wait_until("!document.getElementById('pick-pairs').hidden");
    press(browser, "#pick-pairs");
    wait_for_focus(browser);
    let is_shown = "(() => { const { scene, beside } = osteoflow; return scene.drawn.get('bone.mesh')?.object.visible && \
        !scene.drawn.get('scan.cloud').object.visible && beside.made?.drawn.get(beside.picked?.wire)?.object.visible && !beside.isNew; })()";
    browser.wait_until(is_shown);
    for (k, mark) in marks.iter().enumerate() {
        // A hand that is a millimetre off.
        let place = bone.closest_point(&(truth * mark + Vector3::new(0.0, 0.0, 1.0))).unwrap();
        look(browser, &place.point, &place.normal, 60.0);
        let at = projected(browser, &place.point);
        browser.click(at);
        wait_for_text(browser, "pick-next", &format!("click P{} on the scan", k + 1));
        // The scan is beside the bone, in its own frame.
        if k == 0 {
            browser.screenshot("5-scan");
            // Beside the scan there is no measured point.
            let corner = browser.evaluate("(() => { const box = document.querySelector('#beside canvas').getBoundingClientRect(); return [box.left + 20, box.top + 60]; })()");
            browser.click(serde_json::from_value(corner).unwrap());
            wait_for_text(browser, "pick-problem", "there is no point of the scan under the pointer");
        }
        // Nearer, as a hand does that wants one point of many.
        let at = projected_in(browser, SCAN, mark);
        (0..8).for_each(|_| browser.wheel(at, -1.0));
        let at = projected_in(browser, SCAN, mark);
        browser.click(at);
        browser.screenshot("5-scan-near");
        (0..8).for_each(|_| browser.wheel(at, 1.0));
        browser.wait_until(&format!("osteoflow.picking.nPairs() === {}", k + 1));
    }
    wait_for_text(browser, "pick-next", "save when the sides agree");
    let (on_bone, on_scan) = (picked(browser, "bone"), picked(browser, "scan"));
    let names = |points: &[NamedPoint]| points.iter().map(|p| p.name.to_string()).collect::<Vec<_>>();
    assert_eq!((names(&on_bone), names(&on_scan)), (names(&on_scan), vec!["P1".into(), "P2".into(), "P3".into()]));
    for (point, mark) in on_scan.iter().zip(marks) {
        assert!(scan.points().contains(&point.position), "{point:?} is no measured point");
        let mm = (point.position - mark).norm();
        assert!(mm < 1.0, "{} is {mm} mm from where it was clicked", point.name);
    }
    // The bone is seen as it was left.
    let last = on_bone.last().unwrap().position;
    let [x, y] = projected(browser, &last);
    let size: [f64; 2] = serde_json::from_value(browser.evaluate("[innerWidth, innerHeight]")).unwrap();
    assert!(x > 0.0 && y > 0.0 && x < size[0] && y < size[1], "the last point is out of sight, at {x:.0}, {y:.0}");
    browser.screenshot("6-pairs");
    // A scan that is replaced takes its points with it.
    let other = "(() => { const { items } = osteoflow.picking.shown; const item = items.get('scan.cloud'); window.before = item; \
        const rows = item.columns.points.rows.map((x) => x + 1); \
        osteoflow.picking.item('scan.cloud', 'geometry/Cloud', { ...item, columns: { ...item.columns, points: { width: 3, rows } } }); })()";
    browser.evaluate(other);
    press(browser, "#pick-save");
    wait_for_text(browser, "pick-problem", "P1, P2, P3 was picked on a scan that is not shown any more");
    browser.evaluate("osteoflow.picking.item('scan.cloud', 'geometry/Cloud', window.before)");
    press(browser, "#pick-save");
    wait_for_text(browser, "pick-saved", "3 pairs are saved in");
    assert_eq!(browser.complaints(&served.page), Vec::<String>::new());
    let [bone_points, scan_points] =
        ["bone_points.mrk.json", "scan_points.mrk.json"].map(|f| picks.join("picks-1").join(f));
    assert_eq!(read_picked_points(&bone_points).unwrap().points, on_bone);
    assert_eq!(read_picked_points(&scan_points).unwrap().points, on_scan);

    // A graph and `register` start from them, and end where the registration by shape ended.
    let path = |key: &str, file: &Path| format!("{key}.path={:?}", file.display().to_string());
    let sets = [path("bone_points", &bone_points), path("scan_points", &scan_points)];
    let by_pairs = run(&dir.path().join("pairs"), "graphs/variants/two_files_picked.toml", &sets);
    let results = results(&by_pairs);
    assert_eq!(results["verdict"]["answer"], "trusted");
    assert_eq!(value::<Points>(&by_pairs, "scan_points.points").points.to_vec(), on_scan);
    let files = ["tests/data/folder/bone.stl", "tests/data/folder/scan.ply"].map(|file| root().join(file));
    let registered = osteoflow()
        .arg("register")
        .args(&files)
        .arg("--landmarks")
        .args([&bone_points, &scan_points])
        .args(["--format", "json"])
        .output()
        .unwrap();
    let registered: Value = serde_json::from_slice(&registered.stdout).unwrap();
    let numbers: Vec<f64> = serde_json::from_value(registered["T"].clone()).unwrap();
    let by_register = isometry_from_matrix(&Matrix4::from_row_slice(&numbers)).unwrap();
    for (what, fit) in [("the graph", pose(&results["t_ct_camera"])), ("register", by_register)] {
        let off = along.iter().step_by(50).map(|p| (fit * p - truth * p).norm()).fold(0.0, f64::max);
        assert!(off < 0.05, "{what}: {off} mm from the registration by shape; the samples of the surface differ");
    }
}

#[test]
fn the_shipped_pairs_start_the_graph_in_lps_or_ras_and_wrong_ones_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let graph = "graphs/variants/two_files_picked.toml";
    let pose = |run: &Path| -> Value {
        let results: Value = serde_json::from_slice(&fs::read(run.join("results.json")).unwrap()).unwrap();
        assert_eq!(results["verdict"]["answer"], "trusted");
        results["t_ct_camera"]["matrix"].clone()
    };
    let expected = pose(&run(&dir.path().join("lps"), graph, &[]));
    let file = |name: &str, change: &dyn Fn(&mut Value)| {
        let text = fs::read(root().join("tests/data/picks/bone_points.mrk.json")).unwrap();
        let mut markups: Value = serde_json::from_slice(&text).unwrap();
        change(&mut markups["markups"][0]);
        let path = dir.path().join(name);
        fs::write(&path, markups.to_string()).unwrap();
        format!("bone_points.path={:?}", path.display().to_string())
    };
    // The same points, stated in RAS.
    let ras = file("ras.mrk.json", &|markup| {
        markup["coordinateSystem"] = json!("RAS");
        for point in markup["controlPoints"].as_array_mut().unwrap() {
            for k in 0..2 {
                point["position"][k] = json!(-point["position"][k].as_f64().unwrap());
            }
        }
    });
    assert_eq!(pose(&run(&dir.path().join("ras"), graph, &[ras])), expected, "bit for bit");

    let renamed = |from: usize, to: usize| {
        file(&format!("renamed-{from}-{to}.mrk.json"), &move |markup: &mut Value| {
            let points = markup["controlPoints"].as_array_mut().unwrap();
            let (a, b) = (points[from]["label"].clone(), points[to]["label"].clone());
            (points[from]["label"], points[to]["label"]) = (b, a);
        })
    };
    let unknown = file("other.mrk.json", &|markup| markup["controlPoints"][0]["label"] = json!("apex"));
    let mirrored = file("mirrored.mrk.json", &|markup| markup["coordinateSystem"] = json!("XYZ"));
    for (set, said) in [
        (renamed(0, 1), "the points miss the planned landmarks by"),
        (unknown, "source point P1 has no point of that name on the other side; the target has apex"),
        (mirrored, "coordinate system"),
        ("bone_points.frame=\" \"".into(), "frames do not meet"),
        ("bone_points.frame=\"camera\"".into(), "frames do not meet"),
        ("bone_points.path=\"tests/data/folder/bone.stl\"".into(), "bone.stl"),
    ] {
        let out = dir.path().join("refused");
        let output = osteoflow().args(["run", graph, "--quiet", "--set", &set, "--out"]).arg(&out).output().unwrap();
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.code() != Some(0) && stderr.contains(said), "{set}: {stderr}");
        let _ = fs::remove_dir_all(&out);
    }
}

#[test]
fn the_anatomy_is_that_of_the_plan_as_it_was_and_nobody_else_saves_anything() {
    let dir = tempfile::tempdir().unwrap();
    let plan = dir.path().join("plan.json");
    fs::copy(root().join("tests/data/folder/plan.json"), &plan).unwrap();
    let set = format!("plan.path={:?}", plan.display().to_string());
    let run_dir = run(dir.path(), "graphs/fibula_folder.toml", &[set]);
    let picks = dir.path().join("picks");
    let known = |served: &Served| -> Value {
        let answer = served.ask("GET", "picks", "", "");
        serde_json::from_str(answer.split_once("\r\n\r\n").unwrap().1).unwrap()
    };
    // The run did not record where the plan was, since the command line named it.
    assert_eq!(known(&view(&run_dir, &picks))["plan"], Value::Null);
    let file = plan.to_str().unwrap();
    let served = view_with(&run_dir, &picks, &["--plan", file]);
    let expected = read_plan(&plan).unwrap().plan.anatomy.unwrap();
    let answer = known(&served);
    assert_eq!(answer["plan"]["malleolus_tip"], json!(expected.malleolus_tip.coords.as_slice()));
    assert_eq!(answer["folder"], picks.display().to_string());

    // Another page is refused, and a plan that is wrong, too.
    let body = fs::read_to_string(&plan).unwrap();
    let foreign = served.ask("POST", "save/plan", "Origin: http://evil.example\r\n", &body);
    assert!(foreign.starts_with("HTTP/1.1 403"), "{foreign:.200}");
    let wrong = served.ask("POST", "save/plan", "", "{\"landmarks\": {}}");
    assert!(wrong.starts_with("HTTP/1.1 422") && wrong.contains("0 landmarks are picked; 3 are needed"), "{wrong}");
    assert!(served.ask("POST", "save/../x", "", "{}").starts_with("HTTP/1.1 404"));
    assert!(!picks.exists());
    let saved = served.ask("POST", "save/plan", "", &body);
    assert!(saved.starts_with("HTTP/1.1 200") && picks.join("picks-1/plan.json").is_file(), "{saved}");

    // A plan that has changed since the run is not that of the run: its anatomy is not used.
    let mut changed: Value = serde_json::from_str(&body).unwrap();
    changed["landmarks"]["P1"][2] = json!(-960.0);
    fs::write(&plan, changed.to_string()).unwrap();
    let refused = osteoflow().arg("view").arg(&run_dir).args(["--plan", file]).output().unwrap();
    let stderr = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(refused.status.code() != Some(0) && stderr.contains("is not the plan of this run"), "{stderr}");
    // The plan that the graph itself names is found.
    let of_graph = run(&dir.path().join("of_graph"), "graphs/fibula_folder.toml", &[]);
    let served = view(&of_graph, &picks);
    assert_eq!(known(&served)["plan"]["malleolus_tip"], json!(expected.malleolus_tip.coords.as_slice()));
}

#[test]
fn the_camera_is_drawn_where_the_frames_have_it_with_the_edges_of_what_it_has_seen() {
    if skips_slow("the_camera_is_drawn_where_the_frames_have_it_with_the_edges_of_what_it_has_seen") {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let run_dir = shared_run("graphs/fibula.toml", &[]).dir.path();
    let served = view(run_dir, &dir.path().join("picks"));
    let Some(mut browser) = Browser::start("the_camera_is_drawn") else { return };
    let browser = &mut browser;
    open(browser, &served, "bone.mesh");
    let camera = "osteoflow.scene.drawn.get('camera and what it has seen')";
    browser.wait_until(&format!("{camera} !== undefined && osteoflow.devices.n >= 3"));
    assert_eq!(browser.evaluate(&format!("{camera}.object.visible")), false, "off at first");
    for name in ["camera and what it has seen", "axes of the frames"] {
        browser.evaluate(&format!(
            "(() => {{ osteoflow.scene.drawn.get({name:?}).shown = true; osteoflow.scene.redraw(); }})()"
        ));
        browser.wait_until(&format!("osteoflow.scene.drawn.get({name:?}).object.visible"));
    }
    let seen: [f64; 6] = serde_json::from_value(browser.evaluate("osteoflow.devices.seen")).unwrap();
    // The bounds of the scans in the camera's frame; the page looks at every seventh point.
    let bounds = |wires: &[&str]| {
        let mut all = [f64::INFINITY, f64::NEG_INFINITY].repeat(3);
        for wire in wires {
            for p in value::<Cloud>(run_dir, wire).points() {
                for (k, c) in [p.x / p.z, p.y / p.z, p.z].into_iter().enumerate() {
                    all[2 * k] = f64::min(all[2 * k], c);
                    all[2 * k + 1] = f64::max(all[2 * k + 1], c);
                }
            }
        }
        all
    };
    let scans = bounds(&["recording.scan", "recording.phantom_scan"]);
    for k in 0..6 {
        let slack = if k < 4 { 0.02 } else { 3.0 };
        let outward = if k % 2 == 0 { scans[k] - seen[k] } else { seen[k] - scans[k] };
        assert!(outward > -slack, "bound {k}: {} drawn, {} of the scans", seen[k], scans[k]);
    }
    // Its point is the origin of the camera's frame, where the tracker and the calibration have it.
    let root = browser.evaluate("osteoflow.frames.root('camera')");
    assert_eq!(root, "world");
    let place = browser.evaluate(&format!("{camera}.object.matrix.elements.slice(12, 15)"));
    let expected = browser.evaluate("osteoflow.frames.toRoot('camera').matrix.elements.slice(12, 15)");
    assert_eq!(place, expected);
    let axes = "osteoflow.scene.drawn.get('axes of the frames').object";
    let names = browser.evaluate("JSON.parse(osteoflow.devices.names)[1]");
    assert!(
        ["bone_marker", "camera", "ct", "world"].iter().all(|name| names.as_array().unwrap().contains(&json!(name))),
        "{names}"
    );
    assert_eq!(browser.evaluate(&format!("{axes}.children.length")), names.as_array().unwrap().len());
    // A frame whose marker is lost has no axes, and neither camera nor its view is drawn at its last place.
    browser.evaluate(
        "(() => { osteoflow.frames.unknown.set('recording.camera_marker', 'lost'); osteoflow.scene.redraw(); })()",
    );
    browser.wait_until(&format!("{camera}.object.visible === false && {camera}.object.userData.why === 'lost'"));
    browser.wait_until(&format!("{axes}.children.filter((child) => !child.visible).length >= 2"));
    assert_eq!(browser.complaints(&served.page), Vec::<String>::new());
}
