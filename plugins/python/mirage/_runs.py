"""Learning and judging a mesh: what `mirage attack` and `mirage evaluate` do, against a network of the caller's too."""

from __future__ import annotations

import json
import os
import sys
import warnings
from typing import Any, Callable

from . import _core
from ._settings import text_of, texts


def _run(command: str, settings: dict[str, Any], detector: Any, where: str) -> dict[str, Any]:
    named = texts(settings)
    adapter, content = None, ""
    if isinstance(detector, (str, os.PathLike)):
        named["detector"] = text_of(detector)
    elif detector is not None:
        from ._detector import TorchDetector, content_of

        adapter = detector if isinstance(detector, TorchDetector) else TorchDetector(detector)
        content = content_of(adapter.function)
        named["detector"] = "python"
    if adapter is None:
        _check_torch(where)
    return json.loads(_core.run(command, named, adapter, content, where))


def _check_torch(where: str) -> None:
    """The shipped detectors bring Debian's LibTorch, which does not live beside another one in a process."""
    version = getattr(sys.modules.get("torch"), "__version__", "")
    if version and version.split(".")[:2] != _core.libtorch_version.split(".")[:2]:
        raise _core.Failure(f"{where}: this process has PyTorch {version}, and the shipped detectors need LibTorch "
                            f"{_core.libtorch_version}; use the command line (mirage attack, mirage evaluate) for them")


def _samples(data: str) -> list:
    """Two frames' inputs as a detector gets them, and the first with half its points."""
    import torch

    from ._insertion import read_frame

    ids = _core.list_frames(data)
    samples = []
    for id in ids[:1] + ids[1:][-1:]:
        frame = read_frame(data, id)
        samples.append(tuple(torch.tensor(array) for array in (frame.image, frame.points_in_view, frame.pixel_from_velo)))
    image, points, projection = samples[0]
    return samples + [(image, points[::2].contiguous(), projection)]


def attack(detector: Callable | str = "fusion", *, data: str | os.PathLike, out: str | os.PathLike,
           quiet: bool = True, copy: bool = True, **settings: Any) -> dict[str, Any]:
    """Learns one mesh that hides the vehicles of a data set from a detector; goes on from where it was
    stopped. Returns what OUT/result.json holds.

    detector: a callable (image, points, pixel_from_velo) -> (boxes, logits) on torch tensors, in PyTorch's own
    autograd, without any export, or a name as of `mirage attack --detector`.
        image: H×W×3 float32, scene-linear RGB in [0, 1]. points: N×4 float32, x, y, z (m), reflectance, those in view
        (frame.points_in_view).
        pixel_from_velo: 3×4 float32. boxes: M×5, x, y, length, width (m), yaw (rad) in the bird's-eye view; logits: M.
        One that takes the image alone returns boxes in the picture: M×4, left, top, right, bottom (pixels).
        An attribute `region` (x_min, x_max, y_min, y_max in m) says where it looks; 0, 70, -40, 40 without it.
        A torch.nn.Module runs as it is: call .eval() first.
    out: the run folder, as `mirage evaluate`, `export` and `validate` read it. copy: keep a TorchScript copy of a
    callable there (OUT/detector.pt), where one can be made, for the command line to judge the run by.
    settings: as of `mirage attack`: iterations, batch, target, parts, size, expect, vertex_rate, texel_rate, seed, …

    The callable is called from one thread at a time. Ctrl-C stops after the step at hand, with a checkpoint.
    """
    data, out = os.fspath(data), os.fspath(out)
    if isinstance(detector, (str, os.PathLike)):
        return _run("attack", dict(settings, data=data, out=out, quiet=quiet), detector, "mirage.attack")
    from ._copy import write_copy
    from ._detector import TorchDetector

    adapter = TorchDetector(detector)
    result = _run("attack", dict(settings, data=data, out=out, quiet=quiet), adapter, "mirage.attack")
    file = os.path.join(out, "detector.pt")
    if os.path.exists(file):
        os.remove(file)  # of an earlier network
    if copy:
        why = write_copy(adapter, _samples(data), file)
        if not why:
            _core.remember_code_made_here(file)
        else:
            warnings.warn(f"mirage.attack: the run has no TorchScript copy of the detector ({why}); judge it with "
                          f"mirage.evaluate({out!r}, detector=…)", stacklevel=2)
    return result


def evaluate(run: str | os.PathLike, *, detector: Callable | str | None = None, out: str | os.PathLike | None = None,
             quiet: bool = True, **settings: Any) -> dict[str, Any]:
    """How often a run's mesh fools a detector on vehicles that it was not learned on, beside a random mesh of its size.
    Returns what OUT/result.json holds: fn_asr, fp_asr, asr, vehicles, recall_iou, random, …, shares in [0, 1].

    detector: a callable as of `attack`, a name as of `mirage evaluate --detector`, or None: the run's own (of a run
    against a callable its TorchScript copy). out: None: RUN/evaluate.
    settings: as of `mirage evaluate`: data, hosts, hosts_of, random_meshes, score, iou, …
    """
    run = os.fspath(run)
    out = os.path.join(run, "evaluate") if out is None else os.fspath(out)
    return _run("evaluate", dict(settings, run=run, out=out, quiet=quiet), detector, "mirage.evaluate")


def generate(out: str | os.PathLike, *, frames: int = 8, quiet: bool = True, **settings: Any) -> dict[str, Any]:
    """Writes generated frames in KITTI's layout; settings as of `mirage generate`: rig, lidar, seed, truth, …"""
    return _run("generate", dict(settings, out=os.fspath(out), frames=frames, quiet=quiet), None, "mirage.generate")
