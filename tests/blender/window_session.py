"""Inside Blender's window: -P window_session.py -- FOLDER SCENE.glb OUT.png. Timers carry it from step to step,
so that Blender draws in between; prints "session: done" at the end, or says where it stopped and why."""

import faulthandler
import os
import sys
import time
import traceback

import bpy
import numpy

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
import install  # noqa: E402

FOLDER, SCENE, OUT = sys.argv[sys.argv.index("--") + 1:][:3]
LIMIT = 240  # s; 45 s on two busy cores without a graphics card
STARTED = time.monotonic()
DRAWN = 1.0  # s between the last change and the screenshot, at least
STATE = {}

# A hang inside Blender never comes back to the timers: this says where, and ends it.
faulthandler.dump_traceback_later(LIMIT, exit=True)
bpy.context.preferences.view.show_splash = False


def window():
    return bpy.context.window_manager.windows[0]


def area(kind):
    return next(a for a in window().screen.areas if a.type == kind)


def region(of, kind):
    return next(r for r in of.regions if r.type == kind)


def override(of):
    return bpy.context.temp_override(window=window(), screen=window().screen, area=of, region=region(of, "WINDOW"))


def set_up():
    install.install(os.path.join(FOLDER, "mirage_blender.zip"))
    for thing in list(bpy.data.objects):
        bpy.data.objects.remove(thing)
    bpy.ops.import_scene.mirage(filepath=SCENE)
    bpy.context.scene.render.engine = "MIRAGE"
    bpy.context.preferences.view.render_display_type = "NONE"
    bpy.ops.object.select_all(action="DESELECT")
    return lay_out


def lay_out():
    """The 3-D view above, two image editors below; the screen is brought up to date between two changes."""
    areas = sorted((a for a in window().screen.areas if a.type in ("VIEW_3D", "DOPESHEET_EDITOR")), key=lambda a: a.y)
    with override(areas[1]):
        bpy.ops.screen.area_split(direction="HORIZONTAL", factor=0.36)
    return split_below


def split_below():
    lower = min((a for a in window().screen.areas if a.type == "VIEW_3D"), key=lambda a: a.y)
    with override(lower):
        bpy.ops.screen.area_split(direction="VERTICAL", factor=0.5)
    return set_areas


def set_areas():
    views = sorted((a for a in window().screen.areas if a.type == "VIEW_3D"), key=lambda a: a.y)
    for each in views[:2]:
        each.type = "IMAGE_EDITOR"
    space = area("VIEW_3D").spaces.active
    # Material and rendered shading take minutes without a graphics card.
    space.shading.type, space.shading.color_type = "SOLID", "TEXTURE"
    space.region_3d.view_perspective = "CAMERA"
    space.overlay.show_floor = space.overlay.show_axis_x = space.overlay.show_axis_y = False
    space.overlay.show_extras = space.overlay.show_relationship_lines = space.overlay.show_cursor = False
    space.show_gizmo = space.show_region_toolbar = space.show_region_tool_header = False
    space.show_region_ui = True
    area("PROPERTIES").spaces.active.context = "RENDER"
    return move_to_tabs


def at_tabs():
    """A place on the strip of the sidebar's tabs, in the window."""
    sidebar = region(area("VIEW_3D"), "UI")
    return {"x": sidebar.x + sidebar.width - 8, "y": sidebar.y + sidebar.height // 2}


def move_to_tabs():
    """Blender 3.4 lets only the mouse choose a tab: the wheel with Ctrl goes through them, and ours is the last."""
    window().event_simulate("MOUSEMOVE", "NOTHING", **at_tabs())
    return choose_tab


def choose_tab():
    for _ in range(4):
        window().event_simulate("WHEELDOWNMOUSE", "PRESS", **at_tabs(), ctrl=True)
    return start_render


def start_render():
    with override(area("VIEW_3D")):
        bpy.ops.view3d.view_center_camera()
        bpy.ops.render.render("INVOKE_DEFAULT")
    return wait_for_render


def wait_for_render():
    if bpy.app.is_job_running("RENDER"):
        return wait_for_render
    with override(area("VIEW_3D")):
        if bpy.ops.mirage.validate("INVOKE_DEFAULT") != {"RUNNING_MODAL"}:
            raise RuntimeError("the validation does not start")
    return wait_for_validation


def wait_for_validation():
    return arrange if "mirage_validation" in bpy.context.scene else wait_for_validation


def zoom_in(editor):
    """Onto the surfaces, with their own size around them; the picture stands in the middle of the editor."""
    image = bpy.data.images["Mirage difference"]
    width, height = image.size
    drawn = numpy.empty(width * height * 4, numpy.float32)
    image.pixels.foreach_get(drawn)
    rows, columns = numpy.nonzero(drawn.reshape(height, width, 4)[:, :, 0] > 0)
    x, y = (columns.min() + columns.max()) / 2, (rows.min() + rows.max()) / 2  # rows count from the bottom
    half = max(numpy.ptp(rows), numpy.ptp(columns))
    frame, zoom = region(editor, "WINDOW"), editor.spaces.active.zoom[0]
    left, bottom = frame.width / 2 + (x - half - width / 2) * zoom, frame.height / 2 + (y - half - height / 2) * zoom
    bpy.ops.image.view_zoom_border(xmin=int(left), xmax=int(left + 2 * half * zoom), ymin=int(bottom),
                                   ymax=int(bottom + 2 * half * zoom), wait_for_input=False)


def arrange():
    editors = sorted((a for a in window().screen.areas if a.type == "IMAGE_EDITOR"), key=lambda a: a.x)
    for each, name in zip(editors, ("Render Result", "Mirage difference")):
        each.spaces.active.image = bpy.data.images[name]
        each.spaces.active.show_gizmo = False
        with override(each):
            bpy.ops.image.view_all(fit_view=True)
            zoom_in(each)
    for each in window().screen.areas:
        each.tag_redraw()
    STATE["shoot at"] = time.monotonic() + DRAWN
    return settle


def settle():
    return shoot if time.monotonic() > STATE["shoot at"] else settle


def screenshot():
    """The display's picture, from Xvfb's own file (X11/XWDFile.h): Blender 4's screenshot of a window without focus is black."""
    with open(os.path.join(FOLDER, "Xvfb_screen0"), "rb") as file:
        data = file.read()
    header = numpy.frombuffer(data, ">u4", 25)
    size, width, height, line, colors = (int(header[k]) for k in (0, 4, 5, 12, 19))
    rows = numpy.frombuffer(data, numpy.uint8, height * line, size + 12 * colors).reshape(height, line)
    picture = numpy.ones((height, width, 4), numpy.float32)
    picture[:, :, :3] = rows[:, :4 * width].reshape(height, width, 4)[:, :, 2::-1] / 255  # kept as blue, green, red, unused
    image = bpy.data.images.new("screen", width, height)
    image.pixels.foreach_set(picture[::-1].ravel())
    image.filepath_raw, image.file_format = OUT, "PNG"
    image.save()


def shoot():
    screenshot()
    figures = bpy.context.scene["mirage_validation"]
    print(f"session: mask IoU {figures['mask_iou']:.6f}, mean error {figures['mae']:.2e}", flush=True)
    print("session: done", flush=True)
    return None


def step():
    name = STATE["next"].__name__
    try:
        STATE["next"] = STATE["next"]()
        if STATE["next"] and STATE["next"].__name__ != name:
            print(f"session: {time.monotonic() - STARTED:.1f} s: {name}", flush=True)
    except Exception:
        print(f"session: {name} failed", flush=True)
        traceback.print_exc()
        STATE["next"] = None
    if STATE["next"] is None:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(0)
    return 0.25


STATE["next"] = set_up
bpy.app.timers.register(step, first_interval=0.5)
