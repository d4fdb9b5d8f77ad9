"""The bundle adjustment beside SciPy's least squares on the same residuals.

    AUTOREF_BUNDLE_DUMP=/tmp/bundle.json cargo test -p autoref-flight --test bundle the_minimum
    python benches/bundle_scipy.py /tmp/bundle.json        # needs numpy and scipy
"""

import json
import sys
import time

import numpy as np
from scipy.optimize import least_squares
from scipy.sparse import lil_matrix
from scipy.spatial.transform import Rotation

d = json.load(open(sys.argv[1]))
R0 = np.array([np.array(f["R"]).reshape(3, 3) for f in d["frames"]])
C0 = np.array([f["C"] for f in d["frames"]])
X0 = np.array([p["xyz"] for p in d["points"]])
surveyed = [i for i, p in enumerate(d["points"]) if p["survey"]]
S = np.array([d["points"][i]["survey"] for i in surveyed])
o = d["observations"]
frame = np.array([v[0] for v in o])
point = np.array([v[1] for v in o])
pixel = np.array([[v[2], v[3]] for v in o])
sigma = np.array([v[4] for v in o])
robust = np.array([v[5] for v in o])
n, m, k = len(R0), len(X0), d["huber"]


def residuals(v):
    f, poses, X = v[0], v[1 : 1 + 6 * n].reshape(n, 6), v[1 + 6 * n :].reshape(m, 3)
    R = Rotation.from_rotvec(poses[:, :3]).as_matrix() @ R0
    p = np.einsum("nij,nj->ni", R[frame], X[point] - (C0 + poses[:, 3:])[frame])
    xy = p[:, :2] / p[:, 2:]
    xy = xy * (1 + d["k1"] * (xy**2).sum(1, keepdims=True))
    r = (f * xy + d["pp"] - pixel) / sigma[:, None]
    # Huber of the length of the pair, as a factor: the square of what is returned is rho.
    s = np.maximum((r**2).sum(1), 1e-30)
    rho = np.where(robust & (s > k * k), 2 * k * np.sqrt(s) - k * k, s)
    r = r * np.sqrt(rho / s)[:, None]
    survey = (X[surveyed] - S[:, :3]) / S[:, 3:]
    return np.concatenate([r.ravel(), survey.ravel()])


pattern = lil_matrix((2 * len(o) + 3 * len(surveyed), 1 + 6 * n + 3 * m), dtype=int)
for i in range(len(o)):
    pattern[2 * i : 2 * i + 2, 0] = 1
    pattern[2 * i : 2 * i + 2, 1 + 6 * frame[i] : 7 + 6 * frame[i]] = 1
    at = 1 + 6 * n + 3 * point[i]
    pattern[2 * i : 2 * i + 2, at : at + 3] = 1
for j, i in enumerate(surveyed):
    for a in range(3):
        pattern[2 * len(o) + 3 * j + a, 1 + 6 * n + 3 * i + a] = 1
start = np.concatenate([[d["f"]], np.zeros(6 * n), X0.ravel()])
begin = time.time()
found = least_squares(
    residuals, start, jac_sparsity=pattern, x_scale="jac", method="trf", tr_solver="lsmr",
    ftol=1e-15, xtol=1e-15, gtol=1e-12, max_nfev=2000,
)
ours = d["ours"]
print(f"{n} frames, {m} points, {len(o)} observations")
print(f"SciPy: cost {found.cost:.9f}, f {found.x[0]:.6f} px, {time.time() - begin:.1f} s, {found.nfev} evaluations")
print(f"ours:  cost {ours['cost']:.9f}, f {ours['f']:.6f} px")
print(f"relative difference of the cost: {(found.cost - ours['cost']) / ours['cost']:.2e}")
