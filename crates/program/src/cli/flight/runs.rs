//! Flight lines of a project, which frames are compared, and what a result says of each line.

use autoref_flight::adjust::{Adjustment, Role, RoughPose};
use autoref_flight::lines::{self, Line, Sight, Station};
use autoref_flight::read::{Reconstruction, same_image, tables::CameraRow};
use autoref_flight::statistics::Residuals;
use autoref_flight::world::World;
use autoref_flight::{Camera, Pose};
use autoref_raster::crs::Crs;
use autoref_raster::words::some_of;

use super::document::{LineRecord, in_map};
use super::project::Project;
use super::relative::{Flight, GroundPlane};
use super::ties::PairTies;

/// The table's row of each frame.
pub fn rows_of<'a>(names: &[&str], rows: &'a [CameraRow]) -> Vec<Option<&'a CameraRow>> {
    let mut of = vec![None; names.len()];
    for row in rows {
        if let Some(i) = same_image(&row.name, names.iter().copied()) {
            of[i].get_or_insert(row);
        }
    }
    of
}

/// Poses for the frames that the table lacks: between those before and after, or on beyond the two nearest, less sure
/// by half a base. `None` when fewer than half of the frames have one.
pub fn filled(stated: &[Option<RoughPose>]) -> Option<Vec<RoughPose>> {
    let known: Vec<usize> = (0..stated.len()).filter(|i| stated[*i].is_some()).collect();
    if known.len() < 2 || 2 * known.len() < stated.len() {
        return None;
    }
    let between = |i: usize| -> Option<RoughPose> {
        if let Some(pose) = stated[i] {
            return Some(pose);
        }
        let after = known.partition_point(|k| *k < i).clamp(1, known.len() - 1);
        let (from, to) = (known[after - 1], known[after]);
        let (a, b) = (stated[from]?, stated[to]?);
        let share = (i as f64 - from as f64) / (to as f64 - from as f64);
        let way = b.pose.centre - a.pose.centre;
        let base_m = way.norm() / (to - from) as f64;
        let nearest = if share < 0.5 { a } else { b };
        Some(RoughPose {
            pose: Pose { rotation: nearest.pose.rotation, centre: a.pose.centre + way * share },
            sigma_m: nearest.sigma_m.add_scalar(0.5 * base_m),
            sigma_rad: 2.0 * nearest.sigma_rad,
        })
    };
    (0..stated.len()).map(between).collect()
}

/// How a flight is worked: its lines and the pairs that are compared, by the frames' numbers.
pub struct Plan {
    pub lines: Vec<Line>,
    /// The smaller number first.
    pub pairs: Vec<(usize, usize)>,
    /// Of each pair, the share of a frame whose ground the other sees too, of the frame that has less.
    pub shared: Vec<Option<f64>>,
    /// Where each frame is thought to stand, and the azimuth of its view.
    pub places_m: Vec<Option<[f64; 2]>>,
    pub azimuths_rad: Vec<Option<f64>>,
}

/// The lines of the table, and the pairs that are worth comparing. `sight`: where the frames are thought to stand;
/// without it the nearest places of other lines are taken.
pub fn plan(project: &Project, names: &[&str], rows: &[CameraRow], sight: Option<(&GroundPlane, &Flight<'_>)>) -> Plan {
    let crs = project.crs.as_deref().and_then(|text| Crs::parse(text).ok());
    let metric = crs.as_ref().is_none_or(|crs| !crs.is_geographic());
    let unit_m = crs.as_ref().map_or(1.0, Crs::metres_per_unit);
    let stations: Vec<Station> = rows_of(names, rows)
        .into_iter()
        .enumerate()
        .map(|(i, row)| {
            let view = sight.map(|(plane, _)| plane.views[i].pose);
            let place = row.map(|r| [r.xyz[0] * unit_m, r.xyz[1] * unit_m]).filter(|_| metric);
            Station {
                // In the world's own frame where it is known: metres, whatever the table counts in.
                place_m: view.map(|pose| [pose.centre.x, pose.centre.y]).or(place),
                azimuth_rad: view
                    .as_ref()
                    .map(lines::azimuth_rad)
                    .or_else(|| row.and_then(|r| r.yaw_deg).map(f64::to_radians)),
                line: row.and_then(|r| r.line.clone()),
            }
        })
        .collect();
    let sigma_m = project.rough.as_ref().map_or(0.0, |r| r.sigma_m);
    let lines = lines::lines(&stations, sigma_m);
    let poses: Option<Vec<_>> = sight.map(|(plane, _)| plane.views.iter().map(|v| v.pose).collect());
    let camera = sight.map(|(plane, flight)| Camera::pinhole("film", flight.size_px, plane.f_px, flight.pp_px()));
    let seen = sight.zip(poses.as_ref()).zip(camera.as_ref());
    let sight = seen.map(|(((plane, _), poses), camera)| Sight { camera, poses, ground_m: plane.ground_m });
    let pairs = lines::pairs(&stations, &lines, (project.pairs.neighbours, project.pairs.across), sight);
    let shared = |(a, b): &(usize, usize)| sight.map(|sight| sight.shared(*a, *b).min(sight.shared(*b, *a)));
    Plan {
        shared: pairs.iter().map(shared).collect(),
        places_m: stations.iter().map(|s| s.place_m).collect(),
        azimuths_rad: stations.iter().map(|s| s.azimuth_rad).collect(),
        lines,
        pairs,
    }
}

/// A note on frames that follow each other on a line and share no ties, though the table has them see the same ground.
/// `tied`: the ties of each pair of frames.
pub fn untied(plan: &Plan, names: &[&str], tied: &[PairTies]) -> Option<String> {
    /// Share of a frame that is enough to be matched.
    const ENOUGH: f64 = 0.3;
    let shared = |a: usize, b: usize| {
        let at = plan.pairs.iter().position(|pair| *pair == (a.min(b), a.max(b)));
        at.and_then(|at| plan.shared[at]).is_some_and(|shared| shared >= ENOUGH)
    };
    let has_ties = |a: usize, b: usize| {
        let of = |pair: &&PairTies| [[a, b], [b, a]].iter().any(|f| pair.frames == f.map(|i| names[i]));
        tied.iter().find(of).is_some_and(|pair| pair.ties > 0)
    };
    let next = plan.lines.iter().flat_map(|line| line.frames.windows(2)).filter(|two| shared(two[0], two[1]));
    let (tied, bare): (Vec<&[usize]>, Vec<&[usize]>) = next.partition(|two| has_ties(two[0], two[1]));
    if bare.is_empty() {
        return None;
    }
    let named: Vec<String> = bare.iter().map(|two| format!("{} and {}", names[two[0]], names[two[1]])).collect();
    Some(format!(
        "{} of {} pairs of neighbours share no ties though the table has them see the same ground ({}): where its \
         directions are wrong, or frames were turned, leave its columns of directions out; where a frame shows other \
         ground, take it out",
        bare.len(),
        tied.len() + bare.len(),
        some_of(&named)
    ))
}

/// What an adjustment leaves of each line.
pub fn results(
    lines: &[Line],
    names: &[&str],
    (found, model): (&Adjustment, &Reconstruction),
    world: &World,
) -> Vec<LineRecord> {
    let residuals = |role: Role, frames: &[&str]| {
        let in_line = |i: usize| frames.contains(&model.photographs[i].name.as_str());
        let points = found.points.iter().filter(|p| p.role == role && p.image.iter().any(|(i, _)| in_line(*i)));
        let all = points.filter_map(|p| Some(in_map(world, &p.xyz, &p.residual?)));
        Residuals::of(&all.filter(|r| r.iter().all(|v| v.is_finite())).collect::<Vec<_>>())
    };
    let of = |line: &Line| {
        let frames: Vec<&str> = line.frames.iter().map(|i| names[*i]).collect();
        LineRecord {
            name: line.name.clone(),
            gcp_statistics: residuals(Role::Control, &frames),
            check_point_statistics: residuals(Role::Check, &frames),
            frames: frames.into_iter().map(str::to_string).collect(),
        }
    };
    lines.iter().map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbours_without_ties_are_told_where_the_table_has_them_overlap() {
        let names = ["a", "b", "c", "d"];
        let line = |frames: &[usize]| Line { name: String::new(), frames: frames.to_vec() };
        let plan = Plan {
            lines: vec![line(&[1, 0]), line(&[2, 3])],
            pairs: vec![(0, 1), (0, 2), (2, 3)],
            shared: vec![Some(0.6), Some(0.9), Some(0.5)],
            places_m: vec![None; 4],
            azimuths_rad: vec![None; 4],
        };
        let pair = |frames: [&str; 2], ties| PairTies { frames: frames.map(String::from), ties };
        let tied = |ab, cd| [pair(["a", "b"], ab), pair(["c", "d"], cd)];
        assert_eq!(untied(&plan, &names, &tied(40, 50)), None);
        let note = untied(&plan, &names, &tied(40, 0)).expect("c and d");
        assert!(note.starts_with("1 of 2 pairs of neighbours share no ties") && note.contains("(c and d)"), "{note}");
        assert!(untied(&Plan { shared: vec![Some(0.1); 3], ..plan }, &names, &tied(0, 0)).is_none());
    }
}
