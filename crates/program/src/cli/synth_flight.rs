//! `autoref-stream synth-flight`: a flight with known truth.

mod control;
mod files;
mod film;

use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use autoref_flight::render::{Effects, FrameRenderer, Landscape, Plan};
use autoref_flight::{Camera, Parameter};
use autoref_raster::atomic::refuse_left_behind;
use autoref_raster::output_folder::OutputFolder;

use super::flight::ortho::Dem;
use super::synth::Pair;
use crate::cli::values::positive;

/// Render the frames of a flight over a known landscape, with a rough camera table, GCPs and the truth beside them;
/// ready for `flight solve`.
///
/// The world is flat and metric: `crs = "local"`, whatever the CRS of a model.
#[derive(clap::Args, Debug)]
pub struct Args {
    /// Folder for all files.
    output: PathBuf,
    /// Elevation model of the ground. Default: a drawn landscape.
    #[arg(long, value_name = "FILE", help_heading = "Landscape")]
    dem: Option<PathBuf>,
    /// Image of the ground (an orthophoto in the model's CRS); where it does not reach, the cover is drawn.
    #[arg(long, value_name = "FILE", requires = "dem", help_heading = "Landscape")]
    image: Option<PathBuf>,
    /// Height of the highest ridges of a drawn landscape.
    #[arg(long, value_name = "M", default_value_t = 900.0, value_parser = positive, help_heading = "Landscape")]
    relief: f64,
    /// Height of the sea; none over a model unless it is given.
    #[arg(long, value_name = "M", allow_hyphen_values = true, help_heading = "Landscape")]
    sea_level: Option<f64>,
    /// Middle of the flight on the map. Default: the middle of the model.
    #[arg(long, value_name = "E,N", allow_hyphen_values = true, help_heading = "Flight")]
    centre: Option<Pair>,
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..=500), help_heading = "Flight")]
    lines: u64,
    /// Frames of a line.
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u64).range(1..=5000), help_heading = "Flight")]
    frames: u64,
    /// From frame to frame. Default: 0.6 of the flying height.
    #[arg(long, value_name = "M", value_parser = positive, help_heading = "Flight")]
    base: Option<f64>,
    /// From line to line. Default: the flying height.
    #[arg(long, value_name = "M", value_parser = positive, help_heading = "Flight")]
    spacing: Option<f64>,
    /// Flying height above the middle height of the ground.
    #[arg(long, value_name = "M", default_value_t = 3000.0, value_parser = positive, help_heading = "Flight")]
    height: f64,
    /// Direction of flight, degrees clockwise from north.
    #[arg(long, value_name = "DEG", default_value_t = 90.0, allow_hyphen_values = true, help_heading = "Flight")]
    heading: f64,
    /// Elevation of the view: -90 straight down, -20 towards just below the horizon.
    #[arg(long, value_name = "DEG", default_value_t = -90.0, allow_hyphen_values = true, value_parser = downwards,
        help_heading = "Flight")]
    pitch: f64,
    /// Direction of the view against the direction of flight. Default: 0 straight down, else -90 (to the left).
    #[arg(long, value_name = "DEG", allow_hyphen_values = true, help_heading = "Flight")]
    look: Option<f64>,
    /// 1σ of the true positions and angles about the plan.
    #[arg(long, value_name = "M,DEG", default_value = "20,0.8", help_heading = "Flight")]
    jitter: Pair,
    /// Width and height of a frame, pixels.
    #[arg(long, value_name = "W,H", default_value = "1800,1800", help_heading = "Camera")]
    size: Pair,
    /// Scans of film instead, turned and shifted, with the fiducial marks of a camera: a name of
    /// `fiducials --list-cameras` or a TOML file. `fiducials --resample` makes the frames of them; size and focal
    /// length are the camera's.
    #[arg(long, value_name = "CAMERA", conflicts_with = "size", help_heading = "Camera")]
    film: Option<String>,
    /// Size of a scanned pixel on the film, micrometres.
    #[arg(long, value_name = "UM", default_value_t = 100.0, value_parser = positive, requires = "film", help_heading = "Camera")]
    film_um: f64,
    /// Focal length. Default: 1.17 times the width, as a 21 cm lens on 18 cm film has.
    #[arg(long, value_name = "PX", value_parser = positive, help_heading = "Camera")]
    f_px: Option<f64>,
    /// Principal point against the middle of the frame.
    #[arg(long, value_name = "X,Y", default_value = "0,0", allow_hyphen_values = true, help_heading = "Camera")]
    pp_offset: Pair,
    /// Distortion, such as k1=-0.01,k2=0.002,p1=0.0001.
    #[arg(long, value_name = "LIST", value_delimiter = ',', allow_hyphen_values = true, help_heading = "Camera")]
    distortion: Vec<String>,
    /// 1σ of the rough table's positions and directions.
    #[arg(long, value_name = "M,DEG", default_value = "200,1", help_heading = "Control")]
    table_errors: Pair,
    /// GCPs with errors on the ground, and check points without.
    #[arg(long, value_name = "N,N", default_value = "12,12", help_heading = "Control")]
    points: Pair,
    /// 1σ of GCPs on the ground.
    #[arg(long, value_name = "M", default_value_t = 25.0, help_heading = "Control")]
    sigma_ground: f64,
    /// 1σ of all points in the image.
    #[arg(long, value_name = "PX", default_value_t = 0.7, help_heading = "Control")]
    sigma_image: f64,
    /// Grey frames, as of film. Default: colour.
    #[arg(long, help_heading = "Picture")]
    grey: bool,
    /// 1σ of grain, of 255.
    #[arg(long, value_name = "SD", default_value_t = 4.0, help_heading = "Picture")]
    grain: f64,
    /// Distance over which haze takes 63 % of the light, km.
    #[arg(long, value_name = "KM", value_parser = positive, help_heading = "Picture")]
    haze: Option<f64>,
    /// Share of the sky under clouds, 0 to 1, in a layer at a third of the flying height.
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, help_heading = "Picture")]
    clouds: f64,
    /// The sea mirrors the sun.
    #[arg(long, help_heading = "Picture")]
    glint: bool,
    /// Share of the light that is lost in the corners.
    #[arg(long, value_name = "SHARE", default_value_t = 0.25, help_heading = "Picture")]
    vignetting: f64,
    /// Azimuth and elevation of the sun.
    #[arg(long, value_name = "DEG,DEG", default_value = "160,35", help_heading = "Picture")]
    sun: Pair,
    /// Rays across a pixel, each way.
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = clap::value_parser!(u64).range(1..=8), help_heading = "Picture")]
    samples: u64,
    /// What makes the same flight again.
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Number of working threads. Default: one for each core.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=1024))]
    threads: Option<u64>,
    /// Replace existing files.
    #[arg(long)]
    overwrite: bool,
}

fn downwards(text: &str) -> Result<f64, String> {
    let value = text.trim().parse::<f64>().ok().filter(|v| (-90.0..=0.0).contains(v));
    value.ok_or_else(|| format!("`{text}`: the view is from -90 (straight down) to 0 (the horizon)"))
}

/// Largest number of cells of an elevation model that is held.
const MOST_CELLS: u64 = 64 << 20;
/// Cells of a drawn landscape along its side.
const DRAWN_CELLS: f64 = 2_600.0;

pub fn run(args: &Args) -> Result<()> {
    args.check()?;
    if let Some(threads) = args.threads {
        // Fails only when a pool exists already, which then serves.
        let _ = rayon::ThreadPoolBuilder::new().num_threads(threads as usize).build_global();
    }
    autoref_raster::initialise_gdal(64 << 20);
    let film = args.film.as_ref().map(|name| film::Film::new(name, args.film_um)).transpose()?;
    let camera = args.camera(film.as_ref())?;
    let (landscape, centre) = args.landscape()?;
    let ground_m = landscape.surface.height(centre[0], centre[1]).unwrap_or(landscape.surface.range()[0]);
    let plan = args.plan(centre, ground_m);
    let effects = args.effects(ground_m);
    let exposures = plan.exposures(args.seed);
    let ending = if film.is_some() { "resampled.tif" } else { "tif" };
    let names: Vec<String> = exposures.iter().map(|exposure| format!("{}.{ending}", exposure.name)).collect();
    let bands = if args.grey || film.is_some() { 1 } else { 3 };
    let frames: Vec<FrameRenderer<'_>> = exposures
        .iter()
        .map(|exposure| FrameRenderer { landscape: &landscape, camera: &camera, exposure, effects: &effects, bands })
        .collect();
    let (gcps, checks) = (args.points.0 as usize, args.points.1 as usize);
    let control = control::draw(&frames, gcps, checks, [args.sigma_ground, args.sigma_image], args.seed)
        .with_context(|| format!("{}: no flight was written", args.output.display()))?;
    let folder = args.output.join(if film.is_some() { "scans" } else { "frames" });
    let _folder = OutputFolder::make(&folder)?;
    let frame_path = |frame: &FrameRenderer<'_>| folder.join(format!("{}.tif", frame.exposure.name));
    let beside = files::BESIDE.iter().map(|name| args.output.join(name));
    let model = args.dem.is_none().then(|| args.output.join(files::MODEL));
    for path in frames.iter().map(frame_path).chain(beside).chain(model).filter(|_| !args.overwrite) {
        if path.exists() {
            bail!("{}: exists already; use --overwrite or another folder", path.display());
        }
        refuse_left_behind(&path)?;
    }
    for frame in &frames {
        let path = frame_path(frame);
        match &film {
            Some(film) => film.write(frame, &path)?,
            None => files::write_frame(frame, &path)?,
        }
        println!("{}: {} x {} px", path.display(), camera.size_px[0], camera.size_px[1]);
    }
    let resampled = film.as_ref().map(|film| resampled(&camera, film));
    let flight = files::Flight {
        camera: resampled.as_ref().unwrap_or(&camera),
        offset_px: film.as_ref().map_or([0.0; 2], film::Film::resampled_px),
        exposures: &exposures,
        names: &names,
        control: &control,
        ground_m,
        sigmas: [args.sigma_ground, args.sigma_image],
        table_errors: [args.table_errors.0, args.table_errors.1],
        seed: args.seed,
    };
    for path in flight.write(&args.output)? {
        println!("{}", path.display());
    }
    if args.dem.is_none() {
        let path = args.output.join(files::MODEL);
        files::write_model(&landscape, &path)?;
        println!("{}", path.display());
    }
    if let (Some(film), Some(name)) = (&film, &args.film) {
        println!("Next: autoref-stream {}", film.command(&args.output, name));
    }
    Ok(())
}

/// The camera of the frames that are made of the scans.
fn resampled(camera: &Camera, film: &film::Film) -> Camera {
    let ([dx, dy], [cx, cy]) = (film.resampled_px(), camera.pp_px());
    let mut moved = camera.clone();
    moved.size_px = film.resampled_size_px();
    moved.set(Parameter::Cx, cx + dx);
    moved.set(Parameter::Cy, cy + dy);
    moved
}

impl Args {
    fn check(&self) -> Result<()> {
        let whole = |v: f64| (16.0..=60_000.0).contains(&v) && v.fract() == 0.0;
        if !whole(self.size.0) || !whole(self.size.1) {
            bail!("--size takes width and height in whole pixels, 16 to 60000");
        }
        for (name, share) in [("--clouds", self.clouds), ("--vignetting", self.vignetting)] {
            if !(0.0..=1.0).contains(&share) {
                bail!("{name} takes a share from 0 to 1");
            }
        }
        let least_zero = [
            ("--grain", self.grain),
            ("--sigma-ground", self.sigma_ground),
            ("--sigma-image", self.sigma_image),
            ("--table-errors", self.table_errors.0.min(self.table_errors.1)),
            ("--jitter", self.jitter.0.min(self.jitter.1)),
            ("--points", self.points.0.min(self.points.1)),
        ];
        if let Some((name, value)) = least_zero.iter().find(|(_, value)| !(*value >= 0.0 && value.is_finite())) {
            bail!("{name}: {value} is below 0");
        }
        if self.points.0.max(self.points.1) > 10_000.0 {
            bail!("--points takes at most 10000 of each");
        }
        if !(1.0..=90.0).contains(&self.sun.1) {
            bail!("--sun: the sun stands 1 to 90 degrees above the horizon");
        }
        Ok(())
    }

    fn camera(&self, film: Option<&film::Film>) -> Result<Camera> {
        let size = film.map_or([self.size.0, self.size.1], film::Film::size_px);
        let pp = [size[0] / 2.0 + self.pp_offset.0, size[1] / 2.0 + self.pp_offset.1];
        let mut camera =
            Camera::pinhole("synth", size, self.f_px.or(film.and_then(film::Film::f_px)).unwrap_or(1.17 * size[0]), pp);
        for entry in &self.distortion {
            let parameter = entry.split_once('=').and_then(|(name, value)| {
                let parameter = Parameter::by_name(name.trim())?;
                let lens = !matches!(parameter, Parameter::F | Parameter::Aspect | Parameter::Cx | Parameter::Cy);
                lens.then_some((parameter, value.trim().parse::<f64>().ok()?))
            });
            let Some((parameter, value)) = parameter else {
                bail!(
                    "--distortion: `{entry}` is not like k1=-0.01; names are k1 … k6, d1 … d3, p1, p2, b1, b2, dx, dy"
                );
            };
            camera.set(parameter, value);
        }
        let corners = [[0.0, 0.0], [size[0], 0.0], [0.0, size[1]], size];
        if corners.iter().any(|corner| camera.ray(*corner).is_none()) {
            bail!("--distortion: no ray comes through the frame's corners; the lens folds there");
        }
        Ok(camera)
    }

    fn landscape(&self) -> Result<(Landscape, [f64; 2])> {
        let Some(path) = &self.dem else {
            let centre = self.centre.as_ref().map_or([0.0, 0.0], |c| [c.0, c.1]);
            // As far as is seen, and the flight itself.
            let flown = self.frames as f64 * self.base() + self.lines as f64 * self.spacing.unwrap_or(self.height);
            let seen = if self.pitch > -60.0 { 12.0 * self.height } else { 3.0 * self.height };
            let side = flown + 2.0 * seen;
            let mut landscape = Landscape::drawn(self.seed, centre, side, side / DRAWN_CELLS, self.relief);
            landscape.sea_level_m = Some(self.sea_level.unwrap_or(0.0));
            return Ok((landscape, centre));
        };
        let dem = Dem::open(path)?;
        let window = autoref_raster::window::Window::whole(dem.grid.width, dem.grid.height);
        let surface = dem.surface(path, window, MOST_CELLS)?;
        let [low, high] = surface.range();
        let middle = |start: f64, step: f64, n: u64| start + step * n as f64 / 2.0;
        let g = &dem.grid;
        let in_metres = |of_map: f64| of_map * dem.unit_m;
        let centre = self
            .centre
            .as_ref()
            .map_or([middle(g.x0, g.step_x, g.width), middle(g.y0, g.step_y, g.height)], |c| [c.0, c.1].map(in_metres));
        let cover = self.image.as_deref().map(|image| files::read_cover(image, dem.unit_m)).transpose()?;
        let snow_line_m = low + 0.62 * (high - low);
        let landscape = Landscape { surface, cover, seed: self.seed, sea_level_m: self.sea_level, snow_line_m };
        Ok((landscape, centre))
    }

    fn base(&self) -> f64 {
        self.base.unwrap_or(0.6 * self.height)
    }

    fn plan(&self, centre: [f64; 2], ground_m: f64) -> Plan {
        Plan {
            lines: self.lines as usize,
            frames_per_line: self.frames as usize,
            base_m: self.base(),
            spacing_m: self.spacing.unwrap_or(self.height),
            centre,
            height_m: ground_m + self.height,
            heading_deg: self.heading,
            pitch_deg: self.pitch,
            look_deg: self.look.unwrap_or(if self.pitch > -60.0 { -90.0 } else { 0.0 }),
            jitter_m: self.jitter.0,
            jitter_deg: self.jitter.1,
        }
    }

    fn effects(&self, ground_m: f64) -> Effects {
        Effects {
            sun_deg: [self.sun.0, self.sun.1],
            haze_m: self.haze.map(|km| 1000.0 * km),
            clouds: self.clouds,
            cloud_height_m: ground_m + self.height / 3.0,
            glint: self.glint,
            vignetting: self.vignetting,
            grain: self.grain,
            samples: self.samples as usize,
        }
    }
}
