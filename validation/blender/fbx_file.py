"""The adversary as FBX, for game engines and driving simulators: one object, one material, its texels as an embedded
8-bit sRGB picture with a pixel a texel; metres; the object's origin is the roof socket.

The input is a .glb of mirage export, whose lowest vertex is at z = 0 (exchange/mesh_files.h). FBX cannot express
unfiltered textures: every triangle's UVs lie at one texel's centre, so that any filter shows that texel.
"""

import os
import tempfile

import bpy
from mirage_blender import features
from mirage_blender.glb import Glb

NAME = "adversary"


def fresh_scene():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.preferences.filepaths.use_scripts_auto_execute = False


def write(mesh, output):
    fresh_scene()
    bpy.ops.import_scene.gltf(filepath=mesh, **features.importer_arguments(shading="FLAT", merge=True))
    things = [thing for thing in bpy.data.objects if thing.type == "MESH"]
    if len(things) != 1:
        raise ValueError(f"{mesh}: {len(things)} meshes where one belongs")
    thing = things[0]
    thing.name = thing.data.name = NAME
    with tempfile.TemporaryDirectory(prefix="mirage-fbx-") as folder:
        picture = texels_picture(Glb(mesh), folder)
        if picture:
            thing.data.materials.clear()
            thing.data.materials.append(material(picture))
        bpy.context.view_layer.objects.active = thing
        thing.select_set(True)
        # Blender's own FBX settings of scale: metres stay metres in Blender, and centimetres by the file's unit elsewhere.
        bpy.ops.export_scene.fbx(filepath=output, use_selection=True, object_types={"MESH"}, path_mode="COPY",
                                 embed_textures=True, apply_scale_options="FBX_SCALE_UNITS", mesh_smooth_type="FACE",
                                 bake_anim=False, use_custom_props=False, add_leaf_bones=False)
    return {"vertices": len(thing.data.vertices), "faces": len(thing.data.polygons)}


def texels_picture(glb, folder):
    """The file's own picture, byte for byte; None without one."""
    images = glb.json.get("images", [])
    if not images:
        return None
    path = os.path.join(folder, NAME + ".png")
    with open(path, "wb") as file:
        file.write(glb.bytes(images[0]["bufferView"]))
    return bpy.data.images.load(path)


def material(picture):
    made = bpy.data.materials.new(NAME)
    made.use_nodes = True
    shader = made.node_tree.nodes["Principled BSDF"]
    shader.inputs["Roughness"].default_value = 1.0
    features.principled_input(shader, "specular").default_value = 0.0
    node = made.node_tree.nodes.new("ShaderNodeTexImage")
    node.image, node.interpolation = picture, "Closest"
    made.node_tree.links.new(node.outputs["Color"], shader.inputs["Base Color"])
    return made


def inspect(path):
    """The content for a program that opens the file: the place and scale, its material count, and for each triangle
    its corners (m, world) and the texel (0-255, sRGB) at the middle of its UVs."""
    fresh_scene()
    bpy.ops.import_scene.fbx(filepath=path)
    things = [thing for thing in bpy.data.objects if thing.type == "MESH"]
    if len(things) != 1:
        raise ValueError(f"{path}: {len(things)} meshes where one belongs")
    thing = things[0]
    bpy.context.view_layer.update()
    mesh, world = thing.data, thing.matrix_world
    mesh.calc_loop_triangles()
    uvs = mesh.uv_layers.active
    picture = next((image for image in bpy.data.images if image.size[0] > 0), None)
    width, height = picture.size if picture else (0, 0)
    pixels = list(picture.pixels) if picture else []
    triangles, texels = [], []
    for triangle in mesh.loop_triangles:
        triangles.append([list(world @ mesh.vertices[k].co) for k in triangle.vertices])
        if picture and uvs:
            middle = sum((uvs.data[k].uv for k in triangle.loops), start=uvs.data[triangle.loops[0]].uv * 0) / 3
            at = 4 * (int(middle[1] * height) * width + int(middle[0] * width))
            texels.append([round(255 * value) for value in pixels[at:at + 3]])
    return {"name": thing.name, "materials": len(mesh.materials), "pictures": len(bpy.data.images),
            "packed": bool(picture and picture.packed_file), "origin": list(world.translation),
            "scale": list(world.to_scale()), "triangles": triangles, "texels": texels}
