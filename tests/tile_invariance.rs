//! Any tiling, same answer (the first promise): tile size, thread count and layout never change a candidate by one bit.
//!
//! The oracle is one whole-raster tile on one thread.

use autoref_stream::candidate::Candidate;
use autoref_stream::coords::PixelPoint;
use autoref_stream::pipeline::{Detector, NoProgress, PlanOptions, plan, scan};
use autoref_stream::raster::memory::MemorySource;
use autoref_stream::raster::{Block, Patch, PixelRow, RasterSource, Samples};
use autoref_stream::segment::label::Region;
use autoref_stream::segment::mask::Mask;

/// The smallest detector that exercises every path: red paint, and an examination that looks beyond the region.
struct RedPaint;

impl Detector for RedPaint {
    fn halo_px(&self) -> u64 {
        0
    }
    fn segment(&self, block: &Block, mask: &mut Mask) {
        for piece in &block.pieces {
            for y in piece.window.y..piece.window.bottom() {
                let PixelRow { samples: Samples::U8(samples), pixel_stride, len } =
                    piece.row(piece.window.x, y, piece.window.width)
                else {
                    panic!("8-bit only")
                };
                for i in (0..len).filter(|i| samples[i * pixel_stride] > 200) {
                    mask.set(piece.window.x + i as u64, y, true);
                }
            }
        }
    }
    fn gate(&self, region: &Region) -> bool {
        region.area >= 3
    }
    fn patch_margin_px(&self) -> u64 {
        7
    }
    fn largest_mark_px(&self) -> u64 {
        60
    }
    fn examine(&self, region: &Region, patch: &Patch) -> Option<Candidate> {
        // Depends on every pixel of the patch, so that a patch cut differently shows.
        let ring: f64 = patch.rgb.iter().enumerate().map(|(i, p)| (i % 31) as f64 * f64::from(p[1])).sum();
        Some(Candidate {
            centre: PixelPoint {
                x: region.sum_x as f64 / region.area as f64 + 0.5,
                y: region.sum_y as f64 / region.area as f64 + 0.5,
            },
            covariance_px2: None,
            score: Some(ring / patch.rgb.len() as f64),
            area_px: Some(region.area as f64),
            size_px: Some([region.bounds.width as f64, region.bounds.height as f64]),
            elevation_m: None,
        })
    }
}

fn picture(width: u64, height: u64) -> MemorySource {
    let mut state = 7u64;
    let mut rgb = Vec::new();
    for _ in 0..width * height {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        let red = if (state >> 40).is_multiple_of(5) { 220 } else { 40 };
        rgb.extend([red, (state >> 48) as u8, (state >> 56) as u8]);
    }
    // Marks on purpose across edges and corners of 64-px and 100-px tiles, and one region as large as the picture.
    for (cx, cy) in [(64, 64), (100, 100), (128, 40), (200, 200), (3, 3), (width - 2, height - 2)] {
        for y in cy - cy.min(5)..(cy + 5).min(height) {
            for x in cx - cx.min(5)..(cx + 5).min(width) {
                rgb[((y * width + x) * 3) as usize] = 255;
            }
        }
    }
    MemorySource::rgb8(width, height, rgb)
}

fn candidates(source: &MemorySource, tile_px: u64, threads: usize) -> Vec<Candidate> {
    let options = PlanOptions {
        tile_px: Some(tile_px),
        threads,
        memory_budget_bytes: 512 << 20,
        baseline_bytes: 0,
        cache_bytes: 0,
    };
    let mut plan = plan(source.info(), RedPaint.halo_px(), &options).expect("a small picture fits");
    // The memory raster calls itself strips; square tiles are the harder case.
    plan.grid = autoref_stream::window::TileGrid::new(source.info().width, source.info().height, tile_px, tile_px, 0);
    scan(source, &plan, &RedPaint, &NoProgress).expect("memory can be read").candidates
}

#[test]
fn tiles_and_threads_do_not_change_a_candidate() {
    let source = picture(333, 257);
    let whole = candidates(&source, 1000, 1);
    assert!(whole.len() > 500, "{} candidates", whole.len());
    for tile in [16, 64, 100, 255, 256] {
        for threads in [1, 2, 5] {
            assert_eq!(whole, candidates(&source, tile, threads), "tile {tile}, {threads} threads");
        }
    }
}

mod files {
    //! The same promise for files: layout, lossless compression and reader change nothing either.

    use std::path::Path;

    use autoref_stream::georef::candidate_list;
    use autoref_stream::pipeline::{Detector, NoProgress, PaintDetector, PlanOptions, plan, scan};
    use autoref_stream::profile::Profile;
    use autoref_stream::raster::{self, ReaderChoice};
    use autoref_stream::synth::{self, Compression, FileLayout, MarkSize, MarkStyle, Output, SynthSpec};

    fn spec(layout: FileLayout, compression: Compression, size: (u64, u64)) -> SynthSpec {
        SynthSpec {
            gcps: synth::random_gcps(9, size.0 as f64 * 0.03, size.1 as f64 * 0.03, 5),
            size_px: Some(size),
            straddle_px: Some(256),
            clutter: 30,
            mark: MarkStyle { size: MarkSize::Px(14.0), ..MarkStyle::default() },
            output: Output { layout, compression, predictor: true, ..Output::default() },
            ..SynthSpec::default()
        }
    }

    fn list(path: &Path, reader: ReaderChoice, tile_px: Option<u64>, threads: usize) -> Vec<u8> {
        let cache_bytes = 16 << 20;
        let source = raster::open(path, reader, 0, cache_bytes).expect("a sample that was just written");
        let profile = Profile::builtin("orange").expect("the default profile");
        let detector = PaintDetector::new(profile, source.info(), None).expect("a sound profile");
        let options =
            PlanOptions { tile_px, threads, memory_budget_bytes: 512 << 20, baseline_bytes: 64 << 20, cache_bytes };
        let plan = plan(source.info(), detector.halo_px(), &options).expect("a small image fits");
        let found = scan(source.as_ref(), &plan, &detector, &NoProgress).expect("a whole file");
        let mut text = Vec::new();
        candidate_list::write_csv(&found.candidates, &mut text).expect("memory takes all");
        text
    }

    #[test]
    fn layouts_codecs_and_readers_do_not_change_a_byte() {
        let large = std::env::var_os("AUTOREF_LARGE").is_some();
        let size = if large { (3001, 2003) } else { (1301, 707) };
        let folder = tempfile::tempdir().expect("a temporary folder");
        let mut expected: Option<Vec<u8>> = None;
        let layouts = [FileLayout::Tiles(256), FileLayout::Strips(7)];
        let codecs = [Compression::None, Compression::Deflate, Compression::Lzw, Compression::Zstd];
        for (i, (layout, codec)) in
            layouts.into_iter().flat_map(|l| codecs.into_iter().map(move |c| (l, c))).enumerate()
        {
            let path = folder.path().join(format!("{i}.tif"));
            synth::write(&spec(layout, codec, size), &path).expect("a sample");
            for reader in [ReaderChoice::Native, ReaderChoice::Gdal] {
                for (tile, threads) in
                    [(Some(100_000), 1), (Some(256), 1), (Some(256), 2), (Some(1000), 2), (Some(4096), 2), (None, 2)]
                {
                    let found = list(&path, reader, tile, threads);
                    let oracle = expected.get_or_insert_with(|| found.clone());
                    assert!(oracle.len() > 400, "only {} bytes of candidates", oracle.len());
                    assert!(
                        *oracle == found,
                        "layout and codec {i}, {reader:?}, tile {tile:?}, {threads} threads differ"
                    );
                }
            }
        }
    }

    #[test]
    fn jpeg_does_not_depend_on_the_tiling() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("a.tif");
        synth::write(&spec(FileLayout::Tiles(256), Compression::Jpeg(90), (1301, 707)), &path).expect("a sample");
        for reader in [ReaderChoice::Native, ReaderChoice::Gdal] {
            let whole = list(&path, reader, Some(100_000), 1);
            for (tile, threads) in [(Some(256), 2), (Some(1000), 1), (None, 2)] {
                assert!(whole == list(&path, reader, tile, threads), "{reader:?}, tile {tile:?}");
            }
        }
    }
}
