"""A TorchScript copy of a network, so that the command line can judge a run against it."""

from __future__ import annotations

import contextlib
import os
import warnings
from typing import Callable, Iterator

import torch

from ._detector import TorchDetector, parts_of


class _Wrapped(torch.nn.Module):
    """A function with the modules that it calls, so that their weights are parameters of the copy."""

    def __init__(self, function: Callable):
        super().__init__()
        self.used = torch.nn.ModuleList(part for _, part in parts_of(function) if isinstance(part, torch.nn.Module))
        self._function = [function]  # in a list: a module there would be registered twice

    def forward(self, *inputs):
        return self._function[0](*inputs)


class _OfAll(torch.nn.Module):
    """The stored module. It has the signature that the plugin calls, and `region`: TorchScript keeps only attributes of the object."""

    def __init__(self, network: Callable, region: list[float]):
        super().__init__()
        self.network, self.region = network, region

    def forward(self, image: torch.Tensor, points: torch.Tensor, pixel_from_velo: torch.Tensor):
        return self.network(image, points, pixel_from_velo)


class _OfPoints(_OfAll):
    def forward(self, image: torch.Tensor, points: torch.Tensor, pixel_from_velo: torch.Tensor):
        return self.network(points)


class _OfImage(_OfAll):
    def forward(self, image: torch.Tensor):
        return self.network(image)


@contextlib.contextmanager
def _as_the_plugin_runs_it() -> Iterator[None]:
    """Uses the executor of plugins/detectors/torchscript: another one runs other passes, and tensors can get other types."""
    executor, profiling = torch._C._jit_set_profiling_executor(True), torch._C._jit_set_profiling_mode(False)
    try:
        yield
    finally:
        torch._C._jit_set_profiling_executor(executor)
        torch._C._jit_set_profiling_mode(profiling)


def _answer(function: Callable, inputs: tuple[torch.Tensor, ...]) -> list[torch.Tensor | None]:
    """Boxes, logits, and the gradients of the logits' sum with respect to image and points (None: no dependence)."""
    inputs = tuple(tensor.clone().requires_grad_(k < 2) for k, tensor in enumerate(inputs))
    with torch.enable_grad():
        boxes, logits = function(*inputs)
        gradients = (torch.autograd.grad(logits.sum(), inputs[:2], allow_unused=True) if logits.requires_grad
                     else [None] * len(inputs[:2]))
    return [boxes.detach(), logits.detach(), *gradients]


def _differs(function: Callable, copy: Callable, inputs: tuple[torch.Tensor, ...]) -> str:
    """How the copy's answer differs from the function's, in words; "" if it does not."""
    names = ("its boxes", "its logits", "its gradients to the image", "its gradients to the points")
    for name, ours, theirs in zip(names, _answer(function, inputs), _answer(copy, inputs)):
        if ours is None and theirs is None:
            continue
        like = theirs if ours is None else ours
        ours, theirs = (torch.zeros_like(like) if tensor is None else tensor.double() for tensor in (ours, theirs))
        if ours.shape != theirs.shape:
            return f"{name} have shape {list(theirs.shape)} instead of {list(ours.shape)}"
        if name == "its boxes" and ours.shape[1] > 5:
            return f"its boxes have {ours.shape[1]} columns; a TorchScript detector's have 5 (4 in the picture)"
        largest = float(ours.abs().max()) if ours.numel() else 0.0
        if not torch.allclose(ours, theirs.to(ours.dtype), rtol=1e-3, atol=1e-3 * largest + 1e-9):
            return f"{name} differ on another frame"
    return ""


def _reason(problem: Exception) -> str:
    """The line of an error that gives the reason: the last of a TorchScript trace, else the first. The plugin does the same."""
    text = str(problem)
    lines = [line.strip() for line in text.splitlines() if line.strip(" \t\r~^<-HERE")]
    if not lines:
        return type(problem).__name__
    line = lines[-1 if "Traceback of TorchScript" in text else 0]
    return line if " " in line else f"{type(problem).__name__} in PyTorch itself: {line}"


def write_copy(detector: TorchDetector, samples: list[tuple[torch.Tensor, ...]], file: str) -> str:
    """Writes a TorchScript copy to `file`. Returns "", or the reason why it wrote none. Run as the plugin runs it, the copy must
    give the network's answers and gradients on all samples (image, points, pixel_from_velo). Their numbers of points differ, so
    a trace that has frozen a shape fails."""
    if detector.takes == "frame":
        return "it takes sensors by name, but a TorchScript detector takes one picture and one sweep"
    if detector.pictures != "linear":
        return f"its pictures are {detector.pictures}, but a TorchScript detector's are linear"
    network, signature = detector.function, {"points": _OfPoints, "image": _OfImage}.get(detector.takes, _OfAll)
    whole, arity = (_OfImage, 1) if detector.finds_picture else (_OfAll, 3)
    function = signature(network, detector.region)
    samples = [tuple(tensor.to(detector.device) for tensor in sample[:arity]) for sample in samples]
    why = []
    temporary = f"{file}.mirage-{os.getpid()}.tmp"  # the core clears away those of dead processes
    traced = network if isinstance(network, torch.nn.Module) else _Wrapped(network)
    for name, make in (("script", lambda: torch.jit.script(function)),
                       ("trace", lambda: torch.jit.script(whole(torch.jit.trace(  # a trace has no attributes
                           signature(traced, detector.region), samples[0], check_trace=False), detector.region)))):
        try:
            with warnings.catch_warnings(), torch.no_grad(), _as_the_plugin_runs_it():
                warnings.simplefilter("ignore")
                copy = make()
                copy.save(temporary)
                copy = torch.jit.load(temporary)
                found = next(filter(None, (_differs(function, copy, sample) for sample in samples)), "")
            if not found:
                os.replace(temporary, file)
                return ""
            why.append(f"torch.jit.{name}: {found}")
        except Exception as problem:  # any error of TorchScript
            why.append(f"torch.jit.{name}: {_reason(problem)}")
    if os.path.exists(temporary):
        os.remove(temporary)
    return "; ".join(why)
