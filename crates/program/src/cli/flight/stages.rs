//! What each stage of a flight found: a JSON document and a page for each, and a table of contents.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use anyhow::Result;
use autoref_flight::Error;
use autoref_flight::grey::Grey;
use autoref_raster::atomic;
use serde::Serialize;

use super::stage::Stage;
use super::stage_line::StageLine;
use super::stage_pages;
use super::views::write_png;

/// Whether there is another stage to work.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum After {
    GoesOn,
    Ends,
}

/// Longest side of a frame's picture in the pages.
const PICTURE_PX: usize = 240;

/// Where stages are written down: `stages/NAME.json` and `stages/NAME.html`, `stages/index.html`, and small pictures of
/// the frames in `stages/frames`.
pub struct Record {
    folder: PathBuf,
    title: String,
    until: Stage,
}

impl Record {
    pub fn new(out: &Path, title: String, until: Stage) -> Result<Self> {
        let folder = out.join("stages");
        let frames = folder.join("frames");
        std::fs::create_dir_all(&frames).map_err(|e| Error::io(&frames, "create", e))?;
        Ok(Record { folder, title, until })
    }

    pub fn title(&self) -> &str {
        &self.title
    }

    /// Keeps a small picture of a frame.
    pub fn picture(&self, name: &str, grey: &Grey) -> Result<()> {
        write_png(&grey.smaller(PICTURE_PX), &self.folder.join("frames").join(format!("{name}.png")))
    }

    /// Width and height of the pictures, and their pixels per pixel of a frame.
    pub fn pictures(&self, frame_px: [f64; 2]) -> stage_pages::Pictures {
        stage_pages::Pictures::of(frame_px, PICTURE_PX)
    }

    /// The page of a stage, or of the whole flight.
    pub fn page(&self, stage: Stage) -> PathBuf {
        match stage {
            Stage::Cameras => self.folder.with_file_name("flight.html"),
            _ => self.folder.join(format!("{}.html", stage.name())),
        }
    }

    /// Writes down what a stage found; `body` is what its page shows.
    pub fn put(&self, stage: Stage, found: &impl Serialize, body: &str) -> Result<After> {
        let name = stage.name();
        let text = serde_json::to_string_pretty(found)? + "\n";
        atomic::write(&self.folder.join(format!("{name}.json")), text.as_bytes())?;
        let before = Stage::ALL.iter().rfind(|s| **s < stage).map(|s| s.name());
        let page = stage_pages::whole(&self.title, name, before, body);
        atomic::write(&self.page(stage), page.as_bytes())?;
        self.contents(stage)?;
        Ok(if stage == self.until { After::Ends } else { After::GoesOn })
    }

    /// The table of contents: what every stage up to the last that was worked says in one line. What an older run left
    /// of later ones is of other inputs, perhaps.
    pub fn contents(&self, last: Stage) -> Result<()> {
        let mut rows = String::new();
        for (number, stage) in Stage::ALL.iter().enumerate() {
            let document = match stage {
                Stage::Cameras => self.folder.with_file_name("cameras.json"),
                _ => self.folder.join(format!("{}.json", stage.name())),
            };
            let link =
                if *stage == Stage::Cameras { "../flight.html".into() } else { format!("{}.html", stage.name()) };
            let text = if *stage <= last { std::fs::read_to_string(&document).ok() } else { None };
            let line = text.and_then(|text| StageLine::read(*stage, &text));
            let _ = match line {
                Some(line) => write!(
                    rows,
                    "<tr><td>{}</td><td><a href=\"{link}\">{}</a></td><td>{}</td></tr>",
                    number + 1,
                    stage.name(),
                    line.words()
                ),
                None => write!(rows, "<tr><td>{}</td><td>{}</td><td>not yet</td></tr>", number + 1, stage.name()),
            };
        }
        let page = stage_pages::contents(&self.title, &rows);
        Ok(atomic::write(&self.folder.join("index.html"), page.as_bytes())?)
    }
}
