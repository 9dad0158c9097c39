//! The pictures of a report are those of the live page, in a browser.

use crate::common::browser::Browser;
use crate::common::served::Served;
use crate::common::{copied_run, osteoflow, skips_slow};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

const GRAPH: &str = "graphs/fibula.toml";

/// A run with these settings, and its report.
fn reported(sets: &[&str]) -> (tempfile::TempDir, PathBuf) {
    let dir = tempfile::tempdir().unwrap();
    let run = dir.path().join("run");
    let mut command = osteoflow();
    command.args(["run", GRAPH, "--set", "recording.camera.n_points=8000", "--quiet", "--out"]).arg(&run);
    sets.iter().for_each(|set| {
        command.args(["--set", set]);
    });
    command.output().unwrap();
    osteoflow().arg("report").arg(&run).assert().success();
    (dir, run)
}

/// A run without settings, and its report.
fn reported_as_it_is() -> (tempfile::TempDir, PathBuf) {
    let (dir, run) = copied_run(GRAPH, &[]);
    osteoflow().arg("report").arg(&run).assert().success();
    (dir, run)
}

fn small_view(browser: &mut Browser) {
    // The renderer has no graphics card.
    let size = json!({ "width": 640, "height": 480, "deviceScaleFactor": 1, "mobile": false });
    browser.call("Emulation.setDeviceMetricsOverride", size);
}

/// What a scene shows: each layer with why it is hidden, its points, its planes and how many of them are hatched.
fn layers(browser: &mut Browser, scene: &str) -> Value {
    browser.evaluate(&format!(
        "[...{scene}.drawn].map(([wire, {{ payload, shown, object, frame }}]) => {{ let nPlanes = 0, nHatched = 0; \
         const ellipsoids = []; object.traverse((part) => {{ if (part.userData.isEllipsoid) ellipsoids.push(part.matrix.elements); if (part.userData.isPlane) {{ nPlanes++; nHatched += part.userData.isHatched ? 1 : 0; }} }}); \
         const nPoints = payload === 'geometry/Cloud' ? object.children[0].geometry.getAttribute('position').count : \
         [...(object.userData.places ?? [])].length; return {{ wire, payload, frame, shown, visible: object.visible, \
         why: object.userData.why ?? null, nPoints, nPlanes, nHatched, ellipsoids }}; }}).sort((a, b) => (a.wire < b.wire ? -1 : 1))"
    ))
}

/// Opens a report, and waits until its first view is drawn.
fn open_report(browser: &mut Browser, run: &Path) {
    let page = run.join("report.html");
    browser.open(&page);
    browser.wait_until("'loaded' in document.documentElement.dataset");
    browser.evaluate("document.querySelector('.view').scrollIntoView({ block: 'center' })");
    browser.wait_until(
        "document.querySelector('.view canvas') !== null || !document.querySelector('.view .fallback').hidden",
    );
    browser.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))");
}

/// The first view of the report and the live page, side by side: layers, verdict, frames and residuals.
fn compare(browser: &mut Browser, run: &Path, answer: &str) {
    let cloud = "to_bone.cloud";
    let served = Served::start(&["view", run.to_str().unwrap()]);
    small_view(browser);
    browser.call("Page.navigate", json!({ "url": served.page }));
    browser.wait_until("document.readyState === 'complete' && typeof osteoflow === 'object'");
    browser.wait_until(&format!("document.getElementById('verdict').className === 'verdict {answer}'"));
    browser
        .wait_until(&format!("osteoflow.scene.drawn.has('planes.planes') && osteoflow.scene.residuals.has('{cloud}')"));
    browser.wait_until("osteoflow.devices.names !== '' && osteoflow.scene.drawn.get('bone.mesh').object.visible");
    browser.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))");
    let of = |scene: &str, frames: &str| {
        (
            format!("{frames}.toRoot('ct').matrix.elements"),
            format!(
                "[...{scene}.residuals.get('{cloud}')].map((mm) => (Number.isFinite(mm) ? Math.max(-1, Math.min(1, mm)) : 9))"
            ),
        )
    };
    let (place, residuals) = of("osteoflow.scene", "osteoflow.frames");
    let page_layers = layers(browser, "osteoflow.scene");
    let verdict = browser.evaluate("document.getElementById('verdict').textContent");
    let (page_place, page_residuals) = (browser.evaluate(&place), browser.evaluate(&residuals));
    browser.wait_until("document.querySelectorAll('#shown li').length > 5");
    let list = "[...document.querySelectorAll('SELECTOR')].map((entry) => entry.textContent)";
    let page_list = browser.evaluate(&list.replace("SELECTOR", "#shown li"));

    open_report(browser, run);
    let view = "osteoflow.views[0]";
    let (place, residuals) = of(&format!("{view}.scene"), &format!("{view}.frames"));
    assert_eq!(layers(browser, &format!("{view}.scene")), page_layers);
    assert_eq!(browser.evaluate("document.querySelector('.judged').textContent"), verdict);
    let own_list = browser.evaluate(&list.replace("SELECTOR", "figure:has(.judged) .layers li"));
    assert_eq!(own_list, page_list, "the same words");
    let numbers = |value: Value| -> Vec<f64> { serde_json::from_value(value).unwrap() };
    let (ours, theirs) = (numbers(browser.evaluate(&place)), numbers(page_place));
    let off = ours.iter().zip(&theirs).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(off < 1e-12, "the bone is elsewhere by {off} m");
    let (ours, theirs) = (numbers(browser.evaluate(&residuals)), numbers(page_residuals));
    assert_eq!(ours.len(), theirs.len());
    let off = ours.iter().zip(&theirs).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(off < 0.006, "a residual differs by {off} mm; they have 8 bits, and positions 16");
    assert_eq!(browser.complaints(&format!("file://{}", run.join("report.html").display())), Vec::<String>::new());
    if let Some(to) = std::env::var_os("REPORT_SCREENSHOTS") {
        let shot = browser.call("Page.captureScreenshot", json!({ "format": "png" }));
        let to = Path::new(&to).join(format!("report-{answer}.png.base64"));
        std::fs::write(to, shot["data"].as_str().unwrap()).unwrap();
    }
}

#[test]
fn a_report_shows_the_layers_the_verdict_and_the_residuals_of_the_live_page() {
    if skips_slow("a_report_shows_the_layers_the_verdict_and_the_residuals_of_the_live_page") {
        return;
    }
    let Some(mut browser) = Browser::start("a_report_shows_the_layers_the_verdict_and_the_residuals_of_the_live_page")
    else {
        return;
    };
    let (_dir, run) = reported_as_it_is();
    compare(&mut browser, &run, "trusted");
    let layers_of = layers(&mut browser, "osteoflow.views[0].scene");
    let drawn =
        layers_of.as_array().unwrap().iter().filter(|layer| !layer["ellipsoids"].as_array().unwrap().is_empty());
    let drawn: Vec<_> = drawn.map(|layer| (&layer["wire"], layer["ellipsoids"].as_array().unwrap().len())).collect();
    let n_predicted =
        crate::common::json(&run.join("results.json"))["verdict"]["predicted"]["points"].as_array().unwrap().len();
    assert_eq!(drawn, [(&json!("plan.assessment"), n_predicted)]);
    let words =
        "document.querySelector('figure:has(.judged) .legend').textContent.includes('holds the point with 90 %')";
    assert_eq!(browser.evaluate(words), true, "the legend names the ellipsoid");
    let planes = "osteoflow.views[0].scene.drawn.get('planes.planes').object.visible";
    assert_eq!(browser.evaluate(planes), true);
    // Points just inside the bone are blue, and the bone does not cover them.
    let blue = browser.evaluate(
        "(() => { const c = document.querySelector('.view canvas'), gl = c.getContext('webgl2'), p = new Uint8Array(4 * \
         c.width * c.height); gl.readPixels(0, 0, c.width, c.height, gl.RGBA, gl.UNSIGNED_BYTE, p); let n = 0; for (let k = \
         0; k < p.length; k += 4) n += p[k + 3] === 255 && p[k + 2] > p[k] + 4 && p[k] > 100 ? 1 : 0; return n; })()",
    );
    assert!(blue.as_u64().unwrap() > 30, "{blue} blue pixels");
    // A layer is hidden from the list, and the bone made transparent.
    browser.evaluate("(() => { const of = [...document.querySelectorAll('.layers li')].find((li) => li.textContent.trim() === 'planes.planes'); of.querySelector('input').click(); document.querySelector('[data-do=g]').click(); })()");
    browser.wait_until(&format!(
        "{planes} === false && osteoflow.views[0].scene.drawn.get('bone.mesh').object.children[0].material.opacity < 1"
    ));
}

#[test]
fn a_report_hatches_planes_of_a_doubtful_answer_and_draws_none_of_a_refused_one() {
    if skips_slow("a_report_hatches_planes_of_a_doubtful_answer_and_draws_none_of_a_refused_one") {
        return;
    }
    let Some(mut browser) =
        Browser::start("a_report_hatches_planes_of_a_doubtful_answer_and_draws_none_of_a_refused_one")
    else {
        return;
    };
    let doubt = "verdict.rules.max_misfit_mm=0.001";
    let (_dir, run) = reported(&[doubt]);
    compare(&mut browser, &run, "doubtful");
    let layers_of = layers(&mut browser, "osteoflow.views[0].scene");
    let planes = layers_of.as_array().unwrap().iter().find(|layer| layer["wire"] == "planes.planes").unwrap();
    assert_eq!([&planes["nPlanes"], &planes["nHatched"], &planes["visible"]], [&json!(2), &json!(2), &json!(true)]);
    let (_dir, run) = reported(&[doubt, "results.require=trusted"]);
    compare(&mut browser, &run, "refused");
    let drawn = layers(&mut browser, "osteoflow.views[0].scene");
    let of_planes: Vec<_> =
        drawn.as_array().unwrap().iter().filter(|layer| layer["payload"] == "geometry/Planes").collect();
    let with_errors = |layer: &Value| layer["ellipsoids"] != json!([]);
    assert!(!drawn.as_array().unwrap().iter().any(with_errors), "a refused answer has no predicted error: {drawn}");
    assert!(!of_planes.is_empty() && of_planes.iter().all(|layer| layer["visible"] == false), "{of_planes:?}");
    assert_eq!(browser.evaluate("document.querySelectorAll('.view').length"), 1, "no other picture of refused results");
}

#[test]
fn a_browser_without_webgl_is_named_in_place_of_each_view() {
    if skips_slow("a_browser_without_webgl_is_named_in_place_of_each_view") {
        return;
    }
    let Some(mut browser) = Browser::start("a_browser_without_webgl_is_named_in_place_of_each_view") else { return };
    let (_dir, run) = reported_as_it_is();
    let none = "HTMLCanvasElement.prototype.getContext = () => null";
    browser.call("Page.addScriptToEvaluateOnNewDocument", json!({ "source": none }));
    open_report(&mut browser, &run);
    let words = browser.evaluate("document.querySelector('.view .fallback').textContent");
    assert_eq!(
        words,
        "This browser has no WebGL. figures/view-residuals.svg shows the scan on the bone from one side."
    );
    assert!(run.join("figures/view-residuals.svg").is_file());
    assert_eq!(browser.evaluate("document.querySelector('.view .bar').hidden"), true);
}
