#!/usr/bin/env python3
"""Black and white targets in light that does not fall evenly, on cloth that is not flat, tilted or half covered.

    python3 benches/targets.py PROGRAM PHOTOGRAPHS… [--kinds checker,cross,hourglass] [--conditions even,fall,…] [--targets N] [--seed N]

draws targets of 14 to 120 px into windows of photographs and runs `PROGRAM detect` on them. Prints a Markdown table: how many
are found, RMSE per axis, the median and the largest error, the share of those found that lie beyond five of their deviations, and
candidates where no target is. Needs numpy and opencv-python-headless. Nothing of the project is used to draw: targets are planes
seen by a pinhole camera at 8 to 12 samples a pixel on a side, mixed on stored values in one half of the windows and in linear
light in the other, blurred by a Gaussian, with noise, as JPEG of quality 90.
"""
import argparse
import json
import os
import subprocess
import tempfile

import cv2
import numpy as np

SIDE = 1000
CONDITIONS = ("even", "fall", "shadow", "crumple", "tilt", "covered")


def to_light(value):
    value = np.asarray(value, np.float64) / 255
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def to_stored(light):
    light = np.clip(light, 0, 1)
    return 255 * np.where(light <= 0.0031308, light * 12.92, 1.055 * light ** (1 / 2.4) - 0.055)


def bright(kind, u, v, spec):
    """Where the target is white, in its own plane, -0.5 to 0.5."""
    if kind == "checker":
        white = u * v > 0
    elif kind == "hourglass":
        white = np.abs(v) * spec["slope"] >= np.abs(u)
    else:
        white = (np.abs(u) <= spec["bar"] / 2) | (np.abs(v) <= spec["bar"] / 2)
    return white != spec["inverted"]


def drawn_spec(random, condition):
    spec = {
        "side": float(np.exp(random.uniform(np.log(14), np.log(120)))),
        "turn": random.uniform(0, 2 * np.pi),
        "tilt": np.radians(random.uniform(20, 40) if condition == "tilt" else random.uniform(0, 20)),
        "towards": random.uniform(0, 2 * np.pi),
        "distance": random.uniform(6, 20) if condition == "tilt" else random.uniform(12, 40),
        "blur": random.uniform(0.7, 2.0),
        "white": random.uniform(190, 245),
        "black": random.uniform(15, 60),
        "slope": random.uniform(0.65, 1.3),
        "bar": random.uniform(1 / 9, 1 / 5),
        "inverted": random.random() < 0.35,
        # Direction, place in sides and what is left of the light.
        "light": (random.uniform(0, 2 * np.pi), random.uniform(-0.3, 0.3), random.uniform(0.25, 0.6)),
        "fall": random.uniform(0.2, 0.7) if condition == "fall" else 0.0,
        "crumple": random.uniform(0.3, 2.5) if condition == "crumple" else 0.0,
        "cover": random.uniform(0.02, 0.35),
    }
    return spec


def plane_of(spec):
    """From pixels about the centre to the target's own plane."""
    def about_z(angle):
        return np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1.0]])

    tilt = spec["tilt"]
    about_x = np.array([[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]])
    turned = about_z(spec["towards"]) @ about_x @ about_z(-spec["towards"]) @ about_z(spec["turn"])
    side, distance = spec["side"], spec["distance"]
    image = np.array([
        [side * distance * turned[0, 0], side * distance * turned[0, 1], 0],
        [side * distance * turned[1, 0], side * distance * turned[1, 1], 0],
        [-turned[2, 0], -turned[2, 1], distance],
    ])
    return np.linalg.inv(image / distance)


def plant(picture, kind, condition, at, spec, linear, random):
    """Draws a target whose middle is at `at` (pixel corners lie at whole numbers)."""
    fine = 8 if spec["side"] > 60 else 12
    margin = int(np.ceil(spec["side"] * 0.9 + 4 * spec["blur"] + 3))
    left, top, size = int(at[0]) - margin, int(at[1]) - margin, 2 * margin + 1
    steps = (np.arange(size * fine) + 0.5) / fine
    x, y = (left + steps - at[0])[None, :], (top + steps - at[1])[:, None]
    back = plane_of(spec)
    depth = back[2, 0] * x + back[2, 1] * y + back[2, 2]
    u, v = ((back[k, 0] * x + back[k, 1] * y + back[k, 2]) / depth for k in (0, 1))
    if spec["crumple"]:
        middle = int((at[1] - top) * fine), int((at[0] - left) * fine)
        moved = []
        for _ in range(2):
            smooth = cv2.resize(random.normal(0, 1, (6, 6)), (size * fine,) * 2, interpolation=cv2.INTER_CUBIC)
            moved.append((smooth - smooth[middle]) * spec["crumple"] / spec["side"])
        u, v = u + moved[0], v + moved[1]
    cover = ((np.abs(u) <= 0.5) & (np.abs(v) <= 0.5)).astype(np.float32)
    white = bright(kind, u, v, spec).astype(np.float32)
    direction, place, left_of_light = spec["light"]
    along = x * np.cos(direction) + y * np.sin(direction)
    light = np.broadcast_to(1 + spec["fall"] * along / spec["side"], cover.shape).astype(np.float32)
    if condition == "covered":
        cover = cover * (along <= spec["cover"] * spec["side"])
    shade = ((along > place * spec["side"]) if condition == "shadow" else np.zeros(cover.shape, bool)).astype(np.float32)
    light = light * (1 - (1 - left_of_light) * shade)

    def seen(fine_values):
        quarter = cv2.resize(fine_values.astype(np.float32), (size * 4,) * 2, interpolation=cv2.INTER_AREA)
        blurred = cv2.GaussianBlur(quarter, (0, 0), spec["blur"] * 4, borderType=cv2.BORDER_REPLICATE)
        return cv2.resize(blurred, (size,) * 2, interpolation=cv2.INTER_AREA)[..., None]

    amount = to_light if linear else lambda value: np.asarray(value) / 255
    ground = 1 - (1 - left_of_light) * seen(shade)
    patch = picture[top : top + size, left : left + size]
    patch[:] = (
        patch * ground * (1 - seen(cover))
        + seen(cover * white * light) * amount(spec["white"])
        + seen(cover * (1 - white) * light) * amount(spec["black"])
    )


def scene(photograph, kind, condition, count, random):
    h, w = photograph.shape[:2]
    side_y, side_x = min(h, SIDE), min(w, SIDE)
    top, left = random.integers(0, h - side_y + 1), random.integers(0, w - side_x + 1)
    stored = photograph[top : top + side_y, left : left + side_x].astype(np.float64)
    linear = random.random() < 0.5
    picture = to_light(stored) if linear else stored / 255
    truth = []
    for _ in range(40 * count):
        spec = drawn_spec(random, condition)
        room = spec["side"] + 14
        if len(truth) == count or min(side_x, side_y) < 2 * room + 2:
            continue
        at = random.uniform([room, room], [side_x - room, side_y - room])
        if all(np.hypot(*(at - other)) > 0.95 * (spec["side"] + size) + 10 for other, size in truth):
            plant(picture, kind, condition, at, spec, linear, random)
            truth.append((at, spec["side"]))
    picture = to_stored(picture) if linear else 255 * picture
    noisy = picture + random.normal(0, random.uniform(0.8, 3), picture.shape)
    return np.clip(np.round(noisy), 0, 255).astype(np.uint8), truth


def judged(truth, candidates):
    """Of each target found the error and the error in its deviations; candidates where no target is."""
    found, near = [], set()
    centres = np.array([[c["centre"]["x"], c["centre"]["y"]] for c in candidates]).reshape(-1, 2)
    for at, side in truth:
        off = np.hypot(*(centres - at).T) if len(centres) else np.array([np.inf])
        near.update(np.nonzero(off < 0.75 * side + 2)[0].tolist())
        if off.min() > 0.5 * side + 1:
            continue
        candidate = candidates[int(off.argmin())]
        xx, xy, yy = (lambda c: (c["xx"], c["xy"], c["yy"]) if isinstance(c, dict) else c)(candidate["covariance_px2"])
        error = centres[int(off.argmin())] - at
        found.append((off.min(), np.sqrt(error @ np.linalg.solve([[xx, xy], [xy, yy]], error))))
    return found, len(candidates) - len(near & set(range(len(candidates))))


def main():
    ask = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    ask.add_argument("program")
    ask.add_argument("photographs", nargs="+")
    ask.add_argument("--kinds", default="checker,cross,hourglass")
    ask.add_argument("--conditions", default=",".join(CONDITIONS))
    ask.add_argument("--targets", type=int, default=14, help="in each photograph")
    ask.add_argument("--seed", type=int, default=1)
    args = ask.parse_args()
    pictures = [p for p in (cv2.imread(path, cv2.IMREAD_COLOR) for path in sorted(args.photographs)) if p is not None]
    print("| target | light and cloth | drawn | found | RMSE px | median px | largest px | beyond 5 deviations | false |")
    print("|---|---|---|---|---|---|---|---|---|", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        path = os.path.join(folder, "targets.jpg")
        for kind in args.kinds.split(","):
            for condition in args.conditions.split(","):
                random = np.random.default_rng([args.seed, CONDITIONS.index(condition)])
                drawn, found, false = 0, [], 0
                for picture in pictures:
                    image, truth = scene(picture, kind, condition, args.targets, random)
                    cv2.imwrite(path, image, [cv2.IMWRITE_JPEG_QUALITY, 90])
                    run = [args.program, "detect", path, "--profile", f"black-white-{kind}", "--json", "--quiet", "--threads", "1"]
                    seen = json.loads(subprocess.run(run, capture_output=True, text=True, check=True).stdout)
                    here, elsewhere = judged(truth, seen["candidates"])
                    drawn, found, false = drawn + len(truth), found + here, false + elsewhere
                off, deviations = np.array(found).reshape(-1, 2).T
                rmse, median, largest = (np.sqrt((off**2).mean() / 2), np.median(off), off.max()) if len(off) else (0, 0, 0)
                print(
                    f"| {kind} | {condition} | {drawn} | {len(off)} | {rmse:.3f} | {median:.3f} | {largest:.2f} "
                    f"| {(deviations > 5).sum()} of {len(off)} | {false} |",
                    flush=True,
                )


if __name__ == "__main__":
    main()
