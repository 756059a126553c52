"""A network as a detector, and the hash of its code, weights and settings by which an attack resumes."""

from __future__ import annotations

import argparse
import functools
import hashlib
import inspect
import json
import sys
from types import CodeType, ModuleType, SimpleNamespace
from typing import Any, Callable, Iterator

import numpy as np
import torch

from ._core import InputError
from .mirage_serve import Frame, Network

IGNORED = ("torch", "numpy", "mirage", "builtins", *sys.stdlib_module_names)
PLAIN = (str, bytes, int, float, complex, type(None))


def _is_ours(kind: Any) -> bool:
    """Whether a class or function comes from outside Python, PyTorch, NumPy and Mirage. The adapters of published packages count as
    the user's, because they hold settings."""
    module = getattr(kind, "__module__", None) or ""
    return module in ("mirage.openpcdet", "mirage.mmdet3d", "mirage._voxels") or module.split(".")[0] not in IGNORED


def _is_own(kind: Any) -> bool:
    """Whether a module or class is the user's own: not one of IGNORED, and not an installed package."""
    name = kind.__name__ if inspect.ismodule(kind) else getattr(kind, "__module__", None) or ""
    file = getattr(sys.modules.get(name), "__file__", None) or ""
    return name.split(".")[0] not in IGNORED and "site-packages" not in file and "dist-packages" not in file


def _names_in(code: CodeType) -> set[str]:
    """The names of globals and attributes that the code and its nested functions use."""
    return set(code.co_names).union(*(_names_in(one) for one in code.co_consts if isinstance(one, CodeType)))


def _named_in(module: ModuleType, names: set[str], within: tuple[ModuleType, ...] = ()) -> Iterator[tuple[str, Any]]:
    """(name, value) that code with these names uses from a user's module, and from the user's modules named there.
    Names with a leading underscore, except of callables and tensors, are left out: they may change from call to call."""
    for key in sorted(names & vars(module).keys()):
        one = vars(module)[key]
        if inspect.ismodule(one):
            if _is_own(one) and one not in within:
                yield from _named_in(one, names, (*within, module))
        elif callable(one) or isinstance(one, torch.Tensor) or not key.startswith("_"):
            yield f"{module.__name__}.{key}", one


def parts_of(value: Any, name: str = "self", seen: set[int] | None = None) -> Iterator[tuple[str, Any]]:
    """(name, value) of the modules, tensors, arrays, numbers, texts and code that a callable uses: from its class, attributes,
    closure and globals, and from the functions, objects and containers among them. From a user's module only the named parts."""
    seen = set() if seen is None else seen
    if isinstance(value, PLAIN):
        yield name, value
        return
    if id(value) in seen:
        return
    seen.add(id(value))
    places: list[tuple[str, Any]] = []
    if isinstance(value, (torch.Tensor, np.ndarray, np.generic)):
        yield name, value
    elif isinstance(value, dict):
        places = [(str(key), one) for key, one in value.items()]
    elif isinstance(value, (list, tuple, set, frozenset)):
        places = [(str(k), one) for k, one in enumerate(value if isinstance(value, (list, tuple)) else sorted(value, key=repr))]
    elif inspect.ismethod(value):
        places = [("bound", value.__self__), ("function", value.__func__)]
    elif inspect.isfunction(value):
        if not _is_ours(value) and name != "self":
            return
        code = value.__code__
        yield name, code
        for key, cell in zip(code.co_freevars, value.__closure__ or ()):
            try:
                places.append((key, cell.cell_contents))
            except ValueError:  # not assigned yet
                pass
        places += [("default", value.__defaults__), ("keyword", value.__kwdefaults__)]
        names = _names_in(code)
        for key in sorted(names & value.__globals__.keys()):
            one = value.__globals__[key]
            places += _named_in(one, names) if inspect.ismodule(one) and _is_own(one) else [(key, one)]
    elif isinstance(value, functools.partial):
        places = [("function", value.func), ("arguments", value.args), ("keywords", value.keywords)]
    elif isinstance(value, (SimpleNamespace, argparse.Namespace)):
        places = sorted(vars(value).items())
    elif isinstance(value, torch.nn.Module):
        yield name, value
        for key, module in value.named_modules():
            seen.add(id(module))
            places += [(f"{key}.{its}", one) for its, one in _of_object(module)]
            if isinstance(module, torch.jit.ScriptModule) and module._c._has_method("forward"):
                places.append((key, module.code))
    elif isinstance(value, type):
        places = _of_class(value) if _is_own(value) else []
    elif isinstance(value, functools._lru_cache_wrapper):
        places = [("wrapped", value.__wrapped__)]
    elif not isinstance(value, torch.utils.data.Dataset) and not inspect.ismodule(value) and _is_ours(type(value)):
        places = _of_object(value)
    for key, one in places:
        yield from parts_of(one, key, seen)


def _of_class(of: type) -> list[tuple[str, Any]]:
    """The functions and attributes of a class and its base classes."""
    places = []
    for kind in of.__mro__:
        for key, one in sorted(vars(kind).items()) if _is_ours(kind) else ():
            one = getattr(one, "__func__", getattr(one, "fget", one))  # of a static method or a property
            if inspect.isfunction(one) or not key.startswith("__"):
                places.append((key, one))
    return places


def _of_object(value: Any) -> list[tuple[str, Any]]:
    """The parts of an object's class, and its attributes except those that may change from call to call: names with a leading
    underscore and, if the object has a version, all others too. Modules, tensors and the version always count."""
    places = _of_class(type(value))
    says = getattr(value, "version", "")
    own = {key: getattr(value, key) for key in _slots_of(type(value)) if hasattr(value, key)}
    own.update(getattr(value, "__dict__", {}))
    for key, one in sorted(own.items()):
        if isinstance(one, (torch.nn.Module, torch.Tensor)) or not (key.startswith("_") or says) or key == "version":
            places.append((key, one))
    return places


def _slots_of(of: type) -> Iterator[str]:
    """The names of attributes that the class's objects keep in slots."""
    for kind in of.__mro__:
        slots = vars(kind).get("__slots__", ()) if _is_ours(kind) else ()
        for name in (slots,) if isinstance(slots, str) else slots:
            hidden = name.startswith("__") and not name.endswith("__")
            yield f"_{kind.__name__.lstrip('_')}{name}" if hidden else name


def _of_code(code: CodeType) -> bytes:
    """The instructions, numbers and texts of the code and its nested functions."""
    inner = [_of_code(one) if isinstance(one, CodeType) else repr(one).encode()
             for one in code.co_consts if not isinstance(one, frozenset)]  # their order differs from run to run
    return b"\0".join([code.co_code, repr(code.co_names).encode(), *inner])


def content_of(function: Callable) -> str:
    """A hash of the function's code, weights and settings: an attack resumes only against the same network."""
    digest = hashlib.sha256(type(function).__qualname__.encode())
    for name, value in parts_of(function):
        digest.update(name.encode())
        if isinstance(value, CodeType):
            digest.update(_of_code(value))
            continue
        if isinstance(value, PLAIN):
            digest.update(repr(value).encode())
            continue
        tensors = [("", value)]
        if isinstance(value, torch.nn.Module):  # non-persistent buffers are not in the state
            tensors = sorted({**value.state_dict(), **dict(value.named_buffers())}.items())
        for key, tensor in tensors:
            digest.update(key.encode())
            if isinstance(tensor, torch.Tensor):
                tensor = tensor.detach().cpu().contiguous().numpy()
            if isinstance(tensor, (np.ndarray, np.generic)):
                digest.update(np.ascontiguousarray(tensor).tobytes())
    return "python-" + digest.hexdigest()[:16]


class TorchDetector(Network):
    """The detector that the C++ side calls. It copies its arrays, because their memory is borrowed for the call."""

    error = InputError

    def forward(self, job: str, arrays: list, keep_graph: bool):
        """(boxes, logits, classes or None, identities or None) of a job: JSON, in which {"at": k} stands for arrays[k]."""
        told = json.loads(job, object_hook=lambda one: arrays[one["at"]] if isinstance(one.get("at"), int) else one)
        return super().forward(Frame(told, lambda array: array.copy()), keep_graph)
