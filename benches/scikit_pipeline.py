#!/usr/bin/env python3
"""What a Python user would write to find orange marks: HSV threshold, opening, closing, connected regions, centroids.

    python3 benches/scikit_pipeline.py PICTURE.png [PICTURE.png …]

prints one line a mark: picture, x, y (pixels, outer corner of the first pixel is 0, 0). Needs numpy and scikit-image
(`pip install scikit-image`). Thresholds are those of the usual tutorials for orange, sizes the same 5 to 60 px as ours; the
centroid is weighted with the saturation, as `regionprops` offers it.
"""
import sys

import numpy as np
from skimage import color, io, measure, morphology

SIDE_PX = (5, 60)


def marks(rgb):
    hsv = color.rgb2hsv(rgb)
    hue, saturation, value = hsv[..., 0], hsv[..., 1], hsv[..., 2]
    mask = (hue >= 5 / 360) & (hue <= 40 / 360) & (saturation >= 0.5) & (value >= 0.35)
    mask = morphology.opening(mask, morphology.disk(1))
    mask = morphology.closing(mask, morphology.disk(1))
    for region in measure.regionprops(measure.label(mask), intensity_image=saturation):
        if not SIDE_PX[0] ** 2 / 2 <= region.area <= SIDE_PX[1] ** 2 * 1.5:
            continue
        if region.solidity < 0.8 or region.eccentricity > 0.85:
            continue
        y, x = region.centroid_weighted
        yield x + 0.5, y + 0.5


if __name__ == "__main__":
    for name in sys.argv[1:]:
        for x, y in marks(np.asarray(io.imread(name))[..., :3]):
            print(f"{name}\t{x:.4f}\t{y:.4f}")
