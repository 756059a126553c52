"""Writes the fidelity report of `mirage validate`: one self-contained HTML file; with --sign-off one A4 page to file, too.

    python3 report.py --validation DIR --run RUN [--evaluation result.json] [--tradeoff result.json] [--viewer FILE.js] [--sign-off]

Reads DIR/result.json, DIR/hosts/*.json, DIR/pictures/*.png, RUN/loss.csv, RUN/adversary.glb, and what `mirage evaluate`
and `mirage tradeoff` wrote; `--viewer` is model-viewer's module. Writes DIR/report.html, with --sign-off DIR/sign-off.html, and nothing else. It shows the
program's own judgements. Missing data are left out of the page, never made up.
"""

import argparse
import math
import os
import sys

HERE = os.path.dirname(os.path.abspath(__file__))
sys.dont_write_bytecode = True
sys.path.insert(0, HERE)

try:
    from markupsafe import Markup

    import atomic
    import figures
    import pictures
    import plots
except ImportError as error:
    sys.exit(f"report.py: {error.name}: not installed; install python3-jinja2 and python3-pil")

PICTURED_HOSTS = 12  # vehicles shown with pictures; the table holds all
PICTURED_FLIPS = 12
NAMED_HIDDEN = 12  # vehicles that the page to sign names
OBJECTS = {"learned": "this object", "start": "a random mesh", "sized": "a random mesh of its size", "ellipsoid": "an ellipsoid that fills the box",
           "cuboid": "a cuboid that fills the box"}  # arms of mirage evaluate
BANDS = ((0, 15), (15, 30), (30, 50), (50, math.inf))  # m, those of mirage evaluate
NO_VIEWER = ("model-viewer was not there when Mirage was built. Build once with the npm registry in reach, then run "
             "mirage validate again: finished vehicles are kept.")


def viewer_script(path):
    """model-viewer's module, made safe inside a <script>; None without one."""
    if not path or not os.path.isfile(path):
        return None
    with open(path, encoding="utf-8") as file:
        return Markup(file.read().replace("</script", "<\\/script").replace("<!--", "<\\!--"))


def model_uri(path):
    if not os.path.isfile(path):
        return None
    with open(path, "rb") as file:
        return pictures.data_uri(file.read(), "model/gltf-binary")


def arms(result):
    """{(light, returns): place in verdict.arms}, of arms that hold a vehicle."""
    return {(arm["light"], arm["returns"]): index for index, arm in enumerate(result["verdict"]["arms"])}


def objects(result):
    """[(name, place of its success)] in the evaluation: this object's, and its controls'."""
    found = result["beside"].get("evaluation", {}).get("arms", [])
    return [(OBJECTS[arm["name"]], f"beside.evaluation.arms.{index}.asr") for index, arm in enumerate(found)
            if arm["name"] in OBJECTS]


def flips_of(result, titles, folder):
    """Vehicles whose outcome flips."""
    crop = lambda flip, name: pictures.pixels(os.path.join(folder, flip["pictures"][name]))
    return [{**flip, "index": index, "title": titles[flip["name"]], "raster": crop(flip, "raster_crop"), "cycles": crop(flip, "cycles_crop")}
            for index, flip in enumerate(result["verdict"]["flips"][:PICTURED_FLIPS])]


def words(result):
    """The page's words for the clean frame and for the judged thing."""
    if figures.judges_object(result):
        return {"recorded": "with a plain cuboid", "without": "with a plain cuboid in the object's place", "judged": "the object"}
    return {"recorded": "as recorded", "without": "without the object", "judged": "the vehicle"}


def host_view(result, index, host):
    return {"index": index, "name": host["name"], "title": figures.title(result, host), "raster": figures.outcome(host, "raster"),
            "cycles": figures.outcome(host, "cycles")}


def pictured_view(result, folder, index, host):
    scenes, seen, called = pictures.triptych(folder, host), "picture_boxes" in host, words(result)
    return {**host_view(result, index, host), "scenes": scenes, "crops": pictures.crops(folder, host), "seen": seen,
            "maps": pictures.in_picture(host, scenes, called) if seen else pictures.bev(host, called)}


def judged(result, host):
    """Whether the verdict covers the vehicle: it was held out, or no vehicle was."""
    split = {pair["name"]: pair["split"] for pair in result["verdict"]["pairs"]}
    return result["verdict"]["of"] != "held_back" or split.get(host["name"]) == "test"


def speaks_against(result):
    """Sentences on limitations of the figures above, in words of the report."""
    lines = []
    if result.get("hosts_trained_on"):
        held_back = result["verdict"]["of"] == "held_back"
        lines.append(f"The attack was learned on {result['hosts_trained_on']} of these {result['verdict'][result['verdict']['of']]['vehicles']} "
                     f"{'held-back vehicles, in other frames of their drive' if held_back else 'vehicles, in these frames or in others'}.")
    for key, sentence in (("failed", "Blender was lost on {}, in no figure: {}."), ("unseen", "No camera shows the object on {}, in no figure: {}.")):
        names = [one["name"] if key == "failed" else one for one in result.get(key, [])]
        if names:
            more = f" and {len(names) - NAMED_HIDDEN} more" if len(names) > NAMED_HIDDEN else ""
            lines.append(sentence.format(f"{len(names)} vehicle{'s' if len(names) != 1 else ''}", ", ".join(names[:NAMED_HIDDEN]) + more))
    for channel, sensor in (("image", "camera"), ("lidar", "LiDAR")):
        if result["verdict"]["vacuous"][channel]:
            lines.append(f"Vacuous for the {sensor}: with the object taken out of it no vehicle's outcome changes, so what it sees says nothing.")
    if result.get("evaluation_differences"):
        lines.append(f"The evaluation used other settings: {'; '.join(result['evaluation_differences'])}.")
    return lines


def by_distance(hosts):
    """[{name, found, raster, cycles}]: vehicles found clean, and hidden by each way of drawing, a band of distance. Returns are realistic,
    as in the headline."""
    rows = []
    for low, high in BANDS:
        of = [host for host in hosts if low <= host["range"] < high and host["detected"]]
        name = f"{low}\u2013{high} m" if math.isfinite(high) else f"{low} m and more"
        rows.append({"name": name, "found": len(of), **{key: sum(figures.realistic(host, key)["hidden"] for host in of) for key in ("raster", "cycles")}})
    return rows


def untested(result):
    """Sentences: properties that a reader might wrongly take for tested."""
    cameras = f"these {len(result['cameras'])} cameras" if "cameras" in result else "one front camera"
    lines = ["A physical object: material, mounting and weather are simulated.",
             "What a tracker makes of the missed frames: each frame was judged alone.",
             f"Sensors other than {cameras} and one LiDAR; light other than the recorded sky and sun."]
    if result["test_frames"] < result["frames"]:
        lines.insert(0, f"{result['frames'] - result['test_frames']} of the {result['frames']} frames: the attack was learned on them.")
    if OBJECTS["sized"] not in dict(objects(result)):
        lines.insert(0, "A random object of the same size: give --evaluation.")
    return lines


def sign_off(environment, hosts):
    """The page to sign, of the environment that page() filled."""
    result, nearest = environment.globals["result"], environment.globals["hosts"]
    hidden = lambda host: host["detected"] and judged(result, host) and figures.realistic(host, "cycles")["hidden"]
    return environment.get_template("sign_off.html.j2").render(
        bands=by_distance([host for host in hosts if judged(result, host)]), hidden=[host for host in nearest if hidden(hosts[host["index"]])],
        named=NAMED_HIDDEN, untested=untested(result), against=speaks_against(result),
        style=figures.asset(HERE, "a4.css"))


def page(environment, result, hosts, folder, model, viewer, origin, signed):
    fig = figures.figure_function(result, origin)
    beside, verdict = result["beside"], result["verdict"]
    note = result["reliance"]["note"]  # replaces statements about images
    # Those that vanish under Cycles first, then those that are misplaced, then those that the detector finds, the nearest first.
    seen = ["vanished", "misplaced", "found", "not found clean"]
    order = sorted(range(len(hosts)), key=lambda i: ([seen.index(figures.outcome(hosts[i], key)[0])
                                                      for key in ("cycles", "raster")], hosts[i]["range"]))
    titles = {host["name"]: figures.title(result, host) for host in hosts}
    nearest = [{**host_view(result, i, hosts[i]), "learned_on": not judged(result, hosts[i])} for i in sorted(range(len(hosts)), key=lambda i: hosts[i]["range"])]
    environment.globals.update(
        result=result, fig=fig, interval=figures.interval_function(result, fig), group=verdict["of"], shown=plots.SHOWN,
        arms=arms(result), checks=figures.targets(result), made_of=figures.made_of(result), objects=objects(result), flips=flips_of(result, titles, folder),
        words=words(result), note=note, light_names=plots.LIGHT, tradeoff=beside.get("tradeoff"), pareto=plots.pareto(beside.get("tradeoff")),
        viewer_missing=NO_VIEWER, model=model, signed=signed,
        plots={"loss": plots.loss(beside.get("loss")), "recall": plots.recall(beside.get("evaluation")),
               "success": plots.arms(verdict, bool(note)), "scores": plots.scores(verdict, titles), "ladder": plots.ladder(result),
               "remaining": plots.remaining(result), "ladder_cost": plots.ladder_cost(result)},
        pictured=[pictured_view(result, folder, i, hosts[i]) for i in order[:PICTURED_HOSTS]],
        hosts=nearest, hidden=[host for host in nearest if host["cycles"][1] == "bad"])
    return environment.get_template("page.html.j2").render(style=figures.asset(HERE, "style.css"), script=figures.asset(HERE, "page.js"),
                                                           viewer=viewer)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--validation", required=True)
    parser.add_argument("--run", required=True)
    parser.add_argument("--evaluation")
    parser.add_argument("--tradeoff")
    parser.add_argument("--viewer")
    parser.add_argument("--sign-off", action="store_true")
    options = parser.parse_args()
    folder = options.validation
    result = atomic.read_json(folder, "result.json")
    hosts = [atomic.read_json(folder, "hosts", name + ".json") for name in result["hosts"]]
    hosts = [host for host in hosts if "matched" in host]
    result = figures.gather(result, hosts, figures.loss_curve(os.path.join(options.run, "loss.csv")),
                            atomic.read_json(options.evaluation) if options.evaluation else None,
                            atomic.read_json(options.tradeoff) if options.tradeoff else None)
    environment = figures.templates(HERE)
    text = page(environment, result, hosts, folder, model_uri(os.path.join(options.run, "adversary.glb")),
                viewer_script(options.viewer), figures.origin_function(hosts, options.evaluation, options.tradeoff), options.sign_off)
    atomic.write(os.path.join(folder, "report.html"), text)
    if options.sign_off:
        atomic.write(os.path.join(folder, "sign-off.html"), sign_off(environment, hosts))


if __name__ == "__main__":
    atomic.run(main)
