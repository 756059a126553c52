"""Scripts that people copy from: the acceptance script, the examples of the package and its notebook."""

import json
import os
import subprocess
import sys
import unittest

try:
    import torch  # noqa: F401
except ImportError:
    print("skipped: PyTorch is not installed for this interpreter (Debian package python3-torch)")
    sys.exit(77)

from support import EXAMPLES, PROGRAM, Folder


def setUpModule():
    global FOLDER
    FOLDER = Folder(4)


def tearDownModule():
    FOLDER.remove()


def run(*arguments):
    done = subprocess.run([sys.executable, "-B", *arguments], capture_output=True, text=True, cwd=FOLDER.path)
    if done.returncode:
        raise AssertionError(done.stdout + done.stderr)
    return done.stdout


class Scripts(unittest.TestCase):
    def test_a_script_that_knows_the_issues_text_alone(self):
        script = os.path.join(os.path.dirname(os.path.abspath(__file__)), "acceptance.py")
        told = run(script, FOLDER.data, "000000", FOLDER.path, os.path.abspath(PROGRAM))
        self.assertIn("accepted", told)

    def test_a_pillar_network_that_learned_little_is_refused(self):
        out = os.path.join(FOLDER.path, "pillars")
        with self.assertRaisesRegex(AssertionError, "finds none of the 3 vehicles as recorded"):
            run(os.path.join(EXAMPLES, "attack_pillars.py"), FOLDER.data, out, "--training", "3", "--iterations", "2")

    def test_the_table_beside_pytorch3d(self):
        self.assertIn("| 64×64 |", run(os.path.join(EXAMPLES, "pytorch3d_table.py"), "--sizes", "64", "--repeats", "1"))

    def test_the_notebook_runs_headless(self):
        with open(os.path.join(EXAMPLES, "first_steps.ipynb")) as file:
            cells = json.load(file)["cells"]
        code = "\n\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
        self.assertFalse(any(cell.get("outputs") for cell in cells), "kept without outputs")
        script = os.path.join(FOLDER.path, "notebook.py")
        with open(script, "w") as file:
            file.write("import matplotlib\nmatplotlib.use('Agg')\n" + code)
        os.environ["MIRAGE_EXAMPLE_DATA"] = FOLDER.data
        run(script)


if __name__ == "__main__":
    unittest.main()
