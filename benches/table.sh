#!/usr/bin/env bash
# A line a stage from criterion's bencher output on standard input: name, milliseconds, and how far the runs differ. The same goes to
# benches/record/stages.csv.
set -euo pipefail
here=$(dirname "$0")
printf '%-60s %12s %10s\n' "stage" "ms" "± ms"
awk '/^test .* bench:/ {
  name = $2; for (i = 3; $i != "...";) name = name " " $(i++)
  for (i = 1; i <= NF; i++) if ($i == "bench:") { time = $(i + 1); for (j = i; j <= NF; j++) if ($j == "(+/-") spread = $(j + 1) }
  gsub(",", "", time); gsub(/[,)]/, "", spread)
  printf "%s;%.3f;%.3f\n", name, time / 1e6, spread / 1e6
}' | tee >(awk -F';' '{ print $1 ";" $2 ";ms" }' | "$here/record.sh" stages "cargo bench -p autoref-benches --bench stages") |
  awk -F';' '{ printf "%-60s %12s %10s\n", $1, $2, $3 }'
