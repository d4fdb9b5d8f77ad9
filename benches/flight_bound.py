#!/usr/bin/env python3
"""What the errors of a draw of benches/flight_draws.py must be at least: the same draw adjusted by one who knows more.

    benches/flight_draws.py PROGRAM FLIGHT --keep DRAWS
    benches/flight_bound.py DRAWS FLIGHT [--spread 400]

For each draw in DRAWS its own GCPs, as they were drawn, and the tracks of its ties (out/relative) are adjusted from the truth by
Gauss and Newton: cameras, focal length, radial term, all points. Lines of a draw:

program   what the program gave
own ties  its ties, weighed with Huber's loss, from the truth
iid ties  the same tracks with image points of the truth and independent errors of --tie-px
true ties the same without errors, and as good as free of doubt: what the GCPs' errors alone leave
f known   the same with the true focal length and radial term

Then what the GCPs' and ties' noise allows: errors of --spread drawings of both noises for the geometry of each draw (N^-1 at the
truth, ties of --tie-px), how often all goals hold, and the median over draws. Wants numpy and scipy.
"""

import argparse
import json
import pathlib

import numpy as np
import scipy.sparse as sparse

words = argparse.ArgumentParser()
words.add_argument("draws", type=pathlib.Path)
words.add_argument("flight", type=pathlib.Path)
words.add_argument("--ground", type=float, default=25.0)
words.add_argument("--image", type=float, default=0.7)
words.add_argument("--tie-px", type=float, default=0.72)
words.add_argument("--spread", type=int, default=400)
args = words.parse_args()

truth = json.loads((args.flight / "truth.json").read_text())
LENS = np.array([truth["f_px"], truth["k1"]])
PP = np.array([truth["cx"], truth["cy"]])
POSE = {image["name"]: (np.array(image["R"]), np.array(image["C"])) for image in truth["images"]}


def project(R, C, lens, frame, X):
    p = np.einsum("nij,nj->ni", R[frame], X - C[frame])
    xy = p[:, :2] / p[:, 2:]
    return p, xy, lens[0] * xy * (1 + lens[1] * (xy**2).sum(1))[:, None] + PP


def turned(w):
    angle = np.linalg.norm(w)
    K = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
    if angle < 1e-12:
        return np.eye(3) + K
    return np.eye(3) + np.sin(angle) / angle * K + (1 - np.cos(angle)) / angle**2 * K @ K


class Block:
    """Image points of `points`, some of which have a survey; cameras start at the truth."""

    def __init__(self, names, frame, point, sigma, X, survey):
        self.R = np.array([POSE[name][0] for name in names])
        self.C = np.array([POSE[name][1] for name in names])
        self.lens, self.frame, self.point, self.sigma, self.X, self.survey = LENS.copy(), frame, point, sigma, X.copy(), survey

    def system(self, held):
        """Jacobians by cameras and lens, and by points, each divided by sigma."""
        p, xy, seen = project(self.R, self.C, self.lens, self.frame, self.X[self.point])
        f, k1 = self.lens
        square = (xy**2).sum(1)
        count, n = len(p), len(self.R)
        by_xy = f * ((1 + k1 * square)[:, None, None] * np.eye(2) + 2 * k1 * np.einsum("ni,nj->nij", xy, xy))
        by_p = np.zeros((count, 2, 3))
        by_p[:, 0, 0] = by_p[:, 1, 1] = 1 / p[:, 2]
        by_p[:, :, 2] = -xy / p[:, 2:]
        by_p = by_xy @ by_p
        by_X = by_p @ self.R[self.frame]
        cross = np.zeros((count, 3, 3))
        for i, j, k in [(0, 1, 2), (1, 2, 0), (2, 0, 1)]:
            cross[:, i, j], cross[:, j, i] = p[:, k], -p[:, k]
        by_pose = np.concatenate([by_p @ cross, -by_X], 2)
        by_lens = np.stack([xy * (1 + k1 * square)[:, None], f * xy * square[:, None]], 2)
        if held:
            by_lens[:] = 0
        w = 1 / self.sigma
        rows = np.arange(2 * count).reshape(count, 2, 1)
        poses = np.broadcast_to((6 * self.frame)[:, None, None] + np.arange(6), (count, 2, 6))
        lenses = np.broadcast_to(6 * n + np.arange(2), (count, 2, 2))
        grounds = np.broadcast_to((3 * self.point)[:, None, None] + np.arange(3), (count, 2, 3))
        made = lambda values, columns, width: sparse.csr_matrix(
            ((values * w[:, None, None]).ravel(), (np.broadcast_to(rows, values.shape).ravel(), columns.ravel())), (2 * count, width)
        )
        cameras = made(by_pose, poses, 6 * n + 2) + made(by_lens, lenses, 6 * n + 2)
        return cameras, made(by_X, grounds, 3 * len(self.X)), seen

    def normal(self, held, weight):
        cameras, points, seen = self.system(held)
        W = sparse.diags(np.repeat(weight, 2))
        blocks = (points.T @ W @ points).tobsr((3, 3))
        blocks.sort_indices()
        blocks.data += np.eye(3) / self.survey[1][:, None, None] ** 2
        inverse = sparse.bsr_matrix((np.linalg.inv(blocks.data), blocks.indices, blocks.indptr), blocks.shape).tocsr()
        across = (cameras.T @ W @ points).tocsr()
        reduced = (cameras.T @ W @ cameras - across @ inverse @ across.T).toarray()
        if held:
            reduced[-2:, -2:] += np.eye(2)
        return cameras, points, W, inverse, across, reduced, seen

    def adjust(self, pixels, held=False, huber=None, steps=12):
        for _ in range(steps):
            _, _, seen = project(self.R, self.C, self.lens, self.frame, self.X[self.point])
            residual = (pixels - seen) / self.sigma[:, None]
            length = np.sqrt((residual**2).sum(1))
            weight = np.ones(len(length)) if huber is None else np.minimum(1, huber / np.maximum(length, 1e-9))
            cameras, points, W, inverse, across, reduced, _ = self.normal(held, weight)
            told = (self.survey[0] - self.X) / self.survey[1][:, None] ** 2
            right, below = cameras.T @ W @ residual.ravel(), points.T @ W @ residual.ravel() + told.ravel()
            step = np.linalg.solve(reduced, right - across @ (inverse @ below))
            self.X += (inverse @ (below - across.T @ step)).reshape(-1, 3)
            for i, s in enumerate(step[:-2].reshape(-1, 6)):
                self.R[i], self.C[i] = turned(s[:3]) @ self.R[i], self.C[i] + s[3:]
            self.lens = self.lens + step[-2:]
            if np.abs(step[:-2].reshape(-1, 6)[:, 3:]).max() < 1e-3:
                break
        return self


def intersect(R, C, lens, rows, start):
    """Where the rays of image points meet."""
    X = start.copy()
    for _ in range(5):
        block = Block([], rows[:, 0].astype(int), rows[:, 1].astype(int), np.ones(len(rows)), X, None)
        block.R, block.C, block.lens = R, C, lens
        _, points, seen = block.system(False)
        H = (points.T @ points).tobsr((3, 3))
        H.sort_indices()
        right = (points.T @ (rows[:, 2:] - seen).ravel()).reshape(-1, 3)
        X += np.einsum("nij,nj->ni", np.linalg.inv(H.data), right)
    return X


def tracks(folder, names):
    """Of COLMAP's text model: frame, point, x, y of every image point that a point has."""
    lines = [line for line in (folder / "images.txt").read_text().splitlines() if not line.startswith("#")]
    rows = []
    for head, seen in zip(lines[::2], lines[1::2]):
        frame = names.index(head.split()[9])
        values = np.array(seen.split(), float).reshape(-1, 3)
        values = values[values[:, 2] >= 0]
        rows.append(np.column_stack([np.full(len(values), frame), values[:, 2], values[:, :2]]))
    rows = np.concatenate(rows)
    rows[:, 1] = np.unique(rows[:, 1], return_inverse=True)[1]
    return rows


def rms(errors):
    return np.sqrt((np.asarray(errors) ** 2).mean(0))


def goals(line):
    return bool((line[:3] < 40).all() and (line[3:6] < 15).all() and abs(line[6]) < 0.5)


def told(name, line):
    print(f"  {name:9} cameras {line[0]:5.1f} {line[1]:5.1f} {line[2]:5.1f}  check points {line[3]:5.1f} {line[4]:5.1f} {line[5]:5.1f}  f {line[6]:+.2f} %  {'' if goals(line) else 'beyond'}")


def one(folder):
    document = json.loads((folder / "out" / "cameras.json").read_text())
    names = sorted(c["name"] for c in document["cameras"])
    lists = [row.split() for row in (folder / "gcps.txt").read_text().splitlines()[1:]]
    ids = sorted({row[6] for row in lists})
    rows = np.array([[names.index(row[5]), ids.index(row[6]), float(row[3]), float(row[4])] for row in lists])
    stated = np.zeros((len(ids), 3))
    for row in lists:
        stated[ids.index(row[6])] = [float(v) for v in row[:3]]
    check = np.array([name[0] == "C" for name in ids])
    true = (np.array([POSE[n][0] for n in names]), np.array([POSE[n][1] for n in names]))
    program = np.array([np.array(c["C"]) - POSE[c["name"]][1] for c in document["cameras"]])
    missed = np.array([p["residual_m"] for p in document["check_points"] if p["residual_m"]])
    lines = {"program": np.array([*rms(program), *rms(missed), 100 * (document["interior"][0]["f_px"] / LENS[0] - 1)])}

    ties = tracks(folder / "out" / "relative", names)
    far = np.array([np.bincount(ties[:, 1].astype(int))])
    start = np.full((far.shape[1], 3), np.nan)
    # On the ground plane of the first image point, then where the rays meet.
    first = np.unique(ties[:, 1], return_index=True)[1]
    for k, r in enumerate(ties[first]):
        R, C = true[0][int(r[0])], true[1][int(r[0])]
        way = R.T @ np.array([*((r[2:] - PP) / LENS[0]), 1.0])
        start[k] = C + way * (min((150 - C[2]) / way[2], 20000) if way[2] < 0 else 20000)
    X = intersect(*true, LENS, ties, start)
    frame, point = ties[:, 0].astype(int), ties[:, 1].astype(int)
    _, _, seen = project(*true, LENS, frame, X[point])
    residual = ties[:, 2:] - seen
    # A gross error is no part of a bound.
    worst = np.zeros(len(X))
    np.maximum.at(worst, point, np.sqrt((residual**2).sum(1)))
    good = (worst < 6) & (np.linalg.norm(X - X.mean(0), axis=1) < 1e5)
    keep = good[point]
    new = np.cumsum(good) - 1
    frame, point, pixels, X = frame[keep], new[point[keep]], ties[keep, 2:], X[good]
    spare = 2 * len(frame) - 3 * len(X)
    shown = np.sqrt((residual[keep] ** 2).sum() / spare)

    control = ~check
    index = np.cumsum(control) - 1
    of = rows[control[rows[:, 1].astype(int)]]
    frames = np.concatenate([of[:, 0].astype(int), frame])
    points = np.concatenate([index[of[:, 1].astype(int)], control.sum() + point])
    places = intersect(*true, LENS, rows, stated)
    allX = np.concatenate([stated[control], X])
    survey = (allX, np.concatenate([np.full(control.sum(), args.ground), np.full(len(X), 1e9)]))
    sigma = np.concatenate([np.full(len(of), args.image), np.full(len(frame), shown)])

    def result(block):
        at = rows[check[rows[:, 1].astype(int)]].copy()
        at[:, 1] = np.unique(at[:, 1], return_inverse=True)[1]
        misses = intersect(block.R, block.C, block.lens, at, stated[check]) - stated[check]
        return np.array([*rms(block.C - true[1]), *rms(misses), 100 * (block.lens[0] / LENS[0] - 1)])

    def run(pixels, sigma, **how):
        block = Block(names, frames, points, sigma, allX, survey)
        return result(block.adjust(np.concatenate([of[:, 2:], pixels]), **how))

    lines["own ties"] = run(pixels, sigma, huber=3)
    _, _, exact = project(*true, LENS, frame, X[point])
    noise = np.random.default_rng(0).normal(0, args.tie_px, exact.shape)
    iid = np.concatenate([np.full(len(of), args.image), np.full(len(frame), args.tie_px)])
    lines["iid ties"] = run(exact + noise, iid)
    sure = np.concatenate([np.full(len(of), args.image), np.full(len(frame), 0.02)])
    lines["true ties"] = run(exact, sure)
    lines["f known"] = run(exact, sure, held=True)

    # Noise of both kinds, to first order at the truth.
    block = Block(names, frames, points, iid, allX, survey)
    held = places.copy()
    block.X[: control.sum()] = held[control]
    cameras, grounds, W, inverse, across, reduced, _ = block.normal(False, np.ones(len(frames)))
    cov = np.linalg.inv(reduced)
    rng = np.random.default_rng(1 + int(folder.name))
    steps = np.linalg.cholesky(cov) @ rng.normal(size=(len(cov), args.spread))
    at = rows[check[rows[:, 1].astype(int)]].copy()
    at[:, 1] = np.unique(at[:, 1], return_inverse=True)[1]
    own = Block(names, at[:, 0].astype(int), at[:, 1].astype(int), np.full(len(at), args.image), places[check], (None, np.full(check.sum(), 1e9)))
    by_camera, by_ground, _ = own.system(False)
    H = np.linalg.inv((by_ground.T @ by_ground).toarray())
    seen_noise = rng.normal(size=(2 * len(at), args.spread))
    moved = H @ (by_ground.T @ (seen_noise - by_camera @ steps))
    camera = steps[:-2].reshape(len(names), 6, -1)[:, 3:]
    drawn = np.column_stack(
        [rms(camera).T, np.sqrt((moved.reshape(-1, 3, args.spread) ** 2).mean(0)).T, 100 * steps[-2] / LENS[0]]
    )
    return lines, drawn, shown, len(X)


everything, spreads = [], []
for folder in sorted(args.draws.iterdir(), key=lambda f: int(f.name)):
    if not (folder / "out" / "cameras.json").exists():
        continue
    lines, drawn, shown, count = one(folder)
    print(f"draw {folder.name}: {count} ties that err by {shown:.2f} px against the true cameras")
    for name, line in lines.items():
        told(name, line)
    print(f"  allowed   half of {args.spread} drawings below", end=" ")
    half = np.median(np.abs(drawn), 0)
    print(" ".join(f"{v:.1f}" for v in half[:6]), f"{half[6]:.2f} %; goals kept in {100 * np.mean([goals(d) for d in drawn]):.0f} %", flush=True)
    everything.append(lines)
    spreads.append(drawn)
for name in everything[0]:
    table = np.abs(np.array([lines[name] for lines in everything]))
    print(name, "median", np.round(np.median(table, 0), 2), "worst", np.round(table.max(0), 2), f"goals kept {sum(map(goals, table))} of {len(table)}")
kept = np.array([[goals(d) for d in drawn] for drawn in spreads])
worst = np.abs(np.array(spreads)).max(0)
print(
    f"allowed: goals kept in {100 * kept.mean():.0f} % of drawings, by all {len(spreads)} draws in {100 * kept.all(0).mean():.0f} %; "
    f"worst of {len(spreads)} draws, half of all: " + " ".join(f"{v:.1f}" for v in np.median(worst, 0)[:6]) + f" {np.median(worst, 0)[6]:.2f} %"
)
