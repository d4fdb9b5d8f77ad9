//! Flags about what is solved beside the similarity: heights, other models, other solvers.

use std::path::PathBuf;

use anyhow::bail;
use autoref_raster::atomic::{self, Existing, Transaction};
use autoref_raster::coords::{GeoTransform, MapPoint, PixelPoint};
use autoref_raster::crs::Coordinate;
use autoref_raster::protected::same_file;
use autoref_raster::{ElevationModel, RasterInfo};
use autoref_solve::absolute::{self, AbsoluteOrientation, Method, PointPair};
use autoref_solve::{Pair, kraus, planar};
use autoref_stream::gcp::GcpList;
use autoref_stream::georef::heights::{CopyPlace, write_corrected};
use autoref_stream::pipeline::georeference::{Orientation, Outcome};
use autoref_stream::pipeline::heights::{self, HeightResult, ModelFrame, PlacedModel};
use autoref_stream::pipeline::reasons::{NotFound, Reason};
use autoref_stream::result::{
    ChosenModel, PlanarModel, RunResult, SimilarityModel, SolvedRun, Solver, SpatialModel, SpatialResidual,
};
use clap::{Args, ValueEnum};

use crate::cli::document::NO_MARK_THERE;
use crate::cli::lengths::length;

#[derive(Args, Debug)]
pub struct SolvingArgs {
    /// Elevation model, any raster: in the image's grid, or with a georeference of its own. Its heights at the marks
    /// are compared with the survey; shift, tilt or a quadratic surface is chosen by leave-one-out error.
    #[arg(long, value_name = "MODEL", help_heading = "Solving")]
    pub dem: Option<PathBuf>,
    /// Write a copy of the elevation model with the height correction applied (GeoTIFF, 32-bit floats).
    #[arg(long, value_name = "FILE", requires = "dem", help_heading = "Solving")]
    pub write_dem: Option<PathBuf>,
    /// The transform: `similarity`; `affine`, which is written instead; `projective` and `7-parameter` (in space, with
    /// the heights of the survey and the model), which no world file can hold: they are reported beside it.
    #[arg(long, value_enum, default_value = "similarity", help_heading = "Solving")]
    pub model: ModelArg,
    /// With --dem: heights are means over CELLS × CELLS cells around the mark, instead of the height at its very place.
    #[arg(long, value_name = "CELLS", default_value_t = 1, requires = "dem", value_parser = clap::value_parser!(u32).range(1..=99),
        help_heading = "Solving")]
    pub dem_area: u32,
    /// How similarity and 7-parameter transform are solved. All have one rotation on the same points; those of Horn
    /// take the symmetric scale. Without it the similarity is the weighted one that expected errors follow from.
    #[arg(long, value_enum, value_name = "NAME", help_heading = "Solving")]
    pub solver: Option<SolverArg>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ModelArg {
    Similarity,
    Affine,
    Projective,
    #[value(name = "7-parameter")]
    SevenParameter,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum SolverArg {
    Horn,
    HornHilden,
    Umeyama,
    UmeyamaHornScale,
    Kraus,
}

impl SolverArg {
    pub const ALL: [SolverArg; 5] =
        [SolverArg::Horn, SolverArg::HornHilden, SolverArg::Umeyama, SolverArg::UmeyamaHornScale, SolverArg::Kraus];

    /// The orientation in space, with the standard deviation of a coordinate where the method has one.
    ///
    /// # Errors
    /// Those of the method.
    pub fn in_space(self, points: &[PointPair]) -> Result<(AbsoluteOrientation, Option<f64>), absolute::Undetermined> {
        let method = match self {
            SolverArg::Horn => Method::Horn,
            SolverArg::HornHilden => Method::HornHilden,
            SolverArg::Umeyama => Method::Umeyama,
            SolverArg::UmeyamaHornScale => Method::UmeyamaSymmetricScale,
            SolverArg::Kraus => return kraus::adjust(points).map(|a| (a.orientation, a.sigma0)),
        };
        absolute::solve(points, method).map(|o| (o, None))
    }

    /// As the JSON of a result names it.
    pub fn solver(self) -> Solver {
        match self {
            SolverArg::Horn => Solver::Horn,
            SolverArg::HornHilden => Solver::HornHilden,
            SolverArg::Umeyama => Solver::Umeyama,
            SolverArg::UmeyamaHornScale => Solver::UmeyamaHornScale,
            SolverArg::Kraus => Solver::Kraus,
        }
    }
}

/// What is known of the image's size and place.
pub struct ImagePlace {
    pub size_px: Option<(f64, f64)>,
    pub georeference: Option<GeoTransform>,
}

impl ImagePlace {
    pub fn of(info: &RasterInfo) -> Self {
        ImagePlace { size_px: Some((info.width as f64, info.height as f64)), georeference: info.geotransform }
    }
}

/// A corrected elevation model that is to be written.
pub struct DemCopy {
    placed: PlacedModel,
    heights: HeightResult,
    fitted: GeoTransform,
    target: PathBuf,
    list_wkt: Option<String>,
}

impl DemCopy {
    pub fn stage(self, result: &RunResult, transaction: &mut Transaction) -> autoref_raster::error::Result<()> {
        let to_positions = self.placed.to_positions(&self.fitted);
        let own = self.placed.frame == ModelFrame::Map;
        // The delivered transform counts in the outputs' units, the positions of the surface in metres of the fit.
        let delivered = result.geotransform().map_or(to_positions, |g| self.placed.to_positions(&g));
        let place = CopyPlace {
            to_positions,
            geotransform: if own { to_positions } else { delivered },
            crs_wkt: if own { self.placed.model.crs_wkt() } else { self.list_wkt.as_deref() },
        };
        transaction.stage(&self.target, |partial| {
            write_corrected(&self.placed.model, &self.heights.correction, &place, partial)
        })
    }
}

impl SolvingArgs {
    /// Refuses before the image is read what cannot be.
    ///
    /// # Errors
    /// An elevation model that cannot be opened, a copy that would be written over something.
    pub fn check(&self, existing: Existing) -> anyhow::Result<()> {
        if let Some(dem) = &self.dem {
            ElevationModel::open(dem)?;
        }
        if let Some(copy) = &self.write_dem {
            if self.dem.as_deref().is_some_and(|dem| same_file(dem, copy)) {
                bail!("--write-dem {} is the elevation model itself; name another file", copy.display());
            }
            atomic::check_outputs(&[copy], existing)?;
        }
        if self.solver.is_some() && matches!(self.model, ModelArg::Affine | ModelArg::Projective) {
            bail!(
                "--solver is of --model similarity and 7-parameter; affine and projective have one least squares each"
            );
        }
        Ok(())
    }

    /// Solves what was asked for beside the similarity, and enters it in the result.
    pub fn apply(
        &self,
        result: &mut RunResult,
        outcome: &Outcome,
        list: &GcpList,
        place: &ImagePlace,
    ) -> anyhow::Result<Option<DemCopy>> {
        let Outcome::Solved(orientation) = outcome else { return Ok(None) };
        let copy = self.heights(result, orientation, list, place)?;
        let pairs = pairs(orientation, list);
        match self.model {
            ModelArg::Similarity => {
                if let Some(solver) = self.solver {
                    planar_solver(result, &pairs, solver);
                }
            }
            ModelArg::Affine => {
                planar_model(result, &pairs, planar::Kind::Affine);
                if let Some(written) = written_affine(result) {
                    explain_under(result, &written, list);
                }
            }
            ModelArg::Projective => planar_model(result, &pairs, planar::Kind::Projective),
            ModelArg::SevenParameter => self.in_space(result, orientation, list),
        }
        Ok(copy)
    }

    /// Whether the command line asks for any of it.
    pub fn asked(&self) -> bool {
        self.dem.is_some() || self.model != ModelArg::Similarity || self.solver.is_some()
    }

    fn heights(
        &self,
        result: &mut RunResult,
        orientation: &Orientation,
        list: &GcpList,
        place: &ImagePlace,
    ) -> anyhow::Result<Option<DemCopy>> {
        let Some(dem) = &self.dem else {
            enter_heights(result, heights::from_list(orientation, &list.gcps)?);
            return Ok(None);
        };
        let name = dem.display().to_string();
        let model = ElevationModel::open(dem)?;
        let placed =
            PlacedModel::new(model, &name, place.size_px, place.georeference, list.crs.as_ref())?.over(self.dem_area);
        let to_map = |p: MapPoint| {
            let mut point = [Coordinate { x: p.easting, y: p.northing, height: None }];
            list.working_crs.leave(&mut point)?;
            Ok(MapPoint { easting: point[0].x, northing: point[0].y })
        };
        let mut solved = heights::correct(orientation, &list.gcps, &placed, &to_map)?;
        if solved.position_crs.is_none() {
            solved.position_crs = list.crs.as_ref().map(autoref_raster::crs::Crs::label);
        }
        enter_heights(result, Some(solved.clone()));
        Ok(self.write_dem.clone().map(|target| DemCopy {
            placed,
            heights: solved,
            fitted: orientation.solution.geotransform,
            target,
            list_wkt: list.crs.as_ref().map(|crs| crs.wkt().to_string()),
        }))
    }

    /// Seven parameters in metres: the image points are brought to metres by the similarity first, so that one scale
    /// serves planimetry and heights.
    fn in_space(&self, result: &mut RunResult, orientation: &Orientation, list: &GcpList) {
        let Some(heights) = result.solved().and_then(|solved| solved.heights.as_ref()) else {
            result.warnings.push("--model 7-parameter needs heights: give --dem, and heights in the list".into());
            return;
        };
        let mut names = Vec::new();
        let points: Vec<PointPair> = orientation
            .marks
            .iter()
            .filter_map(|mark| {
                let gcp = &list.gcps[mark.gcp];
                let row = heights.points.iter().find(|row| row.gcp == gcp.name)?;
                let at = orientation.solution.similarity.apply(mark.mark.centre);
                names.push(gcp.name.clone());
                Some(PointPair {
                    model: nalgebra::Vector3::new(at.easting, at.northing, row.model_m),
                    target: nalgebra::Vector3::new(gcp.easting, gcp.northing, row.surveyed_m),
                })
            })
            .collect();
        let solver = self.solver.unwrap_or(SolverArg::Umeyama);
        match solver.in_space(&points) {
            Ok((space, sigma0)) => {
                if points.len() < 5 {
                    let few = points.len();
                    result
                        .warnings
                        .push(format!("only {few} points with heights: seven parameters are hardly checked"));
                }
                enter_model(result, self.describe(&space, sigma0, &names));
            }
            Err(why) => result.warnings.push(format!(
                "no 7-parameter solution from {} points with heights ({why}): the similarity stands alone",
                points.len()
            )),
        }
    }

    fn describe(&self, space: &AbsoluteOrientation, sigma0_m: Option<f64>, names: &[String]) -> ChosenModel {
        let by_axis = space.rmse_by_axis();
        let residual = |(gcp, r): (&String, &nalgebra::Vector3<f64>)| SpatialResidual {
            gcp: gcp.clone(),
            e_m: r.x,
            n_m: r.y,
            h_m: r.z,
        };
        ChosenModel::SevenParameter(SpatialModel {
            solver: self.solver.unwrap_or(SolverArg::Umeyama).solver(),
            from: "similarity's easting and northing of the marks, elevation of the model; metres".into(),
            scale: space.scale,
            rotation: rows(&space.rotation),
            roll_pitch_yaw_deg: absolute::roll_pitch_yaw_deg(&space.rotation),
            translation_m: space.translation.into(),
            rmse_m: space.rmse,
            rmse_e_m: by_axis.x,
            rmse_n_m: by_axis.y,
            rmse_h_m: by_axis.z,
            sigma0_m,
            residuals: names.iter().zip(&space.residuals).map(residual).collect(),
        })
    }
}

fn rows(matrix: &nalgebra::Matrix3<f64>) -> [[f64; 3]; 3] {
    std::array::from_fn(|row| std::array::from_fn(|column| matrix[(row, column)]))
}

fn pairs(orientation: &Orientation, list: &GcpList) -> Vec<Pair> {
    orientation
        .marks
        .iter()
        .map(|mark| Pair {
            pixel: mark.mark.centre,
            covariance_px2: mark.mark.covariance_px2,
            map: list.gcps[mark.gcp].position(),
            survey_sigma_m: list.gcps[mark.gcp].sigma_m,
        })
        .collect()
}

/// Solves again, from the marks that a review left, the model that the recorded run had.
pub fn again(result: &mut RunResult, recorded: &RunResult, orientation: &Orientation, list: &GcpList) {
    let Some(recorded) = recorded.solved() else { return };
    if recorded.heights.is_some() {
        result.warnings.push("heights were not compared again: a replay does not read the elevation model".into());
    }
    match &recorded.chosen_model {
        None => {}
        Some(ChosenModel::Affine(_)) => planar_model(result, &pairs(orientation, list), planar::Kind::Affine),
        Some(ChosenModel::Projective(_)) => planar_model(result, &pairs(orientation, list), planar::Kind::Projective),
        Some(ChosenModel::Similarity(model)) => {
            if let Some(solver) = SolverArg::ALL.into_iter().find(|s| s.solver() == model.solver) {
                planar_solver(result, &pairs(orientation, list), solver);
            }
        }
        Some(ChosenModel::SevenParameter(_)) => {
            result.warnings.push("the 7-parameter transform was not solved again: it needs heights".into())
        }
    }
}

/// The affine transform, or the similarity of another solver, that stands in the place of the weighted similarity.
pub fn written_affine(result: &RunResult) -> Option<GeoTransform> {
    result.solved()?.chosen_model.as_ref()?.written()
}

/// Takes back what was said against points and marks that do not fit the similarity, by which marks are matched, but
/// fit the affine transform that is written.
fn explain_under(result: &mut RunResult, written: &GeoTransform, list: &GcpList) {
    /// A mark fits within so many of the marks' root mean square residuals, and so many pixels at least and at most.
    const TIMES: f64 = 4.0;
    const REACH_PX: (f64, f64) = (1.0, 5.0);
    let candidates: Vec<PixelPoint> = result.candidates.iter().map(|c| c.centre).collect();
    let Some(solved) = result.solved_mut() else { return };
    let used: Vec<(f64, f64)> = solved.matches.iter().map(|row| (row.x, row.y)).collect();
    let candidates: Vec<PixelPoint> = candidates.into_iter().filter(|c| !used.contains(&(c.x, c.y))).collect();
    let reach_px = (TIMES * solved.fit.rmse_m / solved.fit.scale_m_per_px).clamp(REACH_PX.0, REACH_PX.1);
    let mut fitting = vec![];
    for point in &mut solved.not_found {
        // What the image or other points say holds whatever the transform.
        if matches!(point.reason, Reason::Outside | Reason::Ambiguous) {
            continue;
        }
        let Some(gcp) = list.gcps.iter().find(|gcp| gcp.name == point.name) else { continue };
        let Some(at) = written.invert(gcp.position()) else { continue };
        let off = candidates.iter().map(|c| (c.x - at.x).hypot(c.y - at.y)).min_by(f64::total_cmp);
        // By the similarity the mark must lie elsewhere.
        let apart = (at.x - point.x).hypot(at.y - point.y) > reach_px;
        if let Some(off_px) = off.filter(|off| *off <= reach_px && apart) {
            let detail = format!(
                "a mark lies {off_px:.1} px from where the affine transform puts it, but not where the similarity does, by \
                 which marks are matched"
            );
            let name = point.name.clone();
            fitting.push(name.clone());
            *point = NotFound { between: vec![name.clone()], ..NotFound::new(name, Reason::Ambiguous, at, detail) };
        }
    }
    if fitting.is_empty() {
        return;
    }
    let blames = |warning: &String| fitting.iter().any(|name| warning.starts_with(&format!("{name}: {NO_MARK_THERE}")));
    result.warnings.retain(|warning| !blames(warning));
    result.warnings.push(format!(
        "{}: marks lie where the affine transform puts them, but marks are matched by a similarity: left out; make the \
         pixels square first (gdalwarp -tr), or solve the candidates by hand",
        fitting.join(", ")
    ));
}

/// An affine transform takes the similarity's place in the outputs; a projective one is reported.
fn planar_model(result: &mut RunResult, pairs: &[Pair], kind: planar::Kind) {
    let fit = match planar::fit(pairs, kind) {
        Ok(fit) => fit,
        Err(why) => {
            result
                .warnings
                .push(format!("{} points do not support this --model ({why}); the similarity is used", pairs.len()));
            return;
        }
    };
    result.warnings.extend(fit.warnings.iter().cloned());
    let model = PlanarModel {
        matrix: rows(&fit.matrix()),
        rmse_m: fit.rmse_m,
        leave_one_out_rmse_m: fit.leave_one_out_rmse_m,
        similarity_rmse_m: result.solved().map(|solved| solved.fit.rmse_m),
        residuals_m: fit.residuals_m.clone(),
        leave_one_out_m: fit.leave_one_out_m.clone(),
    };
    let model = match kind {
        planar::Kind::Affine => ChosenModel::Affine(model),
        planar::Kind::Projective => ChosenModel::Projective(model),
    };
    enter_model(result, model);
    if kind == planar::Kind::Projective {
        result
            .warnings
            .push("a geotransform cannot hold a projective transform: the outputs are the similarity's".into());
        return;
    }
    let at = |x: f64, y: f64| fit.apply(autoref_raster::coords::PixelPoint { x, y });
    // Far arms, so that eastings of millions do not round the coefficients.
    const ARM: f64 = 65_536.0;
    let (Some(origin), Some(right), Some(down)) = (at(0.0, 0.0), at(ARM, 0.0), at(0.0, ARM)) else { return };
    let transform = GeoTransform::through(origin, right, down, (ARM, ARM));
    enter_planar(result, transform, &fit.residuals_m, fit.leave_one_out_m.as_deref());
    result.warnings.push(
        "the affine transform is written; expected errors, redundancy and outliers are those of the similarity".into(),
    );
}

/// The similarity by another solver than the weighted one takes its place in the outputs. Every point counts alike.
fn planar_solver(result: &mut RunResult, pairs: &[Pair], solver: SolverArg) {
    let flat = flat(pairs);
    let (space, sigma0) = match solver.in_space(&flat) {
        Ok(solved) if solved.0.rotation[(2, 2)] > 0.0 => solved,
        Ok(_) => {
            result
                .warnings
                .push(format!("{}: the points are a mirror image; the similarity is used", solver.solver().name()));
            return;
        }
        Err(why) => {
            let few = pairs.len();
            result.warnings.push(format!(
                "{few} points do not support --solver {} ({why}); the similarity is used",
                solver.solver().name()
            ));
            return;
        }
    };
    let (r, s, t) = (&space.rotation, space.scale, &space.translation);
    let transform = GeoTransform([t.x, s * r[(0, 0)], -s * r[(0, 1)], t.y, s * r[(1, 0)], -s * r[(1, 1)]]);
    let g = transform.0;
    let residuals: Vec<[f64; 2]> = space.residuals.iter().map(|r| [r.x, r.y]).collect();
    let left_out = leave_one_out(&flat, solver);
    let rotation_deg = r[(1, 0)].atan2(r[(0, 0)]).to_degrees();
    let model = SimilarityModel {
        solver: solver.solver(),
        matrix: [[g[1], g[2], g[0]], [g[4], g[5], g[3]], [0.0, 0.0, 1.0]],
        scale_m_per_px: s,
        rotation_deg,
        rmse_m: space.rmse,
        sigma0_m: sigma0,
        similarity_rmse_m: result.solved().map(|solved| solved.fit.rmse_m),
        residuals_m: residuals.clone(),
        leave_one_out_m: left_out.clone(),
    };
    enter_model(result, ChosenModel::Similarity(model));
    if let Some(solved) = result.solved_mut() {
        solved.fit.scale_m_per_px = s;
        solved.fit.rotation_deg = rotation_deg;
    }
    enter_planar(result, transform, &residuals, left_out.as_deref());
    result.warnings.push(format!(
        "the similarity by {} is written, in which every point counts alike; expected errors, redundancy and outliers are \
         those of the weighted one",
        solver.solver().name()
    ));
}

/// What each point is off, surveyed − computed, when the others alone are solved; `None` when one cannot be left out.
fn leave_one_out(points: &[PointPair], solver: SolverArg) -> Option<Vec<[f64; 2]>> {
    /// Two points are exact whatever they are: what they say of a third is no test of them.
    const FEWEST: usize = 4;
    let off = |left_out: usize| {
        let others: Vec<PointPair> =
            points.iter().enumerate().filter(|(i, _)| *i != left_out).map(|(_, point)| *point).collect();
        let (space, _) = solver.in_space(&others).ok()?;
        let computed = space.rotation * points[left_out].model * space.scale + space.translation;
        let off = points[left_out].target - computed;
        Some([off.x, off.y])
    };
    (points.len() >= FEWEST).then(|| (0..points.len()).map(off).collect()).flatten()
}

/// Marks as (x, −y, 0) in pixels and GCPs as (easting, northing, 0) in metres.
pub fn flat(pairs: &[Pair]) -> Vec<PointPair> {
    pairs
        .iter()
        .map(|p| PointPair {
            model: nalgebra::Vector3::new(p.pixel.x, -p.pixel.y, 0.0),
            target: nalgebra::Vector3::new(p.map.easting, p.map.northing, 0.0),
        })
        .collect()
}

/// The heights of a run in one line.
pub fn heights_in_brief(solved: &HeightResult) -> String {
    let (correction, fit) = (&solved.correction, solved.correction.chosen_fit());
    format!(
        "{} points, {} off the model (RMS), {} after a {}",
        solved.points.len(),
        length(correction.uncorrected_rms_m),
        length(fit.rms_m),
        fit.model.label()
    )
}

/// Enters the heights of a solved run.
fn enter_heights(result: &mut RunResult, heights: Option<heights::HeightResult>) {
    if let Some(solved) = result.solved_mut() {
        solved.heights = heights;
    }
}

/// Enters the transform that was asked for beside the similarity.
fn enter_model(result: &mut RunResult, model: ChosenModel) {
    if let Some(solved) = result.solved_mut() {
        solved.chosen_model = Some(model);
    }
}

/// A planar transform takes the similarity's place in the result.
fn enter_planar(
    result: &mut RunResult,
    transform: GeoTransform,
    residuals_m: &[[f64; 2]],
    leave_one_out_m: Option<&[[f64; 2]]>,
) {
    let Some(solved) = result.solved_mut() else { return };
    solved.geotransform = transform;
    let n = residuals_m.len() as f64;
    let rms = |axis: usize| (residuals_m.iter().map(|r| r[axis].powi(2)).sum::<f64>() / n).sqrt();
    let (rms_e, rms_n) = (rms(0), rms(1));
    let fit = &mut solved.fit;
    (fit.rmse_e_m, fit.rmse_n_m, fit.rmse_m) = (rms_e, rms_n, rms_e.hypot(rms_n));
    let scale = fit.scale_m_per_px;
    fit.rmse_px = fit.rmse_m / scale;
    for (i, (row, residual)) in solved.matches.iter_mut().zip(residuals_m).enumerate() {
        (row.residual_e_m, row.residual_n_m) = (residual[0], residual[1]);
        row.residual_px = residual[0].hypot(residual[1]) / scale;
        row.leave_one_out_m = leave_one_out_m.map(|left_out| left_out[i][0].hypot(left_out[i][1]));
    }
    // What is tested is what is written.
    for row in &mut solved.check_points {
        let computed = transform.apply(autoref_raster::coords::PixelPoint { x: row.x, y: row.y });
        (row.residual_e_m, row.residual_n_m) = (row.easting - computed.easting, row.northing - computed.northing);
        row.residual_px = row.residual_e_m.hypot(row.residual_n_m) / scale;
    }
}

/// The transform that was asked for beside or instead of the similarity.
pub fn model_line(solved: &SolvedRun) -> Option<String> {
    let model = solved.chosen_model.as_ref()?;
    let name = model.name();
    Some(match model {
        ChosenModel::Affine(planar) | ChosenModel::Projective(planar) => format!("{name}: RMSE {:.4} m", planar.rmse_m),
        ChosenModel::Similarity(by) => format!("{name} by {}: RMSE {:.4} m", by.solver.name(), by.rmse_m),
        ChosenModel::SevenParameter(by) => {
            let [roll, pitch, yaw] = by.roll_pitch_yaw_deg;
            format!(
                "{name} by {}: RMSE {:.4} m, heights {:.4} m; roll {roll:.5}°, pitch {pitch:.5}°, yaw {yaw:.5}°",
                by.solver.name(),
                by.rmse_m,
                by.rmse_h_m
            )
        }
    })
}

/// Lines of the summary.
pub fn lines(solved: &SolvedRun, line: &mut impl FnMut(&str, String)) {
    let Some(heights) = &solved.heights else { return };
    let from = match heights.frame {
        ModelFrame::Image => "model in the image's grid",
        ModelFrame::Map => "model in map coordinates",
        ModelFrame::List => "elevations of the list",
    };
    line(
        "Heights",
        format!(
            "{} points, {from}; uncorrected RMS {:.4} m",
            heights.points.len(),
            heights.correction.uncorrected_rms_m
        ),
    );
    for fit in &heights.correction.fits {
        let left_out = fit.leave_one_out_rms_m.map_or(String::new(), |loo| format!(", leave-one-out {loo:.4} m"));
        let chosen = if fit.model == heights.correction.chosen { "  (chosen)" } else { "" };
        line(&format!("  {}", fit.model.label()), format!("RMS {:.4} m{left_out}{chosen}", fit.rms_m));
    }
    if let Some(rms) = heights.check_rms_m {
        line("  check points", format!("RMS {rms:.4} m of {}", heights.check_points.len()));
    }
    if !heights.without_height.is_empty() {
        line("  no height", heights.without_height.join(", "));
    }
    for warning in &heights.warnings {
        line("  note", warning.clone());
    }
}
