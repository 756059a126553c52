"""Reads and writes binary glTF 2.0 (.glb), as far as Mirage's scenes need it. Needs only numpy."""

import json
import os
import struct

import numpy

from . import glb_check

FLOAT, UNSIGNED = 5126, 5125  # GL component types
VERTICES, INDICES = 34962, 34963  # GL buffer targets


class Glb:
    """The JSON chunk and the binary chunk of a .glb file, checked by glb_check. ValueError for a file that is not a valid scene."""

    def __init__(self, path):
        if not os.path.isfile(path):  # reading a pipe would wait
            raise ValueError(f"{path}: is not a file")
        with open(path, "rb") as file:
            data = file.read()
        if len(data) < 20 or data[:4] != b"glTF":
            raise ValueError(f"{path}: not a .glb file")
        length = struct.unpack_from("<I", data, 12)[0]
        try:
            self.json = json.loads(data[20:20 + length])
        except ValueError as error:
            raise ValueError(f"{path}: JSON chunk: {error}") from None
        except RecursionError:
            raise ValueError(f"{path}: JSON chunk: nested too deep") from None
        self.binary = data[20 + length + 8:]
        glb_check.check(path, self.json, self.binary)

    def bytes(self, view):
        spec = self.json["bufferViews"][view]
        start = spec.get("byteOffset", 0)
        return self.binary[start:start + spec["byteLength"]]

    def array(self, view, dtype, columns):
        """A buffer view as an array of `columns` columns."""
        return numpy.frombuffer(self.bytes(view), dtype=dtype).reshape(-1, columns)

    def scene_info(self):
        """Mirage's extras of the default scene (camera, lighting, photograph); {} for a file from another program."""
        scenes = self.json.get("scenes") or [{}]
        return scenes[self.json.get("scene", 0)].get("extras", {}).get("mirage", {})


class GlbWriter:
    """Collects meshes in Mirage's conventions and writes them with the scene's extras. Positions are in `velo` (z up, m), which is
    Blender's world; they are converted to glTF's axes (y up) here."""

    def __init__(self, name):
        self.json = {"asset": {"version": "2.0", "generator": "Mirage for Blender"}, "scene": 0,
                     "scenes": [{"name": name, "nodes": [], "extras": {"mirage": {}}}]}
        self.binary = bytearray()

    def add(self, array, value):
        entries = self.json.setdefault(array, [])
        entries.append(value)
        return len(entries) - 1

    def add_view(self, data, target=None):
        self.binary += b"\0" * (-len(self.binary) % 8)
        data = bytes(data)
        view = {"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(data)}
        if target is not None:
            view["target"] = target
        self.binary += data
        return self.add("bufferViews", view)

    def add_mesh(self, name, vertices, faces, texels, resolution, role=""):
        """`vertices` n x 3 (`velo`, m), `faces` f x 3, `texels` (f·C²) x 3, scene-linear, with C the `resolution`."""
        vertices, texels = numpy.asarray(vertices, "<f8"), numpy.asarray(texels, "<f8")
        faces = numpy.asarray(faces, "<i4")
        turned = numpy.stack([vertices[:, 0], vertices[:, 2], -vertices[:, 1]], axis=1).astype("<f4")
        low, high = turned.min(axis=0), turned.max(axis=0)
        position = self.add("accessors", {"bufferView": self.add_view(turned.tobytes(), VERTICES),
                                          "componentType": FLOAT, "count": len(turned), "type": "VEC3",
                                          "min": [float(x) for x in low], "max": [float(x) for x in high]})
        index = self.add("accessors", {"bufferView": self.add_view(faces.tobytes(), INDICES),
                                       "componentType": UNSIGNED, "count": faces.size, "type": "SCALAR"})
        color = [float(x) for x in numpy.clip(texels.mean(axis=0), 0, 1)] + [1.0]
        material = self.add("materials", {"name": name, "doubleSided": True, "pbrMetallicRoughness": {
            "baseColorFactor": color, "metallicFactor": 0.0, "roughnessFactor": 0.5}})
        exact = {"version": 1, "vertices": self.add_view(vertices.tobytes()),
                 "faces": self.add_view(faces.tobytes()), "resolution": int(resolution),
                 "texels": self.add_view(texels.tobytes())}
        mesh = self.add("meshes", {"name": name, "extras": {"mirage": exact}, "primitives": [
            {"attributes": {"POSITION": position}, "indices": index, "material": material}]})
        node = {"name": name, "mesh": mesh}
        if role:
            node["extras"] = {"mirage_role": role}
        self.json["scenes"][0]["nodes"].append(self.add("nodes", node))

    def set_info(self, **info):
        """Adds scene extras: camera and lighting, in the form that write_scene (src/exchange) uses."""
        self.json["scenes"][0]["extras"]["mirage"].update(info)

    def add_photograph(self, data):
        """Embeds the photograph. data: the bytes of a PNG or JPEG file."""
        mime = "image/jpeg" if data[:2] == b"\xff\xd8" else "image/png"
        image = self.add("images", {"name": "photograph", "mimeType": mime, "bufferView": self.add_view(data)})
        self.set_info(photograph=image)

    def write(self, path):
        if self.binary:
            self.json["buffers"] = [{"byteLength": len(self.binary)}]
        text = json.dumps(self.json, allow_nan=False).encode()
        text += b" " * (-len(text) % 4)
        binary = bytes(self.binary) + b"\0" * (-len(self.binary) % 4)
        with open(path, "wb") as file:
            file.write(struct.pack("<4sII", b"glTF", 2, 12 + 8 + len(text) + (8 + len(binary) if binary else 0)))
            file.write(struct.pack("<I4s", len(text), b"JSON") + text)
            if binary:
                file.write(struct.pack("<I4s", len(binary), b"BIN\0") + binary)
