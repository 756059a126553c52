"""A picture of a report, for the pages: screenshot.py REPORT.html OUT.png [CSS SELECTOR]. Without a selector its head."""

import sys
import time

import browser

HEAD = (0, 0, 1280, 1480)  # left, top, width, height
MARGIN = 18


def main(report, out, selector=None):
    with browser.Browser() as chromium:
        chromium.theme("light")
        chromium.open(report)
        if chromium.run("!!document.getElementById('model')"):
            chromium.run("document.getElementById('model').scrollIntoView()")  # it loads when it is seen
            chromium.wait_for("document.getElementById('model').loaded")
            time.sleep(2)  # it fades in
            chromium.run("scrollTo(0, 0)")
        place = HEAD
        if selector:
            x, y, width, height = chromium.run(f"(() => {{ const r = document.querySelector({selector!r}).getBoundingClientRect();"
                                               "return [r.x, r.y, r.width, r.height] })()")
            place = (x - MARGIN, y, width + 2 * MARGIN, height)
        chromium.screenshot(out, place)


if __name__ == "__main__":
    main(*sys.argv[1:])
