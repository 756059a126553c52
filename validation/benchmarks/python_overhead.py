"""What the Python module adds to the same work in C++: CPU time of one thread, alternating runs.

    PYTHONPATH=build/python python3 validation/benchmarks/python_overhead.py [DATA FRAME] [--rounds 200] [--json FILE]

An insertion with its vector-Jacobian product by mirage.insert and mirage.torch.insert; and one mesh (320 faces at 10 m, as an
object on a roof) by mirage.rasterize, mirage.pytorch3d on a crop of 128×128 and a picture of 375×1242, at two softnesses of
edges. Without a data set it generates a frame. Adds to FILE (build/release/bench.json) and prints, for each way: *_ms, median
milliseconds; *_overhead, median ratio to C++ alone, which copies the picture and reads a gradient as large, too; and for the
rasteriser *_kernel_ms, projection, kernel and VJP without those.
"""

import argparse
import json
import os
import statistics
import sys
import tempfile
import time

import mirage
import numpy
from mirage import _core
from mirage._settings import insertion_settings

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "report"))
import atomic  # noqa: E402


def cpu_ms(work):
    start = time.thread_time()
    work()
    return 1e3 * (time.thread_time() - start)


def alternate(ways, rounds):
    """Each way in turn; its median, and the median ratio to the first in the same round: other load affects both."""
    times = {name: [] for name in ways}
    for _ in range(rounds):
        for name, way in ways.items():
            times[name].append(way())
    first = next(iter(times.values()))
    return {name: (statistics.median(values), statistics.median(one / base for one, base in zip(values, first)))
            for name, values in times.items()}


def rasterizers(rounds):
    """By picture and softness: C++, mirage.rasterize and, if PyTorch is installed, mirage.pytorch3d."""
    figures = {}
    mesh = mirage.icosphere()
    mesh.vertices[:] = mesh.vertices[:, [1, 2, 0]] + (0, 0, 10)
    generator = numpy.random.default_rng(1)
    mesh.texels[:] = generator.random(mesh.texels.shape)
    for picture, height, width, focal in (("crop", 128, 128, 900.0), ("full", 375, 1242, 721.0)):
        camera = (focal, focal, (width - 1) / 2, (height - 1) / 2)
        d_image = generator.random((height, width, 3), dtype=numpy.float32)
        for sigma in (1e-5, 1e-4):
            numbers = {"sigma": sigma, "gamma": 1e-2, "epsilon": 1e-3, "dist_eps": 1e-4, "near": 9.0, "far": 11.0}
            kernel = []

            def in_cpp(channels, words):
                alone, whole = _core.time_rasterization(mesh, camera, height, width, (0.2, 0.3, 0.4), numbers, words,
                                                        channels)
                kernel.append(alone)
                return whole

            def by_module():
                drawn = mirage.rasterize(mesh, camera, height, width, background=(0.2, 0.3, 0.4), sigma=sigma, near=9.0,
                                         far=11.0)
                drawn.image
                drawn.vjp(d_image)

            at = f"{picture}_{sigma:.0e}".replace("e-0", "e-")
            pairs = {"module": ({}, 3, by_module)}
            try:
                import torch

                longer = max(height, width) / 2
                points = mesh.vertices * (focal / longer / 10, focal / longer / 10, 1)
                scale = min(height, width) / max(height, width)
                verts = torch.tensor(points * (-1 / scale, 1 / scale, 1), dtype=torch.float32, requires_grad=True)
                colors = torch.tensor(mesh.texels, dtype=torch.float32, requires_grad=True)
                faces = torch.tensor(mesh.faces, dtype=torch.int64)
                upstream = torch.from_numpy(generator.random((height, width, 4), dtype=numpy.float32))

                def by_pytorch3d():
                    drawn = mirage.pytorch3d.soft_rasterize(
                        verts, faces, colors, (height, width), sigma=sigma / scale**2, gamma=1e-2, znear=9.0, zfar=11.0,
                        background_color=(0.2, 0.3, 0.4))
                    torch.autograd.grad(drawn, (verts, colors), upstream)

                pairs["pytorch3d"] = ({"blend": "logit"}, 4, by_pytorch3d)
            except ImportError:
                pass
            for name, (words, channels, way) in pairs.items():
                kernel.clear()
                times = alternate({"cpp": lambda: in_cpp(channels, words), name: lambda: cpu_ms(way)}, rounds)
                figures[f"python_rasterize_{at}_{name}_kernel_ms"] = statistics.median(kernel)
                figures[f"python_rasterize_{at}_{name}_cpp_ms"] = times["cpp"][0]
                figures[f"python_rasterize_{at}_{name}_ms"], figures[f"python_overhead_{name}_{at}"] = times[name]
        figures[f"python_overhead_rasterize_{picture}"] = max(
            ratio for name, ratio in figures.items() if name.startswith(f"python_overhead_module_{picture}"))
    return figures


def main():
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("data", nargs="?")
    options.add_argument("frame", nargs="?", default="000000")
    options.add_argument("--rounds", type=int, default=200)
    options.add_argument("--json", default="build/release/bench.json")
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
        inserted = mirage.insert(frame, host, mesh)
        inserted.image, inserted.points
        inserted.vjp(d_image, d_points)

    ways = {"cpp": lambda: _core.time_insertions(frame, host.index, mesh, settings, 1)[0],
            "module": lambda: cpu_ms(by_module)}
    try:
        import torch

        vertices, texels = (torch.tensor(a, dtype=torch.float32, requires_grad=True) for a in (mesh.vertices, mesh.texels))
        ones = torch.from_numpy(d_image), torch.from_numpy(d_points)

        def by_torch():
            torch.autograd.grad(mirage.torch.insert(frame, host, vertices, texels), (vertices, texels), ones)

        ways["torch"] = lambda: cpu_ms(by_torch)
    except ImportError:
        pass
    figures = {}
    for name, (median, ratio) in alternate(ways, options.rounds).items():
        figures[f"python_insert_{name}_ms"] = median
        if name != "cpp":
            figures[f"python_overhead_insert_{name}"] = ratio
    figures["python_insert_distance_m"] = host.label.box_bev[0]
    figures |= rasterizers(options.rounds)
    print(json.dumps(figures, indent=2))
    if os.path.isdir(os.path.dirname(options.json)):
        atomic.add_figures(options.json, figures)


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    main()
