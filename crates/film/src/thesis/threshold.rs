//! The level between the mark and what lies behind it, from a histogram of 256 levels.

/// Largest level at which the peak of a mark is expected.
const MOST_PEAK: usize = 20;
/// A histogram that changes by less than this share of its range from one level to the next is flat.
const FLAT: f64 = 0.05;

/// Shares of 256 levels, 0 to 255.
pub(super) fn histogram(levels: &[f32]) -> [f64; 256] {
    let mut h = [0.0; 256];
    for v in levels {
        h[v.round().clamp(0.0, 255.0) as usize] += 1.0 / levels.len() as f64;
    }
    h
}

/// Equations 8.2 and 8.3: correlation with −3 … 3, nothing beyond the ends.
fn slopes(h: &[f64; 256]) -> [f64; 256] {
    std::array::from_fn(|i| {
        (-3i32..=3).map(|k| f64::from(k) * h.get((i as i32 + k) as usize).copied().unwrap_or(0.0)).sum()
    })
}

/// Where the slope changes its sign from `from`, zeros left out.
fn turns(slopes: &[f64; 256], from: f64) -> impl Iterator<Item = usize> + '_ {
    let mut before = 0.0f64;
    slopes.iter().enumerate().filter_map(move |(i, s)| {
        let turn = before * from > 0.0 && s * from < 0.0;
        if *s != 0.0 {
            before = *s;
        }
        turn.then_some(i)
    })
}

/// Number of peaks.
pub(super) fn peaks(h: &[f64; 256]) -> usize {
    turns(&slopes(h), 1.0).count()
}

/// N. Otsu, "A threshold selection method from gray-level histograms", IEEE Transactions on Systems, Man, and
/// Cybernetics, 1979: the level at which the variance between the two classes is largest.
pub(super) fn otsu(h: &[f64; 256]) -> usize {
    let mean: f64 = h.iter().enumerate().map(|(i, v)| i as f64 * v).sum();
    let (mut weight, mut sum, mut best) = (0.0, 0.0, (0, -1.0));
    for (i, v) in h.iter().enumerate() {
        weight += v;
        sum += i as f64 * v;
        let between =
            if weight > 0.0 && weight < 1.0 { (mean * weight - sum).powi(2) / (weight * (1.0 - weight)) } else { 0.0 };
        if between > best.1 {
            best = (i, between);
        }
    }
    best.0
}

fn highest(h: &[f64]) -> usize {
    (0..h.len()).max_by(|a, b| h[*a].total_cmp(&h[*b]).then(b.cmp(a))).unwrap_or(0)
}

/// Where the peak of a mark may lie among the levels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Peak {
    Anywhere,
    /// At [`MOST_PEAK`] at most.
    InTheDark,
}

/// Equations 8.4 to 8.6: the first valley below half of the mark's peak, which is the highest below Otsu's threshold,
/// and that threshold at most.
pub(super) fn valley(h: &[f64; 256], where_it_lies: Peak) -> u8 {
    let most = otsu(h);
    let mut peak = highest(&h[..=most]);
    if where_it_lies == Peak::InTheDark && peak > MOST_PEAK {
        peak = highest(&h[..=MOST_PEAK]);
    }
    let valley = turns(&slopes(h), -1.0).find(|i| *i > peak && h[*i] < 0.5 * h[peak]);
    valley.unwrap_or(most).min(most) as u8
}

/// Equation 8.8: the level after the first step that is flat, from the highest peak on, so that the peak itself is
/// always below it. Made for the spike at zero of very dark frames: a peak with a rounded top is flat at its top
/// already.
pub(super) fn flat_after_peak(h: &[f64; 256]) -> u8 {
    let range = h.iter().copied().fold(0.0, f64::max) - h.iter().copied().fold(f64::MAX, f64::min);
    let peak = highest(h);
    (peak..255).find(|i| (h[*i] - h[i + 1]).abs() < FLAT * range).map_or(255, |i| i + 1) as u8
}

/// Levels stretched so that every one is as frequent as the others.
pub(super) fn equalised(levels: &[f32]) -> Vec<f32> {
    let mut sum = 0.0;
    let to = histogram(levels).map(|v| {
        sum += v;
        (255.0 * sum) as f32
    });
    levels.iter().map(|v| to[v.round().clamp(0.0, 255.0) as usize]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Bells of (level, width, share).
    fn bells(list: &[(f64, f64, f64)]) -> [f64; 256] {
        let mut h: [f64; 256] = std::array::from_fn(|i| {
            list.iter().map(|(m, s, a)| a / s * (-0.5 * ((i as f64 - m) / s).powi(2)).exp()).sum()
        });
        let sum: f64 = h.iter().sum();
        h.iter_mut().for_each(|v| *v /= sum);
        h
    }

    #[test]
    fn the_valley_lies_between_the_marks_peak_and_the_ground() {
        let h = bells(&[(12.0, 3.0, 0.3), (60.0, 10.0, 0.4), (170.0, 20.0, 0.3)]);
        assert_eq!(peaks(&h), 3);
        let level = valley(&h, Peak::InTheDark);
        assert!((22..45).contains(&level), "{level}");
        assert!(otsu(&h) > 80, "two classes alone would take the dark ground for the mark");
    }

    /// A spike at zero whose tail falls by two fifths from level to level, on even ground: 0.4 · 0.6ⁱ is below 0.05
    /// from 5 on.
    #[test]
    fn a_dark_box_is_cut_where_its_peak_ends() {
        let h: [f64; 256] = std::array::from_fn(|i| 0.3 * 0.6f64.powi(i as i32) + 0.001);
        assert_eq!(flat_after_peak(&h), 6);
    }

    #[test]
    fn the_peak_is_cut_off_however_it_looks() {
        let mut spike = [0.001; 256];
        spike[3] = 0.745;
        assert_eq!(flat_after_peak(&spike), 5);
        let rounded = bells(&[(2.0, 4.0, 0.8), (40.0, 30.0, 0.2)]);
        assert_eq!(flat_after_peak(&rounded), 3);
    }

    #[test]
    fn equalising_spreads_levels_evenly() {
        let crowded: Vec<f32> = (0..1000).map(|i| (i % 10) as f32).collect();
        let h = histogram(&equalised(&crowded));
        assert_eq!(h.iter().filter(|v| **v > 0.0).count(), 10);
        assert!(h[255] > 0.09 && h[26] > 0.09 && h[3] == 0.0);
    }
}
