#!/bin/bash
# fresh_root.sh PACKAGE.deb [FOLDER]: installs the package in a fresh Debian 12 and runs what a newcomer would. As root; needs
# debootstrap and Debian's mirror. The folder (default: a temporary one, removed at the end) may hold such a root already.
set -euo pipefail
package=$(realpath "$1")
kept=${2:-}
root=${kept:-$(mktemp -d /var/tmp/mirage-root.XXXXXX)}
mirror=$(apt-get indextargets --format '$(REPO_URI)' | grep -E '/debian/?$' | head -1 || true)  # this machine's
mirror=${mirror:-http://deb.debian.org/debian}

leave() {
  for inside in proc dev/pts dev; do
    mountpoint -q "$root/$inside" && umount "$root/$inside"
  done
  [ -n "$kept" ] || rm -rf --one-file-system "$root"
}
trap leave EXIT

[ -x "$root/usr/bin/apt-get" ] || debootstrap --variant=minbase bookworm "$root" "$mirror"
mkdir -p "$root/dev/pts"
mount -t proc proc "$root/proc"
mount --bind /dev "$root/dev"
mount --bind /dev/pts "$root/dev/pts"
cp /etc/resolv.conf "$root/etc/resolv.conf"
cp "$package" "$root/tmp/mirage-simulator.deb"

inside() {
  env -i PATH=/usr/sbin:/usr/bin:/sbin:/bin HOME=/root LC_ALL=C.UTF-8 DEBIAN_FRONTEND=noninteractive chroot "$root" "$@"
}
inside apt-get update -q
inside apt-get install -y -q /tmp/mirage-simulator.deb
inside mirage --version
inside sh -c 'test -s /usr/share/man/man1/mirage-attack.1.gz && test -s /usr/share/bash-completion/completions/mirage'
inside rm -rf /tmp/demo
time inside mirage demo --quick --out /tmp/demo
inside sh -c 'test -s /tmp/demo/validate/report.html'
if inside sh -c 'find /usr/lib/mirage /usr/share/mirage -name __pycache__ | grep .'; then
  echo "fresh_root.sh: a run left files in the package's folders" >&2
  exit 1
fi
echo "installed, and the demo wrote its report"
