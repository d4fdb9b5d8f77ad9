//! The shipped profiles, compiled in from `builtin/`, and those of the paints of colour cards.

use super::Profile;
use super::paint::{self, RIM_OF_WHITE_SIDES, RIM_SIDES};

/// A file of `builtin/`.
struct Shipped {
    name: &'static str,
    text: &'static str,
    /// Width of the dark rim that its marks need on ground which passes for its paint, sides of the mark; `None` where
    /// nothing is painted by it.
    rim_sides: Option<f64>,
}

macro_rules! builtins {
    ($($rim:expr => [$($name:literal),* $(,)?]),* $(,)?) => {
        const BUILTIN: &[Shipped] = &[$($(
            Shipped { name: $name, text: include_str!(concat!("builtin/", $name, ".toml")), rim_sides: $rim }
        ),*),*];
    };
}
builtins!(
    Some(RIM_SIDES) => ["orange", "pink", "green", "yellow", "blue"],
    Some(RIM_OF_WHITE_SIDES) => ["white-on-dark"],
    // Targets are found by shape, whatever their colour.
    None => [
        "black-white-checker",
        "black-white-hourglass",
        "black-white-cross",
        "apriltag-36h11",
        "apriltag-16h5",
        "aruco-4x4-50",
        "aruco-4x4-100",
        "aruco-6x6-250",
        "aruco-mip-36h12",
    ],
    // The prototype's, kept for comparison, not for painting.
    None => ["lerkendal-2016", "autoref-2016"],
);

impl Profile {
    /// Names of the shipped profiles, the default first.
    pub fn names() -> Vec<&'static str> {
        BUILTIN.iter().map(|shipped| shipped.name).chain(paint::names()).collect()
    }

    /// A shipped profile.
    pub fn builtin(name: &str) -> Option<Profile> {
        BUILTIN.iter().find(|shipped| shipped.name == name).map(Shipped::profile).or_else(|| paint::by_name(name))
    }

    /// The shipped profiles that marks are painted by, each with the width of the dark rim that they need on ground
    /// which passes for the paint, in sides of the mark.
    pub(crate) fn of_paints() -> Vec<(Profile, f64)> {
        let built_in = BUILTIN.iter().filter_map(|shipped| Some((shipped.profile(), shipped.rim_sides?)));
        built_in.chain(paint::all()).collect()
    }
}

impl Shipped {
    fn profile(&self) -> Profile {
        toml::from_str(self.text).expect("a test parses every shipped profile")
    }
}

/// Names of the shipped profiles that this build can look for: coded targets need the feature `coded`.
pub(super) fn usable_names() -> Vec<&'static str> {
    let is_usable =
        |name: &&str| cfg!(feature = "coded") || Profile::builtin(name).is_none_or(|profile| profile.tag.is_none());
    Profile::names().into_iter().filter(is_usable).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_painted_by_is_no_target_and_none_of_the_prototypes() {
        let painted = Profile::of_paints();
        let expected = Profile::names().into_iter().filter(|name| {
            !name.ends_with("-2016") && !Profile::builtin(name).expect("names lists what is there").is_target()
        });
        assert!(painted.iter().map(|(profile, _)| profile.name.as_str()).eq(expected));
        assert!(painted.iter().all(|(profile, rim)| (*rim == 1.0) == profile.name.starts_with("white")));
    }
}
