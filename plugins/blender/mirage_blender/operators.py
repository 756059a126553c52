"""File > Import > Mirage scene, and validation in matched light."""

import json
import os
import shutil
import subprocess
import tempfile
import time

import bpy
import numpy
from bpy.props import FloatProperty, StringProperty
from bpy_extras.io_utils import ImportHelper

from . import program

DIFFERENCE = "Mirage difference"


class ImportMirageScene(bpy.types.Operator, ImportHelper):
    """Import a scene that mirage export wrote: meshes, camera with its intrinsics, sun, sky and photograph"""

    bl_idname = "import_scene.mirage"
    bl_label = "Import Mirage scene"
    bl_options = {"UNDO"}
    filename_ext = ".glb"
    filter_glob: StringProperty(default="*.glb", options={"HIDDEN"})

    def execute(self, context):
        from . import scene_import

        if not hasattr(bpy.types, bpy.ops.import_scene.gltf.idname()):
            self.report({"ERROR"}, "glTF importer: is disabled; enable the add-on io_scene_gltf2")
            return {"CANCELLED"}
        try:
            loaded = scene_import.import_scene(context.scene, self.filepath)
        except (OSError, ValueError, KeyError, RuntimeError) as error:
            text = str(error).replace("\n", " ")
            self.report({"ERROR"}, text if self.filepath in text else f"{self.filepath}: {text}")
            return {"CANCELLED"}
        self.report({"INFO"}, scene_import.describe(loaded))
        return {"FINISHED"}


def save_copy(path):
    """Saves a copy without a thumbnail. Drawing one takes seconds, and may never end with a software OpenGL."""
    paths = bpy.context.preferences.filepaths
    kept, paths.file_preview_type = paths.file_preview_type, "NONE"
    try:
        bpy.ops.wm.save_as_mainfile(filepath=path, copy=True, check_existing=False)
    finally:
        paths.file_preview_type = kept


class Validation:
    """Validates a scene in a separate Blender, so that this one stays responsive."""

    def __init__(self, scene):
        self.scene = scene
        self.folder = tempfile.mkdtemp(prefix="mirage-validate-")
        self.log = os.path.join(self.folder, "blender.log")
        copy = os.path.join(self.folder, "scene.blend")
        save_copy(copy)
        script = os.path.join(os.path.dirname(os.path.abspath(__file__)), "matched.py")
        environment = {**os.environ, "MIRAGE_BINARY": program.find()}
        with open(self.log, "wb") as log:
            self.process = subprocess.Popen(
                [bpy.app.binary_path, "-b", "--factory-startup", copy, "--python-exit-code", "1", "-P", script,
                 "--", self.folder],
                stdin=subprocess.DEVNULL, stdout=log, stderr=log, env=environment)
        self.started = time.monotonic()

    def running(self):
        return self.process.poll() is None

    def seconds(self):
        return time.monotonic() - self.started

    def stop(self):
        if self.running():
            program.stop(self.process)

    def error(self):
        """The line of the log that gives the error."""
        with open(self.log, encoding="utf-8", errors="replace") as file:
            lines = [line.strip() for line in file if line.strip()]
        # Printed when the copy opens before the add-on is registered, and after any error in a script.
        said_anyway = ("Error: Engine 'MIRAGE' not available", "Error: Python: Traceback", "Error: script failed")
        lines = [line for line in lines if not line.startswith(said_anyway)]
        for mark in ("Error: ", "RuntimeError: "):
            found = [line for line in lines if line.startswith(mark)]
            if found:
                return found[0][len(mark):]
        return f"Blender ended with exit code {self.process.returncode}: {lines[-1] if lines else 'it printed nothing'}"

    def finish(self, output):
        """Stores the figures in the scene and the difference in an image. Copies the figures to `output` (JSON) if given. ProgramError
        if Blender failed."""
        path = os.path.join(self.folder, "result.json")
        if self.process.returncode != 0 or not os.path.exists(path):
            raise program.ProgramError(self.error())
        with open(path, encoding="utf-8") as file:
            figures = json.load(file)
        self.scene["mirage_validation"] = {**figures, "notes": "\n".join(figures["notes"])}  # cannot hold a list of texts
        show_difference(self.scene, numpy.load(os.path.join(self.folder, "difference.npy")))
        if output:
            shutil.copyfile(path, bpy.path.abspath(output))
        return figures

    def clean(self):
        self.stop()
        shutil.rmtree(self.folder, ignore_errors=True)


def show_difference(scene, difference):
    """Shows the difference as an image: |Δ| on the surfaces, scaled so that the worst pixel is white."""
    height, width = difference.shape[:2]
    old = bpy.data.images.get(DIFFERENCE)
    if old is not None and tuple(old.size) != (width, height):
        bpy.data.images.remove(old)
        old = None
    image = old or bpy.data.images.new(DIFFERENCE, width, height, float_buffer=True)
    image.colorspace_settings.name = "Non-Color"
    worst = float(difference[:, :, :3].max())
    gain = 1 / worst if worst > 0 else 1.0
    pixels = numpy.ones((height, width, 4), numpy.float32)
    pixels[:, :, :3] = difference[:, :, :3] * gain + 0.02 * difference[:, :, 3:]
    image.pixels.foreach_set(pixels[::-1].ravel())
    image.update()
    scene["mirage_difference_gain"] = gain
    for window in getattr(bpy.context.window_manager, "windows", ()):
        for area in window.screen.areas:
            if area.type == "IMAGE_EDITOR":
                area.spaces.active.image = image
                area.tag_redraw()


class ValidateMatchedLight(bpy.types.Operator):
    """Render the camera's view with Mirage's hard rasteriser and with Cycles under the same light, and compare"""

    bl_idname = "mirage.validate"
    bl_label = "Validate in matched light"
    timeout: FloatProperty(name="Timeout (s)", default=600, min=1)
    output: StringProperty(name="Figures", subtype="FILE_PATH", default="", description="JSON file for the figures; empty: none")

    run = timer = None

    def begin(self, context):
        try:
            if context.scene.camera is None:
                raise program.ProgramError("scene: camera: there is none; add a camera and make it the scene's")
            self.run = Validation(context.scene)
        except (program.ProgramError, OSError, RuntimeError) as error:
            self.report({"ERROR"}, str(error).replace("\n", " "))
            return False
        return True

    def end(self, context):
        """Collects the result once Blender has ended, and reports it."""
        try:
            figures = self.run.finish(self.output)
        except (program.ProgramError, OSError, ValueError) as error:
            self.report({"ERROR"}, str(error).replace("\n", " "))
            return {"CANCELLED"}
        finally:
            self.run.clean()
        for note in figures["notes"]:
            self.report({"WARNING"}, note)
        self.report({"INFO"}, f"mask IoU {figures['mask_iou']:.6f}, mean error {figures['mae']:.2e}, "
                              f"worst {figures['max_error']:.2e}")
        return {"FINISHED"}

    def too_long(self):
        if self.run.running() and self.run.seconds() > self.timeout:
            self.report({"ERROR"}, f"validation: no result after {self.timeout:g} s; lower the resolution")
            self.run.clean()
            return True
        return False

    def execute(self, context):
        """Runs to the end, for scripts and the command line."""
        if not self.begin(context):
            return {"CANCELLED"}
        while self.run.running():
            if self.too_long():
                return {"CANCELLED"}
            time.sleep(program.POLL)
        return self.end(context)

    def invoke(self, context, event):
        """Runs from the panel: Blender stays responsive, and Escape stops it."""
        if not self.begin(context):
            return {"CANCELLED"}
        self.timer = context.window_manager.event_timer_add(0.25, window=context.window)
        context.window_manager.modal_handler_add(self)
        context.workspace.status_text_set("Mirage validation is running: press Escape to stop it")
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        if event.type == "ESC":
            self.run.clean()
            return self.leave(context, {"CANCELLED"})
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        if self.too_long():
            return self.leave(context, {"CANCELLED"})
        if self.run.running():
            return {"PASS_THROUGH"}
        return self.leave(context, self.end(context))

    def leave(self, context, outcome):
        context.window_manager.event_timer_remove(self.timer)
        context.workspace.status_text_set(None)
        for area in context.screen.areas:
            area.tag_redraw()
        return outcome


def import_menu(self, context):
    self.layout.operator(ImportMirageScene.bl_idname, text="Mirage scene (.glb)")


CLASSES = (ImportMirageScene, ValidateMatchedLight)


def register():
    for kind in CLASSES:
        bpy.utils.register_class(kind)
    bpy.types.TOPBAR_MT_file_import.append(import_menu)


def unregister():
    bpy.types.TOPBAR_MT_file_import.remove(import_menu)
    for kind in reversed(CLASSES):
        bpy.utils.unregister_class(kind)
