"""Writes the page of `mirage audit`, compare, drive or score: one self-contained HTML file. It shows what the program judged.

    python3 command_page.py DIR

Reads DIR/result.json; the part that it holds (PAGES) says which page: DIR/PART.html.
"""

import os
import sys

HERE = os.path.dirname(os.path.abspath(__file__))
sys.dont_write_bytecode = True
sys.path.insert(0, HERE)

try:
    import atomic
    import charts
    import figures
    import page_drive
except ImportError as error:
    sys.exit(f"command_page.py: {error.name}: not installed; install python3-jinja2 and python3-pil")


def losses(title, rows, label, low, high):
    """Differences in points, one row each: [(name, {value, low, high}, tip)]; orange where the difference is over 0."""
    entries = [(name, "raster" if of["low"] > 0 else "rung", of["value"], of["low"], of["high"], tip) for name, of, tip in rows]
    return charts.intervals(title, entries, label, max([high] + [row[4] for row in entries]), min([low] + [row[3] for row in entries]))


def points(of, form):
    return "{} points ({} to {})".format(*(format(100 * of[key], form) for key in ("value", "low", "high")))


# mirage audit

TITLES = {"picture": "Changed pictures", "points": "Changed sweeps", "calibration": "Wrong calibration"}
USES = {True: ("used", "good"), False: ("not used", "bad"), None: ("cannot be told", "none")}


def audit_plot(title, rows):
    """AP lost, one row a change."""
    shown = [(row["change"], {**row, "value": row["drop"]}) for row in rows if "refused" not in row]
    return losses(title, [(name, of, points(of, ".1f")) for name, of in shown], "AP 0.7 lost", 0, 0.05) if shown else None


def audit_values(result):
    sections = []
    for name, title in TITLES.items():
        rows = [dict(row, at=at) for at, row in enumerate(result["audit"]) if row["input"] == name]
        if rows:
            sections.append({"name": name, "title": title, "rows": rows, "plot": audit_plot(title, rows)})
    strata = [lost["stratum"] for row in result["audit"] for lost in row.get("recall_lost", [])]
    return {"result": result, "sections": sections, "strata": list(dict.fromkeys(strata)),
            "uses": [(name, *USES[use]) for name, use in result["uses"].items()]}


# mirage compare

ANSWERS = {"more": "The second detector is easier to fool", "less": "The second detector is harder to fool",
           "the same within 5 points": "Both detectors are as easy to fool, within 5 points",
           "cannot be told": "Which detector is easier to fool cannot be told"}
WORSE = 40  # of the vehicles with a worse outcome, the nearest


def compare_label(part):
    return f"{part['by']} {os.path.basename(part['name']) if part['by'] == 'object' else part['name']}".strip()


def compare_values(result):
    compare = result["compare"]
    parts = [dict(part, at=f"compare.parts.{at}", label=compare_label(part)) for at, part in enumerate(compare["parts"])]
    if "own" in compare:
        parts.append(dict(compare["own"], at="compare.own", label="each under its own object"))
    plot = losses("Vanished, second less first", [(compare_label(part), part["difference"], points(part["difference"], "+.1f")) for part in parts],
                  "points more in the second detector", -0.05, 0.05)
    return {"compare": compare, "parts": parts, "plot": plot, "answer": ANSWERS[compare["told"]],
            "worse": list(enumerate(compare["worse"]))[:WORSE], "basename": os.path.basename}


# mirage score: one A4 page of a detector, the board of several

HELD = {"holds": ("holds", "good"), "does not hold": ("does not hold", "bad"), "cannot be told": ("cannot be told", "quiet")}
GRADES = [("D", "nothing is shown, or more are missed as recorded"), ("C", "it holds under loads that people carry"),
          ("B", "also under large shapes that nobody learned"), ("A", "also under objects learned against this detector")]  # src/attack/score.h
LEVELS = [("recorded", "no object"), ("loads", "loads"), ("shapes", "shapes"), ("learned", "learned")]


def cells(row, place):
    """The texts of a row's cells, and its place."""
    return [dict(cell, words=HELD[cell["held"]][0], kind=HELD[cell["held"]][1], at=f"{place}.cells.{at}",
                 bound="at_least" if cell["held"] == "does not hold" else "at_most") for at, cell in enumerate(row["cells"])]


def spans(bands):
    return [f"{low:g}–{high:g} m" for low, high in zip(bands, bands[1:])]


def worst(score, level, band, place):
    """The cell that decides for the rows of a level."""
    found = [cells(row, f"{place}.rows.{at}")[band] for at, row in enumerate(score["rows"]) if row["level"] == level]
    order = ["holds", "cannot be told", "does not hold"]
    return max(found, key=lambda cell: (order.index(cell["held"]), cell["at_most"])) if found else None


def certified(score):
    """A row for each size; the first band of each is all distances."""
    return [{"at": f"score.certified.{s}.size", "cells": [{"hosts": band["hosts"], "at": f"score.certified.{s}.bands.{b}"}
                                                          for b, band in enumerate(size["bands"]) if b > 0]}
            for s, size in enumerate(score.get("certified", []))]


def score_values(result):
    score = result["score"]
    rows = [dict(row, cells=cells(row, f"score.rows.{at}"), at=f"score.rows.{at}") for at, row in enumerate(score["rows"])]
    return {"score": score, "bands": spans(score["bands"]), "rows": rows, "grades": GRADES, "certified": certified(score)}


def board_values(result):
    entries = []
    for at, entry in enumerate(result["board"]):
        score, place = entry["score"], f"board.{at}.score"
        entries.append({"score": score, "at": place, "provenance": f"board.{at}.provenance", "data": entry["provenance"].get("inputs", {}).get("data", ""),
                        "levels": [[worst(score, level, band, place) for band in range(len(score["bands"]) - 1)] for level, _ in LEVELS]})
    entries.sort(key=lambda entry: entry["score"]["grade"] or "Z")
    return {"entries": entries, "levels": [name for _, name in LEVELS], "bands": spans(result["board"][0]["score"]["bands"]),
            "same": len({entry["data"] for entry in entries}) == 1,
            "grades": GRADES + [("–", "no object was learned against the detector")]}


PAGES = {"audit": audit_values, "compare": compare_values, "drive": page_drive.values, "score": score_values, "board": board_values}


def main(folder):
    result = atomic.read_json(folder, "result.json")
    name = next(part for part in PAGES if part in result)
    fig = figures.figure_function(result)
    environment = figures.templates(HERE)
    environment.globals.update(fig=fig, interval=figures.interval_function(result, fig), made_of=figures.made_of(result), **PAGES[name](result))
    style = figures.asset(HERE, "a4.css" if name == "score" else "style.css")
    atomic.write(os.path.join(folder, name + ".html"), environment.get_template(name + ".html.j2").render(style=style))


if __name__ == "__main__":
    atomic.run(main, sys.argv[1])
