"""Runs in a separate Blender, on a copy of the scene:

    blender -b --factory-startup COPY.blend --python-exit-code 1 -P matched.py -- OUT

Renders the view with Mirage's engine at its hard limit and with Cycles under the same light (Lambert faces, one sun without
shadows, ambient and hemisphere terms, pixel centres), and compares both. Writes OUT/result.json and OUT/difference.npy
(height x width x 4 float32, row 0 on top: |Mirage − Cycles| as scene-linear RGB, and 1 where either sees a surface)."""

import json
import os
import sys
import time


def compare(mirage, cycles):
    """(figures over the union of both masks, difference as in OUT/difference.npy) of two premultiplied scene-linear RGBA pictures."""
    import numpy

    in_mirage, in_cycles = mirage[:, :, 3] > 0.5, cycles[:, :, 3] > 0.5
    either, both = in_mirage | in_cycles, in_mirage & in_cycles
    difference = numpy.abs(mirage[:, :, :3].astype(numpy.float64) - cycles[:, :, :3])
    inside = difference[either]
    figures = {"mask_iou": float(both.sum() / either.sum()) if either.any() else 1.0,
               "mae": float(inside.mean()) if inside.size else 0.0,
               "max_error": float(inside.max()) if inside.size else 0.0,
               "mask_both": int(both.sum()), "mask_either": int(either.sum()),
               "pixels_off": int((inside > 1e-3).any(axis=1).sum())}
    return figures, numpy.concatenate([difference, either[:, :, None]], axis=2).astype(numpy.float32)


def timed_render(path):
    import bpy

    bpy.context.scene.render.filepath = path
    started = time.monotonic()
    bpy.ops.render.render(write_still=True)
    seconds = time.monotonic() - started
    if not os.path.exists(path):
        raise RuntimeError(f"{path}: Blender wrote no picture")
    return seconds


def drop_own_normals():
    """Removes custom normals, which would change the light on flat faces."""
    import bpy

    for thing in bpy.data.objects:
        mesh = thing.data if thing.type == "MESH" else None
        if mesh is not None and mesh.has_custom_normals and not hasattr(mesh, "use_auto_smooth"):
            with bpy.context.temp_override(object=thing, active_object=thing, mesh=mesh):
                bpy.ops.mesh.customdata_custom_splitnormals_clear()


def match_light(scene, light):
    """Makes every surface that Mirage draws Lambert under `light`, and hides everything else. The export's notes say what a
    material loses by this, because the export also uses paint_of."""
    import bpy

    from mirage_blender import cycles_light
    from mirage_blender.paint import paint_of
    from mirage_blender.scene_export import SURFACES, is_drawn

    bare = cycles_light.make_lambert(bpy.data.materials.new("bare"), paint_of(None), light)
    for material in list(bpy.data.materials):
        if material is not bare:
            cycles_light.make_lambert(material, paint_of(material), light)
    for thing in bpy.data.objects:
        if thing.type == "LIGHT" or not (is_drawn(thing) or thing.type in ("EMPTY", "CAMERA", "ARMATURE", "LATTICE")):
            thing.hide_render = True
        elif thing.type in SURFACES and not thing.material_slots and hasattr(thing.data, "materials"):
            thing.data.materials.append(bare)
    for mesh in bpy.data.meshes:  # flat faces
        mesh.polygons.foreach_set("use_smooth", [False] * len(mesh.polygons))
        if hasattr(mesh, "use_auto_smooth"):  # absent since Blender 4.1, whose meshes always use custom normals
            mesh.use_auto_smooth = False
    drop_own_normals()
    for curve in bpy.data.curves:
        for spline in getattr(curve, "splines", ()):
            spline.use_smooth = False
    sun = bpy.data.objects.new("matched sun", bpy.data.lights.new("matched sun", "SUN"))
    scene.collection.objects.link(sun)
    cycles_light.set_sun(sun, light, shadows=False)
    cycles_light.set_sky(scene, light, on=False)


def main(out):
    import bpy
    import numpy

    import mirage_blender
    from mirage_blender import cycles_light, engine, exr

    if not hasattr(bpy.types.Scene, "mirage"):
        mirage_blender.register()
    scene, layer = bpy.context.scene, bpy.context.view_layer
    render = scene.render
    render.use_border = render.use_motion_blur = render.use_freestyle = False
    render.use_single_layer = True
    scene.cycles.film_exposure = 1.0
    if scene.camera:
        scene.camera.data.dof.use_dof = False
    cycles_light.set_quality(scene, layer, pixel="centre", file_format="OPEN_EXR")
    render.engine = "MIRAGE"
    scene.mirage.hard, scene.mirage.renderer = True, "SOFT"
    pictures, seconds = {}, {}
    mirage_path, cycles_path = os.path.join(out, "mirage.exr"), os.path.join(out, "cycles.exr")
    seconds["mirage_total"] = timed_render(mirage_path)
    if not engine.LAST:
        raise RuntimeError("Mirage drew nothing")
    seconds["mirage"], faces, notes = (engine.LAST[key] for key in ("seconds", "faces", "notes"))
    match_light(scene, engine.LAST["lighting"])
    render.engine = "CYCLES"
    seconds["cycles"] = timed_render(cycles_path)
    for name, path in (("mirage", mirage_path), ("cycles", cycles_path)):
        pictures[name] = exr.read_image(path, "R", "G", "B", "A")
    figures, difference = compare(pictures["mirage"], pictures["cycles"])
    if figures["mask_either"] == 0:
        raise RuntimeError("camera: sees no surface, so nothing was compared; point it at one")
    numpy.save(os.path.join(out, "difference.npy"), difference)
    figures.update(seconds=seconds, faces=faces, width=difference.shape[1],
                   height=difference.shape[0], frame=scene.frame_current, notes=notes)
    with open(os.path.join(out, "result.json"), "w", encoding="utf-8") as file:
        json.dump(figures, file, indent=2)


if __name__ == "__main__":
    sys.dont_write_bytecode = True
    sys.path.insert(0, os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
    main(sys.argv[sys.argv.index("--") + 1])
