#!/usr/bin/env python3
"""A flight's clouds: an elevation model seen from many cameras, one cloud a camera, with noise, flying and low points.

    benches/cloud_flight.py MODEL.tif FOLDER [--cameras 89] [--points 200000] [--reach 8000] [--seed 1]

Cameras fly lines over the model, 1,200 m above its highest point, and look aside, 30 to 80 degrees off the vertical. Each
cloud holds the model's cells within its view, at random places between them (bilinear), as far as REACH metres away: doubles with
600,000 and 8,600,000 m taken off where the model lies there. Written: `cam_NNN.ply`, `cameras.csv` (cloud,E,N,H, map
coordinates) and `truth.csv` (cloud, points, drawn flying and low points). Then, with one command each:

    autoref-stream cloud clean FOLDER/*.ply -o CLEAN --shift E,N,H --z -50,3000 --range-from FOLDER/cameras.csv \\
      --outliers k=8,m=2 --ground --drop noise,object
    autoref-stream cloud grid CLEAN/*.laz -o GRIDS --cell 2 --stat mean,count

The shift is printed. Wants numpy and rasterio.
"""

import argparse
import pathlib

import numpy as np
import rasterio

words = argparse.ArgumentParser()
words.add_argument("model")
words.add_argument("folder", type=pathlib.Path)
words.add_argument("--cameras", type=int, default=89)
words.add_argument("--points", type=int, default=200_000)
words.add_argument("--reach", type=float, default=8000.0)
words.add_argument("--seed", type=int, default=1)
args = words.parse_args()
random = np.random.default_rng(args.seed)
args.folder.mkdir(parents=True, exist_ok=True)
with rasterio.open(args.model) as source:
    heights = source.read(1, masked=True).astype(float).filled(np.nan)
    inverse, bounds = ~source.transform, source.bounds
shift = np.array([np.floor(bounds.left / 1e5) * 1e5, np.floor(bounds.bottom / 1e5) * 1e5, 0.0])


def ground(x, y):
    column, row = inverse * (x, y)
    column, row = column - 0.5, row - 0.5
    i, j = np.floor(row).astype(int), np.floor(column).astype(int)
    inside = (i >= 0) & (j >= 0) & (i < heights.shape[0] - 1) & (j < heights.shape[1] - 1)
    i, j, u, v = (np.where(inside, value, 0) for value in (i, j, column - j, row - i))
    z = (1 - v) * ((1 - u) * heights[i, j] + u * heights[i, j + 1]) + v * (
        (1 - u) * heights[i + 1, j] + u * heights[i + 1, j + 1]
    )
    return np.where(inside, z, np.nan)


lines = max(1, round(args.cameras**0.5 / 2))
cameras = open(args.folder / "cameras.csv", "w")
truth = open(args.folder / "truth.csv", "w")
cameras.write("cloud,E,N,H\n")
truth.write("cloud,points,flying,low\n")
for number in range(args.cameras):
    line, along = number % lines, (number // lines + 0.5) / -(-args.cameras // lines)
    east = bounds.left + along * (bounds.right - bounds.left)
    north = bounds.bottom + (line + 0.5) / lines * (bounds.top - bounds.bottom)
    height = np.nanmax(heights) + 1200
    side = random.choice([-1, 1])
    # Even in the angle off the vertical, and so thinner with distance, as dense matching of obliques is.
    off = np.radians(random.uniform(30, 80, 3 * args.points))
    away = np.minimum(1200 * np.tan(off), args.reach * random.uniform(0.9, 1, len(off)))
    turn = np.radians(random.uniform(-30, 30, len(away))) + side * np.pi / 2
    x, y = east + away * np.cos(turn), north + away * np.sin(turn)
    z = ground(x, y) + 0.3 * random.standard_normal(len(x))
    xyz = np.stack([x, y, z], axis=1)[np.isfinite(z)][: args.points]
    kind = random.random(len(xyz))
    xyz[kind < 0.004, 2] += random.uniform(20, 400, (kind < 0.004).sum())
    xyz[kind > 0.999, 2] -= random.uniform(10, 100, (kind > 0.999).sum())
    name = f"cam_{number:03d}"
    if not len(xyz):
        continue
    with open(args.folder / f"{name}.ply", "wb") as out:
        out.write(
            b"ply\nformat binary_little_endian 1.0\nelement vertex %d\n"
            b"property double x\nproperty double y\nproperty double z\nend_header\n" % len(xyz)
        )
        out.write((xyz - shift).astype("<f8").tobytes())
    cameras.write(f"{name},{east:.3f},{north:.3f},{height:.3f}\n")
    truth.write(f"{name},{len(xyz)},{(kind < 0.004).sum()},{(kind > 0.999).sum()}\n")
print("--shift", ",".join(f"{value:.0f}" for value in shift))
