#!/usr/bin/env python3
"""The whole chain on drawn film: a rendered flight exposed on film with fiducial marks, scanned, and solved.

    benches/flight_film.py EXE [--frames 5] [--camera svalbard-zeiss-1936] [--pixel-um 50] [--seed 1] [--pitch -90] [--keep DIR]

`synth-flight` renders the frames, `synth-film` the film around them (marks, grain, a small turn and shift of every scan), `fiducials
--resample` finds the marks and the interior orientation, `flight init` takes the camera from what it wrote, `flight solve` the
cameras. Compared with the truth: cameras, focal length. Wants numpy, rasterio.
"""

import argparse
import json
import pathlib
import subprocess
import tempfile
import tomllib

import numpy as np
import rasterio

words = argparse.ArgumentParser()
words.add_argument("exe")
words.add_argument("--frames", type=int, default=5)
words.add_argument("--camera", default="svalbard-zeiss-1936")
words.add_argument("--pixel-um", type=float, default=50.0)
words.add_argument("--seed", type=int, default=1)
words.add_argument("--pitch", default="-90")
words.add_argument("--keep", type=pathlib.Path)
args = words.parse_args()
MM = 0.1
CLEAR_MM = 9.0

source = pathlib.Path(__file__).parent.parent / f"crates/film/src/cameras/{args.camera}.toml"
film = tomllib.loads(source.read_text())
down = 1.0 if film["y_axis"] == "down" else -1.0
marks = {m["name"]: np.array([m["x_mm"], down * m["y_mm"]]) for m in film["marks"]}
places = np.array(list(marks.values()))
low, high = places.min(0), places.max(0)
centred = all(low + (high - low) / 4 < 0) and all(high - (high - low) / 4 > 0)
principal = np.zeros(2) if centred else places.mean(0)
f_px = film["focal_length_mm"] / MM


def run(*command):
    done = subprocess.run([args.exe, *map(str, command)], capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{' '.join(map(str, command))}: exit {done.returncode}: {done.stderr.strip()[-2000:]}")
    return done


def expose(frame, scan, truth, target):
    """Puts a frame under the marks of a scan, by the affine transform of the marks' true places."""
    at = {m["mark"]: [m["x"], m["y"]] for m in truth["marks"]}
    design = np.array([[*marks[name], 1.0] for name in at])
    to_scan = np.linalg.lstsq(design, np.array(list(at.values())), rcond=None)[0].T
    inverse = np.linalg.inv(np.vstack([to_scan, [0, 0, 1]]))
    with rasterio.open(scan) as file:
        picture, profile = file.read(1), file.profile
    with rasterio.open(frame) as file:
        image = file.read(1).astype(float)
    rows, columns = np.mgrid[0 : picture.shape[0], 0 : picture.shape[1]] + 0.5
    mm = np.stack([inverse[a, 0] * columns + inverse[a, 1] * rows + inverse[a, 2] for a in (0, 1)])
    u, v = ((mm[k] - principal[k]) / MM + image.shape[1 - k] / 2 - 0.5 for k in (0, 1))
    inside = (u > 0) & (v > 0) & (u < image.shape[1] - 1.001) & (v < image.shape[0] - 1.001)
    for place in places:
        inside &= (mm[0] - place[0]) ** 2 + (mm[1] - place[1]) ** 2 > CLEAR_MM**2
    for k in (0, 1):
        inside &= (mm[k] > low[k] + 1) & (mm[k] < high[k] - 1)
    u, v = u[inside], v[inside]
    i, j = u.astype(int), v.astype(int)
    a, b = u - i, v - j
    value = (1 - b) * ((1 - a) * image[j, i] + a * image[j, i + 1]) + b * ((1 - a) * image[j + 1, i] + a * image[j + 1, i + 1])
    picture[inside] = np.clip(value * (1.0 if picture.dtype == np.uint8 else 257.0) + 0.5, 0, np.iinfo(picture.dtype).max)
    with rasterio.open(target, "w", **profile) as file:
        file.write(picture, 1)


def chain(folder):
    side = int(2 * max((principal - low).max(), (high - principal).max()) / MM) + 40
    flight = folder / "flight"
    run("synth-flight", flight, "--frames", args.frames, "--grey", f"--pitch={args.pitch}", "--size", f"{side},{side}", "--f-px", f_px, "--seed", args.seed)
    run("synth-film", folder / "marks", "--camera", args.camera, "--frames", args.frames, "--pixel-um", args.pixel_um, "--seed", args.seed)
    (folder / "scans").mkdir()
    frames = sorted((flight / "frames").iterdir())
    for frame, scan in zip(frames, sorted((folder / "marks").glob("*.tif")), strict=True):
        expose(frame, scan, json.loads(scan.with_suffix(".truth.json").read_text()), folder / "scans" / frame.name)
    run("fiducials", folder / "scans", "--camera", args.camera, "-o", folder / "film", "--resample", "--resample-mm", MM)
    # Image points are those of the film, in pixels of the resampled frames.
    shift = (principal - low) / MM - side / 2
    rows = (flight / "gcps.txt").read_text().splitlines()
    moved = []
    for row in rows[1:]:
        f = row.split()
        f[3:5] = [f"{float(f[3 + k]) + shift[k]:.3f}" for k in (0, 1)]
        moved.append(" ".join(f))
    (folder / "gcps.txt").write_text("\n".join([rows[0], *moved]) + "\n")
    toml = folder / "FLIGHT.toml"
    run("flight", "init", folder / "film", "--cameras", flight / "table.csv", "--gcps", folder / "gcps.txt", "--crs", "local", "-o", toml)
    given = tomllib.loads((flight / "FLIGHT.toml").read_text())["gcps"]
    text = toml.read_text().replace("sigma_image_px = 5.0", f"sigma_image_px = {given['sigma_image_px']}")
    text = text.replace("[pairs]", f"check = {json.dumps(given['check'])}\n\n[pairs]")
    toml.write_text(text)
    print(text)
    found = json.loads(run("flight", "solve", toml, "-o", folder / "out", "--json").stdout)
    truth = {i["name"].split(".")[0]: np.array(i["C"]) for i in json.loads((flight / "truth.json").read_text())["images"]}
    errors = np.array([np.array(c["C"]) - truth[c["name"].split(".")[0]] for c in found["cameras"]])
    checks = np.array([p["residual_m"] for p in found["check_points"] if p["residual_m"]])
    rms = lambda e: " / ".join(f"{v:.1f}" for v in np.sqrt((e**2).mean(0)))
    print(f"{found['frames_registered']} of {found['frames_listed']} frames; cameras {rms(errors)} m; check points {rms(checks)} m")
    print(f"f {found['interior'][0]['f_px']:.2f} px of {f_px:.2f}; ties {found['ties']}, mean reprojection {found['reprojection_mean_px']:.2f} px")


if args.keep:
    args.keep.mkdir(parents=True)
    chain(args.keep)
else:
    with tempfile.TemporaryDirectory() as folder:
        chain(pathlib.Path(folder))
