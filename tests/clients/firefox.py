"""The page and the report in Firefox, by its own remote protocol (Marionette): no driver and no package beside it."""

import json
import socket
import subprocess
import time

from client import Row, client, debian, folder, osteoflow, recorded
from clouds import off
from streams import Served

PATIENCE_S = 60
# What a page throws while it loads, kept from its first script on.
KEEPS_ERRORS = "user_pref('devtools.console.stdout.content', true);\nuser_pref('browser.dom.window.dump.enabled', true);\n"


class Firefox:
    """A headless Firefox with one page."""

    def __enter__(self):
        profile = folder() / "firefox"
        profile.mkdir(exist_ok=True)
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        software = "user_pref('webgl.force-enabled', true);\n"
        (profile / "user.js").write_text(f"user_pref('marionette.port', {port});\n{software}{KEEPS_ERRORS}")
        self.said = open(folder() / "firefox.txt", "w+", encoding="utf-8")
        command = ["firefox-esr", "--headless", "--marionette", "--no-remote", "--profile", str(profile), "about:blank"]
        self.process = subprocess.Popen(command, stdout=self.said, stderr=subprocess.STDOUT)
        until = time.monotonic() + PATIENCE_S
        while True:
            try:
                self.socket = socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S)
                break
            except OSError:
                assert self.process.poll() is None and time.monotonic() < until, "Firefox does not answer"
                time.sleep(0.2)
        self.stream, self.n = self.socket.makefile("rb"), 0
        self.read()
        self.call("WebDriver:NewSession", {"capabilities": {}})
        return self

    def __exit__(self, *_):
        self.process.terminate()
        self.process.wait(20)
        self.said.close()

    def read(self):
        digits = b""
        while (c := self.stream.read(1)) != b":":
            digits += c
        return json.loads(self.stream.read(int(digits)))

    def call(self, command, parameters):
        self.n += 1
        text = json.dumps([0, self.n, command, parameters]).encode()
        self.socket.sendall(b"%d:%s" % (len(text), text))
        _, _, error, result = self.read()
        assert error is None, f"{command}: {error}"
        return result

    def evaluate(self, script):
        return self.call("WebDriver:ExecuteScript", {"script": f"return {script}", "args": []})["value"]

    def open(self, address):
        self.call("WebDriver:Navigate", {"url": address})

    def wait_until(self, script):
        until = time.monotonic() + PATIENCE_S
        while not self.evaluate(script):
            assert time.monotonic() < until, f"never: {script}; the page: {self.evaluate('document.body.innerText')[:800]}"
            time.sleep(0.1)

    def thrown(self):
        """What pages have thrown so far."""
        self.said.flush()
        text = (folder() / "firefox.txt").read_text(encoding="utf-8", errors="replace")
        return [line for line in text.splitlines() if "JavaScript error: http" in line or "JavaScript error: file" in line]


@client("Firefox", version=lambda: debian("firefox-esr").split("esr")[0], program="firefox-esr")
def firefox():
    run = recorded()
    results = json.loads((run / "results.json").read_text())
    answer = results["verdict"]["answer"]
    with Firefox() as browser:
        has_webgl = browser.evaluate("document.createElement('canvas').getContext('webgl2') !== null")
        how = "" if has_webgl else ", without WebGL"
        with Served("view", run) as served:
            browser.open(served.page)
            browser.wait_until(f"document.getElementById('verdict')?.className === 'verdict {answer}'")
            browser.wait_until("document.querySelectorAll('#graph details').length > 10")
            browser.wait_until("document.querySelectorAll('#numbers dd').length > 3")
            assert has_webgl == browser.evaluate("document.querySelector('#view .missing') === null")
            # A planned plane is drawn where the exported plan has it.
            planes = "osteoflow.scene.drawn.get('plan.planes')"
            browser.wait_until(f"{planes} !== undefined")
            drawn = browser.evaluate(f"{planes}.object.children[0].position.toArray()")
            expected = json.loads((run / "export" / "planes.mrk.json").read_text())["markups"][0]["center"]
            assert browser.thrown() == [], browser.thrown()
            yield Row(f"the page{how}: verdict, numbers, graph; a planned plane", off(drawn, expected), tolerance=1e-3)
        osteoflow("report", run, check=False)
        report = run / "report.html"
        browser.open(report.as_uri())
        browser.wait_until(f"document.body.innerText.toLowerCase().includes('{answer}')")
        n_views = browser.evaluate("document.querySelectorAll('.view').length")
        assert n_views > 0
        browser.wait_until("document.readyState === 'complete'")
        shown = "canvas" if has_webgl else ".fallback"
        browser.evaluate("document.querySelectorAll('.view').forEach((view) => view.scrollIntoView())")
        browser.wait_until(f"document.querySelectorAll('.view {shown}').length > 0")
        assert browser.thrown() == [], browser.thrown()
        yield Row(f"the report{how}: verdict and its {n_views} views", 0.0, "")
