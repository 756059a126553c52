#!/usr/bin/env python3
"""Commands on a disk that fails, killed at any moment, on ranks that die and with a Blender that is none.

    tests/faults/run.py SOURCE BUILD [--quick] [--only WORD] [--kills 100]

Every command is run once whole. Then again and again into a fresh folder, with one fault: it must end with one line
and exit code 1 (2 where an input was not read), leave nothing under its final name that is not finished, and when
the same command is given again, end with the same bits. Exit code 1 if one did not, 77 without the stand-in
detector or Blender.
"""
import argparse
import os
import pathlib
import random
import signal
import subprocess
import sys
import tempfile
import time

from blenders import blender_cases, validate_cases
from program import (BAD_DISK, HERE, NO_SPACE, WRITES, Program, Wrong, cars_for_stand_in, contents, demand, demand_one_line, demand_same,
                     demand_whole, fresh)


class Suite:
    def __init__(self, program, quick, only):
        self.program, self.quick, self.only = program, quick, only
        self.done, self.wrong = {}, []
        self.left_out = ""  # parts that this machine cannot run
        self.process = ""  # the only one that the faults are in; empty: each process, by itself
        self.out = program.folder / "out"

    def case(self, group, name, work):
        if self.only and self.only not in f"{group} {name}":
            return
        self.done[group] = self.done.get(group, 0) + 1
        try:
            work()
        except Wrong as problem:
            self.wrong.append(f"{group}, {name}: {problem}")
            print(f"WRONG: {self.wrong[-1]}", flush=True)

    def where(self):
        return {"_IN": self.process} if self.process else {}

    def title(self, command):
        return f"{command[0]} ({self.process})" if self.process not in ("", "mirage") else command[0]

    def pick(self, count):
        """Which of 1 … count calls fail: all, or the first, one between and the last."""
        if not self.quick or count <= 3:
            return range(1, count + 1)
        return 1, 1 + count // 2, count

    def reference(self, command):
        fresh(self.out)
        code, said = self.program.run(command)
        demand(code == 0, f"{command[0]} fails without a fault: {said}")
        return contents(self.out)

    def again(self, command, reference):
        code, said = self.program.run(command)
        demand(code == 0, f"given again, it fails: {said.strip()}")
        demand_same(self.out, reference)

    def writing(self, command, reference, errors=((NO_SPACE, 0), (NO_SPACE, 1), (BAD_DISK, 0))):
        """Every write, fsync, rename and opening of a file that it makes fails once, or from then on."""
        errors = errors[:1] if self.quick else errors
        for kind in WRITES:
            fresh(self.out)
            calls = self.program.calls(command, kind, self.out, self.where())
            for at in self.pick(calls):
                for error, lasting in errors:
                    self.case(f"{self.title(command)}: {kind}", f"call {at} of {calls}, errno {error}",
                              lambda: self.write_fails(command, reference, kind, at, error, lasting))

    def write_fails(self, command, reference, kind, at, error, lasting):
        fresh(self.out)
        fault = {"": kind, "_UNDER": self.out, "_AT": at, "_ERROR": error, "_LASTING": lasting,
                 **self.where()}
        code, said = self.program.run(command, fault)
        if code == 0:  # nothing of the result: a note in a lock's file, say
            return demand_same(self.out, reference)
        demand_whole(self.out, reference)
        demand_one_line(code, said)
        self.again(command, reference)

    def reading(self, command, reference, under):
        """Every read of its input fails once; or gives half, which is no error."""
        for kind in ("read", "short"):
            fresh(self.out)
            calls = self.program.calls(command, kind, under, self.where())
            for at in self.pick(calls):
                self.case(f"{self.title(command)}: {kind}", f"{under.name}, call {at} of {calls}",
                          lambda: self.read_fails(command, reference, kind, at, under))

    def read_fails(self, command, reference, kind, at, under):
        fresh(self.out)
        code, said = self.program.run(command, {"": kind, "_UNDER": under, "_AT": at, "_ERROR": BAD_DISK,
                                               **self.where()})
        if code == 0:  # right for half a read; an error may be met by reading again
            return demand_same(self.out, reference)
        demand(kind == "read", f"half a read ends it: {said.strip()!r}")
        demand_one_line(code, said, (1, 2))
        self.again(command, reference)

    def kills_at_writes(self, command, reference):
        for kind in ("write", "rename"):
            fresh(self.out)
            calls = self.program.calls(command, kind, self.out, self.where())
            for at in self.pick(calls):
                self.case(f"{self.title(command)}: killed at a {kind}", f"call {at} of {calls}",
                          lambda: self.killed_at(command, reference, kind, at))

    def killed_at(self, command, reference, kind, at):
        fresh(self.out)
        code, _ = self.program.run(command, {"": kind, "_UNDER": self.out, "_AT": at, "_ERROR": "kill",
                                               **self.where()})
        demand(code == -signal.SIGKILL, f"was not killed but ended with {code}")
        demand_whole(self.out, reference)
        self.again(command, reference)

    def kills_at_any_time(self, command, reference, count, before=()):
        start = time.monotonic()
        fresh(self.out)
        self.program.run(command, before=before)
        whole = time.monotonic() - start
        moments = random.Random(19)
        for number in range(count):
            moment = moments.uniform(0.05, 1) * whole
            self.case(f"{command[0]}{' on ranks' if before else ''}: killed", f"{number + 1}, after {moment:.2f} s",
                      lambda: self.killed_after(command, reference, moment, before))

    def killed_after(self, command, reference, seconds, before):
        fresh(self.out)
        process = self.program.start(command, before=before)
        try:
            process.communicate(timeout=seconds)
        except subprocess.TimeoutExpired:
            victim = newest_child(process.pid) if before else process.pid
            try:
                os.kill(victim, signal.SIGKILL)
            except ProcessLookupError:
                pass  # it had ended
            process.communicate(timeout=120)
        if self.out.exists():
            demand_whole(self.out, reference)
        self.again(command, reference)


def newest_child(parent):
    """The last rank that mpirun started; mpirun itself where there is none yet."""
    said = subprocess.run(["ps", "-o", "pid=", "--ppid", str(parent)], capture_output=True, text=True).stdout.split()
    return int(said[-1]) if said else parent


def main():
    reader = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    reader.add_argument("source", type=pathlib.Path)
    reader.add_argument("build", type=pathlib.Path)
    reader.add_argument("--quick", action="store_true", help="the part of make test")
    reader.add_argument("--only", default="", help="cases whose name holds this")
    reader.add_argument("--kills", type=int, default=100)
    arguments = reader.parse_args()
    source, build = arguments.source.resolve(), arguments.build.resolve()
    detector = build / "test_plugins" / "fake_works.so"
    if not detector.exists():
        print("skipped: the stand-in detector was not built")
        return 77
    start = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="mirage-faults-") as name:
        folder = pathlib.Path(name)
        suite = Suite(Program(source, build, folder), arguments.quick, arguments.only)
        everything(suite, folder, detector, arguments.kills)
    for group, count in suite.done.items():
        wrong = sum(line.startswith(group + ",") for line in suite.wrong)
        print(f"{group:36} {count - wrong:4} of {count}")
    print(f"{time.monotonic() - start:.0f} s")
    if suite.wrong or not suite.done:
        return 1
    if suite.left_out:
        print(f"skipped: {suite.left_out}")
        return 77
    return 0


def everything(suite, folder, detector, kills):
    program, out, quick = suite.program, suite.out, suite.quick
    data, run, weights = folder / "data", folder / "run", folder / "none.weights"
    weights.write_bytes(b"the stand-in reads none")
    common = ["--threads", "1", "--quiet", "--out"]
    generate = ["generate", "--rig", HERE / "small-rig.toml", "--frames", "3", "--seed", "5", *common]
    attack = ["attack", "--data", data, "--detector", detector, "--weights", weights, "--rooftop", "box", "--batch",
              "2", "--min-view", "0", *common]
    program.demand_done([*generate, data])
    cars_for_stand_in(data, "110 44 165 76")
    program.demand_done([*attack, run, "--iterations", "25"])
    # One frame is enough to fail in.
    shorter = [*generate, out]
    shorter[shorter.index("--frames") + 1] = "1" if quick else "2"
    export = ["export", "--run", run, "--data", data, "--frames", "1", *common, out]
    attack = [*attack, out, "--iterations", "25"]
    for command in (attack, shorter, export):
        reference = suite.reference(command)
        suite.writing(command, reference)
        if command is export or (command is attack and not quick):
            suite.reading(command, reference, data)
        if command is shorter:
            suite.reading(command, reference, HERE)  # the rig
        if command is attack or not quick:
            suite.kills_at_writes(command, reference)
    longer = [*attack[:-1], "400"]
    suite.kills_at_any_time(longer, suite.reference(longer), 3 if quick else kills)
    if not quick:
        suite.kills_at_any_time(shorter, suite.reference(shorter), kills // 4)
        suite.kills_at_any_time(longer, suite.reference(longer), max(kills // 10, 1),
                                before=("mpirun", "--oversubscribe", "-n", "2"))
    blender_cases(suite, run, data, common, quick)
    validate_cases(suite, run, data, common, quick)


if __name__ == "__main__":
    try:
        sys.exit(main())
    except Wrong as problem:
        sys.exit(f"WRONG: {problem}")
