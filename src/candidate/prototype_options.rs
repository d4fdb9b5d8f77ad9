//! The remaining options of the 2016 prototype (Script A.9), each off by default: clutter, spread, solidity, kernel
//! density, plain centres, candidates too close to each other, and the order of the list.

use super::Candidate;
use super::hull::{convex_hull, twice_area};
use super::scene::Scene;
use crate::profile::colour::lab_from_srgb;
use crate::profile::{CentreMode, Density, Ordering, Profile, Property, Rule, Shape, TooClose};
use crate::segment::classify::Classifier;
use autoref_raster::coords::PixelPoint;

/// The gates that need pixels.
pub(super) fn passes(scene: &Scene<'_>, classifier: &Classifier, profile: &Profile) -> bool {
    let options = &profile.examine;
    if options.max_clutter.is_some_and(|most| scene.clutter() > most) {
        return false;
    }
    if options.max_spread.is_some_and(|most| spread(scene) > most) {
        return false;
    }
    let (least, most) = (profile.gates.min_solidity, profile.gates.max_solidity);
    if least.is_some() || most.is_some() {
        let solidity = solidity(scene);
        if least.is_some_and(|least| solidity < least) || most.is_some_and(|most| solidity > most) {
            return false;
        }
    }
    if profile.gates.rule.as_ref().is_some_and(|rule| !follows(rule, scene, classifier, profile)) {
        return false;
    }
    options.density.as_ref().is_none_or(|density| {
        let values: Vec<f64> = box_pixels(scene).map(|i| probability(density, scene, i)).collect();
        let zeros = values.iter().filter(|&&p| p == 0.0).count() as f64;
        let best = values.iter().copied().fold(0.0, f64::max);
        best >= density.min_probability && zeros / (values.len() as f64) < density.max_zero_share
    })
}

/// Whether the candidate's own pixels satisfy a rule of the profile.
fn follows(rule: &Rule, scene: &Scene<'_>, classifier: &Classifier, profile: &Profile) -> bool {
    let at = |i: usize| ((i % scene.width) as f64, (i / scene.width) as f64);
    let area = scene.own.count() as f64;
    if area == 0.0 {
        return false;
    }
    let (mut low, mut high) = ((f64::INFINITY, f64::INFINITY), (f64::NEG_INFINITY, f64::NEG_INFINITY));
    let (mut mean_x, mut mean_y) = (0.0, 0.0);
    for (x, y) in scene.own.iter().map(at) {
        (low, high) = ((low.0.min(x), low.1.min(y)), (high.0.max(x), high.1.max(y)));
        (mean_x, mean_y) = (mean_x + x / area, mean_y + y / area);
    }
    let (width, height) = (high.0 - low.0 + 1.0, high.1 - low.1 + 1.0);
    let perimeter = || {
        let column = |i: usize| i % scene.width;
        let sides = |i: usize| {
            let free = |inside: bool, other: usize| u64::from(!(inside && scene.own.has(other)));
            free(column(i) > 0, i.wrapping_sub(1))
                + free(column(i) + 1 < scene.width, i + 1)
                + free(i >= scene.width, i.wrapping_sub(scene.width))
                + free(i + scene.width < scene.width * scene.height, i + scene.width)
        };
        scene.own.iter().map(sides).sum::<u64>() as f64
    };
    let eccentricity = || {
        let (mut xx, mut xy, mut yy) = (1.0 / 12.0, 0.0, 1.0 / 12.0);
        for (x, y) in scene.own.iter().map(at) {
            let (x, y) = (x - mean_x, y - mean_y);
            (xx, xy, yy) = (xx + x * x / area, xy + x * y / area, yy + y * y / area);
        }
        let half_gap = (((xx - yy) / 2.0).powi(2) + xy * xy).sqrt();
        (1.0 - (((xx + yy) / 2.0 - half_gap) / ((xx + yy) / 2.0 + half_gap)).clamp(0.0, 1.0)).sqrt()
    };
    let distances =
        || scene.own.iter().map(|i| classifier.reference().nearest2(unit(scene, i)).sqrt() / profile.colour.limit);
    rule.holds(&|property| match property {
        Property::Area => area,
        Property::Perimeter => perimeter(),
        Property::Width => width,
        Property::Height => height,
        Property::Extent => area / (width * height),
        Property::Eccentricity => eccentricity(),
        Property::Solidity => solidity(scene),
        Property::Compactness => 4.0 * std::f64::consts::PI * area / perimeter().powi(2),
        Property::MeanDistance => distances().sum::<f64>() / area,
        Property::MinDistance => distances().fold(f64::INFINITY, f64::min),
        Property::MaxDistance => distances().fold(0.0, f64::max),
    })
}

/// The centre by one of the prototype's modes; `None` when the profile asks for a fit.
pub(super) fn plain_centre(scene: &Scene<'_>, classifier: &Classifier, profile: &Profile) -> Option<(f64, f64)> {
    let own = || scene.own.iter();
    // Lower is better; ties are averaged.
    let cost: Box<dyn Fn(usize) -> f64> = match (profile.examine.centre, &profile.examine.density) {
        (CentreMode::Fit, _) => return None,
        (CentreMode::Centroid, _) => Box::new(|_| 0.0),
        (CentreMode::Probability, Some(density)) => Box::new(|i| -probability(density, scene, i)),
        // Without a density the nearest colour is the most probable one.
        (CentreMode::Probability, None) | (CentreMode::Distance, _) => {
            Box::new(|i| classifier.reference().nearest2(unit(scene, i)))
        }
    };
    let best = own().map(&cost).fold(f64::INFINITY, f64::min);
    let (mut n, mut x, mut y) = (0.0, 0.0, 0.0);
    for i in own().filter(|&i| cost(i) == best) {
        n += 1.0;
        x += (i % scene.width) as f64 + 0.5;
        y += (i / scene.width) as f64 + 0.5;
    }
    Some((scene.patch.window.x as f64 + x / n, scene.patch.window.y as f64 + y / n))
}

fn unit(scene: &Scene<'_>, i: usize) -> [f64; 3] {
    let c = scene.colour(i);
    [c[0], c[1], c[2]].map(|v| v.min(255.0) / 255.0)
}

/// Pixels of the bounding box of the candidate's own paint.
fn box_pixels<'a>(scene: &'a Scene<'_>) -> impl Iterator<Item = usize> + 'a {
    let own = || scene.own.iter();
    let x = (own().map(|i| i % scene.width).min().unwrap_or(0), own().map(|i| i % scene.width).max().unwrap_or(0));
    let y = (own().map(|i| i / scene.width).min().unwrap_or(0), own().map(|i| i / scene.width).max().unwrap_or(0));
    (y.0..=y.1).flat_map(move |v| (x.0..=x.1).map(move |u| v * scene.width + u))
}

/// Product over L\*, a\*, b\* of the kernel densities at the pixel's colour.
fn probability(density: &Density, scene: &Scene<'_>, i: usize) -> f64 {
    let lab = lab_from_srgb(unit(scene, i));
    (0..3)
        .map(|axis| {
            let h = density.bandwidth[axis];
            let samples = &density.samples[axis];
            let sum: f64 = samples.iter().map(|s| (-0.5 * ((lab[axis] - s) / h).powi(2)).exp()).sum();
            sum / (samples.len() as f64 * h * (std::f64::consts::TAU).sqrt())
        })
        .product()
}

/// Standard deviation of the paint's samples about their band means, 0..=1.
fn spread(scene: &Scene<'_>) -> f64 {
    let colours: Vec<[f64; 3]> = scene.own.iter().map(|i| unit(scene, i)).collect();
    let n = colours.len() as f64;
    let mean: [f64; 3] = std::array::from_fn(|c| colours.iter().map(|v| v[c]).sum::<f64>() / n);
    let square: f64 = colours.iter().map(|v| (0..3).map(|c| (v[c] - mean[c]).powi(2)).sum::<f64>()).sum();
    (square / (3.0 * n)).sqrt()
}

/// Area over the area of the convex hull of the pixels' squares.
fn solidity(scene: &Scene<'_>) -> f64 {
    let corners = scene
        .own
        .iter()
        .map(|i| ((i % scene.width) as i64, (i / scene.width) as i64))
        .flat_map(|(x, y)| [(x, y), (x + 1, y), (x, y + 1), (x + 1, y + 1)])
        .collect();
    scene.own.count() as f64 / (twice_area(&convex_hull(corners)) as f64 / 2.0).max(1.0)
}

/// What is done to the whole list at the end: candidates too close to each other, and the order. The list must come in
/// raster order of first pixels, so that the answer does not depend on the tiling.
pub fn finish(mut list: Vec<Candidate>, profile: &Profile) -> Vec<Candidate> {
    if profile.examine.too_close != TooClose::Off {
        list = thin(list, profile.examine.too_close, profile.examine.min_distance_px);
    }
    match profile.examine.order {
        Ordering::Raster => {}
        Ordering::Score => list.sort_by(|a, b| {
            let score = |c: &Candidate| c.score.unwrap_or(f64::NEG_INFINITY);
            score(b).total_cmp(&score(a))
        }),
        Ordering::Closeness => list.sort_by(|a, b| closeness(a, profile.shape).total_cmp(&closeness(b, profile.shape))),
    }
    list
}

/// How far area over squared longer side is from the shape's own: 1 for an upright square, π/4 for a disc.
fn closeness(c: &Candidate, shape: Shape) -> f64 {
    let (Some(area), Some([w, h])) = (c.area_px, c.size_px) else { return f64::INFINITY };
    let expected = if shape == Shape::Square { 1.0 } else { std::f64::consts::FRAC_PI_4 };
    (area / w.max(h).powi(2) - expected).abs()
}

fn thin(list: Vec<Candidate>, mode: TooClose, min_distance_px: f64) -> Vec<Candidate> {
    let near = neighbours(&list, min_distance_px);
    let mut gone = vec![false; list.len()];
    for i in 0..list.len() {
        if near[i].is_empty() || gone[i] && mode != TooClose::Remove {
            continue;
        }
        let group: Vec<usize> = near[i].iter().copied().chain([i]).collect();
        let keep = match mode {
            TooClose::Off => continue,
            TooClose::Remove => {
                gone[i] = true;
                continue;
            }
            TooClose::Average => {
                let n = group.len() as f64;
                let x = group.iter().map(|&j| list[j].centre.x).sum::<f64>() / n;
                let y = group.iter().map(|&j| list[j].centre.y).sum::<f64>() / n;
                let d = |j: usize| distance(list[j].centre, PixelPoint { x, y });
                group.iter().copied().min_by(|&a, &b| d(a).total_cmp(&d(b)).then(a.cmp(&b)))
            }
            TooClose::Probable => {
                let s = |j: usize| list[j].score.unwrap_or(f64::NEG_INFINITY);
                group.iter().copied().min_by(|&a, &b| s(b).total_cmp(&s(a)).then(a.cmp(&b)))
            }
        };
        for &j in &group {
            gone[j] = Some(j) != keep;
        }
    }
    list.into_iter().zip(gone).filter(|(_, gone)| !gone).map(|(c, _)| c).collect()
}

fn distance(a: PixelPoint, b: PixelPoint) -> f64 {
    ((a.x - b.x).powi(2) + (a.y - b.y).powi(2)).sqrt()
}

/// Indices of the candidates nearer than the limit to each, by a sweep over x.
fn neighbours(list: &[Candidate], min_distance_px: f64) -> Vec<Vec<usize>> {
    let mut order: Vec<usize> = (0..list.len()).collect();
    order.sort_by(|&a, &b| list[a].centre.x.total_cmp(&list[b].centre.x).then(a.cmp(&b)));
    let mut near = vec![Vec::new(); list.len()];
    for (k, &i) in order.iter().enumerate() {
        for &j in &order[k + 1..] {
            if list[j].centre.x - list[i].centre.x >= min_distance_px {
                break;
            }
            if distance(list[i].centre, list[j].centre) < min_distance_px {
                near[i].push(j);
                near[j].push(i);
            }
        }
    }
    near.iter_mut().for_each(|n| n.sort_unstable());
    near
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x: f64, y: f64, score: f64) -> Candidate {
        Candidate {
            score: Some(score),
            area_px: Some(78.5),
            size_px: Some([10.0, 10.0]),
            ..Candidate::at(PixelPoint { x, y })
        }
    }

    #[test]
    fn too_close_candidates_follow_the_mode() {
        let list = || vec![at(0.0, 0.0, 1.0), at(5.0, 0.0, 9.0), at(9.0, 0.0, 3.0), at(100.0, 0.0, 2.0)];
        let mut profile = Profile::builtin("orange").expect("shipped");
        profile.examine.min_distance_px = 10.0;
        let xs = |mode, profile: &Profile| {
            let mut profile = profile.clone();
            profile.examine.too_close = mode;
            finish(list(), &profile).iter().map(|c| c.centre.x).collect::<Vec<_>>()
        };
        assert_eq!(xs(TooClose::Off, &profile).len(), 4);
        assert_eq!(xs(TooClose::Remove, &profile), [100.0]);
        assert_eq!(xs(TooClose::Average, &profile), [5.0, 100.0]);
        assert_eq!(xs(TooClose::Probable, &profile), [5.0, 100.0]);
        profile.examine.order = Ordering::Score;
        assert_eq!(finish(list(), &profile)[0].centre.x, 5.0);
    }
}
