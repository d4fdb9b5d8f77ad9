#!/usr/bin/env bash
# A line a stage from criterion's bencher output on standard input: name, milliseconds, and how far the runs differ.
set -euo pipefail
printf '%-60s %12s %10s\n' "stage" "ms" "± ms"
awk '/^test .* bench:/ {
  name = $2; for (i = 3; $i != "...";) name = name " " $(i++)
  for (i = 1; i <= NF; i++) if ($i == "bench:") { time = $(i + 1); for (j = i; j <= NF; j++) if ($j == "(+/-") spread = $(j + 1) }
  gsub(",", "", time); gsub(/[,)]/, "", spread)
  printf "%-60s %12.3f %10.3f\n", name, time / 1e6, spread / 1e6
}'
