"""validation/studies/fitted_vehicle.py on a known vehicle: it is drawn into frames of bare ground, fitted from all but one, and
inserted into that one."""

import os
import sys
import unittest

try:
    import scipy  # noqa: F401
    from PIL import Image  # noqa: F401
except ImportError:
    print("skipped: SciPy or Pillow is not installed for this interpreter (Debian packages python3-scipy, python3-pil)")
    sys.exit(77)

import mirage
import numpy as np

sys.path.insert(0, os.path.join(os.environ.get("MIRAGE_SOURCE", "."), "validation", "studies"))
import fitted_vehicle  # noqa: E402

SIZE = np.array([4.2, 1.7, 1.5])
GROUND, INTRINSICS = -1.73, (721.5, 721.5, 609.5, 172.9)
CAMERA = np.array([[0, -1, 0, 0], [0, 0, -1, -0.08], [1, 0, 0, -0.27]], float)


def bare_ground():
    """The unit's returns from a plane."""
    beams = np.radians(fitted_vehicle.BEAMS * [1, 0, 0, 1]) + fitted_vehicle.BEAMS * [0, 1, 1, 0]
    firing = np.radians(np.round(np.arange(-280, 280) * 0.1671 / 0.09) * 0.09)
    down = beams[beams[:, 0] < -0.03]
    azimuth = firing[:, None] + down[:, 3]
    rho = (GROUND - down[:, 1]) / np.tan(down[:, 0]) + 0 * azimuth
    ahead, left = np.stack([np.cos(azimuth), np.sin(azimuth)], -1), np.stack([-np.sin(azimuth), np.cos(azimuth)], -1)
    flat = rho[..., None] * ahead + down[:, 2:3] * left
    points = np.concatenate([flat, np.full((*rho.shape, 1), GROUND), np.full((*rho.shape, 1), 0.2)], -1).reshape(-1, 4)
    return points[np.linalg.norm(points[:, :3], axis=1) < 75].astype(np.float32)


def true_car():
    """Not a saloon: an egg with a waist; its colours and its reflectance change along it."""
    mesh = mirage.icosphere(4, half=SIZE / 2, resolution=1)
    v = mesh.vertices
    mesh.vertices = v * np.stack([np.ones(len(v)), 1 - 0.15 * np.cos(3 * v[:, 0]), 1 + 0.1 * np.cos(2 * v[:, 0])], 1)
    along = mesh.vertices[mesh.faces].mean(1)[:, 0]
    mesh.texels = np.repeat((0.4 + 0.25 * np.sin(2 * along))[:, None, None, None], 3, 3)
    return mesh


class RealToSim(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        car, cls.frames, cls.sights = true_car(), {}, []
        cls.car, ground = car, bare_ground()
        picture = np.full((375, 1242, 3), 0.1, np.float32)
        for k in range(11):
            x, y, yaw = 22 - 1.0 * k, 5.0 - 0.05 * k, -0.1
            label = ("Car", (x, y, GROUND + SIZE[2] / 2, *SIZE, yaw))
            empty = mirage.Frame(image=picture, points=ground, intrinsics=INTRINSICS, camera_from_velo=CAMERA, labels=[label])
            drawn = fitted_vehicle.insert(empty, 0, car, np.array([x, y, GROUND - car.vertices[:, 2].min(), yaw]),
                                          lidar_effects="noise,albedo")
            frame = mirage.Frame(image=drawn.image, points=drawn.points, intrinsics=INTRINSICS, camera_from_velo=CAMERA, labels=[label])
            cls.frames[f"0000_{k:06d}"] = frame
            cls.sights.append(fitted_vehicle.Sight(f"0000_{k:06d}", frame, frame.labels[0]))
        cls.read, fitted_vehicle.read = fitted_vehicle.read, lambda data, frame_id: cls.frames[frame_id]
        cls.judged = cls.sights[5]
        cls.fit = fitted_vehicle.Fit(None, cls.sights, 5, 1)
        cls.judged.shift = cls.fit.shift
        cls.frame = cls.frames[cls.judged.id]

    @classmethod
    def tearDownClass(cls):
        fitted_vehicle.read = cls.read

    def test_the_frame_that_is_judged_and_its_neighbours_are_left_out(self):
        self.assertEqual([s.id[-2:] for s in self.fit.sights], ["00", "01", "02", "03", "07", "08", "09", "10"])

    def test_the_surface_goes_through_returns_that_it_has_not_seen(self):
        points = self.judged.points
        self.assertLess(np.median(np.abs(self.fit.field.at(points))), 0.015)
        outline = np.abs(fitted_vehicle.outline(points, SIZE, "Car"))
        self.assertGreater(np.median(outline), 0.08, "a saloon would do as well")

    def test_as_many_returns_come_back_as_bright(self):
        new, left = fitted_vehicle.returned(self.frame, self.judged, self.fit, self.judged.registered, 0)
        self.assertGreater(len(self.judged.points), 300)
        self.assertLess(abs(self.judged.on(new).sum() / len(self.judged.points) - 1), 0.05)
        self.assertLess(abs(new[:, 3].mean() - self.judged.reflectance.mean()), 0.03)
        self.assertEqual(self.judged.on(left).sum(), 0, "something of the recorded vehicle is left")

    def test_rays_that_the_other_frames_lost_are_lost(self):
        self.fit.material.back[:] = False
        try:
            new, _ = fitted_vehicle.returned(self.frame, self.judged, self.fit, self.judged.registered, 0)
        finally:
            self.fit.material.back[:] = True
        self.assertEqual(len(new), 0)

    def test_texels_are_the_photographed_colours(self):
        places = fitted_vehicle.texel_places(self.fit.vertices, self.fit.faces, self.fit.paint.texels.shape[1]).reshape(-1, 3)
        photographed = self.fit.paint.texels.reshape(-1, 3).mean(1)
        towards = self.judged.aligned(self.judged.seen_from[None])[0]
        level = np.abs(places[:, 2] - 0.8) < 0.15  # faces of one slope, for the light
        seen = level & (np.abs(places[:, 0]) < 1.5) & (places[:, 1] * np.sign(towards[1]) > 0.3)
        along = np.sin(2 * places[seen, 0])
        self.assertGreater(np.corrcoef(along, photographed[seen])[0, 1], 0.9)


if __name__ == "__main__":
    unittest.main()
