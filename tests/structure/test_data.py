"""A test that needs recorded data is skipped without, so its reader is told which: the name of one that reads real frames has `Real` in
it, and CONTRIBUTING.md's table has every variable that names data.

    python3 tests/structure/test_data.py SOURCE
"""

import glob
import os
import re
import sys

TEST = re.compile(r"^TEST(?:_[FP])?\(\s*(\w+),\s*(\w+)\)", re.M)
READS = re.compile(r"real_frames\(\)|MIRAGE_NEED_REAL_FRAMES\(\)|MIRAGE_KITTI")


def unnamed(text):
    """Tests of a file that read real frames, or a helper of it that does, and do not say so."""
    found, *bodies = [], *TEST.finditer(text)
    ends = [test.start() for test in bodies[1:]] + [len(text)]
    helpers = {name for name, body in re.findall(r"^[\w:<> ]+?(\w+)\([^\n]*\) \{\n(.*?)^\}", text, re.M | re.S)
               if READS.search(body)}
    for test, end in zip(bodies, ends):
        body = text[test.end():end].partition("\n}")[0]
        if (READS.search(body) or any(re.search(rf"\b{name}\(", body) for name in helpers)) and "Real" not in test[1] + test[2]:
            found.append(f"{test[1]}.{test[2]}")
    return found


def main(source):
    with open(os.path.join(source, "CONTRIBUTING.md"), encoding="utf-8") as file:
        table = set(re.findall(r"^\| `(MIRAGE_\w+)` \|", file.read(), re.M))
    wrong, files, variables = [], 0, set()
    for path in sorted(glob.glob(os.path.join(source, "tests", "**", "*.cpp"), recursive=True) +
                       glob.glob(os.path.join(source, "tests", "support", "*.h"))):
        with open(path, encoding="utf-8") as file:
            text = file.read()
        files += 1
        name = os.path.relpath(path, source)
        wrong += [f"{name}: {test} reads real frames without Real in its name" for test in unnamed(text)]
        if os.path.basename(os.path.dirname(path)) not in ("plugins", "targets"):  # programs that tests start, and tell what to do
            variables.update(re.findall(r'getenv\("(MIRAGE_\w+)"', text))
    wrong += [f"CONTRIBUTING.md, Data for tests: {variable} has no row" for variable in sorted(variables - table)]
    wrong += [f"CONTRIBUTING.md, Data for tests: no test reads {variable}" for variable in sorted(table - variables)]
    for line in wrong:
        print(line)
    print(f"{files} files, {len(variables)} variables, {len(wrong)} wrong")
    sys.exit(1 if wrong or files < 50 or not variables else 0)


def planted():
    """The search finds planted errors; otherwise it might find nothing."""
    text = ("path here() {\n  return real_frames();\n}\n\nTEST(A, Plain) {\n  f();\n}\n\nTEST(A, OfReal) {\n  here();\n}\n\n"
            "TEST(A, Hides) {\n  here();\n}\n\nTEST_F(B, Hides) {\n  MIRAGE_NEED_REAL_FRAMES();\n}\n")
    assert unnamed(text) == ["A.Hides", "B.Hides"], unnamed(text)


if __name__ == "__main__":
    planted()
    main(sys.argv[1])
