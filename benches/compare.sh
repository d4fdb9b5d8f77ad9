#!/usr/bin/env bash
# Whole programs side by side in one run, warm: ours (the whole job), GDAL only reading, the codec alone, cat.
#
#   benches/compare.sh [FOLDER]
#
# The Lerkendal-size sample (22,039 × 20,051 px, 20 marks) is made in FOLDER (default: a temporary one, deleted again) in
# five layouts; photographs from ../shared/data when there, else the drawn landscape. Best of five of each program.
set -euo pipefail
cd "$(dirname "$0")/.."
folder=${1:-$(mktemp -d)}
[ $# -gt 0 ] || trap 'rm -rf "$folder"' EXIT
cargo build --release --quiet --example gdal_touch --example codec_floor --bin autoref-stream
bin=target/release
photos=(); [ -d ../shared/data/photos ] && photos=(--photos ../shared/data/photos)

best() { # seconds of the fastest of five runs
  local least=999999
  for _ in 1 2 3 4 5; do
    local start end ns; start=$(date +%s%N); "$@" >/dev/null 2>&1 || { echo "failed: $*" >&2; return 1; }
    end=$(date +%s%N); ns=$(((end - start) / 1000000)); [ "$ns" -lt "$least" ] && least=$ns
  done
  awk "BEGIN{printf \"%.3f\", $least/1000}"
}

make_sample() { # name, options…
  local name=$1; shift
  [ -e "$folder/$name.tif" ] || "$bin/autoref-stream" synth "$folder/$name.tif" --random-gcps 20 --extent-m 600,550 --size 22039,20051 \
    --gsd 0.032 --rotation -0.026 --mark-size 20 --seed 3 "${photos[@]}" --write-gcps "$folder/$name.geojson" "$@" >/dev/null
}

printf '%-22s %8s %8s %8s %8s %8s %8s %8s\n' layout ours gdal2 codec2 cat ours/gdal ours/codec peak_MiB
while read -r name options; do
  # shellcheck disable=SC2086
  make_sample "$name" $options
  file=$folder/$name.tif
  cat "$file" >/dev/null
  ours=$(best "$bin/autoref-stream" "$file" --gcps "$folder/$name.geojson" --overwrite --quiet)
  gdal=$(best "$bin/examples/gdal_touch" "$file" 2)
  codec=$(best "$bin/examples/codec_floor" "$file" 2)
  plain=$(best cat "$file")
  peak=$(awk -F'[ ,]+' '/"peak_memory_bytes"/{printf "%d", $3/1048576}' "$folder/$name.autoref.json")
  printf '%-22s %8s %8s %8s %8s %8s %8s %8s\n' "$name" "$ours" "$gdal" "$codec" "$plain" \
    "$(awk "BEGIN{printf \"%.2f\", $ours/$gdal}")" "$(awk "BEGIN{printf \"%.2f\", $ours/$codec}")" "$peak"
done <<'LAYOUTS'
none_tiles512 --compress none --tiles 512
deflate_tiles512 --compress deflate --predictor --tiles 512
jpeg_tiles512 --compress jpeg --quality 90 --tiles 512
zstd_tiles256 --compress zstd --predictor --tiles 256
lzw_strips1 --compress lzw --predictor --strips 1
LAYOUTS
