"""Converts between Blender's camera and OpenCV/KITTI intrinsics (integer coordinate = pixel centre).

For Blender 3.4's view plane: with r = fx/fy the pixel's height over its width, and the longer side N in
sensor_fit's direction (W, or r·H when the sensor is fitted vertically):
    fx = lens·N/sensor    fy = fx/r    cx = W/2 − shift_x·N − 1/2    cy = H/2 + shift_y·N/r − 1/2
"""

import math

from mathutils import Matrix

OURS_FROM_BLENDER = Matrix.Diagonal((1, -1, -1, 1))  # Blender looks along -z with y up, we along +z, y down


class CameraError(Exception):
    """A message of one line for the user."""


def resolution(scene):
    render = scene.render
    percent = render.resolution_percentage
    return render.resolution_x * percent // 100, render.resolution_y * percent // 100


def intrinsics(scene, camera, matrix_world=None):
    """{fx, fy, cx, cy, width, height (pixels), velo_from_camera (3×4 as 12 numbers, m)} of a perspective camera, else CameraError."""
    if camera is None:
        raise CameraError("scene: camera: there is none; add a camera and make it the scene's (Ctrl-Numpad 0)")
    data = camera.data
    if camera.type != "CAMERA" or data.type != "PERSP":
        kind = data.type.lower() if camera.type == "CAMERA" else camera.type.lower()
        raise CameraError(f"{camera.name}: lens type: {kind} is not supported; set it to Perspective")
    width, height = resolution(scene)
    ratio = scene.render.pixel_aspect_y / scene.render.pixel_aspect_x
    horizontal = data.sensor_fit == "HORIZONTAL" or (data.sensor_fit == "AUTO" and width >= ratio * height)
    sensor = data.sensor_height if data.sensor_fit == "VERTICAL" else data.sensor_width
    side = width if horizontal else ratio * height
    fx = data.lens * side / sensor
    velo_from_camera = (matrix_world or camera.matrix_world).normalized() @ OURS_FROM_BLENDER
    rows = [velo_from_camera[r][c] for r in range(3) for c in range(4)]
    result = {"fx": fx, "fy": fx / ratio, "cx": width / 2 - data.shift_x * side - 0.5,
              "cy": height / 2 + data.shift_y * side / ratio - 0.5, "width": width, "height": height}
    if not all(math.isfinite(value) for value in [*result.values(), *rows]):
        raise CameraError(f"{camera.name}: position: is not finite; reset the camera's transform")
    return {**result, "velo_from_camera": rows}


def set_camera(scene, camera, info):
    """Gives the camera object and the scene the intrinsics and the pose of `info` (as intrinsics()); returns (width, height)."""
    width, height = int(info["width"]), int(info["height"])
    ratio = info["fx"] / info["fy"]
    data = camera.data
    data.type = "PERSP"
    data.sensor_fit = "HORIZONTAL"
    data.sensor_width = 36.0
    data.lens = info["fx"] * 36.0 / width
    data.shift_x = 0.5 - (info["cx"] + 0.5) / width
    data.shift_y = (info["cy"] + 0.5 - height / 2) * ratio / width
    data.clip_start = 0.01
    data.clip_end = 10000.0
    rows = info["velo_from_camera"]
    camera.parent = None
    camera.matrix_world = Matrix([rows[0:4], rows[4:8], rows[8:12], (0, 0, 0, 1)]) @ OURS_FROM_BLENDER
    scene.camera = camera
    render = scene.render
    render.resolution_x, render.resolution_y, render.resolution_percentage = width, height, 100
    render.pixel_aspect_x, render.pixel_aspect_y = (1.0, ratio) if ratio >= 1 else (1.0 / ratio, 1.0)
    return width, height


def set_border(render, rect, width, height):
    """Restricts rendering to pixels [u0, u1) x [v0, v1) of width x height. ValueError if they reach beyond it."""
    u0, v0, u1, v1 = rect
    if not (0 <= u0 < u1 <= width and 0 <= v0 < v1 <= height):
        raise ValueError(f"rect {rect} does not lie in {width}x{height}")
    render.use_border = render.use_crop_to_border = True
    # Blender multiplies by the size and truncates: a quarter of a pixel keeps float32 on the right side.
    render.border_min_x, render.border_max_x = (u0 + 0.25) / width, (u1 + 0.25) / width
    render.border_min_y, render.border_max_y = (height - v1 + 0.25) / height, (height - v0 + 0.25) / height


def border(scene):
    """The window [u0, v0, u1, v1) in pixels that Blender renders, rounded as Blender does (float32, truncated)."""
    width, height = resolution(scene)
    render = scene.render
    if not render.use_border:
        return 0, 0, width, height

    def edge(share, size):
        import numpy

        return int(numpy.float32(share) * numpy.float32(size))

    u0, u1 = edge(render.border_min_x, width), edge(render.border_max_x, width)
    v0, v1 = height - edge(render.border_max_y, height), height - edge(render.border_min_y, height)
    return u0, v0, u1, v1
