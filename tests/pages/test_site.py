"""The site of `make site` in headless Chromium: test_site.py SOURCE BUILD. Exit code 77: skipped, with why.

It is built and served here. Its pages open without console errors and ask for nothing but itself, at 1400 and at 420 pixels
nothing overflows, pictures load, and the search finds a word and leads to its page."""

import functools
import http.server
import os
import subprocess
import sys
import tempfile
import threading
import unittest

SOURCE, BUILD = (os.path.abspath(path) for path in sys.argv[1:3])
sys.path.insert(0, os.path.join(SOURCE, "tests", "report"))
import browser  # noqa: E402

FOLDER = tempfile.TemporaryDirectory(prefix="mirage-site-")
VISITED = ("index.html", "src/guide/trust.html", "src/guide/commands.html", "src/guide/evidence.html", "src/index.html")


class Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *_):
        pass


class Site(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        built = subprocess.run([sys.executable, "-B", os.path.join(SOURCE, "src/guide/site.py"), SOURCE, FOLDER.name],
                               capture_output=True, text=True, check=False)
        if built.returncode:
            raise RuntimeError(built.stdout + built.stderr)
        cls.server = http.server.ThreadingHTTPServer(
            ("127.0.0.1", 0), functools.partial(Quiet, directory=os.path.join(FOLDER.name, "html")))
        threading.Thread(target=cls.server.serve_forever, daemon=True).start()
        cls.root = f"http://127.0.0.1:{cls.server.server_port}/"
        cls.browser = browser.Browser(size=(1400, 900))

    @classmethod
    def tearDownClass(cls):
        cls.browser.__exit__()
        cls.server.shutdown()
        cls.server.server_close()

    def setUp(self):
        self.browser.errors.clear()
        self.browser.requests.clear()

    def tearDown(self):
        self.assertEqual(self.browser.errors, [])
        beyond = [url for url in self.browser.requests if not url.startswith((self.root, "data:", "blob:"))]
        self.assertEqual(beyond, [])

    def test_pages_open_with_their_pictures_and_fit(self):
        for page in VISITED:
            for width in (1400, 420):
                with self.subTest(page=page, width=width):
                    self.browser.resize(width)
                    self.browser.open(self.root + page)
                    self.assertLessEqual(self.browser.run("document.documentElement.scrollWidth"), width)
                    self.browser.wait_for("[...document.images].every(i => i.complete)")
                    self.assertEqual(self.browser.run("[...document.images].filter(i => !i.naturalWidth).map(i => i.src)"), [])

    def test_the_search_finds_a_word_and_leads_to_its_page(self):
        self.browser.resize(1400)
        self.browser.open(self.root + "index.html")
        self.browser.run("document.querySelector('.md-search__input').focus()")
        self.browser.wait_for("document.querySelector('.md-search-result__meta').innerText.startsWith('Type')")
        self.browser.run("document.querySelector('.md-search__input').value = 'vacuous'; "
                         "document.querySelector('.md-search__input').dispatchEvent(new Event('keyup'))")
        self.browser.wait_for("!!document.querySelector('.md-search-result__link')")
        found = self.browser.run("[...document.querySelectorAll('.md-search-result__link')].map(a => a.href)")
        found = [link for link in found if "src/guide/trust.html" in link]
        self.assertTrue(found)
        self.browser.open(found[0])
        self.assertIn("vacuous", self.browser.run("document.body.innerText"))

    def test_the_navigation_names_every_page(self):
        self.browser.open(self.root + "index.html")
        titles = self.browser.run("[...document.querySelectorAll('.md-nav--primary .md-nav__link')].map(a => a.innerText.trim())")
        for title in ("Start", "Attack my detector", "My own log", "Decide", "Defend and certify", "Trust", "Evidence", "Commands"):
            self.assertIn(title, titles)


def has_theme():
    try:
        from mkdocs import utils
    except ImportError:
        return False
    return "material" in utils.get_theme_names()


if __name__ == "__main__":
    if not has_theme():
        print("skipped: mkdocs or its material theme is missing (apt-get install mkdocs mkdocs-material)")
        sys.exit(77)
    if not browser.find():
        print("skipped: no Chromium")
        sys.exit(77)
    unittest.main(argv=sys.argv[:1])
