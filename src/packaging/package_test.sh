#!/bin/bash
# package_test.sh PACKAGE.deb [FOLDER]: installs the package in a fresh root of this machine's own Debian (fresh_root.sh) and runs
# what a newcomer would.
set -euo pipefail
package=$(realpath "$1")
kept=${2:-}
suite=$(. /etc/os-release && echo "$VERSION_CODENAME")
. "$(dirname "$0")/fresh_root.sh"

cp "$package" "$root/tmp/mirage-simulator.deb"
inside apt-get install -y -q /tmp/mirage-simulator.deb
inside mirage --version
inside sh -c 'test -s /usr/share/man/man1/mirage-attack.1.gz && test -s /usr/share/bash-completion/completions/mirage'
inside rm -rf /tmp/demo
time inside mirage demo --quick --out /tmp/demo
inside sh -c 'test -s /tmp/demo/validate/report.html'
if inside sh -c 'find /usr/lib/mirage /usr/share/mirage -name __pycache__ | grep .'; then
  echo "package_test.sh: a run left files in the package's folders" >&2
  exit 1
fi
echo "installed, and the demo wrote its report"
