#!/bin/bash
# system_test.sh SUITE [FOLDER [ARCH]]: `make demo` and `make test` of the last commit in a bare Debian (fresh_root.sh), as a
# newcomer has them. Prints a table of seconds, and which tests were skipped or failed; logs and the runs' result.json go to
# build/system-test/SUITE. Exit code 1 where a step fails; the steps after it are tried all the same. With ARCH, another processor:
# `make portable` in their place, cross-compiled, and run by qemu.
set -euo pipefail
suite=$1
kept=${2:-}
arch=${3:-}
here=$(cd "$(dirname "$0")" && pwd)
source=$(git -C "$here" rev-parse --show-toplevel)
out=$source/build/system-test/$suite${arch:+-$arch}
rm -rf "$out"
mkdir -p "$out"
failed=0

step() {  # step NAME COMMAND…: one row of the table
  local name=$1 started=$SECONDS outcome=ok
  shift
  "$@" > "$out/$name.log" 2>&1 || outcome="exit code $?"
  [ "$outcome" = ok ] || failed=1
  printf '| %s | %d | %s |\n' "$name" $((SECONDS - started)) "$outcome" | tee -a "$out/table.md"
}

echo "a bare $suite; how it is made: $out/root.log" >&2
started=$SECONDS
. "$here/fresh_root.sh" > "$out/root.log" 2>&1
{
  echo "$suite $arch, commit $(git -C "$source" rev-parse --short HEAD), $(date -u +%F), $(nproc) cores"
  printf '\n| step | s | outcome |\n|---|---|---|\n| root | %d | ok |\n' $((SECONDS - started))
} | tee "$out/table.md"
# No path that others hold in theirs: a test looks for it in installed files.
sources=/srv/sources
rm -rf "$root$sources"
git clone -q --depth 1 "file://$source" "$root$sources"
if [ -n "$arch" ]; then
  inside dpkg --add-architecture "$arch"
  inside apt-get update -q >> "$out/root.log" 2>&1
  triplet=$(dpkg-architecture -a"$arch" -qDEB_HOST_GNU_TYPE 2> /dev/null)
  # MPI's package for developers asks for a Fortran compiler of the other processor, and with it comes its GCC, to be emulated.
  mpi=$(inside apt-cache depends "libopenmpi-dev:$arch" | sed -n 's/^ *Depends: \(libopenmpi[0-9].*\)/\1/p')
  step prepare inside sh -c "apt-get install -y -q --no-install-recommends make g++-$triplet $mpi && cd /tmp &&
    apt-get download -q libopenmpi-dev:$arch && dpkg -x libopenmpi-dev_*.deb /"
  step portable inside make -C $sources portable ARCH="$arch" CROSS="$triplet"
else
  step prepare inside apt-get install -y -q --no-install-recommends make git ca-certificates
  # The demo first: where it lacks a package, nothing else has installed that.
  step demo inside make -C $sources demo
  step setup inside make -C $sources setup
  step build inside make -C $sources build
  step test inside make -C $sources test
fi
(cd "$root$sources" && find out -name result.json -exec cp --parents {} "$out" \;) 2> /dev/null || true
{
  echo
  inside sh -c 'dpkg-query -W -f "\${Package} \${Version}\n" g++ cmake libembree-dev libtorch-dev blender python3 clang-format' 2> /dev/null || true
  # What a single test prints is not the outcome of all.
  grep "tests passed" "$out/test.log" 2> /dev/null || true
  grep PASSED "$out/portable.log" 2> /dev/null || true
  sed -n 's/^[[:space:]]*[0-9]* - \(.*\) (Skipped)$/skipped: \1/p' "$out/test.log" 2> /dev/null || true
  sed 's/^/failed: /' "$root$sources/build/release/Testing/Temporary/LastTestsFailed.log" 2> /dev/null || true
} | tee -a "$out/table.md"
exit $failed
