#!/usr/bin/env python3
"""Where does one cubic metre hurt most? A cube's volume of one object, learned anew for each placement, detector and target:

    python3 validation/studies/placements.py --data DATA --judge JUDGE --out OUT [--detectors lidar,late,fusion] [--targets both]
        [--places roof,rear-rack,trailer,road-ahead,kerb] [--iterations 100] [--vehicles 500] [--seed 0] [-- ...]

Each place is the shipped one (scenes/placements) with a volume of 1 x 1 x 1 m. DATA is learned on; of JUDGE as many frames, the
first ones, are judged as give so many hosts that are found as recorded. One `mirage attack` and one `mirage evaluate --baseline sized` each, in
OUT/PLACE-DETECTOR-TARGET; what is finished stays, and a stopped one goes on. Other arguments, frames or another program want another
OUT. Everything after -- goes to every `mirage attack`.
Writes OUT/placements.json and prints it as a table: vehicles that vanish and vehicles with a phantom, less those under a random mesh
of the same size, with 95 % intervals.
"""

import argparse
import json
import pathlib
import re
import sys

import kept

HERE = pathlib.Path(__file__).resolve().parents[2]
PLACES = ("roof", "rear-rack", "trailer", "road-ahead", "kerb")
CUBE = "volume = [1.0, 1.0, 1.0]"
FIRST_FRAMES = 26


def cube_at(place, out):
    text, volumes = re.subn(r"^volume = .*$", CUBE, (HERE / "scenes" / "placements" / f"{place}.toml").read_text(), flags=re.M)
    if volumes != 1:
        sys.exit(f"{place}.toml: has no volume")
    file = out / f"{place}.toml"
    file.write_text(text)
    return file


def judged(options, folder, attack):
    """The evaluation of the attack on as many frames as needed: each gives the hosts per frame."""
    frames = sorted(file.stem for file in (options.judge / "training" / "velodyne").iterdir())
    count, result = min(FIRST_FRAMES, len(frames)), None
    while True:
        some = options.out / f"frames-{count}"
        kept.require_same(some, judge=str(options.judge), files=kept.listing(options.judge))
        for source in sorted(options.judge.rglob("*")):
            if source.is_file() and (source.stem in frames[:count] or source.parent == options.judge):
                copy = some / source.relative_to(options.judge)
                copy.parent.mkdir(parents=True, exist_ok=True)
                if not copy.is_symlink():
                    copy.symlink_to(source.resolve())
        result = kept.result(folder / f"judged-{count}", options.mirage, ["evaluate", "--run", folder, "--data", some, "--hosts", "all",
                                                                          "--baseline", "sized"], options.threads, attack=attack)
        if count == len(frames) or result["vehicles"] >= 0.95 * options.vehicles:
            return result
        count = min(len(frames), -(-count * options.vehicles // max(1, result["vehicles"])))


def main():
    split = sys.argv.index("--") if "--" in sys.argv else len(sys.argv)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name in ("data", "judge", "out"):
        parser.add_argument("--" + name, required=True, type=pathlib.Path)
    parser.add_argument("--detectors", default="lidar,late,fusion")
    parser.add_argument("--targets", default="both")
    parser.add_argument("--places", default=",".join(PLACES))
    parser.add_argument("--iterations", type=int, default=100)
    parser.add_argument("--vehicles", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=0)
    parser.add_argument("--mirage", default=str(HERE / "build" / "release" / "mirage"))
    options = parser.parse_args(sys.argv[1:split])
    options.data, options.judge, options.out = (path.resolve() for path in (options.data, options.judge, options.out))
    options.out.mkdir(parents=True, exist_ok=True)
    rows = []
    for detector in options.detectors.split(","):
        for target in options.targets.split(","):
            for place in options.places.split(","):
                folder, cube = options.out / f"{place}-{detector}-{target}", cube_at(place, options.out)
                attack = kept.result(
                    folder, options.mirage, ["attack", "--data", options.data, "--detector", detector, "--target", target, "--place", cube,
                                             "--iterations", options.iterations, "--seed", options.seed, *sys.argv[split + 1:]],
                    options.threads, place=kept.content(cube), data=kept.listing(options.data))
                result = judged(options, folder, attack["provenance"]["identity"])
                rows.append({"place": place, "detector": detector, "target": target, "vehicles": result["vehicles"],
                             "victim": result["placed"]["victim"], "vanished": result["net"]["vanished"], "phantom": result["net"]["fp_asr"],
                             "vanished_all": {key: result["hidden"]["vanished"][key] for key in ("value", "low", "high")},
                             "phantom_all": result["intervals"]["fp_asr"]})
                (options.out / "placements.json").write_text(json.dumps({**kept.origin(result), "rows": rows}, indent=1) + "\n")
                shown = (f"{100 * rows[-1][what]['value']:+5.1f} ({100 * rows[-1][what]['low']:.1f} to {100 * rows[-1][what]['high']:.1f})"
                         for what in ("vanished", "phantom"))
                print("|", place, "|", detector, "|", target, "|", result["vehicles"], "|", " | ".join(shown), "|", flush=True)


if __name__ == "__main__":
    main()
