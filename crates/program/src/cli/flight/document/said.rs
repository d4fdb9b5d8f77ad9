//! The essence of a document on standard error.

use super::block::{BlunderBy, CamerasDocument};
use super::resected::{PixelResidual, ResectionDocument};

fn fixed(value: impl Into<Option<f64>>, digits: usize) -> String {
    value.into().filter(|v| v.is_finite()).map_or("-".into(), |v| format!("{v:.digits$}"))
}

fn several(values: &[f64], digits: usize) -> String {
    values.iter().map(|v| fixed(*v, digits)).collect::<Vec<_>>().join(", ")
}

/// Notes that were not said `already`.
fn say_notes(notes: &[String], already: &[String]) {
    for note in notes.iter().filter(|note| !already.contains(note)) {
        eprintln!("note: {note}");
    }
}

impl CamerasDocument {
    /// Without the notes that were said `already`.
    pub fn say(&self, already: &[String]) {
        let points = match self.gcps.len() + self.check_points.len() {
            0 => "no GCPs".into(),
            _ => format!(
                "GCPs {} m rms; check points {} m rms; {} blunders",
                fixed(self.gcp_statistics.map(|s| s.d.rms), 2),
                fixed(self.check_point_statistics.map(|s| s.d.rms), 2),
                self.blunders.len()
            ),
        };
        eprintln!(
            "{} of {} frames; ties {} px rms; {points}",
            self.frames_registered,
            self.frames_listed,
            fixed(self.reprojection_rms_px, 2),
        );
        for b in &self.blunders {
            let (gcp, test) = (&b.gcp, fixed(b.test, 1));
            let frame = b.frame.as_deref().unwrap_or_default();
            match &b.by {
                BlunderBy::Pixels(None) => eprintln!("blunder: GCP {gcp} in {frame}: the camera looks away from it"),
                BlunderBy::Pixels(Some(by_px)) => {
                    eprintln!("blunder: GCP {gcp} in {frame} by ({}) px, {test} sigma", several(by_px, 1));
                }
                BlunderBy::Metres(by_m) => {
                    eprintln!("blunder: GCP {gcp} on the ground by ({}) m, {test} sigma", several(by_m, 2));
                }
            }
        }
        say_notes(&self.notes, already);
    }
}

impl ResectionDocument {
    /// Without the notes that were said `already`.
    pub fn say(&self, already: &[String]) {
        let camera = &self.camera;
        let sigmas = camera.deviations.as_ref().map(|d| [d.sigma_e, d.sigma_n, d.sigma_h]);
        eprintln!(
            "{}: C ({}) ± ({}) yaw {} pitch {} roll {} f {} px; rms {} px",
            camera.name,
            several(&camera.centre, 3),
            [0, 1, 2].map(|i| fixed(sigmas.map(|s| s[i]), 3)).join(", "),
            fixed(camera.yaw_deg, 3),
            fixed(camera.pitch_deg, 3),
            fixed(camera.roll_deg, 3),
            fixed(camera.interior.f_px, 1),
            fixed(self.rms_px, 2),
        );
        for g in &self.gcps {
            let word = if g.blunder { "  BLUNDER" } else { "" };
            eprintln!("{}{word}", g.point.words());
        }
        for c in &self.check_points {
            eprintln!("{}  check", c.words());
        }
        for other in &self.alternatives {
            let [yaw, pitch, roll] = [other.yaw_deg, other.pitch_deg, other.roll_deg].map(|a| fixed(a, 3));
            eprintln!("  or: C ({}) yaw {yaw} pitch {pitch} roll {roll}", several(&other.centre, 3));
        }
        say_notes(&self.notes, already);
    }
}

impl PixelResidual {
    fn words(&self) -> String {
        let by = self.residual_px.map_or(String::new(), |r| several(&r, 1));
        format!("  {}: ({by}) px, {} px", self.name, fixed(self.d_px, 1))
    }
}
