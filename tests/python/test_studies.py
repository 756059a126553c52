"""Studies (validation/studies) take what lies in their folder for theirs only where it was made of the same, what is kept as evidence
(src/guide/evidence.py) says when it was measured, and no benchmark's cost is paid by another one's cache. A script stands for mirage."""

import json
import os
import pathlib
import subprocess
import sys
import tempfile
import unittest

SOURCE = pathlib.Path(os.environ.get("MIRAGE_SOURCE", "."))
STUDIES = SOURCE / "validation" / "studies"
CAR = {"frame": "000000", "label": 0}

# Writes what the studies read, each time with another identity, and a line into its log.
PROGRAM = f"""#!{sys.executable}
import json, pathlib, sys
words = sys.argv[1:]
out = pathlib.Path(words[words.index("--out") + 1])
log = pathlib.Path(__file__).with_suffix(".log")
with log.open("a") as file:
    file.write(" ".join(words) + "\\n")
share = {{"value": 0.5, "low": 0.4, "high": 0.6}}
outcome = {{"hidden": True, "false_positive": False}}
host = {{**{CAR!r}, "detected": True, "controls": [{{"control": "photograph", "logit": 2}}], "arms": [
    {{"light": light, "returns": returns, "logit": 1, **outcome}}
    for light, returns in (("raster", "ideal"), ("visible", "ideal"), ("cycles", "ideal"), ("cycles", "realistic"))]}}
(out / "hosts").mkdir(parents=True, exist_ok=True)
(out / "hosts" / "000000_0.json").write_text(json.dumps(host))
(out / "run.json").write_text(json.dumps({{"test": [{CAR!r}]}}))
(out / "result.json").write_text(json.dumps({{
    "vehicles": 500, "placed": {{"victim": "carrier"}}, "net": {{"vanished": share, "fp_asr": share}}, "hidden": {{"vanished": share}},
    "intervals": {{"fp_asr": share}}, "stages": {{"iterations": 4}}, "seconds_per_iteration": 1, "hosts": ["000000_0"],
    "outcomes": [{{**{CAR!r}, **outcome}}],
    "provenance": {{"identity": "same", "commit": "abc1234-dirty", "date": "2026-01-02T03:04:05Z"}}}}))
"""

# Generates a car a frame; says what it kept where.
FLEET = f"""#!{sys.executable}
import os, pathlib, sys
words = sys.argv[1:]
if words[0] == "generate":
    labels = pathlib.Path(words[words.index("--out") + 1]) / "training" / "label_2"
    labels.mkdir(parents=True)
    for number in range(int(words[words.index("--frames") + 1])):
        (labels / f"{{number:06d}}.txt").write_text("Car 0\\n")
with pathlib.Path(__file__).with_suffix(".log").open("a") as file:
    file.write(words[0] + " " + os.environ["MIRAGE_CACHE"] + "\\n")
"""


class Studies(unittest.TestCase):
    def setUp(self):
        self.place = tempfile.TemporaryDirectory(prefix="mirage-studies-")
        self.folder = pathlib.Path(self.place.name)
        self.program = self.folder / "mirage"
        self.program.write_text(PROGRAM)
        self.program.chmod(0o755)
        for data in ("data", "judge"):
            for number in range(3):
                file = self.folder / data / "training" / "velodyne" / f"{number:06d}.bin"
                file.parent.mkdir(parents=True, exist_ok=True)
                file.write_bytes(b"sweep")

    def tearDown(self):
        self.place.cleanup()

    def run_study(self, name, *arguments, out="out"):
        return subprocess.run([sys.executable, "-B", STUDIES / f"{name}.py", "--data", self.folder / "data", "--out", self.folder / out,
                               "--mirage", self.program, *arguments], capture_output=True, text=True)

    def placements(self, *arguments, **where):
        return self.run_study("placements", "--judge", self.folder / "judge", "--detectors", "lidar", "--places", "roof", *arguments, **where)

    def light(self, *arguments):
        return self.run_study("attack_light", "--detectors", "fusion", "--lights", "plain", "--seeds", "1", *arguments)

    def calls(self):
        return self.program.with_suffix(".log").read_text().splitlines()

    def finished(self, process):
        self.assertEqual(process.returncode, 0, process.stderr)

    def refused(self, process, *words):
        self.assertNotEqual(process.returncode, 0, process.stdout)
        self.assertEqual(len(process.stderr.splitlines()), 1, process.stderr)
        for word in words:
            self.assertIn(word, process.stderr)

    def test_what_is_finished_is_taken_by_the_same_study_alone(self):
        self.finished(self.placements())
        self.assertEqual([call.split()[0] for call in self.calls()], ["attack", "evaluate"])
        told = json.loads((self.folder / "out" / "placements.json").read_text())
        self.assertEqual((told["commit"], told["date"], len(told["rows"])), ("abc1234-dirty", "2026-01-02T03:04:05Z", 1))
        self.finished(self.placements("--threads", "1"))
        self.assertEqual(len(self.calls()), 2)  # nothing was made anew
        self.refused(self.placements("--iterations", "50"), "another command", "--iterations 50", "use another --out")
        self.refused(self.placements("--seed", "3"), "another command", "--seed 3")
        self.assertEqual(len(self.calls()), 2)
        self.finished(self.placements("--iterations", "50", out="other"))

    def test_other_frames_and_another_program_are_no_ones_of_before(self):
        for data, said in (("judge", "another files"), ("data", "another data")):
            self.finished(self.placements(out=said))
            (self.folder / data / "training" / "velodyne" / "000000.bin").write_bytes(b"another sweep")
            self.refused(self.placements(out=said), said)
        self.finished(self.placements())
        self.program.write_text(PROGRAM + "# another build\n")
        self.refused(self.placements(), "another program")

    def test_a_folder_that_does_not_say_is_refused(self):
        (self.folder / "out" / "roof-lidar-both").mkdir(parents=True)
        (self.folder / "out" / "roof-lidar-both" / "result.json").write_text("{}")
        self.refused(self.placements(), "does not say what it was made of")

    def test_a_stopped_copy_of_frames_is_completed(self):
        self.finished(self.placements())
        link = self.folder / "out" / "frames-3" / "training" / "velodyne" / "000002.bin"
        link.unlink()
        self.finished(self.placements())
        self.assertTrue(link.is_symlink())

    def test_meshes_under_light_have_their_own_steps_and_vehicles(self):
        self.finished(self.light("--iterations", "4"))
        told = json.loads((self.folder / "out" / "attack_light.json").read_text())
        self.assertEqual((told["commit"], told["rows"][0]["vehicles"]), ("abc1234-dirty", 1))
        self.refused(self.light("--iterations", "2"), "another command", "--iterations 2")
        self.refused(self.light("--iterations", "4", "--", "--free"), "another command", "--free")
        # The folder has a vehicle of an earlier validation that this one does not list.
        hosts = self.folder / "out" / "fusion" / "plain-1" / "validate" / "hosts"
        (hosts / "000009_0.json").write_text("{}")
        self.finished(self.light("--iterations", "4"))

    def test_rows_of_recorded_cars_are_of_one_choice_of_frames(self):
        def study(*arguments):
            return subprocess.run([sys.executable, "-B", STUDIES / "real_to_sim.py", "--data", self.folder / "data", "--out",
                                   self.folder / "out", *arguments], capture_output=True, text=True)

        first = study()  # no data set: it ends with that, its choice made
        if "No module named" in first.stderr:
            self.skipTest(first.stderr.splitlines()[-1])
        self.assertTrue((self.folder / "out" / "made-of.json").exists(), first.stderr)
        self.refused(study("--frames", "2"), "another frames (3, not 2)")
        self.refused(study("--apart", "5"), "another apart")

    def test_what_a_fleet_costs_is_measured_without_frames_of_before(self):
        self.program.write_text(FLEET)
        figures = self.folder / "bench.json"
        self.finished(subprocess.run(
            [sys.executable, "-B", SOURCE / "validation" / "benchmarks" / "fleet_cost.py", self.program, "--frames", "1,3", "--commands",
             "detect,audit", "--json", figures], capture_output=True, text=True))
        self.assertIn("fleet_cpu_s_per_1000_detect", json.loads(figures.read_text()))
        caches = [call for call in self.calls() if not call.startswith("generate")]
        self.assertEqual(len(caches), 6)
        self.assertEqual(len(set(caches)), 6)

    def test_evidence_says_when_it_was_measured_and_not_when_it_was_kept(self):
        evidence = SOURCE / "src" / "guide" / "evidence.py"

        def kept(told):
            file = self.folder / "measured.json"
            file.write_text(json.dumps(told))
            os.utime(file, (1.7e9, 1.7e9))
            subprocess.run([sys.executable, "-B", evidence, self.folder, "--keep", "kept", file, "figures", "--", "make", "bench"], check=True)
            return json.loads((self.folder / "validation" / "results" / "kept.json").read_text())

        self.assertEqual(kept({"ms": 2}), {"command": "make bench", "date": "2023-11-14", "figures": {"ms": 2}})
        self.assertEqual(kept({"commit": "abc-dirty", "date": "2026-01-02", "ms": 2}),
                         {"command": "make bench", "commit": "abc-dirty", "date": "2026-01-02", "figures": {"ms": 2}})
        printed = [sys.executable, "-B", evidence, self.folder, "--keep-lines", "lines", "error", "--", "echo", "error", "1"]
        self.assertIn("mirage.commit", subprocess.run(printed, capture_output=True, text=True).stderr)
        (self.folder / "build" / "release").mkdir(parents=True)
        (self.folder / "build" / "release" / "mirage.commit").write_text("abc-dirty\n")
        subprocess.run(printed, check=True)
        lines = json.loads((self.folder / "validation" / "results" / "lines.json").read_text())
        self.assertEqual((lines["commit"], lines["lines"]), ("abc-dirty", ["error 1"]))


if __name__ == "__main__":
    unittest.main()
