//! The detector of coded targets: cells, the decoder's look, the fit on our own pixels.

use locus_core::{CornerRefinementMode, DetectorBuilder, DetectorConfig, ImageView, LocusEngine, TagFamily};

use super::fit::{Fit, MOST_MODULES, Pattern, Pose, fit};
use crate::black_white::grey::{Plane, level, mean_of_cell};
use crate::black_white::kernels::Sample;
use crate::black_white::once_each;
use crate::candidate::{Candidate, Code};
use crate::detector::Detector;
use crate::profile::Family;
use crate::profile::Profile;
use crate::segment::label::Region;
use autoref_raster::bilinear::by_weights;
use autoref_raster::coords::PixelPoint;
use autoref_raster::error::{Error, Result};
use autoref_raster::mask::Mask;
use autoref_raster::window::Window;
use autoref_raster::{Block, Patch, Pixels, RasterInfo};

/// Sides of a cell in largest tags: the border about a cell is read again with its neighbour.
const CELL_SIDES: f64 = 2.0;
/// Cells no smaller than this, pixels.
const SMALLEST_CELL_PX: u64 = 64;
/// Where the border of a tag may be fitted: half a module of white about it is all that is asked for.
const QUIET_MODULES: f64 = 0.45;
/// A fit takes about this many cells a module; larger ones are averaged first.
const FIT_CELLS: f64 = 6.0;
/// Below this many pixels a module, the decoder is shown the window enlarged.
const ENLARGE_BELOW_PX: f64 = 5.0;
/// What the fit cannot see of its own error: ground that shines through is alike over more than the few pixels that the
/// covariance takes for neighbours, and rounding and JPEG move edges together (measured on 2,518 planted tags,
/// `docs/decisions/coded-targets.md`). A factor on the variances, and a standard deviation in pixels.
const UNSEEN: f64 = 1.5;
const FLOOR_PX: f64 = 0.005;

/// Finds the tags of a family in a raster.
pub struct CodedDetector {
    family: Family,
    side_px: (f64, f64),
    /// Least difference of black and white, grey levels.
    least: f64,
    min_score: f64,
    engine: LocusEngine,
    info: RasterInfo,
    finish: Profile,
}

/// A tag that was read and measured, image pixels.
struct Tag {
    number: u32,
    fit: Fit,
    score: f64,
}

impl CodedDetector {
    /// # Errors
    /// [`Error::Usage`] when the profile is not valid, is not one of tags, or gives metres and `gsd_m` is unknown.
    pub fn new(profile: Profile, info: &RasterInfo, gsd_m: Option<f64>) -> Result<CodedDetector> {
        profile.validate()?;
        let Some(tag) = profile.tag else {
            return Err(Error::usage(
                format!("profile \"{}\" is not one of coded targets", profile.name),
                "give shape = \"tag\" and [tag] family",
            ));
        };
        let side_px = profile.side_range_px(gsd_m)?;
        Ok(CodedDetector {
            family: tag.family,
            side_px,
            least: 255.0 * profile.target.min_contrast,
            min_score: profile.examine.min_score,
            engine: engine(tag.family, side_px.0),
            info: info.clone(),
            finish: profile,
        })
    }

    /// For places where a tag must be: half the contrast and a weak score are enough. The number must still be read.
    pub fn relaxed(&self) -> CodedDetector {
        CodedDetector {
            family: self.family,
            side_px: self.side_px,
            least: (self.least / 2.0).max(8.0),
            min_score: self.min_score.min(0.0) - 4.0,
            engine: engine(self.family, self.side_px.0),
            info: self.info.clone(),
            finish: self.finish.clone(),
        }
    }

    fn cell_px(&self) -> u64 {
        ((CELL_SIDES * self.side_px.1).ceil() as u64).max(SMALLEST_CELL_PX)
    }

    /// Half the diagonal of the largest tag with its quiet zone.
    fn border_px(&self) -> u64 {
        let quiet = 1.0 + 2.0 / self.family.modules() as f64;
        (self.side_px.1 * quiet * std::f64::consts::FRAC_1_SQRT_2).ceil() as u64 + 8
    }

    /// The cell that holds a pixel, clipped to the raster.
    fn cell_of(&self, x: u64, y: u64) -> Window {
        let size = self.cell_px();
        Window::new(x / size * size, y / size * size, size, size).intersect(&self.info.bounds())
    }

    /// The pixel that stands for a cell.
    fn stands_for(cell: Window) -> (u64, u64) {
        (cell.x + cell.width / 2, cell.y + cell.height / 2)
    }

    /// Whether the cell's grey has the contrast of a tag. A tag with its middle in the cell has a quarter of it there.
    fn may_hold(&self, plane: &Plane, cell: Window) -> bool {
        let (mut low, mut high) = (255u8, 0u8);
        for y in cell.y..cell.bottom() {
            let row = plane.row((y - plane.y) as usize);
            for &v in &row[(cell.x - plane.x) as usize..(cell.right() - plane.x) as usize] {
                (low, high) = (low.min(v), high.max(v));
            }
        }
        f64::from(high.saturating_sub(low)) >= self.least
    }

    /// All tags whose middle lies in the region's cell (or a pixel beside it), as the decoder lists them.
    fn tags(&self, region: &Region, pixels: &dyn Pixels) -> Vec<Tag> {
        let cell = self.cell_of(region.bounds.x, region.bounds.y);
        let patch = pixels.part(&cell.grown(self.border_px(), &self.info.bounds()));
        let window = patch.window;
        let mut plane = Plane::of_patch(&patch, window);
        // The decoder may load four bytes where it needs one.
        plane.data.extend([0; 3]);
        let (width, height) = (plane.width, plane.height);
        let Ok(view) = ImageView::new(&plane.data, width, height, width) else { return Vec::new() };
        let read = self.engine.detect_concurrent(&[view], None, None).pop();
        let Some(Ok(read)) = read else { return Vec::new() };
        let (ox, oy) = (window.x as f64, window.y as f64);
        read.iter()
            .filter_map(|seen| {
                let corners = seen.corners.map(|[x, y]| [ox + x, oy + y]);
                let tag = self.measure(&patch, corners)?;
                let [x, y] = tag.0.pose.centre;
                let inside = |v: f64, from: u64, to: u64| (from as f64 - 1.0..to as f64 + 1.0).contains(&v);
                let here = inside(x, cell.x, cell.right()) && inside(y, cell.y, cell.bottom());
                here.then_some(Tag { number: seen.id, fit: tag.0, score: tag.1 })
            })
            .collect()
    }

    /// Pattern, centre and score of a tag about the decoder's corners; `None` when our pixels do not show one.
    fn measure(&self, patch: &Patch, corners: [[f64; 2]; 4]) -> Option<(Fit, f64)> {
        let n = self.family.modules();
        let start = Pose::of_corners(corners, n);
        let side = start.module() * n as f64;
        let (low, high) = (0.75 * self.side_px.0, 1.25 * self.side_px.1);
        if !start.is_square() || !(low..=high).contains(&side) {
            return None;
        }
        let (black, levels) = pattern(patch, &start, n)?;
        let size = ((start.module() / FIT_CELLS).floor() as u64).max(1);
        let scale = size as f64;
        let (ox, oy) = (patch.window.x as f64, patch.window.y as f64);
        let [x, y] = start.centre;
        let in_cells = Pose {
            centre: [(x - ox) / scale, (y - oy) / scale],
            along: start.along.map(|step| step.map(|v| v / scale)),
        };
        let samples = samples(patch, &in_cells, n, size)?;
        let found = fit(&samples, n, black, in_cells, 0.9, levels)?;
        let [x, y] = found.pose.centre;
        let floor = FLOOR_PX * FLOOR_PX;
        let [xx, xy, yy] = found.covariance.map(|v| UNSEEN * v * scale * scale);
        let whole = Fit {
            pose: Pose {
                centre: [ox + x * scale, oy + y * scale],
                along: found.pose.along.map(|step| step.map(|v| v * scale)),
            },
            covariance: [xx + floor, xy, yy + floor],
            ..found
        };
        let side = whole.pose.module() * n as f64;
        let good = whole.height >= self.least && whole.pose.is_square() && (low..=high).contains(&side);
        good.then(|| (whole, score(whole.misfit)))
    }

    fn candidate(&self, tag: &Tag) -> Candidate {
        let [x, y] = tag.fit.pose.centre;
        let side = tag.fit.pose.module() * self.family.modules() as f64;
        Candidate {
            centre: PixelPoint { x, y },
            covariance_px2: Some(tag.fit.covariance),
            score: Some(tag.score),
            area_px: Some(side * side),
            size_px: Some([side; 2]),
            elevation_m: None,
            code: Some(Code { family: self.family.name().to_string(), number: tag.number }),
            paint: None,
        }
    }
}

fn engine(family: Family, smallest_side_px: f64) -> LocusEngine {
    let family_of = match family {
        Family::Apriltag16h5 => TagFamily::AprilTag16h5,
        Family::Apriltag36h11 => TagFamily::AprilTag36h11,
        Family::Aruco4x4x50 => TagFamily::ArUco4x4_50,
        Family::Aruco4x4x100 => TagFamily::ArUco4x4_100,
        Family::Aruco6x6x250 => TagFamily::ArUco6x6_250,
        Family::ArucoMip36h12 => TagFamily::ArUcoMip36h12,
    };
    let enlarged = smallest_side_px / (family.modules() as f64) < ENLARGE_BELOW_PX;
    let config = DetectorConfig {
        upscale_factor: if enlarged { 2 } else { 1 },
        // Corners are only where our own fit starts.
        refinement_mode: CornerRefinementMode::Erf,
        ..DetectorConfig::default()
    };
    DetectorBuilder::new().with_config(config).with_family(family_of).with_max_concurrent_frames(2).build_engine()
}

/// Which modules are black, and the levels of black and white: the border is black by definition, a module of the
/// inside when it is nearer to that than to the brightest quarter of the inside.
fn pattern(patch: &Patch, pose: &Pose, n: usize) -> Option<(Pattern, (f64, f64))> {
    let half = n as f64 / 2.0;
    let mut means = [[0.0; MOST_MODULES]; MOST_MODULES];
    for (j, row) in means.iter_mut().enumerate().take(n) {
        for (i, mean) in row.iter_mut().enumerate().take(n) {
            let places = [(0.5, 0.5), (0.3, 0.3), (0.7, 0.3), (0.3, 0.7), (0.7, 0.7)];
            for (u, v) in places {
                let [x, y] = pose.at(i as f64 + u - half, j as f64 + v - half);
                *mean += bilinear(patch, x, y)? / places.len() as f64;
            }
        }
    }
    let is_border = |i: usize, j: usize| i == 0 || j == 0 || i + 1 == n || j + 1 == n;
    let of = |border: bool| -> Vec<f64> {
        let all = (0..n * n).map(|k| (k % n, k / n)).filter(|&(i, j)| is_border(i, j) == border);
        all.map(|(i, j)| means[j][i]).collect()
    };
    let dark = autoref_raster::ranks::median(of(true));
    let mut inside = of(false);
    inside.sort_by(f64::total_cmp);
    let bright = inside[inside.len() * 7 / 8];
    let mid = (dark + bright) / 2.0;
    let mut black: Pattern = [0; MOST_MODULES];
    for (j, row) in black.iter_mut().enumerate().take(n) {
        for i in (0..n).filter(|&i| is_border(i, j) || means[j][i] < mid) {
            *row |= 1 << i;
        }
    }
    (bright > dark + 1.0).then_some((black, (dark, bright)))
}

fn bilinear(patch: &Patch, x: f64, y: f64) -> Option<f64> {
    let (fx, fy) = (x - 0.5 - patch.window.x as f64, y - 0.5 - patch.window.y as f64);
    let (x0, y0) = (fx.floor(), fy.floor());
    let (width, height) = (patch.window.width as f64, patch.window.height as f64);
    if !(x0 >= 0.0 && y0 >= 0.0 && x0 + 1.0 < width && y0 + 1.0 < height) {
        return None;
    }
    let at = |dx: usize, dy: usize| {
        let i = (y0 as usize + dy) * patch.window.width as usize + x0 as usize + dx;
        patch.valid[i].then(|| level(patch.rgb[i], patch.white))
    };
    let (a, b) = (fx - x0, fy - y0);
    Some(by_weights([[at(0, 0)?, at(1, 0)?], [at(0, 1)?, at(1, 1)?]], [a, b]))
}

/// Means of whole cells of `size` pixels on the tag and its quiet zone; `None` when a tenth of them is not there.
fn samples(patch: &Patch, pose: &Pose, n: usize, size: u64) -> Option<Vec<Sample>> {
    let inverse = pose.inverse()?;
    let reach = n as f64 / 2.0 + QUIET_MODULES;
    let (width, height) = (patch.window.width / size, patch.window.height / size);
    let extent = |i: usize| reach * (pose.along[0][i].abs() + pose.along[1][i].abs());
    let range = |i: usize, len: u64| {
        let (c, e) = (pose.centre[i], extent(i));
        (c - e).max(0.0) as u64..((c + e).ceil().max(0.0) as u64).min(len)
    };
    let mut out = Vec::new();
    for (v, u) in range(1, height).flat_map(|v| range(0, width).map(move |u| (v, u))) {
        let (x, y) = (u as f64 + 0.5, v as f64 + 0.5);
        let (dx, dy) = (x - pose.centre[0], y - pose.centre[1]);
        if inverse.iter().any(|row| (row[0] * dx + row[1] * dy).abs() > reach) {
            continue;
        }
        out.extend(mean_of_cell(patch, (u, v), size).map(|level| Sample { x, y, level }));
    }
    let module = pose.module();
    (out.len() as f64 >= 0.9 * (2.0 * reach * module).powi(2)).then_some(out)
}

/// Log-likelihood ratio of "tag" against "something else that decodes", natural logarithm.
///
/// The measurement is the logarithm of the share of variance that the model leaves over, taken as Gaussian for both. A
/// fit better than the mean does not count further.
fn score(misfit: f64) -> f64 {
    const TAG: (f64, f64) = (-5.0, 1.2);
    const CLUTTER: (f64, f64) = (-1.4, 0.75);
    let at = misfit.max(1e-6).ln().max(TAG.0);
    let log_density = |(mean, sd): (f64, f64)| -0.5 * ((at - mean) / sd).powi(2) - sd.ln();
    log_density(TAG) - log_density(CLUTTER)
}

impl Detector for CodedDetector {
    fn halo_px(&self) -> u64 {
        self.cell_px()
    }

    /// One pixel stands for each cell that may hold a tag.
    fn segment_block(&self, block: &Block, mask: &mut Mask) {
        let plane = Plane::of_block(block, &self.info);
        let (window, size) = (block.window, self.cell_px());
        for y in (window.y / size * size..window.bottom()).step_by(size as usize) {
            for x in (window.x / size * size..window.right()).step_by(size as usize) {
                let cell = self.cell_of(x, y);
                if window.contains_window(&cell) && self.may_hold(&plane, cell) {
                    let (x, y) = Self::stands_for(cell);
                    mask.set(x, y, true);
                }
            }
        }
    }

    fn gate(&self, _region: &Region) -> bool {
        true
    }

    fn patch_margin_px(&self) -> u64 {
        self.cell_px().div_ceil(2) + 1 + self.border_px()
    }

    fn largest_mark_px(&self) -> u64 {
        2 * self.border_px()
    }

    fn examine(&self, region: &Region, pixels: &dyn Pixels) -> Option<Candidate> {
        self.examine_all(region, pixels).into_iter().reduce(|a, b| if b.score > a.score { b } else { a })
    }

    fn examine_all(&self, region: &Region, pixels: &dyn Pixels) -> Vec<Candidate> {
        let tags = self.tags(region, pixels);
        tags.iter().filter(|tag| tag.score >= self.min_score).map(|tag| self.candidate(tag)).collect()
    }

    fn refine(&self, region: &Region, pixels: &dyn Pixels) -> Vec<Candidate> {
        self.examine_all(region, pixels)
    }

    /// The black square.
    fn outline(&self, region: &Region, pixels: &dyn Pixels) -> Option<(PixelPoint, Vec<PixelPoint>)> {
        let tags = self.tags(region, pixels);
        let best = tags.into_iter().reduce(|a, b| if b.score > a.score { b } else { a })?;
        let half = self.family.modules() as f64 / 2.0;
        let point = |[x, y]: [f64; 2]| PixelPoint { x, y };
        let corners = [(-half, -half), (half, -half), (half, half), (-half, half)];
        Some((point(best.fit.pose.centre), corners.map(|(u, v)| point(best.fit.pose.at(u, v))).to_vec()))
    }

    fn finish(&self, list: Vec<Candidate>) -> Vec<Candidate> {
        crate::candidate::finish(once_each(list), &self.finish)
    }
}
