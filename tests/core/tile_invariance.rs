//! Any tiling, same answer (the first promise): tile size, thread count and layout never change a candidate by one bit.
//!
//! The oracle is one whole-raster tile on one thread.

use autoref_raster::coords::PixelPoint;
use autoref_raster::mask::Mask;
use autoref_raster::memory::MemorySource;
use autoref_raster::memory_plan::PlanOptions;
use autoref_raster::memory_plan::plan;
use autoref_raster::{Block, PixelRow, Pixels, RasterSource, Samples};
use autoref_stream::candidate::Candidate;
use autoref_stream::detector::Detector;
use autoref_stream::pipeline::{NoProgress, scan};
use autoref_stream::segment::label::Region;

/// The smallest detector that exercises every path: red paint, and an examination that looks beyond the region.
struct RedPaint;

impl Detector for RedPaint {
    fn halo_px(&self) -> u64 {
        0
    }
    fn segment_block(&self, block: &Block, mask: &mut Mask) {
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
    fn examine(&self, region: &Region, pixels: &dyn Pixels) -> Option<Candidate> {
        let patch = pixels.whole();
        // Depends on every pixel of the patch, so that a patch cut differently shows.
        let ring: f64 = patch.rgb.iter().enumerate().map(|(i, p)| (i % 31) as f64 * f64::from(p[1])).sum();
        Some(Candidate {
            score: Some(ring / patch.rgb.len() as f64),
            area_px: Some(region.area as f64),
            size_px: Some([region.bounds.width as f64, region.bounds.height as f64]),
            ..Candidate::at(PixelPoint {
                x: region.sum_x as f64 / region.area as f64 + 0.5,
                y: region.sum_y as f64 / region.area as f64 + 0.5,
            })
        })
    }
}

fn picture(width: u64, height: u64) -> MemorySource {
    let mut random = crate::common::Random::new(7);
    let mut rgb = Vec::new();
    for _ in 0..width * height {
        let state = random.bits();
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
    plan.grid = autoref_raster::window::TileGrid::new(source.info().width, source.info().height, tile_px, tile_px, 0);
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
    use std::sync::OnceLock;

    use autoref_raster::memory_plan::PlanOptions;
    use autoref_raster::memory_plan::plan;
    use autoref_raster::{self as raster, ReaderChoice};
    use autoref_stream::detector::Detector;
    use autoref_stream::georef::candidate_list;
    use autoref_stream::pipeline::{NoProgress, PaintDetector, scan};
    use autoref_stream::profile::Profile;
    use autoref_synth::{self as synth, Compression, FileLayout, MarkSize, MarkStyle, Output, SynthSpec};

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

    /// A detector of all the files of a test, which differ in their layout alone: its tables of colours take longer
    /// than a scan.
    type Shared = OnceLock<PaintDetector>;

    fn list(path: &Path, shared: &Shared, reader: ReaderChoice, tile_px: Option<u64>, threads: usize) -> Vec<u8> {
        let cache_bytes = 16 << 20;
        let source = raster::open(path, reader, 0, cache_bytes).expect("a sample that was just written");
        let detector = shared.get_or_init(|| {
            let profile = Profile::builtin("orange").expect("the default profile");
            PaintDetector::new(profile, source.info(), None).expect("a sound profile")
        });
        let options =
            PlanOptions { tile_px, threads, memory_budget_bytes: 512 << 20, baseline_bytes: 64 << 20, cache_bytes };
        let plan = plan(source.info(), detector.halo_px(), &options).expect("a small image fits");
        let found = scan(source.as_ref(), &plan, detector, &NoProgress).expect("a whole file");
        let mut text = Vec::new();
        candidate_list::write_csv(&found.candidates, &mut text).expect("memory takes all");
        text
    }

    #[test]
    fn layouts_codecs_and_readers_do_not_change_a_byte() {
        let large = std::env::var_os("AUTOREF_LARGE").is_some();
        let size = if large { (3001, 2003) } else { (601, 407) };
        let folder = tempfile::tempdir().expect("a temporary folder");
        let (mut expected, shared): (Option<Vec<u8>>, _) = (None, Shared::new());
        let layouts = [FileLayout::Tiles(256), FileLayout::Strips(7)];
        let codecs = [Compression::None, Compression::Deflate, Compression::Lzw, Compression::Zstd];
        for (i, (layout, codec)) in
            layouts.into_iter().flat_map(|l| codecs.into_iter().map(move |c| (l, c))).enumerate()
        {
            let path = folder.path().join(format!("{i}.tif"));
            synth::write(&spec(layout, codec, size), &path).expect("a sample");
            let mapped = (codec == Compression::None).then_some(ReaderChoice::Mapped);
            for reader in [ReaderChoice::Native, ReaderChoice::Gdal].into_iter().chain(mapped) {
                let tilings =
                    [(Some(100_000), 1), (Some(256), 2), (Some(256), 1), (Some(1000), 2), (Some(4096), 2), (None, 2)];
                // Every layout, codec and reader meets one whole tile and small ones; the first meets all tilings.
                for &(tile, threads) in if large || i == 0 { &tilings[..] } else { &tilings[..2] } {
                    let found = list(&path, &shared, reader, tile, threads);
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
        let (path, shared) = (folder.path().join("a.tif"), Shared::new());
        synth::write(&spec(FileLayout::Tiles(256), Compression::Jpeg(90), (1301, 707)), &path).expect("a sample");
        for reader in [ReaderChoice::Native, ReaderChoice::Gdal] {
            let whole = list(&path, &shared, reader, Some(100_000), 1);
            for (tile, threads) in [(Some(256), 2), (Some(1000), 1), (None, 2)] {
                assert!(whole == list(&path, &shared, reader, tile, threads), "{reader:?}, tile {tile:?}");
            }
        }
    }
}

mod options {
    //! The same promise with every option of a profile, alone and in random company.

    use autoref_raster::RasterSource;
    use autoref_raster::memory::MemorySource;
    use autoref_raster::memory_plan::PlanOptions;
    use autoref_raster::memory_plan::plan;
    use autoref_raster::window::TileGrid;
    use autoref_stream::georef::candidate_list;
    use autoref_stream::pipeline::{MarkDetector, NoProgress, scan};
    use autoref_stream::profile::colour::{Metric, Space};
    use autoref_stream::profile::{CentreMode, Density, Ordering, Profile, RoughBox, RoughDistance, TooClose};
    use proptest::prelude::*;

    const SIZE: (u64, u64) = (290, 230);

    /// Squares, discs and rings of orange that stand alone, touch, overlap, and lie over edges; some faded; specks and
    /// lines.
    fn picture(seed: u64) -> MemorySource {
        let mut bits = crate::common::Random::new(seed);
        let mut random = move |below: u64| bits.bits() % below;
        let (width, height) = (SIZE.0 as i64, SIZE.1 as i64);
        let mut rgb: Vec<u8> = (0..width * height)
            .flat_map(|_| {
                let light = random(26) as u8;
                [90 + light, 88 + light, 76 + light]
            })
            .collect();
        for k in 0..40 {
            let (cx, cy) = (random(SIZE.0) as i64, random(SIZE.1) as i64);
            // A third of them beside the borders of 64-px tiles.
            let (cx, cy) = if k % 3 == 0 { ((cx + 32) / 64 * 64, (cy + 32) / 64 * 64) } else { (cx, cy) };
            let (half, kind, fading) = (1 + random(9) as i64, random(5), random(45) as i64);
            for y in (cy - half).max(0)..(cy + half + 1).min(height) {
                for x in (cx - half).max(0)..(cx + half + 1).min(width) {
                    let r2 = (x - cx).pow(2) + (y - cy).pow(2);
                    let painted = match kind {
                        0 | 1 => true,
                        2 => r2 <= half * half,
                        3 => r2 <= half * half && 4 * r2 >= half * half,
                        _ => y == cy || random(3) == 0,
                    };
                    if painted {
                        let at = ((y * width + x) * 3) as usize;
                        for (c, paint) in [250i64, 112, 30].into_iter().enumerate() {
                            let noise = random(9) as i64 - 4;
                            let mixed = (i64::from(rgb[at + c]) * fading + paint * (100 - fading)) / 100 + noise;
                            rgb[at + c] = mixed.clamp(0, 255) as u8;
                        }
                    }
                }
            }
        }
        MemorySource::rgb8(SIZE.0, SIZE.1, rgb)
    }

    type Change = fn(&mut Profile);
    /// Every option of a profile, by itself.
    const OPTIONS: &[(&str, Change)] = &[
        ("standardised", |p| p.colour.metric = Metric::Standardised),
        ("rgb", |p| {
            p.colour.space = Space::Rgb;
            p.colour.clouds.truncate(1);
            p.colour.clouds[0].mean = [0.85, 0.45, 0.2];
            p.colour.clouds[0].covariance = [[0.02, 0.0, 0.0], [0.0, 0.01, 0.0], [0.0, 0.0, 0.02]];
        }),
        ("euclidean", |p| {
            // A ball about the cloud of deep shade would hold all dark ground.
            p.colour.clouds.truncate(4);
            p.colour.metric = Metric::Euclidean;
            p.colour.limit = if p.colour.space == Space::Lab { 40.0 } else { 0.35 };
        }),
        ("rough box", |p| p.colour.rough_box = Some(RoughBox { low: [0.4, 0.2, 0.0], high: [1.0, 0.6, 0.4] })),
        ("rough distance", |p| {
            let covariance = [[0.03, 0.0, 0.0], [0.0, 0.02, 0.0], [0.0, 0.0, 0.03]];
            let (space, metric, mean) = (Space::Rgb, Metric::Mahalanobis, [0.85, 0.45, 0.2]);
            p.colour.rough = Some(RoughDistance { space, metric, limit: 3.0, mean, covariance });
        }),
        ("median", |p| p.filters.median = true),
        ("closing", |p| p.filters.closing_radius_px = 3),
        ("wide closing", |p| p.filters.closing_radius_px = 9),
        ("opening", |p| p.filters.opening_radius_px = 1),
        ("holes", |p| p.filters.fill_holes = true),
        ("area", |p| (p.gates.min_area_px, p.gates.max_area_px) = (Some(10), Some(300))),
        ("side", |p| (p.gates.min_side_px, p.gates.max_side_px) = (Some(3), Some(19))),
        ("eccentricity", |p| (p.gates.min_eccentricity, p.gates.max_eccentricity) = (Some(0.05), Some(0.9))),
        ("tightness", |p| (p.gates.min_tightness, p.gates.max_tightness) = (Some(0.4), Some(0.9))),
        ("area over perimeter", |p| {
            (p.gates.min_area_per_perimeter_px, p.gates.max_area_per_perimeter_px) = (Some(0.785), Some(3.93));
        }),
        ("solidity", |p| (p.gates.min_solidity, p.gates.max_solidity) = (Some(0.6), Some(0.99))),
        ("clutter", |p| p.examine.max_clutter = Some(2)),
        ("spread", |p| p.examine.max_spread = Some(0.2)),
        ("density", |p| {
            let axis = |from: f64, step: f64| (0..20).map(|k| from + step * f64::from(k)).collect();
            let samples = [axis(35.0, 2.0), axis(20.0, 2.0), axis(20.0, 2.5)];
            let bandwidth = [4.0, 4.0, 5.0];
            p.examine.density = Some(Density { samples, bandwidth, min_probability: 1e-7, max_zero_share: 0.25 });
        }),
        ("any score", |p| p.examine.min_score = f64::NEG_INFINITY),
        ("split", |p| p.examine.split = true),
        ("centroid", |p| p.examine.centre = CentreMode::Centroid),
        ("probability", |p| p.examine.centre = CentreMode::Probability),
        ("distance", |p| p.examine.centre = CentreMode::Distance),
        ("remove", |p| (p.examine.too_close, p.examine.min_distance_px) = (TooClose::Remove, 30.0)),
        ("average", |p| (p.examine.too_close, p.examine.min_distance_px) = (TooClose::Average, 30.0)),
        ("probable", |p| (p.examine.too_close, p.examine.min_distance_px) = (TooClose::Probable, 30.0)),
        ("by score", |p| p.examine.order = Ordering::Score),
        ("by closeness", |p| p.examine.order = Ordering::Closeness),
        ("larger", |p| (p.size.min_px, p.size.max_px) = (Some(9.0), Some(25.0))),
    ];

    fn list(source: &MemorySource, profile: &Profile, tile: (u64, u64), threads: usize) -> Vec<u8> {
        let detector = MarkDetector::new(profile.clone(), source.info(), None).expect("a sound profile");
        let halo_px = detector.as_detector().halo_px();
        let options = PlanOptions {
            tile_px: Some(SIZE.0),
            threads,
            memory_budget_bytes: 512 << 20,
            baseline_bytes: 0,
            cache_bytes: 0,
        };
        let mut plan = plan(source.info(), halo_px, &options).expect("a small picture fits");
        plan.grid = TileGrid::new(SIZE.0, SIZE.1, tile.0, tile.1, halo_px);
        let found = scan(source, &plan, detector.as_detector(), &NoProgress).expect("memory can be read");
        let mut text = Vec::new();
        candidate_list::write_csv(&found.candidates, &mut text).expect("memory takes all");
        text
    }

    #[test]
    fn every_option_alone_and_all_tilings() {
        let source = picture(5);
        let orange = Profile::builtin("orange").expect("shipped");
        let prototype = Profile::builtin("autoref-2016").expect("shipped");
        let alone = OPTIONS.iter().map(|(name, change)| {
            let mut profile = orange.clone();
            change(&mut profile);
            (*name, profile)
        });
        let mut silent = Vec::new();
        let tilings = [((64, 64), 2), ((97, 71), 3), ((4096, 65), 1)];
        let all = alone.chain([("orange", orange.clone()), ("autoref-2016", prototype)]);
        for (number, (name, profile)) in all.enumerate() {
            let whole = list(&source, &profile, SIZE, 1);
            if whole.iter().filter(|b| **b == b'\n').count() < 3 {
                silent.push(name);
            }
            // Each option meets one of them, or all in the large form.
            let one = &tilings[number % tilings.len()..][..1];
            for &(tile, threads) in if crate::common::large() { &tilings[..] } else { one } {
                assert!(whole == list(&source, &profile, tile, threads), "{name}: tiles of {tile:?} differ");
            }
        }
        // The prototype's colours are those of another orthophoto; all else finds something to compare.
        assert_eq!(silent, ["autoref-2016"]);
    }

    fn cases() -> u32 {
        if std::env::var_os("AUTOREF_LARGE").is_some() { 500 } else { 16 }
    }

    fn side() -> impl Strategy<Value = u64> {
        prop_oneof![3 => 64u64..=200, 1 => 200u64..=4096]
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: cases(), ..ProptestConfig::default() })]
        #[test]
        fn random_company_of_options_and_odd_tiles(
            seed: u64,
            chosen in proptest::sample::subsequence((0..OPTIONS.len()).collect::<Vec<_>>(), 0..=OPTIONS.len()),
            tile in (side(), side()),
            threads in 1usize..=3,
        ) {
            let source = picture(seed);
            let mut profile = Profile::builtin("orange").expect("shipped");
            for &option in &chosen {
                OPTIONS[option].1(&mut profile);
            }
            let names: Vec<&str> = chosen.iter().map(|&i| OPTIONS[i].0).collect();
            let whole = list(&source, &profile, SIZE, 1);
            prop_assert!(whole == list(&source, &profile, tile, threads), "{names:?}, tiles of {tile:?}");
        }
    }
}
