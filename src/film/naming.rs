//! Which way round a frame lies: the names of its marks.

use super::constellation::{Naming, namings};
use super::frame::{FindOptions, Finder};
use super::inner::{Pose, distance, fit_pose};
use super::look::{Measured, located};
use super::template::Model;
use crate::coords::PixelPoint;

/// What the naming of a frame's marks leaves to say.
#[derive(Default)]
pub(super) struct Named {
    /// Why the names are doubtful.
    pub doubt: Option<String>,
    /// What is worth knowing but no reason to look.
    pub note: Option<String>,
}

impl Finder {
    /// Puts the right names to the marks: of all turns of the frame the one whose calibrated positions fit best. Returns
    /// why the names are doubtful, when they are.
    pub(super) fn name_marks(
        &self,
        options: &FindOptions,
        pose: &mut Pose,
        measured: &mut Vec<Option<Measured>>,
    ) -> Named {
        let mut named = Named::default();
        if !self.models.iter().all(Model::is_symmetric) {
            return named;
        }
        // Names need places that are right to some pixels only.
        let sound = located(&self.film, measured, |m| m.reason.is_none());
        let places = if sound.len() >= 3 { sound } else { located(&self.film, measured, |_| true) };
        let allowed = self.orientations(options);
        let all = namings(&self.film, self.centre, &places, pose, &allowed, |a, b| self.class[a] == self.class[b]);
        let Some(best) = all.first() else { return named };
        // The usual orientation wins among those that fit as well.
        let as_good: Vec<&Naming> = all.iter().filter(|n| n.rms_px < best.rms_px + 1.2).collect();
        let taken = allowed
            .iter()
            .find_map(|(t, m)| as_good.iter().find(|n| n.turn_deg == *t && n.mirrored == *m))
            .copied()
            .unwrap_or(best)
            .clone();
        if as_good.len() > 1 {
            let said = "the marks' positions do not tell how the frame is turned";
            if self.tells_turns(pose) {
                named.doubt = Some(format!("{said}; taken as {}", orientation_text(&taken)));
            } else {
                named.note = Some(format!("{said} with this camera; taken as {}", orientation_text(&taken)));
            }
        }
        let before = std::mem::replace(measured, vec![None; self.film.len()]);
        let from: Vec<usize> = places.iter().map(|p| p.0).collect();
        // Places that took no part in the naming follow it through the pose it gives.
        let points: Vec<_> = taken.names.iter().zip(&places).map(|(n, (_, p))| (self.film[*n], *p)).collect();
        if let Some(next) = fit_pose(&points, taken.mirrored) {
            *pose = next;
        }
        for (k, m) in before.into_iter().enumerate() {
            let Some(m) = m else { continue };
            let name = match from.iter().position(|f| *f == k) {
                Some(i) => Some(taken.names[i]),
                None => (0..self.film.len()).min_by(|&a, &b| {
                    let d = |j: usize| distance(pose.apply(self.film[j]), m.centre);
                    d(a).total_cmp(&d(b))
                }),
            };
            if let Some(slot) = name.map(|n| &mut measured[n])
                && slot.is_none()
            {
                *slot = Some(m);
            }
        }
        named
    }

    /// Whether the calibrated positions are far enough from symmetric for a scan of this scale.
    fn tells_turns(&self, pose: &Pose) -> bool {
        let places: Vec<(usize, PixelPoint)> =
            self.film.iter().enumerate().map(|(k, mm)| (k, pose.apply(*mm))).collect();
        let allowed: Vec<(f64, bool)> =
            [0.0, 90.0, 180.0, 270.0].iter().flat_map(|t| [(*t, false), (*t, true)]).collect();
        let all = namings(&self.film, self.centre, &places, pose, &allowed, |a, b| self.class[a] == self.class[b]);
        all.get(1).is_none_or(|second| second.rms_px > 3.0)
    }
}

fn orientation_text(naming: &Naming) -> String {
    let mirrored = if naming.mirrored { ", mirrored" } else { "" };
    format!("turned by {:.0}°{mirrored}", naming.turn_deg)
}
