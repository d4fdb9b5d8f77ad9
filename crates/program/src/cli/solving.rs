//! Flags about what is solved beside the similarity: heights, other models, other solvers.

mod explained;
mod heights;
mod model;
mod planar;
mod solver;
mod space;

use std::path::PathBuf;

use anyhow::bail;
use autoref_raster::ElevationModel;
use autoref_raster::atomic::{self, Existing};
use autoref_raster::protected::same_file;
use autoref_solve::planar::Kind;
use autoref_stream::gcp::GcpList;
use autoref_stream::pipeline::georeference::{Orientation, Outcome, pairs};
use autoref_stream::result::{ChosenModel, RunResult};
use clap::{Args, ValueEnum};

use self::explained::explain_under;
pub use self::heights::{DemCopy, ImagePlace, heights_in_brief, lines};
pub use self::model::{model_line, written_affine};
pub use self::planar::flat;
use self::planar::{planar_model, planar_solver};
pub use self::solver::SolverArg;

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
        let copy =
            match &self.dem {
                Some(dem) => heights::Comparison { dem, area_cells: self.dem_area, copy: self.write_dem.as_deref() }
                    .run(result, orientation, list, place)?,
                None => {
                    heights::of_list(result, orientation, list)?;
                    None
                }
            };
        let pairs = pairs(&list.gcps, &orientation.marks);
        match self.model {
            ModelArg::Similarity => {
                if let Some(solver) = self.solver {
                    planar_solver(result, &pairs, solver);
                }
            }
            ModelArg::Affine => {
                planar_model(result, &pairs, Kind::Affine);
                if let Some(written) = written_affine(result) {
                    explain_under(result, &written, list);
                }
            }
            ModelArg::Projective => planar_model(result, &pairs, Kind::Projective),
            ModelArg::SevenParameter => {
                space::in_space(result, orientation, list, self.solver.unwrap_or(SolverArg::Umeyama));
            }
        }
        Ok(copy)
    }

    /// Whether the command line asks for any of it.
    pub fn asked(&self) -> bool {
        self.dem.is_some() || self.model != ModelArg::Similarity || self.solver.is_some()
    }
}

/// Solves again, from the marks that a review left, the model that the recorded run had.
pub fn again(result: &mut RunResult, recorded: &RunResult, orientation: &Orientation, list: &GcpList) {
    let Some(recorded) = recorded.solved() else { return };
    if recorded.heights.is_some() {
        result.warn("heights were not compared again: a replay does not read the elevation model");
    }
    match &recorded.chosen_model {
        None => {}
        Some(ChosenModel::Affine(_)) => planar_model(result, &pairs(&list.gcps, &orientation.marks), Kind::Affine),
        Some(ChosenModel::Projective(_)) => {
            planar_model(result, &pairs(&list.gcps, &orientation.marks), Kind::Projective)
        }
        Some(ChosenModel::Similarity(model)) => {
            if let Some(solver) = SolverArg::ALL.into_iter().find(|s| s.solver() == model.solver) {
                planar_solver(result, &pairs(&list.gcps, &orientation.marks), solver);
            }
        }
        Some(ChosenModel::SevenParameter(_)) => {
            result.warn("the 7-parameter transform was not solved again: it needs heights")
        }
    }
}
