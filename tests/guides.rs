//! Pages that a newcomer follows: each command is run in the order of the page, and what the page shows is what it prints. The pictures
//! are of the pages that a browser shows on the way. `UPDATE=1` writes both.

use crate::common::{browser::Browser, json, osteoflow, page::Page, python::python, root};
use base64::{Engine, prelude::BASE64_STANDARD};
use serde_json::json;
use std::{
    fs,
    path::Path,
    time::{Duration, Instant},
};

/// Size of a picture, pixels.
const SIZE: [u32; 2] = [1000, 640];
/// Mean difference of the colours of two pictures from which another thing is shown: another font or renderer differs by less.
const SAME_COLOURS: f64 = 9.0;

/// Waits until a run has written its results.
fn wait_for(results: &Path) {
    let until = Instant::now() + Duration::from_secs(120);
    while !results.exists() {
        assert!(Instant::now() < until, "{} does not come", results.display());
        std::thread::sleep(Duration::from_millis(50));
    }
}

fn show(browser: &mut Browser, url: &str) {
    let size = json!({ "width": SIZE[0], "height": SIZE[1], "deviceScaleFactor": 1, "mobile": false });
    browser.call("Emulation.setDeviceMetricsOverride", size);
    browser.events.clear();
    browser.call("Page.navigate", json!({ "url": url }));
    browser.wait_until("document.readyState === 'complete'");
}

/// Mean difference of the colours of two pictures (PNG in base64), drawn by the browser in squares of some pixels; 255 if their sizes differ.
fn difference(browser: &mut Browser, a: &str, b: &str) -> f64 {
    browser.call("Page.navigate", json!({ "url": "about:blank" }));
    let pixels = "async (data) => { const image = new Image(); image.src = 'data:image/png;base64,' + data; await image.decode(); \
                  const canvas = new OffscreenCanvas(50, 32); const to = canvas.getContext('2d'); to.imageSmoothingQuality = 'high'; \
                  to.drawImage(image, 0, 0, 50, 32); return [image.width, image.height, ...to.getImageData(0, 0, 50, 32).data]; }";
    let difference = browser.evaluate(&format!(
        "(async () => {{ const pixels = {pixels}; const a = await pixels('{a}'); const b = await pixels('{b}').catch(() => []); \
         if (a[0] !== b[0] || a[1] !== b[1]) return 255; \
         return a.reduce((sum, value, k) => sum + Math.abs(value - b[k]), 0) / a.length; }})()"
    ));
    difference.as_f64().unwrap()
}

/// Compares what the browser shows with the picture of a page, or writes it.
fn compare_picture(browser: &mut Browser, picture: &str) {
    browser.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))");
    let shot = browser.call("Page.captureScreenshot", json!({ "format": "png" }));
    let shot = shot["data"].as_str().unwrap();
    let path = root().join(picture);
    let kept = BASE64_STANDARD.encode(fs::read(&path).unwrap_or_default());
    let difference = difference(browser, shot, &kept);
    if difference > SAME_COLOURS / 4.0 && std::env::var_os("UPDATE").is_some() {
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(&path, BASE64_STANDARD.decode(shot).unwrap()).unwrap();
        return;
    }
    assert!(
        difference < SAME_COLOURS,
        "{picture} shows something else (colours differ by {difference:.1}); `UPDATE=1 cargo test --release --test suite guides::` takes it again"
    );
}

#[test]
fn a_picture_of_another_page_or_of_an_empty_one_is_found() {
    let Some(mut browser) = Browser::start("a_picture_of_another_page_or_of_an_empty_one_is_found") else { return };
    let [page, report] = ["page", "report"].map(|name| {
        let picture = root().join(format!("docs/begin/first-week/{name}.png"));
        BASE64_STANDARD.encode(fs::read(picture).unwrap())
    });
    assert_eq!(difference(&mut browser, &page, &page), 0.0);
    for other in [&report, ""] {
        let found = difference(&mut browser, &page, other);
        assert!(found > SAME_COLOURS, "{found}");
    }
    // The page before its bone is drawn.
    show(&mut browser, "about:blank");
    let empty = browser.call("Page.captureScreenshot", json!({ "format": "png" }));
    let found = difference(&mut browser, &page, empty["data"].as_str().unwrap());
    assert!(found > SAME_COLOURS, "{found}");
}

#[test]
fn the_numbers_beside_each_other_are_those_of_one_run() {
    let Some(interpreter) = python("the_numbers_beside_each_other_are_those_of_one_run") else { return };
    let folder = tempfile::tempdir().unwrap();
    let done = Page::open("docs/begin/which-number.md", folder.path(), Some(&interpreter)).follow(|_| 0, |_, _, _| {});
    assert_eq!(done.len(), 3);
}

#[test]
fn the_page_of_a_camera_and_a_tracker_of_ones_own_runs_as_it_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let mut page = Page::open("docs/begin/own-camera.md", folder.path(), None);
    let done = page.follow(|_| 0, |_, _, _| {});
    assert!(done.len() >= 4);

    // While all rests, a matrix that is 10 mm off is shown by the stylus alone; without it the answer is doubtful, as is that of the right one.
    let at = folder.path().join("own");
    let simulate = ["simulate", "--points", "10000", "--as", "folder", "--out", "rest"];
    osteoflow().current_dir(&at).args(simulate).assert().success();
    let with_stylus = fs::read_to_string(at.join("own_procedure.toml")).unwrap().replace("mine/", "rest/");
    let (without_stylus, _) = with_stylus.split_once("[[stylus]]").unwrap();
    let right = fs::read_to_string(at.join("hand_eye.txt")).unwrap();
    let mut wrong: Vec<String> = right.split_whitespace().map(str::to_owned).collect();
    wrong[3] = (wrong[3].parse::<f64>().unwrap() + 10.0).to_string();
    for (name, text) in [
        ("stylus.toml", &*with_stylus),
        ("no_stylus.toml", without_stylus),
        ("right.txt", &*right),
        ("wrong.txt", &*wrong.join(" ")),
    ] {
        fs::write(at.join(name), text).unwrap();
    }
    let unknown = ["--set", "verdict.errors.hand_eye_mm=30", "--set", "verdict.errors.hand_eye_deg=10"];
    for (matrix, procedure, more, expected) in [
        ("right", "stylus", &[][..], ("trusted", None)),
        ("wrong", "stylus", &[], ("refused", Some("stylus"))),
        ("right", "no_stylus", &unknown, ("doubtful", Some("hand_eye"))),
        ("wrong", "no_stylus", &unknown, ("doubtful", Some("hand_eye"))),
    ] {
        let out = format!("{matrix}_{procedure}");
        let set = |key: &str, value: String| ["--set".to_owned(), format!("{key}={value}")];
        let sets = [set("recording.path", format!("{procedure}.toml")), set("hand_eye.path", format!("{matrix}.txt"))];
        let run = osteoflow()
            .current_dir(&at)
            .args(["run", "own.toml", "--out", &out])
            .args(sets.concat())
            .args(more)
            .output();
        let code = if expected.0 == "refused" { 3 } else { 0 };
        assert_eq!(run.unwrap().status.code(), Some(code), "{out}");
        let verdict = &json(&at.join(&out).join("results.json"))["verdict"];
        let first = verdict["reasons"].as_array().and_then(|reasons| reasons.first()?["rule"].as_str());
        assert_eq!((verdict["answer"].as_str().unwrap(), first), expected, "{out}");
    }
}

#[test]
fn the_first_week_runs_as_it_is_written() {
    let test = "the_first_week_runs_as_it_is_written";
    let Some(interpreter) = python(test) else { return };
    let folder = tempfile::tempdir().unwrap();
    let mut browser = Browser::start(test);
    let mut page = Page::open("docs/begin/first-week.md", folder.path(), Some(&interpreter));
    let expected = |command: &str| i32::from(command.ends_with("wound/scan.ply --camera 0,0,0")) * 3;
    let done = page.follow(expected, |_, at, address| {
        wait_for(&at.join("two/results.json"));
        let Some(browser) = &mut browser else { return };
        show(browser, address);
        browser.wait_until(
            "typeof osteoflow === 'object' && document.getElementById('verdict').className === 'verdict trusted'",
        );
        browser.wait_until("[...osteoflow.scene.residuals.values()].some((of) => of.length > 0)");
        compare_picture(browser, "docs/begin/first-week/page.png");
    });
    let at = folder.path();
    // What the page says that it finds is there.
    for file in [
        "week/bone.stl",
        "two/report.html",
        "two/export/scan.vtk",
        "week.mrb",
        "scan.vtk",
        "registered/pose.tfm",
        "my_procedure/first/run.mcap",
        "my_procedure/first/report.html",
        "my_icp/S/report.html",
        "my_icp/S/citations.bib",
        "my_icp/S/summary.json",
        "my_icp/S/runs.csv",
        "my_icp/S/points.csv",
        "my_icp/study.zip",
    ] {
        assert!(at.join(file).is_file(), "{file}");
    }
    assert!(
        fs::read_dir(at.join("my_icp/S/figures"))
            .unwrap()
            .any(|file| file.unwrap().path().extension().unwrap() == "svg")
    );
    let printed = |part: &str| &done.iter().find(|done| done.command.contains(part)).unwrap().printed;
    assert!(printed("register week").contains("verdict  trusted"));
    assert!(printed("--landmarks").contains("verdict  trusted"));
    // The pose of the second day is the true one, not only a trusted one.
    let truth = json(&at.join("wound/truth.json"));
    let pose = printed("--landmarks").lines().skip_while(|line| !line.starts_with("t_target_source")).skip(1).take(3);
    let pose: Vec<Vec<f64>> =
        pose.map(|row| row.split_whitespace().map(|cell| cell.parse().unwrap()).collect()).collect();
    let (ct_world, world_scan) =
        (crate::common::isometry(&truth["CT_T_W"]), crate::common::isometry(&truth["W_T_C_scan"]));
    let spot = crate::common::point(&truth["laser_spots_C"][0]);
    let is = ct_world * world_scan * spot;
    let found = |row: &Vec<f64>| row[0] * spot.x + row[1] * spot.y + row[2] * spot.z + row[3];
    let off_mm = (0..3).map(|k| (found(&pose[k]) - is[k]).powi(2)).sum::<f64>().sqrt();
    assert!(off_mm < 0.5, "{off_mm} mm: noise and bias of the camera are 0.1 mm, and the CT's surface is 0.06 mm off");

    let Some(browser) = &mut browser else { return };
    show(browser, &format!("file://{}", at.join("two/report.html").display()));
    browser.wait_until("'loaded' in document.documentElement.dataset");
    browser.evaluate("document.querySelector('.view').scrollIntoView({ block: 'center' })");
    browser.wait_until(
        "document.querySelector('.view canvas') !== null || !document.querySelector('.view .fallback').hidden",
    );
    let verdict = browser.evaluate("document.querySelector('.judged').textContent");
    assert!(verdict.as_str().unwrap().contains("trusted"), "{verdict}");
    compare_picture(browser, "docs/begin/first-week/report.png");
}
