#!/usr/bin/env python3
"""Masks against polygons drawn by hand, for every pair of a teaching and a judged frame of one flight.

    python3 benches/masks.py target/fast/autoref-stream DATA [auto thesis-2017 threshold forest] > masks.csv
    python3 benches/masks.py target/fast/autoref-stream FOLDER held-out > held_out.csv

DATA holds oblique_svalbard, film and frames; the polygons are in crates/terrain/tests/polygons. "shipped" teaches nothing.
`forest` is a random forest on local deviation and gradient at three scales and smoothed entropy with the thesis's cleaning,
by scikit-learn, SciPy and OpenCV. Only what a polygon names is judged; all-keep is the share of ground among that.
The second call judges auto on the photographs of crates/terrain/tests/held_out, which lie in FOLDER and teach nothing.
"""
import csv, json, os, subprocess, sys, tempfile
import cv2, numpy as np

TESTS = os.path.join(os.path.dirname(os.path.abspath(__file__)), "../crates/terrain/tests")
FLIGHTS = [["KR1_uv", "KR1_plume"], ["japan_52", "japan_88", "japan_92"], ["ngi_182", "ngi_184"], ["odm_18", "odm_136"], ["unbc_114"]]
CLASSES = {"keep": 1, "mask": 0, "unknown": 255}


def read_truth(name, data, folder="polygons"):
    polygons = json.load(open(os.path.join(TESTS, folder, name + ".geojson")))
    path = os.path.join(data, polygons["frame"])
    grey = cv2.imread(path, cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION)
    truth = np.full(grey.shape, 255, np.uint8)
    for feature in polygons["features"]:
        rings = feature["geometry"]["coordinates"]
        value = CLASSES[feature["properties"]["class"].split(":")[0]]
        cv2.fillPoly(truth, [np.array(ring, np.int32) for ring in rings], value)
    return path, grey, truth


def scores(mask, truth):
    known = truth < 2
    m, t = mask[known] > 0, truth[known] > 0
    share = lambda a, b: float((a & b).sum() / b.sum()) if b.any() else float("nan")
    keep, masked = share(m, t), share(~m, ~t)
    return [float((m == t).mean()), (keep + masked) / 2, share(t, m), keep, share(~t, ~m), masked, float(t.mean())]


def reduction(shape):
    return 1 if max(shape) < 1500 else 2 if max(shape) < 3000 else 4


def prototype(taught, judged):
    from skimage.filters.rank import entropy
    from skimage.morphology import disk
    from sklearn.ensemble import RandomForestClassifier

    def features(grey):
        f = reduction(grey.shape)
        small = cv2.resize(cv2.GaussianBlur(grey, (5, 5), 1.1), None, fx=1 / f, fy=1 / f, interpolation=cv2.INTER_AREA)
        v = small.astype(np.float32)
        gradient = np.hypot(cv2.Sobel(v, -1, 1, 0), cv2.Sobel(v, -1, 0, 1))
        planes = [v / 255]
        for k in (5, 15, 31):
            mean = cv2.blur(v, (k, k))
            planes += [np.sqrt(np.maximum(cv2.blur(v * v, (k, k)) - mean * mean, 0)), cv2.blur(gradient, (k, k))]
        bits = entropy(small, disk(7)).astype(np.float32)
        return np.stack(planes + [bits, cv2.GaussianBlur(bits, (0, 0), 5)], -1)

    _, grey, truth = taught
    planes = features(grey)
    small = cv2.resize(truth, planes.shape[1::-1], interpolation=cv2.INTER_NEAREST)
    pick, random = [], np.random.default_rng(1)
    for value in (0, 1):
        at = np.flatnonzero(small == value)
        pick.append(random.choice(at, min(3000, at.size), replace=False))
    pick = np.concatenate(pick)
    flat = planes.reshape(-1, planes.shape[-1])
    forest = RandomForestClassifier(100, random_state=0, min_samples_leaf=4).fit(flat[pick], small.ravel()[pick])
    planes = features(judged[1])
    mask = forest.predict(planes.reshape(-1, planes.shape[-1])).reshape(planes.shape[:2]).astype(np.uint8)
    ellipse = lambda k: cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (k, k))

    def flip(m, value):
        count, labels, stats, _ = cv2.connectedComponentsWithStats((m == value).astype(np.uint8), connectivity=4)
        gone = stats[:, cv2.CC_STAT_AREA] < 0.02 * m.size
        gone[0] = False
        return np.where(gone[labels], 1 - value, m).astype(np.uint8)

    for size in range(3, 31, 3):
        mask = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, ellipse(size))
    mask = flip(cv2.dilate(mask, ellipse(15)), 0)
    mask = flip(cv2.erode(mask, ellipse(15), iterations=2), 1)
    mask = cv2.dilate(mask, ellipse(15))
    return cv2.resize(mask, judged[1].shape[::-1], interpolation=cv2.INTER_NEAREST)


def held_out(program, data):
    """Accuracy, balanced, … of auto on each photograph that took no part."""
    names = sorted(name[:-8] for name in os.listdir(os.path.join(TESTS, "held_out")) if name.endswith(".geojson"))
    with tempfile.TemporaryDirectory() as folder:
        for name in names:
            path, _, truth = read_truth(name, data, "held_out")
            command = [program, "mask", path, "-o", folder, "--method", "auto", "--overwrite", "--quiet"]
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
            stem = os.path.splitext(os.path.basename(path))[0]
            mask = cv2.imread(f"{folder}/{stem}_Masq.tif", cv2.IMREAD_UNCHANGED)
            yield ["shipped", name, "auto"] + [f"{v:.3f}" for v in scores(mask, truth)]


def main():
    program, data, methods = sys.argv[1], sys.argv[2], sys.argv[3:] or ["auto", "thesis-2017", "threshold", "forest"]
    out = csv.writer(sys.stdout)
    out.writerow("taught,judged,method,accuracy,balanced,keep_precision,keep_recall,mask_precision,mask_recall,all_keep".split(","))
    if methods == ["held-out"]:
        out.writerows(held_out(program, data))
        return
    with tempfile.TemporaryDirectory() as folder:
        for flight in FLIGHTS:
            frames = {name: read_truth(name, data) for name in flight}
            for name, (_, _, truth) in frames.items():
                cv2.imwrite(f"{folder}/{name}.tif", truth)
            for judged in flight:
                for taught in [None] + [other for other in flight if other != judged]:
                    for method in methods:
                        path, _, truth = frames[judged]
                        if method == "forest":
                            if taught is None:
                                continue
                            mask = prototype(frames[taught], frames[judged])
                        else:
                            if method == "threshold" and taught is not None:
                                continue
                            command = [program, "mask", path, "-o", folder, "--method", method, "--overwrite", "--quiet"]
                            if taught:
                                command += ["--teach", f"{frames[taught][0]}={folder}/{taught}.tif"]
                            subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
                            stem = os.path.splitext(os.path.basename(path))[0]
                            mask = cv2.imread(f"{folder}/{stem}_Masq.tif", cv2.IMREAD_UNCHANGED)
                        row = scores(mask, truth)
                        out.writerow([taught or "shipped", judged, method] + [f"{v:.3f}" for v in row])
                        sys.stdout.flush()


if __name__ == "__main__":
    main()
