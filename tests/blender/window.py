"""Opens Blender's window under Xvfb with an imported scene, a Mirage render, the panel and the difference image,
and takes a screenshot. As a program: window.py SOURCE BUILD SCENE.glb OUT.png makes the picture of src/guide/export.md."""

import os
import shutil
import struct
import subprocess
import sys
import tempfile
import zlib

HERE = os.path.dirname(os.path.abspath(__file__))
SIZE = (1440, 900)
COLORS = 200  # a window that drew nothing has a handful


def start_display(env, folder):
    """Xvfb on a free display, what it shows in folder/Xvfb_screen0; returns the process and the display's name, or None and why."""
    read_end, write_end = os.pipe()
    server = subprocess.Popen(["Xvfb", "-displayfd", str(write_end), "-screen", "0", f"{SIZE[0]}x{SIZE[1]}x24", "-fbdir", folder,
                               "+extension", "GLX", "-nolisten", "tcp"], env=env, pass_fds=[write_end], stdin=subprocess.DEVNULL,
                              stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    os.close(write_end)
    with os.fdopen(read_end) as answer:
        number = answer.readline().strip()
    if not number:
        server.wait(10)
        return None, "Xvfb does not start"
    return server, f":{number}"


def distinct_colors(path):
    """(width, height, distinct colours) of an 8-bit PNG without interlacing."""
    with open(path, "rb") as file:
        data = file.read()
    assert data[:8] == b"\x89PNG\r\n\x1a\n", path
    at, packed = 8, b""
    while at < len(data):
        length, kind = struct.unpack_from(">I4s", data, at)
        body = data[at + 8:at + 8 + length]
        if kind == b"IHDR":
            width, height, depth, color = struct.unpack_from(">IIBB", body)
        elif kind == b"IDAT":
            packed += body
        at += 12 + length
    assert depth == 8 and color in (2, 6), (depth, color)
    import numpy

    step = 3 if color == 2 else 4
    rows = numpy.frombuffer(zlib.decompress(packed), numpy.uint8).reshape(height, 1 + width * step).astype(int)
    image = numpy.zeros((height, width * step), int)
    for y in range(height):  # undo the filters: none, left, up, mean, Paeth
        kind, line = rows[y, 0], rows[y, 1:]
        above = image[y - 1] if y else numpy.zeros(width * step, int)
        if kind == 0:
            image[y] = line
        elif kind == 2:
            image[y] = (line + above) % 256
        elif kind == 1:
            image[y] = numpy.cumsum(line.reshape(width, step), axis=0).reshape(-1) % 256
        else:
            out = image[y]
            for x in range(width * step):
                left = out[x - step] if x >= step else 0
                corner = above[x - step] if x >= step else 0
                if kind == 3:
                    guess = (left + above[x]) // 2
                else:
                    p = left + above[x] - corner
                    near = [abs(p - left), abs(p - above[x]), abs(p - corner)]
                    guess = (left, above[x], corner)[near.index(min(near))]
                out[x] = (line[x] + guess) % 256
    return width, height, len(numpy.unique(image.reshape(-1, step)[:, :3], axis=0))


def picture(blender, source, folder, env, scene, out):
    """Runs the session; returns an empty string, or what went wrong."""
    server, display = start_display(env, folder)
    if server is None:
        return display
    log = os.path.join(folder, "window.log")
    try:
        with open(log, "wb") as file:
            subprocess.run([blender, "--factory-startup", "--enable-event-simulate", "--no-window-focus",
                            "--window-geometry", "0", "0", str(SIZE[0]), str(SIZE[1]),
                            "-P", os.path.join(HERE, "window_session.py"), "--", folder, scene, out],
                           env={**env, "DISPLAY": display, "LIBGL_ALWAYS_SOFTWARE": "1"}, stdin=subprocess.DEVNULL,
                           stdout=file, stderr=subprocess.STDOUT, timeout=300)
    except subprocess.TimeoutExpired:
        return "Blender's window did not come to an end"
    finally:
        server.terminate()
        server.wait(10)
    with open(log, encoding="utf-8", errors="replace") as file:
        said = file.read()
    if "session: done" not in said:
        return "the session broke off:\n" + said[-4000:]
    return ""


def run(blender, source, build, folder, env):
    out = os.path.join(folder, "window.png")
    problem = picture(blender, source, folder, env, os.path.join(folder, "scene.glb"), out)
    if problem:
        print(problem)
        return 1
    width, height, colors = distinct_colors(out)
    print(f"screenshot: {width}x{height}, {colors} distinct colours")
    return 0 if (width, height) == SIZE and colors > COLORS else 1


def main(source, build, scene, out):
    import run as tests

    folder = tempfile.mkdtemp(prefix="mirage-addon-")
    for name in ("config", "scripts"):
        os.makedirs(os.path.join(folder, name))
    subprocess.run([sys.executable, os.path.join(source, "plugins", "blender", "pack.py"),
                    os.path.join(folder, "mirage_blender.zip")], check=True)
    problem = picture(shutil.which("blender"), source, folder, tests.environment(folder, os.path.abspath(build)),
                      os.path.abspath(scene), os.path.abspath(out))
    print(problem or out)
    shutil.rmtree(folder, ignore_errors=True)
    return 1 if problem else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:5]))
