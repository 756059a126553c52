"""What a study finds in its folder is its own: each folder says what it was made of, and one of another make is refused."""

import functools
import hashlib
import json
import os
import pathlib
import subprocess
import sys

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "report"))
import atomic  # noqa: E402

SAYS = "made-of.json"


def content(*files):
    """Of these files together."""
    digest = hashlib.sha256()
    for file in files:
        digest.update(hashlib.sha256(pathlib.Path(file).read_bytes()).digest())
    return digest.hexdigest()[:16]


@functools.cache
def program(file):
    """A program or module of ours by content, with the plugins and weights beside it."""
    plugins = (pathlib.Path(file).parent / "plugins").resolve()
    return content(file, *(each for kind in ("*.so", "*.weights") for each in sorted(plugins.rglob(kind))))


@functools.cache
def listing(folder):
    """A data set by its files' names, sizes and times of change, none of which is read."""
    told = []
    for parent, _, names in os.walk(folder, followlinks=True):
        for name in names:
            about = os.stat(os.path.join(parent, name))
            told.append((os.path.relpath(os.path.join(parent, name), folder), about.st_size, about.st_mtime_ns))
    return hashlib.sha256(json.dumps(sorted(told)).encode()).hexdigest()[:16]


def require_same(folder, **of):
    """Begins FOLDER with what it is made of, or goes on in one that says the same. Else the program ends, with what differs."""
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / SAYS
    if not file.exists():
        if any(folder.iterdir()):
            sys.exit(f"{folder}: does not say what it was made of ({SAYS}); use another --out")
        atomic.write(str(file), json.dumps(of, indent=1) + "\n")
    before = json.loads(file.read_text())
    for name in {**before, **of}:
        if before.get(name) != of.get(name):
            sys.exit(f"{folder}: was made with another {name} ({before.get(name)}, not {of.get(name)}); use another --out")


def result(folder, mirage, arguments, threads=0, **of):
    """What a command of mirage wrote into FOLDER; it runs unless its result is there. `of`: what else it is made of."""
    require_same(folder, command=" ".join(str(a) for a in arguments), program=program(mirage), **of)
    file = folder / "result.json"
    if not file.exists():
        run([mirage, *arguments, "--threads", threads, "--quiet", "--out", folder])
    return json.loads(file.read_text())


def origin(of):
    """Which program a result of mirage is by, and when."""
    return {key: of["provenance"][key] for key in ("commit", "date") if key in of["provenance"]}


def run(arguments):
    arguments = [str(a) for a in arguments]
    if subprocess.run(arguments, stdout=subprocess.DEVNULL).returncode:
        sys.exit("failed: " + " ".join(arguments))
