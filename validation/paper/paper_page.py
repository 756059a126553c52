"""Writes the texts of `mirage reproduce` and its page, one self-contained HTML file.

    python3 paper_page.py DIR

Reads DIR/reproduce.json and the pictures under DIR/evaluations; writes DIR/reproduce.md and DIR/TABLE.md (paper_markdown.py), and,
where there are jinja2 and PIL, DIR/reproduce.html and DIR/fusions*.svg, the heat maps alone. Every figure of the page
stands in reproduce.json. Missing measurements are left out, never made up.
"""

import io
import json
import os
import sys

HERE = os.path.dirname(os.path.abspath(__file__))
REPORT = os.path.join(HERE, "..", "report")
sys.dont_write_bytecode = True
sys.path[:0] = [HERE, REPORT]

import paper_markdown

if __name__ == "__main__":
    with open(os.path.join(sys.argv[1], "reproduce.json"), encoding="utf-8") as texts_of:
        paper_markdown.write(sys.argv[1], json.load(texts_of))

try:
    from PIL import Image

    import atomic
    import figures
    import paper_heat
    import paper_plots as plots
    import pictures
except ImportError as error:
    sys.exit(f"paper_page.py: {error.name}: not installed; install python3-jinja2 and python3-pil")

TAGS = {"holds": "good", "does not hold": "bad", "holds in part": "raster"}
SECTIONS = [("table1", "attack"), ("real", "attack"), ("table2", "attack"), ("fig3", "recall"), ("fig4", "size"),
            ("table3", "transfer"), ("table4", "defences"), ("parts", "attack"),
            ("fusions", "heat"), ("fusions-real", "heat"), ("fusions-xenith", "heat")]
# Pictures of an evaluation: number of each kind, and their content.
PICTURED = {"hidden": (3, "A vehicle that the mesh hides: as recorded and attacked, with the detections."),
            "false_positives": (2, "Detections that the mesh makes, from above."),
            "features": (2, "Magnitude of the image features in the image and projected to the bird's-eye view.")}
WIDE = 1400  # pixels of a picture, at most


def headline(findings):
    """The paper's findings and their outcomes, in one line; ours are not the paper's."""
    own = [f for f in findings if not f["claim"].startswith("Not in the paper") and f["checks"]]
    if not own:
        return "The paper's experiments"
    counts = {}
    for finding in own:
        counts[finding["verdict"]] = counts.get(finding["verdict"], 0) + 1
    named = {"holds": ("holds", "hold"), "holds in part": ("holds in part", "hold in part"),
             "does not hold": ("does not", "do not"), "cannot be told": ("cannot be told", "cannot be told")}
    if counts == {"cannot be told": len(own)} and len(own) > 1:
        return f"These data are too few to decide any of {len(own)} findings of the paper."
    parts = [f"{counts[key]} {words[counts[key] > 1]}" for key, words in named.items() if key in counts]
    return f"Of {len(own)} of the paper's findings, " + ", ".join(parts) + "."


def outside(row, key):
    """The position of the paper's number, if it is outside our interval."""
    value, paper = row["values"].get(key, {}), row["paper"].get(key)
    if paper is None or "low" not in value:
        return ""
    return "\u202f▲" if paper > value["high"] else "\u202f▼" if paper < value["low"] else ""


def paper_columns(table):
    """Keys of the columns for which the paper has a number."""
    return {key for row in table["rows"] for key in row["paper"]}


def picture(path):
    with Image.open(path) as file:
        image = file.convert("RGB")
    if image.width > WIDE:
        image = image.resize((WIDE, round(image.height * WIDE / image.width)), Image.LANCZOS)
    out = io.BytesIO()
    image.save(out, "JPEG", quality=84)
    return pictures.data_uri(out.getvalue(), "image/jpeg")


def shown_pictures(folder, tables):
    """[(case, caption, uri)]: of every evaluation that wrote pictures, some of each kind."""
    shown, seen = [], set()
    for table in tables:
        for row in table["rows"]:
            case = row["case"]
            path = os.path.join(folder, case, "pictures")
            if case in seen or not os.path.isdir(path):
                continue
            seen.add(case)
            files = sorted(name for name in os.listdir(path) if name.endswith(".png"))
            for kind, (most, caption) in PICTURED.items():
                for name in [n for n in files if n.startswith(kind)][:most]:
                    shown.append({"case": case.split("/")[-1], "kind": kind, "caption": caption, "name": name,
                                  "uri": picture(os.path.join(path, name))})
    return shown


def plots_of(table):
    rows = table["rows"]
    if table["name"] in ("table1", "table2", "real"):
        return {"success": plots.success(rows), "distances": plots.distances(rows), "legend": plots.legend(rows)}
    if table["name"] == "fig3":
        rigs = dict.fromkeys(row["rig"] for row in rows)
        return {"recall": [(plots.RIGS[rig], plots.recall([r for r in rows if r["rig"] == rig])) for rig in rigs],
                "legend": plots.legend(rows)}
    if table.get("matrix"):
        return {"heat": paper_heat.heat(table)}
    if table["name"] == "fig4":
        return {"size": plots.size(rows)}
    if table["name"] == "parts":
        return {"success": plots.success(rows, "vanished", "vanished without a trace (95 % interval)")}
    if table["name"] == "table3":
        return {"matrix": plots.matrix(rows)}
    return {"success": plots.success(rows), "ap": plots.success(rows, "ap70", "clean AP at IoU 0.7; ring: the paper's")}


def page(result, folder):
    environment = figures.templates(HERE, REPORT)
    fig = figures.figure_function(result)
    names = [table["name"] for table in result["tables"]]
    sections = [{"at": names.index(name), "kind": kind, "table": result["tables"][names.index(name)],
                 "plots": plots_of(result["tables"][names.index(name)])} for name, kind in SECTIONS if name in names]
    environment.globals.update(
        result=result, fig=fig, interval=figures.interval_function(result, fig), sections=sections, tags=TAGS,
        title=headline(result["findings"]), shade=plots.shade, rigs=plots.RIGS, outside=outside,
        paper_columns=paper_columns,
        pictures=shown_pictures(folder, result["tables"]),
        minutes=sum(step.get("seconds", 0) for step in result["steps"].values()) / 60)
    return environment.get_template("paper_page.html.j2").render(
        style=figures.asset(REPORT, "style.css"), own_style=figures.asset(HERE, "paper_page.css"))


def main(folder):
    result = atomic.read_json(folder, "reproduce.json")
    atomic.write(os.path.join(folder, "reproduce.html"), page(result, folder))
    for table in result["tables"]:  # for other pages
        svg = paper_heat.heat(table) if table.get("matrix") else None
        if svg:
            atomic.write(os.path.join(folder, table["name"] + ".svg"), paper_heat.standalone(svg))


if __name__ == "__main__":
    atomic.run(main, sys.argv[1])
