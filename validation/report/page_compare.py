"""What the page of `mirage compare` shows."""

import os

import charts
import figures

ANSWERS = {"more": "The second detector is easier to fool", "less": "The second detector is harder to fool",
           "the same within 5 points": "Both detectors are as easy to fool, within 5 points",
           "cannot be told": "Which detector is easier to fool cannot be told"}
WORSE = 40  # of the vehicles that got worse, the nearest


def label(part):
    return f"{part['by']} {os.path.basename(part['name']) if part['by'] == 'object' else part['name']}".strip()


def plot(parts):
    """Points more in the second detector, one row a part."""
    rows = [(label(part), "raster" if part["difference"]["low"] > 0 else "rung", part["difference"]["value"],
             part["difference"]["low"], part["difference"]["high"],
             f"{100 * part['difference']['value']:+.1f} points ({100 * part['difference']['low']:+.1f} to "
             f"{100 * part['difference']['high']:+.1f})") for part in parts]
    low, high = min([-0.05] + [row[3] for row in rows]), max([0.05] + [row[4] for row in rows])
    return charts.intervals("Vanished, second less first", rows, "points more in the second detector", high, low)


def values(result):
    compare = result["compare"]
    parts = [dict(part, at=f"compare.parts.{at}", label=label(part)) for at, part in enumerate(compare["parts"])]
    if "own" in compare:
        parts.append(dict(compare["own"], at="compare.own", label="each under its own object"))
    return {"compare": compare, "parts": parts, "plot": plot(parts), "answer": ANSWERS[compare["told"]],
            "worse": list(enumerate(compare["worse"]))[:WORSE], "basename": os.path.basename, "made_of": figures.made_of(result)}
