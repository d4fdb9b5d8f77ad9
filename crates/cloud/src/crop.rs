//! Crops: by height, by distance from a camera, by polygon.

use autoref_raster::rings::SidesByNorthing;

use crate::error::{Error, Result};

/// What lies outside becomes noise; all coordinates are the map's.
#[derive(Clone, Debug, PartialEq)]
pub enum Crop {
    /// Kept when min ≤ z ≤ max.
    Height { min_m: f64, max_m: f64 },
    /// Kept when nearer to the camera than its height over z = 0 divided by the sine of the angle.
    Range { camera: [f64; 3], elevation_angle_deg: f64 },
    /// Kept when inside.
    Polygon(Polygon),
}

impl Crop {
    /// A crop by range.
    ///
    /// # Errors
    /// When the camera is not above z = 0, or the angle not between 0 and 90 degrees.
    pub fn range(camera: [f64; 3], elevation_angle_deg: f64) -> Result<Crop> {
        if !(elevation_angle_deg > 0.0 && elevation_angle_deg <= 90.0) {
            let what = format!("--elevation-angle is {elevation_angle_deg}");
            return Err(Error::usage(what, "give degrees above 0, at most 90"));
        }
        if camera[2] <= 0.0 {
            let what = format!("the camera's height of --range-from is {} m", camera[2]);
            return Err(Error::usage(what, "give a height above z = 0"));
        }
        Ok(Crop::Range { camera, elevation_angle_deg })
    }

    /// The largest distance from the camera that is kept.
    pub fn greatest_range_m(&self) -> Option<f64> {
        match self {
            Crop::Range { camera, elevation_angle_deg } => Some(camera[2] / elevation_angle_deg.to_radians().sin()),
            _ => None,
        }
    }

    /// Whether a point of the map is kept.
    pub fn keeps(&self, map: [f64; 3]) -> bool {
        match self {
            Crop::Height { min_m, max_m } => (*min_m..=*max_m).contains(&map[2]),
            Crop::Range { camera, .. } => {
                let far = self.greatest_range_m().expect("this is a crop by range");
                distance(map, *camera) <= far
            }
            Crop::Polygon(polygon) => polygon.contains([map[0], map[1]]),
        }
    }
}

/// The distance of two places.
pub fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    crate::kdtree::distance2(a, b).sqrt()
}

/// A closed line of corners.
pub type Ring = Vec<[f64; 2]>;

/// A side of a ring.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Side {
    from: [f64; 2],
    to: [f64; 2],
    area: u32,
}

/// Areas, which may overlap: a place inside any of them is inside. The rings of one count by the even-odd rule: holes
/// are rings inside others.
#[derive(Clone, Debug, PartialEq)]
pub struct Polygon {
    /// Area by area.
    sides: Vec<Side>,
    by_northing: SidesByNorthing,
    min: [f64; 2],
    max: [f64; 2],
}

impl Polygon {
    /// Of areas, each with its outline and its holes.
    pub fn new(areas: Vec<Vec<Ring>>) -> Polygon {
        let (mut min, mut max) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for corner in areas.iter().flatten().flatten() {
            for axis in 0..2 {
                min[axis] = min[axis].min(corner[axis]);
                max[axis] = max[axis].max(corner[axis]);
            }
        }
        let mut sides: Vec<Side> = Vec::new();
        for (area, ring) in (0..).zip(&areas).flat_map(|(area, rings)| rings.iter().map(move |ring| (area, ring))) {
            let ends = ring.iter().zip(ring.iter().cycle().skip(1)).take(ring.len());
            // A level side is never crossed.
            sides.extend(ends.filter(|(a, b)| a[1] != b[1]).map(|(&from, &to)| Side { from, to, area }));
        }
        let spans: Vec<(f64, f64)> = sides.iter().map(|s| (s.from[1].min(s.to[1]), s.from[1].max(s.to[1]))).collect();
        Polygon { sides, by_northing: SidesByNorthing::new(&spans), min, max }
    }

    /// Whether a ray towards the east crosses the rings of an area an odd number of times.
    pub fn contains(&self, place: [f64; 2]) -> bool {
        let [x, y] = place;
        // NaN is outside too.
        let within = |axis: usize| place[axis] >= self.min[axis] && place[axis] <= self.max[axis];
        if !(within(0) && within(1)) {
            return false;
        }
        let crosses = |side: &Side| {
            let (a, b) = (side.from, side.to);
            (a[1] > y) != (b[1] > y) && x < (b[0] - a[0]) * (y - a[1]) / (b[1] - a[1]) + a[0]
        };
        let side = |number: &u32| &self.sides[*number as usize];
        let near = self.by_northing.near(y);
        let of_areas = near.chunk_by(|one, other| side(one).area == side(other).area);
        of_areas.into_iter().any(|sides| sides.iter().filter(|number| crosses(side(number))).count() % 2 == 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_thesis_range() {
        let crop = Crop::range([0.0, 0.0, 3000.0], 10.0).expect("a camera");
        assert!((crop.greatest_range_m().expect("range") - 17_276.3).abs() < 0.1);
        assert!(crop.keeps([17_000.0, 0.0, 0.0]) && !crop.keeps([17_100.0, 0.0, 0.0]));
        assert!(Crop::range([0.0; 3], 10.0).is_err() && Crop::range([0.0, 0.0, 1.0], 0.0).is_err());
    }

    #[test]
    fn holes_are_outside() {
        let square = |low: f64, high: f64| vec![[low, low], [high, low], [high, high], [low, high]];
        let polygon = Polygon::new(vec![vec![square(0.0, 10.0), square(4.0, 6.0)]]);
        assert!(polygon.contains([1.0, 5.0]) && !polygon.contains([5.0, 5.0]) && !polygon.contains([11.0, 5.0]));
    }

    /// Every side asked, without bands.
    fn contains_by_all(areas: &[Vec<Ring>], [x, y]: [f64; 2]) -> bool {
        let crossed = |ring: &Ring| {
            (0..ring.len())
                .filter(|&i| {
                    let (a, b) = (ring[i], ring[(i + 1) % ring.len()]);
                    (a[1] > y) != (b[1] > y) && x < (b[0] - a[0]) * (y - a[1]) / (b[1] - a[1]) + a[0]
                })
                .count()
        };
        areas.iter().any(|rings| rings.iter().map(crossed).sum::<usize>() % 2 == 1)
    }

    #[test]
    fn bands_answer_as_all_sides() {
        let mut random = autoref_raster::random::SplitMix64(3);
        for corners in [3, 4, 40, 3000] {
            let mut ring =
                || -> Ring { (0..corners).map(|_| [random.unit(), (8.0 * random.unit()).floor() / 8.0]).collect() };
            let areas = vec![vec![ring(), ring()], vec![ring()]];
            let polygon = Polygon::new(areas.clone());
            let mut inside = 0;
            for k in 0..2000 {
                // Heights of corners among them.
                let place =
                    [random.unit(), if k % 3 == 0 { (8.0 * random.unit()).floor() / 8.0 } else { random.unit() }];
                assert_eq!(polygon.contains(place), contains_by_all(&areas, place), "{place:?}");
                inside += usize::from(polygon.contains(place));
            }
            assert!((50..1950).contains(&inside), "{inside} of {corners} corners");
        }
        assert!(!Polygon::new(Vec::new()).contains([0.0, 0.0]));
    }

    #[test]
    fn a_place_in_two_areas_is_inside() {
        let square = |low: f64, high: f64| vec![[low, low], [high, low], [high, high], [low, high]];
        let polygon = Polygon::new(vec![vec![square(0.0, 4.0)], vec![square(2.0, 6.0)]]);
        assert!([1.0, 3.0, 5.0].iter().all(|&at| polygon.contains([at, at])) && !polygon.contains([1.0, 5.0]));
    }
}
