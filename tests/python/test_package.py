"""The wheel: everything in it, and at home anywhere."""

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
            wheel, = glob.glob(os.path.join(folder, "mirage-*-cp*.whl"))
            place = os.path.join(folder, "site")
            with zipfile.ZipFile(wheel) as packed:
                names = packed.namelist()
                self.assertIsNone(packed.testzip())
                packed.extractall(place)
            for name in ("mirage/__init__.py", "mirage/_core.pyi", "mirage/py.typed", "mirage/plugins/fusion.so", "mirage/mirage_serve.py",
                         "mirage/plugins/process/mirage_serve.py",
                         "mirage/plugins/weights/lidar-kitti64.weights", "mirage/scenes/rigs/kitti64.toml"):
                self.assertIn(name, names)
            self.assertFalse([name for name in names if "CMake" in name or name.endswith(".o")])
            write_data(os.path.join(place, "data"), 1)
            code = ("import mirage, os; assert mirage.__file__.startswith(os.getcwd()); "
                    "frame = mirage.read_frame('data', '000000'); print(frame.hosts())")
            told = subprocess.run([sys.executable, "-c", code], cwd=place, env={"PYTHONPATH": place, "MIRAGE_CACHE": "off"},
                                  capture_output=True, text=True)
            self.assertEqual(told.returncode, 0, told.stderr)
            self.assertIn("mirage.Host 0: Car", told.stdout)


if __name__ == "__main__":
    unittest.main()
