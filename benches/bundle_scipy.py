"""The bundle adjustment beside SciPy's least squares on the same residuals, both from the same far start.

    AUTOREF_BUNDLE_DUMP=/tmp/bundle.json cargo test -p autoref-flight --test bundle the_minimum
    python benches/bundle_scipy.py /tmp/bundle.json        # needs numpy and scipy

SciPy's Jacobian is analytic, its trust region exact (dense), its tolerances as small as it takes. Printed: both costs, both focal
lengths, and the relative difference.
"""

import json
import sys
import time

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

d = json.load(open(sys.argv[1]))
R0 = np.array([np.array(f["R"]).reshape(3, 3) for f in d["frames"]])
C0 = np.array([f["C"] for f in d["frames"]])
X0 = np.array([p["xyz"] for p in d["points"]])
surveyed = np.array([i for i, p in enumerate(d["points"]) if p["survey"]])
S = np.array([d["points"][i]["survey"] for i in surveyed])
o = d["observations"]
frame = np.array([v[0] for v in o])
point = np.array([v[1] for v in o])
pixel = np.array([[v[2], v[3]] for v in o])
sigma = np.array([v[4] for v in o])
robust = np.array([v[5] for v in o])
n, m, k = len(R0), len(X0), d["huber"]


def cross(v):
    x, y, z = np.moveaxis(v, -1, 0)
    zero = np.zeros_like(x)
    return np.stack([np.stack([zero, -z, y], -1), np.stack([z, zero, -x], -1), np.stack([-y, x, zero], -1)], -2)


def left_jacobian(w):
    """d exp(w) = left_jacobian(w) dw exp(w), to first order in dw."""
    angle = np.maximum(np.linalg.norm(w, axis=1), 1e-8)[:, None, None]
    K = cross(w)
    return np.eye(3) + (1 - np.cos(angle)) / angle**2 * K + (angle - np.sin(angle)) / angle**3 * (K @ K)


def parts(v):
    f, poses, X = v[0], v[1 : 1 + 6 * n].reshape(n, 6), v[1 + 6 * n :].reshape(m, 3)
    R = Rotation.from_rotvec(poses[:, :3]).as_matrix() @ R0
    p = np.einsum("nij,nj->ni", R[frame], X[point] - (C0 + poses[:, 3:])[frame])
    xy = p[:, :2] / p[:, 2:]
    return f, poses, X, R, p, xy, 1 + d["k1"] * (xy**2).sum(1)


def huber(r):
    """Huber of the length of a pair as a factor g: the square of g r is rho; and dg/ds."""
    s = np.maximum((r**2).sum(1), 1e-30)
    far = robust & (s > k * k)
    rho = np.where(far, 2 * k * np.sqrt(s) - k * k, s)
    g = np.sqrt(rho / s)
    slope = np.where(far, k / np.sqrt(s), 1.0)
    return g, (slope * s - rho) / (2 * g * s * s)


def residuals(v):
    f, _, X, _, _, xy, radial = parts(v)
    r = (f * xy * radial[:, None] + d["pp"] - pixel) / sigma[:, None]
    survey = (X[surveyed] - S[:, :3]) / S[:, 3:]
    return np.concatenate([(r * huber(r)[0][:, None]).ravel(), survey.ravel()])


def jacobian(v):
    f, poses, X, R, p, xy, radial = parts(v)
    r = (f * xy * radial[:, None] + d["pp"] - pixel) / sigma[:, None]
    g, slope = huber(r)
    by_xy = f * (radial[:, None, None] * np.eye(2) + 2 * d["k1"] * xy[:, :, None] * xy[:, None, :])
    by_p = by_xy @ np.concatenate([np.eye(2) / p[:, 2:, None], -xy[:, :, None] / p[:, 2:, None]], 2)
    by_x = by_p @ R[frame]
    by_turn = by_p @ -cross(p) @ left_jacobian(poses[:, :3])[frame]
    J = np.zeros((len(o), 2, len(v)))
    rows = np.arange(len(o))
    J[:, :, 0] = xy * radial[:, None]
    for a in range(3):
        J[rows, :, 1 + 6 * frame + a] = by_turn[:, :, a]
        J[rows, :, 4 + 6 * frame + a] = -by_x[:, :, a]
        J[rows, :, 1 + 6 * n + 3 * point + a] = by_x[:, :, a]
    J /= sigma[:, None, None]
    J = g[:, None, None] * J + 2 * (slope[:, None] * r)[:, :, None] * np.einsum("oi,oiv->ov", r, J)[:, None, :]
    T = np.zeros((len(surveyed), 3, len(v)))
    for a in range(3):
        T[np.arange(len(surveyed)), a, 1 + 6 * n + 3 * surveyed + a] = 1 / S[:, 3]
    return np.concatenate([J.reshape(-1, len(v)), T.reshape(-1, len(v))])


start = np.concatenate([[d["f"]], np.zeros(6 * n), X0.ravel()])
rng = np.random.default_rng(1)
way = rng.normal(size=len(start))
at = start + 1e-4 * rng.normal(size=len(start))
step = 1e-6
numeric = (residuals(at + step * way) - residuals(at - step * way)) / (2 * step)
wrong = np.abs(jacobian(at) @ way - numeric).max() / np.abs(numeric).max()
assert wrong < 1e-6, f"the Jacobian is off by {wrong:.1e}"
begin = time.time()
found = least_squares(
    residuals, start, jacobian, x_scale="jac", method="trf", tr_solver="exact", ftol=1e-15, xtol=1e-15, gtol=1e-12, max_nfev=20000
)
ours = d["ours"]
print(f"{n} frames, {m} points, {len(o)} observations; start: cost {0.5 * (residuals(start)**2).sum():.3f}")
print(
    f"SciPy: cost {found.cost:.9f}, f {found.x[0]:.6f} px, {time.time() - begin:.1f} s, {found.nfev} evaluations, "
    f"largest slope {found.optimality:.1e}: {found.message}"
)
print(f"ours:  cost {ours['cost']:.9f}, f {ours['f']:.6f} px")
print(f"relative difference of the cost: {(found.cost - ours['cost']) / ours['cost']:.2e}")
