"""Imports a Mirage scene (.glb) into Blender. Blender's own importer reads the geometry, with the nodes and UVs that any viewer
gets. Values that glTF cannot express (principal point, the whole light model, texels beyond 8 bits, the photograph) come
from its extras. Blender's world is Mirage's `velo`: the importer converts glTF's axes (y up) to Blender's (z up)."""

import os
import tempfile

import numpy

if "bool" not in vars(numpy):
    numpy.bool = bool  # Blender 3.4's importer uses the name that numpy 1.24 dropped

import bpy  # noqa: E402

from . import camera, cycles_light, features  # noqa: E402
from .glb import Glb  # noqa: E402
from .glb_check import MOST_PIXELS  # noqa: E402
from .paint import Paint  # noqa: E402

ROLES = ("adversary", "camera", "sun")


class Loaded:
    """An imported scene: `info` (the scene's extras), `roles` {role: [objects]}, `texels` (image or None). ValueError if a part is missing."""

    def __init__(self, glb, objects, path):
        self.glb, self.objects, self.info = glb, objects, glb.scene_info()
        self.roles = {}
        for thing in objects:
            role = thing.get("mirage_role")
            if role:
                self.roles.setdefault(role, []).append(thing)
        for key in ("camera", "lighting"):
            if key not in self.info:
                raise ValueError(f"{path}: no {key} in the scene's extras; export it with mirage export")
        for role in ROLES:
            if role not in self.roles:
                raise ValueError(f"{path}: no object with role '{role}'")
        self.texels = exact_texels(glb)


def load(path):
    """Runs Blender's importer into the current scene. Returns Loaded; ValueError for a file that is not a Mirage scene."""
    glb = Glb(path)
    before, scene = set(bpy.data.objects), bpy.context.scene
    engine = scene.render.engine
    bpy.ops.import_scene.gltf(filepath=path, **features.importer_arguments(shading="FLAT", lighting="RAW"))
    scene.render.engine = engine  # the importer only knows Cycles and Eevee, and sets Eevee for any other
    return Loaded(glb, [thing for thing in bpy.data.objects if thing not in before], path)


def exact_mesh(glb):
    """The extras of the mesh that has Mirage's exact vertices, faces and texels; {} if there is none."""
    for mesh in glb.json.get("meshes", []):
        if mesh.get("extras", {}).get("mirage"):
            return mesh["extras"]["mirage"]
    return {}


def exact_texels(glb):
    """A float image of the adversary's texels, to replace the 8-bit texture; None without texels."""
    exact = exact_mesh(glb)
    if "texels" not in exact or "texture_size" not in exact:
        return None
    width, height = (int(side) for side in exact["texture_size"])
    if not (width >= 1 and height >= 1 and width * height <= MOST_PIXELS):
        raise ValueError("meshes[].extras.mirage.texture_size: is not a picture's size; export the scene again")
    pixels = numpy.ones((height * width, 4), dtype=numpy.float32)
    texels = glb.array(exact["texels"], "<f8", 3)
    pixels[:len(texels), :3] = texels
    image = bpy.data.images.new("exact texels", width, height, float_buffer=True)
    image.colorspace_settings.name = "Non-Color"
    image.pixels.foreach_set(pixels.reshape(height, width, 4)[::-1].ravel())
    image.update()
    return image


def plain_material(name, paint):
    """A new material: the paint on a rough dielectric, with unfiltered texels."""
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    nodes = cycles_light.Nodes(material.node_tree)
    output = nodes.add("ShaderNodeOutputMaterial")
    shader = nodes.add("ShaderNodeBsdfPrincipled")
    shader.inputs["Roughness"].default_value = 0.5
    nodes.put(nodes.color(paint), shader.inputs["Base Color"])
    nodes.put(shader.outputs[0], output.inputs["Surface"])
    return material


def photograph_image(glb, info):
    """The embedded photograph as a packed image; None if there is none."""
    if "photograph" not in info:
        return None
    spec = glb.json["images"][info["photograph"]]
    handle, path = tempfile.mkstemp(suffix=".jpg" if spec["mimeType"] == "image/jpeg" else ".png")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(glb.bytes(spec["bufferView"]))
        image = bpy.data.images.load(path)
        image.pack()
    finally:
        os.unlink(path)
    image.name = "photograph"
    image.filepath_raw = "//photograph.png"  # where it would be unpacked to
    return image


def show_behind(view, image):
    """Shows the picture behind everything, filling the camera's frame."""
    data = view.data
    data.background_images.clear()
    background = data.background_images.new()
    background.image = image
    background.alpha = 1.0
    background.display_depth = "BACK"
    background.frame_method = "STRETCH"
    data.show_background_images = True
    data.passepartout_alpha = 1.0


def import_scene(scene, path):
    """Imports everything: objects, camera, sun, sky, photograph, materials and colour management. Returns Loaded; ValueError for a
    file that is not a Mirage scene."""
    loaded = load(path)
    info, light = loaded.info, loaded.info["lighting"]
    view = loaded.roles["camera"][0]
    camera.set_camera(scene, view, info["camera"])
    cycles_light.set_sun(loaded.roles["sun"][0], light, shadows=True)
    cycles_light.set_sky(scene, light, on=True)
    adversary = loaded.roles["adversary"][0]
    if loaded.texels is not None:
        loaded.texels.pack()  # otherwise a saved .blend loses it
        adversary.data.materials.clear()
        adversary.data.materials.append(plain_material("adversary", Paint(image=loaded.texels)))
    adversary.data["mirage_resolution"] = int(exact_mesh(loaded.glb).get("resolution", 1))
    for role in ("host", "ground"):  # the photograph shows them
        for thing in loaded.roles.get(role, []):
            thing.is_shadow_catcher = True
            thing.display_type = "WIRE"
    photograph = photograph_image(loaded.glb, info)
    if photograph:
        show_behind(view, photograph)
    scene["mirage_photograph"] = photograph.name if photograph else ""
    scene["mirage_source"] = os.path.abspath(path)
    cycles_light.set_view(scene)
    scene.render.film_transparent = True
    if not features.has_denoiser():
        scene.cycles.use_denoising = False
    settings = getattr(scene, "mirage", None)  # absent if the add-on is not registered
    if settings:
        settings.light = "GIVEN"
        settings.ambient, settings.hemisphere = light["ambient"], light["hemisphere"]
        settings.background = "PHOTOGRAPH" if photograph else "FILM"
    return loaded


def describe(loaded):
    """One line that describes an imported scene."""
    info = loaded.info["camera"]
    return (f"{len(loaded.objects)} objects, camera {info['width']}x{info['height']}, "
            f"photograph: {'yes' if 'photograph' in loaded.info else 'no'}")
