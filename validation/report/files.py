"""Files of the pages."""

import os

import jinja2
from markupsafe import Markup

from atomic import run, write  # noqa: F401


def templates(*folders):
    """The environment in which pages are filled; templates are looked for in these folders."""
    return jinja2.Environment(loader=jinja2.FileSystemLoader(folders), autoescape=True)


def asset(folder, name):
    """A text that goes into a page as it is."""
    with open(os.path.join(folder, name), encoding="utf-8") as file:
        return Markup(file.read())
