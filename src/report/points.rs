//! What the page says of every GCP, and the pictures that go with it.

use std::collections::HashMap;

use serde::Serialize;

use crate::candidate::{Candidate, Code};
use crate::detector::Detector;
use crate::gcp::Gcp;
use crate::pipeline::georeference::FoundBy;
use crate::report::chips::cut;
use crate::report::frame::Spot;
use crate::report::jpeg::{Colours, data_uri};
use crate::report::kept_pixels::KeptPixels;
use crate::report::overview::Overview;
use crate::result::{MatchRow, RunResult};
use autoref_raster::RasterSource;
use autoref_raster::coords::PixelPoint;
use autoref_raster::error::Result;
use autoref_raster::ranks::upper_median;

/// No more chips than this, whatever the list: a page must open.
const MAX_CHIPS: usize = 400;
/// Candidates drawn as dots on the overview.
const MAX_DOTS: usize = 1500;
/// Candidates near a GCP that the reviewer may pick instead.
const PROPOSALS: usize = 3;
/// A candidate this close (or four marks) to where a GCP must be is worth showing.
const NEAR_PX: f64 = 60.0;
/// Chips of a refused run without any pattern: the candidates that look most like marks.
const GALLERY: usize = 24;

/// A GCP on the page.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Point {
    #[serde(flatten)]
    gcp: Gcp,
    state: State,
    /// Why a point inside the image has no mark.
    #[serde(skip_serializing_if = "Option::is_none")]
    why: Option<String>,
    /// Where the transform puts it, pixels.
    expected: Option<[f64; 2]>,
    mark: Option<Mark>,
    /// Other candidates near the expected place, nearest first.
    proposals: Vec<Mark>,
    /// Picture of the expected place of a GCP without a mark.
    chip: Option<usize>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
enum State {
    /// Its mark is used: in the fit, or compared when it is a check point.
    Found,
    /// In the best pattern of a refused run.
    Proposed,
    NotFound,
    Outside,
    /// Nothing is known: no transform.
    Unknown,
}

/// A mark or a candidate on the page.
#[derive(Clone, Debug, Serialize)]
struct Mark {
    x: f64,
    y: f64,
    covariance_px2: Option<[f64; 3]>,
    score: Option<f64>,
    /// What a coded target says of itself, as `family:number`.
    #[serde(skip_serializing_if = "Option::is_none")]
    code: Option<Code>,
    found_by: FoundBy,
    /// Index in the result's list.
    candidate: Option<usize>,
    size_px: Option<[f64; 2]>,
    chip: Option<usize>,
}

/// A picture on the page.
#[derive(Clone, Debug, Serialize)]
pub(super) struct ChipData {
    left: i64,
    top: i64,
    side_px: u64,
    src: String,
    outline: Option<Vec<[f64; 2]>>,
}

/// The candidates as dots, and the best of them as pictures when there is no pattern.
#[derive(Clone, Debug, Default, Serialize)]
pub(super) struct Candidates {
    total: usize,
    dots: Vec<[f64; 2]>,
    gallery: Vec<Mark>,
}

/// Everything on the page that needed the image.
#[derive(Clone, Debug)]
pub struct Gathered {
    pub(super) points: Vec<Point>,
    pub(super) candidates: Candidates,
    pub(super) chips: Vec<ChipData>,
    pub(super) overview: String,
    pub(super) overview_size: (usize, usize),
}

/// Works out what to show, cuts the windows, and encodes the pictures.
///
/// # Errors
/// When a window cannot be read or a picture not be encoded.
pub fn gather(
    source: &dyn RasterSource,
    detector: &dyn Detector,
    overview: &Overview,
    kept: &KeptPixels,
    result: &RunResult,
) -> Result<Gathered> {
    let (picture, stretch) = overview.picture();
    let mut plan = Plan::new(result);
    plan.points(source.info().width as f64, source.info().height as f64);
    if result.refused().is_some_and(|refused| refused.best_pattern.is_none()) {
        plan.gallery();
    }
    let Plan { points, candidates, spots, .. } = plan;
    let (overview_uri, chips) = rayon::join(
        || data_uri(&picture, 72, Colours::Half),
        || -> Result<Vec<ChipData>> {
            use rayon::prelude::*;
            let chips = cut(source, detector, stretch, kept, &spots)?;
            chips
                .into_par_iter()
                .map(|chip| {
                    let round = |v: f64| (v * 100.0).round() / 100.0;
                    let outline = chip.outline.map(|o| o.iter().map(|p| [round(p.x), round(p.y)]).collect());
                    let src = data_uri(&chip.picture, 85, Colours::Full)?;
                    Ok(ChipData { left: chip.left, top: chip.top, side_px: chip.side_px, src, outline })
                })
                .collect()
        },
    );
    let overview_size = (picture.width, picture.height);
    Ok(Gathered { points, candidates, chips: chips?, overview: overview_uri?, overview_size })
}

/// The points under construction, and the windows to cut.
struct Plan<'a> {
    result: &'a RunResult,
    /// Candidates by the bits of their centres.
    by_centre: HashMap<(u64, u64), usize>,
    /// Typical longest side of a mark.
    mark_px: f64,
    points: Vec<Point>,
    candidates: Candidates,
    spots: Vec<Spot>,
}

impl<'a> Plan<'a> {
    fn new(result: &'a RunResult) -> Self {
        let key = |p: PixelPoint| (p.x.to_bits(), p.y.to_bits());
        let by_centre: HashMap<_, _> = result.candidates.iter().enumerate().map(|(i, c)| (key(c.centre), i)).collect();
        let longest = |c: &Candidate| c.size_px.map(|[w, h]| w.max(h));
        let matched = result.matches().iter().filter_map(|row| by_centre.get(&(row.x.to_bits(), row.y.to_bits())));
        let mut sizes: Vec<f64> = matched.filter_map(|&i| longest(&result.candidates[i])).collect();
        if sizes.is_empty() {
            sizes = result.candidates.iter().take(1000).filter_map(longest).collect();
        }
        let mark_px = upper_median(&mut sizes).unwrap_or(16.0);
        let candidates =
            Candidates { total: result.candidates_found, dots: dots(&result.candidates), gallery: Vec::new() };
        Plan { result, by_centre, mark_px, points: Vec::new(), candidates, spots: Vec::new() }
    }

    fn points(&mut self, width: f64, height: f64) {
        let result = self.result;
        let similarity = result.similarity();
        let rows: HashMap<&str, &MatchRow> =
            result.matches().iter().chain(result.check_points()).map(|row| (row.gcp.as_str(), row)).collect();
        let proposed: HashMap<usize, usize> = result
            .best_pattern()
            .into_iter()
            .flat_map(|pattern| &pattern.pairs)
            .map(|&(candidate, gcp)| (gcp, candidate))
            .collect();
        let missing: HashMap<&str, String> = result
            .solved()
            .into_iter()
            .flat_map(|solved| &solved.not_found)
            .map(|point| (point.name.as_str(), point.why()))
            .collect();
        for (i, gcp) in result.gcps.iter().enumerate() {
            let expected = similarity.map(|s| s.invert(gcp.position()));
            let inside = |p: PixelPoint| p.x >= 0.0 && p.y >= 0.0 && p.x < width && p.y < height;
            let (state, mark) = match (rows.get(gcp.name.as_str()), proposed.get(&i), expected) {
                (Some(row), ..) => (State::Found, Some(self.mark_of_row(row))),
                (None, Some(&candidate), _) => (State::Proposed, Some(self.mark_of(candidate))),
                (None, None, Some(p)) if inside(p) => (State::NotFound, None),
                (None, None, Some(_)) => (State::Outside, None),
                (None, None, None) => (State::Unknown, None),
            };
            let expected = expected.map(|p| [p.x, p.y]);
            let why = missing.get(gcp.name.as_str()).filter(|_| state == State::NotFound).cloned();
            self.points.push(Point { gcp: gcp.clone(), state, why, expected, mark, proposals: Vec::new(), chip: None });
        }
        self.pictures();
    }

    /// Chips in order of worth: marks, places of missing ones, what else may be picked.
    fn pictures(&mut self) {
        let mut points = std::mem::take(&mut self.points);
        for mark in points.iter_mut().filter_map(|point| point.mark.as_mut()) {
            mark.chip = self.picture(mark);
        }
        for point in points.iter_mut().filter(|point| point.state == State::NotFound) {
            let [x, y] = point.expected.expect("a missing point has a place where it must be");
            let spot = Spot::of_mark(PixelPoint { x, y }, self.mark_px);
            point.chip = self.spot(Spot { side_px: 2 * spot.side_px, mark_px: None, ..spot });
        }
        let used: Vec<usize> =
            points.iter().filter_map(|point| point.mark.as_ref()).filter_map(|mark| mark.candidate).collect();
        for point in &mut points {
            let Some([x, y]) = point.expected.filter(|_| point.state != State::Outside) else { continue };
            for candidate in self.near(x, y, &used) {
                let mut mark = self.mark_of(candidate);
                mark.chip = self.picture(&mark);
                point.proposals.push(mark);
            }
        }
        self.points = points;
    }

    /// Candidates near a place that are nobody's mark, nearest first.
    fn near(&self, x: f64, y: f64, used: &[usize]) -> Vec<usize> {
        let reach = NEAR_PX.max(4.0 * self.mark_px);
        let mut near: Vec<(f64, usize)> = self
            .result
            .candidates
            .iter()
            .enumerate()
            .map(|(i, c)| ((c.centre.x - x).hypot(c.centre.y - y), i))
            .filter(|(distance, i)| *distance <= reach && !used.contains(i))
            .collect();
        near.sort_by(|a, b| a.0.total_cmp(&b.0));
        near.into_iter().take(PROPOSALS).map(|(_, i)| i).collect()
    }

    fn gallery(&mut self) {
        let candidates = &self.result.candidates;
        let mut best: Vec<usize> = (0..candidates.len()).collect();
        best.sort_by(|&a, &b| score(&candidates[b]).total_cmp(&score(&candidates[a])));
        for candidate in best.into_iter().take(GALLERY) {
            let mut mark = self.mark_of(candidate);
            mark.chip = self.picture(&mark);
            self.candidates.gallery.push(mark);
        }
    }

    /// The chip of a mark.
    fn picture(&mut self, mark: &Mark) -> Option<usize> {
        let size = mark.size_px.map_or(self.mark_px, |[w, h]| w.max(h));
        self.spot(Spot::of_mark(PixelPoint { x: mark.x, y: mark.y }, size))
    }

    fn spot(&mut self, spot: Spot) -> Option<usize> {
        if self.spots.len() >= MAX_CHIPS {
            return None;
        }
        self.spots.push(spot);
        Some(self.spots.len() - 1)
    }

    fn mark_of_row(&self, row: &MatchRow) -> Mark {
        let candidate = self.by_centre.get(&(row.x.to_bits(), row.y.to_bits())).copied();
        Mark {
            x: row.x,
            y: row.y,
            covariance_px2: row.covariance_px2,
            score: row.score,
            code: row.code.clone(),
            found_by: row.found_by,
            candidate,
            size_px: candidate.and_then(|i| self.result.candidates[i].size_px),
            chip: None,
        }
    }

    fn mark_of(&self, candidate: usize) -> Mark {
        let c = &self.result.candidates[candidate];
        Mark {
            x: c.centre.x,
            y: c.centre.y,
            covariance_px2: c.covariance_px2,
            score: c.score,
            code: c.code.clone(),
            found_by: FoundBy::Scan,
            candidate: Some(candidate),
            size_px: c.size_px,
            chip: None,
        }
    }
}

fn score(candidate: &Candidate) -> f64 {
    candidate.score.unwrap_or(f64::NEG_INFINITY)
}

/// The best candidates, to a tenth of a pixel.
fn dots(candidates: &[Candidate]) -> Vec<[f64; 2]> {
    let mut best: Vec<&Candidate> = candidates.iter().collect();
    if best.len() > MAX_DOTS {
        best.select_nth_unstable_by(MAX_DOTS, |a, b| score(b).total_cmp(&score(a)));
        best.truncate(MAX_DOTS);
    }
    best.iter().map(|c| [c.centre.x, c.centre.y].map(|v| (v * 10.0).round() / 10.0)).collect()
}
