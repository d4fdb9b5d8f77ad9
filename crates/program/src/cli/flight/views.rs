//! Frames in grey as features are sought in them: their film grain smoothed, their contrast even, and neighbours warped
//! onto each other by the homography of the ground plane, as the rough camera table has it.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use autoref_flight::{Error, Pose};
use autoref_raster::bilinear::by_weights;
use autoref_terrain::smooth;
use gdal::Dataset;
use gdal::raster::ResampleAlg;
use nalgebra::{Matrix3, Vector3};

/// COLMAP seeks no features in larger images.
pub const LARGEST_PX: usize = 3200;
/// Contrast is made even over squares of this size to each side.
const CONTRAST_PX: usize = 40;
/// The standard deviation of grey values that it is made even to, and what is added to the one found: noise stays
/// small.
const CONTRAST: f32 = 45.0;
const LEAST_CONTRAST: f32 = 2.0;

/// A frame, where it is thought to stand, and how far from where that shows it ground may lie (pixels).
#[derive(Clone)]
pub struct View {
    pub name: String,
    pub pose: Pose,
    pub window_px: f64,
}

/// The interior of all frames: focal length and principal point in pixels.
#[derive(Clone, Copy)]
pub struct Interior {
    pub f_px: f64,
    pub pp_px: [f64; 2],
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
            let layout = Layout { width, height, scale: 1.0 };
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
            Grey { layout, pixels }.write(&target)?;
            any = true;
        }
        Ok(any)
    }
}

/// How a frame is laid out in grey: at most [`LARGEST_PX`] wide or high.
#[derive(Clone, Copy)]
pub struct Layout {
    pub width: usize,
    pub height: usize,
    /// Pixels of this per pixel of the frame.
    pub scale: f64,
}

/// A frame in grey.
pub struct Grey {
    pub layout: Layout,
    pixels: Vec<u8>,
}

/// Which pixels of a frame count.
pub struct Counted {
    layout: Layout,
    /// Of the frame's masks, when there are any.
    mask: Option<Vec<u8>>,
}

impl Layout {
    fn of(frame: &Dataset, largest_px: usize) -> Self {
        let (w, h) = frame.raster_size();
        let scale = (largest_px as f64 / w.max(h).max(1) as f64).min(1.0);
        let [width, height] = [w, h].map(|s| ((s as f64 * scale).round() as usize).max(1));
        Layout { width, height, scale }
    }
}

impl Counted {
    pub fn read(folder: &Path, name: &str, masks: &Masks) -> Result<Self> {
        let path = folder.join(name);
        let frame = Dataset::open(&path).with_context(|| format!("{}: cannot be read", path.display()))?;
        let layout = Layout::of(&frame, LARGEST_PX);
        let mask = masks.read(name, frame.raster_size(), &layout)?;
        Ok(Counted { layout, mask })
    }

    pub fn layout(&self) -> Layout {
        self.layout
    }

    /// Whether a pixel of the frame is inside and not masked.
    pub fn has(&self, pixel: [f64; 2]) -> bool {
        let Layout { width, height, scale } = self.layout;
        let [x, y] = pixel.map(|v| v * scale);
        let inside = x >= 0.0 && y >= 0.0 && x < width as f64 && y < height as f64;
        inside && self.mask.as_ref().is_none_or(|m| m[y as usize * width + x as usize] != 0)
    }
}

impl Grey {
    /// A frame as features are sought in it: its film grain smoothed, its contrast even.
    pub fn read(folder: &Path, name: &str) -> Result<Self> {
        let Grey { layout, pixels } = Grey::plain(folder, name, LARGEST_PX)?;
        let smoothed = smooth::gaussian(&pixels, layout.width, layout.height);
        Ok(Grey { layout, pixels: even_contrast(&smoothed, layout.width, layout.height) })
    }

    /// Row by row.
    pub fn pixels(&self) -> &[u8] {
        &self.pixels
    }

    /// A frame as it is, in grey, at most `largest_px` wide or high.
    pub fn plain(folder: &Path, name: &str, largest_px: usize) -> Result<Self> {
        let path = folder.join(name);
        let failed = |error| autoref_raster::Error::gdal(&path, error);
        let frame = Dataset::open(&path).map_err(failed)?;
        let layout = Layout::of(&frame, largest_px);
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
        Ok(Grey { layout, pixels })
    }

    /// Means over squares, at most `longest_px` wide or high.
    pub fn smaller(&self, longest_px: usize) -> Grey {
        let Layout { width, height, scale } = self.layout;
        let ratio = (longest_px as f64 / width.max(height) as f64).min(1.0);
        let [to_width, to_height] = [width, height].map(|s| ((s as f64 * ratio).round() as usize).max(1));
        let span = |k: usize, from: usize, to: usize| (k * from / to, ((k + 1) * from / to).max(k * from / to + 1));
        let mean = |k: usize| {
            let (left, right) = span(k % to_width, width, to_width);
            let (top, bottom) = span(k / to_width, height, to_height);
            let rows = (top..bottom).map(|y| &self.pixels[y * width + left..y * width + right]);
            let sum: u64 = rows.flatten().map(|v| u64::from(*v)).sum();
            (sum / ((right - left) * (bottom - top)) as u64) as u8
        };
        let layout = Layout { width: to_width, height: to_height, scale: scale * ratio };
        Grey { layout, pixels: (0..to_width * to_height).map(mean).collect() }
    }

    /// Bilinear, at pixels of this image; `None` outside.
    fn at(&self, x: f64, y: f64) -> Option<f32> {
        let (x, y) = (x - 0.5, y - 0.5);
        let Layout { width, height, .. } = self.layout;
        if !(x >= 0.0 && y >= 0.0 && x <= (width - 1) as f64 && y <= (height - 1) as f64) {
            return None;
        }
        let (i, j) = ((x as usize).min(width.saturating_sub(2)), (y as usize).min(height.saturating_sub(2)));
        let (a, b) = ((x - i as f64) as f32, (y - j as f64) as f32);
        let p = |i: usize, j: usize| f32::from(self.pixels[j.min(height - 1) * width + i.min(width - 1)]);
        let row = |j: usize| [p(i, j), p(i + 1, j)];
        Some(by_weights([row(j), row(j + 1)], [a, b]))
    }

    /// This frame as the one that `to` lays out would show the ground, `to_this` taking its pixels here; and the share
    /// of it that is seen.
    pub fn warped(&self, to: Layout, to_this: &Matrix3<f64>) -> (Grey, f64) {
        let mut pixels = vec![0u8; to.width * to.height];
        let mut seen = 0usize;
        for (k, grey) in pixels.iter_mut().enumerate() {
            let at = [k % to.width, k / to.width].map(|v| (v as f64 + 0.5) / to.scale);
            let scale = self.layout.scale;
            if let Some(value) = mapped(to_this, at).and_then(|[x, y]| self.at(x * scale, y * scale)) {
                *grey = value.round() as u8;
                seen += 1;
            }
        }
        let share = seen as f64 / pixels.len() as f64;
        (Grey { layout: to, pixels }, share)
    }

    /// As a PNG file.
    fn png(&self) -> Result<Vec<u8>> {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, self.layout.width as u32, self.layout.height as u32);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_compression(png::Compression::Fast);
        let mut writer = encoder.write_header()?;
        writer.write_image_data(&self.pixels)?;
        writer.finish()?;
        Ok(bytes)
    }

    pub fn write(&self, path: &Path) -> Result<()> {
        Ok(autoref_raster::atomic::write(path, &self.png()?)?)
    }
}

/// Grey values with the mean and the standard deviation of the square around each made the same everywhere.
fn even_contrast(pixels: &[u8], width: usize, height: usize) -> Vec<u8> {
    // Sums over all pixels above and to the left: 3200² · 255² fits 64 bits.
    let mut sums = vec![[0u64; 2]; (width + 1) * (height + 1)];
    for y in 0..height {
        let mut row = [0u64; 2];
        for x in 0..width {
            let v = u64::from(pixels[y * width + x]);
            row = [row[0] + v, row[1] + v * v];
            let above = sums[y * (width + 1) + x + 1];
            sums[(y + 1) * (width + 1) + x + 1] = [above[0] + row[0], above[1] + row[1]];
        }
    }
    let even = |k: usize| {
        let (x, y) = (k % width, k / width);
        let (left, top) = (x.saturating_sub(CONTRAST_PX), y.saturating_sub(CONTRAST_PX));
        let (right, bottom) = ((x + CONTRAST_PX + 1).min(width), (y + CONTRAST_PX + 1).min(height));
        let corner = |x: usize, y: usize| sums[y * (width + 1) + x];
        let sum = |c: usize| {
            let inside =
                corner(right, bottom)[c] + corner(left, top)[c] - corner(right, top)[c] - corner(left, bottom)[c];
            inside as f64 / ((right - left) * (bottom - top)) as f64
        };
        let mean = sum(0);
        let deviation = (sum(1) - mean * mean).max(0.0).sqrt() as f32;
        let value = 128.0 + CONTRAST * (f32::from(pixels[k]) - mean as f32) / (deviation + LEAST_CONTRAST);
        value.round().clamp(0.0, 255.0) as u8
    };
    (0..pixels.len()).map(even).collect()
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
            self.0.insert(index, Grey::read(folder, name)?);
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

/// Pixels of `to` from pixels of `from`, over the plane of height `ground_m`. The third coordinate is positive where
/// both see it.
pub fn homography(from: &Pose, to: &Pose, inside: Interior, ground_m: f64) -> Option<Matrix3<f64>> {
    let k = Matrix3::new(inside.f_px, 0.0, inside.pp_px[0], 0.0, inside.f_px, inside.pp_px[1], 0.0, 0.0, 1.0);
    let on_plane = |pose: &Pose| {
        // From (x, y, 1) on the plane, x and y from the first camera's foot.
        let mut m = Matrix3::identity();
        let foot = Vector3::new(from.centre.x, from.centre.y, ground_m);
        m.set_column(2, &(foot - pose.centre));
        k * pose.rotation * m
    };
    Some(on_plane(to) * on_plane(from).try_inverse()?)
}

pub fn mapped(h: &Matrix3<f64>, pixel: [f64; 2]) -> Option<[f64; 2]> {
    let q = h * Vector3::new(pixel[0], pixel[1], 1.0);
    (q.z > 1e-9).then(|| [q.x / q.z, q.y / q.z])
}

#[cfg(test)]
mod tests {
    use super::*;
    use autoref_flight::YawPitchRoll;

    fn picture(path: &Path, (width, height): (usize, usize), value: impl Fn(usize, usize) -> u8) {
        let pixels = (0..width * height).map(|i| value(i % width, i / width)).collect();
        Grey { layout: Layout { width, height, scale: 1.0 }, pixels }.write(path).expect("writable");
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

    #[test]
    fn a_point_of_the_plane_maps_from_frame_to_frame() {
        let look = |x: f64, yaw_deg: f64| {
            Pose::looking(Vector3::new(x, 100.0, 3000.0), YawPitchRoll { yaw_deg, pitch_deg: -20.0, roll_deg: 1.0 })
        };
        let (a, b) = (look(0.0, 3.0), look(1800.0, -2.0));
        let inside = Interior { f_px: 2100.0, pp_px: [900.0, 890.0] };
        let h = homography(&a, &b, inside, 120.0).expect("both see the plane");
        let seen = |pose: &Pose, x: &Vector3<f64>| {
            let p = pose.to_camera(x);
            [0, 1].map(|i| inside.f_px * p[i] / p.z + inside.pp_px[i])
        };
        for ground in [Vector3::new(500.0, 7000.0, 120.0), Vector3::new(2500.0, 12_000.0, 120.0)] {
            let at = mapped(&h, seen(&a, &ground)).expect("in front of both");
            let want = seen(&b, &ground);
            assert!((at[0] - want[0]).hypot(at[1] - want[1]) < 1e-6, "{at:?} {want:?}");
        }
    }

    #[test]
    fn contrast_is_even_where_the_light_is_not() {
        let (width, height) = (300, 120);
        // The same pattern, in half the light and half the contrast to the right.
        let value = |x: usize, y: usize| {
            let light = if x < 150 { 1.0 } else { 0.5 };
            (light * (120.0 + 40.0 * ((x * 7 + y * 13) as f64 * 0.3).sin())) as u8
        };
        let pixels: Vec<u8> = (0..width * height).map(|k| value(k % width, k / width)).collect();
        let even = even_contrast(&pixels, width, height);
        let deviation = |from: usize| {
            let part: Vec<f64> = (0..height)
                .flat_map(|y| (from..from + 60).map(move |x| (x, y)))
                .map(|(x, y)| f64::from(even[y * width + x]))
                .collect();
            let mean = part.iter().sum::<f64>() / part.len() as f64;
            (part.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / part.len() as f64).sqrt()
        };
        let (left, right) = (deviation(20), deviation(220));
        assert!((left / right - 1.0).abs() < 0.1, "{left} {right}");
    }
}
