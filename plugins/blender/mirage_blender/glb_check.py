"""Checks a scene before Blender's importer sees it. The importer opens any file that a .glb names, and follows cycles of nodes;
a Mirage scene contains everything itself. The limits are those of src/exchange/gltf_document.h. Needs only Python."""

import math

FURTHEST, BRIGHTEST, MOST_PIXELS, DEEPEST = 1e7, 1e6, 1 << 26, 256


def picture_size(data):
    """(width, height) in pixels that a PNG's or JPEG's header claims; None for anything else."""
    if data[:8] == b"\x89PNG\r\n\x1a\n" and len(data) >= 24:
        return int.from_bytes(data[16:20], "big"), int.from_bytes(data[20:24], "big")
    at = 2 if data[:2] == b"\xff\xd8" else len(data)
    while at + 9 <= len(data) and data[at] == 0xFF:
        if 0xC0 <= data[at + 1] <= 0xCF and data[at + 1] not in (0xC4, 0xC8, 0xCC):  # a frame's header
            return int.from_bytes(data[at + 7:at + 9], "big"), int.from_bytes(data[at + 5:at + 7], "big")
        at += 2 + int.from_bytes(data[at + 2:at + 4], "big")
    return None


class Checker:
    def __init__(self, path, json, binary):
        self.path, self.json, self.binary = path, json, binary

    def demand(self, good, field, problem):
        if not good:
            raise ValueError(f"{self.path}: {field}: {problem}; export the scene again with mirage export")

    def entries(self, parent, key, field):
        found = parent.get(key, [])
        self.demand(isinstance(found, list), field, "is not a list")
        return found

    def objects(self, key):
        found = self.entries(self.json, key, key)
        for i, entry in enumerate(found):
            self.demand(isinstance(entry, dict), f"{key}[{i}]", "is not an object")
        return found

    def index(self, value, key, field):
        count = len(self.json.get(key, []))
        self.demand(type(value) is int and 0 <= value < count, field, f"is not one of the file's {count} {key}")
        return value

    def numbers(self, parent, key, count, low, high, field):
        values = parent.get(key)
        good = isinstance(values, list) and len(values) == count and all(
            type(value) in (int, float) and low <= value <= high for value in values)
        self.demand(good, f"{field}.{key}", f"is not {count} numbers from {low:g} to {high:g}")
        return values

    def run(self):
        self.demand(isinstance(self.json, dict), "JSON", "is not an object")
        for key in ("buffers", "bufferViews", "accessors", "images", "meshes", "cameras", "nodes", "scenes"):
            self.objects(key)
        for key in ("buffers", "images"):
            for i, entry in enumerate(self.json.get(key, [])):
                uri = entry.get("uri", "data:")
                self.demand(isinstance(uri, str) and uri.startswith("data:"), f"{key}[{i}].uri",
                            "names another file, which is not opened")
        for i, view in enumerate(self.json.get("bufferViews", [])):
            field = f"bufferViews[{i}]"
            self.index(view.get("buffer"), "buffers", field + ".buffer")
            for key in ("byteOffset", "byteLength"):
                value = view.get(key, 0)
                self.demand(type(value) is int and value >= 0, f"{field}.{key}", "is not a length")
        for i, image in enumerate(self.json.get("images", [])):
            if "bufferView" in image:
                self.picture(self.index(image["bufferView"], "bufferViews", f"images[{i}].bufferView"), f"images[{i}]")
        self.nodes()
        self.scene()

    def picture(self, view, field):
        """Checks a picture's size: a header of a few bytes can claim 60000 x 60000 pixels."""
        spec = self.json["bufferViews"][view]
        start = spec.get("byteOffset", 0)
        data = self.binary[start:start + spec.get("byteLength", 0)]
        size = picture_size(data)
        self.demand(size is not None, field, "is not a PNG or JPEG picture")
        most = MOST_PIXELS
        if data[:1] == b"\x89":
            most = min(most, 8 * 1032 * len(data))  # deflate packs at most 1032 bytes into one
        self.demand(size[0] * size[1] <= most, field, f"claims {size[0]}x{size[1]} pixels in {len(data)} bytes")

    def nodes(self):
        """Checks that each node has at most one parent and that there are no cycles."""
        nodes = self.json.get("nodes", [])
        parents = {}
        for i, node in enumerate(nodes):
            field = f"nodes[{i}]"
            for key, count in (("translation", 3), ("scale", 3), ("rotation", 4), ("matrix", 16)):
                if key in node:
                    self.numbers(node, key, count, -FURTHEST, FURTHEST, field)
            if "mesh" in node:
                self.index(node["mesh"], "meshes", field + ".mesh")
            for child in self.entries(node, "children", field + ".children"):
                self.index(child, "nodes", field + ".children")
                self.demand(child not in parents, field + ".children", f"node {child} has two parents")
                parents[child] = i
        depth = {i: 0 for i in range(len(nodes)) if i not in parents}
        queue = list(depth)
        for at in queue:
            for child in nodes[at].get("children", []):
                depth[child] = depth[at] + 1
                self.demand(depth[child] < DEEPEST, f"nodes[{child}]", f"is {DEEPEST} nodes deep")
                queue.append(child)
        for i in range(len(nodes)):
            self.demand(i in depth, f"nodes[{i}].children", "go round in a circle")

    def scene(self):
        scenes = self.json.get("scenes") or [{}]
        chosen = self.json.get("scene", 0)
        self.demand(type(chosen) is int and 0 <= chosen < len(scenes), "scene", "is not one of the file's scenes")
        for i, scene in enumerate(scenes):
            for root in self.entries(scene, "nodes", f"scenes[{i}].nodes"):
                self.index(root, "nodes", f"scenes[{i}].nodes")
        extras = scenes[chosen].get("extras", {})
        info = extras.get("mirage", {}) if isinstance(extras, dict) else None
        field = "scenes[].extras.mirage"
        self.demand(isinstance(info, dict), field, "is not an object")
        if "camera" in info:
            self.camera(info["camera"], field + ".camera")
        if "lighting" in info:
            light, where = info["lighting"], field + ".lighting"
            self.demand(isinstance(light, dict), where, "is not an object")
            sun = self.numbers(light, "to_sun_velo", 3, -1e3, 1e3, where)
            self.demand(math.hypot(*sun) >= 1e-6, where + ".to_sun_velo", "has no length")
            for key in ("sun", "ambient", "hemisphere"):
                self.numbers(light, key, 3, 0, BRIGHTEST, where)
        if "photograph" in info:
            image = self.json["images"][self.index(info["photograph"], "images", field + ".photograph")]
            self.demand("bufferView" in image, field + ".photograph", "is not inside the file")

    def camera(self, camera, field):
        self.demand(isinstance(camera, dict), field, "is not an object")
        value = {key: camera.get(key) for key in ("fx", "fy", "cx", "cy", "width", "height")}
        self.demand(all(type(v) in (int, float) and abs(v) <= FURTHEST for v in value.values()), field,
                    "lacks intrinsics, or they are out of range")
        self.demand(value["width"] >= 1 and value["height"] >= 1 and value["width"] * value["height"] <= MOST_PIXELS,
                    field, f"is not a picture of 1 to {MOST_PIXELS} pixels")
        self.demand(value["fx"] > 0 and value["fy"] > 0, field, "fx, fy are not focal lengths")
        rows = self.numbers(camera, "velo_from_camera", 12, -FURTHEST, FURTHEST, field)
        turn = [rows[0:3], rows[4:7], rows[8:11]]
        for i in range(3):
            for j in range(3):
                dot = sum(a * b for a, b in zip(turn[i], turn[j]))
                self.demand(abs(dot - (i == j)) <= 1e-3, field + ".velo_from_camera", "is not a camera's pose")


def check(path, json, binary):
    """Raises ValueError, one line with file and field, if a scene's JSON and binary chunks are not safe to import."""
    Checker(path, json, binary).run()
