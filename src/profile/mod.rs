//! What a mark looks like: colour, size, shape, and the limits of every gate. A profile is a small TOML file; the
//! shipped ones are compiled in (`src/profile/builtin/`). Every option is listed in `docs/detection-options.md`.
//!
//! ```
//! use autoref_stream::profile::Profile;
//! let orange = Profile::load("orange")?; // or the name of a TOML file
//! let again = Profile::parse(&orange.to_toml()).expect("what it writes it reads");
//! assert_eq!(orange, again);
//! # Ok::<(), autoref_raster::Error>(())
//! ```

mod check;
pub mod colour;
mod family;
pub mod mixing;
mod paint;
mod rule;
mod shipped;
mod worn;

use std::path::Path;

use serde::{Deserialize, Serialize};

use autoref_raster::bounded;
use autoref_raster::error::{Error, Result};
use autoref_raster::mask::Element;
use colour::{Cloud, Metric, Space};
pub use family::Family;
pub(crate) use paint::srgb_of_hex;
pub use rule::{Property, Rule};

/// A mark profile. See `docs/detection-options.md` for the meaning and unit of each field.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Profile {
    pub name: String,
    #[serde(default)]
    pub description: String,
    /// Absent in profiles of black and white targets.
    #[serde(default, skip_serializing_if = "ColourModel::is_empty")]
    pub colour: ColourModel,
    pub size: Size,
    #[serde(default)]
    pub shape: Shape,
    #[serde(default)]
    pub gates: GateLimits,
    #[serde(default)]
    pub filters: Filters,
    #[serde(default)]
    pub examine: Examine,
    #[serde(default, skip_serializing_if = "Target::is_default")]
    pub target: Target,
    /// Present in profiles of coded targets, and only there.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tag: Option<Tag>,
    /// What the profile was learned from, when it was.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub learned: Option<Learned>,
}

/// Clouds of colours in one space; a pixel is paint when it is within `limit` of any cloud.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ColourModel {
    #[serde(default)]
    pub space: Space,
    #[serde(default)]
    pub metric: Metric,
    /// Largest distance, in standard deviations (Euclidean: in units of the space).
    pub limit: f64,
    /// Colour box in sRGB 0..=1 that a pixel must be in first: lowest and highest red, green, blue.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rough_box: Option<RoughBox>,
    /// A second distance that must hold too: the prototype's rough distance in RGB before the fine one in L\*a\*b\*.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rough: Option<RoughDistance>,
    pub clouds: Vec<CloudSpec>,
}

impl Default for ColourModel {
    /// No colour at all.
    fn default() -> Self {
        let (space, metric) = (Space::default(), Metric::default());
        ColourModel { space, metric, limit: 1.0, rough_box: None, rough: None, clouds: Vec::new() }
    }
}

impl ColourModel {
    fn is_empty(&self) -> bool {
        self.clouds.is_empty()
    }
}

/// What is asked of black and white targets; paint has no use for it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Target {
    /// Least difference between bright and dark, as a share of full white.
    pub min_contrast: f64,
}

impl Default for Target {
    fn default() -> Self {
        // A sixth of the scale: worn plates in shade still have it, grass and gravel seldom at all scales.
        Target { min_contrast: 0.16 }
    }
}

impl Target {
    fn is_default(&self) -> bool {
        *self == Target::default()
    }
}

/// Which codes are read; the size of the profile is that of the black square, without its white surround.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tag {
    pub family: Family,
}

/// Mean and covariance of a colour cloud in the model's space.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CloudSpec {
    pub mean: [f64; 3],
    pub covariance: [[f64; 3]; 3],
}

/// A box in the space of colours.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RoughBox {
    pub low: [f64; 3],
    pub high: [f64; 3],
}

/// Distance test in a space and metric of its own.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RoughDistance {
    pub space: Space,
    pub metric: Metric,
    pub limit: f64,
    pub mean: [f64; 3],
    pub covariance: [[f64; 3]; 3],
}

/// Side (or diameter) of a mark; in pixels, in metres (then the ground sample distance must be known), or both: metres
/// win where the ground sample distance is known.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Size {
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub min_px: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max_px: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub min_m: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max_m: Option<f64>,
}

/// What the paint was laid out as.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Shape {
    /// Square or disc, whichever fits better.
    #[default]
    Any,
    Square,
    Disc,
    /// Two crossed bars. Painted when the profile has a colour; else a plate, black on white or white on black.
    Cross,
    /// Four quarters, black and white in turn, found by shape.
    Checker,
    /// Two triangles that touch, found by shape.
    Hourglass,
    /// A black square with a number in it, of the family that `[tag]` names.
    Tag,
}

/// Limits on regions, before any pixel is looked at again. What is absent is derived from the size.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GateLimits {
    #[serde(skip_serializing_if = "Option::is_none")]
    pub min_area_px: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_area_px: Option<u64>,
    /// Shorter side of the bounding box; 2 removes lines of 1 × n pixels.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub min_side_px: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_side_px: Option<u64>,
    /// Of the ellipse with the region's second moments, 0 (circle) to 1 (line).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub min_eccentricity: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_eccentricity: Option<f64>,
    /// Area over area of the bounding box.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub min_tightness: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_tightness: Option<f64>,
    /// Area over crack length of the outline, pixels.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub min_area_per_perimeter_px: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_area_per_perimeter_px: Option<f64>,
    /// Area over area of the convex hull; needs pixels, so it is tested in the examination.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub min_solidity: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_solidity: Option<f64>,
    /// An expression over properties of the candidate's pixels; what does not satisfy it is dropped in the examination.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rule: Option<Rule>,
}

impl GateLimits {
    /// Every limit is a number that a region can reach, and none is above its fellow.
    fn check(&self) -> std::result::Result<(), (&'static str, String)> {
        let count = |v: Option<u64>| v.map(|v| v as f64);
        for (place, low, high, most) in [
            ("gates.max_area_px", count(self.min_area_px), count(self.max_area_px), f64::INFINITY),
            ("gates.max_side_px", count(self.min_side_px), count(self.max_side_px), f64::INFINITY),
            ("gates.max_eccentricity", self.min_eccentricity, self.max_eccentricity, 1.0),
            ("gates.max_tightness", self.min_tightness, self.max_tightness, 1.0),
            ("gates.max_solidity", self.min_solidity, self.max_solidity, 1.0),
            (
                "gates.max_area_per_perimeter_px",
                self.min_area_per_perimeter_px,
                self.max_area_per_perimeter_px,
                f64::INFINITY,
            ),
        ] {
            let limits = [low, high];
            if let Some(bad) = limits.iter().flatten().find(|v| !(v.is_finite() && **v >= 0.0 && **v <= most)) {
                return Err((place, format!("{bad}: this limit and its fellow lie between 0 and {most}")));
            }
            if let (Some(low), Some(high)) = (low, high)
                && low > high
            {
                return Err((place, format!("the smallest {low} is above the largest {high}")));
            }
        }
        Ok(())
    }
}

/// Filters of the mask before regions are made. Each adds its border to the halo.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Filters {
    /// 3 × 3 median (majority) of the mask.
    pub median: bool,
    /// Radius of the disc that closes gaps; 0 is none.
    pub closing_radius_px: u32,
    /// Radius of the disc that opens (removes specks and bridges); 0 is none.
    pub opening_radius_px: u32,
    /// In place of the disc that closes gaps.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub closing_element: Option<Element>,
    /// In place of the disc that opens.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub opening_element: Option<Element>,
    /// Fill holes of regions no larger than the largest mark.
    pub fill_holes: bool,
}

/// How the centre of a candidate is taken.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum CentreMode {
    /// Fit of the blurred shape; falls back to weighted moments.
    #[default]
    Fit,
    /// Mean of the region's pixels.
    Centroid,
    /// Pixel of the largest colour probability (mean of ties).
    Probability,
    /// Pixel nearest in colour (mean of ties).
    Distance,
}

/// What to do with candidates nearer to each other than a limit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TooClose {
    #[default]
    Off,
    /// All of them go.
    Remove,
    /// The one nearest to their mean stays.
    Average,
    /// The one with the best score stays.
    Probable,
}

/// Order of the list of candidates.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Ordering {
    /// By first pixel in raster order.
    #[default]
    Raster,
    Score,
    /// By closeness of area over squared side to the expected shape's.
    Closeness,
}

/// Kernel density of the paint's colour per axis of L\*a\*b\*, as the prototype used it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Density {
    /// Sample values per axis (L, a, b), a few hundred quantiles each.
    pub samples: [Vec<f64>; 3],
    /// Standard deviation of the Gaussian kernel per axis.
    pub bandwidth: [f64; 3],
    /// A candidate whose best pixel is less likely goes.
    pub min_probability: f64,
    /// A candidate with at least this share of its bounding box at probability 0 goes.
    pub max_zero_share: f64,
}

/// The examination of a candidate's own pixels.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Examine {
    pub centre: CentreMode,
    /// Smallest log-likelihood ratio kept. −∞ (`-inf`) keeps all.
    pub min_score: f64,
    /// Most regions of paint in the window around the candidate, itself included.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_clutter: Option<u32>,
    /// Largest standard deviation of the paint's samples (0..=1, all bands together).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_spread: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub density: Option<Density>,
    pub too_close: TooClose,
    pub min_distance_px: f64,
    pub order: Ordering,
    /// Take regions that may be several marks apart; taught profiles do.
    pub split: bool,
    /// Keep only what is even inside and has an edge all around: for paints without a hue, whose colour much else has.
    pub even: bool,
    /// Look for worn and blurred marks too, by a mask of their own; of paints with a hue.
    pub worn: bool,
}

impl Default for Examine {
    fn default() -> Self {
        Examine {
            centre: CentreMode::Fit,
            min_score: 0.0,
            max_clutter: None,
            max_spread: None,
            density: None,
            too_close: TooClose::Off,
            min_distance_px: 0.0,
            order: Ordering::Raster,
            split: false,
            even: false,
            worn: true,
        }
    }
}

impl Examine {
    fn check(&self) -> std::result::Result<(), (&'static str, String)> {
        if self.min_score.is_nan() || !self.min_distance_px.is_finite() || self.min_distance_px < 0.0 {
            return Err(("examine", "min_score and min_distance_px must be numbers, the latter not negative".into()));
        }
        if self.max_spread.is_some_and(|v| !(v.is_finite() && v >= 0.0)) {
            return Err(("examine.max_spread", "must be a number, not negative".into()));
        }
        let Some(d) = &self.density else { return Ok(()) };
        let filled = d.samples.iter().all(|s| !s.is_empty() && s.iter().all(|v| v.is_finite()));
        if !filled || !d.bandwidth.iter().all(|b| b.is_finite() && *b > 0.0) {
            return Err(("examine.density", "needs samples and a positive bandwidth on each axis".into()));
        }
        if !(d.min_probability.is_finite() && d.min_probability >= 0.0 && (0.0..=1.0).contains(&d.max_zero_share)) {
            let what = "min_probability is a number, not negative, max_zero_share a share from 0 to 1";
            return Err(("examine.density", what.into()));
        }
        Ok(())
    }
}

/// Statistics of a learned profile, for people; nothing depends on them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Learned {
    pub marks: u64,
    pub pixels: u64,
    pub mean_srgb: [f64; 3],
    pub side_px_min: f64,
    pub side_px_median: f64,
    pub side_px_max: f64,
    pub eccentricity_max: f64,
    pub tightness_min: f64,
    /// Distance, in the profile's own units, of the 1st percentile of the background around the marks.
    pub background_distance_p01: f64,
    /// Share of the background around the marks that the profile takes for paint.
    pub background_share: f64,
}

impl Profile {
    /// A shipped profile by its name, or one read from a TOML file.
    ///
    /// # Errors
    /// [`Error::Usage`] when it is neither, [`Error::Format`] when the file is not a profile.
    pub fn load(name_or_path: &str) -> Result<Profile> {
        if let Some(profile) = Profile::builtin(name_or_path).or_else(|| Profile::of_hex(name_or_path)) {
            return Ok(profile);
        }
        let path = Path::new(name_or_path);
        if !path.exists() {
            return Err(Error::usage(
                format!("no profile and no file is called \"{name_or_path}\""),
                format!("shipped profiles are {}", shipped::usable_names().join(", ")),
            ));
        }
        let text = bounded::read_to_string(path, "a profile", bounded::TEXT_BYTES)?;
        Profile::parse(&text).map_err(|(place, what)| Error::format(path, place, what))
    }

    /// Parses and validates.
    ///
    /// # Errors
    /// The place in the text and what is wrong there: no TOML, a field that no profile has, or a value that it cannot
    /// have.
    pub fn parse(text: &str) -> std::result::Result<Profile, (String, String)> {
        let profile: Profile = toml::from_str(text).map_err(|e| {
            let place = e.span().map_or("profile".to_owned(), |span| {
                format!("line {}", 1 + text[..span.start.min(text.len())].matches('\n').count())
            });
            (place, e.message().split_whitespace().collect::<Vec<_>>().join(" "))
        })?;
        profile.check().map_err(|(place, what)| (place.to_owned(), what))?;
        Ok(profile)
    }

    /// The profile as a TOML file.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).expect("every field of a profile has a TOML form")
    }

    /// A black and white target, found by shape in grey (coded ones too), instead of paint.
    pub fn is_target(&self) -> bool {
        match self.shape {
            Shape::Checker | Shape::Hourglass | Shape::Tag => true,
            Shape::Cross => self.colour.is_empty(),
            Shape::Any | Shape::Square | Shape::Disc => false,
        }
    }

    /// The clouds ready for use; on failure the index of the singular one.
    pub(crate) fn clouds(&self) -> std::result::Result<Vec<Cloud>, usize> {
        let metric = self.colour.metric;
        self.colour
            .clouds
            .iter()
            .enumerate()
            .map(|(i, spec)| Cloud::new(spec.mean, spec.covariance, metric).ok_or(i))
            .collect()
    }

    /// Smallest and largest side of a mark in pixels.
    ///
    /// # Errors
    /// [`Error::Usage`] when the profile gives metres only and `gsd_m` is unknown.
    pub fn side_range_px(&self, gsd_m: Option<f64>) -> Result<(f64, f64)> {
        let size = &self.size;
        let gsd_m = gsd_m.filter(|g| g.is_finite() && *g > 0.0);
        let pick = |metres: Option<f64>, px: Option<f64>| match (metres, gsd_m) {
            (Some(m), Some(g)) => Some(m / g),
            _ => px,
        };
        let high = pick(size.max_m, size.max_px).ok_or_else(|| {
            Error::usage(
                format!("profile \"{}\" gives the size in metres, and the size of a pixel is not known", self.name),
                "give the ground sample distance, or size.max_px in the profile",
            )
        })?;
        let low = pick(size.min_m, size.min_px).unwrap_or(1.0).min(high);
        Ok((low, high))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_shipped_profile_is_valid_and_survives_a_round_trip() {
        for name in Profile::names() {
            let profile = Profile::builtin(name).expect("names lists what is there");
            assert_eq!(profile.name, name);
            profile.validate().expect(name);
            assert_eq!(Profile::parse(&profile.to_toml()).expect(name), profile);
        }
        assert_eq!(Profile::names()[0], "orange");
    }

    #[test]
    fn the_fresh_paint_of_every_shipped_paint_is_paint() {
        for (name, _) in paint::FRESH {
            let profile = Profile::builtin(name).expect("shipped");
            let test = crate::segment::reference::PaintTest::new(&profile).expect("valid");
            let distance = test.nearest2(profile.fresh_paint().map(|v| f64::from(v) / 255.0)).sqrt();
            assert!(distance <= profile.colour.limit, "{name}: {:?} at {distance:.2}", profile.fresh_paint());
        }
    }

    #[test]
    fn the_reference_colour_of_2016_is_paint() {
        // Means of Table 4.2 as the table's own two halves give them: the RGB means, and the L*a*b* means back in sRGB.
        let from_lab = colour::srgb_from_lab([80.1143, 14.0786, 9.8678]);
        for name in ["lerkendal-2016", "autoref-2016"] {
            let profile = Profile::builtin(name).expect("shipped");
            let test = crate::segment::reference::PaintTest::new(&profile).expect("valid");
            for colour in [[232.0 / 255.0, 189.0 / 255.0, 181.0 / 255.0], [0.9080, 0.7426, 0.7113], from_lab] {
                assert!(test.nearest2(colour).sqrt() < profile.colour.limit, "{name}: {colour:?}");
                assert!(test.is_paint(colour.map(|v| (v * 255.0).round() as u8)), "{name}: {colour:?}");
            }
            // The colour that the corrupt Table 4.3 would give.
            assert!(!test.is_paint([180, 179, 204]), "{name}");
        }
    }

    #[test]
    fn bad_profiles_name_place_and_reason() {
        let good = Profile::builtin("orange").expect("shipped");
        type Spoil = fn(&mut Profile);
        let cases: [(&str, Spoil); 5] = [
            ("colour.limit", |p| p.colour.limit = -1.0),
            ("colour.clouds", |p| p.colour.clouds[0].covariance = [[1.0; 3]; 3]),
            ("colour.clouds", |p| p.colour.clouds.clear()),
            ("size.max_px", |p| p.size.min_px = Some(1e3)),
            ("size", |p| p.size.max_px = None),
        ];
        for (place, spoil) in cases {
            let mut bad = good.clone();
            spoil(&mut bad);
            let message = bad.validate().expect_err(place).to_string();
            assert!(message.contains(place), "{message}");
            assert!(!message.contains('\n'));
        }
        let (place, what) = Profile::parse("name = \"x\"\nbogus = 3\n").expect_err("unknown field");
        assert!(place == "line 2" || what.contains("bogus"), "{place}: {what}");
        assert!(Profile::load("no-such-profile").expect_err("missing").to_string().contains("orange"));
    }
}
