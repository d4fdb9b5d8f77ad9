#!/usr/bin/env python3
"""Film frames drawn without any code of ours, and what `fiducials` says of them.

    film_frames.py draw DIR [--pixel-um 60] [--frames 6] [--seed 1]    a folder per kind of frame: scans, camera.toml, truth.json
    film_frames.py judge DIR PROGRAM [--csv FILE]                       a line per kind: n, OK and right, doubtful, wrong but OK
    film_frames.py wrong DIR PROGRAM [--photos DIR…]                    every camera on the frames of others: none may be OK

Marks are sampled from formulas in millimetres and filtered by OpenCV; ground is noise of many octaves. A frame is right when its
orientation puts a net of film points within 1 px + 15 micrometres of the truth. Needs numpy and opencv-python.
"""

import argparse, glob, json, os, shutil, subprocess, sys, tempfile
import cv2
import numpy as np

FILM, IMAGE = 240.0, 222.0
CORNER, SIDE = 103.94, 108.6


def cross(u, v, arm=0.9, line=0.06):
    a, b = np.maximum(abs(u), abs(v)), np.minimum(abs(u), abs(v))
    return (a < arm) & (b < line / 2)


def dot(u, v, d=0.3):
    return np.hypot(u, v) < d / 2


def dot_ring(u, v):
    r = np.hypot(u, v)
    return (r < 0.06) | (abs(r - 0.6) < 0.06)


def ring_cross(u, v):
    c = np.sqrt(0.5)
    p, q = c * (u + v), c * (v - u)
    a, b = np.maximum(abs(p), abs(q)), np.minimum(abs(p), abs(q))
    return (abs(np.hypot(u, v) - 0.8) < 0.11) | ((b < 0.045) & (a >= 0.32) & (a < 1.4))


def half_circle(u, v):
    """A cross with half a disc on its inner side."""
    r = np.hypot(u, v)
    return cross(u, v, 1.3, 0.09) | ((abs(r - 0.9) < 0.1) & (v > 0))


def wedge(u, v):
    """An arrow that points inwards at its reference point."""
    return (v < 0) & (v > -1.6) & (abs(u) < -0.45 * v)


def numeral(u, v):
    """A cross with a 7 beside it."""
    x, y = u - 2.0, v
    return cross(u, v) | ((abs(y - 0.8) < 0.09) & (abs(x) < 0.5)) | ((abs(x - 0.25 * y) < 0.09) & (abs(y) < 0.85))


CROSS = '{ shape = "cross", arm_mm = 0.9, line_mm = 0.06 }'
KINDS = {
    "cross": (cross, CROSS, "corners"),
    "dot": (dot, '{ shape = "dot", diameter_mm = 0.3 }', "sides"),
    "dot_ring": (dot_ring, '{ shape = "dot", diameter_mm = 0.12, ring_diameter_mm = 1.2, ring_line_mm = 0.12 }', "corners"),
    "ring_cross": (ring_cross, '{ shape = "ring_cross", ring_diameter_mm = 1.6, line_mm = 0.22, arm_from_mm = 0.32, '
                   'arm_to_mm = 1.4, arm_line_mm = 0.09, lines_deg = 45.0 }', "eight"),
    "notch": (None, '{ shape = "notch", width_mm = 3.0, depth_mm = 2.0 }', "notches"),
    "numeral": (numeral, CROSS, "corners"),
    "half_circle": (half_circle, "learn", "sides"),
    "wedge": (wedge, "learn", "sides"),
}
PLAIN = dict(kind="cross", stretch=0.0, quarters=0, mirrored=False, negative=False, crop=0, bits=8, colour=False, form="tiles",
             tag="none", strip=False, dark=False, open_corner=False, dirt=1.0, blur=0.6)
# One thing at a time.
CASES = {k: dict(kind=k) for k in KINDS}
CASES |= {f"stretch_{s:+.1f}%_{k}": dict(kind=k, stretch=s / 100) for k in ("cross", "ring_cross", "dot", "notch")
          for s in (0.5, -1.0, 2.3, -3.0)}
CASES |= {f"stretch_2%_{k}": dict(kind=k, stretch=0.02) for k in ("dot_ring", "half_circle")}
CASES |= {f"quarter_{q}": dict(quarters=q, stretch=0.01) for q in (1, 2, 3)}
CASES |= {"mirrored": dict(mirrored=True, stretch=0.01), "negative": dict(negative=True), "negative_ring_cross": dict(kind="ring_cross", negative=True),
          "negative_notch": dict(kind="notch", negative=True), "crop_one_mark": dict(crop=1), "crop_one_of_eight": dict(kind="ring_cross", crop=1),
          "crop_stretch_2%": dict(crop=1, stretch=0.02), "16_bit": dict(bits=16), "rgb": dict(colour=True), "jpeg": dict(form="jpeg"), "strips": dict(form="strips"),
          "data_strip": dict(strip=True), "dark": dict(dark=True), "open_corners": dict(open_corner=True), "much_dust": dict(dirt=6.0),
          "much_dust_dot": dict(kind="dot", dirt=6.0), "soft": dict(blur=1.6), "tag_right_stretch_2.3%": dict(tag="right", stretch=0.023), "tag_72_dpi": dict(tag="72", stretch=0.01)}


def layout(name, rng):
    c = {"corners": [(1, 1), (-1, 1), (-1, -1), (1, -1)], "sides": [(-1, 0), (1, 0), (0, 1), (0, -1)]}
    if name == "eight":
        at = [(CORNER * x, CORNER * y) for x, y in c["corners"]] + [(SIDE * x, SIDE * y) for x, y in c["sides"]]
    else:
        size = {"corners": CORNER, "sides": SIDE, "notches": 113.0}[name]
        at = [(size * x, size * y) for x, y in c["corners" if name == "corners" else "sides"]]
    return np.array(at) + rng.uniform(-0.02, 0.02, (len(at), 2))


def turn_of(p):
    """Clockwise turn of a mark's shape: its inner side looks at the middle."""
    x, y = p
    if abs(x) > abs(y):
        return 270.0 if x > 0 else 90.0
    return 0.0 if y > 0 else 180.0


def octaves(h, w, rng):
    out = np.zeros((h, w), np.float32)
    for k, a in ((4, 0.3), (12, 0.2), (40, 0.15), (130, 0.1), (400, 0.06), (1300, 0.04)):
        n = max(2, min(k, h, w))
        out += a * cv2.resize(rng.normal(size=(n, n)).astype(np.float32), (w, h), interpolation=cv2.INTER_CUBIC)
    return np.clip(0.5 + out, 0.05, 0.98)


def draw(case, pixel_um, seed):
    c, rng = PLAIN | CASES[case], np.random.default_rng(seed)
    shape, kind, where = KINDS[c["kind"]]
    at = layout(where, np.random.default_rng(sum(map(ord, case))))
    margin = rng.uniform(0.5, 3.0)
    step = pixel_um / 1e3 * (1 + rng.uniform(-0.01, 0.01))
    a = np.deg2rad(90 * c["quarters"] + rng.uniform(-0.8, 0.8))
    mirror = np.diag([-1.0 if c["mirrored"] else 1.0, 1.0])
    stretch = np.diag([1 + c["stretch"] / 2, 1 - c["stretch"] / 2])
    A = stretch @ np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]) @ mirror / step
    w, h = [int((FILM + 2 * margin) * stretch[k, k] / step) for k in (0, 1)]
    off = np.array([w / 2, h / 2]) + rng.uniform(-0.4, 0.4, 2) * margin / step
    places = (at + rng.normal(0, 0.004, at.shape)) @ A.T + off
    B = np.linalg.inv(A)

    def mm(x0, y0, nx, ny):
        x, y = np.meshgrid(x0 + 0.5 + np.arange(nx) - off[0], y0 + 0.5 + np.arange(ny) - off[1])
        return B[0, 0] * x + B[0, 1] * y, B[1, 0] * x + B[1, 1] * y

    img = np.full((h, w), 0.9, np.float32)  # glass
    ground = octaves(h, w, rng) * (0.25 if c["dark"] else 1.0)
    for y0 in range(0, h, 512):
        X, Y = mm(0, y0, w, min(512, h - y0))
        r = np.maximum(abs(X), abs(Y))
        part = img[y0:y0 + 512]
        part[r < FILM / 2] = 0.04
        inside = r < IMAGE / 2
        if where == "corners" and not c["open_corner"]:  # an opaque triangle in every corner
            inside &= ~((abs(X) > CORNER - 4) & (abs(Y) > CORNER - 4))
        if c["strip"]:
            inside &= Y > -IMAGE / 2 + 12
        part[inside] = ground[y0:y0 + 512][inside]
    if c["strip"]:  # clock, altimeter and writing on the opaque strip
        for x in (-60, -20, 25):
            p = tuple(int(v) for v in A @ np.array([x, -IMAGE / 2 + 5]) + off)
            cv2.circle(img, p, int(4 / step), 0.85, max(1, int(0.3 / step)), cv2.LINE_AA)
            for k in range(12):
                t = np.deg2rad(30 * k)
                q = [tuple(int(v) for v in (p[0] + s * np.cos(t) / step, p[1] + s * np.sin(t) / step)) for s in (3.2, 3.9)]
                cv2.line(img, *q, 0.85, max(1, int(0.15 / step)), cv2.LINE_AA)
            ink = np.zeros((int(8 / step), int(30 / step)), np.uint8)
            cv2.putText(ink, "8 1 4 7", (2, int(6 / step)), cv2.FONT_HERSHEY_SIMPLEX, 0.15 / step, 255, max(1, int(0.2 / step)))
            part = img[p[1] - int(4 / step):, p[0] + int(5 / step):][:ink.shape[0], :ink.shape[1]]
            np.maximum(part, 0.9 * ink[:part.shape[0], :part.shape[1]] / 255, out=part)
    s = 6
    for p, m in zip(places, at):
        reach = 4.0 / step
        x0, y0, n = int(p[0] - reach), int(p[1] - reach), int(2 * reach)
        k = (np.arange(n * s) + 0.5) / s
        x, y = np.meshgrid(x0 + k - p[0], y0 + k - p[1])
        X, Y = B[0, 0] * x + B[0, 1] * y, B[1, 0] * x + B[1, 1] * y
        t = np.deg2rad(turn_of(m))
        # The shape's u to the right and v inwards; at the lower edge that is (x, -y).
        u, v = np.cos(t) * X + np.sin(t) * Y, np.sin(t) * X - np.cos(t) * Y
        if shape is None:
            inside = (v > 0) & (v < 2.2) & (abs(u) < 1.5 * np.minimum(v, 2.0) / 2.0)
            value = 0.75
        elif where == "sides" or where == "eight" and abs(m).min() < 1:
            block = (abs(u) < 3.2) & (abs(v) < 3.2)
            cover = cv2.resize(block.astype(np.float32), (n, n), interpolation=cv2.INTER_AREA)
            ys, xs = slice(max(y0, 0), min(y0 + n, h)), slice(max(x0, 0), min(x0 + n, w))
            cover = cover[ys.start - y0:ys.stop - y0, xs.start - x0:xs.stop - x0]
            img[ys, xs] = img[ys, xs] * (1 - cover) + 0.04 * cover
            inside, value = shape(u, v), 0.85
        else:
            inside, value = shape(u, v), 0.85
        cover = cv2.resize(inside.astype(np.float32), (n, n), interpolation=cv2.INTER_AREA)
        ys, xs = slice(max(y0, 0), min(y0 + n, h)), slice(max(x0, 0), min(x0 + n, w))
        if ys.stop > ys.start and xs.stop > xs.start:
            cover = cover[ys.start - y0:ys.stop - y0, xs.start - x0:xs.stop - x0]
            img[ys, xs] = img[ys, xs] * (1 - cover) + value * cover
    for _ in range(int(250 * c["dirt"])):
        p = (int(rng.uniform(0, w)), int(rng.uniform(0, h)))
        cv2.circle(img, p, int(rng.uniform(0.02, 0.2) / step), float(rng.choice([0.9, 0.02])), -1, cv2.LINE_AA)
    for _ in range(int(12 * c["dirt"])):
        p, l, t = rng.uniform(0, [w, h]), rng.uniform(2, 30) / step, rng.uniform(0, 6.3)
        q = p + l * np.array([np.cos(t), np.sin(t)])
        cv2.line(img, tuple(p.astype(int)), tuple(q.astype(int)), float(rng.choice([0.9, 0.05])), 1, cv2.LINE_AA)
    img = cv2.GaussianBlur(img, (0, 0), c["blur"])
    img += rng.normal(0, 0.012, img.shape).astype(np.float32)
    img = np.clip(1 - img if c["negative"] else img, 0, 1)
    if c["crop"]:  # through the first mark
        cut = int(places[0][0] - 0.3 / step)
        img = img[:, :cut] if cut > w / 2 else img[:, cut:]
        if cut <= w / 2:
            off, places = off - [cut, 0], places - [cut, 0]
    dpi = 25.4e3 / (step * 1e3) * np.diag(stretch)
    truth = dict(A=A.tolist(), off=off.tolist(), at=at.tolist(), places=places.tolist(), pixel_um=step * 1e3)
    return img, c, truth, dpi


def save(img, c, path, dpi):
    v = (img * (65535 if c["bits"] == 16 else 255) + 0.5).astype(np.uint16 if c["bits"] == 16 else np.uint8)
    if c["colour"]:
        v = np.dstack([v * 0.8, v * 0.9, v]).astype(v.dtype)
    png = path + ".png"
    cv2.imwrite(png, v)
    options = {"jpeg": ["-of", "JPEG", "-co", "QUALITY=85"], "strips": ["-co", "BLOCKYSIZE=16"]}.get(c["form"], ["-co", "TILED=YES"])
    out = path + (".jpg" if c["form"] == "jpeg" else ".tif")
    tag = {"right": [f"TIFFTAG_XRESOLUTION={dpi[0]:.2f}", f"TIFFTAG_YRESOLUTION={dpi[1]:.2f}", "TIFFTAG_RESOLUTIONUNIT=2"],
           "72": ["TIFFTAG_XRESOLUTION=72", "TIFFTAG_YRESOLUTION=72", "TIFFTAG_RESOLUTIONUNIT=2"], "none": []}[c["tag"]]
    subprocess.run(["gdal_translate", "-q", *options, *[a for t in tag for a in ("-mo", t)], png, out], check=True)
    os.remove(png)
    for extra in glob.glob(path + "*.aux.xml"):
        os.remove(extra)
    return out


def camera(case, folder, truth):
    c = PLAIN | CASES[case]
    kind = KINDS[c["kind"]][1]
    kind = CROSS if kind == "learn" else kind
    lines = [f'name = "{c["kind"]}"', f"film_size_mm = [{FILM}, {FILM}]", f"image_size_mm = [{IMAGE}, {IMAGE}]", 'y_axis = "down"', "marks = ["]
    lines += [f'  {{ name = "M{k}", x_mm = {x:.4f}, y_mm = {y:.4f}, kind = {kind} }},' for k, (x, y) in enumerate(truth["at"])]
    open(os.path.join(folder, "camera.toml"), "w").write("\n".join(lines + ["]"]) + "\n")


def draw_all(args):
    for case in CASES if not args.case else args.case:
        folder = os.path.join(args.dir, case)
        os.makedirs(folder, exist_ok=True)
        truths = {}
        for k in range(args.frames):
            img, c, truth, dpi = draw(case, args.pixel_um, 1000 * args.seed + k)
            truths[os.path.basename(save(img, c, os.path.join(folder, f"f{k}"), dpi))] = truth
        camera(case, folder, truth)
        json.dump(truths, open(os.path.join(folder, "truth.json"), "w"))


def error_px(frame, truth):
    """Largest and root mean square error of the orientation over the film, pixels."""
    H = np.array(frame["inner"]["pixel_to_mm"]).reshape(3, 3)
    net = np.array([(x, y) for x in np.linspace(-105, 105, 5) for y in np.linspace(-105, 105, 5)])
    px = net @ np.array(truth["A"]).T + truth["off"]
    g = np.c_[px, np.ones(len(px))] @ H.T
    off = (g[:, :2] / g[:, 2:] - net) / (truth["pixel_um"] / 1e3)
    return np.hypot(*off.T).max()


def run(program, scans, camera, out, *more):
    shutil.rmtree(out, ignore_errors=True)
    answer = subprocess.run([program, "fiducials", *scans, "--camera", camera, "-o", out, "--json", *more], capture_output=True, text=True)
    if answer.returncode == 2 or answer.returncode < 0:
        print(f"  exit {answer.returncode}: {answer.stderr.strip()[-300:]}")
    return [json.loads(line) for line in answer.stdout.splitlines() if line.startswith('{"')]


def judge(args):
    rows = []
    print(f"{'kind of frame':28} {'n':>3} {'OK, right':>9} {'doubtful':>8} {'failed':>6} {'wrong, OK':>9}  worst px  first reason")
    for case in CASES if not args.case else args.case:
        folder = os.path.join(args.dir, case)
        if not os.path.isdir(folder):
            continue
        c, truths = PLAIN | CASES[case], json.load(open(os.path.join(folder, "truth.json")))
        scans, cam = [os.path.join(folder, n) for n in truths], os.path.join(folder, "camera.toml")
        if KINDS[c["kind"]][1] == "learn" or args.clicks is not None:
            rng, t = np.random.default_rng(args.click_seed), truths[os.path.basename(scans[0])]
            size = args.clicks or 0.0
            turns = rng.uniform(0, 2 * np.pi, len(t["places"]))
            at = [f"--at=M{k}={x + size * np.cos(a):.2f},{y + size * np.sin(a):.2f}" for k, ((x, y), a) in enumerate(zip(t["places"], turns))]
            learned = os.path.join(args.dir, "learned", case)
            shutil.rmtree(learned, ignore_errors=True)
            r = subprocess.run([args.program, "fiducials", *scans[:3], "--camera", cam, "-o", learned, "--learn", *at, "--window-mm", "5,5"],
                               capture_output=True, text=True)
            made = glob.glob(os.path.join(learned, "*.toml"))
            if not made:
                print(f"{case:28} not learned: {r.stderr.strip()[-200:]}")
                rows.append((case, len(scans), 0, 0, len(scans), 0))
                continue
            cam = made[0]
        more = ["--turn", str(90 * c["quarters"]), "--mirrored", str(c["mirrored"]).lower()]
        frames = run(args.program, scans, cam, os.path.join(args.dir, "out"), *more)
        right = wrong = doubtful = failed = 0
        worst, why = 0.0, ""
        for f in frames:
            truth, verdict = truths[os.path.basename(f["path"])], f["status"]["verdict"]
            if verdict == "ok":
                e = error_px(f, truth)
                worst = max(worst, e)
                ok = e < 1.0 + 15.0 / truth["pixel_um"]
                right, wrong = right + ok, wrong + (not ok)
            else:
                doubtful, failed = doubtful + (verdict == "doubtful"), failed + (verdict == "failed")
                why = why or "; ".join(f["status"]["reasons"])
        rows.append((case, len(frames), right, doubtful, failed, wrong))
        print(f"{case:28} {len(frames):3} {right:9} {doubtful:8} {failed:6} {wrong:9}  {worst:8.2f}  {why[:args.width]}", flush=True)
    print(f"{'all':28} " + " ".join(str(sum(r[k] for r in rows)) for k in range(1, 6)))
    if args.csv:
        with open(args.csv, "w") as out:
            out.write("case,frames,ok_right,doubtful,failed,ok_wrong\n" + "".join(",".join(map(str, r)) + "\n" for r in rows))


def wrong(args):
    """Every camera (of the program and of the cases) on every frame that is not its own."""
    listed = subprocess.run([args.program, "fiducials", "--list-cameras"], capture_output=True, text=True).stdout
    cameras = {line.split()[0]: line.split()[0] for line in listed.splitlines()}
    cases = [c for c in sorted(os.listdir(args.dir)) if c in (args.case or CASES)]
    for case in cases:
        cameras.setdefault("drawn " + (PLAIN | CASES[case])["kind"], os.path.join(args.dir, case, "camera.toml"))
    # A camera that is another's with other hundredths of a millimetre is no wrong one.
    same = {"cross": ("cross", "numeral", "rmk-cross"), "numeral": ("cross", "numeral", "rmk-cross"), "ring_cross": ("ring_cross",), "dot": ("dot",),
            "dot_ring": ("dot_ring", "corner-dot-ring"), "notch": ("notch", "side-notch"), "half_circle": ("arc-cross",), "wedge": ()}
    frames = {}
    for case in cases:
        kind = (PLAIN | CASES[case])["kind"]
        frames |= {os.path.join(args.dir, case, n): kind for n in json.load(open(os.path.join(args.dir, case, "truth.json")))}
    for path in args.photos or []:
        inside = glob.glob(os.path.join(path, "*")) if os.path.isdir(path) else [path]
        frames |= {p: "" for p in inside if p.lower().endswith((".jpg", ".jpeg", ".png", ".tif"))}
    n = ok = 0
    verdicts = {}
    for name, file in cameras.items():
        kind = name.removeprefix("drawn ")
        scans = [p for p, k in frames.items() if k != kind and kind not in same.get(k, ()) and not (kind in KINDS and KINDS[kind][1] == "learn")]
        # A run takes no two scans of one name.
        folders = {os.path.dirname(p): [q for q in scans if os.path.dirname(q) == os.path.dirname(p)] for p in scans}
        answers = [f for part in folders.values() for f in run(args.program, part, file, os.path.join(args.dir, "out"), "--turn", "0", "--mirrored", "false")]
        for f in answers:
            n += 1
            v = f["status"]["verdict"]
            verdicts[v] = verdicts.get(v, 0) + 1
            if v == "ok":
                ok += 1
                i = f["inner"]
                print(f"OK: {name} on {f['path']}: RMSE {i['rmse_um']:.0f} um, pixel {i['pixel_um']:.1f} um")
        print(f"{name:24} {len(scans)} frames; so far {n} pairs, {ok} OK, {verdicts}", flush=True)
    print(f"{n} wrong pairs of camera and frame, {ok} called OK; {verdicts}")


parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
jobs = parser.add_subparsers(required=True)
for name, do in (("draw", draw_all), ("judge", judge), ("wrong", wrong)):
    job = jobs.add_parser(name)
    job.set_defaults(do=do)
    job.add_argument("dir")
    job.add_argument("--case", nargs="*")
    if name == "draw":
        job.add_argument("--pixel-um", type=float, default=60.0)
        job.add_argument("--frames", type=int, default=6)
        job.add_argument("--seed", type=int, default=1)
    else:
        job.add_argument("program")
        job.add_argument("--csv")
        job.add_argument("--width", type=int, default=110)
        job.add_argument("--clicks", type=float, help="learn every camera from clicks that are so many pixels off")
        job.add_argument("--click-seed", type=int, default=5)
        job.add_argument("--photos", nargs="*")
if __name__ == "__main__":
    args = parser.parse_args()
    args.do(args)
