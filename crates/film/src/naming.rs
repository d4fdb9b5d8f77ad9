//! Which way round a frame lies: the names of its marks.

use super::constellation::{Naming, namings};
use super::frame::{FindOptions, Finder};
use super::interior::{Pose, distance, refit};
use super::remeasure::{Measured, located};
use super::template::Model;
use autoref_raster::coords::Handedness;

/// Names whose calibrated positions fit worse than the best by no more than this fit as well: errors of certificate and
/// film, micrometres, and of measuring, pixels.
const SAME_UM: f64 = 23.0;
const SAME_PX: f64 = 0.4;

/// Clockwise turn of the frame, and whether it is mirrored.
type Way = (f64, Handedness);

const UPRIGHT: Way = (0.0, Handedness::AsIs);

/// What the naming of a frame's marks leaves to say.
#[derive(Default)]
pub(super) struct Named {
    /// Why the names are doubtful.
    pub doubt: Option<String>,
    /// What is worth knowing but no reason to look.
    pub note: Option<String>,
}

/// Who stands for the way in which a frame is taken to lie.
#[derive(Clone, Copy)]
enum TakenBy {
    /// The camera's file: its scans are upright.
    Camera,
    /// Nobody.
    Chance,
}

impl Named {
    /// Of several ways in which the frame may lie one was taken.
    fn say(&mut self, ways: &[Way], taken: Way, by: TakenBy) {
        let texts: Vec<String> = ways.iter().map(|way| lies(*way)).collect();
        // What was given on the command line does not differ between the ways.
        let turns = ways.iter().any(|way| way.0 != taken.0);
        let mirrors = ways.iter().any(|way| way.1 != taken.1);
        let options = match (turns, mirrors) {
            (true, false) => "--turn",
            (false, true) => "--mirrored",
            _ => "--turn and --mirrored",
        };
        let said =
            format!("the marks do not tell whether the frame is {}; taken as {}", texts.join(" or "), lies(taken));
        let remedy = format!("say {options}");
        match by {
            TakenBy::Camera => {
                self.note = Some(format!("{said}, as the camera's file says; if it lies otherwise, {remedy}"));
            }
            TakenBy::Chance => self.doubt = Some(format!("{said}: {remedy}")),
        }
    }
}

impl Finder {
    /// Whether the camera's file says of its scans that they lie so.
    pub(super) fn is_said_upright(&self, way: Way) -> bool {
        self.camera.upright && way == UPRIGHT
    }

    fn taken_by(&self, way: Way) -> TakenBy {
        if self.is_said_upright(way) { TakenBy::Camera } else { TakenBy::Chance }
    }

    /// Whether all marks are their own mirror images.
    pub(super) fn are_symmetric(&self) -> bool {
        self.models.iter().all(Model::is_symmetric)
    }

    /// Puts the right names to the marks: of all turns of the frame the one whose calibrated positions fit best.
    /// Returns what is doubtful about the names. `rivals` are the ways of lying in which marks that are not their own
    /// mirror images look as good as in the best, best first: among these the positions decide.
    pub(super) fn name_marks(
        &self,
        options: &FindOptions,
        pose: &mut Pose,
        measured: &mut Vec<Option<Measured>>,
        rivals: &[Way],
    ) -> Named {
        let mut named = Named::default();
        // Shapes that are not their own mirror images tell by themselves, unless another way round looks as good.
        let by_shape = !self.are_symmetric();
        if by_shape && rivals.len() <= 1 {
            return named;
        }
        // Names need places that are right to some pixels only.
        let sound = located(&self.film, measured, |m| m.reason.is_none());
        let places = if sound.len() >= 3 { sound } else { located(&self.film, measured, |_| true) };
        let mut allowed = self.orientations(options);
        allowed.retain(|way| !by_shape || rivals.contains(way));
        let alike = |a: usize, b: usize| by_shape || self.class[a] == self.class[b];
        let all = namings(&self.film, self.centre, &places, pose, &allowed, alike);
        let Some(best) = all.first() else {
            // Of two places any way is as good.
            if by_shape {
                named.say(rivals, rivals[0], self.taken_by(rivals[0]));
            }
            return named;
        };
        // The usual orientation wins among those that fit as well.
        let same_px = (SAME_UM / 1e3 * pose.px_per_mm()).hypot(SAME_PX);
        let as_good: Vec<&Naming> =
            all.iter().filter(|n| n.leaves_out == best.leaves_out && n.rms_px < best.rms_px + same_px).collect();
        let taken = allowed
            .iter()
            .find_map(|(t, m)| as_good.iter().find(|n| n.turn_deg == *t && n.mirrored == *m))
            .copied()
            .unwrap_or(best)
            .clone();
        if as_good.len() > 1 {
            let ways: Vec<Way> = as_good.iter().map(|n| (n.turn_deg, n.mirrored)).collect();
            let way = (taken.turn_deg, taken.mirrored);
            named.say(&ways, way, self.taken_by(way));
        }
        if let (Some(turn_deg), None, true) = (options.turn_deg, options.mirrored, taken.mirrored.is_mirrored()) {
            let ways = [0.0, 90.0, 180.0, 270.0].map(|turn| (turn, Handedness::AsIs));
            let others = namings(&self.film, self.centre, &places, pose, &ways, alike);
            let forced = forced_mirror(turn_deg, &taken, &others, same_px, 1e3 / pose.px_per_mm());
            named.doubt = forced.or(named.doubt);
        }
        let before = std::mem::replace(measured, vec![None; self.film.len()]);
        let from: Vec<usize> = places.iter().map(|p| p.0).collect();
        // Places that took no part in the naming follow it through the pose it gives.
        let points: Vec<_> = taken.names.iter().zip(&places).map(|(n, (_, p))| (self.film[*n], *p)).collect();
        if let Some(next) = refit(&points, &Pose { mirrored: taken.mirrored, ..*pose }) {
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
}

/// Why a frame is doubtful that is mirrored only because its turn was given: one of `others`, unmirrored and best
/// first, fits as well.
fn forced_mirror(turn_deg: f64, taken: &Naming, others: &[Naming], same_px: f64, um_per_px: f64) -> Option<String> {
    let other = others.first()?;
    let fits = match (other.leaves_out, taken.leaves_out) {
        (true, false) => false,
        (false, true) => true,
        _ => other.rms_px < taken.rms_px + same_px,
    };
    fits.then(|| {
        format!(
            "as --turn {turn_deg:.0} says, the film is mirrored; without it: turned by {:.0}°, not mirrored, RMSE {:.1} µm \
             against {:.1} µm; say --mirrored if it is, else --turn {:.0}",
            other.turn_deg,
            other.rms_px * um_per_px,
            taken.rms_px * um_per_px,
            other.turn_deg
        )
    })
}

fn lies((turn_deg, mirrored): Way) -> String {
    let mirrored = if mirrored.is_mirrored() { ", mirrored" } else { "" };
    format!("turned by {turn_deg:.0}°{mirrored}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::load_camera;
    use autoref_raster::coords::PixelPoint;

    #[test]
    fn a_turn_that_forces_a_mirroring_is_doubted_where_another_turn_fits() {
        let camera = load_camera("svalbard-zeiss-1936").expect("built in");
        let (film, centre) = (camera.film_points(), camera.film_centre());
        let middle = PixelPoint { x: 4800.0, y: 4700.0 };
        let ways = [0.0, 90.0, 180.0, 270.0].map(|turn| (turn, Handedness::AsIs));
        let doubt = |lies: Way| {
            let pose = Pose::about(centre, middle, 40.0, lies.0, lies.1);
            let places: Vec<_> = film.iter().map(|mm| pose.apply(*mm)).enumerate().collect();
            let named = |ways: &[Way]| namings(&film, centre, &places, &pose, ways, |_, _| true);
            let taken = named(&[(0.0, Handedness::Mirrored)]).remove(0);
            forced_mirror(0.0, &taken, &named(&ways), 0.1, 25.0)
        };
        let said = doubt((180.0, Handedness::AsIs)).expect("turned by 180° it fits exactly");
        assert!(said.contains("--turn 0 says") && said.contains("turned by 180°, not mirrored, RMSE 0.0 µm"), "{said}");
        assert_eq!(doubt((0.0, Handedness::Mirrored)), None, "mirrored in truth");
    }

    #[test]
    fn the_remedy_is_what_is_still_open() {
        let upright = (0.0, Handedness::AsIs);
        for (other, remedy) in [
            ((90.0, Handedness::AsIs), "say --turn"),
            ((0.0, Handedness::Mirrored), "say --mirrored"),
            ((180.0, Handedness::Mirrored), "say --turn and --mirrored"),
        ] {
            let mut named = Named::default();
            named.say(&[upright, other], upright, TakenBy::Chance);
            assert!(named.doubt.as_ref().is_some_and(|said| said.ends_with(remedy)), "{:?}", named.doubt);
            named.say(&[upright, other], upright, TakenBy::Camera);
            assert!(named.note.as_ref().is_some_and(|said| said.ends_with(remedy)), "{:?}", named.note);
        }
    }
}
