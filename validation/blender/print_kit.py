"""Cuts a solid into parts that fit a printer's bed, each closed, as STL and together as 3MF. Runs in Blender (blender_worker.py).

Coordinates: metres in the object's frame, z up; files are in millimetres, as printers read them.
"""

import os
import zipfile
from itertools import product
from math import ceil
from xml.sax.saxutils import quoteattr

import bmesh
import numpy
from mathutils import Vector

MM = 1000
TRIES = 6  # places of the cuts, 1.3 mm apart: a plane through a vertex or along a face may leave a part open
LARGEST = 2000  # parts


def solid(vertices, faces):
    mesh = bmesh.new()
    corners = [mesh.verts.new(v) for v in vertices]
    for face in faces:
        mesh.faces.new([corners[i] for i in face])
    return mesh


def keep_below(mesh, place, normal):
    """Removes the part on the normal's side of a plane and closes the cut."""
    bmesh.ops.bisect_plane(mesh, geom=mesh.verts[:] + mesh.edges[:] + mesh.faces[:], dist=1e-7, plane_co=place,
                           plane_no=normal, clear_outer=True)
    rim = [edge for edge in mesh.edges if edge.is_boundary]
    if rim:
        bmesh.ops.triangle_fill(mesh, use_beauty=True, edges=rim, normal=normal)
        bmesh.ops.recalc_face_normals(mesh, faces=mesh.faces)


def within(whole, low, high, outer_low, outer_high):
    """The part of a solid in a box; sides on the outer box cut nothing."""
    part = whole.copy()
    for axis in range(3):
        for side, sign in ((low, -1), (high, 1)):
            if side[axis] in (outer_low[axis], outer_high[axis]) or not part.faces:
                continue
            place, normal = Vector((0, 0, 0)), Vector((0, 0, 0))
            place[axis], normal[axis] = side[axis], sign
            keep_below(part, place, normal)
    bmesh.ops.triangulate(part, faces=part.faces)
    return part


def is_closed(mesh):
    return all(edge.is_manifold for edge in mesh.edges)


def triangles(mesh):
    """(vertices, faces) as arrays."""
    mesh.verts.index_update()
    return (numpy.array([v.co[:] for v in mesh.verts], float).reshape(-1, 3),
            numpy.array([[v.index for v in face.verts] for face in mesh.faces], int).reshape(-1, 3))


def cut(vertices, faces, bed):
    """[(cell, vertices, faces)] of closed parts none of which is larger than the bed. ValueError if there is no such cut."""
    low, high = numpy.min(vertices, 0), numpy.max(vertices, 0)
    counts = [ceil((high[axis] - low[axis]) / bed[axis] - 1e-9) for axis in range(3)]
    if numpy.prod(counts) > LARGEST:
        raise ValueError(f"{' x '.join(map(str, counts))} parts; use a larger bed")
    whole = solid(vertices, faces)
    if not is_closed(whole):
        raise ValueError("the object is not watertight, so it has no inside to print")
    for attempt in range(TRIES):
        shift = 0.0013 * attempt
        planes = []
        for axis in range(3):
            step = (high[axis] - low[axis]) / counts[axis]
            inner = [low[axis] + k * step + shift for k in range(1, counts[axis])]
            planes.append([low[axis], *inner, high[axis]])
        parts, closed, volume = [], True, 0
        for cell in product(*(range(n) for n in counts)):
            box = [[planes[axis][cell[axis] + k] for axis in range(3)] for k in range(2)]
            part = within(whole, *box, low, high)
            if part.faces:
                closed = closed and is_closed(part)
                volume += part.calc_volume(signed=True)
                parts.append((cell, *triangles(part)))
            part.free()
        total = whole.calc_volume(signed=True)
        fits = all(numpy.all(numpy.ptp(v, 0) <= numpy.add(bed, 1e-6)) for _, v, _ in parts)
        if closed and fits and abs(volume - total) <= 1e-5 * abs(total):
            whole.free()
            return parts
    raise ValueError(f"no cut into closed parts found in {TRIES} tries; use another bed")


def volume_of(vertices, faces):
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return float(numpy.einsum("ij,ij->", a, numpy.cross(b, c)) / 6)


def write_stl(path, vertices, faces):
    corners = (MM * vertices[faces]).astype("<f4")
    normals = numpy.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    rows = numpy.zeros(len(faces), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])
    rows["normal"] = normals / numpy.maximum(numpy.linalg.norm(normals, axis=1), 1e-30)[:, None]
    rows["corners"] = corners
    with open(path, "wb") as file:
        file.write(b"millimetres".ljust(80) + numpy.uint32(len(faces)).tobytes() + rows.tobytes())


def write_3mf(path, parts):
    """3MF Core Specification 1.3: one object per part, at its place in the whole."""
    core = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
    out = [f'<?xml version="1.0" encoding="UTF-8"?>\n<model unit="millimeter" xml:lang="en" xmlns="{core}"><resources>']
    for number, (name, vertices, faces) in enumerate(parts, 1):
        out.append(f'<object id="{number}" type="model" name={quoteattr(name)}><mesh><vertices>')
        out += [f'<vertex x="{x:.6f}" y="{y:.6f}" z="{z:.6f}"/>' for x, y, z in MM * vertices]
        out.append("</vertices><triangles>")
        out += [f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in faces]
        out.append("</triangles></mesh></object>")
    out.append("</resources><build>" + "".join(f'<item objectid="{k}"/>' for k in range(1, len(parts) + 1)) + "</build></model>")
    files = {
        "[Content_Types].xml": '<?xml version="1.0" encoding="UTF-8"?>\n<Types xmlns="http://schemas.openxmlformats.org/package/2006/'
        'content-types"><Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>'
        '<Default Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/></Types>',
        "_rels/.rels": '<?xml version="1.0" encoding="UTF-8"?>\n<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/'
        'relationships"><Relationship Target="/3D/3dmodel.model" Id="rel0" '
        'Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/></Relationships>',
        "3D/3dmodel.model": "".join(out)}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in files.items():
            archive.writestr(zipfile.ZipInfo(name), text, zipfile.ZIP_DEFLATED)  # no time: reproducible bytes


def write(job):
    """{"vertices", "faces", "bed", "out"} → {"parts": [{name, file, extents_m, volume_m3, faces}]}"""
    parts = cut(numpy.array(job["vertices"], float), numpy.array(job["faces"], int), job["bed"])
    told, named = [], []
    for cell, vertices, faces in parts:
        name = "part-" + "-".join(str(c + 1) for c in cell)
        write_stl(os.path.join(job["out"], name + ".stl"), vertices, faces)
        named.append((name, vertices, faces))
        told.append({"name": name, "file": name + ".stl", "extents_m": numpy.ptp(vertices, 0).tolist(),
                     "volume_m3": volume_of(vertices, faces), "faces": len(faces)})
    write_3mf(os.path.join(job["out"], "object.3mf"), named)
    return {"parts": told}
