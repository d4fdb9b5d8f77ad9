#!/usr/bin/env python3
"""What masks are worth in tie points: good ones kept and bad ones removed on pairs of frames.

    python3 benches/mask_ties.py target/fast/autoref-stream DATA > ties.csv

OpenCV judges: SIFT (8,000 points a frame), ratio test at 0.85, fundamental matrix by MAGSAC at 2 px of the frame; what fits it is good.
A match is kept when both masks keep its place. `polygons` are the masks drawn by hand. The KR1 frames are one photograph twice.
"""
import csv, importlib.util, os, subprocess, sys, tempfile
import cv2, numpy as np

spec = importlib.util.spec_from_file_location("masks", os.path.join(os.path.dirname(os.path.abspath(__file__)), "masks.py"))
masks = importlib.util.module_from_spec(spec)
spec.loader.exec_module(masks)
PAIRS = [["odm_18", "odm_136"], ["ngi_182", "ngi_184"], ["KR1_uv", "KR1_plume"]]


def matches(frames):
    scale = 1 if max(frames[0][1].shape) < 3000 else 0.5
    sift = cv2.SIFT_create(8000)
    small = [cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA) for _, grey, _ in frames]
    (points_a, a), (points_b, b) = [sift.detectAndCompute(grey, None) for grey in small]
    pairs = [m for m, n in cv2.BFMatcher().knnMatch(a, b, k=2) if m.distance < 0.85 * n.distance]
    places = [np.float32([points_a[m.queryIdx].pt for m in pairs]) / scale,
              np.float32([points_b[m.trainIdx].pt for m in pairs]) / scale]
    cv2.setRNGSeed(1)
    return places, cv2.findFundamentalMat(*places, cv2.USAC_MAGSAC, 2.0, 0.9999, 20000)[1].ravel() > 0


def made(program, folder, method, taught, frames):
    out = []
    for (path, _, _), other in zip(frames, frames[::-1]):
        command = [program, "mask", path, "-o", folder, "--method", method, "--overwrite", "--quiet"]
        if taught:
            cv2.imwrite(f"{folder}/taught.tif", other[2])
            command += ["--teach", f"{other[0]}={folder}/taught.tif"]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        stem = os.path.splitext(os.path.basename(path))[0]
        out.append(cv2.imread(f"{folder}/{stem}_Masq.tif", cv2.IMREAD_UNCHANGED))
    return out


def main():
    program, data = sys.argv[1:3]
    table = csv.writer(sys.stdout)
    table.writerow("pair,masks,good,bad,good_kept,bad_removed".split(","))
    with tempfile.TemporaryDirectory() as folder:
        for names in PAIRS:
            frames = [masks.read_truth(name, data) for name in names]
            places, good = matches(frames)
            ways = [("polygons", [np.where(truth == 0, 0, 1) for _, _, truth in frames])]
            for method, taught in (("auto", False), ("auto", True), ("thesis-2017", True)):
                name = f"{method} taught by the other" if taught else f"{method} as shipped"
                ways.append((name, made(program, folder, method, taught, frames)))
            for name, pair in ways:
                at = [mask[tuple(np.minimum(place.astype(int)[:, ::-1], np.array(mask.shape) - 1).T)] > 0
                      for mask, place in zip(pair, places)]
                kept = at[0] & at[1]
                row = [int(good.sum()), int((~good).sum()), f"{kept[good].mean():.3f}", f"{(~kept[~good]).mean():.3f}"]
                table.writerow([" ".join(names), name] + row)


main()
