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
        self.size.is_some() || self.rule.is_some()
    }

    /// Another paint's profile with size and rules.
    pub(super) fn of(&self, profile: Profile) -> Profile {
        let size = self.size.unwrap_or(profile.size);
        Profile { size, ..self.ruled(profile) }
    }

    /// A profile with the rules; its size is known better.
    pub(super) fn ruled(&self, mut profile: Profile) -> Profile {
        if let Some(asked) = &self.rule {
            profile.gates.rule = Some(match profile.gates.rule.take() {
                Some(own) => own.and(asked.clone()),
                None => asked.clone(),
            });
        }
        profile
    }
}
