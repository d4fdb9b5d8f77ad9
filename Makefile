# make demo          installs what is missing, builds, makes a sample and runs the main job on it
# make test          everything needed to pass the whole test suite
# make check         what CI runs: formatting, lints, documentation, tests; and `make deny`
# make deny          licences, sources and duplicates of all dependencies (cargo-deny)
# make sbom          target/autoref-stream.cdx.json: what a release is made of (cargo-cyclonedx)
# make bench         stage by stage and against other programs (minutes)
# make fixtures      draws the small images of fixtures/ anew
# make fuzz          ten minutes of a parser under cargo-fuzz (needs a nightly toolchain): fuzz/README.md
# make check-large   the checks that take minutes or gigabytes
SHELL := /bin/bash
CARGO ?= cargo
SUDO := $(shell [ "$$(id -u)" = 0 ] || echo sudo)
PACKAGES := libgdal-dev gdal-bin pkg-config gcc g++ time
# For the tests that open pages; without it they are skipped with a message.
TEST_PACKAGES := chromium
MISSING = $(shell for p in $(PACKAGES); do dpkg-query -W -f='$${Status}' $$p 2>/dev/null | grep -q '^install ok installed' || echo $$p; done)
DEMO := demo
# Python with other programs' libraries, for the tests that compare with them.
PEERS := target/peers
# Odd, old and corrupt TIFFs to begin with, where they are there; the other parsers begin with what fuzz/seeds.py writes.
FUZZ_SEEDS = $(if $(filter native_tiff,$(TARGET)),$(wildcard $(addprefix $(CURDIR)/../shared/data/tiff/,image-tiff twelvemonkeys rio)))

.PHONY: all fixtures deps test-deps build demo compile test check lint doc deny sbom bench fuzz check-large clean

all: build

deps:
	@missing="$(MISSING)"; if [ -n "$$missing" ]; then \
	  echo "Will install with apt-get: $$missing"; \
	  $(SUDO) apt-get update -qq && DEBIAN_FRONTEND=noninteractive $(SUDO) apt-get install -y -qq $$missing >/dev/null; \
	else echo "Nothing to install: $(PACKAGES) are there."; fi

test-deps:
	@command -v chromium chromium-browser google-chrome >/dev/null || { echo "Will install with apt-get: $(TEST_PACKAGES)"; \
	  { $(SUDO) apt-get update -qq && DEBIAN_FRONTEND=noninteractive timeout 300 $(SUDO) apt-get install -y -qq \
	    --no-install-recommends $(TEST_PACKAGES) >/dev/null; } || echo "No browser: the tests that open pages are skipped."; }
	@command -v strace >/dev/null || { echo "Will install with apt-get: strace"; \
	  { $(SUDO) apt-get update -qq && DEBIAN_FRONTEND=noninteractive timeout 120 $(SUDO) apt-get install -y -qq \
	    --no-install-recommends strace >/dev/null; } || echo "No strace: the tests of system calls are skipped."; }
	@command -v colmap >/dev/null || { echo "Will install with apt-get: colmap"; \
	  { $(SUDO) apt-get update -qq && DEBIAN_FRONTEND=noninteractive timeout 600 $(SUDO) apt-get install -y -qq \
	    --no-install-recommends colmap >/dev/null; } || echo "No colmap: the test that solves a flight is skipped."; }
	@$(PEERS)/bin/python -c "import rasterio, jsonschema" 2>/dev/null || { echo "Will install with pip, under $(PEERS): rasterio, rio-cogeo, jsonschema"; \
	  { python3 -m venv $(PEERS) && timeout 300 $(PEERS)/bin/python -m pip install -q --timeout 15 --retries 1 rasterio rio-cogeo jsonschema; } \
	    >/dev/null 2>&1 || echo "No rasterio, no jsonschema: the tests that need them are skipped."; }

build: deps
	$(CARGO) build --release

demo: build
	@rm -rf $(DEMO) && mkdir -p $(DEMO)
	target/release/autoref-stream synth $(DEMO)/e6.tif --random-gcps 14 --visible 11 --extent-m 160,120 --size 6000,4500 \
	  --gsd 0.03 --rotation 12 --mark-size 12 --clutter 60 --seed 6 --compress deflate --predictor \
	  --write-gcps $(DEMO)/e6.geojson
	target/release/autoref-stream $(DEMO)/e6.tif --gcps $(DEMO)/e6.geojson --tile 4096
	@echo "--- GDAL sees:" && gdalinfo $(DEMO)/e6.tif | grep -E "^Size|UTM zone|GeoTransform|^  +-?[0-9]" | head -5

# Draws fixtures/ anew (a test compares).
fixtures: build
	fixtures/make.sh target/release/autoref-stream fixtures

# The system's libzstd, which GDAL's packages bring, saves a compilation; a release is built with its own.
lint doc compile test: export ZSTD_SYS_USE_PKG_CONFIG ?= 1

# What the tests need beside the program is installed while they are compiled.
compile: deps
	@mkdir -p target
	@$(MAKE) --no-print-directory test-deps & \
	if $(CARGO) nextest --version >/dev/null 2>&1; then \
	  set -x; $(CARGO) nextest run --features coded --no-run; \
	else set -x; $(CARGO) test --quiet --features coded --no-run; fi; \
	compiled=$$?; wait; exit $$compiled

# The random tests draw the same cases in every run; `make check-large` draws new ones. What was skipped is told at the end:
# tests say so in the file of AUTOREF_SKIPPED.
test: export PROPTEST_RNG_SEED ?= 2016
test: export AUTOREF_SKIPPED := $(CURDIR)/target/skipped.txt
test: export AUTOREF_PYTHON ?= $(CURDIR)/$(PEERS)/bin/python
test: compile
	@rm -f $(AUTOREF_SKIPPED)
	@if $(CARGO) nextest --version >/dev/null 2>&1; then \
	  set -ex; $(CARGO) nextest run --features coded --no-fail-fast --status-level slow --final-status-level slow --show-progress none; \
	  $(CARGO) test --quiet --features coded --doc -- --format=terse; \
	else set -ex; $(CARGO) test --quiet --features coded -- --format=terse; fi
	AUTOREF_KERNELS=scalar $(CARGO) test --quiet --features coded --lib -- --format=terse segment
	@if [ -s $(AUTOREF_SKIPPED) ]; then \
	  echo "Skipped, whole or in part: $$(cut -f1 $(AUTOREF_SKIPPED) | sort -u | wc -l) tests; why, and how often:"; \
	  cut -f2 $(AUTOREF_SKIPPED) | sort | uniq -c | sort -rn; \
	else echo "No test was skipped."; fi

lint: deps
	$(CARGO) fmt --check
	$(CARGO) clippy --workspace --all-targets --features coded -- -D warnings

doc: deps
	RUSTDOCFLAGS="-D warnings" $(CARGO) doc --workspace --no-deps --features coded

check: lint doc deny test

# The advisories of RustSec are fetched by cargo-deny itself, where that can be done.
deny:
	@if $(CARGO) deny --version >/dev/null 2>&1; then \
	  $(CARGO) deny --workspace check --hide-inclusion-graph licenses bans sources && \
	  { $(CARGO) deny --workspace fetch db >/dev/null 2>&1 || { echo "The database of advisories cannot be reached: not looked at."; exit 0; } && \
	    $(CARGO) deny --workspace check --hide-inclusion-graph advisories; }; \
	else echo "No cargo-deny (cargo install cargo-deny): dependencies are not looked at."; fi

sbom: deps
	@$(CARGO) cyclonedx --version >/dev/null 2>&1 || { echo "cargo install cargo-cyclonedx first"; exit 1; }
	$(CARGO) cyclonedx --quiet --format json --features coded --manifest-path crates/program/Cargo.toml --override-filename autoref-stream.cdx
	@mkdir -p target
	sed 's|$(CURDIR)||g' crates/program/autoref-stream.cdx.json >target/autoref-stream.cdx.json
	@# It writes one for every crate of the house.
	@rm -f autoref-stream.cdx.json {tools,benches,crates/*}/autoref-stream.cdx.json

bench: build
	$(CARGO) bench -p autoref-benches --bench stages -- --output-format bencher | benches/table.sh
	$(CARGO) bench -p autoref-benches --bench decode --bench detection
	benches/compare.sh

# `make fuzz TARGET=native_tiff SECONDS=600`. Leaks are not looked for: GDAL's binding keeps a CRS that it cannot read.
TARGET ?= native_tiff
SECONDS ?= 600
fuzz:
	mkdir -p fuzz/corpus/$(TARGET)
	python3 fuzz/seeds.py $(TARGET) fuzz/corpus/$(TARGET)
	cd fuzz && ASAN_OPTIONS=detect_leaks=0 $(CARGO) +nightly fuzz run $(TARGET) corpus/$(TARGET) $(FUZZ_SEEDS) -- -max_total_time=$(SECONDS) -rss_limit_mb=1024 -timeout=10 -detect_leaks=0

check-large: export AUTOREF_PYTHON ?= $(CURDIR)/$(PEERS)/bin/python
check-large: build
	@$(PEERS)/bin/python -c "import pycolmap" 2>/dev/null || $(PEERS)/bin/python -m pip install -q pycolmap || echo "No pycolmap: its test is skipped."
	AUTOREF_LARGE=1 $(CARGO) test --release --features coded -- --nocapture

clean:
	$(CARGO) clean
	rm -rf $(DEMO)
