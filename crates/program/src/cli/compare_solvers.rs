//! `autoref-stream compare-solvers`: the same matched points by all solvers, in the plane and in space.

mod compared;

use std::path::Path;
use std::process::ExitCode;

use anyhow::{Context, bail};
use autoref_raster::Error;
use autoref_raster::coords::{MapPoint, PixelPoint};
use autoref_solve::absolute::{self, PointPair};
use autoref_solve::partial::{self, ControlPoint, Known};
use autoref_solve::residual_analysis::{Analysis, Residual, analyse};
use autoref_solve::{Pair, planar};
use autoref_stream::georef::spreadsheet::Spreadsheet;
use autoref_stream::result::RunResult;
use clap::Args;
use nalgebra::Vector3;
use serde_json::json;

use self::compared::{Compared, Found, Partly, Solved, Space, Turn, failed, print};
use crate::cli::run::{self, LookArgs};
use crate::cli::solving::{SolverArg, flat};
use autoref_raster::words::counted;

/// Solve the same points by all solvers and print the comparison.
///
/// IMAGE needs --gcps, and --dem for the solvers in space. Instead of an image: the result of a run
/// (NAME.autoref.json), or a table of matched points (NAME.csv) with the columns name, x, y, elevation, easting,
/// northing, height; a point without elevation or height counts in plan only, one without easting and northing in
/// height only.
#[derive(Args, Debug)]
pub struct CompareArgs {
    #[command(flatten)]
    look: LookArgs,
    /// Leave out this share of the smallest and of the largest residuals in histograms, tests of normality and
    /// correlations of magnitudes; 0.1 as in the 2016 thesis.
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, value_parser = share, help_heading = "Analysis")]
    tail_cut: f64,
}

fn share(text: &str) -> Result<f64, String> {
    let value = text.parse::<f64>().ok().filter(|v| (0.0..0.5).contains(v));
    value.ok_or_else(|| format!("`{text}` is no share from 0 to below 0.5"))
}

/// Units of the two sides where marks are taken as they lie in the image.
const PIXELS: &str = "pixels to metres";

/// A matched point: what is known of it on both sides.
struct Row {
    name: String,
    pixel: PixelPoint,
    elevation_m: Option<f64>,
    plan: Option<MapPoint>,
    height_m: Option<f64>,
    covariance_px2: Option<[f64; 3]>,
    sigma_m: Option<f64>,
}

pub fn run(args: &CompareArgs) -> anyhow::Result<ExitCode> {
    let input = args.look.image.as_deref().context("no image: name an image, a result or a table of matched points")?;
    let ends = |end: &str| input.extension().is_some_and(|e| e.eq_ignore_ascii_case(end));
    let (rows, from) = if ends("json") {
        (of_result(&RunResult::read(input)?, input)?, "result")
    } else if ends("csv") {
        (of_table(input)?, "table")
    } else {
        let result = run::first_look(&args.look)?;
        if let Some(refused) = result.refused() {
            let reason = &refused.reason;
            if args.look.json {
                let document = json!({"input": input.display().to_string(), "status": "refused", "reason": reason});
                println!("{}", serde_json::to_string_pretty(&document)?);
            } else if !args.look.quiet {
                println!("Not solved          {reason}");
            }
            return Ok(ExitCode::from(1));
        }
        (of_result(&result, input)?, "image")
    };
    let mut solvers = compare(&rows);
    for solved in solvers.iter_mut().filter_map(Compared::solved_mut) {
        solved.analysis = Some(analysis(&rows, solved, args.tail_cut));
    }
    if args.look.json {
        let document = json!({
            "input": input.display().to_string(),
            "from": from,
            "status": "solved",
            "points": rows.len(),
            "points_in_space": rows.iter().filter(|r| r.is_full()).count(),
            "solvers": solvers,
        });
        println!("{}", serde_json::to_string_pretty(&document)?);
    } else if !args.look.quiet {
        print(&solvers);
    }
    Ok(ExitCode::SUCCESS)
}

impl Row {
    fn is_full(&self) -> bool {
        self.plan.is_some() && self.height_m.is_some() && self.elevation_m.is_some()
    }
}

/// The residuals of a solver against the places of their points.
fn analysis(rows: &[Row], solved: &Solved, tail_cut: f64) -> Analysis {
    let known = |value: &f64| value.is_finite();
    let residuals: Vec<Residual> = solved
        .residuals
        .iter()
        .filter_map(|residual| {
            let row = rows.iter().find(|row| row.name == residual.gcp)?;
            let plan = row.plan?;
            Some(Residual {
                position: [plan.easting, plan.northing],
                height_m: row.height_m,
                e_m: residual.e_m.filter(known)?,
                n_m: residual.n_m.filter(known)?,
                h_m: residual.h_m.filter(known),
            })
        })
        .collect();
    analyse(&residuals, tail_cut)
}

/// Control points of a result in the metres of its fit, with the heights that its elevation model or list brought.
fn of_result(result: &RunResult, path: &Path) -> anyhow::Result<Vec<Row>> {
    if result.matches().is_empty() {
        bail!("{}: the result has no matched points to solve by", path.display());
    }
    let model = |name: &str| {
        result.solved()?.heights.as_ref()?.points.iter().find(|row| row.gcp == name).map(|row| row.model_m)
    };
    let row = |m: &autoref_stream::result::MatchRow| {
        // In the list they are in metres, whatever the outputs count in.
        let gcp = result.gcps.iter().find(|g| g.name == m.gcp);
        let plan = gcp.map_or(MapPoint { easting: m.easting, northing: m.northing }, |g| g.position());
        Row {
            name: m.gcp.clone(),
            pixel: PixelPoint { x: m.x, y: m.y },
            elevation_m: model(&m.gcp),
            plan: Some(plan),
            height_m: gcp.map_or(m.height, |g| g.height),
            covariance_px2: m.covariance_px2,
            sigma_m: m.survey_sigma_m,
        }
    };
    Ok(result.matches().iter().map(row).collect())
}

fn of_table(path: &Path) -> anyhow::Result<Vec<Row>> {
    let table = Spreadsheet::read(path, "a table of matched points", 32 << 20)?;
    let mut reader = table.reader();
    let unreadable = |place: &str, e: csv::Error| Error::format(path, place, e.to_string());
    let headers = reader.headers().map_err(|e| unreadable("row 1", e))?.clone();
    let column =
        |title: &str| headers.iter().position(|h| h.trim_start_matches('\u{feff}').eq_ignore_ascii_case(title));
    for needed in ["x", "y", "easting", "northing"] {
        if column(needed).is_none() {
            return Err(Error::format(
                path,
                "row 1",
                format!(
                    "no column `{needed}`; x, y, easting and northing are needed, name, elevation and height are used"
                ),
            )
            .into());
        }
    }
    let mut rows = Vec::new();
    for (i, record) in reader.records().enumerate() {
        let place = format!("row {}", table.row(i));
        let record = record.map_err(|e| unreadable(&place, e))?;
        let text = |title: &str| column(title).and_then(|c| record.get(c)).filter(|t| !t.is_empty());
        let number = |title: &str| -> Result<Option<f64>, Error> {
            let Some(text) = text(title) else { return Ok(None) };
            table
                .number(text)
                .map(Some)
                .ok_or_else(|| Error::format(path, &place, format!("`{text}` is no number for {title}")))
        };
        let (Some(x), Some(y)) = (number("x")?, number("y")?) else {
            return Err(Error::format(path, &place, "x and y are needed; complete or remove the row").into());
        };
        let plan = number("easting")?.zip(number("northing")?);
        let name = text("name").map_or_else(|| (i + 1).to_string(), str::to_owned);
        if rows.iter().any(|row: &Row| row.name == name) {
            let what = format!("a second point is called `{}`; give each its own name", crate::printable(&name));
            return Err(Error::format(path, &place, what).into());
        }
        rows.push(Row {
            name,
            pixel: PixelPoint { x, y },
            elevation_m: number("elevation")?,
            plan: plan.map(|(easting, northing)| MapPoint { easting, northing }),
            height_m: number("height")?,
            covariance_px2: None,
            sigma_m: number("sigma_m")?.filter(|s| *s > 0.0),
        });
    }
    if rows.len() < 2 {
        return Err(Error::format(
            path,
            "the table",
            format!("{}; at least 2 are needed", counted(rows.len(), "matched point", "matched points")),
        )
        .into());
    }
    Ok(rows)
}

fn compare(rows: &[Row]) -> Vec<Compared> {
    let flat_rows: Vec<&Row> = rows.iter().filter(|r| r.plan.is_some()).collect();
    let names: Vec<&str> = flat_rows.iter().map(|r| r.name.as_str()).collect();
    let pairs: Vec<Pair> = flat_rows
        .iter()
        .map(|r| Pair {
            pixel: r.pixel,
            covariance_px2: r.covariance_px2,
            map: r.plan.expect("only those with a plan"),
            survey_sigma_m: r.sigma_m,
        })
        .collect();
    let mut out = vec![weighted(&pairs, &names)];
    let level = flat(&pairs);
    for solver in SolverArg::ALL {
        let solved = solver.in_space(&level);
        // A rotation in space turns a plane over where its points are a mirror image.
        if solved.as_ref().is_ok_and(|(orientation, _)| orientation.rotation[(2, 2)] <= 0.0) {
            let why = "the points are a mirror image";
            out.push(failed(Space::Plane, solver.solver().name(), PIXELS, why));
            continue;
        }
        out.push(entry(Space::Plane, solver.solver().name(), PIXELS, &names, &level, solved));
    }
    for (kind, name) in [(planar::Kind::Affine, "Affine"), (planar::Kind::Projective, "Projective")] {
        out.push(match planar::fit(&pairs, kind, planar::Weighting::Equal) {
            Ok(fit) => {
                let residuals: Vec<[Option<f64>; 3]> =
                    fit.residuals_m.iter().map(|r| [Some(r[0]), Some(r[1]), None]).collect();
                let found = Found::Planar { leave_one_out_rmse_m: fit.leave_one_out_rmse_m };
                Compared::solved((Space::Plane, name, PIXELS), &names, &residuals, found)
            }
            Err(why) => failed(Space::Plane, name, PIXELS, &why.to_string()),
        });
    }
    let full: Vec<&Row> = rows.iter().filter(|r| r.is_full()).collect();
    let names: Vec<&str> = full.iter().map(|r| r.name.as_str()).collect();
    if full.is_empty() {
        return out;
    }
    let target = |r: &Row| {
        let plan = r.plan.expect("a full row");
        Vector3::new(plan.easting, plan.northing, r.height_m.expect("a full row"))
    };
    let elevation = |r: &Row| r.elevation_m.expect("a full row");
    // Pixels are brought to metres by the similarity first, so that one scale serves planimetry and heights.
    if let Ok(plane) = autoref_solve::solve(&pairs) {
        let at = |r: &Row| plane.similarity.apply(r.pixel);
        let metric: Vec<PointPair> = full
            .iter()
            .map(|r| PointPair { model: Vector3::new(at(r).easting, at(r).northing, elevation(r)), target: target(r) })
            .collect();
        for solver in SolverArg::ALL {
            out.push(entry(Space::Full, solver.solver().name(), "metres", &names, &metric, solver.in_space(&metric)));
        }
        // By what the survey states, where it states it for all.
        let weights: Option<Vec<f64>> = full.iter().map(|r| r.sigma_m.map(|s| s.powi(-2))).collect();
        if let Some(weights) = weights {
            let solved = absolute::solve_weighted(&metric, &weights, absolute::Method::Umeyama).map(|o| (o, None));
            out.push(entry(Space::Full, "UmeyamaWeighted", "metres", &names, &metric, solved));
        }
        if full.len() < rows.len() {
            out.push(partly(rows, &|r| {
                let p = at(r);
                Vector3::new(p.easting, p.northing, r.elevation_m.unwrap_or(0.0))
            }));
        }
    }
    let mixed: Vec<PointPair> = full
        .iter()
        .map(|r| PointPair { model: Vector3::new(r.pixel.x, -r.pixel.y, elevation(r)), target: target(r) })
        .collect();
    for solver in SolverArg::ALL {
        out.push(entry(Space::Full, solver.solver().name(), "mixed", &names, &mixed, solver.in_space(&mixed)));
    }
    out
}

/// Kraus with the points that are known only in plan or only in height beside the others.
fn partly(rows: &[Row], model: &dyn Fn(&Row) -> Vector3<f64>) -> Compared {
    let mut names = Vec::new();
    let mut points = Vec::new();
    for row in rows {
        let height = row.height_m.filter(|_| row.elevation_m.is_some());
        let known = match (row.plan, height) {
            (Some(_), Some(_)) => Known::Full,
            (Some(_), None) => Known::Plan,
            (None, Some(_)) => Known::Height,
            (None, None) => continue,
        };
        let plan = row.plan.unwrap_or(MapPoint { easting: 0.0, northing: 0.0 });
        let target = Vector3::new(plan.easting, plan.northing, height.unwrap_or(0.0));
        names.push(row.name.as_str());
        points.push(ControlPoint { pair: PointPair { model: model(row), target }, known, weight: 1.0 });
    }
    match partial::adjust(&points) {
        Ok(fit) => {
            let count = |known: Known| points.iter().filter(|p| p.known == known).count();
            let found = Found::Turned {
                turn: Turn::of(fit.scale, &fit.rotation, Space::Full),
                sigma0_m: fit.sigma0,
                partly: Some(Partly { plan_only: count(Known::Plan), height_only: count(Known::Height) }),
            };
            Compared::solved((Space::Full, "KrausPartial", "metres"), &names, &fit.residuals, found)
        }
        Err(why) => failed(Space::Full, "KrausPartial", "metres", &why.to_string()),
    }
}

/// The weighted similarity, which a run uses.
fn weighted(pairs: &[Pair], names: &[&str]) -> Compared {
    match autoref_solve::solve(pairs) {
        Ok(solution) => {
            let residuals: Vec<[Option<f64>; 3]> =
                solution.pairs.iter().map(|p| [Some(p.residual_e_m), Some(p.residual_n_m), None]).collect();
            let left_out: Option<Vec<f64>> = solution
                .pairs
                .iter()
                .map(|p| p.leave_one_out_e_m.zip(p.leave_one_out_n_m).map(|(e, n)| e * e + n * n))
                .collect();
            let rms = |squares: Vec<f64>| (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
            let found = Found::Weighted {
                scale: solution.scale_m_per_px,
                rotation_deg: solution.rotation_deg,
                leave_one_out_rmse_m: left_out.map(rms),
            };
            Compared::solved((Space::Plane, "Similarity", PIXELS), names, &residuals, found)
        }
        Err(why) => failed(Space::Plane, "Similarity", PIXELS, &why.to_string()),
    }
}

type InSpace = Result<(absolute::AbsoluteOrientation, Option<f64>), absolute::Undetermined>;

fn entry(
    space: Space,
    solver: &'static str,
    units: &'static str,
    names: &[&str],
    points: &[PointPair],
    solved: InSpace,
) -> Compared {
    debug_assert_eq!(names.len(), points.len());
    match solved {
        Ok((orientation, sigma0)) => {
            let residuals: Vec<[Option<f64>; 3]> =
                orientation.residuals.iter().map(|r| [Some(r.x), Some(r.y), space.height(r.z)]).collect();
            let turn = Turn::of(orientation.scale, &orientation.rotation, space);
            let found = Found::Turned { turn, sigma0_m: sigma0, partly: None };
            Compared::solved((space, solver, units), names, &residuals, found)
        }
        Err(why) => failed(space, solver, units, &why.to_string()),
    }
}
