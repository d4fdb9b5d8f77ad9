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
        let red = if (state >> 40) % 5 == 0 { 220 } else { 40 };
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
