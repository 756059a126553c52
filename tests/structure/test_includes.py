"""The structure that src/README.md promises, read off the sources: no two units include each other, directly or in a round (a unit is
a header with its source file), a layer or a plugin of the table includes only what its row names, and so does a room of src/README.md.

    python3 tests/structure/test_includes.py SOURCE
"""

import fnmatch
import os
import re
import sys

TOPS = ("src", "validation", "plugins")
INCLUDE = re.compile(r'^\s*#\s*include "([^"]+)"', re.MULTILINE)


def units(source):
    """{unit: {units that it includes}}; a unit is a path without its ending."""
    found = {}
    for top in TOPS:
        for folder, _, names in os.walk(os.path.join(source, top)):
            for name in sorted(names):
                if not name.endswith((".h", ".cpp")):
                    continue
                path = os.path.relpath(os.path.join(folder, name), source)
                unit = os.path.splitext(path)[0]
                mine = found.setdefault(unit, set())
                with open(os.path.join(source, path), encoding="utf-8") as file:
                    text = file.read()
                for include in INCLUDE.findall(text):
                    for place in (os.path.join("src", include), include, os.path.join(os.path.dirname(path), include)):
                        if os.path.exists(os.path.join(source, place)):
                            other = os.path.splitext(os.path.normpath(place))[0]
                            if other != unit:
                                mine.add(other)
                            break
    return found


def rounds(graph):
    """Strongly connected sets of more than one unit (Tarjan, SIAM J. Comput. 1972), without recursion."""
    index, low, stack, on_stack, found = {}, {}, [], set(), []
    for root in graph:
        if root in index:
            continue
        work = [(root, iter(sorted(graph[root])))]
        index[root] = low[root] = len(index)
        stack.append(root)
        on_stack.add(root)
        while work:
            unit, others = work[-1]
            for other in others:
                if other not in graph:
                    continue
                if other not in index:
                    index[other] = low[other] = len(index)
                    stack.append(other)
                    on_stack.add(other)
                    work.append((other, iter(sorted(graph[other]))))
                    break
                if other in on_stack:
                    low[unit] = min(low[unit], index[other])
            else:
                work.pop()
                if work:
                    low[work[-1][0]] = min(low[work[-1][0]], low[unit])
                if low[unit] == index[unit]:
                    members = []
                    while not members or members[-1] != unit:
                        members.append(stack.pop())
                        on_stack.discard(members[-1])
                    if len(members) > 1:
                        found.append(sorted(members))
    return found


def table(path, name, width):
    """(name, cells) of the rows with `width` cells whose first one matches `name`."""
    with open(path, encoding="utf-8") as file:
        for line in file:
            cells = [cell.strip() for cell in line.split("|")[1:-1]]
            match = re.match(name, cells[0]) if len(cells) == width else None
            if match:
                yield match[1], cells


def place(unit):
    """The row that a unit is of: src/base, validation, plugins/depth; plugins for what lies beside the plugins' folders."""
    parts = unit.split(os.sep)
    return parts[0] if parts[0] == "validation" or len(parts) < 3 else "/".join(parts[:2])


def row(may, above):
    """The patterns of units that a row's words allow. `above`: places of the rows above it."""
    layers, headers = re.sub("`[^`]*`", "", may), re.findall(r"`([^`]+)\.h`", may)
    if layers.strip() == "everything":
        return ["*"]
    among, _, but = layers.partition(" but ")
    named = above if among.strip() == "all of the above" else ["src/" + word for word in re.findall(r"\w+", among)]
    return [at + "/*" for at in named if at != "src/" + but.strip()] + ["src/" + header for header in headers]


def allowed(source):
    """{place: patterns of the units that it may include}, from the table of src/README.md."""
    rows = {}
    for at, cells in table(os.path.join(source, "src/README.md"), r"`((?:src|plugins)/\w+|validation|plugins)`$", 4):
        rows[at] = row(cells[2], list(rows))
    return rows


def forbidden(graph, rows):
    """(unit, what it includes) against the rows. Plugins share what lies beside their folders."""
    for unit, others in sorted(graph.items()):
        at = place(unit)
        may = rows.get(at, [])
        for other in sorted(others):
            shared = place(other) == "plugins" and at.startswith("plugins")
            if place(other) != at and not shared and not any(fnmatch.fnmatchcase(other, pattern) for pattern in may):
                yield unit, other


def rooms(source):
    """{room: rooms that it may include}, from the table of src/README.md."""
    rows = table(os.path.join(source, "src/README.md"), r"\[?`validation/(\w+)`", 3)
    return {room: set(re.findall(r"\w+", cells[2])) for room, cells in rows}


def main(source):
    graph = units(source)
    wrong = ["these include each other: " + ", ".join(members) for members in rounds(graph)]
    rows = allowed(source)
    if len(rows) < 18 or len(graph) < 200:
        sys.exit(f"{source}: {len(rows)} rows and {len(graph)} units were found: neither the table nor the sources are where they were")
    wrong += [f"{unit} includes {other}, which the row of {place(unit)} in src/README.md does not name" for unit, other in forbidden(graph, rows)]
    inside = rooms(source)
    if len(inside) < 8:
        sys.exit(f"{source}: {len(inside)} rooms were found in src/README.md")
    for unit, others in sorted(graph.items()):
        parts = unit.split(os.sep)
        if parts[0] != "validation" or len(parts) < 3:
            continue
        if parts[1] not in inside:
            wrong.append(f"{unit} lies in no room of src/README.md")
            continue
        for other in sorted(others):
            to = other.split(os.sep)
            if to[0] == "validation" and len(to) > 2 and to[1] != parts[1] and to[1] not in inside[parts[1]]:
                wrong.append(f"{unit} includes {other}, which the row of {parts[1]} in src/README.md does not name")
    for line in wrong:
        print(line)
    print(f"{len(graph)} units, {sum(map(len, graph.values()))} includes, {len(wrong)} wrong")
    sys.exit(1 if wrong else 0)


def planted():
    """The search finds planted errors; otherwise it might find nothing."""
    loop = {"a": {"b"}, "b": {"c"}, "c": {"a", "d"}, "d": set(), "e": {"d", "a"}}
    assert rounds(loop) == [["a", "b", "c"]], rounds(loop)
    assert rounds({"a": {"b"}, "b": set()}) == []
    rows = {"src/base": [], "src/scene": row("base", []), "src/cli": row("everything", ["src/base"])}
    rows["validation"] = row("all of the above but cli", list(rows))
    rows["plugins/detectors"] = row("base, `scene/abi*.h`", list(rows))
    graph = {"src/base/a": {"src/base/b", "src/scene/c"}, "src/scene/c": {"src/base/a"}, "src/cli/m": {"validation/v", "src/scene/c"},
             "validation/v": {"src/scene/c", "src/cli/m"}, "plugins/t": {"src/base/a"},
             "plugins/detectors/f/n": {"plugins/t", "src/scene/abi3", "src/scene/c", "plugins/detectors/p", "plugins/depth/g/n"}}
    found = list(forbidden(graph, rows))
    assert found == [("plugins/detectors/f/n", "plugins/depth/g/n"), ("plugins/detectors/f/n", "src/scene/c"), ("plugins/t", "src/base/a"),
                     ("src/base/a", "src/scene/c"), ("validation/v", "src/cli/m")], found


if __name__ == "__main__":
    planted()
    main(sys.argv[1])
