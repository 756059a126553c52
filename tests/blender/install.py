"""Installs the packed add-on into the running Blender."""

import importlib
import sys

import bpy

EXTENSIONS = "package_install_files" in dir(bpy.ops.extensions)  # Blender 4.2
MODULE = "bl_ext.user_default.mirage_blender" if EXTENSIONS else "mirage_blender"


def install(zipped):
    """As an extension where Blender has them, else as an add-on; enabled, and imported as `mirage_blender` in both."""
    if EXTENSIONS:
        bpy.ops.extensions.package_install_files(filepath=zipped, repo="user_default", enable_on_install=True)
    else:
        bpy.ops.preferences.addon_install(filepath=zipped, overwrite=True)
        bpy.ops.preferences.addon_enable(module=MODULE)
    sys.modules["mirage_blender"] = importlib.import_module(MODULE)
    return MODULE
