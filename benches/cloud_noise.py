"""Recall and share flagged of `cloud clean --isolated` and `--outliers` on clouds with drawn noise.

    python3 cloud_noise.py PROGRAM CLOUD... [--m 0.3,0.35,...]

Three quarters of a percent of noise is drawn into every cloud, a third each: points below the lowest of their nearest
eight in plan, by 0.5 to 20 times the median spacing; clusters of two to four points as low; and clusters of one to four
points 5 to 40 spacings above. Needs numpy, scipy and laspy.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import laspy
import numpy as np
from scipy.spatial import cKDTree


def load(path):
    if path.endswith(".txt"):
        return np.loadtxt(path)[:, :3]
    return np.asarray(laspy.read(path).xyz)


def with_noise(xyz, random):
    tree = cKDTree(xyz[:, :2])
    spacing = np.median(tree.query(xyz[:, :2], 2)[0][:, 1])
    wanted = max(len(xyz) // 400, 4)
    at = xyz[random.integers(0, len(xyz), wanted), :2] + spacing * random.standard_normal((wanted, 2))
    floor = xyz[tree.query(at, 8)[1], 2].min(axis=1)
    low = np.column_stack([at, floor - spacing * np.exp(random.uniform(np.log(0.5), np.log(20), wanted))])
    high = []
    while len(high) < wanted:
        centre = xyz[random.integers(0, len(xyz))] + [0, 0, spacing * random.uniform(5, 40)]
        count = random.integers(1, 5)
        high.extend(centre + 0.5 * spacing * random.standard_normal((count, 3)))
    several = []
    while len(several) < wanted:
        place = xyz[random.integers(0, len(xyz)), :2]
        beneath = xyz[tree.query(place, 8)[1], 2].min() - spacing * np.exp(random.uniform(np.log(0.5), np.log(20)))
        count = random.integers(2, 5)
        several.extend(np.append(place, beneath) + 0.5 * spacing * random.standard_normal((count, 3)) * [1, 1, 0.3])
    return low, np.array(several), np.array(high)


def flagged(program, folder, xyz, step):
    source, target = folder / "in.ply", folder / "out.las"
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(xyz)}\n"
    head += "".join(f"property double {axis}\n" for axis in "xyz") + "end_header\n"
    source.write_bytes(head.encode() + xyz.astype("<f8").tobytes())
    command = [program, "cloud", "clean", source, "-o", target, *step, "--overwrite", "--no-report", "--json"]
    json.loads(subprocess.run(command, check=True, capture_output=True).stdout)
    return np.asarray(laspy.read(target).classification) == 7


def main():
    arguments = sys.argv[1:]
    ms = ["0.35"]
    if "--m" in arguments:
        place = arguments.index("--m")
        ms = arguments[place + 1].split(",")
        del arguments[place : place + 2]
    program, clouds = arguments[0], arguments[1:]
    steps = [["--outliers"]] + [["--isolated", f"m={m}"] for m in ms]
    print("cloud,step,points,recall_low,recall_low_clusters,recall_high,flagged_others_percent")
    with tempfile.TemporaryDirectory() as name:
        for cloud in clouds:
            xyz = load(cloud)
            drawn = with_noise(xyz, np.random.default_rng(7))
            every = np.vstack([xyz, *drawn])
            ends = np.cumsum([len(xyz), *map(len, drawn)])
            for step in steps:
                found = flagged(program, Path(name), every, step)
                row = [found[begin:end].mean() for begin, end in zip(ends, ends[1:])] + [100 * found[: ends[0]].mean()]
                print(Path(cloud).name, " ".join(step), len(every), *(f"{v:.3f}" for v in row), sep=",", flush=True)


if __name__ == "__main__":
    main()
