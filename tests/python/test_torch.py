"""mirage.torch and mirage.pytorch3d: gradients that PyTorch checks."""

import math
import sys
import types
import unittest

try:
    import torch
except ImportError:
    print("skipped: PyTorch is not installed for this interpreter (Debian package python3-torch)")
    sys.exit(77)

import mirage
from support import Folder, example


def setUpModule():
    global FOLDER, FRAME, HOST
    FOLDER = Folder(1)
    FRAME = mirage.read_frame(FOLDER.data, "000000")
    HOST = FRAME.hosts()[0]


def tearDownModule():
    FOLDER.remove()


def parameters(mesh, dtype):
    return [torch.tensor(array, dtype=dtype, requires_grad=True) for array in (mesh.vertices, mesh.texels)]


class Insert(unittest.TestCase):
    def test_gradcheck(self):
        """Every component, of both outputs, through both inputs."""
        vertices, texels = parameters(mirage.icosphere(0, resolution=1), torch.float64)
        texels.data.uniform_(0.2, 0.9, generator=torch.Generator().manual_seed(1))
        some = (slice(26, 38, 3), slice(118, 140, 3))  # pixels of the object and around it

        def seen(v, t):
            image, points = mirage.torch.insert(FRAME, HOST, v, t)
            return image[some], points[-5:]

        self.assertTrue(torch.autograd.gradcheck(seen, (vertices, texels)))

    def test_gradcheck_of_the_attacks_own_start(self):
        vertices, texels = parameters(mirage.icosphere(), torch.float64)
        torch.manual_seed(2)
        self.assertTrue(torch.autograd.gradcheck(lambda v, t: mirage.torch.insert(FRAME, HOST, v, t),
                                                 (vertices, texels), fast_mode=True))

    def test_it_is_mirage_insert(self):
        mesh = mirage.icosphere()
        result = mirage.insert(FRAME, HOST, mesh, sigma=1e-5)
        vertices, texels = parameters(mesh, torch.float32)
        image, points = mirage.torch.insert(FRAME, HOST, vertices, texels, sigma=1e-5)
        self.assertEqual((image.dtype, points.dtype), (torch.float32, torch.float32))
        self.assertLess((image.detach() - torch.tensor(result.image)).abs().max(), 1e-3)
        (image.sum() + points.sum()).backward()
        self.assertEqual((vertices.grad.dtype, texels.grad.shape), (torch.float32, texels.shape))
        self.assertGreater(vertices.grad.abs().sum(), 0)

    def test_one_output_alone_and_twice(self):
        vertices, texels = parameters(mirage.icosphere(), torch.float32)
        image, points = mirage.torch.insert(FRAME, HOST, vertices, texels)
        first = torch.autograd.grad(image.sum(), (vertices, texels), retain_graph=True)
        again = torch.autograd.grad(image.sum(), (vertices, texels), retain_graph=True)
        for a, b in zip(first, again):
            self.assertTrue(torch.equal(a, b))
        d_vertices, d_texels = torch.autograd.grad(points.sum(), (vertices, texels))
        self.assertGreater(d_vertices.abs().sum(), 0)
        self.assertEqual(d_texels.abs().sum(), 0)  # the LiDAR's reflectivity is the material's, not the paint's

    def test_meshes_of_other_faces(self):
        vertices, texels = parameters(mirage.icosphere(1), torch.float32)
        with self.assertRaisesRegex(mirage.InputError, "faces"):
            mirage.torch.insert(FRAME, HOST, vertices[:-1], texels)
        with self.assertRaisesRegex(mirage.InputError, "mirage.torch.insert: blur: unknown setting"):
            mirage.torch.insert(FRAME, HOST, vertices, texels, blur=1)
        with self.assertRaisesRegex(mirage.InputError, "host: .* is of another frame"):
            mirage.torch.insert(mirage.read_frame(FOLDER.data, "000000"), HOST, vertices, texels)
        faces = mirage.icosphere(1).faces
        image, _ = mirage.torch.insert(FRAME, HOST, vertices, texels, faces=torch.tensor(faces))
        self.assertEqual(image.shape, FRAME.image.shape)


class InThePlaceOfPyTorch3D(unittest.TestCase):
    def scene(self, dtype=torch.float64):
        mesh = mirage.icosphere(1, (0.5, 0.5, 0.5))
        verts = torch.tensor(mesh.vertices, dtype=dtype)
        verts += 0.02 * torch.randn(verts.shape, dtype=dtype, generator=torch.Generator().manual_seed(5))  # no symmetry
        verts = torch.stack([2 * verts[:, 0], 2 * verts[:, 1], verts[:, 2] + 4], 1) * torch.tensor([0.5, 0.5, 1.0])
        colors = torch.rand(80, 3, 3, 3, dtype=dtype, generator=torch.Generator().manual_seed(3))
        return verts, torch.tensor(mesh.faces, dtype=torch.int64), colors

    def test_the_published_formula(self):
        soft_formula = example("soft_formula")

        verts, faces, colors = self.scene()
        for size, blur, gamma in (((40, 40), None, 1e-2), ((30, 50), None, 1e-3), ((50, 30), 0.0, 1e-2)):
            settings = dict(sigma=1e-3, gamma=gamma, blur_radius=blur, background_color=(0.2, 0.4, 0.9))
            ours = mirage.pytorch3d.soft_rasterize(verts, faces, colors, size, **settings)
            theirs = soft_formula.soft_rasterize(verts, faces, colors, size, **settings)
            self.assertEqual(ours.shape, (*size, 4))
            self.assertGreater(ours[..., 3].sum(), 50)
            apart = (ours - theirs).abs()
            self.assertLess(apart[..., 3].max(), 1e-6, size)
            # Outside of faces: the order of clipping, and which of two texels an edge between them has.
            self.assertLess(apart[..., :3].mean(), 5e-3, size)

    def test_gradcheck(self):
        verts, faces, _ = self.scene()
        colors = torch.rand(42, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(4))
        settings = dict(sigma=1e-3, gamma=1e-1, blur_radius=0.03)
        self.assertTrue(torch.autograd.gradcheck(
            lambda v, c: mirage.pytorch3d.soft_rasterize(v, faces, c, (12, 16), **settings),
            (verts.requires_grad_(), colors.requires_grad_())))

    def test_its_classes_are_told_by_what_they_have(self):
        verts, faces, colors = self.scene(torch.float32)
        simple = types.SimpleNamespace
        transform = simple(transform_points=lambda v: v)
        cameras = simple(transform_points_ndc=lambda v: v, get_world_to_view_transform=lambda: transform)
        meshes = simple(verts_list=lambda: [verts] * 2, faces_list=lambda: [faces] * 2,
                        textures=simple(atlas_list=lambda: [colors] * 2))
        sigma = 1e-4
        renderer = mirage.pytorch3d.SoftRenderer(
            cameras, simple(image_size=32, blur_radius=math.log(1 / 1e-4 - 1) * sigma, faces_per_pixel=50),
            simple(sigma=sigma, gamma=1e-4, background_color=(1.0, 1.0, 1.0)))
        images = renderer(meshes)
        self.assertEqual(images.shape, (2, 32, 32, 4))
        self.assertTrue(torch.equal(images[0], images[1]))
        self.assertTrue(torch.equal(images[0], mirage.pytorch3d.soft_rasterize(verts, faces, colors, 32, sigma=sigma)))

        # A camera for each mesh: the second stands elsewhere.
        moved = torch.tensor([0.3, 0.0, 0.0])
        two = simple(transform_points_ndc=lambda v: torch.stack([v, v + moved]),
                     get_world_to_view_transform=lambda: simple(transform_points=lambda v: torch.stack([v, v])))
        renderer.cameras = two
        images = renderer(meshes)
        self.assertTrue(torch.equal(images[1],
                                    mirage.pytorch3d.soft_rasterize(verts + moved, faces, colors, 32, sigma=sigma)))
        meshes.verts_list, meshes.faces_list = (lambda: [verts] * 3), (lambda: [faces] * 3)
        meshes.textures.atlas_list = lambda: [colors] * 3
        with self.assertRaisesRegex(mirage.InputError, "2 cameras for 3 meshes"):
            renderer(meshes)

    def test_nearer_and_farther_than_the_depth_range_colours_are_those_of_the_formula(self):
        soft_formula = example("soft_formula")
        triangle = torch.tensor([[0.5, -0.5, 0.8], [-0.5, -0.5, 0.8], [0.0, 0.6, 0.8]], dtype=torch.float64)
        red = torch.tensor([[1.0, 0, 0]] * 3, dtype=torch.float64)
        one = torch.tensor([[0, 1, 2]])
        drawn = mirage.pytorch3d.soft_rasterize(triangle, one, red, 32, background_color=(0.0, 0.0, 1.0))
        self.assertLess((drawn[16, 16] - torch.tensor([1.0, 0, 0, 1.0])).abs().max(), 1e-6)

        verts, faces, _ = self.scene()  # from 3.5 to 4.5 m
        colors = torch.rand(42, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(4))
        for znear, zfar in ((4.0, 100.0), (5.0, 9.0), (0.5, 4.0), (1.0, 3.0), (3.9, 4.1), (0.0, 10.0)):
            settings = dict(sigma=1e-3, gamma=5e-2, background_color=(0.2, 0.4, 0.9), znear=znear, zfar=zfar)
            theirs = soft_formula.soft_rasterize(verts, faces, colors, 40, **settings)
            for dtype in (torch.float64, torch.float32):
                ours = mirage.pytorch3d.soft_rasterize(verts.to(dtype), faces, colors.to(dtype), 40, **settings)
                self.assertLess((ours - theirs)[..., 3].abs().max(), 1e-5, (znear, dtype))
                self.assertLess((ours - theirs)[..., :3].abs().mean(), 1e-3, (znear, dtype))  # the order of clipping
        with self.assertRaisesRegex(mirage.InputError, "give znear < zfar"):
            mirage.pytorch3d.soft_rasterize(verts, faces, colors, 8, znear=2.0, zfar=1.0)

    def test_culled_faces_are_drawn_by_neither(self):
        soft_formula = example("soft_formula")
        verts, faces, colors = self.scene()
        corners = verts[faces]
        towards_us = torch.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], dim=1)[:, 2] < 0
        self.assertTrue(20 < towards_us.sum() < 60)
        settings = dict(sigma=1e-3, gamma=1e-2)
        ours = mirage.pytorch3d.soft_rasterize(verts, faces, colors, 40, cull_backfaces=True, **settings)
        theirs = soft_formula.soft_rasterize(verts, faces[towards_us], colors[towards_us], 40, **settings)
        self.assertLess((ours - theirs)[..., 3].abs().max(), 1e-6)
        self.assertLess((ours - theirs)[..., :3].abs().mean(), 5e-3)
        whole = mirage.pytorch3d.soft_rasterize(verts, faces, colors, 40, **settings)
        self.assertGreater((ours - whole)[..., 3].abs().max(), 1e-2)  # their edges are in the silhouette
        none = mirage.pytorch3d.soft_rasterize(verts, faces[~towards_us], colors[~towards_us], 8, cull_backfaces=True)
        self.assertTrue(torch.equal(none, torch.tensor([1.0, 1, 1, 0], dtype=none.dtype).expand(8, 8, 4)))
        leaves = [tensor.clone().requires_grad_() for tensor in (verts, colors)]
        mirage.pytorch3d.soft_rasterize(leaves[0], faces, leaves[1], 40, cull_backfaces=True, **settings).sum().backward()
        self.assertGreater(leaves[1].grad[towards_us].abs().sum(), 0)
        self.assertEqual(leaves[1].grad[~towards_us].abs().sum(), 0)

    def test_what_a_camera_and_its_settings_say_is_drawn_or_refused(self):
        verts, faces, colors = self.scene(torch.float32)
        simple = types.SimpleNamespace
        transform = simple(transform_points=lambda v: v)
        cameras = simple(transform_points_ndc=lambda v: v, get_world_to_view_transform=lambda: transform, is_perspective=lambda: True,
                         znear=torch.tensor([0.3, 0.3]), zfar=torch.tensor([9.0, 9.0]))
        meshes = simple(verts_list=lambda: [verts], faces_list=lambda: [faces], textures=simple(atlas_list=lambda: [colors]))
        settings = simple(image_size=32, blur_radius=1e-3, faces_per_pixel=50, cull_backfaces=True, perspective_correct=None,
                          z_clip_value=None)
        renderer = mirage.pytorch3d.SoftRenderer(cameras, settings, simple(sigma=1e-4, gamma=5e-2, background_color=(1.0, 1.0, 1.0)))

        def drawn(**changes):
            options = dict(sigma=1e-4, gamma=5e-2, blur_radius=1e-3, znear=0.3, zfar=9.0, cull_backfaces=True)
            return mirage.pytorch3d.soft_rasterize(verts, faces, colors, 32, **{**options, **changes})

        self.assertLess((renderer(meshes)[0] - drawn()).abs().max(), 1e-5)
        self.assertGreater((renderer(meshes)[0] - drawn(znear=1.0, zfar=100.0)).abs().max(), 1e-3)
        self.assertGreater((renderer(meshes)[0] - drawn(cull_backfaces=False)).abs().max(), 1e-3)
        renderer.znear = 2.0  # what is given here counts
        self.assertLess((renderer(meshes)[0] - drawn(znear=2.0)).abs().max(), 1e-5)
        for owner, name, value, said in ((cameras, "znear", torch.tensor([0.3, 0.4]), "give cameras with one znear"),
                                         (settings, "perspective_correct", False, "perspective cameras"),
                                         (cameras, "is_perspective", lambda: False, "perspective cameras"),
                                         (settings, "z_clip_value", 4.0, "reach behind z = 4 m")):
            before = getattr(owner, name)
            setattr(owner, name, value)
            renderer.znear = None
            with self.assertRaisesRegex(mirage.InputError, said):
                renderer(meshes)
            setattr(owner, name, before)
        with self.assertRaisesRegex(mirage.InputError, "80 reach behind z = 0 m"):
            mirage.pytorch3d.soft_rasterize(verts - torch.tensor([0, 0, 4.0]), faces, colors, 32)
        settings.z_clip_value = 10.0  # all of it is nearer
        self.assertEqual(renderer(meshes)[..., 3].max(), 0)

    def test_colours_of_vertices_in_float_as_in_double(self):
        verts, faces, _ = self.scene()
        colors = torch.rand(42, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(4))
        upstream = torch.rand(2, 40, 60, 4, dtype=torch.float64, generator=torch.Generator().manual_seed(5))
        gradients = []
        for dtype in (torch.float64, torch.float32):
            leaves = [tensor.to(dtype).requires_grad_() for tensor in (verts, colors)]
            drawn = mirage.pytorch3d.soft_rasterize([leaves[0]] * 2, [faces] * 2, [leaves[1]] * 2, (40, 60), sigma=1e-4,
                                                    gamma=1e-2)
            gradients.append(torch.autograd.grad(drawn, leaves, upstream.to(dtype)))
        for exact, fast in zip(*gradients):
            self.assertLess((exact - fast).norm(), 1e-3 * exact.norm())


if __name__ == "__main__":
    unittest.main()
