//! What the page says to do first, in each of its states, and how the reasons of a verdict are read from a telephone to a wide screen.

use crate::common::{browser::Browser, osteoflow, served::Served, shared_run};
use crate::viewer_picking::{press, text};
use serde_json::{Value, json};
use std::{path::Path, sync::OnceLock};

/// The width of a telephone, and of two windows.
const WIDTHS: [u32; 3] = [390, 1000, 1440];
const FRAMES: &str =
    "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => requestAnimationFrame(done))))";

fn resize(browser: &mut Browser, width: u32) {
    let size = json!({ "width": width, "height": 900, "deviceScaleFactor": 1, "mobile": false });
    browser.call("Emulation.setDeviceMetricsOverride", size);
    browser.evaluate(FRAMES);
}

/// Opens a page whose stream can be held back, and said otherwise.
fn open(browser: &mut Browser, page: &str, ready: &str) {
    browser.events.clear();
    browser.call("Page.navigate", json!({ "url": page }));
    browser.wait_until(&format!("document.readyState === 'complete' && typeof osteoflow === 'object' && ({ready})"));
}

/// Waits until the line is this one, with this button.
pub(crate) fn wait_for_line(browser: &mut Browser, text: &str, button: Option<&str>) {
    let expected = json!([text, button]);
    browser.wait_until(&format!("JSON.stringify({LINE}) === JSON.stringify({expected})"));
}

/// The line, and the text of the button beside it, null if there is none.
const LINE: &str = "(() => { const [line, button] = document.getElementById('next').children; return [line.textContent, button.hidden ? null : button.textContent]; })()";

/// The line, and the button beside it if there is one.
fn line(browser: &mut Browser) -> (String, Option<String>) {
    browser.evaluate(FRAMES);
    let said = browser.evaluate(LINE);
    serde_json::from_value(said).unwrap()
}

fn reason(rule: &str, answer: &str, reason: &str, remedy: &str) -> Value {
    json!({ "rule": rule, "answer": answer, "reason": reason, "remedy": remedy })
}

/// A verdict of these reasons, as `results.json` has it.
fn verdict(answer: &str, reasons: &[Value]) -> Value {
    json!({ "answer": answer, "sentence": reasons[0]["reason"], "reasons": reasons })
}

const CROP: &str = "crop the scan to the bone (register: --box, --sphere, or --region with a region drawn on the page of osteoflow view; \
                    in a graph: crop.box)";

#[test]
fn each_state_of_the_page_says_in_one_line_at_one_place_what_to_do_first_with_its_button() {
    let Some(mut browser) = Browser::start("each_state_of_the_page_says_in_one_line") else { return };
    let browser = &mut browser;
    browser.call("Page.addScriptToEvaluateOnNewDocument", json!({ "source": include_str!("viewer_next.js") }));
    resize(browser, 1200);
    let folder = tempfile::tempdir().unwrap();
    let [out, picks] = ["run", "picks"].map(|name| folder.path().join(name).display().to_string());
    let (bone, scan) = ("tests/data/folder/bone.stl", "tests/data/folder/scan.ply");
    let served = Served::start(&["view", bone, scan, "--out", &out, "--picks", &picks]);

    // Before a scan has come, as the page first hears of its run.
    let held = "stream.holds = true;";
    browser.call("Page.addScriptToEvaluateOnNewDocument", json!({ "source": held }));
    open(browser, &served.page, "stream.ids.has('/viewer/state')");
    let running = json!({ "name": "two_files", "state": "running", "origin": "recorded", "verdict_wire": "none" });
    let say = |browser: &mut Browser, state: &Value| {
        browser.evaluate(&format!("stream.say({state})"));
        line(browser)
    };
    let alone = |text: &str| (text.to_owned(), None);
    let with = |text: &str, button: &str| (text.to_owned(), Some(button.to_owned()));
    assert_eq!(line(browser), alone("Wait: the page connects to its run"));
    assert_eq!(say(browser, &running), alone("Wait: the bone and its scan are being read"));
    let mut live = running.clone();
    live["origin"] = "live".into();
    assert_eq!(say(browser, &live), alone("Show the bone to the camera: no scan has come yet"));

    // What the run really gave.
    browser.call("Page.addScriptToEvaluateOnNewDocument", json!({ "source": "stream.holds = false;" }));
    let done = "osteoflow.state.state === 'complete' && osteoflow.scene.drawn.has('scan.cloud') && osteoflow.scene.drawn.get('crop.cloud')?.object.visible";
    open(browser, &served.page, done);
    let trusted = alone("Touch one landmark with a stylus, or scan a check piece, before you use this answer");
    assert_eq!(line(browser), trusted);
    let state = browser.evaluate("osteoflow.state");
    let place = "JSON.stringify([document.getElementById('next').getBoundingClientRect().top - document.querySelector('header').getBoundingClientRect().bottom, \
                 document.getElementById('next').checkVisibility()])";
    assert_eq!(browser.evaluate(place), "[0,true]");
    let surroundings = "surroundings such as skin or drape are in the scan: only 12 % of it lies on the surface";
    let start = "start from landmarks or from a known pose, or scan a longer stretch, or one with more shape";
    let mirrored = reason(
        "mirrored",
        "refused",
        "the scan's mirror image fits better",
        "check the side, and that the CT was not flipped on export",
    );
    let misfit = reason(
        "misfit",
        "doubtful",
        "scan and surface differ",
        "clean the bone and scan again, and check that CT and scan are of one bone",
    );
    let require = reason(
        "require",
        "refused",
        "the result is doubtful, and [results] require = \"trusted\"",
        "remove the doubts",
    );
    let lost = reason("failure", "refused", "node \"scan\": scan.ply cannot be read", "mend the cause and run again");
    let stopped = reason("interrupted", "refused", "the run was interrupted before its end", "run it again to its end");
    let nowhere = format!(
        "node \"coarse\": none of 90 starts came to lie on the surface; If surroundings are in the scan, {CROP}"
    );
    let four = "check the side; scan more of the bone, or start from four landmarks that do not lie in a plane";
    let unit = "give its unit (register: --source-unit-mm 1000; in a graph: scan.unit_mm = 1000.0)";
    let sensor = "state the sensor if it is another one (register: --sensor; in a graph: ct_surface.sensor.like), clean the bone and scan again, \
                  and check that CT and scan are of one bone";
    let mended = "Mend what the line above says, and run again";
    for (changes, expected) in [
        (
            json!({ "state": "running", "verdict": null, "verdict_wire": "none" }),
            alone("Wait: the scan is being registered onto the bone"),
        ),
        (
            json!({ "verdict": verdict("refused", &[reason("start", "refused", surroundings, &format!("{CROP}; else start from landmarks"))]) }),
            with("Crop the scan to the bone: skin or drape is in it", "Region"),
        ),
        (
            json!({ "verdict": verdict("doubtful", &[reason("on_surface", "doubtful", surroundings, CROP), misfit.clone()]) }),
            with("Crop the scan to the bone: skin or drape is in it", "Region"),
        ),
        (
            json!({ "verdict": verdict("doubtful", &[reason("start", "doubtful", "it started by shape alone", start)]) }),
            with("Show where the scan lies: pick three places on the bone, and the same on the scan", "Pick pairs"),
        ),
        (
            json!({ "verdict": verdict("doubtful", &[reason("mirrored", "doubtful", "the mirror image fits better", four)]) }),
            with(
                "Check the side; scan more of the bone, or start from four landmarks that do not lie in a plane",
                "Pick pairs",
            ),
        ),
        (
            json!({ "verdict": verdict("refused", &[misfit.clone(), mirrored.clone()]) }),
            alone("Check the side, and that the CT was not flipped on export"),
        ),
        (
            json!({ "verdict": verdict("refused", &[require, misfit.clone()]) }),
            alone("Clean the bone and scan again, and check that CT and scan are of one bone"),
        ),
        (
            json!({ "verdict": verdict("doubtful", &[misfit]) }),
            alone("Clean the bone and scan again, and check that CT and scan are of one bone"),
        ),
        (
            json!({ "verdict": verdict("refused", &[reason("extent", "refused", "the scan spans 0.1 mm", unit)]) }),
            alone("Give its unit (register: --source-unit-mm 1000; in a graph: scan.unit_mm = 1000.0)"),
        ),
        (
            json!({ "verdict": verdict("doubtful", &[reason("misfit", "doubtful", "scan and surface differ", sensor)]) }),
            alone(
                "State the sensor if it is another one, clean the bone and scan again, and check that CT and scan are of one bone",
            ),
        ),
        (
            json!({ "verdict": verdict("doubtful", &[reason("own", "doubtful", "a rule of one's own", "")]) }),
            alone(mended),
        ),
        (json!({ "state": "refused", "verdict": verdict("refused", &[lost]) }), alone(mended)),
        (json!({ "state": "interrupted", "verdict": verdict("refused", &[stopped]) }), alone(mended)),
        (
            json!({ "state": "refused", "verdict": verdict("refused", &[reason("failure", "refused", &nowhere, "mend the cause and run again")]) }),
            with(
                "Crop the scan to the bone if skin or drape is in it; else mend what the line above says, and run again",
                "Region",
            ),
        ),
        (
            json!({ "state": "failed", "verdict": null, "problem": "the disk is full", "verdict_wire": "none" }),
            alone("Mend what the red line says, and run again"),
        ),
        (
            json!({ "problem": "the graph has a fault and was not run", "outdated": true }),
            alone("Mend the graph as the red line says; it is run again once it is saved"),
        ),
        (
            json!({ "verdict": null, "verdict_wire": "none" }),
            alone("Look at the scan on the bone yourself: nothing in this graph gives a verdict"),
        ),
    ] {
        let mut now = state.clone();
        now.as_object_mut().unwrap().extend(changes.as_object().unwrap().clone());
        assert_eq!(say(browser, &now), expected, "{changes}");
        assert_eq!(browser.evaluate(place), "[0,true]", "{changes}: the line is below the head of the page");
        let step = browser.evaluate("document.getElementById('next').dataset.step");
        browser.screenshot(&format!("next-{}", step.as_str().unwrap()));
    }

    // A button does what it says, and the line goes on with it; as do the tools that are opened elsewhere.
    let mut now = state.clone();
    now["verdict"] = verdict("refused", &[reason("start", "refused", surroundings, CROP)]);
    say(browser, &now);
    press(browser, "#next button");
    browser.wait_until("osteoflow.region.isOpen");
    assert_eq!(line(browser), alone("Draw around the bone on the scan"));
    browser.evaluate("osteoflow.region.shapes.push({ shape: { shape: 'box', min: [-9999, -9999, -9999], max: [9999, 9999, 9999] }, keeps: true })");
    assert_eq!(line(browser), alone("Press save and run below the scan, or draw more"));
    press(browser, "#region-close");
    now["verdict"] = verdict("doubtful", &[reason("start", "doubtful", "it started by shape alone", start)]);
    say(browser, &now);
    press(browser, "#next button");
    browser.wait_until("osteoflow.picking.mode === 'pairs'");
    assert_eq!(line(browser), alone("Click a place on the bone, then the same place on the scan: 0 of 3 pairs"));
    press(browser, "#pick-plan");
    assert_eq!(line(browser), alone("Set the points of the plan on the bone, then save the plan"));
    press(browser, "#pick-plan");
    assert_eq!(say(browser, &state), trusted);
    assert_eq!(browser.complaints(&served.page), Vec::<String>::new());
    assert!(served.interrupt().success());
    browser.wait_until("document.getElementById('next').dataset.step === 'closed'");
    assert_eq!(line(browser), alone("The command has ended: start it again, and open the address that it prints"));

    // A recording, which is shown at its end first.
    let run = shared_run("graphs/fibula.toml", &[]).dir.path();
    let served = Served::start(&["view", run.to_str().unwrap(), "--picks", &picks]);
    open(browser, &served.page, "osteoflow.verdict !== null && osteoflow.scene.drawn.has('bone.mesh')");
    assert_eq!(line(browser), trusted);
    browser.evaluate("(() => { const time = document.getElementById('time'); time.value = '0'; time.onchange(); })()");
    browser.wait_until("osteoflow.verdict === null");
    assert_eq!(line(browser), with("Press Play, or drag the time to its end, for the verdict", "Play"));
    press(browser, "#next button");
    browser.wait_until("document.getElementById('play').textContent === 'pause'");
    assert_eq!(line(browser), alone("Wait for the end of the recording: the verdict comes there"));
    // What cannot be done on the page of a recording has no button.
    let mut old = browser.evaluate("osteoflow.state");
    browser.evaluate("document.getElementById('speed').value = '20'; document.getElementById('speed').onchange();");
    browser.wait_until("osteoflow.verdict !== null");
    old["verdict"] = verdict("refused", &[reason("on_surface", "refused", surroundings, CROP)]);
    let again = "Crop the scan to the bone, and register it again: skin or drape is in it";
    assert_eq!(say(browser, &old), alone(again));
    old["problem"] = "the recording is damaged: it ends in a chunk".into();
    let damaged = "Look at what is left of the recording; osteoflow recover FILE NEW saves it";
    assert_eq!(say(browser, &old), with(damaged, "Play"));
    assert_eq!(browser.complaints(&served.page), Vec::<String>::new());
}

/// Presses a key as a hand does.
fn strike(browser: &mut Browser, key: &str, code: u32, text: &str) {
    for kind in ["keyDown", "keyUp"] {
        let mut event = json!({ "type": kind, "key": key, "code": key, "windowsVirtualKeyCode": code });
        if kind == "keyDown" && !text.is_empty() {
            event["text"] = text.into();
        }
        browser.call("Input.dispatchKeyEvent", event);
    }
    browser.evaluate(FRAMES);
}

/// Tabs until an element has the focus.
fn tab_to(browser: &mut Browser, selector: &str) {
    for _ in 0..60 {
        strike(browser, "Tab", 9, "");
        if browser.evaluate(&format!("document.activeElement === document.querySelector({selector:?})")) == true {
            return;
        }
    }
    panic!("the keyboard does not come to {selector}");
}

/// The reasons that a scan with surroundings gets, again and again.
fn reasons(n: usize) -> Vec<Value> {
    static REAL: OnceLock<Vec<Value>> = OnceLock::new();
    let real = REAL.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name).display().to_string();
        simulate_wound(folder.path());
        let mut register = osteoflow();
        let ran = register.args(["register", &at("bone.stl"), &at("scan.ply"), "--format", "json"]).output().unwrap();
        let results: Value = serde_json::from_slice(&ran.stdout).unwrap();
        let real = results["verdict"]["reasons"].as_array().unwrap().clone();
        assert!(real.len() > 3, "{real:?}");
        real
    });
    let doubt = |k: usize| {
        let mut reason = real[k % real.len()].clone();
        reason["answer"] = "doubtful".into();
        reason
    };
    (0..n).map(doubt).collect()
}

/// A scan with skin and drape in it, and the bone, as the first week makes them.
pub(crate) fn simulate_wound(folder: &Path) {
    let mut simulate = osteoflow();
    simulate.args([
        "simulate",
        "--seed",
        "42",
        "--points",
        "10000",
        "--set",
        "camera.surroundings=true",
        "--as",
        "folder",
        "--force",
        "--out",
    ]);
    simulate.arg(folder).assert().success();
}

#[test]
fn one_to_twelve_reasons_are_read_whole_at_390_1000_and_1440_pixels_by_mouse_and_keyboard() {
    let Some(mut browser) = Browser::start("one_to_twelve_reasons_are_read_whole") else { return };
    let browser = &mut browser;
    browser.call("Page.addScriptToEvaluateOnNewDocument", json!({ "source": include_str!("viewer_next.js") }));
    let run = shared_run("graphs/fibula.toml", &[]).dir.path();
    let served = Served::start(&["view", run.to_str().unwrap()]);
    resize(browser, 1000);
    open(
        browser,
        &served.page,
        "osteoflow.verdict !== null && osteoflow.scene.drawn.get('planes.planes')?.object.visible",
    );
    let state = browser.evaluate("osteoflow.state");
    let faults =
        |browser: &mut Browser| -> Vec<String> { serde_json::from_value(browser.evaluate("stream.faults()")).unwrap() };
    let mut all = Vec::new();
    for n in [1, 2, 5, 12] {
        let mut now = state.clone();
        now["verdict"] = verdict("doubtful", &reasons(n));
        browser.evaluate(&format!("stream.say({now})"));
        for width in WIDTHS {
            resize(browser, width);
            let what = format!("{n} reasons at {width} pixels");
            let said = text(browser, "verdict");
            let first = "surroundings such as skin or drape are in the scan, of which a tenth lies more than 5 mm from the surface";
            assert_eq!(said, format!("doubtful {first}"), "{what}: the first clause of the first reason");
            let label = if n == 1 { "what to do".to_owned() } else { format!("all {n} reasons") };
            assert_eq!(text(browser, "why"), label);
            all.extend(faults(browser).iter().map(|fault| format!("{what}: {fault}")));
            browser.screenshot(&format!("reasons-{n}-{width}-closed"));
            // By keys: to the button, open, into the list, and through it to its end.
            browser.evaluate("(() => { const verdict = document.getElementById('verdict'); verdict.tabIndex = -1; verdict.focus(); verdict.removeAttribute('tabindex'); window.scrollTo(0, 0); })()");
            tab_to(browser, "#why");
            strike(browser, "Enter", 13, "\r");
            assert_eq!(
                browser.evaluate("document.getElementById('why').getAttribute('aria-expanded')"),
                "true",
                "{what}"
            );
            assert_eq!(browser.evaluate("document.querySelectorAll('#reasons li').length"), n, "{what}");
            all.extend(faults(browser).iter().map(|fault| format!("{what}, open: {fault}")));
            browser.screenshot(&format!("reasons-{n}-{width}-open"));
            tab_to(browser, "#reasons ol");
            strike(browser, "End", 35, "");
            browser.wait_until(
                "(() => { const last = document.querySelector('#reasons li:last-child').getBoundingClientRect(); const list = document.querySelector('#reasons ol').getBoundingClientRect(); \
                 return last.bottom <= list.bottom + 1; })()",
            );
            browser.evaluate("document.querySelector('#reasons ol').scrollTop = 0; window.scrollTo(0, 0)");
            press(browser, "#why");
            assert_eq!(browser.evaluate("document.getElementById('reasons').hidden"), true, "{what}");
        }
    }
    assert!(all.is_empty(), "{} faults:\n{}", all.len(), all.join("\n"));

    // What would hide a text is found.
    press(browser, "#why");
    for (width, rule) in [
        (1000, "#reasons ol { overflow: hidden !important }"),
        (1440, "#reasons ol { max-height: 100px !important }"),
        (390, "#reasons ol { max-height: 60px !important; overflow: hidden !important }"),
        (1000, "#reasons p { display: none }"),
        (390, ".verdict div { height: 1.5em; overflow: hidden }"),
        (1000, ".verdict { white-space: nowrap; overflow: hidden }"),
        (390, "#next p { white-space: nowrap }"),
        (1440, "#next { position: absolute; top: 0 }"),
        (1000, "#reasons { max-height: 20px }"),
        (390, "header { height: 40px }"),
    ] {
        resize(browser, width);
        assert_eq!(faults(browser), Vec::<String>::new(), "{width} pixels");
        browser.evaluate(&format!(
            "document.styleSheets[0].insertRule({rule:?}, document.styleSheets[0].cssRules.length)"
        ));
        browser.evaluate(FRAMES);
        let found = faults(browser);
        println!("{rule}: {found:?}");
        assert!(!found.is_empty(), "{width} pixels: nothing is noticed of {rule}");
        browser.evaluate("document.styleSheets[0].deleteRule(document.styleSheets[0].cssRules.length - 1)");
        browser.evaluate(FRAMES);
    }
    assert_eq!(browser.complaints(&served.page), Vec::<String>::new());
}
