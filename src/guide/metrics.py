"""The size of the project: metrics.py SOURCE prints words of the pages, lines of C++, their files, weights and casts. A word has
a letter or a digit; table bars do not count."""

import os
import re
import statistics
import sys

SKIPPED = {".git", "build", "out", "node_modules"}
CODE = ("src", "plugins", "validation")
GENERATED, HISTORY = os.path.join("src", "guide", "commands.md"), "CHANGELOG.md"


def files(source, endings, below=("",)):
    for part in below:
        for folder, folders, names in os.walk(os.path.join(source, part)):
            folders[:] = sorted(f for f in folders if f not in SKIPPED)
            yield from (os.path.join(folder, name) for name in sorted(names) if name.endswith(endings))


def read(path):
    with open(path, encoding="utf-8") as file:
        return file.read()


def code(source, title, below):
    texts = {path: read(path) for path in files(source, (".cpp", ".h"), below)}
    lines = {path: text.count("\n") for path, text in texts.items()}
    longest = max(lines, key=lines.get)
    yield f"C++ in {title}", f"{sum(lines.values())} lines, {len(lines)} files"
    yield "  median, under 40 lines", f"{statistics.median(lines.values()):.0f} lines, {sum(n < 40 for n in lines.values())} files"
    yield "  longest", f"{lines[longest]} lines, {os.path.relpath(longest, source)}"
    yield "  to std::size_t", str(sum(len(re.findall(r"\bas_size\(|static_cast<(?:std::)?size_t>", t)) for t in texts.values()))


def rows(source):
    words = {os.path.relpath(page, source): sum(any(c.isalnum() for c in word) for word in read(page).split())
             for page in files(source, ".md")}
    by_hand = {page: n for page, n in words.items() if page not in (GENERATED, HISTORY)}
    yield "pages", f"{sum(by_hand.values())} words, {len(by_hand)} files"
    yield "  README", f"{words['README.md']} words"
    yield "  commands, from --help", f"{words.get(GENERATED, 0)} words"
    yield "  changes", f"{words[HISTORY]} words"
    yield from code(source, ", ".join(CODE), CODE)
    yield from code(source, "tests", ("tests",))
    weights = [os.path.getsize(path) for path in files(source, (".weights", ".parts"), CODE)]
    yield "weights", f"{sum(weights) / 1e6:.1f} MB, {len(weights)} files"


if __name__ == "__main__":
    for name, figure in rows(sys.argv[1]):
        print(f"{name:<28} {figure}")
