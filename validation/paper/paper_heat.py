"""The picture of "which fusion is weak where": a heat map of what learning adds to size, as inline SVG. Rows: against which
detector, and through which sensor, the mesh was learned; columns: who judges it; a panel for each meaning of hidden. The
colours (orange over 0, blue below, no red beside green) are of the mark itself and the same in both themes."""

from markupsafe import Markup, escape

from paper_markdown import signed

PANELS = [("vanished", "vanished: no box is left"), ("fn_asr", "missed at IoU 0.7")]
CAPTION = ["Points of the vehicles more than under a random mesh of the", "same extents (cuboid: the one beside the judge's own row);",
           "95 % interval below, bold: without 0. Framed: judged by", "whom it was learned against."]
OVER, UNDER = (224, 112, 22), (47, 98, 178)
LEFT, CELL, HIGH, TOP, GAP = 172, 84, 36, 74, 26
PANEL = 190  # at least: the panels' titles stand side by side, and the caption below both
FONT = "'Inter', 'Source Sans 3', system-ui, -apple-system, 'Segoe UI', 'Liberation Sans', 'DejaVu Sans', sans-serif"


def reach(rows):
    """The net at which a colour is full: the largest, at least 10 points."""
    nets = [row["values"].get("net_" + key) for row in rows for key, _ in PANELS]
    return max([0.1] + [abs(net["value"]) for net in nets if net])


def colour(net, full):
    share = min(1.0, abs(net) / full) ** 0.8
    return "#" + "".join(f"{round(255 + share * (c - 255)):02x}" for c in (OVER if net > 0 else UNDER))


def ink_on(fill):
    red, green, blue = (int(fill[k:k + 2], 16) for k in (1, 3, 5))
    return "#16202c" if 0.3 * red + 0.59 * green + 0.11 * blue > 120 else "#ffffff"


def words(row, key):
    value, net = row["values"][key], row["values"].get("net_" + key)
    said = f"{row['label']}: {100 * value['value']:.1f} % ({100 * value['low']:.1f}–{100 * value['high']:.1f})"
    if net:
        said += f", net of its size {signed(net['value'])} points ({signed(net['low'])} to {signed(net['high'])})"
    return f"{said}, {row.get('vehicles', 0)} vehicles found clean at IoU 0.7"


def each_once(rows, key):
    return list(dict.fromkeys(row[key] for row in rows))


def text(kind, x, y, said, anchor="middle", style=""):
    return f'<text class="{kind}" x="{x}" y="{y}" text-anchor="{anchor}"{style}>{escape(said)}</text>'


def cell(row, key, x, y, full, own):
    """Colour and number are the net value, with its interval below; without a net value only the share."""
    if row is None or key not in row["values"]:
        return text("tick", x + CELL / 2, y + HIGH / 2 + 4, "–")
    value, net = row["values"][key], row["values"].get("net_" + key)
    shown = net or value
    fill = colour(net["value"], full) if net else "#eef0f3"
    told = net is not None and (net["low"] > 0 or net["high"] < 0)
    weight = ";font-weight:700" if told else ""
    ink = f' style="fill:{ink_on(fill)}{{}}"'
    figure = signed(net["value"]) if net else f"{100 * value['value']:.1f} %"
    frame = f'<rect x="{x + 2.5}" y="{y + 2.5}" width="{CELL - 5}" height="{HIGH - 5}" fill="none" stroke="#16202c" stroke-width="1.4"/>'
    bounds = f"{signed(shown['low'])} to {signed(shown['high'])}" if net else f"{100 * value['low']:.1f}–{100 * value['high']:.1f}"
    return (f'<g><rect x="{x + 1}" y="{y + 1}" width="{CELL - 2}" height="{HIGH - 2}" fill="{fill}"/>{frame if own else ""}'
            + text("figure", x + CELL / 2, y + 16, figure, style=ink.format(";font-size:13px" + weight))
            + text("bounds", x + CELL / 2, y + 29, bounds, style=ink.format(";font-size:10px"))
            + f"<title>{escape(words(row, key))}</title></g>")


def legend(x, y, full):
    steps = [full * (k - 10) / 10 for k in range(21)]
    parts = [f'<rect x="{x + 9 * k}" y="{y}" width="9" height="10" fill="{colour(net, full)}"/>' for k, net in enumerate(steps)]
    for k, said in ((0, signed(-full)), (10, "0"), (20, signed(full))):
        parts.append(text("tick", x + 9 * k + 4.5, y + 23, said))
    return "".join(parts)


def heat(table):
    """The table's heat map, or None without evaluations."""
    rows = [row for row in table["rows"] if any(key in row["values"] for key, _ in PANELS)]
    if not rows:
        return None
    cells = {(row["source"], row["target"]): row for row in rows}
    sources, targets, full = each_once(rows, "source"), each_once(rows, "target"), reach(rows)  # judged
    wide = CELL * len(targets)
    panel_wide = max(wide, PANEL)
    width, height = LEFT + 2 * panel_wide + GAP + 8, TOP + HIGH * len(sources) + 62 + 16 * len(CAPTION)
    parts = [text("label", LEFT - 12, TOP - 12, "learned against, through", "end")]
    for panel, (key, title) in enumerate(PANELS):
        start = LEFT + panel * (panel_wide + GAP) + (panel_wide - wide) / 2
        parts.append(text("name", start + wide / 2, 20, title, style=' style="font-size:14px;font-weight:600"'))
        parts.append(text("label", start + wide / 2, 38, "judged by"))
        for column, target in enumerate(targets):
            x = start + CELL * column
            parts.append(text("name", x + CELL / 2, TOP - 12, target))
            for line, source in enumerate(sources):
                own = source.startswith(target + ",")
                parts.append(cell(cells.get((source, target)), key, x, TOP + HIGH * line, full, own))
    before = None
    for line, source in enumerate(sources):
        y = TOP + HIGH * line
        parts.append(text("name", LEFT - 12, y + HIGH / 2 + 4, source, "end"))
        family = source.split(",")[0]
        if before is not None and family != before:
            parts.append(f'<line class="axis" x1="{8}" y1="{y}" x2="{width - 8}" y2="{y}"/>')
        before = family
    below = TOP + HIGH * len(sources)
    parts.append(legend(LEFT, below + 16, full))
    for line, said in enumerate(CAPTION):
        parts.append(text("tick", LEFT, below + 62 + 16 * line, said, "start"))
    return Markup(f'<svg class="plot" viewBox="0 0 {width} {height}" role="img" aria-label="{escape(table["title"])}">'
                  f'{"".join(parts)}</svg>')


def standalone(svg):
    """The same as a standalone file, on white."""
    style = (f"text{{font-family:{FONT};font-size:12px;fill:#5b6776}}.name{{fill:#16202c}}.label{{font-size:12.5px}}"
             ".axis{stroke:#b6bec8;stroke-width:1}")
    head, rest = str(svg).split(">", 1)
    wide, high = head.split('viewBox="0 0 ')[1].split('"')[0].split()
    head = head.replace('<svg class="plot"', f'<svg xmlns="http://www.w3.org/2000/svg" width="{wide}" height="{high}"')
    return f'{head}><style>{style}</style><rect width="100%" height="100%" fill="#fff"/>{rest}\n'
