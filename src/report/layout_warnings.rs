//! Warnings about the layout of the marks, in plain words.

use autoref_raster::coords::PixelPoint;
use autoref_solve::Solution;
use autoref_solve::accuracy::ErrorModel;

/// Marks within this part of their extent from a line count as on it.
const ON_LINE: f64 = 0.02;
/// Lines are sought among this many marks at most; of more, some always lie apart.
const MOST_MARKS: usize = 60;
/// Worth a warning when the error in a corner is this many times that amid the marks.
const GROWTH: f64 = 2.5;
/// And at least so many pixels: nothing is read off an image more finely.
const LEAST_PX: f64 = 0.1;

/// What the places of the marks mean for the corners of the image: marks on one line, marks in one part of it.
/// `errors` are those of what is written.
pub fn plain_warnings(
    solution: &Solution,
    errors: &ErrorModel,
    marks: &[PixelPoint],
    size_px: (f64, f64),
) -> Vec<String> {
    let on_line = largest_line(marks);
    let lined = marks.len() >= 3 && on_line >= 3 && on_line + 1 >= marks.len();
    let Some((amid, worst, direction)) = corner_error(solution, errors, size_px) else { return Vec::new() };
    let growth = format!(
        "the expected error (95 %) grows from {} amid the marks to {} in the {direction} corner",
        ground(amid),
        ground(worst)
    );
    if lined {
        let share = if on_line == marks.len() { "all".into() } else { format!("{on_line} of") };
        return vec![format!("{share} {} marks lie on one line: {growth}", marks.len())];
    }
    if worst > GROWTH * amid && worst > LEAST_PX * solution.scale_m_per_px {
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

/// Radius of 95 % amid the marks, in the worst corner, and which corner that is on the map. `None` where there is no
/// noise.
fn corner_error(solution: &Solution, errors: &ErrorModel, size_px: (f64, f64)) -> Option<(f64, f64, String)> {
    let amid = errors.at(solution.centre).transform_95_m;
    let worst = errors
        .corners(&solution.similarity, size_px)
        .into_iter()
        .max_by(|a, b| a.expected.transform_95_m.total_cmp(&b.expected.transform_95_m))?;
    (amid > 0.0).then_some((amid, worst.expected.transform_95_m, worst.direction))
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
            .map_or_else(Vec::new, |errors| plain_warnings(solution, &errors, marks, (side_px, side_px)))
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
        let worst = corner_error(&solution, &ErrorModel::new(&solution).expect("redundant"), (1000.0, 1000.0))
            .expect("redundant")
            .1;
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
