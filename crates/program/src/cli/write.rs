//! Flags for what is written, shared by the main job and `apply`.

use std::path::{Path, PathBuf};

use autoref_raster::atomic::Existing;
use autoref_raster::error::Error;
use autoref_raster::output_folder::OutputFolder;
use autoref_raster::tile_folder;
use autoref_stream::georef::output::Output;
use autoref_stream::georef::shown;
use autoref_stream::georef::warp::{Border, Compression, Resampling, WarpOptions};
use autoref_stream::georef::write::WriteRequest;
use clap::Args;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use crate::cli::progress::Telling;

/// What is written and where.
#[derive(Args, Debug)]
pub struct WriteArgs {
    /// What to write. Default: world,aux, and vrt too with --out and for an image of which GDAL passes these over; for
    /// a folder or list of tiles only vrt.
    #[arg(long, value_name = "KIND,…", value_delimiter = ',', value_parser = kinds(), help_heading = "Output")]
    pub write: Vec<Output>,
    /// Write here instead of beside the image.
    #[arg(long, value_name = "DIR", help_heading = "Output")]
    pub out: Option<PathBuf>,
    /// Replace outputs that exist; without it they are an error before any work.
    #[arg(long, help_heading = "Output")]
    pub overwrite: bool,
    /// With --write tags: a Cloud Optimized GeoTIFF may become an ordinary one.
    #[arg(long, help_heading = "Output")]
    pub break_cog: bool,
    #[command(flatten)]
    pub warp: WarpArgs,
}

/// The north-up copy of `--write warp`.
#[derive(Args, Debug)]
pub struct WarpArgs {
    /// How a pixel of the copy is made of those around it. Default: bilinear.
    #[arg(long, value_name = "HOW", value_parser = names::<Resampling>(Resampling::ALL.map(Resampling::name)),
        help_heading = "Output: warp")]
    pub resampling: Option<Resampling>,
    /// Compression of the copy; jpeg and webp lose detail. Default: deflate.
    #[arg(long, value_name = "HOW", value_parser = names::<Compression>(Compression::ALL.map(Compression::name)),
        help_heading = "Output: warp")]
    pub compress: Option<Compression>,
    /// Quality of jpeg and webp, 1 to 100. Default: 75.
    #[arg(long, value_name = "Q", value_parser = clap::value_parser!(u8).range(1..=100), help_heading = "Output: warp")]
    pub quality: Option<u8>,
    /// Side of a pixel of the copy, in map units. Default: that of the image.
    #[arg(long, value_name = "M", help_heading = "Output: warp")]
    pub resolution: Option<f64>,
    /// What is where no image is: alpha (one more band), or a nodata value. Default: the image's nodata value if it has
    /// one, -9999 for elevation models without, else alpha.
    #[arg(long, value_name = "alpha|VALUE", allow_hyphen_values = true, help_heading = "Output: warp")]
    pub border: Option<Border>,
}

impl WarpArgs {
    /// An option of the copy that was given.
    fn given(&self) -> Option<&'static str> {
        let given = [
            ("--resampling", self.resampling.is_some()),
            ("--compress", self.compress.is_some()),
            ("--quality", self.quality.is_some()),
            ("--resolution", self.resolution.is_some()),
            ("--border", self.border.is_some()),
        ];
        given.into_iter().find(|(_, is_given)| *is_given).map(|(option, _)| option)
    }
}

fn names<T>(names: impl IntoIterator<Item = &'static str>) -> impl TypedValueParser<Value = T>
where
    T: std::str::FromStr<Err = String> + Clone + Send + Sync + 'static,
{
    PossibleValuesParser::new(names).try_map(|name| name.parse::<T>())
}

fn kinds() -> impl TypedValueParser<Value = Output> {
    let values = Output::ALL.map(|kind| PossibleValue::new(kind.name()).help(kind.describe()));
    PossibleValuesParser::new(values).try_map(|name| name.parse::<Output>())
}

impl WriteArgs {
    fn kinds(&self, image: &Path, page: usize) -> Vec<Output> {
        match (self.write.is_empty(), &self.out) {
            // The tiles' own world files are what places them: nothing replaces them unasked.
            (true, _) if tile_folder::is_tile_folder(image) => vec![Output::Vrt],
            (false, _) => self.write.clone(),
            (true, None) if shown::heeds_sidecars(image, page) => vec![Output::World, Output::Aux],
            (true, _) => vec![Output::World, Output::Aux, Output::Vrt],
        }
    }

    /// An option of a kind that is not written would be left out without a word.
    fn refuse_what_has_no_effect(&self, kinds: &[Output]) -> Result<(), Error> {
        let unused = match self.warp.given() {
            Some(option) if !kinds.contains(&Output::Warp) => Some((option, "warp")),
            _ => (self.break_cog && !kinds.contains(&Output::Tags)).then_some(("--break-cog", "tags")),
        };
        let is_lossy = matches!(self.warp.compress, Some(Compression::Jpeg | Compression::Webp));
        if unused.is_none() && self.warp.quality.is_some() && !is_lossy {
            return Err(Error::usage(
                "--quality is of jpeg and webp, and the copy is compressed without loss",
                "give --compress jpeg or webp, or leave --quality out",
            ));
        }
        unused.map_or(Ok(()), |(option, kind)| {
            Err(Error::usage(
                format!("{option} belongs to --write {kind}, and {kind} is not written"),
                format!("add {kind} to --write, or leave {option} out"),
            ))
        })
    }

    /// The folder of `--out`, for as long as the run lasts.
    pub fn folder(&self) -> anyhow::Result<Option<OutputFolder>> {
        Ok(self.out.as_deref().map(OutputFolder::make).transpose()?)
    }

    /// What these flags ask for, checked as far as that goes before any work.
    pub fn request(
        &self,
        image: &Path,
        page: usize,
        memory_budget_bytes: u64,
        threads: usize,
    ) -> anyhow::Result<WriteRequest> {
        let kinds = self.kinds(image, page);
        self.refuse_what_has_no_effect(&kinds)?;
        let mut request = WriteRequest::new(image, self.out.as_deref(), &kinds, Existing::of_flag(self.overwrite));
        request.page = page;
        request.tags.break_cog = self.break_cog;
        request.warp = WarpOptions {
            resampling: self.warp.resampling.unwrap_or_default(),
            compression: self.warp.compress.unwrap_or_default(),
            quality: self.warp.quality,
            resolution: self.warp.resolution,
            border: self.warp.border.unwrap_or_default(),
            memory_budget_bytes,
            threads,
        };
        request.check()?;
        Ok(request)
    }
}

/// How far the warped copy is.
pub struct WarpBar(ProgressBar);

impl WarpBar {
    /// Shown where a warped copy is asked for.
    pub fn new(request: &WriteRequest, telling: Telling) -> Self {
        let bar = ProgressBar::new(1000);
        if telling == Telling::Silent || !request.wants(Output::Warp) {
            bar.set_draw_target(ProgressDrawTarget::hidden());
        }
        let style = ProgressStyle::with_template("{spinner} warping {wide_bar} {percent} %  {eta} left")
            .expect("a fixed template");
        bar.set_style(style);
        WarpBar(bar)
    }

    /// From 0 to 1; answers whether to go on.
    pub fn set(&self, done: f64) -> bool {
        self.0.set_position((done.clamp(0.0, 1.0) * 1000.0) as u64);
        true
    }
}

impl Drop for WarpBar {
    fn drop(&mut self) {
        self.0.finish_and_clear();
    }
}
