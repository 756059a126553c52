"""How much of two processors an attack on two ranks uses: wall seconds of a step on one rank, on two, and, as the ceiling that
memory and caches of this machine leave, of two attacks on one rank each that know nothing of each other. In alternation.

    python3 validation/benchmarks/rank_efficiency.py [PROGRAM] [--data DIR] [--rounds 3] [--steps 64] [--json FILE]

Adds to FILE (build/release/bench.json): rank_efficiency_2 = (step on one rank) / (2 · step on two), rank_ceiling_2 = (step of one
attack alone) / (step of one of two at a time), and rank_step_ms_1, _2. Medians over rounds. The machine must be idle otherwise.
"""

import argparse
import filecmp
import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "report"))
import atomic  # noqa: E402

ROOT_FLAGS = ["--allow-run-as-root"] if os.geteuid() == 0 else []


def start(program, data, out, ranks, options):
    shutil.rmtree(out, ignore_errors=True)
    launcher = ["mpirun", *ROOT_FLAGS, "--bind-to", "none", "-n", str(ranks)]
    return subprocess.Popen([*launcher, program, "attack", "--data", data, "--out", out, "--threads", "1", "--quiet",
                             "--detector", options.detector, "--batch", str(options.batch), "--iterations", str(options.steps)],
                            stdout=subprocess.DEVNULL)


def seconds(runs):
    """Of a step, the longest of the runs'."""
    steps = []
    for process, out in runs:
        if process.wait() != 0:
            sys.exit(f"{out}: mirage attack ended with {process.returncode}; its line stands above")
        with open(os.path.join(out, "result.json"), encoding="utf-8") as file:
            steps.append(json.load(file)["seconds_per_iteration"])
    return max(steps)


def main():
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("program", nargs="?", default="build/release/mirage")
    options.add_argument("--data", help="16 generated frames if left out")
    options.add_argument("--detector", default="fusion")
    options.add_argument("--batch", type=int, default=2)
    options.add_argument("--rounds", type=int, default=3)
    options.add_argument("--steps", type=int, default=64)
    options.add_argument("--json", default="build/release/bench.json")
    options = options.parse_args()
    program = os.path.abspath(options.program)
    one, two, pair = [], [], []
    with tempfile.TemporaryDirectory() as folder:
        data = options.data
        if not data:
            data = os.path.join(folder, "data")
            subprocess.run([program, "generate", "--rig", "kitti64", "--frames", "16", "--seed", "31", "--out", data, "--quiet"],
                           check=True, stdout=subprocess.DEVNULL)
        outs = [os.path.join(folder, name) for name in ("one", "two", "left", "right")]
        for _ in range(options.rounds):
            one.append(seconds([(start(program, data, outs[0], 1, options), outs[0])]))
            two.append(seconds([(start(program, data, outs[1], 2, options), outs[1])]))
            pair.append(seconds([(start(program, data, out, 1, options), out) for out in outs[2:]]))
            if not filecmp.cmp(os.path.join(outs[0], "adversary.glb"), os.path.join(outs[1], "adversary.glb"), shallow=False):
                sys.exit("one rank and two learned different meshes")
    alone, both, beside = (statistics.median(times) for times in (one, two, pair))
    figures = {"rank_step_ms_1": 1e3 * alone, "rank_step_ms_2": 1e3 * both, "rank_efficiency_2": alone / (2 * both),
               "rank_ceiling_2": alone / beside}
    print(json.dumps(figures, indent=1))
    known = {}
    if os.path.exists(options.json):
        with open(options.json, encoding="utf-8") as file:
            known = json.load(file)
    atomic.write(options.json, json.dumps({**known, **figures}, indent=1))


if __name__ == "__main__":
    atomic.run(main)
