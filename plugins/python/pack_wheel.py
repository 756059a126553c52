"""Packs the built package into two wheels: python3 pack_wheel.py BUILT OUT [INTERPRETER] [--carry]   (Debian: python3-wheel)

mirage: for this interpreter, or the one that is named. Its libraries are those of the machine that built it; with --carry they are
in the wheel, by auditwheel's rules (Debian: patchelf): all but those that every Linux has (PEP 600), under names of their own, found
beside it (168 MB for 12; some of Debian's are under the GPL, so that wheel is for machines of your own). Of its plugins those that
take LibTorch stay out then: a detector of the user's own needs none.
mirage_weights: the weights of its detectors, for every interpreter.
"""

import argparse
import glob
import hashlib
import importlib
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import zipfile

from wheel.wheelfile import WheelFile

SOURCE = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "..")
CODE = ("*.py", "*.pyi", "py.typed", "_core{suffix}", "plugins/process/*", "report/*.js", "mirage.commit")
# Files of the project that commands read at run time, as src/packaging/install.cmake installs them.
SHIPPED = re.compile(r"(scenes/.*\.(toml|shape|glb|ti3)|scenes/objects/zoo\.json|plugins/blender/mirage_blender/.*\.py|"
                     r"validation/(?!benchmarks|studies).*\.(py|toml|j2|html|css|js))")
PLUGINS = ("plugins/*.so", "plugins/*.json")
PICTURES = ("plugins/pictures.so",)
WEIGHTS = ("plugins/weights/*",)
TOLD = """import json, sys, sysconfig
print(json.dumps([sys.version_info[:2], sysconfig.get_platform(), sysconfig.get_config_var("EXT_SUFFIX")]))"""
METADATA = """Metadata-Version: 2.1
Name: {name}
Version: {version}
Summary: {summary}
Requires-Python: >=3.9
{requires}"""
WHEEL = """Wheel-Version: 1.0
Generator: mirage
Root-Is-Purelib: {pure}
Tag: {tag}
"""
# From the policies manylinux_2_*: on every Linux, so not carried. X libraries are carried all the same: a server lacks them.
EVERYWHERE = re.compile(r"(ld-linux.*|lib(c|m|dl|rt|pthread|util|resolv|nsl|anl|mvec|gcc_s|stdc\+\+|z|expat|GL|gobject-2\.0|gthread-2\.0|"
                        r"glib-2\.0))\.so\.\d+")


def resolved(file):
    """{name: path} of all libraries that the loader resolves for a file."""
    told = subprocess.run(["ldd", file], check=True, capture_output=True, text=True).stdout
    found = dict(re.findall(r"^\s*(\S+) => (/\S+)", told, re.M))
    missing = re.findall(r"^\s*(\S+) => not found", told, re.M)
    if missing:
        raise SystemExit(f"{file}: needs {', '.join(missing)}, which this machine lacks")
    return found


def needed(file):
    return subprocess.run(["patchelf", "--print-needed", file], check=True, capture_output=True, text=True).stdout.split()


def carry(modules, folder):
    """Copies modules {path in the wheel: file}, and what they need, into the folder as they lie in the wheel: {path in the wheel: file}."""
    if shutil.which("patchelf") is None:
        raise SystemExit("--carry: patchelf is missing; apt-get install patchelf")
    libraries = {name: path for module in modules.values() for name, path in resolved(module).items() if not EVERYWHERE.fullmatch(name)}
    names = {}
    for name, path in libraries.items():
        with open(path, "rb") as file:
            stem, dot, rest = name.partition(".so")
            names[name] = f"{stem}-{hashlib.sha256(file.read()).hexdigest()[:8]}{dot}{rest}"
    packed = {}
    for place, source in {**modules, **{"mirage.libs/" + names[name]: path for name, path in libraries.items()}}.items():
        file = os.path.join(folder, os.path.basename(place))
        shutil.copyfile(source, file)
        origin = os.path.normpath(os.path.join("$ORIGIN", os.path.relpath("mirage.libs", os.path.dirname(place))))
        changes = [["--set-rpath", origin, "--force-rpath"]]  # one call each: in one call some are lost
        if place not in modules:
            changes.append(["--set-soname", os.path.basename(place)])
        changes.append([word for name in needed(file) if name in names for word in ("--replace-needed", name, names[name])])
        for change in filter(None, changes):
            subprocess.run(["patchelf", *change, file], check=True)
        packed[place] = file
    return packed


def shipped():
    """{path in the wheel: file}"""
    found = {}
    for top in ("scenes", "validation", "plugins/blender"):
        for folder, _, names in os.walk(os.path.join(SOURCE, top)):
            for path in (os.path.join(folder, name) for name in names):
                place = os.path.relpath(path, SOURCE)
                if SHIPPED.fullmatch(place):
                    found["mirage/" + place] = path
    return found


def write(out, name, version, tag, files, summary, requires=""):
    for old in glob.glob(os.path.join(out, f"{name}-*-{tag}.whl")):
        os.remove(old)
    path = os.path.join(out, f"{name}-{version}-{tag}.whl")
    about = f"{name}-{version}.dist-info"
    with WheelFile(path, "w", zipfile.ZIP_DEFLATED) as wheel:
        for place, file in sorted(files.items()):
            wheel.write(file, place)
        wheel.write(os.path.join(SOURCE, "NOTICE"), about + "/NOTICE")
        wheel.writestr(about + "/METADATA", METADATA.format(name=name, version=version, summary=summary, requires=requires))
        wheel.writestr(about + "/WHEEL", WHEEL.format(tag=tag, pure=str(tag.endswith("any")).lower()))
    print(f"{path} ({os.path.getsize(path) / 1e6:.0f} MB)")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("built"), parser.add_argument("out"), parser.add_argument("interpreter", nargs="?", default=sys.executable)
    parser.add_argument("--carry", action="store_true")
    asked = parser.parse_args()
    python, platform, suffix = json.loads(subprocess.check_output([asked.interpreter, "-c", TOLD]))
    sys.path.insert(0, asked.built)
    version = importlib.import_module("mirage").__version__
    os.makedirs(asked.out, exist_ok=True)

    def files(patterns):
        found = [path for pattern in patterns
                 for path in glob.glob(os.path.join(asked.built, "mirage", pattern.format(suffix=suffix))) if os.path.isfile(path)]
        return {os.path.relpath(path, asked.built): path for path in found}

    with tempfile.TemporaryDirectory() as folder:
        code = {**files(CODE), **shipped()}
        module = f"mirage/_core{suffix}"
        if module not in code:
            raise SystemExit(f"{asked.interpreter}: the module was not built for it; make python PYTHON={asked.interpreter}")
        if asked.carry:
            carried = {module: code[module], **files(PICTURES)}
            code.update(carry(carried, folder))
            glibc = subprocess.check_output(["getconf", "GNU_LIBC_VERSION"], text=True).split()[1]
            platform = f"manylinux_{glibc}_" + platform.split("-", 1)[1]
        else:
            code.update(files(PLUGINS))
        tag = "cp{0}{1}-cp{0}{1}-".format(*python) + platform.replace("-", "_").replace(".", "_")
        write(asked.out, "mirage", version, tag, code, "Differentiable camera and LiDAR simulation for attacks on detectors, on a CPU",
              'Requires-Dist: numpy\nProvides-Extra: torch\nRequires-Dist: torch; extra == "torch"\n')
    write(asked.out, "mirage_weights", version, "py3-none-any", files(WEIGHTS), "Weights of Mirage's own detectors",
          f"Requires-Dist: mirage=={version}\n")


if __name__ == "__main__":
    main()
