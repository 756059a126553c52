"""Reads scan-line OpenEXR files (uncompressed, ZIPS or ZIP; what OpenImageIO and Blender write by default) into float32. A render
engine runs outside Blender's main thread, so it cannot use bpy.data.images.
File layout: https://openexr.com/en/latest/OpenEXRFileLayout.html. Needs only numpy."""

import struct
import zlib

import numpy

TYPES = ("<u4", "<f2", "<f4")  # pixel types 0, 1, 2
ROWS = {0: 1, 2: 1, 3: 16}  # rows a block, by compression: none, ZIPS, ZIP


def text(data, at):
    end = data.index(b"\0", at)
    return data[at:end].decode(), end + 1


def read_header(data, path):
    if data[:4] != b"\x76\x2f\x31\x01" or struct.unpack_from("<I", data, 4)[0] & 0x1A00:
        raise ValueError(f"{path}: not a single-part scan-line EXR")
    at, header = 8, {}
    while data[at]:
        name, at = text(data, at)
        _, at = text(data, at)
        size = struct.unpack_from("<I", data, at)[0]
        header[name] = data[at + 4:at + 4 + size]
        at += 4 + size
    return header, at + 1


def unpacked(block, size):
    """The block's `size` bytes: undoes ZIP, the difference to the previous byte, and the split into even and odd bytes."""
    if len(block) == size:
        return block
    bytes_ = numpy.frombuffer(zlib.decompress(block), numpy.uint8).astype(numpy.int64)
    bytes_[1:] -= 128
    bytes_ = numpy.cumsum(bytes_).astype(numpy.uint8)
    half = (size + 1) // 2
    out = numpy.empty(size, numpy.uint8)
    out[0::2], out[1::2] = bytes_[:half], bytes_[half:]
    return out.tobytes()


def read_channels(path):
    """{channel name: height x width float32}, row 0 on top. ValueError for a file that is damaged or of another kind."""
    with open(path, "rb") as file:
        data = file.read()
    try:
        return decode(data, path)
    except (struct.error, IndexError, zlib.error) as error:
        raise ValueError(f"{path}: damaged ({error})") from None


def decode(data, path):
    header, at = read_header(data, path)
    channels, place = [], 0
    while header["channels"][place]:
        name, place = text(header["channels"], place)
        kind, _, step_x, step_y = struct.unpack_from("<iIii", header["channels"], place)
        if (step_x, step_y) != (1, 1):
            raise ValueError(f"{path}: channel {name} is sub-sampled")
        channels.append((name, numpy.dtype(TYPES[kind])))
        place += 16
    compression = header["compression"][0]
    if compression not in ROWS:
        raise ValueError(f"{path}: compression {compression} is not supported, only none, ZIPS and ZIP")
    x0, y0, x1, y1 = struct.unpack("<4i", header["dataWindow"])
    width, height, rows = x1 - x0 + 1, y1 - y0 + 1, ROWS[compression]
    images = {name: numpy.empty((height, width), numpy.float32) for name, _ in channels}
    row_bytes = width * sum(kind.itemsize for _, kind in channels)
    blocks = -(-height // rows)
    for start in struct.unpack_from(f"<{blocks}Q", data, at):
        y, size = struct.unpack_from("<iI", data, start)
        first, count = y - y0, min(rows, height - (y - y0))
        block = unpacked(data[start + 8:start + 8 + size], row_bytes * count)
        place = 0
        for row in range(first, first + count):
            for name, kind in channels:
                images[name][row] = numpy.frombuffer(block, kind, width, place)
                place += width * kind.itemsize
    return images


def read_image(path, *names):
    """height x width x len(names) float32, row 0 on top. A name also matches the last part of "Layer.Pass.R". ValueError without a match."""
    channels = read_channels(path)
    found = []
    for name in names:
        match = [channel for channel in channels if channel == name or channel.endswith("." + name)]
        if not match:
            raise ValueError(f"{path}: no channel {name}, only {', '.join(channels)}")
        found.append(channels[match[0]])
    return numpy.stack(found, axis=-1)
