#!/usr/bin/env python3
"""How well can a mark's centre be known at all? Cramér–Rao bounds and an oracle for conditions of the detection benchmark.

    python3 benches/centre_bound.py ../shared/data [marks per condition]

Needs numpy, scipy and Pillow. Marks are made as `crates/synth/src/plant.rs` makes them. The oracle knows everything but the centre:
shape, side, angle, blur, light, the paint's colour as it shines here, the mean of the ground, its texture (autocovariance of
the three bands over 64 x 64 pixels of bare ground at the very place), the noise, and the JPEG's tables and grid. It sees the
JPEG's own coefficients: luma in blocks of 8 x 8, chroma averaged over 2 x 2 pixels. A mark hides the texture by its share; what
is left is taken as Gaussian with covariance C, rounding in steps q as noise of variance q^2/12 (B. Widrow and I. Kollar,
"Quantization noise", 2008). Bound: (J' C^-1 J)^-1 (S. M. Kay, "Fundamentals of statistical signal processing: estimation theory", 1993,
section 3.9), J by differences. Oracle: the generalised least-squares step from the truth on the very coefficients of the file.
"""
import io
import sys
import zlib
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.linalg import cho_factor, cho_solve
from scipy.special import erf

Image.MAX_IMAGE_PIXELS = None
SIDE = 32  # pixels, two macroblocks
COVERS = ["photos/city_ochota_3013.jpg", "photos/city_ochota_3019.jpg", "photos/construction_caliterra.jpg",
          "photos/river_town_oam.tif", "photos/savanna_oam.tif", "photos/canal_pdok_tiled_jpeg.tif",
          "photos/forest_agung.jpg", "targets/IMG_0046.jpg"]
BASE = dict(side=10.0, blur=0.9, angle=None, fading=0.2, light=1.0, quality=90, paint=(255, 110, 20), noise=1.5)
CELLS = [("size 10 px", {}), ("size 6 px", dict(side=6.0)), ("rotation 0°", dict(angle=0.0)), ("blur 1.8 px", dict(blur=1.8)),
         ("JPEG 75", dict(quality=75)), ("JPEG 85", dict(quality=85)), ("JPEG 95", dict(quality=95)),
         ("shadow, light 0.35", dict(light=0.35)), ("paint [240, 130, 50]", dict(paint=(240, 130, 50)))]
TO_YCC = np.array([[0.299, 0.587, 0.114], [-0.168736, -0.331264, 0.5], [0.5, -0.418688, -0.081312]])
K = np.arange(8)
DCT = np.sqrt(2 / 8) * np.cos(np.pi * (2 * K[None, :] + 1) * K[:, None] / 16)
DCT[0] /= np.sqrt(2)


def shares(cell, cx, cy, angle):
    """Share of paint in each pixel: a blurred square at five times the resolution, averaged."""
    n = SIDE * 5
    at = (np.arange(n) + 0.5) / 5
    dx, dy = at[None, :] - cx, at[:, None] - cy
    u, v = np.cos(angle) * dx + np.sin(angle) * dy, np.cos(angle) * dy - np.sin(angle) * dx
    h, s = cell["side"] / 2, cell["blur"] * np.sqrt(2)
    fine = (erf((u + h) / s) - erf((u - h) / s)) * (erf((v + h) / s) - erf((v - h) / s)) / 4
    return fine.reshape(SIDE, 5, SIDE, 5).mean(axis=(1, 3))


def dim(colour, light):
    tint = np.array([1 - 0.1 * (1 - light), 1, 1 + 0.12 * (1 - light)])
    c = np.asarray(colour, float) / 255
    linear = np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4) * light * tint
    back = np.where(linear <= 0.0031308, linear * 12.92, 1.055 * np.maximum(linear, 1e-12) ** (1 / 2.4) - 0.055)
    return np.clip(np.round(back * 255), 0, 255)


def coefficients(rgb):
    """(3, SIDE, SIDE, columns) of RGB to JPEG's coefficients, one column each."""
    y, cb, cr = np.tensordot(TO_YCC, rgb, axes=1)
    out = []
    for plane, step in ((y, 1), (cb, 2), (cr, 2)):
        n, columns = SIDE // step, plane.shape[-1]
        plane = plane.reshape(n, step, n, step, columns).mean(axis=(1, 3)) if step > 1 else plane
        blocks = plane.reshape(n // 8, 8, n // 8, 8, columns)
        blocks = np.einsum("iy,ayblc->aiblc", DCT, blocks, optimize=True)
        out.append(np.einsum("jl,aiblc->aibjc", DCT, blocks, optimize=True).reshape(-1, columns))
    return np.concatenate(out)


def steps(quality):
    buffer = io.BytesIO()
    Image.new("RGB", (16, 16)).save(buffer, "JPEG", quality=quality)
    tables = Image.open(buffer).quantization
    out = []
    for table, n in ((tables[0], SIDE), (tables[1], SIDE // 2), (tables[1], SIDE // 2)):
        q = np.array(table, float).reshape(8, 8)
        out.append(np.tile(q.reshape(1, 8, 1, 8), (n // 8, 1, n // 8, 1)).ravel())
    return np.concatenate(out)


def texture(ground):
    """Covariance of the bare ground's pixels (3·SIDE², band by band) from its autocovariance, and its mean."""
    n = ground.shape[0]
    mean = ground.mean(axis=(0, 1))
    f = np.fft.rfft2(ground - mean, s=(2 * n, 2 * n), axes=(0, 1))
    lag = np.arange(SIDE)[:, None] - np.arange(SIDE)[None, :]
    out = np.empty((3, SIDE, SIDE, 3, SIDE, SIDE))
    for a in range(3):
        for b in range(3):
            auto = np.fft.irfft2(f[..., a] * np.conj(f[..., b]), s=(2 * n, 2 * n)) / n**2
            out[a, :, :, b] = auto[lag[:, None, :, None], lag[None, :, None, :]]
    return out, mean


def one(cell, photo, random):
    for _ in range(1000):
        x, y = (int(random.integers(0, s - 64)) for s in (photo.shape[1], photo.shape[0]))
        around = photo[y:y + 64, x:x + 64].astype(float)
        if (around == 0).all(axis=2).mean() < 0.02:
            break
    around = dim(around, cell["light"]) if cell["light"] < 1 else around
    ground = around[16:48, 16:48].transpose(2, 0, 1)
    cx, cy = 16 + random.uniform(-4, 4, 2)
    angle = random.uniform(0, 2 * np.pi) if cell["angle"] is None else cell["angle"]
    fading = random.uniform(0, cell["fading"])
    paint = dim(cell["paint"], cell["light"])[:, None, None]
    covariance, mean = texture(around)
    mean = mean[:, None, None]
    expected = lambda cx, cy: (lambda a: a * paint + (1 - a) * mean)(shares(cell, cx, cy, angle) * (1 - fading))
    covered = shares(cell, cx, cy, angle)
    a = covered * (1 - fading)
    seen = a * paint + (1 - a) * ground + cell["noise"] * covered * random.standard_normal((3, SIDE, SIDE))
    seen = np.clip(np.round(seen), 0, 255)
    q = steps(cell["quality"])
    z = np.round((coefficients(seen[..., None])[:, 0]) / q) * q
    mu = coefficients(expected(cx, cy)[..., None])[:, 0]
    h = 0.02
    jacobian = np.stack([coefficients(((expected(cx + dx, cy + dy) - expected(cx - dx, cy - dy)) / (2 * h))[..., None])[:, 0]
                         for dx, dy in ((h, 0), (0, h))], axis=1)
    open_ = 1 - a
    covariance = covariance * open_[None, :, :, None, None, None] * open_[None, None, None, None, :, :]
    pixels = 3 * SIDE * SIDE
    flat = covariance.reshape(pixels, pixels)
    own = np.broadcast_to((cell["noise"] * covered) ** 2 + 1 / 12, (3, SIDE, SIDE)).ravel()
    flat[np.arange(pixels), np.arange(pixels)] += own
    half = coefficients(flat.reshape(3, SIDE, SIDE, pixels))
    c = coefficients(half.T.reshape(3, SIDE, SIDE, -1))
    c = (c + c.T) / 2
    c[np.diag_indices_from(c)] += q * q / 12
    factor = cho_factor(c, check_finite=False)
    weighted = cho_solve(factor, jacobian, check_finite=False)
    bound = np.linalg.inv(jacobian.T @ weighted)
    return bound, bound @ (weighted.T @ (z - mu))


def main():
    data = Path(sys.argv[1])
    count = int(sys.argv[2]) if len(sys.argv) > 2 else 120
    only = sys.argv[3] if len(sys.argv) > 3 else ""
    photos = [np.asarray(Image.open(data / name).convert("RGB")) for name in COVERS if (data / name).exists()]
    print("| conditions | marks | bound: RMSE px | median px | oracle: RMSE px | median px |\n|---|---|---|---|---|---|")
    for label, change in CELLS:
        if only not in label:
            continue
        random = np.random.default_rng(zlib.crc32(label.encode()))
        results = [one({**BASE, **change}, photos[i % len(photos)], random) for i in range(count)]
        variances = np.array([np.diag(b) for b, _ in results]).ravel()
        errors = np.array([e for _, e in results]).ravel()
        drawn = np.abs(np.sqrt(variances)[:, None] * random.standard_normal((variances.size, 200)))
        print(f"| {label} | {count} | {np.sqrt(variances.mean()):.3f} | {np.median(drawn):.3f} | "
              f"{np.sqrt((errors**2).mean()):.3f} | {np.median(np.abs(errors)):.3f} |", flush=True)


if __name__ == "__main__":
    main()
