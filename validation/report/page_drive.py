"""The data of `mirage drive`'s page: medians, lengths of gaps, and one strip per vehicle with its distance over
time and, for each version, where it was found, coasting or lost."""

import math
import sys

import charts

VERSIONS = ("clean", "attacked", "random")
NAMES = {"clean": "as recorded", "attacked": "with the object", "random": "random of its size"}
CURVE_LEFT = 52  # px, of the curve's axis
LEFT, WIDTH, HEIGHT, BAR, GAP = 130, 1000, 90, 12, 5  # px: of names, of the time axis, of the distance, of a bar, between bars


def runs(states, away, starts, ends):
    """(state, from, to) of consecutive frames with one state; an absence ends a run."""
    found = []
    for i, state in enumerate(states):
        if found and found[-1][0] == state and not away[i - 1]:
            found[-1] = (state, found[-1][1], ends[i])
        else:
            found.append((state, starts[i], ends[i]))
    return found


def strip(vehicle):
    """The data of one vehicle's drawing, in pixels."""
    times = [t - vehicle["strip"]["time_s"][0] for t in vehicle["strip"]["time_s"]]
    ends = [t + stands for t, stands in zip(times, vehicle["strip"]["stands_s"])]
    away = vehicle["strip"]["away"]
    ranges = vehicle["strip"]["range_m"]
    longest = max(ends[-1], 1e-9)
    top = max(10 * math.ceil(max(ranges) / 10), 10)

    def x(t):
        return round(LEFT + WIDTH * t / longest, 2)

    def y(metres):
        return round(HEIGHT * (1 - metres / top), 2)

    bars = []
    for row, version in enumerate(VERSIONS):
        of = vehicle["strip"][version]
        at = HEIGHT + 12 + row * (BAR + GAP)
        confirmed = vehicle["confirmed_s"][version]
        bars.append({
            "name": NAMES[version], "version": version, "y": at,
            "runs": [{"state": state, "x": x(a), "width": round(x(b) - x(a), 2), "from": a, "to": b}
                     for state, a, b in runs(of["track"], away, times, ends)],
            "found": [{"x": x(a), "width": round(x(b) - x(a), 2)} for state, a, b in runs(of["found"], away, times, ends) if state == "f"],
            "confirmed": None if confirmed is None else {"x": x(confirmed), "y": y(vehicle["confirmed_m"][version])},
        })
    whole = max(1, round(longest / 8))
    return {
        "line": " ".join(f"{x(t)},{y(r)}" for t, r in zip(times, ranges)),
        "bars": bars, "bottom": HEIGHT + 12 + 3 * (BAR + GAP),
        "metres": [{"y": y(m), "text": m} for m in (0, top // 2, top)],
        "seconds": [{"x": x(s), "text": s} for s in range(0, int(longest) + 1, whole)],
    }


def survival(vehicles, width, height):
    """The curve of gaps, in pixels: for each version the share of vehicles whose longest gap is longer than s."""
    longest = max([1.0, *(vehicle["gap_s"][v] for vehicle in vehicles for v in VERSIONS)])
    x, y = charts.Axis(0, longest, CURVE_LEFT, width - 20), charts.Axis(0, 1, height - 34, 10)
    curves = []
    for version in VERSIONS:
        points = [(0.0, 1.0)]
        gaps = sorted(vehicle["gap_s"][version] for vehicle in vehicles)
        for i, gap in enumerate(gaps):
            points += [(gap, points[-1][1]), (gap, 1 - (i + 1) / len(gaps))]
        points.append((longest, points[-1][1]))
        curves.append({"version": version, "line": " ".join(f"{x(a)},{y(b)}" for a, b in points)})
    return {"width": width, "height": height, "left": CURVE_LEFT, "curves": curves,
            "seconds": [{"x": x(m), "text": x.label(m)} for m in x.marks],
            "shares": [{"y": y(share), "text": round(100 * share)} for share in (0, 0.25, 0.5, 0.75, 1)]}


def values(result):
    drive = result["drive"]
    if not all("stands_s" in vehicle["strip"] for vehicle in drive["vehicles"]):
        sys.exit("result.json: drive.vehicles: a strip lacks stands_s; run the same mirage drive again into an empty folder")
    return {"result": result, "drive": drive, "versions": VERSIONS, "names": NAMES, "curve": survival(drive["vehicles"], 620, 260),
            "strips": [strip(vehicle) for vehicle in drive["vehicles"]], "left": LEFT, "width": LEFT + WIDTH + 20, "height": HEIGHT, "bar": BAR}
