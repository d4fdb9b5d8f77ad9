//! Tiles in, candidates out: `Tile → Block → Mask → TileRegions → Region → Candidate`.
//!
//! Workers take tiles in order, kept close together by `pipeline::pace`; each does one tile at a time from reading to
//! labelling, and the calling thread merges. Marks whose surroundings lie inside a tile are examined by its worker at
//! once, while their pixels are there; those that straddle tiles are examined as soon as the last of these tiles is
//! read, from pixels along the faces that were kept for them (`pipeline::seams`), or else through small windows read
//! again. Either way the examination sees the same pixels, so that no candidate depends on the tiling.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use crossbeam_channel::TrySendError;
use rayon::prelude::*;
use serde::Serialize;

use crate::candidate::Candidate;
use crate::candidate::standing::{Examined, Layer, Standing, one_of_each};
use crate::detector::Detector;
use crate::merge::RegionMerger;
use crate::pipeline::pace::Pace;
use crate::pipeline::seams::{Seam, Seams, band_pool};
use crate::segment::label::{Labeller, Region, TileRegions};
use autoref_raster::error::{Error, Result};
use autoref_raster::mask::Mask;
use autoref_raster::memory_plan::ScanPlan;
use autoref_raster::window::{Tile, Window};
use autoref_raster::{Block, BufferPool, Piece, RasterInfo, RasterSource, ReadStats, View};

/// More marks than this are no marks; also what bounds memory on a picture of confetti.
pub const MAX_CANDIDATES: usize = 1_000_000;
/// The system is asked to fetch so much of the file before the tiles that are under way: a few hundredths of a second
/// of a fast disk. It lies in the system's cache, not in ours.
const FETCH_AHEAD_BYTES: u64 = 64 << 20;
/// Straddling marks that may wait for each worker, with the pixels around them.
const STRADDLERS_PER_WORKER: usize = 64;
/// The fetcher is woken for so many tiles at once.
const FETCHED_TOGETHER: u64 = 8;

/// Hears how far the scan has come; called from several threads.
pub trait Progress: Sync {
    fn scanned(&self, pixels: u64);
    /// The pixels of a tile while they are there, with the candidates that were found in it already; `core` lies in the
    /// block's window, and the cores cover the raster once.
    fn saw(&self, _block: &Block, _core: Window, _found: &[&Candidate]) {}
    /// Another pass over the whole raster begins, in plain words; what was scanned so far no longer counts.
    fn pass(&self, _what: &str) {}
    /// Something else begins, in plain words, that may take a while.
    fn stage(&self, _what: &str) {}
}

/// Nobody listens.
pub struct NoProgress;

impl Progress for NoProgress {
    fn scanned(&self, _pixels: u64) {}
}

/// What the scan found.
#[derive(Clone, Debug)]
pub struct ScanOutcome {
    /// In raster order of the regions' first pixels.
    pub candidates: Vec<Candidate>,
    /// Regions that passed the gates, candidates or not.
    pub regions_examined: u64,
    /// Regions of the detector's own mask that were examined and are no candidates: what the masks beside it show is
    /// often part of a mark.
    pub regions_turned_down: u64,
    /// Reading of the scan alone.
    pub scan_reads: ReadStats,
    pub timings: ScanTimings,
}

/// Wall-clock seconds.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct ScanTimings {
    pub scan_s: f64,
    pub examine_s: f64,
}

/// A detector and those that look in the same pass.
fn layers(detector: &dyn Detector) -> Vec<&dyn Detector> {
    std::iter::once(detector).chain(detector.others()).collect()
}

/// A complete region.
struct Seen {
    layer: Layer,
    region: Region,
}

/// What a worker sends on for one tile.
struct TileOutput {
    id: u64,
    /// Examined here.
    examined: Vec<Examined>,
    /// Complete, but their surroundings reach beyond the tile.
    straddling: Vec<Seen>,
    /// Only what is open at the faces is left in it, of each layer.
    open: Vec<TileRegions>,
    seam: Seam,
}

/// A complete region that lies in several tiles, with the pixels around it when the seams held them.
struct Straddler {
    seen: Seen,
    block: Option<Block>,
}

/// Scans the raster as planned.
///
/// # Errors
/// The first read error of any worker, or [`Error::Limit`] when there are more than [`MAX_CANDIDATES`] candidates.
pub fn scan(
    source: &dyn RasterSource,
    plan: &ScanPlan,
    detector: &dyn Detector,
    progress: &dyn Progress,
) -> Result<ScanOutcome> {
    let started = Instant::now();
    let _span = tracing::info_span!("scan").entered();
    let before = source.stats();
    let collected = scan_tiles(source, plan, detector, progress)?;
    let scan_time = started.elapsed();
    let scanned = source.stats();
    let mut examined = collected.examined;
    let mut straddling = collected.straddling;
    let _span = tracing::info_span!("examine straddlers").entered();
    let examine_started = Instant::now();
    if !straddling.is_empty() {
        progress.stage("looking at marks that straddle tiles");
    }
    straddling.sort_by_key(|straddler| (straddler.seen.region.first, straddler.seen.layer));
    for batch in straddling.chunks(plan.workers) {
        examined.extend(examine_windows(source, detector, batch)?);
        // Or the blocks around far windows would fill the cache, in a long scan more than in a short one. A source that
        // reads from the top down needs its cache to step back.
        if !source.info().sequential {
            source.release(source.info().bounds());
        }
    }
    let regions_examined = collected.clutter + examined.len() as u64;
    let at_the_end = examined.iter().filter(|one| one.is_turned_down()).count() as u64;
    Ok(ScanOutcome {
        candidates: detector.finish(one_of_each(examined)),
        regions_examined,
        regions_turned_down: collected.turned_down + at_the_end,
        scan_reads: difference(scanned, before),
        timings: ScanTimings { scan_s: seconds(scan_time), examine_s: seconds(examine_started.elapsed()) },
    })
}

fn seconds(duration: Duration) -> f64 {
    duration.as_secs_f64()
}

fn difference(after: ReadStats, before: ReadStats) -> ReadStats {
    ReadStats {
        blocks_decoded: after.blocks_decoded - before.blocks_decoded,
        blocks_skipped: after.blocks_skipped - before.blocks_skipped,
        bytes_read: after.bytes_read - before.bytes_read,
    }
}

#[derive(Default)]
struct Collected {
    /// Only what became candidates: the rest is counted, or a large image would need more memory than a small one.
    examined: Vec<Examined>,
    /// Regions examined that are no candidates.
    clutter: u64,
    /// Of these, those of the detector's own mask.
    turned_down: u64,
    /// Not examined yet.
    straddling: Vec<Straddler>,
}

fn scan_tiles(
    source: &dyn RasterSource,
    plan: &ScanPlan,
    detector: &dyn Detector,
    progress: &dyn Progress,
) -> Result<Collected> {
    let stop = AtomicBool::new(false);
    let in_order = Mutex::new(());
    let info = source.info();
    let tile_bytes = plan.grid.tile_width() * plan.grid.tile_height() * (info.bands * info.sample.bytes()) as u64;
    let pace = Pace::of(plan.workers, FETCH_AHEAD_BYTES.div_ceil(tile_bytes.max(1)));
    let next_tile = AtomicU64::new(0);
    let span = tracing::Span::current();
    let (straddler_sender, straddlers) = crossbeam_channel::bounded::<Straddler>(STRADDLERS_PER_WORKER * plan.workers);
    let (output_sender, outputs) = crossbeam_channel::bounded::<Result<TileOutput>>(2 * plan.workers);
    std::thread::scope(|scope| {
        let (stop, pace) = (&stop, &pace);
        // The request itself waits while the disk has enough to do. Without a fetcher tiles are read as they are
        // needed.
        let _ = spawn_named(scope, "fetcher".into(), move || {
            for tile in plan.grid.iter() {
                if tile.id % FETCHED_TOGETHER == 0 {
                    pace.wait_to_fetch(tile.id + FETCHED_TOGETHER - 1);
                }
                if stop.load(Ordering::Relaxed) {
                    return;
                }
                source.prefetch(tile.read);
            }
        });
        let bands = band_pool(&plan.grid, detector.patch_margin_px(), source.info());
        let mut started = Ok(());
        for index in 0..plan.workers {
            let straddlers = straddlers.clone();
            let bands = bands.clone();
            let (next_tile, in_order, span) = (&next_tile, &in_order, &span);
            let layers = layers(detector);
            #[rustfmt::skip]
            let worker = Worker {
                source, plan, detector, layers, progress, next_tile, pace, stop, in_order, straddlers, bands, span,
            };
            let outputs = output_sender.clone();
            let worker = spawn_named(scope, format!("worker {index}"), move || {
                let _rest = pace.lifted_by_panic();
                worker.run(&outputs);
            });
            // A system that starts no more threads gives fewer workers; what they find is the same.
            if let Err(error) = worker {
                started = if index == 0 { Err(error) } else { Ok(()) };
                break;
            }
        }
        drop(output_sender);
        if let Err(error) = started {
            stop.store(true, Ordering::Relaxed);
            pace.lift();
            return Err(Error::io(&source.info().path, "start a thread to read", error));
        }
        let mut collector = Collector::new(source, plan, detector, pace, bands);
        let result = collector.run(&outputs, &straddler_sender);
        // On an error nobody must wait for us for ever.
        stop.store(true, Ordering::Relaxed);
        pace.lift();
        while outputs.recv().is_ok() {}
        result?;
        collector.mergers.into_iter().for_each(|merger| merger.finalize());
        let mut collected = collector.collected;
        collected.straddling.extend(straddlers.try_iter());
        Ok(collected)
    })
}

fn spawn_named<'scope>(
    scope: &'scope std::thread::Scope<'scope, '_>,
    name: String,
    work: impl FnOnce() + Send + 'scope,
) -> std::io::Result<()> {
    std::thread::Builder::new().name(name).spawn_scoped(scope, work).map(|_| ())
}

/// Brings together what the workers found, in whatever order the tiles come.
struct Collector<'a> {
    source: &'a dyn RasterSource,
    plan: &'a ScanPlan,
    detector: &'a dyn Detector,
    layers: Vec<&'a dyn Detector>,
    /// One for each layer.
    mergers: Vec<RegionMerger>,
    collected: Collected,
    /// Complete regions by a tile that their surroundings reach into and that has not come.
    waiting: BTreeMap<u64, Vec<Seen>>,
    /// Of each tile, whether it has come.
    done: Vec<bool>,
    /// The first tile that has not come.
    next: u64,
    seams: Seams,
    pace: &'a Pace,
}

impl<'a> Collector<'a> {
    fn new(
        source: &'a dyn RasterSource,
        plan: &'a ScanPlan,
        detector: &'a dyn Detector,
        pace: &'a Pace,
        bands: BufferPool,
    ) -> Self {
        Collector {
            source,
            plan,
            detector,
            mergers: layers(detector).iter().map(|_| RegionMerger::new(plan.grid)).collect(),
            layers: layers(detector),
            collected: Collected::default(),
            waiting: BTreeMap::new(),
            done: vec![false; plan.grid.len() as usize],
            next: 0,
            seams: Seams::new(plan.grid, plan.seam_bytes, bands),
            pace,
        }
    }

    /// Until there are no more outputs. What is complete goes to the workers through `straddlers`; what is left in the
    /// end is in `collected`.
    fn run(
        &mut self,
        outputs: &crossbeam_channel::Receiver<Result<TileOutput>>,
        straddlers: &crossbeam_channel::Sender<Straddler>,
    ) -> Result<()> {
        for output in outputs {
            let output = output?;
            let id = output.id;
            let regions = output.examined.len();
            let marks = self.collected.examined.len();
            let turned_down = output.examined.iter().filter(|one| one.is_turned_down()).count() as u64;
            self.collected.examined.extend(output.examined.into_iter().filter(|one| !one.found.is_empty()));
            self.collected.clutter += (regions + marks - self.collected.examined.len()) as u64;
            self.collected.turned_down += turned_down;
            let mut complete = output.straddling;
            let _span = tracing::info_span!("merge").entered();
            for (layer, (merger, open)) in self.mergers.iter_mut().zip(output.open).enumerate() {
                merger.feed(id, open, &mut |region| {
                    if self.layers[layer].gate(&region) {
                        complete.push(Seen { layer, region });
                    }
                });
            }
            self.done[id as usize] = true;
            self.seams.keep(id, output.seam);
            complete.extend(self.waiting.remove(&id).into_iter().flatten());
            for seen in complete {
                match self.missing_tile(&seen.region) {
                    Some(missing) => self.waiting.entry(missing).or_default().push(seen),
                    None => self.pass_on(seen, straddlers)?,
                }
            }
            self.release_behind();
            let waiting = self.waiting.values().map(Vec::len).sum::<usize>() + self.collected.straddling.len();
            let found = self.collected.examined.len() + waiting;
            if found > MAX_CANDIDATES {
                return Err(Error::Limit {
                    what: "the image is full of regions that look like marks".into(),
                    needed: found as u64,
                    allowed: MAX_CANDIDATES as u64,
                    remedy: "use a stricter profile (--profile) or the size of the marks".into(),
                });
            }
        }
        let waiting = std::mem::take(&mut self.waiting).into_values().flatten();
        self.collected.straddling.extend(waiting.map(|seen| Straddler { seen, block: None }));
        Ok(())
    }

    /// A tile that a region's surroundings reach into and that has not come.
    fn missing_tile(&self, region: &Region) -> Option<u64> {
        let window = patch_window(region, self.detector, self.source.info());
        self.plan.grid.tiles_of(&window).find(|&id| !self.done[id as usize])
    }

    /// All tiles around the region have come. What the seams do not hold is read again after the scan.
    /// Where the workers have enough to do it is examined here, so that no more wait than the channel holds.
    fn pass_on(&mut self, seen: Seen, straddlers: &crossbeam_channel::Sender<Straddler>) -> Result<()> {
        let window = patch_window(&seen.region, self.detector, self.source.info());
        let straddler = Straddler { block: self.seams.block(window), seen };
        if straddler.block.is_none() {
            self.collected.straddling.push(straddler);
            return Ok(());
        }
        match straddlers.try_send(straddler) {
            Ok(()) => {}
            Err(TrySendError::Full(straddler)) => {
                let examined = examine_straddler(self.source, self.detector, &straddler)?;
                self.collected.clutter += u64::from(examined.found.is_empty());
                self.collected.turned_down += u64::from(examined.is_turned_down());
                self.collected.examined.extend(Some(examined).filter(|one| !one.found.is_empty()));
            }
            // Nobody listens when all workers have ended.
            Err(TrySendError::Disconnected(straddler)) => self.collected.straddling.push(straddler),
        }
        Ok(())
    }

    /// Lets go of the tiles that have come: of their file blocks when no tile can want them any more, and of their
    /// seams when no region that straddles them can be open still.
    fn release_behind(&mut self) {
        let grid = &self.plan.grid;
        let (margin, largest) = (self.detector.patch_margin_px(), self.detector.largest_mark_px());
        let reach = margin + largest + 2 * self.plan.halo_px;
        // So many tiles to the right of one must have come before a region above its lowest rows is complete.
        let beside = 1 + reach / grid.tile_width().max(1);
        // A region at the lower face of a tile may go on over as many rows of tiles.
        let below = grid.columns() * reach.div_ceil(grid.tile_height()).max(1);
        while self.next < grid.len() && self.done[self.next as usize] {
            if self.plan.halo_px > 0 {
                self.source.release(grid.tile(self.next).core);
            }
            if let Some(surrounded) = self.next.checked_sub(beside) {
                self.seams.keep_lowest(surrounded, largest + 2 * margin);
            }
            // The tile beside the one below it shares its lower right corner.
            if let Some(far) = self.next.checked_sub(below + 1) {
                self.seams.drop_tile(far);
            }
            self.next += 1;
        }
        self.pace.reached(self.next);
    }
}

struct Worker<'a> {
    source: &'a dyn RasterSource,
    plan: &'a ScanPlan,
    detector: &'a dyn Detector,
    layers: Vec<&'a dyn Detector>,
    progress: &'a dyn Progress,
    next_tile: &'a AtomicU64,
    pace: &'a Pace,
    stop: &'a AtomicBool,
    /// Held from taking a tile until it is read, when the source can only be read from the top down.
    in_order: &'a Mutex<()>,
    /// Regions whose surroundings reach over tiles that have all been read.
    straddlers: crossbeam_channel::Receiver<Straddler>,
    /// For what is kept of tiles.
    bands: BufferPool,
    /// The scan's, of which those of the worker's steps are parts.
    span: &'a tracing::Span,
}

impl Worker<'_> {
    fn run(&self, outputs: &crossbeam_channel::Sender<Result<TileOutput>>) {
        let mut masks = vec![Mask::new(Window::new(0, 0, 0, 0)); self.layers.len()];
        let mut labeller = Labeller::new();
        while let Some((tile, block)) = self.next_block(&mut masks) {
            let output = block.and_then(|block| {
                let mut output = self.process(&tile, &block, &mut masks, &mut labeller);
                let found: Vec<&Candidate> = output.examined.iter().flat_map(|one| &one.found).collect();
                self.progress.saw(&block, tile.core, &found);
                drop(block);
                if self.plan.halo_px == 0 {
                    // No other tile reads its pixels. At once, so that the next tile is read into the same buffers.
                    self.source.release(tile.core);
                }
                for straddler in self.straddlers.try_iter() {
                    output.examined.push(examine_straddler(self.source, self.detector, &straddler)?);
                }
                self.progress.scanned(tile.core.area());
                Ok(output)
            });
            if outputs.send(output).is_err() {
                return;
            }
        }
    }

    /// The next tile in order, when its turn has come.
    fn next_tile(&self) -> Option<Tile> {
        let id = self.next_tile.fetch_add(1, Ordering::Relaxed);
        if id >= self.plan.grid.len() {
            return None;
        }
        self.pace.wait_for_turn(id);
        (!self.stop.load(Ordering::Relaxed)).then(|| self.plan.grid.tile(id))
    }

    /// Tile → Block, and of the masks what can be told from each piece.
    fn next_block(&self, masks: &mut [Mask]) -> Option<(Tile, Result<Block>)> {
        if !self.source.info().sequential {
            let tile = self.next_tile()?;
            let _span = tracing::info_span!(parent: self.span, "read and classify").entered();
            masks.iter_mut().for_each(|mask| mask.reset(tile.read));
            let block = self.source.read_seen(tile.read, &mut |piece| self.segment_piece(piece, masks));
            return Some((tile, block));
        }
        // Only the reading takes turns.
        let turn = self.in_order.lock().unwrap_or_else(PoisonError::into_inner);
        let tile = self.next_tile()?;
        let _span = tracing::info_span!(parent: self.span, "read and classify").entered();
        let block = self.source.read(tile.read);
        drop(turn);
        masks.iter_mut().for_each(|mask| mask.reset(tile.read));
        block.iter().flat_map(|b| &b.pieces).for_each(|piece| self.segment_piece(piece, masks));
        Some((tile, block))
    }

    fn segment_piece(&self, piece: &Piece, masks: &mut [Mask]) {
        let (first, others) = masks.split_at_mut(1);
        self.detector.segment_piece(piece, &mut first[0]);
        for (detector, mask) in self.layers[1..].iter().zip(others) {
            detector.segment_beside(piece, &first[0], mask);
        }
    }

    /// Block → Mask → TileRegions, and what can be examined at once. The masks hold what [`Detector::segment_piece`]
    /// set.
    fn process(&self, tile: &Tile, block: &Block, masks: &mut [Mask], labeller: &mut Labeller) -> TileOutput {
        let info = self.source.info();
        let mut regions: Vec<TileRegions> = {
            let _span = tracing::info_span!(parent: self.span, "segment").entered();
            self.detector.segment_blocks(block, masks);
            let label = |(detector, mask): (&&dyn Detector, &mut Mask)| {
                labeller.label(mask, tile.core, info.bounds(), |region| detector.gate(region))
            };
            self.layers.iter().zip(masks).map(label).collect()
        };
        let _span = tracing::info_span!(parent: self.span, "examine").entered();
        let mut output = TileOutput {
            id: tile.id,
            examined: Vec::new(),
            straddling: Vec::new(),
            open: Vec::new(),
            seam: Seam::default(),
        };
        let mut standing = Standing::default();
        for (layer, regions) in regions.iter_mut().enumerate() {
            for region in std::mem::take(&mut regions.finished) {
                let window = patch_window(&region, self.detector, info);
                if !block.window.contains_window(&window) {
                    output.straddling.push(Seen { layer, region });
                    continue;
                }
                // What would not stand beside a candidate of the detector itself is not looked at.
                let view = View { block, window, info };
                let decided = layer > 0 && standing.any_whole_in(&region.bounds);
                let found = if decided { Vec::new() } else { self.layers[layer].examine_all(&region, &view) };
                output.examined.push(Examined { layer, region, found });
            }
            if layer == 0 {
                standing.add(output.examined.iter().flat_map(|one| &one.found));
            }
        }
        let whole = output.straddling.iter().map(|seen| &seen.region);
        let open = regions.iter().flat_map(|regions| &regions.open);
        output.seam = Seam::of_tile((block, tile), whole, open, self.detector, info, &self.bands);
        output.open = regions;
        debug_assert!(self.plan.grid.bounds() == info.bounds());
        output
    }
}

fn patch_window(region: &Region, detector: &dyn Detector, info: &RasterInfo) -> Window {
    region.bounds.grown(detector.patch_margin_px(), &info.bounds())
}

/// Region → Candidate through windows of their own.
fn examine_windows(
    source: &dyn RasterSource,
    detector: &dyn Detector,
    straddlers: &[Straddler],
) -> Result<Vec<Examined>> {
    let examine = |straddler: &Straddler| examine_straddler(source, detector, straddler);
    if source.info().sequential {
        // One pass from the top down: in parallel the reader would have to go back and forth.
        return straddlers.iter().map(examine).collect();
    }
    straddlers.par_iter().map(examine).collect()
}

fn examine_straddler(source: &dyn RasterSource, detector: &dyn Detector, straddler: &Straddler) -> Result<Examined> {
    let Straddler { seen: Seen { layer, region }, block } = straddler;
    let info = source.info();
    let read;
    let block = match block {
        Some(block) => block,
        None => {
            read = source.read(patch_window(region, detector, info))?;
            &read
        }
    };
    let view = View { block, window: block.window, info };
    let found = layers(detector)[*layer].examine_all(region, &view);
    Ok(Examined { layer: *layer, region: region.clone(), found })
}
