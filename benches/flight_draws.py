#!/usr/bin/env python3
"""`flight solve` on a rendered flight with truth, over many draws of the rough table and the GCPs.

    benches/flight_draws.py EXE FLIGHT [--draws 10] [--first 0] [--every 1] [--sigma-table 200,1] [--sigma-gcp 25,0.7] [--gcps 12]
                            [--engine colmap|pycolmap] [--keep DIR]

FLIGHT holds truth.json, dem10.npz, depth_NAME.npz and the frames (../shared/data/flight; its README says what they are). For each
draw (its seed is its number) the table gets errors of 200 m and 1 degree, and GCPs and check points are drawn on the ground where
at least three frames see it, as its depths have it. Printed: frames registered, RMS errors of cameras and of check points
against the truth (not against what the list says), focal length, and at the end median and worst. With --gcps 0 the table alone
places the block. --keep leaves each draw in DIR/SEED, and
goes on from what is there. Wants numpy.
"""

import argparse
import contextlib
import json
import pathlib
import subprocess
import sys
import tempfile
import time

import numpy as np

words = argparse.ArgumentParser()
words.add_argument("exe")
words.add_argument("flight", type=pathlib.Path)
words.add_argument("--draws", type=int, default=10)
words.add_argument("--first", type=int, default=0)
words.add_argument("--every", type=int, default=1)
words.add_argument("--sigma-table", default="200,1")
words.add_argument("--sigma-gcp", default="25,0.7")
words.add_argument("--gcps", type=int, default=12)
words.add_argument("--engine", default="colmap", help="colmap, or pycolmap in the interpreter that AUTOREF_PYTHON names")
words.add_argument("--keep", type=pathlib.Path)
args = words.parse_args()
place_m, turn_deg = map(float, args.sigma_table.split(","))
ground_m, image_px = map(float, args.sigma_gcp.split(","))

truth = json.loads((args.flight / "truth.json").read_text())
images = truth["images"][:: args.every]
f, cx, cy, k1, size = truth["f_px"], truth["cx"], truth["cy"], truth["k1"], truth["size"]
grid = np.load(args.flight / "dem10.npz")
heights, x0, y0, step = grid["z"] / 10.0, float(grid["x0"]), float(grid["y0"]), float(grid["d"])
depths = {}
for image in images:
    file = args.flight / f"depth_{image['name'].split('_')[1].split('.')[0]}.npz"
    stored = np.load(file)
    depths[image["name"]] = stored[list(stored)[0]].astype(float)


def height(x, y):
    u, v = (x - x0) / step, (y - y0) / step
    i, j = int(u), int(v)
    if not (0 <= i < heights.shape[1] - 1 and 0 <= j < heights.shape[0] - 1):
        return None
    a, b = u - i, v - j
    cell = heights[j : j + 2, i : i + 2]
    return float((1 - b) * ((1 - a) * cell[0, 0] + a * cell[0, 1]) + b * ((1 - a) * cell[1, 0] + a * cell[1, 1]))


def seen(image, point):
    """The pixel at which a frame shows a point, when nothing hides it."""
    p = np.array(image["R"]) @ (point - np.array(image["C"]))
    if p[2] <= 0:
        return None
    u, v = p[0] / p[2], p[1] / p[2]
    r = 1 + k1 * (u * u + v * v)
    x, y = f * u * r + cx, f * v * r + cy
    if not (20 < x < size - 20 and 20 < y < size - 20):
        return None
    depth = depths[image["name"]][int(y / 2), int(x / 2)]
    return (x, y) if depth > 0 and abs(depth - p[2]) < 0.01 * p[2] else None


def angles(rotation):
    right, _, view = np.array(rotation)
    yaw, pitch = np.arctan2(view[0], view[1]), np.arcsin(view[2])
    level = np.array([np.cos(yaw), -np.sin(yaw), 0.0])
    down = np.cross(view, level)
    return np.degrees([yaw, pitch, np.arctan2(right @ down, right @ level)])


def draw(folder, seed):
    rng = np.random.default_rng(seed)
    lines = ["name,x,y,z,yaw,pitch,roll"]
    for image in images:
        c = np.array(image["C"]) + rng.normal(0, place_m, 3)
        a = angles(image["R"]) + rng.normal(0, turn_deg, 3)
        lines.append(",".join([image["name"], *(f"{v:.4f}" for v in [*c, *a])]))
    (folder / "table.csv").write_text("\n".join(lines) + "\n")
    rows, points = ["local"], {}
    while len(points) < 2 * args.gcps:
        x, y = rng.uniform(500, 17500), rng.uniform(600, 11000)
        z = height(x, y)
        if z is None or z < 5:
            continue
        point = np.array([x, y, z])
        views = [(image["name"], at) for image in images if (at := seen(image, point))]
        if len(views) < 3:
            continue
        check = len(points) >= args.gcps
        name = f"{'C' if check else 'G'}{len(points):02}"
        points[name] = point
        told = point + (0 if check else rng.normal(0, ground_m, 3))
        for frame, at in views:
            u, v = np.array(at) + rng.normal(0, image_px, 2)
            rows.append(f"{told[0]:.3f} {told[1]:.3f} {told[2]:.3f} {u:.3f} {v:.3f} {frame} {name}")
    (folder / "gcps.txt").write_text("\n".join(rows) + "\n")
    frames = folder / "frames"
    frames.mkdir()
    for image in images:
        (frames / image["name"]).symlink_to((args.flight / image["name"]).resolve())
    checks = json.dumps([name for name in points if name[0] == "C"])
    gcps = f'[gcps]\nlist = "gcps.txt"\nsigma_ground_m = {ground_m}\nsigma_image_px = {image_px}\ncheck = {checks}\n'
    (folder / "FLIGHT.toml").write_text(
        f'crs = "local"\n[frames]\nfolder = "frames"\npattern = ["*.png"]\n[camera]\nf_px = {f}\npp_px = [{cx}, {cy}]\n'
        f'[rough]\ntable = "table.csv"\nsigma_m = {place_m}\n'
        + (gcps if args.gcps else f"ground_m = {np.median(heights):.0f}\n")
    )


def place(seed):
    if args.keep is None:
        return tempfile.TemporaryDirectory()
    folder = args.keep / str(seed)
    folder.mkdir(parents=True, exist_ok=True)
    return contextlib.nullcontext(folder)


found, errors = [], []
for seed in range(args.first, args.first + args.draws):
    with place(seed) as folder:
        folder = pathlib.Path(folder)
        if not (folder / "FLIGHT.toml").exists():
            draw(folder, seed)
        start = time.time()
        run = subprocess.run(
            [args.exe, "flight", "solve", folder / "FLIGHT.toml", "-o", folder / "out", "--engine", args.engine, "--json"],
            capture_output=True,
            text=True,
        )
        if run.returncode != 0:
            print(f"draw {seed}: exit {run.returncode}: {run.stderr.strip().splitlines()[-1]}", flush=True)
            continue
        document = json.loads(run.stdout)
        at = {image["name"]: np.array(image["C"]) for image in images}
        cameras = np.array([np.array(c["C"]) - at[c["name"]] for c in document["cameras"]])
        checks = np.array([p["residual_m"] for p in document["check_points"] if p["residual_m"]]).reshape(-1, 3)
        sigmas = [[c[f"sigma_{axis}"] for axis in "enh"] for c in document["cameras"]]
        errors.extend(cameras / np.array(sigmas, dtype=float))
        row = [
            document["frames_registered"],
            *np.sqrt((cameras**2).mean(0)),
            *(np.sqrt((checks**2).mean(0)) if len(checks) else [np.nan] * 3),
            100 * (document["interior"][0]["f_px"] / f - 1),
            document["reprojection_mean_px"],
        ]
        found.append(row)
        print(
            f"draw {seed}: {row[0]} of {len(images)} frames; cameras {row[1]:.1f} {row[2]:.1f} {row[3]:.1f} m; check points "
            f"{row[4]:.1f} {row[5]:.1f} {row[6]:.1f} m; f {row[7]:+.2f} %; mean reprojection {row[8]:.2f} px; "
            f"{document['ties']} ties; {len(document['lines'])} lines; {time.time() - start:.0f} s",
            flush=True,
        )
if not found:
    sys.exit("no draw was solved")
table = np.abs(np.array(found))
for name, row in [("median", np.median(table, 0)), ("worst", table.max(0))]:
    print(
        f"{name}: cameras {row[1]:.1f} {row[2]:.1f} {row[3]:.1f} m; check points {row[4]:.1f} {row[5]:.1f} {row[6]:.1f} m; f {row[7]:.2f} %; "
        f"mean reprojection {row[8]:.2f} px"
    )
print(f"fewest frames registered: {int(np.array(found)[:, 0].min())}; draws solved: {len(found)} of {args.draws}")
print("cameras' errors over their stated deviations, RMS in e, n, h: " + " ".join(f"{v:.2f}" for v in np.sqrt((np.array(errors) ** 2).mean(0))))
