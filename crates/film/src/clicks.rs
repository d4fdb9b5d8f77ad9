//! Places that somebody pointed at, made exact: marks that look alike are laid on each other, and where what they have
//! in common is its own image turned by half a turn, edge on edge, its centre is the reference point, where clicks may
//! have missed it; where two straight edges meet as near as clicks scatter, their corner is. Of other marks it is the
//! mean of the clicks. What none of these says stays as it was pointed at.

mod corner;
mod field;

use super::stack::Grid;
use field::Field;

/// Correlation of edges from which a mark shows the same as the others, and contrast, of theirs, below which it is
/// faint.
const SAME: f64 = 0.8;
const FAINT: f64 = 0.5;
/// A centre of symmetry is no further from the mean of clicks than this, values of the grid, or than so many standard
/// deviations of that mean.
const NEAR_CLICKS: f64 = 3.0;
const NEAR_SIGMAS: f64 = 3.0;
/// A corner is no further from the mean of clicks than so many standard deviations of that mean allow and this, values
/// of the grid: solid shapes have corners that nobody meant.
const NEAR_CORNER: f64 = 0.5;
/// No reference point is known better, values of the grid.
const LEAST_SIGMA: f64 = 0.15;
/// A window about a click, values row by row.
type Values = [f32];

/// What is known of the centre of a mark that was pointed at; shifts in values of the grid, to the right and down.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Centre {
    /// It shows the same as others.
    Same([f64; 2]),
    /// It shows what others do, but so faintly that theirs tell better what it looks like.
    Faint([f64; 2]),
    /// It tells by itself, or it is like others but not the same.
    Own([f64; 2]),
    /// It looks like no other and has no centre of symmetry.
    AsPointed,
}

impl Centre {
    /// From the click to the centre; `None` where the click is all that is known.
    pub fn shift(self) -> Option<[f64; 2]> {
        match self {
            Centre::Same(shift) | Centre::Faint(shift) | Centre::Own(shift) => Some(shift),
            Centre::AsPointed => None,
        }
    }
}

/// A centre and its standard deviation, values of the grid: what clicks leave where no symmetry tells the centre.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Told {
    pub centre: Centre,
    pub sigma: f64,
}

/// The centre of what every window shows.
pub(super) fn centres(windows: &[&Values], grid: &Grid) -> Vec<Told> {
    let field = Field::new(grid);
    let mut found = vec![Centre::AsPointed; windows.len()];
    let mut shared_sigma = 0.0;
    let mut laid = field.laid_on_most(windows);
    let edges: Vec<Vec<f32>> = windows.iter().map(|w| field.edges(w)).collect();
    let edges: Vec<&Values> = edges.iter().map(Vec::as_slice).collect();
    let mut seen = windows;
    // In front of terrain marks have their edges in common, not where it is dark and where bright.
    let by_edges = count(&laid) < 2;
    if by_edges {
        (laid, seen) = (field.laid_on_most(&edges), &edges);
    }
    if count(&laid) >= 2 {
        let stack = field.stacked(seen, &laid);
        let squares: f64 = laid.iter().flatten().map(|s| s[0] * s[0] + s[1] * s[1]).sum();
        let n = count(&laid) as f64;
        let of_mean = (squares / (2.0 * (n - 1.0)) / n).sqrt();
        let spread = |tell: Tell, centre| field.spread(seen, &laid, centre, tell);
        let settled = by_symmetry(&field, &stack, of_mean, spread)
            .or_else(|| by_corner(&field, &stack, of_mean, spread))
            .unwrap_or_else(|| by_clicks(&field, &stack, of_mean));
        shared_sigma = settled.sigma;
        let common = if by_edges { stack } else { field.edges(&stack) };
        for ((edges, shift), found) in edges.iter().zip(&laid).zip(&mut found) {
            *found = match field.compare(&common, edges, *shift) {
                Some((shift, alike)) => {
                    let shift = [shift[0] + settled.shift[0], shift[1] + settled.shift[1]];
                    if alike.correlation > SAME {
                        Centre::Same(shift)
                    } else if alike.contrast < FAINT {
                        Centre::Faint(shift)
                    } else {
                        Centre::Own(shift)
                    }
                }
                None => Centre::AsPointed,
            };
        }
    }
    let click_sigma = sigma_of_clicks(&found);
    let told = |(window, centre): (&&Values, Centre)| {
        if centre != Centre::AsPointed {
            return Told { centre, sigma: shared_sigma };
        }
        // Alone there is one click, and it is its own mean; what lies behind a mark has corners, but no symmetry.
        match by_symmetry(&field, window, click_sigma, |_, _| None) {
            Some(own) => Told { centre: Centre::Own(own.shift), sigma: own.sigma },
            None => Told { centre, sigma: by_clicks(&field, window, click_sigma).sigma },
        }
    };
    windows.iter().zip(found).map(told).collect()
}

/// How many windows could be laid on the others.
fn count(laid: &[Option<[f64; 2]>]) -> usize {
    laid.iter().flatten().count()
}

/// A reference point from the mean of its clicks, and its standard deviation, values of the grid.
struct Settled {
    shift: [f64; 2],
    sigma: f64,
}

/// How what is seen in a window tells its reference point, which lies about a place.
type Tell<'a> = &'a dyn Fn(&Values, [f64; 2]) -> Option<[f64; 2]>;

/// How far a reference point may lie from the mean of clicks with this standard deviation.
fn allowed(of_mean: f64) -> f64 {
    NEAR_SIGMAS * 2f64.sqrt() * of_mean
}

/// The centre of symmetry, with what `spread` says of it, where it lies as near as the mean of the clicks allows.
fn by_symmetry(
    field: &Field,
    window: &Values,
    of_mean: f64,
    spread: impl Fn(Tell, [f64; 2]) -> Option<f64>,
) -> Option<Settled> {
    let tell: Tell = &|window, _| field.symmetric_centre(window);
    let shift = tell(window, [0.0; 2]).filter(|c| c[0].hypot(c[1]) <= NEAR_CLICKS.max(allowed(of_mean)))?;
    Some(Settled { shift, sigma: spread(tell, shift).map_or(LEAST_SIGMA, |sigma| sigma.max(LEAST_SIGMA)) })
}

/// The corner of two edges, likewise. One that no two windows show alone is as good as the mean of the clicks.
fn by_corner(
    field: &Field,
    window: &Values,
    of_mean: f64,
    spread: impl Fn(Tell, [f64; 2]) -> Option<f64>,
) -> Option<Settled> {
    let tell: Tell = &|window, about| field.corner(window, about, NEAR_CORNER + allowed(of_mean));
    let shift = tell(window, [0.0; 2])?;
    Some(Settled { shift, sigma: spread(tell, shift).unwrap_or(of_mean).max(LEAST_SIGMA) })
}

/// The mean of the clicks. Where a centre of symmetry lies further away, that is another point or the clicks are all
/// wrong: then the mean is no better than both are apart.
fn by_clicks(field: &Field, window: &Values, of_mean: f64) -> Settled {
    let away = field.symmetric_centre(window).map_or(0.0, |c| c[0].hypot(c[1]));
    Settled { shift: [0.0; 2], sigma: of_mean.max(away / 2f64.sqrt()).max(LEAST_SIGMA) }
}

/// Standard deviation of a click along one axis, by those that are known to be off; 0 where none is.
fn sigma_of_clicks(found: &[Centre]) -> f64 {
    let known: Vec<[f64; 2]> = found.iter().filter_map(|c| c.shift()).collect();
    let squares: f64 = known.iter().map(|s| s[0] * s[0] + s[1] * s[1]).sum();
    (squares / (2 * known.len().max(1)) as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stack::even;

    fn cross_at(grid: &Grid, x: f64, y: f64) -> Vec<f32> {
        let soft = |d: f64| (-0.5 * d * d).exp();
        (0..grid.width * grid.height)
            .map(|k| {
                let (u, v) = ((k % grid.width) as f64 + 0.5 - x, (k / grid.width) as f64 + 0.5 - y);
                let arms = if u.abs().max(v.abs()) < 14.0 { soft(u).max(soft(v)) } else { 0.0 };
                (arms + 0.02 * ((k * 7919) % 13) as f64 / 13.0) as f32
            })
            .collect()
    }

    /// What lies inside of a shape, in values from its reference point, with grain.
    fn solid(size: (usize, usize), off: [f64; 2], inside: impl Fn(f64, f64) -> bool) -> Vec<f32> {
        let middle = [0.5 * size.0 as f64 + off[0], 0.5 * size.1 as f64 + off[1]];
        let covered = |k: usize| {
            let (x, y) = ((k % size.0) as f64, (k / size.0) as f64);
            let parts = (0..36).filter(|s| {
                let at = |p: usize| (p as f64 + 0.5) / 6.0;
                inside(x + at(s % 6) - middle[0], y + at(s / 6) - middle[1])
            });
            parts.count() as f32 / 36.0 + 0.04 * ((k * 7919) % 13) as f32 / 13.0
        };
        (0..size.0 * size.1).map(covered).collect()
    }

    /// A shape by its name, as whether a place in values from its reference point lies inside.
    type Solid = (&'static str, fn(f64, f64) -> bool);

    const OFF: [[f64; 2]; 4] = [[2.0, -1.3], [-4.6, 0.4], [0.0, 5.0], [2.6, -4.1]];

    /// Half discs are no images of themselves, and their reference point is no corner: nothing but the clicks' mean
    /// tells it, and they scatter by what is known.
    #[test]
    fn clicks_on_marks_without_a_point_say_how_good_they_are() {
        let made = OFF.map(|o| solid((80, 80), o, |u, v| u.hypot(v) < 18.0 && v < 0.0));
        let windows: Vec<&Values> = made.iter().map(Vec::as_slice).collect();
        let squares: f64 = OFF.iter().map(|o| o[0] * o[0] + o[1] * o[1]).sum();
        let expected = (squares / 6.0 / 4.0).sqrt();
        for (told, o) in centres(&windows, &Grid { step_mm: 0.06, width: 80, height: 80 }).iter().zip(OFF) {
            assert!((told.sigma - expected).abs() < 0.1 * expected, "{told:?}, {expected}");
            let shift = told.centre.shift().expect("half discs look alike");
            assert!((shift[0] - o[0]).hypot(shift[1] - o[1]) < 0.4, "{shift:?} for {o:?}");
        }
    }

    /// Edges that meet tell the reference point of wedges and notches, whatever their angle.
    #[test]
    fn clicks_beside_corners_are_moved_onto_them() {
        for slope in [0.35, 0.45, 0.75, 1.3] {
            // Clicks whose mean is 1.2 values beside the corner.
            let off = OFF.map(|o| [o[0] + 1.0, o[1] + 0.7]);
            let made = off.map(|o| solid((80, 80), o, |u, v| v < 0.0 && v > -24.0 && u.abs() < -slope * v));
            let windows: Vec<&Values> = made.iter().map(Vec::as_slice).collect();
            for (told, o) in centres(&windows, &Grid { step_mm: 0.06, width: 80, height: 80 }).iter().zip(off) {
                let shift = told.centre.shift().expect("wedges look alike");
                let error = (shift[0] - o[0]).hypot(shift[1] - o[1]);
                assert!(error < 0.25 && told.sigma < 0.3, "slope {slope}: {told:?} for {o:?}");
            }
        }
    }

    /// Solid shapes cover themselves well under half a turn about their middle, which is not their reference point:
    /// exact clicks stay.
    #[test]
    fn exact_clicks_on_solid_shapes_stay() {
        let shapes: [Solid; 4] = [
            ("half disc", |u, v| u.hypot(v) < 16.0 && v < 0.0),
            ("quarter of a disc", |u, v| u.hypot(v) < 20.0 && v < 0.0 && u > 0.0),
            ("triangle", |u, v| v > 0.0 && v < 24.0 && u.abs() < 0.6 * v),
            ("box open above", |u, v| u.abs().max(v.abs()) < 13.0 && !(u.abs() < 9.0 && v < 9.0)),
        ];
        let off = [[0.1, -0.1], [-0.2, 0.1], [0.0, 0.1], [0.1, -0.1]];
        for (name, inside) in shapes {
            let made = off.map(|o| solid((80, 80), o, inside));
            let windows: Vec<&Values> = made.iter().map(Vec::as_slice).collect();
            for (told, o) in centres(&windows, &Grid { step_mm: 0.06, width: 80, height: 80 }).iter().zip(off) {
                let shift = told.centre.shift().expect("they look alike");
                let error = (shift[0] - o[0]).hypot(shift[1] - o[1]);
                assert!(error < 0.3 && told.sigma < 0.5, "{name}: {told:?} for {o:?}");
            }
        }
    }

    /// Dots are their own images, but all clicks are 6 values off to one side: the centre is not where it was pointed
    /// at, and nobody is told a point that he did not mean without a doubt.
    #[test]
    fn a_centre_far_from_all_clicks_is_doubtful() {
        let made: Vec<Vec<f32>> =
            [[6.0, 0.1], [5.9, -0.1], [6.1, 0.0]].map(|o| solid((80, 80), o, |u, v| u.hypot(v) < 8.0)).to_vec();
        let windows: Vec<&Values> = made.iter().map(Vec::as_slice).collect();
        for told in centres(&windows, &Grid { step_mm: 0.06, width: 80, height: 80 }) {
            let shift = told.centre.shift().expect("they look alike");
            assert!(shift[0].hypot(shift[1]) < 0.5 && told.sigma > 3.0, "{told:?}");
        }
    }

    #[test]
    fn clicks_that_are_off_are_moved_to_the_centres() {
        for (width, height) in [(80, 80), (81, 79)] {
            let grid = Grid { step_mm: 0.06, width, height };
            let middle = [0.5 * width as f64, 0.5 * height as f64];
            let off = [[2.0, -1.3], [-4.6, 0.4], [0.0, 5.0], [1.7, 1.7]];
            let made: Vec<Vec<f32>> = off.iter().map(|o| cross_at(&grid, middle[0] + o[0], middle[1] + o[1])).collect();
            let windows: Vec<&Values> = made.iter().map(Vec::as_slice).collect();
            for (found, true_off) in centres(&windows, &grid).iter().zip(off) {
                let found = found.centre.shift().expect("crosses look alike");
                let error = (found[0] - true_off[0]).hypot(found[1] - true_off[1]);
                assert!(error < 0.2, "{found:?} for {true_off:?}");
            }
        }
    }

    /// Dots of five pixels on opaque film with grain, each pointed at two pixels off in another direction.
    #[test]
    fn clicks_beside_small_dots_are_moved_onto_them() {
        const SIDE: usize = 83;
        let grid = Grid { step_mm: 0.06, width: SIDE, height: SIDE };
        let off = [[1.6, -1.2], [-2.0, 0.3], [0.4, 1.9], [-1.3, -1.5]];
        let windows: Vec<Vec<f32>> = off
            .iter()
            .enumerate()
            .map(|(k, [dx, dy])| {
                let value = |n: usize| {
                    let (x, y) = ((n % SIDE) as f64 + 0.5 - 41.5 - dx, (n / SIDE) as f64 + 0.5 - 41.5 - dy);
                    let grain = (((n + 7919 * k) as u32).wrapping_mul(2_654_435_761) >> 16) % 1000;
                    let cover = (3.0 - x.hypot(y)).clamp(0.0, 1.0);
                    0.04 + 0.8 * cover as f32 + 0.04 * (grain as f32 / 1000.0 - 0.5)
                };
                let mut values: Vec<f32> = (0..SIDE * SIDE).map(value).collect();
                even(&mut values);
                values
            })
            .collect();
        let views: Vec<&[f32]> = windows.iter().map(Vec::as_slice).collect();
        for (centre, [dx, dy]) in centres(&views, &grid).into_iter().zip(off) {
            let [x, y] = centre.centre.shift().expect("a dot tells its centre");
            assert!((x - dx).hypot(y - dy) < 0.3, "{x} {y} instead of {dx} {dy}");
        }
    }
}
