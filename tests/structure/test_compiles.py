"""Programs that no test runs still compile: the benchmarks and the studies, which `make test` does not build.

    python3 tests/structure/test_compiles.py BUILD FOLDER [FOLDER…]

Of every source below the folders BUILD/compile_commands.json knows the command; it is run without making anything.
"""

import json
import os
import shlex
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor


def check(entry):
    words = shlex.split(entry["command"])
    if os.path.basename(words[0]) == "ccache":
        words = words[1:]
    words = words[: words.index("-o")] + words[words.index("-o") + 2 :] + ["-fsyntax-only"]
    done = subprocess.run(words, cwd=entry["directory"], capture_output=True, text=True, check=False)
    return entry["file"], done.returncode, done.stderr


def main(build, folders):
    with open(os.path.join(build, "compile_commands.json"), encoding="utf-8") as file:
        entries = [e for e in json.load(file) if any(e["file"].startswith(os.path.join(f, "")) for f in folders)]
    for folder in folders:
        if not any(e["file"].startswith(os.path.join(folder, "")) for e in entries):
            sys.exit(f"{build}/compile_commands.json names no source in {folder}")
    with ThreadPoolExecutor(2) as pool:
        results = list(pool.map(check, entries))
    for path, code, said in results:
        print(f"{'ok' if code == 0 else 'FAILED'} {path}")
        if code != 0:
            print(said)
    sys.exit(any(code for _, code, _ in results))


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
