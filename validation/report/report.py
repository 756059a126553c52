"""Writes the fidelity report of `mirage validate`: one self-contained HTML file.

    python3 report.py --validation DIR --run RUN [--evaluation result.json] [--tradeoff result.json] [--viewer FILE.js]

Reads DIR/result.json, DIR/hosts/*.json, DIR/pictures/*.png, RUN/loss.csv, RUN/adversary.glb, and what `mirage evaluate`
and `mirage tradeoff` wrote; `--viewer` is model-viewer's module. Writes DIR/report.html, and into DIR/result.json the
figures of other files that the page shows (`report_figures`). What is missing is left out of the page, never made up.
"""

import argparse
import json
import os
import sys

HERE = os.path.dirname(os.path.abspath(__file__))
sys.dont_write_bytecode = True
sys.path.insert(0, HERE)

try:
    import jinja2
    from markupsafe import Markup

    import figures
    import files
    import pictures
    import plots
except ImportError as error:
    sys.exit(f"report.py: {error.name}: not installed; install python3-jinja2 and python3-pil")

PICTURED_HOSTS = 12  # vehicles shown with pictures; the table holds all
PICTURED_FLIPS = 12
NO_VIEWER = ("model-viewer was not there when Mirage was built. Build once with the npm registry in reach, then run "
             "mirage validate again: finished vehicles are kept.")


def viewer_script(path):
    """model-viewer's module, fit to stand inside a <script>; None without one."""
    if not path or not os.path.isfile(path):
        return None
    with open(path, encoding="utf-8") as file:
        return Markup(file.read().replace("</script", "<\\/script").replace("<!--", "<\\!--"))


def model_uri(path):
    if not os.path.isfile(path):
        return None
    with open(path, "rb") as file:
        return pictures.data_uri(file.read(), "model/gltf-binary")


def group_of(result):
    """Which part of the verdict the page puts first: held-back vehicles, or all if none was held back."""
    verdict = result.get("verdict", {})
    for name in ("held_back", "all"):
        if verdict.get(name, {}).get("variants"):
            return name
    return "held_back"


def picture_note(result):
    """What stands in place of statements about images (detection/reliance.h); empty if the detector sees."""
    return result.get("reliance", {}).get("note", "")


def percent(arm):
    return f"{100 * arm['asr']['value']:.1f}\u202f%"


def arms(result):
    """{(light, returns): place in verdict.arms}, of arms that hold a vehicle."""
    return {(arm["light"], arm["returns"]): index for index, arm in enumerate(result.get("verdict", {}).get("arms", []))}


def judge(result, group, checks):
    """What the page says in words."""
    missed = [check["name"].split(",")[0] for check in checks if not check["met"]]
    said = {"missed": len(missed), "missed_names": " and ".join(missed), "compared": False, "difference": None,
            "flips": None}
    part = result.get("verdict", {}).get(group, {})
    names = [variant["name"] for variant in part.get("variants", [])]
    if "soft" in names and "cycles" in names:
        soft, cycles = names.index("soft"), names.index("cycles")
        said.update(compared=True, soft=soft, cycles=cycles, flips=len(result["verdict"].get("flips", [])))
        raster, traced = part["variants"][soft]["asr"]["value"], part["variants"][cycles]["asr"]["value"]
        gap = part.get("difference", {}).get("asr")
        if gap:
            said["difference"] = ("none" if gap["low"] <= 0 <= gap["high"] else
                                  "overstates" if gap["value"] > 0 else "understates")
    else:
        raster, traced = result["attack"]["asr_raster"], result["attack"]["asr_cycles"]
    known = {"none": ", no significant difference", "overstates": ", weaker than learned",
             "understates": ", stronger than learned"}.get(said["difference"], "")
    success = f"{100 * traced:.1f}\u202f% in Cycles, {100 * raster:.1f}\u202f% with the rasteriser{known}"
    found = arms(result)
    said["arms"] = {name: index for name, index in found.items()}
    as_learned, real = (result["verdict"]["arms"][found[name]] if name in found else None
                        for name in (("raster", "ideal"), ("cycles", "realistic")))
    if as_learned and real:
        gap = real["difference"]
        known = (", weaker than learned" if gap["high"] < 0 else ", stronger than learned" if gap["low"] > 0 else
                 ", no significant difference")
        success = (f"{percent(real)} in Cycles with realistic returns, {percent(as_learned)} with the rasteriser and ideal "
                   f"ones{known}")
    vacuous = result.get("verdict", {}).get("vacuous", {})
    said["vacuous"] = [name for channel, name in (("image", "camera"), ("lidar", "LiDAR")) if vacuous.get(channel)]
    if said["vacuous"]:
        success += f"; vacuous for the {' and the '.join(said['vacuous'])}"
    if note := picture_note(result):
        success = f"{100 * raster:.1f}\u202f% with the rasteriser; {note}"
        if ("raster", "realistic") in found:
            real = result["verdict"]["arms"][found["raster", "realistic"]]
            success = f"{percent(as_learned)} with the rasteriser, {percent(real)} with realistic returns; {note}"
    correct = "the renderers agree in matched light" if not missed else "correctness in matched light misses a target"
    return {**said, "title": f"Attack success: {success}; {correct}."}


def flips_of(result, folder):
    """Vehicles whose outcome flips, those that have pictures."""
    shown = []
    for index, flip in enumerate(result.get("verdict", {}).get("flips", [])):
        files = flip.get("pictures", {})
        if len(shown) < PICTURED_FLIPS and all(name in files for name in ("raster_crop", "cycles_crop")):
            shown.append({**flip, "index": index, "raster": pictures.pixels(os.path.join(folder, files["raster_crop"])),
                          "cycles": pictures.pixels(os.path.join(folder, files["cycles_crop"]))})
    return shown


def host_view(index, host):
    return {"index": index, "name": host["name"], "raster": figures.outcome(host, "raster"),
            "cycles": figures.outcome(host, "cycles")}


def pictured_view(folder, index, host):
    scenes, seen = pictures.triptych(folder, host), "picture_boxes" in host
    return {**host_view(index, host), "scenes": scenes, "crops": pictures.crops(folder, host), "seen": seen,
            "maps": pictures.in_picture(host, scenes) if seen else pictures.bev(host)}


def page(result, hosts, folder, model, viewer):
    environment = jinja2.Environment(loader=jinja2.FileSystemLoader(HERE), autoescape=True)
    fig = figures.figure_function(result)
    extra, group = result["report_figures"], group_of(result)
    # Those that stay hidden under Cycles first, then those that the detector found, the nearest first.
    order = sorted(range(len(hosts)), key=lambda i: (not hosts[i]["cycles"]["hidden"], not hosts[i]["raster"]["hidden"],
                                                     not hosts[i]["detected"], hosts[i]["range"]))
    environment.globals.update(
        result=result, fig=fig, interval=figures.interval_function(result, fig), group=group, shown=plots.SHOWN,
        verdict=judge(result, group, extra["targets"]), checks=extra["targets"], flips=flips_of(result, folder),
        note=picture_note(result), light_names=plots.LIGHT, tradeoff=extra.get("tradeoff"), pareto=plots.pareto(extra.get("tradeoff")), viewer_missing=NO_VIEWER, model=model,
        plots={"loss": plots.loss(extra.get("loss")), "recall": plots.recall(extra.get("evaluation")),
               "success": plots.arms(result.get("verdict"), bool(picture_note(result))) or
               plots.success(result.get("verdict", {}).get(group)),
               "scores": plots.scores(result.get("verdict")), "ladder": plots.ladder(result),
               "remaining": plots.remaining(result), "ladder_cost": plots.ladder_cost(result)},
        pictured=[pictured_view(folder, i, hosts[i]) for i in order[:PICTURED_HOSTS]],
        hosts=[host_view(i, host) for i, host in enumerate(hosts)])
    environment.globals["swipe"] = environment.get_template("macros.html.j2").module.swipe
    return environment.get_template("page.html.j2").render(style=files.asset(HERE, "style.css"), script=files.asset(HERE, "page.js"), viewer=viewer)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--validation", required=True)
    parser.add_argument("--run", required=True)
    parser.add_argument("--evaluation")
    parser.add_argument("--tradeoff")
    parser.add_argument("--viewer")
    options = parser.parse_args()
    folder = options.validation
    result = figures.read_json(os.path.join(folder, "result.json"))
    hosts = [figures.read_json(os.path.join(folder, "hosts", name + ".json")) for name in result["hosts"]]
    hosts = [host for host in hosts if "matched" in host]
    result = figures.gather(result, hosts, figures.loss_curve(os.path.join(options.run, "loss.csv")),
                            figures.read_json(options.evaluation) if options.evaluation else None,
                            figures.read_json(options.tradeoff) if options.tradeoff else None)
    text = page(result, hosts, folder, model_uri(os.path.join(options.run, "adversary.glb")),
                viewer_script(options.viewer))
    files.write(os.path.join(folder, "report.html"), text)
    files.write(os.path.join(folder, "result.json"), json.dumps(result, indent=2) + "\n")


if __name__ == "__main__":
    files.run(main)
