"""What a thousand vehicles cost by each command: processor seconds of one process, its start left out.

    python3 validation/benchmarks/fleet_cost.py [PROGRAM] [--frames 4,12] [--detector fusion] [--json FILE]

Each command goes over few and over more generated frames; what the further vehicles take is the cost. Adds to FILE
(build/release/bench.json) and prints fleet_cpu_s_per_1000_COMMAND (`attack`: of 1000 steps of 8), certify_seconds_a_frame and
fleet_start_s_COMMAND.
Processor time, Blender's included: of N processes each takes an N-th, but for the start. And attack_peak_memory_gb, of an
attack on all threads.
"""

import argparse
import glob
import json
import os
import subprocess
import sys
import tempfile

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "report"))
import atomic  # noqa: E402


def usage(words, cache):
    """Resources that a command and its processes used (os.wait4)."""
    process = subprocess.Popen([*words, "--quiet"], stdout=subprocess.DEVNULL, env={**os.environ, "MIRAGE_CACHE": cache})
    _, status, used = os.wait4(process.pid, 0)
    if status != 0:
        sys.exit(f"{' '.join(words)} failed; its line stands above")
    return used


def cpu_seconds(words, cache):
    used = usage([*words, "--threads", "1"], cache)
    return used.ru_utime + used.ru_stime


def labelled_cars(data):
    count = 0
    for file in glob.glob(os.path.join(data, "training", "label_2", "*.txt")):
        with open(file, encoding="utf-8") as rows:
            count += sum(row.startswith("Car ") for row in rows)
    return count


def main():
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("program", nargs="?", default="build/release/mirage")
    options.add_argument("--frames", default="4,12")
    options.add_argument("--detector", default="fusion")
    options.add_argument("--commands", default="generate,fit,detect,audit,evaluate,certify,validate,attack")
    options.add_argument("--json", default="build/release/bench.json")
    options = options.parse_args()
    program, chosen = os.path.abspath(options.program), options.commands.split(",")
    sizes = [int(size) for size in options.frames.split(",")]
    figures = {}
    with tempfile.TemporaryDirectory() as folder:
        path = lambda *names: os.path.join(folder, *names)
        took, cars = {name: [] for name in chosen}, []
        for size in sizes:
            data, run = path(f"data{size}"), path(f"run{size}")
            cost = cpu_seconds([program, "generate", "--rig", "kitti64", "--frames", str(size), "--seed", "31", "--out", data], "off")
            if "generate" in took:
                took["generate"].append(cost)
            cars.append(labelled_cars(data))
            attack = [program, "attack", "--data", data, "--detector", options.detector, "--out"]
            cpu_seconds([*attack, run, "--iterations", "2"], path(f"attack-cache{size}"))
            by = ["--detector", options.detector]
            words = {"fit": ["fit", "--data", data], "detect": ["detect", "--data", data, *by],
                     "audit": ["audit", "--data", data, *by],
                     "evaluate": ["evaluate", "--run", run, "--hosts", "all"],
                     "certify": ["certify", "--data", data, *by, "--objects", "0"],
                     "validate": ["validate", "--run", run, "--frames", str(size)]}
            for name in chosen:
                if name in words:
                    # Each size has its own cache: the frames of one are among those of the other.
                    took[name].append(cpu_seconds([program, *words[name], "--out", path(f"{name}{size}")], path(f"{name}-cache{size}")))
        if "attack" in took:  # per step, on the larger set; its roofs and clean detections are cached
            cache = path(f"attack-cache{sizes[-1]}")
            took["attack"] = [cpu_seconds([*attack, path(f"steps{steps}"), "--iterations", str(steps)], cache) for steps in (4, 24)]
            most = usage([*attack, path("wide"), "--iterations", "16"], cache).ru_maxrss
            figures["attack_peak_memory_gb"] = most / 1e6
        for name, (few, more) in took.items():
            count = 20 if name == "attack" else cars[1] - cars[0]
            each = (more - few) / count
            figures[f"fleet_cpu_s_per_1000_{name}"] = 1000 * each
            if name == "certify":
                figures["certify_seconds_a_frame"] = (more - few) / (sizes[1] - sizes[0])
            figures[f"fleet_start_s_{name}"] = few - each * (4 if name == "attack" else cars[0])
    print(json.dumps(figures, indent=1))
    atomic.add_figures(options.json, figures)


if __name__ == "__main__":
    atomic.run(main)
