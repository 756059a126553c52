# SPDX-License-Identifier: GPL-3.0-or-later
"""Finds what this Blender has, by looking at Blender itself instead of its version number: names of inputs, properties and
operators' arguments differ between 3.4 and 4.3, and a later version may have either. The first name that exists is used."""

import bpy

# Inputs of the principled shader: the name since Blender 4.0, and the one before.
PRINCIPLED = {"specular": ("Specular IOR Level", "Specular"), "coat": ("Coat Weight", "Clearcoat"),
              "coat roughness": ("Coat Roughness", "Clearcoat Roughness"),
              "transmission": ("Transmission Weight", "Transmission"), "emission": ("Emission Color", "Emission")}
# The glTF importer's arguments by their meaning. An importer that lacks one behaves that way by default.
IMPORTER = {"shading": ("import_shading",), "lighting": ("export_import_convert_lighting_mode", "convert_lighting_mode"),
            "merge": ("merge_vertices",)}


def first(names, there):
    """The first of the names that is in `there`, or None."""
    return next((name for name in names if name in there), None)


def principled_input(node, what):
    """The socket of a principled shader for a key of PRINCIPLED. ValueError if this Blender has none."""
    name = first(PRINCIPLED[what], node.inputs)
    if name is None:
        raise ValueError(f"principled shader: Blender {bpy.app.version_string} has no input "
                         f"{' or '.join(PRINCIPLED[what])}; use Blender 3.4 to 4.3")
    return node.inputs[name]


def importer_names():
    """{key of IMPORTER: the argument's name in bpy.ops.import_scene.gltf, or None}."""
    there = bpy.ops.import_scene.gltf.get_rna_type().properties.keys()
    return {what: first(names, there) for what, names in IMPORTER.items()}


def importer_arguments(**wanted):
    """{argument: value} for bpy.ops.import_scene.gltf, from values by the keys of IMPORTER. Arguments that it lacks are left out."""
    names = importer_names()
    return {names[what]: value for what, value in wanted.items() if names[what]}


def has_denoiser():
    """Whether this build has OpenImageDenoise. Without it, Cycles fails if denoising is on."""
    try:
        import _cycles
    except ImportError:
        return False
    return bool(getattr(_cycles, "with_openimagedenoise", False))


def found():
    """The worker's report as JSON when it starts: the chosen names, None for a missing one."""
    material = bpy.data.materials.new("asked")
    material.use_nodes = True
    node = material.node_tree.nodes.new("ShaderNodeBsdfPrincipled")
    inputs = {what: first(names, node.inputs) for what, names in PRINCIPLED.items()}
    bpy.data.materials.remove(material)
    return {"version": bpy.app.version_string, "principled_inputs": inputs, "importer_arguments": importer_names(),
            "view_transform": bpy.context.scene.view_settings.view_transform, "denoiser": has_denoiser()}
