#!/usr/bin/env python3
"""Each step of the mask against the library it is said to equal, on real and random images.

    cargo build --profile fast -p autoref-terrain --example steps
    python3 crates/terrain/tests/peers.py target/fast/examples/steps IMAGE...

Needs numpy, scipy, scikit-image, scikit-learn and OpenCV; says so and stops where they are absent.
"""
import subprocess, sys, tempfile, time, os
try:
    import cv2, numpy as np, skimage
    from scipy import ndimage
    from skimage.filters import rank
    from skimage.morphology import disk
    from sklearn.neighbors import KNeighborsClassifier
except ImportError as missing:
    print(f"skipped: {missing}")
    sys.exit(0)

PROGRAM, IMAGES = sys.argv[1], sys.argv[2:]
FOLDER = tempfile.mkdtemp()
failed = 0


def ours(step, image, argument=None, dtype=np.uint8, shape=None):
    source, target = os.path.join(FOLDER, "in"), os.path.join(FOLDER, "out")
    image.astype(np.uint8).tofile(source)
    height, width = image.shape
    command = [PROGRAM, step, str(width), str(height), source, target] + ([str(argument)] if argument is not None else [])
    done = subprocess.run(command, check=True, capture_output=True, text=True, env={**os.environ, "RAYON_NUM_THREADS": "1"})
    return np.fromfile(target, dtype).reshape(shape or image.shape), float(done.stdout or 0)


def same(what, a, b):
    global failed
    n = int((np.asarray(a) != np.asarray(b)).sum())
    failed += n > 0
    print(f"  {what}: {'identical' if n == 0 else f'{n} of {np.size(a)} differ'}")


def mean4(image, f=4):
    h, w = image.shape
    out = np.zeros((-(-h // f), -(-w // f)), np.uint8)
    pad = np.pad(image.astype(np.int64), ((0, -h % f), (0, -w % f)))
    ones = np.pad(np.ones_like(image, np.int64), ((0, -h % f), (0, -w % f)))
    block = lambda a: a.reshape(a.shape[0] // f, f, a.shape[1] // f, f).sum((1, 3))
    s, n = block(pad), block(ones)
    return ((2 * s + n) // (2 * n)).astype(np.uint8)


random = np.random.default_rng(2017)
images = [(path, cv2.imread(path, cv2.IMREAD_GRAYSCALE)) for path in IMAGES]
images.append(("random", random.integers(0, 256, (301, 403), np.uint8)))
print("OpenCV", cv2.__version__, "scikit-image", skimage.__version__)
for name, full in images:
    print(name, full.shape)
    same("Gaussian, OpenCV", ours("gaussian", full)[0], cv2.GaussianBlur(full, (5, 5), 1.1))
    small = mean4(cv2.GaussianBlur(full, (5, 5), 1.1))
    same("mean of 4×4, NumPy", ours("reduce", cv2.GaussianBlur(full, (5, 5), 1.1), 4, shape=small.shape)[0], small)
    started = time.perf_counter()
    expected = rank.entropy(small, disk(7))
    theirs = time.perf_counter() - started
    got, seconds = ours("entropy", small, dtype="<f4")
    worst = float(np.abs(got - expected).max())
    failed += worst > 1e-6
    print(f"  entropy, scikit-image: greatest difference {worst:.2g} bit; {small.size / seconds / 1e6:.1f} against "
          f"{small.size / theirs / 1e6:.2f} Mpx/s, × {theirs / seconds:.1f}")
    pick = random.choice(small.size, 500, replace=False)
    label = (random.random(500) < 0.5) ^ (expected.ravel()[pick] > 4.5)
    features = np.stack([got.ravel().astype(float), small.ravel() / 255], 1)
    with open(os.path.join(FOLDER, "samples"), "w") as file:
        for f, keep in zip(features[pick], label):
            file.write(f"{f[0]!r} {f[1]!r} {int(keep)}\n".replace("np.float64(", "").replace(")", ""))
    peer = KNeighborsClassifier(3, algorithm="brute").fit(features[pick], label)
    kept, seconds = ours("knn", small, os.path.join(FOLDER, "samples"))
    started = time.perf_counter()
    voted = peer.predict(features)
    theirs = time.perf_counter() - started
    # Where the third and the fourth neighbour are equally far, the vote depends on the order in which they are found.
    unlike = np.flatnonzero(voted != kept.ravel())
    distance = np.sort(((features[unlike][:, None] - features[pick][None]) ** 2).sum(2), 1) if unlike.size else None
    ties = 0 if distance is None else int((distance[:, 3] - distance[:, 2] < 1e-9).sum())
    failed += unlike.size > ties
    print(f"  3 nearest, scikit-learn: {unlike.size} of {small.size} differ, {ties} of them with equal distances; "
          f"× {theirs / seconds:.1f}")
    for what, mask in (("threshold", (expected > 4).astype(np.uint8)), ("kNN", kept), ("noise", (random.random(small.shape) < 0.55).astype(np.uint8))):
        for size in (3, 6, 9, 12, 15, 18, 21, 24, 27, 30):
            kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
            for step, operation in (("dilate", cv2.MORPH_DILATE), ("erode", cv2.MORPH_ERODE), ("close", cv2.MORPH_CLOSE)):
                a, b = ours(step, mask, size)[0], cv2.morphologyEx(mask, operation, kernel)
                if (a != b).any():
                    same(f"{what}: {step} {size}", a, b)
        ellipse = lambda k: cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (k, k))

        def flip(m, value, share):
            labels, n = ndimage.label(m == value)
            area = np.bincount(labels.ravel())
            gone = area < share * m.size
            gone[0] = False
            return np.where(gone[labels], 1 - value, m).astype(np.uint8)

        for step, value in (("holes", 0), ("objects", 1)):
            same(f"{what}: {step} under 2 %, SciPy", ours(step, mask, 0.02)[0], flip(mask, value, 0.02))
        chain = mask
        for size in range(3, 31, 3):
            chain = cv2.morphologyEx(chain, cv2.MORPH_CLOSE, ellipse(size))
        chain = flip(cv2.dilate(chain, ellipse(15)), 0, 0.02)
        chain = flip(cv2.erode(cv2.erode(chain, ellipse(15)), ellipse(15)), 1, 0.02)
        same(f"{what}: the whole cleaning", ours("clean", mask)[0], cv2.dilate(chain, ellipse(15)))
print("every step agrees" if not failed else f"{failed} comparisons failed")
sys.exit(failed > 0)
