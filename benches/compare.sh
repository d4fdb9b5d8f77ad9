#!/usr/bin/env bash
# Whole programs side by side in one run: ours (the whole job, without the HTML report), GDAL only reading, the codec alone, cat.
#
#   benches/compare.sh [FOLDER]          warm: five layouts of the Lerkendal-size sample
#   benches/compare.sh --python [FOLDER] the uncompressed sample also beside scikit-image and libvips
#   benches/compare.sh --cold FILE LIST  a file larger than memory, or not in the page cache, beside direct `dd`
#
# The sample (22,039 × 20,051 px, 20 marks) is made in FOLDER (default: a temporary one, deleted again); photographs from
# ../shared/data when there, else the drawn landscape. The programs take turns, five rounds, and the best of each counts:
# wall seconds, and processor milliseconds for machines on which other work runs. --python wants an interpreter with
# numpy, scikit-image, tifffile and pyvips in AUTOREF_BENCH_PYTHON. The warm rounds go to benches/record/whole-job.csv.
set -euo pipefail
cd "$(dirname "$0")/.."
mode=warm
case ${1:-} in --python | --cold) mode=${1#--}; shift ;; esac
[ -n "${AUTOREF_BENCH_BUILT:-}" ] || cargo build --release --quiet -p autoref-tools -p autoref-program
bin=target/release
rounds=${AUTOREF_BENCH_ROUNDS:-5}

timed() { # appends "wall_s cpu_ms" of a command to a file
  local to=$1; shift
  local TIMEFORMAT='%R %U %S'
  # A host may take page cache back within seconds.
  [ "$mode" = cold ] || cat "$file" >/dev/null
  { time "$@" >/dev/null 2>&1 || echo "failed: $*" >&3; } 3>&2 2>>"$to"
}
least() { awk -v c="$2" 'NF==3{v=(c==1)?$1:1000*($2+$3); if(n++==0||v<m)m=v} END{printf (c==1)?"%.3f":"%d", m}' "$1"; }
ratio() { awk "BEGIN{printf \"%.2f\", $1/$2}"; }
ours() { "$bin/autoref-stream" "$1" --gcps "$2" --overwrite --quiet --no-report; }

if [ "$mode" = cold ]; then
  file=$1 list=$2; times=$(mktemp -d); trap 'rm -rf "$times"' EXIT
  forget() { dd if="$file" iflag=nocache count=0 status=none; sync; }
  for _ in $(seq "${AUTOREF_BENCH_ROUNDS:-2}"); do
    forget; timed "$times/dd" dd if="$file" of=/dev/null bs=8M iflag=direct
    forget; timed "$times/ours" ours "$file" "$list"
  done
  peak=$(awk -F'[ ,]+' '/"peak_memory_bytes"/{printf "%d", $3/1048576}' "${file%.*}.autoref.json")
  printf 'cold: ours %s s, direct dd %s s, ratio %s, peak %s MiB\n' "$(least "$times/ours" 1)" "$(least "$times/dd" 1)" \
    "$(ratio "$(least "$times/ours" 1)" "$(least "$times/dd" 1)")" "$peak"
  exit
fi

folder=${1:-$(mktemp -d)}
[ $# -gt 0 ] || trap 'rm -rf "$folder"' EXIT
photos=(); [ -d ../shared/data/photos ] && photos=(--photos ../shared/data/photos)
make_sample() { # name, options…
  local name=$1; shift
  [ -e "$folder/$name.tif" ] || "$bin/autoref-stream" synth "$folder/$name.tif" --random-gcps 20 --extent-m 600,550 --size 22039,20051 \
    --gsd 0.032 --rotation -0.026 --mark-size 20 --seed 3 "${photos[@]}" --write-gcps "$folder/$name.geojson" "$@" >/dev/null
}

if [ "$mode" = python ]; then
  make_sample none_tiles512 --compress none --tiles 512
  python=${AUTOREF_BENCH_PYTHON:?an interpreter with numpy, scikit-image, tifffile and pyvips}
  times=$(mktemp -d); file=$folder/none_tiles512.tif
  for _ in 1 2; do
    timed "$times/ours" ours "$file" "$folder/none_tiles512.geojson"
    timed "$times/scikit" "$python" benches/scikit_pipeline.py "$file"
    timed "$times/vips_box" "$python" benches/vips_pipeline.py box "$file"
    timed "$times/vips_lab" "$python" benches/vips_pipeline.py lab "$file"
  done
  for program in scikit vips_box vips_lab; do
    printf '%-9s %8s s, %s x ours (%s s)\n' $program "$(least "$times/$program" 1)" \
      "$(ratio "$(least "$times/$program" 1)" "$(least "$times/ours" 1)")" "$(least "$times/ours" 1)"
  done
  rm -r "$times"; exit
fi

printf '%-17s %6s %6s %6s %6s %6s | %6s %7s %6s | %5s %5s %6s %5s | %s\n' layout ours gdal2 gdal1 codec2 cat ours/g ours/c ours/cat \
  ours gdal2 codec2 cat peak_MiB
while read -r name options; do
  # shellcheck disable=SC2086
  make_sample "$name" $options
  file=$folder/$name.tif times=$(mktemp -d)
  for _ in $(seq "$rounds"); do
    timed "$times/ours" ours "$file" "$folder/$name.geojson"
    timed "$times/gdal2" "$bin/gdal_touch" "$file" 2
    timed "$times/codec2" "$bin/codec_floor" "$file" 2
    timed "$times/cat" cat "$file"
  done
  timed "$times/gdal1" "$bin/gdal_touch" "$file" 1
  wall() { least "$times/$1" 1; }
  peak=$(awk -F'[ ,]+' '/"peak_memory_bytes"/{printf "%d", $3/1048576}' "$folder/$name.autoref.json")
  printf '%-17s %6s %6s %6s %6s %6s | %6s %7s %8s | %5s %5s %6s %5s | %s\n' "$name" \
    "$(wall ours)" "$(wall gdal2)" "$(wall gdal1)" "$(wall codec2)" "$(wall cat)" "$(ratio "$(wall ours)" "$(wall gdal2)")" \
    "$(ratio "$(wall ours)" "$(wall codec2)")" "$(ratio "$(wall ours)" "$(wall cat)")" \
    "$(least "$times/ours" 2)" "$(least "$times/gdal2" 2)" "$(least "$times/codec2" 2)" "$(least "$times/cat" 2)" "$peak"
  {
    for program in ours gdal2 gdal1 codec2 cat; do
      printf '%s %s wall;%s;s\n%s %s processor;%s;ms\n' "$name" $program "$(wall $program)" "$name" $program "$(least "$times/$program" 2)"
    done
    printf '%s ours peak;%s;MiB\n' "$name" "$peak"
  } | benches/record.sh whole-job "benches/compare.sh, least of $rounds"
  rm -r "$times"
done <<'LAYOUTS'
none_tiles512 --compress none --tiles 512
deflate_tiles512 --compress deflate --predictor --tiles 512
jpeg_tiles512 --compress jpeg --quality 90 --tiles 512
zstd_tiles256 --compress zstd --predictor --tiles 256
lzw_strips1 --compress lzw --predictor --strips 1
LAYOUTS
