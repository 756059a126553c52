"""A detector of yours for Mirage, from any Python with numpy. End its program with serve(detector), and run

    mirage attack --detector "exec:python3 my_detector.py" --data path/to/kitti

The detector is what mirage.attack(detector=…) takes: detector(image, points, pixel_from_velo) -> (boxes, logits),
detector(points), detector(image) for boxes in the picture, or detector(frame) for all sensors by name. It gets torch tensors if
the program has imported torch, else numpy arrays. This file imports nothing of Mirage; Mirage puts it on the path.

Attributes of the detector, all optional:
reads: some of "image", "points" and the names of other sensors (default: ("image", "points")); omitted arrays are empty.
pictures: "linear" (float32, scene-linear in [0, 1]) or "srgb8" (0 … 255 as in a file, uint8; float32 for torch).
region: x_min, x_max, y_min, y_max, m, where it searches. classes: ["Car", …], in the order of its class numbers.
heights: True if its boxes of 7 or 9 numbers are also compared in 3-D. local: True if frame.clean saves it work. version: a text
that changes with the network; Mirage stores answers on disk under it, so that an evaluation can resume.
new_sequence(): for a detector that remembers frames; called when a sequence begins. Without torch, the gradient comes from
backward(d_logits) -> (d_image, d_points), or {sensor: gradient}.

A tracker answers (boxes, logits, classes or None, identities). For mirage drive --tracker it has reads = ("detections",), and
frame.data["detections"] has a row for each box: x, y, z of the centre, length, width, height (m), yaw (rad), score.
"""

import inspect
import json
import math
import mmap
import os
import sys
import traceback

import numpy as np

ATTRIBUTES = {"reads": ("image", "points"), "pictures": "linear", "region": (0.0, 70.0, -40.0, 40.0), "classes": (),
              "heights": False, "local": False, "version": ""}
READS = ATTRIBUTES["reads"]
KINDS = (("cameras", "image"), ("lidars", "points"), ("sensors", "data"))  # of sensors, and the names of their arrays
GUIDE = ("give (boxes, logits [M]), boxes [M,5]: x, y, length, width (m), yaw (rad), [M,7]: x, y, z, length, width, height, "
         "yaw, or [M,9]: and vx, vy; for boxes in the picture [M,4]")


class Frame:
    """One frame: arrays or tensors by the sensors' names ("camera", "lidar", …).

    images: H×W×3, scene-linear RGB in [0, 1] (0 … 255 with "srgb8"). points: N×4, x, y, z in `velo` (x forward, y left, z up, m),
    reflectance. data: arrays of other sensors, as their plugins give them. pixel_from_velo: each camera's 3×4 matrix.
    id: as in the data set. continues: whether this frame follows the one before in its sequence. moment: {"sequence", "index",
    "time" (s), "world_from_ego" (12 numbers, 3×4)} or None. told: all that Mirage says of the frame, from JSON.

    clean: for a detector with `local`, the frame without the object, or None. Results from it may be cached under clean.key.
    Outside clean.changed[camera] (left, top, right, bottom; pixels, right and bottom exclusive) both pictures are equal. Answers
    must cover the whole frame. Gradients of unchanged pixels, and of points that clean.points also has, may be 0.
    """

    def __init__(self, told, read):
        self.told, self.id, self.continues = told, told.get("frame", ""), told.get("continues", False)
        self.moment = told.get("moment")
        cameras, lidars = told["cameras"], told["lidars"]
        self.images = {name: read(camera["image"]) for name, camera in cameras.items() if "image" in camera}
        self.points = {name: read(lidar["points"]) for name, lidar in lidars.items() if "points" in lidar}
        self.data = {name: read(sensor["data"]) for name, sensor in told.get("sensors", {}).items()}
        self.pixel_from_velo = {name: np.array(camera.get("pixel_from_velo", [0.0] * 12), np.float32).reshape(3, 4)
                                for name, camera in cameras.items()}
        self.clean = Frame(told["clean"], read) if "clean" in told else None
        self.key = told.get("key")
        self.changed = {name: tuple(camera["changed"]) for name, camera in cameras.items() if "changed" in camera}


class Network:
    """A callable as Mirage calls it, with checked answers. Gradients come from PyTorch's autograd or from its own `backward`."""

    error = ValueError

    def __init__(self, function, **given):
        """given: values for attributes that the function lacks. `error` (ValueError) for wrong ones."""
        if not callable(function):
            raise self._bad("type", f"{type(function).__name__} cannot be called", "give a function or a torch.nn.Module")
        self.function, self.torch = function, sys.modules.get("torch")
        self.differentiable = self.torch is not None or hasattr(function, "backward")
        self.takes = self._takes()
        self.finds_picture = self.takes == "image"
        for name in set(given) - set(ATTRIBUTES):
            raise self._bad(name, "is not an attribute of a detector", "use " + ", ".join(ATTRIBUTES))
        about = {name: getattr(function, name, value) for name, value in {**ATTRIBUTES, **given}.items()}
        reads, region = about["reads"], about["region"]
        self.reads = [self.takes] if self.takes in READS else [reads] if isinstance(reads, str) else list(reads)
        self.pictures, self.heights, self.local = about["pictures"], bool(about["heights"]), bool(about["local"])
        if self.local and self.takes != "frame":
            raise self._bad("local", "needs frame.clean", "take one argument, frame")
        self.classes = [str(name).capitalize() for name in about["classes"]]
        self.version = str(about["version"])
        self.region = [float(edge) for edge in (region() if callable(region) else region)]
        if len(self.region) != 4 or not all(map(math.isfinite, self.region)):
            raise self._bad("region", f"{self.region} are not four finite numbers", "give x_min, x_max, y_min, y_max, in m")
        parameters = getattr(function, "parameters", None)
        parameter = next(iter(parameters()), None) if self.torch and callable(parameters) else None
        self.device = getattr(function, "device", "cpu" if parameter is None else parameter.device)
        self._inputs, self._logits = {}, None

    def word(self):
        """The answer to the job hello: its description of itself."""
        return {"reads": self.reads, "pictures": self.pictures, "finds": "picture" if self.finds_picture else "boxes",
                "region": self.region, "gradient": self.differentiable, "classes": self.classes,
                "heights": self.heights, "local": self.local, "version": self.version,
                "remembers": hasattr(self.function, "new_sequence")}

    def _bad(self, field, problem, fix):
        return self.error(f"detector: {field}: {problem}; {fix}")

    def _takes(self):
        """Its arguments: "image" (its boxes are in the picture), "points", "frame", or "all": (image, points, pixel_from_velo)."""
        module = self.torch is not None and isinstance(self.function, self.torch.nn.Module)
        try:
            parameters = inspect.signature(self.function.forward if module else self.function).parameters.values()
        except (TypeError, ValueError):
            return "all"
        needed = [p for p in parameters if p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD) and p.default is p.empty]
        if len(needed) == 3 or any(p.kind is p.VAR_POSITIONAL for p in parameters):
            return "all"
        if len(needed) == 1:
            return needed[0].name if needed[0].name in ("frame", "points") else "image"
        raise self._bad("signature", f"takes {len(needed)} arguments",
                        "take (image, points, pixel_from_velo), points or image alone, or frame")

    def forward(self, frame, keep_graph):
        """(boxes, logits, classes or None, identities or None) as arrays, for a Frame of arrays. keep_graph prepares backward."""
        self._inputs, self._logits = {}, None
        if keep_graph and not self.differentiable:
            raise self._bad("gradient", "is missing", "write the network in torch, or give it backward(d_logits)")
        if hasattr(self.function, "new_sequence") and not frame.continues:
            self.function.new_sequence()
        for given in (frame, frame.clean) if self.torch else ():
            for group in (given.images, given.points, given.data, given.pixel_from_velo) if given else ():
                for name, array in group.items():
                    tensor = self.torch.from_numpy(array).to(self.device)
                    tensor = group[name] = tensor if tensor.is_floating_point() else tensor.float()
                    if keep_graph and given is frame and group is not frame.pixel_from_velo:
                        self._inputs[name] = tensor.requires_grad_(True)
        arguments = [frame]
        if self.takes != "frame":
            empty = self.torch.zeros if self.torch else np.zeros
            arguments = [group[name] if name in group else empty(shape) for group, name, shape in (
                (frame.images, "camera", (0, 0, 3)), (frame.points, "lidar", (0, 4)), (frame.pixel_from_velo, "camera", (3, 4)))]
            arguments = arguments[READS.index(self.takes):][:1] if self.takes in READS else arguments
        if self.torch is None:
            return self._checked(self.function(*arguments))
        with self.torch.set_grad_enabled(keep_graph):
            boxes, logits, *numbers = self._checked(self.function(*arguments))
        if keep_graph:
            if logits.numel() and not logits.requires_grad:
                raise self._bad("logits", "don't depend on image or points in a differentiable way",
                                "remove detach(), no_grad(), hard thresholds and .item() between them, or use --attack black-box")
            self._logits = logits
        return (*(part.detach().cpu().float().numpy() for part in (boxes, logits)),
                *(None if part is None else part.detach().cpu().int().numpy() for part in numbers))

    def _checked(self, found):
        kind = self.torch.Tensor if self.torch else np.ndarray
        boxes, logits, classes, identities = read_answer(found, self)
        if not all(isinstance(part, kind) for part in (boxes, logits)):
            raise self._bad("result", f"is {type(found).__name__}", f"return two {kind.__name__}s: (boxes, logits)")
        for name, part in (("boxes", boxes), ("logits", logits)):
            if not (part.is_floating_point() if self.torch else part.dtype.kind == "f"):
                raise self._bad(name, f"hold {part.dtype} values", "return floating-point numbers")
        if boxes.ndim != 2 or boxes.shape[1] not in ((4,) if self.finds_picture else (5, 7, 9)):
            raise self._bad("boxes", f"have shape {list(boxes.shape)}", GUIDE)
        for name, part in (("logits", logits), ("classes", classes), ("identities", identities)):
            if part is not None and (part.ndim != 1 or part.shape[0] != boxes.shape[0]):
                raise self._bad(name, f"have shape {list(part.shape)} for {boxes.shape[0]} boxes", "return one per box")
        if classes is not None and not self.classes and set(classes.tolist()) - {0}:
            raise self._bad("classes", "are not named, but some boxes have a class other than 0", 'give detector.classes = ["Car", …]')
        for name, part in (("boxes", boxes), ("logits", logits)):
            if not (self.torch.isfinite(part.detach()) if self.torch else np.isfinite(part)).all():
                raise self._bad(name, "are not finite", "look for logarithms, roots and divisions of 0 in the network")
        return boxes, logits, classes if self.classes else None, identities

    def backward(self, d_logits):
        """{sensor: gradient} of the last forward, as float32 arrays. d_logits: M. Sensors without a gradient are left out."""
        if self.torch is None:
            found = self.function.backward(d_logits)  # (d_image, d_points), or by the sensors' names
            found = found if isinstance(found, dict) else dict(zip(("camera", "lidar"), found))
        elif self._logits is None:
            raise RuntimeError("detector: backward before a forward that keeps its graph; call forward first")
        elif not self._logits.requires_grad:
            found = {}
        else:
            seed = self.torch.from_numpy(d_logits).to(self._logits)
            found = dict(zip(self._inputs, self.torch.autograd.grad(self._logits, list(self._inputs.values()), seed,
                                                                    allow_unused=True)))
            found = {name: part.detach().cpu().float().contiguous().numpy() for name, part in found.items() if part is not None}
        self._logits = None
        return {name: part for name, part in found.items() if part is not None}


RESULTS = (("pred_boxes", "pred_scores", "pred_labels", 1), ("bboxes_3d", "scores_3d", "labels_3d", 0),
           ("boxes_3d", "scores_3d", "labels_3d", 0))


def read_answer(found, network):
    """(boxes, logits, classes or None, identities or None) from a network's answer. The answer is two to four of these, a dictionary
    of OpenPCDet (pred_boxes, pred_scores, pred_labels, from 1) or of mmdetection3d (bboxes_3d or boxes_3d, scores_3d, labels_3d),
    or a list with one of them. Scores become logits."""
    if isinstance(found, (tuple, list)) and len(found) == 1:
        found = found[0]
    found = getattr(found, "pred_instances_3d", found)
    if isinstance(found, (tuple, list)) and len(found) in (2, 3, 4):
        return (*found, None, None)[:4]
    for names in RESULTS if hasattr(found, "keys") else ():
        if names[0] not in found.keys():
            continue
        boxes, scores, labels = (found[name] for name in names[:3])
        if hasattr(boxes, "gravity_center"):  # mmdetection3d's own tensor has the centre of the bottom
            boxes = network.torch.cat([boxes.gravity_center, boxes.tensor[:, 3:]], 1)
        scores = scores.clip(1e-7, 1 - 1e-7)
        logits = (network.torch or np).log(scores / (1 - scores))
        return boxes[:, : 9 if boxes.shape[1] >= 9 else 7], logits, labels - names[3], None
    what = f"has the keys {sorted(found.keys())}" if hasattr(found, "keys") else f"is {type(found).__name__}"
    raise network._bad("result", what, GUIDE)


class _Memory:
    """Arrays in the memory that Mirage shares with this process."""

    def __init__(self, path):
        self._file, self._map, self._free = open(path, "r+b"), b"", 0

    def begin(self, job):
        if len(self._map) != job["size"]:
            self._map = mmap.mmap(self._file.fileno(), job["size"])
        self._free = job["answer_at"]

    def read(self, where):
        count = int(np.prod(where["shape"]))
        return np.frombuffer(self._map, where["type"], count, where["at"]).reshape(where["shape"])

    def write(self, array, kind="float32"):
        where = {"at": self._free, "shape": list(array.shape), "type": kind}
        self.read(where)[...] = array
        self._free += -(-array.size * 4 // 64) * 64
        return where


def serve(function, **attributes):
    """Answers Mirage until it closes the connection. `attributes` stand in for those that the function lacks: reads=("points",)."""
    network = Network(function, **attributes)
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # other output goes to the terminal
    memory, asked = None, {}
    for line in sys.stdin:
        job = json.loads(line)
        answer = {"id": job["id"], "ok": True}
        try:
            if job["job"] == "hello":
                memory = _Memory(job["memory"])
                if network.torch:
                    network.torch.set_num_threads(job["threads"])
                answer.update(network.word(), protocol=1)
            elif job["job"] == "detect":
                memory.begin(job)
                asked = job
                boxes, logits, *numbers = network.forward(Frame(job, memory.read), job["gradient"])
                answer.update(boxes=memory.write(boxes), logits=memory.write(logits))
                for name, part in zip(("classes", "identities"), numbers):
                    if part is not None:
                        answer[name] = memory.write(part, "int32")
            else:
                memory.begin(job)
                for name, part in network.backward(memory.read(job["d_logits"]).copy()).items():
                    group, field = next(kind for kind in KINDS if name in asked.get(kind[0], {}))
                    answer.setdefault(group, {})[name] = {"d_" + field: memory.write(part)}
        except Exception as problem:  # the detector's own error: Mirage shows it in one line
            blind = "image" in network.reads and not any("image" in camera for camera in job.get("cameras", {}).values())
            if not (job["job"] == "detect" and blind):  # Mirage asks whether it works without its picture
                traceback.print_exc()
            answer = {"id": job["id"], "ok": False, "error": f"{type(problem).__name__}: {problem}"}
        print(json.dumps(answer), file=answers, flush=True)
