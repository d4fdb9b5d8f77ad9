//! A page in which the marks of a camera that is not known yet are clicked, and the file that it saves.

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use autoref_film::{
    Camera, FindOptions,
    learn::{self, Pointed},
};
use autoref_raster::atomic::Existing;
use autoref_raster::coords::PixelPoint;

use super::flight::click::{self, ClickData, ExpectedMark, PointToClick, ShownFrame};
use super::flight::views;

/// Share of the frame's longer side that the detail shows around the place where a mark is expected.
const SHOWN_SHARE: f64 = 0.2;
/// Side of the detail, pixels of the screen.
const DETAIL_PX: f64 = 512.0;
/// What the page saves.
const SAVED: &str = "clicks.csv";

/// What --at says: a place, or a file of the page.
#[derive(Clone, Debug)]
pub enum At {
    Place(Pointed),
    File(PathBuf),
}

impl At {
    /// "MARK=x,y" in pixels, or a file that exists.
    pub fn parse(text: &str) -> Result<At, String> {
        let place = text.rsplit_once('=').map(|(mark, place)| (mark, super::positions::parse_point(place)));
        match place {
            Some((mark, Ok(at))) => Ok(At::Place(Pointed { mark: mark.to_owned(), at })),
            _ if Path::new(text).is_file() => Ok(At::File(text.into())),
            Some((_, Err(why))) => Err(why),
            None => Err(format!("\"{text}\" is not MARK=X,Y, nor a file that the page of --page saved")),
        }
    }
}

/// The places in the first scan that `all` name.
///
/// # Errors
/// When a file cannot be read, is no table of clicks, or has none for this scan.
pub fn pointed(all: &[At], first: &Path) -> anyhow::Result<Vec<Pointed>> {
    let mut places = vec![];
    for at in all {
        let file = match at {
            At::Place(place) => {
                places.push(place.clone());
                continue;
            }
            At::File(file) => file,
        };
        let (_, rows) = autoref_flight::read::image_points::read(file)?;
        let name = first.file_name().unwrap_or_default().to_string_lossy();
        let before = places.len();
        for row in rows {
            if row.image.is_empty() || row.image == name {
                let Some([x, y]) = row.pixel else { continue };
                places.push(Pointed { mark: row.name, at: PixelPoint { x, y } });
            }
        }
        if places.len() == before {
            bail!("{}: no click in {name}; name that scan first, or click it in the page of --page", file.display());
        }
    }
    Ok(places)
}

/// Writes `click.html` and the first scan, in grey, into `output`.
///
/// # Errors
/// When the page is there already, the scan cannot be read, or a file cannot be written.
pub fn write(
    output: &Path,
    scan: &Path,
    (camera, named): (&Camera, &str),
    options: &FindOptions,
    existing: Existing,
) -> anyhow::Result<PathBuf> {
    let page = output.join("click.html");
    super::flight::check_output_in(output, &page, existing)?;
    let folder = scan.parent().unwrap_or(Path::new(""));
    let name = scan.file_name().with_context(|| format!("{}: is no file", scan.display()))?.to_string_lossy();
    let size_px = super::flight::image_size(scan, None)?;
    let shown = views::plain(folder, &name, click::LARGEST_PX)?;
    let frames = output.join(click::SHOWN);
    std::fs::create_dir_all(&frames).with_context(|| format!("{}: cannot create it", frames.display()))?;
    views::write_png(&shown, &frames.join("0.png"))?;
    let expected = learn::expected(camera, size_px, options);
    let marks = expected.iter().enumerate();
    let marks = marks.map(|(point, at)| ExpectedMark { point, frame: 0, predicted: Some([at.x, at.y]), at: None });
    let command = format!("autoref-stream fiducials SCANS --camera {named} --learn --at {SAVED}");
    let data = ClickData {
        frames: vec![ShownFrame::of(0, &name, size_px)],
        points: camera.marks.iter().map(|m| PointToClick { name: m.name.clone() }).collect(),
        marks: marks.collect(),
        zoom: Some(DETAIL_PX / (SHOWN_SHARE * size_px[0].max(size_px[1]))),
        saved: SAVED,
        then: Some(command),
    };
    click::write_page(&page, &format!("{name}: marks of {}", camera.name), &data)?;
    Ok(page)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_and_files_of_the_page_are_told_apart() {
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("clicks.csv");
        std::fs::write(&file, "name,image,px,py\n\"M 1\",\"a.tif\",10.5,20\n\"M 2\",\"b.tif\",1,2\n").expect("written");
        let all = [At::parse("M3=4,5"), At::parse(&file.to_string_lossy())].map(|a| a.expect("known"));
        let places = pointed(&all, Path::new("scans/a.tif")).expect("readable");
        let named: Vec<_> = places.iter().map(|p| (p.mark.as_str(), p.at.x)).collect();
        assert_eq!(named, [("M3", 4.0), ("M 1", 10.5)]);
        assert!(At::parse("nowhere.csv").expect_err("no file").contains("MARK=X,Y"));
        assert!(pointed(&all[1..], Path::new("c.tif")).expect_err("another scan").to_string().contains("c.tif"));
    }
}
