"""Writes files completely or not at all, like src/base/files.cpp. Needs nothing beside Python."""

import errno
import io
import json
import os
import sys


def write(path, data):
    """Text or bytes. All of it is on the disk before it takes the old file's place; OSError, and the old file stays,
    if that fails. The temporary name is one that Mirage cleans up after a kill (src/base/files.h)."""
    temporary = f"{path}.mirage-{os.getpid()}.tmp"
    try:
        with open(temporary, "wb") as file:
            file.write(data.encode() if isinstance(data, str) else data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except BaseException as error:
        if os.path.exists(temporary):
            os.unlink(temporary)
        if isinstance(error, OSError):  # of a failed write or fsync; these name no file
            raise OSError(error.errno, error.strerror, path) from None
        raise
    folder = os.open(os.path.dirname(path) or ".", os.O_RDONLY)
    try:
        os.fsync(folder)
    except OSError:
        pass  # some network disks have nothing to wait for
    finally:
        os.close(folder)


def read_json(*path):
    """The content of the JSON file at a path, given by its parts."""
    with open(os.path.join(*path), encoding="utf-8") as file:
        return json.load(file)


def add_figures(path, figures):
    """Adds figures by name to a JSON file, which may contain those of other benchmarks, or not exist."""
    known = read_json(path) if os.path.exists(path) else {}
    write(path, json.dumps({**known, **figures}, indent=1))


def fix_for(number):
    """The fix for an error number, as in src/base/files.cpp."""
    if number in (errno.ENOSPC, errno.EDQUOT):
        return "free some space"
    if number in (errno.EACCES, errno.EPERM, errno.EROFS):
        return "check the permissions of the file and its folders"
    return "check the path and the disk"


def run(main, *arguments):
    """Runs a script's main function; prints its file errors in one line."""
    try:
        main(*arguments)
    except OSError as error:
        sys.exit(f"{error.filename}: {error.strerror}; {fix_for(error.errno)} or choose another folder")


def save_figure(figure, path, kind, **options):
    """A matplotlib figure, drawn in memory first."""
    out = io.BytesIO()
    figure.savefig(out, format=kind, facecolor="white", **options)
    write(path, out.getvalue())
