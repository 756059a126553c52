"""mirage.attack and mirage.evaluate against the caller's own network, and their run folder."""

import csv
import functools
import json
import os
import signal
import subprocess
import sys
import textwrap
import threading
import time
import types
import unittest
import warnings

try:
    import torch
except ImportError:
    print("skipped: PyTorch is not installed for this interpreter (Debian package python3-torch)")
    sys.exit(77)

import mirage
import numpy as np
from mirage._copy import write_copy
from mirage._detector import TorchDetector, content_of
from mirage._runs import _samples
from support import PROGRAM, Folder, detector

SETTINGS = {"iterations": 6, "rooftop": "box", "threads": 1}


class Pillars(torch.nn.Module):
    """PointPillars' first stage on a hard grid, with offsets to the pillars' centres; a box where each car may be."""

    CELL, SIDE = 1.6, 32

    def __init__(self):
        super().__init__()
        torch.manual_seed(3)
        self.point = torch.nn.Linear(5, 8)
        self.head = torch.nn.Linear(8, 2)

    def forward(self, image, points, pixel_from_velo):
        batch = {"points": points, "side": self.SIDE}  # of two types: TorchScript scripts none, and traces it
        column = (points[:, 0] / self.CELL).long().clamp(0, self.SIDE - 1)
        row = (points[:, 1] / self.CELL + self.SIDE / 2).long().clamp(0, self.SIDE - 1)
        x = points[:, 0] - (column + 0.5) * self.CELL
        y = points[:, 1] - (row + 0.5 - self.SIDE / 2) * self.CELL
        features = torch.relu(self.point(torch.cat([batch["points"][:, :3] / 20, x[:, None], y[:, None]], 1)))
        grid = features.new_zeros(batch["side"] ** 2, 8).index_add(0, row * self.SIDE + column, features)
        around = torch.nn.functional.avg_pool2d(torch.tanh(grid).t().reshape(1, 8, self.SIDE, self.SIDE), 3, 1, 1)
        k = torch.arange(4)
        cell = ((k * 0.5 - 0.5) / self.CELL + self.SIDE / 2).long() * self.SIDE + ((10 + k) / self.CELL).long()
        found = self.head(around.reshape(8, -1).t()[cell])
        boxes = torch.stack([10.0 + k, 0.5 * k - 0.5, 0 * k + 3.9, 1.6 + 0.1 * torch.tanh(found[:, 1]), 0.0 * k], 1)
        return boxes, 3 + found[:, 0] + image.mean()


def setUpModule():
    global FOLDER, RUN, RESULT
    FOLDER = Folder(4)
    RUN = os.path.join(FOLDER.path, "run")
    RESULT = mirage.attack(detector=detector, data=FOLDER.data, out=RUN, **SETTINGS)


def tearDownModule():
    FOLDER.remove()


def place(name):
    return os.path.join(FOLDER.path, name)


def command_line(*arguments):
    return subprocess.run([PROGRAM, *arguments, "--quiet"], capture_output=True, text=True)


def losses(run):
    with open(os.path.join(run, "loss.csv")) as file:
        return [float(row["loss"]) for row in csv.DictReader(file)]


class Attack(unittest.TestCase):
    def test_the_run_is_one(self):
        self.assertEqual(RESULT["iterations"], 6)
        found = RESULT["found_clean"]
        self.assertGreater(found["found"], 0)
        self.assertEqual(found["vehicles"], RESULT["vehicles_train"])
        self.assertEqual(RESULT["vehicles_train"] + RESULT["vehicles_test"], 4)
        for name in ("run.json", "checkpoint.json", "adversary.glb", "random.glb", "loss.csv", "result.json", "detector.pt"):
            self.assertTrue(os.path.exists(os.path.join(RUN, name)), name)
        self.assertEqual(mirage.read_mesh(os.path.join(RUN, "adversary.glb")).vertices.shape, (162, 3))

    def test_it_learns(self):
        run = place("learns")
        mirage.attack(detector=detector, data=FOLDER.data, out=run, copy=False, **dict(SETTINGS, iterations=15, batch=3,
                      parts="texture", texel_rate=4e-2))
        loss = losses(run)
        self.assertLess(sum(loss[-5:]), sum(loss[:5]))
        self.assertFalse(os.path.exists(os.path.join(run, "detector.pt")))

    def test_stopped_and_resumed_it_is_the_same_bits(self):
        run = place("resumed")
        for iterations in (2, 6):
            mirage.attack(detector=detector, data=FOLDER.data, out=run, copy=False, **dict(SETTINGS, iterations=iterations))
        self.assertEqual(losses(run), losses(RUN))

    def test_it_goes_on_with_the_same_network_only(self):
        net = torch.nn.Linear(1, 1)
        torch.nn.init.ones_(net.weight)
        torch.nn.init.zeros_(net.bias)

        def other(image, points, pixel_from_velo):
            boxes, logits = detector(image, points, pixel_from_velo)
            return boxes, net(logits[:, None])[:, 0]

        run = place("another")
        mirage.attack(detector=other, data=FOLDER.data, out=run, copy=False, **dict(SETTINGS, iterations=1))
        net.weight.data *= 1.5
        with self.assertRaisesRegex(mirage.InputError, "weights"):
            mirage.attack(detector=other, data=FOLDER.data, out=run, copy=False, **dict(SETTINGS, iterations=2))

    def test_a_number_in_its_code_is_of_the_network(self):
        def doubled(boxes, logits):
            return boxes, logits * 2

        def tripled(boxes, logits):
            return boxes, logits * 3

        contents = [content_of(f) for f in (doubled, tripled, lambda *inputs: doubled(*inputs), lambda *inputs: tripled(*inputs))]
        self.assertEqual(len(set(contents)), 4)
        self.assertEqual(content_of(doubled), contents[0])

    def test_all_that_it_works_with_is_of_the_network(self):
        class Listed:
            def __init__(self, seed=0, top=10, **more):
                generator = torch.Generator().manual_seed(seed)
                self.layers, self.top, self.config = [(torch.randn(2, 2, generator=generator), 0.5)], top, {"best": (1, {"of": np.zeros(2)})}
                self.__dict__.update(more)

            def boxes(self, points):
                return points

            def __call__(self, points):
                return self.boxes(points)

        class Other(Listed):
            def boxes(self, points):
                return points + 1

        class Module(torch.nn.Module):
            def __init__(self, gain):
                super().__init__()
                self.inner, self.gain = torch.nn.ReLU(), gain

            def forward(self, points):
                return self.gain * points

        def of(gain):
            return lambda points: gain * points

        Other.__qualname__ = Listed.__qualname__
        different = [Listed(), Listed(seed=1), Listed(top=11), Listed(config={"best": (1, {"of": np.ones(2)})}), Other(), Listed().boxes,
                     Module(1.0), Module(2.0), torch.nn.Sequential(Module(1.0)), torch.nn.Sequential(Module(2.0)), of(1), of(2),
                     functools.partial(of(1), 3), functools.partial(of(1), 4), torch.jit.script(torch.nn.ReLU()),
                     torch.jit.script(torch.nn.Tanh()), Listed(version="1"), Listed(version="2")]
        contents = [content_of(one) for one in different]
        self.assertEqual(len(set(contents)), len(contents), contents)
        self.assertEqual([content_of(one) for one in different], contents)
        # Attributes that change from call to call do not count: with an underscore, or any beside a version.
        for same, changed in ((Listed(), Listed(_calls=3)), (Listed(version="1"), Listed(version="1", calls=3))):
            self.assertEqual(content_of(same), content_of(changed))

    def test_weights_are_found_wherever_its_code_reaches_them(self):
        """Each text defines f, and what stands beside it changes what f works with."""
        module = f"""
            import torch
            NET, GAIN, _asked = torch.nn.Linear(1, 1), [1.0], [0]
            def scaled(points):
                return GAIN[0] * points
            """
        os.makedirs(place("users_nets"))
        for name, text in (("users_net.py", module), ("users_nets/__init__.py", ""), ("users_nets/inner.py", module)):
            with open(place(name), "w") as file:
                file.write(textwrap.dedent(text))
        sys.path.insert(0, FOLDER.path)
        self.addCleanup(sys.path.remove, FOLDER.path)
        net = "NET = torch.nn.Linear(1, 1)\n"
        moved = "NET.weight.data += 1"
        texts = {
            "a module's": ("import users_net\ndef f(points): return users_net.NET(points)", "users_net.NET.weight.data += 1"),
            "an alias": ("import users_nets.inner as n\ndef f(points): return n.NET(points)", "n.NET.weight.data += 1"),
            "a package's": ("import users_nets.inner\ndef f(points): return users_nets.inner.NET(points)",
                            "users_nets.inner.NET.bias.data += 1"),
            "a module's function's": ("import users_net\ndef f(points): return users_net.scaled(points)", "users_net.GAIN[0] += 1"),
            "an inner function": (net + "def f(points):\n    def g(p):\n        return NET(p)\n    return g(points)", moved),
            "a lambda": (net + "def f(points): return (lambda p: NET(p))(points)", moved),
            "a comprehension": (net + "def f(points): return [NET(p) for p in points]", moved),
            "within within": (net + "def f(points): return [(lambda q: NET(q))(p) for p in points]", moved),
            "a class": ("class C:\n    gain = 1.0\ndef f(points): return C.gain * points", "C.gain = 2.0"),
            "a cached one": (net + "@functools.lru_cache\ndef made(): return NET\ndef f(points): return made()(points)", moved),
            "settings": ("s = types.SimpleNamespace(gain=1.0)\ndef f(points): return s.gain * points", "s.gain = 2.0"),
            "a buffer": ("class N(torch.nn.Module):\n    def __init__(self):\n        super().__init__()\n"
                         "        self.register_buffer('anchors', torch.zeros(2), persistent=False)\n"
                         "    def forward(self, points): return points\nf = torch.nn.Sequential(N())", "f[0].anchors += 1"),
            "slots": ("class B:\n    __slots__ = 'gain'\nclass S(B):\n    __slots__ = ('net', '__hidden')\n"
                      "    def __init__(self): self.net, self.gain = torch.nn.Linear(1, 1), 1.0\n"
                      "    def __call__(self, points): return self.net(points)\nf = S()", "f.net.weight.data += 1"),
            "another slot": ("class B:\n    __slots__ = 'gain'\nclass S(B):\n    __slots__ = ()\n"
                             "    def __call__(self, points): return self.gain * points\nf = S()\nf.gain = 1.0", "f.gain = 2.0"),
        }
        for name, (text, change) in texts.items():
            space = {"__name__": "users", "torch": torch, "functools": functools, "types": types}
            exec(text, space)
            before = content_of(space["f"])
            self.assertEqual(content_of(space["f"]), before, name)
            exec(change, space)
            self.assertNotEqual(content_of(space["f"]), before, name)
        # Of another one's module nothing is looked at that the code does not name, and of what it names nothing with an underscore.
        space = {"__name__": "users"}
        exec("import users_net\ndef f(points):\n    users_net._asked[0] += 1\n    return users_net.scaled(points)", space)
        before = content_of(space["f"])
        exec("users_net._asked[0] += 1\nusers_net.NET.weight.data += 1", space)
        self.assertEqual(content_of(space["f"]), before)

    def test_errors(self):
        def attack(function, **settings):
            mirage.attack(detector=function, data=FOLDER.data, out=place("wrong"), **dict(SETTINGS, **settings))

        with self.assertRaisesRegex(mirage.InputError, "mirage.attack: iteratons: unknown setting; did you mean iterations"):
            attack(detector, iteratons=3)
        with self.assertRaisesRegex(mirage.InputError, "target"):
            attack(detector, target="nose")
        with self.assertRaisesRegex(mirage.InputError, "nowhere"):
            mirage.attack(detector=detector, data="nowhere", out=place("wrong"))
        with self.assertRaisesRegex(mirage.InputError, "boxes: have shape"):
            attack(lambda i, p, m: (torch.zeros(3, 6), torch.zeros(3)))
        with self.assertRaisesRegex(mirage.InputError, "differentiable"):
            attack(lambda i, p, m: tuple(t.detach() for t in detector(i, p, m)))

        def with_boxes(change):
            def other(image, points, pixel_from_velo):
                boxes, logits = detector(image, points, pixel_from_velo)
                return change(boxes), logits
            return other

        with self.assertRaisesRegex(mirage.InputError, "finds none of the .* would be found with length and width exchanged"):
            attack(with_boxes(lambda boxes: boxes[:, [0, 1, 3, 2, 4]]))
        with self.assertRaisesRegex(mirage.InputError, "box 0 of .*length -3.9 m.*positive"):
            attack(with_boxes(lambda boxes: boxes * torch.tensor([1, 1, -1, 1, 1.0])))
        with self.assertRaisesRegex(mirage.InputError, "takes 2 arguments"):
            attack(lambda i, p: None)
        with self.assertRaisesRegex(ZeroDivisionError, "division"):  # the caller's own, as it is
            attack(lambda i, p, m: 1 / 0)

    def test_ctrl_c_stops_it_with_a_checkpoint(self):
        run = place("stopped")

        def slow(image, points, pixel_from_velo):
            time.sleep(0.05)
            return detector(image, points, pixel_from_velo)

        timer = threading.Timer(1.5, os.kill, (os.getpid(), signal.SIGINT))
        timer.start()
        with self.assertRaises(KeyboardInterrupt):
            mirage.attack(detector=slow, data=FOLDER.data, out=run, copy=False, **dict(SETTINGS, iterations=10000))
        timer.join()
        self.assertGreater(len(losses(run)), 0)
        with self.assertRaises(KeyboardInterrupt):  # Python's own handler is back
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(1)


class Evaluate(unittest.TestCase):
    def test_by_callable_by_copy_and_on_the_command_line(self):
        by_callable = mirage.evaluate(RUN, detector=detector, hosts="all")
        self.assertGreater(by_callable["vehicles"], 0)
        self.assertTrue(os.path.exists(os.path.join(RUN, "evaluate", "result.json")))
        by_copy = mirage.evaluate(RUN, out=place("by-copy"), hosts="all")
        done = command_line("evaluate", "--run", RUN, "--out", place("by-command"), "--hosts", "all")
        self.assertEqual(done.returncode, 0, done.stderr)
        with open(os.path.join(place("by-command"), "result.json")) as file:
            by_command = json.load(file)
        self.assertEqual(by_command["detector"], "torchscript")
        for key in ("vehicles", "asr", "fn_asr", "fp_asr"):
            self.assertEqual(by_callable[key], by_copy[key], key)
            self.assertEqual(by_callable[key], by_command[key], key)

    def test_without_a_copy_the_command_line_says_what_to_do(self):
        run = place("no-copy")
        mirage.attack(detector=detector, data=FOLDER.data, out=run, copy=False, **dict(SETTINGS, iterations=1))
        done = command_line("evaluate", "--run", run, "--out", place("none"))
        self.assertEqual(done.returncode, 2)
        self.assertIn("mirage.evaluate", done.stderr)
        self.assertIn("--detector", done.stderr)
        self.assertEqual(len(done.stderr.strip().splitlines()), 1)

    def test_a_network_that_has_no_copy_warns(self):
        def stubborn(image, points, pixel_from_velo):
            boxes, logits = detector(image, points, pixel_from_velo)
            return boxes, logits + (1.0 if float(points.sum()) > 1e9 else 0.001 * len(points))

        with self.assertWarnsRegex(UserWarning, "no TorchScript copy"):
            mirage.attack(detector=stubborn, data=FOLDER.data, out=place("stubborn"), **dict(SETTINGS, iterations=1))

    def test_a_copy_is_what_the_network_says_of_itself(self):
        class Points(torch.nn.Module):
            region = (0.0, 50.0, -20.0, 20.0)

            def __init__(self, columns=5, **attributes):
                super().__init__()
                self.head, self.columns = torch.nn.Linear(4, 6), columns
                for name, value in attributes.items():
                    setattr(self, name, value)

            def forward(self, points):
                found = self.head(points[:50])
                return torch.cat([points[:50, :2], 1 + found[:, 2:5].sigmoid(), found[:, :2]], 1)[:, : self.columns], found[:, 5]

        def why(function, name):
            return write_copy(TorchDetector(function), _samples(FOLDER.data), place(name))

        network = Points().eval()
        for name, function in (("module", network), ("function", lambda points: network(points))):
            self.assertEqual(why(function, name + ".pt"), "", name)
        self.assertEqual(list(torch.jit.load(place("module.pt")).region), list(Points.region))
        self.assertRegex(why(Points(pictures="srgb8").eval(), "srgb8.pt"), "pictures are srgb8")
        self.assertRegex(why(Points(columns=7).eval(), "wide.pt"), "7 columns")
        self.assertFalse(os.path.exists(place("wide.pt")) or os.path.exists(place("srgb8.pt")))

    def test_why_there_is_no_copy_is_said_in_pytorchs_own_words(self):
        def counts(image, points, pixel_from_velo):  # a trace freezes the number of points
            boxes, logits = detector(image, points, pixel_from_velo)
            return boxes, logits + (points[:, 3] * torch.arange(len(list(points)))).sum() * 1e-9

        with self.assertWarnsRegex(UserWarning, r"torch\.jit\.trace: RuntimeError: The size of tensor a \(\d+\) must match"):
            mirage.attack(detector=counts, data=FOLDER.data, out=place("counts"), **dict(SETTINGS, iterations=1))

    def test_a_traced_pillar_network_runs_as_pytorch_runs_it(self):
        network = Pillars().eval()
        run = place("pillars")
        with warnings.catch_warnings():
            warnings.simplefilter("error", UserWarning)
            mirage.attack(detector=network, data=FOLDER.data, out=run, **dict(SETTINGS, iterations=3))
        copy = os.path.join(run, "detector.pt")
        asked = ["--data", FOLDER.data, "--detector", "torchscript", "--weights", copy, "--threads", "1"]
        done = command_line("detect", *asked, "--out", place("pillars-detect"))
        self.assertEqual(done.returncode, 0, done.stderr)
        # Its gradient is PyTorch's: three steps lead to the same mesh.
        again = place("pillars-by-copy")
        done = command_line("attack", *asked, "--rooftop", "box", "--iterations", "3", "--out", again)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertEqual(len(losses(run)), 3)
        np.testing.assert_allclose(losses(again), losses(run), rtol=1e-5)
        meshes = [mirage.read_mesh(os.path.join(of, "adversary.glb")) for of in (run, again)]
        self.assertGreater(np.abs(meshes[0].vertices - mirage.icosphere().vertices).max(), 1e-3)
        for name in ("vertices", "texels"):
            np.testing.assert_allclose(getattr(meshes[1], name), getattr(meshes[0], name), atol=1e-5)

    def test_export_reads_the_run(self):
        done = command_line("export", "--run", RUN, "--frames", "1", "--out", place("export"))
        self.assertEqual(done.returncode, 0, done.stderr)

    def test_a_module_and_boxes_in_the_picture(self):
        class Pictures(torch.nn.Module):
            def __init__(self):
                super().__init__()
                self.gain = torch.nn.Parameter(torch.tensor(5.0))

            def forward(self, image):
                logits = 3 + self.gain * (image[20:60, 90:150].mean() - 0.05)
                return torch.tensor([[90.0, 20.0, 150.0, 60.0]]), logits[None]

        run = place("pictures")
        mirage.attack(detector=Pictures().eval(), data=FOLDER.data, out=run, **dict(SETTINGS, iterations=2, target="image"))
        self.assertTrue(os.path.exists(os.path.join(run, "detector.pt")))
        self.assertEqual(mirage.evaluate(run, detector=Pictures().eval(), hosts="all")["plane"], "picture")

    def test_another_pytorch_keeps_the_shipped_detectors_out(self):
        code = textwrap.dedent(f"""
            import sys, types
            sys.modules["torch"] = types.SimpleNamespace(__version__="9.9.0")
            import mirage
            try:
                mirage.evaluate({RUN!r})
            except mirage.Failure as problem:
                print(problem)""")
        told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
        self.assertIn("PyTorch 9.9.0", told)


if __name__ == "__main__":
    unittest.main()
