#!/usr/bin/env python3
"""Reads every output back with rasterio, by the rules that rasterio follows, and compares it with the result.

    check_outputs.py FOLDER

FOLDER holds e6.tif with its .aux.xml, e6.vrt, e6.gcps.vrt, e6.warp.tif and e6.autoref.json, and copies of the image with
nothing but a world file (world/e6.tif) and nothing but tags (tags/e6.tif). The image is a slope: a pixel's value tells
where it was, 1000 + 40 x + 25 y. Exit code 1 and a line for each thing that is wrong.
"""

import json
import math
import sys
from pathlib import Path

import rasterio
from rasterio.transform import Affine

TOLERANCE_PX = 1e-6


def main(folder):
    result = json.loads((folder / "e6.autoref.json").read_text(encoding="utf-8"))
    expected = Affine.from_gdal(*result["geotransform"])
    wrong = []
    for name in ["e6.tif", "e6.vrt", "world/e6.tif", "tags/e6.tif"]:
        with rasterio.open(folder / name) as source:
            width, height = source.width, source.height
            for corner in [(0, 0), (width, 0), (0, height), (width / 2, height / 2)]:
                back = ~expected * (source.transform * corner)
                off = math.hypot(back[0] - corner[0], back[1] - corner[1])
                if not off <= TOLERANCE_PX:
                    wrong.append(f"{name}: {corner} is off by {off} px")
            if name != "world/e6.tif" and source.crs.to_epsg() != 25832:
                wrong.append(f"{name}: its CRS is {source.crs}")
    wrong += gcps(folder / "e6.gcps.vrt", result)
    wrong += warped(folder / "e6.warp.tif", expected, width, height)
    for line in wrong:
        print(line)
    print(f"rasterio {rasterio.__version__} with GDAL {rasterio.__gdal_version__}: {len(wrong)} things are wrong")
    return 1 if wrong else 0


def gcps(path, result):
    with rasterio.open(path) as source:
        points, crs = source.gcps
    read = [(p.id, p.col, p.row, p.x, p.y, p.z) for p in points]
    rows = [(m["gcp"], m["x"], m["y"], m["easting"], m["northing"], m["height"]) for m in result["matches"]]
    wrong = [] if read == rows else [f"{path.name}: {read} are not {rows}"]
    return wrong if crs.to_epsg() == 25832 else wrong + [f"{path.name}: its CRS is {crs}"]


def warped(path, expected, width, height):
    wrong = []
    with rasterio.open(path) as source:
        transform, values, mask = source.transform, source.read(1), source.dataset_mask()
        if transform.b or transform.d or source.crs.to_epsg() != 25832:
            wrong.append(f"{path.name}: {transform} in {source.crs} is not north-up")
    compared = 0
    for row in range(0, values.shape[0], 11):
        for column in range(0, values.shape[1], 11):
            x, y = ~expected * (transform * (column + 0.5, row + 0.5))
            if 2 < x < width - 2 and 2 < y < height - 2:
                compared += 1
                off = int(values[row, column]) - (1000 + 40 * x + 25 * y)
                if abs(off) > 1.01 or not mask[row, column]:
                    wrong.append(f"{path.name}: {values[row, column]} at {x}, {y} is off by {off}")
    if compared < 1000:
        wrong.append(f"{path.name}: only {compared} pixels to compare")
    try:
        from rio_cogeo.cogeo import cog_validate
    except ImportError:
        print("skipped: rio-cogeo is not installed")
        return wrong
    valid, errors, warnings = cog_validate(path)
    if not valid or errors or warnings:
        wrong.append(f"{path.name}: no valid COG: {errors} {warnings}")
    return wrong


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
