"""How much of two processors a command on two ranks uses: wall seconds on one rank, on two, and, as the ceiling that memory and
caches of this machine leave, of two runs on one rank each that know nothing of each other. In alternation.

    python3 validation/benchmarks/rank_efficiency.py [PROGRAM] [--commands attack,evaluate,validate] [--frames 16] [--rounds 3]
        [--steps 24] [--json FILE]

Adds to FILE (build/release/bench.json), for each command: rank_efficiency_2_COMMAND = (one rank) / (2 · two ranks),
rank_ceiling_2_COMMAND = (alone) / (one of two at a time), and rank_seconds_1_COMMAND, rank_seconds_2_COMMAND. Medians over rounds.
Seconds are those of a step for `attack`, of the whole command, its start included, for the others. Each run has a cache of its own.
The machine must be idle otherwise.
"""

import argparse
import filecmp
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "report"))
import atomic  # noqa: E402

ROOT_FLAGS = ["--allow-run-as-root"] if os.geteuid() == 0 else []


class Run:
    """A running command on several ranks, in its own folder."""

    def __init__(self, words, ranks):
        self.folder = tempfile.TemporaryDirectory()
        self.out = os.path.join(self.folder.name, "out")
        launcher = ["mpirun", *ROOT_FLAGS, "--bind-to", "none", "-n", str(ranks)]
        environment = {**os.environ, "MIRAGE_CACHE": os.path.join(self.folder.name, "cache")}
        self.started = time.monotonic()
        self.process = subprocess.Popen([*launcher, *words, "--out", self.out, "--threads", "1", "--quiet"], env=environment,
                                        stdout=subprocess.DEVNULL)

    def seconds(self):
        """Waits for its end."""
        if self.process.wait() != 0:
            sys.exit(f"{' '.join(self.process.args)} ended with {self.process.returncode}; its line stands above")
        took = time.monotonic() - self.started
        return atomic.read_json(self.out, "result.json").get("seconds_per_iteration", took)


def measure(words, rounds, same):
    one, two, pair = [], [], []
    for _ in range(rounds):
        alone = Run(words, 1)
        one.append(alone.seconds())
        both = Run(words, 2)
        two.append(both.seconds())
        beside = [Run(words, 1), Run(words, 1)]
        pair.append(max(run.seconds() for run in beside))
        if same and not filecmp.cmp(os.path.join(alone.out, same), os.path.join(both.out, same), shallow=False):
            sys.exit(f"one rank and two of mirage {words[1]} wrote another {same}")
    return [statistics.median(times) for times in (one, two, pair)]


def main():
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("program", nargs="?", default="build/release/mirage")
    options.add_argument("--commands", default="attack,evaluate,validate")
    options.add_argument("--frames", type=int, default=16)
    options.add_argument("--detector", default="fusion")
    options.add_argument("--batch", type=int, default=8)
    options.add_argument("--rounds", type=int, default=3)
    options.add_argument("--steps", type=int, default=24)
    options.add_argument("--json", default="build/release/bench.json")
    options = options.parse_args()
    program = os.path.abspath(options.program)
    figures = {}
    with tempfile.TemporaryDirectory() as folder:
        data, run = os.path.join(folder, "data"), os.path.join(folder, "run")
        attack = [program, "attack", "--data", data, "--detector", options.detector, "--batch", str(options.batch)]
        for words in ([program, "generate", "--rig", "kitti64", "--frames", str(options.frames), "--seed", "31", "--out", data],
                      [*attack, "--iterations", "2", "--out", run]):
            subprocess.run([*words, "--quiet"], check=True, stdout=subprocess.DEVNULL)
        commands = {"attack": ([*attack, "--iterations", str(options.steps)], "adversary.glb"),
                    "evaluate": ([program, "evaluate", "--run", run, "--hosts", "all", "--baseline", "sized"], None),
                    "validate": ([program, "validate", "--run", run, "--frames", str(options.frames)], None)}
        for name in options.commands.split(","):
            alone, both, beside = measure(commands[name][0], options.rounds, commands[name][1])
            figures |= {f"rank_seconds_1_{name}": alone, f"rank_seconds_2_{name}": both,
                        f"rank_efficiency_2_{name}": alone / (2 * both), f"rank_ceiling_2_{name}": alone / beside}
            print(json.dumps(figures, indent=1), flush=True)
    atomic.add_figures(options.json, figures)


if __name__ == "__main__":
    atomic.run(main)
