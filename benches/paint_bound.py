#!/usr/bin/env python3
"""How well can the centres of the marks of `paint.py` be known at all? Bounds and an oracle for its cells.

    python3 benches/paint_bound.py PHOTOGRAPHS… [--half tune|held-out|all] [--cells REGEX] [--marks N]

Marks are drawn by `paint.py` itself; bound and oracle are those of `centre_bound.py`: all is known but the centre (outline, side,
angle, blur, paint, light, wear, the mean and the autocovariance of the bare ground at the very place, the noise, the tables and
the grid of the JPEG). Only marks that fit into 32 pixels and whose paint is whole. Needs numpy, scipy, Pillow and opencv-python-headless.
"""
import argparse
import io
import math
import re

import cv2
import numpy as np
from PIL import Image
from scipy.linalg import cho_factor, cho_solve

import centre_bound as bound
import paint

NOISE = 1.2


def draws(spec):
    return spec["side"] <= 14 and not {"gone", "patch", "haze", "cast"} & spec.keys()


def look(ground, spec, centre, angle, disc, colour, shadow):
    """The mark on this ground as `paint.plant` draws it, and how much of the ground is still seen through it."""
    size = ground.shape[0]
    own, blur = 1 - spec.get("worn", 0.0), spec["blur"]
    cover = own * paint.coverage(centre, spec["side"], angle, disc, size)
    if shadow is None:
        share = cv2.GaussianBlur(cover, (0, 0), blur)[..., None]
        light = spec.get("shade", 1.0)
        return (ground + share * (colour - ground)) * light, (1 - share[..., 0]) * light
    turn, off, dark = shadow
    v, u = np.mgrid[0:size, 0:size] + 0.5
    # The border of a shadow stays where it is on the ground.
    beyond = (u - size / 2) * math.cos(turn) + (v - size / 2) * math.sin(turn) - off
    light = (1 - (1 - dark) * np.clip(beyond + 0.5, 0, 1)).astype(np.float32)
    drawn = cv2.GaussianBlur((ground + cover[..., None] * (colour - ground)) * light[..., None], (0, 0), blur)
    return drawn, cv2.GaussianBlur((1 - cover) * light, (0, 0), blur)


def one(spec, picture, quality, disc, random):
    side = bound.SIDE
    for _ in range(1000):
        x, y = (int(random.integers(0, s - 64)) for s in (picture.shape[1], picture.shape[0]))
        around = picture[y:y + 64, x:x + 64].astype(np.float32)
        if (around == 0).all(axis=2).mean() < 0.02:
            break
    centre = np.array([side / 2 + random.uniform(-4, 4), side / 2 + random.uniform(-4, 4)])
    angle, colour = random.uniform(0, math.pi / 2), np.array(spec["paints"][random.integers(len(spec["paints"]))], np.float32)
    shadow = (random.uniform(0, 2 * math.pi), random.uniform(-0.2, 0.2) * spec["side"], spec["half"]) if "half" in spec else None
    if shadow is not None:
        around = cv2.GaussianBlur(around, (0, 0), spec["blur"])
    ground = around[16:48, 16:48]
    seen, open_ = look(ground, spec, centre, angle, disc, colour, shadow)
    seen = np.clip(np.round(seen + random.normal(0, NOISE, seen.shape)), 0, 255)
    q = steps_of(quality)
    coefficients = lambda rgb: bound.coefficients(rgb.transpose(2, 0, 1)[..., None].astype(float))[:, 0]
    z = np.round(coefficients(seen) / q) * q
    covariance, mean = bound.texture(around.astype(float))
    flat_ground = np.broadcast_to(mean.astype(np.float32), ground.shape)
    expected = lambda at: np.clip(look(flat_ground, spec, at, angle, disc, colour, shadow)[0], 0, 255)
    h = 0.125  # outlines are drawn on sixteenths of a pixel
    jacobian = np.stack([coefficients((expected(centre + d) - expected(centre - d)) / (2 * h)) for d in (np.array([h, 0]), np.array([0, h]))], axis=1)
    covariance = covariance * open_[None, :, :, None, None, None] * open_[None, None, None, None, :, :]
    pixels = 3 * side * side
    flat = covariance.reshape(pixels, pixels)
    flat[np.arange(pixels), np.arange(pixels)] += NOISE**2 + 1 / 12
    half = bound.coefficients(flat.reshape(3, side, side, pixels))
    c = bound.coefficients(half.T.reshape(3, side, side, -1))
    c = (c + c.T) / 2
    c[np.diag_indices_from(c)] += q * q / 12
    weighted = cho_solve(cho_factor(c, check_finite=False), jacobian, check_finite=False)
    least = np.linalg.inv(jacobian.T @ weighted)
    return least, least @ (weighted.T @ (z - coefficients(expected(centre))))


def steps_of(quality):
    """Steps of the coefficients in the files of OpenCV's encoder."""
    _, coded = cv2.imencode(".jpg", np.zeros((16, 16, 3), np.uint8), [cv2.IMWRITE_JPEG_QUALITY, quality])
    tables = Image.open(io.BytesIO(coded.tobytes())).quantization
    out = []
    for table, n in ((tables[0], bound.SIDE), (tables[1], bound.SIDE // 2), (tables[1], bound.SIDE // 2)):
        out.append(np.tile(np.array(table, float).reshape(1, 8, 1, 8), (n // 8, 1, n // 8, 1)).ravel())
    return np.concatenate(out)


def main():
    ask = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    ask.add_argument("photographs", nargs="+")
    ask.add_argument("--half", choices=["tune", "held-out", "all"], default="tune")
    ask.add_argument("--cells", default=".")
    ask.add_argument("--marks", type=int, default=96)
    args = ask.parse_args()
    paths = [p for p in sorted(args.photographs) if args.half == "all" or paint.is_held_out(p) == (args.half == "held-out")]
    pictures = [p for p in (paint.photograph(path) for path in paths) if p is not None and min(p.shape[:2]) >= 350]
    print("| cell | marks | bound: RMSE px | oracle: RMSE px | median of the oracle's errors px |\n|---|---|---|---|---|")
    for spec in paint.cells():
        if not (re.search(args.cells, spec["name"]) and draws(spec)):
            continue
        random = np.random.default_rng(27)
        results = [one(spec, pictures[k % len(pictures)], int(random.integers(85, 97)), k % 2 == 1, random) for k in range(args.marks)]
        variances = np.array([np.diag(least) for least, _ in results]).ravel()
        errors = np.array([error for _, error in results]).ravel()
        print(f"| {spec['name']} | {args.marks} | {math.sqrt(variances.mean()):.3f} | {math.sqrt((errors**2).mean()):.3f} | "
              f"{np.median(np.abs(errors)):.3f} |", flush=True)


if __name__ == "__main__":
    main()
