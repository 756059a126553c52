"""A network as a detector, and what an attack goes on by: the code and the weights that it works with."""

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
    """Whether a class or function is neither Python's, PyTorch's, NumPy's nor Mirage's; the adapters of published packages are the
    user's settings of them."""
    module = getattr(kind, "__module__", None) or ""
    return module in ("mirage.openpcdet", "mirage.mmdet3d", "mirage._voxels") or module.split(".")[0] not in IGNORED


def _is_own(kind: Any) -> bool:
    """Whether a module or a class is the user's own: ours, and not installed."""
    name = kind.__name__ if inspect.ismodule(kind) else getattr(kind, "__module__", None) or ""
    file = getattr(sys.modules.get(name), "__file__", None) or ""
    return name.split(".")[0] not in IGNORED and "site-packages" not in file and "dist-packages" not in file


def _names_in(code: CodeType) -> set[str]:
    """Of globals and attributes that it names, in the functions within, too."""
    return set(code.co_names).union(*(_names_in(one) for one in code.co_consts if isinstance(one, CodeType)))


def _named_in(module: ModuleType, names: set[str], within: tuple[ModuleType, ...] = ()) -> Iterator[tuple[str, Any]]:
    """What code with these names takes out of a module of the user's, and of those that it names there. What may change from call to
    call has a name that begins with an underscore, as in objects."""
    for key in sorted(names & vars(module).keys()):
        one = vars(module)[key]
        if inspect.ismodule(one):
            if _is_own(one) and one not in within:
                yield from _named_in(one, names, (*within, module))
        elif callable(one) or isinstance(one, torch.Tensor) or not key.startswith("_"):
            yield f"{module.__name__}.{key}", one


def parts_of(value: Any, name: str = "self", seen: set[int] | None = None) -> Iterator[tuple[str, Any]]:
    """The modules, tensors, arrays, numbers, words and code that a callable works with: its class, its attributes, its closure, its
    globals, and those of the functions, objects and containers among them. Of a module of the user's what the code names."""
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
    """The functions and attributes of a class and of those that it is made from."""
    places = []
    for kind in of.__mro__:
        for key, one in sorted(vars(kind).items()) if _is_ours(kind) else ():
            one = getattr(one, "__func__", getattr(one, "fget", one))  # of a static method or a property
            if inspect.isfunction(one) or not key.startswith("__"):
                places.append((key, one))
    return places


def _of_object(value: Any) -> list[tuple[str, Any]]:
    """Those of its class, and its own attributes. Of one that says its version, an attribute that is no network may change from
    call to call; so may one whose name begins with an underscore."""
    places = _of_class(type(value))
    says = getattr(value, "version", "")
    own = {key: getattr(value, key) for key in _slots_of(type(value)) if hasattr(value, key)}
    own.update(getattr(value, "__dict__", {}))
    for key, one in sorted(own.items()):
        if isinstance(one, (torch.nn.Module, torch.Tensor)) or not (key.startswith("_") or says) or key == "version":
            places.append((key, one))
    return places


def _slots_of(of: type) -> Iterator[str]:
    """Attributes that its objects have outside of a dictionary."""
    for kind in of.__mro__:
        slots = vars(kind).get("__slots__", ()) if _is_ours(kind) else ()
        for name in (slots,) if isinstance(slots, str) else slots:
            hidden = name.startswith("__") and not name.endswith("__")
            yield f"_{kind.__name__.lstrip('_')}{name}" if hidden else name


def _of_code(code: CodeType) -> bytes:
    """Its instructions with the numbers and words in them, and those of the functions within."""
    inner = [_of_code(one) if isinstance(one, CodeType) else repr(one).encode()
             for one in code.co_consts if not isinstance(one, frozenset)]  # of which the order is another each time
    return b"\0".join([code.co_code, repr(code.co_names).encode(), *inner])


def content_of(function: Callable) -> str:
    """Changes with its code, its weights and its settings: an attack goes on only on the same network."""
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
        if isinstance(value, torch.nn.Module):  # buffers that are not persistent are in no state
            tensors = sorted({**value.state_dict(), **dict(value.named_buffers())}.items())
        for key, tensor in tensors:
            digest.update(key.encode())
            if isinstance(tensor, torch.Tensor):
                tensor = tensor.detach().cpu().contiguous().numpy()
            if isinstance(tensor, (np.ndarray, np.generic)):
                digest.update(np.ascontiguousarray(tensor).tobytes())
    return "python-" + digest.hexdigest()[:16]


class TorchDetector(Network):
    """What the C++ side calls; it copies what it is given, which does not outlive the call."""

    error = InputError

    def forward(self, job: str, arrays: list, keep_graph: bool):
        """job: JSON, where {"at": k} stands for arrays[k]."""
        told = json.loads(job, object_hook=lambda one: arrays[one["at"]] if isinstance(one.get("at"), int) else one)
        return super().forward(Frame(told, lambda array: array.copy()), keep_graph)
