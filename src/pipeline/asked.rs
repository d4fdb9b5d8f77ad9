//! What the user said of the marks, whatever their paint: it holds at every look at the image.

use crate::profile::{Profile, Rule, Size};

/// Colours are learned and searched for; size and rules are the user's word.
#[derive(Clone, Debug, Default)]
pub struct Asked {
    pub size: Option<Size>,
    pub rule: Option<Rule>,
    /// Ground size of a pixel, metres; needed for a size in metres.
    pub gsd_m: Option<f64>,
    /// The options as they were given, such as `--mark-size 30..50px`.
    pub options: Vec<String>,
}

impl Asked {
    pub(super) fn is_something(&self) -> bool {
        self.size.is_some() || self.rule.as_ref().is_some_and(|rule| !rule.asks_of_colour())
    }

    /// Another paint's profile with size and rules.
    pub(super) fn of(&self, profile: Profile) -> Profile {
        let size = self.size.unwrap_or(profile.size);
        Profile { size, ..self.ruled(profile) }
    }

    /// A profile with the rules, but for those that ask of another paint's colour; its size is known better.
    pub(super) fn ruled(&self, mut profile: Profile) -> Profile {
        if let Some(asked) = self.rule.as_ref().filter(|rule| !rule.asks_of_colour()) {
            profile.gates.rule = Some(match profile.gates.rule.take() {
                Some(own) => own.and(asked.clone()),
                None => asked.clone(),
            });
        }
        profile
    }
}
