#!/usr/bin/env python3
"""Turns weights of an earlier Mirage (LibTorch archives) into today's format: python3 convert_weights.py OLD NEW

Today's format is that of safetensors: 8 bytes with the length of a JSON header, the header, raw little-endian
numbers (plugins/tensor_file.h). OLD may be such a file, too: then --half and --part make it smaller, as the
shipped files are.

    python3 convert_weights.py old/my.weights my.weights
    python3 convert_weights.py --half --part camera-kitti64.weights --part lidar-kitti64.weights out/late.weights late-kitti64.weights

An archive's pickle is read here by a reader that knows tensors and plain values; nothing in it is called.
"""

import argparse
import collections
import hashlib
import json
import os
import pickle
import struct
import sys
import zipfile

import numpy

TYPES = {"F32": numpy.dtype("<f4"), "F16": numpy.dtype("<f2"), "F64": numpy.dtype("<f8"), "I64": numpy.dtype("<i8")}
MAX_HEADER_BYTES = 1 << 19  # as plugins/tensor_file.h
STORAGES = {"FloatStorage": "F32", "HalfStorage": "F16", "DoubleStorage": "F64", "LongStorage": "I64"}


class Refused(Exception):
    pass


class Module:
    """The content of LibTorch's OutputArchive: named values, tensors and further modules."""

    def __setstate__(self, state):
        if not isinstance(state, dict):
            raise Refused("holds a module that is not a table of values")
        self.values = state


def tensor_of(storage, offset, sizes, strides, *_):
    item = storage.itemsize
    last = offset + sum((size - 1) * stride for size, stride in zip(sizes, strides))
    if offset < 0 or min((*sizes, 1)) < 1 or min((*strides, 0)) < 0 or last >= storage.size:
        raise Refused("holds a tensor that leaves its storage")
    view = numpy.lib.stride_tricks.as_strided(storage[offset:], sizes, [stride * item for stride in strides])
    return numpy.array(view, order="C")


class Reader(pickle.Unpickler):
    def __init__(self, archive, folder):
        super().__init__(archive.open(folder + "data.pkl"))
        self.archive, self.folder = archive, folder

    def find_class(self, module, name):
        if name == "Module" and module.split(".")[0] == "__torch__":
            return Module
        if (module, name) == ("torch._utils", "_rebuild_tensor_v2"):
            return tensor_of
        if (module, name) == ("collections", "OrderedDict"):
            return collections.OrderedDict
        if module == "torch" and name in STORAGES:
            return STORAGES[name]
        raise Refused(f"names {module}.{name}: weights are data")

    def persistent_load(self, reference):
        _, kind, key, _, _ = reference
        return numpy.frombuffer(self.archive.read(f"{self.folder}data/{key}"), TYPES[kind])


def flat(module, prefix=""):
    """The module's tensors under the names of LibTorch's named_parameters."""
    for name, value in module.values.items():
        if isinstance(value, Module):
            yield from flat(value, prefix + name + ".")
        elif isinstance(value, numpy.ndarray):
            yield prefix + name, value


def read_state(optimiser):
    """AdamW's state by parameter index."""
    states = optimiser.values["state"].values
    group = optimiser.values["param_groups"].values["param_groups/0"].values
    for k in range(int(group["params/size"])):
        state = states.get(group[f"params/{k}"])
        if state is None:
            continue
        yield f"optimiser.{k}.step", numpy.array(int(state.values["step"]), "<i8")
        for moment in ("exp_avg", "exp_avg_sq"):
            yield f"optimiser.{k}.{moment}", state.values[moment]


def of_detector(old):
    has = lambda name: bool(old.get(name, False))
    if not has("without_lidar") and not has("channel_norm"):
        raise Refused("is of a network with group norms, which no program of today has; train anew with mirage train")
    name = ("camera" if has("without_lidar") else "refined" if has("second") else "painted" if has("painted") else
            "late" if has("late") else "fusion" if has("with_image") else "lidar")
    facts = {"format": "mirage fusion detector 3", "detector": name}
    for fact, words in (("with", {"denoising": "denoising", "depth_gate": "depth-gate"}),
                        ("frozen", {"camera_frozen": "camera", "lidar_frozen": "lidar", "trunk_frozen": "trunk"})):
        if said := " ".join(word for key, word in words.items() if has(key)):
            facts[fact] = said
    tensors = dict(flat(old["network"]))
    if has("with_optimiser"):
        for key, kind, usual in (("steps", "<i8", 0), ("samples_seen", "<i8", 0), ("peak_rate", "<f8", 0.0)):
            tensors["training." + key] = numpy.array(old.get(key, usual), kind)
        tensors.update(read_state(old["optimiser"]))
        tensors.update((name, value) for name, value in old.items() if name.startswith("start"))
    return facts, tensors


def of_depth(old):
    tensors = {name.replace("_", "."): value for name, value in old.items() if isinstance(value, numpy.ndarray)}
    if old.get("with_optimiser"):
        tensors.update(read_state(old["optimiser"]))
    return {"format": "mirage guided depth completion 2"}, tensors


FORMATS = {"mirage fusion detector 2": of_detector, "mirage guided depth completion 1": of_depth}


def read_archive(file):
    with zipfile.ZipFile(file) as archive:
        inside = [name for name in archive.namelist() if name.endswith("/data.pkl") and name.count("/") == 1]
        if len(inside) != 1:
            raise Refused("is a zip file, but no archive of LibTorch")
        module = Reader(archive, inside[0][:-len("data.pkl")]).load()
    kind = module.values.get("format") if isinstance(module, Module) else None
    if kind not in FORMATS:
        raise Refused("is an archive of LibTorch, but not of Mirage's weights")
    return FORMATS[kind](module.values)


def read_tensors(file, sha256=None):
    with open(file, "rb") as opened:
        whole = opened.read()
    if sha256 not in (None, hashlib.sha256(whole).hexdigest()):
        raise Refused(f"needs {os.path.basename(file)} of SHA-256 {sha256} beside it, and that file is another; restore both")
    length = struct.unpack_from("<Q", whole)[0]
    if length > min(MAX_HEADER_BYTES, len(whole) - 8):
        raise Refused("is damaged or not a weights file: it does not begin with a header's length")
    header, data = json.loads(whole[8 : 8 + length]), whole[8 + length :]
    facts = header.pop("__metadata__", {})
    return facts, {name: numpy.frombuffer(data[slice(*value["data_offsets"])], TYPES[value["dtype"]]).reshape(value["shape"])
                   for name, value in header.items()}


def read_weights(file):
    with open(file, "rb") as opened:
        if opened.read(4) == b"PK\3\4":
            return read_archive(file)
    facts, tensors = read_tensors(file)
    for line in facts.pop("parts", "").splitlines():
        sha256, part = line.split("  ")
        for name, value in read_tensors(os.path.join(os.path.dirname(file), part), sha256)[1].items():
            tensors.setdefault(name, value)
    return facts, tensors


def halved(name, value):
    """Kernels and matrices as halves; small, decisive tensors (biases, norms, their statistics) unchanged."""
    if value.ndim < 2 or value.dtype != TYPES["F32"]:
        return value
    half = value.astype("<f2")
    if not numpy.isfinite(half).all():
        raise Refused(f"holds a value in {name} that is too large for a half")
    return half


def same(a, b):
    return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()


def without_parts(file, tensors, parts):
    """The tensors without those of the named parts, and the parts' lines as sha256sum prints them."""
    used, left, known = set(), {}, [(part, read_tensors(part)[1]) for part in parts]
    for name, value in tensors.items():
        first = next(((part, its[name]) for part, its in known if name in its), None)
        if first and same(first[1], value):
            used.add(first[0])
        else:
            left[name] = value
    lines = ""
    for part in (part for part in parts if part in used):
        if os.path.abspath(os.path.dirname(part)) != os.path.abspath(os.path.dirname(file)):
            raise Refused(f"cannot name {part}, which does not lie beside {file}")
        with open(part, "rb") as opened:
            lines += f"{hashlib.sha256(opened.read()).hexdigest()}  {os.path.basename(part)}\n"
    return left, lines


def write_weights(file, facts, tensors):
    header, pieces, at = {"__metadata__": facts}, [], 0
    for name, value in sorted(tensors.items()):
        kind = next(word for word, dtype in TYPES.items() if dtype == value.dtype)
        pieces.append(value.tobytes())
        header[name] = {"data_offsets": [at, at + len(pieces[-1])], "dtype": kind, "shape": list(value.shape)}
        at += len(pieces[-1])
    text = json.dumps(header, separators=(",", ":"), ensure_ascii=False, sort_keys=True).encode()
    text += b" " * (-len(text) % 8)
    temporary = f"{file}.mirage-{os.getpid()}.tmp"
    with open(temporary, "wb") as opened:
        opened.write(struct.pack("<Q", len(text)) + text + b"".join(pieces))
    os.replace(temporary, file)


def main():
    reader = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    reader.add_argument("old")
    reader.add_argument("new")
    reader.add_argument("--half", action="store_true", help="kernels in half precision; for weights that are done with learning")
    reader.add_argument("--part", action="append", default=[], help="a file beside NEW whose tensors need not be stored again")
    arguments = reader.parse_args()
    try:
        facts, tensors = read_weights(arguments.old)
        if arguments.half and any(name.startswith("optimiser.") for name in tensors):
            raise Refused("is a training's checkpoint, whose going on must not be rounded; leave --half out")
        if arguments.half:
            tensors = {name: halved(name, value) for name, value in tensors.items()}
        tensors, lines = without_parts(arguments.new, tensors, arguments.part)
        write_weights(arguments.new, {**facts, "parts": lines} if lines else facts, tensors)
    except (Refused, OSError, ValueError, KeyError, TypeError, AttributeError, IndexError, OverflowError, MemoryError, RecursionError,
            EOFError, pickle.UnpicklingError, zipfile.BadZipFile, struct.error) as problem:
        known = isinstance(problem, (Refused, OSError))
        sys.exit(f"{arguments.old}: {problem if known else 'is damaged or not a weights file'}")


if __name__ == "__main__":
    main()
