#!/usr/bin/env python3
"""Do two halves of the frames put detectors and their defences into one order? From evaluations of the same frames with the same
objects (`mirage evaluate --mesh …`):

    python3 validation/studies/rank_agreement.py NAME=OUT/result.json NAME=OUT/result.json ... [--splits N]

An arm's rate is the share of its cars, found as recorded, that vanish (IoU 0.1), over all objects. Frames are split in halves at
random, N times, and once into even and odd ones. Kendall's tau-b is between the two halves' rates. Told apart: pairs of arms whose
paired difference over all frames excludes 0 by its 95 % interval (jackknife over frames, on cars that both find); of these, the
share whose order both halves have. Prints a table, and the answer as one line of JSON.
"""

import argparse
import itertools
import json
import math
import random
import statistics

VANISHED = 0.1  # the rule "vanished" of src/attack/host_outcome.h
Z = 1.96


def outcomes(path):
    """{frame: {(label, mesh): whether it vanishes}} of the cars found as recorded."""
    with open(path, encoding="utf-8") as file:
        result = json.load(file)
    frames = {}
    for host in result["outcomes"]:
        if host["clean_iou"] > VANISHED:
            frames.setdefault(host["frame"], {})[host["label"], host.get("mesh", 0)] = host["attacked_iou"] <= VANISHED
    return frames


def rate(arm, frames):
    lost = [lost for frame in frames for lost in arm.get(frame, {}).values()]
    return sum(lost) / len(lost) if lost else 0.0


def tau_b(x, y):
    both = tied_x = tied_y = 0
    for i, k in itertools.combinations(range(len(x)), 2):
        a, b = x[i] - x[k], y[i] - y[k]
        both += (a * b > 0) - (a * b < 0)
        tied_x += a == 0
        tied_y += b == 0
    pairs = len(x) * (len(x) - 1) // 2
    least = math.sqrt((pairs - tied_x) * (pairs - tied_y))
    return both / least if least else float("nan")


def told(a, b, frames):
    """-1, 0 or 1: whether a loses less or more than b on cars that both find."""
    sums = []
    for frame in frames:
        first, second = a.get(frame, {}), b.get(frame, {})
        cars = first.keys() & second.keys()
        sums.append((sum(first[car] - second[car] for car in cars), len(cars)))
    total, count = map(sum, zip(*sums))
    if not count:
        return 0
    whole = total / count
    without = [(total - d) / (count - n) for d, n in sums if count > n]
    k = len(without)
    error = math.sqrt(sum((x - whole) ** 2 for x in without) * (k - 1) / k)
    return (whole > Z * error) - (whole < -Z * error)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("results", nargs="+", metavar="NAME=RESULT")
    parser.add_argument("--splits", type=int, default=1000)
    args = parser.parse_args()
    arms = {name: outcomes(path) for name, path in (each.split("=", 1) for each in args.results)}
    frames = sorted(set.union(*(set(arm) for arm in arms.values())))
    halves = [(frames[::2], frames[1::2])]
    draw = random.Random(0)
    for _ in range(args.splits):
        shuffled = draw.sample(frames, len(frames))
        halves.append((shuffled[:len(frames) // 2], shuffled[len(frames) // 2:]))
    pairs = [(a, b, order) for a, b in itertools.combinations(arms, 2) if (order := told(arms[a], arms[b], frames))]
    taus, kept = [], []
    for first, second in halves:
        x, y = ({name: rate(arm, half) for name, arm in arms.items()} for half in (first, second))
        taus.append(tau_b(list(x.values()), list(y.values())))
        kept.append(statistics.mean((x[a] - x[b]) * order > 0 and (y[a] - y[b]) * order > 0 for a, b, order in pairs) if pairs else 0)
    for name, arm in sorted(arms.items(), key=lambda item: rate(item[1], frames)):
        print(f"{name:28} {100 * rate(arm, frames):5.1f} %  even {100 * rate(arm, halves[0][0]):5.1f}  odd {100 * rate(arm, halves[0][1]):5.1f}")
    drawn = sorted(taus[1:])
    print(json.dumps({"arms": len(arms), "frames": len(frames), "tau_even_odd": round(taus[0], 3), "tau_median": round(statistics.median(drawn), 3),
                      "tau_low": round(drawn[int(0.025 * len(drawn))], 3), "tau_high": round(drawn[int(0.975 * len(drawn))], 3),
                      "pairs": len(arms) * (len(arms) - 1) // 2, "told_apart": len(pairs), "kept_in_both": round(statistics.mean(kept[1:]), 3)}))


if __name__ == "__main__":
    main()
