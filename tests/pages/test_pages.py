"""What the pages say against what is there: links and headings (cited in sources, too), files, options, names of tests.

    python3 test_pages.py SOURCE BUILD

Reads every *.md of SOURCE. Options are held against `BUILD/mirage COMMAND --help`; without that program they are skipped.
"""

import fnmatch
import os
import re
import subprocess
import sys

SKIPPED = {".git", "build", "out", "node_modules"}
README_WORDS, README_CELL_WORDS = 1200, 15
# Where a page's `folder/file.h` may stand.
ROOTS = ("", "src", "tests", "plugins", "validation", "src/scene", "plugins/detectors/fusion")


def files_of(source, ending):
    for folder, folders, names in os.walk(source):
        folders[:] = [f for f in folders if f not in SKIPPED]
        yield from (os.path.join(folder, name) for name in names if name.endswith(ending))


def read(path):
    with open(path, encoding="utf-8") as file:
        return file.read()


def without_code(text):
    """The text without blocks and spans of code: links in those are none."""
    text = re.sub(r"^(```.*?^```|(?:    |\t).*?)$", "", text, flags=re.M | re.S)
    return re.sub(r"`[^`\n]*`", lambda span: " " * len(span.group()), text)


def code(text):
    """Lines and spans of code, a command each; continued lines are joined."""
    text = text.replace("\\\n", " ")
    blocks = re.findall(r"^(?:    |\t)(.*)$", text, flags=re.M)
    return blocks + re.findall(r"`([^`]+)`", text)


def slug(heading):
    """A heading's anchor as GitHub makes it."""
    heading = re.sub(r"[`*]", "", heading).strip().lower()
    return re.sub(r"[^\w\- ]", "", heading).replace(" ", "-")


def anchors(path):
    return {slug(heading) for heading in re.findall(r"^#+ (.*)$", read(path), flags=re.M)}


def broken_links(page, text):
    for target in re.findall(r"\]\(([^)\s]+)\)", without_code(text)):
        if "://" in target or target.startswith("mailto:"):
            continue
        name, _, anchor = target.partition("#")
        path = os.path.join(os.path.dirname(page), name) if name else page
        if not os.path.exists(path):
            yield f"link to {target}: no such file"
        elif anchor and path.endswith(".md") and anchor not in anchors(path):
            yield f"link to {target}: no such heading"


def missing_files(source, page, text):
    """Source files that are named in code: folder/name.h and the like; name.{h,cpp} means both."""
    for span in code(text):
        for name in re.findall(r"(?<![\w./-])((?:[\w-]+/)+[\w-]+\.(?:h|cpp|py|toml|cmake|\{h,cpp\}))(?![\w.])", span):
            if name.startswith(("out/", "path/")):
                continue
            each = [name.replace("{h,cpp}", e) for e in ("h", "cpp")] if "{" in name else [name]
            for file in each:
                places = [os.path.dirname(page)] + [os.path.join(source, root) for root in ROOTS]
                if not any(os.path.exists(os.path.join(place, file)) for place in places):
                    yield f"`{file}`: no such file"


class Options:
    """Options of the program's commands, asked for once."""

    def __init__(self, program):
        self.program, self.known = program, {}

    def of(self, command):
        if command not in self.known:
            run = subprocess.run([self.program, command, "--help"], capture_output=True, text=True, check=False)
            self.known[command] = set(re.findall(r"--[a-z][a-z0-9-]*", run.stdout)) if run.returncode == 0 else None
        return self.known[command]


def unknown_options(options, text):
    for line in code(text):
        for command, rest in re.findall(r"(?:^|[\s/$(])mirage ([a-z]+)((?:[ ](?!#)[^|;()]*)?)", line):
            if command not in COMMANDS and not rest.strip().startswith("-"):
                continue  # a sentence
            known = options.of(command)
            if known is None:
                yield f"`mirage {command}`: no such command"
                continue
            for option in re.findall(r"(?:^|\s)(--[a-z][a-z0-9-]*)", rest.split(" # ")[0]):
                if option not in known:
                    yield f"`mirage {command}` has no {option}"


COMMANDS = {"demo", "generate", "simulate", "fit", "train", "detect", "attack", "evaluate", "export", "validate", "tradeoff",
            "defend", "certify", "render", "depth", "reproduce", "view"}


def test_names(source):
    pattern = re.compile(r"^(?:TEST(?:_F|_P)?|RC_GTEST_PROP)\(\s*(\w+),\s*\"?(\w+)", re.M)
    for path in files_of(os.path.join(source, "tests"), ".cpp"):
        yield from (f"{suite}.{name}" for suite, name in pattern.findall(read(path)))


def unmatched_filters(names, text):
    for wanted in re.findall(r"--gtest_filter='?([\w*.:?]+)", text):
        for pattern in wanted.split(":"):
            if not any(fnmatch.fnmatchcase(name, pattern) for name in names):
                yield f"--gtest_filter={pattern} matches no test"


def broken_citations(source, path):
    """Comments that cite a heading: (src/README.md, HEADING)."""
    for page, heading in re.findall(r"([\w/]+\.md), ([A-Z][^);]*)[);]", read(path)):
        if not os.path.exists(os.path.join(source, page)):
            yield f"cites {page}: no such file"
        elif slug(heading) not in anchors(os.path.join(source, page)):
            yield f"cites {page}, {heading}: no such heading"


def too_long(readme):
    """What of the user's page is longer than a stranger reads: the page, and cells of its tables. A link counts as its text."""
    words = len(readme.split())
    if words > README_WORDS:
        yield f"{words} words, more than {README_WORDS}; move some to the page beside the code"
    for row in re.findall(r"^\|(.*)\|\s*$", readme, flags=re.M):
        for cell in re.sub(r"\]\([^)]*\)", "]", row).split("|"):
            if len(cell.split()) > README_CELL_WORDS:
                yield f"a cell of {len(cell.split())} words, more than {README_CELL_WORDS}: {cell.strip()[:60]}"


def main(source, build):
    source = os.path.abspath(source)
    program = os.path.join(build, "mirage")
    options = Options(program) if os.access(program, os.X_OK) else None
    if not options:
        print("no mirage in the build folder: options are not looked at")
    names = list(test_names(source))
    problems, pages = [], sorted(files_of(source, ".md"))
    for page in pages:
        text = read(page)
        found = [*broken_links(page, text), *missing_files(source, page, text), *unmatched_filters(names, text)]
        if options:
            found += unknown_options(options, text)
        if "../shared" in text:
            found.append("names a folder beside the repository, which a reader has not")
        problems += [f"{os.path.relpath(page, source)}: {problem}" for problem in found]
    for ending in (".h", ".cpp"):
        for path in files_of(source, ending):
            problems += [f"{os.path.relpath(path, source)}: {problem}" for problem in broken_citations(source, path)]
    problems += [f"README.md: {problem}" for problem in too_long(read(os.path.join(source, "README.md")))]
    print("\n".join(problems) or f"{len(pages)} pages, {len(names)} tests known: nothing wrong")
    return 1 if problems or len(pages) < 10 else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
