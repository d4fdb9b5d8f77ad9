//! A flight as other programs read it.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Result, bail};
use autoref_flight::micmac_files::{self, Chain, FilmCamera, Masks, SurveyedPoint, TextFile};
use autoref_raster::atomic::{self, Existing};
use autoref_raster::output_folder::OutputFolder;
use autoref_raster::protected::same_file;

use super::project::{OrderedFrames, Project, ordered_frames, point_args, read_project};
use super::runs;
use super::{called, check_output, image_size, lists, worlds};

/// Size of a pixel on the film where none is stated: any will do, MicMac's focal length is in the same millimetres.
pub const PIXEL_MM: f64 = 0.01;

/// Write a flight as MicMac reads it: camera, pairs, masks, GCPs in the forms of v1 and of MMVII, and a script of its
/// commands.
#[derive(Debug, clap::Args)]
pub struct ExportArgs {
    /// The project file.
    project: PathBuf,
    /// The folder to write into.
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Size of a pixel on the film, with which the focal length is written in millimetres.
    #[arg(long, value_name = "MM", default_value_t = PIXEL_MM)]
    pixel_mm: f64,
    /// Replace existing outputs.
    #[arg(long)]
    overwrite: bool,
}

pub fn export(args: &ExportArgs) -> Result<ExitCode> {
    if !(args.pixel_mm > 0.0 && args.pixel_mm.is_finite()) {
        bail!("--pixel-mm: a positive number of millimetres is expected");
    }
    let (project, base) = read_project(&args.project)?;
    let mut flight = ordered_frames(&project, &base)?;
    let list = point_args(&project, &base).map(|points| points.load(None)).transpose()?;
    flight.rows_on_map(&project, &base, list.as_ref())?;
    let size = image_size(&flight.folder.join(&flight.names[0]), None)?.map(|v| v as usize);
    for note in flight.masks.leave_out_misfits(&flight.names, size.into())? {
        eprintln!("warning: {note}");
    }
    let files = files(&args.project, (&project, &base), &flight, args.pixel_mm)?;
    if let Some(global) = &flight.masks.global
        && same_file(&flight.masks.folder, &args.output)
    {
        bail!(
            "{}: what is joined with {} would lie there as the frames' own masks, and count as such from then on; name \
             another folder, and link the frames into it",
            args.output.display(),
            global.display()
        );
    }
    let _folder = OutputFolder::make(&args.output)?;
    let paths: Vec<PathBuf> = files.iter().map(|(name, _)| args.output.join(name)).collect();
    let names: Vec<&str> = flight.names.iter().map(String::as_str).collect();
    let masks = flight.masks.for_micmac(&names, &args.output);
    for path in paths.iter().chain(masks.iter().flat_map(|mask| [&mask.mask, &mask.xml])) {
        check_output(Some(path), Existing::of_flag(args.overwrite))?;
    }
    // The commands that read them come last: a mask that does not fit leaves none behind.
    for mask in &masks {
        flight.masks.write_for_micmac(&flight.folder, mask)?;
        println!("{}\n{}", mask.mask.display(), mask.xml.display());
    }
    for (path, (_, text)) in paths.iter().zip(&files) {
        atomic::write(path, text.as_bytes())?;
        println!("{}", path.display());
    }
    Ok(ExitCode::SUCCESS)
}

/// What MicMac reads of a flight; `file` is the project's, for messages, and `pixel_mm` the size of a pixel on the
/// film.
///
/// # Errors
/// When the project has no focal length, or its GCPs cannot be read.
pub fn files(
    file: &Path,
    (project, base): (&Project, &Path),
    flight: &OrderedFrames,
    pixel_mm: f64,
) -> Result<Vec<TextFile>> {
    let Some(f_px) = project.camera.f_px else {
        bail!("{}: MicMac needs a focal length; give camera.f_px", file.display())
    };
    flight.refuse_blanks(file, "rename the frames")?;
    let size = image_size(&flight.folder.join(&flight.names[0]), None)?;
    let camera = FilmCamera { name: "film".into(), f_mm: f_px * pixel_mm, size_mm: size.map(|s| s * pixel_mm) };
    // Alternatives in full: any pattern of the project may take files that are no frames.
    let names: Vec<String> = flight.names.iter().map(|n| escaped(n)).collect();
    let images = format!("({})", names.join("|"));
    let listed: Vec<&str> = flight.names.iter().map(String::as_str).collect();
    let near = runs::plan(project, &listed, &flight.rows, None).pairs;
    let pairs: Vec<(String, String)> =
        near.into_iter().map(|(a, b)| (flight.names[a].clone(), flight.names[b].clone())).collect();
    let mut files = vec![micmac_files::camera_database(&camera, &images), micmac_files::image_pairs(&pairs)];
    if let Some(gcps) = &project.gcps {
        let list = base.join(&gcps.list);
        let observations = gcps.observations.as_ref().map(|o| base.join(o));
        let control = lists::load(&list, observations.as_deref(), project.crs.as_deref(), None)?;
        let [unit_m, height_unit_m] =
            control.crs.as_ref().map_or([1.0; 2], |crs| [crs.metres_per_unit(), worlds::height_unit_m(crs)]);
        if (unit_m / height_unit_m - 1.0).abs() > 1e-4 {
            bail!(
                "{}: its heights count in another unit ({height_unit_m} m) than its eastings ({unit_m} m), and MicMac \
                 knows one; give a list in one unit",
                list.display()
            );
        }
        // MicMac counts deviations as it does coordinates.
        let sigma_ground = gcps.sigma_ground_m / unit_m;
        let points: Vec<SurveyedPoint> = control
            .points
            .into_iter()
            .filter(|p| !p.check && !gcps.check.iter().any(|wanted| called::is_called(&p.name, wanted)))
            .map(|p| SurveyedPoint {
                sigma_m: p.sigma_or(gcps.sigma_ground_m).map(|m| m / unit_m),
                name: p.name,
                xyz: p.xyz,
                seen: p.seen,
            })
            .collect();
        files.extend(micmac_files::points_v1("GCP", &points));
        files.extend(micmac_files::points_mmvii("GCP", &points, gcps.sigma_image_px));
        let masks = if flight.masks.files(&listed).is_empty() { Masks::None } else { Masks::Beside };
        // Without points in the images there is nothing for them to do.
        if points.iter().any(|p| !p.seen.is_empty()) {
            files.push(micmac_files::commands(&Chain {
                images: &images,
                points: "GCP",
                masks,
                sigma_ground,
                sigma_px: gcps.sigma_image_px,
                principal_point: principal_point(project, size),
            }));
        } else {
            eprintln!(
                "autoref-stream: no GCP is measured in an image: no commands for MicMac; name [gcps] observations"
            );
        }
    }
    Ok(files)
}

/// The project's principal point as Tapas takes it: as shares of the frame.
fn principal_point(project: &Project, size_px: [f64; 2]) -> Option<[f64; 2]> {
    let pp_px = project.camera.pp_px?;
    let shares = [0, 1].map(|axis| pp_px[axis] / size_px[axis]);
    if shares.iter().all(|share| *share >= 0.0) {
        return Some(shares);
    }
    eprintln!(
        "autoref-stream: camera.pp_px {}, {} lies left of or above the frame, which Tapas takes for none: it starts from \
         the frame's middle",
        pp_px[0], pp_px[1]
    );
    None
}

/// A name as a regular expression that takes it alone.
fn escaped(name: &str) -> String {
    let special = |c: char| "\\.+*?()|[]{}^$".contains(c);
    name.chars().flat_map(|c| special(c).then_some('\\').into_iter().chain([c])).collect()
}

#[cfg(test)]
mod tests {
    #[test]
    fn names_are_taken_literally() {
        assert_eq!(super::escaped("S36 (1)_a.tif"), "S36 \\(1\\)_a\\.tif");
    }
}
