#!/usr/bin/env python3
"""How much physical light must an attack know? Meshes learned under plain, visible, exact and Cycles pictures, and
their success in Cycles with realistic returns:

    python3 validation/studies/attack_light.py --data DATA --out OUT [--detectors camera,late,fusion]
        [--lights plain,visible,exact,exact-visible,exact-fine,cycles,cycles-exact] [--seeds 1,2,3,4,5] [--iterations N] [--frames F] [--samples S] [-- ...]

A light may name its own number of steps (plain@240): so attacks of equal time are compared. Everything after -- goes to every `mirage attack`. One attack and one `mirage validate` for each detector, light and
seed, in OUT/DETECTOR/LIGHT-SEED; what is finished is kept, and a stopped one goes on. Other arguments, frames or another program want
another OUT. All meshes are judged by the
same arms (validation/fidelity/vehicle_validation.h): default quality, plain light, Cycles with S samples; and "own" by `mirage evaluate`, the
rasteriser that the mesh was learned by (of Cycles' the one whose gradient it took). Prints a table and writes
OUT/attack_light.json. A seed splits the frames anew; shares are of the held-back vehicles that were found clean, pooled
over seeds, with 95 % percentile intervals by bootstrap over frames. "difference": success in Cycles with realistic
returns less that before its own rasteriser, on the same vehicles. "logit": how far the vehicle's logit falls in Cycles with realistic
returns from that of the photograph without the object (the verdict's control); it tells meshes apart where no outcome
does. Differences to plain, of success and of logit, are on the same vehicles, drawn together.
"""

import argparse
import json
import pathlib
import random
import sys

import kept

HERE = pathlib.Path(__file__).resolve().parents[2]
LIGHTS = {"plain": [], "visible": ["--light", "visible"], "exact": ["--quality", "exact"],
          "exact-visible": ["--quality", "exact", "--light", "visible"],
          "exact-fine": ["--quality", "exact", "--light", "fine"], "cycles": ["--renderer", "cycles", "--quality", "default", "--light", "plain"],
          "cycles-exact": ["--renderer", "cycles", "--quality", "exact", "--light", "visible"]}
OWN = ("own", "ideal")
ARMS = [OWN, ("raster", "ideal"), ("visible", "ideal"), ("cycles", "ideal"), ("cycles", "realistic")]
DRAWS = 10000


def outcomes(folder, seed):
    """{(seed, frame, label): {arm: attacked successfully, "logit": its fall}} of the held-back vehicles found clean."""
    test = {(h["frame"], h["label"]) for h in json.loads((folder / "run.json").read_text())["test"]}
    own = {(h["frame"], h["label"]): h for h in json.loads((folder / "evaluate" / "result.json").read_text())["outcomes"]}
    found = {}
    for name in json.loads((folder / "validate" / "result.json").read_text())["hosts"]:  # other files may be in the folder
        host = json.loads((folder / "validate" / "hosts" / f"{name}.json").read_text())
        vehicle = (host["frame"], host["label"])
        if vehicle not in test or not host.get("detected"):
            continue
        of = {(arm["light"], arm["returns"]): arm for arm in host["arms"]} | {OWN: own[vehicle]}
        bare = next(control["logit"] for control in host["controls"] if control["control"] == "photograph")
        found[(seed, *vehicle)] = {
            arm: bool(of[arm]["hidden"] or of[arm]["false_positive"]) for arm in ARMS} | {
            "logit": bare - of[ARMS[-1]]["logit"]}
    return found


def interval(values):
    """Mean and 95 % of {(seed, frame, label): number}, frames drawn with replacement."""
    frames = {}
    for (_, frame, _), value in values.items():
        frames.setdefault(frame, []).append(value)
    if not frames:
        return [float("nan")] * 3
    groups, draw = list(frames.values()), random.Random(0)
    means = []
    for _ in range(DRAWS):
        some = [value for _ in groups for value in draw.choice(groups)]
        means.append(sum(some) / len(some))
    means.sort()
    return [sum(values.values()) / len(values), means[int(0.025 * DRAWS)], means[int(0.975 * DRAWS) - 1]]


def shown(of, unit=100, digits=1):
    return "{:.{d}f} ({:.{d}f} to {:.{d}f})".format(*(unit * x for x in of), d=digits)


def main():
    split = sys.argv.index("--") if "--" in sys.argv else len(sys.argv)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", required=True, type=pathlib.Path)
    parser.add_argument("--out", required=True, type=pathlib.Path)
    parser.add_argument("--detectors", default="camera,late,fusion")
    parser.add_argument("--lights", default=",".join(LIGHTS))
    parser.add_argument("--seeds", default="1,2,3,4,5")
    parser.add_argument("--iterations", type=int, default=0, help="of lights that name no own; 0: as many as mirage attack takes by itself")
    parser.add_argument("--frames", type=int, default=0, help="to validate, held-back ones first; 0: all held back")
    parser.add_argument("--samples", type=int, default=32)
    parser.add_argument("--threads", type=int, default=0)
    parser.add_argument("--mirage", default=str(HERE / "build" / "release" / "mirage"))
    options = parser.parse_args(sys.argv[1:split])
    options.data, options.out = options.data.resolve(), options.out.resolve()
    more, table = sys.argv[split + 1:], []
    for detector in options.detectors.split(","):
        pooled = {}
        for light in options.lights.split(","):
            steps = seconds = 0
            kind, _, own = light.partition("@")
            iterations = int(own) if own else options.iterations
            steps_asked = ["--iterations", iterations] if iterations else []
            for seed in options.seeds.split(","):
                folder = options.out / detector / f"{light}-{seed}"
                result = kept.result(folder, options.mirage, ["attack", "--data", options.data, "--detector", detector, "--seed", seed,
                                                              *steps_asked, *LIGHTS[kind], *more], options.threads,
                                     data=kept.listing(options.data))
                steps += result["stages"]["iterations"]
                seconds += result["stages"]["iterations"] * result["seconds_per_iteration"]
                test = json.loads((folder / "run.json").read_text())["test"]
                frames = options.frames or len({host["frame"] for host in test})
                kept.result(folder / "evaluate", options.mirage, ["evaluate", "--run", folder, "--data", options.data, "--random-meshes", 0],
                            options.threads, attack=result["provenance"]["identity"])
                kept.run([options.mirage, "validate", "--run", folder, "--data", options.data, "--frames", frames, "--ladder", 0,
                          "--samples", options.samples, "--quality", "default", "--light", "plain", "--quiet", "--out",
                          folder / "validate", "--threads", options.threads])
                pooled.setdefault(light, {}).update(outcomes(folder, seed))
            row = {"detector": detector, "light": light, "vehicles": len(pooled[light]),
                   "seconds_per_step": seconds / steps if steps else None, "arms": {}}
            for arm in ARMS:
                row["arms"][" ".join(arm)] = interval({key: of[arm] for key, of in pooled[light].items()})
            row["difference"] = interval({key: of[ARMS[-1]] - of[ARMS[0]] for key, of in pooled[light].items()})
            row["logit"] = interval({key: of["logit"] for key, of in pooled[light].items()})
            if light != "plain" and "plain" in pooled:
                plain = pooled["plain"]
                for name, what in (("over_plain", ARMS[-1]), ("logit_over_plain", "logit")):
                    row[name] = interval({key: of[what] - plain[key][what]
                                          for key, of in pooled[light].items() if key in plain})
            table.append(row)
            (options.out / "attack_light.json").write_text(json.dumps({**kept.origin(result), "rows": table}, indent=1) + "\n")
    print("| detector, learned under | vehicles | s a step |", " | ".join(", ".join(arm) for arm in ARMS),
          "| difference | over plain | logit | over plain |")
    print("|---" * (7 + len(ARMS)) + "|")
    for row in table:
        step = "" if row["seconds_per_step"] is None else f"{row['seconds_per_step']:.2f}"
        print("|", f"{row['detector']}, {row['light']} | {row['vehicles']} | {step} |",
              " | ".join(shown(of) for of in row["arms"].values()), "|",
              shown(row["difference"]), "|",
              shown(row["over_plain"]) if "over_plain" in row else "", "|", shown(row["logit"], 1, 2), "|",
              shown(row["logit_over_plain"], 1, 2) if "over_plain" in row else "", "|")


if __name__ == "__main__":
    main()
