"""A network as a detector, and what an attack goes on by: the code and the weights that it works with."""

from __future__ import annotations

import hashlib
import inspect
import json
from types import CodeType
from typing import Any, Callable, Iterator

import torch

from ._core import InputError
from .mirage_serve import Frame, Network

IGNORED = ("torch", "numpy", "mirage")


def parts_of(function: Callable, seen: set[int] | None = None) -> Iterator[tuple[str, Any]]:
    """The modules, tensors and code that a callable works with: itself, its attributes, its closure, its globals, and those
    of the functions among them."""
    seen = set() if seen is None else seen
    plain = getattr(function, "__func__", function)
    places: list[tuple[str, Any]] = [("self", function), ("bound", getattr(function, "__self__", None))]
    if not isinstance(function, torch.nn.Module):
        places += sorted(getattr(function, "__dict__", {}).items())
    code = getattr(plain, "__code__", None)
    if code is not None:
        yield "code", code
        for name, cell in zip(code.co_freevars, plain.__closure__ or ()):
            try:
                places.append((name, cell.cell_contents))
            except ValueError:  # not assigned yet
                pass
        places += [(name, plain.__globals__[name]) for name in code.co_names if name in plain.__globals__]
    for name, value in places:
        if id(value) in seen:
            continue
        seen.add(id(value))
        if isinstance(value, (torch.nn.Module, torch.Tensor)):
            yield name, value
        elif inspect.isfunction(value) and value is not plain and (value.__module__ or "").split(".")[0] not in IGNORED:
            yield from parts_of(value, seen)


def _of_code(code: CodeType) -> bytes:
    """Its instructions with the numbers and words in them, and those of the functions within."""
    inner = [_of_code(one) if isinstance(one, CodeType) else repr(one).encode()
             for one in code.co_consts if not isinstance(one, frozenset)]  # of which the order is another each time
    return b"\0".join([code.co_code, repr(code.co_names).encode(), *inner])


def content_of(function: Callable) -> str:
    """Changes with its code and its weights: an attack goes on only on the same network."""
    digest = hashlib.sha256(type(function).__qualname__.encode())
    own = [(name, getattr(getattr(type(function), name, None), "__code__", None)) for name in ("__call__", "forward")]
    for name, value in (*own, *parts_of(function)):
        digest.update(name.encode())
        if value is None or isinstance(value, CodeType):
            digest.update(_of_code(value) if value else b"")
            continue
        tensors = value.state_dict().items() if isinstance(value, torch.nn.Module) else [("", value)]
        for key, tensor in tensors:
            digest.update(key.encode())
            if isinstance(tensor, torch.Tensor):
                digest.update(tensor.detach().cpu().contiguous().numpy().tobytes())
    return "python-" + digest.hexdigest()[:16]


class TorchDetector(Network):
    """What the C++ side calls; it copies what it is given, which does not outlive the call."""

    error = InputError

    def forward(self, job: str, arrays: list, keep_graph: bool):
        """job: JSON, where {"at": k} stands for arrays[k]."""
        told = json.loads(job, object_hook=lambda one: arrays[one["at"]] if isinstance(one.get("at"), int) else one)
        return super().forward(Frame(told, lambda array: array.copy()), keep_graph)
