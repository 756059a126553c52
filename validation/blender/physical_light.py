"""Effects beyond the light model in the validation's renders: the host's car paint and a clear sky."""

import math
import os
import tempfile

import bpy
import numpy

from mirage_blender import features
from mirage_blender.cycles_light import Nodes

LUMINANCE = numpy.array([0.2126, 0.7152, 0.0722])
PROBE = (128, 64)  # pixels of the panorama that measures a sky
TURBIDITY = {"air_density": 1.0, "dust_density": 1.0, "ozone_density": 1.0, "altitude": 0.0}


def set_paint(host, on):
    """Glossy: a dielectric clear coat over a slightly rough coloured base. Otherwise the imported material."""
    if "mirage_plain" not in host:
        host["mirage_plain"] = host.data.materials[0].name if host.data.materials else ""
    plain = bpy.data.materials.get(host["mirage_plain"])
    if plain is None:
        return
    material = plain
    if on:
        material = bpy.data.materials.get("car paint")
        if material is None:
            material = plain.copy()
            material.name = "car paint"
            for node in material.node_tree.nodes:
                if node.type == "BSDF_PRINCIPLED":
                    node.inputs["Roughness"].default_value = 0.3
                    node.inputs["IOR"].default_value = 1.5
                    features.principled_input(node, "specular").default_value = 0.5
                    node.inputs["Metallic"].default_value = 0.0
                    features.principled_input(node, "coat").default_value = 1.0
                    features.principled_input(node, "coat roughness").default_value = 0.03
    host.data.materials[0] = material


def nishita(tree, elevation, azimuth, strength):
    nodes = Nodes(tree)
    output = nodes.add("ShaderNodeOutputWorld")
    background = nodes.add("ShaderNodeBackground")
    sky = nodes.add("ShaderNodeTexSky", sky_type="NISHITA", sun_disc=False, sun_elevation=elevation,
                    sun_rotation=azimuth, **TURBIDITY)
    nodes.put(sky.outputs[0], background.inputs["Color"])
    background.inputs["Strength"].default_value = strength
    nodes.put(background.outputs[0], output.inputs["Surface"])


def upward_irradiance(scene):
    """Luminance / pi that a face looking up receives from the scene's world, by a panorama of it."""
    render = scene.render
    kept = {name: getattr(render, name) for name in (
        "resolution_x", "resolution_y", "resolution_percentage", "use_border", "film_transparent", "filepath",
        "pixel_aspect_x", "pixel_aspect_y")}
    settings, camera, samples = render.image_settings, scene.camera, scene.cycles.samples
    kept_format = settings.file_format
    hidden = [(thing, thing.hide_render) for thing in scene.objects]
    data = bpy.data.cameras.new("probe")
    data.type = "PANO"
    lens = data if hasattr(data, "panorama_type") else data.cycles
    lens.panorama_type = "EQUIRECTANGULAR"
    probe = bpy.data.objects.new("probe", data)
    scene.collection.objects.link(probe)
    probe.rotation_euler = (math.pi / 2, 0, 0)  # upright: the picture's rows are elevations
    handle, path = tempfile.mkstemp(suffix=".exr")
    os.close(handle)
    try:
        for thing, _ in hidden:
            thing.hide_render = True
        scene.camera = probe
        scene.cycles.samples = 1
        render.resolution_x, render.resolution_y, render.resolution_percentage = (*PROBE, 100)
        render.pixel_aspect_x = render.pixel_aspect_y = 1
        render.use_border = render.film_transparent = False
        settings.file_format = "OPEN_EXR"
        render.filepath = path
        bpy.ops.render.render(write_still=True)
        image = bpy.data.images.load(path)
        image.colorspace_settings.name = "Non-Color"
        pixels = numpy.empty(PROBE[0] * PROBE[1] * image.channels, numpy.float32)
        image.pixels.foreach_get(pixels)
        pixels = pixels.reshape(PROBE[1], PROBE[0], image.channels)[:, :, :3]
        bpy.data.images.remove(image)
    finally:
        os.unlink(path)
        for name, value in kept.items():
            setattr(render, name, value)
        settings.file_format = kept_format
        scene.camera, scene.cycles.samples = camera, samples
        for thing, was in hidden:
            thing.hide_render = was
        bpy.data.objects.remove(probe)
        bpy.data.cameras.remove(data)
    rows = PROBE[1]
    elevation = (numpy.arange(rows) + 0.5) / rows * math.pi - math.pi / 2  # Blender's rows go upwards
    luminance = pixels.astype(numpy.float64) @ LUMINANCE
    weight = numpy.where(elevation > 0, numpy.sin(elevation) * numpy.cos(elevation), 0.0)
    return float((luminance.mean(axis=1) * weight).sum() * 2 * math.pi / rows)


def set_clear_sky(scene, light):
    """Nishita's sky (a clear one, without the sun's disc) in place of the light model's, with its gain."""
    x, y, z = light["to_sun_velo"]
    elevation = math.asin(max(-1.0, min(1.0, z)))
    # Blender's sky has its sun at +y, turned clockwise by sun_rotation as seen from above.
    azimuth = math.atan2(x, y)
    wanted = float(LUMINANCE @ (numpy.array(light["ambient"]) + numpy.array(light["hemisphere"])))
    world = scene.world
    nishita(world.node_tree, elevation, azimuth, 1.0)
    world.cycles.sampling_method = "MANUAL"
    world.cycles.sample_map_resolution = 256
    got = upward_irradiance(scene)
    nishita(world.node_tree, elevation, azimuth, wanted / got if got > 0 else 0.0)
