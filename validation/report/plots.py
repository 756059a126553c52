"""The page's plots, each from result.json; None where the data are missing."""

import charts

SHOWN = {"soft": "soft rasteriser", "hard": "hard rasteriser", "cycles": "full Cycles"}


def percent(value):
    return f"{100 * value:.1f} %"


def interval_text(share):
    return f"{percent(share['value'])} ({percent(share['low'])}–{percent(share['high'])})"


LIGHT = {"learned": "as learned", "raster": "rasteriser", "visible": "visible light", "cycles": "Cycles"}


def arms(verdict, raster_alone):
    """Attack success by who drew the object and which returns met it; with a detector that uses no picture the first alone."""
    chosen = [arm for arm in verdict["arms"] if not raster_alone or arm["light"] in ("learned", "raster")]
    if not chosen:
        return None
    kinds = {"learned": "raster", "raster": "raster", "cycles": "cycles"}
    name = lambda arm: LIGHT[arm["light"]] + ("" if arm["light"] == "learned" else f", {arm['returns']}")
    rows = [(name(arm), kinds.get(arm["light"], "rung"), arm["asr"]["value"], arm["asr"]["low"],
             arm["asr"]["high"], f"{name(arm)}: ASR {interval_text(arm['asr'])}, "
             f"{arm['vehicles']} vehicles") for arm in chosen]
    high = min(1.0, max(0.1, max(row[4] for row in rows) * 1.1))
    return charts.intervals("Attack success by light and returns", rows, "attack success rate (95 % interval)", high)


def scores(verdict, titles):
    """Detector score under the rasteriser against the score under Cycles. `titles`: of the vehicles, by name."""
    flipped = {flip["name"] for flip in verdict["flips"]}
    points = [("bad" if pair["name"] in flipped else "held" if pair["split"] == "test" else "rung", pair["soft"],
               pair["cycles"], f"{titles[pair['name']]}: rasteriser {pair['soft']:.3f}, Cycles {pair['cycles']:.3f}")
              for pair in verdict["pairs"] if pair["detected"]]
    points.sort(key=lambda point: ("rung", "held", "bad").index(point[0]))
    if not points:
        return None
    return charts.scatter("Score under the rasteriser against score under Cycles", points,
                          "score, soft rasteriser", "score, full Cycles", (-0.02, 1.02), (-0.02, 1.02), diagonal=True)


def ladder(result):
    rungs = [rung for rung in result["ladder"] if rung["effect"] != rung["base"]]
    if not rungs:
        return None
    rows = [(rung["effect"], rung["group"], rung["relative"],
             f"{rung['effect']}: {percent(rung['relative'])} of radiance, SSIM {rung['ssim']:.3f}, "
             f"FLIP {rung['flip']:.3f}, {rung['seconds']:.2f} s, {rung['vehicles']} vehicles") for rung in rungs]
    return charts.bars("What each effect changes", rows, "mean change, share of the object's radiance", charts.percent)


def remaining(result):
    """The remaining error of each rung against full Cycles without noise, and the band of noise alone."""
    rungs = result["ladder"]
    if not rungs:
        return None
    rows, bands = [], []
    for rung in rungs:
        share = rung["interval"]
        rows.append((rung["effect"], rung["group"], share["value"], share["low"], share["high"],
                     f"{rung['effect']}: {interval_text(share)} without noise, {percent(rung['error_plain'])} with it"))
        bands.append((rung["floor"], f"{rung['effect']}: noise alone makes {percent(rung['floor'])}"))
    low = min(0, min(row[3] for row in rows))
    high = max(max(row[4] for row in rows), max(rung["floor"] for rung in rungs))
    return charts.intervals("What each rung leaves to full Cycles", rows, "error to full Cycles without noise, share of radiance",
                            1.06 * high, 1.06 * low, bands)


def ladder_cost(result):
    """Remaining error of the picture as drawn, its own noise included, against cost."""
    rungs = [rung for rung in result["ladder"] if rung["error_drawn"] > 0 and rung["seconds"] > 0]
    if len(rungs) < 3:
        return None
    costs, errors = [r["seconds"] for r in rungs], [r["error_drawn"] for r in rungs]
    points = [(r["group"], r["seconds"], r["error_drawn"],
               f"{r['effect']}: {percent(r['error_drawn'])} from full Cycles at {r['seconds']:.3g} s")
              for r in rungs]
    return charts.scatter("Error against full Cycles over cost", points, "time a vehicle, s",
                          "error as drawn, share of radiance", (*charts.around(costs, True), "log"),
                          (0, max(errors) * 1.08), front=front(list(zip(costs, errors))), size=(560, 340))


def front(points):
    """The points that no other point beats in both values, by cost; drawn as a step curve."""
    kept = []
    for cost, error in sorted(points):
        if not kept or error < kept[-1][1]:
            kept.append((cost, error))
    stairs = kept[:1]
    for (_, before), (cost, error) in zip(kept, kept[1:]):
        stairs += [(cost, before), (cost, error)]
    return stairs


def recall(evaluation):
    curve = (evaluation or {}).get("recall_iou")
    if not curve:
        return None
    series = [("clean", "as recorded", curve["iou"], curve["clean"]),
              ("raster", "attacked", curve["iou"], curve["attacked"])]
    random = (evaluation.get("random") or {}).get("recall_iou")
    if random:
        series.insert(1, ("rung", "random mesh", random["iou"], random["attacked"]))
    return charts.curves("Recall over IoU", series, "IoU asked for", "share of vehicles found", (0, 1), (0, 1.02),
                         rule=evaluation["detected_iou"])


def loss(curve):
    if not curve:
        return None
    return charts.curves("Loss over iterations", [("raster", f"mean of {curve['window']}", curve["iteration"],
                                                   curve["loss"])], "iteration", "loss")


SENSORS = {"camera": "Camera", "lidar": "LiDAR", "depth": "Depth completion", "cycles": "Cycles"}
PARETO = [("camera", "image_levels", "mean image error, 8-bit levels"),
          ("camera", "gradient", "1 − cosine to finite differences"),
          ("lidar", "range_error_m", "mean range error, m"), ("depth", "rmse_mm", "depth RMSE, mm"),
          ("cycles", "image_levels", "mean image error, 8-bit levels")]


def pareto(tradeoff):
    """[(title, SVG)]: error against time for each group of settings, with the front."""
    plots = []
    for group, key, label in PARETO:
        points = [point for point in (tradeoff or {}).get("points", []) if point["group"] == group and
                  (point.get("errors", {}).get(key) or 0) > 0 and point.get("ms", 0) > 0]
        if len(points) < 3:
            continue
        times, errors = [p["ms"] for p in points], [p["errors"][key] for p in points]
        dots = [("front" if key in p.get("front", ()) else "rung", p["ms"], p["errors"][key],
                 f"{p['axis']}, {p['label']}: {p['ms']:.3g} ms, {p['errors'][key]:.3g}") for p in points]
        dots.sort(key=lambda dot: dot[0] == "front")
        line = sorted((p["ms"], p["errors"][key]) for p in points if key in p.get("front", ()))
        plots.append((f"{SENSORS.get(group, group)}: {label}",
                      charts.scatter(f"{group}: {label} over time", dots, "time, ms", label,
                                     (*charts.around(times, True), "log"), (*charts.around(errors, True), "log"),
                                     front=line, size=(560, 320))))
    return plots
