//! Page and report from a telephone to a large screen, light and dark: what is written can be read, what is pressed can be hit, nothing leaves its box.

use crate::common::{browser::Browser, osteoflow, served::Served, shared_run};
use crate::viewer_picking::press;
use serde_json::{Value, json};

const WIDTHS: [u32; 4] = [360, 768, 1440, 2560];

/// What of the page that is shown cannot be read, hit or reached, at each width, light and dark.
fn faults(browser: &mut Browser, what: &str) -> Vec<String> {
    let mut all = Vec::new();
    for width in WIDTHS {
        let size = json!({ "width": width, "height": 900, "deviceScaleFactor": 1, "mobile": false });
        browser.call("Emulation.setDeviceMetricsOverride", size);
        for theme in ["light", "dark"] {
            let features = json!([{ "name": "prefers-color-scheme", "value": theme }]);
            browser.call("Emulation.setEmulatedMedia", json!({ "features": features }));
            browser.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))");
            let found = browser.evaluate(include_str!("viewer_layout.js"));
            let found: Vec<String> = serde_json::from_value(found).unwrap();
            all.extend(found.iter().map(|fault| format!("{what}, {width} pixels, {theme}: {fault}")));
            browser.screenshot(&format!("{what}-{width}-{theme}"));
        }
    }
    browser.call("Emulation.setEmulatedMedia", json!({ "features": [] }));
    all
}

#[test]
fn page_and_report_can_be_read_and_hit_from_360_to_2560_pixels_light_and_dark() {
    let Some(mut browser) = Browser::start("page_and_report_can_be_read_and_hit") else { return };
    let browser = &mut browser;
    let run = shared_run("graphs/fibula.toml", &[]).dir.path();
    let out = tempfile::tempdir().unwrap();
    let picks = out.path().join("picks");
    let served = Served::start(&["view", run.to_str().unwrap(), "--picks", picks.to_str().unwrap()]);
    browser.events.clear();
    browser.call("Page.navigate", json!({ "url": served.page }));
    browser.wait_until("typeof osteoflow === 'object' && osteoflow.scene.drawn.has('bone.mesh')");
    browser
        .evaluate("(() => { const time = document.getElementById('time'); time.value = '1000'; time.onchange(); })()");
    browser.wait_until(
        "osteoflow.verdict !== null && osteoflow.scene.drawn.get('to_bone.cloud')?.object.visible === true",
    );
    let mut all = faults(browser, "view");
    // With all that can be open.
    browser.evaluate("document.querySelectorAll('details').forEach((row) => { row.open = true; })");
    press(browser, "#pick-plan");
    browser.wait_until("osteoflow.picking.mode === 'plan'");
    all.extend(faults(browser, "plan"));
    press(browser, "#pick-pairs");
    browser.wait_until("osteoflow.picking.mode === 'pairs' && !document.getElementById('beside').hidden");
    all.extend(faults(browser, "pairs"));
    assert_eq!(browser.complaints(&served.page), Vec::<String>::new());

    let report = out.path().join("report.html");
    let made = osteoflow().arg("report").arg(run).arg("--out").arg(&report).output().unwrap();
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    browser.open(&report);
    browser.wait_until("document.documentElement.dataset.loaded !== undefined");
    all.extend(faults(browser, "report"));
    let html = std::fs::read_to_string(&report).unwrap();
    let manifest: Value = serde_json::from_slice(&std::fs::read(run.join("manifest.json")).unwrap()).unwrap();
    let began = manifest["began"].as_str().unwrap();
    let date = format!("{} {} UTC", &began[..10], &began[11..16]);
    assert!(html.contains(&date), "no {date}");
    assert!(html.contains("<th scope=\"col\" class=\"n\">tilt (\u{b0})</th>"), "angles are in degrees");
    assert!(all.is_empty(), "{} faults:\n{}", all.len(), all[..all.len().min(40)].join("\n"));
}
