# Sourced with `suite` (bookworm, trixie, …) and `kept` (a folder, or empty): a bare Debian of that suite in the folder $root, made
# by debootstrap unless it holds one already, and `inside COMMAND` to run something there. Without `kept` the folder is a
# temporary one, removed at the end. As root; needs debootstrap and Debian's mirror.
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

[ -x "$root/usr/bin/apt-get" ] || debootstrap --variant=minbase "$suite" "$root" "$mirror"
mkdir -p "$root/dev/pts"
mount -t proc proc "$root/proc"
mount --bind /dev "$root/dev"
mount --bind /dev/pts "$root/dev/pts"
cp /etc/resolv.conf "$root/etc/resolv.conf"

inside() {
  env -i PATH=/usr/sbin:/usr/bin:/sbin:/bin HOME=/root LC_ALL=C.UTF-8 DEBIAN_FRONTEND=noninteractive chroot "$root" "$@"
}
inside apt-get update -q
