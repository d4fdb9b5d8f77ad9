#!/usr/bin/env python3
"""Coverage of the stated errors of volumes: `dem compare` on a synthetic glacier, over many draws of correlated noise.

    benches/volume_draws.py EXE [--draws 2000] [--first 0] [--side 120] [--range 200] [--sill 4] [--white 1]

For each draw (its seed is its number) B is hilly ground of SIDE x SIDE cells of 20 m, A the same 30 m lower on an elliptic
glacier; the noise of A has a spherical variogram of RANGE metres and SILL square metres, plus WHITE. Printed: the share of
draws whose true volume lies within 1.96 stated standard errors, the root mean square of the normalised errors, and the same
for the mean of the ground outside. Wants numpy and rasterio.
"""

import argparse
import json
import subprocess
import tempfile
import pathlib
import time

import numpy as np
import rasterio

words = argparse.ArgumentParser()
words.add_argument("exe")
words.add_argument("--draws", type=int, default=2000)
words.add_argument("--first", type=int, default=0)
words.add_argument("--side", type=int, default=120)
words.add_argument("--range", type=float, default=200.0)
words.add_argument("--sill", type=float, default=4.0)
words.add_argument("--white", type=float, default=1.0)
args = words.parse_args()

cell, side = 20.0, args.side
# Noise by its spectrum on a torus twice as large, of which a corner is taken: its covariance is the model's.
torus = 2 * side
away = np.minimum(np.arange(torus), torus - np.arange(torus)) * cell
lag = np.hypot(away[:, None], away[None, :]) / args.range
covariance = args.sill * np.where(lag < 1, 1 - 1.5 * lag + 0.5 * lag**3, 0)
spectrum = np.sqrt(np.maximum(np.fft.fft2(covariance).real, 0))
y, x = (np.mgrid[0:side, 0:side] + 0.5) * cell
ground = 500 + 80 * np.sin(x / 310) + 60 * np.cos(y / 270)
middle, (half_x, half_y) = side * cell / 2, (0.30 * side * cell, 0.22 * side * cell)
turn = np.linspace(0, 2 * np.pi, 73)
ring = np.stack([middle + half_x * np.cos(turn), middle + half_y * np.sin(turn)], 1)
ice = np.zeros((side, side), bool)
for (x1, y1), (x2, y2) in zip(ring[:-1], ring[1:]):
    with np.errstate(divide="ignore", invalid="ignore"):
        ice ^= ((y1 > y) != (y2 > y)) & (x < (x2 - x1) * (y - y1) / (y2 - y1) + x1)
truth = -30.0 * ice.sum() * cell**2
profile = dict(driver="GTiff", width=side, height=side, count=1, dtype="float32", crs="EPSG:32633",
               transform=rasterio.Affine(cell, 0, 5e5, 0, -cell, 87e5))
points = [[5e5 + a, 87e5 - b] for a, b in ring]
zones = {"type": "FeatureCollection", "crs": {"type": "name", "properties": {"name": "EPSG:32633"}}, "features": [
    {"type": "Feature", "properties": {"name": "ice"}, "geometry": {"type": "Polygon", "coordinates": [points]}}]}


def write(path, values):
    with rasterio.open(path, "w", **profile) as out:
        out.write(values.astype("float32"), 1)


with tempfile.TemporaryDirectory() as name:
    folder = pathlib.Path(name)
    (folder / "zones.geojson").write_text(json.dumps(zones))
    write(folder / "b.tif", ground)
    errors, errors_se, start = [], [], time.time()
    for draw in range(args.first, args.first + args.draws):
        random = np.random.default_rng(draw)
        noise = np.fft.ifft2(np.fft.fft2(random.normal(size=(torus, torus))) * spectrum).real[:side, :side]
        noise += np.sqrt(args.white) * random.normal(size=(side, side))
        write(folder / "a.tif", ground + noise - 30.0 * ice)
        command = [args.exe, "dem", "compare", folder / "a.tif", folder / "b.tif", "-o", folder / "out", "--overwrite",
                   "--zones", folder / "zones.geojson", "--json"]
        found = json.loads(subprocess.run(command, check=True, capture_output=True).stdout)["volumes"][0]
        errors.append(found["volume_m3"] - truth)
        errors_se.append(found["volume_se_m3"])
        if len(errors) % 100 == 0 or len(errors) == args.draws:
            e, s = np.array(errors), np.array(errors_se)
            print(f"{len(errors)} draws, {time.time() - start:.0f} s: within 95 %: {100 * np.mean(abs(e) < 1.96 * s):.1f} %, "
                  f"normalised RMS {np.sqrt(np.mean((e / s) ** 2)):.3f}, RMS error {np.sqrt(np.mean(e**2)):.0f} m3, "
                  f"median stated {np.median(s):.0f} m3, mean error {e.mean():.0f} m3", flush=True)
