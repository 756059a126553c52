"""A user's network in Mirage: as a callable, as a program, with wrong glue code, and of other frameworks."""

import contextlib
import io
import math
import os
import pathlib
import shutil
import subprocess
import sys
import textwrap
import types
import time
import unittest

try:
    import torch
except ImportError:
    print("skipped: PyTorch is not installed for this interpreter (Debian package python3-torch)")
    sys.exit(77)

import mirage
import numpy as np
from mirage._voxels import turned, turned_back, voxels_of
from support import PROGRAM, Folder, LocalDetector, detector

HERE = os.path.dirname(os.path.abspath(__file__))
SETTINGS = {"rooftop": "box", "threads": 1}
AS_A_PROGRAM = f"""
import sys
sys.path.insert(0, {HERE!r})
import torch
from mirage_serve import serve
from support import detector
"""


def setUpModule():
    global FOLDER
    FOLDER = Folder(4)


def tearDownModule():
    FOLDER.remove()


def place(name):
    return os.path.join(FOLDER.path, name)


def program(name, text):
    """A --detector that runs the text."""
    with open(place(name), "w") as file:
        file.write(AS_A_PROGRAM + textwrap.dedent(text))
    return f"exec:{sys.executable} -B '{place(name)}'"


def changed(change):
    """The tests' detector with its boxes and logits changed."""
    return lambda image, points, pixel_from_velo: change(*detector(image, points, pixel_from_velo))


def seven(boxes):
    """The same boxes with z and height."""
    rows = torch.tensor([-0.98, 1.5]).expand(len(boxes), 2)
    return torch.stack([boxes[:, 0], boxes[:, 1], rows[:, 0], boxes[:, 2], boxes[:, 3], rows[:, 1], boxes[:, 4]], 1)


THE_ISSUES_TEXT = """
import mirage
r = mirage.detect(detector=f, data="data"); print(r["ap70"], r["found"], "of", r["vehicles"])
mirage.check(f, "data")
mirage.attack(detector=f, data="data", out="out/run"); mirage.evaluate("out/run", detector=f); mirage.validate("out/run", detector=f, frames=4)
"""
ITS_COMMANDS = """
detect --data data
attack --data data --out out/by-command
evaluate --run out/by-command
validate --run out/by-command --frames 4 --samples 4
certify --data data
"""


class TheScript(unittest.TestCase):
    """The steps of a user who has only the first text; with three iterations, so that they take seconds."""

    def setUp(self):
        self.few = dict(os.environ, MIRAGE_CACHE=place("cache"))
        with open(place("few.toml"), "w") as file:
            file.write("iterations = 3\n")

    def run_in_folder(self, *words):
        done = subprocess.run(words, cwd=FOLDER.path, capture_output=True, text=True, env=self.few)
        self.assertEqual(done.returncode, 0, " ".join(words) + done.stdout + done.stderr)
        return done

    def test_in_python(self):
        text = THE_ISSUES_TEXT if shutil.which("blender") else THE_ISSUES_TEXT.rpartition(";")[0]
        text = text.replace('out="out/run")', 'out="out/run", iterations=3)', 1).replace("frames=4", "frames=4, samples=4")
        with open(place("user.py"), "w") as file:
            file.write(f"import sys\nsys.path[:0] = [{HERE!r}]\nimport torch\nfrom support import detector as f\n{text}")
        done = self.run_in_folder(sys.executable, "-B", "-W", "error", "user.py")
        self.assertRegex(done.stdout.splitlines()[0], r"^0\.\d+ \d of 4$")
        self.assertIn("logits (median)", done.stdout)
        self.assertIn("cosine", done.stdout)
        self.assertNotIn("looks wrong", done.stdout)
        # Of its few vehicles the detector finds none on the test side, and that is said; nothing else is.
        self.assertFalse([line for line in done.stderr.splitlines() if "finds none of 1 vehicles as recorded" not in line])
        for name in ("evaluate/result.json", *(["validate/report.html"] if shutil.which("blender") else [])):
            self.assertTrue(os.path.exists(place(f"out/run/{name}")), name)

    def test_on_the_command_line(self):
        named = program("f.py", "serve(detector)\n")
        for line in ITS_COMMANDS.strip().splitlines():
            if line.startswith("validate") and not shutil.which("blender"):
                continue
            few = ["--config", "few.toml"] if line.startswith("attack") else []
            done = self.run_in_folder(os.path.abspath(PROGRAM), *line.split(), "--detector", named, *few)
            self.assertNotIn("Traceback", done.stderr)  # where it is asked without a picture, either


class Program(unittest.TestCase):
    def test_an_attack_on_it_is_that_on_the_callable_to_the_bit(self):
        named = program("same.py", "serve(detector)\n")
        runs = [place("by-callable"), place("by-program"), place("by-command")]
        for run, network in zip(runs, (detector, named)):
            mirage.attack(detector=network, data=FOLDER.data, out=run, iterations=4, copy=False, **SETTINGS)
        done = subprocess.run([PROGRAM, "attack", "--detector", named, "--data", FOLDER.data, "--out", runs[2], "--iterations", "4",
                               "--rooftop", "box", "--threads", "1", "--quiet"], capture_output=True, text=True)
        self.assertEqual(done.returncode, 0, done.stderr)
        first, *others = (mirage.read_mesh(os.path.join(run, "adversary.glb")) for run in runs)
        self.assertGreater(np.abs(first.vertices - mirage.icosphere().vertices).max(), 1e-3)
        for other in others:
            np.testing.assert_array_equal(other.vertices, first.vertices)
            np.testing.assert_array_equal(other.texels, first.texels)
        # Judged by itself, and by the callable: the same answers. A run of a program's is code, and must be named.
        judged = [mirage.evaluate(runs[1], detector=network, hosts="all", out=place("judged")) for network in (named, detector)]
        self.assertGreater(judged[0]["vehicles"], 0)
        for key in ("vehicles", "asr", "fn_asr", "fp_asr"):
            self.assertEqual(judged[0][key], judged[1][key])
        with self.assertRaisesRegex(mirage.InputError, "a program would be loaded, which is code.*--trust-run"):
            mirage.evaluate(runs[1])
        with self.assertRaisesRegex(mirage.InputError, "weights"):  # it goes on with the same program only
            program("same.py", "serve(detector)\n# another one\n")
            mirage.attack(detector=named, data=FOLDER.data, out=runs[1], iterations=5, copy=False, **SETTINGS)

    def test_every_command_takes_it(self):
        named = program("all.py", "serve(detector)\n")
        run = place("all")
        mirage.attack(detector=named, data=FOLDER.data, out=run, iterations=1, **SETTINGS)
        for words in (["detect", "--data", FOLDER.data, "--threads", "2"], ["view", "--run", run]):
            done = subprocess.run([PROGRAM, *words, "--detector", named, "--out", place("command"), "--quiet"],
                                  capture_output=True, text=True)
            self.assertEqual(done.returncode, 0, words[0] + done.stderr)
        done = subprocess.run([PROGRAM, "detect", "--data", FOLDER.data, "--detector", named, "--weights", "a.pt", "--out",
                               place("command")], capture_output=True, text=True)
        self.assertEqual(done.returncode, 2)
        self.assertIn("name the file in the command", done.stderr)

    def test_detect_asks_one_process_a_thread(self):
        named = program("several.py", f"""
            import os
            open({place("pids")!r}, "a").write(f"{{os.getpid()}}\\n")
            serve(detector)
        """)
        answers = []
        for threads in (1, 2):
            with open(place("pids"), "w"):
                pass
            done = subprocess.run([PROGRAM, "detect", "--data", FOLDER.data, "--detector", named, "--threads", str(threads),
                                   "--out", place("several"), "--kitti", place("several-kitti"), "--quiet"], capture_output=True, text=True)
            self.assertEqual(done.returncode, 0, done.stderr)
            with open(place("pids")) as file:
                self.assertEqual(len(set(file.read().split())), threads)
            with open(os.path.join(place("several"), "detections.json")) as file:
                answers.append([file.read(), sorted(os.listdir(place("several-kitti")))])
        self.assertEqual(answers[0], answers[1])

    def test_its_own_error_is_a_line(self):
        named = program("raises.py", "serve(lambda image, points, matrix: detector(image, points[:, :5], None))\n")
        done = subprocess.run([PROGRAM, "detect", "--data", FOLDER.data, "--detector", named, "--out", place("command")],
                              capture_output=True, text=True)
        self.assertEqual(done.returncode, 1)
        last = done.stderr.strip().splitlines()[-1]  # after the program's own trace
        self.assertRegex(last, "^mirage: exec:.*detect failed .*Error.*; look at what the program printed$")

    def test_a_run_that_ends_leaves_no_process(self):
        named = program("ends.py", f"open({place('pid')!r}, 'w').write(str(__import__('os').getpid()))\nserve(detector)\n")
        mirage.detect(detector=named, data=FOLDER.data, out=place("command"))
        with open(place("pid")) as file:
            self.assertFalse(os.path.exists(f"/proc/{file.read()}/stat"))


class Detect(unittest.TestCase):
    def test_figures_and_a_summary(self):
        told = []
        result = mirage.detect(detector=detector, data=FOLDER.data, out=place("detect"), progress=lambda *now: told.append(now))
        self.assertEqual(result["vehicles"], 4)
        self.assertGreaterEqual(result["found"], 1)
        self.assertGreater(result["ap70"], 0)
        self.assertIn("recall 0.7", str(result))
        self.assertNotIn("{", str(result))
        self.assertEqual(told[-1][:3], ("detect", 4, 4))
        seen = mirage.detect(detector=changed(lambda boxes, logits: (seven(boxes), logits)), data=FOLDER.data, out=place("detect"))
        self.assertEqual(seen["ap70"], result["ap70"])

    def test_forms_of_answers(self):
        plain = mirage.detect(detector=detector, data=FOLDER.data, out=place("detect"))
        length = torch.tensor([1.0, 0.0])  # a velocity

        def of_openpcdet(boxes, logits):
            boxes = torch.cat([seven(boxes), length.expand(len(boxes), 2)], 1)
            return [{"pred_boxes": boxes, "pred_scores": torch.sigmoid(logits), "pred_labels": torch.ones(len(boxes)).long()}]

        class Boxes:  # mmdetection3d's, by the centre of the bottom
            def __init__(self, boxes):
                self.gravity_center, self.tensor = boxes[:, :3], boxes.clone()
                self.tensor[:, 2] -= boxes[:, 5] / 2

        def of_mmdet3d(boxes, logits):
            found = {"bboxes_3d": Boxes(seven(boxes)), "scores_3d": torch.sigmoid(logits), "labels_3d": torch.zeros(len(boxes)).long()}
            return types.SimpleNamespace(pred_instances_3d=found)

        for form in (of_openpcdet, of_mmdet3d):
            result = mirage.detect(detector=changed(form), data=FOLDER.data, out=place("detect"))
            self.assertEqual((result["found"], round(result["ap70"], 5)), (plain["found"], round(plain["ap70"], 5)))

        def several(boxes, logits):
            return boxes, logits, torch.arange(len(boxes)) % 2

        with self.assertRaisesRegex(mirage.InputError, "classes: are not named"):
            mirage.detect(detector=changed(several), data=FOLDER.data, out=place("detect"))

        def by_name(frame):
            self.assertRegex(frame.id, "^00000[0-3]$")
            return detector(frame.images["camera"], frame.points["lidar"], frame.pixel_from_velo["camera"])

        self.assertEqual(mirage.detect(detector=by_name, data=FOLDER.data, out=place("detect"))["ap70"], plain["ap70"])
        mirage.attack(detector=by_name, data=FOLDER.data, out=place("by-name"), iterations=1, copy=False, **SETTINGS)

    def test_the_page_and_the_scenes(self):
        run = place("pages")
        mirage.attack(detector=detector, data=FOLDER.data, out=run, iterations=1, copy=False, **SETTINGS)
        page = mirage.view(run=run, detector=detector, out=place("page"))["page"]
        self.assertTrue(os.path.exists(os.path.join(place("page"), os.path.basename(page))))
        shown = mirage.view(FOLDER.data, out=place("page"), frames=1)._repr_html_()  # what a notebook has inline
        self.assertRegex(shown, '(?is)^<iframe srcdoc="&lt;!doctype html&gt;.*</iframe>$')
        self.assertNotIn("<script", shown)
        self.assertIsNone(mirage.detect(detector=detector, data=FOLDER.data, out=place("detect"))._repr_html_())
        self.assertGreater(mirage.export(run, frames=1)["scenes"], 0)

    @unittest.skipIf(shutil.which("blender") is None, "Blender is not installed")
    def test_a_verdict_without_a_copy(self):
        run = place("verdict")
        mirage.attack(detector=detector, data=FOLDER.data, out=run, iterations=1, copy=False, **SETTINGS)
        result = mirage.validate(run, detector=detector, frames=1, samples=4, threads=1)
        self.assertEqual(result["vehicles"], 1)
        self.assertTrue(os.path.exists(os.path.join(run, "validate", "report.html")))


class Reads(unittest.TestCase):
    """A detector declares its inputs, and gets no others."""

    def of_points(self, points):
        self.asked += 1
        return detector(torch.full((2, 2, 3), 0.15), points, torch.tensor([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]]))

    def setUp(self):
        self.asked = 0

    def test_points_alone(self):
        def named(image, points, pixel_from_velo):
            self.assertEqual(image.shape, (0, 0, 3))
            return self.of_points(points)

        named.reads = ("points",)
        runs = []
        for network in (named, lambda points: self.of_points(points)):
            runs.append(place(f"reads-{len(runs)}"))
            mirage.attack(detector=network, data=FOLDER.data, out=runs[-1], iterations=2, copy=False, **SETTINGS)
            with self.assertRaisesRegex(mirage.InputError, "target: image: .*does not read the picture"):
                mirage.attack(detector=network, data=FOLDER.data, out=place("reads-none"), target="image", copy=False)
            told = mirage.audit(detector=network, data=FOLDER.data, out=place("audit"))
            self.assertEqual(set(row["input"] for row in told["audit"]), {"points"})
            self.assertIn("no picture", str(told))
        first, second = (mirage.read_mesh(os.path.join(run, "adversary.glb")) for run in runs)
        np.testing.assert_array_equal(first.vertices, second.vertices)

    def test_an_evaluation_asks_once_a_frame_and_once_a_mesh(self):
        run = place("asked")
        network = lambda points: self.of_points(points)  # noqa: E731
        mirage.attack(detector=network, data=FOLDER.data, out=run, iterations=1, copy=False, **SETTINGS)
        self.asked = 0
        result = mirage.evaluate(run, detector=network, hosts="all", baseline="sized", random_meshes=2)
        self.assertEqual(self.asked, 4 + result["hosts"] * 3)

    def test_bytes_in_python_are_those_of_a_program(self):
        def of_bytes(image, points, pixel_from_velo):
            assert image.max() > 1 and (image == image.round()).all()
            return detector(image / 255, points, pixel_from_velo)

        of_bytes.pictures = "srgb8"
        named = program("bytes.py", """
            def of_bytes(image, points, pixel_from_velo):
                return detector(image / 255, points, pixel_from_velo)
            serve(of_bytes, pictures="srgb8")
        """)
        runs = [place("bytes-here"), place("bytes-there")]
        for run, network in zip(runs, (of_bytes, named)):
            mirage.attack(detector=network, data=FOLDER.data, out=run, iterations=2, copy=False, **SETTINGS)
        first, second = (mirage.read_mesh(os.path.join(run, "adversary.glb")) for run in runs)
        self.assertGreater(np.abs(first.texels - mirage.icosphere().texels).max(), 1e-3)
        np.testing.assert_array_equal(first.texels, second.texels)

    def test_what_no_detector_reads(self):
        def odd(image, points, pixel_from_velo):
            return detector(image, points, pixel_from_velo)

        odd.reads = ("nose",)
        with self.assertRaisesRegex(mirage.InputError, "nose: the frame has no such sensor"):
            mirage.detect(detector=odd, data=FOLDER.data, out=place("detect"))
        odd.reads, odd.region = ("points", "image"), (-np.inf, np.inf, -40, 40)
        with self.assertRaisesRegex(mirage.InputError, "region: .*four finite numbers"):
            mirage.detect(detector=odd, data=FOLDER.data, out=place("odd"))
        odd.region = (3, 1, 0, 1)
        with self.assertRaisesRegex(mirage.InputError, "region is "):
            mirage.detect(detector=odd, data=FOLDER.data, out=place("detect"))


class Local(unittest.TestCase):
    """A detector declares that it reuses results for unchanged data: the same answers at less cost."""

    def test_it_learns_the_same_mesh_by_fewer_points(self):
        runs, rows = [], []
        for local in (False, True):
            network = LocalDetector(local)
            runs.append(place(f"local-{local}"))
            mirage.attack(detector=network, data=FOLDER.data, out=runs[-1], iterations=6, copy=False, **SETTINGS)
            rows.append(network.rows)
        whole, local = (mirage.read_mesh(os.path.join(run, "adversary.glb")) for run in runs)
        self.assertGreater(np.abs(whole.vertices - mirage.icosphere().vertices).max(), 1e-3)
        np.testing.assert_allclose(local.vertices, whole.vertices, atol=1e-4)
        np.testing.assert_allclose(local.texels, whole.texels, atol=1e-3)
        self.assertLess(rows[1], 0.5 * rows[0])
        judged, rows = [], []
        for local in (False, True):
            network = LocalDetector(local)
            judged.append(mirage.evaluate(runs[0], detector=network, hosts="all", baseline="sized", random_meshes=6))
            rows.append(network.rows)
        for key in ("vehicles", "asr", "fn_asr", "fp_asr", "recall_iou"):
            self.assertEqual(judged[0][key], judged[1][key])
        self.assertLess(rows[1], 0.7 * rows[0])

    def test_as_a_program_it_is_the_same(self):
        named = program("local.py", """
            from support import LocalDetector
            serve(LocalDetector())
        """)
        runs = [place("local-here"), place("local-there")]
        for run, network in zip(runs, (LocalDetector(), named)):
            mirage.attack(detector=network, data=FOLDER.data, out=run, iterations=3, copy=False, **SETTINGS)
        first, second = (mirage.read_mesh(os.path.join(run, "adversary.glb")) for run in runs)
        np.testing.assert_array_equal(first.vertices, second.vertices)

    def test_what_gets_no_frame_knows_no_clean_one(self):
        network = lambda image, points, matrix: detector(image, points, matrix)  # noqa: E731
        network.local = True
        with self.assertRaisesRegex(mirage.InputError, "local: .*take one argument, frame"):
            mirage.detect(detector=network, data=FOLDER.data, out=place("detect"))


class Kept(unittest.TestCase):
    """Answers of a detector with a version are cached: an evaluation resumes, and another version asks anew."""

    def test_an_evaluation_goes_on(self):
        asked = []

        def network(points):
            asked.append(len(points))
            return detector(torch.full((2, 2, 3), 0.15), points, torch.tensor([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]]))

        run = place("kept")
        mirage.attack(detector=network, data=FOLDER.data, out=run, iterations=1, copy=False, **SETTINGS)

        def evaluated():
            asked.clear()
            return mirage.evaluate(run, detector=network, hosts="all", baseline="none"), len(asked)

        first, again = evaluated(), evaluated()
        self.assertEqual(first[1], again[1])  # without a version nothing is kept
        network.version = f"one {time.time_ns()}"  # of no test before, whose answers the cache may have
        whole, kept = evaluated(), evaluated()
        self.assertEqual((whole[1], kept[1]), (first[1], 0))
        for key in ("vehicles", "asr", "fn_asr", "fp_asr"):
            self.assertEqual(kept[0][key], first[0][key])
        network.version = f"two {time.time_ns()}"
        self.assertEqual(evaluated()[1], first[1])

    def test_the_gates_frames_are_asked_about_once(self):
        asked = []

        def network(frame):
            asked.append(frame.id)
            return detector(frame.images["camera"], frame.points["lidar"], frame.pixel_from_velo["camera"])

        run = place("gate")
        mirage.attack(detector=network, data=FOLDER.data, out=run, iterations=1, copy=False, **SETTINGS)
        asked.clear()
        result = mirage.evaluate(run, detector=network, hosts="all", baseline="none")
        # As recorded, with another picture, a black one and none, which it refuses; then once a mesh.
        self.assertEqual(len(asked), 4 * 4 + result["hosts"])


class Compare(unittest.TestCase):
    def test_two_networks_of_the_callers(self):
        def bold(image, points, pixel_from_velo):
            boxes, logits = detector(image, points, pixel_from_velo)
            return boxes, logits + 1

        run = place("compared")
        mirage.attack(detector=detector, data=FOLDER.data, out=run, iterations=1, copy=False, **SETTINGS)
        sphere = place("sphere.glb")
        mirage.icosphere().write(sphere)
        result = mirage.compare((detector, bold), data=FOLDER.data, runs=[run], mesh=[sphere], out=place("compare"), rooftop="box")
        self.assertEqual(result["compare"]["detectors"], ["python", "python:2"])
        self.assertIn("vehicles vanish under the second", str(result))
        self.assertTrue(os.path.exists(os.path.join(place("compare"), "result.json")))
        again = mirage.compare((bold, program("same.py", "serve(detector)\n")), data=FOLDER.data, mesh=sphere, out=place("compare"),
                               rooftop="box")
        self.assertEqual(len(again["compare"]["detectors"]), 2)


class Check(unittest.TestCase):
    def check(self, network, **settings):
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            result = mirage.check(network, FOLDER.data, out=place("check"), **settings)
        return result, printed.getvalue()

    def test_right_glue(self):
        result, printed = self.check(detector, vehicles=2)
        self.assertNotIn("looks wrong", printed)
        boxes, gradient = result["check"]["boxes"], result["check"]["gradient"]
        self.assertEqual(boxes["vehicles"], 4)
        self.assertAlmostEqual(boxes["length"], 3.9, 5)
        self.assertAlmostEqual(boxes["label_length"], 3.9, 5)
        self.assertLess(boxes["yaw"], 0.01)
        self.assertGreater(boxes["logit"], boxes["other_logit"])
        self.assertEqual(gradient["vehicles"], min(2, result["found"]))
        self.assertGreater(gradient["share"], 0)  # small: rays come and go within 1 cm, on a car of 450 returns
        self.assertLess(gradient["share"], 1.5)

    def test_wrong_glue_is_told_and_nothing_is_raised(self):
        wrong = {
            "length and width exchanged": lambda boxes, logits: (boxes[:, [0, 1, 3, 2, 4]], logits),
            "probabilities": lambda boxes, logits: (boxes, torch.sigmoid(logits)),
            "no box": lambda boxes, logits: (boxes[:0], logits[:0]),
            "axes read as": lambda boxes, logits: (boxes[:, [1, 0, 2, 3, 4]], logits),
            "shape \\[.*, 6\\]": lambda boxes, logits: (torch.cat([boxes, boxes[:, :1]], 1), logits),
            "in radians, not in degrees": lambda boxes, logits: (torch.cat([boxes[:, :4], boxes[:, 4:] + 90], 1), logits),
        }
        for hint, change in wrong.items():
            self.assertRegex(self.check(changed(change))[1], hint)
        result, printed = self.check(lambda image, points, matrix: 1 / 0)
        self.assertIsNone(result)
        self.assertEqual(printed, "ZeroDivisionError: division by zero\n")

    def test_a_gradient_that_is_not_the_networks(self):
        class Halved(torch.autograd.Function):
            @staticmethod
            def forward(ctx, logits):
                return logits.clone()

            @staticmethod
            def backward(ctx, d_logits):
                return 0.25 * d_logits

        whole = self.check(detector, vehicles=2)[0]["check"]["gradient"]
        quarter = self.check(changed(lambda boxes, logits: (boxes, Halved.apply(logits))), vehicles=2)[0]["check"]["gradient"]
        self.assertAlmostEqual(quarter["share"], whole["share"] / 4, 4)
        self.assertAlmostEqual(quarter["cosine"], whole["cosine"], 4)  # it points where it did
        self.assertGreater(whole["cosine"], 0)
        turned = self.check(changed(lambda boxes, logits: (boxes, 2 * logits.detach() - logits)), vehicles=2)[0]["check"]["gradient"]
        self.assertAlmostEqual(turned["cosine"], -whole["cosine"], 4)


class Frames(unittest.TestCase):
    def test_of_arrays_it_is_the_same(self):
        read = mirage.read_frame(FOLDER.data, "000001")
        label = read.labels[0]
        x, y, length, width, yaw = label.box_bev
        box = (x, y, label.bottom + label.height / 2, length, width, label.height, yaw)
        made = mirage.Frame(image=read.image, points=read.points, intrinsics=read.intrinsics,
                            camera_from_velo=read.camera_from_velo, labels=[("Car", box)])
        mesh = mirage.icosphere()
        mesh.texels[:] = 0.8
        one, other = (mirage.insert(frame, 0, mesh, rooftop="box") for frame in (read, made))
        self.assertGreater(one.adversary_pixels, 0)
        np.testing.assert_allclose(other.mask, one.mask, atol=1e-6)
        np.testing.assert_allclose(other.points, one.points, atol=1e-5)
        np.testing.assert_allclose(other.image, one.image, atol=1e-5)  # lit as the road says
        image, points, matrix = read.view()
        self.assertEqual((image.shape[2], points.shape[1], matrix.shape), (3, 4, (3, 4)))
        self.assertLess(len(points), len(read.points) + 1)

    def test_a_label_out_of_view_keeps_its_index(self):
        read = mirage.read_frame(FOLDER.data, "000001")
        label = read.labels[0]
        x, y, length, width, yaw = label.box_bev
        z = label.bottom + label.height / 2
        boxes = [(at, y, z, length, width, label.height, yaw) for at in (-30, x, x + 12)]
        made = mirage.Frame(image=read.image, points=read.points, intrinsics=read.intrinsics,
                            camera_from_velo=read.camera_from_velo, labels=[("Car", box) for box in boxes])
        self.assertEqual([round(one.box_bev[0], 6) for one in made.labels], [round(box[0], 6) for box in boxes])
        self.assertEqual((made.labels[0].truncated, made.labels[0].box_2d), (1, (0, 0, 0, 0)))
        found = [host.index for host in made.hosts(rooftop="box")]
        self.assertTrue(1 in found and 0 not in found, found)
        mesh = mirage.icosphere()
        one, other = (mirage.insert(frame, host, mesh, rooftop="box") for frame, host in ((read, 0), (made, 1)))
        np.testing.assert_allclose(other.mask, one.mask, atol=1e-6)
        np.testing.assert_allclose(other.points, one.points, atol=1e-5)
        self.assertEqual(mirage.insert(made, 0, mesh, rooftop="box").adversary_pixels, 0)

    def test_a_sweep_of_another_unit_is_refused_or_said(self):
        points = np.random.default_rng(3).uniform([5, -20, -1.6, 0], [40, 20, 1, 1], (3000, 4))
        given = {"image": np.full((75, 248, 3), 0.2), "points": points, "intrinsics": (144.0, 144.0, 122.0, 35.0),
                 "camera_from_velo": [[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0]]}
        with self.assertRaisesRegex(mirage.InputError, r"points: \d+\.\d % of them lie on a ray .* kitti64, which is assumed: .*rig="):
            mirage.Frame(**given).hosts()
        np.savez(place("arrays.npz"), **given)
        script = f"import mirage, numpy\nprint(mirage.Frame(**numpy.load({place('arrays.npz')!r}), rig='xenith').hosts())"
        done = subprocess.run([sys.executable, "-B", "-c", script], capture_output=True, text=True, check=True)
        self.assertEqual(done.stdout, "[]\n")
        self.assertRegex(done.stderr, r"% of them lie on a ray of the LiDAR of the rig xenith: another unit")

    def test_arrays_that_are_none(self):
        good = {"image": np.zeros((4, 5, 3)), "points": np.zeros((2, 4)), "intrinsics": (5.0, 5.0, 2.0, 2.0), "camera_from_velo": np.eye(4)[:3]}
        mirage.Frame(**good)
        label = ("Car", [0, 0, np.float32(8), 4, 2, 1.5, 0])
        self.assertEqual(len(mirage.Frame(**{**good, "intrinsics": (5, np.float32(5), 2, 2), "labels": [label],
                                             "rig": pathlib.Path("kitti64")}).labels), 1)
        for name, value, said in (("intrinsics", (0, 5, 2, 2), "not a camera"), ("intrinsics", (5, 5, np.nan, 2), "not a camera"),
                                  ("camera_from_velo", np.diag([1.0, 1, -1, 1])[:3], "rotation"),
                                  ("image", np.full((4, 5, 3), 200), "scene-linear"), ("points", np.zeros((2, 3)), "points"),
                                  ("points", np.full((2, 4), np.nan), "finite"),
                                  ("points", np.full((2, 4), 87.0), r"points: reflectance: 87 is not within \[0, 1\]"),
                                  ("camera_from_velo", 7 * np.eye(4)[:3], "rotation"),
                                  ("rig", "no-such-unit", "no-such-unit"), ("labels", [("Car", (1.0, 2.0, 3.0, -4.0, 5.0, 6.0, 0.0))], "labels")):
            with self.assertRaisesRegex(mirage.InputError, said):
                mirage.Frame(**{**good, name: value})

    def test_the_srgb_curve(self):
        linear = torch.linspace(1e-3, 0.999, 41, dtype=torch.float64, requires_grad=True)
        self.assertTrue(torch.autograd.gradcheck(mirage.torch.srgb, linear))
        self.assertAlmostEqual(float(mirage.torch.srgb(torch.tensor(0.5))), 0.735357, 5)
        edges = mirage.torch.srgb(torch.tensor([0.0, 1.0], requires_grad=True))
        np.testing.assert_allclose(edges.detach().numpy(), [0, 1], atol=1e-6)
        self.assertTrue(torch.isfinite(torch.autograd.grad(edges.sum(), edges)[0]).all())


BOUNDS, SIZE = [0.0, -8.0, -3.0, 25.6, 8.0, 1.0], [0.4, 0.4, 4.0]


class PillarNet(torch.nn.Module):
    """Shared by both mock-ups: PointPillars' first stage on hard voxels, and a box at each car."""

    def __init__(self):
        super().__init__()
        torch.manual_seed(1)
        self.linear = torch.nn.Linear(4, 8)

    def map_of(self, voxels, coordinates, counts):
        mask = torch.arange(voxels.shape[1])[None] < counts[:, None]
        features = (torch.tanh(self.linear(voxels[..., -4:])) * mask[..., None]).sum(1) / counts[:, None]
        grid = features.new_zeros(40 * 64, 8).index_put((coordinates[:, -2].long() * 64 + coordinates[:, -1].long(),), features)
        return torch.nn.functional.avg_pool2d(grid.t().reshape(1, 8, 40, 64), 5, 1, 2)

    def found(self, features):
        k = torch.arange(4.0)
        boxes = torch.stack([10 + k, 0.5 * k - 0.5, 0 * k - 0.98, 0 * k + 3.9, 0 * k + 1.6, 0 * k + 1.5, 0 * k], 1)
        cells = ((boxes[:, 1] + 8) / 0.4).long() * 64 + (boxes[:, 0] / 0.4).long()
        return boxes, 2 + features.reshape(8, -1)[:, cells].mean(0)


class OpenPCDetMock(torch.nn.Module):
    """Detector3DTemplate's interface: modules that hand a batch_dict on."""

    class Stage(torch.nn.Module):
        def __init__(self, work):
            super().__init__()
            self.work = work

        def forward(self, batch):
            return self.work(batch)

    def __init__(self):
        super().__init__()
        self.net = PillarNet()
        self.class_names = ["Pedestrian", "Car"]
        self.dataset = types.SimpleNamespace(
            point_cloud_range=np.array(BOUNDS), point_feature_encoder=types.SimpleNamespace(num_point_features=4),
            dataset_cfg={"DATA_PROCESSOR": [{"NAME": "mask_points_and_boxes_outside_range"},
                                            {"NAME": "transform_points_to_voxels", "VOXEL_SIZE": SIZE, "MAX_POINTS_PER_VOXEL": 32,
                                             "MAX_NUMBER_OF_VOXELS": {"train": 10, "test": 4000}}]})
        self.module_list = [self.Stage(self.vfe), self.Stage(self.head)]

    def vfe(self, batch):
        assert batch["batch_size"] == 1 and batch["points"].shape[1] == 5 and batch["voxel_coords"].shape[1] == 4
        x, y, self.brightest = batch["points"][:, 1], batch["points"][:, 2], float(batch["points"].detach()[:, 4].max())
        assert x.min() >= BOUNDS[0] and x.max() <= BOUNDS[3] and y.min() >= BOUNDS[1] and y.max() <= BOUNDS[4]
        batch["spatial_features"] = self.net.map_of(batch["voxels"], batch["voxel_coords"], batch["voxel_num_points"])
        return batch

    def head(self, batch):
        boxes, logits = self.net.found(batch["spatial_features"])
        batch["batch_box_preds"] = boxes[None]
        batch["batch_cls_preds"] = torch.stack([logits - 5, logits], 1)[None]
        batch["cls_preds_normalized"] = False
        return batch


class TwoStageMock(OpenPCDetMock):
    """With RoIHeadTemplate's second stage: one score a box, labels from 1 taken over from the proposals, and the batch filled up
    with proposals without a size."""

    FILLED = 3

    def __init__(self):
        super().__init__()
        self.module_list.append(self.Stage(self.roi_head))

    def roi_head(self, batch):
        boxes, logits = batch["batch_box_preds"][0], batch["batch_cls_preds"][0].max(1).values
        filled = boxes.new_zeros(self.FILLED, 7)
        batch["rois"] = torch.cat([boxes.detach(), filled])[None]
        batch["roi_labels"] = torch.cat([torch.full((len(boxes),), 2), torch.ones(self.FILLED).long()])[None]
        batch["has_class_labels"] = True
        batch["batch_box_preds"] = torch.cat([boxes, filled])[None]
        batch["batch_cls_preds"] = torch.cat([logits, logits.new_full((self.FILLED,), 9.0)])[None, :, None]
        return batch


class SeveralHeadsMock(OpenPCDetMock):
    """With AnchorHeadMulti's heads: scores and labels (from 1) of each, boxes of all in one."""

    def head(self, batch):
        boxes, logits = self.net.found(batch["spatial_features"])
        batch["batch_box_preds"] = torch.cat([boxes, boxes + torch.tensor([8.0, 0, 0, 0, 0, 0, 0])])[None]
        batch["batch_cls_preds"] = [logits[None, :, None], logits[None, :, None] - 9]
        batch["multihead_label_mapping"] = [torch.tensor([2]), torch.tensor([1])]
        return batch


class MMDet3DMock(torch.nn.Module):
    """VoxelNet's interface of mmdetection3d 1.x."""

    class Boxes:
        def __init__(self, tensor):
            self.tensor = tensor

        @property
        def gravity_center(self):
            centre = self.tensor[:, :3].clone()
            centre[:, 2] += self.tensor[:, 5] / 2
            return centre

    def __init__(self):
        super().__init__()
        self.net = PillarNet()
        self.dataset_meta = {"classes": ["Pedestrian", "Cyclist", "Car"]}
        layer = types.SimpleNamespace(point_cloud_range=BOUNDS, voxel_size=SIZE, max_num_points=32, max_voxels=(10, 4000))
        self.data_preprocessor = types.SimpleNamespace(voxel_layer=layer)
        self.bbox_head = types.SimpleNamespace()
        self.bbox_head = self.Head(self.net)

    class Head(torch.nn.Module):
        def __init__(self, net):
            super().__init__()
            self.net = net

        def forward(self, features):
            boxes, logits = self.net.found(features[0])
            return [logits], [boxes]

        def predict_by_feat(self, scores, boxes, batch_input_metas):
            assert batch_input_metas == [{"box_type_3d": "mock"}]
            tensor = boxes[0].clone()
            tensor[:, 2] -= tensor[:, 5] / 2
            labels = torch.full((len(tensor),), 2)
            return [types.SimpleNamespace(bboxes_3d=MMDet3DMock.Boxes(tensor), scores_3d=torch.sigmoid(scores[0]), labels_3d=labels)]

    def extract_feat(self, inputs):
        voxels = inputs["voxels"]
        assert voxels["coors"].shape[1] == 4 and voxels["coors"].dtype == torch.int32
        return [self.net.map_of(voxels["voxels"], voxels["coors"], voxels["num_points"])]


class Frameworks(unittest.TestCase):
    def test_voxels_are_those_of_a_loop(self):
        random = np.random.default_rng(2)
        points = torch.tensor(random.uniform([-2, -9, -4, 0], [8, 9, 2, 1], (500, 4)), dtype=torch.float64, requires_grad=True)
        voxels, coordinates, counts = voxels_of(points, BOUNDS, [2.0, 2.0, 4.0], 5, 30)
        found, order = {}, []
        for row in points.detach().numpy():
            at = tuple(int(k) for k in np.floor((row[:3] - BOUNDS[:3]) / [2.0, 2.0, 4.0]))
            if not all(0 <= k < most for k, most in zip(at, (13, 8, 1))):
                continue
            if at not in found:
                if len(found) == 30:
                    continue
                found[at] = []
                order.append(at)
            if len(found[at]) < 5:
                found[at].append(row)
        self.assertEqual([tuple(at) for at in coordinates.flip(1).tolist()], order)
        self.assertEqual(counts.tolist(), [len(found[at]) for at in order])
        for voxel, at in zip(voxels.detach().numpy(), order):
            np.testing.assert_array_equal(voxel[: len(found[at])], found[at])
            self.assertFalse(voxel[len(found[at]):].any())
        weights = torch.rand_like(voxels)
        gradient, = torch.autograd.grad((weights * voxels).sum(), points)
        self.assertAlmostEqual(float(gradient.sum()), float(weights[voxels.detach() != 0].sum()), 9)

    def test_axes_turn_there_and_back(self):
        points = torch.tensor([[3.0, 1, 2, 0.5]])
        np.testing.assert_allclose(turned(points, -math.pi / 2), [[-1, 3, 2, 0.5]], atol=1e-6)  # nuScenes: x right, y ahead
        boxes = torch.tensor([[3.0, 1, 0, 4, 2, 1.5, 0.3, 5, 1]])
        there = torch.cat([turned(boxes[:, :3], 0.7), boxes[:, 3:6], boxes[:, 6:7] - 0.7, turned(boxes[:, 7:9], 0.7)], 1)
        np.testing.assert_allclose(turned_back(there, 0.7), boxes, atol=1e-6)

    def test_attacks_on_both(self):
        for name, network in (("pcdet", mirage.openpcdet.wrap(OpenPCDetMock())),
                              ("two-stage", mirage.openpcdet.wrap(TwoStageMock())),
                              ("heads", mirage.openpcdet.wrap(SeveralHeadsMock())),
                              ("mmdet", mirage.mmdet3d.wrap(MMDet3DMock(), meta={"box_type_3d": "mock"}))):
            found = mirage.detect(detector=network, data=FOLDER.data, out=place("detect"))
            self.assertGreaterEqual(found["found"], 1, name)  # its four boxes overlap: one a frame survives
            result = mirage.attack(detector=network, data=FOLDER.data, out=place(name), iterations=2, copy=False, **SETTINGS)
            self.assertEqual(result["iterations"], 2)
            mesh = mirage.read_mesh(os.path.join(place(name), "adversary.glb"))
            self.assertGreater(np.abs(mesh.vertices - mirage.icosphere().vertices).max(), 1e-4, name)
            in_space = mirage.detect(detector=network, data=FOLDER.data, out=place("detect"), matching="3d")
            self.assertGreaterEqual(in_space["found"], 1, name)

    def test_every_box_has_the_label_that_the_framework_gives_it(self):
        points = torch.tensor(mirage.read_frame(FOLDER.data, "000001").points_in_view)
        for model, labels in ((OpenPCDetMock(), [1] * 4), (TwoStageMock(), [1] * 4), (SeveralHeadsMock(), [1] * 4 + [0] * 4)):
            boxes, logits, classes = mirage.openpcdet.wrap(model)(points)
            self.assertEqual(classes.tolist(), labels, type(model).__name__)
            self.assertEqual((len(boxes), len(logits)), (len(labels), len(labels)))
            self.assertGreater(float(boxes[:, 3:6].min()), 0)
        model = TwoStageMock()  # without labels of its own a box has its best column's
        model.module_list[-1].work = lambda batch: {**TwoStageMock.roi_head(model, batch), "has_class_labels": False}
        self.assertEqual(mirage.openpcdet.wrap(model)(points)[2].tolist(), [0] * 4)

    def test_reflectances_are_in_the_networks_unit(self):
        frame = mirage.read_frame(FOLDER.data, "000001")
        for wrap, unit in ((dict(), 1), (dict(intensity=255), 255)):
            model = OpenPCDetMock()
            mirage.openpcdet.wrap(model, **wrap)(torch.tensor(frame.points_in_view))
            self.assertAlmostEqual(model.brightest, 0.3 * unit, delta=1e-4 * unit)
        model, seen = MMDet3DMock(), []
        model.extract_feat = lambda inputs: seen.append(inputs["points"][0]) or MMDet3DMock.extract_feat(model, inputs)
        mirage.mmdet3d.wrap(model, intensity=255, meta={"box_type_3d": "mock"})(torch.tensor(frame.points_in_view))
        self.assertAlmostEqual(float(seen[0][:, 3].max()), 76.5, delta=0.03)

    def test_its_region_is_that_of_the_turned_bounds(self):
        x, y = torch.meshgrid(torch.tensor(BOUNDS)[[0, 3]], torch.tensor(BOUNDS)[[1, 4]], indexing="ij")
        corners = torch.stack([x.flatten(), y.flatten(), 0 * x.flatten(), 0 * x.flatten()], 1)
        for quarters in range(-4, 5):
            angle = quarters * math.pi / 2
            ours = turned(corners, -angle)  # what the network's axes call so
            expected = [ours[:, 0].min(), ours[:, 0].max(), ours[:, 1].min(), ours[:, 1].max()]
            for network in (mirage.openpcdet.wrap(OpenPCDetMock(), angle=angle),
                            mirage.mmdet3d.wrap(MMDet3DMock(), angle=angle, meta={})):
                np.testing.assert_allclose(network.region, expected, atol=1e-4)
        with self.assertRaisesRegex(mirage.InputError, "angle: 0.3 rad is not a quarter turn"):
            mirage.openpcdet.wrap(OpenPCDetMock(), angle=0.3)

    def test_points_that_are_drawn_by_chance_are_refused(self):
        model = OpenPCDetMock()
        model.dataset.dataset_cfg["DATA_PROCESSOR"].append({"NAME": "sample_points", "NUM_POINTS": {"train": 16384, "test": 16384}})
        with self.assertRaisesRegex(mirage.InputError, "draws 16384 points by chance.*NUM_POINTS to -1"):
            mirage.openpcdet.wrap(model)
        model.dataset.dataset_cfg["DATA_PROCESSOR"][-1]["NUM_POINTS"]["test"] = -1
        self.assertEqual(len(mirage.openpcdet.wrap(model).region), 4)

    def test_what_is_no_model(self):
        with self.assertRaisesRegex(mirage.InputError, "model: has no dataset"):
            mirage.openpcdet.wrap(torch.nn.Linear(1, 1))
        with self.assertRaisesRegex(mirage.InputError, "model: has no data_preprocessor"):
            mirage.mmdet3d.wrap(torch.nn.Linear(1, 1), meta={})


class Import(unittest.TestCase):
    def test_another_interpreter_is_told_what_to_do(self):
        package = os.path.dirname(mirage.__file__)
        elsewhere = place("elsewhere")
        shutil.copytree(package, os.path.join(elsewhere, "mirage"), symlinks=True, ignore=shutil.ignore_patterns("_core.cpython-*"))
        with open(os.path.join(elsewhere, "mirage", "_core.cpython-36m-x86_64-linux-gnu.so"), "w"):
            pass
        done = subprocess.run([sys.executable, "-c", "import mirage"], env={**os.environ, "PYTHONPATH": elsewhere},
                              capture_output=True, text=True)
        self.assertRegex(done.stderr.strip().splitlines()[-1],
                         r"^ImportError: mirage: is built for cpython-36m.*, and this is Python 3\..*make python PYTHON=")


if __name__ == "__main__":
    unittest.main()
