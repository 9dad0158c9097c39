//! The page of a run and of a sweep in a browser.

use crate::common::browser::Browser;
use crate::common::{copied_run, copy_folder, osteoflow, reproduce, run_whole, shared_folder, skips_slow};
use osteoflow_formats::write::write_stl;
use osteoflow_geometry::Mesh;
use osteoflow_simulation::{BoneParams, bone};
use serde_json::{Value, json};
use std::{
    collections::BTreeSet,
    fs,
    path::{Path, PathBuf},
    sync::LazyLock,
};

/// Writes the report of a folder.
fn report(dir: &Path) -> std::path::PathBuf {
    osteoflow().arg("report").arg(dir).assert().success();
    dir.join("report.html")
}

/// Checks of every page: no errors, nothing fetched, every drawing has a size and its disclaimer.
fn check_page(browser: &mut Browser, page: &Path, n_drawings: usize) {
    browser.open(page);
    let sizes = browser.evaluate("[...document.querySelectorAll('.drawing svg')].map((s) => [s.getBoundingClientRect().width, s.getBoundingClientRect().height])");
    let sizes = sizes.as_array().unwrap();
    assert!(sizes.len() >= n_drawings, "{} drawings, at least {n_drawings} expected", sizes.len());
    for size in sizes {
        assert!(size[0].as_f64().unwrap() > 300.0 && size[1].as_f64().unwrap() > 150.0, "a drawing of {size} pixels");
    }
    let words = "[...document.querySelectorAll('figure, table')].every((f) => /SIMULATED/.test(f.textContent) && /research use only/.test(f.textContent))";
    assert_eq!(browser.evaluate(words), true, "every figure and table says what it is");
    assert_eq!(browser.complaints(&format!("file://{}", page.display())), Vec::<String>::new());
    if let Some(to) = std::env::var_os("REPORT_SCREENSHOTS") {
        screenshot(browser, &Path::new(&to).join(page.parent().unwrap().file_name().unwrap()));
    }
}

/// Printed on A4, every cell of every table is within its page, and the pages have the two sizes that this presumes.
fn check_print(browser: &mut Browser, page: &Path) {
    browser.open(page);
    browser.call("Emulation.setEmulatedMedia", json!({ "media": "print" }));
    let mut n_boxes = 0;
    // As they are, and of more columns than any of ours.
    let widen = "for (const table of document.querySelectorAll('table')) for (const row of table.rows) for (let k = row.cells.length; k < 30; k++) \
                 row.append(row.cells[k % row.cells.length].cloneNode(true))";
    for change in ["", widen] {
        browser.evaluate(change);
        for (of, width_mm) in [("auto", 210.0), ("landscape", 297.0)] {
            let width = ((width_mm - 2.0 * 12.0) / 25.4 * 96.0_f64).floor();
            let metrics = json!({ "width": width, "height": 700, "deviceScaleFactor": 1, "mobile": false });
            browser.call("Emulation.setDeviceMetricsOverride", metrics);
            let boxes = browser.evaluate(&format!(
                "[...document.querySelectorAll('.wide')].filter((box) => getComputedStyle(box).page === '{of}').map((box) => {{ \
                 const beyond = [box, ...box.querySelectorAll('table, caption, th, td')].filter((part) => !part.checkVisibility() || \
                 part.getBoundingClientRect().width === 0 || part.getBoundingClientRect().right > {width} + 0.5 || \
                 part.scrollWidth > Math.ceil(part.getBoundingClientRect().width) + 1); \
                 return [box.querySelectorAll('th').length, beyond.map((part) => part.textContent.slice(0, 60))]; }})"
            ));
            for of_box in boxes.as_array().unwrap() {
                let n_columns = of_box[0].as_u64().unwrap();
                assert_eq!(of_box[1], json!([]), "beyond a page of {width} pixels, of a table of {n_columns} columns");
                assert_eq!(n_columns >= 10, of == "landscape", "{n_columns} columns on a page of {width} pixels");
                n_boxes += 1;
            }
        }
    }
    let n_tables = browser.evaluate("document.querySelectorAll('table').length").as_u64().unwrap();
    assert_eq!(n_boxes, 2 * n_tables, "each table is on one of these pages");
    browser.open(page);
    let printed = browser.call("Page.printToPDF", json!({ "preferCSSPageSize": true }));
    let sizes = browser.evaluate(&format!(
        "[...new Set([...atob('{}').matchAll(/MediaBox ?\\[0 0 ([0-9.]+) ([0-9.]+)\\]/g)].map((of) => of.slice(1).map((side) => \
         Math.round(side * 25.4 / 72)).join(' ')))].sort()",
        printed["data"].as_str().unwrap()
    ));
    assert_eq!(sizes, json!(["210 297", "297 210"]), "A4, upright and across");
    browser.call("Emulation.setEmulatedMedia", json!({ "media": "" }));
    browser.call("Emulation.clearDeviceMetricsOverride", json!({}));
}

/// What a print shows, read from its PDF: no page is empty, every row of a table and every figure is whole and on one page, and
/// no text lies over another. `mutants` are rules of style with the fault that each makes.
///
/// Stored pictures would be those of one machine's fonts. Each print is compared with its own page instead, and its pictures, which
/// are made of the boxes of texts and shapes, with those of a print from a small window. On a finer screen letters have other
/// widths, as with other fonts: its lines break elsewhere, and the faults are looked for once more.
fn check_layout(browser: &mut Browser, page: &Path, mutants: &[(&str, &str)]) {
    let print = |browser: &mut Browser, rules: &str| {
        browser.open(page);
        let style = format!("<style>@media print {{ {rules} }}</style>");
        browser.evaluate(&format!("document.head.insertAdjacentHTML('beforeend', '{style}')"));
        let printed = browser.call("Page.printToPDF", json!({ "preferCSSPageSize": true }));
        let (script, pdf) = (include_str!("print_layout.js").trim_end(), printed["data"].as_str().unwrap());
        browser.evaluate(&format!("{script}('{pdf}')"))
    };
    let whole = print(browser, "");
    assert_eq!(whole["faults"], json!([]), "{}", page.display());
    let [again, finer] = [1, 2].map(|scale| {
        let small = json!({ "width": 400, "height": 700, "deviceScaleFactor": scale, "mobile": false });
        browser.call("Emulation.setDeviceMetricsOverride", small);
        print(browser, "")
    });
    browser.call("Emulation.clearDeviceMetricsOverride", json!({}));
    assert_eq!(finer["faults"], json!([]), "{} on a finer screen", page.display());
    let [whole, again] = [&whole, &again].map(|print| print["pictures"].as_array().unwrap());
    assert_eq!(whole.len(), again.len(), "pages of both prints");
    for (k, (whole, again)) in whole.iter().zip(again).enumerate() {
        let [whole, again] = [whole, again].map(|picture| picture.as_str().unwrap());
        assert!(whole == again, "page {}:\n{whole}\nfrom a small window:\n{again}", k + 1);
    }
    for (rules, fault) in mutants {
        let faults = print(browser, rules)["faults"].clone();
        let is_found = faults.as_array().unwrap().iter().any(|found| found.as_str().unwrap().contains(fault));
        assert!(is_found, "{rules} is not found: {faults}");
    }
}

/// The tables of all charts, by a reader of CSV that is not ours: what they hold is drawn where it belongs, and is in the results.
fn check_tables(test: &str, dir: &Path) {
    let script = crate::common::root().join("tests/python/check_figures.py");
    let Ok(output) = std::process::Command::new("python3").arg(script).arg(dir).output() else {
        return println!("skipped: {test}: no python3 to read the tables of the charts");
    };
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// The whole page as an image, for people.
fn screenshot(browser: &mut Browser, to: &Path) {
    let height = browser.evaluate("document.documentElement.scrollHeight").as_f64().unwrap();
    let metrics = json!({ "width": 1100, "height": height, "deviceScaleFactor": 1, "mobile": false });
    browser.call("Emulation.setDeviceMetricsOverride", metrics);
    std::thread::sleep(std::time::Duration::from_secs(1));
    let shot = browser.call("Page.captureScreenshot", json!({ "format": "png" }));
    fs::write(to.with_extension("png.base64"), shot["data"].as_str().unwrap()).unwrap();
    browser.call("Emulation.clearDeviceMetricsOverride", json!({}));
}

/// The pixels of a view: the number of those that are not empty, and a checksum.
fn pixels(browser: &mut Browser, view: usize) -> Value {
    browser.evaluate(&format!(
        "(() => {{ const c = document.querySelectorAll('.view')[{view}].querySelector('canvas'), gl = c.getContext('webgl2'); \
         const p = new Uint8Array(4 * c.width * c.height); gl.readPixels(0, 0, c.width, c.height, gl.RGBA, gl.UNSIGNED_BYTE, \
         p); let n = 0, h = 0; for (let k = 0; k < p.length; k += 4) if (p[k + 3]) {{ n++; h = (31 * h + 7 * k + p[k] + \
         256 * p[k + 1] + 65536 * p[k + 2]) >>> 0; }} return [n, h, c.width * c.height]; }})()"
    ))
}

#[test]
fn the_page_of_a_run_opens_offline_and_its_views_turn_under_the_mouse() {
    let (_dir, run) = copied_run("graphs/fibula.toml", &[]);
    let page = report(&run);
    assert!(fs::metadata(&page).unwrap().len() < 10_000_000, "a page that can be mailed");
    for file in ["graph", "convergence", "tre-measured", "view-residuals", "view-cuts", "view-fragment-aligned"] {
        assert!(run.join(format!("figures/{file}.svg")).is_file(), "{file} is missing");
    }
    let bibliography = fs::read_to_string(run.join("citations.bib")).unwrap();
    assert!(
        bibliography.contains("@article{chen1992") && !bibliography.contains("segal2009"),
        "what was used: {bibliography}"
    );
    let drawings = fs::read_dir(run.join("figures")).unwrap().map(|figure| figure.unwrap().path());
    for path in drawings.filter(|path| path.extension().is_some_and(|end| end == "svg")) {
        let text = fs::read_to_string(&path).unwrap();
        roxmltree::Document::parse(&text).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        assert!(!text.contains("NaN"), "{}", path.display());
    }
    check_tables("the_page_of_a_run_opens_offline_and_its_views_turn_under_the_mouse", &run);

    let Some(mut browser) = Browser::start("the_page_of_a_run_opens_offline_and_its_views_turn_under_the_mouse") else {
        return;
    };
    check_page(&mut browser, &page, 5);
    check_print(&mut browser, &page);
    let cut = ("figure { break-inside: auto !important }", "a figure is not on one page");
    check_layout(&mut browser, &page, &[cut]);
    browser.open(&page);
    let shown = browser.evaluate("[...document.querySelectorAll('.missing')].map((p) => p.textContent)");
    assert_eq!(shown, json!([]), "everything is recorded by the shipped graph");
    let n_views = browser.evaluate("document.querySelectorAll('.view').length").as_u64().unwrap() as usize;
    assert_eq!(n_views, 5, "residuals, points, cuts, the fragment in place and carried back");
    for view in 0..n_views {
        let select = format!("document.querySelectorAll('.view')[{view}].querySelector('canvas')");
        browser.evaluate(&format!("document.querySelectorAll('.view')[{view}].scrollIntoView({{ block: 'center' }})"));
        browser.wait_until(&format!("{select}?.width > 300 && {select}?.getContext('webgl2') != null"));
        browser.evaluate("new Promise((done) => setTimeout(done, 100))");
        let before = pixels(&mut browser, view);
        let filled = before[0].as_f64().unwrap() / before[2].as_f64().unwrap();
        assert!(filled > 0.02, "view {view} is blank: {before}");
        let at = browser.evaluate(&format!("(() => {{ const r = {select}.getBoundingClientRect(); return [r.left + r.width / 2, r.top + r.height / 2]; }})()"));
        let at = [0, 1].map(|k| at[k].as_f64().unwrap());
        browser.drag(at, [at[0] + 80.0, at[1] + 60.0]);
        let turned = pixels(&mut browser, view);
        assert!(
            turned[0].as_u64().unwrap() > 1000 && turned[1] != before[1],
            "view {view} does not turn: {before} {turned}"
        );
        browser.evaluate(&format!("{select}.dispatchEvent(new MouseEvent('dblclick'))"));
        browser.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))");
        assert_eq!(pixels(&mut browser, view), before, "view {view} comes back");
    }
    assert_eq!(browser.complaints(&format!("file://{}", page.display())), Vec::<String>::new());
}

#[test]
fn a_run_that_gives_other_results_when_repeated_is_not_drawn() {
    let dir = tempfile::tempdir().unwrap();
    let out = swept(dir.path());
    let is_run = |entry: &std::io::Result<fs::DirEntry>| entry.as_ref().is_ok_and(|entry| entry.path().is_file());
    for run in fs::read_dir(out.join("runs")).unwrap().filter(is_run) {
        let path = run.unwrap().path();
        let mut run = crate::common::json(&path);
        run["results"]["icp"]["iterations"] = 1.into();
        fs::write(path, run.to_string()).unwrap();
    }
    let html = fs::read_to_string(report(&out)).unwrap().replace("<wbr>", "");
    assert!(html.contains("the repeated run of the frozen graph gives other results"));
    assert!(!html.contains("data-scene"), "no fragment is drawn");
}

#[test]
fn a_wire_that_was_not_recorded_is_named_with_what_to_record() {
    let small = ["--set", "recording.camera.n_points=5000", "--set", "bone.exact=true"];
    let few = [&small[..], &["--set", "record.wires=[\"icp.report\"]"]].concat();
    let ran = run_whole("graphs/fibula.toml", &few);
    let html = fs::read_to_string(report(ran.dir.path())).unwrap().replace("<wbr>", "");
    let printed = "the wire to_bone.cloud was not recorded; add &quot;to_bone.cloud&quot; to wires in [record]";
    assert!(html.contains(printed), "{printed}");
    assert!(html.contains("icp.trace was not recorded"));
    let (_dir, bare) = copied_run("graphs/fibula.toml", &["--no-record"]);
    let html = fs::read_to_string(report(&bare)).unwrap().replace("<wbr>", "");
    assert!(html.contains("the run was not recorded") && html.contains("Results"));
}

#[test]
fn a_folder_of_neither_a_run_nor_a_sweep_is_a_fault_of_the_command_line() {
    let dir = tempfile::tempdir().unwrap();
    let printed = osteoflow().arg("report").arg(dir.path()).assert().code(2);
    let printed = String::from_utf8_lossy(&printed.get_output().stderr).into_owned();
    assert!(printed.contains("manifest.json") && printed.contains("sweep.json"), "{printed}");
}

/// A small sweep, made once, and copied into the folder `swept` of this one.
fn swept(dir: &Path) -> PathBuf {
    static SWEPT: LazyLock<PathBuf> = LazyLock::new(|| sweep(shared_folder()));
    let out = dir.join("swept");
    copy_folder(&SWEPT, &out);
    out
}

fn sweep(dir: &Path) -> PathBuf {
    let graph = dir.join("sweep.toml");
    let shipped = crate::common::root().join("graphs/fibula.toml");
    let text = format!(
        r#"
        extends = "{}"
        [node.recording]
        camera.n_points = 5000
        [node.bone]
        exact = true
        [sweep]
        repeat = 4
        same_seed = true
        units = ["bone", "procedure"]
        [sweep.factor]
        bone = {{ keys = ["recording.bone.shape_seed", "plan.bone.shape_seed", "bone.bone.shape_seed"], values = [1] }}
        icp = {{ key = "icp.kind", values = ["icp.point_to_point", "icp.point_to_plane"] }}
        [sweep.draw]
        gate_mm = {{ key = "icp.max_pair_distance_mm", uniform = [4.0, 6.0] }}
        [sweep.columns]
        tre_z_mm = "metrics.tre_true_mm.mean_signed.z"
        converged = "icp.converged"
        [sweep.points]
        tre_true_mm = {{ from = "metrics.tre_true_mm.points" }}
        "#,
        shipped.display()
    );
    fs::write(&graph, text).unwrap();
    let out = dir.join("swept");
    osteoflow().arg("sweep").arg(&graph).arg("--out").arg(&out).assert().success();
    out
}

#[test]
fn the_methods_of_a_sweep_name_the_kinds_that_its_runs_ran() {
    let dir = tempfile::tempdir().unwrap();
    let graph = dir.path().join("sweep.toml");
    let shipped = crate::common::root().join("graphs/fibula.toml");
    let text = format!(
        r#"
        extends = "{}"
        [node.icp]
        kind = "icp.point_to_point"
        [sweep]
        repeat = 1
        [sweep.factor.registration]
        values = [
            {{ icp.kind = "icp.symmetric" }},
            {{ icp.kind = "icp.generalized", icp.max_pair_distance_mm = 4.5 }},
        ]
        labels = ["s", "g"]
        "#,
        shipped.display()
    );
    fs::write(&graph, text).unwrap();
    let out = dir.path().join("swept");
    osteoflow().arg("sweep").arg(&graph).arg("--out").arg(&out).assert().success();
    let html = fs::read_to_string(report(&out)).unwrap().replace("<wbr>", "");
    assert!(html.contains("Fine registration: icp.generalized, icp.symmetric."), "the kinds that ran");
    let in_the_graph = html.matches("kind = &quot;icp.point_to_point&quot;").count();
    assert_eq!(html.matches("icp.point_to_point").count(), in_the_graph, "no run had the kind of the base graph");
    assert!(html.contains("max_pair_distance_mm = 4.5"), "with the parameters that the factor sets");
    assert!(html.contains("segal2009") && !html.contains("besl1992"), "literature of what ran");
}

#[test]
fn the_page_of_a_sweep_shows_boxes_by_setting_and_a_scatter_of_what_was_drawn() {
    if skips_slow("the_page_of_a_sweep_shows_boxes_by_setting_and_a_scatter_of_what_was_drawn") {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let out = swept(dir.path());
    let page = report(&out);
    for file in ["column-tre_z_mm", "points-tre_true_mm", "scatter-tre_z_mm-gate_mm"] {
        assert!(out.join(format!("figures/{file}.svg")).is_file(), "{file} is missing");
    }
    let html = fs::read_to_string(&page).unwrap().replace("<wbr>", "");
    for word in ["8 runs", "gate_mm, uniform from 4 to 6", "bone &gt; procedure", "point_to_plane", "chen1992", "r = "]
    {
        assert!(html.contains(word), "{word} is missing");
    }
    let which = "by the size of tre_z_mm";
    assert!(html.contains(which) && html.contains("which has its greatest mean"), "maps say what they go by");
    let figures: Vec<_> = fs::read_dir(out.join("figures")).unwrap().map(|file| file.unwrap().path()).collect();
    let maps: Vec<_> = figures.iter().filter(|path| path.to_string_lossy().contains("view-fragment-")).collect();
    let range = |path: &&PathBuf| {
        let text = fs::read_to_string(path).unwrap();
        let (before, _) = text.split_once(" mm: executed fragment").unwrap();
        before.rsplit_once('+').unwrap().1.to_owned()
    };
    let ranges: BTreeSet<String> = maps.iter().map(range).collect();
    assert_eq!((maps.len(), ranges.len()), (4, 1), "all maps have one range: {ranges:?}");
    let graph = fs::read_to_string(out.join("figures/graph.svg")).unwrap();
    assert!(graph.contains("SIMULATED") && graph.contains("research use only"), "the graph says what it is");
    let scatter = fs::read_to_string(out.join("figures/scatter-tre_z_mm-gate_mm.svg")).unwrap();
    roxmltree::Document::parse(&scatter).unwrap();
    assert_eq!(scatter.matches("<g transform=\"translate(0 ").count(), 2, "a panel for each kind of ICP");
    check_tables("the_page_of_a_sweep_shows_boxes_by_setting_and_a_scatter_of_what_was_drawn", &out);
    let Some(mut browser) =
        Browser::start("the_page_of_a_sweep_shows_boxes_by_setting_and_a_scatter_of_what_was_drawn")
    else {
        return;
    };
    check_page(&mut browser, &page, 3);
    let maps = browser.evaluate("document.querySelectorAll('.view').length");
    assert_eq!(maps, 4, "two fragments, each in place and carried back");
}

/// The stderr of a command, and its exit code.
fn complaint(args: &[&str]) -> (String, i32) {
    let output = osteoflow().args(args).output().unwrap();
    (String::from_utf8(output.stderr).unwrap(), output.status.code().unwrap())
}

/// A tenth of the built-in bone, with a fitting anatomy.
fn short_bone(dir: &Path) -> (PathBuf, PathBuf) {
    let (whole, anatomy) = (bone::fibula(&BoneParams::default()), bone::anatomy(&BoneParams::default()));
    let tip = anatomy.malleolus_tip;
    let vertices: Vec<_> = whole.vertices().iter().map(|p| tip + (p - tip) * 0.1).collect();
    let (stl, plan) = (dir.join("short.stl"), dir.join("short.json"));
    write_stl(&stl, &Mesh::new("ct", whole.origin, vertices, whole.faces().to_vec()).unwrap()).unwrap();
    let own = json!({
        "malleolus_tip": tip.coords.as_slice(), "proximal": anatomy.proximal.as_slice(),
        "lateral": anatomy.lateral.as_slice(), "posterior": anatomy.posterior.as_slice(),
    });
    fs::write(&plan, own.to_string()).unwrap();
    (stl, plan)
}

#[test]
fn a_bone_that_cannot_be_simulated_on_is_refused_before_any_sweep_in_the_words_of_simulate() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    let (bone, plan) = (at("own/bone.stl"), at("own/plan.json"));
    let own = at("own");
    let simulated = ["simulate", "--points", "1000", "--out", own.to_str().unwrap(), "--quiet"];
    assert_eq!(complaint(&simulated).1, 0);
    fs::write(at("broken.json"), "{ \"malleolus_tip\": [").unwrap();
    fs::write(at("another.json"), "{ \"another_bone\": {} }").unwrap();
    fs::write(at("text.stl"), "no surface").unwrap();
    let (short, short_plan) = short_bone(dir.path());
    let mut pairs = vec![
        (bone.clone(), at("broken.json")),
        (bone, at("another.json")),
        (at("text.stl"), plan),
        (short, short_plan),
    ];
    let name = "a_bone_that_cannot_be_simulated_on_is_refused_before_any_sweep_in_the_words_of_simulate";
    if let Some(jaw) = crate::common::data(name, "bones/myosim_jaw.stl") {
        let anatomy = jaw.with_file_name("anatomy.json");
        pairs.push((jaw, anatomy));
    }
    for (k, (bone, plan)) in pairs.iter().enumerate() {
        let out = at(&format!("reproduced-{k}"));
        let pair = ["--bone", bone.to_str().unwrap(), "--plan", plan.to_str().unwrap(), "--out"];
        let simulated = at(&format!("simulated-{k}"));
        let expected = complaint(&[&["simulate"], &pair[..], &[simulated.to_str().unwrap()]].concat());
        let args = [&["--quiet", "--only", "accuracy_camera"], &pair[..], &[out.to_str().unwrap()]].concat();
        let Some((_, err, code)) = reproduce(name, &args) else { return };
        let found = (err, code);
        assert_eq!(found, expected, "{} with {}", bone.display(), plan.display());
        assert!(found.1 != 0 && !out.exists(), "nothing is begun: {found:?}");
    }
}

#[test]
fn an_experiment_without_any_results_ends_as_refused_with_the_page_and_the_most_frequent_reason() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("out");
    // An outlier beside the region of interest would be a reason of its own: a point less.
    let sets = [
        "--set",
        "sweep.repeat=1",
        "--set",
        "icp.max_pair_distance_mm=1e-6",
        "--set",
        "recording.camera.edge_outliers=0.0",
    ];
    let name = "an_experiment_without_any_results_ends_as_refused_with_the_page_and_the_most_frequent_reason";
    let only = ["--quiet", "--only", "accuracy_camera", "--out", out.to_str().unwrap()];
    let Some((_, err, code)) = reproduce(name, &[&only[..], &sets[..]].concat()) else { return };
    assert_eq!(code, 3, "{err}");
    assert!(err.contains("accuracy_camera: none of its 3 runs has results; run 0: "), "{err}");
    let page = fs::read_to_string(out.join("paper-reproduction.md")).unwrap();
    let command = "`graphs/paper/reproduce.py --only accuracy_camera --set sweep.repeat=1 --set icp.max_pair_distance_mm=1e-6 \
                   --set recording.camera.edge_outliers=0.0`";
    assert!(page.contains(&format!("| accuracy_camera | {command} | 3 | 3 |")), "{page}");
    let reason = page.lines().find(|line| line.starts_with("- accuracy_camera: ")).unwrap();
    assert!(reason.ends_with("(3 runs)") && !reason.contains("node"), "{reason}");
    assert!(!page.contains("silhouette"), "{page}");
}

#[test]
fn a_row_without_a_number_of_ours_is_shown_and_listed_and_the_times_name_what_they_lack() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("out");
    let small = ["--set", "recording.camera.n_points=5000", "--set", "bone.exact=true"];
    let sets = ["--set", "sweep.repeat=2", "--set", "sweep.columns.tre_x_mm=\"metrics.tre_measured_mm.mean_abs.w\""];
    let name = "a_row_without_a_number_of_ours_is_shown_and_listed_and_the_times_name_what_they_lack";
    let only = ["--quiet", "--only", "accuracy_camera", "--out", out.to_str().unwrap()];
    let Some((_, err, code)) = reproduce(name, &[&only[..], &small[..], &sets[..]].concat()) else { return };
    assert_eq!(code, 3, "{err}");
    assert_eq!(err.matches("without a number: ").count(), 2, "of the paper and of the other implementation: {err}");
    let page = fs::read_to_string(out.join("paper-reproduction.md")).unwrap();
    let row = page.lines().find(|line| line.contains("registered by camera") && line.contains("axis x")).unwrap();
    assert!(row.contains("| 0.5 ± 0.1 | **none**: the sweep has no columns.tre_x_mm | 0 | - |"), "{row}");
    let time = page.lines().find(|line| line.contains("time of a calibration | 40 s | ")).unwrap();
    let share = time.split(" | ").nth(4).and_then(|share| share.strip_suffix(" %")).map(str::parse::<f64>);
    assert!(share.is_some_and(|share| share.is_ok_and(|share| share > 0.0)), "{time}");
    assert!(!page.contains("time of a procedure with the stylus"), "{time}");
}

/// Two bones with a few procedures each, of which some are refused: their gate lets no pair through.
const REFUSING: &str = r#"
extends = "GRAPH"
[node.recording]
camera.n_points = 4000
[node.bone]
exact = true
[sweep]
repeat = 4
units = ["bone", "procedure"]
[sweep.factor]
bone = { keys = ["recording.bone.shape_seed", "plan.bone.shape_seed", "bone.bone.shape_seed"], values = [1, 2] }
icp = { key = "icp.kind", values = ["icp.point_to_point", "icp.point_to_plane"] }
[sweep.draw]
gate_mm = { key = "icp.max_pair_distance_mm", choice = [8.0, 8.5, 1e-6] }
[sweep.columns]
tre_mm = "metrics.tre_true_mm.mean_abs.norm"
[sweep.points]
tre_true_mm = { from = "metrics.tre_true_mm.points" }
[sweep.compare]
factor = "icp"
margin = { tre_mm = 1.0 }
"#;

/// The cells of the table whose caption contains these words, heads first.
fn table(browser: &mut Browser, words: &str) -> Vec<Vec<String>> {
    let cells = browser.evaluate(&format!(
        "[...[...document.querySelectorAll('table')].find((t) => t.caption.textContent.includes('{words}')).rows].map((r) => \
         [...r.cells].map((c) => c.textContent.replaceAll('\\u00a0', ' ')))"
    ));
    serde_json::from_value(cells).unwrap_or_else(|e| panic!("no table of {words}: {e}"))
}

/// The cell under a head in a row.
fn under<'a>(table: &'a [Vec<String>], head: &str, row: usize) -> &'a str {
    let at = table[0].iter().position(|of| of == head).unwrap_or_else(|| panic!("no {head} in {:?}", table[0]));
    &table[row][at]
}

#[test]
fn the_tables_of_a_sweep_have_the_units_of_each_column_the_sd_within_them_and_readable_comparisons() {
    if skips_slow("the_tables_of_a_sweep_have_the_units_of_each_column_the_sd_within_them_and_readable_comparisons") {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let graph = dir.path().join("refusing.toml");
    fs::write(&graph, REFUSING.replace("GRAPH", crate::common::root().join("graphs/fibula.toml").to_str().unwrap()))
        .unwrap();
    let out = dir.path().join("swept");
    osteoflow().arg("sweep").arg(&graph).arg("--out").arg(&out).assert().success();
    let rows = fs::read_to_string(out.join("runs.csv")).unwrap();
    let n_complete = rows.lines().filter(|row| row.contains("point_to_point") && row.contains(",complete,")).count();
    assert!((4..8).contains(&n_complete), "some of 8 procedures are refused, on either bone the same:\n{rows}");
    let summary = crate::common::json(&out.join("summary.json"));
    let page = report(&out);
    let Some(mut browser) = Browser::start(
        "the_tables_of_a_sweep_have_the_units_of_each_column_the_sd_within_them_and_readable_comparisons",
    ) else {
        return;
    };
    check_page(&mut browser, &page, 2);

    let columns = table(&mut browser, "tre (mm) by column");
    let of = format!("2 bones, {n_complete} procedures; {} runs without results", 8 - n_complete);
    assert_eq!([under(&columns, "n", 1), under(&columns, "of", 1)], [&n_complete.to_string(), of.as_str()]);
    let interval = under(&columns, "95 % interval of the mean", 1);
    assert!(interval.contains(" to ") && interval.ends_with("(few: 2 bones)"), "{interval}");
    let about = browser.evaluate("document.body.textContent.includes('fewer than 5 units is too narrow')");
    assert_eq!(about, true, "what few means is printed");

    let points = table(&mut browser, "tre true (mm) at the points");
    assert_eq!(points.iter().map(|row| row[1].as_str()).collect::<Vec<_>>()[..4], ["axis", "x", "y", "z"]);
    let z = &summary["groups"][0]["points"]["tre_true_mm"]["z"];
    for (head, groups) in [("SD within points", "within_points"), ("SD within procedures", "within_procedures")] {
        let shown: f64 = under(&points, head, 3).parse().unwrap();
        let computed = z[groups]["sd_within"].as_f64().unwrap();
        assert!((shown - computed).abs() <= 5.1e-4, "{head}: {shown} shown, {computed} mm computed");
    }
    assert!(under(&points, "of", 1).contains(&format!("{n_complete} procedures, {} points", 5 * n_complete)));

    let compared = table(&mut browser, "Second against first");
    let heads = [
        "column",
        "first",
        "second",
        "n",
        "unit",
        "mean of first",
        "mean of second",
        "difference",
        "95 % interval of the difference",
        "95 % limits of agreement",
        "p",
        "p (Holm)",
        "effect",
        "equivalent",
        "remark",
    ];
    assert_eq!(compared[0], heads, "what can be read, and nothing for programs");
    assert_eq!(under(&compared, "n", 1), n_complete.to_string());
    assert!(under(&compared, "remark", 1).contains("within 2 bones"), "{compared:?}");
}

/// A source that reads a file, and a node with literature.
#[cfg(unix)]
const PLUGIN: &str = r#"
from dataclasses import dataclass

import numpy as np
from osteoflow_node import Cloud, node, param, payload, source


@payload("mine/Number")
class Number:
    """A number."""

    number: float


@dataclass
class Params:
    path: str = param(path=True, doc="A file of numbers.")


@source("mine.numbers", output="cloud")
def numbers(params: Params) -> Cloud:
    """One cloud from a file."""
    yield 0, Cloud("camera", np.loadtxt(params.path).reshape(-1, 3))


@node("mine.mean", output="number", literature=["Nobody 1999"])
def mean(cloud: Cloud) -> Number:
    """The mean of all coordinates, as of old."""
    if len(cloud) > 1:
        raise ValueError(f"{__file__} takes one point")
    return Number(float(cloud.points.mean()))
"#;

#[cfg(unix)]
#[test]
fn a_report_names_no_folder_and_knows_the_kinds_of_the_plugins_that_the_user_names() {
    use crate::common::python::Folder;
    let Some(folder) = Folder::new("a report with kinds of a plugin", &[("my.py", PLUGIN)]) else { return };
    let secret = folder.0.path().to_str().unwrap().to_owned();
    folder.write("one.txt", "1 2 3\n");
    folder.write("two.txt", "1 2 3 4 5 6\n");
    let graph = format!(
        "plugins = [\"{secret}/my.py\"]\n[graph]\nformat = 1\nname = \"mine\"\n[node.numbers]\nkind = \"mine.numbers\"\n\
         path = \"{secret}/one.txt\"\n[node.mean]\nkind = \"mine.mean\"\nin = {{ cloud = \"numbers.cloud\" }}\n\
         [results]\nmean = \"mean.number\"\n[sweep.factor]\n\
         file = {{ key = \"numbers.path\", values = [\"{secret}/one.txt\", \"{secret}/two.txt\"] }}\n[sweep.columns]\nmean = \"mean.number\"\n"
    );
    folder.write("g.toml", &graph);
    let at = |name: &str| folder.path(name).display().to_string();
    let says = |arguments: &[&str]| {
        let mut command = osteoflow();
        let output = command.env("OSTEOFLOW_PYTHON", &folder.1).args(arguments).output().unwrap();
        let text = String::from_utf8_lossy(&[output.stdout, output.stderr].concat()).into_owned();
        (output.status.code(), text)
    };
    for (command, out) in [("run", "r"), ("sweep", "s")] {
        let (code, text) = says(&[command, &at("g.toml"), "--out", &at(out)]);
        assert_eq!(code, Some(0), "{text}");
        for (plugin, has_kinds) in [(None, false), (Some(at("my.py")), true)] {
            let (dir, mut arguments) = (at(out), vec!["report"]);
            arguments.push(&dir);
            arguments.extend(plugin.iter().flat_map(|plugin| ["--plugin", plugin.as_str()]));
            let (code, text) = says(&arguments);
            assert_eq!(code, Some(0), "{text}");
            // Where a word of a table may be wrapped, a path is a path.
            let page = fs::read_to_string(folder.path(&format!("{out}/report.html"))).unwrap().replace("<wbr>", "");
            let near = page.find(&secret).map(|at| page[at.saturating_sub(200)..at + 100].to_owned());
            assert_eq!(near, None, "{command}");
            assert!(page.contains("one.txt") && page.contains("my.py") && page.contains("g.toml"), "{command}");
            assert_eq!(page.contains("The mean of all coordinates, as of old"), has_kinds, "{command}");
            assert_eq!(page.contains("Nobody 1999 (named by mine.mean)"), has_kinds, "{command}");
        }
        let (code, text) = says(&["report", &at(out), "--plugin", &at("your.py")]);
        assert!(code == Some(2) && text.contains("your.py"), "{code:?} {text}");
    }
    // The reason of the run that failed names the file of the plugin, by its name alone.
    let page = fs::read_to_string(folder.path("s/report.html")).unwrap().replace("<wbr>", "");
    assert!(page.contains("my.py takes one point"), "the reason is shown");
}

#[test]
fn the_page_of_a_sweep_begins_with_its_statistics_and_nothing_runs_out_of_its_box_at_1440_pixels() {
    let dir = tempfile::tempdir().unwrap();
    // Three factors with long names, a comparison with all of its columns, and an angle.
    let graph = dir.path().join("wide.toml");
    let shipped = crate::common::root().join("graphs/fibula.toml");
    let text = format!(
        "extends = \"{}\"\n[node.recording]\ncamera.n_points = 3000\n[node.bone]\nexact = true\n[sweep]\nunits = [\"bone\", \"procedure\"]\n\
         limit = {{ tre_mm = 1.0 }}\ncompare = {{ factor = \"registration\", to = \"icp.point_to_plane\", margin = {{ tre_mm = 0.5, tilt_rad = 0.01 }} }}\n\
         [sweep.factor]\nbone = {{ keys = [\"recording.bone.shape_seed\", \"plan.bone.shape_seed\", \"bone.bone.shape_seed\"], values = [1, 2] }}\n\
         registration = {{ key = \"icp.kind\", values = [\"icp.point_to_plane\", \"icp.point_to_point\"] }}\n\
         depth_noise_mm = {{ key = \"recording.camera.depth_noise_mm\", values = [0.05, 0.2] }}\n\
         [sweep.columns]\ntre_mm = \"metrics.tre_true_mm.mean_abs.norm\"\ntilt_rad = \"metrics.cuts.cuts.plane_1.tilt_rad\"\n\
         stopped = \"icp.stop_reason\"\n\
         [sweep.points]\ntre_true_mm = {{ from = \"metrics.tre_true_mm.points\" }}\n",
        shipped.display()
    );
    fs::write(&graph, text).unwrap();
    let out = dir.path().join("wide");
    osteoflow().arg("sweep").arg(&graph).arg("--out").arg(&out).assert().success();
    let page = report(&out);
    let html = fs::read_to_string(&page).unwrap().replace("<wbr>", "");
    let at = |word: &str| html.find(word).unwrap_or_else(|| panic!("no {word}"));
    let first = [
        "<h2 id=\"statistics\">",
        "p (Holm)",
        "<h2 id=\"design\">",
        "<h2 id=\"figures\">",
        "<h2 id=\"the-graph-as-run\">",
    ];
    let places = first.map(at);
    assert!(places.is_sorted(), "{first:?} are at {places:?}");
    assert!(html.contains("tilt (\u{b0})") && !html.contains("tilt (rad)"), "angles are degrees");
    assert!(html.contains("latest table, by the time of summary.json"), "it has its dates");
    assert!(html.contains("along x (blue), y (orange), z (green)"), "a caption names the colours that are drawn");
    let test = "the_page_of_a_sweep_begins_with_its_statistics_and_nothing_runs_out_of_its_box_at_1440_pixels";
    check_tables(test, &out);
    let Some(mut browser) = Browser::start(test) else { return };
    browser.open(&page);
    browser.call(
        "Emulation.setDeviceMetricsOverride",
        json!({ "width": 1440, "height": 900, "deviceScaleFactor": 1, "mobile": false }),
    );
    let hidden = browser.evaluate("[...document.querySelectorAll('.wide')].filter((box) => box.scrollWidth > box.clientWidth + 1).map((box) => box.textContent.slice(0, 60))");
    assert_eq!(hidden, json!([]), "tables that must be scrolled");
    let cut = browser.evaluate(
        "[...document.querySelectorAll('.drawn-chart svg text')].filter((text) => { const t = text.getBoundingClientRect(), \
         s = text.closest('svg').getBoundingClientRect(); return t.left < s.left - 1 || t.right > s.right + 1 || t.bottom > s.bottom + 1; \
         }).map((text) => text.textContent)",
    );
    assert_eq!(cut, json!([]), "labels that run out of their drawing");
    // A narrow window: a table says that it is wider than its box exactly if it is.
    let metrics = json!({ "width": 800, "height": 900, "deviceScaleFactor": 1, "mobile": false });
    browser.call("Emulation.setDeviceMetricsOverride", metrics);
    browser.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))");
    let says = browser.evaluate(
        "[...document.querySelectorAll('.wide')].filter((box) => box.checkVisibility()).map((box) => [box.scrollWidth > box.clientWidth, \
         getComputedStyle(box, '::before').visibility === 'visible'])",
    );
    let says: Vec<[bool; 2]> = serde_json::from_value(says).unwrap();
    assert!(says.contains(&[true, true]) && says.contains(&[false, false]), "{says:?}");
    assert!(says.iter().all(|[scrolls, says]| scrolls == says), "{says:?}");
    check_print(&mut browser, &page);
    let mutants = [
        ("td:nth-child(4), th:nth-child(4) { display: none }", "a row is not on one page"),
        (".wide { overflow: hidden !important; max-width: 100mm }", "a row is not on one page"),
        (".wide table { margin-left: -5mm !important }", "a row is not on one page"),
        ("table { line-height: 0.6 !important }", " lies over "),
        ("figcaption { margin-top: -9mm }", " lies over "),
        ("main::after { content: \"\"; display: block; height: 20mm; break-before: page }", " is empty"),
    ];
    check_layout(&mut browser, &page, &mutants);
    assert!(out.join("figures/difference-1-tre_mm.svg").is_file(), "a figure of the differences");
    let words = table(&mut browser, "stopped: runs with each word");
    assert!(words.len() == 5 && words.iter().any(|row| row[2] == "2"), "two runs of each of four settings: {words:?}");
    let runs = fs::read_to_string(out.join("runs.csv")).unwrap();
    for (k, word) in words[0].iter().enumerate().skip(3) {
        let shown: usize = words[1..].iter().map(|row| row[k].parse::<usize>().unwrap()).sum();
        assert_eq!(shown, runs.lines().filter(|row| row.contains(&format!(",{word},"))).count(), "{word}: {words:?}");
    }
}
