#!/usr/bin/env python3
"""Our JPEG decoder beside libjpeg-turbo, on the tiles of one TIFF, in processor seconds of one thread, by turns.

benches/jpeg_turbo.py FILE.tif ONE_CORE [ROUNDS]

FILE.tif is tiled and JPEG-compressed, with tables of its own (as GDAL and `synth` write it). ONE_CORE is the built
tools/one_core: its "decode" reads, decodes and hands out every tile. libjpeg-turbo comes with Pillow: each tile is completed by the
tables and decoded to RGB by the accurate integer transform (libjpeg's default, which is what GDAL uses). Reading the file is not
counted for it. Needs Pillow.
"""

import io
import re
import struct
import subprocess
import sys
import time

from PIL import Image, features


def tiles(path):
    """Tables and the compressed tiles of the first directory (classic TIFF or BigTIFF)."""
    data = open(path, "rb").read()
    order = "<" if data[:2] == b"II" else ">"
    big = struct.unpack(order + "H", data[2:4])[0] == 43
    at = struct.unpack(order + ("Q" if big else "I"), data[8:16] if big else data[4:8])[0]
    count = struct.unpack_from(order + ("Q" if big else "H"), data, at)[0]
    at += 8 if big else 2
    step, inline = (20, 8) if big else (12, 4)
    sizes = {1: 1, 2: 1, 3: 2, 4: 4, 7: 1, 16: 8}
    letters = {1: "B", 3: "H", 4: "I", 16: "Q"}
    fields = {}
    for i in range(count):
        tag, kind = struct.unpack_from(order + "HH", data, at + step * i)
        number = struct.unpack_from(order + ("Q" if big else "I"), data, at + step * i + 4)[0]
        place = at + step * i + (12 if big else 8)
        if kind not in sizes:
            continue
        if number * sizes[kind] > inline:
            place = struct.unpack_from(order + ("Q" if big else "I"), data, place)[0]
        if tag in (324, 325, 322, 323):
            fields[tag] = struct.unpack_from(order + letters[kind] * number, data, place)
        elif tag == 347:
            fields[tag] = data[place : place + number]
    tables = fields.get(347, b"")
    pieces = [data[o : o + n] for o, n in zip(fields[324], fields[325]) if n]
    # Tables end in EOI, tiles begin with SOI: joined they are one picture.
    return [tables[:-2] + piece[2:] if tables else piece for piece in pieces]


def turbo(pictures):
    started = time.process_time()
    for picture in pictures:
        Image.open(io.BytesIO(picture)).load()
    return time.process_time() - started


def ours(program, path):
    words = subprocess.run([program, path], capture_output=True, text=True, check=True).stdout
    return float(re.search(r"decode ([0-9.]+)", words).group(1))


path, program = sys.argv[1:3]
rounds = int(sys.argv[3]) if len(sys.argv) > 3 else 5
pictures = tiles(path)
print(f"{len(pictures)} tiles, libjpeg-turbo {features.version('libjpeg_turbo')}")
pairs = [(ours(program, path), turbo(pictures)) for _ in range(rounds)]
for a, b in pairs:
    print(f"ours {a:.3f} s, libjpeg-turbo {b:.3f} s, ratio {a / b:.3f}")
a, b = (min(p[k] for p in pairs) for k in (0, 1))
print(f"least: ours {a:.3f} s, libjpeg-turbo {b:.3f} s, ratio {a / b:.3f}")
