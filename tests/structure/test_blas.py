"""The program's BLAS is OpenBLAS: LibTorch multiplies with the first BLAS that is linked, and Ceres links ATLAS.

    python3 tests/structure/test_blas.py SOURCE BUILD
"""

import os
import re
import subprocess
import sys

BLAS = ("libopenblas", "libf77blas", "libblas", "libatlas", "libcblas")


def main():
    program = os.path.join(sys.argv[2], "mirage")
    with open(os.path.join(sys.argv[2], "CMakeCache.txt"), encoding="utf-8") as file:
        if not re.search(r"^MIRAGE_OPENBLAS:FILEPATH=/", file.read(), re.MULTILINE):
            print("skipped: this machine has no OpenBLAS")
            sys.exit(77)
    told = subprocess.run(["readelf", "-d", program], check=True, capture_output=True, text=True).stdout
    needed = re.findall(r"\(NEEDED\).*\[(.*)\]", told)
    found = [library for library in needed if library.startswith(BLAS)]
    if not found or not found[0].startswith("libopenblas"):
        sys.exit(f"{program} names {', '.join(found) or 'no BLAS'}: OpenBLAS must come first (src/packages.cmake, mirage_blas)")
    print("first of", ", ".join(found))


main()
