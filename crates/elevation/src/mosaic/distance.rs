//! How far cells lie from the nearest that is not there, up to a reach: exact, so that any tile that sees so far around
//! itself finds the same (A. Meijster, J. B. T. M. Roerdink and W. H. Hesselink, *A general algorithm for computing
//! distance transforms in linear time*, 2000).

/// Distances between centres, in cells, up to `reach`; 0 for cells that are not there. What lies outside the window is
/// taken to be there.
pub(super) fn from_voids(there: &[bool], width: usize, reach: u16) -> Vec<f32> {
    if there.iter().all(|there| *there) {
        return vec![f32::from(reach); there.len()];
    }
    let height = there.len() / width;
    // Farther than any distance that counts.
    let far = reach + 1;
    let mut down = vec![far; there.len()];
    for x in 0..width {
        let mut last = far;
        let mut pass = |y: usize| {
            let at = y * width + x;
            last = if there[at] { (last + 1).min(far) } else { 0 };
            down[at] = down[at].min(last);
        };
        (0..height).for_each(&mut pass);
        last = far;
        let mut pass = |y: usize| {
            let at = y * width + x;
            last = if there[at] { (last + 1).min(far) } else { 0 };
            down[at] = down[at].min(last);
        };
        (0..height).rev().for_each(&mut pass);
    }
    let mut out = Vec::with_capacity(there.len());
    let mut hulls = Vec::new();
    for row in down.chunks_exact(width) {
        along(row, far, &mut hulls);
        let mut hull = 0;
        for x in 0..width as i64 {
            while hull + 1 < hulls.len() && hulls[hull + 1].1 <= x {
                hull += 1;
            }
            let distance = hulls.get(hull).map_or(f32::from(far), |&(column, _)| {
                let down = i64::from(row[column as usize]);
                // Squares beyond what a float holds whole are beyond the reach.
                (((x - column) * (x - column) + down * down) as f32).sqrt()
            });
            out.push(distance.min(f32::from(reach)));
        }
    }
    out
}

/// The lower hull of the parabolas over the columns of a row: each column with the place from which on it is lowest.
fn along(row: &[u16], far: u16, hulls: &mut Vec<(i64, i64)>) {
    hulls.clear();
    for (column, &down) in (0i64..).zip(row).filter(|(_, down)| **down < far) {
        let down = i64::from(down);
        let mut from = i64::MIN;
        while let Some(&(other, begins)) = hulls.last() {
            let height = i64::from(row[other as usize]);
            // The first place where this column is nearer than the other one, or as near.
            let sum = column * column - other * other + down * down - height * height;
            from = sum.div_euclid(2 * (column - other)) + 1;
            if from > begins {
                break;
            }
            hulls.pop();
            from = i64::MIN;
        }
        hulls.push((column, from));
    }
}

#[cfg(test)]
mod tests {
    use super::from_voids;

    #[test]
    fn distances_are_those_of_a_search_whatever_the_window() {
        let (width, height, reach) = (41usize, 33usize, 9u16);
        let mut random = autoref_raster::random::SplitMix64(3);
        let there: Vec<bool> = (0..width * height).map(|_| random.unit() > 0.02).collect();
        let search = |x: usize, y: usize| {
            let voids = (0..width * height).filter(|&at| !there[at]);
            let away = |at: usize| ((at % width) as f64 - x as f64).hypot((at / width) as f64 - y as f64);
            voids.map(away).fold(f64::from(reach), f64::min)
        };
        let found = from_voids(&there, width, reach);
        for (at, distance) in found.iter().enumerate() {
            assert!((f64::from(*distance) - search(at % width, at / width)).abs() < 1e-6, "{at}");
        }
        // Rows and columns 3 to 29 see 9 cells around those from 12 to 20.
        let part: Vec<bool> = (3..30).flat_map(|y| there[y * width + 3..y * width + 30].to_vec()).collect();
        let some = from_voids(&part, 27, reach);
        for (y, x) in (12..21).flat_map(|y| (12..21).map(move |x| (y, x))) {
            assert_eq!(some[(y - 3) * 27 + x - 3].to_bits(), found[y * width + x].to_bits());
        }
        assert!(from_voids(&[true; 12], 4, 5).iter().all(|d| *d == 5.0));
    }
}
