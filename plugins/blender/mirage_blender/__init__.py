# SPDX-License-Identifier: GPL-3.0-or-later
"""Mirage in Blender: a render engine, the import of Mirage scenes, and validation in matched light."""

bl_info = {
    "name": "Mirage",
    "author": "Mirage",
    "version": (0, 1, 0),
    "blender": (3, 4, 0),
    "location": "Render properties > Render Engine; File > Import > Mirage scene; 3D View > Sidebar > Mirage",
    "description": "Render engine with a soft rasteriser and a ray-traced camera; import and validation of Mirage scenes",
    "category": "Render",
}


def modules():
    # Imported late: validation/blender/blender_worker.py uses parts of the package without the add-on.
    from . import engine, operators, panels, properties

    return properties, operators, panels, engine


def register():
    import bpy

    properties, operators, panels, engine = modules()
    properties.register()
    operators.register()
    bpy.utils.register_class(engine.MirageEngine)
    panels.register()


def unregister():
    import bpy

    properties, operators, panels, engine = modules()
    panels.unregister()
    bpy.utils.unregister_class(engine.MirageEngine)
    operators.unregister()
    properties.unregister()
