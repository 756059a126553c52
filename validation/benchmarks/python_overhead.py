"""What the module adds to an insertion with its vector-Jacobian product in C++: medians of alternating runs, CPU time of one
thread.

    PYTHONPATH=build/python python3 validation/benchmarks/python_overhead.py [DATA FRAME] [--rounds 200]

Without a data set it generates a frame. Prints JSON: milliseconds in C++, by mirage.insert with result.vjp, by
mirage.torch.insert with backward, and the overheads in percent.
"""

import argparse
import json
import os
import statistics
import tempfile
import time

import mirage
import numpy
from mirage import _core
from mirage._settings import insertion_settings


def main():
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("data", nargs="?")
    options.add_argument("frame", nargs="?", default="000000")
    options.add_argument("--rounds", type=int, default=200)
    options = options.parse_args()
    _core.set_thread_count(1)
    with tempfile.TemporaryDirectory() as folder:
        if not options.data:
            mirage.generate(folder, frames=1, rig="kitti64", seed=1)
        frame = mirage.read_frame(options.data or folder, options.frame)
    hosts = frame.hosts()
    host = min(hosts, key=lambda h: abs(h.label.box_bev[0] - 10))
    mesh = mirage.icosphere()
    settings = insertion_settings({}, "benchmark")
    result = mirage.insert(frame, host, mesh)
    d_image, d_points = numpy.ones_like(result.image), numpy.ones_like(result.points)

    def by_module():
        start = time.thread_time()
        inserted = mirage.insert(frame, host, mesh)
        inserted.image, inserted.points
        inserted.vjp(d_image, d_points)
        return 1e3 * (time.thread_time() - start)

    ways = {"cpp_ms": lambda: _core.time_insertions(frame, host.index, mesh, settings, 1)[0], "module_ms": by_module}
    try:
        import torch

        vertices, texels = (torch.tensor(a, dtype=torch.float32, requires_grad=True) for a in (mesh.vertices, mesh.texels))
        ones = torch.from_numpy(d_image), torch.from_numpy(d_points)

        def by_torch():
            start = time.thread_time()
            torch.autograd.grad(mirage.torch.insert(frame, host, vertices, texels), (vertices, texels), ones)
            return 1e3 * (time.thread_time() - start)

        ways["torch_ms"] = by_torch
    except ImportError:
        pass
    times = {name: [] for name in ways}
    for _ in range(options.rounds):
        for name, way in ways.items():
            times[name].append(way())
    figures = {name: statistics.median(values) for name, values in times.items()}
    for name in list(figures)[1:]:
        # Of neighbouring runs: what else the machine does hits both alike.
        ratios = [one / base for one, base in zip(times[name], times["cpp_ms"])]
        figures[name.replace("_ms", "_overhead_percent")] = 100 * (statistics.median(ratios) - 1)
    figures["distance_m"] = host.label.box_bev[0]
    print(json.dumps(figures, indent=2))


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    main()
