"""Mirage's light model in Cycles: ambient + hemisphere (1 + n·up)/2 + sun max(0, n·l) on Lambert faces, and the effects that
the validation adds."""

import math

import bpy
from mathutils import Vector

from . import features

SUN_ANGLE = math.radians(0.53)  # the sun's disc seen from the Earth
NO_EFFECTS = {"shadows": False, "sky": False, "bounces": 0, "specular": False, "surroundings": "none"}


class Nodes:
    """Helper to build node trees."""

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

    def color(self, paint):
        """A paint's plain colour, or its image's texels without filtering."""
        if paint.image is None:
            return (*paint.color, 1.0)
        texture = self.add("ShaderNodeTexImage", interpolation="Closest", extension=paint.extension,
                           image=paint.image)
        return texture.outputs["Color"]


def surface(nodes, color, specular):
    if specular:
        node = nodes.add("ShaderNodeBsdfPrincipled")
        nodes.put(color, node.inputs["Base Color"])
        features.principled_input(node, "specular").default_value = 0.5
        node.inputs["IOR"].default_value = 1.5  # with a level of 0.5: 4 % reflected at normal incidence, under either name
        node.inputs["Roughness"].default_value = 0.5
        node.inputs["Metallic"].default_value = 0.0
    else:
        node = nodes.add("ShaderNodeBsdfDiffuse")
        nodes.put(color, node.inputs["Color"])
        node.inputs["Roughness"].default_value = 0.0
    return node.outputs[0]


def make_lambert(material, paint, light, effects=NO_EFFECTS):
    """Turns the material into `paint` under the light. A BSDF reflects the sun. Ambient and hemisphere come from the sky with
    effects["sky"], else from emission. Returns the material."""
    material.use_nodes = True
    if hasattr(material.cycles, "emission_sampling"):  # Blender 3.5
        material.cycles.emission_sampling = "NONE"
    else:
        material.cycles.sample_as_light = False
    nodes = Nodes(material.node_tree)
    output = nodes.add("ShaderNodeOutputMaterial")
    color = nodes.color(paint)
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
    """Gives the scene a world of radiance a + b·z, z the sine of the direction's elevation: a = ambient + hemisphere/2, b = 3/4
    hemisphere. A face with normal n then receives exactly ambient + hemisphere (1 + n_up)/2 (times π). Black unless `on`."""
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


def set_sun(sun, light, shadows):
    strongest = max(max(light["sun"]), 1e-12)
    sun.data.energy = math.pi * strongest
    sun.data.color = [value / strongest for value in light["sun"]]
    sun.data.angle = SUN_ANGLE if shadows else 0.0
    # Set both if both exist: which one Cycles reads depends on the version.
    for holder, name in ((sun.data, "use_shadow"), (sun.data.cycles, "cast_shadow")):
        if hasattr(holder, name):
            setattr(holder, name, bool(shadows))
    sun.parent = None
    sun.matrix_world = Vector(light["to_sun_velo"]).to_track_quat("Z", "Y").to_matrix().to_4x4()


def set_view(scene):
    """Shows pictures in plain sRGB: by default Blender uses Filmic or AgX, depending on its version."""
    view = scene.view_settings
    view.view_transform, view.look, view.exposure, view.gamma = "Standard", "None", 0.0, 1.0


def set_quality(scene, layer, samples=1, seed=0, pixel="area", effects=NO_EFFECTS, threads=0,
                file_format="OPEN_EXR_MULTILAYER"):
    """Sets Cycles to exact on the CPU: no denoiser, adaptive sampling or clamping; linear 32-bit EXR. `pixel`: "centre" samples only
    the pixel's centre, "area" its area evenly. threads: 0 for all."""
    render, cycles = scene.render, scene.cycles
    render.engine = "CYCLES"
    cycles.device = "CPU"
    cycles.feature_set = "SUPPORTED"
    cycles.samples = int(samples)
    cycles.seed = int(seed) & 0x7FFFFFFF
    cycles.use_denoising = False
    cycles.use_adaptive_sampling = False
    cycles.light_sampling_threshold = 0.0
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0.0
    bounces = int(effects["bounces"])
    cycles.max_bounces = cycles.diffuse_bounces = cycles.glossy_bounces = bounces
    cycles.transmission_bounces = cycles.volume_bounces = 0
    cycles.caustics_reflective = cycles.caustics_refractive = True
    cycles.blur_glossy = 0.0
    if pixel == "centre":
        # Cycles takes a pixel's first sample at its centre with any filter; a narrow filter keeps later ones near.
        cycles.pixel_filter_type = "BLACKMAN_HARRIS"
        cycles.filter_width = 0.01
    else:
        cycles.pixel_filter_type = "BOX"
    render.film_transparent = True
    set_view(scene)
    render.use_compositing = render.use_sequencer = False
    render.use_persistent_data = False
    render.threads_mode = "FIXED" if threads else "AUTO"
    if threads:
        render.threads = int(threads)
    settings = render.image_settings
    settings.file_format = file_format
    settings.color_mode = "RGBA"
    settings.color_depth = "32"
    settings.exr_codec = "ZIP"
    render.use_file_extension = False
    layer.use_pass_combined = True
    layer.cycles.use_pass_shadow_catcher = effects["surroundings"] == "catcher"
