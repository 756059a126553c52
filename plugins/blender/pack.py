"""Packs the add-on into one zip for every Blender: pack.py OUT.zip. Before 4.2 it is installed as an add-on (bl_info of
__init__.py), since then as an extension (blender_manifest.toml). The same files give the same bytes."""

import os
import sys
import zipfile


def main(out):
    folder = os.path.dirname(os.path.abspath(__file__))
    package = os.path.join(folder, "mirage_blender")
    os.makedirs(os.path.dirname(os.path.abspath(out)), exist_ok=True)
    temporary = out + ".tmp"
    with zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in ["LICENSE", *sorted(os.listdir(package))]:
            if name != "LICENSE" and not name.endswith((".py", ".toml")):
                continue
            with open(os.path.join(folder if name == "LICENSE" else package, name), "rb") as file:
                archive.writestr(zipfile.ZipInfo(f"mirage_blender/{name}", (2000, 1, 1, 0, 0, 0)), file.read(),
                                 zipfile.ZIP_DEFLATED)
    os.replace(temporary, out)


if __name__ == "__main__":
    main(sys.argv[1])
