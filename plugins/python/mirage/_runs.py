"""The commands of `mirage`, for shipped detectors and for a network of the caller's."""

from __future__ import annotations

import html
import json
import os
import sys
import warnings
from typing import Any, Callable, Optional, Sequence

from . import _core
from ._settings import text_of, texts

LOADS_DETECTORS = ("attack", "audit", "compare", "detect", "evaluate", "validate", "view")
# Called with the current work, units done, units in all, the time left ("1:23") and a note.
Progress = Optional[Callable[[str, int, int, str, str], None]]


class Result(dict):
    """The content of a command's result.json. Printing it shows the command's table."""

    def __init__(self, values: dict[str, Any], summary: str):
        super().__init__(values)
        self.summary = summary.rstrip()

    def __str__(self) -> str:
        return self.summary or super().__repr__()

    __repr__ = __str__

    def _repr_html_(self) -> str | None:
        """A notebook's output: the page that `view` wrote (None: the table)."""
        page = self.get("page")
        if not isinstance(page, str) or not page.endswith(".html") or not os.path.exists(page):
            return None
        with open(page, encoding="utf-8") as file:
            return (f'<iframe srcdoc="{html.escape(file.read())}" width="100%" height="640" style="border: 0" '
                    f'title="{html.escape(page)}"></iframe>')


def _show(what: str, done: int, total: int, left: str, note: str) -> None:
    """Prints progress as one line where standard error is not a terminal, in a notebook."""
    print(f"\r{what} {done}/{total}  {left} left  {note}    ", end="" if done < total else "\n", file=sys.stderr, flush=True)


def _run(command: str, settings: dict[str, Any], detectors: Any, where: str, quiet: bool, progress: Progress = None) -> Result:
    """detectors: one as for `attack`, None, or a list as for `compare`."""
    named = texts(settings)
    words, given = [], []
    named["quiet"] = "false"  # the table is for print(result)
    for detector in detectors if isinstance(detectors, (list, tuple)) else [detectors]:
        if detector is None:
            continue
        if isinstance(detector, (str, os.PathLike)):
            words.append(text_of(detector))
            continue
        from ._detector import TorchDetector, content_of

        adapter = detector if isinstance(detector, TorchDetector) else TorchDetector(detector)
        words.append("python:2" if given else "python")
        given.append((adapter, content_of(adapter.function)))
    if words:
        named["detectors" if command == "compare" else "detector"] = text_of(words)
    own = [word for word in words if not word.startswith(("python", "exec:"))]
    if command in LOADS_DETECTORS and (own or not words):
        _check_torch(where)
    if progress is None and not quiet and "ipykernel" in sys.modules:
        progress = _show
    values, summary = _core.run(command, named, given, where, progress, quiet)
    return Result(json.loads(values), summary)


def _check_torch(where: str) -> None:
    """Failure if this process has another PyTorch than the shipped detectors' LibTorch: one process cannot hold both."""
    version = getattr(sys.modules.get("torch"), "__version__", "")
    if version and version.split(".")[:2] != _core.libtorch_version.split(".")[:2]:
        raise _core.Failure(f"{where}: this process has PyTorch {version}, and the shipped detectors need LibTorch "
                            f"{_core.libtorch_version}; use the command line (mirage attack, mirage evaluate) for them")


def _samples(data: str) -> list:
    """The inputs that a detector gets for the first and the last frame, and for the first with half its points."""
    import torch

    from ._insertion import read_frame

    ids = _core.list_frames(data)
    samples = []
    for id in ids[:1] + ids[1:][-1:]:
        frame = read_frame(data, id)
        samples.append(tuple(torch.tensor(array) for array in (frame.image, frame.points_in_view, frame.pixel_from_velo)))
    image, points, projection = samples[0]
    return samples + [(image, points[::2].contiguous(), projection)]


def detect(detector: Callable | str = "fusion", *, data: str | os.PathLike, out: str | os.PathLike | None = None,
           quiet: bool = True, progress: Progress = None, **settings: Any) -> Result:
    """Runs a detector over a data set and scores it. Returns what OUT/result.json holds: ap50, ap70, vehicles and how many are
    found (score of 0.3, IoU over 0.7), hints at what is wrong with the boxes, strata, …

    detector: as for `attack`. out: None: out/detect. settings: as for `mirage detect`: frames, check, kitti, …
    quiet: False shows progress and messages on standard error. progress: a function to call with (what is being done, units
    done, units in all, time left, note). Errors are those of `attack`. This holds for every command.
    """
    named = dict(settings, data=os.fspath(data), out=out)
    return _run("detect", named, detector, "mirage.detect", quiet, progress)


def audit(detector: Callable | str = "fusion", *, data: str | os.PathLike, out: str | os.PathLike | None = None,
          quiet: bool = True, progress: Progress = None, **settings: Any) -> Result:
    """Measures what a detector loses when one of its inputs is wrong, and whether it uses its picture. Returns what OUT/result.json
    holds: audit, uses, … detector: as for `attack`. out: None: out/audit. settings: as for `mirage audit`: frames, gate, …"""
    return _run("audit", dict(settings, data=os.fspath(data), out=out), detector, "mirage.audit", quiet, progress)


def check(detector: Callable | str, data: str | os.PathLike, *, vehicles: int = 12, frames: int = 0,
          out: str | os.PathLike | None = None, **settings: Any) -> Result | None:
    """Checks that a detector is connected correctly. Prints what it finds in recorded frames, its boxes, headings and logits
    beside the labels, and how much of its change the gradient predicts when an object on a roof moves by 1 cm. Names likely
    mistakes: degrees for radians, probabilities for logits, length and width exchanged, other axes, too few boxes. Returns what
    `detect` returns. Prints any error, also the detector's own, and returns None then.

    vehicles: at how many the gradient is checked. frames: only the first ones (0: all). out, settings: as for `detect`.
    """
    try:
        result = detect(detector, data=data, out=out, check=vehicles, frames=frames, **settings)
    except Exception as problem:  # the detector's own error as well
        print(f"{type(problem).__name__}: {problem}")
        return None
    print(result)
    return result


def attack(detector: Callable | str = "fusion", *, data: str | os.PathLike, out: str | os.PathLike,
           quiet: bool = True, progress: Progress = None, copy: bool = True, **settings: Any) -> Result:
    """Learns one mesh that hides the vehicles of a data set from a detector. Resumes from OUT's checkpoint if there is one.
    Returns what OUT/result.json holds.

    detector: a callable (image, points, pixel_from_velo) -> (boxes, logits) on torch tensors, differentiated by PyTorch's
    autograd without any export, or a name as for `mirage attack --detector`.
        image: H×W×3 float32, scene-linear RGB in [0, 1]. points: N×4 float32, x, y, z in `velo` (m), reflectance: only those
        in view (frame.points_in_view). pixel_from_velo: 3×4 float32.
        boxes, in `velo`: M×5, x, y of the centre, length, width (m), yaw (rad, counter-clockwise from +x); M×7, x, y, z of the
        centre, length, width, height, yaw; or M×9, these and the velocity's x and y (m/s). logits: M. A third tensor may hold
        M classes. Dictionaries of OpenPCDet and mmdetection3d are read too.
        A callable with one argument called points gets no picture; with one called frame, all sensors by name
        (mirage.mirage_serve.Frame). With any other single argument it gets the image, and its boxes are in the picture: M×4,
        left, top, right, bottom (pixels).
        Optional attributes: `reads`, its inputs (default: ("image", "points")); `region`, where it searches, x_min, x_max,
        y_min, y_max, m (default: 0, 70, -40, 40); `classes`, its class names (["Car", …]); more in mirage.mirage_serve.
        A torch.nn.Module runs as it is: call .eval() first.
        "exec:python3 my_detector.py" is a program that calls mirage.serve, in any Python, for any GPU.
    out: the run folder, which `evaluate`, `export` and `validate` read. copy: also write a TorchScript copy of a callable
    (OUT/detector.pt), by which the command line can judge the run; warns if there can be none.
    settings: as for `mirage attack`: iterations, batch, target, parts, size, expect, vertex_rate, texel_rate, seed, …

    The callable is called from one thread at a time. Raises InputError for wrong settings, data or answers, Failure for failed
    work, and the callable's own errors. Ctrl-C ends it with KeyboardInterrupt after the current step, with a checkpoint.
    """
    data, out = os.fspath(data), os.fspath(out)
    if isinstance(detector, (str, os.PathLike)):
        return _run("attack", dict(settings, data=data, out=out), detector, "mirage.attack", quiet, progress)
    from ._copy import write_copy
    from ._detector import TorchDetector

    adapter = TorchDetector(detector)
    result = _run("attack", dict(settings, data=data, out=out), adapter, "mirage.attack", quiet, progress)
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


def evaluate(run: str | os.PathLike | None = None, *, detector: Callable | str | None = None, out: str | os.PathLike | None = None,
             quiet: bool = True, progress: Progress = None, **settings: Any) -> Result:
    """Measures how often a run's mesh fools a detector on held-out vehicles, beside a random mesh of its size. Returns what
    OUT/result.json holds: fn_asr, fp_asr, asr, vehicles, recall_iou, random, …; shares are in [0, 1].

    run: the run folder. None: judge objects instead, mesh=["a.glb", …] or "zoo", on every car of data=…
    detector: a callable as for `attack`, a name as for `mirage evaluate --detector`, or None for the run's own. The own one of
    a run against a callable is its TorchScript copy. out: None: RUN/evaluate, or out/evaluate without a run.
    settings: as for `mirage evaluate`: data, hosts, hosts_of, random_meshes, score, iou, …
    """
    out = os.path.join(run, "evaluate") if out is None and run is not None else out
    return _run("evaluate", dict(settings, run=run, out=out), detector, "mirage.evaluate", quiet, progress)


def compare(detectors: Sequence[Callable | str], *, data: str | os.PathLike, runs: Sequence[str | os.PathLike] = (),
            mesh: Sequence[str | os.PathLike] | str = (), out: str | os.PathLike | None = None, quiet: bool = True,
            progress: Progress = None, **settings: Any) -> Result:
    """Tells whether the second detector is easier to fool than the first, on the same cars with the same objects on their roofs.
    Returns what OUT/result.json holds, under compare: difference (second less first share of vanished cars), low, high, …

    detectors: two as for `attack`, or one name with two weights or defenses. runs: folders of `attack`, whose meshes are the
    objects. mesh: further files, or "zoo". out: None: out/compare. settings: as for `mirage compare`: adaptive, frames, score, …
    """
    named = dict(settings, data=data, runs=list(runs) or None, mesh=mesh or None, out=out)
    return _run("compare", named, list(detectors), "mirage.compare", quiet, progress)


def validate(run: str | os.PathLike, *, detector: Callable | str | None = None, out: str | os.PathLike | None = None,
             quiet: bool = True, progress: Progress = None, **settings: Any) -> Result:
    """Renders a run's vehicles in Blender Cycles, runs the detector on these pictures and writes OUT/report.html.

    detector: as for `evaluate`. out: None: RUN/validate. settings: as for `mirage validate`: frames, samples, light, …
    """
    run = os.fspath(run)
    out = os.path.join(run, "validate") if out is None else os.fspath(out)
    return _run("validate", dict(settings, run=run, out=out), detector, "mirage.validate", quiet, progress)


def view(data: str | os.PathLike | None = None, *, run: str | os.PathLike | None = None,
         detector: Callable | str | None = None, out: str | os.PathLike | None = None, quiet: bool = True,
         progress: Progress = None, **settings: Any) -> Result:
    """Writes one page that opens offline: frames of a data set, or of a run with its attacks and the boxes of its detector (or of
    `detector`). Result["page"] is the file. out: None: out/view. settings: as for `mirage view`: frames, drive, detections, …"""
    named = dict(settings, data=data, run=run, out=out)
    return _run("view", named, detector, "mirage.view", quiet, progress)


def export(run: str | os.PathLike, *, out: str | os.PathLike | None = None, quiet: bool = True, progress: Progress = None,
           **settings: Any) -> Result:
    """Writes a run's mesh and scenes as .glb files. out: None: RUN/export. settings: as for `mirage export`: frames, …"""
    run = os.fspath(run)
    out = os.path.join(run, "export") if out is None else os.fspath(out)
    return _run("export", dict(settings, run=run, out=out), None, "mirage.export", quiet, progress)


def generate(out: str | os.PathLike, *, frames: int = 8, quiet: bool = True, progress: Progress = None,
             **settings: Any) -> Result:
    """Writes generated frames in KITTI's layout to `out`. settings: as for `mirage generate`: rig, lidar, seed, truth, …"""
    named = dict(settings, out=os.fspath(out), frames=frames)
    return _run("generate", named, None, "mirage.generate", quiet, progress)
