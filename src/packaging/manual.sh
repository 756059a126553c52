#!/bin/sh
# manual.sh PROGRAM HELP2MAN OUT VERSION: mirage.1.gz and a page mirage-COMMAND.1.gz for each command, from --help.
set -eu
program=$1 help2man=$2 out=$3 version=$4
if [ ! -x "$help2man" ]; then
  echo "help2man is missing; make manual installs it" >&2
  exit 1
fi
rm -rf "$out"
mkdir -p "$out"

# The day of the pages is the sources', so that the same sources give the same bytes.
SOURCE_DATE_EPOCH=${SOURCE_DATE_EPOCH:-$(git -C "$(dirname "$0")" log -1 --format=%ct 2>/dev/null || date +%s)}
export SOURCE_DATE_EPOCH

# page COMMAND NAME_LINE: of a script that help2man takes for the program. An option as wide as its column stands one space before its
# text, which help2man takes for one word.
page() {
  name="mirage${1:+-$1}"
  printf '#!/bin/sh\n"%s" %s "$@" | sed -E "s/^(  -[^ ]+ [A-Z][^ ]*) ([^ A-Z])/\\1  \\2/"\n' "$program" "$1" > "$out/$name"
  chmod +x "$out/$name"
  "$help2man" --no-info --no-discard-stderr --version-string="$version" --source="Mirage $version" --section=1 --manual=Mirage \
    --name="$2" --include="$out/see-also" --output="$out/$name.1" "$out/$name"
  gzip -9n "$out/$name.1"
  rm "$out/$name"
}

commands=$("$program" --completion commands)
printf '[SEE ALSO]\n' > "$out/see-also"
printf '%s\n' "$commands" | cut -f1 | sed 's/.*/.BR mirage-& (1),/' >> "$out/see-also"
printf '.BR mirage (1)\n' >> "$out/see-also"

tab=$(printf '\t')
page "" "attacks on camera + LiDAR detectors by differentiable simulation"
printf '%s\n' "$commands" | while IFS=$tab read -r name help; do
  page "$name" "$help"
done
rm "$out/see-also"
