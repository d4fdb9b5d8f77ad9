//! `autoref-stream compare-solvers`: the same matched points by all solvers, in the plane and in space.

use std::path::Path;
use std::process::ExitCode;

use anyhow::{Context, bail};
use autoref_raster::Error;
use autoref_raster::coords::{MapPoint, PixelPoint};
use autoref_solve::absolute::{self, PointPair};
use autoref_solve::partial::{self, ControlPoint, Known};
use autoref_solve::{Pair, planar};
use autoref_stream::georef::spreadsheet::Spreadsheet;
use autoref_stream::result::RunResult;
use clap::Args;
use nalgebra::{Matrix3, Vector3};
use serde_json::{Value, json};

use crate::cli::residual_analysis::{Residual, analyse};
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
    for value in &mut solvers {
        let analysis = analysis(&rows, value, args.tail_cut);
        if let Some(analysis) = analysis {
            value["analysis"] = analysis;
        }
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
fn analysis(rows: &[Row], solved: &Value, tail_cut: f64) -> Option<Value> {
    let residuals: Vec<Residual> = solved["residuals"]
        .as_array()?
        .iter()
        .filter_map(|residual| {
            let row = rows.iter().find(|row| residual["gcp"] == row.name.as_str())?;
            let plan = row.plan?;
            Some(Residual {
                position: [plan.easting, plan.northing],
                height_m: row.height_m,
                e_m: residual["e_m"].as_f64()?,
                n_m: residual["n_m"].as_f64()?,
                h_m: residual["h_m"].as_f64(),
            })
        })
        .collect();
    Some(analyse(&residuals, tail_cut))
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

fn compare(rows: &[Row]) -> Vec<Value> {
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
            out.push(failed(Space::Plane, solver.solver().name(), "pixels to metres", "the points are a mirror image"));
            continue;
        }
        out.push(entry(Space::Plane, solver.solver().name(), "pixels to metres", &names, &level, solved));
    }
    for (kind, name) in [(planar::Kind::Affine, "Affine"), (planar::Kind::Projective, "Projective")] {
        out.push(match planar::fit(&pairs, kind) {
            Ok(fit) => {
                let residuals: Vec<[Option<f64>; 3]> =
                    fit.residuals_m.iter().map(|r| [Some(r[0]), Some(r[1]), None]).collect();
                let mut value = statistics(Space::Plane, name, "pixels to metres", &names, &residuals);
                value["leave_one_out_rmse_m"] = json!(fit.leave_one_out_rmse_m);
                value
            }
            Err(why) => failed(Space::Plane, name, "pixels to metres", &why.to_string()),
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
fn partly(rows: &[Row], model: &dyn Fn(&Row) -> Vector3<f64>) -> Value {
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
            let mut value = statistics(Space::Full, "KrausPartial", "metres", &names, &fit.residuals);
            turned(&mut value, fit.scale, &fit.rotation, Space::Full);
            value["sigma0_m"] = json!(fit.sigma0);
            let count = |known: Known| points.iter().filter(|p| p.known == known).count();
            value["plan_only"] = json!(count(Known::Plan));
            value["height_only"] = json!(count(Known::Height));
            value
        }
        Err(why) => failed(Space::Full, "KrausPartial", "metres", &why.to_string()),
    }
}

/// The weighted similarity, which a run uses.
fn weighted(pairs: &[Pair], names: &[&str]) -> Value {
    match autoref_solve::solve(pairs) {
        Ok(solution) => {
            let residuals: Vec<[Option<f64>; 3]> =
                solution.pairs.iter().map(|p| [Some(p.residual_e_m), Some(p.residual_n_m), None]).collect();
            let mut value = statistics(Space::Plane, "Similarity", "pixels to metres", names, &residuals);
            value["scale"] = json!(solution.scale_m_per_px);
            value["rotation_deg"] = json!(solution.rotation_deg);
            let left_out: Option<Vec<f64>> = solution
                .pairs
                .iter()
                .map(|p| p.leave_one_out_e_m.zip(p.leave_one_out_n_m).map(|(e, n)| e * e + n * n))
                .collect();
            value["leave_one_out_rmse_m"] =
                json!(left_out.map(|squares| (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()));
            value
        }
        Err(why) => failed(Space::Plane, "Similarity", "pixels to metres", &why.to_string()),
    }
}

/// What a solver places points in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Space {
    Plane,
    Full,
}

impl Space {
    fn word(self) -> &'static str {
        match self {
            Space::Plane => "plane",
            Space::Full => "space",
        }
    }

    /// A residual of heights, which a plane has not.
    fn height(self, residual: f64) -> Option<f64> {
        (self == Space::Full).then_some(residual)
    }
}

type InSpace = Result<(absolute::AbsoluteOrientation, Option<f64>), absolute::Undetermined>;

fn entry(space: Space, solver: &str, units: &str, names: &[&str], points: &[PointPair], solved: InSpace) -> Value {
    debug_assert_eq!(names.len(), points.len());
    match solved {
        Ok((orientation, sigma0)) => {
            let residuals: Vec<[Option<f64>; 3]> =
                orientation.residuals.iter().map(|r| [Some(r.x), Some(r.y), space.height(r.z)]).collect();
            let mut value = statistics(space, solver, units, names, &residuals);
            turned(&mut value, orientation.scale, &orientation.rotation, space);
            value["sigma0_m"] = json!(sigma0);
            value
        }
        Err(why) => failed(space, solver, units, &why.to_string()),
    }
}

fn turned(value: &mut Value, scale: f64, rotation: &Matrix3<f64>, space: Space) {
    value["scale"] = json!(scale);
    let turns = absolute::roll_pitch_yaw_deg(rotation);
    value["rotation_deg"] = json!(turns[2]);
    if space == Space::Full {
        value["roll_deg"] = json!(turns[0]);
        value["pitch_deg"] = json!(turns[1]);
        value["yaw_deg"] = json!(turns[2]);
    }
}

fn failed(space: Space, solver: &str, units: &str, why: &str) -> Value {
    json!({"space": space.word(), "solver": solver, "units": units, "status": "undetermined", "reason": why})
}

/// RMSE is √(mean of squared lengths), divisor n, for each axis over the points that are known in it.
fn statistics(space: Space, solver: &str, units: &str, names: &[&str], residuals: &[[Option<f64>; 3]]) -> Value {
    let rms = |axis: usize| {
        let known: Vec<f64> = residuals.iter().filter_map(|r| r[axis]).collect();
        (!known.is_empty()).then(|| (known.iter().map(|v| v * v).sum::<f64>() / known.len() as f64).sqrt())
    };
    let axes = [rms(0), rms(1), rms(2)];
    let length = |r: &[Option<f64>; 3]| r.iter().flatten().map(|v| v * v).sum::<f64>().sqrt();
    let lengths: Vec<f64> = residuals.iter().map(length).collect();
    let rows: Vec<Value> = names
        .iter()
        .zip(residuals)
        .zip(&lengths)
        .map(|((name, r), length)| json!({"gcp": name, "e_m": r[0], "n_m": r[1], "h_m": r[2], "length_m": length}))
        .collect();
    json!({
        "space": space.word(),
        "solver": solver,
        "units": units,
        "status": "solved",
        "points": names.len(),
        "rmse_m": axes.iter().flatten().map(|v| v * v).sum::<f64>().sqrt(),
        "rmse_e_m": axes[0],
        "rmse_n_m": axes[1],
        "rmse_h_m": axes[2],
        "min_residual_m": lengths.iter().copied().fold(f64::INFINITY, f64::min),
        "max_residual_m": lengths.iter().copied().fold(0.0, f64::max),
        "residuals": rows,
    })
}

fn print(solvers: &[Value]) {
    println!(
        "{:<6} {:<17} {:<17} {:>3} {:>15} {:>11} {:>10} {:>10} {:>10} {:>10} {:>10}",
        "space", "solver", "units", "n", "scale", "yaw °", "RMSE m", "E m", "N m", "height m", "max m"
    );
    for value in solvers {
        let text = |key: &str| value[key].as_str().unwrap_or_default();
        let figure =
            |key: &str, digits: usize| value[key].as_f64().map_or("–".to_owned(), |v| format!("{v:.digits$}"));
        if value["status"] != "solved" {
            println!("{:<6} {:<17} {:<17} {}", text("space"), text("solver"), text("units"), text("reason"));
            continue;
        }
        println!(
            "{:<6} {:<17} {:<17} {:>3} {:>15} {:>11} {:>10} {:>10} {:>10} {:>10} {:>10}",
            text("space"),
            text("solver"),
            text("units"),
            value["points"],
            figure("scale", 11),
            figure("rotation_deg", 6),
            figure("rmse_m", 6),
            figure("rmse_e_m", 6),
            figure("rmse_n_m", 6),
            figure("rmse_h_m", 6),
            figure("max_residual_m", 6)
        );
        if let Some(normality) = normality(value) {
            println!("{:>24} {normality}", "");
        }
        if let (Some(roll), Some(pitch), Some(yaw)) =
            (value["roll_deg"].as_f64(), value["pitch_deg"].as_f64(), value["yaw_deg"].as_f64())
        {
            println!("{:>24} roll {roll:.6}°, pitch {pitch:.6}°, yaw {yaw:.6}°", "");
        }
    }
}

/// One line on the analysis: p-values of normality and the correlation of magnitude and distance.
fn normality(value: &Value) -> Option<String> {
    let analysis = &value["analysis"];
    let p =
        |axis: &str| analysis[axis]["normality"]["p_value"].as_f64().map_or("–".to_owned(), |p| format!("{p:.3}"));
    let grows = &analysis["correlations"]["magnitude_distance_2d"];
    let r = grows["r"].as_f64()?;
    Some(format!(
        "normal: p {} E, {} N, {} height; magnitude and distance: r {r:.4} ({:.4} to {:.4})",
        p("easting"),
        p("northing"),
        p("height"),
        grows["low_95"].as_f64()?,
        grows["high_95"].as_f64()?
    ))
}
