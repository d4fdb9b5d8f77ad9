//! Warnings about the layout of the marks, in plain words.

use autoref_raster::coords::PixelPoint;
use autoref_solve::Solution;
use autoref_solve::accuracy::ErrorModel;

use crate::result::Misfit;

/// Marks within this part of their extent from a line count as on it.
const ON_LINE: f64 = 0.02;
/// Lines are sought among this many marks at most; of more, some always lie apart.
const MOST_MARKS: usize = 60;
/// Worth a warning when the error in a corner is this many times that amid the marks.
const GROWTH: f64 = 2.5;
/// And at least so many pixels: nothing is read off an image more finely.
const LEAST_PX: f64 = 0.1;

/// What the places of the marks mean for the corners of the image: marks on one line, marks in one part of it.
/// `errors` are those of what is written, `misfit` what they do not know of.
pub fn plain_warnings(
    solution: &Solution,
    errors: &ErrorModel,
    misfit: Option<&Misfit>,
    marks: &[PixelPoint],
    size_px: (f64, f64),
) -> Vec<String> {
    let on_line = largest_line(marks);
    let lined = marks.len() >= 3 && on_line >= 3 && on_line + 1 >= marks.len();
    let Some(Growth { amid_m, worst_m, corner, direction }) = growth(solution, errors, size_px) else {
        return Vec::new();
    };
    let stated = |expected_m: f64, place: PixelPoint| {
        ground(misfit.map_or(expected_m, |misfit| misfit.with_m(expected_m, place, solution.scale_m_per_px)))
    };
    let growth = format!(
        "the expected error (95 %) grows from {} amid the marks to {} in the {direction} corner",
        stated(amid_m, solution.centre),
        stated(worst_m, corner)
    );
    if lined {
        let share = if on_line == marks.len() { "all".into() } else { format!("{on_line} of") };
        return vec![format!("{share} {} marks lie on one line: {growth}", marks.len())];
    }
    if worst_m > GROWTH * amid_m && worst_m > LEAST_PX * solution.scale_m_per_px {
        return vec![format!("the marks cover only a part of the image: {growth}")];
    }
    Vec::new()
}

/// About two significant digits; millimetres below a metre.
fn ground(value_m: f64) -> String {
    match value_m {
        v if v >= 1.0 => format!("{v:.1} m"),
        v if v >= 0.01 => format!("{:.0} mm", 1000.0 * v),
        v => format!("{:.1} mm", 1000.0 * v),
    }
}

/// Radii of 95 % of the fit alone.
struct Growth {
    amid_m: f64,
    worst_m: f64,
    /// Where it is worst, and which corner that is on the map.
    corner: PixelPoint,
    direction: String,
}

/// From amid the marks to the worst corner. `None` where there is no noise.
fn growth(solution: &Solution, errors: &ErrorModel, size_px: (f64, f64)) -> Option<Growth> {
    let amid_m = errors.at(solution.centre).transform_95_m;
    let worst = errors
        .corners(&solution.similarity, size_px)
        .into_iter()
        .max_by(|a, b| a.expected.transform_95_m.total_cmp(&b.expected.transform_95_m))?;
    let (worst_m, corner) = (worst.expected.transform_95_m, worst.corner.place(size_px));
    (amid_m > 0.0).then_some(Growth { amid_m, worst_m, corner, direction: worst.direction })
}

/// How many marks lie on one line.
fn largest_line(marks: &[PixelPoint]) -> usize {
    if marks.len() > MOST_MARKS {
        return 0;
    }
    let distance = |a: &PixelPoint, b: &PixelPoint| (a.x - b.x).hypot(a.y - b.y);
    let extent = marks.iter().flat_map(|a| marks.iter().map(move |b| distance(a, b))).fold(0.0, f64::max);
    let mut most = 0;
    for (i, a) in marks.iter().enumerate() {
        for b in &marks[i + 1..] {
            let length = distance(a, b);
            // The direction of a short pair says little about where a line runs.
            if length < 0.3 * extent || length == 0.0 {
                continue;
            }
            let across = |p: &PixelPoint| ((b.x - a.x) * (p.y - a.y) - (b.y - a.y) * (p.x - a.x)).abs() / length;
            most = most.max(marks.iter().filter(|p| across(p) <= ON_LINE * extent).count());
        }
    }
    most
}

#[cfg(test)]
mod tests {
    use super::*;
    use autoref_raster::coords::MapPoint;
    use autoref_solve::{Pair, solve};

    fn told(solution: &Solution, marks: &[PixelPoint], side_px: f64) -> Vec<String> {
        ErrorModel::new(solution)
            .map_or_else(Vec::new, |errors| plain_warnings(solution, &errors, None, marks, (side_px, side_px)))
    }

    fn solved(places: &[(f64, f64)]) -> (Solution, Vec<PixelPoint>) {
        let pairs: Vec<Pair> = places
            .iter()
            .enumerate()
            .map(|(i, &(x, y))| Pair {
                pixel: PixelPoint { x, y },
                covariance_px2: None,
                map: MapPoint { easting: 0.1 * x + 0.01 * (i % 2) as f64, northing: -0.1 * y + 0.008 * (i % 3) as f64 },
                survey_sigma_m: None,
            })
            .collect();
        (solve(&pairs).expect("not in one place"), places.iter().map(|&(x, y)| PixelPoint { x, y }).collect())
    }

    #[test]
    fn marks_on_one_line_name_the_corner_that_suffers() {
        let (solution, marks) = solved(&[(700.0, 700.0), (800.0, 701.0), (980.0, 699.0), (900.0, 900.0)]);
        let warnings = told(&solution, &marks, 1000.0);
        assert_eq!(warnings.len(), 1);
        assert!(warnings[0].starts_with("3 of 4 marks lie on one line"), "{warnings:?}");
        assert!(warnings[0].ends_with("in the north-west corner"), "{warnings:?}");
        let errors = ErrorModel::new(&solution).expect("redundant");
        let worst = growth(&solution, &errors, (1000.0, 1000.0)).expect("noise").worst_m;
        // What the fit does not know of is in the words.
        let off = Misfit::Unlike { off_px: 20.0 };
        let with = plain_warnings(&solution, &errors, Some(&off), &marks, (1000.0, 1000.0));
        let stated_m = worst.hypot(20.0 * solution.scale_m_per_px);
        assert!(with[0].contains(&format!(" to {} in the north-west", ground(stated_m))), "{with:?}");
        // ν = 4: √(4·(0.05^(−1/2) − 1)) = 3.726734.
        assert!((worst - 3.726_734 * solution.sigma_at_m(PixelPoint { x: 0.0, y: 0.0 })).abs() < 1e-6 * worst);
    }

    #[test]
    fn well_spread_marks_are_not_warned_of() {
        let (solution, marks) = solved(&[(50.0, 40.0), (930.0, 80.0), (960.0, 940.0), (60.0, 900.0), (500.0, 480.0)]);
        assert!(told(&solution, &marks, 1000.0).is_empty());
    }

    #[test]
    fn marks_in_a_corner_are_warned_of() {
        let (solution, marks) = solved(&[(50.0, 40.0), (150.0, 80.0), (160.0, 140.0), (60.0, 190.0)]);
        let warnings = told(&solution, &marks, 2000.0);
        assert!(warnings[0].contains("only a part") && warnings[0].contains("south-east"), "{warnings:?}");
    }
}
