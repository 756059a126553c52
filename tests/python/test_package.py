"""The wheel: it is complete, and works from any folder."""

import glob
import os
import subprocess
import sys
import tempfile
import unittest
import zipfile

from support import write_data

SOURCE, BUILD = os.environ["MIRAGE_SOURCE"], os.environ["MIRAGE_BUILD"]


class Wheel(unittest.TestCase):
    def test_unpacked_elsewhere_it_works(self):
        with tempfile.TemporaryDirectory() as folder:
            subprocess.run([sys.executable, "-B", os.path.join(SOURCE, "plugins/python/pack_wheel.py"),
                            os.path.join(BUILD, "python"), folder], check=True, stdout=subprocess.DEVNULL)
            place = os.path.join(folder, "site")

            def unpack(wheel):
                with zipfile.ZipFile(*glob.glob(os.path.join(folder, wheel))) as packed:
                    self.assertIsNone(packed.testzip())
                    packed.extractall(place)
                    return packed.namelist()

            def told(code):
                done = subprocess.run([sys.executable, "-c", "import mirage, os; assert mirage.__file__.startswith(os.getcwd()); " + code],
                                      cwd=place, env={"PYTHONPATH": place, "MIRAGE_CACHE": "off"}, capture_output=True, text=True)
                self.assertEqual(done.returncode, 0, done.stderr)
                return done.stdout

            names = unpack("mirage-*-cp*.whl")
            for name in ("mirage/__init__.py", "mirage/_core.pyi", "mirage/py.typed", "mirage/plugins/fusion.so", "mirage/mirage_serve.py",
                         "mirage/plugins/process/mirage_serve.py", "mirage/scenes/rigs/kitti64.toml",
                         "mirage/scenes/objects/zoo.json", "mirage/validation/report/detection_plot.py", "mirage/validation/view/page.html",
                         "mirage/validation/blender/blender_worker.py", "mirage/plugins/blender/mirage_blender/__init__.py"):
                self.assertIn(name, names)
            for name in ("report/model-viewer.min.js", "mirage.commit"):  # fetched, and of a clone: where the build has them
                self.assertEqual("mirage/" + name in names, os.path.exists(os.path.join(BUILD, name)), name)
            self.assertFalse([name for name in names if "CMake" in name or name.endswith((".o", ".weights"))])
            write_data(os.path.join(place, "data"), 1)
            self.assertIn("mirage.Host 0: Car", told("print(mirage.read_frame('data', '000000').hosts())"))
            look = "print(mirage.check('lidar', 'data', out='out', vehicles=1))"
            self.assertIn("install mirage_weights", told(look))
            names = unpack("mirage_weights-*-py3-none-any.whl")
            self.assertIn("mirage/plugins/weights/lidar-kitti64.weights", names)
            self.assertIn("found", told(look))


if __name__ == "__main__":
    unittest.main()
