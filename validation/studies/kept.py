"""Guards the results in a study's folder: the folder records its inputs, and another study's is refused."""

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
    """A hash of these files together."""
    digest = hashlib.sha256()
    for file in files:
        digest.update(hashlib.sha256(pathlib.Path(file).read_bytes()).digest())
    return digest.hexdigest()[:16]


@functools.cache
def program(file):
    """A hash of a program or module of ours, with the plugins and weights beside it."""
    plugins = (pathlib.Path(file).parent / "plugins").resolve()
    return content(file, *(each for kind in ("*.so", "*.weights") for each in sorted(plugins.rglob(kind))))


@functools.cache
def listing(folder):
    """A hash of a data set by its files' names, sizes and modification times; reads no file."""
    told = []
    for parent, _, names in os.walk(folder, followlinks=True):
        for name in names:
            about = os.stat(os.path.join(parent, name))
            told.append((os.path.relpath(os.path.join(parent, name), folder), about.st_size, about.st_mtime_ns))
    return hashlib.sha256(json.dumps(sorted(told)).encode()).hexdigest()[:16]


def require_same(folder, **of):
    """Records the inputs in FOLDER, or resumes if they are equal. Otherwise the program ends, and names the difference."""
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
    """The result of a command of mirage in FOLDER; runs it unless the result exists. `of`: its further inputs."""
    require_same(folder, command=" ".join(str(a) for a in arguments), program=program(mirage), **of)
    file = folder / "result.json"
    if not file.exists():
        run([mirage, *arguments, "--threads", threads, "--quiet", "--out", folder])
    return json.loads(file.read_text())


def origin(of):
    """The program and date of a result of mirage."""
    return {key: of["provenance"][key] for key in ("commit", "date") if key in of["provenance"]}


def run(arguments):
    arguments = [str(a) for a in arguments]
    if subprocess.run(arguments, stdout=subprocess.DEVNULL).returncode:
        sys.exit("failed: " + " ".join(arguments))
