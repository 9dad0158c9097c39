//! The hand on the view: what a drag, the wheel, clicks, keys and fingers do to what is shown, pairs and a crop by a mouse; on bones that lie along
//! x, y and z and whose scans are in the world of a tracker, far from the origin.

use crate::common::browser::Browser;
use crate::common::served::Served;
use crate::viewer_picking::{BONE, SCAN, look, press, projected, projected_in, text, wait_for_text};
use osteoflow_algorithms::mesh_query::MeshQuery;
use osteoflow_formats::{
    mesh_or_cloud::{read_cloud, read_mesh},
    write::{write_ply, write_stl},
};
use osteoflow_geometry::{
    Cloud, Mesh, SurfaceOrigin, isometry_from_matrix,
    nalgebra::{Isometry3, Matrix4, Point3, Translation3, UnitQuaternion, Vector3},
};
use serde_json::{Value, json};
use std::{
    f64::consts::{FRAC_PI_2, PI},
    fs,
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

const LIMIT: Duration = Duration::from_secs(120);
/// What a place on the screen may be off by rounding to the pixels of events, pixels.
const PIXEL: f64 = 1.0;

/// A bone that lies along an axis, a scan of it in the world of a tracker, and the pose between them.
struct Case {
    folder: tempfile::TempDir,
    bone: MeshQuery,
    scan: Cloud,
    ends: [Point3<f64>; 2],
    t_bone_scan: Isometry3<f64>,
}

impl Case {
    /// Turns the shipped bone by `turn` about its middle, and moves its scan to where a tracker would have it.
    fn new(turn: UnitQuaternion<f64>) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/folder");
        let mesh: Mesh = read_mesh(&data.join("bone.stl"), 1.0, "ct", SurfaceOrigin::User).unwrap().mesh;
        let scan: Cloud = read_cloud(&data.join("scan.ply"), 1.0, "camera").unwrap().cloud;
        let t_turned_ct = Isometry3::from_parts(Translation3::new(40.0, -75.0, 310.0), turn);
        let t_world_camera = Isometry3::from_parts(
            Translation3::new(-420.0, 1130.0, -2350.0),
            UnitQuaternion::from_euler_angles(0.7, -1.9, 2.4),
        );
        let mesh = mesh.transformed("ct", &t_turned_ct);
        let scan = scan.transformed("camera", &t_world_camera);
        write_stl(&folder.path().join("bone.stl"), &mesh).unwrap();
        write_ply(&folder.path().join("scan.ply"), &scan, 1.0).unwrap();
        let middle =
            mesh.vertices().iter().fold(Vector3::zeros(), |sum, v| sum + v.coords) / mesh.vertices().len() as f64;
        let far = |from: Point3<f64>| {
            *mesh.vertices().iter().max_by(|a, b| (*a - from).norm().total_cmp(&(*b - from).norm())).unwrap()
        };
        let end = far(middle.into());
        Self { ends: [end, far(end)], bone: MeshQuery::new(&mesh), scan, folder, t_bone_scan: Isometry3::identity() }
    }

    /// The middle of the bone at a share of its length; the surface before it is seen from all sides.
    fn middle(&self, share: f64) -> Point3<f64> {
        let [a, b] = self.ends;
        let (along, level) = ((b - a).normalize(), share * (b - a).norm());
        let near = self.bone.mesh().vertices().iter().filter(|v| ((*v - a).dot(&along) - level).abs() < 3.0);
        let (sum, n) = near.fold((Vector3::zeros(), 0.0), |(sum, n), v| (sum + v.coords, n + 1.0));
        Point3::from(sum / n)
    }

    /// Bones along z, x and y.
    fn all() -> Vec<(&'static str, UnitQuaternion<f64>)> {
        vec![
            ("z", UnitQuaternion::identity()),
            ("x", UnitQuaternion::from_axis_angle(&Vector3::y_axis(), FRAC_PI_2)),
            ("y", UnitQuaternion::from_axis_angle(&Vector3::x_axis(), -FRAC_PI_2)),
        ]
    }

    fn run(&self, n: usize) -> PathBuf {
        self.folder.path().join(if n == 1 { "run".to_owned() } else { format!("run-{n}") })
    }

    /// The pose of the n-th run, once it has ended.
    fn pose(&self, n: usize) -> (Isometry3<f64>, Value) {
        let until = Instant::now() + LIMIT;
        while !self.run(n).join("manifest.json").exists() {
            assert!(Instant::now() < until, "run {n} does not end");
            std::thread::sleep(Duration::from_millis(20));
        }
        let results: Value = serde_json::from_slice(&fs::read(self.run(n).join("results.json")).unwrap()).unwrap();
        let rows: Vec<Vec<f64>> = serde_json::from_value(results["t_ct_camera"]["matrix"].clone()).unwrap();
        (isometry_from_matrix(&Matrix4::from_row_slice(&rows.concat())).unwrap(), results)
    }

    fn view(&mut self, browser: &mut Browser) -> Served {
        let file = |name: &str| self.folder.path().join(name).display().to_string();
        let (bone, scan, out, picks) = (file("bone.stl"), file("scan.ply"), file("run"), file("picks"));
        let served = Served::start(&["view", &bone, &scan, "--out", &out, "--picks", &picks]);
        let (pose, results) = self.pose(1);
        assert_eq!(results["verdict"]["answer"], "trusted");
        self.t_bone_scan = pose;
        browser.events.clear();
        let size = json!({ "width": 1200, "height": 800, "deviceScaleFactor": 1, "mobile": false });
        browser.call("Emulation.setDeviceMetricsOverride", size);
        browser.call("Page.navigate", json!({ "url": served.page }));
        browser.wait_until("document.readyState === 'complete' && typeof osteoflow === 'object'");
        browser.wait_until(
            "osteoflow.state.state === 'complete' && osteoflow.scene.drawn.get('crop.cloud')?.object.visible && osteoflow.scene.isLookedAt",
        );
        served
    }
}

/// Where two points are apart on the screen, pixels to the right and down.
fn apart(browser: &mut Browser, [a, b]: [Point3<f64>; 2]) -> [f64; 2] {
    let [a, b] = [a, b].map(|p| projected(browser, &p));
    [b[0] - a[0], b[1] - a[1]]
}

/// Whether the bone stands upright on the screen: within a few degrees, as its ends are broader than its middle.
fn is_upright(browser: &mut Browser, case: &Case) -> bool {
    let [right, down] = apart(browser, case.ends);
    right.abs() < 0.12 * down.abs() && down.abs() > 350.0
}

/// What is under a place of the window, mm.
fn under(browser: &mut Browser, view: &str, [x, y]: [f64; 2]) -> Point3<f64> {
    let found = browser.evaluate(&format!("{view}.under({{ x: {x}, y: {y} }})?.toArray() ?? null"));
    let metres: [f64; 3] = serde_json::from_value(found).expect("something is under the pointer");
    Point3::from(metres) * 1000.0
}

fn px(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

#[test]
fn a_hand_turns_zooms_centres_and_moves_the_bone_by_the_point_under_it_whichever_way_it_lies() {
    let Some(mut browser) = Browser::start("a_hand_turns_zooms_centres_and_moves_the_bone") else { return };
    let browser = &mut browser;
    for (axis, turn) in Case::all() {
        let mut case = Case::new(turn);
        let served = case.view(browser);
        assert!(is_upright(browser, &case), "{axis}: {:?}", apart(browser, case.ends));
        browser.screenshot(&format!("hand-{axis}"));

        // A drag to the side turns the bone about the vertical of the screen: it stays upright, and what was held stays where it was.
        let height: f64 = browser.evaluate("document.querySelector('#view').clientHeight").as_f64().unwrap();
        let at = projected(browser, &case.middle(0.4)).map(f64::round);
        let held = under(browser, BONE, at);
        let before = [held, held + (case.ends[1] - case.ends[0]).normalize() * 20.0];
        let along = apart(browser, before);
        browser.drag(at, [at[0] + height / 4.0, at[1]]);
        assert!(px(projected(browser, &held), at) < PIXEL, "{axis}: what is held stays under its place as it turns");
        let off = px(apart(browser, before), along);
        assert!(off < 4.0, "{axis}: the bone tips by {off} pixels");
        assert!(is_upright(browser, &case), "{axis}: {:?}", apart(browser, case.ends));
        // A quarter of the height is an eighth of a turn: what was seen from the front is seen by that angle from aside.
        let seen = browser
            .evaluate("osteoflow.scene.camera.getWorldDirection(osteoflow.scene.camera.position.clone()).toArray()");
        browser.drag(at, [at[0] - height / 4.0, at[1]]);
        let back = browser
            .evaluate("osteoflow.scene.camera.getWorldDirection(osteoflow.scene.camera.position.clone()).toArray()");
        let [seen, back] = [seen, back].map(|v| Vector3::from(serde_json::from_value::<[f64; 3]>(v).unwrap()));
        assert!((seen.angle(&back) - PI / 4.0).abs() < 0.02, "{axis}: {} rad", seen.angle(&back));
        assert!(px(projected(browser, &held), at) < PIXEL, "{axis}: {:?} {at:?}", projected(browser, &held));

        // Down and up again tips it, and holds the same.
        browser.drag(at, [at[0], at[1] + 120.0]);
        assert!(px(projected(browser, &held), at) < PIXEL, "{axis}: {:?} {at:?}", projected(browser, &held));
        let [_, down] = apart(browser, case.ends);
        assert!(down.abs() < 0.95 * apart(browser, before)[1].hypot(1e3), "{axis}");
        // A preset stands it upright again, from each side, and a drag turns it about its own axis there, too.
        for key in ["2", "3", "1"] {
            browser.key(key, false);
            assert!(is_upright(browser, &case), "{axis}, key {key}: {:?}", apart(browser, case.ends));
            browser.drag([at[0], at[1] + 30.0], [at[0] + 90.0, at[1] + 30.0]);
            assert!(is_upright(browser, &case), "{axis}, key {key}, dragged: {:?}", apart(browser, case.ends));
            browser.key(key, false);
        }

        // The wheel zooms to what is under it.
        let at = projected(browser, &case.middle(0.7)).map(f64::round);
        let held = under(browser, BONE, at);
        let tip = [held, held + (case.ends[1] - case.ends[0]).normalize() * 10.0];
        let small = px(apart(browser, tip), [0.0; 2]);
        for _ in 0..5 {
            browser.wheel(at, -1.0);
        }
        assert!(px(projected(browser, &held), at) < PIXEL, "{axis}: {:?} {at:?}", projected(browser, &held));
        let large = px(apart(browser, tip), [0.0; 2]);
        // Five notches of 0.88 of the distance.
        assert!((1.6..2.2).contains(&(large / small)), "{axis}: {} times as large", large / small);
        // The right button moves it with the pointer.
        let to = [at[0] - 70.0, at[1] + 45.0];
        browser.drag_right(at, to);
        assert!(px(projected(browser, &held), to) < PIXEL, "{axis}: {:?} {to:?}", projected(browser, &held));
        // Two clicks put it in the middle.
        browser.click(to);
        browser.click(to);
        let centre = browser.evaluate("(() => { const box = document.querySelector('#view').getBoundingClientRect(); return [box.left + box.width / 2, box.top + box.height / 2]; })()");
        let centre: [f64; 2] = serde_json::from_value(centre).unwrap();
        assert!(px(projected(browser, &held), centre) < 2.0, "{axis}: {:?} {centre:?}", projected(browser, &held));

        // One finger turns, two move and pinch.
        browser.key("1", false);
        let at = projected(browser, &case.middle(0.4)).map(f64::round);
        let held = under(browser, BONE, at);
        browser.touch(&[[at, [at[0] + 80.0, at[1]]]]);
        assert!(px(projected(browser, &held), at) < PIXEL && is_upright(browser, &case), "{axis}: by a finger");
        browser.key("1", false);
        let tip = [held, held + (case.ends[1] - case.ends[0]).normalize() * 10.0];
        let small = px(apart(browser, tip), [0.0; 2]);
        let around = |x: f64, y: f64, by: f64| [[x - by, y], [x + by, y]];
        let ([a, b], [c, d]) = (around(at[0], at[1], 40.0), around(at[0] + 30.0, at[1] - 20.0, 80.0));
        browser.touch(&[[a, c], [b, d]]);
        let large = px(apart(browser, tip), [0.0; 2]);
        assert!((1.85..2.1).contains(&(large / small)), "{axis}: pinched to {} times", large / small);
        assert!(
            px(projected(browser, &held), [at[0] + 30.0, at[1] - 20.0]) < 3.0,
            "{axis}: {:?}",
            projected(browser, &held)
        );

        // Keys, for who has no mouse.
        browser.key("1", false);
        browser.evaluate("document.getElementById('view').focus()");
        let [right, down] = apart(browser, case.ends);
        browser.key("ArrowLeft", false);
        let turned = apart(browser, case.ends);
        assert!(is_upright(browser, &case), "{axis}: {turned:?} after {right} {down}");
        browser.key("+", false);
        let [_, nearer] = apart(browser, case.ends);
        assert!(nearer.abs() > 1.1 * down.abs(), "{axis}: {nearer} {down}");
        browser.key("0", false);
        let again = apart(browser, case.ends);
        assert!(px(again, [right, down]) < 2.0, "{axis}: {again:?} {right} {down}");
        assert_eq!(browser.complaints(&served.page), Vec::<String>::new());
    }
}

#[test]
fn three_pairs_by_the_mouse_register_a_scan_far_from_the_origin_and_save_and_run_shows_it() {
    let Some(mut browser) = Browser::start("three_pairs_by_the_mouse_register_a_scan") else { return };
    let browser = &mut browser;
    for (axis, turn) in Case::all() {
        let mut case = Case::new(turn);
        let served = case.view(browser);
        let truth = case.t_bone_scan;
        // Three places that both show, spread along the bone.
        let direction = (case.ends[1] - case.ends[0]).normalize();
        let mut along: Vec<Point3<f64>> = case.scan.points().to_vec();
        along.sort_by(|a, b| {
            (truth * a - case.ends[0]).dot(&direction).total_cmp(&(truth * b - case.ends[0]).dot(&direction))
        });
        let n = along.len();
        press(browser, "#pick-pairs");
        browser.wait_until("osteoflow.beside.made?.drawn.get(osteoflow.beside.picked?.wire)?.object.visible === true && !osteoflow.beside.isNew && osteoflow.scene.isLookedAt");
        assert!(text(browser, "pick-next").contains("0 of 3 pairs"), "{}", text(browser, "pick-next"));
        // The scan is seen from outside, all of it, its length upright.
        let sight: [f64; 4] = serde_json::from_value(browser.evaluate(
            "(() => { const box = document.querySelector('#beside canvas').getBoundingClientRect(); return [box.left, box.top, box.right, box.bottom]; })()",
        )).unwrap();
        let ends = [along[n / 50], along[n - 1 - n / 50]].map(|p| projected_in(browser, SCAN, &p));
        for [x, y] in ends {
            assert!(x > sight[0] && x < sight[2] && y > sight[1] && y < sight[3], "{axis}: {ends:?} in {sight:?}");
        }
        assert!((ends[0][0] - ends[1][0]).abs() < 0.3 * (ends[0][1] - ends[1][1]).abs(), "{axis}: {ends:?}");
        for (k, mark) in [along[n / 10], along[n / 2], along[n * 9 / 10]].iter().enumerate() {
            let place = case.bone.closest_point(&(truth * mark)).unwrap();
            look(browser, &place.point, &place.normal, 60.0);
            // On either side first.
            let clicks: [(&str, Point3<f64>); 2] = [(BONE, place.point), (SCAN, *mark)];
            for (view, p) in if k == 1 { [clicks[1], clicks[0]] } else { clicks } {
                let at = projected_in(browser, view, &p);
                browser.click(at);
            }
            browser.wait_until(&format!("osteoflow.picking.nPairs() === {}", k + 1));
        }
        browser.screenshot(&format!("pairs-{axis}"));
        wait_for_text(browser, "pick-next", "save when the sides agree");
        assert_eq!(text(browser, "pick-save"), "save and run");
        press(browser, "#pick-save");
        browser.wait_until("osteoflow.state.run === 'run-2' && osteoflow.state.state === 'complete'");
        let (pose, results) = case.pose(2);
        assert_eq!(results["verdict"]["answer"], "trusted");
        let off = along.iter().step_by(50).map(|p| (pose * p - truth * p).norm()).fold(0.0, f64::max);
        assert!(off < 0.05, "{axis}: {off} mm from the registration by shape; the samples of the surface differ");
        // What it gave is shown: the scan on the bone, and nothing beside.
        browser.wait_until("osteoflow.picking.mode === null && osteoflow.scene.drawn.get('crop.cloud')?.object.visible && document.getElementById('beside').hidden");
        assert!(text(browser, "pick-saved").contains("3 pairs are saved in"), "{}", text(browser, "pick-saved"));
        let said = browser.evaluate("document.body.innerText");
        assert!(!said.as_str().unwrap().contains("graph.toml"), "a graph that is built in has no file: {said}");
        assert_eq!(browser.complaints(&served.page), Vec::<String>::new());
    }
}

#[test]
fn a_crop_by_the_mouse_leaves_what_was_kept_on_the_bone_and_what_is_not_registered_is_grey_beside_it() {
    let Some(mut browser) = Browser::start("a_crop_by_the_mouse_leaves_what_was_kept") else { return };
    let browser = &mut browser;
    for (axis, turn) in Case::all() {
        let mut case = Case::new(turn);
        let served = case.view(browser);
        let n = case.scan.points().len() as u64;
        press(browser, "#draw");
        browser.wait_until("osteoflow.region.isOpen");
        let rows = browser.evaluate("osteoflow.region.on.rows.length / 3").as_u64();
        assert_eq!(rows, Some(n), "{axis}: it is drawn on what is cropped");
        // A lasso around the upper two thirds of the scan as it is seen.
        let mut seen: Vec<[f64; 2]> = Vec::new();
        for p in case.scan.points().iter().step_by(40) {
            seen.push(projected(browser, p));
        }
        let bound = |k: usize, most: bool| {
            seen.iter()
                .map(|p| p[k])
                .fold(if most { f64::MIN } else { f64::MAX }, if most { f64::max } else { f64::min })
        };
        let (left, right, top, bottom) =
            (bound(0, false) - 8.0, bound(0, true) + 8.0, bound(1, false) - 8.0, bound(1, true) + 8.0);
        let (wide, high) = (right - left > bottom - top, bottom - top);
        let corners = if wide {
            let to = left + 0.66 * (right - left);
            [[left, top], [to, top], [to, bottom], [left, bottom]]
        } else {
            let to = top + 0.66 * high;
            [[left, top], [right, top], [right, to], [left, to]]
        };
        browser.stroke(&corners);
        browser.screenshot(&format!("crop-{axis}"));
        let said = text(browser, "region-count");
        let kept: u64 = said.split(' ').next().unwrap().parse().unwrap();
        assert!((n / 2..n * 4 / 5).contains(&kept), "{axis}: {said}, {corners:?}");
        press(browser, "#region-save");
        browser.wait_until("osteoflow.state.run === 'run-2' && ['complete', 'refused'].includes(osteoflow.state.state) && !osteoflow.region.isOpen");
        // Shown is what was kept, not the scan that it was kept of.
        browser.wait_until("osteoflow.scene.drawn.has('crop.cloud') && osteoflow.scene.drawn.has('scan.cloud')");
        let shown = browser.evaluate("osteoflow.scene.drawn.get('crop.cloud').object.userData.points.length / 3");
        assert_eq!(shown.as_u64(), Some(kept), "{axis}");
        browser.wait_until("osteoflow.scene.drawn.get('crop.cloud').object.visible && !osteoflow.scene.drawn.get('scan.cloud').object.visible");
        // A choice of the user's holds.
        press(browser, "#shown input[data-wire=\"scan.cloud\"]");
        browser.wait_until("osteoflow.scene.drawn.get('scan.cloud').object.visible");
        assert_eq!(browser.complaints(&served.page), Vec::<String>::new());
    }
    // A run that is refused shows both, each in its own frame, and what is not registered is grey.
    let case = Case::new(UnitQuaternion::identity());
    // A scan in metres that is read as one in millimetres.
    let metres = case.scan.points().iter().map(|p| p / 1000.0).collect::<Vec<_>>();
    write_ply(&case.folder.path().join("scan.ply"), &Cloud::new("camera", metres).unwrap(), 1.0).unwrap();
    let file = |name: &str| case.folder.path().join(name).display().to_string();
    let (bone, scan, out, picks) = (file("bone.stl"), file("scan.ply"), file("run"), file("picks"));
    let served = Served::start(&["view", &bone, &scan, "--out", &out, "--picks", &picks]);
    browser.events.clear();
    browser.call("Page.navigate", json!({ "url": served.page }));
    browser.wait_until("typeof osteoflow === 'object' && osteoflow.state.state === 'refused'");
    browser.wait_until("osteoflow.scene.drawn.get('bone.mesh')?.object.visible === true");
    browser.wait_until("!document.getElementById('beside').hidden && osteoflow.beside.made?.drawn.get('crop.cloud')?.object.visible === true");
    let colours =
        browser.evaluate("osteoflow.beside.made.drawn.get('crop.cloud').object.children[0].material.vertexColors");
    assert_eq!(colours, false, "grey");
    wait_for_text(browser, "shown", "not registered: shown beside the bone, in camera");
    let said = browser.evaluate("document.body.innerText");
    assert!(!said.as_str().unwrap().contains("/tmp"), "no path of a temporary folder: {said}");
    assert_eq!(browser.complaints(&served.page), Vec::<String>::new());
}
