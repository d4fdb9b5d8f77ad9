//! Marks that are known by distances: their coordinates by least squares, whether the distances fix them, and whether
//! they agree with each other and with the coordinates that are given.

use std::collections::HashSet;
use std::path::Path;

use nalgebra::{DMatrix, DVector, SymmetricEigen};

use crate::types::Camera;
use autoref_raster::error::{Error, Result};

/// Distances that are off by more are told, and by more are refused, millimetres: standard deviations of certificates
/// are 1 to 10 µm.
const TOLD_MM: f64 = 0.02;
const REFUSED_MM: f64 = 0.1;
/// The same where every mark has coordinates: the distances only check them, and may be given to a tenth.
const REFUSED_BESIDE_COORDINATES_MM: f64 = 0.5;
/// A mark whose place is so many times worse than the distances are is not fixed by them: 5 µm leave it 0.15 mm.
const LOOSE: f64 = 30.0;
/// A distance that others hardly check has no contradiction to show.
const LEAST_REDUNDANCY: f64 = 1e-4;
/// Pairs named in a message.
const MOST_NAMED: usize = 6;

/// Gives marks without coordinates theirs. Marks with coordinates keep them: place and turn are theirs. What they leave
/// open of place and turn stays as the rough positions have it.
///
/// # Errors
/// [`Error::Format`] when a pair is given twice, distances contradict each other or the coordinates by more than
/// certificates do, or a mark is not fixed.
pub(super) fn settle(camera: &mut Camera, path: &Path) -> Result<()> {
    let mut figure = Figure::of(camera, path)?;
    figure.adjust();
    let solved = Solved::of(&figure);
    let worst_mm = figure.distances.iter().map(|d| figure.excess_mm(d).abs()).fold(0.0, f64::max);
    // Contradictions can flatten a figure so that it seems loose.
    if worst_mm <= REFUSED_MM
        && let Some(loose) = solved.loose(&figure, camera)
    {
        return Err(Error::format(path, "distances_mm", loose));
    }
    if let Some((off_mm, pairs)) = solved.contradictions(&figure, camera) {
        let what = format!("do not agree: compare {pairs} with the certificate");
        let only_checks = figure.unknown.iter().all(Option::is_none);
        let refused_mm = if only_checks { REFUSED_BESIDE_COORDINATES_MM } else { REFUSED_MM };
        if off_mm > refused_mm || !off_mm.is_finite() {
            return Err(Error::format(path, "distances_mm", what));
        }
        tracing::warn!("{}: distances_mm: {what}", path.display());
    }
    for (mark, at) in camera.marks.iter_mut().zip(figure.at) {
        (mark.x_mm, mark.y_mm) = (Some(at[0]), Some(at[1]));
    }
    Ok(())
}

struct Distance {
    ends: [usize; 2],
    mm: f64,
}

struct Figure {
    /// Places of all marks, millimetres, the camera's axes.
    at: Vec<[f64; 2]>,
    /// Of marks without coordinates, their place among the unknowns.
    unknown: Vec<Option<usize>>,
    distances: Vec<Distance>,
}

impl Figure {
    fn of(camera: &Camera, path: &Path) -> Result<Figure> {
        let index = |name: &str| camera.marks.iter().position(|m| m.name == name).expect("checked before");
        let mut seen = HashSet::new();
        let mut distances = vec![];
        for ([a, b], mm) in &camera.distances_mm {
            let ends = [index(a), index(b)];
            if !seen.insert((ends[0].min(ends[1]), ends[0].max(ends[1]))) {
                return Err(Error::format(path, "distances_mm", format!("{a} to {b} is given twice")));
            }
            distances.push(Distance { ends, mm: *mm });
        }
        let at = |m: &crate::types::CameraMark| m.x_mm.zip(m.y_mm).map(|(x, y)| [x, y]).or(m.near_mm);
        let mut free = 0..;
        Ok(Figure {
            at: camera.marks.iter().map(|m| at(m).expect("checked before")).collect(),
            unknown: camera.marks.iter().map(|m| if m.x_mm.is_some() { None } else { free.next() }).collect(),
            distances,
        })
    }

    fn unknowns(&self) -> usize {
        2 * self.unknown.iter().flatten().count()
    }

    /// Which way the second end of a distance lies from its first, and how far.
    fn towards(&self, d: &Distance) -> ([f64; 2], f64) {
        let [a, b] = d.ends.map(|k| self.at[k]);
        let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
        let mm = dx.hypot(dy).max(1e-9);
        ([dx / mm, dy / mm], mm)
    }

    /// Stated less what the places have, millimetres.
    fn excess_mm(&self, d: &Distance) -> f64 {
        d.mm - self.towards(d).1
    }

    /// How a distance grows with the unknowns.
    fn row(&self, d: &Distance) -> DVector<f64> {
        let mut row = DVector::zeros(self.unknowns());
        let (way, _) = self.towards(d);
        for (end, sign) in d.ends.iter().zip([-1.0, 1.0]) {
            if let Some(u) = self.unknown[*end] {
                (0..2).for_each(|k| row[2 * u + k] = sign * way[k]);
            }
        }
        row
    }

    /// Moves of the figure as a whole that marks with coordinates leave open, each of length one.
    fn open_moves(&self) -> Vec<DVector<f64>> {
        let fixed: Vec<[f64; 2]> = self.unknown.iter().zip(&self.at).filter(|p| p.0.is_none()).map(|p| *p.1).collect();
        let n = (self.at.len() - fixed.len()) as f64;
        let (pivot, shifts) = match fixed[..] {
            [] => ([0, 1].map(|k| self.at.iter().map(|p| p[k]).sum::<f64>() / n), true),
            [one] => (one, false),
            _ => return vec![],
        };
        let moved = |by: &dyn Fn([f64; 2]) -> [f64; 2]| {
            let mut all = DVector::zeros(self.unknowns());
            for (at, u) in self.at.iter().zip(&self.unknown) {
                if let Some(u) = u {
                    let by = by(*at);
                    (0..2).for_each(|k| all[2 * u + k] = by[k]);
                }
            }
            all.normalize()
        };
        let mut moves = vec![moved(&|at| [pivot[1] - at[1], at[0] - pivot[0]])];
        if shifts {
            moves.extend([moved(&|_| [1.0, 0.0]), moved(&|_| [0.0, 1.0])]);
        }
        moves
    }

    /// Normal matrix with the open moves held, and the right side.
    fn normal(&self) -> (DMatrix<f64>, DVector<f64>) {
        let n = self.unknowns();
        let (mut normal, mut right) = (DMatrix::zeros(n, n), DVector::zeros(n));
        for d in &self.distances {
            let row = self.row(d);
            normal.ger(1.0, &row, &row, 1.0);
            right.axpy(self.excess_mm(d), &row, 1.0);
        }
        for open in self.open_moves() {
            normal.ger(1.0, &open, &open, 1.0);
        }
        (normal, right)
    }

    /// Gauss–Newton from the rough positions, without steps along what is not determined.
    fn adjust(&mut self) {
        if self.unknowns() == 0 {
            return;
        }
        for _ in 0..50 {
            let (normal, right) = self.normal();
            if !normal.iter().all(|v| v.is_finite()) {
                return;
            }
            let eigen = SymmetricEigen::new(normal);
            let mut step = DVector::zeros(self.unknowns());
            for (value, v) in eigen.eigenvalues.iter().zip(eigen.eigenvectors.column_iter()) {
                if *value > 1e-9 {
                    step.axpy(v.dot(&right) / value, &v, 1.0);
                }
            }
            for (at, u) in self.at.iter_mut().zip(&self.unknown) {
                if let Some(u) = u {
                    (0..2).for_each(|k| at[k] += step[2 * u + k]);
                }
            }
            if step.norm() < 1e-10 {
                return;
            }
        }
    }
}

/// What the adjusted figure says of its marks and distances.
struct Solved {
    cofactors: DMatrix<f64>,
}

impl Solved {
    fn of(figure: &Figure) -> Solved {
        let n = figure.unknowns();
        let (normal, _) = figure.normal();
        let mut cofactors = DMatrix::zeros(n, n);
        if n > 0 && normal.iter().all(|v| v.is_finite()) {
            let eigen = SymmetricEigen::new(normal);
            for (value, v) in eigen.eigenvalues.iter().zip(eigen.eigenvectors.column_iter()) {
                cofactors.ger(1.0 / value.max(1e-12), &v, &v, 1.0);
            }
        }
        Solved { cofactors }
    }

    /// Marks that the distances do not fix, in words.
    fn loose(&self, figure: &Figure, camera: &Camera) -> Option<String> {
        let spread = |u: usize| (self.cofactors[(2 * u, 2 * u)] + self.cofactors[(2 * u + 1, 2 * u + 1)]).sqrt();
        let spreads: Vec<f64> = figure.unknown.iter().map(|u| u.map_or(0.0, spread)).collect();
        let most = spreads.iter().copied().fold(0.0, f64::max);
        if most <= LOOSE {
            return None;
        }
        let fixed = self.largest_rigid_part(figure);
        let names: Vec<&str> = (0..spreads.len())
            .filter(|k| figure.unknown[*k].is_some() && !fixed.contains(k))
            .map(|k| camera.marks[k].name.as_str())
            .collect();
        let needed = figure.unknowns() - figure.open_moves().len();
        Some(format!(
            "the {} given do not fix {}: give more from there to other marks (at least {needed} are needed)",
            figure.distances.len(),
            names.join(", ")
        ))
    }

    /// Most marks of which every two are known to each other, as far as one mark after the other finds them; none below
    /// three, or two with coordinates.
    fn largest_rigid_part(&self, figure: &Figure) -> Vec<usize> {
        let known = |a: usize, b: usize| {
            let row = figure.row(&Distance { ends: [a, b], mm: 0.0 });
            row.dot(&(&self.cofactors * &row)) <= LOOSE * LOOSE
        };
        let n = figure.at.len();
        let pairs: Vec<Vec<bool>> = (0..n).map(|a| (0..n).map(|b| a == b || known(a, b)).collect()).collect();
        let mut largest: Vec<usize> = vec![];
        for first in 0..n {
            for second in (0..n).filter(|k| pairs[first][*k] && *k != first) {
                let mut part = vec![first, second];
                for k in 0..n {
                    if !part.contains(&k) && part.iter().all(|p| pairs[*p][k]) {
                        part.push(k);
                    }
                }
                if part.len() > largest.len() {
                    largest = part;
                }
            }
        }
        let have_coordinates = largest.iter().filter(|k| figure.unknown[**k].is_none()).count();
        if largest.len() > 2 || have_coordinates > 1 { largest } else { vec![] }
    }

    /// How much the distances contradict each other and the coordinates, millimetres, and the pairs that do it most:
    /// residuals divided by the root of their redundancy have the standard deviation of a distance (W. Baarda, "A
    /// testing procedure for use in geodetic networks", 1968), and divided by it they say what the others put in the
    /// place of a distance. `None` below what is told.
    fn contradictions(&self, figure: &Figure, camera: &Camera) -> Option<(f64, String)> {
        let tested: Vec<(f64, &Distance, f64)> = figure
            .distances
            .iter()
            .filter_map(|d| {
                let row = figure.row(d);
                let redundancy = (1.0 - row.dot(&(&self.cofactors * &row))).min(1.0);
                let excess_mm = figure.excess_mm(d);
                let seen = redundancy > LEAST_REDUNDANCY || excess_mm.abs() > REFUSED_MM;
                let redundancy = redundancy.max(LEAST_REDUNDANCY);
                seen.then(|| (excess_mm.abs() / redundancy.sqrt(), d, d.mm - excess_mm / redundancy))
            })
            .collect();
        let off_mm = tested.iter().map(|t| t.0).fold(0.0, |a: f64, b| if b.is_finite() { a.max(b) } else { b });
        if off_mm <= TOLD_MM {
            return None;
        }
        // Where one distance is more than is needed, nothing tells which is wrong.
        let mut worst: Vec<_> = tested.iter().filter(|t| t.0.is_nan() || t.0 >= 0.99 * off_mm).collect();
        worst.sort_by(|a, b| b.0.total_cmp(&a.0));
        let more = if worst.len() > MOST_NAMED { " and others" } else { "" };
        let pairs: Vec<String> = worst
            .into_iter()
            .take(MOST_NAMED)
            .map(|(_, d, by_others)| {
                let [a, b] = d.ends.map(|k| camera.marks[k].name.as_str());
                format!("{a} to {b} ({:.3} mm, by the rest of the file {by_others:.3} mm)", d.mm)
            })
            .collect();
        Some((off_mm, pairs.join(", ") + more))
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::super::parse;
    use crate::types::Camera;

    const PLACES: [[f64; 2]; 4] =
        [[105.3112, -104.9958], [-104.9916, -105.0164], [-104.9948, 105.2192], [105.0, 104.98]];
    const ALL: [(usize, usize); 6] = [(0, 1), (1, 2), (2, 3), (3, 0), (0, 2), (1, 3)];

    /// Four marks, some with coordinates and the others up to 0.8 mm beside theirs, with distances that are off by so
    /// much.
    fn camera(fixed: &[usize], pairs: &[(usize, usize)], off: impl Fn(usize, usize) -> f64) -> Result<Camera, String> {
        let mark = |k: usize| {
            let [x, y] = PLACES[k];
            let place = if fixed.contains(&k) {
                format!("x_mm = {x}, y_mm = {y}")
            } else {
                format!("near_mm = [{}, {}]", x + [0.8, -0.3, 0.2, 0.5][k], y + [0.5, 0.4, -0.6, 0.1][k])
            };
            format!("{{ name = \"M{}\", {place}, kind = {{ shape = \"dot\", diameter_mm = 0.2 }} }}", k + 1)
        };
        let distance = |&(a, b): &(usize, usize)| {
            let mm = (PLACES[a][0] - PLACES[b][0]).hypot(PLACES[a][1] - PLACES[b][1]) + off(a, b);
            format!("[[\"M{}\", \"M{}\"], {mm:.4}]", a + 1, b + 1)
        };
        let text = format!(
            "name = \"d\"\nfilm_size_mm = [236.0, 236.0]\ny_axis = \"up\"\ndistances_mm = [{}]\nmarks = [{}]",
            pairs.iter().map(distance).collect::<Vec<_>>().join(", "),
            (0..4).map(mark).collect::<Vec<_>>().join(", ")
        );
        parse(&text, Path::new("d.toml")).map_err(|e| e.to_string())
    }

    fn right(_: usize, _: usize) -> f64 {
        0.0
    }

    #[test]
    fn marks_with_coordinates_keep_them() {
        for fixed in [&[0, 1, 2][..], &[1, 3], &[0, 1, 2, 3]] {
            let at = camera(fixed, &ALL, right).expect("sound").marks;
            for (mark, [x, y]) in at.iter().zip(PLACES) {
                let off = (mark.x_mm.expect("solved") - x).hypot(mark.y_mm.expect("solved") - y);
                assert!(off < 3e-4, "{fixed:?}: {} is {off} mm off", mark.name);
            }
        }
        // One mark holds the place, not the turn.
        let one = camera(&[2], &ALL, right).expect("sound").marks;
        assert_eq!((one[2].x_mm, one[2].y_mm), (Some(PLACES[2][0]), Some(PLACES[2][1])));
        let apart = |a: usize, b: usize| {
            let of = |k: usize| one[k].x_mm.zip(one[k].y_mm).expect("solved");
            (of(a).0 - of(b).0).hypot(of(a).1 - of(b).1)
        };
        assert!((apart(0, 1) - (PLACES[0][0] - PLACES[1][0]).hypot(PLACES[0][1] - PLACES[1][1])).abs() < 2e-4);
    }

    #[test]
    fn what_distances_do_not_fix_is_named() {
        let said = camera(&[], &ALL[..4], right).expect_err("a frame of four bars gives way");
        assert!(said.starts_with("d.toml: distances_mm: ") && said.contains("at least 5 are"), "{said}");
        let said = camera(&[], &[(0, 1), (1, 2), (2, 0), (3, 0)], right).expect_err("M4 swings about M1");
        assert!(said.contains("do not fix M4: "), "{said}");
        let said = camera(&[0, 1, 2], &[(3, 1)], right).expect_err("M4 swings about M2");
        assert!(said.contains("do not fix M4: ") && said.contains("at least 2 are"), "{said}");
        for twice in [(0, 1), (1, 0)] {
            let said = camera(&[], &[&ALL[..4], &[twice]].concat(), right).expect_err("twice");
            assert!(said.contains(" is given twice"), "{said}");
        }
        assert!(camera(&[], &ALL[..5], right).is_ok() && camera(&[0, 1, 2], &[(3, 0), (3, 2)], right).is_ok());
    }

    #[test]
    fn distances_that_contradict_each_other_or_coordinates_are_refused_by_name() {
        let off = |wrong: (usize, usize), mm: f64| move |a: usize, b: usize| if (a, b) == wrong { mm } else { 0.0 };
        for (fixed, wrong, mm) in [
            (&[][..], (0, 2), 0.6),
            (&[], (0, 1), 0.4),
            (&[0, 1, 2, 3], (0, 2), 5.0),
            (&[0, 1, 2, 3], (2, 3), 0.7),
            (&[0, 1, 2], (3, 0), 0.3),
        ] {
            let said = camera(fixed, &ALL, off(wrong, mm)).expect_err("contradicts");
            let pair = format!("M{} to M{} (", wrong.0 + 1, wrong.1 + 1);
            assert!(said.starts_with("d.toml: distances_mm: do not agree: ") && said.contains(&pair), "{said}");
            let [a, b] = [wrong.0, wrong.1].map(|k| PLACES[k]);
            let by_others = said.split(&pair).nth(1).and_then(|s| s.split("file ").nth(1)).expect("what it should be");
            let by_others: f64 = by_others.split(' ').next().and_then(|v| v.parse().ok()).expect("a number");
            assert!((by_others - (a[0] - b[0]).hypot(a[1] - b[1])).abs() < 0.002, "{said}");
        }
        // Where all marks have coordinates distances to a tenth check them.
        assert!(camera(&[0, 1, 2, 3], &ALL, off((2, 3), 0.12)).is_ok());
        // What certificates leave.
        let scatter = |a: usize, b: usize| 0.01 * ((7 * a + 5 * b) % 3) as f64 - 0.01;
        assert!(camera(&[], &ALL, scatter).is_ok() && camera(&[0, 1, 2, 3], &ALL, scatter).is_ok());
    }
}
