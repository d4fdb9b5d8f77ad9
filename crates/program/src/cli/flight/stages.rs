//! What each stage of a flight found: a JSON document and a page for each, and a table of contents.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use anyhow::Result;
use autoref_flight::Error;
use autoref_flight::adjust::{GroundPoint, OnGround, Role};
use autoref_flight::read::Reconstruction;
use autoref_flight::statistics::Residuals;
use autoref_flight::world::World;
use autoref_raster::atomic;
use serde_json::{Value, json};

use super::document::{in_map, list, number};
use super::project::Focal;
use super::relative::{Flight, Matched, Oriented};
use super::runs::Plan;
use super::stage::Stage;
use super::stage_pages;
use super::ties::{PairTies, Ties};
use super::views::Grey;

/// Whether there is another stage to work.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum After {
    GoesOn,
    Ends,
}

/// Longest side of a frame's picture in the pages.
const PICTURE_PX: usize = 240;

/// Where stages are written down: `stages/NAME.json` and `stages/NAME.html`, `stages/index.html`, and small pictures of
/// the frames in `stages/frames`.
pub struct Record {
    folder: PathBuf,
    title: String,
    until: Stage,
}

impl Record {
    pub fn new(out: &Path, title: String, until: Stage) -> Result<Self> {
        let folder = out.join("stages");
        let frames = folder.join("frames");
        std::fs::create_dir_all(&frames).map_err(|e| Error::io(&frames, "create", e))?;
        Ok(Record { folder, title, until })
    }

    pub fn title(&self) -> &str {
        &self.title
    }

    /// Keeps a small picture of a frame.
    pub fn picture(&self, name: &str, grey: &Grey) -> Result<()> {
        grey.smaller(PICTURE_PX).write(&self.folder.join("frames").join(format!("{name}.png")))
    }

    /// Width and height of the pictures, and their pixels per pixel of a frame.
    pub fn pictures(&self, frame_px: [f64; 2]) -> stage_pages::Pictures {
        stage_pages::Pictures::of(frame_px, PICTURE_PX)
    }

    /// The page of a stage, or of the whole flight.
    pub fn page(&self, stage: Stage) -> PathBuf {
        match stage {
            Stage::Cameras => self.folder.with_file_name("flight.html"),
            _ => self.folder.join(format!("{}.html", stage.name())),
        }
    }

    /// Writes down what a stage found; `body` is what its page shows.
    pub fn put(&self, stage: Stage, found: &Value, body: &str) -> Result<After> {
        let name = stage.name();
        let text = serde_json::to_string_pretty(found)? + "\n";
        atomic::write(&self.folder.join(format!("{name}.json")), text.as_bytes())?;
        let before = Stage::ALL.iter().rfind(|s| **s < stage).map(|s| s.name());
        let page = stage_pages::whole(&self.title, name, before, body);
        atomic::write(&self.page(stage), page.as_bytes())?;
        self.contents(stage)?;
        Ok(if stage == self.until { After::Ends } else { After::GoesOn })
    }

    /// The table of contents: what every stage up to the last that was worked says in one line. What an older run left
    /// of later ones is of other inputs, perhaps.
    pub fn contents(&self, last: Stage) -> Result<()> {
        let mut rows = String::new();
        for (number, stage) in Stage::ALL.iter().enumerate() {
            let document = match stage {
                Stage::Cameras => self.folder.with_file_name("cameras.json"),
                _ => self.folder.join(format!("{}.json", stage.name())),
            };
            let link =
                if *stage == Stage::Cameras { "../flight.html".into() } else { format!("{}.html", stage.name()) };
            let text = if *stage <= last { std::fs::read_to_string(&document).ok() } else { None };
            let found: Option<Value> = text.and_then(|text| serde_json::from_str(&text).ok());
            let _ = match found {
                Some(found) => write!(
                    rows,
                    "<tr><td>{}</td><td><a href=\"{link}\">{}</a></td><td>{}</td></tr>",
                    number + 1,
                    stage.name(),
                    stage_pages::line(*stage, &found)
                ),
                None => write!(rows, "<tr><td>{}</td><td>{}</td><td>not yet</td></tr>", number + 1, stage.name()),
            };
        }
        let page = stage_pages::contents(&self.title, &rows);
        Ok(atomic::write(&self.folder.join("index.html"), page.as_bytes())?)
    }
}

/// The camera and the frames.
pub fn interior(flight: &Flight<'_>, listed: usize, left_out: &[String]) -> Value {
    let camera = &flight.project.camera;
    let angle = |size: f64| camera.f_px.map(|f| 2.0 * (size / 2.0 / f).atan().to_degrees());
    let focal = match (camera.f_px, camera.focal) {
        (None, _) => "sought",
        (Some(_), Focal::Held) => "held",
        (Some(_), Focal::Rough) => "rough",
    };
    let frame = |name: &&str| {
        let masks: Vec<String> = flight
            .masks
            .of(name)
            .iter()
            .filter_map(|mask| Some(mask.file_name()?.to_string_lossy().into_owned()))
            .collect();
        json!({"name": name, "masks": masks})
    };
    json!({
        "stage": "interior",
        "frames_listed": listed,
        "f_px": camera.f_px,
        "focal": focal,
        "pp_px": list(&flight.pp_px()),
        "size_px": list(&flight.size_px),
        "field_of_view_deg": flight.size_px.map(angle),
        "frames": flight.ordered.iter().map(frame).collect::<Vec<_>>(),
        "left_out": left_out,
    })
}

/// Flight lines and pairs. Places are metres: of the adjustment's frame where focal length and directions are known,
/// else the table's.
pub fn pairs(plan: &Plan, names: &[&str]) -> Value {
    let line_of = |frame: usize| plan.lines.iter().position(|l| l.frames.contains(&frame));
    let pair = |(k, &(a, b)): (usize, &(usize, usize))| {
        let along = line_of(a) == line_of(b);
        json!({"frames": [names[a], names[b]], "along_line": along, "shared": plan.shared[k].map(number)})
    };
    let place = |i: usize| {
        json!({"name": names[i], "place_m": plan.places_m[i].map(|p| list(&p)),
               "azimuth_deg": plan.azimuths_rad[i].map(|a| number(a.to_degrees().rem_euclid(360.0)))})
    };
    let lines: Vec<Value> = plan
        .lines
        .iter()
        .map(|l| json!({"name": l.name, "frames": l.frames.iter().map(|i| names[*i]).collect::<Vec<_>>()}))
        .collect();
    json!({
        "stage": "pairs",
        "lines": lines,
        "pairs": plan.pairs.iter().enumerate().map(pair).collect::<Vec<_>>(),
        "frames": (0..names.len()).map(place).collect::<Vec<_>>(),
    })
}

/// Cells along a side of a frame for which it is told whether they have ties.
const CELLS: usize = 8;

/// Ties by pair and by frame.
pub fn ties(matched: &Matched, names: &[&str], size_px: [f64; 2]) -> Value {
    let verified = &matched.verified;
    let all = matched.all.as_ref().unwrap_or(verified);
    let agree = verified.by_pair();
    let pair = |((a, b), matches): (&(usize, usize), &usize)| {
        let checked = agree.get(&(*a, *b)).copied().unwrap_or(0);
        json!({"frames": [names[*a], names[*b]], "matches": matches, "ties": checked})
    };
    let frame = |i: usize| {
        let places = verified.places_tied(i);
        let neighbours = agree.iter().filter(|((a, b), n)| **n > 0 && (*a == i || *b == i)).count();
        json!({"name": names[i], "features": all.features(i), "ties": places.len(), "neighbours": neighbours,
               "covered": number(covered(&places, size_px))})
    };
    json!({
        "stage": "ties",
        "neighbours_warped": matched.all.is_some(),
        "pairs": all.by_pair().iter().map(pair).collect::<Vec<_>>(),
        "frames": (0..names.len()).map(frame).collect::<Vec<_>>(),
    })
}

/// The matches of each pair; `None` where frames were matched as they are.
pub fn all_matches(matched: &Matched, names: &[&str]) -> Option<Vec<PairTies>> {
    matched.all.as_ref().map(|ties: &Ties| ties.statistics(names))
}

/// Share of the frame's cells in which one of the places lies.
fn covered(places: &[[f64; 2]], size_px: [f64; 2]) -> f64 {
    let mut has = [false; CELLS * CELLS];
    for at in places {
        let [i, j] = [0, 1].map(|k| ((at[k] / size_px[k] * CELLS as f64) as usize).min(CELLS - 1));
        has[j * CELLS + i] = true;
    }
    has.iter().filter(|h| **h).count() as f64 / has.len() as f64
}

/// The block before it stands on the ground.
pub fn relative(oriented: &Oriented, names: &[&str], listed: usize) -> Value {
    let model = &oriented.model;
    let mut squares = vec![(0usize, 0.0f64); model.photographs.len()];
    for tie in &model.ties {
        for (i, pixel) in &tie.seen {
            let photograph = &model.photographs[*i];
            let seen = model.cameras[photograph.camera].project(photograph.pose.to_camera(&tie.xyz).into());
            if let Some([x, y]) = seen {
                squares[*i].0 += 1;
                squares[*i].1 += (x - pixel[0]).powi(2) + (y - pixel[1]).powi(2);
            }
        }
    }
    let rms = |(count, sum): (usize, f64)| (count > 0).then(|| number((sum / count as f64).sqrt()));
    let total = squares.iter().fold((0, 0.0), |(n, s), (count, sum)| (n + count, s + sum));
    let frame = |(p, own): (&autoref_flight::read::Photograph, &(usize, f64))| {
        let centre: [f64; 3] = p.pose.centre.into();
        json!({"name": p.name, "ties": own.0, "rms_px": rms(*own), "centre": list(&centre)})
    };
    let lost: Vec<&&str> = names.iter().filter(|n| model.find(n).is_none()).collect();
    json!({
        "stage": "relative",
        "made_by": oriented.by.words(),
        "frames_registered": model.photographs.len(),
        "frames_listed": listed,
        "not_registered": lost,
        "ties": model.ties.len(),
        "image_points": total.0,
        "image_points_laid": oriented.laid,
        "reprojection_rms_px": rms(total),
        "frames": model.photographs.iter().zip(&squares).map(frame).collect::<Vec<_>>(),
    })
}

/// Surveyed points in the images, and what a similarity leaves at them.
pub fn gcp(placed: &OnGround, points: &[GroundPoint], model: &Reconstruction, world: &World, crs: String) -> Value {
    let mut residuals: [Vec<[f64; 3]>; 2] = Default::default();
    let mut point = |(p, left): (&GroundPoint, &Option<nalgebra::Vector3<f64>>)| {
        let at = world.to_map(&p.xyz).unwrap_or_default();
        let left = left.map(|v| in_map(world, &p.xyz, &v));
        residuals[usize::from(p.role == Role::Check)].extend(left);
        let images: Vec<Value> = p
            .seen
            .iter()
            .map(|(i, pixel)| json!({"frame": model.photographs[*i].name, "pixel": list(pixel)}))
            .collect();
        let role = match p.role {
            Role::Control => "control",
            Role::Check => "check",
        };
        let sigma: [f64; 3] = p.sigma.into();
        json!({"name": p.name, "role": role, "e": number(at[0]), "n": number(at[1]), "h": number(at[2]),
               "sigma_m": list(&sigma), "images": images, "residual_m": left.map(|v| list(&v)),
               "d_m": left.map(|v| number(v.iter().map(|v| v * v).sum::<f64>().sqrt()))})
    };
    let all: Vec<Value> = points.iter().zip(&placed.residuals).map(&mut point).collect();
    json!({
        "stage": "gcp",
        "crs": crs,
        "unit_m": world.units_m()[0],
        "height_unit_m": world.units_m()[1],
        "scale": number(placed.similarity.scale),
        "points": all,
        "gcp_statistics": Residuals::of(&residuals[0]),
        "check_point_statistics": Residuals::of(&residuals[1]),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_is_covered_where_it_has_ties() {
        assert_eq!(covered(&[], [800.0, 400.0]), 0.0);
        let everywhere: Vec<[f64; 2]> =
            (0..64).map(|k| [(k % 8) as f64 * 100.0 + 50.0, (k / 8) as f64 * 50.0 + 25.0]).collect();
        assert_eq!(covered(&everywhere, [800.0, 400.0]), 1.0);
        assert_eq!(covered(&everywhere[..16], [800.0, 400.0]), 0.25);
        // The far edge is inside.
        assert_eq!(covered(&[[800.0, 400.0]], [800.0, 400.0]), 1.0 / 64.0);
    }
}
