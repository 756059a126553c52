"""Packs the built package into a wheel: python3 pack_wheel.py build/release/python OUT (Debian package python3-wheel).

The wheel has Mirage's own plugins, weights and shipped files; its libraries are those of the machine that built it.
"""

import glob
import importlib
import os
import sys
import sysconfig
import zipfile

from wheel.wheelfile import WheelFile

CONTENT = ("*.py", "*.pyi", "py.typed", "*.so", "plugins/*.so", "plugins/*.json", "plugins/weights/*.weights", "scenes/rigs/*.toml",
           "scenes/lidars/*.toml", "scenes/shapes/*.shape")
METADATA = """Metadata-Version: 2.1
Name: mirage
Version: {version}
Summary: Differentiable camera and LiDAR simulation for attacks on detectors, on a CPU
Requires-Python: >=3.9
Requires-Dist: numpy
Provides-Extra: torch
Requires-Dist: torch; extra == "torch"
"""
WHEEL = """Wheel-Version: 1.0
Generator: mirage
Root-Is-Purelib: false
Tag: {tag}
"""


def main():
    built, out = sys.argv[1:3]
    sys.path.insert(0, built)
    version = importlib.import_module("mirage").__version__
    python = f"cp{sys.version_info.major}{sys.version_info.minor}"
    tag = f"{python}-{python}-{sysconfig.get_platform().replace('-', '_').replace('.', '_')}"
    os.makedirs(out, exist_ok=True)
    for old in glob.glob(os.path.join(out, "mirage-*.whl")):
        os.remove(old)
    file = os.path.join(out, f"mirage-{version}-{tag}.whl")
    with WheelFile(file, "w", zipfile.ZIP_STORED) as wheel:
        for pattern in CONTENT:
            for path in sorted(glob.glob(os.path.join(built, "mirage", pattern))):
                wheel.write(path, os.path.relpath(path, built))
        notice = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "..", "NOTICE")  # of the weights
        wheel.write(notice, f"mirage-{version}.dist-info/NOTICE")
        wheel.writestr(f"mirage-{version}.dist-info/METADATA", METADATA.format(version=version))
        wheel.writestr(f"mirage-{version}.dist-info/WHEEL", WHEEL.format(tag=tag))
    print(file)


if __name__ == "__main__":
    main()
