"""A TorchScript copy of a network, so that the command line can judge a run against it."""

from __future__ import annotations

import os
import warnings
from typing import Callable

import torch

from ._detector import TorchDetector, parts_of


class _Wrapped(torch.nn.Module):
    """A function with the modules that it uses, so that their weights are parameters of the copy."""

    def __init__(self, function: Callable):
        super().__init__()
        self.used = torch.nn.ModuleList(part for _, part in parts_of(function) if isinstance(part, torch.nn.Module))
        self._function = [function]  # in a list: a module there would be registered twice

    def forward(self, *inputs):
        return self._function[0](*inputs)


def _agree(function: Callable, copy: Callable, inputs: tuple[torch.Tensor, ...]) -> bool:
    with torch.no_grad():
        for ours, theirs in zip(function(*inputs), copy(*inputs)):
            if ours.shape != theirs.shape or not torch.allclose(ours, theirs, rtol=1e-3, atol=1e-4):
                return False
    return True


def write_copy(detector: TorchDetector, samples: list[tuple[torch.Tensor, ...]], file: str) -> str:
    """Writes the copy, or nothing; why not, in words, or "". What it says must be what the network says, on all
    samples: their numbers of points differ, which a trace that has frozen a shape does not survive."""
    function = detector.function
    arity = 1 if detector.finds_picture else 3
    samples = [tuple(tensor.to(detector.device) for tensor in sample[:arity]) for sample in samples]
    why = "it is not TorchScript"
    temporary = f"{file}.mirage-{os.getpid()}.tmp"  # the core clears away those of dead processes
    for make in (torch.jit.script, lambda f: torch.jit.trace(
            f if isinstance(f, torch.nn.Module) else _Wrapped(f), samples[0], check_trace=False)):
        try:
            with warnings.catch_warnings(), torch.no_grad():
                warnings.simplefilter("ignore")
                copy = make(function)
                copy.save(temporary)
                copy = torch.jit.load(temporary)
            if all(_agree(function, copy, sample) for sample in samples):
                os.replace(temporary, file)
                return ""
            why = "a trace of it says something else on another frame"
        except Exception as problem:  # whatever TorchScript objects to
            why = (str(problem).strip() or type(problem).__name__).splitlines()[0]
    if os.path.exists(temporary):
        os.remove(temporary)
    return why
