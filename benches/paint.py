#!/usr/bin/env python3
"""Painted marks that the detector was not made with: any hue, real RAL values, shadow, wear, blur.

    python3 benches/paint.py PROGRAM PHOTOGRAPHS… [--half tune|held-out|all] [--cells REGEX] [--marks N] [--jobs N] [--advice] [--nothing N]

draws marks into photographs and runs `PROGRAM detect` on them (`--jobs N`: also N whole jobs of 20 points a cell), and prints a
Markdown table: recall, RMSE per axis, share of candidates whose error is more than 5 of its stated deviations, false candidates
per megapixel. Needs numpy and opencv-python-headless. Nothing of the project is used to draw: outlines are polygons that OpenCV
fills at 16 times the resolution and averages, blurred by its Gaussian, mixed on the stored values, with JPEG by its encoder.

Photographs are split by SHA-256 of the file's name: odd first byte is held out. Limits may be chosen on the others only.
"""
import argparse
import colorsys
import functools
import hashlib
import json
import math
import os
import re
import subprocess
import sys
import tempfile

import cv2
import numpy as np

FINE = 16
CROP = 1400

# RAL Classic, in the two tables of sRGB values that are in use.
RAL = {
    "RAL 2003": [(255, 117, 20), (250, 132, 43)],
    "RAL 2004": [(244, 70, 17), (231, 91, 18)],
    "RAL 2005": [(255, 35, 1), (255, 35, 0)],
    "RAL 2007": [(255, 164, 32), (255, 164, 33)],
    "RAL 3020": [(204, 6, 5), (187, 30, 16)],
    "RAL 3024": [(248, 0, 0), (255, 45, 33)],
    "RAL 5015": [(34, 113, 179), (0, 124, 176)],
    "RAL 1003": [(249, 168, 0)],
    "RAL 1016": [(237, 255, 33), (241, 221, 56)],
    "RAL 1026": [(255, 255, 0)],
    "RAL 6018": [(87, 166, 57), (97, 153, 59)],
}
ORANGE = [(255, 103, 0), (255, 90, 31)]


def cell(name, paints=ORANGE, side=12.0, blur=0.8, profile="orange", **more):
    return dict(name=name, paints=paints, side=side, blur=blur, profile=profile, **more)


def of_hue(degrees, saturation=1.0, value=1.0):
    return [tuple(round(255 * c) for c in colorsys.hsv_to_rgb(degrees / 360, saturation, value))]


def cells():
    for side in (5, 6, 8, 12, 20, 40, 60):
        yield cell(f"orange, {side} px", side=side)
    for hue in (0, 6, 12, 18, 24, 30, 36, 42, 48, 54, 60):
        yield cell(f"hue {hue}°", [of_hue(hue, s, v)[0] for s, v in ((1, 1), (0.9, 0.95), (0.85, 1))], sweep=True)
    yield cell("safety orange (255, 121, 0)", [(255, 121, 0)])
    yield cell("red (200, 25, 30)", [(200, 25, 30)], sweep=True)
    for name in ("RAL 2003", "RAL 2004", "RAL 2005", "RAL 2007", "RAL 3020"):
        yield cell(name, RAL[name], sweep=True)
    for name in RAL:
        code = name.replace("RAL ", "ral-")
        yield cell(f"{name}, {code}", RAL[name], profile=code)
    yield cell("pink (255, 20, 147), pink", [(255, 20, 147), (235, 60, 150)], profile="pink", sweep=True)
    yield cell("blue, RAL 5015", RAL["RAL 5015"], profile="blue", sweep=True)
    yield cell("yellow, (249, 168, 0)", [(249, 168, 0)], profile="yellow")
    yield cell("white, white", [(245, 245, 245), (235, 238, 240)], profile="white", sweep=True)
    for side in (12, 20):
        yield cell(f"surroundings in shadow × 0.4, {side} px", side=side, shade=0.4)
        yield cell(f"half in shadow × 0.4, {side} px", side=side, half=0.4)
    yield cell("surroundings in shadow × 0.3", shade=0.3)
    yield cell("surroundings in shadow × 0.6", shade=0.6)
    yield cell("half in shadow × 0.6", half=0.6)
    yield cell("over-exposed × 1.4", shade=1.4)
    yield cell("haze 25 %", haze=0.25)
    yield cell("cast (0.85, 1, 1.15)", cast=(0.85, 1.0, 1.15))
    yield cell("worn 40 %", worn=0.4)
    yield cell("worn 60 %", worn=0.6)
    yield cell("paint × 0.4", [tuple(round(0.4 * v) for v in c) for c in ORANGE])
    yield cell("6 px, blur 2.1 px", side=6, blur=2.1)
    yield cell("6 px, blur 2.5 px", side=6, blur=2.5)
    for side in (12, 24):
        for gone in (0.07, 0.15):
            yield cell(f"{gone * 100:.0f} % of the paint gone, {side} px", side=side, gone=gone)
    yield cell("15 % of the paint gone, white, 24 px", [(245, 245, 245), (235, 238, 240)], profile="white", side=24, gone=0.15)


def circle():
    for hue in range(0, 360, 15):
        yield cell(f"hue {hue}°, s 1, v 1", of_hue(hue), sweep=True)
        yield cell(f"hue {hue}°, s 0.7, v 0.8", of_hue(hue, 0.7, 0.8), sweep=True)


def advice():
    """What to paint on which ground, with a dark rim or without."""
    grounds = {"asphalt": (88, 88, 90), "concrete": (198, 196, 188), "dry grass": (182, 166, 108), "red earth": (165, 88, 58),
               "green grass": (76, 104, 50), "snow": (238, 241, 246)}
    paints = {"orange": ORANGE, "pink": [(255, 20, 147)], "yellow": [(255, 220, 20)], "blue": RAL["RAL 5015"], "white": [(245, 245, 245)]}
    for paint, colours in paints.items():
        for ground, colour in grounds.items():
            for rim in (0, 0.25, 0.5, 1):
                yield cell(f"{paint} on {ground}, rim {rim}", colours, profile=paint, patch=colour, rim=rim)
    for side in (6, 8, 10, 12, 16):
        for disc in (False, True):
            yield cell(f"{'disc' if disc else 'square'} of {side} px", side=side, disc=disc)


def is_held_out(path):
    return hashlib.sha256(os.path.basename(path).encode()).digest()[0] % 2 == 1


@functools.lru_cache(maxsize=None)
def photograph(path):
    picture = cv2.imread(path, cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH)
    if picture is None:
        return None
    if picture.dtype != np.uint8:
        # OpenCV takes 16 bits for full range; a camera fills some of it.
        picture = np.clip(picture * (250.0 / np.percentile(picture, 99.5)), 0, 255).astype(np.uint8)
    return picture[:, :, ::-1]


def crops(paths, random, count, side=CROP):
    """So many windows, spread over the photographs; where nothing was photographed (exactly black) there is no ground."""
    pictures = [p for p in (photograph(path) for path in paths) if p is not None and min(p.shape[:2]) >= 350]
    for k in range(count):
        picture = pictures[k % len(pictures)]
        h, w = picture.shape[:2]
        y, x = random.integers(0, max(h - side, 0) + 1), random.integers(0, max(w - side, 0) + 1)
        yield picture[y : y + side, x : x + side].astype(np.float32)


def coverage(centre, side, angle, disc, size):
    """Share of each pixel of a size × size patch that the mark covers; pixel corners lie at whole numbers."""
    if disc:
        turns = np.linspace(0, 2 * math.pi, 180, endpoint=False)
        corners = np.stack([np.cos(turns), np.sin(turns)], 1) * side / 2
    else:
        turns = angle + math.pi / 4 + np.arange(4) * math.pi / 2
        corners = np.stack([np.cos(turns), np.sin(turns)], 1) * side / math.sqrt(2)
    fine = np.zeros((size * FINE, size * FINE), np.float32)
    # OpenCV counts from the middle of the first pixel; four more bits of a fine pixel.
    points = np.round(((corners + centre) * FINE - 0.5) * 16).astype(np.int32)
    cv2.fillPoly(fine, [points.reshape(-1, 1, 2)], 1.0, lineType=cv2.LINE_8, shift=4)
    return cv2.resize(fine, (size, size), interpolation=cv2.INTER_AREA)


def left_of(cover, side, gone, random):
    """What is left of the paint where so large a share has come off, in flakes of about a tenth of a side."""
    size = cover.shape[0]
    uneven = cv2.GaussianBlur(random.normal(0, 1, (size, size)).astype(np.float32), (0, 0), max(1.0, side / 14))
    fine = cv2.resize(uneven, None, fx=FINE, fy=FINE, interpolation=cv2.INTER_CUBIC)
    inside = cv2.resize(cover, None, fx=FINE, fy=FINE, interpolation=cv2.INTER_NEAREST) > 0.5
    left = (fine > np.quantile(fine[inside], gone)).astype(np.float32)
    return cv2.resize(left, (size, size), interpolation=cv2.INTER_AREA)


def plant(picture, at, spec, random, disc):
    """Draws one mark with its centre near `at`; returns the true centre."""
    disc = spec.get("disc", disc)
    side, blur = spec["side"], spec["blur"]
    around = max(60, int(4 * side)) if "shade" in spec or "half" in spec else int(side * 1.5 + 6 * blur + 12)
    if "patch" in spec:
        around = int(3 * side) + 8
    size = 2 * around
    x0, y0 = int(at[0]) - around, int(at[1]) - around
    ground = picture[y0 : y0 + size, x0 : x0 + size]
    if (ground.max(axis=2) == 0).mean() > 0.02:
        return None
    centre = np.array([around + random.uniform(-0.5, 0.5), around + random.uniform(-0.5, 0.5)])
    angle = random.uniform(0, math.pi / 2)
    cover = coverage(centre, side, angle, disc, size)
    paint = np.array(spec["paints"][random.integers(len(spec["paints"]))], np.float32)
    if "gone" in spec:
        cover = cover * left_of(cover, side, spec["gone"], random)
    own = 1.0 - spec.get("worn", 0.0)
    if "patch" in spec:
        # Ground of this colour, uneven in brightness, around the mark; and a rim so many sides wide that is nearly black.
        v, u = np.mgrid[0:size, 0:size] + 0.5
        within = np.clip(around - 3 - np.hypot(u - centre[0], v - centre[1]), 0, 4)[..., None] / 4
        uneven = cv2.GaussianBlur(random.normal(0, 1, (size, size)).astype(np.float32), (0, 0), 1.5)
        own_ground = np.array(spec["patch"], np.float32) * (1 + 0.06 * uneven / uneven.std())[..., None]
        ground = ground + within * (own_ground - ground)
        if spec["rim"]:
            dark = cv2.GaussianBlur(coverage(centre, side * (1 + 2 * spec["rim"]), angle, disc, size), (0, 0), blur)
            ground = ground + dark[..., None] * (np.float32(28) - ground)
    drawn = ground + (own * cover)[..., None] * (paint - ground)
    if "half" in spec:
        # The border of a shadow goes through the mark, near its middle, any way round.
        turn = random.uniform(0, 2 * math.pi)
        off = random.uniform(-0.2, 0.2) * side
        v, u = np.mgrid[0:size, 0:size] + 0.5
        beyond = (u - centre[0]) * math.cos(turn) + (v - centre[1]) * math.sin(turn) - off
        light = 1 - (1 - spec["half"]) * np.clip(beyond + 0.5, 0, 1)
        far = np.hypot(u - centre[0], v - centre[1]) > around - 2
        drawn = drawn * np.where(far, 1.0, light)[..., None]
    drawn = cv2.GaussianBlur(drawn, (0, 0), blur)
    if "half" in spec:
        weight = np.clip(cv2.GaussianBlur((np.hypot(u - centre[0], v - centre[1]) < around - 6).astype(np.float32), (0, 0), 2), 0, 1)
    else:
        # The photograph keeps its own sharpness.
        weight = np.float32(1)
        drawn = ground + cv2.GaussianBlur(own * cover, (0, 0), blur)[..., None] * (paint - ground)
    if "shade" in spec:
        v, u = np.mgrid[0:size, 0:size] + 0.5
        radius = np.hypot(u - centre[0], v - centre[1])
        light = spec["shade"] + (1 - spec["shade"]) * np.clip((radius - (around - 14)) / 8, 0, 1)
        picture[y0 : y0 + size, x0 : x0 + size] = drawn * light[..., None]
    else:
        picture[y0 : y0 + size, x0 : x0 + size] = ground + (weight[..., None] if weight.ndim else weight) * (drawn - ground)
    return centre + (x0, y0)


def store(picture, path, spec, random, quality):
    """Whole-picture light, noise of a sensor, and the file."""
    if "haze" in spec:
        picture = picture * (1 - spec["haze"]) + 215 * spec["haze"]
    if "cast" in spec:
        picture = picture * np.array(spec["cast"], np.float32)
    noisy = picture + random.normal(0, 1.2, picture.shape)
    stored = np.clip(np.round(noisy), 0, 255).astype(np.uint8)[:, :, ::-1]
    cv2.imwrite(path, np.ascontiguousarray(stored), [cv2.IMWRITE_JPEG_QUALITY, quality])


def detect(program, path, profile):
    run = subprocess.run([program, "detect", path, "--profile", profile, "--json", "--quiet", "--threads", "1"], capture_output=True, text=True)
    if run.returncode != 0:
        sys.exit(f"{program} detect {path} --profile {profile}: {run.stderr.strip()}")
    return json.loads(run.stdout)["candidates"]


class Tally:
    def __init__(self):
        self.planted = self.found = self.false = self.beyond = 0
        self.megapixels = 0.0
        self.errors, self.ratios = [], []
        self.beside = 0

    def add(self, truths, candidates, side, megapixels):
        self.planted += len(truths)
        self.megapixels += megapixels
        truths = np.array(truths).reshape(-1, 2)
        best = {}
        for c in candidates:
            at = np.array([c["centre"]["x"], c["centre"]["y"]])
            apart = np.hypot(*(truths - at).T)
            i = int(np.argmin(apart)) if len(apart) else -1
            if i < 0 or apart[i] > max(side, 4.0):
                self.false += 1
                continue
            error = at - truths[i]
            xx, xy, yy = c["covariance_px2"]
            ratio = math.sqrt(error @ np.linalg.solve([[xx, xy], [xy, yy]], error))
            self.beside += 1
            self.beyond += ratio > 5
            self.ratios.append((math.sqrt((xx + yy) / 2), ratio))
            if i not in best or apart[i] < best[i][0]:
                best[i] = (apart[i], error)
        for apart, error in best.values():
            if apart <= max(1.5, 0.25 * side):
                self.found += 1
                self.errors.append(error)

    def row(self, name):
        errors = np.array(self.errors).reshape(-1, 2)
        rms = math.sqrt((errors**2).mean()) if len(errors) else float("nan")
        p95 = np.percentile(np.hypot(*errors.T), 95) if len(errors) else float("nan")
        return (f"| {name} | {self.planted} | {self.found / max(1, self.planted):.3f} | {rms:.3f} | {p95:.3f} | "
                f"{self.beyond} of {self.beside} | {self.false / max(self.megapixels, 1e-9):.3f} |")


def detection(program, paths, spec, marks, folder, seed):
    random = np.random.default_rng(seed)
    tally, step = Tally(), max(90, int(5 * spec["side"]), 150 if "half" in spec or "shade" in spec else 0, int(7 * spec["side"]) + 20 if "patch" in spec else 0)
    number, windows = 0, max(8, 2 * math.ceil(marks * step * step / CROP**2))
    for picture in crops(paths, random, windows):
        picture = picture.copy()
        h, w = picture.shape[:2]
        margin = step // 2 + 8
        places = [(x, y) for y in range(margin, h - margin, step) for x in range(margin, w - margin, step)]
        random.shuffle(places)
        truths = []
        for at in places[: math.ceil(marks / windows)]:
            truth = plant(picture, at, spec, random, disc=number % 2 == 1)
            number += 1
            if truth is not None:
                truths.append(truth)
        path = os.path.join(folder, "planted.jpg")
        store(picture, path, spec, random, quality=int(random.integers(85, 97)))
        tally.add(truths, detect(program, path, spec["profile"]), spec["side"], h * w / 1e6)
    return tally


def bare(program, paths, profile, folder):
    """False candidates on the photographs as they are."""
    number = megapixels = 0
    for path in paths:
        picture = photograph(path)
        if picture is None:
            continue
        file = os.path.join(folder, "bare.png")
        cv2.imwrite(file, np.ascontiguousarray(picture[:, :, ::-1]))
        found = detect(program, file, profile)
        number += len(found)
        megapixels += picture.shape[0] * picture.shape[1] / 1e6
        print(f"<!-- {os.path.basename(path)}: {len(found)} -->", file=sys.stderr)
    return number, megapixels


def whole_jobs(program, paths, spec, jobs, folder, seed, more):
    """20 points in the picture, 4 outside, and what became of them; `default` names no profile."""
    random = np.random.default_rng(seed)
    solved = matched = wrong = off = again = 0
    seconds = 0.0
    for number, picture in enumerate(crops(paths, random, jobs, side=1100)):
        picture = picture.copy()
        h, w = picture.shape[:2]
        truths, tries = [], 0
        while len(truths) < 20 and tries < 4000:
            tries += 1
            edge = max(70, int(4 * spec["side"]))
            at = random.uniform([edge, edge], [w - edge, h - edge])
            if all(np.hypot(*(at - t)) > 1.6 * edge if ("half" in spec or "shade" in spec) else np.hypot(*(at - t)) > 50 for t in truths):
                truth = plant(picture, at, spec, random, disc=number % 2 == 1)
                if truth is not None:
                    truths.append(truth)
        path = os.path.join(folder, "job.jpg")
        store(picture, path, spec, random, quality=90)
        gsd, turn = 0.05, random.uniform(0, 2 * math.pi)
        cos, sin = math.cos(turn), math.sin(turn)
        ground = lambda p: (600000 + gsd * (cos * p[0] + sin * p[1]), 6700000 + gsd * (sin * p[0] - cos * p[1]))
        points = [ground(t) for t in truths] + [ground(random.uniform([w + 50, 0], [2 * w, h])) for _ in range(4)]
        listed = os.path.join(folder, "job.csv")
        with open(listed, "w") as out:
            out.write("name,easting,northing\n")
            for k in random.permutation(len(points)):
                e, n = points[k] + random.normal(0, 0.002, 2)
                out.write(f"P{k},{e:.4f},{n:.4f}\n")
        run = subprocess.run([program, path, "--gcps", listed, "--crs", "EPSG:32632", "--gsd", str(gsd), "--json", "--quiet", "--overwrite",
                              "--no-report", "--threads", "1", *more], capture_output=True, text=True)
        if run.returncode not in (0, 1):
            sys.exit(run.stderr)
        result = json.loads(run.stdout)
        seconds += result["elapsed_s"]
        again += result.get("second_pass") is not None
        if result["status"] != "solved":
            print(f"<!-- {spec['name']} {number}: {result.get('reason')} -->", file=sys.stderr)
            continue
        solved += 1
        gt = result["geotransform"]
        gt = gt if isinstance(gt, list) else gt["coefficients"] if "coefficients" in gt else list(gt.values())
        corners = [(0, 0), (w, 0), (0, h), (w, h)]
        shift = max(math.dist((gt[0] + gt[1] * x + gt[2] * y, gt[3] + gt[4] * x + gt[5] * y), ground((x, y))) for x, y in corners) / gsd
        wrong += shift > 3
        for row in result["matches"] + result["check_points"]:
            matched += 1
            truth = truths[int(row["gcp"][1:])] if int(row["gcp"][1:]) < len(truths) else (1e9, 1e9)
            error = np.array([row["x"], row["y"]]) - truth
            xx, xy, yy = row["covariance_px2"]
            ratio = math.sqrt(error @ np.linalg.solve([[xx, xy], [xy, yy]], error))
            off += np.hypot(*error) > 1 and ratio > 5 and not row.get("outlier")
    return f"| {spec['name']} | {jobs} | {solved} | {matched} of {20 * jobs} | {wrong} | {off} | {again} | {seconds / max(1, jobs):.2f} |"


def nothing_there(program, paths, count, folder, seed, more):
    """Lists of 20 points that have nothing to do with the picture: bare photographs, and photographs with 20 marks of a random hue."""
    random = np.random.default_rng(seed)
    outcomes = {}
    for number, picture in enumerate(crops(paths, random, 2 * count, side=1100)):
        kind = ("bare", "other marks")[number // count]
        picture = picture.copy()
        h, w = picture.shape[:2]
        if kind == "other marks":
            spec = cell("", of_hue(random.uniform(0, 360), random.uniform(0.6, 1), random.uniform(0.7, 1)), side=random.uniform(8, 20))
            for _ in range(20):
                plant(picture, random.uniform([80, 80], [w - 80, h - 80]), spec, random, disc=number % 2 == 1)
        path = os.path.join(folder, "nothing.png")
        cv2.imwrite(path, np.clip(np.round(picture), 0, 255).astype(np.uint8)[:, :, ::-1])
        listed = os.path.join(folder, "nothing.csv")
        with open(listed, "w") as out:
            out.write("name,easting,northing\n")
            for k in range(20):
                e, n = random.uniform([600000, 6700000], [600000 + 0.06 * w, 6700000 + 0.06 * h])
                out.write(f"P{k},{e:.3f},{n:.3f}\n")
        known = ["--gsd", "0.05"] if number % 3 else []
        run = subprocess.run([program, path, "--gcps", listed, "--crs", "EPSG:32632", "--json", "--quiet", "--overwrite", "--no-report",
                              "--threads", "1", *known, *more], capture_output=True, text=True)
        if run.returncode not in (0, 1):
            sys.exit(run.stderr)
        result = json.loads(run.stdout)
        tally = outcomes.setdefault(kind, [0, 0, 0.0, 0.0])
        tally[0] += 1
        tally[1] += result["status"] == "solved"
        tally[2] += result["elapsed_s"]
        tally[3] = max(tally[3], result["elapsed_s"])
        if result["status"] == "solved":
            print(f"<!-- accepted: {kind} {number}, 10^{result['log10_false_alarms']:.1f} -->", flush=True)
    for kind, (runs, accepted, seconds, longest) in outcomes.items():
        print(f"{kind}: {accepted} of {runs} accepted; {seconds / runs:.2f} s a run, at most {longest:.1f} s", flush=True)


def reliability(ratios):
    lines = ["", "| stated deviation px | candidates | share within 1 | within 2 | within 3 | beyond 5 |", "|---|---|---|---|---|---|"]
    ratios = np.array(ratios).reshape(-1, 2)
    for low, high in ((0, 0.02), (0.02, 0.05), (0.05, 0.1), (0.1, 0.2), (0.2, 0.5), (0.5, 1), (1, 99)):
        r = ratios[(ratios[:, 0] >= low) & (ratios[:, 0] < high), 1]
        if len(r):
            lines.append(f"| {low} to {high} | {len(r)} | " + " | ".join(f"{(r < k).mean():.3f}" for k in (1, 2, 3)) + f" | {(r > 5).mean():.4f} |")
    return "\n".join(lines + ["", "An honest pair of coordinates lies within 1, 2, 3 of its deviations in 0.393, 0.865, 0.989 of all cases."])


def main():
    ask = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    ask.add_argument("program")
    ask.add_argument("photographs", nargs="+")
    ask.add_argument("--half", choices=["tune", "held-out", "all"], default="tune")
    ask.add_argument("--cells", default=".")
    ask.add_argument("--circle", action="store_true", help="hues over the whole circle instead of the cells of the table")
    ask.add_argument("--advice", action="store_true", help="paints on grounds, with a dark rim and without, instead")
    ask.add_argument("--marks", type=int, default=300)
    ask.add_argument("--jobs", type=int, default=0, help="whole jobs a cell, without a profile named")
    ask.add_argument("--nothing", type=int, default=0, help="so many bare photographs and as many with other marks, with lists of elsewhere")
    ask.add_argument("--seed", type=int, default=22)
    ask.add_argument("--profile", help="this one instead of the cell's")
    ask.add_argument("--bare", default="", help="profiles to count false candidates of, on the bare photographs")
    ask.add_argument("more", nargs="*", default=[])
    args, more = ask.parse_known_args()
    paths = [p for p in sorted(args.photographs) if args.half == "all" or is_held_out(p) == (args.half == "held-out")]
    print(f"{args.half}: {', '.join(os.path.basename(p) for p in paths)}\n", flush=True)
    chosen = [c for c in (advice() if args.advice else circle() if args.circle else cells()) if re.search(args.cells, c["name"])]
    ratios = []
    with tempfile.TemporaryDirectory() as folder:
        if args.marks:
            print("| cell | marks | recall | RMSE px | 95 % px | beyond 5 deviations | false per Mpx |\n|---|---|---|---|---|---|---|")
            for k, spec in enumerate(chosen):
                if args.profile:
                    spec = dict(spec, profile=args.profile)
                tally = detection(args.program, paths, spec, args.marks, folder, args.seed + k)
                ratios += tally.ratios
                print(tally.row(spec["name"]), flush=True)
            print(reliability(ratios))
        for profile in filter(None, args.bare.split(",")):
            number, megapixels = bare(args.program, paths, profile, folder)
            print(f"bare photographs, {profile}: {number} false candidates in {megapixels:.1f} Mpx = {number / megapixels:.3f} per Mpx", flush=True)
        if args.nothing:
            nothing_there(args.program, paths, args.nothing, folder, args.seed, more)
        if args.jobs:
            print("\n| whole jobs | jobs | solved | matched | wrong georeferences | more than 1 px and 5 deviations off, not flagged | looked again | s a job |\n|---|---|---|---|---|---|---|---|")
            for k, spec in enumerate(c for c in chosen if args.circle or c.get("sweep") or c["profile"] == "orange"):
                print(whole_jobs(args.program, paths, spec, args.jobs, folder, args.seed + k, more), flush=True)


if __name__ == "__main__":
    main()
