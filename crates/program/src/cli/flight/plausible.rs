//! What cannot be, told before and after a frame or a block is solved.

use std::path::Path;

use anyhow::{Result, bail};
use autoref_flight::adjust::{GroundPoint, UpsideDown};
use autoref_flight::read::Reconstruction;
use autoref_flight::world::World;
use autoref_flight::{Error, Pose};
use nalgebra::Vector3;

/// A mistake that refuses a flight's result unless it is named.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Mistake {
    /// The cameras look up at the ground from below it, as a mirror image of the block has them.
    UpsideDown,
}

/// What a command is told to go on in spite of.
#[derive(Clone, Debug, clap::Args)]
pub struct ForceArgs {
    /// Go on in spite of a mistake that is plain, by its name.
    #[arg(long, value_enum, value_name = "NAME")]
    force: Vec<Mistake>,
}

/// What is to be said of a block that seems to be placed as its mirror image; `lists` are those of GCPs and of
/// positions.
///
/// # Errors
/// Where nothing but a mirror image is likely, unless `force` names it.
pub fn upside_down(
    found: Option<UpsideDown>,
    lists: [Option<&Path>; 2],
    ForceArgs { force }: &ForceArgs,
) -> Result<Option<String>> {
    let Some(found) = found else { return Ok(None) };
    let [gcps, positions] = lists.map(|list| list.map_or(String::new(), |list| format!("{}: ", list.display())));
    let [stated, exchanged] = found.misses_m;
    let (list, places) = if found.by_gcps { (gcps, "points") } else { (positions, "positions") };
    let fit = format!("RMS {exchanged:.2} m, as they stand {stated:.2} m");
    let what = if found.looks_up() {
        format!(
            "{list}its {places} hang the block upside down: its frames look up ({:.0} degrees above the horizon), and \
             would look down with easting and northing of the {places} exchanged, which fits about as well ({fit})",
            found.looks_deg
        )
    } else {
        format!("{list}its {places} are those of a mirror image: with easting and northing exchanged they fit ({fit})")
    };
    let other = match found.by_gcps {
        true => "pixels whose y counts from the lower edge",
        false => "positions in a row, which leave open how the block is turned about it",
    };
    let causes = format!("northings that stand before eastings, heights that count downwards, {other}");
    if found.is_plain() && !force.contains(&Mistake::UpsideDown) {
        let remedy = format!(
            "correct what mirrors it ({causes}), or go on with --force upside-down where the frames do look up"
        );
        return Err(Error::no_result(what, remedy).into());
    }
    Ok(Some(format!("{what}; unless the frames do look up, correct what mirrors it ({causes})")))
}

/// Pixels beyond a frame's edge that a click may be off.
const BESIDE_PX: f64 = 5.0;
/// A share of measurements outside their frames that no slip explains.
const MANY: f64 = 0.25;

/// Takes measurements that lie outside their frames out of `points`, and says so.
///
/// # Errors
/// When many do: the list is of frames of another size, or counts from another corner.
pub fn within_frames(points: &mut [GroundPoint], model: &Reconstruction, list: &str) -> Result<Vec<String>> {
    let size = |photograph: usize| model.cameras[model.photographs[photograph].camera].size_px;
    let is_outside = |&(photograph, pixel): &(usize, [f64; 2])| {
        let size = size(photograph);
        (0..2).any(|axis| size[axis] > 0.0 && !(-BESIDE_PX..=size[axis] + BESIDE_PX).contains(&pixel[axis]))
    };
    let all: usize = points.iter().map(|p| p.seen.len()).sum();
    let astray: Vec<(String, (usize, [f64; 2]))> = points
        .iter()
        .flat_map(|p| p.seen.iter().filter(|seen| is_outside(seen)).map(|seen| (p.name.clone(), *seen)))
        .collect();
    let Some((name, (photograph, [x, y]))) = astray.first() else { return Ok(Vec::new()) };
    let ([width, height], frame) = (size(*photograph), &model.photographs[*photograph].name);
    let first = format!("first `{name}` at ({x:.1}, {y:.1}) in `{frame}` of {width} x {height} px");
    if astray.len() as f64 > MANY * all as f64 {
        let upwards = astray.len() == all && astray.iter().all(|(_, (_, [_, y]))| *y < 0.0);
        let remedy = if upwards {
            "its y counts upwards: change its sign"
        } else {
            "give pixels of these frames, from their upper left corner down"
        };
        bail!("{list}: {} of {all} measurements lie outside their frames ({first}): {remedy}", astray.len());
    }
    points.iter_mut().for_each(|p| p.seen.retain(|seen| !is_outside(seen)));
    let note =
        format!("{list}: {} of {all} measurements lie outside their frames and are left out ({first})", astray.len());
    tracing::warn!("{note}");
    Ok(vec![note])
}

/// What to think of cameras that stand below all the ground that was measured, as mirrored coordinates put them. On
/// slopes a camera may stand there.
pub fn below_ground<'a>(
    poses: impl Iterator<Item = &'a Pose>,
    ground: impl Iterator<Item = &'a Vector3<f64>>,
    world: &World,
) -> Option<String> {
    let height = |at: &Vector3<f64>| world.to_map(at).map(|map| map[2]);
    let lowest = ground.filter_map(height).reduce(f64::min)?;
    let heights: Vec<f64> = poses.filter_map(|pose| height(&pose.centre)).collect();
    let below = heights.iter().filter(|h| **h < lowest).count();
    (2 * below > heights.len()).then(|| {
        format!(
            "{below} of {} cameras stand below all points on the ground: unless they do, northings stand before eastings, or \
             the pixels' y counts from the lower edge",
            heights.len()
        )
    })
}
