//! Where the cameras of clouds stood.

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use autoref_cloud::io::stem;
use autoref_cloud::params;
use autoref_raster::bounded;

/// A camera's place for each cloud.
pub enum Cameras {
    One([f64; 3]),
    /// Names of clouds, without folder and extension, and their cameras.
    Table(PathBuf, Vec<(String, [f64; 3])>),
}

impl Cameras {
    /// `E,N,H`, a table with the columns cloud, E, N, H, or a MicMac orientation with a `<Centre>`.
    pub fn read(text: &str) -> anyhow::Result<Cameras> {
        let path = Path::new(text);
        if !path.exists() {
            if !text.contains(',') {
                bail!("--range-from {text}: there is no such file; give E,N,H, or the name of a table cloud,E,N,H");
            }
            let numbers = params::numbers("--range-from", text, "E,N,H, or the name of a table cloud,E,N,H");
            return Ok(Cameras::One(numbers?));
        }
        let content = bounded::read_to_string(path, "a table of cameras", bounded::TEXT_BYTES)?;
        if let Some((_, rest)) = content.split_once("<Centre>") {
            let words = rest.split('<').next().unwrap_or_default().split_whitespace().collect::<Vec<_>>().join(",");
            return Ok(Cameras::One(params::numbers("--range-from", &words, "with a centre of three numbers")?));
        }
        let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(content.as_bytes());
        let heads: Vec<String> = reader.headers()?.iter().map(str::to_ascii_lowercase).collect();
        let column = |name: &str| {
            heads
                .iter()
                .position(|head| head == name)
                .with_context(|| format!("{}: no column `{name}`; the head must be cloud,E,N,H", path.display()))
        };
        let columns = [column("cloud")?, column("e")?, column("n")?, column("h")?];
        let mut rows = Vec::new();
        for (number, row) in reader.records().enumerate() {
            let row = row.with_context(|| format!("{}: row {}", path.display(), number + 2))?;
            let field = |index: usize| row.get(columns[index]).unwrap_or_default();
            let mut camera = [0.0; 3];
            for (axis, value) in camera.iter_mut().enumerate() {
                let text = field(axis + 1);
                *value = text
                    .parse()
                    .ok()
                    .filter(|value: &f64| value.is_finite())
                    .with_context(|| format!("{}: row {}: `{text}` is no number", path.display(), number + 2))?;
            }
            rows.push((stem(Path::new(field(0))), camera));
        }
        Ok(Cameras::Table(path.to_path_buf(), rows))
    }

    pub fn of(&self, cloud: &Path) -> anyhow::Result<[f64; 3]> {
        match self {
            Cameras::One(camera) => Ok(*camera),
            Cameras::Table(path, rows) => {
                let wanted = stem(cloud);
                rows.iter().find(|(name, _)| *name == wanted).map(|(_, camera)| *camera).with_context(|| {
                    format!("{}: no row for the cloud {wanted}; add cloud,E,N,H of its camera", path.display())
                })
            }
        }
    }
}
