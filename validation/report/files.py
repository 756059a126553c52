"""Files of the pages."""

import os

from markupsafe import Markup

from atomic import run, write  # noqa: F401


def asset(folder, name):
    """A text that goes into a page as it is."""
    with open(os.path.join(folder, name), encoding="utf-8") as file:
        return Markup(file.read())
