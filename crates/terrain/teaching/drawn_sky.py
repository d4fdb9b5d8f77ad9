#!/usr/bin/env python3
"""Photographs of ground with a sky drawn above them: overcast and thin cloud, which few free photographs show.

    python3 drawn_sky.py FOLDER      # writes drawn_sky_N.jpg into FOLDER and drawn_sky_N.geojson beside this file

FOLDER holds the photographs by their names. A sky is an even brightness that changes downwards, clouds of noise whose
power falls with the frequency, and the camera's noise; every second one has wisps on an even ground. The skyline is
noise too. Below every third one lies haze, for a quarter of the height. Values are chosen; needs NumPy and OpenCV.
"""
import json, os, sys
import cv2, numpy as np

# Number, photograph, clouds' deviation (grey levels), the camera's noise before the photograph is reduced.
FRAMES = [
    (0, "img_4248.jpg", 2, 0.7),
    (1, "IMG_0481.jpg", 4, 1.0),
    (2, "IMG_0502.jpg", 8, 1.5),
    (3, "IMG_0544.jpg", 14, 2.0),
    (4, "img_4858.jpg", 22, 2.5),
    (5, "D800_20160308_222216-1.jpg", 3, 1.2),
    (8, "img_4132.jpg", 28, 1.8),
    (9, "IMG_0486.jpg", 5, 1.3),
]


def clouds(height, width, falls, random):
    """Noise whose power falls with this power of the frequency; mean 0, deviation 1."""
    across, down = np.fft.rfftfreq(width)[None], np.fft.fftfreq(height)[:, None] * height / width
    frequency = np.hypot(down, across)
    frequency[0, 0] = 1
    waves = random.normal(size=frequency.shape) + 1j * random.normal(size=frequency.shape)
    noise = np.fft.irfft2(waves / frequency ** (falls / 2), s=(height, width))
    return (noise - noise.mean()) / noise.std()


def draw(ground, number, deviation, grain):
    """The photograph with its sky, its skyline by column, and the quality that it is written with."""
    random = np.random.default_rng(number)
    height, width = ground.shape
    falls, level = random.uniform(2.4, 3.4), random.uniform(150, 235)
    share = np.linspace(0, 1, height)[:, None]
    shapes = clouds(height, width, falls, random)
    slopes = [random.uniform(-25, 25) for _ in range(1 + number % 2)]
    if number % 2:
        shapes = np.maximum(shapes, -0.3)
    sky = level + slopes[-1] * (share - 0.3) + deviation * shapes
    noise = cv2.GaussianBlur(random.normal(size=(height, width)).astype(np.float32), (0, 0), 0.7)
    sky = np.clip(sky, 20, 252) + 1.8 * grain * noise
    at, rough = random.uniform(0.3, 0.6), random.uniform(0.005, 0.04)
    line = ((at + rough * clouds(2, width, 2.2, random)[0]) * height).astype(int)
    row = np.arange(height)[:, None]
    part = np.clip((line[None] - row) / 2 + 0.5, 0, 1)
    image = part * sky + (1 - part) * ground
    if number % 3 == 0:
        clear = np.clip((row - line[None]) / (0.25 * height), 0, 1)
        image = np.where(row > line[None], image * (0.55 + 0.45 * clear) + level * (0.45 - 0.45 * clear), image)
    return np.clip(image, 0, 255).astype(np.uint8), line, int(random.integers(85, 96))


def polygons(name, line, height):
    """Sky and ground, with a gap of 1.2 % of the height on both sides of the skyline."""
    width, gap = len(line), int(0.012 * height)
    columns = list(range(0, width, max(1, width // 60))) + [width - 1]
    sky = [[0, 0], [width, 0]] + [[x, max(int(line[x]) - gap, 1)] for x in reversed(columns)]
    ground = [[x, min(int(line[x]) + gap, height - 1)] for x in columns] + [[width, height], [0, height]]
    lines = []
    for kind, what, ring in (("mask", "drawn sky", sky), ("keep", "ground", ground)):
        geometry = {"type": "Polygon", "coordinates": [ring + ring[:1]]}
        feature = {"type": "Feature", "properties": {"class": kind, "what": what}, "geometry": geometry}
        lines.append(json.dumps(feature, separators=(",", ":")))
    pixels = "pixels, x right, y down, (0,0) the outer corner of the first pixel; later polygons win"
    head = f'{{"type":"FeatureCollection","frame":"{name}.jpg","coordinates":"{pixels}","features":[\n'
    return head + ",\n".join(lines) + "\n]}\n"


def main():
    folder = sys.argv[1]
    for number, photograph, deviation, grain in FRAMES:
        ground = cv2.imread(os.path.join(folder, photograph), cv2.IMREAD_GRAYSCALE).astype(np.float32)
        image, line, quality = draw(ground, number, deviation, grain)
        name = f"drawn_sky_{number}"
        cv2.imwrite(os.path.join(folder, name + ".jpg"), image, [cv2.IMWRITE_JPEG_QUALITY, quality])
        with open(os.path.join(os.path.dirname(os.path.abspath(__file__)), name + ".geojson"), "w") as file:
            file.write(polygons(name, line, len(ground)))


if __name__ == "__main__":
    main()
