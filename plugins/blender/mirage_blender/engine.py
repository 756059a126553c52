"""The render engine "Mirage": exports what Blender shows, runs `mirage render` and reads the picture back."""

import json
import os
import shutil
import tempfile

import bpy
import numpy

from . import camera, exr, program
from .scene_export import ExportError, SceneExport

NOTHING_HIT = 1e10  # Blender's depth where there is no surface
HARD = {"sigma": 1e-18, "gamma": 1e-6, "samples": 1}  # σ as kHardSigma of sensors/raster/limits.h
LAST = {}  # result.json of the latest render in this process, its light, and the export's notes


def arguments(settings, window, color, scene, out):
    """The arguments of `mirage render` for one render. window: u0, v0, u1, v1 in pixels; color: scene-linear RGB behind the meshes."""
    exact = HARD if settings.hard else {"sigma": 1e-6 * settings.sigma, "gamma": settings.gamma,
                                        "samples": settings.samples}
    line = ["render", "--scene", scene, "--renderer", settings.renderer.lower(), "--out", out, "--quiet",
            "--parts", "all", "--seed", str(settings.seed), "--samples", str(exact["samples"]),
            "--window", ",".join(map(str, window))]
    if settings.renderer == "SOFT":
        line += ["--sigma", f"{exact['sigma']:.9g}"]
        if exact["gamma"] > 0:
            line += ["--gamma", f"{exact['gamma']:.9g}"]
    if settings.background == "PHOTOGRAPH" and not settings.hard:
        return line + ["--background", "photograph"]
    return line + ["--background", "plain", "--color", ",".join(f"{c:.9g}" for c in color)]


def fill(target, pixels):
    """Copies height x width x channels, row 0 on top, into a render pass, which has the bottom row first."""
    rows = numpy.ascontiguousarray(pixels[::-1]).reshape(-1, pixels.shape[2])
    try:
        target.rect.foreach_set(rows)  # Blender 3: a row a pixel
    except (TypeError, ValueError):
        target.rect.foreach_set(rows.ravel())  # Blender 4: all numbers in one row


class MirageEngine(bpy.types.RenderEngine):
    bl_idname = "MIRAGE"
    bl_label = "Mirage"
    bl_use_preview = False
    bl_use_shading_nodes_custom = False
    bl_use_eevee_viewport = True

    def render(self, depsgraph):
        scene = depsgraph.scene
        u0, v0, u1, v1 = window = camera.border(scene)
        shape = (max(v1 - v0, 1), max(u1 - u0, 1))
        color, depth = numpy.zeros((*shape, 4), numpy.float32), numpy.full(shape, NOTHING_HIT, numpy.float32)
        folder = tempfile.mkdtemp(prefix="mirage-")
        try:
            drawn = self.picture(depsgraph, window, folder)
            if drawn:
                color, depth = drawn
        except (ExportError, camera.CameraError, program.ProgramError, ValueError, OSError) as error:
            self.report({"ERROR"}, str(error).replace("\n", " "))
        finally:
            shutil.rmtree(folder, ignore_errors=True)
        # After an error too: Blender crashes when it writes an EXR without a result.
        self.hand_over(depsgraph.view_layer.name, color, depth)

    def picture(self, depsgraph, window, folder):
        """(color: height x width x 4, depth: height x width, m), row 0 on top; None when cancelled."""
        scene = depsgraph.scene
        settings = scene.mirage
        self.update_stats("", "Mirage: exporting")
        export = SceneExport(depsgraph, settings)
        path, photograph = os.path.join(folder, "scene.glb"), settings.background == "PHOTOGRAPH"
        export.write(path, photograph and not settings.hard)
        if settings.keep_scene:
            shutil.copyfile(path, bpy.path.abspath(settings.keep_scene))
        for note in export.notes:
            self.report({"WARNING"}, note)
        see_through = scene.render.film_transparent or settings.hard
        behind = [0.0, 0.0, 0.0] if see_through else export.world_color()
        self.update_stats("", "Mirage: drawing")
        if not program.run(arguments(settings, window, behind, path, folder), folder, self.test_break):
            return None
        with open(os.path.join(folder, "result.json"), encoding="utf-8") as file:
            LAST.clear()
            LAST.update(json.load(file), lighting=export.lighting(), notes=export.notes)
        color = exr.read_image(os.path.join(folder, "image.exr"), "R", "G", "B", "A")
        if not see_through or photograph and not settings.hard:
            color[:, :, 3] = 1
        depth = next(iter(exr.read_channels(os.path.join(folder, "depth.exr")).values()))
        return color, numpy.where(depth > 0, depth, numpy.float32(NOTHING_HIT))

    def hand_over(self, view_layer, color, depth):
        height, width = depth.shape
        result = self.begin_result(0, 0, width, height, layer=view_layer)  # otherwise all view layers
        if not result:
            return
        try:
            passes = result.layers[0].passes
            for name, pixels in (("Combined", color), ("Depth", depth[:, :, None])):
                target = passes.get(name)
                if target is not None:
                    fill(target, pixels)
        except (TypeError, ValueError) as error:
            self.report({"ERROR"}, f"render result: {error}; use Blender 3.4 to 4.3")
        finally:
            self.end_result(result)

    def update_render_passes(self, scene=None, renderlayer=None):
        self.register_pass(scene, renderlayer, "Combined", 4, "RGBA", "COLOR")
        if renderlayer and renderlayer.use_pass_z:
            self.register_pass(scene, renderlayer, "Depth", 1, "Z", "VALUE")
