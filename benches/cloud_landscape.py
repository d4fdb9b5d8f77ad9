"""Draws a cloud for benchmarks: hills with holes, flying and low points, and a dense cluster, one point a square metre.

    python3 cloud_landscape.py OUT.ply POINTS [SEED]

Binary PLY of doubles in UTM-like coordinates, written in pieces; NumPy alone.
"""

import sys

import numpy as np

PIECE = 1_000_000


def ground(x, y):
    return 200 + 60 * np.sin(x / 700) + 45 * np.cos(y / 900) + 4 * np.sin(x / 37) * np.cos(y / 41)


def piece(random, count, side):
    x, y = random.random(count) * side, random.random(count) * side
    # Lakes: a lattice of discs without points; what would fall there comes to lie in the cluster.
    hole = np.hypot((x % 1500) - 750, (y % 1500) - 750) < 130
    cluster = hole & (random.random(count) < 0.5)
    x[cluster] = side / 2 + 400 + 40 * random.random(cluster.sum())
    y[cluster] = side / 2 + 400 + 40 * random.random(cluster.sum())
    inside = hole & ~cluster
    x[inside] = (np.floor(x[inside] / 1500)) * 1500 + 10 + 300 * random.random(inside.sum())
    z = ground(x, y) + 0.04 * random.standard_normal(count)
    house = ((x % 90) < 12) & ((y % 70) < 9)
    z[house] += 6
    kind = random.random(count)
    flying = kind < 0.005
    z[flying] += random.uniform(5, 150, flying.sum())
    low = kind > 0.999
    z[low] -= random.uniform(2, 60, low.sum())
    return np.stack([600_000 + x, 8_600_000 + y, z], axis=1)


def main():
    path, count = sys.argv[1], int(float(sys.argv[2]))
    random = np.random.default_rng(int(sys.argv[3]) if len(sys.argv) > 3 else 1)
    side = count**0.5
    with open(path, "wb") as out:
        out.write(
            b"ply\nformat binary_little_endian 1.0\nelement vertex %d\n"
            b"property double x\nproperty double y\nproperty double z\nend_header\n" % count
        )
        for begin in range(0, count, PIECE):
            out.write(piece(random, min(PIECE, count - begin), side).astype("<f8").tobytes())


if __name__ == "__main__":
    main()
