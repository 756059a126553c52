"""A picture of a report's head, for src/guide/start.md: screenshot.py REPORT.html OUT.png [HEIGHT]"""

import sys
import time

import browser


def main(report, out, height=1480):
    with browser.Browser() as chromium:
        chromium.theme("light")
        chromium.open(report)
        if chromium.run("!!document.getElementById('model')"):
            chromium.wait_for("document.getElementById('model').loaded")
            time.sleep(2)  # it fades in
        chromium.screenshot(out, (0, 0, 1280, int(height)))


if __name__ == "__main__":
    main(*sys.argv[1:])
