#!/bin/sh
# commit.sh SOURCE BUILD CMAKE: the commit that the program names is the one that its sources are of, and is no part of the program.
set -eu
source=$1 build=$2 cmake=$3
command -v git > /dev/null || { echo "skipped: git is not installed"; exit 77; }
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
# Nobody's settings, and no repository around the scratch folder.
export HOME="$scratch" GIT_CONFIG_NOSYSTEM=1 GIT_CEILING_DIRECTORIES="$scratch"
unset GIT_DIR GIT_WORK_TREE GIT_INDEX_FILE
repository=$scratch/repository out=$scratch/commit

fail() {
  echo "commit.sh: $*" >&2
  exit 1
}
in_repository() {
  git -C "$repository" -c user.name=a -c user.email=a@b "$@" > "$scratch/log" 2>&1 || { cat "$scratch/log"; fail "git $*"; }
}
demand() {  # demand EXPECTED WHEN
  "$cmake" -DGIT="$(command -v git)" -DSOURCE="$repository" -DOUT="$out" -P "$source/src/packaging/commit.cmake"
  found=$(cat "$out" 2> /dev/null || true)
  [ "$found" = "$1" ] || fail "names '$found' $2, not '$1'"
}

mkdir "$repository"
echo 1 > "$repository/tracked"
demand "" "without a repository"
in_repository init -q
in_repository add tracked
in_repository commit -q -m one
first=$(git -C "$repository" rev-parse --short HEAD)
demand "$first" "of a clean tree"
touch -d 2000-01-01 "$out"
demand "$first" "when asked again"
[ "$out" -ot "$repository/tracked" ] || fail "writes what is written"
touch -d 2001-01-01 "$repository/tracked"
demand "$first" "after a touch"
echo 2 > "$repository/tracked"
demand "$first-dirty" "of a changed file"
in_repository commit -q -a -m two
demand "$(git -C "$repository" rev-parse --short HEAD)" "after a commit"
in_repository tag v7
demand "v7" "of a tag"
rm -rf "$repository/.git"
demand "" "once the repository is gone"

# A cache or a half-done run of the same program is not lost with a commit.
named=$(cat "$build/mirage.commit" 2> /dev/null || true)
"$build/mirage" --version | grep -qF "(${named:+commit }${named:-sources without git})" || fail "--version names another commit"
hash=$(printf %s "$named" | sed -nE 's/^(.*-g)?([0-9a-f]{7,})(-dirty)?$/\2/p')
if [ -n "$hash" ] && grep -qaF "$hash" "$build/mirage"; then
  fail "the program holds the name of its commit"
fi
