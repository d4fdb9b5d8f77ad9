//! `--solver`: how a transform is solved.

use autoref_solve::absolute::{self, AbsoluteOrientation, Method, PointPair};
use autoref_solve::kraus;
use autoref_stream::result::Solver;
use clap::ValueEnum;

/// `--solver`.
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
