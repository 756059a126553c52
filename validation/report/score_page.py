"""Writes the pages of `mirage score`: one A4 page of a detector, or the board of several. Self-contained HTML.

    python3 score_page.py DIR

Reads DIR/result.json; writes DIR/score.html, or DIR/board.html where it holds a board. The pages show what the program judged.
"""

import os
import sys

HERE = os.path.dirname(os.path.abspath(__file__))
sys.dont_write_bytecode = True
sys.path.insert(0, HERE)

try:
    import figures
    import files
except ImportError as error:
    sys.exit(f"score_page.py: {error.name}: not installed; install python3-jinja2")

HELD = {"holds": ("holds", "good"), "does not hold": ("does not hold", "bad"), "cannot be told": ("cannot be told", "quiet")}
GRADES = [("D", "nothing is shown, or more are missed as recorded"), ("C", "it holds under loads that people carry"),
          ("B", "also under large shapes that nobody learned"), ("A", "also under objects learned against this detector")]  # src/attack/score.h
LEVELS = [("recorded", "no object"), ("loads", "loads"), ("shapes", "shapes"), ("learned", "learned")]


def cells(row, place):
    """What the cells of a row say, and where it stands."""
    return [dict(cell, words=HELD[cell["held"]][0], kind=HELD[cell["held"]][1], at=f"{place}.cells.{at}",
                 bound="at_least" if cell["held"] == "does not hold" else "at_most") for at, cell in enumerate(row["cells"])]


def spans(bands):
    return [f"{low:g}–{high:g} m" for low, high in zip(bands, bands[1:])]


def worst(score, level, band, place):
    """Of a level's rows the cell that decides."""
    found = [cells(row, f"{place}.rows.{at}")[band] for at, row in enumerate(score["rows"]) if row["level"] == level]
    order = ["holds", "cannot be told", "does not hold"]
    return max(found, key=lambda cell: (order.index(cell["held"]), cell["at_most"])) if found else None


def score_page(result):
    score = result["score"]
    environment = files.templates(HERE)
    fig = figures.figure_function(result)
    environment.globals.update(
        score=score, fig=fig, interval=figures.interval_function(result, fig), bands=spans(score["bands"]),
        rows=[dict(row, cells=cells(row, f"score.rows.{at}"), at=f"score.rows.{at}") for at, row in enumerate(score["rows"])],
        made_of=figures.made_of(result), grades=GRADES)
    return environment.get_template("score.html.j2").render(style=files.asset(HERE, "a4.css"))


def board_page(result):
    entries = []
    for at, entry in enumerate(result["board"]):
        score, place = entry["score"], f"board.{at}.score"
        entries.append({"score": score, "at": place, "provenance": f"board.{at}.provenance", "data": entry["provenance"].get("inputs", {}).get("data", ""),
                        "levels": [[worst(score, level, band, place) for band in range(len(score["bands"]) - 1)] for level, _ in LEVELS]})
    entries.sort(key=lambda entry: entry["score"]["grade"] or "Z")
    environment = files.templates(HERE)
    environment.globals.update(entries=entries, levels=[name for _, name in LEVELS], bands=spans(result["board"][0]["score"]["bands"]),
                               fig=figures.figure_function(result), same=len({entry["data"] for entry in entries}) == 1, grades=GRADES + [("–", "no object was learned against the detector")])
    return environment.get_template("board.html.j2").render(style=files.asset(HERE, "style.css"))


def main(folder):
    result = figures.read_json(os.path.join(folder, "result.json"))
    name, page = ("board.html", board_page) if "board" in result else ("score.html", score_page)
    files.write(os.path.join(folder, name), page(result))


if __name__ == "__main__":
    files.run(main, sys.argv[1])
