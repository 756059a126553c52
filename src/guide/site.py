"""The pages as a site with search, by mkdocs and its material theme (Debian: mkdocs, mkdocs-material).

    site.py SOURCE OUT

Copies the pages of NAVIGATION and what they link to into OUT/pages, in the repository's order of folders so that their links hold,
and builds OUT/html from there. A broken link ends it with exit code 1. Pages load nothing from the network, but the
search needs a server: python3 -m http.server --directory OUT/html.
"""

import os
import re
import shutil
import subprocess
import sys

NAVIGATION = [
    ("Mirage", "README.md"),
    ("Start", "src/guide/start.md"),
    ("Attack my detector", "src/guide/attack.md"),
    ("My own log", "src/guide/log.md"),
    ("Decide", "src/guide/decide.md"),
    ("Defend and certify", "src/guide/defend.md"),
    ("Trust", "src/guide/trust.md"),
    ("Export, Blender, engines", "src/guide/export.md"),
    ("Reference", [("Commands", "src/guide/commands.md"), ("Files, Python, C++", "src/guide/reference.md"),
                   ("Shipped detectors", "src/guide/detectors.md")]),
    ("Evidence", "src/guide/evidence.md"),
    ("Contribute", [("Contributing", "CONTRIBUTING.md"), ("The blueprint", "src/README.md")]),
    ("Security", "SECURITY.md"),
    ("Changes", "CHANGELOG.md"),
]

CONFIGURATION = """site_name: Mirage
docs_dir: pages
site_dir: html
use_directory_urls: false
theme:
  name: material
  font: false
  palette:
    - {media: "(prefers-color-scheme: light)", scheme: default, primary: indigo}
    - {media: "(prefers-color-scheme: dark)", scheme: slate, primary: indigo}
  features: [navigation.sections, navigation.top, search.highlight]
markdown_extensions:
  - tables
  - toc:
      permalink: true
      slugify: !!python/name:guide_slug.slug
plugins: [search]
extra_css: [narrow.css]
nav:
"""


# Words without spaces, such as an option's list of defaults, break at the end of a phone's column.
STYLE = ".md-typeset { overflow-wrap: anywhere; }\n"


def pages(entries=NAVIGATION):
    for _, at in entries:
        yield from [at] if isinstance(at, str) else pages(at)


def nav(entries, indent="  "):
    for title, at in entries:
        if isinstance(at, str):
            yield f'{indent}- "{title}": {at}'
        else:
            yield f'{indent}- "{title}":'
            yield from nav(at, indent + "    ")


def targets(text):
    """The links of a page, except into the network and to itself; code has no links."""
    text = re.sub(r"^(?: {4}).*$", "", re.sub(r"`[^`\n]*`", "", text), flags=re.M)
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if "://" not in target and not target.startswith(("#", "mailto:")):
            yield target.partition("#")[0]


def as_mkdocs_reads(text):
    """GitHub needs no empty line between a sentence and its list; Python-Markdown does."""
    return re.sub(r"(?m)^((?!\s*(?:[-*]|\d+\.) |\s{2,}|\|).+)\n(?=(?:[-*]|1\.) )", r"\1\n\n", text)


def stage(source, out):
    """Copies the pages and the files that they show; files that are not pages are copied unchanged."""
    to = os.path.join(out, "pages")
    shutil.rmtree(to, ignore_errors=True)
    names = list(pages())
    for name in names:
        with open(os.path.join(source, name), encoding="utf-8") as file:
            text = file.read()
        os.makedirs(os.path.dirname(os.path.join(to, name)), exist_ok=True)
        with open(os.path.join(to, name), "w", encoding="utf-8") as file:
            file.write(as_mkdocs_reads(text))
        for target in targets(text):
            linked = os.path.normpath(os.path.join(os.path.dirname(name), target))
            if linked.endswith(".md") and linked not in names:
                sys.exit(f"{name}: links to {linked}, which is not a page of the site; add it to NAVIGATION")
            if not linked.endswith(".md"):
                os.makedirs(os.path.dirname(os.path.join(to, linked)), exist_ok=True)
                shutil.copyfile(os.path.join(source, linked), os.path.join(to, linked))


def main(source, out):
    os.makedirs(out, exist_ok=True)
    stage(source, out)
    with open(os.path.join(out, "mkdocs.yml"), "w", encoding="utf-8") as file:
        file.write(CONFIGURATION + "\n".join(nav(NAVIGATION)) + "\n")
    with open(os.path.join(out, "pages", "narrow.css"), "w", encoding="utf-8") as file:
        file.write(STYLE)
    # Anchors as GitHub makes them, so that a link holds in both places.
    with open(os.path.join(out, "guide_slug.py"), "w", encoding="utf-8") as file:
        file.write('import re\n\n\ndef slug(text, separator):\n'
                   '    return re.sub(r"[^\\w\\- ]", "", re.sub(r"[`*]", "", text).strip().lower()).replace(" ", separator)\n')
    run = subprocess.run([sys.executable, "-m", "mkdocs", "build", "--strict", "--clean", "-q"], cwd=out, check=False,
                         env={**os.environ, "PYTHONPATH": os.path.abspath(out)})
    if run.returncode == 0:
        print(f"{len(list(pages()))} pages: {os.path.join(out, 'html', 'index.html')}")
    return run.returncode


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
