"""The commands of `mirage`, against a network of the caller's too."""

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
# Called with what is done, units done, units in all, the time left ("1:23") and a note.
Progress = Optional[Callable[[str, int, int, str, str], None]]


class Result(dict):
    """What a command's result.json holds; printed it is the command's table."""

    def __init__(self, values: dict[str, Any], summary: str):
        super().__init__(values)
        self.summary = summary.rstrip()

    def __str__(self) -> str:
        return self.summary or super().__repr__()

    __repr__ = __str__

    def _repr_html_(self) -> str | None:
        """In a notebook: the page that `view` wrote (None: the summary)."""
        page = self.get("page")
        if not isinstance(page, str) or not page.endswith(".html") or not os.path.exists(page):
            return None
        with open(page, encoding="utf-8") as file:
            return (f'<iframe srcdoc="{html.escape(file.read())}" width="100%" height="640" style="border: 0" '
                    f'title="{html.escape(page)}"></iframe>')


def _show(what: str, done: int, total: int, left: str, note: str) -> None:
    """A line of progress where standard error is no terminal: in a notebook."""
    print(f"\r{what} {done}/{total}  {left} left  {note}    ", end="" if done < total else "\n", file=sys.stderr, flush=True)


def _run(command: str, settings: dict[str, Any], detectors: Any, where: str, quiet: bool, progress: Progress = None) -> Result:
    """detectors: one as of `attack`, None, or those of `compare`."""
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


def detect(detector: Callable | str = "fusion", *, data: str | os.PathLike, out: str | os.PathLike | None = None,
           quiet: bool = True, progress: Progress = None, **settings: Any) -> Result:
    """Runs a detector over a data set and scores it. Returns what OUT/result.json holds: ap50, ap70, found of vehicles (at a
    score of 0.3 and an IoU over 0.7), hints at what is wrong with the boxes, strata, …

    detector: as of `attack`. out: None: out/detect. settings: as of `mirage detect`: frames, check, kitti, …
    """
    named = dict(settings, data=os.fspath(data), out=out)
    return _run("detect", named, detector, "mirage.detect", quiet, progress)


def audit(detector: Callable | str = "fusion", *, data: str | os.PathLike, out: str | os.PathLike | None = None,
          quiet: bool = True, progress: Progress = None, **settings: Any) -> Result:
    """What a detector loses when one of its inputs is wrong, and whether it uses its picture. Settings as of `mirage audit`:
    frames, gate, …"""
    return _run("audit", dict(settings, data=os.fspath(data), out=out), detector, "mirage.audit", quiet, progress)


def check(detector: Callable | str, data: str | os.PathLike, *, vehicles: int = 12, frames: int = 0,
          out: str | os.PathLike | None = None, **settings: Any) -> Result | None:
    """Is my glue right? Prints what the detector finds in recorded frames, its boxes, headings and logits beside the labels,
    how much of its change its gradient sees as an object on a roof moves by 1 cm, and what looks wrong: degrees for
    radians, probabilities for logits, length and width exchanged, other axes, too few boxes. Raises nothing that the
    detector or the data is to blame for: prints it, and returns None.

    vehicles: at how many the gradient is looked at. frames: only the first ones (0: all).
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
    """Learns one mesh that hides the vehicles of a data set from a detector; goes on from where it was
    stopped. Returns what OUT/result.json holds.

    detector: a callable (image, points, pixel_from_velo) -> (boxes, logits) on torch tensors, in PyTorch's own
    autograd, without any export, or a name as of `mirage attack --detector`.
        image: H×W×3 float32, scene-linear RGB in [0, 1]. points: N×4 float32, x, y, z (m), reflectance, those in view
        (frame.points_in_view).
        pixel_from_velo: 3×4 float32. boxes: M×5, x, y, length, width (m), yaw (rad) in the bird's-eye view, M×7, x, y, z of
        the centre, length, width, height, yaw, or M×9, and the velocity's x and y; logits: M. A third tensor may hold M
        classes. Dictionaries as of OpenPCDet and mmdetection3d are read, too.
        One whose only argument is called points reads no picture; one that takes the image alone returns boxes in the
        picture: M×4, left, top, right, bottom (pixels).
        One whose only argument is called frame gets all sensors by name (mirage.mirage_serve.Frame).
        An attribute `reads` (("points",)) says what it looks at; both without it; `region` (x_min, x_max, y_min, y_max in m)
        where, 0, 70, -40, 40 without it; `classes` (["Car", …]) what its classes' numbers mean; others: mirage.mirage_serve.
        A torch.nn.Module runs as it is: call .eval() first.
        "exec:python3 my_detector.py": a program (mirage.serve), in any Python, for any GPU.
    out: the run folder, as `mirage evaluate`, `export` and `validate` read it. copy: keep a TorchScript copy of a
    callable there (OUT/detector.pt), where one can be made, for the command line to judge the run by.
    settings: as of `mirage attack`: iterations, batch, target, parts, size, expect, vertex_rate, texel_rate, seed, …

    The callable is called from one thread at a time. Ctrl-C stops after the step at hand, with a checkpoint.
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
    """How often a run's mesh fools a detector on vehicles that it was not learned on, beside a random mesh of its size.
    Returns what OUT/result.json holds: fn_asr, fp_asr, asr, vehicles, recall_iou, random, …, shares in [0, 1].

    run: None: of objects, mesh=["a.glb", …] or "zoo", on every car of data=…
    detector: a callable as of `attack`, a name as of `mirage evaluate --detector`, or None: the run's own (of a run
    against a callable its TorchScript copy). out: None: RUN/evaluate.
    settings: as of `mirage evaluate`: data, hosts, hosts_of, random_meshes, score, iou, …
    """
    out = os.path.join(run, "evaluate") if out is None and run is not None else out
    return _run("evaluate", dict(settings, run=run, out=out), detector, "mirage.evaluate", quiet, progress)


def compare(detectors: Sequence[Callable | str], *, data: str | os.PathLike, runs: Sequence[str | os.PathLike] = (),
            mesh: Sequence[str | os.PathLike] | str = (), out: str | os.PathLike | None = None, quiet: bool = True,
            progress: Progress = None, **settings: Any) -> Result:
    """Is the second detector easier to fool than the first? Both see the same cars of a data set with the same objects on their
    roofs. Returns what OUT/result.json holds, under compare: difference (of the shares that vanish), low, high, parts, worse, …

    detectors: two as of `attack`, or one word with two weights or defenses. runs: of `attack`, whose meshes are the objects.
    mesh: others, or "zoo". settings: as of `mirage compare`: adaptive, frames, score, …
    """
    named = dict(settings, data=data, runs=list(runs) or None, mesh=mesh or None, out=out)
    return _run("compare", named, list(detectors), "mirage.compare", quiet, progress)


def validate(run: str | os.PathLike, *, detector: Callable | str | None = None, out: str | os.PathLike | None = None,
             quiet: bool = True, progress: Progress = None, **settings: Any) -> Result:
    """Draws a run's vehicles in Blender Cycles, asks the detector about these pictures and writes OUT/report.html.

    detector: as of `evaluate`. out: None: RUN/validate. settings: as of `mirage validate`: frames, samples, light, …
    """
    run = os.fspath(run)
    out = os.path.join(run, "validate") if out is None else os.fspath(out)
    return _run("validate", dict(settings, run=run, out=out), detector, "mirage.validate", quiet, progress)


def view(data: str | os.PathLike | None = None, *, run: str | os.PathLike | None = None,
         detector: Callable | str | None = None, out: str | os.PathLike | None = None, quiet: bool = True,
         progress: Progress = None, **settings: Any) -> Result:
    """Frames, boxes and attacks as one page that opens offline: of a data set, or of a run, whose detector (or the one that is
    given) looks at them. Result["page"] is the file. settings: as of `mirage view`."""
    named = dict(settings, data=data, run=run, out=out)
    return _run("view", named, detector, "mirage.view", quiet, progress)


def export(run: str | os.PathLike, *, out: str | os.PathLike | None = None, quiet: bool = True, progress: Progress = None,
           **settings: Any) -> Result:
    """Writes a run's mesh and scenes as .glb files; settings as of `mirage export`: frames, …"""
    run = os.fspath(run)
    out = os.path.join(run, "export") if out is None else os.fspath(out)
    return _run("export", dict(settings, run=run, out=out), None, "mirage.export", quiet, progress)


def generate(out: str | os.PathLike, *, frames: int = 8, quiet: bool = True, progress: Progress = None,
             **settings: Any) -> Result:
    """Writes generated frames in KITTI's layout; settings as of `mirage generate`: rig, lidar, seed, truth, …"""
    named = dict(settings, out=os.fspath(out), frames=frames)
    return _run("generate", named, None, "mirage.generate", quiet, progress)
