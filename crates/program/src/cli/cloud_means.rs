//! Means that all cloud commands share.

use std::path::{Path, PathBuf};

use anyhow::bail;
use autoref_cloud::{io, params};
use autoref_raster::crs::Crs;
use autoref_raster::memory_plan::SMALLEST_BUDGET_BYTES;
use clap::Args;

use crate::cli::prepare;
use crate::cli::values::Bytes;

/// Means that all cloud commands share.
#[derive(Args, Debug)]
pub struct MeansArgs {
    /// Map coordinates less the clouds' own: what was taken off before they were written. Default: what a file says.
    #[arg(long, value_name = "E,N,H", allow_hyphen_values = true, help_heading = "Reading")]
    pub shift: Option<String>,
    /// Coordinate reference system of clouds that name none (EPSG code, WKT, PROJ string or a file with one).
    #[arg(long, value_name = "CRS", help_heading = "Reading")]
    pub crs: Option<String>,
    /// Bound on the peak resident memory: bytes, or with K, M or G. At least 112M.
    #[arg(long, value_name = "SIZE", default_value = "512M", help_heading = "Resources")]
    pub memory: Bytes,
    /// Number of working threads. Default: one for each core.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=1024), help_heading = "Resources")]
    pub threads: Option<u64>,
    /// Folder for temporary tiles, which are removed in any case. Default: the output's folder.
    #[arg(long, value_name = "DIR", help_heading = "Resources")]
    pub scratch: Option<PathBuf>,
    /// Replace existing outputs.
    #[arg(long, help_heading = "Writing")]
    pub overwrite: bool,
    /// Print what was done as one JSON document.
    #[arg(long, help_heading = "Writing")]
    pub json: bool,
}

impl MeansArgs {
    pub fn shift(&self) -> anyhow::Result<Option<[f64; 3]>> {
        Ok(self.shift.as_deref().map(|text| params::shift("--shift", text)).transpose()?)
    }

    /// Checks memory and clouds, starts the threads.
    pub fn begin(&self, clouds: &[PathBuf]) -> anyhow::Result<Begun> {
        if self.memory.0 < SMALLEST_BUDGET_BYTES {
            bail!("--memory is {} bytes; give 112M or more", self.memory.0);
        }
        autoref_raster::initialise_gdal(64 << 20);
        // Fails only when a pool exists already, which then serves.
        let _ = rayon::ThreadPoolBuilder::new().num_threads(prepare::threads(self.threads)).build_global();
        let asked = self.crs.as_deref().map(Crs::parse).transpose()?;
        let mut of_clouds = asked.clone();
        let mut first: Option<(&Path, String)> =
            self.crs.as_deref().map(|text| (Path::new("--crs"), label(text, asked.as_ref())));
        for cloud in clouds {
            let (header, _) = io::open(cloud)?;
            let Some(text) = header.crs else { continue };
            let crs = Crs::parse(&text).ok();
            // What is not understood gives way to --crs.
            if crs.is_none() && asked.is_some() {
                continue;
            }
            let label = label(&text, crs.as_ref());
            of_clouds = of_clouds.or(crs);
            match &first {
                Some((other, known)) if *known != label => bail!(
                    "{}: its reference system is {}, that of {} is {}; give clouds of one system at a time",
                    cloud.display(),
                    short(&label),
                    other.display(),
                    short(known)
                ),
                Some(_) => {}
                None => first = Some((cloud, label)),
            }
        }
        Ok(Begun { asked, of_clouds })
    }
}

/// The reference systems of a run.
pub struct Begun {
    /// That of --crs.
    pub asked: Option<Crs>,
    /// What the clouds are in, by themselves or by --crs.
    pub of_clouds: Option<Crs>,
}

/// By what reference systems are compared: heights that codes name beside the map make no difference.
fn label(text: &str, crs: Option<&Crs>) -> String {
    match text.strip_prefix("EPSG:").and_then(|codes| codes.split_once('+')) {
        Some((code, _)) => format!("EPSG:{code}"),
        None => crs.map_or_else(|| text.to_string(), Crs::label),
    }
}

/// A reference system by its name, where it has no code.
fn short(label: &str) -> &str {
    if label.contains('[') { label.split('"').nth(1).unwrap_or(label) } else { label }
}
