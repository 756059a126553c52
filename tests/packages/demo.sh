#!/bin/sh
# demo.sh SOURCE CMAKE: the demo's configuration needs none of the packages that only tests and the Python module take, and
# `make demo` installs none of them. Without them the configuration of `make test` ends with what is missing.
set -eu
source=$1 cmake=$2
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
without=""
for package in GTest rapidcheck benchmark pybind11 Python Python3; do without="$without -DCMAKE_DISABLE_FIND_PACKAGE_$package=ON"; done

cd "$source"
"$cmake" --preset demo -B "$scratch/demo" $without -DMIRAGE_NPM=MIRAGE_NPM-NOTFOUND > "$scratch/log" 2>&1 || { cat "$scratch/log"; exit 1; }
while read -r part package debian; do
  if "$cmake" --preset release -B "$scratch/$package" -DMIRAGE_TESTS=OFF -DMIRAGE_PYTHON=OFF -DMIRAGE_BENCHMARKS=OFF \
       -DMIRAGE_$part=ON -DMIRAGE_DETECTORS=OFF -DCMAKE_DISABLE_FIND_PACKAGE_$package=ON > "$scratch/log" 2>&1 < /dev/null; then
    echo "MIRAGE_$part=ON was configured without $package"
    exit 1
  fi
  # CMake breaks long lines.
  tr -s ' \n' ' ' < "$scratch/log" | grep -q "Install [a-z]* with: make setup (Debian packages* [^)]*\b$debian\b" ||
    { cat "$scratch/log"; echo "without $package, MIRAGE_$part=ON does not end with the name of $debian"; exit 1; }
done <<MISSING
TESTS GTest libgtest-dev
TESTS rapidcheck librapidcheck-dev
PYTHON pybind11 pybind11-dev
BENCHMARKS benchmark libbenchmark-dev
MISSING

# Of what it installs.
make -s --no-print-directory -f - demo-packages > "$scratch/packages" <<MAKE
include Makefile
demo-packages:
	@echo \$(DEMO_PACKAGES)
MAKE
for package in chromium nodejs npm clang-tidy clang-format strace libgtest-dev librapidcheck-dev libbenchmark-dev xvfb pybind11-dev; do
  if grep -qw -- "$package" "$scratch/packages"; then
    echo "make demo would install $package, which it does not run"
    exit 1
  fi
done
