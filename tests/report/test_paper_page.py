"""The page of `mirage reproduce` in headless Chromium: test_paper_page.py SOURCE. Exit code 77: skipped, with why.

Opens without console errors and without asking for anything but itself, every figure stands in reproduce.json, failed
rows show their error, all parts are there, and both themes draw."""

import json
import os
import subprocess
import sys
import tempfile
import unittest
import xml.etree.ElementTree

import browser
import paper_fixture

SOURCE = os.path.abspath(sys.argv[1])
sys.path.append(os.path.join(SOURCE, "validation", "paper"))
import paper_page  # noqa: E402


def write_page(folder):
    subprocess.run([sys.executable, os.path.join(SOURCE, "validation", "paper", "paper_page.py"), folder], check=True)
    return os.path.join(folder, "reproduce.html")


class Page(browser.ReportChecks, unittest.TestCase):
    least, result, cells = 300, "reproduce.json", "section:not(#method) td:not(.quiet)"

    @classmethod
    def setUpClass(cls):
        cls.folder = tempfile.TemporaryDirectory(prefix="mirage-paper-")
        cls.addClassCleanup(cls.folder.cleanup)
        paper_fixture.make(cls.folder.name)
        cls.show(write_page(cls.folder.name))

    def count(self, selector):
        return self.browser.run(f"document.querySelectorAll({json.dumps(selector)}).length")

    def test_parts_are_there(self):
        sections = self.browser.run("[...document.querySelectorAll('section')].map(s => s.id)")
        self.assertEqual(sections, ["findings", "pictures-used", "table1", "table2", "fig3", "fig4", "table3", "table4", "parts", "fusions", "pictures", "method"])
        self.assertEqual(self.count("svg.plot"), 2 + 2 + 2 + 1 + 2 + 1 + 1)
        self.assertEqual(self.browser.run("[...document.images].filter(i => !i.naturalWidth).length"), 0)
        self.assertEqual(self.count("#pictures img"), 3)

    def test_headline_counts_the_findings(self):
        self.assertEqual(self.browser.run("document.querySelector('h1').textContent"),
                         "Of 4 of the paper's findings, 1 holds, 1 holds in part, 1 does not, 1 cannot be told.")
        told = [{"claim": "a", "verdict": "cannot be told", "checks": [1]}] * 3
        self.assertEqual(paper_page.headline(told), "These data are too few to decide any of 3 findings of the paper.")
        self.assertEqual(self.count("#findings .finding .tag"), 4)  # one a finding
        self.assertIn("not measured here", self.browser.run("document.querySelector('#findings').textContent.toLowerCase()"))

    def test_failed_rows_show_their_error(self):
        self.assertIn("made to fail", self.browser.run("document.querySelector('#table1 td.error').textContent"))

    def test_rows_about_a_picture_that_is_not_used_say_so(self):
        self.assertIn("so this says nothing about images", self.browser.run("document.querySelector('#table1').textContent"))
        self.assertEqual(self.count("#pictures-used tbody tr"), 2)

    def test_the_heat_map_shows_each_cell_twice_and_what_is_told_in_bold(self):
        figures = self.browser.run("[...document.querySelectorAll('#fusions .heat text.figure')].map(t => "
                                   "[t.textContent, t.style.fontWeight])")
        self.assertEqual(len(figures), 2 * (9 - 1))  # one cell failed
        self.assertEqual(figures[0], ["−8.0", "700"])
        self.assertEqual(figures[3], ["0.0", ""])  # a column after the other
        fills = self.browser.run("[...document.querySelectorAll('#fusions .heat g > rect:first-child')].map(r => r.getAttribute('fill'))")
        self.assertEqual(fills[3], "#ffffff")
        self.assertNotEqual(fills[0], fills[5])
        self.assertIn("made to fail", self.browser.run("document.querySelector('#fusions td.error').textContent"))

    def test_the_heat_map_is_a_file_of_its_own(self):
        path = os.path.join(self.folder.name, "fusions.svg")
        self.assertLess(os.path.getsize(path), 300_000)
        root = xml.etree.ElementTree.parse(path).getroot()
        self.assertTrue(root.tag.endswith("svg"))
        self.assertGreater(int(root.get("width")), 500)


class OneJudge(unittest.TestCase):
    def test_what_the_map_says_fits_beside_each_other(self):
        with tempfile.TemporaryDirectory(prefix="mirage-paper-") as folder, browser.Browser() as chromium:
            result = paper_fixture.make(folder)
            table = next(table for table in result["tables"] if table["name"] == "fusions")
            table["rows"] = [row for row in table["rows"] if row["target"] == table["rows"][0]["target"]]
            with open(os.path.join(folder, "reproduce.json"), "w", encoding="utf-8") as file:
                json.dump(result, file)
            chromium.open(write_page(folder))
            outside, over = chromium.run("""(() => {
                const svg = document.querySelector('#fusions .heat svg') || document.querySelector('#fusions svg.plot');
                const [, , wide, high] = svg.getAttribute('viewBox').split(' ').map(Number);
                const boxes = [...svg.querySelectorAll('text')].map(t => [t.textContent, t.getBBox()]);
                const met = (a, b) => a.x < b.x + b.width && b.x < a.x + a.width && a.y < b.y + b.height && b.y < a.y + a.height;
                const panels = boxes.filter(([said]) => said.startsWith('vanished') || said.startsWith('missed'));
                return [boxes.filter(([, b]) => b.x < 0 || b.x + b.width > wide || b.y + b.height > high).map(([said]) => said),
                        panels.length < 2 || met(panels[0][1], panels[1][1])];
            })()""")
            self.assertEqual(outside, [])
            self.assertFalse(over)


class Distances(unittest.TestCase):
    def test_are_of_every_look_at_a_vehicle(self):
        """Ten of a hundred in each of two runs are ten of a hundred, not twenty."""
        sys.path.insert(0, os.path.join(SOURCE, "validation", "paper"))
        sys.path.insert(0, os.path.join(SOURCE, "validation", "report"))
        import paper_plots
        row = {"label": "fusion, both", "vehicles": 100, "meshes": 1, "runs": 2, "false_positives_of": 200, "false_positive_distances": [1.0] * 20}
        plot = str(paper_plots.distances([row]))
        self.assertIn(">10</text>", plot)
        self.assertNotIn(">20</text>", plot.split("distance from the host")[0].split('text-anchor="end"', 1)[1])


class WithoutResults(unittest.TestCase):
    def test_a_page_of_errors_alone(self):
        with tempfile.TemporaryDirectory(prefix="mirage-paper-") as folder, browser.Browser() as chromium:
            result = paper_fixture.make(folder)
            for table in result["tables"]:
                for index, row in enumerate(table["rows"]):
                    kept = {key: row[key] for key in ("label", "rig", "case", "paper", "size", "source", "target") if key in row}
                    table["rows"][index] = {**kept, "values": {}, "error": "not run"}
            for finding in result["findings"]:
                finding["checks"] = []
            with open(os.path.join(folder, "reproduce.json"), "w", encoding="utf-8") as file:
                json.dump(result, file)
            chromium.open(write_page(folder))
            self.assertEqual(chromium.run("document.querySelectorAll('svg.plot').length"), 0)
            self.assertIn("not run", chromium.run("document.querySelector('#table4').textContent"))
            self.assertEqual(chromium.errors, [])


if __name__ == "__main__":
    if not browser.find():
        print("skipped: chromium is not installed (package chromium)")
        sys.exit(77)
    unittest.main(argv=sys.argv[:1], verbosity=2)
