#!/usr/bin/env python3
"""`dem align` and `dem compare` beside xDEM, by turns: wall and processor time, peak memory.

    benches/xdem_pair.py EXE A.tif B.tif [--memory 512M] [--rounds 2]

xDEM runs in a process of its own for each job. Its `compare` is the difference on B's grid, slope and aspect, mean, standard
deviation, median and NMAD of all cells and by class of slope and aspect: no variogram, no page. Wants xdem.
Prints one CSV row a job: program, job, wall s, processor s, peak MB, exit code.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time

ALIGN = """
import sys, xdem
a, b = xdem.DEM(sys.argv[1]), xdem.DEM(sys.argv[2])
out = xdem.coreg.{}().fit(b, a).apply(a)
out.to_file(sys.argv[3] + "/aligned.tif") if hasattr(out, "to_file") else out.save(sys.argv[3] + "/aligned.tif")
"""
COMPARE = """
import sys, numpy as np, xdem
a, b = xdem.DEM(sys.argv[1]), xdem.DEM(sys.argv[2])
d = a - b
slope, aspect = b.slope(), b.aspect()
v = d.data.filled(np.nan).squeeze()
nmad = lambda x: 1.4826 * np.nanmedian(np.abs(x - np.nanmedian(x)))
print(np.nanmean(v), np.nanstd(v), np.nanmedian(v), nmad(v))
for by, edges in ((slope, [0, 5, 10, 20, 30, 40, 90]), (aspect, range(0, 361, 45))):
    w = by.data.filled(np.nan).squeeze()
    for low, high in zip(edges, list(edges)[1:]):
        c = v[(w >= low) & (w < high)]
        if c.size:
            print(low, c.size, np.nanmean(c), np.nanstd(c), np.nanmedian(c), nmad(c))
(d.to_file if hasattr(d, "to_file") else d.save)(sys.argv[3] + "/difference.tif")
"""


def run(name, job, command):
    began = time.time()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    text = process.stderr.read()
    _, status, usage = os.wait4(process.pid, 0)
    code = status >> 8 or status & 127
    seconds = usage.ru_utime + usage.ru_stime
    print(f"{name},{job},{time.time() - began:.1f},{seconds:.1f},{usage.ru_maxrss // 1024},{code}", flush=True)
    if code:
        print("#", text.strip().splitlines()[-1][:200] if text.strip() else "no message", flush=True)


words = argparse.ArgumentParser()
words.add_argument("exe")
words.add_argument("a")
words.add_argument("b")
words.add_argument("--memory", default="512M")
words.add_argument("--rounds", type=int, default=2)
words.add_argument("--jobs", default="nuth-kaab,lzd,compare")
args = words.parse_args()
print("program,job,wall_s,processor_s,peak_mb,exit")
methods = {"nuth-kaab": "NuthKaab", "lzd": "LZD"}
for _ in range(args.rounds):
    for job in args.jobs.split(","):
        with tempfile.TemporaryDirectory() as folder:
            limits = ["--memory", args.memory, "--overwrite"]
            if job == "compare":
                ours = ["dem", "compare", args.a, args.b, "-o", folder, *limits]
                theirs = COMPARE
            else:
                ours = ["dem", "align", args.a, "--to", args.b, "--method", job, "-o", folder + "/o.tif", *limits]
                theirs = ALIGN.format(methods[job])
            run("autoref-stream", job, [args.exe, *ours])
            run("xDEM", job, [sys.executable, "-c", theirs, args.a, args.b, folder])
