"""Scripts that people copy from: the acceptance script, the examples of the package and its notebook."""

import json
import os
import subprocess
import sys
import types
import unittest

try:
    import torch  # noqa: F401
except ImportError:
    print("skipped: PyTorch is not installed for this interpreter (Debian package python3-torch)")
    sys.exit(77)

import mirage
import numpy as np
from support import EXAMPLES, PROGRAM, Folder, example


def setUpModule():
    global FOLDER
    FOLDER = Folder(4)


def tearDownModule():
    FOLDER.remove()


def run(*arguments):
    done = subprocess.run([sys.executable, "-B", *arguments], capture_output=True, text=True, cwd=FOLDER.path)
    if done.returncode:
        raise AssertionError(done.stdout + done.stderr)
    return done.stdout


class Scripts(unittest.TestCase):
    def test_a_script_that_knows_the_issues_text_alone(self):
        script = os.path.join(os.path.dirname(os.path.abspath(__file__)), "acceptance.py")
        told = run(script, FOLDER.data, "000000", FOLDER.path, os.path.abspath(PROGRAM))
        self.assertIn("accepted", told)

    def test_a_pillar_network_that_learned_little_is_refused(self):
        out = os.path.join(FOLDER.path, "pillars")
        with self.assertRaisesRegex(AssertionError, "finds none of the 3 vehicles as recorded"):
            run(os.path.join(EXAMPLES, "attack_pillars.py"), FOLDER.data, out, "--training", "3", "--iterations", "2")

    def test_the_table_beside_pytorch3d(self):
        self.assertIn("| 64×64 |", run(os.path.join(EXAMPLES, "pytorch3d_table.py"), "--sizes", "64", "--repeats", "1"))

    def test_stored_boxes_stand_where_labels_do(self):
        sys.path.insert(0, os.path.join(os.environ["MIRAGE_SOURCE"], "plugins", "process"))
        stored = example("stored_boxes")
        os.makedirs(os.path.join(FOLDER.path, "training", "calib"), exist_ok=True)
        with open(os.path.join(FOLDER.path, "training", "calib", "0003.txt"), "w") as file:
            file.write("R_rect 1 0 0 0 1 0 0 0 1\nTr_velo_cam 0 -1 0 0 0 0 -1 0 1 0 0 -0.27\n")
        with open(os.path.join(FOLDER.path, "0003.txt"), "w") as file:
            file.write("6,2,0,0,9,9,1.5,1.4,1.6,3.9,0,1.7,10,0,0\n7,2,0,0,9,9,2.5,1.4,1.6,3.9,-2,1.7,20,-1.5707963,0\n")
        frame = types.SimpleNamespace(moment={"sequence": "0003", "index": 7})
        boxes, logits = stored.StoredBoxes(FOLDER.path, FOLDER.path)(frame)
        np.testing.assert_allclose(boxes, [[20.27, 2, -1, 3.9, 1.6, 1.4, 0]], atol=1e-5)
        np.testing.assert_allclose(logits, [2.5])

    def test_the_notebook_runs_headless(self):
        with open(os.path.join(EXAMPLES, "first_steps.ipynb")) as file:
            cells = json.load(file)["cells"]
        os.environ["MIRAGE_EXAMPLE_DATA"] = FOLDER.data
        again = os.path.join(FOLDER.path, "again.ipynb")
        run(os.path.join(os.environ["MIRAGE_SOURCE"], "src/guide/notebook.py"), os.path.join(EXAMPLES, "first_steps.ipynb"), again)
        with open(again) as file:
            fresh = json.load(file)["cells"]
        for kept, new in zip(cells, fresh):  # of another frame, but of the same kinds; small
            self.assertEqual(kept["source"], new["source"])
            kinds = [[(out["output_type"], *out.get("data", ())) for out in cell.get("outputs", ())] for cell in (kept, new)]
            self.assertEqual(kinds[0], kinds[1], "run src/guide/notebook.py over it")
        self.assertGreater(sum(len(cell.get("outputs", ())) for cell in cells), 4)
        self.assertLess(os.path.getsize(os.path.join(EXAMPLES, "first_steps.ipynb")), 1 << 20)


def made_up_weights(folder):
    """Of the published networks' layout, with random values: (Point-GNN's, CLOCs', the picture network's) files."""
    random = np.random.default_rng(5)
    sizes = {"layer1/extract_vertex_features": (4, 8, 16), "layer1/combined_features": (16, 16), "output/predictor/cls": (16, 8, 4),
             "output/predictor/loc/cls_1": (16, 7), "output/predictor/loc/cls_2": (16, 7)}
    arrays = {}
    for scope, widths in sizes.items():
        for k, (before, after) in enumerate(zip(widths, widths[1:])):
            name = f"{scope}/fully_connected" + (f"_{k}" if k else "")
            arrays[f"{name}/weights"] = random.normal(0, 0.5, (before, after)).astype(np.float32)
            arrays[f"{name}/biases"] = random.normal(0, 0.1, after).astype(np.float32)
    arrays = {name: 0.05 * array if "/loc/" in name else array for name, array in arrays.items()}
    fusion = {}
    for k, (before, after) in zip((0, 2, 4, 6), ((4, 6), (6, 6), (6, 6), (6, 1))):
        fusion[f"fuse_2d_3d.{k}.weight"] = abs(random.normal(0, 0.5, (after, before, 1, 1))).astype(np.float32)
        fusion[f"fuse_2d_3d.{k}.bias"] = np.zeros(after, np.float32)

    class Photographs(torch.nn.Module):
        def forward(self, batch: torch.Tensor):
            assert batch.size(2) % 32 == 0 and batch.size(3) % 32 == 0
            boxes = torch.tensor([[100.0, 20.0, 160.0, 70.0], [102.0, 20.0, 161.0, 70.0], [0.0, 0.0, 300.0, 90.0]])
            return boxes, batch[0, 0, 20, 100:103] / 60 - 1

    files = [os.path.join(folder, name) for name in ("lidar.npz", "fusion.npz", "picture.pt")]
    np.savez(files[0], **arrays)
    np.savez(files[1], **fusion)
    torch.jit.script(Photographs()).save(files[2])
    return files


class Published(unittest.TestCase):
    def setUp(self):
        self.published = example("published")
        self.lidar, self.fusion, self.picture = made_up_weights(FOLDER.path)
        self.frame = mirage.read_frame(FOLDER.data, "000001")

    def asked(self, network, points, image=None):
        """(boxes, logits, gradient to the points, to the picture) of a network on the frame's picture and these points."""
        inputs = [torch.tensor(array).requires_grad_() for array in (self.frame.image if image is None else image, points)]
        boxes, logits = network(*inputs, torch.tensor(self.frame.pixel_from_velo))
        gradients = torch.autograd.grad(logits.sigmoid().sum(), inputs, allow_unused=True)
        return boxes.detach().numpy(), logits.detach().numpy(), gradients[1], gradients[0]

    def test_what_is_kept_of_a_sweep_changes_no_answer(self):
        clean = self.frame.points_in_view
        added = np.array([[11, 0, 0.2, 0.4]], np.float32) + np.random.default_rng(1).random((60, 4), np.float32) * 0.3
        attacked = np.concatenate([clean, added])
        seen = self.published.PointGnn(self.lidar)
        self.asked(seen, clean)
        before = len(seen.known)
        boxes, logits, gradient, _ = self.asked(seen, attacked)
        self.assertLess(len(seen.known) - before, before / 2)  # the others stand as they were
        whole = self.asked(self.published.PointGnn(self.lidar), attacked)
        np.testing.assert_allclose(boxes, whole[0], atol=1e-4)
        np.testing.assert_allclose(logits, whole[1], atol=1e-4)
        own = slice(len(clean), None)
        self.assertGreater(float(gradient[own].abs().max()), 1e-5)
        np.testing.assert_allclose(gradient[own], whole[2][own], rtol=1e-3, atol=1e-5)

    def test_pairs_and_keypoints_are_those_of_a_loop(self):
        points = np.random.default_rng(2).uniform(0, 3, (80, 3)).astype(np.float32)
        point, centre = self.published.pairs_within(0.7, points, points[:20])
        near = np.linalg.norm(points[None] - points[:20, None], axis=2) <= 0.7
        self.assertEqual(sorted(zip(centre, point)), list(zip(*np.nonzero(near))))
        self.assertTrue((np.diff(centre) >= 0).all())
        cell = np.floor((points - (points.min(0) - 0.5)) / 1.0).astype(int)
        means = [points[(cell == c).all(1)].mean(0) for c in np.unique(cell, axis=0)]
        self.assertEqual(list(self.published.keypoints_of(points, 1.0)), [np.square(points - m).sum(1).argmin() for m in means])

    def test_fusion_takes_the_best_of_its_pairs(self):
        fused = self.published.Clocs(self.fusion, self.published.PointGnn(self.lidar), self.published.Picture(self.picture))
        boxes, logits, d_points, d_image = self.asked(fused, self.frame.points_in_view)
        alone = self.asked(fused, self.frame.points_in_view, np.zeros((0, 0, 3), np.float32))
        np.testing.assert_array_equal(boxes, alone[0])
        self.assertTrue((logits >= alone[1]).all() and (logits > alone[1]).any())
        self.assertGreater(float(d_image.abs().max()), 0)
        self.assertGreater(float(d_points.abs().max()), 0)

    def test_in_this_python_and_as_a_program(self):
        command = f"exec:{sys.executable} -B {os.path.join(EXAMPLES, 'published.py')}"
        lidar = self.published.PointGnn(self.lidar)
        for network, words in ((lidar, f"point-gnn {self.lidar}"), (self.published.Picture(self.picture), f"picture {self.picture}"), (
                self.published.Clocs(self.fusion, lidar, self.published.Picture(self.picture)),
                f"clocs {self.lidar} {self.picture} {self.fusion}")):
            here, there = (mirage.detect(detector=d, data=FOLDER.data, frames=2, out=os.path.join(FOLDER.path, "detect"))
                           for d in (network, f"{command} {words}"))
            for key in ("vehicles", "ap50", "ap70", "found"):
                self.assertEqual(here[key], there[key])

    def test_weights_of_a_graph_are_refused(self):
        file = os.path.join(FOLDER.path, "graph.npz")
        np.savez(file, **dict(np.load(self.lidar)), **{"layer2/extract_vertex_features/fully_connected/weights": np.zeros((4, 4))})
        with self.assertRaisesRegex(ValueError, "without graph layers"):
            self.published.PointGnn(file)


if __name__ == "__main__":
    unittest.main()
