#!/usr/bin/env bash
# Appends measurements to benches/record/NAME.csv: `… | benches/record.sh NAME COMMAND`, each line of standard input `what;value;unit`.
# Date, machine and commit are added; a tree with changes that are not committed is marked with a plus.
set -euo pipefail
name=$1 command=$2
file=$(dirname "$0")/record/$name.csv
machine="$(nproc) cores, $(awk -F': ' '/^model name/{print $2; exit}' /proc/cpuinfo)"
commit=$(git -C "$(dirname "$0")" rev-parse --short HEAD)
[ -z "$(git -C "$(dirname "$0")" status --porcelain --untracked-files=no)" ] || commit+=+
[ -e "$file" ] || echo "date,machine,commit,command,what,value,unit" >"$file"
while IFS=';' read -r what value unit; do
  printf '%s,"%s",%s,"%s","%s",%s,%s\n' "$(date +%F)" "$machine" "$commit" "$command" "$what" "$value" "$unit" >>"$file"
done
