"""What the pages of `mirage score` show: one A4 page of a detector, the board of several."""

import figures

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


def certified(score):
    """A row for each size; the first band of each is all distances."""
    return [{"at": f"score.certified.{s}.size", "cells": [{"hosts": band["hosts"], "at": f"score.certified.{s}.bands.{b}"}
                                                          for b, band in enumerate(size["bands"]) if b > 0]}
            for s, size in enumerate(score.get("certified", []))]


def values(result):
    score = result["score"]
    rows = [dict(row, cells=cells(row, f"score.rows.{at}"), at=f"score.rows.{at}") for at, row in enumerate(score["rows"])]
    return {"score": score, "bands": spans(score["bands"]), "rows": rows, "made_of": figures.made_of(result), "grades": GRADES,
            "certified": certified(score)}


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
