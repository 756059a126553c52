"""OpenPCDet's LiDAR networks as detectors: mirage.attack(detector=mirage.openpcdet.wrap(model), …).

Nothing of OpenPCDet is imported. A model must have `dataset` (point_cloud_range, dataset_cfg, point_feature_encoder),
`class_names` and `module_list`, as Detector3DTemplate does.
"""

from __future__ import annotations

from typing import Any

import torch

from ._core import InputError
from ._voxels import Wrapped, turned_back, voxels_of


def wrap(model: Any, *, angle: float = 0.0, intensity: float = 1.0, top: int = 2000) -> "OpenPCDet":
    """A detector for mirage.attack from a model of pcdet.models.build_network with its weights loaded. angle: from straight ahead
    to the model's x axis, rad, counter-clockwise, in quarter turns: 0 for KITTI and Waymo, −π/2 for nuScenes, whose x points to
    the right. intensity: the value of a reflectance of 1 in its points: 1 for KITTI, 255 for nuScenes. top: how many of the
    best-scored boxes to keep, before suppression; a head of centres gives its boxes after its own suppression. InputError for
    another model or angle, and for a model that samples its points at random."""
    return OpenPCDet(model, angle, intensity, top)


class OpenPCDet(Wrapped):
    def __init__(self, model: Any, angle: float, intensity: float, top: int):
        for name in ("dataset", "class_names", "module_list"):
            if not hasattr(model, name):
                raise InputError(f"model: has no {name}; give a network of pcdet.models.build_network")
        data = model.dataset
        super().__init__(model, data.point_cloud_range, model.class_names, angle, intensity)
        self.top = top
        self.features = int(data.point_feature_encoder.num_point_features)
        steps = {step["NAME"]: dict(step) for step in data.dataset_cfg["DATA_PROCESSOR"]}
        self.masks = "mask_points_and_boxes_outside_range" in steps
        drawn = steps["sample_points"]["NUM_POINTS"]["test"] if "sample_points" in steps else -1
        if drawn != -1:
            raise InputError(f"model: its sample_points draws {drawn} points by chance, so one more point changes them all; set "
                             "NUM_POINTS to -1 in its DATA_PROCESSOR, to give it every point")
        self.voxels = next((step for name, step in steps.items() if name.startswith("transform_points_to_voxels")), None)

    def detect(self, points: torch.Tensor):
        more = points.new_zeros(len(points), max(0, self.features - 4))  # times in several sweeps: 0 for this one
        points = torch.cat([points, more], 1)[:, : self.features]
        if self.masks:
            low, high = (points.new_tensor(self.bounds[k: k + 2]) for k in (0, 3))
            points = points[((points[:, :2] >= low) & (points[:, :2] <= high)).all(1)]
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
        boxes, logits, classes = _best_of(batch)
        kept = logits.detach().topk(min(self.top, len(logits))).indices
        boxes = boxes[kept]
        return turned_back(boxes[:, : 9 if boxes.shape[1] >= 9 else 7], self.angle), logits[kept], classes[kept]


def _best_of(batch: dict[str, Any]) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """(boxes, logits, classes from 0) of one sample, each box with its best class, as Detector3DTemplate.post_processing finds it:
    from the columns of one or several heads, or from the labels that a second stage took from its proposals."""
    scores, numbers = batch["batch_cls_preds"], batch.get("multihead_label_mapping")
    best = [head.flatten(0, -2).max(1) for head in (scores if isinstance(scores, (list, tuple)) else [scores])]
    logits = torch.cat([head.values for head in best])
    if batch.get("cls_preds_normalized", False):
        logits = torch.logit(logits, 1e-7)
    if batch.get("has_class_labels", False):
        classes = batch["roi_labels" if "roi_labels" in batch else "batch_pred_labels"].reshape(-1) - 1
    else:
        classes = torch.cat([head.indices if numbers is None else numbers[k].to(head.indices)[head.indices] - 1
                             for k, head in enumerate(best)])
    boxes = batch["batch_box_preds"].flatten(0, -2)
    if "rois" in batch:  # proposals without a size are padding
        real = (batch["rois"].flatten(0, -2)[:, 3:6] > 0).all(1)
        boxes, logits, classes = boxes[real], logits[real], classes[real]
    return boxes, logits, classes
