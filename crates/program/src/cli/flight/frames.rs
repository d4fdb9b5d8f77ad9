//! What frames say of themselves: whether they can be used, by what camera they were taken, and where.

use autoref_raster::words::some_of;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use autoref_flight::Error;
use autoref_flight::grey::Grey;
use autoref_flight::read::tables::CameraRow;
use autoref_raster::crs::Crs;
use autoref_raster::jpeg_end;
use autoref_raster::ranks;
use gdal::raster::GdalDataType;
use gdal::{Dataset, Metadata};
use rayon::prelude::*;

use super::camera_tables::brought;
use super::views::{LARGEST_PX, plain, write_png};

/// The frames that can be read and are of the size that most have, and a line about each of the others. `seen` is shown
/// each frame that can be read.
///
/// # Errors
/// That of `seen`.
pub fn usable(
    folder: &Path,
    names: &[String],
    seen: &(dyn Fn(&str, &Grey) -> Result<()> + Sync),
) -> Result<(Vec<String>, Vec<String>)> {
    let look = |name: &String| -> Result<((usize, usize), Grey)> {
        let path = folder.join(name);
        let size = Dataset::open(&path).map_err(|e| autoref_raster::Error::gdal(&path, e))?.raster_size();
        jpeg_end::check(&path)?;
        // A file that ends too early tells its size all the same.
        Ok((size, plain(folder, name, LARGEST_PX)?))
    };
    let size = |name: &String| match look(name) {
        Ok((size, grey)) => seen(name, &grey).map(|()| Ok(size)),
        Err(unreadable) => Ok(Err(unreadable)),
    };
    let sizes: Vec<Result<(usize, usize)>> = names.par_iter().map(size).collect::<Result<_>>()?;
    let mut counts: BTreeMap<(usize, usize), usize> = BTreeMap::new();
    for size in sizes.iter().flatten() {
        *counts.entry(*size).or_default() += 1;
    }
    let most = counts.iter().max_by_key(|(_, count)| **count).map(|(size, _)| *size);
    let (mut kept, mut left_out) = (Vec::new(), Vec::new());
    for (name, size) in names.iter().zip(&sizes) {
        match (size, most) {
            (Ok(size), Some(most)) if *size == most => kept.push(name.clone()),
            (Ok((w, h)), Some((mw, mh))) => {
                left_out.push(format!("{name}: left out: it has {w} x {h} pixels, most frames have {mw} x {mh}"));
            }
            (Err(error), _) => left_out.push(format!("{name}: left out: {error:#}")),
            (Ok(_), None) => {}
        }
    }
    Ok((kept, left_out))
}

/// Width and height of an image that can be opened.
pub fn size(frame: &Path) -> Option<(usize, usize)> {
    Dataset::open(frame).ok().map(|image| image.raster_size())
}

/// The folder from which COLMAP reads the frames: `folder` itself, or one below `out` in which colour frames of more
/// than eight bits, which COLMAP cannot read, are grey ones of eight, beside links to the others.
///
/// # Errors
/// When a frame cannot be read, or the folder not be written.
pub fn for_colmap(folder: &Path, names: &[String], out: &Path) -> Result<PathBuf> {
    let deep_colour = |name: &String| -> Result<bool> {
        let path = folder.join(name);
        let frame = Dataset::open(&path).with_context(|| format!("{}: cannot be read", path.display()))?;
        let kind = frame.rasterband(1).with_context(|| format!("{}: cannot be read", path.display()))?.band_type();
        Ok(frame.raster_count() >= 3 && kind != GdalDataType::UInt8)
    };
    let deep: Vec<bool> = names.iter().map(deep_colour).collect::<Result<_>>()?;
    if !deep.contains(&true) {
        return Ok(folder.to_path_buf());
    }
    let made = out.join("frames_8bit");
    for (name, deep) in names.iter().zip(deep) {
        let target = made.join(name);
        if let Some(parent) = target.parent() {
            std::fs::create_dir_all(parent).map_err(|e| Error::io(parent, "create", e))?;
        }
        autoref_raster::protected::refuse_input(&target)?;
        match std::fs::remove_file(&target) {
            Err(e) if e.kind() != std::io::ErrorKind::NotFound => return Err(Error::io(&target, "replace", e).into()),
            _ => {}
        }
        if deep {
            // PNG under any name: readers go by what a file begins with.
            write_png(&plain(folder, name, usize::MAX)?, &target)?;
        } else {
            std::os::unix::fs::symlink(folder.join(name), &target).map_err(|e| Error::io(&target, "link", e))?;
        }
    }
    Ok(made)
}

/// Focal length and principal point, in pixels, of a frame that `fiducials --resample` made. `camera`: the film camera,
/// a name or a file; without it the one that the frame names. `None` when the frame is none of these and no camera is
/// asked for.
///
/// # Errors
/// When the camera is unknown or has no focal length, or one is named and the frame was not resampled.
pub fn film_interior(frame: &Path, camera: Option<&str>, stated_f_px: Option<f64>) -> Result<Option<(f64, [f64; 2])>> {
    let said = Dataset::open(frame).ok().and_then(|d| d.metadata_item("TIFFTAG_IMAGEDESCRIPTION", ""));
    let said: serde_json::Value = said.and_then(|text| serde_json::from_str(&text).ok()).unwrap_or_default();
    let corner = &said["film_of_first_pixel_mm"];
    let grid = said["pixel_mm"].as_f64().zip(corner[0].as_f64()).zip(corner[1].as_f64());
    let Some(((pixel_mm, left_mm), top_mm)) = grid.filter(|((pixel_mm, _), _)| *pixel_mm > 0.0) else {
        match camera {
            Some(_) => bail!("{}: was not written by `fiducials --resample`; give --f-px and --pp-px", frame.display()),
            None => return Ok(None),
        }
    };
    let film = match (camera, said["camera"].as_str()) {
        (Some(name), _) => autoref_film::load_camera(name)?,
        (None, Some(name)) => match autoref_film::builtin_cameras().into_iter().find(|c| c.name == name) {
            Some(film) => film,
            None if stated_f_px.is_some() => return Ok(None),
            None => bail!("{}: the camera `{name}` is none of the program's; give --film FILE", frame.display()),
        },
        (None, None) => return Ok(None),
    };
    let Some(f_px) = stated_f_px.or(film.focal_length_mm.map(|f_mm| f_mm / pixel_mm)) else {
        bail!("camera `{}`: has no focal_length_mm; add it, or give --f-px", film.name)
    };
    let middle = principal_mm(&film);
    Ok(Some((f_px, [(middle[0] - left_mm) / pixel_mm, (middle[1] - top_mm) / pixel_mm])))
}

/// The principal point in the film's millimetres, y down: the origin where the axes run through the middle, as a
/// certificate has them, else the mean of the marks, which is that of the midpoints of opposite ones.
fn principal_mm(film: &autoref_film::Camera) -> [f64; 2] {
    let (low, high) = film.film_box();
    let quarter = [0, 1].map(|k| 0.25 * (high[k] - low[k]));
    if (0..2).all(|k| low[k] + quarter[k] < 0.0 && high[k] - quarter[k] > 0.0) {
        return [0.0; 2];
    }
    let points = film.film_points();
    [0, 1].map(|k| points.iter().map(|p| p[k]).sum::<f64>() / points.len() as f64)
}

/// What a digital camera wrote into a frame.
#[derive(Clone, Debug, Default)]
pub struct Told {
    pub f_px: Option<f64>,
    /// Longitude and latitude, degrees.
    pub place: Option<[f64; 2]>,
    pub height_m: Option<f64>,
    /// Yaw from true north, pitch and roll, degrees.
    pub angles_deg: [Option<f64>; 3],
    /// 1σ in plan and of the height, of a position that carrier phases fixed (RTK).
    pub sigma_m: Option<[f64; 2]>,
    /// Height above the place of take-off.
    pub above_start_m: Option<f64>,
}

/// A focal length in pixels by that of 35 mm film: of equal diagonals (CIPA DCG-001, *Guideline for Noting Digital
/// Camera Specifications in Catalogs*), which by width are another twentieth apart on sensors of 4:3.
fn of_small_picture(f_mm: f64, size_px: [usize; 2]) -> f64 {
    const DIAGONAL_MM: f64 = 43.266_615_305_567_87;
    f_mm / DIAGONAL_MM * (size_px[0] as f64).hypot(size_px[1] as f64)
}

fn numbers(text: &str) -> Vec<f64> {
    text.split(['(', ')', ' ', ',']).filter_map(|t| t.parse().ok()).collect()
}

/// The number after a key of an XMP packet, an attribute or an element.
fn of_xmp(packet: &str, key: &str) -> Option<f64> {
    let rest = &packet[packet.find(key)? + key.len()..];
    let rest = rest.trim_start_matches(['=', '"', '>']);
    let end = rest.find(|c: char| !(c.is_ascii_digit() || "+-.".contains(c))).unwrap_or(rest.len());
    rest[..end].trim_start_matches('+').parse().ok()
}

/// What flies higher takes no aerial photographs.
const HIGHEST_M: f64 = 100_000.0;

/// EXIF's focal length and GPS, and the direction of a gimbal (DJI's XMP).
pub fn told(frame: &Path) -> Told {
    let Ok(set) = Dataset::open(frame) else { return Told::default() };
    let (w, h) = set.raster_size();
    let tag = |name: &str| {
        let name = format!("EXIF_{name}");
        set.metadata_item(&name, "").or_else(|| set.metadata_item(&name, "EXIF"))
    };
    let number = |name: &str| tag(name).and_then(|t| numbers(&t).first().copied());
    let positive = |v: Option<f64>| v.filter(|v| *v > 0.0 && v.is_finite());
    let per_mm = || {
        let unit_mm = match number("FocalPlaneResolutionUnit")? as i64 {
            2 => 25.4,
            3 => 10.0,
            4 => 1.0,
            _ => return None,
        };
        let scale = positive(number("PixelXDimension")).map_or(1.0, |full| w as f64 / full);
        Some(positive(number("FocalPlaneXResolution"))? / unit_mm * scale)
    };
    let by_sensor = || Some(positive(number("FocalLength"))? * per_mm()?);
    let f_px = positive(number("FocalLengthIn35mmFilm")).map(|f_mm| of_small_picture(f_mm, [w, h])).or_else(by_sensor);
    // A hemisphere that is not named is not guessed.
    let degrees = |name: &str, [positive, negative]: [&str; 2], most: f64| {
        let n = numbers(&tag(name)?);
        let value = n.first()? + n.get(1).unwrap_or(&0.0) / 60.0 + n.get(2).unwrap_or(&0.0) / 3600.0;
        let hemisphere = tag(&format!("{name}Ref"))?.trim().to_uppercase();
        let sign = match hemisphere {
            h if h == positive => 1.0,
            h if h == negative => -1.0,
            _ => return None,
        };
        Some(sign * value).filter(|v| v.abs() <= most)
    };
    let packet = set.metadata_domain("xml:XMP").map(|lines| lines.join("\n")).unwrap_or_default();
    let below = tag("GPSAltitudeRef").is_some_and(|r| r.trim().ends_with('1'));
    let height = number("GPSAltitude").filter(|h| *h != 0.0 && h.abs() < HIGHEST_M).map(|h| if below { -h } else { h });
    let height_m = height.or_else(|| of_xmp(&packet, "drone-dji:AbsoluteAltitude"));
    let place = degrees("GPSLongitude", ["E", "W"], 180.0).zip(degrees("GPSLatitude", ["N", "S"], 90.0));
    // A receiver without a fix writes zeros.
    let place = place.filter(|p| *p != (0.0, 0.0)).map(|(x, y)| [x, y]);
    let gimbal = |which: &str| of_xmp(&packet, &format!("drone-dji:Gimbal{which}Degree"));
    // Of a direction from magnetic north nobody says how far that is from true north.
    let magnetic = tag("GPSImgDirectionRef").is_some_and(|r| r.trim().eq_ignore_ascii_case("M"));
    let direction = || number("GPSImgDirection").filter(|_| !magnetic);
    Told {
        f_px,
        place,
        height_m,
        angles_deg: [gimbal("Yaw").or_else(direction), gimbal("Pitch"), gimbal("Roll")],
        sigma_m: rtk_sigma_m(&packet),
        above_start_m: of_xmp(&packet, "drone-dji:RelativeAltitude").filter(|h| h.abs() < HIGHEST_M),
    }
}

/// What DJI's receiver states of a position whose ambiguities are fixed: `RtkFlag` 50, and deviations of each axis.
fn rtk_sigma_m(packet: &str) -> Option<[f64; 2]> {
    const FIXED: f64 = 50.0;
    of_xmp(packet, "drone-dji:RtkFlag").filter(|flag| *flag == FIXED)?;
    let stated = |axis: &str| of_xmp(packet, &format!("drone-dji:RtkStd{axis}")).filter(|s| *s > 0.0 && *s < 1.0);
    Some([stated("Lon")?.max(stated("Lat")?), stated("Hgt")?])
}

/// A table of rough positions, and what is to be said of it.
pub struct RoughTable {
    pub text: String,
    pub crs: Crs,
    /// Height of the place of take-off, the median of what frames tell.
    pub start_m: Option<f64>,
    /// Frames whose position has deviations of its own in the table.
    pub fixed: usize,
    pub warnings: Vec<String>,
}

/// What the table says of how good positions are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Deviations {
    /// Those that receivers state.
    Stated,
    /// Nothing: GCPs and receivers may count in two datums, above all of heights.
    LeftOut,
}

/// The median; `None` of none.
pub fn median(values: Vec<f64>) -> Option<f64> {
    (!values.is_empty()).then(|| ranks::median(values))
}

/// The table of rough positions that frames tell, in `crs`, or in the UTM zone of the first; directions count from the
/// grid's north. Where a frame tells no height, the median of the others' stands in; `None` where fewer than two tell
/// their place, or none a height.
///
/// # Errors
/// When a position does not lie in the CRS.
pub fn table(names: &[String], told: &[Told], crs: Option<Crs>, deviations: Deviations) -> Result<Option<RoughTable>> {
    let placed: Vec<(&String, &Told, [f64; 2])> =
        names.iter().zip(told).filter_map(|(name, t)| Some((name, t, t.place?))).collect();
    let usual_m = median(placed.iter().filter_map(|(_, t, _)| t.height_m).collect());
    let start_m = median(placed.iter().filter_map(|(_, t, _)| Some(t.height_m? - t.above_start_m?)).collect());
    let (Some(usual_m), true) = (usual_m, placed.len() >= 2) else { return Ok(None) };
    let earth = Crs::from_epsg(4326)?;
    let crs = match crs {
        Some(crs) => crs,
        None => earth.utm_zone(placed[0].2[0], placed[0].2[1])?,
    };
    let mut warnings = Vec::new();
    let lost: Vec<String> =
        names.iter().zip(told).filter(|(_, t)| t.place.is_none()).map(|(name, _)| name.clone()).collect();
    if !lost.is_empty() {
        warnings.push(format!("no position in the EXIF of {}: not in the table", some_of(&lost)));
    }
    let without: Vec<String> =
        placed.iter().filter(|(_, t, _)| t.height_m.is_none()).map(|(name, ..)| (*name).clone()).collect();
    if !without.is_empty() {
        warnings.push(format!("no altitude in {}: {usual_m:.1} m, the median, stands in", some_of(&without)));
    }
    let row = |(name, told, [x, y]): &(&String, &Told, [f64; 2])| CameraRow {
        name: (*name).clone(),
        xyz: [*x, *y, told.height_m.unwrap_or(usual_m)],
        geographic: true,
        yaw_deg: told.angles_deg[0],
        ..CameraRow::default()
    };
    let rows = brought(placed.iter().map(row).collect(), Path::new("EXIF"), Some(&crs))?;
    let of_receiver = |told: &Told| told.sigma_m.filter(|_| deviations == Deviations::Stated);
    let fixed = placed.iter().filter(|(_, told, _)| of_receiver(told).is_some()).count();
    let mut text = "name,x,y,z,yaw,pitch,roll".to_string();
    text += if fixed > 0 { ",sigma_m,sigma_height_m\n" } else { "\n" };
    for (row, (name, told, _)) in rows.iter().zip(&placed) {
        let yaw = row.yaw_deg.map_or(String::new(), |a| format!("{:.3}", a.rem_euclid(360.0)));
        let [pitch, roll] =
            [told.angles_deg[1], told.angles_deg[2]].map(|a| a.map_or(String::new(), |a| a.to_string()));
        let [x, y, z] = row.xyz;
        text += &format!("\"{}\",{x:.3},{y:.3},{z:.3},{yaw},{pitch},{roll}", name.replace('"', "\"\""));
        text += &match (fixed, of_receiver(told)) {
            (0, _) => String::new(),
            (_, Some([plan, up])) => format!(",{plan},{up}"),
            (_, None) => ",,".into(),
        };
        text += "\n";
    }
    Ok(Some(RoughTable { text, crs, start_m, fixed, warnings }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_exif_and_xmp() {
        assert_eq!(numbers("(46) (31) (12.5)"), [46.0, 31.0, 12.5]);
        let packet = "<rdf drone-dji:GimbalYawDegree=\"+12.30\" drone-dji:GimbalPitchDegree=\"-89.9\"/>";
        assert_eq!(of_xmp(packet, "drone-dji:GimbalYawDegree"), Some(12.3));
        assert_eq!(of_xmp(packet, "drone-dji:GimbalPitchDegree"), Some(-89.9));
        let element = "<drone-dji:GimbalRollDegree>-1.5</drone-dji:GimbalRollDegree>";
        assert_eq!(of_xmp(element, "drone-dji:GimbalRollDegree"), Some(-1.5));
        assert_eq!(of_xmp(packet, "drone-dji:GimbalRollDegree"), None);
        let rtk = |flag: u32| {
            format!(
                "drone-dji:RtkFlag=\"{flag}\" drone-dji:RtkStdLon=\"0.011\" drone-dji:RtkStdLat=\"0.012\" drone-dji:RtkStdHgt=\"0.03\""
            )
        };
        assert_eq!(rtk_sigma_m(&rtk(50)), Some([0.012, 0.03]));
        // A float solution states deviations that nobody should trust.
        assert_eq!(rtk_sigma_m(&rtk(34)), None);
    }

    /// DJI's FC330, 3.61 mm over 6.25 mm of 4000 px, calls itself 20 mm.
    #[test]
    fn focal_lengths_of_small_pictures_count_by_the_diagonal() {
        let f_px = of_small_picture(20.0, [4000, 3000]);
        assert!((f_px - 3.61 / 6.25 * 4000.0).abs() < 5.0, "{f_px}");
    }

    #[test]
    fn positions_become_metres() {
        let told = |x: f64| Told {
            place: Some([x, 78.5]),
            height_m: (x < 15.05).then_some(500.0),
            angles_deg: [Some(90.0), None, None],
            sigma_m: (x < 15.05).then_some([0.02, 0.04]),
            above_start_m: Some(120.0),
            f_px: None,
        };
        let names = ["a.jpg".to_string(), "b.jpg".to_string()];
        let both = [told(15.0), told(15.1)];
        let made = table(&names, &both, None, Deviations::LeftOut).expect("inside").expect("two");
        assert_eq!((made.start_m, made.fixed), (Some(380.0), 0));
        assert_eq!(made.crs.label(), "EPSG:32633");
        let line = |n: usize| made.text.lines().nth(n).unwrap_or_default();
        assert!(line(1).starts_with("\"a.jpg\",500000.000,") && line(1).ends_with("500.000,90.000,,"), "{}", made.text);
        // The second tells no height, and true north is 0.1° · sin 78.5° to the left of the grid's there.
        assert!(line(2).ends_with(",500.000,89.902,,"), "{}", made.text);
        assert!(made.warnings.len() == 1 && made.warnings[0].contains("b.jpg"), "{:?}", made.warnings);
        assert!(table(&names[..1], &both[..1], None, Deviations::Stated).expect("inside").is_none());
        let stated = table(&names, &both, None, Deviations::Stated).expect("inside").expect("two");
        let ends: Vec<&str> = stated.text.lines().collect();
        assert!(stated.fixed == 1 && ends[0].ends_with(",sigma_m,sigma_height_m"), "{}", stated.text);
        assert!(ends[1].ends_with(",,0.02,0.04") && ends[2].ends_with(",,,"), "{}", stated.text);
    }
}
