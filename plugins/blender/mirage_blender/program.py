"""Finds and runs the `mirage` program."""

import os
import shutil
import subprocess
import time

import bpy

POLL = 0.05  # s


class ProgramError(Exception):
    """A message of one line for the user."""


def preferences():
    addon = bpy.context.preferences.addons.get(__package__)
    return addon.preferences if addon else None


def find():
    """The program's path, from the add-on's preferences, MIRAGE_BINARY or PATH, in that order. ProgramError without one."""
    ours = preferences()
    for source, path in (("add-on preferences", ours.binary if ours else ""),
                         ("MIRAGE_BINARY", os.environ.get("MIRAGE_BINARY", ""))):
        if path:
            path = bpy.path.abspath(path)
            if not (os.path.isfile(path) and os.access(path, os.X_OK)):
                raise ProgramError(f"{source}: {path}: is not a program; set it to the mirage binary")
            return path
    path = shutil.which("mirage")
    if not path:
        raise ProgramError("mirage: program not found; set its path in the add-on's preferences or MIRAGE_BINARY")
    return path


def last_line(path):
    with open(path, encoding="utf-8", errors="replace") as file:
        lines = [line.strip() for line in file if line.strip()]
    return lines[-1] if lines else ""


def run(arguments, folder, cancelled=lambda: False, timeout=None):
    """Runs mirage until it ends; its messages go to `folder`/mirage.log. Returns False if cancelled() stopped it, else True.
    ProgramError with mirage's last line if it fails, and after `timeout` (s)."""
    log = os.path.join(folder, "mirage.log")
    with open(log, "wb") as file:
        try:
            process = subprocess.Popen([find(), *arguments], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
                                       stderr=file)
        except OSError as error:
            raise ProgramError(f"mirage: cannot be started ({error.strerror}); set its path in the add-on's "
                               "preferences") from None
        started = time.monotonic()
        while process.poll() is None:
            if cancelled():
                stop(process)
                return False
            if timeout and time.monotonic() - started > timeout:
                stop(process)
                raise ProgramError(f"mirage: no result after {timeout:g} s; render a smaller image")
            time.sleep(POLL)
    if process.returncode != 0:
        how = f"ended with {process.returncode}"
        raise ProgramError(last_line(log) or f"mirage: {how}; run it in a terminal to see why")
    return True


def stop(process):
    """Terminates a child process; kills it if it has not ended after 5 s."""
    process.terminate()
    try:
        process.wait(5)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
