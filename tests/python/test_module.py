"""The package without PyTorch: frames, meshes, insertions and their parts, errors."""

import os
import shutil
import subprocess
import sys
import unittest

import mirage
import numpy as np
from support import HEIGHT, WIDTH, Folder


def setUpModule():
    global FOLDER, FRAME, HOST
    FOLDER = Folder(2)
    FRAME = mirage.read_frame(FOLDER.data, "000000")
    HOST = FRAME.hosts()[0]


def tearDownModule():
    FOLDER.remove()


class Lend:
    """Anything with __dlpack__, and nothing else."""

    def __init__(self, array):
        self.array = array

    def __dlpack__(self, stream=None):
        return self.array.__dlpack__()

    def __dlpack_device__(self):
        return self.array.__dlpack_device__()


class Frames(unittest.TestCase):
    def test_what_a_frame_holds(self):
        self.assertEqual((FRAME.image.shape, FRAME.image.dtype), ((HEIGHT, WIDTH, 3), np.float32))
        self.assertEqual((FRAME.points.shape[1], FRAME.points.dtype), (4, np.float32))
        raw = np.fromfile(os.path.join(FOLDER.data, "training/velodyne/000000.bin"), "<f4").reshape(-1, 4)
        np.testing.assert_array_equal(FRAME.points, raw)
        self.assertEqual(FRAME.depth.shape, (HEIGHT, WIDTH))
        self.assertEqual(FRAME.labels[0].type, "Car")
        x, y, length, width, yaw = FRAME.labels[0].box_bev
        np.testing.assert_allclose([x, y, length, width, yaw], [10, -0.5, 3.9, 1.6, 0], atol=1e-3)

    def test_pixel_from_velo_projects(self):
        u, v, w = FRAME.pixel_from_velo @ [10, -0.5, -0.23, 1]
        np.testing.assert_allclose([u / w, v / w], [122 + 144 * 0.5 / 9.73, 35 + 144 * (0.23 - 0.08) / 9.73], atol=1e-3)

    def test_arrays_are_views(self):
        self.assertTrue(np.shares_memory(FRAME.image, FRAME.image))
        self.assertFalse(FRAME.image.flags.writeable)

    def test_points_in_view_are_those_that_a_detector_gets(self):
        uvw = np.c_[FRAME.points[:, :3], np.ones(len(FRAME.points))] @ FRAME.pixel_from_velo.T
        u, v = uvw[:, 0] / uvw[:, 2], uvw[:, 1] / uvw[:, 2]
        seen = (uvw[:, 2] > 0) & (u >= -0.49) & (u < WIDTH - 0.51) & (v >= -0.49) & (v < HEIGHT - 0.51)
        self.assertLess(len(FRAME.points_in_view), len(FRAME.points))
        self.assertAlmostEqual(len(FRAME.points_in_view), int(seen.sum()), delta=3)

    def test_hosts(self):
        self.assertEqual([host.index for host in FRAME.hosts()], [0])
        self.assertGreater(HOST.share_in_view, 0.7)
        self.assertEqual(FRAME.hosts(min_view=1.01), [])
        self.assertIs(HOST.frame, FRAME)

    def test_a_host_of_another_frame_is_refused(self):
        other = mirage.read_frame(FOLDER.data, "000001")
        with self.assertRaisesRegex(mirage.InputError, "^host: <mirage.Host 0: .*> is of another frame; give one of this frame's"):
            mirage.insert(FRAME, other.hosts()[0], mirage.icosphere())

    def test_classes_are_those_that_carry_the_object(self):
        label = FRAME.labels[0]
        x, y, length, width, yaw = label.box_bev
        box = (x, y, label.bottom + label.height / 2, length, width, label.height, yaw)
        frame = mirage.Frame(image=FRAME.image, points=FRAME.points, intrinsics=FRAME.intrinsics,
                             camera_from_velo=FRAME.camera_from_velo, labels=[("Van", box), ("Pedestrian", box), ("Car", box)])
        for classes, found in ((None, [2]), ("Car", [2]), ("Van,Car", [0, 2]), (["pedestrian"], [1]), ("Truck", [])):
            self.assertEqual([host.index for host in frame.hosts(classes=classes, rooftop="box")], found, classes)
        with self.assertRaisesRegex(mirage.InputError, "host: 1: .*not a vehicle"):
            mirage.insert(frame, 1, mirage.icosphere(), rooftop="box")
        self.assertGreater(mirage.insert(frame, 1, mirage.icosphere(), rooftop="box", classes="Pedestrian").adversary_pixels, 0)
        for call in (frame.hosts, lambda **settings: mirage.insert(frame, 0, mirage.icosphere(), **settings)):
            with self.assertRaisesRegex(mirage.InputError, "sensors: unknown setting"):
                call(sensors="radar")
            with self.assertRaisesRegex(mirage.InputError, "classes"):
                call(classes=" ")


class Meshes(unittest.TestCase):
    def test_icosphere(self):
        mesh = mirage.icosphere()
        self.assertEqual((mesh.vertices.shape, mesh.faces.shape, mesh.texels.shape), ((162, 3), (320, 3), (320, 5, 5, 3)))
        np.testing.assert_allclose(np.abs(mirage.icosphere(3, (1, 2, 3)).vertices).max(0), [1, 2, 3], atol=1e-12)

    def test_written_and_read_again_it_is_the_same_bits(self):
        mesh = mirage.icosphere(1)
        mesh.vertices += np.random.default_rng(1).normal(0, 0.05, mesh.vertices.shape)
        mesh.texels[:] = np.random.default_rng(2).random(mesh.texels.shape)
        mesh.write(os.path.join(FOLDER.path, "a.glb"))
        again = mirage.read_mesh(os.path.join(FOLDER.path, "a.glb"))
        for name in ("vertices", "faces", "texels"):
            np.testing.assert_array_equal(getattr(again, name), getattr(mesh, name))

    def test_a_file_is_what_it_holds_and_not_what_it_is_called(self):
        mesh = mirage.icosphere(1)
        mesh.texels[:] = np.random.default_rng(2).random(mesh.texels.shape)
        written, renamed = (os.path.join(FOLDER.path, name) for name in ("A.GLB", "renamed.obj"))
        mesh.write(written)
        shutil.copy(written, renamed)
        for again in (mirage.read_mesh(written), mirage.read_mesh(renamed)):
            for name in ("vertices", "faces", "texels"):
                np.testing.assert_array_equal(getattr(again, name), getattr(mesh, name))
        for name in ("a.gltf", "a.stl", "a"):
            with self.assertRaisesRegex(mirage.InputError, "extension"):
                mesh.write(os.path.join(FOLDER.path, name))

    def test_an_object_of_no_roof_is_refused(self):
        large = mirage.icosphere(1, half=(700, 700, 400))
        with self.assertRaisesRegex(mirage.InputError, "are these millimetres"):
            mirage.insert(FRAME, HOST, large)

    def test_vertices_that_no_face_uses_are_not_drawn(self):
        mesh = mirage.icosphere(1)
        mesh.vertices[:, 2] += 5
        more = mirage.Mesh(np.concatenate([mesh.vertices, [[0, 0, 900]]]), mesh.faces, mesh.texels)
        drawn = [mirage.rasterize(m, FRAME, HEIGHT, WIDTH) for m in (mesh, more)]
        self.assertGreater(drawn[0].mask.max(), 0.9)
        np.testing.assert_array_equal(drawn[0].image, drawn[1].image)
        gradient = drawn[1].vjp(np.ones_like(drawn[1].image))[0]
        np.testing.assert_array_equal(gradient[-1], 0)

    def test_views_outlive_the_mesh(self):
        vertices = mirage.icosphere().vertices
        self.assertTrue(np.isfinite(vertices).all())

    def test_wrong_meshes(self):
        good = mirage.icosphere(0)
        for vertices, faces, word in ((good.vertices[:, :2], good.faces, "vertices: shape"),
                                      (good.vertices, good.faces + 1, "mesh"),
                                      (good.vertices, good.faces[:, :2], "faces: shape")):
            with self.assertRaisesRegex(mirage.InputError, word):
                mirage.Mesh(vertices, faces)
        for faces in (np.zeros((0, 3), int), mirage.icosphere().faces[:0]):
            with self.assertRaisesRegex(mirage.InputError, "0 faces"):
                mirage.Mesh(np.zeros((3, 3)), faces, np.zeros((1, 1, 1, 3)))
        with self.assertRaisesRegex(mirage.InputError, "texels: shape"):
            mirage.Mesh(good.vertices, good.faces, np.zeros((7, 3)))
        with self.assertRaisesRegex(mirage.InputError, "nowhere.glb"):
            mirage.read_mesh("nowhere.glb")

    def test_texels_are_albedo(self):
        good, file = mirage.icosphere(0, resolution=1), os.path.join(FOLDER.path, "bright.glb")
        for value, said in ((200, "200"), (-0.5, "-0.5"), (np.nan, "")):
            texels = np.full((20, 1, 1, 3), 0.5)
            texels[7, 0, 0, 1] = value
            mesh = good.copy()
            with self.assertRaisesRegex(mirage.InputError, f"texel.*{said}"):
                mirage.Mesh(good.vertices, good.faces, texels)
            with self.assertRaisesRegex(mirage.InputError, f"texels: {said}.* is not an albedo; give scene-linear"):
                mesh.texels = texels
            np.testing.assert_array_equal(mesh.texels, 0.5)
            mesh.texels[:] = texels  # a view: whoever uses it looks
            with self.assertRaisesRegex(mirage.InputError, "texel"):
                mesh.write(file)
            self.assertFalse(os.path.exists(file))
            with self.assertRaisesRegex(mirage.InputError, "texel"):
                mirage.insert(FRAME, HOST, mesh)
        mirage.Mesh(good.vertices, good.faces, np.full((20, 1, 1, 3), 1 + 1e-6))  # the step of a central difference


class Insertions(unittest.TestCase):
    def test_both_sensors_see_the_mesh(self):
        result = mirage.insert(FRAME, HOST, mirage.icosphere())
        self.assertEqual((result.image.shape, result.image.dtype), ((HEIGHT, WIDTH, 3), np.float32))
        self.assertGreater(result.adversary_pixels, 50)
        self.assertGreater(result.adversary_points, 20)
        self.assertEqual(len(result.points), len(FRAME.points) - result.removed_points + result.adversary_points)
        changed = np.abs(result.image - FRAME.image).max(-1) > 1e-3
        self.assertFalse((changed & (result.mask < 1e-4)).any())
        self.assertEqual((result.mask > 0.5).sum(), result.adversary_pixels)
        on_it = result.mask > 0.9
        self.assertTrue((np.abs(result.depth[on_it] - 9.7) < 2).all())
        np.testing.assert_array_equal(result.depth[result.mask <= 0.5], FRAME.depth[result.mask <= 0.5])

    def test_it_is_what_the_command_line_draws(self):
        import json

        from support import PROGRAM

        mesh, out = mirage.icosphere(), os.path.join(FOLDER.path, "simulate")
        mesh.write(os.path.join(FOLDER.path, "mesh.glb"))
        subprocess.run([PROGRAM, "simulate", "--data", FOLDER.data, "--frame", "000000", "--mesh",
                        os.path.join(FOLDER.path, "mesh.glb"), "--out", out, "--sigma", "1e-5", "--quiet"],
                       check=True, stdout=subprocess.DEVNULL)
        result = mirage.insert(FRAME, 0, mesh, sigma=1e-5)
        sweep = np.fromfile(os.path.join(out, "sweep.bin"), "<f4").reshape(-1, 4)
        np.testing.assert_array_equal(result.points, sweep)
        with open(os.path.join(out, "result.json")) as file:
            told = json.load(file)
        self.assertEqual(told["adversary_pixels"], result.adversary_pixels)

    def test_vjp_against_central_differences_in_double(self):
        mesh = mirage.icosphere(1, resolution=1)
        random = np.random.default_rng(3)
        mesh.texels[:] = random.uniform(0.2, 0.9, mesh.texels.shape)
        settings = {"sigma": 1e-4, "gamma": 5e-2, "double": True}
        at = mirage.insert(FRAME, HOST, mesh, **settings)
        self.assertEqual((at.image.dtype, at.points.dtype), (np.float64, np.float64))
        d_image, d_points = random.normal(size=at.image.shape), random.normal(size=at.points.shape)
        d_vertices, d_texels = at.vjp(d_image, d_points)
        self.assertEqual((d_vertices.shape, d_texels.shape), (mesh.vertices.shape, mesh.texels.shape))

        def loss(other):
            there = mirage.insert(FRAME, HOST, other, **settings)
            self.assertEqual(len(there.points), len(at.points))
            return (d_image * there.image).sum() + (d_points * there.points).sum()

        for name, gradient, step in (("vertices", d_vertices, 1e-7), ("texels", d_texels, 1e-4)):
            direction = random.normal(size=gradient.shape)
            ends = []
            for sign in (1, -1):
                moved = mesh.copy()
                getattr(moved, name)[...] += sign * step * direction
                ends.append(loss(moved))
            numeric = (ends[0] - ends[1]) / (2 * step)
            self.assertLess(abs(numeric - (gradient * direction).sum()), 1e-4 * abs(numeric), name)

    def test_float_and_double_agree(self):
        mesh = mirage.icosphere()
        single, double = (mirage.insert(FRAME, HOST, mesh, double=word) for word in (False, True))
        self.assertLess(np.abs(single.image - double.image).max(), 2e-4)
        self.assertLess(np.abs(single.points - double.points).max(), 1e-5)

    def test_one_sensor_alone(self):
        result = mirage.insert(FRAME, HOST, mirage.icosphere())
        d_image, d_points = np.ones_like(result.image), np.ones_like(result.points)
        both, image, points = (np.concatenate([part.ravel() for part in result.vjp(*given)])
                               for given in ((d_image, d_points), (d_image, None), (None, d_points)))
        np.testing.assert_allclose(both, image + points, atol=1e-9)

    def test_other_peoples_arrays(self):
        result = mirage.insert(FRAME, HOST, mirage.icosphere())
        d_image = np.random.default_rng(1).normal(size=result.image.shape).astype(np.float32)
        plain = result.vjp(d_image, None)[0]
        for other in (Lend(d_image), np.asfortranarray(d_image), d_image.astype(np.float64), d_image.tolist()):
            np.testing.assert_allclose(result.vjp(other)[0], plain, atol=1e-12)
        d_points = np.random.default_rng(2).normal(size=result.points.shape).astype(np.float32)
        plain = result.vjp(None, d_points)[0]
        for other in (Lend(d_points), np.asfortranarray(d_points), d_points.astype(np.float64), d_points.tolist()):
            np.testing.assert_allclose(result.vjp(None, other)[0], plain, atol=1e-12)

    def test_errors_name_the_setting(self):
        mesh = mirage.icosphere()
        with self.assertRaisesRegex(mirage.InputError, r"mirage.insert: sigmma: unknown setting; did you mean sigma") as at:
            mirage.insert(FRAME, HOST, mesh, sigmma=1e-5)
        self.assertNotIn("\n", str(at.exception))
        for settings, word in (({"supersampling": 99}, "supersampling"), ({"quality": "best"}, "quality"),
                               ({"sigma": -1.0}, "sigma"), ({"light": "neon"}, "light"), ({"sun": "up"}, "sun"),
                               ({"depth": "no-such"}, "depth"), ({"rooftop": "thatched"}, "rooftop")):
            with self.assertRaisesRegex(mirage.InputError, word):
                mirage.insert(FRAME, HOST, mesh, **settings)
        result = mirage.insert(FRAME, HOST, mesh)
        for given, word in (((np.zeros((3, 3)), None), "d_image: shape: is 3 × 3"),
                            ((None, np.zeros((7, 4))), "d_points: shape"), (("no", None), "d_image")):
            with self.assertRaisesRegex(mirage.InputError, word):
                result.vjp(*given)
        with self.assertRaisesRegex(mirage.Failure, "not finite"):
            result.vjp(np.full_like(result.image, np.nan), None)
        with self.assertRaisesRegex(mirage.InputError, "host: 5"):
            mirage.insert(FRAME, 5, mesh)
        with self.assertRaisesRegex(mirage.InputError, "000099"):
            mirage.read_frame(FOLDER.data, "000099")
        self.assertIn(FRAME.id, mirage.list_frames(FOLDER.data))
        with self.assertRaises(mirage.InputError):
            mirage.list_frames(os.path.join(FOLDER.data, "none"))
        self.assertTrue(issubclass(mirage.InputError, ValueError))
        self.assertTrue(issubclass(mirage.Failure, RuntimeError))


class Damaged(unittest.TestCase):
    def test_a_damaged_picture_is_the_error_and_no_line_of_another_library(self):
        folder = Folder(1)
        self.addCleanup(folder.remove)
        picture = os.path.join(folder.data, "training/image_2/000000.png")
        with open(picture, "rb") as file:
            whole = file.read()
        middle = len(whole) // 2
        with open(picture, "wb") as file:
            file.write(whole[:middle] + bytes(byte ^ 0x5A for byte in whole[middle : middle + 64]) + whole[middle + 64 :])
        script = f"import mirage\ntry: mirage.read_frame({folder.data!r}, '000000')\nexcept mirage.InputError: print('refused')"
        ended = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
        self.assertEqual((ended.stdout, ended.stderr, ended.returncode), ("refused\n", "", 0))


class Pieces(unittest.TestCase):
    def test_rasterize_and_its_vjp(self):
        mesh = mirage.icosphere(1, resolution=1)
        random = np.random.default_rng(5)
        mesh.vertices[:, 2] += 6
        mesh.vertices += random.normal(0, 0.02, mesh.vertices.shape)  # no pixel on an edge or a corner: a kink
        mesh.texels[:] = random.random(mesh.texels.shape)
        settings = dict(sigma=1e-4, gamma=5e-2, dist_eps=1e-13, near=4, far=8, double=True)
        camera = (60, 60, 32, 24)
        at = mirage.rasterize(mesh, camera, 48, 64, background=(0.1, 0.2, 0.3), **settings)
        np.testing.assert_allclose(at.image[0, 0], [0.1, 0.2, 0.3], atol=1e-6)
        self.assertGreater(at.mask[24, 32], 0.9)
        d_image, d_mask = random.normal(size=at.image.shape), random.normal(size=at.mask.shape)
        gradients = at.vjp(d_image, d_mask)
        for name, gradient, step in zip(("vertices", "texels"), gradients, (1e-6, 1e-4)):
            direction, ends = random.normal(size=gradient.shape), []
            for sign in (1, -1):
                moved = mesh.copy()
                getattr(moved, name)[...] += sign * step * direction
                there = mirage.rasterize(moved, camera, 48, 64, background=(0.1, 0.2, 0.3), **settings)
                ends.append((d_image * there.image).sum() + (d_mask * there.mask).sum())
            numeric = (ends[0] - ends[1]) / (2 * step)
            self.assertLess(abs(numeric - (gradient * direction).sum()), 1e-4 * abs(numeric), name)
        settings["double"] = False
        fast = mirage.rasterize(mesh, [[60, 0, 32], [0, 60, 24], [0, 0, 1]], 48, 64, background=(0.1, 0.2, 0.3), **settings)
        self.assertLess(np.abs(fast.image - at.image).max(), 2e-4)
        with self.assertRaisesRegex(mirage.InputError, "blend"):
            mirage.rasterize(mesh, camera, 48, 64, blend="wet")
        with self.assertRaisesRegex(mirage.InputError, "background"):
            mirage.rasterize(mesh, camera, 48, 64, background=np.zeros((3, 48, 64)))

    def test_many_pictures_in_one_call(self):
        random = np.random.default_rng(6)
        meshes = [mirage.icosphere(1, resolution=2) for _ in range(2)]
        for mesh, away in zip(meshes, (5, 7)):
            mesh.vertices[:, 2] += away
            mesh.texels[:] = random.random(mesh.texels.shape)
        cameras = [(60, 60, 32, 24), (90, 90, 20, 30)]
        settings = dict(background=random.random((48, 64, 3), dtype=np.float32), sigma=1e-4, near=3, far=9)
        singly = [mirage.rasterize(mesh, camera, 48, 64, **settings) for mesh, camera in zip(meshes, cameras)]
        both = mirage.rasterize(meshes, cameras, 48, 64, **settings)
        d_image, d_mask = random.normal(size=both.image.shape), random.normal(size=both.mask.shape).astype(np.float32)
        # As it lies: turned round, with gaps, in another order; floats and doubles are one gradient.
        laid = np.empty((48, 2, 128, 3), np.float32)[:, :, ::2][::-1].transpose(1, 0, 2, 3)
        laid[:] = d_image
        for n, (alone, pair, strided) in enumerate(zip(singly, both.vjp(d_image, d_mask), both.vjp(laid, d_mask))):
            np.testing.assert_array_equal(both.image[n], alone.image)
            np.testing.assert_array_equal(both.mask[n], alone.mask)
            for one, other, third in zip(alone.vjp(d_image[n], d_mask[n]), pair, strided):
                self.assertGreater(np.abs(one).max(), 0)
                np.testing.assert_array_equal(one, other)
                np.testing.assert_array_equal(one, third)
        views = mirage.rasterize(meshes[0], cameras, 48, 64, **settings)
        gradient = views.vjp(d_image)
        parts = [mirage.rasterize(meshes[0], camera, 48, 64, **settings).vjp(d_image[n])
                 for n, camera in enumerate(cameras)]
        for k in (0, 1):
            np.testing.assert_allclose(gradient[k], parts[0][k] + parts[1][k], rtol=1e-12)
        with self.assertRaisesRegex(mirage.InputError, "3 cameras for 2 meshes"):
            mirage.rasterize(meshes, cameras + cameras[:1], 48, 64, **settings)
        d_image[1, 30, 20, 0] = np.nan
        with self.assertRaisesRegex(mirage.Failure, "d_image: is not finite"):
            both.vjp(d_image)

    def test_a_background_is_the_one_that_was_given(self):
        background = np.full((48, 64, 3), 0.25, np.float32)
        mesh = mirage.icosphere(1)
        mesh.vertices[:, 2] += 6
        drawn = mirage.rasterize(mesh, (60, 60, 32, 24), 48, 64, background=background)
        background[:] = 0.75
        self.assertEqual(drawn.image[0, 0, 0], 0.25)

    def test_cast_rays(self):
        mesh = mirage.icosphere(3, (1, 1, 1))
        origins = np.array([[5.0, 0.1, 0.2], [5.0, 3.0, 0.0]])
        hits = mirage.cast_rays(mesh, origins, [[-2.0, 0, 0], [-2.0, 0, 0]])
        self.assertEqual(hits.face[1], -1)
        self.assertTrue(np.isinf(hits.t[1]))
        self.assertAlmostEqual(hits.t[0], (5 - np.sqrt(1 - 0.05)) / 2, delta=0.01)
        np.testing.assert_allclose(hits.points[0], origins[0] + hits.t[0] * np.array([-2.0, 0, 0]))
        corners = mesh.vertices[mesh.faces[hits.face[0]]]
        np.testing.assert_allclose(hits.barycentrics[0] @ corners, hits.points[0], atol=1e-9)
        gradient, = hits.vjp([[1.0, 0, 0], [0, 0, 0]])
        moved = mesh.copy()
        moved.vertices[:, 0] += 1e-3
        there = mirage.cast_rays([moved], origins, [[-2.0, 0, 0], [-2.0, 0, 0]])
        self.assertAlmostEqual((there.points[0, 0] - hits.points[0, 0]) / 1e-3, gradient[:, 0].sum(), delta=1e-6)


class Interpreter(unittest.TestCase):
    def test_imports_from_anywhere_with_no_other_variable(self):
        place = os.path.dirname(os.path.dirname(os.path.abspath(mirage.__file__)))
        code = "import mirage, sys; assert 'torch' not in sys.modules; print(mirage.icosphere())"
        told = subprocess.run([sys.executable, "-c", code], cwd="/", env={"PYTHONPATH": place}, check=True,
                              capture_output=True, text=True)
        self.assertIn("162 vertices", told.stdout)

    def test_others_run_meanwhile(self):
        """The interpreter's lock is free while Mirage works: another thread counts on."""
        import threading
        import time

        mesh, counted, stop = mirage.icosphere(), [0], threading.Event()

        def count():
            while not stop.is_set():
                counted[0] += 1
                time.sleep(1e-3)

        other = threading.Thread(target=count)
        other.start()
        before, start = counted[0], time.monotonic()
        mirage.insert(FRAME, HOST, mesh, double=True, sigma=1e-8, gamma=1e-3, supersampling=8)
        spent = time.monotonic() - start
        during = counted[0] - before
        stop.set()
        other.join()
        self.assertGreater(during, 20 * spent)

    def test_commands_wait_for_each_other(self):
        import threading

        results, places = {}, {}
        rig = os.path.join(os.path.dirname(os.path.dirname(os.path.abspath(__file__))), "faults", "small-rig.toml")

        def generate(name):
            called = places[name] = []
            results[name] = mirage.generate(rig=rig, frames=1, seed=3, out=os.path.join(FOLDER.path, name), quiet=False,
                                            progress=lambda *told: called.append(told))

        threads = [threading.Thread(target=generate, args=(name,)) for name in ("one", "other")]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        for name in ("one", "other"):
            self.assertEqual(str(results[name]).count("frames written"), 1, name)
            self.assertIn(os.path.join(FOLDER.path, name), str(results[name]))
            self.assertGreaterEqual(len(places[name]), 1, name)

    def test_every_public_thing_says_what_it_is(self):
        for name in mirage.__all__:
            thing = getattr(mirage, name) if name not in ("torch", "pytorch3d") else None
            if thing is None:
                continue
            self.assertTrue((thing.__doc__ or "").strip(), name)
            for member, value in vars(thing).items() if isinstance(thing, type) else ():
                if not member.startswith("_") and name not in ("InputError", "Failure"):
                    self.assertTrue((value.__doc__ or "").strip(), f"{name}.{member}")

    def test_the_stub_names_what_there_is(self):
        import ast

        from mirage import _core

        with open(os.path.join(os.path.dirname(mirage.__file__), "_core.pyi")) as file:
            stub = ast.parse(file.read())
        told = {}
        for node in stub.body:
            if isinstance(node, ast.ClassDef):
                told[node.name] = {n.name for n in node.body if isinstance(n, ast.FunctionDef)}
                told[node.name] |= {n.target.id for n in node.body if isinstance(n, ast.AnnAssign)}
            elif isinstance(node, ast.FunctionDef):
                told[node.name] = set()
            elif isinstance(node, ast.AnnAssign):
                told[node.target.id] = set()
        real = {name for name in vars(_core) if not name.startswith("__")}
        self.assertEqual(real, set(told))
        for name in real:
            thing = getattr(_core, name)
            if isinstance(thing, type) and name not in ("InputError", "Failure"):
                members = {m for m in vars(thing) if not m.startswith(("__", "_pybind11"))}
                self.assertEqual(members, {m for m in told[name] if not m.startswith("__")}, name)


if __name__ == "__main__":
    unittest.main()
