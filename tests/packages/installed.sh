#!/bin/bash
# installed.sh SOURCE BUILD CMAKE: installs into a fresh folder outside the sources, moves it, and uses what lies there: the program
# with its data, plugins and weights and no variable set, and the libraries from somebody else's project.
set -euo pipefail
source=$1 build=$2 cmake=$3
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
unset MIRAGE_HOME
export MIRAGE_CACHE=off

fail() {
  echo "installed.sh: $*" >&2
  exit 1
}

"$cmake" --install "$build" --prefix "$work/first" > "$work/install.log"
mv "$work/first" "$work/moved"
prefix=$work/moved
cd "$work"  # nothing is found through the working folder

# Every header that an installed header includes is there too.
(cd "$prefix/include/mirage" && grep -rhoP '^#include "\K[^"]+' . | sort -u | while read -r header; do
  [ -f "$header" ] || fail "an installed header includes $header, which is not installed"
done)

# What a plugin, a script or a picture of the system's would hide: nothing points back.
if grep -rlF -e "$source" -e "$build" "$prefix/lib/cmake" "$prefix/share/bash-completion"; then
  fail "these installed files name the build tree"
fi

version=$("$prefix/bin/mirage" --version)
[[ "$version" =~ ^mirage\ [0-9.]+\ \( ]] || fail "--version says something else"
[ "$version" = "$("$build/mirage" --version)" ] || fail "--version says $version, and another commit in the build folder"
"$prefix/bin/mirage" generate --rig kitti64 --frames 1 --seed 3 --quiet --out data > generate.log
if [ -e "$prefix/lib/mirage/plugins/fusion.so" ]; then
  "$prefix/bin/mirage" detect --data data --detector lidar --quiet --out detected > detect.log
fi
(cd "$source" && find scenes -type f ! -name '*.jpg') | while read -r file; do
  [ -f "$prefix/share/mirage/$file" ] || fail "$file is not installed"
done
for script in blender/blender_worker.py report/report.py report/page.html.j2; do
  [ -f "$prefix/share/mirage/validation/$script" ] || fail "validation/$script is not installed"
done
python=/usr/bin/python3
[ -x $python ] || python=python3
$python -B -c "import sys; sys.path.insert(0, '$prefix/share/mirage/plugins/blender'); import mirage_blender"

# Completion: commands, options, the words of a choice, with and without an equals sign.
. "$prefix/share/bash-completion/completions/mirage"
completed() {  # completed EXPECTED WORD…: the last word is being written
  local expected=$1
  shift
  COMP_WORDS=("$@") COMP_CWORD=$(($# - 1))
  _mirage
  [[ " ${COMPREPLY[*]} " == *" $expected "* ]] || fail "completing '$*' gives '${COMPREPLY[*]}', not $expected"
}
completed attack mirage att
completed --iterations mirage attack --iter
completed depth mirage train d
completed draft mirage attack --quality dr
completed draft mirage attack --quality = dr

"$cmake" -S "$source/tests/packages/consumer" -B consumer -G Ninja -DCMAKE_PREFIX_PATH="$prefix" > configure.log 2>&1 ||
  { cat configure.log; fail "the consumer is not configured"; }
"$cmake" --build consumer > build.log 2>&1 || { cat build.log; fail "the consumer does not build"; }
frame=$(basename "$(ls data/training/image_2/* | head -1)" .png)
consumer/consumer data "$frame" sphere.glb
[ -s sphere.glb ] || fail "the consumer wrote nothing"

"$cmake" -S "$source/tests/packages/components" -B components -G Ninja -DCMAKE_PREFIX_PATH="$prefix" > components.log 2>&1 ||
  { cat components.log; fail "components cannot be asked for"; }
said() {
  grep -qF -e "-- $1" components.log || { cat components.log; fail "find_package does not say '$1'"; }
}
said "geometry: 1"
said "scene: 0 Ceres is missing (Debian package libceres-dev)"
said "magic: 0 There is no component magic; there are base geometry"
