//! A headless browser, controlled over its debugging pipe: no port, and no crate for it.

use serde_json::{Value, json};
use std::{
    io::{BufRead, BufReader, Write},
    path::Path,
    process::{Child, ChildStdin, Command, Stdio},
    sync::{
        Mutex,
        mpsc::{Receiver, sync_channel},
    },
    time::{Duration, Instant},
};

/// Timeout of every operation.
const PATIENCE: Duration = Duration::from_secs(60);

/// A browser with one page.
pub(crate) struct Browser {
    /// None once it is closed.
    process: Option<Process>,
    target: Value,
    session: String,
    /// Events that the page has sent.
    pub(crate) events: Vec<Value>,
}

/// The program, which serves one test after another: its start takes longer than many a test. It ends with the process of the tests.
struct Process {
    child: Child,
    to: ChildStdin,
    from: Receiver<Value>,
    /// Number of the next command.
    next: u64,
}

/// Browsers that no test uses at the moment.
static IDLE: Mutex<Vec<Process>> = Mutex::new(Vec::new());

/// The browser's program: OSTEOFLOW_BROWSER, or one in the path.
fn program() -> Option<String> {
    let asked = std::env::var("OSTEOFLOW_BROWSER").ok().filter(|program| !program.is_empty());
    let known = ["chromium", "chromium-browser", "google-chrome"].map(String::from);
    asked.into_iter().chain(known).find(|program| {
        let version = Command::new(program).arg("--version").stdout(Stdio::null()).stderr(Stdio::null()).status();
        version.is_ok_and(|status| status.success())
    })
}

impl Process {
    /// `None` if there is no browser.
    fn start() -> Option<Self> {
        let program = program()?;
        // Removed with what the tests share.
        let profile = tempfile::tempdir_in(super::shared_folder()).unwrap().keep();
        let mut command = Command::new("sh");
        // It reads commands from descriptor 3 and writes answers to 4.
        command.args(["-c", "exec \"$0\" \"$@\" 3<&0 4>&1 0</dev/null 1>/dev/null 2>/dev/null", &program]);
        command.args([
            "--headless=new",
            "--remote-debugging-pipe",
            "--no-sandbox",
            "--disable-gpu",
            "--window-size=1100,900",
        ]);
        // Views are drawn without a graphics card.
        command.args(["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]);
        command.args([
            "--disable-background-networking",
            "--disable-component-update",
            "--disable-sync",
            "--no-first-run",
        ]);
        command.arg(format!("--user-data-dir={}", profile.display())).arg("about:blank");
        let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
        let (to, out) = (child.stdin.take().unwrap(), child.stdout.take().unwrap());
        // Buffers the events of a page: more than any page of ours sends.
        let (tell, from) = sync_channel(1 << 16);
        std::thread::spawn(move || {
            let mut out = BufReader::new(out);
            let mut message = Vec::new();
            while out.read_until(0, &mut message).is_ok_and(|n| n > 0) {
                message.pop();
                if serde_json::from_slice(&message).is_ok_and(|value| tell.send(value).is_err()) {
                    return;
                }
                message.clear();
            }
        });
        Some(Self { child, to, from, next: 1 })
    }
}

impl Browser {
    /// Starts it with an empty page; prints a message and returns `None` if there is no browser.
    pub(crate) fn start(test: &str) -> Option<Self> {
        let mut browser = Self { process: None, target: Value::Null, session: String::new(), events: Vec::new() };
        // One that dies before it has a page, as on a machine short of memory, is started again.
        let mut said = Err(String::new());
        for _ in 0..3 {
            let idle = IDLE.lock().unwrap().pop();
            let Some(process) = idle.or_else(Process::start) else {
                eprintln!("skipped: {test}: no browser (chromium, or OSTEOFLOW_BROWSER)");
                return None;
            };
            browser.process = Some(process);
            said = browser.ask("Target.createTarget", &json!({ "url": "about:blank" }));
            if said.is_ok() {
                break;
            }
        }
        browser.target = said.unwrap_or_else(|message| panic!("{message}"))["targetId"].clone();
        let attached = browser.call("Target.attachToTarget", json!({ "targetId": browser.target, "flatten": true }));
        browser.session = attached["sessionId"].as_str().unwrap().to_owned();
        for domain in ["Page", "Runtime", "Log", "Network"] {
            browser.call(&format!("{domain}.enable"), json!({}));
        }
        Some(browser)
    }

    /// Saves a picture of the page in the folder `SCREENSHOTS`, if it is named, in base64.
    #[allow(dead_code, reason = "not all tests use it")]
    pub(crate) fn screenshot(&mut self, name: &str) {
        let Some(folder) = std::env::var_os("SCREENSHOTS") else { return };
        self.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))");
        let shot = self.call("Page.captureScreenshot", json!({ "format": "png" }));
        std::fs::write(Path::new(&folder).join(format!("{name}.b64")), shot["data"].as_str().unwrap()).unwrap();
    }

    /// Sends a command and waits for its answer.
    pub(crate) fn call(&mut self, method: &str, params: Value) -> Value {
        self.ask(method, &params).unwrap_or_else(|message| panic!("{message}"))
    }

    fn ask(&mut self, method: &str, params: &Value) -> Result<Value, String> {
        let silent = || format!("the browser did not answer {method} {params}");
        let process = self.process.as_mut().expect("it is open");
        let id = process.next;
        process.next += 1;
        let mut message = json!({ "id": id, "method": method, "params": params });
        if !self.session.is_empty() {
            message["sessionId"] = self.session.as_str().into();
        }
        process.to.write_all(format!("{message}\0").as_bytes()).map_err(|_| silent())?;
        process.to.flush().map_err(|_| silent())?;
        let until = Instant::now() + PATIENCE;
        loop {
            let message = process.from.recv_timeout(until.saturating_duration_since(Instant::now()));
            let message = message.map_err(|_| silent())?;
            match message["id"].as_u64() {
                Some(answer) if answer == id => {
                    assert!(message["error"].is_null(), "{method}: {}", message["error"]);
                    return Ok(message["result"].clone());
                }
                None if message["sessionId"] == self.session.as_str() => self.events.push(message),
                // Of another page, before.
                _ => {}
            }
        }
    }

    #[allow(dead_code, reason = "not all tests open files")]
    /// Opens a file and waits until it is loaded and drawn.
    pub(crate) fn open(&mut self, file: &Path) {
        self.events.clear();
        self.call("Page.navigate", json!({ "url": format!("file://{}", file.display()) }));
        self.wait_until("document.readyState === 'complete'");
        self.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))");
    }

    /// The value of an expression in the page.
    pub(crate) fn evaluate(&mut self, expression: &str) -> Value {
        let asked = json!({ "expression": expression, "awaitPromise": true, "returnByValue": true });
        let said = self.call("Runtime.evaluate", asked);
        assert!(said["exceptionDetails"].is_null(), "{expression}: {}", said["exceptionDetails"]);
        said["result"]["value"].clone()
    }

    #[allow(dead_code, reason = "not all tests have frames")]
    /// The value of an expression in the frame whose address begins with that of a page.
    pub(crate) fn evaluate_in(&mut self, page: &str, expression: &str) -> Value {
        // Earlier events have arrived before this answer.
        self.evaluate("1");
        let host = page.splitn(4, '/').take(3).collect::<Vec<_>>().join("/");
        let made = self.events.iter().rev().filter(|event| event["method"] == "Runtime.executionContextCreated");
        let mut of_page =
            made.map(|event| &event["params"]["context"]).filter(|context| context["origin"] == host.as_str());
        let Some(id) = of_page.next().map(|context| context["id"].clone()) else { return Value::Null };
        let asked = json!({ "expression": expression, "awaitPromise": true, "returnByValue": true, "contextId": id });
        self.call("Runtime.evaluate", asked)["result"]["value"].clone()
    }

    #[allow(dead_code, reason = "not all tests have frames")]
    /// Waits until an expression is true in the frame of a page.
    pub(crate) fn wait_in(&mut self, page: &str, expression: &str) {
        let until = Instant::now() + PATIENCE;
        while self.evaluate_in(page, expression) != true {
            assert!(Instant::now() < until, "it did not come true in {page}: {expression}");
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    /// Waits until an expression is true.
    pub(crate) fn wait_until(&mut self, expression: &str) {
        let until = Instant::now() + PATIENCE;
        while self.evaluate(expression) != true {
            if Instant::now() >= until {
                panic!(
                    "it did not come true: {expression}\nthe page says: {}",
                    self.evaluate("document.body.innerText")
                );
            }
            std::thread::sleep(Duration::from_millis(30));
        }
    }

    #[allow(dead_code, reason = "not all tests draw")]
    /// Draws with the mouse's left button from place to place, in steps.
    pub(crate) fn stroke(&mut self, places: &[[f64; 2]]) {
        let mut event = |kind: &str, [x, y]: [f64; 2], buttons: u32| {
            let button = if kind == "mouseMoved" { "none" } else { "left" };
            let mouse = json!({ "type": kind, "x": x, "y": y, "button": button, "buttons": buttons, "clickCount": 1 });
            self.call("Input.dispatchMouseEvent", mouse);
        };
        event("mousePressed", places[0], 1);
        for pair in places.windows(2) {
            for step in 1..=6 {
                let share = f64::from(step) / 6.0;
                event("mouseMoved", [0, 1].map(|k| pair[0][k] + share * (pair[1][k] - pair[0][k])), 1);
            }
        }
        event("mouseReleased", places[places.len() - 1], 0);
        self.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))");
    }

    #[allow(dead_code, reason = "not all tests drag")]
    /// Drags the mouse with its right button, in steps.
    pub(crate) fn drag_right(&mut self, from: [f64; 2], to: [f64; 2]) {
        for (kind, share, button, buttons) in [
            ("mousePressed", 0.0, "right", 2),
            ("mouseMoved", 0.5, "none", 2),
            ("mouseMoved", 1.0, "none", 2),
            ("mouseReleased", 1.0, "right", 0),
        ] {
            let [x, y] = [0, 1].map(|k| from[k] + share * (to[k] - from[k]));
            let mouse = json!({ "type": kind, "x": x, "y": y, "button": button, "buttons": buttons, "clickCount": 1 });
            self.call("Input.dispatchMouseEvent", mouse);
        }
        self.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))");
    }

    #[allow(dead_code, reason = "not all tests drag")]
    /// Drags the mouse with its left button, in steps.
    pub(crate) fn drag(&mut self, from: [f64; 2], to: [f64; 2]) {
        self.stroke(&[from, to]);
    }

    #[allow(dead_code, reason = "not all tests click")]
    /// Clicks with the left button of the mouse.
    pub(crate) fn click(&mut self, [x, y]: [f64; 2]) {
        for (kind, button, buttons) in
            [("mouseMoved", "none", 0), ("mousePressed", "left", 1), ("mouseReleased", "left", 0)]
        {
            let mouse = json!({ "type": kind, "x": x, "y": y, "button": button, "buttons": buttons, "clickCount": 1 });
            self.call("Input.dispatchMouseEvent", mouse);
        }
        self.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))");
    }

    #[allow(dead_code, reason = "not all tests turn the wheel")]
    /// Turns the wheel by notches; those that are negative zoom in.
    pub(crate) fn wheel(&mut self, [x, y]: [f64; 2], notches: f64) {
        let wheel = json!({ "type": "mouseWheel", "x": x, "y": y, "deltaX": 0, "deltaY": 100.0 * notches });
        self.call("Input.dispatchMouseEvent", wheel);
        self.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))");
    }

    #[allow(dead_code, reason = "not all tests touch")]
    /// Moves fingers, each from a place to another, in steps, and lifts them.
    pub(crate) fn touch(&mut self, fingers: &[[[f64; 2]; 2]]) {
        let mut event = |kind: &str, share: f64| {
            let at = |(id, [from, to]): (usize, &[[f64; 2]; 2])| json!({ "id": id, "x": from[0] + share * (to[0] - from[0]), "y": from[1] + share * (to[1] - from[1]) });
            let points: Vec<_> =
                if kind == "touchEnd" { Vec::new() } else { fingers.iter().enumerate().map(at).collect() };
            self.call("Input.dispatchTouchEvent", json!({ "type": kind, "touchPoints": points }));
        };
        event("touchStart", 0.0);
        (1..=8).for_each(|step| event("touchMove", f64::from(step) / 8.0));
        event("touchEnd", 1.0);
        self.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))");
    }

    #[allow(dead_code, reason = "not all tests touch")]
    /// Touches with one finger, and lifts it.
    pub(crate) fn tap(&mut self, [x, y]: [f64; 2]) {
        self.call("Input.dispatchTouchEvent", json!({ "type": "touchStart", "touchPoints": [{ "x": x, "y": y }] }));
        self.call("Input.dispatchTouchEvent", json!({ "type": "touchEnd", "touchPoints": [] }));
        self.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))");
    }

    #[allow(dead_code, reason = "not all tests use the keyboard")]
    /// Presses a key, with Ctrl if it is asked for.
    pub(crate) fn key(&mut self, key: &str, with_ctrl: bool) {
        for kind in ["rawKeyDown", "keyUp"] {
            let modifiers = if with_ctrl { 2 } else { 0 };
            let code = json!({ "type": kind, "key": key, "modifiers": modifiers });
            self.call("Input.dispatchKeyEvent", code);
        }
        self.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))");
    }

    #[allow(dead_code, reason = "not all tests look at them")]
    /// Errors that the page has reported, and addresses that it has asked for, except those that begin with its own; refusals of its own
    /// requests are shown on the page and are none.
    pub(crate) fn complaints(&mut self, own: &str) -> Vec<String> {
        // Earlier events have arrived before this answer.
        self.evaluate("1");
        let fetched = |event: &Value| {
            let url = event["params"]["request"]["url"].as_str().unwrap_or_default().to_owned();
            let inside = url.starts_with(own) || url.starts_with("data:") || url.starts_with("blob:");
            (!inside).then(|| format!("it asked for {url}"))
        };
        let said = |event: &Value| match event["method"].as_str().unwrap_or_default() {
            "Runtime.exceptionThrown" => Some(event["params"]["exceptionDetails"].to_string()),
            "Runtime.consoleAPICalled" if event["params"]["type"] == "error" => Some(event["params"].to_string()),
            "Log.entryAdded" => {
                let entry = &event["params"]["entry"];
                let is_refusal =
                    entry["source"] == "network" && entry["url"].as_str().is_some_and(|url| url.starts_with(own));
                (entry["level"] == "error" && !is_refusal).then(|| entry.to_string())
            }
            "Network.requestWillBeSent" => fetched(event),
            _ => None,
        };
        self.events.iter().filter_map(said).collect()
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        // There is none where no browser is installed.
        if self.process.is_none() || std::thread::panicking() {
            return;
        }
        self.session.clear();
        self.call("Target.closeTarget", json!({ "targetId": self.target }));
        IDLE.lock().unwrap().extend(self.process.take());
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        // Its child processes end with it.
        let _ = self.to.write_all(b"{\"id\":0,\"method\":\"Browser.close\"}\0");
        let until = Instant::now() + Duration::from_secs(10);
        while Instant::now() < until && matches!(self.child.try_wait(), Ok(None)) {
            std::thread::sleep(Duration::from_millis(20));
        }
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
