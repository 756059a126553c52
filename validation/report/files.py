"""Files of the pages."""

import os
import tempfile

from markupsafe import Markup


def write(path, text):
    """All or nothing."""
    handle, temporary = tempfile.mkstemp(dir=os.path.dirname(path) or ".", suffix=".tmp")
    with os.fdopen(handle, "w", encoding="utf-8") as file:
        file.write(text)
    os.chmod(temporary, 0o644)
    os.replace(temporary, path)


def asset(folder, name):
    """A text that goes into a page as it is."""
    with open(os.path.join(folder, name), encoding="utf-8") as file:
        return Markup(file.read())
