//! A spec with every choice made, and any window of its picture.

use std::collections::HashMap;
use std::sync::Arc;

use super::landscape::Landscape;
use super::mark::Mark;
use super::objects;
use super::photo::{Patchwork, PhotoStore};
use super::rng::{NoiseTable, Rng, mix, purpose, value_noise};
use super::shape::Shape;
use super::spec::{Background, Border, MarkSize, MarkStyle, MarkTurn, SynthSpec};
use super::truth::{Shadow, Truth, TruthClutter, TruthGcp};
use autoref_raster::coords::{GeoTransform, PixelPoint};
use autoref_raster::error::{Error, Result};
use autoref_raster::window::Window;

/// Side of the cells in which marks are looked up.
const BUCKET_PX: f64 = 512.0;

#[derive(Debug)]
enum Ground {
    Landscape(Landscape),
    Flat([u8; 3]),
    Patchwork(Patchwork),
    AsIs(Arc<PhotoStore>),
}

/// Everything decided: ready to draw. Drawing is a pure function of the window, so windows can be drawn on any thread
/// in any order.
#[derive(Debug)]
pub struct Scene {
    width: u64,
    height: u64,
    truth: Truth,
    marks: Vec<Mark>,
    buckets: HashMap<(u64, u64), Vec<u32>>,
    ground: Ground,
    border: Border,
    /// Noise, and whether the ground gets it too.
    noise: Option<(NoiseTable, bool)>,
    seed: u64,
}

/// A sample of the picture: 8 bits, or 16 with 65535 as white.
pub(crate) trait Sample: Copy + Default + Send {
    /// Of an 8-bit level.
    const SCALE: f32;
    fn from_scaled(value: f32) -> Self;
    fn level(self) -> f32;
    /// Adds noise given in 1/256 of an 8-bit level.
    fn noisy(self, noise: i32) -> Self;
}

impl Sample for u8 {
    const SCALE: f32 = 1.0;
    fn from_scaled(value: f32) -> u8 {
        (value + 0.5) as u8
    }
    fn level(self) -> f32 {
        f32::from(self)
    }
    fn noisy(self, noise: i32) -> u8 {
        (((i32::from(self) << 8) + noise + 128) >> 8).clamp(0, 255) as u8
    }
}

impl Sample for u16 {
    const SCALE: f32 = 257.0;
    fn from_scaled(value: f32) -> u16 {
        (value + 0.5) as u16
    }
    fn level(self) -> f32 {
        f32::from(self) / 257.0
    }
    fn noisy(self, noise: i32) -> u16 {
        (i32::from(self) + noise).clamp(0, 65535) as u16
    }
}

impl Scene {
    /// Makes all choices and, for photographs, decodes them into a scratch file.
    ///
    /// # Errors
    /// [`Error::Usage`] when the spec contradicts itself, [`Error::Gdal`] or [`Error::Io`] when a photograph cannot be
    /// read.
    pub fn new(spec: &SynthSpec) -> Result<Scene> {
        let store = match &spec.background {
            Background::Photographs(paths) => Some(Arc::new(PhotoStore::open(paths)?)),
            Background::AsIs(path) => Some(Arc::new(PhotoStore::open(std::slice::from_ref(path))?)),
            Background::Landscape | Background::Flat(_) => None,
        };
        Scene::build(spec, store)
    }

    fn build(spec: &SynthSpec, store: Option<Arc<PhotoStore>>) -> Result<Scene> {
        check(spec)?;
        let mut spec = spec.clone();
        if let (Background::AsIs(_), Some(store)) = (&spec.background, &store) {
            spec.size_px = Some(store.size(0));
        }
        let plan = super::plan::lay_out(&spec)?;
        let ground = match (&spec.background, store) {
            (Background::Photographs(_), Some(store)) => Ground::Patchwork(Patchwork::new(store, spec.seed)),
            (Background::AsIs(_), Some(store)) => Ground::AsIs(store),
            (Background::Flat(rgb), _) => Ground::Flat(*rgb),
            _ => Ground::Landscape(Landscape::new(spec.seed, spec.gsd_m)),
        };
        let everywhere = matches!(ground, Ground::Landscape(_) | Ground::Flat(_));
        let noise = (spec.noise_sigma > 0.0).then(|| (NoiseTable::new(spec.seed, spec.noise_sigma), everywhere));
        let mut scene = Scene {
            width: plan.width,
            height: plan.height,
            truth: Truth {
                version: Truth::VERSION,
                width: plan.width,
                height: plan.height,
                geotransform: plan.geotransform,
                gsd_m: spec.gsd_m,
                rotation_deg: spec.rotation_deg,
                mirrored: spec.mirrored,
                seed: spec.seed,
                gcps: vec![],
                clutter: vec![],
                options: spec.clone(),
            },
            marks: vec![],
            buckets: HashMap::new(),
            ground,
            border: spec.border,
            noise,
            seed: spec.seed,
        };
        scene.add_gcps(&spec, &plan.geotransform, &plan.drawn);
        scene.add_placed(&spec, &plan.geotransform);
        scene.add_clutter(&spec);
        scene.index_marks();
        Ok(scene)
    }

    fn add_gcps(&mut self, spec: &SynthSpec, geotransform: &GeoTransform, drawn: &[bool]) {
        for (i, gcp) in spec.gcps.iter().enumerate() {
            let map = autoref_raster::coords::MapPoint { easting: gcp.easting, northing: gcp.northing };
            let at = geotransform.invert(map).expect("a similarity with a positive scale has an inverse");
            let mut rng = Rng::new(spec.seed, purpose::DISPLACE, i as u64);
            let x = at.x + spec.displacement_px * rng.normal();
            let y = at.y + spec.displacement_px * rng.normal();
            let mark = Mark::new(&spec.mark, spec.gsd_m, x, y, Rng::new(spec.seed, purpose::MARK, i as u64));
            let visible = drawn[i] && self.holds(x, y);
            self.truth.gcps.push(truth_of(gcp.clone(), at, &mark, visible));
            if visible {
                self.marks.push(mark);
            }
        }
    }

    fn add_placed(&mut self, spec: &SynthSpec, geotransform: &GeoTransform) {
        for (i, p) in spec.placed.iter().enumerate() {
            let style = p.style.as_ref().unwrap_or(&spec.mark);
            let mark = Mark::new(style, spec.gsd_m, p.x, p.y, Rng::new(spec.seed, purpose::PLACED, i as u64));
            let at = PixelPoint { x: p.x, y: p.y };
            let map = geotransform.apply(at);
            let gcp =
                super::SynthGcp { name: p.name.clone(), easting: map.easting, northing: map.northing, height: None };
            let visible = self.holds(p.x, p.y);
            self.truth.gcps.push(truth_of(gcp, at, &mark, visible));
            if visible {
                self.marks.push(mark);
            }
        }
    }

    /// False objects: bars, discs and squares of 0.4 to 2.5 times the marks' size, never nearer to a mark than both
    /// their sizes.
    fn add_clutter(&mut self, spec: &SynthSpec) {
        let marks: Vec<(f64, f64, f64)> = self.marks.iter().map(|m| (m.x, m.y, m.size_px)).collect();
        let mark_px = spec.mark.size.px(spec.gsd_m);
        for i in 0..spec.clutter {
            let mut rng = Rng::new(spec.seed, purpose::CLUTTER, i as u64);
            let size = mark_px * rng.range(0.4f64.ln(), 2.5f64.ln()).exp();
            let free = (0..50).find_map(|_| {
                let (x, y) = (rng.range(0.0, self.width as f64), rng.range(0.0, self.height as f64));
                let clear = marks.iter().all(|m| (m.0 - x).hypot(m.1 - y) > 1.5 * (m.2 + size) + 6.0);
                (clear && self.holds(x, y)).then_some((x, y))
            });
            // An image full of marks has no room left: less clutter then, and the truth says how much.
            let Some((x, y)) = free else { continue };
            let base = spec.mark.paints[rng.below(spec.mark.paints.len())];
            let jitter = |v: u8, rng: &mut Rng| (f64::from(v) + 22.0 * rng.normal()).clamp(0.0, 255.0) as u8;
            let paint = super::Paint(base.0.map(|v| jitter(v, &mut rng)));
            let style = MarkStyle {
                size: MarkSize::Px(size),
                shape: [Shape::Bar, Shape::Disc, Shape::Square][rng.below(3)],
                paints: vec![paint],
                fading: rng.range(0.0, 0.4),
                texture: 0.15,
                shadow_share: 0.0,
                cover_max: 0.4,
                turn: MarkTurn::Random,
                ..spec.mark.clone()
            };
            let mark = Mark::new(&style, spec.gsd_m, x, y, rng);
            self.truth.clutter.push(TruthClutter { x, y, size_px: size, shape: mark.shape, paint });
            self.marks.push(mark);
        }
    }

    fn index_marks(&mut self) {
        for (i, mark) in self.marks.iter().enumerate() {
            let cells = mark.bounds().map(|v| (v.max(0.0) / BUCKET_PX) as u64);
            for cy in cells[1]..=cells[3] {
                for cx in cells[0]..=cells[2] {
                    self.buckets.entry((cx, cy)).or_default().push(i as u32);
                }
            }
        }
    }

    /// Width of the picture, pixels.
    pub fn width(&self) -> u64 {
        self.width
    }

    /// Height of the picture, pixels.
    pub fn height(&self) -> u64 {
        self.height
    }

    /// What was drawn where.
    pub fn truth(&self) -> &Truth {
        &self.truth
    }

    /// Draws a window: RGB, 8 bits, row-major, `3 · width · height` bytes.
    ///
    /// # Errors
    /// [`Error::Usage`] when the window leaves the image, [`Error::Io`] when the photographs' scratch file fails.
    pub fn render_window(&self, window: Window) -> Result<Vec<u8>> {
        self.render::<u8>(window)
    }

    /// As [`Scene::render_window`] with 16 bits a sample, 65535 being white.
    ///
    /// # Errors
    /// As [`Scene::render_window`].
    pub fn render_window_u16(&self, window: Window) -> Result<Vec<u16>> {
        self.render::<u16>(window)
    }

    pub(crate) fn render<T: Sample>(&self, window: Window) -> Result<Vec<T>> {
        if !Window::whole(self.width, self.height).contains_window(&window) {
            return Err(Error::usage(
                format!("window {window:?} leaves the image of {} x {} pixels", self.width, self.height),
                "ask for pixels inside",
            ));
        }
        let mut ground = vec![0u8; (window.area() * 3) as usize];
        match &self.ground {
            Ground::Landscape(land) => {
                land.render(window, &mut ground);
                objects::draw(land, window, &mut ground);
            }
            Ground::Flat(rgb) => ground.chunks_exact_mut(3).for_each(|p| p.copy_from_slice(rgb)),
            Ground::Patchwork(m) => m.render(window, &mut ground)?,
            Ground::AsIs(store) => store.read_plain(0, window, &mut ground)?,
        }
        let mut out: Vec<T> = ground.iter().map(|&v| T::from_scaled(f32::from(v) * T::SCALE)).collect();
        drop(ground);
        if let Some((table, true)) = &self.noise {
            self.draw_marks(window, &mut out, None);
            add_noise(table, window, &mut out);
        } else {
            self.draw_marks(window, &mut out, self.noise.as_ref().map(|n| &n.0));
        }
        match self.border {
            Border::None => {}
            Border::Nodata { value, .. } => self.cut_border(window, value, ToldBy::Value, &mut out),
            Border::Alpha { .. } => self.cut_border(window, 0, ToldBy::Alpha, &mut out),
        }
        Ok(out)
    }

    /// Marks in the order of their index, so that overlaps come out the same from every window.
    fn draw_marks<T: Sample>(&self, window: Window, out: &mut [T], noise: Option<&NoiseTable>) {
        let mut found: Vec<u32> = vec![];
        let bucket = BUCKET_PX as u64;
        for cy in window.y / bucket..=window.bottom() / bucket {
            for cx in window.x / bucket..=window.right() / bucket {
                found.extend(self.buckets.get(&(cx, cy)).into_iter().flatten());
            }
        }
        found.sort_unstable();
        found.dedup();
        for mark in found.into_iter().map(|i| &self.marks[i as usize]) {
            let [x0, y0, x1, y1] = mark.bounds();
            let left = (x0.max(0.0) as u64).max(window.x);
            let top = (y0.max(0.0) as u64).max(window.y);
            let right = (x1.max(0.0).ceil() as u64).min(window.right());
            let bottom = (y1.max(0.0).ceil() as u64).min(window.bottom());
            for y in top..bottom {
                for x in left..right {
                    let at = (((y - window.y) * window.width + x - window.x) * 3) as usize;
                    let pixel = &mut out[at..at + 3];
                    let before = [pixel[0].level(), pixel[1].level(), pixel[2].level()];
                    let mut rgb = before;
                    let share = mark.paint(x, y, &mut rgb);
                    if rgb == before {
                        continue;
                    }
                    let added = noise.map_or([0; 3], |table| table.at(x, y));
                    for band in 0..3 {
                        let value = rgb[band] + share * added[band] as f32 / 256.0;
                        pixel[band] = T::from_scaled(value.clamp(0.0, 255.0) * T::SCALE);
                    }
                }
            }
        }
    }

    /// Whether a pixel position is inside the image and its ragged border.
    fn holds(&self, x: f64, y: f64) -> bool {
        x >= 0.0
            && y >= 0.0
            && x < self.width as f64
            && y < self.height as f64
            && (self.border.width_px() == 0 || self.is_valid(x as u64, y as u64))
    }

    /// Whether a pixel lies inside the ragged border.
    pub(crate) fn is_valid(&self, x: u64, y: u64) -> bool {
        let width = self.border.width_px();
        let near = |distance: u64, side: i64, along: u64| {
            distance < width && {
                let ragged = 0.5 + 0.5 * value_noise(mix(self.seed ^ 0xb0), along as f32 / 180.0, side as f32 * 7.0);
                (distance as f32) < width as f32 * ragged
            }
        };
        let (from_right, from_bottom) = (self.width - 1 - x, self.height - 1 - y);
        !(near(x, 1, y) || near(from_right, 2, y) || near(y, 3, x) || near(from_bottom, 4, x))
    }

    /// `value` outside; inside, when the value itself tells what is outside, a pixel that happens to look like it is
    /// moved by one level of green.
    fn cut_border<T: Sample>(&self, window: Window, value: u8, outside: ToldBy, out: &mut [T]) {
        let nodata = f32::from(value);
        for y in window.y..window.bottom() {
            for x in window.x..window.right() {
                let at = (((y - window.y) * window.width + x - window.x) * 3) as usize;
                let pixel = &mut out[at..at + 3];
                if !self.is_valid(x, y) {
                    pixel.fill(T::from_scaled(nodata * T::SCALE));
                } else if outside == ToldBy::Value && pixel.iter().all(|s| s.level() == nodata) {
                    pixel[1] = T::from_scaled(if value == 255 { 254.0 } else { nodata + 1.0 } * T::SCALE);
                }
            }
        }
    }
}

/// What tells where the image ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum ToldBy {
    Value,
    Alpha,
}

fn add_noise<T: Sample>(table: &NoiseTable, window: Window, out: &mut [T]) {
    let mut pixels = out.chunks_exact_mut(3);
    for y in window.y..window.bottom() {
        for (x, pixel) in (window.x..window.right()).zip(&mut pixels) {
            for (sample, noise) in pixel.iter_mut().zip(table.at(x, y)) {
                *sample = sample.noisy(noise);
            }
        }
    }
}

fn truth_of(gcp: super::SynthGcp, at: PixelPoint, mark: &Mark, visible: bool) -> TruthGcp {
    TruthGcp {
        name: gcp.name,
        easting: gcp.easting,
        northing: gcp.northing,
        height: gcp.height,
        visible,
        x: mark.x,
        y: mark.y,
        gcp_x: at.x,
        gcp_y: at.y,
        size_px: mark.size_px,
        shape: mark.shape,
        turn_deg: mark.turn_deg,
        paint: mark.paint,
        fading: mark.fading,
        covered: mark.covered,
        shadow: if visible { mark.shadow } else { Shadow::None },
    }
}

/// Refuses what cannot be drawn.
fn check(spec: &SynthSpec) -> Result<()> {
    let refuse = |what: String, remedy: &str| Err(Error::usage(what, remedy));
    if !(1e-12..=1e12).contains(&spec.gsd_m) {
        return refuse(format!("a ground sample distance of {} m", spec.gsd_m), "give one above 0, of sensible size");
    }
    if !spec.rotation_deg.is_finite() || spec.origin.is_some_and(|o| !(o.easting + o.northing).is_finite()) {
        return refuse("rotation or origin is not a finite number".into(), "give plain numbers");
    }
    for style in std::iter::once(&spec.mark).chain(spec.placed.iter().filter_map(|p| p.style.as_ref())) {
        let size = style.size.px(spec.gsd_m);
        if !(0.5..=5000.0).contains(&size) {
            return refuse(format!("marks of {size} px"), "sizes from 0.5 to 5000 px can be drawn");
        }
        if style.paints.is_empty() {
            return refuse("no paint for the marks".into(), "name at least one");
        }
        let shares = [style.fading, style.shadow_share, style.cover_max, style.texture];
        if shares.iter().any(|s| !(0.0..=1.0).contains(s)) {
            return refuse("fading, texture, shadow or cover outside 0 to 1".into(), "they are shares");
        }
        if matches!(style.turn, MarkTurn::Degrees(angle) if !angle.is_finite()) {
            return refuse("the angle of the marks is not a finite number".into(), "give one in degrees");
        }
        if !(0.0..=50.0).contains(&style.blur_px) {
            return refuse(format!("a blur of {} px", style.blur_px), "0 to 50 px can be drawn");
        }
    }
    if !(0.0..=100.0).contains(&spec.noise_sigma) || !(0.0..=1e6).contains(&spec.displacement_px) {
        return refuse("noise or displacement out of range".into(), "give a positive number of sensible size");
    }
    Ok(())
}
