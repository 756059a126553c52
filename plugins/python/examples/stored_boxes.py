"""Boxes stored by another program, as a detector for mirage detect and for the clean side of mirage drive:

    mirage drive --detector "exec:python3 stored_boxes.py path/to/boxes path/to/kitti-tracking" --mesh crate.obj --data path/to/kitti-tracking

BOXES/SEQUENCE.txt has the comma-separated rows of PointRCNN's files in AB3DMOT's repository (data/KITTI/pointrcnn_Car_val): frame,
class, left, top, right, bottom, score (logit), height, width, length, x, y, z (m, rectified camera, centre of the bottom),
rotation_y, alpha. The detector ignores the sensors, so an object changes nothing."""

import sys

import numpy as np
from mirage_serve import serve


def read_calibration(file):
    """velo_from_rectified, 4×4 (m), from a KITTI calibration file."""
    rows = {line.split()[0].rstrip(":"): np.array(line.split()[1:], float) for line in open(file) if line.strip()}
    rectify, velo = np.eye(4), np.eye(4)
    rectify[:3, :3] = rows.get("R_rect", rows.get("R0_rect")).reshape(3, 3)
    velo[:3] = rows.get("Tr_velo_cam", rows.get("Tr_velo_to_cam")).reshape(3, 4)
    return np.linalg.inv(rectify @ velo)


class StoredBoxes:
    reads = ("points",)
    heights = True

    def __init__(self, boxes, data):
        self.boxes, self.data, self.sequence = boxes, data, None

    def __call__(self, frame):
        sequence = frame.moment["sequence"]
        if sequence != self.sequence:
            self.rows = np.loadtxt(f"{self.boxes}/{sequence}.txt", delimiter=",", ndmin=2)
            self.velo_from_rectified = read_calibration(f"{self.data}/training/calib/{sequence}.txt")
            self.sequence = sequence
        rows = self.rows[self.rows[:, 0] == frame.moment["index"]]
        at = (self.velo_from_rectified @ np.c_[rows[:, 10:13], np.ones(len(rows))].T).T
        height, width, length = rows[:, 7:10].T
        yaw = -rows[:, 13] - np.pi / 2
        boxes = np.c_[at[:, :2], at[:, 2] + height / 2, length, width, height, yaw]
        return boxes.astype(np.float32), rows[:, 6].astype(np.float32)


if __name__ == "__main__":
    serve(StoredBoxes(*sys.argv[1:3]))
