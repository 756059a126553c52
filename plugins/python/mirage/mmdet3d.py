"""mmdetection3d's LiDAR networks as detectors: mirage.attack(detector=mirage.mmdet3d.wrap(model), …).

Of mmdetection3d only the box types are imported, and only without `meta`. A model (1.x, VoxelNet and its like) must have
data_preprocessor.voxel_layer, extract_feat, bbox_head and dataset_meta.
"""

from __future__ import annotations

from typing import Any

import torch

from ._core import InputError
from ._voxels import Wrapped, turned_back, voxels_of


def wrap(model: Any, *, angle: float = 0.0, intensity: float = 1.0, meta: dict[str, Any] | None = None) -> "MMDet3D":
    """A detector for mirage.attack from a model of mmdet3d.apis.init_model. InputError for another model or angle.

    angle: from straight ahead to the model's x axis, rad, counter-clockwise, in quarter turns: 0 for KITTI and Waymo, −π/2 for
    nuScenes' own axes. intensity: the fourth number of its points for a reflectance of 1: 1 for KITTI, 255 for nuScenes (0 if
    that number is a time). meta: what its head needs of a sample (None: box_type_3d and box_mode_3d of LiDAR boxes).

    Its answers are those after the model's own suppression. To get more, lower the model's test_cfg.score_thr."""
    if meta is None:
        from mmdet3d.structures import Box3DMode, LiDARInstance3DBoxes

        meta = {"box_type_3d": LiDARInstance3DBoxes, "box_mode_3d": Box3DMode.LIDAR}
    return MMDet3D(model, angle, intensity, meta)


class MMDet3D(Wrapped):
    def __init__(self, model: Any, angle: float, intensity: float, meta: dict[str, Any]):
        for name in ("data_preprocessor", "extract_feat", "bbox_head", "dataset_meta"):
            if not hasattr(model, name):
                raise InputError(f"model: has no {name}; give a detector of mmdet3d.apis.init_model")
        self.layer, self.meta = model.data_preprocessor.voxel_layer, meta
        classes = model.dataset_meta.get("classes") or model.dataset_meta["CLASSES"]
        super().__init__(model, self.layer.point_cloud_range, classes, angle, intensity)

    def detect(self, points: torch.Tensor):
        most = self.layer.max_voxels
        voxels, coordinates, counts = voxels_of(points, self.bounds, self.layer.voxel_size, self.layer.max_num_points,
                                                most[-1] if isinstance(most, (tuple, list)) else most)
        coordinates = torch.cat([coordinates.new_zeros(len(coordinates), 1), coordinates], 1)
        inputs = {"points": [points], "voxels": {"voxels": voxels, "coors": coordinates.int(), "num_points": counts.int()}}
        outputs = self.model.bbox_head(self.model.extract_feat(inputs))
        result = self.model.bbox_head.predict_by_feat(*outputs, batch_input_metas=[self.meta])[0]
        boxes = torch.cat([result.bboxes_3d.gravity_center, result.bboxes_3d.tensor[:, 3:]], 1)
        boxes = boxes[:, : 9 if boxes.shape[1] >= 9 else 7]
        return {"bboxes_3d": turned_back(boxes, self.angle), "scores_3d": result.scores_3d, "labels_3d": result.labels_3d}
