"""Packs the built package into a wheel: python3 pack_wheel.py build/release/python OUT [INTERPRETER] (Debian package python3-wheel).

The wheel is for this interpreter, or the one that is named. It has Mirage's own plugins, weights and shipped files; its libraries are those of the machine that built it.
"""

import glob
import importlib
import json
import os
import subprocess
import sys
import zipfile

from wheel.wheelfile import WheelFile

CONTENT = ("*.py", "*.pyi", "py.typed", "_core{suffix}", "plugins/*.so", "plugins/*.json", "plugins/process/*", "plugins/weights/*", "scenes/rigs/*.toml",
           "scenes/lidars/*.toml", "scenes/shapes/*.shape")
TOLD = """import json, sys, sysconfig
print(json.dumps([sys.version_info[:2], sysconfig.get_platform(), sysconfig.get_config_var("EXT_SUFFIX")]))"""
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
    interpreter = sys.argv[3] if len(sys.argv) > 3 else sys.executable
    python, platform, suffix = json.loads(subprocess.check_output([interpreter, "-c", TOLD]))
    sys.path.insert(0, built)
    version = importlib.import_module("mirage").__version__
    tag = "cp{0}{1}-cp{0}{1}-".format(*python) + platform.replace("-", "_").replace(".", "_")
    os.makedirs(out, exist_ok=True)
    for old in glob.glob(os.path.join(out, f"mirage-*-{tag}.whl")):
        os.remove(old)
    file = os.path.join(out, f"mirage-{version}-{tag}.whl")
    with WheelFile(file, "w", zipfile.ZIP_STORED) as wheel:
        for pattern in CONTENT:
            for path in sorted(glob.glob(os.path.join(built, "mirage", pattern.format(suffix=suffix)))):
                wheel.write(path, os.path.relpath(path, built))
        notice = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "..", "NOTICE")  # of the weights
        wheel.write(notice, f"mirage-{version}.dist-info/NOTICE")
        wheel.writestr(f"mirage-{version}.dist-info/METADATA", METADATA.format(version=version))
        wheel.writestr(f"mirage-{version}.dist-info/WHEEL", WHEEL.format(tag=tag))
    print(file)


if __name__ == "__main__":
    main()
