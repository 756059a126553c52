"""Starts Blender for the add-on's tests: run.py headless|window SOURCE BUILD. Exit code 77: skipped, with why.

Blender gets settings and scripts of its own, away from the user's."""

import os
import shutil
import subprocess
import sys
import tempfile

HERE = os.path.dirname(os.path.abspath(__file__))
SKIPPED = 77


def skip(why):
    print(f"skipped: {why}")
    sys.exit(SKIPPED)


def environment(folder, build):
    # Blender's Python finds its home through the first python3 on PATH.
    kept = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    return {**kept, "PATH": "/usr/bin:/bin", "BLENDER_USER_CONFIG": os.path.join(folder, "config"),
            "BLENDER_USER_SCRIPTS": os.path.join(folder, "scripts"), "HOME": folder,
            "MIRAGE_BINARY": os.path.join(build, "mirage")}


def blender(arguments, env, timeout=240):
    """Runs it; returns (exit code, output)."""
    done = subprocess.run([BLENDER, *arguments], env=env, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                          stderr=subprocess.STDOUT, timeout=timeout, text=True, errors="replace")
    return done.returncode, done.stdout


def headless(source, build, folder, env):
    code, said = blender(["-b", "--factory-startup", "--python-exit-code", "1", "-P",
                          os.path.join(HERE, "in_blender.py"), "--", folder, source], env)
    print(said)
    if code != 0:
        return 1
    return command_line(source, build, folder, env)


def command_line(source, build, folder, env):
    """blender -b FILE -E MIRAGE -f 1, with the add-on as the first run installed it."""
    sys.dont_write_bytecode = True
    sys.path.insert(0, os.path.join(source, "plugins", "blender"))
    import numpy
    from mirage_blender import exr

    code, said = blender(["-b", os.path.join(folder, "saved.blend"), "-E", "MIRAGE", "-o",
                          os.path.join(folder, "cli-"), "-F", "OPEN_EXR", "-x", "1", "-f", "1"], env)
    picture = os.path.join(folder, "cli-0001.exr")
    if code != 0 or not os.path.exists(picture):
        print(said, f"blender -E MIRAGE -f 1 ended with {code} and wrote no picture")
        return 1
    out = os.path.join(folder, "cli-program")
    subprocess.run([os.path.join(build, "mirage"), "render", "--scene", os.path.join(folder, "kept.glb"), "--out",
                    out, "--quiet", "--parts", "all"], check=True, stdout=subprocess.DEVNULL)
    channels = "RGB"
    difference = numpy.abs(exr.read_image(picture, *channels) -
                           exr.read_image(os.path.join(out, "image.exr"), *channels)).max()
    print(f"blender -b -E MIRAGE -f 1 against mirage render: largest difference {difference:.2g}")
    return 0 if difference <= 1e-6 else 1


def window(source, build, folder, env):
    if not shutil.which("Xvfb"):
        skip("Xvfb is not installed (package xvfb)")
    sys.path.insert(0, HERE)
    import window as session

    return session.run(BLENDER, source, build, folder, env)


def main():
    global BLENDER
    suite, source, build = sys.argv[1:4]
    BLENDER = shutil.which("blender")
    if not BLENDER:
        skip("blender is not installed")
    folder = tempfile.mkdtemp(prefix="mirage-addon-")
    try:
        for name in ("config", "scripts"):
            os.makedirs(os.path.join(folder, name))
        env = environment(folder, build)
        subprocess.run([os.path.join(build, "make_addon_scene"), os.path.join(folder, "scene.glb")], check=True)
        subprocess.run([sys.executable, os.path.join(source, "plugins", "blender", "pack.py"),
                        os.path.join(folder, "mirage_blender.zip")], check=True)
        return {"headless": headless, "window": window}[suite](source, build, folder, env)
    finally:
        if os.environ.get("MIRAGE_KEEP"):
            print("kept:", folder)
        else:
            shutil.rmtree(folder, ignore_errors=True)


if __name__ == "__main__":
    sys.exit(main())
