"""Long-lived Blender worker: JSON lines in on stdin, JSON lines out on what was stdout.

    blender -b --factory-startup --python-exit-code 1 -P blender_worker.py --

Jobs (one object a line, each answered by one line {"id", "ok": true, ...} or {"id", "ok": false, "error"}):
    {"job": "ping"}
    {"job": "render", "scene": GLB, "rect": [u0, v0, u1, v1], "output": EXR, "samples": N, "seed": S,
     "pixel": "centre" | "area", "effects": {"shadows", "sky", "bounces", "specular", "surroundings": "none" | "unseen" | "catcher"}}
    {"job": "raycast", "scene": GLB, "rays": FILE, "output": FILE}
    {"job": "quit"}

The .glb comes in through Blender's own importer: geometry, nodes and UVs are what any viewer gets. What glTF
cannot say (principal point, the whole light model, texels beyond 8 bits) is read from the file's extras.
glTF's axes (y up) turn into Blender's (z up) on import, so Blender's world is Mirage's `velo`.
"""

import json
import math
import os
import struct
import sys
import time

# Blender prints on stdout: keep a private copy for the protocol and send its chatter to stderr.
ANSWERS = os.fdopen(os.dup(1), "w", buffering=1)
os.dup2(2, 1)

import numpy  # noqa: E402

if "bool" not in vars(numpy):
    numpy.bool = bool  # Blender 3.4's importer uses the name that numpy 1.24 dropped

import bpy  # noqa: E402
from mathutils import Matrix, Vector  # noqa: E402
from mathutils.bvhtree import BVHTree  # noqa: E402

NO_EFFECTS = {"shadows": False, "sky": False, "bounces": 0, "specular": False, "surroundings": "none"}
SUN_ANGLE = math.radians(0.53)  # the sun's disc seen from the Earth


class Glb:
    """The JSON chunk and the binary chunk of a .glb file."""

    def __init__(self, path):
        with open(path, "rb") as file:
            data = file.read()
        if len(data) < 20 or data[:4] != b"glTF":
            raise ValueError(f"{path}: not a .glb file")
        length = struct.unpack_from("<I", data, 12)[0]
        self.json = json.loads(data[20:20 + length])
        self.binary = data[20 + length + 8:]

    def array(self, view, dtype, columns):
        """A buffer view as a float/int table."""
        spec = self.json["bufferViews"][view]
        start = spec.get("byteOffset", 0)
        flat = numpy.frombuffer(self.binary[start:start + spec["byteLength"]], dtype=dtype)
        return flat.reshape(-1, columns)


class LoadedScene:
    """The scene that is in Blender now; kept between jobs on the same file."""

    def __init__(self):
        self.key = None
        self.info = None

    def load(self, path):
        stat = os.stat(path)
        key = (os.path.abspath(path), stat.st_mtime_ns, stat.st_size)
        if key == self.key:
            return
        self.key = None
        bpy.ops.wm.read_factory_settings(use_empty=True)
        bpy.context.preferences.filepaths.use_scripts_auto_execute = False
        glb = Glb(path)
        bpy.ops.import_scene.gltf(filepath=path, import_shading="FLAT", convert_lighting_mode="RAW")
        self.info = glb.json["scenes"][glb.json.get("scene", 0)]["extras"]["mirage"]
        self.roles = {}
        for thing in bpy.data.objects:
            role = thing.get("mirage_role")
            if role:
                self.roles.setdefault(role, []).append(thing)
        for role in ("adversary", "camera", "sun"):
            if role not in self.roles:
                raise ValueError(f"{path}: no object with role '{role}'")
        self.texels = exact_texels(glb, self.roles["adversary"][0])
        self.key = key


SCENE = LoadedScene()


def exact_texels(glb, adversary):
    """A float image of the adversary's texels in the place of the 8-bit texture; None without texels."""
    mesh = next(m for m in glb.json["meshes"] if m.get("extras", {}).get("mirage"))
    exact = mesh["extras"]["mirage"]
    if "texels" not in exact:
        return None
    width, height = exact["texture_size"]
    pixels = numpy.ones((height * width, 4), dtype=numpy.float32)
    texels = glb.array(exact["texels"], "<f8", 3)
    pixels[:len(texels), :3] = texels
    image = bpy.data.images.new("exact texels", width, height, float_buffer=True)
    image.colorspace_settings.name = "Non-Color"
    image.pixels.foreach_set(pixels.reshape(height, width, 4)[::-1].ravel())
    image.update()
    return image


class Nodes:
    """Short-hand for building node trees."""

    def __init__(self, tree):
        self.tree = tree
        tree.nodes.clear()

    def add(self, kind, **settings):
        node = self.tree.nodes.new(kind)
        for name, value in settings.items():
            setattr(node, name, value)
        return node

    def put(self, value, socket):
        if hasattr(value, "is_output"):
            self.tree.links.new(value, socket)
        else:
            socket.default_value = value

    def math(self, operation, *values):
        node = self.add("ShaderNodeMath", operation=operation)
        for value, socket in zip(values, node.inputs):
            self.put(value, socket)
        return node.outputs[0]

    def vector(self, operation, *values):
        node = self.add("ShaderNodeVectorMath", operation=operation)
        for value, socket in zip(values, node.inputs):
            self.put(value, socket)
        return node.outputs["Value" if operation == "DOT_PRODUCT" else "Vector"]

    def scale(self, vector, factor):
        node = self.add("ShaderNodeVectorMath", operation="SCALE")
        self.put(vector, node.inputs[0])
        self.put(factor, node.inputs["Scale"])
        return node.outputs["Vector"]


def surface(nodes, color, specular):
    if specular:
        node = nodes.add("ShaderNodeBsdfPrincipled")
        nodes.put(color, node.inputs["Base Color"])
        node.inputs["Specular"].default_value = 0.5
        node.inputs["Roughness"].default_value = 0.5
        node.inputs["Metallic"].default_value = 0.0
    else:
        node = nodes.add("ShaderNodeBsdfDiffuse")
        nodes.put(color, node.inputs["Color"])
        node.inputs["Roughness"].default_value = 0.0
    return node.outputs[0]


def adversary_material(light, effects):
    """The texels under the light: sun by a BSDF; ambient and hemisphere by the sky, or else as emission."""
    material = bpy.data.materials.new("adversary")
    material.use_nodes = True
    material.cycles.sample_as_light = False
    nodes = Nodes(material.node_tree)
    output = nodes.add("ShaderNodeOutputMaterial")
    if SCENE.texels is None:
        color = (0.5, 0.5, 0.5, 1.0)
    else:
        texture = nodes.add("ShaderNodeTexImage", interpolation="Closest", extension="EXTEND", image=SCENE.texels)
        color = texture.outputs["Color"]
    if effects["sky"]:
        nodes.put(surface(nodes, color, effects["specular"]), output.inputs["Surface"])
        return material
    # The light-weight model shades by the face's winding. Cycles turns a normal seen from behind towards the
    # viewer: turn it back, and take the sun's part of such a face out of the BSDF.
    geometry = nodes.add("ShaderNodeNewGeometry")
    behind = geometry.outputs["Backfacing"]
    normal = nodes.scale(geometry.outputs["True Normal"], nodes.math("MULTIPLY_ADD", behind, -2.0, 1.0))
    upward = nodes.math("MULTIPLY_ADD", nodes.vector("DOT_PRODUCT", normal, (0.0, 0.0, 1.0)), 0.5, 0.5)
    towards_sun = nodes.math("MAXIMUM", nodes.vector("DOT_PRODUCT", normal, tuple(light["to_sun_velo"])), 0.0)
    factor = nodes.vector("ADD", nodes.scale(tuple(light["hemisphere"]), upward), tuple(light["ambient"]))
    from_behind = nodes.scale(tuple(light["sun"]), nodes.math("MULTIPLY", towards_sun, behind))
    factor = nodes.vector("ADD", factor, from_behind)
    albedo = color if hasattr(color, "is_output") else color[:3]
    emission = nodes.add("ShaderNodeEmission")
    nodes.put(nodes.vector("MULTIPLY", albedo, factor), emission.inputs["Color"])
    nodes.put(nodes.add("ShaderNodeLightPath").outputs["Is Camera Ray"], emission.inputs["Strength"])
    front = nodes.scale(albedo, nodes.math("SUBTRACT", 1.0, behind))
    add = nodes.add("ShaderNodeAddShader")
    nodes.put(surface(nodes, front, effects["specular"]), add.inputs[0])
    nodes.put(emission.outputs[0], add.inputs[1])
    nodes.put(add.outputs[0], output.inputs["Surface"])
    return material


def set_sky(scene, light, on):
    """Radiance a + b·z with z the direction's elevation sine, so that a face with normal n receives exactly
    ambient + hemisphere (1 + n_up)/2 (times π): a = ambient + hemisphere/2, b = 3/4 hemisphere."""
    world = bpy.data.worlds.new("sky")
    scene.world = world
    world.use_nodes = True
    nodes = Nodes(world.node_tree)
    output = nodes.add("ShaderNodeOutputWorld")
    background = nodes.add("ShaderNodeBackground")
    nodes.put(background.outputs[0], output.inputs["Surface"])
    background.inputs["Strength"].default_value = 1.0 if on else 0.0
    if not on:
        background.inputs["Color"].default_value = (0, 0, 0, 1)
        world.cycles.sampling_method = "NONE"
        return
    direction = nodes.add("ShaderNodeTexCoord").outputs["Generated"]
    up = nodes.vector("DOT_PRODUCT", direction, (0.0, 0.0, 1.0))
    level = tuple(a + h / 2 for a, h in zip(light["ambient"], light["hemisphere"]))
    slope = tuple(0.75 * h for h in light["hemisphere"])
    radiance = nodes.vector("ADD", nodes.scale(slope, up), level)
    nodes.put(nodes.vector("MAXIMUM", radiance, (0.0, 0.0, 0.0)), background.inputs["Color"])


def set_camera(scene, camera, info):
    width, height = int(info["width"]), int(info["height"])
    ratio = info["fx"] / info["fy"]
    data = camera.data
    data.type = "PERSP"
    data.sensor_fit = "HORIZONTAL"
    data.sensor_width = 36.0
    data.lens = info["fx"] * 36.0 / width
    data.shift_x = 0.5 - (info["cx"] + 0.5) / width
    data.shift_y = (info["cy"] + 0.5 - height / 2) * ratio / width
    data.clip_start = 0.01
    data.clip_end = 10000.0
    rows = info["velo_from_camera"]
    velo_from_camera = Matrix([rows[0:4], rows[4:8], rows[8:12], (0, 0, 0, 1)])
    camera.parent = None
    # Blender's camera looks along -z with y up; ours along +z with y down.
    camera.matrix_world = velo_from_camera @ Matrix.Diagonal((1, -1, -1, 1))
    scene.camera = camera
    render = scene.render
    render.resolution_x, render.resolution_y, render.resolution_percentage = width, height, 100
    render.pixel_aspect_x, render.pixel_aspect_y = (1.0, ratio) if ratio >= 1 else (1.0 / ratio, 1.0)
    return width, height


def set_sun(sun, light, shadows):
    strongest = max(max(light["sun"]), 1e-12)
    sun.data.energy = math.pi * strongest
    sun.data.color = [value / strongest for value in light["sun"]]
    sun.data.angle = SUN_ANGLE if shadows else 0.0
    sun.data.cycles.cast_shadow = bool(shadows)
    sun.parent = None
    sun.matrix_world = Vector(light["to_sun_velo"]).to_track_quat("Z", "Y").to_matrix().to_4x4()


def set_quality(scene, job, effects):
    render, cycles = scene.render, scene.cycles
    render.engine = "CYCLES"
    cycles.device = "CPU"
    cycles.feature_set = "SUPPORTED"
    cycles.samples = int(job.get("samples", 1))
    cycles.seed = int(job.get("seed", 0)) & 0x7FFFFFFF
    cycles.use_denoising = False
    cycles.use_adaptive_sampling = False
    cycles.light_sampling_threshold = 0.0
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0.0
    bounces = int(effects["bounces"])
    cycles.max_bounces = cycles.diffuse_bounces = cycles.glossy_bounces = bounces
    cycles.transmission_bounces = cycles.volume_bounces = 0
    cycles.caustics_reflective = cycles.caustics_refractive = True
    cycles.blur_glossy = 0.0
    if job.get("pixel", "area") == "centre":
        # Cycles takes a pixel's first sample at its centre, whatever the filter; a narrow one keeps later ones near.
        cycles.pixel_filter_type = "BLACKMAN_HARRIS"
        cycles.filter_width = 0.01
    else:
        cycles.pixel_filter_type = "BOX"
    render.film_transparent = True
    render.use_compositing = render.use_sequencer = False
    render.use_persistent_data = False
    render.threads_mode = "FIXED" if job.get("threads") else "AUTO"
    if job.get("threads"):
        render.threads = int(job["threads"])
    settings = render.image_settings
    settings.file_format = "OPEN_EXR_MULTILAYER"
    settings.color_mode = "RGBA"
    settings.color_depth = "32"
    settings.exr_codec = "ZIP"
    render.use_file_extension = False
    layer = bpy.context.view_layer
    layer.use_pass_combined = True
    layer.cycles.use_pass_shadow_catcher = effects["surroundings"] == "catcher"


def render(job):
    effects = {**NO_EFFECTS, **job.get("effects", {})}
    SCENE.load(job["scene"])
    scene, light = bpy.context.scene, SCENE.info["lighting"]
    width, height = set_camera(scene, SCENE.roles["camera"][0], SCENE.info["camera"])
    set_quality(scene, job, effects)
    set_sun(SCENE.roles["sun"][0], light, effects["shadows"])
    set_sky(scene, light, effects["sky"])
    adversary = SCENE.roles["adversary"][0]
    adversary.data.materials.clear()
    adversary.data.materials.append(adversary_material(light, effects))
    surroundings = effects["surroundings"]
    for role, things in SCENE.roles.items():
        if role in ("adversary", "camera", "sun"):
            continue
        for thing in things:
            thing.hide_render = surroundings == "none"
            thing.visible_camera = surroundings != "unseen"
            thing.is_shadow_catcher = surroundings == "catcher"
    u0, v0, u1, v1 = job["rect"]
    if not (0 <= u0 < u1 <= width and 0 <= v0 < v1 <= height):
        raise ValueError(f"rect {job['rect']} does not lie in {width}x{height}")
    border = scene.render
    border.use_border = border.use_crop_to_border = True
    # Blender multiplies by the size again and cuts off: a quarter of a pixel keeps float32 on the right side.
    border.border_min_x, border.border_max_x = (u0 + 0.25) / width, (u1 + 0.25) / width
    border.border_min_y, border.border_max_y = (height - v1 + 0.25) / height, (height - v0 + 0.25) / height
    border.filepath = job["output"]
    started = time.time()
    bpy.ops.render.render(write_still=True)
    seconds = time.time() - started
    if not os.path.exists(job["output"]):
        raise RuntimeError("Blender wrote no picture")
    return {"seconds": seconds}


def raycast(job):
    """Nearest distance along each ray (unit direction) to the adversary alone; -1 where it is missed.
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


JOBS = {"ping": lambda job: {"version": bpy.app.version_string}, "render": render, "raycast": raycast}


def main():
    for line in sys.stdin:
        if not line.strip():
            continue
        answer = {"id": None, "ok": False}
        try:
            job = json.loads(line)
            answer["id"] = job.get("id")
            if job["job"] == "quit":
                break
            answer.update(JOBS[job["job"]](job), ok=True)
        except Exception as error:  # every failure is an answer: the worker lives on
            answer.update(ok=False, error=f"{type(error).__name__}: {error}".replace("\n", " "))
        ANSWERS.write(json.dumps(answer) + "\n")
        ANSWERS.flush()


main()
