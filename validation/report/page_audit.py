"""What the page of `mirage audit` shows."""

import charts
import figures

TITLES = {"picture": "Changed pictures", "points": "Changed sweeps", "calibration": "Wrong calibration"}
USES = {True: ("used", "good"), False: ("not used", "bad"), None: ("cannot be told", "none")}


def plot(title, rows):
    """AP lost, one row a change."""
    shown = [row for row in rows if "refused" not in row]
    if not shown:
        return None
    low, high = min([0] + [row["low"] for row in shown]), max([0.05] + [row["high"] for row in shown])
    entries = [(row["change"], "raster" if row["low"] > 0 else "rung", row["drop"], row["low"], row["high"],
                f"{100 * row['drop']:.1f} points ({100 * row['low']:.1f} to {100 * row['high']:.1f})") for row in shown]
    return charts.intervals(title, entries, "AP 0.7 lost", high, low)


def values(result):
    sections = []
    for name, title in TITLES.items():
        rows = [dict(row, at=at) for at, row in enumerate(result["audit"]) if row["input"] == name]
        if rows:
            sections.append({"name": name, "title": title, "rows": rows, "plot": plot(title, rows)})
    strata = [lost["stratum"] for row in result["audit"] for lost in row.get("recall_lost", [])]
    return {"result": result, "sections": sections, "strata": list(dict.fromkeys(strata)),
            "uses": [(name, *USES[use]) for name, use in result["uses"].items()], "made_of": figures.made_of(result)}
