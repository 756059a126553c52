"""The engine's render properties, and the sidebar of the 3-D view."""

import bpy

from .operators import DIFFERENCE, ImportMirageScene, ValidateMatchedLight

EXCLUDED = {"RENDER_PT_simplify", "RENDER_PT_gpencil", "RENDER_PT_freestyle"}


def draw_figures(layout, scene):
    layout.operator(ValidateMatchedLight.bl_idname, icon="CHECKMARK")
    figures = scene.get("mirage_validation")
    if not figures:
        layout.label(text="Not validated yet")
        return
    column = layout.column(align=True)
    for name, value in (("Mask IoU", f"{figures['mask_iou']:.6f}"),
                        ("Mean colour error", f"{figures['mae']:.2e}"),
                        ("Worst colour error", f"{figures['max_error']:.2e}"),
                        ("Pixels", str(figures["mask_either"])),
                        ("Mirage, s", f"{figures['seconds']['mirage']:.3f}"),
                        ("Cycles, s", f"{figures['seconds']['cycles']:.3f}")):
        row = column.split(factor=0.6)
        row.label(text=name)
        row.label(text=value)
    for note in figures.get("notes", "").splitlines():  # neither renderer drew this as Blender would
        column.label(text=note, icon="ERROR")
    if DIFFERENCE in bpy.data.images:
        column.label(text=f"Image \"{DIFFERENCE}\": |Δ| × {scene.get('mirage_difference_gain', 1):.3g}")


def draw_engine(layout, settings):
    layout.prop(settings, "renderer")
    if settings.renderer == "SOFT":
        layout.prop(settings, "sigma")
        layout.prop(settings, "gamma")
    else:
        layout.prop(settings, "seed")
    layout.prop(settings, "samples")
    layout.prop(settings, "texels")
    layout.prop(settings, "background")
    layout.prop(settings, "light")
    if settings.light == "GIVEN":
        layout.prop(settings, "ambient")
        layout.prop(settings, "hemisphere")


class RenderPanel(bpy.types.Panel):
    bl_idname = "RENDER_PT_mirage"
    bl_label = "Mirage"
    bl_space_type, bl_region_type, bl_context = "PROPERTIES", "WINDOW", "render"
    COMPAT_ENGINES = {"MIRAGE"}

    @classmethod
    def poll(cls, context):
        return context.engine in cls.COMPAT_ENGINES

    def draw(self, context):
        self.layout.use_property_split = True
        draw_engine(self.layout, context.scene.mirage)


class ValidationPanel(bpy.types.Panel):
    bl_idname = "RENDER_PT_mirage_validation"
    bl_label = "Mirage validation"
    bl_space_type, bl_region_type, bl_context = "PROPERTIES", "WINDOW", "render"

    def draw(self, context):
        draw_figures(self.layout, context.scene)


class SidebarPanel(bpy.types.Panel):
    bl_idname = "VIEW3D_PT_mirage"
    bl_label = "Mirage"
    bl_space_type, bl_region_type, bl_category = "VIEW_3D", "UI", "Mirage"

    def draw(self, context):
        layout, scene = self.layout, context.scene
        layout.operator(ImportMirageScene.bl_idname, icon="IMPORT")
        if scene.render.engine == "MIRAGE":
            box = layout.box().column()
            box.use_property_split = True
            draw_engine(box, scene.mirage)
        else:
            layout.prop(scene.render, "engine")
        draw_figures(layout.box(), scene)


CLASSES = (RenderPanel, ValidationPanel, SidebarPanel)


def shared_panels():
    """Blender's own panels that work with any engine."""
    return [panel for panel in bpy.types.Panel.__subclasses__()
            if "BLENDER_RENDER" in getattr(panel, "COMPAT_ENGINES", ()) and panel.__name__ not in EXCLUDED]


def register():
    for kind in CLASSES:
        bpy.utils.register_class(kind)
    for panel in shared_panels():
        panel.COMPAT_ENGINES.add("MIRAGE")


def unregister():
    for panel in shared_panels():
        panel.COMPAT_ENGINES.discard("MIRAGE")
    for kind in reversed(CLASSES):
        bpy.utils.unregister_class(kind)
