//! The chain: a cloud is spooled, shared out among tiles, classified step by step, and written again in its own order.

use std::path::{Path, PathBuf};
use std::time::Instant;

use rayon::prelude::*;
use serde::Serialize;

use crate::crop::{self, Crop};
use crate::error::{Error, Result};
use crate::io::{self, Header, OutPoint, Target};
use crate::kdtree::Bounds;
use crate::outliers::{self, NOISE, OutlierStatistics};
use crate::point::Point;
use crate::schema::Batch;
use crate::smrf;
use crate::summary::Summary;
use crate::tiles::{Scratch, Spool, Tiles, Verdicts};
use crate::{elm, isolated};
use autoref_raster::words::{counted, in_short};

/// Points of one read.
const BATCH: usize = 1 << 14;
/// What the program itself and its libraries take.
const BASE_BYTES: u64 = 80 << 20;
/// Tiles whose trees are kept while one is searched, itself among them.
const TREES: u64 = 5;
const OBJECT: u8 = 1;

/// One step of the chain.
#[derive(Clone, Debug, PartialEq)]
pub enum Step {
    Crop(Crop),
    /// Statistical outliers.
    Outliers {
        neighbours: usize,
        multiplier: f64,
    },
    Radius {
        radius_m: f64,
        least: usize,
    },
    Low {
        cell_m: f64,
        gap_m: f64,
    },
    Isolated(isolated::Options),
    Ground(smrf::Options),
}

impl Step {
    /// As the command line calls it.
    pub fn name(&self) -> &'static str {
        match self {
            Step::Crop(Crop::Height { .. }) => "z",
            Step::Crop(Crop::Range { .. }) => "range",
            Step::Crop(Crop::Polygon(_)) => "crop",
            Step::Outliers { .. } => "outliers",
            Step::Radius { .. } => "radius",
            Step::Low { .. } => "low",
            Step::Isolated(_) => "isolated",
            Step::Ground(_) => "ground",
        }
    }
}

impl Step {
    /// Whether it counts in one unit along all axes.
    fn needs_lengths(&self) -> bool {
        !matches!(self, Step::Crop(Crop::Height { .. } | Crop::Polygon(_)))
    }
}

/// What becomes of points whose coordinates are no finite numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Invalid {
    Refuse,
    LeaveOut,
}

/// How clouds are cleaned.
#[derive(Clone, Debug)]
pub struct Plan {
    pub steps: Vec<Step>,
    pub drop_noise: bool,
    pub drop_objects: bool,
    /// Map coordinates less the file's; `None` takes what the file says.
    pub shift: Option<[f64; 3]>,
    pub invalid: Invalid,
    pub memory_bytes: u64,
    /// At most so many points in a tile; fewer when memory asks for it.
    pub tile_points: Option<usize>,
    pub scratch: PathBuf,
    /// WKT for outputs whose source has no reference system.
    pub crs_wkt: Option<String>,
}

/// What a step did.
#[derive(Clone, Debug, Serialize)]
pub struct StepReport {
    pub step: String,
    pub points_in: u64,
    /// Points to which the step gave a class that takes them from the ground: noise, or objects.
    pub classified: u64,
    pub dropped: u64,
    pub seconds: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub statistics: Option<OutlierStatistics>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub greatest_range_m: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ground: Option<u64>,
}

/// What became of a cloud.
#[derive(Clone, Debug, Serialize)]
pub struct CleanReport {
    #[serde(serialize_with = "autoref_raster::path_text::one")]
    pub input: PathBuf,
    #[serde(serialize_with = "autoref_raster::path_text::one")]
    pub output: PathBuf,
    pub format: String,
    pub crs: Option<String>,
    /// In which coordinates, and so all lengths, count: `m` unless the CRS says otherwise.
    pub unit: String,
    pub shift: [f64; 3],
    pub points: u64,
    /// Points whose coordinates are no finite numbers.
    pub invalid: u64,
    /// Points that are flagged as withheld, which LAS calls deleted: they go on as they came, and no step sees them.
    pub withheld: u64,
    pub points_kept: u64,
    pub tiles: usize,
    pub seconds: f64,
    pub steps: Vec<StepReport>,
    pub summary: Summary,
    /// What of the cloud the output does not carry, and what else is to be known of it.
    pub notes: Vec<String>,
}

impl Plan {
    /// Whether points of a class are left out.
    fn drops(&self, class: u8) -> bool {
        (class == NOISE && self.drop_noise) || (class == OBJECT && self.drop_objects)
    }

    fn working_bytes(&self) -> u64 {
        self.memory_bytes.saturating_sub(BASE_BYTES).max(16 << 20)
    }

    fn most_tile_points(&self) -> usize {
        let neighbours = self.steps.iter().map(|step| match step {
            Step::Outliers { neighbours, .. } => *neighbours,
            Step::Radius { least, .. } => *least,
            Step::Isolated(options) => options.neighbours(),
            _ => 0,
        });
        let bytes = TREES * 44 + 8 * neighbours.max().unwrap_or(0) as u64 + 64;
        let fits = (self.working_bytes() / bytes).clamp(1, 2 << 20) as usize;
        self.tile_points.map_or(fits, |points| points.min(fits))
    }
}

/// Cleans one cloud: reads `input`, writes `output` in the format that the name `named` asks for.
///
/// # Errors
/// Bad input, a budget that does not suffice, a full disk. The output may then be left half-written: it should be a
/// temporary name.
pub fn clean(input: &Path, output: &Path, named: &Path, plan: &Plan) -> Result<CleanReport> {
    /// Of each point one byte says which step classified it and whether later ones see it.
    const MOST_STEPS: usize = 126;
    if plan.steps.len() > MOST_STEPS {
        return Err(Error::usage(
            format!("a chain of {} steps", plan.steps.len()),
            format!("give at most {MOST_STEPS}, and clean the result again"),
        ));
    }
    let began = Instant::now();
    let (mut header, _) = io::open(input)?;
    let mut notes = look(input, named, plan, &mut header)?;
    let Spooled { mut tiles, invalid, withheld, left_over } =
        tracing::info_span!("read").in_scope(|| spool(input, plan))?;
    notes.extend(left_over);
    if withheld > 0 && !plan.steps.is_empty() {
        let are = counted(
            withheld,
            "point is flagged as withheld: no step sees it",
            "points are flagged as withheld: no step sees them",
        );
        tracing::warn!("{}: {are}", input.display());
        notes.push(are);
    }
    let shift = plan.shift.or(header.shift).unwrap_or([0.0; 3]);
    let mut steps = Vec::new();
    let mut active = tiles.points - withheld;
    for (index, step) in plan.steps.iter().enumerate() {
        let span = tracing::info_span!("step");
        let report = span.in_scope(|| run_step(&mut tiles, step, (index + 1) as u8, active, shift, plan))?;
        tracing::info!(step = report.step, points_in = report.points_in, classified = report.classified, "step");
        active -= if matches!(step, Step::Ground(_)) { report.dropped } else { report.classified };
        steps.push(report);
    }
    let dropped: u64 = steps.iter().map(|step| step.dropped).sum();
    let points = tiles.indices.max(tiles.points + invalid);
    let kept = tiles.points - dropped;
    let camera = plan.steps.iter().rev().find_map(|step| match step {
        Step::Crop(Crop::Range { camera, .. }) => Some(*camera),
        _ => None,
    });
    let bounds = if kept == 0 { tiles.bounds } else { kept_bounds(&tiles, plan, dropped)? };
    let target = Target {
        source: &header,
        shift,
        points: kept,
        with_range: camera.is_some(),
        min: bounds.min,
        max: bounds.max,
        crs_wkt: plan.crs_wkt.as_deref(),
        scratch: &plan.scratch,
        memory_bytes: plan.working_bytes(),
    };
    let summary = write(input, output, named, &target, &mut tiles, plan, camera)?;
    Ok(CleanReport {
        input: input.to_path_buf(),
        output: named.to_path_buf(),
        format: header.description,
        unit: io::unit_of(header.crs.as_deref().or(plan.crs_wkt.as_deref())),
        crs: header.crs,
        shift,
        points,
        invalid,
        withheld,
        points_kept: kept,
        tiles: tiles.tiles.len(),
        seconds: began.elapsed().as_secs_f64(),
        steps,
        summary,
        notes,
    })
}

/// Settles the reference system, refuses what makes no sense in it, and says what the output will not carry.
fn look(input: &Path, named: &Path, plan: &Plan, header: &mut Header) -> Result<Vec<String>> {
    let asked = plan.crs_wkt.as_deref();
    let to_ply = io::format_of(named)? == io::Format::Ply;
    // PLY takes any words, LAS only WKT.
    if let Some(words) = header.crs.as_deref().filter(|text| !text.contains('['))
        && asked.is_none()
        && !to_ply
        && header.parsed_crs().is_none()
    {
        let words: String = words.chars().take(60).collect();
        let what = format!("{}: PROJ does not understand its reference system `{words}`", input.display());
        return Err(Error::usage(what, "give it with --crs"));
    }
    let mut notes: Vec<String> = header.settle_crs(asked, "it goes on as it came").into_iter().collect();
    if let Some(step) = plan.steps.iter().find(|step| step.needs_lengths()) {
        header.refuse_degrees(input, asked, &format!("the step {}", step.name()))?;
    }
    notes.extend(header.las.iter().flat_map(|las| las.not_kept.clone()));
    if to_ply {
        notes.extend(header.lost_in_ply());
    }
    for note in &notes {
        tracing::warn!("{}: {note}", input.display());
    }
    Ok(notes)
}

/// What the points that are written span. LAS counts in tenths of a millimetre up to some 200 km; in a wider cloud a
/// stray point that was dropped must not make its steps coarse.
fn kept_bounds(tiles: &Tiles, plan: &Plan, dropped: u64) -> Result<Bounds> {
    const WIDE: f64 = 2e5;
    let all = &tiles.bounds;
    if dropped == 0 || (0..3).all(|axis| all.max[axis] - all.min[axis] <= WIDE) {
        return Ok(*all);
    }
    let mut bounds = Bounds::EMPTY;
    for tile in 0..tiles.tiles.len() {
        let points = tiles.load(tile)?;
        points.iter().filter(|p| !plan.drops(p.class())).for_each(|p| bounds.add(p.xyz));
    }
    Ok(bounds)
}

/// All points of a cloud, shared out among tiles.
struct Spooled {
    tiles: Tiles,
    invalid: u64,
    withheld: u64,
    left_over: Option<String>,
}

/// Reads all points and shares them out.
fn spool(input: &Path, plan: &Plan) -> Result<Spooled> {
    let (header, mut reader) = io::open(input)?;
    let flag = header.schema.field("withheld");
    let mut scratch = Scratch::new(&plan.scratch)?;
    let mut spool = Spool::new(&mut scratch)?;
    let mut batch = Batch::default();
    let (mut index, mut invalid, mut withheld) = (0u64, 0, 0);
    loop {
        reader.read(&mut batch, BATCH)?;
        if batch.is_empty() {
            break;
        }
        for (at, &xyz) in batch.xyz.iter().enumerate() {
            if xyz.iter().all(|value| value.is_finite()) {
                let mut point = Point::new(xyz, index);
                if flag.is_some_and(|flag| flag.value(batch.record(&header.schema, at)) == 1.0) {
                    point.withhold();
                    withheld += 1;
                }
                spool.push(&scratch, &point)?;
            } else if plan.invalid == Invalid::Refuse {
                let [x, y, z] = xyz.map(in_short);
                let what = format!(
                    "the coordinates ({x}, {y}, {z}) are not finite; leave such points out with --skip-invalid"
                );
                return Err(Error::format(input, format!("point {}", index + 1), what));
            } else {
                invalid += 1;
            }
            index += 1;
        }
    }
    let left_over = reader.left_over()?;
    if let Some(note) = &left_over {
        tracing::warn!("{}: {note}", input.display());
    }
    if spool.points == 0 {
        return Err(Error::format(input, "points", "there are none; leave the file out"));
    }
    if spool.points > 1 && spool.bounds.min == spool.bounds.max {
        let [x, y, z] = spool.bounds.min.map(in_short);
        return Err(Error::format(input, "points", format!("all {} lie at one place, ({x}, {y}, {z})", spool.points)));
    }
    spool.indices = index;
    let tiles = Tiles::new(scratch, spool, plan.most_tile_points())?;
    Ok(Spooled { tiles, invalid, withheld, left_over })
}

fn run_step(
    tiles: &mut Tiles,
    step: &Step,
    number: u8,
    active: u64,
    shift: [f64; 3],
    plan: &Plan,
) -> Result<StepReport> {
    let began = Instant::now();
    let kept = TREES as usize * plan.most_tile_points();
    let mut statistics = None;
    let classified = match step {
        Step::Crop(crop) => {
            let mut gone = 0;
            tiles.update(|_, points| {
                let here = points.par_iter_mut().filter(|point| point.is_active()).map(|point| {
                    let out = !crop.keeps(to_map(point.xyz, shift));
                    if out {
                        point.take_out(NOISE, number);
                    }
                    u64::from(out)
                });
                let here: u64 = here.sum();
                gone += here;
                Ok(here > 0)
            })?;
            gone
        }
        Step::Outliers { neighbours, multiplier } => {
            let (noise, measured) = outliers::statistical(tiles, *neighbours, *multiplier, kept, number)?;
            statistics = Some(measured);
            noise
        }
        Step::Radius { radius_m, least } => outliers::radius(tiles, *radius_m, *least, kept, number)?,
        Step::Low { cell_m, gap_m } => elm::low_points(tiles, *cell_m, *gap_m, plan.working_bytes(), number)?,
        Step::Isolated(options) => isolated::find(tiles, options, kept, number)?,
        Step::Ground(options) => {
            let objects = if plan.drop_objects { smrf::Objects::Go } else { smrf::Objects::Stay };
            smrf::ground(tiles, options, smrf::Lattice::default(), plan.working_bytes(), number, objects)?
        }
    };
    let is_ground = matches!(step, Step::Ground(_));
    let drops = if is_ground { plan.drop_objects } else { plan.drop_noise };
    Ok(StepReport {
        step: step.name().into(),
        points_in: active,
        classified,
        dropped: if drops { classified } else { 0 },
        seconds: began.elapsed().as_secs_f64(),
        statistics,
        greatest_range_m: match step {
            Step::Crop(crop) => crop.greatest_range_m(),
            _ => None,
        },
        ground: is_ground.then(|| active - classified),
    })
}

fn to_map(xyz: [f64; 3], shift: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|axis| xyz[axis] + shift[axis])
}

/// Reads the cloud once more and writes it with its classes.
fn write(
    input: &Path,
    output: &Path,
    named: &Path,
    target: &Target<'_>,
    tiles: &mut Tiles,
    plan: &Plan,
    camera: Option<[f64; 3]>,
) -> Result<Summary> {
    let part_points = (plan.working_bytes() / 8).clamp(1, 1 << 31);
    let mut verdicts = Verdicts::new(tiles, part_points)?;
    let (header, mut reader) = io::open(input)?;
    let mut writer = io::create(output, named, target)?;
    let mut summary = Summary::new(plan.steps.iter().map(Step::name), tiles.bounds.min, tiles.bounds.max, target.shift);
    // Noise is what this run found: labels of an earlier run would hide it.
    let seeks_noise = plan.steps.iter().any(|step| !matches!(step, Step::Ground(_)));
    let class_field = header.schema.field("classification").cloned();
    let withheld_field = header.schema.field("withheld").cloned();
    let mut batch = Batch::default();
    let mut index = 0;
    loop {
        reader.read(&mut batch, BATCH)?;
        if batch.is_empty() {
            break;
        }
        let mut points = Vec::with_capacity(batch.len());
        for (at, &xyz) in batch.xyz.iter().enumerate() {
            let verdict = verdicts.get(&tiles.scratch, index)?;
            index += 1;
            let Some((class, step)) = verdict else { continue };
            let step = step & 0x7f;
            let dropped = plan.drops(class);
            summary.add(xyz, class, step, dropped);
            if dropped {
                continue;
            }
            let raw = batch.record(&header.schema, at);
            let came = || class_field.as_ref().map_or(0, |field| field.value(raw) as u8);
            // No step saw it: what it came as stands.
            let is_withheld = || withheld_field.as_ref().is_some_and(|field| field.value(raw) == 1.0);
            let class = match class {
                0 if seeks_noise && matches!(came(), 7 | 18) && !is_withheld() => Some(OBJECT),
                0 if class_field.is_none() => Some(OBJECT),
                0 => None,
                class => Some(class),
            };
            let range = camera.map(|camera| crop::distance(to_map(xyz, target.shift), camera));
            points.push(OutPoint { xyz, raw, class, range });
        }
        writer.write(&points)?;
    }
    // An octree needs the memory.
    drop(verdicts);
    let written = writer.finish()?;
    if written != target.points {
        let what = format!("{written} points are kept, {} were counted: the file changed meanwhile", target.points);
        return Err(Error::format(input, "points", what));
    }
    Ok(summary)
}
