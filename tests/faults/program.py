"""One command on tiny inputs: how it is run, with or without a fault, and whether what it left is whole."""
import json
import os
import pathlib
import re
import shutil
import signal
import subprocess

HERE = pathlib.Path(__file__).resolve().parent
WRITES = ("write", "fsync", "rename", "open")
NO_SPACE, BAD_DISK = 28, 5
VOLATILE = ("result.json", ".log")  # times and paths are in them


class Wrong(Exception):
    """A promise of the program does not hold."""


def demand(good, said):
    if not good:
        raise Wrong(said)


class Program:
    def __init__(self, source, build, folder):
        self.source, self.build, self.folder = source, build, folder
        self.mirage = build / "mirage"
        self.injector = build / "test_plugins" / "libmirage_faults.so"
        self.environment = {**os.environ, "MIRAGE_HOME": str(source), "MIRAGE_CACHE": "off",
                            "OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}

    def start(self, command, fault=None, before=()):
        environment = dict(self.environment)
        if fault:
            environment.update({f"MIRAGE_FAULT{key}": str(value) for key, value in fault.items()})
            environment["LD_PRELOAD"] = str(self.injector)
        return subprocess.Popen([str(part) for part in (*before, self.mirage, *command)], env=environment,
                                stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, errors="replace",
                                start_new_session=True)

    def run(self, command, fault=None, before=(), timeout=120):
        process = self.start(command, fault, before)
        try:
            said = process.communicate(timeout=timeout)[1]
            return process.returncode, said
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            raise Wrong(f"hangs for more than {timeout} s") from None

    def demand_done(self, command):
        """Runs a command that must succeed, without a fault."""
        code, said = self.run(command)
        demand(code == 0, f"{command[0]} fails without a fault: {said}")

    def calls(self, command, kind, under, where={}):
        """How many calls of a kind a whole run makes on files under a folder. Wrong if there are none, as no fault can come then."""
        count = self.folder / "count"
        count.unlink(missing_ok=True)
        code, said = self.run(command, {"": kind, "_UNDER": under, "_AT": 0, "_COUNT": count, **where})
        demand(code == 0, f"fails without a fault: {said}")
        calls = int(count.read_text())
        demand(calls > 0, f"{command[0]}: no {kind} of a file under {under} was seen: injector.cpp does not wrap what makes them")
        return calls


DATE = re.compile(rb"20\d\d-\d\d-\d\dT\d\d:\d\d:\d\dZ")  # as provenance and the report write it


def contents(folder):
    return {str(f.relative_to(folder)): f.read_bytes() for f in sorted(folder.rglob("*")) if f.is_file()}


def volatile(name):
    return name.endswith(VOLATILE)


def timeless(name, bytes_):
    """A file without measured times ("seconds" and similar keys in JSON), and without the date of its making."""
    if name.endswith(".html"):
        return DATE.sub(b"", bytes_)
    if not name.endswith(".json"):
        return bytes_

    def without(value):
        if isinstance(value, dict):
            return {key: without(inner) for key, inner in value.items()
                    if "seconds" not in key and key != "date"}
        return [without(inner) for inner in value] if isinstance(value, list) else value

    return without(json.loads(bytes_))


def demand_same(out, reference):
    """Every file of the reference, bit by bit, and no other."""
    left = contents(out)
    demand(left.keys() == reference.keys(), f"files differ: {sorted(left.keys() ^ reference.keys())}")
    for name, bytes_ in reference.items():
        demand(volatile(name) or left[name] == bytes_ or timeless(name, left[name]) == timeless(name, bytes_),
               f"{name} differs")


def demand_whole(out, reference, growing=("checkpoint.json", "loss.csv")):
    """Every file under its final name is complete."""
    for name, bytes_ in contents(out).items():
        if name.startswith(".mirage-scratch/"):
            continue  # working files, which are removed at the end
        if name not in reference:
            demand(name.endswith((".tmp", ".part")) or "/." in "/" + name, f"{name} is no file of the command")
        elif name.endswith(".json"):
            try:
                json.loads(bytes_)
            except ValueError:
                raise Wrong(f"{name} is cut short") from None
        elif not volatile(name) and not name.endswith(growing):
            demand(bytes_ == reference[name], f"{name} is not what it is to be")


def demand_one_line(code, said, codes=(1,)):
    demand(code in codes, f"exit code {code} where {codes} belongs: {said.strip()!r}")
    lines = [line for line in said.splitlines() if line.strip() and not line.startswith("warning ")]
    demand(len(lines) == 1 and lines[0].startswith("mirage: "), f"{len(lines)} lines where one belongs: {said.strip()!r}")


def cars_for_stand_in(data, picture_box):
    """Labels of generated frames: one car, where the stand-in of fake_works.so finds one. The box in pixels is of the rig's camera."""
    for label in (data / "training/label_2").glob("*.txt"):
        label.write_text(f"Car 0 0 0 {picture_box} 1.5 2 4 -1 1.65 9.73 -1.5708\n")
    for tracks in (data / "training/track_2").glob("*.txt"):
        tracks.unlink()


def fresh(folder):
    shutil.rmtree(folder, ignore_errors=True)
