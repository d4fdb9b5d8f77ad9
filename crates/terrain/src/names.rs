//! Paths of a frame's outputs.

use std::path::{Path, PathBuf};

use crate::options::{Extras, Method, Options};

/// Paths of a frame's outputs.
pub struct Names {
    pub mask: PathBuf,
    pub xml: PathBuf,
    pub report: PathBuf,
    pub outlines: PathBuf,
    pub probability: PathBuf,
    pub colmap: PathBuf,
    pub class: PathBuf,
    pub entropy: PathBuf,
    pub distance: PathBuf,
    pub scatter: PathBuf,
    /// The small picture of the contact sheet.
    pub preview: PathBuf,
}

impl Names {
    /// The files of a frame in the folder of outputs.
    pub fn of(frame: &Path, folder: &Path) -> Names {
        let stem = frame.file_stem().unwrap_or(frame.as_os_str()).to_string_lossy();
        let name = frame.file_name().unwrap_or(frame.as_os_str()).to_string_lossy();
        Names::of_stem(&stem, &name, folder)
    }

    /// Of the frame that is called `name`, without its extension `stem`.
    pub(crate) fn of_stem(stem: &str, name: &str, folder: &Path) -> Names {
        let path = |end: &str| folder.join(format!("{stem}{end}"));
        Names {
            mask: path("_Masq.tif"),
            xml: path("_Masq.xml"),
            report: path("_Masq.json"),
            outlines: path("_Masq.geojson"),
            probability: path("_Prob.tif"),
            colmap: folder.join(format!("{name}.png")),
            class: path("_Class.tif"),
            entropy: path("_Entropy.tif"),
            distance: path("_Distance.tif"),
            scatter: path("_Scatter.svg"),
            preview: folder.join("previews").join(format!("{stem}.png")),
        }
    }

    /// Everything that a run may write for the frame, but for the sheet's.
    pub(crate) fn all(&self) -> [&PathBuf; 10] {
        let Names { mask, xml, report, outlines, probability, colmap, class, entropy, distance, scatter, preview: _ } =
            self;
        [mask, xml, report, outlines, probability, colmap, class, entropy, distance, scatter]
    }

    /// Names of the files that a run with these options writes.
    pub(crate) fn written(&self, options: &Options, has_probability: bool) -> Vec<String> {
        let Extras { explain, colmap, .. } = options.extras;
        let mut files = vec![&self.mask, &self.xml, &self.report, &self.outlines];
        files.extend(has_probability.then_some(&self.probability));
        files.extend(colmap.then_some(&self.colmap));
        if explain {
            files.extend([&self.class, &self.entropy, &self.scatter]);
            files.extend((options.method == Method::Thesis2017).then_some(&self.distance));
        }
        files.into_iter().map(|path| name_of(path)).collect()
    }
}

pub(crate) fn name_of(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}
