//! The page in JupyterLab: `osteoflow.view` in a notebook, driven in a browser.
//!
//! Needs a Python with jupyterlab, anywidget and the package, named by OSTEOFLOW_JUPYTER.

use crate::common::{browser::Browser, program, root};
use serde_json::{Value, json};
use std::{
    fs,
    io::{BufRead, BufReader},
    path::PathBuf,
    process::{Child, Command, Stdio},
};

const TEST: &str = "the_page_is_in_a_notebook_of_jupyterlab";

/// A Python with what is needed; a message and `None` without one.
fn python() -> Option<PathBuf> {
    let skip = |why: &str| {
        eprintln!("skipped: {TEST}: {why}");
        None
    };
    let Some(python) = std::env::var_os("OSTEOFLOW_JUPYTER").map(PathBuf::from) else {
        return skip("OSTEOFLOW_JUPYTER names no Python with jupyterlab, anywidget and the package");
    };
    let import = Command::new(&python).args(["-c", "import jupyterlab, anywidget, osteoflow; osteoflow.view"]).output();
    match import {
        Ok(output) if output.status.success() => Some(python),
        Ok(output) => skip(&String::from_utf8_lossy(&output.stderr)),
        Err(error) => skip(&format!("{}: {error}", python.display())),
    }
}

/// JupyterLab, which ends with the test.
struct Lab(Child);

impl Drop for Lab {
    fn drop(&mut self) {
        // It ends its kernels, too.
        let _ = Command::new("kill").args(["-TERM", &self.0.id().to_string()]).status();
        let _ = self.0.wait();
    }
}

#[test]
fn the_page_is_in_a_notebook_of_jupyterlab() {
    let Some(python) = python() else { return };
    let Some(mut browser) = Browser::start(TEST) else { return };
    let browser = &mut browser;
    let folder = tempfile::tempdir().unwrap();
    let data = |name: &str| root().join("tests/data/folder").join(name).display().to_string();
    let (run, picks) = (folder.path().join("run"), folder.path().join("picks"));
    // The program of the tests in place of the installed one, and a scan in memory.
    let source = format!(
        "import osteoflow, osteoflow._view as view\nview._COMMAND = [{:?}]\nscan = osteoflow.read({:?})\n\
         osteoflow.view({:?}, scan, out={:?}, picks={:?}, height=500)",
        program(),
        data("scan.ply"),
        data("bone.stl"),
        run,
        picks
    );
    let cell = json!({ "cell_type": "code", "execution_count": null, "id": "a", "metadata": {}, "outputs": [], "source": source });
    let kernel = json!({ "display_name": "Python 3", "language": "python", "name": "python3" });
    let notebook = json!({ "cells": [cell], "metadata": { "kernelspec": kernel }, "nbformat": 4, "nbformat_minor": 5 });
    fs::write(folder.path().join("shown.ipynb"), notebook.to_string()).unwrap();
    let mut lab = Command::new(&python);
    lab.args([
        "-m",
        "jupyterlab",
        "--no-browser",
        "--allow-root",
        "--ServerApp.port=0",
        "--IdentityProvider.token=seen",
    ]);
    lab.arg(format!("--ServerApp.root_dir={}", folder.path().display()));
    lab.env("JUPYTER_CONFIG_DIR", folder.path().join("config")).env("JUPYTER_DATA_DIR", folder.path().join("data"));
    let mut lab = Lab(lab.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap());
    let mut lines = BufReader::new(lab.0.stderr.take().unwrap()).lines().map_while(Result::ok);
    let address = lines.by_ref().find_map(|line| {
        let at = line.find("http://")?;
        Some(line[at..].split("/lab").next()?.trim().to_owned())
    });
    // The frame is then of the same site, and of the same process of the browser.
    let address = address.expect("JupyterLab says where it is").replace("localhost", "127.0.0.1");
    std::thread::spawn(move || lines.for_each(drop));

    browser.events.clear();
    let size = json!({ "width": 1300, "height": 900, "deviceScaleFactor": 1, "mobile": false });
    browser.call("Emulation.setDeviceMetricsOverride", size);
    browser.call("Page.navigate", json!({ "url": format!("{address}/lab/tree/shown.ipynb?token=seen") }));
    browser.wait_until("document.querySelector('.jp-Notebook .jp-CodeCell .cm-content') !== null && document.querySelector('.jp-Notebook-ExecutionIndicator[data-status=idle]') !== null");
    // As a person does it: by the button that runs a cell, which moves while the notebook is laid out.
    let button = "(() => { const box = document.querySelector('[data-command=\"notebook:run-cell-and-select-next\"]')?.getBoundingClientRect(); \
        return box && box.width > 0 ? [box.left + box.width / 2, box.top + box.height / 2] : null; })()";
    browser.wait_until(&format!("{button} !== null"));
    let mut place = Value::Null;
    loop {
        let now = browser.evaluate(button);
        if now == place && !now.is_null() {
            break;
        }
        place = now;
        std::thread::sleep(std::time::Duration::from_secs(1));
    }
    browser.click(serde_json::from_value(place).unwrap());
    browser.screenshot("notebook-0");
    browser.wait_until("document.querySelector('.jp-Notebook .jp-CodeCell .cm-content') !== null && document.querySelector('.jp-Notebook-ExecutionIndicator[data-status=idle]') !== null");
    // As a person does it: the cell, then Shift and Enter.
    let middle = browser.evaluate(
        "(() => { const box = document.querySelector('.jp-Notebook .jp-CodeCell .cm-content').getBoundingClientRect(); return [box.left + 30, box.top + 10]; })()",
    );
    browser.click(serde_json::from_value(middle).unwrap());
    for kind in ["rawKeyDown", "keyUp"] {
        let key = json!({ "type": kind, "key": "Enter", "code": "Enter", "windowsVirtualKeyCode": 13, "modifiers": 8 });
        browser.call("Input.dispatchKeyEvent", key);
    }
    browser
        .wait_until("document.querySelector('iframe[title=Osteoflow]')?.src.startsWith('http://127.0.0.1:') === true");
    let page = browser.evaluate("document.querySelector('iframe[title=Osteoflow]').src").as_str().unwrap().to_owned();
    browser.wait_in(
        &page,
        "typeof osteoflow === 'object' && osteoflow.state.state === 'complete' && osteoflow.scene.isLookedAt",
    );
    browser.wait_in(&page, "document.getElementById('verdict').className === 'verdict trusted' && osteoflow.scene.drawn.get('crop.cloud')?.object.visible === true");
    // The answer is that of the command.
    let results: Value = serde_json::from_slice(&fs::read(run.join("results.json")).unwrap()).unwrap();
    assert_eq!(results["verdict"]["answer"], "trusted");
    // A mouse in the notebook turns the bone in it.
    let eye = "osteoflow.scene.camera.position.toArray()";
    let before = browser.evaluate_in(&page, eye);
    let at = browser.evaluate(
        "(() => { const box = document.querySelector('iframe[title=Osteoflow]').getBoundingClientRect(); return [box.left + 0.25 * box.width, box.top + 0.6 * box.height]; })()",
    );
    let at: [f64; 2] = serde_json::from_value(at).unwrap();
    browser.drag(at, [at[0] + 90.0, at[1]]);
    assert_ne!(browser.evaluate_in(&page, eye), before);
    browser.screenshot("notebook");
    // No other page may show it: the frame is for the notebook's address alone.
    let host = page.strip_prefix("http://").unwrap().split('/').next().unwrap();
    let path = page.strip_prefix(&format!("http://{host}")).unwrap();
    let mut asked = std::net::TcpStream::connect(host).unwrap();
    let head = format!("GET {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n");
    std::io::Write::write_all(&mut asked, head.as_bytes()).unwrap();
    let policy = BufReader::new(asked)
        .lines()
        .map_while(Result::ok)
        .find(|line| line.starts_with("Content-Security-Policy"))
        .unwrap();
    assert!(policy.ends_with(&format!("frame-ancestors {address}")), "{policy}");
}
