"""A detector in its own process that does what its first argument says; needs only numpy."""

import os
import signal
import sys
import time

import mirage_serve
import numpy as np

what = sys.argv[1]
mark = sys.argv[2] if len(sys.argv) > 2 else ""  # a file that is there once it has happened


def once():
    """True the first time in all processes, always without a mark."""
    if not mark:
        return True
    if os.path.exists(mark):
        return False
    open(mark, "w").close()
    return True


class Detector:
    """Two cars and a pedestrian, whose logits are linear in the picture's first value and the first point."""

    region = (0, 50, -20, 20)
    heights = True
    classes = ["Pedestrian", "car"] if what == "classes" else []

    def __call__(self, image, points, pixel_from_velo):
        if what == "dies" and once():
            os.kill(os.getpid(), signal.SIGKILL)
        if what == "hangs" and once():
            time.sleep(60)
        if what == "garbage" and once():
            os.write(self.out, b"\xff\x00 this is no answer\n")
        if what == "raises":
            raise RuntimeError("no such\nlayer")
        if what == "prints":
            print("a line of its own", flush=True)
            os.system("echo another one")
        if what == "not-finite":
            return np.array([[np.nan] * 5], np.float32), np.zeros(1, np.float32)
        self.shapes = image.shape, points.shape
        first = float(image.ravel()[0]) if image.size else 0
        logits = np.array([2 * first + points[0, 0], 0.5, -9], np.float32)
        boxes = np.array([[10, 1, -1, 4, 2, 1.5, 0.1], [20, -1, -1, 4, 2, 1.5, 0], [5, 0, -1, 1, 1, 1.8, 0]], np.float32)
        if what == "nine":
            boxes = np.concatenate([boxes, [[3, 1]] * 3], 1).astype(np.float32)
        if what == "classes":
            return boxes, logits + 9, np.array([1, 0, 1])
        if what == "unnamed-classes":
            return boxes, logits, np.array([1, 1, 1])
        return boxes, logits

    def backward(self, d_logits):
        if what == "dies-back" and once():
            os._exit(4)
        if what == "nan-back":
            return np.full(self.shapes[0], np.nan), None
        d_image, d_points = (np.zeros(shape, np.float32) for shape in self.shapes)
        if d_image.size:
            d_image.ravel()[0] = 2 * d_logits[0]
        d_points[0, 0] = d_logits[0]
        return d_image, d_points


class ByName(Detector):
    """Sums three times the first value of LEFT, the second y of rear, the last value of radar, the frame's number and its time."""

    def __call__(self, frame):
        boxes, logits = super().__call__(frame.images["camera"], frame.points["lidar"], frame.pixel_from_velo["camera"])
        self.frame = frame
        logits[0] = (3 * frame.images["LEFT"].ravel()[0] + frame.points["rear"][1, 1] + frame.data["radar"][0, 1, 2]
                     + int(frame.id) + frame.moment["time"])
        return boxes, logits

    def backward(self, d_logits):
        found = {name: np.zeros_like(self.frame.images[name]) for name in ("camera", "LEFT")}
        found.update({name: np.zeros_like(self.frame.points[name]) for name in ("lidar", "rear")})
        found["LEFT"].ravel()[0] = 3 * d_logits[0]
        found["rear"][1, 1] = d_logits[0]
        found["radar"] = np.zeros_like(self.frame.data["radar"])
        found["radar"][0, 1, 2] = d_logits[0]
        return found


class Local(Detector):
    """The sum of all x, of which it keeps what it made of the clean sweep; then how many points it has looked at, and the changed
    rectangle's lower right corner."""

    local, kept = True, {}

    def __call__(self, frame):
        points, before = frame.points["lidar"], None if frame.clean is None else frame.clean.points["lidar"]
        added, looked = points, len(points)
        total = 0
        if frame.clean is not None:
            if frame.clean.key not in self.kept:
                self.kept[frame.clean.key] = before[:, 0].sum()
                looked += len(before)
            known = {row.tobytes() for row in before}
            stays = np.array([row.tobytes() in known for row in points])
            gone = known - {row.tobytes() for row in points}
            total = self.kept[frame.clean.key] - sum(np.frombuffer(row, np.float32)[0] for row in gone)
            added, looked = points[~stays], looked - stays.sum()
        corner = frame.clean.changed["camera"][2:] if frame.clean is not None else (0, 0)
        boxes = np.array([[10, 0, 4, 2, 0], [20, 0, 4, 2, 0], [30, 0, 4, 2, 0], [40, 0, 4, 2, 0]], np.float32)
        return boxes, np.array([total + added[:, 0].sum(), looked, *corner], np.float32)


class Remembering(Detector):
    """Dies at the frame of its sequence that its name says, once."""

    def new_sequence(self):
        self.frames = 0

    def __call__(self, image, points, pixel_from_velo):
        self.frames += 1
        if self.frames == {"dies-first": 1, "dies-second": 2}[what] and once():
            os.kill(os.getpid(), signal.SIGKILL)
        return super().__call__(image, points, pixel_from_velo)


class Tracker:
    """Gives each box the identity 10 × (frames of its sequence so far) + its index."""

    reads = ("detections",)

    def new_sequence(self):
        self.frames = 0

    def __call__(self, frame):
        self.frames += 1
        rows = frame.data["detections"]
        identities = 10 * self.frames + np.arange(len(rows) - (what == "few-identities"))
        return rows[:, :7], rows[:, 7], None, identities.astype(np.int32)


detector = {"others": ByName, "local": Local, "tracker": Tracker, "few-identities": Tracker, "dies-first": Remembering,
            "dies-second": Remembering}.get(what, Detector)()
detector.out = os.dup(1)
if what == "early":
    sys.exit("no weights")
if what == "talks":
    os.write(1, b"loading the network\n{\"id\": 1}\n")
if what == "no-gradient":
    mirage_serve.serve(lambda image, points, matrix: detector(image, points, matrix))
mirage_serve.serve(detector, pictures="srgb8" if what == "srgb8" else "linear")
