//! Rough tables of cameras: where a flight's frames are said to stand, on the map and in the world's frame.

use autoref_raster::words::some_of;
use std::path::Path;

use anyhow::{Result, bail};
use autoref_flight::Pose;
use autoref_flight::adjust::RoughPose;
use autoref_flight::pose::turn;
use autoref_flight::read::same_image;
use autoref_flight::read::tables::{self, Angles, CameraRow};
use autoref_flight::read::units::{self, Stated};
use autoref_flight::world::World;
use autoref_raster::crs::{Coordinate, Crs};
use autoref_raster::units::FOOT_M;
use nalgebra::Vector3;

use super::worlds::{DATUM_M, height_unit_m};

/// What a block without GCPs cannot say.
pub const NO_GCPS: &str = "no GCPs: the positions of the table place the block; what is wrong with all of them alike (the \
                       datum of their heights, a receiver's offset) is in no standard deviation";

/// What the yaw, pitch and roll of a camera table are.
#[derive(Clone, Copy, Debug, clap::Args)]
pub struct AnglesArgs {
    /// With a camera table: whose yaw, pitch and roll it states. `view`: a pitch of 0 is level, -90 straight down, as
    /// of a gimbal; `aircraft`: a pitch of 0 looks straight down, as Metashape, Pix4D and OpenSfM count.
    #[arg(long, value_enum, default_value = "view")]
    angles: AnglesWord,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum AnglesWord {
    View,
    Aircraft,
}

impl AnglesArgs {
    pub fn angles(self) -> Angles {
        match self.angles {
            AnglesWord::View => Angles::View,
            AnglesWord::Aircraft => Angles::Aircraft,
        }
    }
}

/// The rows of a camera table, with the angles of the view.
///
/// # Errors
/// Those of [`tables::cameras`].
pub fn cameras(table: &Path, angles: Angles) -> Result<Vec<CameraRow>> {
    let rows = tables::cameras(table)?;
    let above = rows.iter().filter(|row| row.pitch_deg.is_some_and(|pitch| pitch > 0.0)).count();
    if above > 0 && angles == Angles::View {
        tracing::warn!(
            "{}: the view of {above} of {} rows would look above the horizon; Metashape, Pix4D and OpenSfM count pitch from \
             straight down: --angles aircraft, or angles = \"aircraft\" under [rough]",
            table.display(),
            rows.len()
        );
    }
    if angles == Angles::Aircraft && rows.iter().all(|row| row.yaw_deg.is_none()) {
        bail!(
            "{}: states no yaw, pitch and roll of an aircraft; leave out --angles aircraft, or angles under [rough]",
            table.display()
        );
    }
    let rows: Vec<CameraRow> = rows.into_iter().map(|row| row.with_angles_of_view(angles)).collect();
    match rows.iter().find_map(|row| Some((row, apart_deg(row).filter(|deg| *deg > SAME_DEG)?))) {
        Some((row, deg)) => bail!(
            "{}: `{}`: its omega, phi, kappa and its yaw, pitch, roll are {deg:.1} degrees apart; correct them, or leave the \
             columns of the one out, or give --angles aircraft where yaw, pitch and roll are the aircraft's",
            table.display(),
            row.name
        ),
        None => Ok(rows),
    }
}

/// Two statements of one direction are no further apart than they were rounded.
const SAME_DEG: f64 = 1.0;

/// The turn between both directions of a row that states two; of the views alone where it states no roll.
fn apart_deg(row: &CameraRow) -> Option<f64> {
    let [o, p, k] = row.omega_phi_kappa_deg?;
    let stated = Pose::from_omega_phi_kappa(Vector3::zeros(), [o, p, k]).rotation;
    let of_view = CameraRow { omega_phi_kappa_deg: None, ..row.clone() };
    let other = of_view.pose(None)?.rotation;
    let turned = match row.roll_deg {
        Some(_) => turn(&stated, &other).norm(),
        None => stated.row(2).transpose().angle(&other.row(2).transpose()),
    };
    Some(turned.to_degrees())
}

/// Rows of a camera table on the map: longitudes and latitudes are brought to `crs`, and directions count from the
/// grid's north.
///
/// # Errors
/// When there is no map to bring them to.
pub fn on_map(rows: Vec<CameraRow>, table: &Path, crs: Option<&Crs>) -> Result<Vec<CameraRow>> {
    let [plan, height] = units::stated_by_titles(table)?;
    let crs = crs.filter(|c| !c.is_local());
    let geographic = rows.iter().any(|row| row.geographic);
    let plan_m = crs.filter(|_| !geographic).map_or(1.0, Crs::metres_per_unit);
    let height_m = crs.filter(|_| !geographic).map_or(1.0, height_unit_m);
    let is_other = |unit: Stated, unit_m: f64| match unit {
        Stated::Feet => (unit_m / FOOT_M - 1.0).abs() >= 1e-4,
        Stated::Metres => (unit_m - 1.0).abs() >= 1e-4,
    };
    for (stated, unit_m, what) in [(plan, plan_m, "coordinates"), (height, height_m, "heights")] {
        let Some((title, unit)) = stated.filter(|(_, unit)| is_other(*unit, unit_m)) else { continue };
        let unit = match unit {
            Stated::Feet => "feet",
            Stated::Metres => "metres",
        };
        let system = crs.map_or("the table".to_string(), |c| c.title());
        let apart = if what == "heights" { " (with a vertical CRS for heights alone, as EPSG:2263+5703)" } else { "" };
        bail!(
            "{}: `{title}` says {unit}, and {what} count in units of {unit_m} m in {system}; bring the column to these, \
             or give the --crs, or crs in FLIGHT.toml, that counts in {unit}{apart}",
            table.display()
        )
    }
    brought(rows, table, crs)
}

/// [`on_map`] of rows that stand in this map and no other: northings that come first are exchanged where the area of
/// use of `crs` allows nothing else, and that is said; so are rows of which none lies in it.
///
/// # Errors
/// Those of [`on_map`].
pub fn in_map(rows: Vec<CameraRow>, table: &Path, crs: Option<&Crs>) -> Result<Vec<CameraRow>> {
    let mut rows = on_map(rows, table, crs)?;
    let Some(crs) = crs.filter(|crs| !crs.is_local() && !crs.is_geographic()) else { return Ok(rows) };
    if rows.is_empty() || rows.iter().any(|row| crs.covers(row.xyz[0], row.xyz[1]) != Some(false)) {
        return Ok(rows);
    }
    let (table, title) = (table.display(), crs.title());
    let lie = if rows.len() == 1 { "its position lies" } else { "all its positions lie" };
    let exchanged = rows.iter().filter(|row| crs.covers(row.xyz[1], row.xyz[0]) == Some(true)).count();
    // Single rows may be in nowhere.
    if 2 * exchanged > rows.len() {
        tracing::warn!("{table}: {lie} in {title} only with the northing first; easting and northing are exchanged");
        rows.iter_mut().for_each(|row| row.xyz.swap(0, 1));
    } else {
        // One zone of UTM is used far beyond its edges where a country keeps to it.
        tracing::warn!("{table}: {lie} outside the area of use of {title}; is it the --crs, or crs in FLIGHT.toml?");
    }
    Ok(rows)
}

/// [`on_map`] of rows whose units are known.
pub fn brought(mut rows: Vec<CameraRow>, table: &Path, crs: Option<&Crs>) -> Result<Vec<CameraRow>> {
    let Some(first) = rows.iter().find(|row| row.geographic) else { return Ok(rows) };
    let Some(crs) = crs.filter(|c| !c.is_local()) else {
        bail!(
            "{}: longitudes and latitudes, and no CRS to bring them to; give --crs, or crs in FLIGHT.toml",
            table.display()
        )
    };
    let at = Coordinate { x: first.xyz[0], y: first.xyz[1], height: None };
    let way = Crs::from_epsg(4326)?.way(&[at], crs, DATUM_M)?;
    /// Degrees of latitude over which the grid's north is taken.
    const NORTH_DEG: f64 = 1e-4;
    for row in rows.iter_mut().filter(|row| row.geographic) {
        if row.omega_phi_kappa_deg.is_some() {
            bail!(
                "{}: omega, phi and kappa beside longitude and latitude; give map coordinates, in which they count",
                table.display()
            );
        }
        let [x, y, height] = row.xyz;
        let mut both = [0.0, NORTH_DEG].map(|north| Coordinate { x, y: y + north, height: None });
        way.transform(&mut both)?;
        let north_deg = (both[1].x - both[0].x).atan2(both[1].y - both[0].y).to_degrees();
        // Heights beside longitude and latitude are metres.
        row.xyz = [both[0].x, both[0].y, height / height_unit_m(crs)];
        row.yaw_deg = row.yaw_deg.map(|yaw| yaw + north_deg);
        row.geographic = false;
    }
    Ok(rows)
}

/// The map of positions that stand without GCPs: the one named, else the UTM zone of their longitudes and latitudes.
///
/// # Errors
/// When they lie in no UTM zone.
pub fn map_of(rows: &[CameraRow], stated: Option<Crs>) -> Result<Option<Crs>> {
    let lon_lat = rows.iter().find(|row| row.geographic);
    match (lon_lat, stated) {
        (Some(row), None) => Ok(Some(Crs::from_epsg(4326)?.utm_zone(row.xyz[0], row.xyz[1])?)),
        (Some(row), Some(crs)) if crs.is_geographic() => Ok(Some(crs.utm_zone(row.xyz[0], row.xyz[1])?)),
        (_, stated) => Ok(stated),
    }
}

/// What a row of a camera table says, in the world's frame: its position, and its direction where that is stated whole.
/// `sigma_m` is that of positions whose row states none.
pub fn rough_pose(row: &CameraRow, world: &World, sigma_m: f64, sigma_rad: f64) -> Option<RoughPose> {
    let any_way = || Pose { rotation: nalgebra::Matrix3::identity(), centre: Vector3::from(row.xyz) };
    let pose = world.pose_to_world(&row.pose(Some(0.0)).unwrap_or_else(any_way))?;
    let sigma_rad = if row.is_directed() { sigma_rad } else { f64::INFINITY };
    Some(RoughPose { pose, sigma_m: position_sigmas(row, sigma_m), sigma_rad })
}

/// 1σ of a row's position: what it states, else `sigma_m`.
pub fn position_sigmas(row: &CameraRow, sigma_m: f64) -> Vector3<f64> {
    let [plan, up] = row.sigma_m.map(|stated| stated.unwrap_or(sigma_m));
    Vector3::new(plan, plan, up)
}

/// Refuses a table none of whose names is a frame's; a note on those that are not.
///
/// # Errors
/// When no row is of a frame.
pub fn unmatched(rows: &[CameraRow], table: &Path, frames: &[&str]) -> Result<Option<String>> {
    let is_lost = |row: &&CameraRow| same_image(&row.name, frames.iter().copied()).is_none();
    let lost: Vec<String> = rows.iter().filter(is_lost).map(|row| row.name.clone()).collect();
    if !rows.is_empty() && lost.len() == rows.len() {
        let frames: Vec<String> = frames.iter().map(|name| (*name).to_string()).collect();
        bail!(
            "{}: none of its names ({}) is a frame's ({}); correct the names",
            table.display(),
            some_of(&lost),
            some_of(&frames)
        );
    }
    let all = rows.len();
    Ok((!lost.is_empty())
        .then(|| format!("{}: {} of {all} rows are of no frame: {}", table.display(), lost.len(), some_of(&lost))))
}
