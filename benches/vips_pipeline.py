#!/usr/bin/env python3
"""The colour test alone, by libvips: which pixels are orange?

    python3 benches/vips_pipeline.py box|lab PICTURE.tif

`box` compares red, green and blue with limits; `lab` converts to L*a*b* and compares the distance from one orange. Both
print the number of pixels that pass; neither labels regions nor solves anything. Needs pyvips (`pip install
pyvips[binary]`).
"""
import sys

import pyvips

ORANGE_LAB = (67.0, 43.0, 74.0)
LIMIT = 40.0


def main(mode, name):
    image = pyvips.Image.new_from_file(name, access="sequential")[:3]
    if mode == "box":
        red, green, blue = image.bandsplit()
        orange = (red > 140) & (green > 40) & (green < 190) & (blue < 110)
    else:
        orange = image.colourspace("lab").dE76(pyvips.Image.black(image.width, image.height, bands=3)
                                               .linear([1] * 3, list(ORANGE_LAB)).copy(interpretation="lab")) < LIMIT
    print(round(orange.avg() / 255 * image.width * image.height))


if __name__ == "__main__":
    main(*sys.argv[1:3])
