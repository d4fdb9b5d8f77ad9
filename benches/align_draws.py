#!/usr/bin/env python3
"""Stated errors of `dem align` on a real model that was moved, tilted, made noisy and partly changed.

    benches/align_draws.py EXE MODEL.tif [--draws 400] [--first 0] [--method auto] [--noise 1] [--tilt 0.3]

For each draw (its seed is its number) B is every other cell of MODEL, smoothed by 1.2 cells, and A the same ground moved by
up to 3 of B's cells each way (a spline of the fifth degree between MODEL's cells), raised by up to 5 m and tilted by up to
TILT mm/m towards east and north; both have white noise of NOISE metres, and an ellipse over a tenth of A has melted by up
to 30 m. Printed: the root mean square of (found - true) / stated and of found - true for east, north, height and tilts, and
refusals. Wants numpy, scipy and rasterio.
"""

import argparse
import json
import math
import pathlib
import subprocess
import tempfile

import numpy as np
import rasterio
from rasterio.transform import from_origin
from scipy.ndimage import gaussian_filter, map_coordinates, spline_filter

words = argparse.ArgumentParser()
words.add_argument("exe")
words.add_argument("model")
words.add_argument("--draws", type=int, default=400)
words.add_argument("--first", type=int, default=0)
words.add_argument("--method", default="auto")
words.add_argument("--noise", type=float, default=1.0)
words.add_argument("--tilt", type=float, default=0.3)
args = words.parse_args()

with rasterio.open(args.model) as source:
    ground = source.read(1).astype(float)
    cell, crs = 2 * source.transform.a, source.crs
    if source.nodata is not None:
        ground[ground == source.nodata] = np.nan
# Without holes a spline is smooth everywhere: each takes the nearest row's value above it.
ground = np.where(np.isfinite(ground), ground, np.nanmedian(ground))
spline = spline_filter(gaussian_filter(ground, 2.4), order=5)
margin = 8
rows, columns = ground.shape[0] // 2 - 2 * margin, ground.shape[1] // 2 - 2 * margin
row, column = np.mgrid[0:rows, 0:columns] + float(margin)
west, north = 500000.0, 8700000.0


def heights(east_m, north_m):
    """Of cells whose ground lies so much farther east and north."""
    at = [2 * (row - north_m / cell), 2 * (column + east_m / cell)]
    return map_coordinates(spline, at, order=5, prefilter=False, mode="nearest")


def write(path, values):
    profile = dict(driver="GTiff", height=rows, width=columns, count=1, dtype="float32", crs=crs, nodata=-9999,
                   transform=from_origin(west, north, cell, cell), tiled=True, compress="deflate", predictor=3)
    with rasterio.open(path, "w", **profile) as out:
        out.write(values.astype(np.float32), 1)


still = heights(0, 0)
normalised, errors, refused = [], [], 0
with tempfile.TemporaryDirectory() as folder:
    a, b, out = (pathlib.Path(folder) / name for name in ("a.tif", "b.tif", "out.tif"))
    for draw in range(args.first, args.first + args.draws):
        dice = np.random.default_rng(draw)
        east, north_m = dice.uniform(-3 * cell, 3 * cell, 2)
        up = dice.uniform(-5, 5)
        tilt_e, tilt_n = dice.uniform(-args.tilt, args.tilt, 2) / 1000
        write(b, still + dice.normal(0, args.noise, still.shape))
        # A shows at X what lies at X + (east, north): it goes that far to lie on B.
        moved = heights(east, north_m)
        x = (column - margin + 0.5) * cell
        y = -(row - margin + 0.5) * cell
        middle = (columns * cell / 2, -rows * cell / 2)
        moved += up + tilt_e * (x - middle[0]) + tilt_n * (y - middle[1])
        centre = dice.uniform(0.25, 0.75, 2) * (rows, columns)
        half = math.sqrt(0.1 * rows * columns / math.pi)
        away = np.hypot(row - margin - centre[0], column - margin - centre[1]) / half
        moved -= np.where(away < 1, 30 * (1 - 0.5 * away), 0)
        write(a, moved + dice.normal(0, args.noise, moved.shape))
        command = [args.exe, "dem", "align", a, "--to", b, "-o", out, "--overwrite", "--json", "--quiet", "--method", args.method]
        run = subprocess.run(command, capture_output=True, text=True)
        found = json.loads(run.stdout)
        if run.returncode:
            refused += 1
            print(f"# draw {draw}: exit {run.returncode}: {run.stderr.strip() or found}")
            continue
        # The surface that is added counts at the middle of the aligned A, which lies as A's own.
        pairs = [(found["shift_e_m"], east, found["shift_e_se_m"]), (found["shift_n_m"], north_m, found["shift_n_se_m"]),
                 (found["shift_h_m"], -up, found["shift_h_se_m"])]
        if found["tilted"]:
            pairs += [(found[f"tilt_{axis}_mm_per_m"], -1000 * true, found[f"tilt_{axis}_se_mm_per_m"])
                      for axis, true in (("e", tilt_e), ("n", tilt_n))]
        else:
            pairs += [(math.nan, 0, 1)] * 2
        normalised.append([(value - true) / stated for value, true, stated in pairs])
        errors.append([value - true for value, true, _ in pairs])

z, e = np.array(normalised), np.array(errors)
print(f"{len(z)} draws, {refused} refused, a tilt in {int(np.isfinite(z[:, 3]).sum())}")
for index, name in enumerate(["east m", "north m", "height m", "tilt e mm/m", "tilt n mm/m"]):
    rms = lambda values: math.sqrt(np.nanmean(values[:, index] ** 2))
    print(f"{name}: normalised {rms(z):.3f}, error {rms(e):.5f}, mean error {np.nanmean(e[:, index]):+.5f}")
