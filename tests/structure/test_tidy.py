"""Findings of clang-tidy (.clang-tidy) on the changed lines: against where the branch left its upstream, or against the last commit but
one, and in the working tree (files that git knows).

    python3 tests/structure/test_tidy.py SOURCE BUILD [BASE]

Exits with 77 (skipped) outside of a clone. Sources that include LibTorch are left out: clang 14 does not compile Debian's headers of it.
"""

import json
import os
import re
import shlex
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor

SKIPPED = 77
FILES_AT_MOST = 16  # some twenty seconds each: the lines of the others are told and not looked at
HUNK = re.compile(r"^@@ -\S+ \+(\d+)(?:,(\d+))? @@")


def git(source, *words):
    done = subprocess.run(["git", "-C", source, *words], capture_output=True, text=True, check=False)
    return done.stdout if done.returncode == 0 else None


def base_of(source):
    """The commit that changes are compared with; None without one."""
    head, fork = git(source, "rev-parse", "HEAD"), git(source, "merge-base", "HEAD", "@{upstream}")
    return (fork if fork and fork != head else git(source, "rev-parse", "HEAD~1") or "").strip() or None


def changed_lines(source, base):
    """{path: [[first, last], …]} of the C++ sources."""
    lines, path = {}, None
    for line in (git(source, "diff", "-U0", "--no-color", "--diff-filter=d", base, "--", "*.cpp", "*.h") or "").splitlines():
        if line.startswith("+++ b/"):
            path = line[6:]
        elif (hunk := HUNK.match(line)) and int(hunk[2] or 1) > 0:
            lines.setdefault(path, []).append([int(hunk[1]), int(hunk[1]) + int(hunk[2] or 1) - 1])
    return lines


def commands(build):
    """{source file: compile command}; of a unity build's files the command of the unit that includes them."""
    with open(os.path.join(build, "compile_commands.json"), encoding="utf-8") as file:
        entries = json.load(file)
    known = {}
    for entry in entries:
        sources = [entry["file"]]
        if "/Unity/" in entry["file"] and os.path.exists(entry["file"]):
            with open(entry["file"], encoding="utf-8") as file:
                sources = re.findall(r'^#include "(/[^"]+)"', file.read(), re.MULTILINE)
        words = shlex.split(entry["command"])
        if os.path.basename(words[0]) == "ccache":
            words = words[1:]
        if "/torch/csrc/api/include" in entry["command"]:
            continue
        words = [word for word in words[: words.index("-o")] if word not in ("-Wconversion", "-Wsign-conversion")] + ["-c"]  # Clang warns of more
        for source in sources:
            known[source] = {"directory": entry["directory"], "file": source, "arguments": [*words, source]}
    return known


def includers(source, headers, known):
    """For each header a source that is compiled and includes it: its own, else any."""
    texts = {}
    for path in known:
        if path.startswith(source) and os.path.exists(path):
            with open(path, encoding="utf-8") as file:
                texts[path] = file.read()
    for header in headers:
        own = os.path.join(source, header[:-2] + ".cpp")
        names = {header, header.partition("/")[2]}
        others = (path for path, text in texts.items() if any(f'#include "{name}"' in text for name in names))
        if (unit := own if own in texts else next(others, None)) is not None:
            yield unit


def main(source, build, base=None):
    source = os.path.realpath(source)
    base = base or base_of(source)
    if base is None:
        print("no clone, or a single commit: nothing to compare with")
        return SKIPPED
    lines = changed_lines(source, base)
    known = commands(build)
    units = {os.path.join(source, path) for path in lines if path.endswith(".cpp")}
    units.update(includers(source, [path for path in lines if path.endswith(".h")], known))
    unknown = sorted(units - known.keys())
    units = sorted(units & known.keys())
    print(f"{len(lines)} files changed since {base[:12]}, {len(units)} units to look at")
    for unit in [*unknown, *units[FILES_AT_MOST:]]:
        print(f"not looked at: {os.path.relpath(unit, source)}")
    line_filter = json.dumps([{"name": os.path.join(source, path), "lines": ranges} for path, ranges in lines.items()])
    with tempfile.TemporaryDirectory() as folder:
        with open(os.path.join(folder, "compile_commands.json"), "w", encoding="utf-8") as file:
            json.dump([known[unit] for unit in units], file)

        def look(unit):
            words = ["clang-tidy", "-p", folder, "--quiet", "--warnings-as-errors=*", f"--line-filter={line_filter}",
                     "--extra-arg=-Wno-unknown-warning-option", unit]
            done = subprocess.run(words, cwd=source, capture_output=True, text=True, check=False)
            return unit, done.returncode, done.stdout

        with ThreadPoolExecutor(2) as pool:
            results = list(pool.map(look, units[:FILES_AT_MOST]))
    for unit, code, said in results:
        print(f"{'ok' if code == 0 else 'FAILED'} {os.path.relpath(unit, source)}")
        if code != 0:
            print(said)
    return int(any(code for _, code, _ in results))


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
