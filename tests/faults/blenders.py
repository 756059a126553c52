"""mirage validate where Blender is dead, dies, or talks nonsense, and on a disk that fails."""
import contextlib
import os
import shutil
import stat

from program import HERE, NO_SPACE, demand, demand_one_line, fresh

# Stand-ins for Blender: one dies at its start, one answers the first question and dies at the next job, one talks
# nonsense for ever.
STAND_INS = {"dead": "exit 3",
             "dies at a job": """while read -r line; do case "$line" in *'"ping"'*)
    id=$(echo "$line" | sed 's/.*"id":\\([0-9]*\\).*/\\1/')
    echo "{\\"id\\":$id,\\"ok\\":true,\\"version\\":\\"none\\"}" ;; *) exit 3 ;; esac; done""",
             "answers nonsense": """while read -r line; do case "$line" in *'"ping"'*)
    id=$(echo "$line" | sed 's/.*"id":\\([0-9]*\\).*/\\1/')
    echo "{\\"id\\":$id,\\"ok\\":true,\\"version\\":\\"none\\"}" ;;
    *) id=$(echo "$line" | sed 's/.*"id":\\([0-9]*\\).*/\\1/'); echo "{\\"id\\":$id,\\"ok\\":true,\\"image\\":[}" ;; esac; done"""}


def blender_cases(suite, run, data, common, quick):
    for name, script in STAND_INS.items():
        if quick and name != "dead":  # the others are given time
            continue
        suite.case("validate: Blender", name, lambda: without_blender(suite, script, run, data, common))


def without_blender(suite, script, run, data, common):
    fresh(suite.out)
    with standing_in(suite.program, script):
        code, said = suite.program.run(validation(suite, run, data, common), timeout=900)
    demand_one_line(code, said)
    demand("lender" in said, f"does not name Blender: {said.strip()!r}")


def validation(suite, run, data, common):
    return ["validate", "--trust-run", "--run", run, "--data", data, "--frames", "1", "--samples", "1", "--ladder", "0",
            *common, suite.out]


@contextlib.contextmanager
def standing_in(program, script):
    """A shell script is the blender on PATH."""
    folder = program.folder / "bin"
    folder.mkdir(exist_ok=True)
    blender = folder / "blender"
    blender.write_text(f"#!/bin/sh\n{script}\n")
    blender.chmod(blender.stat().st_mode | stat.S_IXUSR)
    path = program.environment["PATH"]
    program.environment["PATH"] = f"{folder}{os.pathsep}{path}"
    try:
        yield
    finally:
        program.environment["PATH"] = path


def validate_cases(suite, run, data, common, quick):
    """Faults of the program's own and of the report's writes; Blender says what it said once (replay_blender.py)."""
    real = shutil.which("blender")
    if real is None:
        suite.left_out = "validate on a failing disk: there is no blender"
        return
    records, replayer = suite.program.folder / "records", suite.program.folder / "replayer"
    records.mkdir()
    replayer.symlink_to("/usr/bin/python3")  # a process of another name than the report's
    command = validation(suite, run, data, common)
    script = f'exec {replayer} -B {HERE}/replay_blender.py {records} {real} "$@"'
    with standing_in(suite.program, script):
        fresh(suite.out)
        code, said = suite.program.run(command, timeout=900)  # asks the real one
        demand(code == 0, f"validate fails without a fault: {said}")
        reference = suite.reference(command)
        for suite.process in ("mirage", "python3"):
            suite.writing(command, reference, ((NO_SPACE, 0),))
        suite.process = "mirage"
        for under in () if quick else (data, run):
            suite.reading(command, reference, under)
        if not quick:
            suite.kills_at_writes(command, reference)
            suite.kills_at_any_time(command, reference, 10)
        suite.process = ""
