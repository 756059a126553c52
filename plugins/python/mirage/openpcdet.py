"""OpenPCDet's LiDAR networks as detectors: mirage.attack(detector=mirage.openpcdet.wrap(model), …).

Nothing of OpenPCDet is imported: what is read of a model are `dataset` (point_cloud_range, voxel_size, dataset_cfg,
point_feature_encoder), `class_names` and `module_list`, as Detector3DTemplate has them.
"""

from __future__ import annotations

from typing import Any

import torch

from ._core import InputError
from ._voxels import Wrapped, turned_back, voxels_of


def wrap(model: Any, *, angle: float = 0.0, top: int = 2000) -> "OpenPCDet":
    """model: of pcdet.models.build_network, with its weights loaded. angle: of its x axis from straight ahead, rad,
    counter-clockwise: 0 for KITTI and Waymo, −π/2 for nuScenes, whose x points to the right. top: boxes that are kept, the
    best-scored, before suppression."""
    return OpenPCDet(model, angle, top)


class OpenPCDet(Wrapped):
    def __init__(self, model: Any, angle: float, top: int):
        for name in ("dataset", "class_names", "module_list"):
            if not hasattr(model, name):
                raise InputError(f"model: has no {name}; give a network of pcdet.models.build_network")
        data = model.dataset
        super().__init__(model, data.point_cloud_range, model.class_names, angle)
        self.top = top
        self.features = int(data.point_feature_encoder.num_point_features)
        steps = [dict(step) for step in data.dataset_cfg["DATA_PROCESSOR"]]
        self.voxels = next((step for step in steps if step["NAME"].startswith("transform_points_to_voxels")), None)

    def detect(self, points: torch.Tensor):
        more = points.new_zeros(len(points), max(0, self.features - 4))  # times within several sweeps: this one's
        points = torch.cat([points, more], 1)[:, : self.features]
        batch = {"batch_size": 1, "points": torch.cat([points.new_zeros(len(points), 1), points], 1)}
        if self.voxels and "MAX_POINTS_PER_VOXEL" in self.voxels:
            most = self.voxels["MAX_NUMBER_OF_VOXELS"]
            voxels, coordinates, counts = voxels_of(points, self.bounds, self.voxels["VOXEL_SIZE"],
                                                    self.voxels["MAX_POINTS_PER_VOXEL"], most["test"])
            coordinates = torch.cat([coordinates.new_zeros(len(coordinates), 1), coordinates], 1)
            batch.update(voxels=voxels, voxel_coords=coordinates.to(points.dtype), voxel_num_points=counts.to(points.dtype))
        for module in self.model.module_list:
            batch = module(batch)
        if "batch_cls_preds" not in batch:  # a head of centres, which has suppressed already
            result = batch["final_box_dicts"][0]
            return {**result, "pred_boxes": turned_back(result["pred_boxes"][:, :9], self.angle)}
        logits, classes = batch["batch_cls_preds"][0].max(1)
        if batch.get("cls_preds_normalized", False):
            logits = torch.logit(logits, 1e-7)
        if "batch_pred_labels" in batch:  # of a second stage, from 1
            classes = batch["batch_pred_labels"][0] - 1
        kept = logits.detach().topk(min(self.top, len(logits))).indices
        boxes = batch["batch_box_preds"][0][kept]
        return turned_back(boxes[:, : 9 if boxes.shape[1] >= 9 else 7], self.angle), logits[kept], classes[kept]
