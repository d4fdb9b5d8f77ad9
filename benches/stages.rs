//! Each stage of the flow by itself, on one thread's worth of made input: what a change to one of them costs or gains.
//!
//! `cargo bench -p autoref-benches --bench stages` prints a line a stage; a word after `--` chooses stages. Decoding
//! has a bench of its own (`decode`), against codecs and GDAL.

use std::hint::black_box;

use autoref_film::drawn::{FilmGround, FilmScene, FilmSpec};
use autoref_film::frame::{FindOptions, Finder};
use autoref_film::load_camera;
use autoref_raster::RasterSource;
use autoref_raster::coords::{GeoTransform, PixelPoint};
use autoref_raster::mask::Mask;
use autoref_raster::memory::MemorySource;
use autoref_raster::window::{TileGrid, Window};
use autoref_solve::{Pair, solve};
use autoref_stream::candidate::Candidate;
use autoref_stream::detector::Detector;
use autoref_stream::gcp::Gcp;
use autoref_stream::matching::{Matcher, Priors, RobustMatcher};
use autoref_stream::merge::RegionMerger;
use autoref_stream::pipeline::PaintDetector;
use autoref_stream::profile::Profile;
use autoref_stream::rematch::{Expected, rematch};
use autoref_stream::segment::label::Labeller;
use autoref_synth::plant::Random;
use criterion::{Criterion, Throughput, criterion_group, criterion_main};

const SIDE: u64 = 2048;

/// Ground with a little noise and a 12 px mark every 256 px.
fn picture() -> (MemorySource, Vec<PixelPoint>) {
    let mut random = Random(7);
    let mut rgb: Vec<u8> = (0..SIDE * SIDE)
        .flat_map(|_| {
            let light = (random.unit() * 30.0) as u8;
            [88 + light, 92 + light, 76 + light]
        })
        .collect();
    let mut centres = Vec::new();
    for (left, top) in (0..64).map(|i| (128 + i % 8 * 256, 100 + i / 8 * 256)) {
        for (x, y) in (0..144).map(|i| (left + i % 12, top + i / 12)) {
            rgb[((y * SIDE + x) * 3) as usize..][..3].copy_from_slice(&[250, 110, 25]);
        }
        centres.push(PixelPoint { x: left as f64 + 6.0, y: top as f64 + 6.0 });
    }
    (MemorySource::rgb8(SIDE, SIDE, rgb), centres)
}

fn segmentation(c: &mut Criterion) {
    let (source, _) = picture();
    let detector = PaintDetector::new(Profile::builtin("orange").expect("shipped"), source.info(), None);
    let detector = detector.expect("a sound profile");
    let block = source.read(Window::whole(SIDE, SIDE)).expect("in memory");
    let mut mask = Mask::new(block.window);
    let mut group = c.benchmark_group("segmentation");
    group.throughput(Throughput::Elements(SIDE * SIDE));
    group.bench_function("paint", |b| {
        b.iter(|| {
            mask.reset(block.window);
            detector.segment(&block, &mut mask);
            black_box(mask.count())
        })
    });
    group.finish();
}

/// Labels and merges tiles of 256 px of a mask with a region in every 16 × 16 px.
fn merge(c: &mut Criterion) {
    let whole = Window::whole(SIDE, SIDE);
    let mut mask = Mask::new(whole);
    let mut random = Random(3);
    for cell in 0..(SIDE / 16).pow(2) {
        let (x, y) = (cell % (SIDE / 16) * 16, cell / (SIDE / 16) * 16);
        let (w, h) = (2 + (random.unit() * 12.0) as u64, 2 + (random.unit() * 12.0) as u64);
        for i in 0..w * h {
            mask.set(x + i % w, y + i / w, true);
        }
    }
    let grid = TileGrid::new(SIDE, SIDE, 256, 256, 0);
    let mut group = c.benchmark_group("merge");
    group.throughput(Throughput::Elements(SIDE * SIDE));
    group.bench_function("labels and seams of 64 tiles", |b| {
        b.iter(|| {
            let (mut labeller, mut merger, mut found) = (Labeller::new(), RegionMerger::new(grid), 0u64);
            for tile in grid.iter() {
                let regions = labeller.label(&mask, tile.core, whole, |_| true);
                found += regions.finished.len() as u64;
                merger.feed(tile.id, regions, &mut |_| found += 1);
            }
            merger.finalize();
            black_box(found)
        })
    });
    group.finish();
}

const TRUTH: GeoTransform = GeoTransform([570_000.0, 0.029, 0.006, 7_032_000.0, 0.006, -0.029]);

/// Fourteen of twenty points among three hundred other candidates.
fn scene() -> (Vec<Candidate>, Vec<Gcp>) {
    let mut random = Random(11);
    let mut place = || PixelPoint { x: random.unit() * 16_000.0, y: random.unit() * 12_000.0 };
    let points: Vec<PixelPoint> = (0..20).map(|_| place()).collect();
    let gcps = points.iter().enumerate().map(|(i, p)| {
        let ground = TRUTH.apply(*p);
        Gcp::control(format!("P{i}"), ground.easting, ground.northing)
    });
    let gcps = gcps.collect();
    let mut candidates: Vec<Candidate> = points[..14].iter().copied().map(Candidate::at).collect();
    candidates.extend((0..300).map(|_| Candidate::at(place())));
    (candidates, gcps)
}

fn matching(c: &mut Criterion) {
    let (candidates, gcps) = scene();
    let size = Some((16_000.0, 12_000.0));
    let known = Priors { gsd_m_per_px: Some((0.027, 0.033)), rotation_deg: None, image_size_px: size };
    let unknown = Priors { gsd_m_per_px: None, ..known.clone() };
    let mut group = c.benchmark_group("matching");
    for (name, priors) in [("14 of 20 among 300, scale known", known), ("scale unknown", unknown)] {
        group
            .bench_function(name, |b| b.iter(|| black_box(RobustMatcher::default().find(&candidates, &gcps, &priors))));
    }
    group.finish();
}

fn solving(c: &mut Criterion) {
    let (candidates, gcps) = scene();
    let pair = |(mark, gcp): (&Candidate, &Gcp)| Pair {
        pixel: mark.centre,
        covariance_px2: Some([0.01, 0.002, 0.02]),
        map: gcp.position(),
        survey_sigma_m: Some(0.01),
    };
    let pairs: Vec<Pair> = candidates.iter().zip(&gcps).take(14).map(pair).collect();
    c.bench_function("solving/similarity of 14 pairs", |b| b.iter(|| black_box(solve(&pairs))));
}

fn refinement(c: &mut Criterion) {
    let (source, centres) = picture();
    let detector = PaintDetector::new(Profile::builtin("orange").expect("shipped"), source.info(), None);
    let detector = detector.expect("a sound profile");
    let at = |(gcp, p): (usize, &PixelPoint)| Expected { gcp, position: *p, radius_px: 6.0 };
    let expected: Vec<Expected> = centres.iter().enumerate().map(at).collect();
    let mut group = c.benchmark_group("refinement");
    group.throughput(Throughput::Elements(expected.len() as u64));
    group.bench_function("64 marks in windows of their own", |b| {
        b.iter(|| black_box(rematch(&source, &detector, &[], &[], &expected).expect("in memory")))
    });
    group.finish();
}

fn film(c: &mut Criterion) {
    let camera = load_camera("wild-15-4").expect("shipped");
    let scene = FilmScene::new(&FilmSpec::plain(&camera, 60.0, 3), &FilmGround::default()).expect("a frame");
    let finder = Finder::new(&camera).expect("a shipped camera");
    let mut group = c.benchmark_group("film");
    group.sample_size(10);
    group.bench_function("fiducial marks of a drawn frame, drawing included", |b| {
        b.iter(|| black_box(finder.find(&scene, &FindOptions::default()).expect("in memory")))
    });
    group.finish();
}

criterion_group!(stages, segmentation, merge, matching, solving, refinement, film);
criterion_main!(stages);
