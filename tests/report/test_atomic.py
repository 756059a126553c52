"""Files of the plots and pages on a disk that fills up: test_atomic.py SOURCE."""

import errno
import os
import resource
import signal
import subprocess
import sys
import tempfile
import unittest

SOURCE = os.path.abspath(sys.argv[1])
REPORT = os.path.join(SOURCE, "validation", "report")
sys.path.insert(0, REPORT)
import atomic  # noqa: E402


def small_files():
    """A limit on the size of files stands in for a full disk."""
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, resource.RLIM_INFINITY))


class Writing(unittest.TestCase):
    def test_text_and_bytes_replace_the_file_whole(self):
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, "page.html")
            for data, expected in (("σ", "σ".encode()), (b"\0\1", b"\0\1")):
                atomic.write(path, data)
                with open(path, "rb") as file:
                    self.assertEqual(file.read(), expected)
            self.assertEqual(os.listdir(folder), ["page.html"])

    def test_a_full_disk_leaves_the_old_file_and_is_one_line(self):
        script = ("import sys; sys.path.insert(0, sys.argv[1]); import atomic; "
                  "atomic.run(atomic.write, sys.argv[2], 'x' * 100000)")
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, "page.html")
            atomic.write(path, "old")
            done = subprocess.run([sys.executable, "-B", "-c", script, REPORT, path], preexec_fn=small_files,
                                  capture_output=True, text=True, check=False)
            self.assertEqual(done.returncode, 1)
            self.assertIn("page.html: File too large; check the path", done.stderr)
            self.assertEqual(done.stderr.count("\n"), 1)
            with open(path, encoding="utf-8") as file:
                self.assertEqual(file.read(), "old")
            self.assertEqual(os.listdir(folder), ["page.html"])

    def test_the_hint_is_that_of_the_error(self):
        self.assertIn("space", atomic.fix_for(errno.ENOSPC))
        self.assertIn("permissions", atomic.fix_for(errno.EACCES))


unittest.main(argv=sys.argv[:1])
