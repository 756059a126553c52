"""Headless Chromium over the Chrome DevTools Protocol's pipe (file descriptors 3 and 4): needs no package."""

import base64
import json
import os
import select
import shutil
import subprocess
import tempfile
import time

FLAGS = ["--headless=new", "--remote-debugging-pipe", "--no-sandbox", "--no-first-run", "--disable-extensions",
         "--disable-background-networking", "--disable-component-update", "--disable-sync", "--hide-scrollbars",
         "--disable-dev-shm-usage", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


def find():
    return shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


class BrowserError(Exception):
    pass


class Browser:
    """One page. `errors`: complaints of the console or a script; `requests`: the requested addresses."""

    def __init__(self, size=(1280, 900), timeout=120):
        self.timeout, self.errors, self.requests, self.number = timeout, [], [], 0
        self.events, self.buffer, self.session = [], b"", None
        self.folder = tempfile.mkdtemp(prefix="mirage-chromium-")
        to_read, self.to_write = os.pipe()
        self.from_read, from_write = os.pipe()

        def connect():  # the pipes' ends may stand on 3 and 4 themselves
            a, b = os.dup(to_read), os.dup(from_write)
            a, b = os.dup(a) if a in (3, 4) else a, os.dup(b) if b in (3, 4) else b
            os.dup2(a, 3)
            os.dup2(b, 4)

        self.process = subprocess.Popen(
            [find(), *FLAGS, f"--user-data-dir={self.folder}", f"--window-size={size[0]},{size[1]}", "about:blank"],
            preexec_fn=connect, close_fds=False, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL, env={**os.environ, "HOME": self.folder}, start_new_session=True)
        os.close(to_read)
        os.close(from_write)
        try:
            self.attach(size)
        except Exception:
            self.__exit__()
            raise

    def attach(self, size):
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self.session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(domain + ".enable")
        self.resize(*size)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        try:
            self.session = None
            self.call("Browser.close")
            self.process.wait(10)
        except (BrowserError, OSError, subprocess.TimeoutExpired):
            self.process.kill()
            self.process.wait()
        os.close(self.to_write)
        os.close(self.from_read)
        shutil.rmtree(self.folder, ignore_errors=True)

    def call(self, method, **parameters):
        self.number += 1
        message = {"id": self.number, "method": method, "params": parameters}
        if self.session:
            message["sessionId"] = self.session
        data = json.dumps(message).encode() + b"\0"
        while data:
            data = data[os.write(self.to_write, data):]
        ends = time.monotonic() + self.timeout
        while True:
            answer = self.receive(ends)
            if answer.get("id") == self.number:
                if "error" in answer:
                    raise BrowserError(f"{method}: {answer['error']}")
                return answer["result"]
            self.note(answer)

    def receive(self, ends):
        while b"\0" not in self.buffer:
            if not select.select([self.from_read], [], [], max(0, ends - time.monotonic()))[0]:
                raise BrowserError(f"Chromium did not answer within {self.timeout} s")
            piece = os.read(self.from_read, 1 << 20)
            if not piece:
                raise BrowserError("Chromium ended")
            self.buffer += piece
        message, self.buffer = self.buffer.split(b"\0", 1)
        return json.loads(message)

    def note(self, event):
        method, told = event.get("method"), event.get("params", {})
        if method == "Runtime.exceptionThrown":
            details = told["exceptionDetails"]
            self.errors.append(details.get("exception", {}).get("description", details["text"]))
        elif method == "Runtime.consoleAPICalled" and told["type"] in ("error", "assert"):
            self.errors.append(" ".join(str(part.get("value", part.get("description"))) for part in told["args"]))
        elif method == "Log.entryAdded" and told["entry"]["level"] == "error":
            self.errors.append(told["entry"]["text"] + " " + told["entry"].get("url", "")[:200])
        elif method == "Network.requestWillBeSent":
            self.requests.append(told["request"]["url"][:200])
        elif method:
            self.events.append(method)

    def open(self, path):
        """A file, or an address with its scheme."""
        self.events.clear()
        self.call("Page.navigate", url=path if "://" in path else "file://" + os.path.abspath(path))
        self.wait_for("document.readyState === 'complete'")

    def run(self, expression):
        """The value of a JavaScript expression."""
        answer = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in answer:
            raise BrowserError(f"{expression}: {answer['exceptionDetails']}")
        return answer["result"].get("value")

    def wait_for(self, expression):
        ends = time.monotonic() + self.timeout
        while not self.run(expression):
            if time.monotonic() > ends:
                raise BrowserError(f"never came true: {expression}")
            time.sleep(0.1)

    def drag(self, start, end):
        """With the left button, in the window's pixels."""
        for kind, (x, y), buttons in (("mousePressed", start, 1), ("mouseMoved", end, 1), ("mouseReleased", end, 0)):
            self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", buttons=buttons, clickCount=1)

    def press(self, key, code):
        for kind in ("keyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", type=kind, key=key, code=key, windowsVirtualKeyCode=code)

    def resize(self, width, height=900):
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)

    def theme(self, name):
        self.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": name}])

    def screenshot(self, path, clip=None):
        """clip: (x, y, width, height) of the page; None: the window."""
        options = {"format": "png"}
        if clip:
            options.update(captureBeyondViewport=True, clip=dict(zip(("x", "y", "width", "height"), clip), scale=1))
        with open(path, "wb") as file:
            file.write(base64.b64decode(self.call("Page.captureScreenshot", **options)["data"]))


def at(tree, place):
    """The value at a path such as "a.0.b"."""
    for part in place.split("."):
        tree = tree[int(part)] if isinstance(tree, list) else tree[part]
    return tree


class PageChecks:
    """Checks for every page; for a TestCase with its `browser` at the page."""

    def test_nothing_sticks_out(self):
        cut = ("(() => { const shut = [...document.querySelectorAll('details:not([open])')]; shut.forEach(d => { d.open = true });"
               "const cut = [...document.querySelectorAll('table.data')].filter(t => t.offsetWidth > t.parentElement.clientWidth)"
               ".map(t => t.textContent.trim().slice(0, 60)); shut.forEach(d => { d.open = false }); return cut })()")
        for width in (1400, 1280, 420):
            self.browser.resize(width)
            self.assertLessEqual(self.browser.run("document.documentElement.scrollWidth"), width)
            if width != 1280:
                self.assertEqual(self.browser.run(cut), [], width)
        self.browser.resize(1280)

    def test_themes(self):
        paper = []
        for theme in ("light", "dark"):
            self.browser.theme(theme)
            paper.append(self.browser.run("getComputedStyle(document.body).backgroundColor"))
        self.browser.theme("light")
        self.assertNotEqual(*paper)


class ReportChecks(PageChecks):
    """Checks for every page of figures. `path`: the page; `least`: figures; `result`: the file beside it that has them; `cells`:
    selects those of tables that hold figures and no digits of their own."""

    least, result, cells = 30, "result.json", None

    @classmethod
    def show(cls, path):
        cls.path, cls.browser = path, Browser()
        cls.addClassCleanup(cls.browser.__exit__)
        cls.browser.open(path)

    def tearDown(self):
        self.assertEqual(self.browser.errors, [])

    def test_asks_for_nothing_but_itself(self):
        outside = [url for url in self.browser.requests if not url.startswith(("data:", "blob:"))]
        self.assertEqual([url for url in outside if not url.endswith(os.path.basename(self.path))], [])

    def test_every_figure_is_in_the_result(self):
        read = {}
        shown = self.browser.run("[...document.querySelectorAll('data')].map(d => [d.dataset.at, d.value, d.textContent])")
        self.assertGreater(len(shown), self.least)
        for place, value, text in shown:
            name, inside = place.split("#") if "#" in place else (self.result, place)
            if name not in read:
                with open(os.path.join(os.path.dirname(self.path), name), encoding="utf-8") as file:
                    read[name] = json.load(file)
            self.assertEqual(str(at(read[name], inside)), value, place)
            self.assertTrue(text)
        if self.cells:
            self.assertEqual(self.browser.run(f"[...document.querySelectorAll({json.dumps(self.cells)})].filter(c => /\\d/.test(c.textContent) && "
                                              "!c.querySelector('data')).map(c => c.textContent)"), [])
