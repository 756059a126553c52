"""mirage validate where Blender is dead, dies, or talks nonsense."""
import os
import stat

from program import demand, demand_one_line, fresh

# What stands in for Blender: dies while it starts; answers the first question and dies at the next job; talks
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
    folder = suite.program.folder / "bin"
    folder.mkdir(exist_ok=True)
    blender = folder / "blender"
    blender.write_text(f"#!/bin/sh\n{script}\n")
    blender.chmod(blender.stat().st_mode | stat.S_IXUSR)
    fresh(suite.out)
    path = suite.program.environment["PATH"]
    suite.program.environment["PATH"] = f"{folder}{os.pathsep}{path}"
    try:
        code, said = suite.program.run(["validate", "--trust-run", "--run", run, "--data", data, "--frames", "1", *common,
                                        suite.out],
                                       timeout=900)
    finally:
        suite.program.environment["PATH"] = path
    demand_one_line(code, said)
    demand("lender" in said, f"does not name Blender: {said.strip()!r}")
