"""What recordings/packed.py wrote, read as the page reads it."""

import zlib
from base64 import b64decode

import numpy as np


def unpacked(found):
    """The numbers, as in page/unpack.js: a cumulative sum that wraps around in 16 bits."""
    rows, *others = found["shape"]
    bytes_ = zlib.decompress(b64decode(found["data"]))
    changes = np.frombuffer(bytes_, "<i2").reshape(rows, -1)
    levels = np.cumsum(changes, axis=0, dtype=np.int16)
    return (found["low"] + found["step"] * levels).reshape(rows, *others)
