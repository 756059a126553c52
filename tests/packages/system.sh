#!/bin/bash
# system.sh SOURCE: src/packaging/system_test.sh in a root that only writes down what it is asked: the demo has the bare machine for
# itself, and the table tells what was skipped, what failed, and which step did.
set -euo pipefail
source=$1
command -v git > /dev/null || { echo "skipped: git is not installed"; exit 77; }
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
export HOME=$scratch GIT_CONFIG_NOSYSTEM=1
unset GIT_DIR GIT_WORK_TREE GIT_INDEX_FILE
repository=$scratch/repository
mkdir -p "$repository/src/packaging" "$scratch/root/srv"
cp "$source/src/packaging/system_test.sh" "$repository/src/packaging/"
cat > "$repository/src/packaging/fresh_root.sh" <<ROOT
root=$scratch/root
inside() {
  echo "\$*" >> $scratch/asked
  case "\$*" in
    *' test') printf '\t  7 - Depth.OfRealFrames (Skipped)\n\t 12 - Box.Turns (Failed)\n99%% tests passed, 1 tests failed out of 12\n'; return 8;;
    *' build') mkdir -p $scratch/root/srv/sources/build/release/Testing/Temporary
               echo 12:Box.Turns > $scratch/root/srv/sources/build/release/Testing/Temporary/LastTestsFailed.log;;
  esac
}
ROOT
git -C "$repository" init -q
git -C "$repository" add .
git -C "$repository" -c user.name=a -c user.email=a@b commit -q -m one

fail() {
  cat "$scratch/said" "$scratch/asked" 2> /dev/null || true
  echo "system.sh: $*" >&2
  exit 1
}
! "$repository/src/packaging/system_test.sh" trixie > "$scratch/said" 2>&1 || fail "a failing step gives exit code 0"
[ "$(grep -o 'make -C .*' "$scratch/asked" | sed 's/.* //' | tr '\n' ' ')" = "demo setup build test " ] || fail "the steps are others"
for line in 'skipped: Depth.OfRealFrames' 'failed: 12:Box.Turns' '99% tests passed, 1 tests failed out of 12'; do
  grep -qxF "$line" "$repository/build/system-test/trixie/table.md" || fail "the table does not say '$line'"
done
grep -qE '^\| demo \| [0-9]+ \| ok \|$' "$scratch/said" || fail "the demo's step is not told"
grep -qE '^\| test \| [0-9]+ \| exit code 8 \|$' "$scratch/said" || fail "the failing step is not told"
