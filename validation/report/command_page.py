"""Writes the page of `mirage audit`, compare, drive or score: one self-contained HTML file. It shows what the program judged.

    python3 command_page.py DIR

Reads DIR/result.json; the part that it holds (PAGES) says which page: DIR/PART.html.
"""

import os
import sys

HERE = os.path.dirname(os.path.abspath(__file__))
sys.dont_write_bytecode = True
sys.path.insert(0, HERE)

try:
    import figures
    import files
    import page_audit
    import page_compare
    import page_drive
    import page_score
except ImportError as error:
    sys.exit(f"command_page.py: {error.name}: not installed; install python3-jinja2 and python3-pil")

PAGES = {"audit": page_audit.values, "compare": page_compare.values, "drive": page_drive.values, "score": page_score.values,
         "board": page_score.board_values}


def main(folder):
    result = figures.read_json(os.path.join(folder, "result.json"))
    name = next(part for part in PAGES if part in result)
    fig = figures.figure_function(result)
    environment = files.templates(HERE)
    environment.globals.update(fig=fig, interval=figures.interval_function(result, fig), **PAGES[name](result))
    style = files.asset(HERE, "a4.css" if name == "score" else "style.css")
    files.write(os.path.join(folder, name + ".html"), environment.get_template(name + ".html.j2").render(style=style))


if __name__ == "__main__":
    files.run(main, sys.argv[1])
