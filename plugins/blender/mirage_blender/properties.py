"""scene.mirage, and the add-on's preferences."""

import bpy
from bpy.props import (BoolProperty, EnumProperty, FloatProperty, FloatVectorProperty, IntProperty,
                       StringProperty)


class MirageSettings(bpy.types.PropertyGroup):
    renderer: EnumProperty(name="Renderer", default="SOFT", items=[
        ("SOFT", "Soft rasteriser", "Differentiable rasteriser: Lambert faces under ambient light and one sun"),
        ("TRACED", "Ray-traced camera", "Adds the sun's shadows and the sky's occlusion")])
    sigma: FloatProperty(
        name="Sigma (1e-6)", default=0.5, min=1e-6, max=1e5, soft_max=100, precision=4,
        description="Softness of edges, σ, in 1e-6 NDC² of the longer image side; 2.6 is one pixel of 1242")
    gamma: FloatProperty(
        name="Gamma", default=0, min=0, max=1e3, soft_max=0.1, precision=6,
        description="Softness of depth order, γ, as a share of the scene's depth range; 0: 3 cm")
    samples: IntProperty(name="Samples", default=2, min=1, max=32, description="Samples along each side of a pixel")
    hard: BoolProperty(name="Hard limit", default=False, options={"HIDDEN"},
                       description="What the validation compares: σ and γ near 0, pixel centres, no background")
    seed: IntProperty(name="Seed", default=0, min=0, description="Seed of the ray-traced camera's noise")
    texels: IntProperty(name="Texels", default=10, min=1, max=64,
                        description="Texels along each edge of a triangle that carries an image")
    background: EnumProperty(name="Background", default="FILM", items=[
        ("FILM", "Film", "The world's colour, or transparent with Film > Transparent"),
        ("PHOTOGRAPH", "Photograph", "The camera's background image")])
    light: EnumProperty(name="Ambient light", default="WORLD", items=[
        ("WORLD", "World", "The world's plain colour"),
        ("GIVEN", "Given", "The two colours below")])
    ambient: FloatVectorProperty(name="Ambient", subtype="COLOR", size=3, min=0, soft_max=1, default=(0.1, 0.1, 0.11),
                                 description="Light that is the same from all directions")
    hemisphere: FloatVectorProperty(name="Hemisphere", subtype="COLOR", size=3, min=0, soft_max=1,
                                    default=(0.2, 0.22, 0.26), description="Light that is stronger from above: (1 + n·up) / 2")
    keep_scene: StringProperty(name="Keep scene", subtype="FILE_PATH", default="",
                               description="File for a copy of the exported .glb; empty: no copy")


class MiragePreferences(bpy.types.AddonPreferences):
    bl_idname = __package__
    binary: StringProperty(name="mirage program", subtype="FILE_PATH", default="",
                           description="Path of the mirage program; empty: MIRAGE_BINARY, or mirage on PATH")

    def draw(self, context):
        self.layout.prop(self, "binary")


CLASSES = (MirageSettings, MiragePreferences)


def register():
    for kind in CLASSES:
        bpy.utils.register_class(kind)
    bpy.types.Scene.mirage = bpy.props.PointerProperty(type=MirageSettings)


def unregister():
    del bpy.types.Scene.mirage
    for kind in reversed(CLASSES):
        bpy.utils.unregister_class(kind)
