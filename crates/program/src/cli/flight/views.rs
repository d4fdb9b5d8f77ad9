//! Frames in grey as features are sought in them: their film grain smoothed, their contrast even, and neighbours warped
//! onto each other by the homography of the ground plane, as the rough camera table has it.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use autoref_flight::grey::{Grey, Layout, even_contrast};
use autoref_flight::{Error, Pose};
use autoref_raster::atomic;
use autoref_raster::protected::same_file;
use autoref_terrain::smooth;
use autoref_terrain::write::{mask_of_bytes, micmac_xml};
use gdal::Dataset;
use gdal::raster::ResampleAlg;

/// COLMAP seeks no features in larger images.
pub const LARGEST_PX: usize = 3200;
/// A frame, where it is thought to stand, and how far from where that shows it ground may lie (pixels).
#[derive(Clone)]
pub struct View {
    pub name: String,
    pub pose: Pose,
    pub window_px: f64,
}

/// Whether the file is the mask of another frame, as MicMac or `fiducials --resample` names them.
pub fn is_mask(name: &str) -> bool {
    name.ends_with("_Masq.tif") || name.ends_with(".mask.tif")
}

/// Where masks lie: 0 where a frame is not to be used.
#[derive(Clone, Debug, Default)]
pub struct Masks {
    /// The folder of those of single frames, `NAME_Masq.tif`, or `NAME.mask.tif` of `NAME.resampled.tif`.
    pub folder: PathBuf,
    /// One for all frames: the film's border, data strips, fiducial marks.
    pub global: Option<PathBuf>,
    /// Masks of single frames that do not fit them.
    left_out: BTreeSet<PathBuf>,
}

impl Masks {
    pub fn new(folder: PathBuf, global: Option<PathBuf>) -> Self {
        Masks { folder, global, left_out: BTreeSet::new() }
    }

    /// Leaves out the masks of single frames that cannot be read or are of another size than their frame; a line about
    /// each.
    ///
    /// # Errors
    /// When there are several and none fits: then they are of other frames.
    pub fn leave_out_misfits(&mut self, names: &[String], frame_px: (usize, usize)) -> Result<Vec<String>> {
        let mut notes = Vec::new();
        let own: Vec<PathBuf> =
            names.iter().flat_map(|n| self.of(n)).filter(|p| Some(p) != self.global.as_ref()).collect();
        for path in &own {
            let what = match Dataset::open(path).map(|mask| mask.raster_size()) {
                Ok(size) if size == frame_px => continue,
                Ok((w, h)) => format!("the mask has {w} x {h} pixels, its frame {} x {}", frame_px.0, frame_px.1),
                Err(error) => format!("the mask cannot be read: {error}"),
            };
            notes.push(format!("{}: left out: {what}; its frame counts without it", path.display()));
            self.left_out.insert(path.clone());
        }
        if own.len() > 1 && self.left_out.len() == own.len() {
            let (width, height) = frame_px;
            bail!(
                "{}: none of the {} masks fits the frames of {width} x {height} pixels ({}); make them of these frames with \
                 `autoref-stream mask`, or name another folder under [masks]",
                self.folder.display(),
                own.len(),
                notes[0]
            );
        }
        Ok(notes)
    }

    /// The masks of a frame.
    pub fn of(&self, name: &str) -> Vec<PathBuf> {
        let stem = name.rsplit_once('.').map_or(name, |(stem, _)| stem);
        let mut own = vec![format!("{stem}_Masq.tif")];
        own.extend(stem.strip_suffix(".resampled").map(|film| format!("{film}.mask.tif")));
        let own = own.into_iter().map(|name| self.folder.join(name));
        let own = own.filter(|path| path.is_file() && !self.left_out.contains(path));
        self.global.iter().cloned().chain(own).collect()
    }

    /// The files that the ties of frames depend on besides the frames.
    pub fn files(&self, names: &[&str]) -> Vec<PathBuf> {
        let all: BTreeSet<PathBuf> = names.iter().flat_map(|n| self.of(n)).collect();
        all.into_iter().collect()
    }

    /// The masks of a frame of `frame_px` together, at the size of `layout`; `None` when it has none.
    ///
    /// # Errors
    /// When one cannot be read, or is of another size than the frame.
    fn read(&self, name: &str, frame_px: (usize, usize), layout: &Layout) -> Result<Option<Vec<u8>>> {
        let mut together: Option<Vec<u8>> = None;
        for path in self.of(name) {
            let failed = || format!("{}: cannot be read", path.display());
            let mask = Dataset::open(&path).with_context(failed)?;
            if mask.raster_size() != frame_px {
                let ((w, h), (fw, fh)) = (mask.raster_size(), frame_px);
                bail!("{}: the mask has {w} x {h} pixels, the frame {name} has {fw} x {fh}", path.display());
            }
            let band = mask.rasterband(1).with_context(failed)?;
            let nearest = Some(ResampleAlg::NearestNeighbour);
            let read = band.read_as::<u8>((0, 0), frame_px, (layout.width, layout.height), nearest);
            let values = read.with_context(failed)?.data().to_vec();
            match &mut together {
                Some(all) => all.iter_mut().zip(values).for_each(|(all, v)| *all = u8::from(*all != 0 && v != 0)),
                None => together = Some(values),
            }
        }
        Ok(together)
    }

    /// Writes the masks of frames as COLMAP reads them, `NAME.png` of the frame's size, 255 where it may be used;
    /// whether there are any.
    ///
    /// # Errors
    /// As for reading a mask; when one cannot be written.
    pub fn write_for_colmap(&self, frames: &Path, names: &[&str], into: &Path) -> Result<bool> {
        let mut any = false;
        std::fs::create_dir_all(into).map_err(|e| Error::io(into, "create", e))?;
        for name in names {
            let path = frames.join(name);
            let frame = Dataset::open(&path).with_context(|| format!("{}: cannot be read", path.display()))?;
            let (width, height) = frame.raster_size();
            let layout = Layout::whole((width, height));
            let target = into.join(format!("{name}.png"));
            let Some(mut pixels) = self.read(name, (width, height), &layout)? else {
                // That of an earlier run would still hold.
                match std::fs::remove_file(&target) {
                    Err(e) if e.kind() != std::io::ErrorKind::NotFound => {
                        return Err(Error::io(&target, "remove", e).into());
                    }
                    _ => continue,
                }
            };
            pixels.iter_mut().for_each(|v| *v = if *v == 0 { 0 } else { 255 });
            write_png(&Grey::new(layout, pixels), &target)?;
            any = true;
        }
        Ok(any)
    }

    /// The masks that MicMac wants in `into`, where any frame has one: one of each frame, since it stops where one is
    /// missing. Without those that lie there already.
    pub fn for_micmac(&self, names: &[&str], into: &Path) -> Vec<MicmacMask> {
        if self.files(names).is_empty() {
            return Vec::new();
        }
        let one = |name: &&str| {
            let stem = name.rsplit_once('.').map_or(*name, |(stem, _)| stem);
            let [mask, xml] = ["tif", "xml"].map(|ending| into.join(format!("{stem}_Masq.{ending}")));
            MicmacMask { frame: (*name).to_string(), mask, xml }
        };
        let there = |mask: &MicmacMask| matches!(&self.of(&mask.frame)[..], [one] if same_file(one, &mask.mask));
        names.iter().map(one).filter(|mask| !there(mask)).collect()
    }

    /// Writes the masks of a frame as one that MicMac reads, 1 where it may be used, and its description.
    ///
    /// # Errors
    /// As for reading a mask; when one cannot be written.
    pub fn write_for_micmac(&self, frames: &Path, to: &MicmacMask) -> Result<()> {
        let path = frames.join(&to.frame);
        let frame = Dataset::open(&path).with_context(|| format!("{}: cannot be read", path.display()))?;
        let (width, height) = frame.raster_size();
        let layout = Layout::whole((width, height));
        let pixels = self.read(&to.frame, (width, height), &layout)?.unwrap_or_else(|| vec![1; width * height]);
        let size = [width, height];
        atomic::with_temporary(&to.mask, |temporary| mask_of_bytes(temporary, size, &pixels))?;
        let name = to.mask.file_name().unwrap_or_default().to_string_lossy();
        Ok(atomic::write(&to.xml, micmac_xml(&name, size).as_bytes())?)
    }
}

/// Where MicMac reads the mask of a frame.
pub struct MicmacMask {
    frame: String,
    pub mask: PathBuf,
    pub xml: PathBuf,
}

/// Which pixels of a frame count.
pub struct Counted {
    layout: Layout,
    /// Of the frame's masks, when there are any.
    mask: Option<Vec<u8>>,
}

impl Counted {
    pub fn read(folder: &Path, name: &str, masks: &Masks) -> Result<Self> {
        let path = folder.join(name);
        let frame = Dataset::open(&path).with_context(|| format!("{}: cannot be read", path.display()))?;
        let layout = Layout::of(frame.raster_size(), LARGEST_PX);
        let mask = masks.read(name, frame.raster_size(), &layout)?;
        Ok(Counted { layout, mask })
    }

    pub fn layout(&self) -> Layout {
        self.layout
    }

    /// Whether a pixel of the frame is inside and not masked.
    pub fn has(&self, pixel: [f64; 2]) -> bool {
        let Layout { width, height, .. } = self.layout;
        let [x, y] = self.layout.of_frame(pixel);
        let inside = x >= 0.0 && y >= 0.0 && x < width as f64 && y < height as f64;
        inside && self.mask.as_ref().is_none_or(|m| m[y as usize * width + x as usize] != 0)
    }
}

/// A frame as features are sought in it: its film grain smoothed, its contrast even.
fn even(folder: &Path, name: &str) -> Result<Grey> {
    let grey = plain(folder, name, LARGEST_PX)?;
    let Layout { width, height, .. } = grey.layout;
    let smoothed = smooth::gaussian(grey.pixels(), width, height);
    Ok(Grey::new(grey.layout, even_contrast(&smoothed, width, height)))
}

/// A frame as it is, in grey, at most `largest_px` wide or high.
pub fn plain(folder: &Path, name: &str, largest_px: usize) -> Result<Grey> {
    let path = folder.join(name);
    let failed = |error| autoref_raster::Error::gdal(&path, error);
    let frame = Dataset::open(&path).map_err(failed)?;
    let layout = Layout::of(frame.raster_size(), largest_px);
    let bands = if frame.raster_count() >= 3 { 3 } else { 1 };
    let mut sum = vec![0f32; layout.width * layout.height];
    for band in 1..=bands {
        let part = frame.rasterband(band).map_err(failed)?;
        let (from, to) = (frame.raster_size(), (layout.width, layout.height));
        let part = part.read_as::<f32>((0, 0), from, to, Some(ResampleAlg::Average)).map_err(failed)?;
        for (sum, v) in sum.iter_mut().zip(part.data()) {
            *sum += if v.is_finite() { *v } else { 0.0 } / bands as f32;
        }
    }
    let (low, high) = sum.iter().fold((f32::MAX, f32::MIN), |(l, h), v| (l.min(*v), h.max(*v)));
    // Other than eight bits: the range that is there.
    let (black, white) = if low < 0.0 || high > 255.0 { (low, high) } else { (0.0, 255.0) };
    let range = (white - black).max(f32::MIN_POSITIVE);
    let pixels = sum.iter().map(|v| ((v - black) / range * 255.0).round() as u8).collect();
    Ok(Grey::new(layout, pixels))
}

/// As a PNG file.
fn png(grey: &Grey) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, grey.layout.width as u32, grey.layout.height as u32);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(png::Compression::Fast);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(grey.pixels())?;
    writer.finish()?;
    Ok(bytes)
}

/// Writes a frame in grey as a PNG file.
pub fn write_png(grey: &Grey, path: &Path) -> Result<()> {
    Ok(atomic::write(path, &png(grey)?)?)
}

/// Frames in grey that are held at once.
const MOST_HELD: usize = 32;

/// Frames in grey that are needed at the moment.
#[derive(Default)]
pub struct Shelf(BTreeMap<usize, Grey>);

impl Shelf {
    /// The frame that is called `name`, `index` being its number.
    pub fn get(&mut self, folder: &Path, name: &str, index: usize) -> Result<&Grey> {
        if !self.0.contains_key(&index) {
            // The first is at work; the last is needed the latest.
            if self.0.len() >= MOST_HELD {
                self.0.pop_last();
            }
            self.0.insert(index, even(folder, name)?);
        }
        Ok(&self.0[&index])
    }

    pub fn have(&self, index: usize) -> &Grey {
        &self.0[&index]
    }

    /// Gives back what no later pair needs.
    pub fn forget_before(&mut self, index: usize) {
        self.0 = self.0.split_off(&index);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(path: &Path, (width, height): (usize, usize), value: impl Fn(usize, usize) -> u8) {
        let pixels = (0..width * height).map(|i| value(i % width, i / width)).collect();
        write_png(&Grey::new(Layout::whole((width, height)), pixels), path).expect("writable");
    }

    #[test]
    fn masks_of_the_camera_and_of_the_frame_count_together() {
        let folder = tempfile::tempdir().expect("a folder");
        let at = |name: &str| folder.path().join(name);
        picture(&at("f.png"), (40, 30), |x, _| x as u8);
        picture(&at("f_Masq.tif"), (40, 30), |x, _| u8::from(x < 20));
        picture(&at("border.png"), (40, 30), |_, y| u8::from(y >= 5));
        let mut masks = Masks::new(folder.path().into(), Some(at("border.png")));
        let counted = Counted::read(folder.path(), "f.png", &masks).expect("readable");
        for (pixel, truth) in [([3.5, 8.5], true), ([25.5, 8.5], false), ([3.5, 2.5], false), ([41.0, 8.5], false)] {
            assert_eq!(counted.has(pixel), truth, "{pixel:?}");
        }
        assert!(masks.write_for_colmap(folder.path(), &["f.png"], &at("masks")).expect("writable"));
        let written = Dataset::open(at("masks").join("f.png.png")).expect("readable");
        let values = written.rasterband(1).expect("a band").read_band_as::<u8>().expect("values");
        let truth: Vec<u8> = (0..1200).map(|i| if i % 40 < 20 && i / 40 >= 5 { 255 } else { 0 }).collect();
        assert_eq!(values.data(), truth);
        picture(&at("border.png"), (40, 31), |_, _| 1);
        let error = Counted::read(folder.path(), "f.png", &masks).err().expect("another size").to_string();
        assert!(error.contains("border.png") && error.contains("40 x 31") && error.contains("f.png"), "{error}");
        // A frame's own mask of another size is left out and named; that of the camera is not.
        picture(&at("border.png"), (40, 30), |_, y| u8::from(y >= 5));
        picture(&at("f_Masq.tif"), (30, 40), |_, _| 0);
        let notes = masks.leave_out_misfits(&["f.png".into()], (40, 30)).expect("one alone is left out");
        assert!(matches!(&notes[..], [one] if one.contains("f_Masq.tif") && one.contains("30 x 40")), "{notes:?}");
        let counted = Counted::read(folder.path(), "f.png", &masks).expect("readable");
        assert!(counted.has([25.5, 8.5]) && !counted.has([25.5, 2.5]));
        // Without masks what an earlier run wrote goes, and nothing else.
        std::fs::write(at("masks").join("mine.txt"), "kept").expect("writable");
        masks = Masks::new(at("masks"), None);
        assert!(!masks.write_for_colmap(folder.path(), &["f.png"], &at("masks")).expect("nothing to write"));
        assert!(!at("masks").join("f.png.png").exists() && at("masks").join("mine.txt").exists());
    }
}
