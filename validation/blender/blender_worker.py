"""Long-lived Blender worker: JSON lines in on stdin, JSON lines out on what was stdout.

    blender -b --factory-startup --python-exit-code 1 -P blender_worker.py --

Jobs (one object a line, each answered by one line {"id", "ok": true, ...} or {"id", "ok": false, "error"}):
    {"job": "ping"}
    {"job": "render", "scene": GLB, "rect": [u0, v0, u1, v1], "output": EXR, "samples": N, "seed": S,
     "threads": N (0: all cores), "pixel": "centre" | "area", "filter_width": PIXELS, "effects": {"shadows", "sky", "clear_sky", "bounces", "specular",
     "paint", "surroundings": "none" | "unseen" | "catcher"}}
    {"job": "raycast", "scene": GLB, "rays": FILE, "output": FILE}
    {"job": "fbx", "mesh": GLB, "output": FBX}
    {"job": "inspect", "file": FBX}
    {"job": "kit", "vertices", "faces", "bed": [x, y, z], "out": FOLDER}

Blender's own importer reads geometry, nodes and UVs of the .glb, as any viewer does. What glTF cannot express
(principal point, the whole light model, texels beyond 8 bits) is read from the file's extras.
glTF's axes (y up) turn into Blender's (z up) on import, so Blender's world is Mirage's `velo`. No code in a file is
ever run: glTF holds no scripts, its extras come in as plain properties, and auto-execution (drivers, registered
texts) is off.
"""

import json
import os
import sys
import time

# Blender prints on stdout: keep a private copy for the protocol and send its chatter to stderr.
ANSWERS = os.fdopen(os.dup(1), "w", buffering=1)
os.dup2(2, 1)

import bpy  # noqa: E402
import numpy  # noqa: E402
from mathutils import Vector  # noqa: E402
from mathutils.bvhtree import BVHTree  # noqa: E402

# Import, camera and light are implemented once, in the add-on's package.
sys.dont_write_bytecode = True
HERE = os.path.dirname(os.path.abspath(__file__))
sys.path[:0] = [HERE, os.path.join(HERE, "..", "..", "plugins", "blender")]
from mirage_blender import camera as camera_model  # noqa: E402
from mirage_blender import cycles_light, features, scene_import  # noqa: E402
from mirage_blender.paint import Paint  # noqa: E402

import fbx_file  # noqa: E402
import physical_light  # noqa: E402
import print_kit  # noqa: E402


class LoadedScene:
    """The scene that Blender holds now; kept between jobs on the same file."""

    def __init__(self):
        self.key = None

    def load(self, path):
        stat = os.stat(path)
        key = (os.path.abspath(path), stat.st_mtime_ns, stat.st_size)
        if key == self.key:
            return
        self.key = None
        bpy.ops.wm.read_factory_settings(use_empty=True)
        bpy.context.preferences.filepaths.use_scripts_auto_execute = False
        loaded = scene_import.load(path)
        self.info, self.roles, self.texels = loaded.info, loaded.roles, loaded.texels
        self.key = key


SCENE = LoadedScene()
FOUND = features.found()
GREY = (0.5, 0.5, 0.5)  # for a mesh without texels


def render(job):
    effects = {**cycles_light.NO_EFFECTS, **job.get("effects", {})}
    SCENE.load(job["scene"])
    scene, light = bpy.context.scene, SCENE.info["lighting"]
    width, height = camera_model.set_camera(scene, SCENE.roles["camera"][0], SCENE.info["camera"])
    cycles_light.set_quality(scene, bpy.context.view_layer, job.get("samples", 1), job.get("seed", 0),
                             job.get("pixel", "area"), effects, job.get("threads", 0))
    cycles_light.set_sun(SCENE.roles["sun"][0], light, effects["shadows"])
    cycles_light.set_sky(scene, light, effects["sky"])
    if effects["sky"]:
        # Blender's own choice of importance map takes 0.8 s a render; the sky varies slowly.
        scene.world.cycles.sampling_method = "MANUAL"
        scene.world.cycles.sample_map_resolution = 128
    if effects["sky"] and effects.get("clear_sky"):
        physical_light.set_clear_sky(scene, light)
    if job.get("filter_width", 0) > 0:
        scene.cycles.pixel_filter_type = "BLACKMAN_HARRIS"
        scene.cycles.filter_width = job["filter_width"]
    adversary = SCENE.roles["adversary"][0]
    adversary.data.materials.clear()
    material = cycles_light.make_lambert(bpy.data.materials.new("adversary"), Paint(GREY, SCENE.texels), light,
                                         effects)
    adversary.data.materials.append(material)
    surroundings = effects["surroundings"]
    for role, things in SCENE.roles.items():
        if role in scene_import.ROLES:
            continue
        for thing in things:
            thing.hide_render = surroundings == "none"
            thing.visible_camera = surroundings != "unseen"
            thing.is_shadow_catcher = surroundings == "catcher"
            if role == "host":
                physical_light.set_paint(thing, effects.get("paint", False))
    camera_model.set_border(scene.render, job["rect"], width, height)
    scene.render.filepath = job["output"]
    started = time.time()
    bpy.ops.render.render(write_still=True)
    seconds = time.time() - started
    if not os.path.exists(job["output"]):
        raise RuntimeError("Blender wrote no picture")
    return {"seconds": seconds}


def raycast(job):
    """Nearest distance along each ray (unit direction) to the adversary alone; -1 if the ray misses it.
    Rays: rows of six little-endian float64 (origin, direction); answers: float64."""
    SCENE.load(job["scene"])
    thing = SCENE.roles["adversary"][0]
    mesh, world = thing.data, thing.matrix_world
    mesh.calc_loop_triangles()
    vertices = [world @ vertex.co for vertex in mesh.vertices]
    triangles = [tuple(triangle.vertices) for triangle in mesh.loop_triangles]
    tree = BVHTree.FromPolygons(vertices, triangles, all_triangles=True)
    rays = numpy.fromfile(job["rays"], dtype="<f8").reshape(-1, 6)
    ranges = numpy.full(len(rays), -1.0)
    started = time.time()
    for i, ray in enumerate(rays):
        distance = tree.ray_cast(Vector(ray[:3]), Vector(ray[3:]))[3]
        if distance is not None:
            ranges[i] = distance
    ranges.astype("<f8").tofile(job["output"])
    return {"seconds": time.time() - started, "rays": len(rays)}


def ping(job):
    return {"version": bpy.app.version_string, "found": FOUND,
            "runs_scripts": bool(bpy.context.preferences.filepaths.use_scripts_auto_execute)}


def write_fbx(job):
    SCENE.key = None
    return fbx_file.write(job["mesh"], job["output"])


def inspect(job):
    SCENE.key = None
    return fbx_file.inspect(job["file"])


JOBS = {"ping": ping, "render": render, "raycast": raycast, "fbx": write_fbx, "inspect": inspect, "kit": print_kit.write}


def main():
    print("blender_worker.py found:", json.dumps(FOUND), file=sys.stderr, flush=True)
    for line in sys.stdin:
        if not line.strip():
            continue
        answer = {"id": None, "ok": False}
        try:
            job = json.loads(line)
            answer["id"] = job.get("id")
            answer.update(JOBS[job["job"]](job), ok=True)
        except Exception as error:  # every failure is an answer: the worker lives on
            answer.update(ok=False, error=f"{type(error).__name__}: {error}".replace("\n", " "))
        ANSWERS.write(json.dumps(answer) + "\n")
        ANSWERS.flush()


main()
