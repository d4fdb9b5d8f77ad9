//! Is what was found this camera's frame at all? Marks that agree with each other may be specks, or another camera's
//! marks: they must not agree by chance, and the size of a pixel that they give must be one that the scan can have.

use super::constellation::Assembly;
use super::frame::{FindOptions, Finder};
use super::interior::Pose;
use super::remeasure::Measured;
use super::resolution::Resolution;
use super::types::{FrameResult, FrameStatus, InteriorModel, InteriorOrientation, MarkStatus};
use autoref_raster::ranks::median;

/// Assemblies by chance above which a frame is looked at by a person.
const MOST_CHANCE: f64 = 2e-3;
/// By how much the size of a pixel may differ from a stated one: told, and looked at.
const TOLD: f64 = 0.005;
const ASTRAY: f64 = 0.04;
/// By how much from one that a person gave: axes of scanners differ by up to 2.3 %, half of which is in the mean.
const GIVEN_ASTRAY: f64 = 0.02;
/// A file's resolution further off than this many times says nothing of the scan.
const NONSENSE: f64 = 3.0;
/// What a scan may show of the film's width and height at all, where nothing else tells its scale.
const SHOWN: std::ops::Range<f64> = 0.85..1.25;
/// What one of the two must be for the film to tell the scale: up to so many millimetres cut off or of the scanner's
/// glass beside it. Marks of another size of camera that lie alike (113.0 and 108.6 mm are 4 % apart) then show 10 mm
/// too much or too little.
const CUT_MM: f64 = 2.0;
const GLASS_MM: f64 = 9.0;
/// Differences of scale between the axes that are told: film alone shrinks unevenly by a tenth of a per cent.
const TOLD_STRETCH: f64 = 0.003;

/// Of marks of lines that are another camera's: the share of their pixels and of those around them that do not fit, and
/// what they correlate at most. Right ones of drawn frames stay below 0.5 in the median, in front of bright ground too,
/// or correlate better where only the file's lengths are off by a third.
const MOST_MISFIT: f64 = 0.5;
const HARDLY: f64 = 0.87;
/// Where a pixel scatters by more of a mark's contrast, its four standard deviations nearly reach from the frame to the
/// mark: no pixel stands out, and none fits, whatever the form.
const MOST_NOISE: f64 = 0.2;

/// What speaks against a frame as a whole, and what is worth knowing of it.
#[derive(Default)]
struct Said {
    doubts: Vec<String>,
    notes: Vec<String>,
}

impl Finder {
    /// Adds to `result` what speaks against it as a whole, and what is worth knowing of its scale.
    pub(super) fn doubt_whole(
        &self,
        options: &FindOptions,
        stated: Option<Resolution>,
        assembly: &Assembly,
        result: &mut FrameResult,
    ) {
        let Some(interior) = &result.interior else { return };
        let mut said = Said::default();
        if assembly.chance > MOST_CHANCE {
            let turned_deg = (interior.rotation_deg / 90.0).round().rem_euclid(4.0) * 90.0;
            let is_open = !self.is_said_upright((turned_deg, interior.mirrored));
            let unsaid = [
                (options.pixel_um.is_none(), "say --pixel-um"),
                (is_open && options.turn_deg.is_none(), "say --turn"),
                (is_open && options.mirrored.is_none(), "say --mirrored"),
            ];
            // One alone may not suffice: each divides the number of places or of ways to lie.
            let ways = unsaid.into_iter().filter(|(open, _)| *open).map(|(_, way)| way);
            let ways = ways.chain(["take a smaller --box-share, or several of these"]);
            said.doubts.push(format!(
                "so many places look like marks that {} of them would agree as well by chance; {}",
                interior.marks.len(),
                ways.collect::<Vec<_>>().join(", ")
            ));
        }
        let by_file =
            stated.map(|r| (r, r.pixel_um())).filter(|(_, um)| off(interior.pixel_um, *um).abs() < NONSENSE.ln());
        said.against_stated_scale(interior.pixel_um, options.pixel_um, by_file);
        if let Some(resolution) = stated.filter(|_| by_file.is_none()) {
            said.notes.push(format!("the file's resolution ({:.0} dpi) is not that of the scan", resolution.0[0]));
        }
        let no_scale = by_file.is_none_or(|(r, um)| r.is_usual_default() && off(interior.pixel_um, um).abs() > ASTRAY);
        if options.pixel_um.is_none() && no_scale {
            said.doubts.extend(self.doubt_of_size(interior, [result.width as f64, result.height as f64]));
        }
        said.notes.extend(note_of_axes(interior));
        said.tell(result);
    }

    /// Why the marks show another size of film than the camera's, where nothing but them tells the scale.
    fn doubt_of_size(&self, interior: &InteriorOrientation, [width, height]: [f64; 2]) -> Option<String> {
        let turned = (interior.rotation_deg / 90.0).round() as i64 % 2 != 0;
        let [w, h] = self.camera.film_size_mm;
        let film = if turned { [h, w] } else { [w, h] };
        // Film that lies aslant takes more room; a scan may show all of that, or be cut to the film's size.
        let aslant_deg = interior.rotation_deg - 90.0 * (interior.rotation_deg / 90.0).round();
        let (s, c) = aslant_deg.abs().to_radians().sin_cos();
        let room = [film[0] * c + film[1] * s, film[1] * c + film[0] * s];
        let [px, py] = interior.pixel_xy_um;
        let shown = [width * px / 1e3, height * py / 1e3];
        let whole = |k: usize| (film[k] - CUT_MM..room[k] + GLASS_MM).contains(&shown[k]);
        let hardly = |k: usize| (SHOWN.start * film[k]..SHOWN.end * room[k]).contains(&shown[k]);
        let says = format!(
            "by the marks the scan shows {:.1} x {:.1} mm, the camera's film is {:.0} x {:.0} mm",
            shown[0], shown[1], film[0], film[1]
        );
        let pixel_um = interior.pixel_um;
        if !(0..2).all(hardly) {
            return Some(format!("{says}: if that is right, say --pixel-um {pixel_um:.1}"));
        }
        (!(0..2).any(whole)).then(|| {
            format!(
                "{says}, and no resolution tells the scale: a camera of another size whose marks lie alike would fit as well; if \
                 this one is right, say --pixel-um {pixel_um:.1}"
            )
        })
    }

    /// More than this a fit may not leave, whatever agrees: micrometres.
    pub(super) fn most_rmse_um(&self, options: &FindOptions, pose: &Pose) -> f64 {
        options.agreement_um + RMSE_PX * 1e3 / pose.px_per_mm()
    }
}

/// Why what is seen at the marks of lines is not what the camera's marks look like: marks of another camera can lie
/// alike, and a part of each (the crossing of a cross) resembles a smaller mark. Dust and scratches spoil some marks of
/// a frame; where half of them neither fit nor correlate, it is their form.
pub(super) fn doubt_of_shape(measured: &[Option<Measured>], used: &[usize]) -> Option<String> {
    let of_lines: Vec<&Measured> =
        used.iter().filter_map(|k| measured[*k].as_ref()).filter(|m| m.misfit.is_some()).collect();
    if of_lines.is_empty() {
        return None;
    }
    let middle = |of: fn(&Measured) -> Option<f64>| median(of_lines.iter().filter_map(|m| of(m)).collect());
    let (misfit, score) = (middle(|m| m.misfit), middle(|m| Some(m.score)));
    let noise = of_lines.iter().any(|m| m.noise.is_some()).then(|| middle(|m| m.noise)).filter(|n| *n > MOST_NOISE);
    let noise = noise.map_or(String::new(), |noise| {
        format!("noise or grain hides them (a pixel scatters by {:.0} % of their contrast), ", 100.0 * noise)
    });
    (misfit > MOST_MISFIT && score < HARDLY).then(|| {
        format!(
            "what is seen at the marks does not look like them (correlation {score:.2}): {noise}another camera's frame, \
             or the lengths of the marks in the camera's file are wrong; correct them, or teach the marks with --learn"
        )
    })
}

/// How far one size of a pixel is from another, logarithmically.
fn off(pixel_um: f64, other: f64) -> f64 {
    (pixel_um / other).ln()
}

impl Said {
    /// Compares the size of a pixel by the marks with that of the command line, or else of the file.
    fn against_stated_scale(&mut self, pixel_um: f64, given: Option<f64>, by_file: Option<(Resolution, f64)>) {
        let told = |what: String, other: f64| {
            format!(
                "by the marks a pixel is {pixel_um:.2} µm, by {what} {other:.2} µm ({:+.1} %)",
                100.0 * (pixel_um / other - 1.0)
            )
        };
        if let Some(given) = given {
            let (text, off) = (told("--pixel-um".into(), given), off(pixel_um, given).abs());
            if off > GIVEN_ASTRAY {
                self.doubts.push(format!("{text}: this is the camera only if --pixel-um is wrong by that much"));
            } else if off > TOLD {
                self.notes.push(text);
            }
        } else if let Some((resolution, um)) = by_file {
            let text = told(format!("the file's resolution ({:.0} dpi)", resolution.0[0]), um);
            let off = off(pixel_um, um).abs();
            if off > ASTRAY && !resolution.is_usual_default() {
                self.doubts.push(format!("{text}: if the marks are right, say --pixel-um {pixel_um:.1}"));
            } else if off > TOLD {
                self.notes.push(text);
            }
        }
    }

    /// Puts it into the result: with a doubt the frame and all its marks are doubtful.
    fn tell(self, result: &mut FrameResult) {
        result.notes.extend(self.notes);
        if self.doubts.is_empty() {
            return;
        }
        match &mut result.status {
            FrameStatus::Doubtful { reasons } | FrameStatus::Failed { reasons } => reasons.extend(self.doubts),
            status @ FrameStatus::Ok => *status = FrameStatus::Doubtful { reasons: self.doubts },
        }
        for mark in result.marks.iter_mut().filter(|m| m.status == MarkStatus::Ok) {
            mark.status = MarkStatus::Doubtful;
            mark.reason = Some("its frame as a whole is in doubt".to_owned());
        }
    }
}

/// That the axes of the scan differ in scale, where the model lets them.
fn note_of_axes(interior: &InteriorOrientation) -> Option<String> {
    let [x, y] = interior.pixel_xy_um;
    (interior.model != InteriorModel::Similarity && (x / y).ln().abs() > TOLD_STRETCH).then(|| {
        format!("the scan's axes differ in scale by {:.2} %: a pixel is {x:.3} x {y:.3} µm", 100.0 * (x / y - 1.0))
    })
}

/// Pixels of root mean square that measuring may leave beside what film does.
const RMSE_PX: f64 = 0.3;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drawn::{FilmGround, FilmScene, FilmSpec, write_film};
    use crate::types::{Camera, MarkKind};
    use crate::{find_frame, load_camera};
    use autoref_raster::coords::{Handedness, PixelPoint};

    fn measured(misfit: f64, score: f64) -> Option<Measured> {
        let centre = PixelPoint { x: 0.0, y: 0.0 };
        Some(Measured {
            centre,
            covariance_px2: None,
            score,
            misfit: Some(misfit),
            noise: Some(0.05),
            body: None,
            reason: None,
        })
    }

    /// Film that lies aslant takes more room in its scan, however its marks are turned.
    #[test]
    fn film_that_lies_aslant_shows_its_own_size() {
        let finder = Finder::new(&load_camera("rmk-dot").expect("built in")).expect("a finder");
        let side_mm = finder.camera.film_size_mm[0];
        let doubted = |rotation_deg: f64, shown_mm: f64| {
            let interior = InteriorOrientation {
                model: InteriorModel::Similarity,
                pixel_to_mm: [0.05, 0.0, 0.0, 0.0, 0.05, 0.0, 0.0, 0.0, 1.0],
                rmse_um: 1.0,
                sigma0_um: None,
                covariance: vec![],
                marks: vec![],
                leave_one_out_um: vec![],
                leave_one_out_rmse_um: None,
                pixel_um: 50.0,
                pixel_xy_um: [50.0; 2],
                rotation_deg,
                mirrored: Handedness::AsIs,
            };
            finder.doubt_of_size(&interior, [shown_mm * 20.0; 2]).is_some()
        };
        let room = |deg: f64| side_mm * (deg.to_radians().cos() + deg.to_radians().sin());
        for deg in [3.0, 5.0, 7.0] {
            assert!(!doubted(deg, room(deg) + 4.0) && !doubted(90.0 - deg, room(deg) + 4.0), "turned by {deg}");
            assert!(!doubted(deg, side_mm), "cut to the film's size");
            assert!(doubted(deg, room(deg) + 12.0), "too large");
        }
        assert!(doubted(0.0, room(5.0) + 4.0) && doubted(5.0, side_mm - 4.0));
    }

    /// A speck in front of one mark, or lengths that are a fifth off, are no other camera's marks.
    #[test]
    fn the_form_of_most_marks_counts_where_it_neither_fits_nor_correlates() {
        let of = |all: &[(f64, f64)]| {
            let all: Vec<_> = all.iter().map(|(misfit, score)| measured(*misfit, *score)).collect();
            doubt_of_shape(&all, &(0..all.len()).collect::<Vec<_>>()).is_some()
        };
        assert!(of(&[(0.7, 0.80), (0.6, 0.79), (0.8, 0.78), (1.0, 0.80)]));
        assert!(!of(&[(0.7, 0.80), (0.0, 0.97), (0.0, 0.96), (0.1, 0.95)]), "one is under a speck");
        assert!(!of(&[(0.6, 0.94), (0.66, 0.95), (0.6, 0.94), (0.7, 0.95)]), "larger than drawn");
        assert!(!of(&[(0.03, 0.60), (0.02, 0.61), (0.03, 0.60), (0.03, 0.62)]), "a soft scan");
        assert!(doubt_of_shape(&[None], &[0]).is_none());
    }

    #[test]
    fn noise_is_named_where_it_may_be_the_cause() {
        let said = |noise: f64| {
            let all = [(1.0, 0.56), (0.9, 0.55), (1.0, 0.57)]
                .map(|(misfit, score)| measured(misfit, score).map(|m| Measured { noise: Some(noise), ..m }));
            doubt_of_shape(&all, &[0, 1, 2]).expect("nothing fits")
        };
        assert!(said(0.31).contains("noise or grain hides them (a pixel scatters by 31 % of their contrast), another"));
        assert!(!said(0.05).contains("noise"));
    }

    /// The crossings of thin crosses look like dots, and lie where the dots of another camera would.
    #[test]
    fn crossings_are_no_dots() {
        let dots = load_camera("rmk-dot").expect("built in");
        let with = |kind: MarkKind| {
            let mut camera: Camera = dots.clone();
            camera.marks.iter_mut().for_each(|m| m.kind = kind.clone());
            camera
        };
        let crosses = with(MarkKind::Cross { arm_mm: 1.3, line_mm: 0.09, gap_mm: 0.0, lines_deg: 0.0 });
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("f.tif");
        let spec = FilmSpec::plain(&crosses, 60.0, 3);
        write_film(&FilmScene::new(&spec, &FilmGround::Noise).expect("a scene"), &path, 512).expect("written");
        let options = FindOptions {
            pixel_um: Some(60.0),
            turn_deg: Some(0.0),
            mirrored: Some(Handedness::AsIs),
            ..FindOptions::default()
        };
        let look = |camera: &Camera| find_frame(&Finder::new(camera).expect("a finder"), &path, &options).status;
        assert_eq!(look(&crosses), FrameStatus::Ok);
        let FrameStatus::Doubtful { reasons } = look(&dots) else { panic!("{:?}", look(&dots)) };
        assert!(reasons.iter().any(|r| r.contains("does not look like them")), "{reasons:?}");
    }
}
