"""Writes the fidelity report of `mirage validate`: one self-contained HTML file.

    python3 report.py --validation DIR --run RUN [--evaluation result.json]

Reads DIR/result.json, DIR/hosts/*.json, DIR/pictures/*.png, RUN/loss.csv and the evaluation's recall curve; writes
DIR/report.html. What is missing is left out of the report, never made up.
"""

import argparse
import base64
import csv
import io
import json
import math
import os
import sys
import tempfile

try:
    import jinja2
    import matplotlib
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.patches import Polygon
    from PIL import Image
except ImportError as error:
    sys.exit(f"report.py: {error.name}: not installed; install python3-matplotlib, python3-jinja2 and python3-pil")

INK, MUTED, LINE = "#1c2430", "#667085", "#e4e7ec"
CLEAN, ATTACKED, CYCLES, TRUTH = "#2563eb", "#dc2626", "#d97706", "#16a34a"
PICTURED_HOSTS = 12  # vehicles shown with pictures; the table holds all

plt.rcParams.update({
    "font.family": "DejaVu Sans", "font.size": 9, "axes.edgecolor": LINE, "axes.labelcolor": MUTED,
    "xtick.color": MUTED, "ytick.color": MUTED, "axes.spines.top": False, "axes.spines.right": False,
    "axes.grid": True, "grid.color": LINE, "grid.linewidth": 0.7, "axes.axisbelow": True, "svg.fonttype": "path",
    "svg.hashsalt": "mirage",
})


def read_json(path):
    with open(path, encoding="utf-8") as file:
        return json.load(file)


def data_uri(data, kind):
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"


def svg(figure):
    out = io.BytesIO()
    figure.savefig(out, format="svg", bbox_inches="tight", transparent=True, dpi=170, metadata={"Date": None})
    plt.close(figure)
    return data_uri(out.getvalue(), "image/svg+xml")


def photo(path, box=None):
    """A photograph (or a window of it) as JPEG."""
    image = Image.open(path).convert("RGB")
    if box:
        image = image.crop(box)
    out = io.BytesIO()
    image.save(out, "JPEG", quality=88)
    return data_uri(out.getvalue(), "image/jpeg")


def pixels(path, gain=1, least=220):
    """A crop with its pixels kept apart, enlarged by a whole factor, as PNG."""
    image = Image.open(path).convert("RGB")
    if gain != 1:
        image = image.point(lambda value: min(255, value * gain))
    factor = max(1, math.ceil(least / max(image.size)))
    image = image.resize((image.width * factor, image.height * factor), Image.NEAREST)
    out = io.BytesIO()
    image.save(out, "PNG", optimize=True)
    return data_uri(out.getvalue(), "image/png")


def window(host, size):
    """A wide window of the photograph around the vehicle and what stands on it."""
    (l, t, r, b), (cl, ct, cr, cb) = host["host_rect"], host["crop_rect"]
    left, top, right, bottom = min(l, cl), min(t, ct), max(r, cr), max(b, cb)
    width = max(300, 2.4 * (right - left))
    height = max(150, width * 0.45, 1.25 * (bottom - top))
    width = max(width, height / 0.6)
    x, y = (left + right) / 2, (top + bottom) / 2
    x = min(max(x, width / 2), max(width / 2, size[0] - width / 2))
    y = min(max(y, height / 2), max(height / 2, size[1] - height / 2))
    return (int(max(0, x - width / 2)), int(max(0, y - height / 2)), int(min(size[0], x + width / 2)),
            int(min(size[1], y + height / 2)))


def draw_box(axes, box, color, style="-", width=1.6, label=None):
    x, y, length, breadth, yaw = box
    c, s = math.cos(yaw), math.sin(yaw)
    corners = [(dx * length / 2, dy * breadth / 2) for dx, dy in ((1, 1), (-1, 1), (-1, -1), (1, -1))]
    # The page shows `velo` with x upwards and y to the left.
    points = [(-(y + s * a + c * b), x + c * a - s * b) for a, b in corners]
    axes.add_patch(Polygon(points, closed=True, fill=False, ec=color, ls=style, lw=width, label=label))


def bev(host):
    """Points from above with boxes, before and after."""
    view = host["bev"]
    figure, panels = plt.subplots(1, 3, figsize=(10.2, 3.6), sharex=True, sharey=True)
    cases = (("clean", "as recorded", CLEAN), ("raster", "attacked", ATTACKED), ("cycles", "attacked, Cycles", CYCLES))
    for axes, (key, title, color) in zip(panels, cases):
        if view["points"]:
            axes.scatter([-p[1] for p in view["points"]], [p[0] for p in view["points"]], s=0.5, c="#98a2b3", lw=0,
                         rasterized=True)
        if key != "clean" and view["adversary_points"]:
            axes.scatter([-p[1] for p in view["adversary_points"]], [p[0] for p in view["adversary_points"]], s=2,
                         c=ATTACKED, lw=0)
        for box in view["truth"]:
            draw_box(axes, box, TRUTH, (0, (3, 2)), 1.0)
        draw_box(axes, view["host"], TRUTH, "-", 1.4)
        for found in view[key]:
            draw_box(axes, found["box"], color, "-", 2.0)
            axes.annotate(f"{found['score']:.2f}", (-found["box"][1], found["box"][0]), fontsize=7, color=color,
                          ha="center", va="center", annotation_clip=True)
        reach, (x, y) = view["reach"], view["host"][:2]
        axes.set_xlim(-y - reach, -y + reach)
        axes.set_ylim(x - reach, x + reach)
        axes.set_aspect("equal")
        axes.set_title(title, fontsize=9, color=color, loc="left", weight="bold")
        axes.set_xlabel("right of the sensor, m")
    panels[0].set_ylabel("ahead, m")
    figure.tight_layout()
    return svg(figure)


def loss_curve(path):
    """The loss over iterations, with a running mean; None without a readable file."""
    if not os.path.exists(path):
        return None
    with open(path, newline="", encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row.get("loss")]
    if len(rows) < 2:
        return None
    x = [float(row["iteration"]) for row in rows]
    y = [float(row["loss"]) for row in rows]
    span = max(1, len(y) // 20)
    mean, total = [], 0.0
    for i, value in enumerate(y):
        total += value - (y[i - span] if i >= span else 0)
        mean.append(total / min(i + 1, span))
    figure, axes = plt.subplots(figsize=(5.2, 2.9))
    axes.plot(x, y, color=ATTACKED, lw=0.8, alpha=0.3)
    axes.plot(x, mean, color=ATTACKED, lw=1.8, label=f"mean of {span}" if span > 1 else "loss")
    axes.set_xlabel("iteration")
    axes.set_ylabel("loss")
    axes.legend(frameon=False, fontsize=8)
    return svg(figure)


def recall_curve(evaluation):
    curve = (evaluation or {}).get("recall_iou")
    if not curve:
        return None
    figure, axes = plt.subplots(figsize=(5.2, 2.9))
    axes.plot(curve["iou"], curve["clean"], color=CLEAN, lw=1.8, label="as recorded")
    axes.plot(curve["iou"], curve["attacked"], color=ATTACKED, lw=1.8, label="attacked")
    axes.axvline(0.7, color=MUTED, lw=0.8, ls=":")
    axes.set_xlim(0, 1)
    axes.set_ylim(0, 1.02)
    axes.set_xlabel("IoU asked for")
    axes.set_ylabel("share of vehicles found")
    axes.legend(frameon=False, fontsize=8)
    return svg(figure)


def percent(value, digits=1):
    return f"{100 * value:.{digits}f} %"


def headline(result, evaluation):
    matched, attack, full = result["matched"], result["attack"], result["full"]
    found = attack["detected_clean"]
    cards = [
        ("Hidden under Cycles", f"{attack['hidden_cycles']} of {found}",
         f"{attack['hidden_raster']} with the rasteriser, {attack['hidden_both']} with both"),
        ("ASR, Cycles", percent(attack["asr_cycles"]), f"rasteriser {percent(attack['asr_raster'])}"),
        ("Matched light: mask IoU", f"{matched['mask_iou']:.6f}",
         f"over {matched['pixels']:,.0f} pixels; worst vehicle {matched['mask_iou_worst']:.6f}"),
        ("Matched light: mean error", f"{matched['mae']:.1e}",
         f"scene-linear; {matched['pixels_off']} pixels off by more than 1e-3"),
        ("LiDAR against Blender's rays", f"{1e6 * matched['range_error_m']:.1f} µm",
         f"largest range error; {matched['hit_disagreements']} disagreements in {matched['rays']:,} rays"),
        ("Full light against rasteriser", percent(full["relative"]),
         f"of radiance; SSIM {full['ssim']:.3f}, FLIP {full['flip']:.3f}"),
    ]
    if evaluation and "asr" in evaluation:
        cards.insert(0, ("ASR on all test vehicles", percent(evaluation["asr"]),
                         f"FN {percent(evaluation['fn_asr'])}, FP {percent(evaluation['fp_asr'])}, "
                         f"{evaluation['vehicles']} vehicles"))
    return cards


def verdict(host, key):
    if not host["detected"]:
        return "not found clean", "muted"
    if host[key]["hidden"]:
        return "hidden", "bad"
    return f"found, IoU {host[key]['iou']:.2f}", "good"


def host_view(folder, host, pictured):
    view = {"name": host["name"], "range": host["range"], "matched": host["matched"], "full": host["full"],
            "visible": percent(host["visible_share"], 0), "points": host["adversary_points"],
            "clean": f"IoU {host['clean']['iou']:.2f}, score {host['clean']['score']:.2f}" if host["clean"]["iou"] > 0
            else "not found",
            "raster": verdict(host, "raster"), "cycles": verdict(host, "cycles"),
            "relative": percent(host["full"]["mae"] / host["full"]["mean"]) if host["full"]["mean"] > 0 else "–"}
    if pictured:
        def file(name):
            return os.path.join(folder, host["pictures"][name])
        with Image.open(file("clean")) as image:
            box = window(host, image.size)
        view["scenes"] = [(title, photo(file(name), box)) for title, name in
                          (("as recorded", "clean"), ("attacked (rasteriser)", "attacked"),
                           ("attacked (Cycles)", "cycles"))]
        view["crops"] = [("rasteriser", pixels(file("raster_crop"))), ("Cycles, full light", pixels(file("cycles_crop"))),
                         ("difference", pixels(file("difference"))),
                         ("rasteriser, hard limit", pixels(file("matched_raster"))),
                         ("Cycles, matched light", pixels(file("matched_cycles"))),
                         ("difference × 10", pixels(file("matched_difference")))]
        view["bev"] = bev(host)
    return view


TEMPLATE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>Mirage: fidelity report</title>
<style>
:root{--ink:#1c2430;--muted:#667085;--line:#e4e7ec;--paper:#fff;--wash:#f7f8fa;--good:#16a34a;--bad:#dc2626}
*{box-sizing:border-box}
body{margin:0;background:var(--wash);color:var(--ink);font:15px/1.55 system-ui,-apple-system,"Segoe UI","DejaVu Sans",sans-serif}
main{max-width:1120px;margin:0 auto;padding:44px 28px 80px}
h1{font-size:30px;line-height:1.2;margin:0 0 6px;letter-spacing:-.02em}
h2{font-size:20px;margin:46px 0 12px;letter-spacing:-.01em}
h3{font-size:16px;margin:0}
p{margin:0 0 12px;max-width:76ch}.lead,.note{color:var(--muted)}.note{font-size:13px}
.cards{display:grid;grid-template-columns:repeat(auto-fill,minmax(250px,1fr));gap:14px;margin:26px 0}
.card,section.host,.panel{background:var(--paper);border:1px solid var(--line);border-radius:12px}
.card{padding:16px 18px}.card b{display:block;font-size:26px;line-height:1.25;letter-spacing:-.02em;font-variant-numeric:tabular-nums}
.card span{font-size:13px;color:var(--muted)}.card i{font-style:normal;font-weight:600;font-size:13px}
.two{display:grid;grid-template-columns:1fr 1fr;gap:14px}.panel{padding:16px}.panel img{width:100%}
figure{margin:0}figcaption{font-size:12.5px;color:var(--muted);margin-top:4px}
.row{display:grid;gap:10px;margin-top:12px}.three{grid-template-columns:repeat(3,1fr)}.six{grid-template-columns:repeat(6,1fr)}
.row img{width:100%;border-radius:6px;display:block}.six img{image-rendering:pixelated}
section.host{padding:18px 20px;margin-top:16px;break-inside:avoid}
.head{display:flex;gap:12px;align-items:baseline;flex-wrap:wrap}
.tag{font-size:12.5px;padding:1px 9px;border-radius:99px;background:var(--wash);border:1px solid var(--line)}
.good{color:var(--good)}.bad{color:var(--bad)}.muted{color:var(--muted)}
table{border-collapse:collapse;width:100%;font-size:13.5px;font-variant-numeric:tabular-nums;background:var(--paper)}
th,td{padding:7px 10px;text-align:right;border-bottom:1px solid var(--line);white-space:nowrap}
th:first-child,td:first-child{text-align:left}th{color:var(--muted);font-weight:500}
.scroll{overflow-x:auto;border:1px solid var(--line);border-radius:12px}tr:last-child td{border-bottom:0}
@media(max-width:760px){.two,.three{grid-template-columns:1fr}.six{grid-template-columns:repeat(3,1fr)}}
</style></head><body><main>
<h1>Fidelity report</h1>
<p class="lead">{{ result.vehicles }} vehicle{{ "s" if result.vehicles != 1 }} in {{ result.frames }}
frame{{ "s" if result.frames != 1 }} ({{ result.test_frames }} held back from the attack), re-rendered in Blender
{{ result.blender }} Cycles with {{ result.samples }} samples a pixel.</p>
<div class="cards">{% for title, value, note in cards %}<div class="card"><i>{{ title }}</i><b>{{ value }}</b>
<span>{{ note }}</span></div>{% endfor %}</div>

{% if loss or recall %}<h2>The attack</h2><div class="two">
{% if loss %}<div class="panel"><h3>Loss</h3><img src="{{ loss }}" alt="Loss over iterations"></div>{% endif %}
{% if recall %}<div class="panel"><h3>Recall over IoU</h3><img src="{{ recall }}" alt="Recall over IoU"></div>{% endif %}
</div>{% endif %}

<h2>What each effect of light changes</h2>
<p class="note">Each row adds effects to matched light (Lambert, ambient and hemisphere and sun without shadows, no bounces)
and is compared with it over the object's pixels at the same samples; “+bounces” rows hold shadows and occlusion as well.
The first row is no light: it averages matched light over each pixel's area where the rasteriser looks at its centre, which
matters where texels are smaller than pixels. Error in scene-linear radiance.</p>
{% if result.ladder %}<div class="scroll"><table><tr><th>effect</th><th>mean error</th><th>of radiance</th><th>SSIM</th>
<th>FLIP</th><th>render, s</th><th>vehicles</th></tr>
{% for rung in result.ladder %}<tr><td>{{ rung.effect }}</td><td>{{ "%.4f"|format(rung.mae) }}</td>
<td>{{ "%.1f %%"|format(100 * rung.relative) }}</td><td>{{ "%.3f"|format(rung.ssim) }}</td>
<td>{{ "%.3f"|format(rung.flip) }}</td><td>{{ "%.2f"|format(rung.seconds) }}</td><td>{{ rung.vehicles }}</td></tr>{% endfor %}
</table></div>{% else %}<p>Not rendered (--ladder 0).</p>{% endif %}

<h2>Vehicles</h2>
{% for host in pictured %}<section class="host"><div class="head"><h3>{{ host.name }}</h3>
<span class="muted">{{ "%.0f"|format(host.range) }} m · {{ host.visible }} in view · {{ host.points }} LiDAR returns</span>
<span class="tag">clean: {{ host.clean }}</span>
<span class="tag {{ host.raster[1] }}">rasteriser: {{ host.raster[0] }}</span>
<span class="tag {{ host.cycles[1] }}">Cycles: {{ host.cycles[0] }}</span></div>
<div class="row three">{% for title, picture in host.scenes %}<figure><img src="{{ picture }}" alt="{{ title }}">
<figcaption>{{ title }}</figcaption></figure>{% endfor %}</div>
<div class="row six">{% for title, picture in host.crops %}<figure><img src="{{ picture }}" alt="{{ title }}">
<figcaption>{{ title }}</figcaption></figure>{% endfor %}</div>
<div class="row"><figure><img src="{{ host.bev }}" alt="Bird's-eye view"><figcaption>Sweep from above: returns on the object
in red, labels in green, detections in the title's colour with their score.</figcaption></figure></div>
</section>{% endfor %}

<h2>All vehicles</h2>
<div class="scroll"><table><tr><th>vehicle</th><th>range, m</th><th>clean</th><th>rasteriser</th><th>Cycles</th>
<th>mask IoU</th><th>mean error</th><th>range error, µm</th><th>full light</th><th>SSIM</th><th>FLIP</th></tr>
{% for host in hosts %}<tr><td>{{ host.name }}</td><td>{{ "%.1f"|format(host.range) }}</td><td>{{ host.clean }}</td>
<td class="{{ host.raster[1] }}">{{ host.raster[0] }}</td><td class="{{ host.cycles[1] }}">{{ host.cycles[0] }}</td>
<td>{{ "%.6f"|format(host.matched.mask_iou) }}</td><td>{{ "%.1e"|format(host.matched.mae) }}</td>
<td>{{ "%.1f"|format(1e6 * host.matched.range_error_m) }}</td><td>{{ host.relative }}</td>
<td>{{ "%.3f"|format(host.full.ssim) }}</td><td>{{ "%.3f"|format(host.full.flip) }}</td></tr>{% endfor %}</table></div>
<p class="note" style="margin-top:22px">Mask IoU and mean error: the rasteriser at its hard limit against Cycles in matched
light, a test of correctness. Full light: sun with shadows, sky occluded by host and road, four bounces, specular
reflection, against the rasteriser as the attack used it; both are judged by the same detector with the same sweep.</p>
</main></body></html>
"""


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--validation", required=True)
    parser.add_argument("--run", required=True)
    parser.add_argument("--evaluation")
    options = parser.parse_args()
    folder = options.validation
    result = read_json(os.path.join(folder, "result.json"))
    evaluation = read_json(options.evaluation) if options.evaluation else None
    hosts = [read_json(os.path.join(folder, "hosts", name + ".json")) for name in result["hosts"]]
    hosts = [host for host in hosts if "matched" in host]
    # Pictures of those that stay hidden under Cycles first, then of those that the detector found, the nearest first.
    shown = sorted(hosts, key=lambda host: (not host["cycles"]["hidden"], not host["raster"]["hidden"],
                                             not host["detected"], host["range"]))[:PICTURED_HOSTS]
    page = jinja2.Environment(autoescape=True).from_string(TEMPLATE).render(
        result=result, cards=headline(result, evaluation), loss=loss_curve(os.path.join(options.run, "loss.csv")),
        recall=recall_curve(evaluation), pictured=[host_view(folder, host, True) for host in shown],
        hosts=[host_view(folder, host, False) for host in hosts])
    target = os.path.join(folder, "report.html")
    handle, temporary = tempfile.mkstemp(dir=folder, suffix=".tmp")
    with os.fdopen(handle, "w", encoding="utf-8") as file:
        file.write(page)
    os.chmod(temporary, 0o644)
    os.replace(temporary, target)


main()
