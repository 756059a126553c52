"""Inside Blender's window: -P window_session.py -- FOLDER SCENE.glb OUT.png. Timers carry it from step to step,
so that Blender draws in between; prints "session: done" at the end."""

import os
import sys
import traceback

import bpy

FOLDER, SCENE, OUT = sys.argv[sys.argv.index("--") + 1:][:3]
STATE = {"ticks": 0}


def area(kind):
    return next(a for a in bpy.context.window_manager.windows[0].screen.areas if a.type == kind)


def override(of):
    window = bpy.context.window_manager.windows[0]
    region = next(r for r in of.regions if r.type == "WINDOW")
    return bpy.context.temp_override(window=window, screen=window.screen, area=of, region=region)


def set_up():
    bpy.context.preferences.view.show_splash = False
    bpy.ops.preferences.addon_install(filepath=os.path.join(FOLDER, "mirage_blender.zip"), overwrite=True)
    bpy.ops.preferences.addon_enable(module="mirage_blender")
    for thing in list(bpy.data.objects):
        bpy.data.objects.remove(thing)
    bpy.ops.import_scene.mirage(filepath=SCENE)
    scene = bpy.context.scene
    scene.render.engine = "MIRAGE"
    bpy.context.preferences.view.render_display_type = "NONE"
    with override(area("DOPESHEET_EDITOR")):
        bpy.ops.screen.area_split(direction="VERTICAL", factor=0.5)
    for each in [a for a in bpy.context.window_manager.windows[0].screen.areas if a.type == "DOPESHEET_EDITOR"]:
        each.type = "IMAGE_EDITOR"
    space = area("VIEW_3D").spaces.active
    space.shading.type = "MATERIAL"
    space.region_3d.view_perspective = "CAMERA"
    space.overlay.show_floor = space.overlay.show_axis_x = space.overlay.show_axis_y = False
    space.show_region_ui = True
    area("PROPERTIES").spaces.active.context = "RENDER"
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
        bpy.ops.mirage.validate("INVOKE_DEFAULT")
    return wait_for_validation


def wait_for_validation():
    return arrange if "mirage_validation" in bpy.context.scene else wait_for_validation


def arrange():
    editors = [a for a in bpy.context.window_manager.windows[0].screen.areas if a.type == "IMAGE_EDITOR"]
    editors.sort(key=lambda a: a.x)
    for each, name in zip(editors, ("Render Result", "Mirage difference")):
        each.spaces.active.image = bpy.data.images[name]
        with override(each):
            bpy.ops.image.view_all(fit_view=True)
    sidebar = next(r for r in area("VIEW_3D").regions if r.type == "UI")
    try:
        sidebar.active_panel_category = "Mirage"
    except AttributeError:  # read-only before Blender 4: the first tab shows
        pass
    for each in bpy.context.window_manager.windows[0].screen.areas:
        each.tag_redraw()
    STATE["ticks"] = 6  # let it draw
    return settle


def settle():
    STATE["ticks"] -= 1
    return settle if STATE["ticks"] > 0 else shoot


def shoot():
    bpy.ops.screen.screenshot(filepath=OUT)
    print("session: done", flush=True)
    return None


def step():
    try:
        STATE["next"] = STATE["next"]()
    except Exception:
        traceback.print_exc()
        STATE["next"] = None
    if STATE["next"] is None:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(0)
    return 0.25


STATE["next"] = set_up
bpy.app.timers.register(step, first_interval=1.0)
