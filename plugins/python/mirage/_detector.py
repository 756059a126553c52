"""A network as a detector: what it must give, checked, and its gradients by autograd."""

from __future__ import annotations

import hashlib
import inspect
from typing import Any, Callable, Iterator

import numpy
import torch

from ._core import Failure, InputError

REGION = (0.0, 70.0, -40.0, 40.0)
GUIDE = "give (boxes [M,5]: x, y, length, width (m), yaw (rad); logits [M]), or for boxes in the picture [M,4]"


def _bad(field: str, problem: str, fix: str) -> InputError:
    return InputError(f"detector: {field}: {problem}; {fix}")


def takes_picture_alone(function: Callable) -> bool:
    """Whether it finds boxes in the picture: such a detector takes the image and nothing else."""
    try:
        parameters = inspect.signature(function.forward if isinstance(function, torch.nn.Module) else function).parameters
    except (TypeError, ValueError):
        return False
    needed = [p for p in parameters.values() if p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD)
              and p.default is p.empty]
    several = any(p.kind is p.VAR_POSITIONAL for p in parameters.values())
    if several or len(needed) == 3:
        return False
    if len(needed) == 1:
        return True
    raise _bad("signature", f"takes {len(needed)} arguments", "take (image, points, pixel_from_velo), or image alone")


def parts_of(function: Callable, seen: set[int] | None = None) -> Iterator[tuple[str, Any]]:
    """The modules and tensors that a callable works with: itself, its attributes, its closure, its globals, and those of
    the functions among them."""
    seen = set() if seen is None else seen
    plain = getattr(function, "__func__", function)
    places: list[tuple[str, Any]] = [("self", function), ("bound", getattr(function, "__self__", None))]
    if not isinstance(function, torch.nn.Module):
        places += sorted(getattr(function, "__dict__", {}).items())
    code = getattr(plain, "__code__", None)
    if code is not None:
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
        elif inspect.isfunction(value) and value is not plain and (value.__module__ or "").split(".")[0] not in (
                "torch", "numpy", "mirage"):
            yield from parts_of(value, seen)


def content_of(function: Callable) -> str:
    """Changes with its code and its weights: an attack goes on only on the same network."""
    digest = hashlib.sha256()
    plain = getattr(function, "__func__", function)
    code = getattr(plain, "__code__", None) or getattr(type(function).__call__, "__code__", None)
    digest.update(code.co_code if code is not None else type(function).__qualname__.encode())
    for name, value in parts_of(function):
        digest.update(name.encode())
        tensors = value.state_dict().items() if isinstance(value, torch.nn.Module) else [("", value)]
        for key, tensor in tensors:
            digest.update(key.encode())
            if isinstance(tensor, torch.Tensor):
                digest.update(tensor.detach().cpu().contiguous().numpy().tobytes())
    return "python-" + digest.hexdigest()[:16]


class TorchDetector:
    """What the C++ side calls; it copies its arguments, which do not outlive the call."""

    def __init__(self, function: Callable):
        if not callable(function):
            raise _bad("type", f"{type(function).__name__} cannot be called", "give a function or a torch.nn.Module")
        self.function = function
        self.finds_picture = takes_picture_alone(function)
        region = getattr(function, "region", REGION)
        region = tuple(float(edge) for edge in (region() if callable(region) else region))
        if len(region) != 4 or not (region[0] < region[1] and region[2] < region[3]):
            raise _bad("region", f"is {region}", "give (x_min, x_max, y_min, y_max) in m, or leave it out")
        self.region = region
        parameter = next(function.parameters(), None) if isinstance(function, torch.nn.Module) else None
        self.device = torch.device("cpu") if parameter is None else parameter.device
        self._inputs: tuple[torch.Tensor, ...] = ()
        self._logits: torch.Tensor | None = None

    def forward(self, image, points, pixel_from_velo, keep_graph: bool):
        """(boxes, logits) as float32 arrays; keep_graph prepares backward."""
        self._inputs, self._logits = (), None
        tensors = [torch.from_numpy(array.copy()).to(self.device) for array in (image, points, pixel_from_velo)]
        with torch.set_grad_enabled(keep_graph):
            if keep_graph:
                for tensor in tensors[:2]:
                    tensor.requires_grad_(True)
            boxes, logits = self._checked(self.function(*tensors[: 1 if self.finds_picture else 3]))
        if keep_graph:
            if logits.numel() and not logits.requires_grad:
                raise _bad("logits", "don't depend on image or points in a differentiable way",
                           "remove detach(), no_grad(), hard thresholds and .item() between them")
            self._inputs, self._logits = tuple(tensors[:2]), logits
        return tuple(tensor.detach().cpu().float().numpy() for tensor in (boxes, logits))

    def _checked(self, found):
        if not isinstance(found, (tuple, list)) or len(found) != 2 or not all(isinstance(t, torch.Tensor) for t in found):
            raise _bad("result", f"is {type(found).__name__}", "return two tensors: (boxes, logits)")
        boxes, logits = found
        columns = 4 if self.finds_picture else 5
        for name, tensor in (("boxes", boxes), ("logits", logits)):
            if not tensor.is_floating_point():
                raise _bad(name, f"hold {tensor.dtype} values", "return floating-point tensors")
        if boxes.dim() != 2 or boxes.shape[1] != columns:
            raise _bad("boxes", f"have shape {list(boxes.shape)}", GUIDE)
        if logits.dim() != 1 or logits.shape[0] != boxes.shape[0]:
            raise _bad("logits", f"have shape {list(logits.shape)} for {boxes.shape[0]} boxes", "return one a box")
        for name, tensor in (("boxes", boxes), ("logits", logits)):
            if not torch.isfinite(tensor.detach()).all():
                raise _bad(name, "are not finite", "look for logarithms, roots and divisions of 0 in the network")
        return boxes, logits

    def backward(self, d_logits):
        """(d_image (H×W×3), d_points (N×4)) as float32 arrays."""
        if self._logits is None:
            raise Failure("detector: backward before a forward that keeps its graph; call forward first")
        gradients: list[torch.Tensor | None] = [None, None]
        if self._logits.requires_grad:
            seed = torch.from_numpy(d_logits).to(self._logits)
            gradients = list(torch.autograd.grad(self._logits, self._inputs, seed, allow_unused=True))
        self._logits = None
        arrays = []
        for name, gradient, like in zip(("image", "points"), gradients, self._inputs):
            array = (numpy.zeros(tuple(like.shape), numpy.float32) if gradient is None
                     else gradient.detach().cpu().float().contiguous().numpy())
            if not numpy.isfinite(array).all():
                raise _bad(f"gradient to {name}", "is not finite", "look for roots and norms of 0 in the network")
            arrays.append(array)
        return tuple(arrays)
