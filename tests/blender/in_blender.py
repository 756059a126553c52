"""The add-on's tests inside headless Blender: -P in_blender.py -- FOLDER SOURCE. FOLDER holds scene.glb and
mirage_blender.zip; the add-on is used as installed from the zip."""

import json
import math
import os
import struct
import subprocess
import sys
import unittest

import bpy
import numpy
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Vector

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
import install  # noqa: E402

FOLDER, SOURCE = sys.argv[sys.argv.index("--") + 1:][:2]
SCENE = os.path.join(FOLDER, "scene.glb")


def path(name):
    return os.path.join(FOLDER, name)


def render(name, file_format="OPEN_EXR"):
    """Renders the scene; returns the file and the error line, if there was one."""
    scene = bpy.context.scene
    settings = scene.render.image_settings
    settings.file_format, settings.color_mode, settings.color_depth = file_format, "RGBA", "32"
    scene.render.filepath = path(name)
    error = ""
    try:
        bpy.ops.render.render(write_still=True)
    except RuntimeError as failure:
        error = str(failure)
    return path(name), error


def program(arguments, out):
    subprocess.run([os.environ["MIRAGE_BINARY"], "render", *arguments, "--out", path(out), "--quiet"], check=True,
                   stdout=subprocess.DEVNULL)
    return path(os.path.join(out, "image.exr")), path(os.path.join(out, "depth.exr"))


def pixels(file, *names):
    from mirage_blender import exr

    return exr.read_image(file, *(names or "RGBA"))


def fresh():
    """An empty scene with Mirage as its render engine."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=False)
    if install.MODULE not in bpy.context.preferences.addons:
        bpy.ops.preferences.addon_enable(module=install.MODULE)
    bpy.context.scene.render.engine = "MIRAGE"
    return bpy.context.scene


def imported():
    scene = fresh()
    bpy.ops.import_scene.mirage(filepath=SCENE)
    return scene


def extras():
    from mirage_blender.glb import Glb

    return Glb(SCENE)


def put(name, vertices, faces, at=(0, 0, 0)):
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(vertices, [], faces)
    thing = bpy.data.objects.new(name, mesh)
    thing.location = at
    bpy.context.scene.collection.objects.link(thing)
    return thing


def box(name, at, size=0.2):
    corners = [(x * size / 2, y * size / 2, z * size / 2) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    return put(name, corners, [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)], at)


def view(scene, lens=35.0):
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(camera)
    camera.data.lens = lens
    camera.rotation_euler = (math.pi / 2, 0, -math.pi / 2)  # looks along +x with z up
    scene.camera = camera
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 160, 100, 100
    bpy.context.view_layer.update()
    return camera


class A1_Install(unittest.TestCase):
    def test_zip_installs_and_enables(self):
        module = install.install(path("mirage_blender.zip"))
        import mirage_blender

        self.assertTrue(mirage_blender.__file__.startswith(FOLDER))
        self.assertIn(module, bpy.context.preferences.addons)
        bpy.ops.wm.save_userpref()
        bpy.ops.preferences.addon_disable(module=module)  # leaves nothing behind
        self.assertFalse(hasattr(bpy.types.Scene, "mirage"))
        bpy.ops.preferences.addon_enable(module=module)
        bpy.context.scene.render.engine = "MIRAGE"


class Import(unittest.TestCase):
    def test_camera_has_the_intrinsics_of_the_file(self):
        from mirage_blender import camera

        scene, info = imported(), extras().scene_info()["camera"]
        self.assertEqual((scene.render.resolution_x, scene.render.resolution_y), (info["width"], info["height"]))
        found = camera.intrinsics(scene, scene.camera)
        for key in ("fx", "fy", "cx", "cy"):
            self.assertAlmostEqual(found[key], info[key], delta=1e-4, msg=key)
        numpy.testing.assert_allclose(found["velo_from_camera"], info["velo_from_camera"], atol=1e-6)

    def test_sun_photograph_materials_and_colour_management(self):
        scene, glb = imported(), extras()
        light = glb.scene_info()["lighting"]
        sun = next(thing for thing in scene.objects if thing.type == "LIGHT")
        numpy.testing.assert_allclose(sun.matrix_world.col[2][:3], light["to_sun_velo"], atol=1e-6)
        numpy.testing.assert_allclose([sun.data.energy * c / math.pi for c in sun.data.color], light["sun"], rtol=1e-5)
        numpy.testing.assert_allclose(scene.mirage.hemisphere, light["hemisphere"], rtol=1e-6)
        behind = scene.camera.data.background_images[0].image
        self.assertEqual(tuple(behind.size), (320, 120))
        self.assertTrue(behind.packed_file)
        adversary = next(thing for thing in scene.objects if thing.get("mirage_role") == "adversary")
        nodes = adversary.material_slots[0].material.node_tree.nodes
        texture = next(node for node in nodes if node.type == "TEX_IMAGE")
        self.assertEqual(texture.interpolation, "Closest")
        exact = next(m for m in glb.json["meshes"] if m.get("extras"))["extras"]["mirage"]
        texels = glb.array(exact["texels"], "<f8", 3)
        from mirage_blender.paint import linear_pixels

        stored = linear_pixels(texture.image)[::-1].reshape(-1, 3)[:len(texels)]
        self.assertLessEqual(numpy.abs(stored - texels).max(), 1e-7)
        self.assertEqual(scene.view_settings.view_transform, "Standard")

    def test_a_file_that_is_no_scene_is_one_clear_line(self):
        fresh()
        with open(path("text.glb"), "w", encoding="utf-8") as file:
            file.write("this is not a scene, whatever its name says")
        with self.assertRaisesRegex(RuntimeError, "text.glb.*not a .glb"):
            bpy.ops.import_scene.mirage(filepath=path("text.glb"))

    def test_a_scene_that_names_other_files_or_goes_round_in_a_circle_never_reaches_the_importer(self):
        fresh()
        with open(SCENE, "rb") as file:
            data = file.read()
        length = struct.unpack_from("<I", data, 12)[0]
        for field, change in (("buffers.1..uri", lambda scene: scene["buffers"].append({"byteLength": 4, "uri": "/dev/zero"})),
                              ("two parents", lambda scene: scene["nodes"].append({"children": [0, 0]}))):
            scene = json.loads(data[20:20 + length])
            change(scene)
            text = json.dumps(scene).encode()
            text += b" " * (-len(text) % 4)
            with open(path("hostile.glb"), "wb") as file:
                rest = data[20 + length:]
                file.write(struct.pack("<4sII", b"glTF", 2, 20 + len(text) + len(rest)))
                file.write(struct.pack("<I4s", len(text), b"JSON") + text + rest)
            before = len(bpy.data.objects)
            with self.assertRaisesRegex(RuntimeError, "hostile.glb.*" + field):
                bpy.ops.import_scene.mirage(filepath=path("hostile.glb"))
            self.assertEqual(len(bpy.data.objects), before)


class Engine(unittest.TestCase):
    def test_draws_what_the_program_draws(self):
        scene = imported()
        bpy.context.view_layer.use_pass_z = True
        for renderer in ("TRACED", "SOFT"):
            scene.mirage.renderer, scene.mirage.keep_scene = renderer, path("kept.glb")
            picture, error = render(f"{renderer}.exr", "OPEN_EXR_MULTILAYER")
            self.assertEqual(error, "")
            image, depth = program(["--scene", path("kept.glb"), "--renderer", renderer.lower()], "program")
            combined = pixels(picture, "Combined.R", "Combined.G", "Combined.B")
            self.assertLessEqual(numpy.abs(combined - pixels(image, *"RGB")).max(), 1e-6)
            from mirage_blender import exr

            ours, theirs = pixels(picture, "Depth.Z")[..., 0], exr.read_channels(depth)["Y"]
            self.assertGreater((theirs > 0).sum(), 300)
            numpy.testing.assert_allclose(ours[theirs > 0], theirs[theirs > 0], rtol=1e-6)
            self.assertTrue((ours[theirs == 0] > 1e9).all())
        scene.mirage.keep_scene = ""
        bpy.ops.wm.save_as_mainfile(filepath=path("saved.blend"))  # for the command line test

    def test_an_imported_scene_is_drawn_as_its_file(self):
        imported()
        picture, _ = render("imported.exr")
        image, _ = program(["--scene", SCENE], "original")  # whole faces of 5x5 texels, in double
        difference = numpy.abs(pixels(picture, *"RGB") - pixels(image, *"RGB"))
        self.assertLess(difference.mean(), 1e-5)
        self.assertGreater((difference.max(axis=2) < 1e-3).mean(), 0.999)

    def test_puts_things_at_the_right_pixels(self):
        cases = [("HORIZONTAL", 1.0, 1.3), ("VERTICAL", 1.2, 1.0), ("AUTO", 1.0, 2.0), ("AUTO", 1.0, 1.0)]
        for fit, aspect_x, aspect_y in cases:
            scene = fresh()
            camera = view(scene)
            camera.data.sensor_fit, camera.data.shift_x, camera.data.shift_y = fit, 0.13, -0.07
            scene.render.pixel_aspect_x, scene.render.pixel_aspect_y = aspect_x, aspect_y
            scene.mirage.hard = True
            at = Vector((6, 0.9, -0.4))
            box("box", at, 0.25)
            bpy.context.view_layer.update()
            where = world_to_camera_view(scene, camera, at)
            expected = (where.x * 160 - 0.5, (1 - where.y) * 100 - 0.5)
            picture, error = render("asymmetric.exr")
            self.assertEqual(error, "")
            rows, columns = numpy.nonzero(pixels(picture)[:, :, 3] > 0.5)
            self.assertGreater(len(rows), 5)
            self.assertLess(abs(columns.mean() - expected[0]), 0.5, (fit, aspect_x, aspect_y))
            self.assertLess(abs(rows.mean() - expected[1]), 0.5, (fit, aspect_x, aspect_y))

    def test_a_border_is_that_part_of_the_whole(self):
        scene = imported()
        whole = pixels(render("whole.exr")[0])
        render_ = scene.render
        render_.use_border = True
        render_.border_min_x, render_.border_max_x, render_.border_min_y, render_.border_max_y = 0.31, 0.62, 0.3, 0.9
        for crop in (True, False):
            render_.use_crop_to_border = crop
            part = pixels(render("part.exr")[0])
            u0, u1, v0, v1 = 99, 198, 12, 84
            if crop:
                self.assertEqual(part.shape[:2], (v1 - v0, u1 - u0))
            else:
                part = part[v0:v1, u0:u1]
            # The rasteriser's tiles start at the window: equal up to the last bits of float32.
            numpy.testing.assert_allclose(part, whole[v0:v1, u0:u1], rtol=0, atol=1e-6)

    def test_hidden_mirrored_and_instanced_things(self):
        scene = fresh()
        view(scene)
        scene.mirage.hard = True
        box("shown", (6, 1, 0), 0.5).scale = (-1, 1, 1)
        box("hidden", (6, -1, 0), 0.5).hide_render = True
        copies = bpy.data.collections.new("copies")
        one = box("one", (0, 0, 0), 0.4)
        scene.collection.objects.unlink(one)
        copies.objects.link(one)
        empty = bpy.data.objects.new("instance", None)
        empty.instance_type, empty.instance_collection, empty.location = "COLLECTION", copies, (6, 0, 0.8)
        scene.collection.objects.link(empty)
        scene.mirage.light, scene.mirage.ambient, scene.mirage.hemisphere = "GIVEN", (0, 0, 0), (1, 1, 1)
        alpha = pixels(render("things.exr")[0])
        covered = alpha[:, :, 3] > 0.5
        self.assertTrue(covered[:, :75].any())  # +y is left
        self.assertFalse(covered[40:, 90:].any())
        self.assertTrue(covered[:40, 75:85].any())
        # A mirrored box is lit as a box: the side towards the camera is upright, so half of the hemisphere.
        self.assertAlmostEqual(float(alpha[50, 48, 0]), 0.4, delta=1e-5)


    def test_view_layers_have_what_is_in_each(self):
        scene = fresh()
        view(scene)
        scene.render.film_transparent = True
        scene.view_layers[0].name = "Left"
        scene.view_layers.new("Right")
        for name, y in (("Left", 1), ("Right", -1)):
            collection = bpy.data.collections.new(name)
            scene.collection.children.link(collection)
            thing = box(name, (6, y, 0), 0.5)
            scene.collection.objects.unlink(thing)
            collection.objects.link(thing)
        for layer in scene.view_layers:
            for child in layer.layer_collection.children:
                child.exclude = child.name != layer.name
        picture, error = render("layers.exr", "OPEN_EXR_MULTILAYER")
        self.assertEqual(error, "")
        for name, inside in (("Left", slice(0, 75)), ("Right", slice(85, 160))):  # +y is left
            alpha = pixels(picture, f"{name}.Combined.A")[..., 0]
            self.assertGreater(alpha.max(), 0.5, name)
            self.assertAlmostEqual(float(alpha[:, inside].sum()), float(alpha.sum()), delta=1e-3, msg=name)

    def test_the_traced_camera_is_given_no_softness(self):
        from mirage_blender.engine import arguments

        settings = fresh().mirage
        settings.sigma, settings.gamma = 2, 0.5
        for renderer, soft in (("SOFT", True), ("TRACED", False)):
            settings.renderer = renderer
            line = arguments(settings, (0, 0, 8, 8), (0, 0, 0), "s.glb", "out")
            for option in ("--sigma", "--gamma"):
                self.assertEqual(option in line, soft, (renderer, option))


def material(name, kind=None, **inputs):
    """One with a shader of that kind at its output; without one, Blender's own. Returns it and the shader."""
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    tree = made.node_tree
    shader = tree.nodes["Principled BSDF"]
    if kind:
        shader = tree.nodes.new(kind)
        tree.links.new(shader.outputs[0], tree.nodes["Material Output"].inputs["Surface"])
    for socket, value in inputs.items():
        shader.inputs[socket].default_value = value
    return made, shader


def textured(name, vector=None, output="Color"):
    """A material of an image, mapped by a node of that kind. Returns it, the texture's node and the mapping's."""
    made, shader = material(name)
    tree = made.node_tree
    texture = tree.nodes.new("ShaderNodeTexImage")
    texture.image = bpy.data.images.new(name, 4, 4)
    tree.links.new(texture.outputs[output], shader.inputs["Base Color"])
    mapping = tree.nodes.new(vector) if vector else None
    if mapping:
        tree.links.new(mapping.outputs["UV"], texture.inputs["Vector"])
    return made, texture, mapping


class Notes(unittest.TestCase):
    """Features of a material that are not drawn have a note."""

    def notes(self, made, uv_maps=()):
        from mirage_blender.scene_export import SceneExport

        scene = bpy.context.scene
        thing = box("box", (6, 0, 0))
        for name in uv_maps:
            thing.data.uv_layers.new(name=name)
        thing.data.materials.append(made)
        found = SceneExport(bpy.context.evaluated_depsgraph_get(), scene.mirage).notes
        bpy.data.objects.remove(thing)
        return found

    def setUp(self):
        view(fresh())

    def test_a_plain_colour_and_a_plain_image_have_none(self):
        self.assertEqual(self.notes(material("principled")[0]), [])
        self.assertEqual(self.notes(material("diffuse", "ShaderNodeBsdfDiffuse")[0]), [])
        self.assertEqual(self.notes(textured("image")[0], ["one"]), [])
        self.assertEqual(self.notes(textured("coordinates", "ShaderNodeTexCoord")[0], ["one"]), [])

    def test_shaders_that_are_no_matt_surface(self):
        for kind in ("BsdfGlass", "Emission", "BsdfTransparent"):
            made, shader = material("shiny", "ShaderNode" + kind)
            self.assertEqual(self.notes(made),
                             [f"{made.name}: {shader.name} is drawn matt, opaque and without a light of its own"])

    def test_a_mix_is_drawn_by_its_first_shader(self):
        made, mix = material("mixed", "ShaderNodeMixShader")
        tree = made.node_tree
        tree.links.new(tree.nodes.new("ShaderNodeBsdfTransparent").outputs[0], mix.inputs[1])
        tree.links.new(tree.nodes["Principled BSDF"].outputs[0], mix.inputs[2])
        self.assertEqual(self.notes(made), [
            "mixed: only the first shader of Mix Shader is drawn",
            "mixed: Transparent BSDF is drawn matt, opaque and without a light of its own"])

    def test_alpha_transmission_and_emission_of_a_principled_shader(self):
        from mirage_blender import features

        made, _ = material("seen through", Alpha=0)
        self.assertEqual(self.notes(made), ["seen through: its alpha is ignored"])
        made, shader = material("clear")
        features.principled_input(shader, "transmission").default_value = 1
        self.assertEqual(self.notes(made), ["clear: its transmission is ignored"])
        made, shader = material("lamp", **{"Emission Strength": 2})
        features.principled_input(shader, "emission").default_value = (0, 1, 0, 1)
        self.assertEqual(self.notes(made), ["lamp: its emission is ignored"])

    def test_images_that_are_mapped_otherwise(self):
        made, _, mapping = textured("image", "ShaderNodeUVMap")
        mapping.uv_map = "one"
        self.assertEqual(self.notes(made, ["one", "two"]), [])
        mapping.uv_map = "two"
        self.assertEqual(self.notes(made, ["one", "two"]),
                         ["box: its UV map one, active in renders, is used in place of two"])
        made, texture, _ = textured("around")
        texture.projection = "BOX"
        self.assertEqual(self.notes(made, ["one"]), ["around: its texture projection is ignored"])
        made = textured("mask", output="Alpha")[0]
        self.assertEqual(self.notes(made, ["one"]), ["mask: its image gives its colours in place of its alpha"])

    def test_a_validation_tells_them(self):
        box("box", (6, 0, 0)).data.materials.append(material("glass", "ShaderNodeBsdfGlass")[0])
        self.assertEqual(bpy.ops.mirage.validate(output=path("noted.json"), timeout=200), {"FINISHED"})
        with open(path("noted.json"), encoding="utf-8") as file:
            told = json.load(file)["notes"]
        self.assertEqual(told, ["glass: Glass BSDF is drawn matt, opaque and without a light of its own"])
        self.assertEqual(bpy.context.scene["mirage_validation"]["notes"], "\n".join(told))  # of which the panel reads


class Errors(unittest.TestCase):
    def setUp(self):
        self.binary = os.environ["MIRAGE_BINARY"]

    def tearDown(self):
        os.environ["MIRAGE_BINARY"] = self.binary

    def small(self):
        scene = fresh()
        view(scene)
        return scene, box("box", (6, 0, 0))

    def expect(self, pattern):
        """Expects an error of one line, and an empty picture."""
        picture, error = render("error.exr")
        self.assertRegex(error, pattern)
        self.assertEqual(error.strip().count("\n"), 0, error)
        if os.path.exists(picture):
            self.assertFalse(pixels(picture, *"RGB").any())

    def test_a_missing_program(self):
        self.small()
        os.environ["MIRAGE_BINARY"] = "/nowhere/mirage"
        self.expect("MIRAGE_BINARY: /nowhere/mirage: is not a program; set it")

    def test_a_program_that_fails(self):
        self.small()
        os.environ["MIRAGE_BINARY"] = "/bin/false"
        self.expect("mirage: ended with 1")

    def test_vertices_that_are_not_finite(self):
        _, thing = self.small()
        thing.data.vertices[3].co.x = math.nan
        self.expect("box: vertices: 1 of 8 are not finite; ")

    def test_nothing_to_draw(self):
        _, thing = self.small()
        thing.hide_render = True
        self.expect("nothing to draw; add a mesh")

    def test_a_camera_without_perspective(self):
        scene, _ = self.small()
        scene.camera.data.type = "ORTHO"
        self.expect("camera: lens type: ortho is not supported; ")

    def test_no_camera(self):
        scene, _ = self.small()
        scene.camera = None
        _, error = render("error.exr")
        self.assertRegex(error, "(?i)camera")
        with self.assertRaisesRegex(RuntimeError, "camera: there is none; add"):
            bpy.ops.mirage.validate()

    def test_a_photograph_of_another_size(self):
        scene = imported()
        scene.render.resolution_percentage = 50
        self.expect("photograph: size: 320x120 in a render of 160x60; ")


class Validate(unittest.TestCase):
    def test_an_exported_scene(self):
        scene = imported()
        self.assertEqual(bpy.ops.mirage.validate(output=path("figures.json"), timeout=200), {"FINISHED"})
        with open(path("figures.json"), encoding="utf-8") as file:
            figures = json.load(file)
        print("imported scene:", json.dumps(figures))
        self.assertGreaterEqual(figures["mask_iou"], 0.9999)
        self.assertLessEqual(figures["mae"], 1e-4)
        self.assertGreater(figures["mask_both"], 500)
        self.assertAlmostEqual(scene["mirage_validation"]["mae"], figures["mae"])
        self.assertEqual(tuple(bpy.data.images["Mirage difference"].size), (320, 120))
        self.assertEqual(figures["notes"], [])
        self.assertEqual(scene.render.engine, "MIRAGE")  # the user's scene is as it was

    def test_a_view_of_nothing_is_no_success(self):
        scene = imported()
        scene.camera.location = (0, 0, 5000)  # above all that there is
        with self.assertRaisesRegex(RuntimeError, "sees no surface, so nothing was compared"):
            bpy.ops.mirage.validate(output=path("none.json"), timeout=200)
        self.assertFalse(os.path.exists(path("none.json")))

    def test_a_scene_made_in_blender(self):
        """Base colours, an 8-bit texture on quadrangles, smooth faces, normals of its own, a mirrored thing, a world
        colour."""
        scene = fresh()
        camera = view(scene)
        camera.location = (0.013, 0.021, 0.017)
        sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
        sun.data.energy, sun.data.color, sun.rotation_euler = 2.5, (1, 0.9, 0.7), (0.5, -0.7, 0.2)
        scene.collection.objects.link(sun)
        scene.world = bpy.data.worlds.new("world")
        scene.world.use_nodes = True
        scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.1, 0.2, 0.3, 1)
        red = bpy.data.materials.new("red")
        red.use_nodes = True
        red.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (0.8, 0.1, 0.05, 1)
        bpy.ops.mesh.primitive_uv_sphere_add(radius=0.5, location=(5, 0.8, 0.2), segments=16, ring_count=8)
        ball = bpy.context.object
        ball.data.materials.append(red)
        bpy.ops.object.shade_smooth()
        ball.scale = (1, -1.1, 0.9)
        image = bpy.data.images.new("squares", 4, 4)
        image.pixels.foreach_set(numpy.random.default_rng(1).random(64).astype(numpy.float32))
        image.pack()
        picture = bpy.data.materials.new("picture")
        picture.use_nodes = True
        texture = picture.node_tree.nodes.new("ShaderNodeTexImage")
        texture.image = image
        shader = picture.node_tree.nodes["Principled BSDF"]
        picture.node_tree.links.new(texture.outputs["Color"], shader.inputs["Base Color"])
        bpy.ops.mesh.primitive_cube_add(size=0.9, location=(5, -0.6, 0.1), rotation=(0.3, 0.2, 0.6))
        cube = bpy.context.object.data
        cube.materials.append(picture)
        cube.normals_split_custom_set([(0.6, 0, 0.8)] * len(cube.loops))  # Mirage's faces are flat all the same
        scene.mirage.texels = 8  # a multiple of the image's 4: its squares are runs of whole texels
        self.assertEqual(bpy.ops.mirage.validate(output=path("figures.json"), timeout=200), {"FINISHED"})
        figures = dict(scene["mirage_validation"])
        print("Blender scene:", {key: figures[key] for key in ("mask_iou", "mae", "max_error", "mask_both")})
        self.assertGreaterEqual(figures["mask_iou"], 0.9999)
        self.assertLessEqual(figures["mae"], 1e-4)


if __name__ == "__main__":
    suite = unittest.defaultTestLoader.loadTestsFromModule(sys.modules[__name__])
    outcome = unittest.TextTestRunner(verbosity=2, stream=sys.stdout).run(suite)
    sys.exit(0 if outcome.wasSuccessful() else 1)
