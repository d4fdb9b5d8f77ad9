#!/usr/bin/env python3
"""Plants one error in every room, one after the other, and runs the room's tests: each of them must fail.

tools/mutations.py [WORD]   only those whose name contains WORD

Works in a copy of the tree under a temporary folder; builds go to CARGO_TARGET_DIR or to target/mutations.
"""

import os
import pathlib
import shutil
import subprocess
import sys
import tempfile

# Name, file, what stands there, what is put in its place, the tests that must notice.
CORE = ["-p", "autoref-stream"]
PROGRAM = ["-p", "autoref-program", "--features", "coded", "--test", "program", "--"]
MUTATIONS = [
    ("raster: a window grows to one side only", "crates/raster/src/window.rs",
     "self.right().saturating_add(margin_px)", "self.right()", CORE + ["--test", "core", "--", "tile_invariance::"]),
    ("segment: rows of a region are joined one pixel apart", "src/merge.rs",
     "one[start].end < run.start", "one[start].end <= run.start", CORE + ["--lib", "merge::"]),
    ("candidate: scatter of neighbours is half", "src/candidate/fit.rs",
     "const REACH: i64 = 4;", "const REACH: i64 = 1;", CORE + ["--lib", "candidate::"]),
    ("matching: hits count once", "src/matching/evidence.rs",
     "state[hits] += state[hits - 1] * p;", "state[hits] = state[hits - 1] * p;", CORE + ["--lib", "matching::"]),
    ("solve: y downwards in the fit", "crates/solve/src/similarity.rs",
     "upright(pair.pixel.x - centre.x, pair.pixel.y - centre.y, mirrored);", "upright(pair.pixel.x - centre.x, centre.y - pair.pixel.y, mirrored);",
     ["-p", "autoref-solve", "--lib"]),
    ("gcp: titles of longitude and latitude exchanged", "src/gcp/csv_list.rs",
     "pair(LONGITUDES, LATITUDES)", "pair(LATITUDES, LONGITUDES)", CORE + ["--test", "core", "--", "gcp_lists::"]),
    ("georef: a world file of corners", "src/georef/sidecar.rs",
     "g[0] + (g[1] + g[2]) / 2.0", "g[0]", CORE + ["--lib", "georef::"]),
    ("replay: a rejected mark stays", "src/replay.rs",
     "held.used = false;", "held.used = true;", CORE + ["--lib", "replay::"]),
    ("film: residuals ten times too small", "crates/film/src/interior.rs",
     "[1e3 * (at[0] - mm[0]), 1e3 * (at[1] - mm[1])]", "[1e2 * (at[0] - mm[0]), 1e2 * (at[1] - mm[1])]",
     ["-p", "autoref-film", "--lib"]),
    ("terrain: a closing that only dilates", "crates/terrain/src/morphology.rs",
     "erode(dilated, kernel)", "dilated", ["-p", "autoref-terrain"]),
    ("cloud: a threshold below the mean", "crates/cloud/src/outliers.rs",
     "mean + multiplier * deviation", "mean - multiplier * deviation", ["-p", "autoref-cloud"]),
    ("elevation: aspects point uphill", "crates/elevation/src/gradient.rs",
     "(-east).atan2(-north).to_degrees()", "east.atan2(north).to_degrees()", ["-p", "autoref-elevation"]),
    ("flight: a camera that squints", "crates/flight/src/camera.rs",
     "(point[0] / point[2], point[1] / point[2])", "(point[0] / point[2], point[1] / point[0])", ["-p", "autoref-flight"]),
    ("review: every schema is taken", "crates/review/src/patch_file.rs",
     "if patch.schema != SCHEMA || patch.schema_version != SCHEMA_VERSION {", "if false {", ["-p", "autoref-review"]),
    ("synth: noise without a seed", "crates/synth/src/rng.rs",
     "mix(seed ^ (x as u64)", "mix((x as u64)", ["-p", "autoref-synth", "--lib"]),
    ("program: a refusal exits with 0", "crates/program/src/cli/document.rs",
     "Status::Refused => ExitCode::from(1)", "Status::Refused => ExitCode::SUCCESS", PROGRAM + ["main_job::"]),
]


def main():
    top = pathlib.Path(__file__).resolve().parent.parent
    word = sys.argv[1] if len(sys.argv) > 1 else ""
    for name, path, before, _, _ in MUTATIONS:
        if (stands := (top / path).read_text(encoding="utf-8").count(before)) != 1:
            sys.exit(f"{name}: `{before}` stands {stands} times in {path}: mend tools/mutations.py")
    environment = {**os.environ, "CARGO_INCREMENTAL": "0"}
    environment.setdefault("CARGO_TARGET_DIR", str(top / "target/mutations"))
    survived = []
    with tempfile.TemporaryDirectory() as scratch:
        tree = pathlib.Path(scratch) / "tree"
        subprocess.run(["git", "-C", str(top), "worktree", "add", "--detach", str(tree)], check=True, capture_output=True)
        shared = top.parent / "shared"
        if shared.exists():
            (tree.parent / "shared").symlink_to(shared)
        try:
            for name, path, before, after, tests in MUTATIONS:
                if word not in name:
                    continue
                file = tree / path
                text = file.read_text(encoding="utf-8")
                file.write_text(text.replace(before, after), encoding="utf-8")
                ran = subprocess.run(["cargo", "test", "--quiet", *tests], cwd=tree, env=environment, capture_output=True, text=True)
                broken = "could not compile" in ran.stderr
                noticed = ran.returncode != 0 and not broken
                print(f"{'noticed' if noticed else 'BROKEN' if broken else 'SURVIVED':<9} {name}", flush=True)
                if not noticed:
                    survived.append(name)
                file.write_text(text, encoding="utf-8")
        finally:
            subprocess.run(["git", "-C", str(top), "worktree", "remove", "--force", str(tree)], capture_output=True)
            shutil.rmtree(tree, ignore_errors=True)
    sys.exit(f"{len(survived)} went unnoticed" if survived else 0)


main()
