//! `autoref-stream synth-film`: scanned film with known truth.

use std::path::PathBuf;

use anyhow::bail;
use autoref_film::drawn::{FilmGround, FilmScene, FilmSpec, write_film};
use autoref_film::load_camera;
use autoref_raster::atomic::refuse_left_behind;
use autoref_raster::output_folder::OutputFolder;
use autoref_synth::photographs;
use clap::Args;

/// Make scanned film frames of a camera with marks at known places, and the truth beside each (NAME.truth.json).
#[derive(Args, Debug)]
pub struct SynthFilmArgs {
    /// Folder for the frames.
    output: PathBuf,
    /// The camera: a name of fiducials --list-cameras or a TOML file.
    #[arg(long, value_name = "NAME|FILE")]
    camera: String,
    /// Number of frames.
    #[arg(long, value_name = "N", default_value_t = 1)]
    frames: u64,
    /// Seed of the first frame; the next ones count up.
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Size of a scanned pixel on the film, micrometres.
    #[arg(long, value_name = "UM", default_value_t = 20.0)]
    pixel_um: f64,
    /// Photographs to lie under the marks, or folders of them. Default: a landscape of noise.
    #[arg(long, value_name = "FILE|DIR")]
    photos: Vec<PathBuf>,
    /// Frames as an archive has them: scratches, dust, text boxes, vignette, bands, dark, saturated and cropped ones.
    #[arg(long)]
    archive: bool,
    /// Quarters of a turn, clockwise.
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u8).range(0..4))]
    quarters: u8,
    /// Show the film from the wrong side.
    #[arg(long)]
    mirrored: bool,
    /// Shift of the film in the scan, millimetres right and down.
    #[arg(long, value_name = "X,Y", default_value = "0,0", allow_hyphen_values = true)]
    offset_mm: super::synth::Pair,
    /// Tiles of N pixels, a multiple of 16; 0 for strips.
    #[arg(long, value_name = "N", default_value_t = 512)]
    tiles: u64,
    /// Replace existing frames.
    #[arg(long)]
    overwrite: bool,
}

pub fn run(args: &SynthFilmArgs) -> anyhow::Result<()> {
    if !(2.0..=500.0).contains(&args.pixel_um) {
        bail!("--pixel-um must be between 2 and 500 micrometres");
    }
    let camera = load_camera(&args.camera)?;
    let ground =
        if args.photos.is_empty() { FilmGround::Noise } else { FilmGround::open(&photographs(&args.photos)?)? };
    let _folder = OutputFolder::make(&args.output)?;
    let seeds = || args.seed..args.seed.saturating_add(args.frames);
    let path_of = |seed: u64| args.output.join(format!("{}-{seed}.tif", camera.name));
    if let Some(path) = seeds().map(path_of).find(|path| path.exists() && !args.overwrite) {
        bail!("{}: exists already; use --overwrite or another folder", path.display());
    }
    if !args.overwrite {
        seeds().try_for_each(|seed| refuse_left_behind(&path_of(seed)))?;
    }
    for seed in seeds() {
        let path = path_of(seed);
        let mut spec = if args.archive {
            FilmSpec::archive(&camera, args.pixel_um, seed)
        } else {
            FilmSpec::plain(&camera, args.pixel_um, seed)
        };
        spec.quarters = args.quarters;
        spec.mirrored = args.mirrored.into();
        spec.offset_mm[0] += args.offset_mm.0;
        spec.offset_mm[1] += args.offset_mm.1;
        let scene = FilmScene::new(&spec, &ground)?;
        write_film(&scene, &path, args.tiles)?;
        println!("{}: {} x {} px", path.display(), scene.truth().width, scene.truth().height);
    }
    Ok(())
}
