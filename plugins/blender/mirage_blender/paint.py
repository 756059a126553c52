"""The paint of a Blender material: one scene-linear colour or one image, all that Mirage's light model uses."""

from typing import NamedTuple

import numpy

from . import features


class Paint(NamedTuple):
    color: tuple = (0.8, 0.8, 0.8)  # scene-linear; Cycles' grey for a mesh without a material
    image: object = None  # bpy.types.Image, instead of the colour
    extension: str = "EXTEND"  # beyond the image's edge: EXTEND, REPEAT or CLIP
    uv_map: str = ""  # the image's UV map; empty: the one that is active in renders
    notes: tuple = ()  # for the user: features that are not drawn


def surface_node(material, notes):
    """The shader at the output, or the first one of a mix or a sum; None without one."""
    outputs = [n for n in material.node_tree.nodes if n.type == "OUTPUT_MATERIAL" and n.is_active_output]
    links = outputs[0].inputs["Surface"].links if outputs else ()
    node = links[0].from_node if links else None
    for _ in range(32):
        if node is None or node.type not in ("MIX_SHADER", "ADD_SHADER"):
            break
        shaders = [s for s in node.inputs if s.type == "SHADER" and s.links]
        if shaders:
            notes.append(f"only the first shader of {node.name} is drawn")
        node = shaders[0].links[0].from_node if shaders else None
    return node


def is_over_zero(socket):
    """Whether a number or a colour may be more than 0."""
    value = socket.default_value
    return bool(socket.links) or (max(value[:3]) if hasattr(value, "__len__") else value) > 0


def shader_notes(node):
    """Notes on what a shader does beyond a matt surface of its colour. Gloss is not noted."""
    if node.type == "BSDF_DIFFUSE":
        return []
    if node.type != "BSDF_PRINCIPLED":
        return [f"{node.name} is drawn matt, opaque and without a light of its own"]
    notes = []
    alpha, strength = node.inputs["Alpha"], node.inputs["Emission Strength"]
    if alpha.links or alpha.default_value < 1:
        notes.append("its alpha is ignored")
    if is_over_zero(features.principled_input(node, "transmission")):
        notes.append("its transmission is ignored")
    if is_over_zero(strength) and is_over_zero(features.principled_input(node, "emission")):
        notes.append("its emission is ignored")
    return notes


def image_paint(shown, node, output, notes):
    """The paint of an image texture node, whose socket `output` is linked. shown: the viewport colour."""
    links, uv_map = node.inputs["Vector"].links, ""
    if links and links[0].from_node.type == "UVMAP":
        uv_map = links[0].from_node.uv_map
    elif links and not (links[0].from_node.type == "TEX_COORD" and links[0].from_socket.name == "UV"):
        notes.append("its texture mapping is ignored")
    if node.projection != "FLAT":
        notes.append("its texture projection is ignored")
    if output != "Color":
        notes.append(f"its image gives its colours in place of its {output.lower()}")
    return Paint(shown, node.image, node.extension, uv_map)


def followed(material, notes):
    """The paint of a material. Its notes are added to the list instead."""
    shown = tuple(material.diffuse_color[:3])
    if not material.use_nodes or material.node_tree is None:
        return Paint(shown)
    node = surface_node(material, notes)
    socket = node and (node.inputs.get("Base Color") or node.inputs.get("Color"))
    if socket is None:
        notes.append("no base colour; its viewport colour is used")
        return Paint(shown)
    notes += shader_notes(node)
    if not socket.links:
        return Paint(tuple(socket.default_value[:3]))
    source = socket.links[0].from_node
    if source.type == "RGB":
        return Paint(tuple(source.outputs[0].default_value[:3]))
    if source.type == "TEX_IMAGE" and source.image is not None:
        return image_paint(shown, source, socket.links[0].from_socket.name, notes)
    notes.append(f"base colour comes from {source.name}; its viewport colour is used")
    return Paint(shown)


def paint_of(material):
    if material is None:
        return Paint()
    notes = []
    paint = followed(material, notes)
    return paint._replace(notes=tuple(f"{material.name}: {note}" for note in notes))


def linear_pixels(image):
    """An image's pixels: height x width x 3 float64, scene-linear, row 0 at the bottom as in Blender; None for an empty image."""
    width, height = image.size
    if width == 0 or height == 0:
        return None
    flat = numpy.empty(width * height * image.channels, numpy.float32)
    image.pixels.foreach_get(flat)
    pixels = flat.reshape(height, width, image.channels)[:, :, :3].astype(numpy.float64)
    if pixels.shape[2] < 3:
        pixels = numpy.repeat(pixels[:, :, :1], 3, axis=2)
    if not image.is_float and image.colorspace_settings.name == "sRGB":
        pixels = numpy.where(pixels <= 0.04045, pixels / 12.92, ((pixels + 0.055) / 1.055) ** 2.4)
    return pixels


def look_up(pixels, uv, extension):
    """The nearest pixels, n x 3, at n x 2 UV coordinates (0 … 1, origin bottom left). extension: EXTEND, REPEAT or CLIP."""
    height, width = pixels.shape[:2]
    x = numpy.floor(uv[:, 0] * width).astype(numpy.int64)
    y = numpy.floor(uv[:, 1] * height).astype(numpy.int64)
    if extension == "REPEAT":
        return pixels[y % height, x % width]
    found = pixels[numpy.clip(y, 0, height - 1), numpy.clip(x, 0, width - 1)]
    if extension == "CLIP":
        found = numpy.where(((x >= 0) & (x < width) & (y >= 0) & (y < height))[:, None], found, 0)
    return found
