"""Exports what a dependency graph shows as a Mirage scene (.glb): meshes in world space (`velo`, m) with flat faces and their base
colours as texels, one sun, ambient light, and the camera's intrinsics."""

import math
import os

import bpy
import numpy

from . import camera
from .glb import GlbWriter
from .paint import linear_pixels, look_up, paint_of

SURFACES = {"MESH", "CURVE", "SURFACE", "META", "FONT"}


class ExportError(Exception):
    """A message of one line for the user: where, what is wrong, how to fix it."""


def is_drawn(thing):
    """Whether Mirage draws the object. It skips shadow catchers and hold-outs, which stand in for what is behind the scene."""
    return thing.type in SURFACES and thing.visible_camera and not (thing.is_shadow_catcher or thing.is_holdout)


def atlas_corners(resolution):
    """The C² triangles of a face (C: resolution) in the exporter's order (src/exchange/tessellation.cpp): barycentrics (b0, b1) of
    their corners, C² x 3 x 2, and the index of each one's texel, C²."""
    n, corners, texels = resolution, [], []
    for y in range(n):
        for x in range(n - y):
            corners.append([(x, y), (x + 1, y), (x, y + 1)])
            texels.append(y * n + x)
            if x + y < n - 1:
                corners.append([(x + 1, y), (x + 1, y + 1), (x, y + 1)])
                texels.append((n - 1 - y) * n + (n - 1 - x))
    return numpy.array(corners, dtype=numpy.float64) / n, numpy.array(texels)


def whole_faces(corners, colors, resolution):
    """Undoes the exporter's tessellation: turns each run of C² triangles (`corners` n x 3 x 3, `colors` n x 3) into one face
    with C² texels. Returns (corners f x 3 x 3, texels (f·C²) x 3), or None if the triangles have moved within a face."""
    per_face = resolution ** 2
    if len(corners) == 0 or len(corners) % per_face:
        return None
    barycentric, texel = atlas_corners(resolution)
    weights = barycentric.reshape(-1, 2)
    weights = numpy.concatenate([weights, 1 - weights.sum(axis=1, keepdims=True)], axis=1)
    points = corners.reshape(-1, 3 * per_face, 3)
    faces = numpy.linalg.pinv(weights) @ points
    size = numpy.abs(points - points.mean(axis=1, keepdims=True)).max(axis=(1, 2))
    reach = numpy.abs(points).max() * 1e-6  # float32
    if (numpy.abs(weights @ faces - points).max(axis=(1, 2)) > 1e-4 * size + reach).any():
        return None
    texels = numpy.empty((len(faces), per_face, 3))
    texels[:, texel] = colors.reshape(-1, per_face, 3)
    return faces, texels.reshape(-1, 3)


class SceneExport:
    """Collects meshes and light from a dependency graph; `notes` are one-line warnings. ExportError if there is nothing to draw."""

    def __init__(self, depsgraph, settings):
        self.depsgraph, self.settings = depsgraph, settings
        self.scene = depsgraph.scene_eval
        self.notes, self.sun, self.images, self.meshes = [], None, {}, []
        for instance in depsgraph.object_instances:
            thing = instance.object
            if not instance.show_self:
                continue
            if thing.type == "LIGHT":
                self.add_light(thing, instance.matrix_world)
            elif is_drawn(thing):
                self.add_surface(thing, instance.matrix_world)
        if not self.meshes:
            raise ExportError("scene: meshes: there is nothing to draw; add a mesh that is visible in renders")

    def note(self, text):
        if text not in self.notes:
            self.notes.append(text)

    def add_light(self, thing, matrix):
        light = thing.data
        if light.type != "SUN":
            self.note(f"{thing.name}: only sun lights are drawn")
        elif self.sun is not None:
            self.note(f"{thing.name}: only one sun is drawn")
        else:
            direction = matrix.to_3x3().col[2].normalized()
            self.sun = {"to_sun_velo": list(direction),
                        "sun": [light.energy * c / math.pi for c in light.color]}

    def lighting(self):
        """extras.mirage.lighting (sensors/lighting.h): scene-linear RGB radiances of a white Lambert face, and the sun's direction."""
        sun = self.sun or {"to_sun_velo": [0.0, 0.0, 1.0], "sun": [0.0, 0.0, 0.0]}
        settings = self.settings
        if settings.light == "GIVEN":
            return {**sun, "ambient": list(settings.ambient), "hemisphere": list(settings.hemisphere)}
        return {**sun, "ambient": self.world_color(), "hemisphere": [0.0, 0.0, 0.0]}

    def world_color(self):
        world = self.scene.world
        if world is None:
            return [0.0, 0.0, 0.0]
        if not world.use_nodes:
            return list(world.color)
        nodes = [n for n in world.node_tree.nodes if n.type == "BACKGROUND"]
        if not nodes or nodes[0].inputs["Color"].links or nodes[0].inputs["Strength"].links:
            self.note(f"{world.name}: only a plain colour lights the scene; the world's viewport colour is used")
            return list(world.color)
        return [nodes[0].inputs["Strength"].default_value * c for c in nodes[0].inputs["Color"].default_value[:3]]

    def add_surface(self, thing, matrix):
        mesh = thing.to_mesh()
        try:
            if mesh is None:
                return
            mesh.calc_loop_triangles()
            count = len(mesh.loop_triangles)
            if count:
                self.add_mesh(thing, mesh, count, numpy.array(matrix, dtype=numpy.float64))
        finally:
            thing.to_mesh_clear()

    def add_mesh(self, thing, mesh, count, matrix):
        def column(source, name, dtype, width, length):
            flat = numpy.empty(length * width, dtype)
            source.foreach_get(name, flat)
            return flat.reshape(length, width)

        local = column(mesh.vertices, "co", numpy.float32, 3, len(mesh.vertices)).astype(numpy.float64)
        vertices = local @ matrix[:3, :3].T + matrix[:3, 3]
        broken = int((~numpy.isfinite(vertices)).any(axis=1).sum())
        if broken:
            raise ExportError(f"{thing.name}: vertices: {broken} of {len(vertices)} are not finite; "
                              "delete them or reset the object's transform")
        faces = column(mesh.loop_triangles, "vertices", numpy.int32, 3, count)
        loops = column(mesh.loop_triangles, "loops", numpy.int32, 3, count)
        slots = column(mesh.loop_triangles, "material_index", numpy.int32, 1, count)[:, 0]
        layer = next((layer for layer in mesh.uv_layers if layer.active_render), None)
        uv = None
        if layer:
            uv = column(layer.data, "uv", numpy.float32, 2, len(mesh.loops)).astype(numpy.float64)[loops]
        texels, resolution = self.texels(thing, slots, layer and (layer.name, uv), count)
        stored = thing.original.data.get("mirage_resolution", 1) if thing.original.data else 1
        if resolution == 1 and stored > 1:
            whole = whole_faces(vertices[faces], texels, stored)
            if whole:
                corners, texels = whole
                vertices, resolution = corners.reshape(-1, 3), stored
                faces = numpy.arange(len(vertices), dtype=numpy.int32).reshape(-1, 3)
        if numpy.linalg.det(matrix[:3, :3]) < 0:  # mirrored: reverse the winding, and the texels with it
            faces, texels = faces[:, [1, 0, 2]], swapped(texels, resolution)
        self.meshes.append((thing.name, vertices, faces, texels, resolution))

    def texels(self, thing, slots, layer, count):
        """(scene-linear colours of the triangles, (count·C²) x 3, and C). `layer`: name and coordinates (count x 3 x 2) of the UV map
        that is active in renders, or None."""
        paints = [paint_of(slot.material) for slot in thing.material_slots] or [paint_of(None)]
        slots = numpy.clip(slots, 0, len(paints) - 1)
        textured = [k for k, paint in enumerate(paints) if paint.image is not None and (slots == k).any()]
        resolution = 1
        name, uv = layer or ("", None)
        if textured and uv is None:
            self.note(f"{thing.name}: has an image but no UV map")
            textured = []
        for k in textured:
            if paints[k].uv_map not in ("", name):
                self.note(f"{thing.name}: its UV map {name}, active in renders, is used in place of {paints[k].uv_map}")
        if textured:
            seen = uv[numpy.isin(slots, textured)]
            if numpy.abs(seen - seen[:, :1]).max() > 1e-7:
                resolution = self.settings.texels
        texels = numpy.empty((count, resolution ** 2, 3))
        barycentric, texel = atlas_corners(resolution)
        centres = numpy.empty((resolution ** 2, 2))
        centres[texel] = barycentric.mean(axis=1)
        weights = numpy.concatenate([centres, 1 - centres.sum(axis=1, keepdims=True)], axis=1)
        for k, paint in enumerate(paints):
            mine = slots == k
            if not mine.any():
                continue
            for note in paint.notes:
                self.note(note)
            pixels = self.pixels(paint.image) if k in textured else None
            if pixels is None:
                texels[mine] = paint.color
                continue
            at = numpy.einsum("tk,fkd->ftd", weights, uv[mine])
            texels[mine] = look_up(pixels, at.reshape(-1, 2), paint.extension).reshape(-1, resolution ** 2, 3)
        return texels.reshape(-1, 3), resolution

    def pixels(self, image):
        if image.name not in self.images:
            self.images[image.name] = linear_pixels(image)
            if self.images[image.name] is None:
                self.note(f"{image.name}: the image cannot be read; the material's viewport colour is used")
        return self.images[image.name]

    def photograph(self, view):
        """The bytes of the camera's background image. ExportError unless it is a PNG or JPEG of the render's size."""
        images = [b.image for b in view.data.background_images if b.image is not None]
        if not images:
            raise ExportError(f"{view.name}: background image: there is none; add one or set Background to Film")
        image, size = images[0], camera.resolution(self.scene)
        if tuple(image.size) != size:
            raise ExportError(f"{image.name}: size: {image.size[0]}x{image.size[1]} in a render of "
                              f"{size[0]}x{size[1]}; set the resolution to the picture's")
        path = bpy.path.abspath(image.filepath)
        data = b""
        if image.packed_file:
            data = bytes(image.packed_file.data)
        elif path and os.path.isfile(path):
            with open(path, "rb") as file:
                data = file.read()
        if data[:4] != b"\x89PNG" and data[:2] != b"\xff\xd8":
            raise ExportError(f"{image.name}: file: is not a PNG or JPEG; save the picture as one")
        return data

    def write(self, path, with_photograph=False):
        view = self.scene.camera
        info = camera.intrinsics(self.scene, view)
        writer = GlbWriter(self.scene.name)
        # One texture resolution that all others divide keeps every colour exact.
        for name, vertices, faces, texels, resolution in self.meshes:
            writer.add_mesh(name, vertices, faces, texels, resolution)
        writer.set_info(camera=info, lighting=self.lighting())
        if with_photograph:
            writer.add_photograph(self.photograph(view))
        writer.write(path)


def swapped(texels, resolution):
    """The texels of faces after their first two corners are swapped: (ix, iy) becomes (iy, ix)."""
    square = texels.reshape(-1, resolution, resolution, 3)
    return square.transpose(0, 2, 1, 3).reshape(-1, 3)
