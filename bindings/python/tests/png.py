"""Reads PNG files of 8-bit RGB."""

import struct
import zlib

import numpy as np


def read(path):
    """u8 [H, W, 3]."""
    data, at, packed = path.read_bytes(), 8, b""
    while at < len(data):
        length, kind = struct.unpack(">I4s", data[at : at + 8])
        chunk = data[at + 8 : at + 8 + length]
        if kind == b"IHDR":
            width, height, depth, color = struct.unpack(">IIBB", chunk[:10])
            assert (depth, color) == (8, 2)
        packed += chunk if kind == b"IDAT" else b""
        at += 12 + length
    lines = np.frombuffer(zlib.decompress(packed), np.uint8).reshape(height, 1 + 3 * width)
    above = np.zeros(3 * width + 3, int)
    out = np.zeros((height, 3 * width + 3), int)
    for filter_type, line, row in zip(lines[:, 0], lines[:, 1:].astype(int), out):
        for x, value in enumerate(line):
            a, b, c = row[x], above[x + 3], above[x]
            p = a + b - c
            distances = abs(p - a), abs(p - b), abs(p - c)
            paeth = (a, b, c)[distances.index(min(distances))]
            row[x + 3] = (value + (0, a, b, (a + b) // 2, paeth)[filter_type]) % 256
        above = row
    return out[:, 3:].astype(np.uint8).reshape(height, width, 3)
