"""Scenes that the add-on's reader refuses, without Blender: test_glb_check.py SOURCE MAKE_ADDON_SCENE."""

import copy
import json
import os
import struct
import subprocess
import sys
import tempfile
import unittest

SOURCE, MAKE = (os.path.abspath(path) for path in sys.argv[1:3])
sys.path.insert(0, os.path.join(SOURCE, "plugins", "blender"))
from mirage_blender import glb  # noqa: E402

NESTED = 20000


class Scenes(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.folder = tempfile.TemporaryDirectory()
        cls.good = os.path.join(cls.folder.name, "scene.glb")
        subprocess.run([MAKE, cls.good], check=True, stdout=subprocess.DEVNULL)
        scene = glb.Glb(cls.good)
        cls.json, cls.binary = scene.json, scene.binary

    @classmethod
    def tearDownClass(cls):
        cls.folder.cleanup()

    def write(self, text, binary):
        path = os.path.join(self.folder.name, "bad.glb")
        text += b" " * (-len(text) % 4)
        with open(path, "wb") as file:
            file.write(struct.pack("<4sIII4s", b"glTF", 2, 28 + len(text) + len(binary), len(text), b"JSON") + text)
            file.write(struct.pack("<I4s", len(binary), b"BIN\0") + binary)
        return path

    def refused(self, field, change, binary=None):
        scene = copy.deepcopy(self.json)
        change(scene)
        path = self.write(json.dumps(scene).encode(), self.binary if binary is None else binary)
        with self.assertRaises(ValueError) as caught:
            glb.Glb(path)
        text = str(caught.exception)
        self.assertIn("bad.glb: " + field, text)
        self.assertNotIn("\n", text)

    def test_the_programs_own_scene_passes(self):
        self.assertIn("camera", glb.Glb(self.good).scene_info())

    def test_other_files_are_not_named(self):
        for key in ("buffers", "images"):
            for uri in ("/etc/passwd", "../x.bin", "x.bin", "file:///x", 5):
                self.refused(f"{key}[0].uri", lambda scene: scene[key][0].update(uri=uri))

    def test_nodes(self):
        self.refused("nodes[0].children", lambda scene: scene["nodes"][0].update(children=[1, 1]))
        self.refused("nodes[0].children", lambda scene: scene["nodes"][0].update(children=[0]))
        self.refused("nodes[0].children", lambda scene: scene["nodes"][0].update(children=[99]))
        self.refused("nodes[0].scale", lambda scene: scene["nodes"][0].update(scale=[1e38, 1, 1]))

        def chain(scene):
            first = len(scene["nodes"])
            scene["nodes"] += [{"children": [first + i + 1]} for i in range(5000)] + [{}]

        self.refused("nodes[", chain)

    def test_values(self):
        def info(part, **values):
            return lambda scene: scene["scenes"][0]["extras"]["mirage"][part].update(values)

        field = "scenes[].extras.mirage."
        self.refused(field + "lighting.sun", info("lighting", sun=[1e300, 0, 0]))
        self.refused(field + "lighting.to_sun_velo", info("lighting", to_sun_velo=[0, 0, 0]))
        self.refused(field + "camera", info("camera", fx=0))
        self.refused(field + "camera", info("camera", width=60000, height=60000))
        self.refused(field + "camera.velo_from_camera", info("camera", velo_from_camera=[0] * 12))
        self.refused("bufferViews[0].byteOffset", lambda scene: scene["bufferViews"][0].update(byteOffset=-4))
        self.refused("scene", lambda scene: scene.update(scene=9))
        self.refused("nodes", lambda scene: scene.update(nodes=5))

    def test_a_picture_that_claims_too_much(self):
        view = self.json["bufferViews"][self.json["images"][0]["bufferView"]]
        at = view.get("byteOffset", 0)
        binary = self.binary[:at + 16] + struct.pack(">II", 60000, 60000) + self.binary[at + 24:]
        self.refused("images[0]", lambda scene: None, binary)

    def test_nested_json_and_pipes(self):
        path = self.write(b'{"extras":' + b"[" * NESTED + b"]" * NESTED + b"}", b"\0\0\0\0")
        with self.assertRaisesRegex(ValueError, "bad.glb: JSON chunk: nested too deep"):
            glb.Glb(path)
        pipe = os.path.join(self.folder.name, "pipe.glb")
        os.mkfifo(pipe)
        with self.assertRaisesRegex(ValueError, "pipe.glb: is not a file"):
            glb.Glb(pipe)


unittest.main(argv=sys.argv[:1])
