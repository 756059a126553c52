"""A vehicle of a drive as a moving picture: animation.py FOLDER.

FOLDER/animation.json names the file to write (.webp or .gif), the vehicle (its strip as in `mirage drive`) and its
frames: a photograph, where the object changes it, the vehicle's box and the projection. Left as recorded, right with the
object, each cropped around the vehicle with its box as the detector left it; below for both a bar over time: found,
coasting, lost. 10 frames a second; smaller or coarser until it has at most LIMIT bytes."""

import io
import math
import os
import sys

from PIL import Image, ImageDraw, ImageFont

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "report"))
import atomic  # noqa: E402

LIMIT = 1_500_000  # bytes
WIDTH, GAP, SHAPE = 720, 8, 4 / 3  # px; px; width over height of a crop
LONGEST = 10.0  # s
VERSIONS = (("clean", "as recorded"), ("attacked", "with the object"))
COLOURS = {"f": "#22a35a", "c": "#d99a06", "l": "#d63b3b"}
PAPER, INK, MUTED = "#12171d", "#e3e7ec", "#98a3b1"
LEGEND = [(COLOURS["f"], "tracked", 4), (COLOURS["c"], "coasting", 4), (COLOURS["l"], "not tracked", 4), (MUTED, "detected", 1)]
EDGES = [(0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7)]


def font(size):
    try:
        return ImageFont.truetype("DejaVuSans.ttf", size)
    except OSError:
        return ImageFont.load_default()


def pixels(frame):
    """The box's corners in the photograph; those behind the camera are left out with their edges: None."""
    x, y, bottom, length, width, height, yaw = frame["box"]
    c, s, m = math.cos(yaw), math.sin(yaw), frame["pixel_from_velo"]
    found = []
    for z in (bottom, bottom + height):
        for a, b in ((1, 1), (-1, 1), (-1, -1), (1, -1)):
            p = (x + (c * a * length - s * b * width) / 2, y + (s * a * length + c * b * width) / 2, z, 1)
            u, v, w = (sum(m[4 * row + k] * p[k] for k in range(4)) for row in range(3))
            found.append((u / w, v / w) if w > 0.3 else None)
    return found


def smooth(values, reach=4):
    return [sum(values[max(0, i - reach):i + reach + 1]) / len(values[max(0, i - reach):i + reach + 1]) for i in range(len(values))]


def windows(corners, size):
    """Around each frame's box the part of the photograph that is shown: (left, top, width), without trembling."""
    boxes = []
    for points in corners:
        seen = [p for p in points if p] or [(size[0] / 2, size[1] / 2)]
        u, v = [min(max(p[0], 0), size[0]) for p in seen], [min(max(p[1], 0), size[1]) for p in seen]
        boxes.append(((min(u) + max(u)) / 2, (min(v) + max(v)) / 2, max(max(u) - min(u), SHAPE * (max(v) - min(v)))))
    middle_u, middle_v, wide = (smooth([box[k] for box in boxes]) for k in range(3))
    shown = []
    for u, v, w in zip(middle_u, middle_v, wide):
        width = min(max(2.2 * w, 120), size[0], SHAPE * size[1])
        height = width / SHAPE
        shown.append((min(max(u - width / 2, 0), size[0] - width), min(max(v - 0.58 * height, 0), size[1] - height), width))
    return shown


def part_of(strip, version):
    """The frames that are shown: LONGEST seconds around the longest time in which the version is not found."""
    times, best, seconds, start = strip["time_s"], (0, 0, 0), 0, 0
    for i, (letter, stands) in enumerate(zip(strip[version]["found"], strip["stands_s"])):
        if letter == "f" or i > 0 and strip["away"][i - 1]:
            seconds = 0
        if letter != "f":
            start = start if seconds else i
            seconds += stands
            best = max(best, (seconds, start, i))
    middle = (times[best[1]] + times[best[2]]) / 2
    first = min(max(middle - LONGEST / 2, times[0]), max(times[-1] - LONGEST, times[0]))
    return [i for i, t in enumerate(times) if first <= t <= first + LONGEST]


def bars(draw, strip, chosen, at, top, width):
    """Both versions' bars over the chosen frames, and the moment."""
    times, stands = strip["time_s"], strip["stands_s"]
    first, length = times[chosen[0]], times[chosen[-1]] + stands[chosen[-1]] - times[chosen[0]]
    left, small = 118, font(12)
    x = lambda t: left + (width - left) * (t - first) / length  # noqa: E731
    for row, (version, name) in enumerate(VERSIONS):
        y = top + 18 * row
        draw.text((left - 8, y + 5), name, MUTED, small, anchor="rm")
        for i in chosen:
            draw.rectangle((x(times[i]), y, x(times[i] + stands[i]), y + 8), COLOURS[strip[version]["track"][i]])
            if strip[version]["found"][i] == "f":
                draw.rectangle((x(times[i]), y + 10, x(times[i] + stands[i]), y + 12), MUTED)
    now = x(times[at] + stands[at] / 2)
    draw.line((now, top - 3, now, top + 33), INK, 2)


def picture(folder, told, chosen, at, window, width):
    """One frame of the animation."""
    strip, frame = told["vehicle"]["strip"], told["frames"][at]
    crop_width = (WIDTH - GAP) // 2
    crop_height = round(crop_width / SHAPE)
    canvas = Image.new("RGB", (WIDTH, 26 + crop_height + 58), PAPER)
    draw, title = ImageDraw.Draw(canvas), font(15)
    left, top, wide = window
    scale = crop_width / wide
    with Image.open(os.path.join(folder, frame["photo"])) as image:
        recorded = image.convert("RGB")
    for column, (version, name) in enumerate(VERSIONS):
        photo, x0 = recorded, column * (crop_width + GAP)
        if version != "clean" and frame["patch"]:
            photo = recorded.copy()
            with Image.open(os.path.join(folder, frame["patch"]["file"])) as patch:
                photo.paste(patch, tuple(frame["patch"]["at"]))
        crop = photo.resize((crop_width, crop_height), Image.BICUBIC, box=(left, top, left + wide, top + wide / SHAPE))
        found, pen = strip[version]["found"][at] == "f", ImageDraw.Draw(crop)
        colour = COLOURS["f" if found else "l"]
        corners = [p and ((p[0] + 0.5 - left) * scale, (p[1] + 0.5 - top) * scale) for p in pixels(frame)]
        for a, b in EDGES:
            if corners[a] and corners[b]:
                pen.line((corners[a], corners[b]), colour, 2)
        canvas.paste(crop, (x0, 26))
        draw.text((x0 + 4, 13), name, INK, title, anchor="lm")
        draw.text((x0 + crop_width - 4, 13), "found" if found else "not found", colour, title, anchor="rm")
    seconds = strip["time_s"][at] - strip["time_s"][chosen[0]]
    bars(draw, strip, chosen, at, 26 + crop_height + 8, WIDTH - 6)
    low, small, x0 = canvas.height - 9, font(12), WIDTH - 6
    draw.text((118, low), f"{seconds:.1f} s, {strip['range_m'][at]:.0f} m away", MUTED, small, anchor="lm")
    for colour, text, thick in reversed(LEGEND):
        draw.text((x0, low), text, MUTED, small, anchor="rm")
        x0 -= draw.textlength(text, small) + 22
        draw.rectangle((x0, low - thick, x0 + 15, low + thick), colour)
        x0 -= 12
    return canvas if width == WIDTH else canvas.resize((width, round(canvas.height * width / WIDTH)), Image.LANCZOS)


def colours_of(frames):
    """A picture whose colours are those of all frames; the states' own must not be lost among them."""
    few = frames[::max(1, len(frames) // 6)]
    width, height = few[0].size
    sheet = Image.new("RGB", (width, height * len(few) + height // 4 * len(LEGEND)))
    for row, frame in enumerate(few):
        sheet.paste(frame, (0, height * row))
    for row, (colour, *_) in enumerate(LEGEND):
        sheet.paste(colour, (0, height * len(few) + height // 4 * row, width, height * len(few) + height // 4 * (row + 1)))
    return sheet


def encoded(frames, kind, durations, quality):
    out = io.BytesIO()
    if kind == ".gif":
        palette = colours_of(frames).quantize(quality, dither=Image.Dither.NONE)
        frames = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
        frames[0].save(out, "GIF", save_all=True, append_images=frames[1:], duration=durations, loop=0, optimize=False)
    else:
        frames[0].save(out, "WEBP", save_all=True, append_images=frames[1:], duration=durations, loop=0, quality=quality, method=4)
    return out.getvalue()


def draw(folder):
    told = atomic.read_json(folder, "animation.json")
    strip, kind = told["vehicle"]["strip"], os.path.splitext(told["file"])[1]
    chosen = part_of(strip, "attacked")
    with Image.open(os.path.join(folder, told["frames"][0]["photo"])) as image:
        shown = windows([pixels(frame) for frame in told["frames"]], image.size)
    durations = [100] * (len(chosen) - 1) + [1000]
    tries = ([(WIDTH, quality) for quality in (75, 60, 45)] + [(600, 45), (480, 45), (360, 45)] if kind == ".webp"
             else [(WIDTH, 128), (WIDTH, 64), (560, 64), (440, 64), (360, 48), (280, 32)])
    for width, quality in tries:
        frames = [picture(folder, told, chosen, i, shown[i], width) for i in chosen]
        data = encoded(frames, kind, durations, quality)
        if len(data) <= LIMIT:
            break
    atomic.write(told["file"], data)


if __name__ == "__main__":
    atomic.run(draw, sys.argv[1])
