//! The hand on the view: what a drag, the wheel, clicks, keys and fingers do to what is shown, pairs and a crop by a mouse; on bones that lie along
//! x, y and z and whose scans are in the world of a tracker, far from the origin. The bones of others are in `viewer_bones`.

use crate::common::browser::Browser;
use crate::common::served::Served;
use crate::viewer_picking::{BONE, SCAN, picked, press, projected, projected_in, text, value, wait_for_text};
use osteoflow_algorithms::{mesh_query::MeshQuery, section};
use osteoflow_formats::{
    mesh_or_cloud::{read_cloud, read_mesh},
    write::{write_ply, write_stl},
};
use osteoflow_geometry::{
    Cloud, Mesh, SurfaceOrigin, isometry_from_matrix,
    nalgebra::{Isometry3, Matrix4, Point3, Translation3, UnitQuaternion, Vector3, Vector4},
};
use serde_json::{Value, json};
use std::{
    collections::HashSet,
    f64::consts::{FRAC_PI_2, PI},
    fs,
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

const LIMIT: Duration = Duration::from_secs(120);
/// What a place on the screen may be off by rounding to the pixels of events, pixels.
const PIXEL: f64 = 1.0;

/// A bone that lies along an axis, a scan of it in the world of a tracker, and the pose between them.
pub(crate) struct Case {
    pub(crate) name: String,
    folder: tempfile::TempDir,
    bone: MeshQuery,
    scan: Cloud,
    /// Where the bone ends, on its long axis or on that which its frame has upwards.
    ends: [Point3<f64>; 2],
    /// Shares of the length at which the bone is held.
    shares: [f64; 2],
    /// None where the registration by shape is that with which pairs are compared.
    t_bone_scan: Option<Isometry3<f64>>,
    /// Largest mean distance of the scan's points from where they are by the pose.
    right_mm: f64,
}

/// Where a tracker has a camera: far from the origin, and turned about no axis of its own.
pub(crate) fn t_world_camera() -> Isometry3<f64> {
    let turn = UnitQuaternion::from_euler_angles(0.7, -1.9, 2.4);
    Isometry3::from_parts(Translation3::new(-420.0, 1130.0, -2350.0), turn)
}

impl Case {
    /// Turns the shipped bone by `turn` about its middle, and moves its scan to where a tracker would have it.
    fn new(axis: &str, turn: UnitQuaternion<f64>) -> Self {
        let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/folder");
        let mesh: Mesh = read_mesh(&data.join("bone.stl"), 1.0, "ct", SurfaceOrigin::User).unwrap().mesh;
        let scan: Cloud = read_cloud(&data.join("scan.ply"), 1.0, "camera").unwrap().cloud;
        let t_turned_ct = Isometry3::from_parts(Translation3::new(40.0, -75.0, 310.0), turn);
        let mesh = mesh.transformed("ct", &t_turned_ct);
        let scan = scan.transformed("camera", &t_world_camera());
        let middle =
            mesh.vertices().iter().fold(Vector3::zeros(), |sum, v| sum + v.coords) / mesh.vertices().len() as f64;
        let far = |from: Point3<f64>| {
            *mesh.vertices().iter().max_by(|a, b| (*a - from).norm().total_cmp(&(*b - from).norm())).unwrap()
        };
        let end = far(middle.into());
        // The samples of the surface differ.
        Self { right_mm: 0.05, shares: [0.4, 0.7], ..Self::of(axis, &mesh, &scan, [end, far(end)], None) }
    }

    /// A bone and a scan that are written to files.
    pub(crate) fn of(
        name: &str,
        mesh: &Mesh,
        scan: &Cloud,
        ends: [Point3<f64>; 2],
        t_bone_scan: Option<(Isometry3<f64>, f64)>,
    ) -> Self {
        let folder = tempfile::tempdir().unwrap();
        write_stl(&folder.path().join("bone.stl"), mesh).unwrap();
        write_ply(&folder.path().join("scan.ply"), scan, 1.0).unwrap();
        Self::in_folder(folder, name, mesh, scan, ends, t_bone_scan)
    }

    /// A bone and a scan whose files, `bone.stl` and `scan.ply`, are in a folder.
    pub(crate) fn in_folder(
        folder: tempfile::TempDir,
        name: &str,
        mesh: &Mesh,
        scan: &Cloud,
        ends: [Point3<f64>; 2],
        t_bone_scan: Option<(Isometry3<f64>, f64)>,
    ) -> Self {
        Self {
            name: name.to_owned(),
            bone: MeshQuery::new(mesh),
            scan: scan.clone(),
            ends,
            shares: [0.25, 0.45],
            right_mm: t_bone_scan.map_or(0.0, |(_, mm)| mm),
            t_bone_scan: t_bone_scan.map(|(pose, _)| pose),
            folder,
        }
    }

    fn along(&self) -> Vector3<f64> {
        (self.ends[1] - self.ends[0]).normalize()
    }

    /// The middle of the bone at a share of its length; the surface before it is seen from all sides.
    fn middle(&self, share: f64) -> Point3<f64> {
        let at = self.ends[0] + share * (self.ends[1] - self.ends[0]);
        let turn = UnitQuaternion::rotation_between(&Vector3::z(), &self.along())
            .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI));
        section::middle(self.bone.mesh(), &Isometry3::from_parts(at.into(), turn), Some(60.0)).unwrap()
    }

    /// Bones along z, x and y.
    fn all() -> Vec<(&'static str, UnitQuaternion<f64>)> {
        vec![
            ("z", UnitQuaternion::identity()),
            ("x", UnitQuaternion::from_axis_angle(&Vector3::y_axis(), FRAC_PI_2)),
            ("y", UnitQuaternion::from_axis_angle(&Vector3::x_axis(), -FRAC_PI_2)),
        ]
    }

    pub(crate) fn run(&self, n: usize) -> PathBuf {
        self.folder.path().join(if n == 1 { "run".to_owned() } else { format!("run-{n}") })
    }

    /// What the n-th run has found, once it has ended.
    pub(crate) fn results(&self, n: usize) -> Value {
        let until = Instant::now() + LIMIT;
        while !self.run(n).join("manifest.json").exists() {
            assert!(Instant::now() < until, "run {n} does not end");
            std::thread::sleep(Duration::from_millis(20));
        }
        serde_json::from_slice(&fs::read(self.run(n).join("results.json")).unwrap()).unwrap()
    }

    pub(crate) fn pose(&self, n: usize) -> Isometry3<f64> {
        let results = self.results(n);
        let rows: Vec<Vec<f64>> = serde_json::from_value(results["t_ct_camera"]["matrix"].clone())
            .unwrap_or_else(|_| panic!("{}: no pose: {}", self.name, results["verdict"]));
        isometry_from_matrix(&Matrix4::from_row_slice(&rows.concat())).unwrap()
    }

    /// Shows bone and scan on the page, and waits for the registration by shape, whatever it finds.
    pub(crate) fn view(&mut self, browser: &mut Browser) -> Served {
        let file = |name: &str| self.folder.path().join(name).display().to_string();
        let (bone, scan, out, picks) = (file("bone.stl"), file("scan.ply"), file("run"), file("picks"));
        let served = Served::start(&["view", &bone, &scan, "--out", &out, "--picks", &picks]);
        if self.t_bone_scan.is_none() {
            assert_eq!(self.results(1)["verdict"]["answer"], "trusted");
            self.t_bone_scan = Some(self.pose(1));
        }
        browser.events.clear();
        let size = json!({ "width": 1200, "height": 800, "deviceScaleFactor": 1, "mobile": false });
        browser.call("Emulation.setDeviceMetricsOverride", size);
        browser.call("Page.navigate", json!({ "url": served.page }));
        browser.wait_until("document.readyState === 'complete' && typeof osteoflow === 'object'");
        browser.wait_until(
            "['complete', 'refused'].includes(osteoflow.state.state) && osteoflow.scene.drawn.has('crop.cloud') && osteoflow.scene.isLookedAt && \
             osteoflow.scene.drawn.get('bone.mesh')?.object.visible",
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

/// Drags, turns the wheel, clicks twice, moves, touches and presses keys, and looks each time at what became of what was held.
pub(crate) fn turn_by_hand(browser: &mut Browser, case: &Case) {
    let axis = &case.name;
    assert!(is_upright(browser, case), "{axis}: {:?}", apart(browser, case.ends));
    browser.screenshot(&format!("hand-{axis}"));

    // A drag to the side turns the bone about the vertical of the screen: it stays upright, and what was held stays where it was.
    let height: f64 = browser.evaluate("document.querySelector('#view').clientHeight").as_f64().unwrap();
    let at = projected(browser, &case.middle(case.shares[0])).map(f64::round);
    let held = under(browser, BONE, at);
    let before = [held, held + case.along() * 20.0];
    let along = apart(browser, before);
    browser.drag(at, [at[0] + height / 4.0, at[1]]);
    assert!(px(projected(browser, &held), at) < PIXEL, "{axis}: what is held stays under its place as it turns");
    let off = px(apart(browser, before), along);
    assert!(off < 4.0, "{axis}: the bone tips by {off} pixels");
    assert!(is_upright(browser, case), "{axis}: {:?}", apart(browser, case.ends));
    // A quarter of the height is an eighth of a turn: what was seen from the front is seen by that angle from aside.
    let seen =
        browser.evaluate("osteoflow.scene.camera.getWorldDirection(osteoflow.scene.camera.position.clone()).toArray()");
    // Seen from aside, a part of the bone that has come in front of what was held is held then, and nothing else.
    let [former, held] = [held, under(browser, BONE, at)];
    let eye: [f64; 3] = serde_json::from_value(browser.evaluate("osteoflow.scene.camera.position.toArray()")).unwrap();
    let [before_mm, now_mm] = [former, held].map(|p| (p - Point3::from(eye) * 1000.0).norm());
    assert!((held - former).norm() < 0.01 || now_mm < before_mm, "{axis}: {before_mm} mm, {now_mm} mm away");
    browser.drag(at, [at[0] - height / 4.0, at[1]]);
    let back =
        browser.evaluate("osteoflow.scene.camera.getWorldDirection(osteoflow.scene.camera.position.clone()).toArray()");
    let [seen, back] = [seen, back].map(|v| Vector3::from(serde_json::from_value::<[f64; 3]>(v).unwrap()));
    assert!((seen.angle(&back) - PI / 4.0).abs() < 0.02, "{axis}: {} rad", seen.angle(&back));
    assert!(px(projected(browser, &held), at) < PIXEL, "{axis}: {:?} {at:?}", projected(browser, &held));

    // Down and up again tips it, and holds the same.
    let held = under(browser, BONE, at);
    let long = px(apart(browser, case.ends), [0.0; 2]);
    browser.drag(at, [at[0], at[1] + 120.0]);
    assert!(px(projected(browser, &held), at) < PIXEL, "{axis}: {:?} {at:?}", projected(browser, &held));
    let tipped = px(apart(browser, case.ends), [0.0; 2]);
    let angle = 120.0 / height * PI;
    assert!(tipped < (angle.cos() + 0.1) * long, "{axis}: {tipped} of {long} px after {angle} rad");
    // A preset stands it upright again, from each side, and a drag turns it about its own axis there, too.
    for key in ["2", "3", "1"] {
        browser.key(key, false);
        assert!(is_upright(browser, case), "{axis}, key {key}: {:?}", apart(browser, case.ends));
        browser.drag([at[0], at[1] + 30.0], [at[0] + 90.0, at[1] + 30.0]);
        assert!(is_upright(browser, case), "{axis}, key {key}, dragged: {:?}", apart(browser, case.ends));
        browser.key(key, false);
    }

    // The wheel zooms to what is under it.
    let at = projected(browser, &case.middle(case.shares[1])).map(f64::round);
    let held = under(browser, BONE, at);
    let tip = [held, held + case.along() * 10.0];
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
    let at = projected(browser, &case.middle(case.shares[0])).map(f64::round);
    let held = under(browser, BONE, at);
    browser.touch(&[[at, [at[0] + 80.0, at[1]]]]);
    assert!(px(projected(browser, &held), at) < PIXEL && is_upright(browser, case), "{axis}: by a finger");
    browser.key("1", false);
    let tip = [held, held + case.along() * 10.0];
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
    assert!(is_upright(browser, case), "{axis}: {turned:?} after {right} {down}");
    browser.key("+", false);
    let [_, nearer] = apart(browser, case.ends);
    assert!(nearer.abs() > 1.1 * down.abs(), "{axis}: {nearer} {down}");
    browser.key("0", false);
    let again = apart(browser, case.ends);
    assert!(px(again, [right, down]) < 2.0, "{axis}: {again:?} {right} {down}");
}

/// Turns the bone about its own axis by drags beside it until it is seen from a direction.
fn turn_to(browser: &mut Browser, case: &Case, from: &Vector3<f64>) {
    let [height, left, top]: [f64; 3] = serde_json::from_value(browser.evaluate(
        "(() => { const box = document.querySelector('#view').getBoundingClientRect(); return [box.height, box.left, box.top]; })()",
    ))
    .unwrap();
    let axes: [f64; 16] =
        serde_json::from_value(browser.evaluate("osteoflow.scene.camera.matrixWorld.elements")).unwrap();
    let right = Vector3::new(axes[0], axes[1], axes[2]);
    let towards = Vector3::new(axes[8], axes[9], axes[10]);
    let angle = from.dot(&right).atan2(from.dot(&towards));
    // From the left edge to the right, or back, as often as it takes.
    let mut px = -angle * height / PI;
    while px.abs() > 0.5 {
        let step = px.clamp(-150.0, 150.0).round();
        let at = if step > 0.0 { [left + 20.0, top + 40.0] } else { [left + 180.0, top + 40.0] };
        browser.drag(at, [at[0] + step, at[1]]);
        px -= step;
    }
    assert!(is_upright(browser, case), "{}: it tips over by drags to the side", case.name);
}

/// Three measured points that both views show: spread along the bone, on its surface, and seen from where the scan is looked at.
fn marks(browser: &mut Browser, case: &Case) -> Vec<(Point3<f64>, Point3<f64>, Vector3<f64>)> {
    let (truth, along) = (case.t_bone_scan.unwrap(), case.along());
    let sight: [f64; 16] =
        serde_json::from_value(browser.evaluate("osteoflow.beside.scene.camera.matrixWorld.elements")).unwrap();
    let eye = Point3::new(sight[12], sight[13], sight[14]) * 1000.0;
    let length = (case.ends[1] - case.ends[0]).norm();
    let is_seen = |mark: &&Point3<f64>| {
        let place = case.bone.closest_point(&(truth * *mark)).unwrap();
        let across = place.normal - along * place.normal.dot(&along);
        let before = |from: Point3<f64>| {
            let hit = case.bone.cast_ray(&from, &(place.point - from));
            hit.is_some_and(|hit| (hit.point - place.point).norm() < 0.5)
        };
        place.distance_mm < 0.7
            && across.norm() > 0.7
            && place.normal.dot(&(truth * eye - place.point).normalize()) > 0.5
            && before(place.point + across.normalize() * 300.0)
            && before(truth * eye)
    };
    let mut seen: Vec<Point3<f64>> = case.scan.points().iter().step_by(7).filter(is_seen).copied().collect();
    let level = |p: &Point3<f64>| (truth * p - case.ends[0]).dot(&along);
    seen.sort_by(|a, b| level(a).total_cmp(&level(b)));
    let n = seen.len();
    assert!(n > 20 && level(&seen[n - 1]) - level(&seen[0]) > 0.2 * length, "{}: {n} marks", case.name);
    // Measured points scatter: one that others are well before is not what a hand sees.
    let is_front = |mark: &Point3<f64>| {
        let sight = (mark - eye).normalize();
        case.scan.points().iter().all(|p| {
            let (off, nearer) = (p - mark, (mark - p).dot(&sight));
            nearer < 2.0 || (off + sight * nearer).norm() > 3.0
        })
    };
    let [first, last] = [n / 10, n * 9 / 10].map(|k| {
        let front = (0..n / 10).flat_map(|by| [k - by, k + by]).map(|k| seen[k.min(n - 1)]).find(is_front);
        front.unwrap_or_else(|| panic!("{}: no mark is before the others", case.name))
    });
    // As far off the line through both as there is, since three in a row leave the turn about it open.
    let line = (last - first).normalize();
    let off_line = |p: &Point3<f64>| ((p - first) - line * (p - first).dot(&line)).norm();
    let mut between: Vec<_> = seen[n / 3..n * 2 / 3].to_vec();
    between.sort_by(|a, b| off_line(b).total_cmp(&off_line(a)));
    let middle = between.into_iter().find(is_front).expect("a mark in the middle is before the others");
    let marks = [first, middle, last];
    let marks = marks.map(|mark| {
        let place = case.bone.closest_point(&(truth * mark)).unwrap();
        (mark, place.point, (place.normal - along * place.normal.dot(&along)).normalize())
    });
    marks.to_vec()
}

/// Picks three pairs side by side, by a mouse or a finger, saves and runs; `n` is the number of the run.
pub(crate) fn pair_by_hand(browser: &mut Browser, case: &Case, n: usize, is_touch: bool) {
    press(browser, "#pick-pairs");
    pair_side_by_side(browser, case, n, is_touch);
}

/// The same where bone and scan are side by side already.
pub(crate) fn pair_side_by_side(browser: &mut Browser, case: &Case, n: usize, is_touch: bool) {
    let axis = &case.name;
    let (truth, points) = (case.t_bone_scan.unwrap(), case.scan.points());
    browser.wait_until("osteoflow.beside.made?.drawn.get(osteoflow.beside.picked?.wire)?.object.visible === true && !osteoflow.beside.isNew && osteoflow.scene.isLookedAt");
    assert!(text(browser, "pick-next").contains("0 of 3 pairs"), "{}", text(browser, "pick-next"));
    // The scan is seen whole, its length upright where it has one.
    let sight: [f64; 4] = serde_json::from_value(browser.evaluate(
        "(() => { const box = document.querySelector('#beside canvas').getBoundingClientRect(); return [box.left, box.top, box.right, box.bottom]; })()",
    ))
    .unwrap();
    let marks = marks(browser, case);
    let ends = [marks[0].0, marks[2].0].map(|p| projected_in(browser, SCAN, &p));
    for [x, y] in ends {
        assert!(x > sight[0] && x < sight[2] && y > sight[1] && y < sight[3], "{axis}: {ends:?} in {sight:?}");
    }
    let click = |browser: &mut Browser, view: &str, p: &Point3<f64>| {
        let at = projected_in(browser, view, p).map(f64::round);
        let held = under(browser, view, at);
        // Nearer, as a hand does that wants one point of many, and back.
        (0..8).for_each(|_| browser.wheel(at, -1.0));
        let off = px(projected_in(browser, view, &held), at);
        assert!(off < PIXEL, "{axis}: the wheel zooms to what is under it, not {off} pixels beside");
        let near = projected_in(browser, view, p);
        if is_touch {
            browser.tap(near)
        } else {
            browser.click(near)
        }
        (0..8).for_each(|_| browser.wheel(near, 1.0));
    };
    for (k, (mark, place, across)) in marks.iter().enumerate() {
        turn_to(browser, case, across);
        // On either side first.
        let clicks = [(BONE, place), (SCAN, mark)];
        for (view, p) in if k == 1 { [clicks[1], clicks[0]] } else { clicks } {
            click(browser, view, p);
        }
        browser.wait_until(&format!("osteoflow.picking.nPairs() === {}", k + 1));
    }
    browser.screenshot(&format!("pairs-{axis}"));
    for (pick, (_, place, _)) in picked(browser, "bone").iter().zip(&marks) {
        let mm = (pick.position - place).norm();
        assert!(mm < 1.0, "{axis}: {} is {mm} mm from where it was clicked on the bone", pick.name);
    }
    let eye: [f64; 3] =
        serde_json::from_value(browser.evaluate("osteoflow.beside.scene.camera.position.toArray()")).unwrap();
    for (pick, (mark, _, _)) in picked(browser, "scan").iter().zip(&marks) {
        assert!(points.contains(&pick.position), "{axis}: {pick:?} is no measured point");
        let (off, sight) = (pick.position - mark, (mark - Point3::from(eye) * 1000.0).normalize());
        // Of points behind each other one of the nearest 3 mm is taken.
        let (along, across) = (off.dot(&sight), (off - sight * off.dot(&sight)).norm());
        assert!(across < 1.0 && along.abs() < 3.0, "{axis}: {} is {off} from where it was clicked", pick.name);
    }
    wait_for_text(browser, "pick-next", "save when the sides agree");
    assert_eq!(text(browser, "pick-save"), "save and run");
    press(browser, "#pick-save");
    browser.wait_until(&format!(
        "osteoflow.state.run === 'run-{n}' && ['complete', 'refused'].includes(osteoflow.state.state)"
    ));
    let pose = case.pose(n);
    let off = points.iter().map(|p| (pose * p - truth * p).norm()).sum::<f64>() / points.len() as f64;
    let answer = case.results(n)["verdict"]["answer"].clone();
    println!("{axis}: registered from pairs, {off:.3} mm off, {answer}");
    assert!(off < case.right_mm, "{axis}: {off} mm off");
    // What it gave is shown: the scan on the bone, and nothing beside.
    browser.wait_until("osteoflow.picking.mode === null && osteoflow.scene.drawn.get('crop.cloud')?.object.visible && document.getElementById('beside').hidden");
    assert!(text(browser, "pick-saved").contains("3 pairs are saved in"), "{}", text(browser, "pick-saved"));
}

/// Where the region's view shows each point of the scan, and the rectangle that holds them all.
fn seen_points(browser: &mut Browser, case: &Case) -> (Vec<[f64; 2]>, [f64; 4]) {
    let found = browser.evaluate(
        "(() => { const { camera, renderer } = osteoflow.scene; camera.updateMatrixWorld(); const box = renderer.domElement.getBoundingClientRect(); \
         return [camera.projectionMatrix.elements, camera.matrixWorldInverse.elements, [box.left, box.top, box.width, box.height]]; })()",
    );
    let [projection, view, at]: [Vec<f64>; 3] = serde_json::from_value(found).unwrap();
    let matrix = Matrix4::from_column_slice(&projection) * Matrix4::from_column_slice(&view);
    let place = |p: &Point3<f64>| {
        let seen: Vector4<f64> = matrix * (p / 1000.0).to_homogeneous();
        [at[0] + (seen.x / seen.w + 1.0) / 2.0 * at[2], at[1] + (1.0 - seen.y / seen.w) / 2.0 * at[3]]
    };
    let all: Vec<[f64; 2]> = case.scan.points().iter().map(place).collect();
    let bound = |k: usize, sign: f64| sign * all.iter().map(|p| sign * p[k]).fold(f64::MAX, f64::min);
    let bounds = [bound(0, 1.0), bound(1, 1.0), bound(0, -1.0), bound(1, -1.0)];
    (all, bounds)
}

/// Draws a lasso around what is bone in the scan, along its upper and lower edge as the region's view shows it.
pub(crate) fn draw_around_bone(browser: &mut Browser, case: &Case) {
    let (seen, _) = seen_points(browser, case);
    let truth = case.t_bone_scan.unwrap();
    let is_bone = |p: &Point3<f64>| case.bone.closest_point(&(truth * p)).is_some_and(|place| place.distance_mm < 0.7);
    let bone: Vec<[f64; 2]> =
        case.scan.points().iter().zip(&seen).filter(|(p, _)| is_bone(p)).map(|(_, at)| *at).collect();
    let bound = |sign: f64| sign * bone.iter().map(|at| sign * at[0]).fold(f64::MAX, f64::min);
    let (left, step) = (bound(1.0), (bound(-1.0) - bound(1.0)) / 10.0);
    let edge = |sign: f64| -> Vec<[f64; 2]> {
        let of = |k: usize| {
            let within = bone.iter().filter(|at| ((at[0] - left) / step - k as f64 - 0.5).abs() <= 0.6);
            [left + (k as f64 + 0.5) * step, sign * within.map(|at| sign * at[1]).fold(f64::MAX, f64::min)]
        };
        (0..10).map(of).collect()
    };
    let (upper, mut lower) = (edge(1.0), edge(-1.0));
    lower.reverse();
    browser.stroke(&[upper, lower].concat());
}

/// Crops by a lasso or a box, saves and runs, and looks at what is left; `n` is the number of the run.
pub(crate) fn crop_by_hand(browser: &mut Browser, case: &Case, n: usize, shape: &str, is_touch: bool) {
    let axis = &case.name;
    let all = case.scan.points();
    press(browser, "#draw");
    browser.wait_until("osteoflow.region.isOpen");
    let rows = browser.evaluate("osteoflow.region.on.rows.length / 3").as_u64();
    assert_eq!(rows, Some(all.len() as u64), "{axis}: it is drawn on what is cropped");
    // Its shape is seen, in the colour of bone until something is drawn.
    let tints = "(() => { const colours = osteoflow.region.on.object.geometry.getAttribute('color').array; const [lights, tints] = [new Set(), new Set()]; \
                 for (let k = 0; k < colours.length; k += 3) { lights.add(Math.round(50 * colours[k])); tints.add(Math.round(10 * colours[k + 2] / Math.max(colours[k], 1e-9))); } \
                 return [lights.size, tints.size]; })()";
    let [lights, hues]: [usize; 2] = serde_json::from_value(browser.evaluate(tints)).unwrap();
    assert!(lights > 10 && hues == 1, "{axis}: {lights} lights of {hues} colours");
    press(browser, &format!("#region-{shape}"));
    // The hand of the picking does nothing meanwhile.
    browser.key("p", false);
    assert_eq!(browser.evaluate("osteoflow.picking.mode"), Value::Null, "{axis}: one tool at a time");
    // Around two thirds of the scan as it is seen.
    let (seen, [left, top, right, bottom]) = seen_points(browser, case);
    let part = |from: f64, to: f64| (from + 0.66 * (to - from)).round();
    let [right, bottom] =
        if right - left > bottom - top { [part(left, right), bottom + 8.0] } else { [right + 8.0, part(top, bottom)] };
    let [left, top, right, bottom] = [left - 8.0, top - 8.0, right, bottom].map(f64::round);
    match (shape, is_touch) {
        ("lasso", _) => browser.stroke(&[[left, top], [right, top], [right, bottom], [left, bottom]]),
        (_, true) => browser.touch(&[[[left, top], [right, bottom]]]),
        _ => browser.stroke(&[[left, top], [right, bottom]]),
    }
    browser.screenshot(&format!("{shape}-{axis}"));
    let [lights, hues]: [usize; 2] = serde_json::from_value(browser.evaluate(tints)).unwrap();
    assert!(lights > 10 && hues == 2, "{axis}: {lights} lights of {hues} colours, inside and outside");
    let is_within = |[x, y]: &[f64; 2], px: f64| *x > left - px && *x < right + px && *y > top - px && *y < bottom + px;
    let said = text(browser, "region-count");
    press(browser, "#region-save");
    browser.wait_until(&format!("osteoflow.state.run === 'run-{n}' && ['complete', 'refused'].includes(osteoflow.state.state) && !osteoflow.region.isOpen"));
    case.results(n);
    let kept = value::<Cloud>(&case.run(n), "crop.cloud").points().to_vec();
    assert_eq!(
        said,
        format!("{} of {} points", kept.len(), all.len()),
        "{axis}, {shape}: counted, and left by the run"
    );
    let is_kept: HashSet<[u64; 3]> = kept.iter().map(bits).collect();
    let [low, high] = [f64::min, f64::max].map(|of: fn(f64, f64) -> f64| {
        kept.iter().skip(1).fold(kept[0], |a, p| Point3::new(of(a.x, p.x), of(a.y, p.y), of(a.z, p.z)))
    });
    for (p, at) in all.iter().zip(&seen) {
        let is = is_kept.contains(&bits(p));
        assert!(is || !is_within(at, -1.0), "{axis}, {shape}: {p} at {at:?} was enclosed and is not left");
        if shape == "box" {
            let is_in_box = (0..3).all(|k| low[k] <= p[k] && p[k] <= high[k]);
            assert_eq!(is, is_in_box, "{axis}: {p} and the box {low} to {high}");
        } else {
            assert!(!is || is_within(at, 1.0), "{axis}, {shape}: {p} at {at:?} was not enclosed and is left");
        }
    }
    assert!(kept.len() > all.len() / 3 && kept.len() < all.len(), "{axis}, {shape}: {said}");
    // Shown is what was kept, not the scan that it was kept of; on the bone, or grey beside it where it was refused.
    browser.wait_until("osteoflow.scene.drawn.has('crop.cloud') && osteoflow.scene.drawn.has('scan.cloud')");
    let shown = browser.evaluate("osteoflow.scene.drawn.get('crop.cloud').object.userData.points.length / 3");
    assert_eq!(shown.as_u64(), Some(kept.len() as u64), "{axis}, {shape}");
    browser.wait_until(
        "[osteoflow.scene, osteoflow.beside.made].some((view) => view?.drawn.get('crop.cloud')?.object.visible) && \
         !osteoflow.scene.drawn.get('scan.cloud').object.visible",
    );
}

/// A point by its bits.
fn bits(p: &Point3<f64>) -> [u64; 3] {
    [p.x, p.y, p.z].map(f64::to_bits)
}

#[test]
fn a_hand_turns_zooms_centres_and_moves_the_bone_by_the_point_under_it_whichever_way_it_lies() {
    let Some(mut browser) = Browser::start("a_hand_turns_zooms_centres_and_moves_the_bone") else { return };
    let browser = &mut browser;
    for (axis, turn) in Case::all() {
        let mut case = Case::new(axis, turn);
        let served = case.view(browser);
        turn_by_hand(browser, &case);
        assert_eq!(browser.complaints(&served.page), Vec::<String>::new());
    }
}

#[test]
fn three_pairs_by_the_mouse_register_a_scan_far_from_the_origin_and_save_and_run_shows_it() {
    let Some(mut browser) = Browser::start("three_pairs_by_the_mouse_register_a_scan") else { return };
    let browser = &mut browser;
    for (axis, turn) in Case::all() {
        let mut case = Case::new(axis, turn);
        let served = case.view(browser);
        pair_by_hand(browser, &case, 2, axis == "y");
        assert_eq!(case.results(2)["verdict"]["answer"], "trusted");
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
        let mut case = Case::new(axis, turn);
        let served = case.view(browser);
        crop_by_hand(browser, &case, 2, if axis == "y" { "box" } else { "lasso" }, axis == "y");
        // A choice of the user's holds.
        press(browser, "#shown input[data-wire=\"scan.cloud\"]");
        browser.wait_until("osteoflow.scene.drawn.get('scan.cloud').object.visible");
        assert_eq!(browser.complaints(&served.page), Vec::<String>::new());
    }
    // A run that is refused shows both, each in its own frame, and what is not registered is grey.
    let case = Case::new("z", UnitQuaternion::identity());
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

/// A scan whose upper half is red and whose lower half is blue, as scanners and other programs write colours.
fn coloured(scan: &Cloud, at_mm: f64, bits: u32, file: &Path) {
    let (kind, most) = if bits == 8 { ("uchar", 255) } else { ("ushort", 65535) };
    let n = scan.points().len();
    let colours = ["red", "green", "blue"].map(|name| format!("property {kind} {name}\n")).concat();
    let mut text = format!(
        "ply\nformat ascii 1.0\nelement vertex {n}\nproperty double x\nproperty double y\nproperty double z\n{colours}end_header\n"
    );
    for p in scan.points() {
        let (red, blue) = if p.y < at_mm { (most, 0) } else { (0, most) };
        text += &format!("{} {} {} {red} {} {blue}\n", p.x, p.y, p.z, most / 5);
    }
    fs::write(file, text).unwrap();
}

/// The colours on the screen within a few pixels of a place, red, green and blue each.
fn pixels(browser: &mut Browser, view: &str, [x, y]: [f64; 2]) -> Vec<[u8; 4]> {
    let read = format!(
        "(() => {{ const canvas = {view}.renderer.domElement; const box = canvas.getBoundingClientRect(); \
         const copy = document.createElement('canvas'); [copy.width, copy.height] = [canvas.width, canvas.height]; \
         const context = copy.getContext('2d'); context.drawImage(canvas, 0, 0); const k = canvas.width / box.width; \
         return [...context.getImageData((({x}) - box.left) * k - 3, (({y}) - box.top) * k - 3, 7, 7).data]; }})()"
    );
    let flat: Vec<u8> = serde_json::from_value(browser.evaluate(&read)).unwrap();
    flat.chunks(4).map(|p| [p[0], p[1], p[2], p[3]]).collect()
}

#[test]
fn a_scan_with_colours_of_its_own_is_shown_in_them_on_the_bone_and_beside_it_when_they_are_asked_for() {
    let Some(mut browser) = Browser::start("a_scan_with_colours_of_its_own") else { return };
    let browser = &mut browser;
    for bits in [8, 16] {
        let mut case = Case::new("z", UnitQuaternion::identity());
        let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/folder/scan.ply");
        // In the camera's frame, where a camera sees it: along its rows.
        case.scan = read_cloud(&data, 1.0, "camera").unwrap().cloud;
        let mut along: Vec<f64> = case.scan.points().iter().map(|p| p.y).collect();
        along.sort_by(f64::total_cmp);
        let half = along[along.len() / 2];
        coloured(&case.scan, half, bits, &case.folder.path().join("scan.ply"));
        let served = case.view(browser);
        let truth = case.t_bone_scan.unwrap();
        browser.wait_until("osteoflow.scene.residuals.has('crop.cloud')");
        let near = |level: f64| {
            let middle = case.scan.points().iter().filter(|p| (p.y - level).abs() < 2.0);
            let (sum, n) = middle.fold((Vector3::zeros(), 0.0), |(sum, n), p| (sum + p.coords, n + 1.0));
            let middle = Point3::from(sum / n);
            *case.scan.points().iter().min_by(|a, b| (*a - middle).norm().total_cmp(&(*b - middle).norm())).unwrap()
        };
        let [upper, lower] = [near(0.5 * (along[0] + half)), near(0.5 * (along[along.len() - 1] + half))];
        // A fifth of the green, and all of the red or the blue, as in the file.
        let is_of = |rgb: &[u8; 4], colour: [u8; 3]| (0..3).all(|k| rgb[k].abs_diff(colour[k]) <= 2);
        let has = |browser: &mut Browser, view: &str, p: &Point3<f64>, colour: [u8; 3]| {
            let at = projected_in(browser, view, p);
            pixels(browser, view, at).iter().any(|rgb| is_of(rgb, colour))
        };
        let (own_red, own_blue) = ([255, 51, 0], [0, 51, 255]);
        let frame = "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => requestAnimationFrame(done))))";
        // At first the colours are those of the distance from the bone, and their scale is there.
        assert_eq!(
            browser.evaluate("[document.getElementById('own').hidden, document.getElementById('scale').hidden]"),
            json!([false, false])
        );
        assert!(!has(browser, BONE, &(truth * upper), own_red), "{bits} bits: distances are not red");
        press(browser, "#own");
        browser.evaluate(frame);
        browser.screenshot(&format!("own-colours-{bits}"));
        assert!(has(browser, BONE, &(truth * upper), own_red), "{bits} bits: {:?}", {
            let at = projected(browser, &(truth * upper));
            pixels(browser, BONE, at)
        });
        assert!(has(browser, BONE, &(truth * lower), own_blue), "{bits} bits");
        browser.wait_until("document.getElementById('scale').hidden && document.getElementById('own').getAttribute('aria-pressed') === 'true'");
        // Beside the bone the scan has them, too, and light and shade without them.
        press(browser, "#pick-pairs");
        browser.wait_until("osteoflow.beside.made?.drawn.get(osteoflow.beside.picked?.wire)?.object.visible === true && !osteoflow.beside.isNew");
        browser.evaluate(frame);
        browser.screenshot(&format!("own-colours-beside-{bits}"));
        assert!(has(browser, SCAN, &upper, own_red) && has(browser, SCAN, &lower, own_blue), "{bits} bits, beside");
        browser.evaluate("document.activeElement.blur()");
        browser.key("c", false);
        browser.evaluate(frame);
        let at = projected_in(browser, SCAN, &upper);
        let shades = pixels(browser, SCAN, at);
        assert!(!shades.iter().any(|rgb| is_of(rgb, own_red)), "{bits} bits: shades are not red");
        assert!(
            shades.iter().any(|[r, g, b, _]| r >= g && g >= b && *r > 90),
            "{bits} bits: the colour of bone, {shades:?}"
        );
        assert_eq!(browser.complaints(&served.page), Vec::<String>::new());
    }
}
