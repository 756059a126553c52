#!/usr/bin/env python3
"""What the program opens, and how much memory it takes, when it is given files that are wrong.

    tests/faults/refusals.py SOURCE BUILD [--quick] [--only WORD] [--mutations 20]

Into a small run and a data set goes one bad file after another: what the fuzzers found (tests/fuzz/regressions), what
claims to be larger than it is, what names files elsewhere, and mutations of the good file. The command that reads it
must end with one line and exit code 2 (or take it), within PICTURES times a frame's pictures of the memory that it
takes to refuse an empty file there; and, by strace, it must open nothing outside the folders that it was given, its
own and the system's. Exit code 1 if one did not, 77 without the stand-in detector, and without strace, which that half
needs.
"""
import argparse
import collections
import json
import os
import pathlib
import random
import re
import shutil
import struct
import subprocess
import sys
import tempfile
import time
import zlib

from program import HERE, Program, Wrong, cars_for_stand_in, demand, demand_one_line, fresh

PICTURES = 3
SLOWEST = 20  # s
WIDTH, HEIGHT = 1242, 375  # of the default rig
FRAME = WIDTH * HEIGHT * 4 * 4  # bytes: a colour picture and depth as floats
# Read by the loader, the C library, libraries' own settings, and a query of the machine.
SYSTEM = re.compile(r"/(usr|lib|lib64|sys|dev/shm)/|/etc/(ld\.so\.cache|localtime|nsswitch\.conf|passwd|ssl/openssl\.cnf)$|/dev/(null|urandom)$|"
                    r"/proc/(cpuinfo|filesystems|meminfo|mounts|self/cgroup|stat)$|/proc/sys/|/proc/\d+/(cgroup|maps|mountinfo|stat|status|task/\d+/comm)$")
SECRET = "nobody is to read this"


def png(width, height, rows=b"\0" * 100, texts=()):
    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    return (b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)) +
            b"".join(chunk(b"zTXt", b"a%d\0\0" % n + zlib.compress(text)) for n, text in enumerate(texts)) +
            chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b""))


def glb(document, binary=b"\0" * 44):
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    return (b"glTF" + struct.pack("<II", 2, 28 + len(text) + len(binary)) + struct.pack("<I", len(text)) + b"JSON" + text +
            struct.pack("<I", len(binary)) + b"BIN\0" + binary)


def mesh_document(uri=None, image=None, count=3):
    document = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
                "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
                "accessors": [{"bufferView": 0, "componentType": 5126, "count": count, "type": "VEC3"}],
                "bufferViews": [{"buffer": 0, "byteLength": 36}], "buffers": [{"byteLength": 44}]}
    if uri:
        document["buffers"][0]["uri"] = uri
    if image:
        document["images"] = [{"uri": image}]
        document["textures"] = [{"source": 0}]
        document["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]
        document["meshes"][0]["primitives"][0]["material"] = 0
    return document


def header_that_claims(bytes_, length):
    """A weights file whose header has so many bytes, by its own word."""
    return struct.pack("<Q", length) + bytes_[8:]


def tensors_of_nothing(count):
    """A weights file with so many tensors in its header, and none behind it."""
    header = b"{" + b",".join(b'"%d":{"dtype":"F32","shape":[1],"data_offsets":[0,4]}' % i for i in range(count)) + b"}"
    return struct.pack("<Q", len(header)) + header


class Refusals:
    def __init__(self, program, arguments):
        self.program, self.only, self.mutations, self.quick = program, arguments.only, arguments.mutations, arguments.quick
        self.folder, self.out = program.folder, program.folder / "out"
        self.secret = self.folder / "elsewhere/secret.bin"
        self.secret.parent.mkdir()
        self.secret.write_text(SECRET)
        self.trace = shutil.which("strace")
        self.cases, self.refused, self.opened, self.outside = 0, 0, 0, 0
        self.traced = set()
        self.usual = set()  # opened by the command with the good file, too
        self.worst = collections.defaultdict(float)
        self.wrong = []

    def measured(self, command):
        """Exit code, what it said and its peak of memory, bytes."""
        fresh(self.out)
        with tempfile.TemporaryFile() as said:
            process = subprocess.Popen([str(part) for part in (self.program.mirage, *command)],
                                       env=self.program.environment, cwd=self.folder, stdout=subprocess.DEVNULL,
                                       stderr=said, start_new_session=True)
            deadline = time.monotonic() + 15 * SLOWEST  # of a machine that does other things
            while True:
                pid, status, usage = os.wait4(process.pid, os.WNOHANG)
                if pid:
                    break
                if time.monotonic() > deadline:
                    process.kill()
                    process.wait()
                    raise Wrong(f"has not ended after {15 * SLOWEST} s")
                time.sleep(0.005)
            demand(usage.ru_utime + usage.ru_stime < SLOWEST, f"takes more than {SLOWEST} s of processor time")
            process.returncode = os.waitstatus_to_exitcode(status)
            said.seek(0)
            return process.returncode, said.read().decode(errors="replace"), 1024 * usage.ru_maxrss

    def strangers(self, command, given):
        """The paths that it opened, and those of them outside the given folders."""
        fresh(self.out)
        log = self.folder / "strace.log"
        subprocess.run([self.trace, "-f", "-qq", "-y", "-e", "trace=open,openat,openat2,creat", "-s", "4096", "-o", log,
                        self.program.mirage, *map(str, command)], env=self.program.environment, cwd=self.folder,
                       stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, timeout=120)
        allowed = [str(path.resolve()) for path in (*given, self.out, self.program.build, self.program.source)]
        opened, strange = 0, []
        for line in log.read_text(errors="replace").splitlines():
            found = re.search(r" = \d+<(.*)>$", line)  # where the descriptor leads, links followed
            if not found:
                continue
            opened += 1
            path = found.group(1)
            if not SYSTEM.match(path) and not any(path == a or path.startswith(a + "/") for a in allowed):
                strange.append(path)
        return opened, strange

    def try_one(self, kind, name, place, bytes_, command, given, floor):
        if isinstance(bytes_, int):  # a hole
            place.unlink(missing_ok=True)
            with open(place, "wb") as file:
                file.truncate(bytes_)
        else:
            place.write_bytes(bytes_)
        self.cases += 1
        try:
            code, said, peak = self.measured(command)
            if code:
                demand_one_line(code, said, (2,))
                demand(SECRET not in said, f"quotes a file elsewhere: {said.strip()!r}")
                self.refused += 1
                more = (peak - floor) / FRAME
                self.worst[kind] = max(self.worst[kind], more)
                demand(peak - floor <= PICTURES * FRAME,
                       f"takes {more:.1f} frames' pictures of memory more than an empty file")
            # Files that name others, and one of each other kind: strace takes three times what the program does.
            if self.trace and (not self.quick or kind in ("gltf", "run") or kind not in self.traced):
                self.traced.add(kind)
                opened, strange = self.strangers(command, given)
                strange = [path for path in strange if path not in self.usual]
                demand(opened > 0, "strace saw nothing opened")
                self.opened += opened
                self.outside += len(strange)
                demand(not strange, f"opens {', '.join(strange)}")
        except Wrong as problem:
            self.wrong.append(f"{kind}, {name}: {problem}")
            print(f"WRONG: {self.wrong[-1]}", flush=True)

    def kind(self, kind, place, command, given, bad, taken=True, empty=b""):
        """Every bad file in the place of a good one; `bad`: (name, bytes), `empty`: refused at once."""
        if self.only and self.only not in kind:
            return
        good = place.read_bytes() if place.exists() else None
        self.usual = set()
        if taken and good is not None:
            code, said, _ = self.measured(command)
            demand(code == 0, f"{kind}: the good file is refused: {said.strip()!r}")
            # A page's Python reads settings of the machine, whatever file it was given.
            self.usual = set(self.strangers(command, given)[1]) if self.trace and not self.quick else set()
            demand(str(self.secret) not in self.usual, f"{kind}: the good file leads elsewhere")
        place.write_bytes(empty)
        code, said, floor = self.measured(command)
        demand(code == 2, f"{kind}: an empty file is not refused: {said.strip()!r}")
        for name, bytes_ in (*bad, ("50 GB of zeros", 50 << 30)):
            self.try_one(kind, name, place, bytes_, command, given, floor)
        if good is None:
            place.unlink()
            return
        dice = random.Random(f"19 {kind}")
        for number in range(self.mutations):
            changed = bytearray(good)
            for _ in range(dice.randint(1, 4)):
                at = dice.randrange(len(changed))
                choice = dice.randrange(3)
                if choice == 0:
                    changed[at] ^= 1 << dice.randrange(8)
                elif choice == 1:
                    changed[at:at + 1] = dice.choice([b"", b"-", b"1e999", b"\xff", b"\0", b"[" * 300, b"9" * 40])
                else:
                    changed[at:at + dice.randint(1, 64)] = b""
                changed = changed or bytearray(b"0")
            self.try_one(kind, f"mutation {number + 1}", place, bytes(changed), command, given, floor)
        place.write_bytes(good)


def found(source, parser):
    return [(f.name, f.read_bytes()) for f in sorted((source / "tests/fuzz/regressions" / parser).glob("*"))]


def everything(suite, source, build):
    folder, out, program = suite.folder, suite.out, suite.program
    data, run, given = folder / "data", folder / "run", folder / "given"
    given.mkdir()
    detector, weights = build / "test_plugins/fake_works.so", given / "none.weights"
    weights.write_bytes(b"the stand-in reads none")
    common = ["--threads", "1", "--quiet", "--out"]
    by = ["--detector", detector, "--weights", weights]
    attack = ["attack", "--data", data, *by, "--rooftop", "box", "--batch", "2", "--min-view", "0", *common, run,
              "--iterations"]
    program.demand_done(["generate", "--frames", "1", "--seed", "5", *common, data])
    cars_for_stand_in(data, "500 170 720 360")
    program.demand_done([*attack, "2"])
    mesh = given / "mesh.glb"
    mesh.write_bytes((run / "adversary.glb").read_bytes())
    away = [str(suite.secret), "../elsewhere/secret.bin", "..%2felsewhere%2Fsecret.bin", f"file://{suite.secret}",
            "/dev/zero", "/proc/self/environ"]
    simulate = ["simulate", "--data", data, "--frame", "000000", "--mesh", mesh, "--rooftop", "box", *common, out]

    frame = {"calibration": "calib/000000.txt", "labels": "label_2/000000.txt", "sweep": "velodyne/000000.bin",
             "lighting": "lighting/000000.json", "png": "image_2/000000.png"}
    huge = {"png": [("65000 by 65000", png(65000, 65000)), ("a thousand million rows", png(1, 10**9)),
                    ("9 KB that claim 200 MB", png(8192, 8192, b"\0" * 9_000_000)),
                    ("100 texts of 8 MB", png(WIDTH, HEIGHT, texts=[b"x" * 7900000] * 100)),
                    ("texts as long as are taken", png(WIDTH, HEIGHT, texts=[b"x" * 4000000])),
                    ("a bomb of its own size", png(WIDTH, HEIGHT, b"\0" * (3 * WIDTH + 1) * HEIGHT * 8))],
            "labels": [("a line of 1 MB", b"Car " * 250000), ("a million lines", b"Car\n" * 10**6),
                       ("16 MB, wrong at their end", b"DontCare -1 -1 -10 1 1 2 2 -1 -1 -1 -1000 -1000 -1000 -10\n" * 285000 + b"Car\n")],
            "calibration": [("a line of 1 MB", b"P2: " + b"1 " * 500000)],
            "lighting": [("20 000 lists", b"[" * 20000), ("1 MB of lists", b"[[]," * 250000)],
            "sweep": [("15 bytes", b"\0" * 15), ("not finite", b"\xff" * 1600), ("not finite, 200 MB", b"\xff" * 200_000_000),
                      ("not finite after 200 MB", b"\0" * 200_000_000 + b"\xff" * 16), ("200 MB and 15 bytes", b"\0" * 200_000_015)]}
    below = [("a hole of 200 MB", 200_000_000)]  # of what its reader takes by its size
    for kind, name in frame.items():
        suite.kind(kind, data / "training" / name, simulate, (data, given), [*found(source, kind), *huge[kind]])
    suite.kind("gltf", mesh, simulate, (data, given),
               [*found(source, "gltf"), ("a thousand million vertices", glb(mesh_document(count=10**9))),
                *((f"buffer {uri}", glb(mesh_document(uri))) for uri in away),
                *((f"picture {uri}", glb(mesh_document(image=uri))) for uri in away),
                ("1 MB of lists", glb({"extras": [[]] * 300000})), *below,
                ("wrong before 200 MB", glb({**mesh_document(), "nodes": 0}, b"\0" * 200_000_000)), ("20 MB of JSON", glb({"extras": "x" * 20_000_000})),
                ("a buffer many times", glb({**mesh_document(), "buffers": [{"byteLength": 44}] + [
                    {"byteLength": 1 << 28, "uri": "none.weights"}] * 8}))])
    shape = given / "cars.shape"
    shape.write_bytes(next((source / "scenes/shapes").glob("*.shape")).read_bytes())
    by_shape = [str(shape) if part == "box" else part for part in simulate]
    suite.kind("shape", shape, by_shape, (data, given),
               [*found(source, "shape"), *below, ("a hole behind it", shape.read_bytes() + b"\0" * 200_000_000),
                ("2 MB of lists", b"MIRAGE-SHAPE 1\n[" + b"[]," * 600_000 + b"[]]\n"), ("200 MB of lists", b"MIRAGE-SHAPE 1\n[" + b"[]," * 66_000_000)])
    vehicles = given / "vehicles"
    vehicles.mkdir()
    fit = ["fit", "--build-model", given / "made.shape", "--meshes", vehicles, "--each", "0", *common, out]

    def ply(vertices, faces, body):
        return (f"ply\nformat ascii 1.0\nelement vertex {vertices}\nproperty float x\nproperty float y\nproperty float z\n"
                f"element face {faces}\nproperty list uchar int vertex_indices\nend_header\n{body}").encode()
    suite.kind("ply", vehicles / "a.ply", fit, (given,),
               [("three vertices in one", ply(3, 1, "0 0 0\n")), ("10^8 vertices", ply(10**8, 10**8, "0 0 0\n")),
                ("a face without corners", ply(3, 1, "0 0 0\n1 0 0\n0 1 0\n0\n0 0\n")),
                ("200 000 elements", b"ply\nformat ascii 1.0\n" + b"element e 0\n" * 200_000 + b"end_header\n"),
                ("60 MB, wrong at their end", ply(10**7, 10**7 - 1, "0 0 0\n" * 10**7)), *below])
    suite.kind("obj", vehicles / "a.obj", fit, (given,),
               [("a face of 60 000 corners", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf" + b" 1 2 3" * 20000),
                ("60 MB of vertices, and one that is none", b"v 0 0 0\n" * 7_500_000 + b"v\n"),
                ("60 MB of faces of nothing", b"v 0 0 0\n" + b"f 1\n" * 15_000_000 + b"f 2\n"), *below])
    rig = given / "rig.toml"
    rig.write_bytes((HERE / "small-rig.toml").read_bytes())
    suite.kind("rig", rig, ["generate", "--rig", rig, "--frames", "1", *common, out], (given,),
               [*found(source, "toml"), ("a picture of 10^10", rig.read_bytes().replace(b"width = 310", b"width = 9999999999")),
                ("a step of 1e-9", rig.read_bytes().replace(b"azimuth_step = 0.5", b"azimuth_step = 1e-9")),
                ("1 MB of lists", b"a = " + b"[" * 10**6)])
    config = given / "config.toml"
    config.write_text("frames = 1\n")
    suite.kind("config", config, ["generate", "--rig", rig, "--config", config, *common, out], (given,),
               [("a plugin", f'detector = "{detector}"'.encode()), ("letters", "é = 1".encode()),
                *((f"{n} keys", b"".join(b"k%d=1\n" % i for i in range(n))) for n in (30000, 100000))],
               taken=False, empty=b"?")
    gamut = given / "print.ti3"
    gamut.write_bytes((source / "scenes/prints/fogra39.ti3").read_bytes())
    patches = b"CTI3\nNUMBER_OF_FIELDS 4\nBEGIN_DATA_FORMAT\nSAMPLE_ID XYZ_X XYZ_Y XYZ_Z\nEND_DATA_FORMAT\nNUMBER_OF_SETS %d\nBEGIN_DATA\n%sEND_DATA\n"
    suite.kind("gamut", gamut, ["attack", "--data", given / "none", "--gamut", gamut, *common, out], (given,),
               [*found(source, "gamut"), ("another chart", b'CTI3\n.INCLUDE "%s"\n' % str(suite.secret).encode()),
                ("10^9 patches", patches % (10**9, b"1 2 3 4\n")), ("30 000 patches, and none", patches % (30000, b"")),
                ("a line of 1 MB", b"CTI3\n" + b"K" * 10**6), ("a million keywords", b"CTI3\n" + b"KEYWORD \"K\"\n" * 10**5),
                ("a profile of nothing", b"\0" * 36 + b"acsp" + b"\0" * 200), ("tags of 4 GB", b"\0" * 36 + b"acsp" + b"\0" * 88 + b"\xff" * 400)],
               taken=False, empty=b"?")
    read = ["export", "--run", run, "--data", data, "--trust-run", *common, out]
    text = json.loads((run / "run.json").read_text())

    def but(**changes):
        return json.dumps({**text, **changes}).encode()
    suite.kind("run", run / "run.json", read, (run, data, given),
               [("a path of 5000 bytes", but(rooftop="r" * 5000)), ("another data set", but(data=str(suite.secret.parent))),
                ("20 000 lists", b"[" * 20000), ("4 MB of lists", b"[" + b"[]," * 1400000),
                ("4 MB of hosts", but(test=[{"frame": "000000", "label": i} for i in range(110000)])), ("a frame elsewhere", but(test=[{"frame": "../x", "label": 0}], train=[])),
                ("a million hosts", but(test=[{"frame": "000000", "label": 0}] * 10**6)),
                ("a defence of 1 MB", but(defense="d" * 10**6)), ("a plugin that is none", but(depth=str(suite.secret) + ".so"))])
    suite.kind("checkpoint", run / "checkpoint.json", [*attack, "3"], (run, data, given), [("20 000 lists", b"[" * 20000), ("30 MB of lists", b"[" + b"[]," * 10**7),
                ("lists in the place of losses", b'{"iteration": 7000000, "losses": [' + b"[]," * 10**7 + b"[]]}"),
                ("texts", b'{"iteration": 10, "losses": [' + b'"",' * 10**7 + b"0]}"),
                ("steps without losses", b'{"iteration": 1000000000}')],
               taken=False)
    detections = given / "detections.json"
    detections.write_text('{"frames": [{"frame": "000000", "detections": []}]}')
    suite.kind("detections", detections, ["view", data, "--detections", detections, "--threads", "1", "--quiet", "--out", out / "view.html"],
               (data, given),
               [("60 MB of lists", b'{"frames": [' + b"[]," * (2 * 10**7) + b"[]]}"),
                ("60 MB of lists in a frame", b'{"frames": [{"frame": "000000", "detections": [' + b"[]," * (2 * 10**7) + b"[]]}]}"),
                ("60 MB beside the frames", b'{"a": [' + b"[]," * (2 * 10**7) + b'[]], "frames": []}')])
    fusion = build / "plugins/weights/lidar-kitti64.weights"
    if fusion.exists():
        ours = given / "some.weights"
        ours.write_bytes(fusion.read_bytes())
        detect = ["detect", "--data", data, "--detector", "lidar", "--weights", ours, *common, out]
        suite.kind("weights", ours, detect, (data, given),
                   [*found(source, "weights"), ("claims 4 GB", header_that_claims(ours.read_bytes(), 4_000_000_000)),
                    ("all of it header", header_that_claims(ours.read_bytes(), len(ours.read_bytes()) - 8)),
                    ("150 000 tensors", tensors_of_nothing(150_000)),
                    ("half of it", ours.read_bytes()[:1500000]), *below])


def main():
    reader = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    reader.add_argument("source", type=pathlib.Path)
    reader.add_argument("build", type=pathlib.Path)
    reader.add_argument("--quick", action="store_true", help="the part of make test: no mutations, less under strace")
    reader.add_argument("--only", default="", help="kinds of files whose name holds this")
    reader.add_argument("--mutations", type=int, default=20, help="of each good file")
    arguments = reader.parse_args()
    arguments.mutations = 0 if arguments.quick else arguments.mutations
    source, build = arguments.source.resolve(), arguments.build.resolve()
    if not (build / "test_plugins/fake_works.so").exists():
        print("skipped: the stand-in detector was not built")
        return 77
    start = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="mirage-refusals-") as name:
        program = Program(source, build, pathlib.Path(name).resolve())
        program.source = source
        suite = Refusals(program, arguments)
        everything(suite, source, build)
    for kind, more in suite.worst.items():
        print(f"{kind:12} at most {more:5.2f} × a frame's pictures")
    print(f"{suite.cases} files, {suite.refused} refused, {len(suite.wrong)} wrong; "
          + (f"{suite.opened} files opened, {suite.outside} of them outside" if suite.trace else
             "what is opened was not looked at: strace is missing (apt-get install strace)")
          + f"; {time.monotonic() - start:.0f} s")
    return 1 if suite.wrong or not suite.cases else 0 if suite.trace else 77


if __name__ == "__main__":
    try:
        sys.exit(main())
    except Wrong as problem:
        sys.exit(f"WRONG: {problem}")
