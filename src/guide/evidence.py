"""Tables and plots of the pages from what commands wrote.

    evidence.py SOURCE                                      writes every block and plot
    evidence.py SOURCE --check                              compares them; exit code 1 where one is another one
    evidence.py SOURCE --keep NAME FILE KEY... [-- COMMAND] stores a result as validation/results/NAME.json; of an object or a
                                                            list of them KEY[FIELD,…] stores these fields, which may be such
    evidence.py SOURCE --keep-lines NAME PATTERN -- COMMAND runs a command in SOURCE and stores the printed lines with PATTERN

A block of a page stands between <!-- evidence: NAME --> and <!-- /evidence -->, and its table is TABLES[NAME] of the stored files.
A stored file has the keys that tables need and where they come from: command, commit, date, hashes. COMMAND names the command of a
file that does not say it, such as bench.json. Commit and date are those that the file says; without, the day of its last change alone.
"""

import datetime
import json
import os
import re
import subprocess
import sys
from html import escape

RESULTS = os.path.join("validation", "results")
ORIGIN = ("command", "commit", "version", "date", "seed", "program", "identity", "data_hash", "frames", "detector", "weights_hash")
BLOCK = re.compile(r"(<!-- evidence: (\w+) -->\n).*?(<!-- /evidence -->)", re.S)
DETECTORS = ("lidar", "camera", "painted", "fusion", "late", "refined")


class Missing(Exception):
    pass


def stored(source, name):
    path = os.path.join(source, RESULTS, name + ".json")
    if not os.path.exists(path):
        raise Missing(f"{path}: no such file; make it with evidence.py --keep")
    with open(path, encoding="utf-8") as file:
        return json.load(file)


def at(tree, place):
    for part in place.split("."):
        tree = tree[int(part)] if isinstance(tree, list) else tree[part]
    return tree


def percent(x):
    return f"{100 * x:.1f}".replace("-0.0", "0.0").replace("-", "−")


def grouped(count):
    return f"{count:,}".replace(",", " ")


def between(interval):
    to = " to " if interval["low"] < 0 else "–"
    return f"{percent(interval['low'])}{to}{percent(interval['high'])}"


def table(head, rows):
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines) + "\n"


def wrapped(command, width=116):
    """In lines that end with a backslash, broken before options."""
    first, *parts = re.split(r" (?=--)", command)
    lines = [first]
    for part in parts:
        if len(lines[-1]) + 1 + len(part) <= width:
            lines[-1] += " " + part
        else:
            lines.append("  " + part)
    return " \\\n    ".join(lines)


def commands(*results):
    return "\n" + "".join(f"    {wrapped(one)}\n" for each in results for one in each["command"].split(" && "))


def detections(source, data):
    """{detector: result} of the stored ones on generated or recorded frames."""
    names = {name: f"detect-{data}-{name}" for name in DETECTORS}
    return {name: stored(source, file) for name, file in names.items()
            if os.path.exists(os.path.join(source, RESULTS, file + ".json"))}


def titled(detector):
    return f"`{detector}`" + (", in the picture" if detector == "camera" else "")


def ap(result):
    return [percent(result["ap70"]), between(result["ap70_interval"])]


def average_precisions(source, sets):
    """AP 0.7 of the shipped detectors on each of the sets (name of the files, title)."""
    results = [detections(source, of) for of, _ in sets]
    head = ["detector", *(each for _, said in sets for each in (said + ", %", "95 %"))]
    rows = [[titled(name), *(cell for of in results for cell in (ap(of[name]) if name in of else ["–", "–"]))] for name in DETECTORS
            if any(name in of for of in results)]
    return table(head, rows) + commands(*(of["lidar"] for of in results))


def detectors(source):
    return average_precisions(source, (("generated", "generated"), ("kitti", "44 KITTI frames"), ("xenith", "rig xenith")))


def recorded(source):
    """By the free weights and by those tuned on KITTI."""
    return average_precisions(source, (("0009-free", "drive 0009"), ("0009-real", "drive 0009, `real`"), ("34-free", "34 frames")))


def depth(source):
    """Errors of depth completion on generated and on recorded frames."""
    made = [(stored(source, "depth-" + of), said) for of, said in (("generated", "30 generated, true depth"),
                                                                 ("kitti", "44 KITTI, 20 % of returns held back"))]
    names, rows = ("ip-basic", "guided"), []
    for result, said in made:
        by = {each["name"]: each["common"] for each in result["backends"]}
        rows.append([said, *(f"{by[name][what]:.0f}" for name in names for what in ("rmse_mm", "mae_mm"))])
    return table(["frames", *(f"{name} {what}" for name in names for what in ("RMSE, mm", "MAE, mm"))], rows) + commands(
        *(result for result, _ in made))


def roofs(source):
    """How far fitted roofs lie from the true ones, by distance."""
    made, rows = stored(source, "fit-generated"), []
    for each in made["by_range"]:
        (low, high), error = each["range_m"], each["error"]["roof_m"]
        rows.append([f"{low:.0f}–{high:.0f} m" if high else f"{low:.0f} m on", str(each["vehicles"]), str(each["fitted"]),
                     f"{100 * error['median']:.1f}", f"{100 * error['p95']:.1f}"])
    return table(["range", "cars", "fitted", "median error, cm", "95th percentile, cm"], rows) + commands(made)


def certificate(source):
    """Of the usual size."""
    return next(each for each in stored(source, "certify-lidar")["sizes"] if each["size"] == 0.8)


def certified(source):
    """Of one size: found, and certified with the roof known and without."""
    of = certificate(source)
    rows = [[said, f"{percent(of[key]['value'])} %", between(of[key])] for key, said in
            (("clean_iou70", "found as recorded"), ("known_roof_iou70", "certified, roof known"), ("lattice_iou70", "certified by the lattice"))]
    return table(["", "cars", "95 %"], rows)


def certificates(source):
    """Cars that no object of a size can hide."""
    made, fusion = stored(source, "certify-lidar"), stored(source, "certify-fusion")
    rows = [[f"{each['size']:.1f} m", percent(each["lattice_iou70"]["value"]), between(each["lattice_iou70"])] for each in made["sizes"]]

    def known(result):
        shares = sorted({percent(each["known_roof_iou70"]["value"]) for each in result["sizes"]}, key=float)
        return " to ".join((shares[0], shares[-1])[:len(shares)])

    tried, past = (sum(each[key] for each in made["sizes"]) for key in ("objects", "violations"))
    return table(["half length L", "certified, %", "95 %"], rows) + commands(made, fusion) + f"""
With the roof known {known(made)} % are certified at every size, all that are found. `fusion` with the roof known: {known(fusion)} %. Of {grouped(tried)}
random objects {past or "none"} reached past its mask.
"""


def experiment(source, name, of=""):
    """A table, `of` or NAME's own, of the stored `mirage reproduce`: {rows, found: {evaluation: cars of *vanished*}, findings:
    {name: [check]}, command}. A row's `vehicles` are those found at IoU 0.7, which ASR counts; *vanished* counts those at 0.1."""
    made = stored(source, "reproduce-" + name)
    rows = next(each["rows"] for each in made["tables"] if each["name"] == (of or name))
    found = {f"evaluations/{arm['name']}": arm["hidden"]["vanished"]["vehicles"] for arm in made.get("arms", ()) if arm["mesh"] == "learned"}
    return {"rows": [row for row in rows if "error" not in row], "found": found, "command": made["command"],
            "findings": {each["name"]: each["checks"] for each in made["findings"]}}


def rate(row, key="vanished"):
    return [percent(row["values"][key]["value"]), between(row["values"][key])]


def signed(x):
    text = f"{100 * x:+.1f}"
    return "0.0" if text in ("+0.0", "-0.0") else text.replace("-", "−")


def points(interval):
    return [signed(interval["value"]), f"{signed(interval['low'])} to {signed(interval['high'])}"]


def printed(row, key):
    return percent(row["paper"][key]) if key in row.get("paper", {}) else "–"


def told(interval):
    """In a sentence: value and interval, without a unit."""
    return f"{percent(interval['value'])} ({between(interval)})"


def matched(source):
    """Rasteriser and LiDAR against Cycles and Blender's rays under equal light."""
    made = stored(source, "validate-kitti")
    of = made["matched"]
    rows = [["vehicles", str(made["vehicles"])], ["mask IoU", f"{of['mask_iou']:.6f}"], ["mean absolute colour error", f"{of['mae']:.1e}"],
            ["LiDAR rays", grouped(of["rays"])], ["rays that differ", str(of["hit_disagreements"])],
            ["range error at most", f"{of['range_error_m']:.1e} m"]]
    return table(["what", "figure"], rows) + commands(made)


def success(source):
    """Attacks on the KITTI rig's detectors, beside the paper's."""
    made = experiment(source, "table1")
    rows = [[row["label"], *rate(row), *rate(row, "asr"), str(row["vehicles"]), printed(row, "asr")] for row in made["rows"]]
    hidden = {row["label"]: row["values"]["vanished"]["value"] for row in made["rows"]}
    ratio = hidden["fusion, both"] / hidden["fusion, random mesh of its size"]
    return table(["attack", "vanished, %", "95 %", "ASR, %", "95 %", "cars of ASR", "paper's ASR, %"], rows) + commands(made) + f"""
- **A learned mesh is more than its size**: through both sensors it hides {ratio:.1f} times as many cars as its random mesh.
- **Fusion helps against attacks through LiDAR**: by {told(made["findings"]["fusion"][0]["comparisons"][0]["difference"])} points of ASR.
"""


def by_label(made, head):
    """Vanished, and net of a random mesh of the size."""
    rows = [[row["label"].removesuffix(", both"), *rate(row), *points(row["values"]["net_vanished"])] for row in made["rows"]]
    return table([head, "vanished, %", "95 %", "net", "95 %"], rows) + commands(made)


def sizes(source):
    """Half the length of the object's box."""
    return by_label(experiment(source, "fig4"), "half length")


def parts(source):
    """What of the object is learned."""
    return by_label(experiment(source, "parts"), "learned")


def transfer(source):
    """A mesh learned elsewhere, and that of the attacked detector's own run."""
    made = experiment(source, "table3")
    own = {row["target"]: row for row in made["rows"] if row["source"] == row["target"]}
    rows = [[row["source"], row["target"], *rate(row), rate(own[row["target"]])[0], *points(row["values"]["net_vanished"])]
            for row in made["rows"] if row["source"] not in (row["target"], "random mesh")]
    return table(["learned on", "attacked", "vanished, %", "95 %", "white box, %", "net", "95 %"], rows) + commands(made)


def sides(source):
    """What an attack through one sensor hides from each fusion, net of a random mesh of its size."""
    made = experiment(source, "fusions")
    less = {check["rig"].rsplit(", ", 1)[1]: check["comparisons"][0]["difference"] for check in made["findings"]["fusions-side"]}
    net = {(row["source"], row["target"]): row["values"]["net_vanished"] for row in made["rows"]}
    rows = [[f"`{name}`{said}", *(figure for sensor in ("image", "LiDAR") for figure in points(net[f"{name}, {sensor}", name])),
             *points(less[name])]
            for name, said in (("painted", ", early"), ("fusion", ", mid"), ("refined", ", mid, second stage"), ("late", ""))]
    return table(["detector", "through the image", "95 %", "through LiDAR", "95 %", "image less LiDAR", "95 %"], rows) + commands(made)


def real_frames(source):
    """Meshes learned on generated frames, on the vehicles of recorded ones."""
    made = experiment(source, "fusions-real")
    rows = [[f"`{row['target']}`", str(made["found"][row["case"]]), *rate(row), *points(row["values"]["net_vanished"])]
            for row in sorted(made["rows"], key=lambda row: -row["values"]["vanished"]["value"])
            if row["source"].split(",")[0] == row["target"]]
    return table(["detector", "cars", "vanished, %", "95 %", "net", "95 %"], rows) + commands(made)


def light_models(source):
    """Mean error of each light model against Cycles in full light."""
    made = [stored(source, "light-" + meshes) for meshes in ("random", "learned")]
    columns = [(one["figures"], side) for one in made for side in ("front", "back")]
    rows = [[said, *(percent(figures[model][side]["no_noise"]) for figures, side in columns)]
            for model, said in (("plain", "plain"), ("visible", "`visible`"), ("fine", "`fine`"))]
    vehicles = sorted({figures["plain"][side]["vehicles"] for figures, side in columns})
    return table(["light", *(f"{meshes}, {side}-lit, %" for meshes in ("random mesh", "learned mesh") for side in ("front", "back"))],
                 rows) + commands(*made) + f"\nEach column has {' to '.join(map(str, vehicles))} vehicles.\n"


def option(row):
    """The word of --defense of a row of table4."""
    name = row["case"].removeprefix("evaluations/kitti64-fusion-both").lstrip("-")
    word = re.sub(r"^(jpeg|ceiling)(?=\d)", r"\1:", name).replace("adversarial-", "adversarial+")
    return f"`{word}`" if word else "none"


# Findings about defences, and what of theirs takes ASR off.
DEFENDED = (("adversarial", "adversarial training"), ("roof-objects", "its part beyond the control `roof-objects`"),
            ("adversarial+shadows", "shadow checks besides"), ("shadows", "shadow checks alone"), ("jpeg", "`jpeg:50`"),
            ("ceiling:1.4", "`ceiling:1.4`"), ("ceiling", "training under it"))


def defences(source):
    """Each attacked by who knows it."""
    made = experiment(source, "table4")
    rows = [[option(row), grouped(made["found"][row["case"]]), *rate(row), str(row["vehicles"]), *rate(row, "asr"), printed(row, "asr"),
             percent(row["values"]["ap70"]["value"])]
            for row in made["rows"]]
    taken = [f"- {said}: {told(made['findings'][name][0]['comparisons'][0]['difference'])}" for name, said in DEFENDED if made["findings"].get(name)]
    return table(["`--defense`", "cars", "vanished, %", "95 %", "cars of ASR", "ASR, %", "95 %", "paper's ASR, %", "clean AP 0.7, %"],
                 rows) + commands(made) + "\nASR taken off, in points:\n\n" + "\n".join(taken) + "\n"


def worth(source):
    """Of each defence in short."""
    made = experiment(source, "table4")
    rows = [[option(row), *(percent(row["values"][key]["value"]) for key in ("vanished", "asr", "ap70"))] for row in made["rows"]]
    return table(["`--defense`", "vanished, %", "ASR, %", "clean AP 0.7, %"], rows)


def workshop(source):
    """The printable solid as learned, and as a workshop might make it."""
    made_solid = experiment(source, "solid", "parts")
    solid = next(row for row in made_solid["rows"] if row["label"] == "printable solid, both")
    made = [(stored(source, "workshop-" + name), said) for name, said in
            (("fine", "2 cm off, colour cast, 24 colours"), ("coarse", "10 cm off, colour cast, 3 colours"))]
    rows = [["as learned", grouped(made_solid["found"][solid["case"]]), *rate(solid)],
            *([said, grouped(of["hidden"]["vanished"]["vehicles"]), *rate({"values": of["hidden"]})] for of, said in made)]
    return table(["object", "cars", "vanished, %", "95 %"], rows) + commands(made_solid, *(of for of, _ in made))


def cubes(source):
    """Plain cubes on the road with a box on them, by distance: what `--place debris` has beside its object."""
    rows, trained = [], DETECTORS[:1] + DETECTORS[2:]
    for edge, said in (("half", "0.5 m"), ("1", "1 m")):
        def seen(detector):
            ranges = [each for each in stored(source, f"cube-{edge}-{detector}")["strata"] if each["by"] == "range"]
            return [f"{percent(each['seen']['clean']['value'])} % ({100 * each['seen']['clean']['low']:.0f}–{100 * each['seen']['clean']['high']:.0f})"
                    for each in ranges if each["name"] in ("0-15 m", "15-30 m", "30-50 m")]

        rows.append([said, "`clusters`", *seen("clusters")])
        of = {name: seen(name) for name in trained}
        if len({tuple(cells) for cells in of.values()}) == 1:
            rows.append([said, "each trained one", *of["lidar"]])
        else:
            rows += [[said, f"`{name}`", *cells] for name, cells in sorted(of.items(), key=lambda item: -float(item[1][0].split()[0]))]
    return table(["edge", "detector", "0–15 m", "15–30 m", "30–50 m"], rows) + commands(stored(source, "cube-half-clusters"))


def where(source):
    """The place that hides most cars and the one that makes most phantoms, net of a random mesh of the size."""
    rows = stored(source, "placements")["figures"]["rows"]

    def most(what):
        row = max(rows, key=lambda row: row[what]["value"])
        return f"{row['place'].replace('-', ' ')}", f"{points(row[what])[0]} points from `{row['detector']}` ({between(row[what])})"

    (hides, hidden), (makes, phantoms) = most("vanished"), most("phantom")
    kerb = max((row["vanished"] for row in rows if row["place"] == "kerb"), key=lambda of: of["value"])
    return f"""On the {hides} it hides most: {hidden}. From the {makes} it makes most phantoms: {phantoms}. From the kerb
it hides no neighbour: {points(kerb)[0]} points at most ({between(kerb)}).
"""


# What, the printed line with its figure, and the test.
GRADIENTS = (
    ("soft rasteriser, random faces", r"error \(random faces\): (\S+)", "SoftRasterizerGradient*"),
    ("soft rasteriser, 144 combinations of its options", r"combinations, worst relative gradient error (\S+)", "SoftRasterizerGradient*"),
    ("faces that cross the near plane", r"error \(clipped faces\): (\S+)", "ProjectionGradient*"),
    ("exact areas", r"components, worst relative error (\S+); .* left out", "ExactCoverageGradient*"),
    ("light with visibility", r"visible light: .* worst relative error (\S+)", "VisibleLight*"),
    ("one LiDAR return", r"^worst relative error (\S+)$", "LidarReturn*"),
)


# Through a whole insertion: what, and the printed line with its figure.
INSERTION = (
    ("camera, vertices", r"^camera, vertices: .* error (\S+)"),
    ("LiDAR, vertices", r"^LiDAR, vertices: .* error (\S+),"),
    ("LiDAR with all effects", r"vertex components, worst (\S+);"),
    ("lens and sensor", r"^(?:blur|noise|unit): .* error (\S+)"),
)


# Values beside others: what, the printed line with their differences, and the test.
AGREEMENTS = (
    ("soft rasteriser: Liu et al.'s values and gradients", r"image (\S+), paper's background (\S+), d faces (\S+), d textures (\S+)", "*Golden*"),
    ("fast float rasteriser: the double one's picture", r"^\w+ +image (\S+)", "RasterBatch*Reference*"),
    ("its gradients", r"vertices (\S+) +texels (\S+)", "RasterBatch*Reference*"),
    ("LiDAR with silhouettes: differences of the mean sweep", r"off by (\S+),", "LidarSilhouette*"),
    ("without silhouettes", r"without the silhouette by (\S+)", "LidarSilhouette*"),
    ("a detector's local pass: the whole one, in double", r"in double (\S+) apart", "*LocalPasses*"),
)


def worst(lines, pattern):
    return f"{max(float(figure) for line in lines for match in re.finditer(pattern, line) for figure in match.groups()):.1e}"


def gradients(source):
    """The worst of each test's printed figures."""
    result = stored(source, "gradients")
    rows = [[what, worst(result["lines"], pattern), f"`{test}`"] for what, pattern, test in GRADIENTS]
    return table(["backward pass against central differences", "worst relative error", "tests"], rows) + commands(result)


def insertion(source):
    result = stored(source, "gradients-insertion")
    return table(["through a whole insertion", "worst relative error"],
                 [[what, worst(result["lines"], pattern)] for what, pattern in INSERTION]) + commands(result)


def agreement(source):
    result = stored(source, "agreement")
    return table(["values: beside", "worst difference", "tests"],
                 [[what, worst(result["lines"], pattern), f"`{test}`"] for what, pattern, test in AGREEMENTS]) + commands(result)


def rays(source):
    made = stored(source, "rays")
    frames, share, least = re.match(r"(\d+) frames: (\S+) % of the returns assigned, (\S+) % in the worst", made["lines"][0]).groups()
    return f"Returns with a ray of their own within 0.1°: {share} % on {frames} KITTI frames, {least} % in the worst.\n" + commands(made)


REAL_TO_SIM = (("fitted", "fitted from other frames"), ("as-recorded", "the same mesh, `as-recorded`"), ("unit", "the same mesh, `unit`"),
               ("cuboid", "cuboid of the label's size"), ("next", "the next recorded frame"))


def real_to_sim(source):
    """A car in a recorded frame against another one in its place: returns, and the detectors' answers."""
    made = stored(source, "real-to-sim")
    figures, detectors = made["figures"], [name for name in made["figures"]["detectors"] if name.endswith(" real")]

    def plain(interval):
        return f"{interval['value']:.2f} ({interval['low']:.2f}–{interval['high']:.2f})"

    rows = []
    for arm, name in REAL_TO_SIM:
        of = (figures[key].get(arm) for key in ("returns", "below_windows_within_35_m"))
        rows.append([name, *(f"{percent(one['off']['value'])} ({between(one['off'])})" if one else "–" for one in of),
                     *(plain(figures["detectors"][each]["delta_logit"][arm]["size"]) for each in detectors)])
    head = ["in place of the recorded car", "returns off, %", "below windows, to 35 m, %", *(f"`{each.split()[0]}`, logits off" for each in detectors)]
    bars = figures["error_bar"]["fitted"]
    as_recorded, unit = (plain(figures["below_windows_within_35_m"][arm]["sum"]) for arm in ("as-recorded", "unit"))

    def lost(albedo):
        bins = [each for each in figures["lost"] if "cosine" in each and each["albedo"] == albedo]
        return round(100 * sum(each["share"] * each["rays"] for each in bins) / sum(each["rays"] for each in bins))

    return f"""Each recorded car is fitted from other frames and put back where it stood: {figures["vehicles"]} vehicles, {figures["parked"]} parked, {figures["frames"]} frames. Figures are medians
over vehicles of absolute differences from the recording (95 %, bootstrap).

""" + table(head, rows) + commands(made) + f"""
Replacing a recorded car by its fit changes the logit no more than going on to the next frame does. Found or not (IoU 0.7) turns in {told(bars["found"])} % of frames, seen or not
(0.1) in {told(bars["seen"])} %: the error bar of every rate here.

Black paint loses {lost([0, 0.05])} % of its rays, bright paint {lost([0.5, 1.01])} %. `as-recorded`, fitted to these cars, gives {as_recorded} of the returns below the
windows, `unit` {unit}. Neither is right car by car.
"""


def speed(source):
    """Of one insertion, of a vehicle's step, of a picture from Python."""
    made = stored(source, "bench")
    figures = made["figures"]
    rows = [["both sensors, occlusion, forward + VJP", f"{figures['insertion_ms_10m_sigma_1e-5']:.2f}"],
            ["copying its picture and sweep", f"{figures['insertion_copy_image_ms'] + figures['insertion_copy_sweep_ms']:.2f}"]]
    text = table(["one insertion at 10 m", "ms"], rows) + "\n"
    rows = [[f"`{name}`", f"{figures[at + '_full']:.0f}", f"{figures[at]:.0f}", f"{figures['attack_step_speedup_' + name]:.1f}"]
            for name, at in ((name, "attack_step_ms_" + name) for name in ("lidar", "fusion", "late"))]
    text += table(["a vehicle's step", "whole, ms", "what the object changes, ms", "times faster"], rows) + "\n"
    rows = []
    for picture, size in (("crop", "128×128"), ("full", "375×1242")):
        for sigma in ("1e-5", "1e-4") if picture == "full" else ("1e-5",):
            at = f"python_rasterize_{picture}_{sigma}_"
            rows.append([size, sigma, *(f"{figures[at + key]:.2f}" for key in ("module_kernel_ms", "module_cpp_ms", "module_ms", "pytorch3d_ms"))])
    return text + table(["picture and VJP", "σ", "kernel, ms", "C++, ms", "`mirage.rasterize`, ms", "`mirage.pytorch3d`, ms"], rows) + commands(made)


def fleet(source):
    """Processor time of each command."""
    made = stored(source, "fleet")
    rows = [[f"`{name}`" + (", 1000 steps of 8" if name == "attack" else ""), f"{made['figures']['fleet_cpu_s_per_1000_' + name]:.0f}"]
            for name in ("generate", "fit", "detect", "audit", "evaluate", "certify", "validate", "attack")]
    return table(["command", "seconds"], rows) + commands(made)


def zoo(source):
    """The shipped objects (scenes/objects/zoo.json, which `mirage zoo` writes): {objects, command}."""
    with open(os.path.join(source, "scenes", "objects", "zoo.json"), encoding="utf-8") as file:
        return json.load(file)


def sayings(source):
    """{page: texts that it must hold}: figures of a table that is not made here."""
    def share(of, count=""):
        return f"| {100 * of['value']:.0f} %{count} | {100 * of['low']:.0f}–{100 * of['high']:.0f} % |"

    matched = stored(source, "validate-kitti")["matched"]
    rows = {row["label"]: row for row in experiment(source, "table1")["rows"]}
    sized = rows["fusion, random mesh of its size"]
    gap = stored(source, "drive-KITTI-fusion-real-learned")["drive"]["gap_s"]
    lost = gap["attacked"]
    insertion_ms = stored(source, "bench")["figures"]["insertion_ms_10m_sigma_1e-5"]
    recorded_made, defences_made = experiment(source, "fusions-real"), experiment(source, "table4")
    recorded_cars = next(row for row in recorded_made["rows"] if row["target"] == "fusion" and row["source"] == "fusion, both")
    by_defence = {option(row): row for row in defences_made["rows"]}
    bare, best = by_defence["none"], by_defence["`adversarial+shadows`"]["values"]["asr"]
    return {"README.md": (
        share(recorded_cars["values"]["vanished"], f" of {recorded_made['found'][recorded_cars['case']]}"),
        f"| from {100 * bare['values']['asr']['value']:.0f} to {100 * best['value']:.0f} % | {100 * best['low']:.0f}–{100 * best['high']:.0f} % |",
        f"| {matched['hit_disagreements']} of {grouped(matched['rays'])} rays differ |",
        share(bare["values"]["vanished"], f" of {grouped(defences_made['found'][bare['case']])}"), share(sized["values"]["vanished"]),
        f"recorded cars are lost for {lost['value']:.1f} s ({lost['low']:.1f}–{lost['high']:.1f}), with a random object for {gap['random']['value']:.1f} s",
        share(certificate(source)["lattice_iou70"]), f"| {insertion_ms:.0f} ms on one core |")}


TABLES = {"detectors": detectors, "recorded": recorded, "gradients": gradients, "real_to_sim": real_to_sim, "depth": depth, "roofs": roofs,
          "certificates": certificates, "certified": certified, "insertion": insertion, "agreement": agreement, "rays": rays, "speed": speed, "matched": matched, "success": success, "transfer": transfer, "sides": sides, "real_frames": real_frames,
          "light_models": light_models, "defences": defences, "worth": worth, "fleet": fleet,
          "sizes": sizes, "parts": parts, "workshop": workshop, "where": where, "cubes": cubes}


def cells(title, said, left, columns, rows):
    """Rows down, columns across: a figure, its interval below, the darker the more. A row is (name, [cell]); a cell is None or (share
    of the darkest shade, text, interval, whether it is framed). `said`: the line above, for who reads; `title`: for who listens."""
    top, wide, high = 52, 92, 36
    out = [f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {left + wide * len(columns) + 10} {top + high * len(rows) + 10}" '
           f'font-family="sans-serif" font-size="13" role="img"><title>{escape(title)}</title>'
           f'<rect width="100%" height="100%" fill="#fff"/><text x="10" y="18" font-weight="bold">{escape(said)}</text>']
    for k, name in enumerate(columns):
        out.append(f'<text x="{left + wide * (k + 0.5):.0f}" y="{top - 8}" text-anchor="middle" font-size="12">{escape(name)}</text>')
    for i, (name, values) in enumerate(rows):
        y = top + high * i
        out.append(f'<text x="{left - 8}" y="{y + 22}" text-anchor="end">{escape(name)}</text>')
        for k, value in enumerate(values):
            if value is None:
                continue
            share, text, interval, framed = value
            shade = min(1, max(0, share))
            fill = "#" + "".join(f"{round(255 + shade * (end - 255)):02x}" for end in (0xB7, 0x1C, 0x1C))
            ink = "#fff" if shade > 0.55 else "#222"
            x = left + wide * k
            edge = ' stroke="#222" stroke-width="2"' if framed else ""
            out.append(f'<rect x="{x + 2}" y="{y + 2}" width="{wide - 4}" height="{high - 4}" fill="{fill}"{edge}/>'
                       f'<text x="{x + wide / 2:.0f}" y="{y + 17}" text-anchor="middle" fill="{ink}">{escape(text)}</text>'
                       f'<text x="{x + wide / 2:.0f}" y="{y + 30}" text-anchor="middle" font-size="10" fill="{ink}">{escape(interval)}</text>')
    return "\n".join(out) + "\n</svg>\n"


def objects(made):
    """Shares that vanish: objects down, detectors across; framed where an object was learned against the detector."""
    judged = [each for each in made["objects"] if each.get("judged_by")]
    columns = [name for name in DETECTORS if any(name in each["judged_by"] for each in judged)]

    def cell(each, name):
        share = each["judged_by"].get(name)
        if share is None:
            return None
        framed = each["vanished"]["detector"] == name and each["kind"] == "learned"
        return share["value"] / 0.5, percent(share["value"]), between(share), framed

    return cells("Cars that vanish by each detector under each object", "Cars that vanish (%, 95 % below): objects down, detectors across",
                 150, columns, [(each["name"], [cell(each, name) for name in columns]) for each in judged])


def audits(source, names):
    """What each wrong input costs each detector, points of AP 0.7: changes down, detectors across."""
    results = {name: stored(source, file) for name, file in names.items()}
    changes = {}
    for name, result in results.items():
        for row in result["audit"]:
            changes.setdefault((row["input"], row["change"]), {})[name] = row

    def cell(row):
        if row is None:
            return None
        if "refused" in row:
            return 0, "refuses", "", False
        return row["drop"], percent(row["drop"]), between(row), False

    sides = ("picture", "points", "calibration")
    rows = sorted(changes.items(), key=lambda item: sides.index(item[0][0]))
    return cells("What each wrong input costs each detector", "AP 0.7 that each wrong input costs (points, 95 % below)", 230,
                 list(results), [(f"{side}: {change}", [cell(of.get(name)) for name in results]) for (side, change), of in rows])


def grades(result):
    """Objects of each level down, distances across: at most how many cars vanish, and whether the level holds."""
    score = result["score"]
    bands = [f"{near:g}–{far:g} m" for near, far in zip(score["bands"], score["bands"][1:])]

    def cell(each):
        if not each["vehicles"]:
            return 0, "no cars", "", False
        return each["at_most"] / 0.5, "≤ " + percent(each["at_most"]), each["held"], False

    return cells("What grade has this detector?", f"Cars that vanish at most (%, 95 %): {score['detector']}, grade {score['grade']}", 260,
                 bands, [(row["name"], [cell(each) for each in row["cells"]]) for row in score["rows"]])


def plot(title, rows, low=0, high=1, tick=0.25):
    """Shares or their differences with intervals, a row each: (name, value, low, high). Text is the reader's colour."""
    height, left, width = 26, 170, 420
    x = lambda share: left + (share - low) / (high - low) * width
    out = [f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {left + width + 70} {height * (len(rows) + 2)}" font-family="sans-serif" '
           f'font-size="13" role="img"><title>{escape(title)}</title><rect width="100%" height="100%" fill="#fff"/>']
    for k in range(round((high - low) / tick) + 1):
        at_tick = low + k * tick
        out.append(f'<path d="M{x(at_tick):.1f} {height}V{height * (len(rows) + 1)}" stroke="{"#888" if low < 0 and abs(at_tick) < 1e-9 else "#ccc"}"/>'
                   f'<text x="{x(at_tick):.1f}" y="{height * (len(rows) + 1) + 16}" text-anchor="middle">{f"{100 * at_tick:.0f}".replace("-", "−") + ("" if low < 0 else " %")}</text>')
    out.append(f'<text x="10" y="16" font-weight="bold">{escape(title)}</text>')
    for i, (name, value, least, most) in enumerate(rows):
        y = height * (i + 1.5)
        out.append(f'<text x="{left - 8}" y="{y + 4:.1f}" text-anchor="end">{escape(name)}</text>'
                   f'<path d="M{x(max(low, least)):.1f} {y:.1f}H{x(min(high, most)):.1f}" stroke="#3949ab" stroke-width="2"/>'
                   f'<circle cx="{x(value):.1f}" cy="{y:.1f}" r="4.5" fill="#3949ab"/>'
                   f'<text x="{x(min(high, most)) + 8:.1f}" y="{y + 4:.1f}">{percent(value)}</text>')
    return "\n".join(out) + "\n</svg>\n"


def regressions(result):
    """What the second detector loses more than the first, by part."""
    compared = result["compare"]
    first, second = compared["detectors"]
    rows = [(f"{os.path.basename(part['name']) or 'all'} ({part['vehicles']})", *(part["difference"][key] for key in ("value", "low", "high")))
            for part in compared["parts"] if part["by"] in ("all", "object", "range", "occlusion") and part["vehicles"] >= 10]
    return plot(f"Cars that vanish: {second} less {first} (points, 95 %)", rows, -0.2, 0.2, 0.1)


def seconds(source):
    """Longest gaps of detection: what was driven down, versions across."""
    folder = os.path.join(source, RESULTS)
    rows = []
    for file in sorted(name for name in os.listdir(folder) if name.startswith("drive-")):
        result = stored(source, file[:-5])
        gaps = result["drive"]["gap_s"]
        cells_of = []
        for version in ("clean", "attacked", "random", "attacked_less_clean", "attacked_less_random"):
            value, low, high = (f"{round(gaps[version][key], 1) + 0.0:.1f}".replace("-", "−") for key in ("value", "low", "high"))
            cells_of.append((gaps[version]["value"] / 2, value, f"{low} to {high}", False))
        rows.append((file[len("drive-"):-5].replace("-", " "), cells_of))
    return cells("For how long is a car lost?", "Longest time without a detection, s: median over vehicles, 95 % below", 260,
                 ["recorded", "object", "random", "added", "over random"], rows)


def placements(result):
    """Where one cubic metre hurts most: places down, detectors across, net of a random mesh of the size."""
    detectors = list(dict.fromkeys(row["detector"] for row in result["rows"]))
    places = list(dict.fromkeys(row["place"] for row in result["rows"]))
    found = {(row["place"], row["detector"]): row for row in result["rows"]}
    whats = (("vanished", "hidden"), ("phantom", "phantom"))

    def cell(place, detector, what):
        if (place, detector) not in found:
            return None
        row = found[place, detector]
        of = row[what]
        return of["value"] / 0.3, signed(of["value"]), between(of), (what == "phantom") == (row["victim"] == "phantom")

    return cells("Where does one cubic metre hurt most?",
                 "One cubic metre: vehicles hidden, or with a phantom (points net of size, 95 %)",
                 150, [f"{detector} {said}" for detector in detectors for _, said in whats],
                 [(place, [cell(place, detector, what) for detector in detectors for what, _ in whats]) for place in places])


def plots(source):
    """{path: text}"""
    rows = [(name, result["ap70"], result["ap70_interval"]["low"], result["ap70_interval"]["high"])
            for name, result in detections(source, "kitti").items()]
    made = {"detectors": plot("AP 0.7 on 44 KITTI frames, 95 %", rows),
            "objects": objects(zoo(source)),
            "audits": audits(source, {name: f"audit-generated-{name}" for name in DETECTORS}),
            "placements": placements(stored(source, "placements")["figures"]),
            "seconds": seconds(source),
            "grades": grades(stored(source, "score-fusion")),
            "regressions": regressions(stored(source, "compare-fusion-refined"))}
    return {os.path.join(RESULTS, name + ".svg"): text for name, text in made.items()}


def written(source):
    """{path: text} of every page with blocks and of every plot."""
    files = plots(source)
    for folder in ("", "src", os.path.join("src", "guide")):
        for name in sorted(os.listdir(os.path.join(source, folder))):
            path = os.path.join(folder, name)
            if not name.endswith(".md"):
                continue
            with open(os.path.join(source, path), encoding="utf-8") as file:
                text = file.read()
            if BLOCK.search(text):
                files[path] = BLOCK.sub(lambda m: m[1] + "\n" + TABLES[m[2]](source) + "\n" + m[3], text)
    return files


def fields(result, words):
    """Of an object what "a,b[c,d]" names: a as it is, and of b, an object or a list of them, c and d."""
    out = {}
    for key, _, inner in re.findall(r"(\w+)(\[((?:[^\[\]]|\[[^\[\]]*\])*)\])?", words):
        if key in result:
            of = result[key]
            out[key] = of if not inner else fields(of, inner) if isinstance(of, dict) else [fields(each, inner) for each in of]
    return out


def keep(source, name, file, keys, command):
    with open(file, encoding="utf-8") as opened:
        result = json.load(opened)
    said = result.get("provenance", {})
    out = {key: said[key] for key in ORIGIN if key in said}
    if command:
        out.update(command=command, **{key: result[key] for key in ("commit", "date") if key in result})
        out.setdefault("date", datetime.date.fromtimestamp(os.path.getmtime(file)).isoformat())
    if command and "figures" not in result:
        result = {"figures": {key: value for key, value in result.items() if key not in out}}
    for key in keys:
        if "[" in key:
            result[key.split("[")[0]]  # or there is none
            out.update(fields(result, key))
            continue
        head, _, rest = key.partition(".")
        if rest:
            out.setdefault(head, {})[rest] = at(result, key)
        else:
            out[key] = result[key]
    for pattern, place in PLACES:
        out["command"] = re.sub(pattern, place, out["command"])
    store(source, name, out)


def built_commit(source):
    """Of the programs that a command in SOURCE runs (src/packaging/commit.cmake)."""
    path = os.path.join(source, "build", "release", "mirage.commit")
    if not os.path.exists(path):
        raise Missing(f"{path}: no such file; build first")
    with open(path, encoding="utf-8") as file:
        return file.read().strip()


# Where a command's own folders lie is nobody's business: what a reader puts in their place.
PLACES = ((r"--(data|real) \S*shared/kitti\b", r"--\1 path/to/kitti"), (r"--(run|data) paper/", r"--\1 out/reproduce/"), (r"--data /\S*/([\w-]+)", r"--data out/\1"),
          (r"--(run|place|data) ev/", r"--\1 out/"), (r"--mesh \S*/(scenes/\S+)", r"--mesh \1"),
          (r" --weights /\S+", ""), (r" --out \S+", ""), (r" --(?:quiet|threads \d+|pictures 0)\b", ""))


def keep_lines(source, name, pattern, command):
    origin = {"command": command, "commit": built_commit(source), "date": datetime.date.today().isoformat()}
    ran = subprocess.run(command, shell=True, cwd=source, capture_output=True, text=True, check=True)
    store(source, name, {**origin, "lines": [line for line in ran.stdout.splitlines() if re.search(pattern, line)]})


def store(source, name, result):
    os.makedirs(os.path.join(source, RESULTS), exist_ok=True)
    with open(os.path.join(source, RESULTS, name + ".json"), "w", encoding="utf-8") as file:
        json.dump(result, file, indent=1, ensure_ascii=False)
        file.write("\n")


def main(source, *arguments):
    if arguments[:1] == ("--keep",):
        name, file, *keys = arguments[1:]
        command = " ".join(keys[keys.index("--") + 1:]) if "--" in keys else ""
        keep(source, name, file, keys[:keys.index("--")] if "--" in keys else keys, command)
        return 0
    if arguments[:1] == ("--keep-lines",):
        name, pattern, _, *command = arguments[1:]
        keep_lines(source, name, pattern, " ".join(command))
        return 0
    wrong = 0
    for path, texts in sayings(source).items():
        with open(os.path.join(source, path), encoding="utf-8") as file:
            page = file.read()
        for text in texts:
            if text not in page:
                print(f"{path}: does not say {text}, as {RESULTS} does; correct it")
                wrong = 1
    for path, text in written(source).items():
        full = os.path.join(source, path)
        before = open(full, encoding="utf-8").read() if os.path.exists(full) else ""
        if arguments == ("--check",):
            if before != text:
                print(f"{path}: is not what {RESULTS} holds; run make evidence")
                wrong = 1
        elif before != text:
            with open(full, "w", encoding="utf-8") as file:
                file.write(text)
            print(path)
    return wrong


if __name__ == "__main__":
    try:
        sys.exit(main(*sys.argv[1:]))
    except Missing as missing:
        sys.exit(str(missing))
