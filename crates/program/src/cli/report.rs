//! The report beside a result: its flags, what it gathers during the scan, and when it is made.

use std::path::{Path, PathBuf};

use autoref_raster::coords::PixelPoint;
use autoref_raster::window::Window;
use autoref_raster::{Block, RasterSource};
use autoref_solve::accuracy::AccuracyStatement;
use autoref_solve::heights::HeightModel;
use autoref_solve::residual_analysis::{self, Analysis, Correlation, Correlations};
use autoref_stream::candidate::Candidate;
use autoref_stream::detector::Detector;
use autoref_stream::pipeline::Progress;
use autoref_stream::pipeline::heights::{HeightResult, HeightRow};
use autoref_stream::report::{self, Gathered, HeightArrow, KeptPixels, Overview, Section, Table};
use autoref_stream::result::{MatchRow, Misfit, RunResult, SolvedRun, Warning};
use clap::Args;

use crate::cli::accuracy;
use crate::cli::lengths::length;
use crate::cli::progress::Bar;

#[derive(Args, Debug)]
pub struct ReportArgs {
    /// Write NAME.report.html, a page with pictures, plots and tables in which marks can be reviewed (the default).
    #[arg(long, overrides_with = "no_report", help_heading = "Output")]
    report: bool,
    /// Write no report.
    #[arg(long, help_heading = "Output")]
    no_report: bool,
}

impl ReportArgs {
    pub fn wanted(&self) -> bool {
        !self.no_report
    }
}

/// The progress bar, and the overview that grows with it.
pub struct Watch<'a> {
    bar: &'a Bar,
    source: &'a dyn RasterSource,
    detector: &'a dyn Detector,
    /// When a report is wanted.
    pictures: Option<(Overview, KeptPixels)>,
}

impl<'a> Watch<'a> {
    pub fn new(bar: &'a Bar, source: &'a dyn RasterSource, detector: &'a dyn Detector, args: &ReportArgs) -> Self {
        let pictures = args.wanted().then(|| (Overview::new(source.info()), KeptPixels::default()));
        Watch { bar, source, detector, pictures }
    }

    /// Adds what the places of the marks mean to the warnings, and cuts the pictures of the report, when one is wanted.
    pub fn gather(&self, result: &mut RunResult) -> anyhow::Result<Option<Gathered>> {
        if let Some(solved) = result.solved()
            && let Some(solution) = &solved.solution
            && let Some(errors) = accuracy::error_model(solved)
        {
            let marks: Vec<PixelPoint> = solved.matches.iter().map(|row| PixelPoint { x: row.x, y: row.y }).collect();
            let info = self.source.info();
            let size_px = (info.width as f64, info.height as f64);
            let words = report::plain_warnings(solution, &errors, Misfit::of(result).as_ref(), &marks, size_px);
            result.warnings.extend(words.into_iter().map(Warning::Said));
        }
        let Some((overview, kept)) = &self.pictures else { return Ok(None) };
        self.bar.stage("making the report");
        Ok(Some(report::gather(self.source, self.detector, overview, kept, result)?))
    }
}

impl Progress for Watch<'_> {
    fn scanned(&self, pixels: u64) {
        self.bar.scanned(pixels);
    }

    fn saw(&self, block: &Block, core: Window, found: &[&Candidate]) {
        if let Some((overview, kept)) = &self.pictures {
            overview.add(block, core);
            kept.add(block, self.source.info(), self.detector, found);
        }
    }

    fn pass(&self, what: &str) {
        Progress::pass(self.bar, what);
    }

    fn stage(&self, what: &str) {
        self.bar.stage(what);
    }
}

/// Where the report goes: beside the result.
pub fn path(json: &Path) -> PathBuf {
    // "e6.autoref.json": both extensions go.
    json.with_extension("").with_extension("report.html")
}

/// The page as text.
pub fn page(result: &RunResult, gathered: &Gathered, json: &Path) -> autoref_raster::Result<String> {
    let name = json.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
    report::page(result, gathered, &sections(result), &name, report::utc(std::time::SystemTime::now()))
}

/// Parts that other rooms word.
fn sections(result: &RunResult) -> Vec<Section> {
    let accuracy = result.solved().and_then(|solved| solved.accuracy.as_ref());
    let heights = result.solved().and_then(|solved| solved.heights.as_ref());
    let accuracy = accuracy.into_iter().map(accuracy_section);
    let heights = heights.into_iter().map(|heights| heights_section(heights, result));
    accuracy.chain(heights).chain(result.solved().and_then(analysis_section)).collect()
}

/// Matches below which the analysis says nothing.
const FEWEST_ANALYSED: usize = 5;

/// What the residuals say of the model: chapter 5 of the 2016 thesis, with the tests of [`residual_analysis`].
fn analysis_section(solved: &SolvedRun) -> Option<Section> {
    if solved.matches.len() < FEWEST_ANALYSED {
        return None;
    }
    let height_of = |gcp: &str| {
        let heights = solved.heights.as_ref()?;
        heights.points.iter().find(|row| row.gcp == gcp).map(|row| row.residual_m)
    };
    let residual = |m: &MatchRow| residual_analysis::Residual {
        position: [m.easting, m.northing],
        height_m: m.height,
        e_m: m.residual_e_m,
        n_m: m.residual_n_m,
        h_m: height_of(&m.gcp),
    };
    let residuals: Vec<_> = solved.matches.iter().map(residual).collect();
    let analysis = residual_analysis::analyse(&residuals, 0.0);
    let titles = |list: &[&str]| list.iter().map(|title| (*title).to_string()).collect();
    Some(Section {
        heading: "Analysis of residuals".into(),
        paragraphs: vec![format!(
            "Of the {} points of the run's fit, without what a review changes. A p-value below 0.05 says that chance makes such \
             residuals in fewer than one of 20 images.",
            residuals.len()
        )],
        tables: vec![
            Table {
                caption: "Tests".into(),
                header: titles(&["Test", "Value", "p", "What it says"]),
                rows: test_rows(&analysis),
            },
            Table {
                caption: "Correlations, with intervals of 95 %".into(),
                header: titles(&["Between", "r", "Interval", "What it says"]),
                rows: correlation_rows(&analysis.correlations),
            },
        ],
        ..Section::default()
    })
}

fn number(value: f64, digits: usize) -> String {
    if value.is_finite() { format!("{value:.digits$}") } else { "–".to_string() }
}

/// Test, value, p and what it says.
fn test_rows(analysis: &Analysis) -> Vec<Vec<String>> {
    let mut tests: Vec<Vec<String>> = Vec::new();
    let components = [
        ("Easting", Some(&analysis.easting)),
        ("Northing", Some(&analysis.northing)),
        ("Height", analysis.height.as_ref()),
    ];
    for (name, component) in components {
        if let Some(normality) = component.and_then(|component| component.normality.as_ref()) {
            let meaning = if normality.p_value < 0.05 {
                "not normal: look for blunders or a bend"
            } else {
                "as normal errors are"
            };
            tests.push(vec![
                format!("{name}: normal (Anderson–Darling)"),
                number(normality.statistic, 3),
                number(normality.p_value, 3),
                meaning.into(),
            ]);
        }
    }
    if let Some(favoured) = &analysis.directions.favoured {
        let meaning = match favoured.p_value < 0.05 {
            true => format!("most point to {}° from east", number(favoured.direction_deg, 0)),
            false => "no direction is favoured".into(),
        };
        tests.push(vec![
            "Direction (Rayleigh)".into(),
            number(favoured.share, 3),
            number(favoured.p_value, 3),
            meaning,
        ]);
    }
    if let Some(radial) = &analysis.directions.radial {
        // With the p-value of a mean of so many chance directions, which is nearly normal.
        let p = 2.0 * autoref_raster::normal::below(-radial.mean.abs() * (2.0 * radial.n as f64).sqrt());
        let meaning = match (p < 0.05, radial.mean > 0.0) {
            (false, _) => "neither along nor across the lines from the centre",
            (true, true) => "along the lines from the centre: bend or lens",
            (true, false) => "across the lines from the centre: a turn that grows or lessens outwards",
        };
        tests.push(vec!["Radial (mean of cos 2δ)".into(), number(radial.mean, 3), number(p, 3), meaning.into()]);
    }
    tests
}

/// Between what, r, its interval and what it says.
fn correlation_rows(found: &Correlations) -> Vec<Vec<String>> {
    let mut correlations: Vec<Vec<String>> = Vec::new();
    for (name, correlation, meaning) in [
        ("Length and distance from the centre", &found.magnitude_distance_2d, "residuals grow outwards: scale or bend"),
        ("The same in space", &found.magnitude_distance_3d, "residuals grow outwards in space"),
    ] {
        let known = correlation.as_ref().filter(|c| c.low_95.is_finite() && c.high_95.is_finite());
        if let Some(&Correlation { r, low_95: low, high_95: high, .. }) = known {
            let says = if low > 0.0 || high < 0.0 { meaning } else { "none is seen" };
            correlations.push(vec![name.into(), number(r, 3), format!("{low:.3} to {high:.3}"), says.into()]);
        }
    }
    correlations
}

fn heights_section(heights: &HeightResult, result: &RunResult) -> Section {
    let m = |value: f64| format!("{value:.3} m");
    let opt = |value: Option<f64>| value.map_or("–".into(), m);
    let correction = &heights.correction;
    let chosen = correction.chosen_fit();
    let mut figures = vec![
        ("Surface chosen".to_string(), surface(chosen.model).to_string()),
        ("RMS before, after".to_string(), format!("{}, {}", m(correction.uncorrected_rms_m), m(chosen.rms_m))),
        ("RMS, each point left out".to_string(), opt(chosen.leave_one_out_rms_m)),
    ];
    if heights.check_rms_m.is_some() {
        figures.push(("RMS of check points".to_string(), opt(heights.check_rms_m)));
    }
    let fits = correction.fits.iter().map(|f| vec![surface(f.model).into(), m(f.rms_m), opt(f.leave_one_out_rms_m)]);
    let row = |row: &HeightRow, state: &str| {
        vec![
            row.gcp.clone(),
            state.into(),
            m(row.surveyed_m),
            m(row.model_m),
            m(row.residual_m),
            opt(row.leave_one_out_m),
        ]
    };
    let points = heights.points.iter().map(|point| row(point, "in the fit"));
    let checks = heights.check_points.iter().map(|point| row(point, "check point"));
    let titles = |list: &[&str]| list.iter().map(|title| (*title).to_string()).collect();
    Section {
        heading: "Heights".into(),
        paragraphs: vec![
            "Surveyed heights against the elevation model; the surface with the least error of points left out is \
                          what to add to the model."
                .into(),
        ],
        reservations: heights
            .warnings
            .iter()
            .chain(correction.warnings.iter().filter(|w| !heights.warnings.contains(w)))
            .cloned()
            .collect(),
        figures,
        height_arrows: height_arrows(heights, result),
        tables: vec![
            Table { caption: "Surfaces".into(), header: titles(&["Surface", "RMS", "Left out"]), rows: fits.collect() },
            Table {
                caption: "Heights of the points; residuals are surveyed − corrected model".into(),
                header: titles(&["Point", "State", "Surveyed", "Model", "Residual", "Left out"]),
                rows: points.chain(checks).collect(),
            },
        ],
    }
}

/// Where the points with heights lie on the map.
fn height_arrows(heights: &HeightResult, result: &RunResult) -> Vec<HeightArrow> {
    let Some(solved) = result.solved() else { return Vec::new() };
    let arrow = |row: &HeightRow, check: bool| {
        let place = solved.matches.iter().chain(&solved.check_points).find(|m| m.gcp == row.gcp)?;
        let (easting, northing) = (place.easting, place.northing);
        Some(HeightArrow { name: row.gcp.clone(), easting, northing, residual_m: row.residual_m, check })
    };
    let points = heights.points.iter().filter_map(|row| arrow(row, false));
    points.chain(heights.check_points.iter().filter_map(|row| arrow(row, true))).collect()
}

fn surface(model: HeightModel) -> &'static str {
    match model {
        HeightModel::Shift => "shift",
        HeightModel::Tilt => "tilt",
        HeightModel::Quadratic => "quadratic (doming)",
    }
}

fn accuracy_section(statement: &AccuracyStatement) -> Section {
    let m = length;
    let figures = &statement.figures;
    let mut rows: Vec<(String, String)> = Vec::new();
    let mut add = |name: &str, value: String| rows.push((name.into(), value));
    if let Some(h) = &figures.horizontal {
        add("Check points", h.check_points.to_string());
        add("RMSE easting, northing", format!("{}, {}", m(h.rmse_e_m), m(h.rmse_n_m)));
        add("Mean easting, northing", format!("{}, {}", m(h.mean_e_m), m(h.mean_n_m)));
        add("RMSE_H1, of the check points", m(h.rmse_h1_m));
        add("RMSE_H2, of their survey", h.rmse_h2_m.map_or("not stated".into(), m));
        add("RMSE_H", m(h.rmse_h_m));
    }
    if let Some(v) = &figures.vertical {
        add("RMSE_V1, of the heights", m(v.rmse_v1_m));
        add("RMSE_V2, of their survey", v.rmse_v2_m.map_or("not stated".into(), m));
        add("RMSE_V", m(v.rmse_v_m));
    }
    if let Some(rmse) = figures.rmse_3d_m {
        add("RMSE_3D", m(rmse));
    }
    if let Some(nssda) = &figures.nssda {
        add("NSSDA, 95 %", m(nssda.horizontal_95_m));
        if let Some(vertical) = nssda.vertical_95_m {
            add("NSSDA heights, 95 %", m(vertical));
        }
    }
    if let Some(rmse) = figures.leave_one_out_m {
        add("Points of the fit, each left out", m(rmse));
    }
    Section {
        heading: "Accuracy statement".into(),
        paragraphs: statement.sentences.clone(),
        reservations: statement.reservations.clone(),
        figures: rows,
        ..Section::default()
    }
}
