//! Profiles of paints by their colour: RAL Classic and a few others by name, any other from its sRGB value.
//!
//! The clouds are those of the mixing model ([`super::mixing`]) for the paint itself, fresh and worn. sRGB values of
//! RAL colours differ from table to table; both that are in wide use are taken.

use super::colour::Space;
use super::mixing::{Mixing, cloud, population};
use super::{CentreMode, CloudSpec, ColourModel, Examine, Filters, GateLimits, Profile, Shape, Size, Target};

/// A name, what it is, its sRGB values, and the dark rim that it needs, see [`Profile::of_paints`].
struct Paint {
    name: &'static str,
    called: &'static str,
    srgb: &'static [[u8; 3]],
    rim_sides: f64,
}

/// Width of the rim that keeps ground of a paint's colour off a mark, sides of the mark; of white it is a whole one, as
/// much of any ground is bright.
pub(super) const RIM_SIDES: f64 = 0.5;
pub(super) const RIM_OF_WHITE_SIDES: f64 = 1.0;

const PAINTS: [Paint; 12] = [
    Paint { name: "ral-1003", called: "signal yellow", srgb: &[[249, 168, 0], [229, 190, 1]], rim_sides: RIM_SIDES },
    Paint { name: "ral-1016", called: "sulphur yellow", srgb: &[[237, 255, 33], [241, 221, 56]], rim_sides: RIM_SIDES },
    Paint { name: "ral-1026", called: "luminous yellow", srgb: &[[255, 255, 0], [255, 246, 0]], rim_sides: RIM_SIDES },
    Paint { name: "ral-2003", called: "pastel orange", srgb: &[[255, 117, 20], [250, 132, 43]], rim_sides: RIM_SIDES },
    Paint { name: "ral-2004", called: "pure orange", srgb: &[[244, 70, 17], [231, 91, 18]], rim_sides: RIM_SIDES },
    Paint { name: "ral-2005", called: "luminous orange", srgb: &[[255, 35, 1], [255, 77, 8]], rim_sides: RIM_SIDES },
    Paint {
        name: "ral-2007",
        called: "luminous bright orange",
        srgb: &[[255, 164, 32], [255, 178, 0]],
        rim_sides: RIM_SIDES,
    },
    Paint { name: "ral-3020", called: "traffic red", srgb: &[[204, 6, 5], [187, 30, 16]], rim_sides: RIM_SIDES },
    Paint { name: "ral-3024", called: "luminous red", srgb: &[[248, 0, 0], [255, 45, 33]], rim_sides: RIM_SIDES },
    Paint { name: "ral-5015", called: "sky blue", srgb: &[[34, 113, 179], [0, 124, 176]], rim_sides: RIM_SIDES },
    Paint { name: "ral-6018", called: "yellow green", srgb: &[[87, 166, 57], [97, 153, 59]], rim_sides: RIM_SIDES },
    Paint {
        name: "white",
        called: "white",
        srgb: &[[255, 255, 255], [245, 245, 245], [235, 238, 240]],
        rim_sides: RIM_OF_WHITE_SIDES,
    },
];

/// Names of the paints, as [`by_name`] takes them.
pub(super) fn names() -> impl Iterator<Item = &'static str> {
    PAINTS.iter().map(|paint| paint.name)
}

/// All paints, each with the rim that it needs, sides of the mark.
pub(super) fn all() -> impl Iterator<Item = (Profile, f64)> {
    PAINTS.iter().map(|paint| (paint.profile(), paint.rim_sides))
}

/// A paint by its name; RAL numbers in any writing: `ral-2007`, `RAL 2007`, `RAL2007`, `2007`.
pub(super) fn by_name(name: &str) -> Option<Profile> {
    let plain: String = name.to_lowercase().chars().filter(|c| c.is_ascii_alphanumeric()).collect();
    let wanted = plain.strip_prefix("ral").unwrap_or(&plain);
    let paint = PAINTS.iter().find(|paint| paint.name.strip_prefix("ral-").unwrap_or(paint.name) == wanted)?;
    Some(paint.profile())
}

impl Paint {
    fn profile(&self) -> Profile {
        let description = match self.name.strip_prefix("ral-") {
            Some(number) => format!("RAL {number}, {}, fresh and worn", self.called),
            None => format!("{} paint", self.called),
        };
        of(self.name, description, self.srgb)
    }
}

/// The first sRGB value of a paint of that name.
pub(super) fn fresh(name: &str) -> Option<[u8; 3]> {
    PAINTS.iter().find(|paint| paint.name == name).map(|paint| paint.srgb[0])
}

/// The colour that `#RRGGBB` writes.
pub(crate) fn srgb_of_hex(text: &str) -> Option<[u8; 3]> {
    let digits = text.strip_prefix('#').filter(|d| d.len() == 6 && d.bytes().all(|b| b.is_ascii_hexdigit()))?;
    let byte = |at: usize| u8::from_str_radix(&digits[at..at + 2], 16).ok();
    Some([byte(0)?, byte(2)?, byte(4)?])
}

impl Profile {
    /// The profile of a paint of this colour in full sun, sRGB 0..=255.
    pub fn of_paint(srgb: [u8; 3]) -> Profile {
        let [r, g, b] = srgb;
        let name = format!("#{r:02X}{g:02X}{b:02X}");
        let description = format!("Paint of the colour {name}, fresh and worn");
        of(&name, description, &[srgb])
    }

    /// The same of a colour written as `#RRGGBB`.
    pub fn of_hex(text: &str) -> Option<Profile> {
        srgb_of_hex(text).map(Profile::of_paint)
    }

    /// Any paint at all: saturated colours all around the circle, and white. Only to see what might be marks when a
    /// profile finds none; what it finds is sorted by colour.
    pub fn any_paint() -> Profile {
        let mut wheel: Vec<[u8; 3]> = vec![[200, 25, 30], [34, 113, 179], [0, 60, 200], [87, 166, 57], [255, 105, 180]];
        for sixth in 0..6u8 {
            // Eight hues in each sixth of the circle: between fewer there are paints that no cloud holds.
            for step in 0..8u8 {
                let (rising, falling) = (step * 32, 255 - step * 32);
                wheel.push(match sixth {
                    0 => [255, rising, 0],
                    1 => [falling, 255, 0],
                    2 => [0, 255, rising],
                    3 => [0, falling, 255],
                    4 => [rising, 0, 255],
                    _ => [255, 0, falling],
                });
            }
        }
        let mut profile = of("any paint", "Saturated colours of any hue, and white".into(), &[[255; 3], [240; 3]]);
        for paint in wheel {
            // Between orange and cyan dim paint has the colours of plants, which would join the marks that lie on them.
            let [r, g, b] = paint.map(i32::from);
            let like_plants = g > r - 40 && g > b + 60;
            let (min_light, variance) = if like_plants { (0.45, 16.0) } else { (0.25, 36.0) };
            let mixing = Mixing { fading: (0.0, 0.2), max_blur_share: 0.1, min_light };
            let mut spec = cloud(&population(&[paint], mixing, 1500));
            (0..3).for_each(|k| spec.covariance[k][k] += variance);
            profile.colour.clouds.push(spec);
        }
        profile.colour.limit = 2.7;
        profile.examine.even = false;
        profile
    }
}

fn of(name: &str, description: String, srgb: &[[u8; 3]]) -> Profile {
    // Two tins of a paint differ, and so do two cameras.
    const TINS: f64 = 10.0;
    let shades: Vec<[u8; 3]> = srgb
        .iter()
        .flat_map(|paint| {
            [[0.0; 3], [1.0, -1.0, 0.0], [-1.0, 1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, -1.0, -1.0]].map(|step: [f64; 3]| {
                std::array::from_fn(|c| (f64::from(paint[c]) + TINS * step[c]).clamp(0.0, 255.0).round() as u8)
            })
        })
        .collect();
    let (most, least) = (srgb[0].iter().max().copied().unwrap_or(0), srgb[0].iter().min().copied().unwrap_or(0));
    // Worn paint without a hue of its own is any ground.
    let has_hue = u32::from(most) - u32::from(least) > 80;
    let states: &[((f64, f64), f64, f64, f64)] = if has_hue {
        &[((0.0, 0.15), 0.15, 0.25, 1.0), ((0.1, 0.4), 0.15, 0.25, 0.36)]
    } else {
        &[((0.0, 0.12), 0.08, 0.7, 1.0)]
    };
    let clouds = states
        .iter()
        .map(|&(fading, max_blur_share, min_light, scale)| {
            let spec = cloud(&population(&shades, Mixing { fading, max_blur_share, min_light }, 6000));
            // Rounded as in a file; a little noise keeps a grey cloud from being flat.
            let round = |v: f64| (v * 100.0).round() / 100.0;
            let mean = spec.mean.map(round);
            let covariance = std::array::from_fn(|r| {
                std::array::from_fn(|c| round(scale * spec.covariance[r][c] + if r == c { 4.0 } else { 0.0 }))
            });
            CloudSpec { mean, covariance }
        })
        .collect();
    Profile {
        name: name.to_owned(),
        description,
        colour: ColourModel { limit: 3.0, clouds, ..ColourModel::default() },
        size: Size { min_px: Some(5.0), max_px: Some(60.0), min_m: None, max_m: None },
        shape: Shape::Any,
        gates: GateLimits::default(),
        filters: Filters::default(),
        examine: Examine { even: !has_hue, ..Examine::default() },
        target: Target::default(),
        tag: None,
        learned: None,
    }
}

/// One fresh paint of each shipped profile, in full sun: of those that `tools/derive_profiles.rs` makes the clouds
/// from, but for orange, which is the benchmark's.
pub(super) const FRESH: [(&str, [u8; 3]); 6] = [
    ("orange", [255, 110, 20]),
    ("pink", [255, 20, 147]),
    ("green", [0, 230, 60]),
    ("yellow", [255, 230, 0]),
    ("blue", [0, 80, 255]),
    ("white-on-dark", [255, 255, 255]),
];

impl Profile {
    /// Whether it is of one paint, with a plain mask, whole regions and fitted centres.
    pub(super) fn is_one_plain_paint(&self) -> bool {
        const MOST_CLOUDS: usize = 8;
        let plain = self.filters == Filters::default() && self.examine.centre == CentreMode::Fit && !self.examine.split;
        let colour = &self.colour;
        let one_paint = colour.clouds.len() <= MOST_CLOUDS && colour.rough.is_none() && colour.rough_box.is_none();
        plain && one_paint && !self.is_target()
    }

    /// The least red, green and blue of this paint in nearly full light, sRGB 0..=255: asked of the bands in which it
    /// is brightest. `None` of profiles whose mask is filtered, whose regions are taken apart, or whose centres are not
    /// fitted, and of any paint at once.
    pub(crate) fn least_in_full_light(&self) -> Option<[u8; 3]> {
        /// Share of the light.
        const LEAST_LIGHT: f64 = 0.86;
        /// Bands that are nearly as bright as the brightest.
        const BRIGHT_BAND: f64 = 0.95;
        if !self.is_one_plain_paint() {
            return None;
        }
        let fresh = self.fresh_paint().map(f64::from);
        let most = fresh.iter().copied().fold(0.0, f64::max);
        Some(fresh.map(|v| if v >= BRIGHT_BAND * most { (LEAST_LIGHT * v).round() as u8 } else { 0 }))
    }

    /// The colour of a new mark of this profile in full sun, sRGB 0..=255: that of a shipped paint, the mean of what
    /// was learned, or the middle of the first cloud.
    pub fn fresh_paint(&self) -> [u8; 3] {
        let byte = |rgb: [f64; 3]| rgb.map(|v| (v.clamp(0.0, 1.0) * 255.0).round() as u8);
        if let Some((_, paint)) = FRESH.iter().find(|(name, _)| *name == self.name) {
            return *paint;
        }
        if let Some(paint) = fresh(&self.name) {
            return paint;
        }
        match (&self.learned, self.colour.clouds.first(), self.colour.space) {
            (Some(learned), _, _) => byte(learned.mean_srgb),
            (None, Some(cloud), Space::Rgb) => byte(cloud.mean),
            (None, Some(cloud), Space::Lab) => byte(super::colour::srgb_from_lab(cloud.mean)),
            (None, None, _) => FRESH[0].1,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::segment::reference::PaintTest;

    #[test]
    fn paints_go_by_number_in_any_writing_and_take_their_own_colours() {
        for name in ["ral-2007", "RAL 2007", "RAL2007", "2007"] {
            assert_eq!(by_name(name).expect(name).name, "ral-2007");
        }
        assert!(by_name("ral-9999").is_none() && by_name("").is_none());
        for paint in &PAINTS {
            let test = PaintTest::new(&by_name(paint.name).expect("listed")).expect("valid");
            for &srgb in paint.srgb {
                assert!(test.is_paint(srgb), "{} {srgb:?}", paint.name);
            }
            assert!(!test.is_paint([110, 100, 85]), "{} takes bare ground", paint.name);
        }
    }

    #[test]
    fn a_colour_makes_a_profile_on_the_spot() {
        let profile = Profile::of_hex("#FFA421").expect("a colour");
        assert_eq!((profile.name.as_str(), profile.validate().is_ok()), ("#FFA421", true));
        assert!(PaintTest::new(&profile).expect("valid").is_paint([255, 164, 33]));
        for bad in ["FFA421", "#FFA42", "#FFA42G", "#ÄÄÄ", ""] {
            assert!(Profile::of_hex(bad).is_none(), "{bad}");
        }
        Profile::any_paint().validate().expect("usable");
    }

    /// Between the hues of the wheel there is no paint that the search over colours does not see.
    #[test]
    fn any_paint_holds_every_hue_bright_and_in_shade() {
        let test = PaintTest::new(&Profile::any_paint()).expect("valid");
        for degrees in (0..360).step_by(3) {
            // Dim yellow and green are left to the plants.
            let dim = if (40..170).contains(&degrees) { (0.95, 0.85) } else { (0.95, 0.6) };
            for (saturation, light) in [(1.0, 1.0), (0.9, 0.95), dim] {
                let sixth = f64::from(degrees) / 60.0;
                let channel = |shift: f64| {
                    let k = (shift + sixth) % 6.0;
                    255.0 * light * (1.0 - saturation * k.min(4.0 - k).clamp(0.0, 1.0))
                };
                let colour = [5.0, 3.0, 1.0].map(|shift| channel(shift).round() as u8);
                assert!(test.is_paint(colour), "hue {degrees}°, {saturation}, {light}: {colour:?}");
            }
        }
        for ground in [[110, 100, 85], [93, 111, 59], [60, 80, 45]] {
            assert!(!test.is_paint(ground), "bare ground and grass: {ground:?}");
        }
    }
}
