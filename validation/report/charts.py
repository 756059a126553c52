"""Plots as inline SVG. Colours are CSS classes (report/style.css), so that a plot follows the page's light or dark
theme; every mark carries its figures as a tooltip (<title>)."""

import math

from markupsafe import Markup, escape


def ticks(low, high, count=5):
    """Round numbers from low to high."""
    if high <= low:
        return [low]
    raw = (high - low) / count
    step = 10 ** math.floor(math.log10(raw))
    step *= next(m for m in (1, 2, 2.5, 5, 10) if m * step >= raw * 0.999)
    first = math.ceil(low / step - 1e-9)
    return [k * step for k in range(first, math.floor(high / step + 1e-9) + 1)]


def log_ticks(low, high):
    decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    steps = (1,) if len(decades) > 4 else (1, 3) if len(decades) > 2 else (1, 2, 5)
    marks = [m * 10.0**d for d in decades for m in steps if low <= m * 10.0**d <= high]
    return marks if len(marks) > 1 else ticks(low, high, 4)


def scientific(value, digits=2):
    """4.7·10⁻⁵, 10⁻⁴, 0."""
    if value == 0:
        return "0"
    mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
    mantissa = f"{float(mantissa):.{digits}g}"
    power = "10" + str(int(exponent)).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return power if mantissa == "1" else f"{mantissa}·{power}"


def short(value, digits=6):
    """With as many digits as needed, and as a power of ten far from 1."""
    far = value != 0 and not 1e-3 <= abs(value) < 1e5
    return scientific(value, min(digits, 3)) if far else f"{value:.{digits}g}"


def percent(value):
    return f"{100 * value:.3g}\u202f%"


class Axis:
    """Maps values to a span of the page."""

    def __init__(self, low, high, start, end, log=False, marks=None, label=short):
        if not high > low:  # all values are equal, such as errors of 0: any span shows them
            high = 10 * low if log else low + 1
        self.low, self.high, self.start, self.end, self.log, self.label = low, high, start, end, log, label
        self.marks = marks if marks is not None else (log_ticks if log else ticks)(low, high)

    def __call__(self, value):
        if self.log:
            value = min(max(value, self.low), self.high)
            share = math.log(value / self.low) / math.log(self.high / self.low)
        else:
            share = (value - self.low) / (self.high - self.low)
        return round(self.start + share * (self.end - self.start), 2)


def around(values, log=False):
    """(low, high) with a margin."""
    low, high = min(values), max(values)
    if log:
        spread = max(math.log10(high / low), 0.3) * 0.08
        return low / 10**spread, high * 10**spread
    margin = 0.06 * (high - low) or abs(high) * 0.1 or 1
    return low - margin, high + margin


class Plot:
    """A frame with axes; `left` leaves room for the labels of the vertical axis."""

    def __init__(self, x, y, title, x_label, y_label="", size=(560, 300), left=58, right=20, top=14, bottom=46,
                 tick=short):
        """x, y: (low, high) or (low, high, "log"); y None: rows (see `row`)."""
        self.width, self.height = size
        self.left, self.right, self.top, self.bottom = left, self.width - right, top, self.height - bottom
        self.x = Axis(x[0], x[1], self.left, self.right, len(x) > 2, label=tick)
        self.y = Axis(y[0], y[1], self.bottom, self.top, len(y) > 2) if y else None
        self.title, self.parts = title, []
        self.frame(x_label, y_label)

    def frame(self, x_label, y_label):
        for mark in self.x.marks:
            at = self.x(mark)
            self.line("grid", at, self.top, at, self.bottom)
            self.text("tick", at, self.bottom + 16, self.x.label(mark), "middle")
        if self.y:
            for mark in self.y.marks:
                at = self.y(mark)
                self.line("grid", self.left, at, self.right, at)
                self.text("tick", self.left - 8, at + 4, self.y.label(mark), "end")
        self.line("axis", self.left, self.bottom, self.right, self.bottom)
        self.text("label", (self.left + self.right) / 2, self.height - 8, x_label, "middle")
        if y_label:
            middle = (self.top + self.bottom) / 2
            self.parts.append(f'<text class="label" text-anchor="middle" transform="translate(13 {middle}) rotate(-90)">'
                              f"{escape(y_label)}</text>")

    def add(self, mark, tip=""):
        self.parts.append(f"<g>{mark}<title>{escape(tip)}</title></g>" if tip else mark)

    def line(self, kind, x0, y0, x1, y1, tip=""):
        self.add(f'<line class="{kind}" x1="{x0}" y1="{y0}" x2="{x1}" y2="{y1}"/>', tip)

    def text(self, kind, x, y, text, anchor="start"):
        self.parts.append(f'<text class="{kind}" x="{round(x, 2)}" y="{round(y, 2)}" text-anchor="{anchor}">'
                          f"{escape(text)}</text>")

    def curve(self, kind, xs, ys):
        points = " ".join(f"{self.x(a)},{self.y(b)}" for a, b in zip(xs, ys))
        self.parts.append(f'<polyline class="curve {kind}" points="{points}"/>')

    def dot(self, kind, x, y, tip="", radius=3.6):
        self.add(f'<circle class="dot {kind}" cx="{self.x(x)}" cy="{self.y(y)}" r="{radius}"/>', tip)

    def legend(self, entries):
        """[(kind, text)] at the top right, from the right."""
        at = self.right
        for kind, text in reversed(entries):
            at -= 6.9 * len(text)
            self.text("key", at, self.top - 10, text)
            self.line(f"curve {kind}", at - 20, self.top - 14, at - 6, self.top - 14)
            at -= 40

    def row(self, index, count):
        """Height of a row's middle, for plots with one row an entry."""
        return round(self.top + (index + 0.5) * (self.bottom - self.top) / count, 2)

    def svg(self):
        return Markup(f'<svg class="plot" viewBox="0 0 {self.width} {self.height}" role="img" '
                      f'aria-label="{escape(self.title)}">{"".join(self.parts)}</svg>')


def intervals(title, rows, x_label, high=1.0, low=0, bands=()):
    """Values with their intervals, one row each: [(name, class, value, low, high, tip)]; shares as percentages. `bands`: to
    each row how far from 0 a band reaches, or None, and its tip."""
    plot = Plot((low, high), None, title, x_label, size=(560, 62 + 27 * len(rows)),
                left=max(176 if bands else 150, 20 + round(7.2 * max((len(row[0]) for row in rows), default=0))), tick=percent)
    for index, (name, kind, value, least, most, tip) in enumerate(rows):
        y = plot.row(index, len(rows))
        plot.text("name", plot.left - 12, y + 4, name, "end")
        if bands and bands[index][0]:
            start, end = plot.x(max(low, 0)), plot.x(bands[index][0])
            plot.add(f'<rect class="floor" x="{start}" y="{y - 9}" width="{round(max(end - start, 0.5), 2)}" height="18"/>',
                     bands[index][1])
        if least is not None:
            plot.line(f"interval {kind}", plot.x(least), y, plot.x(most), y)
        plot.add(f'<circle class="dot {kind}" cx="{plot.x(value)}" cy="{y}" r="5"/>', tip)
    return plot.svg()


def bars(title, rows, x_label, tick=short):
    """One bar a row: [(name, class, value, tip)]."""
    high = max(value for *_, value, _ in rows) or 1
    plot = Plot((0, high * 1.12), None, title, x_label, size=(560, 62 + 25 * len(rows)), left=176, tick=tick)
    for index, (name, kind, value, tip) in enumerate(rows):
        y = plot.row(index, len(rows))
        plot.text("name", plot.left - 12, y + 4, name, "end")
        width = max(plot.x(value) - plot.left, 0.5)
        plot.add(f'<rect class="bar {kind}" x="{plot.left}" y="{y - 7}" width="{round(width, 2)}" height="14" rx="1"/>',
                 tip)
    return plot.svg()


def curves(title, series, x_label, y_label, x=None, y=None, size=(560, 300), rule=None):
    """Lines: [(class, name, xs, ys)]; `rule`: an upright line at an x."""
    xs, ys = [v for s in series for v in s[2]], [v for s in series for v in s[3]]
    plot = Plot(x or (min(xs), max(xs)), y or around(ys), title, x_label, y_label, size, top=30)
    if rule is not None:
        plot.line("rule", plot.x(rule), plot.top, plot.x(rule), plot.bottom)
    for kind, _, a, b in series:
        plot.curve(kind, a, b)
    plot.legend([(kind, name) for kind, name, *_ in series if name])
    return plot.svg()


def scatter(title, points, x_label, y_label, x, y, diagonal=False, front=(), size=(560, 380)):
    """Dots [(class, x, y, tip)] and the line through `front` [(x, y)]."""
    plot = Plot(x, y, title, x_label, y_label, size)
    if diagonal:
        plot.line("rule", plot.x(plot.x.low), plot.y(plot.x.low), plot.x(plot.x.high), plot.y(plot.x.high))
    if front:
        plot.curve("front", [p[0] for p in front], [p[1] for p in front])
    for kind, a, b, tip in points:
        plot.dot(kind, a, b, tip)
    return plot.svg()
