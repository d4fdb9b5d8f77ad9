//! The detector over a whole picture in memory: classify, label, gate, examine.

use autoref_raster::mask::Mask;
use autoref_raster::window::Window;
use autoref_raster::{Patch, PixelRow, SampleType, Samples};
use autoref_stream::candidate::examine::measure;
use autoref_stream::candidate::score::score;
use autoref_stream::candidate::split::examine_parts;
use autoref_stream::candidate::{Candidate, Gates, examine, finish, patch_margin_px};
use autoref_stream::profile::Profile;
use autoref_stream::segment::classify::Classifier;
use autoref_stream::segment::filters::MaskFilters;
use autoref_stream::segment::label::Region;

use autoref_synth::plant::Picture;

pub struct Detector {
    pub profile: Profile,
    pub classifier: Classifier,
    pub gates: Gates,
}

impl Detector {
    pub fn new(profile: Profile) -> Detector {
        let classifier = Classifier::new(&profile, SampleType::U8, 255, [0, 1, 2], None, None).expect("valid profile");
        let gates = Gates::new(&profile, None).expect("sizes in pixels");
        Detector { profile, classifier, gates }
    }

    /// The candidates as the program lists them.
    pub fn list(&self, picture: &Picture) -> Vec<Candidate> {
        finish(self.candidates(picture).into_iter().map(|(_, c)| c).collect(), &self.profile)
    }

    pub fn regions(&self, picture: &Picture) -> Vec<Region> {
        let bounds = Window::whole(picture.width as u64, picture.height as u64);
        let mut mask = Mask::new(bounds);
        let samples: &[u8] = picture.rgb.as_flattened();
        for y in 0..picture.height {
            let row = &samples[y * picture.width * 3..(y + 1) * picture.width * 3];
            let row = PixelRow { samples: Samples::U8(row), pixel_stride: 3, len: picture.width };
            self.classifier.classify_row(row, mask.row_mut(y as u64));
        }
        MaskFilters::new(&self.profile.filters, self.gates.max_side_px()).apply(&mut mask);
        label(&mask)
    }

    pub fn candidates(&self, picture: &Picture) -> Vec<(Region, Candidate)> {
        self.regions(picture)
            .into_iter()
            .filter(|r| self.gates.region(r))
            .flat_map(|r| {
                let patch = self.patch(picture, &r);
                let (classifier, profile, gates) = (&self.classifier, &self.profile, &self.gates);
                let found = if profile.examine.split {
                    examine_parts(&r, &patch, classifier, profile, gates)
                } else {
                    examine(&r, &patch, classifier, profile, gates).into_iter().collect()
                };
                found.into_iter().map(|c| (r.clone(), c)).collect::<Vec<_>>()
            })
            .collect()
    }

    /// What a region measured, and the gate that it stopped at.
    #[allow(dead_code)] // the test that shares this file has no use for it
    pub fn explain(&self, picture: &Picture, region: &Region) -> String {
        let bounds = region.bounds;
        let outline = format!("{}x{} px, area {}", bounds.width, bounds.height, region.area);
        if !self.gates.region(region) {
            return format!("{outline}: gates");
        }
        let Some(seen) = measure(region, &self.patch(picture, region), &self.classifier, &self.profile, &self.gates)
        else {
            return format!("{outline}: not in its patch");
        };
        let score = score(&seen, &self.profile, &self.gates);
        let fit = seen.fit.as_ref().map_or("no fit".to_string(), |f| {
            let [a, b] = f.sides_px;
            format!("{:?} {a:.1}x{b:.1}, blur {:.2}, rms {:.3}", f.form, f.blur_px, f.rms)
        });
        format!("{outline}: contrast {:.1}, {fit}, score {score:.1}", seen.contrast)
    }

    pub fn patch(&self, picture: &Picture, region: &Region) -> Patch {
        let bounds = Window::whole(picture.width as u64, picture.height as u64);
        let window = region.bounds.grown(patch_margin_px(&self.profile), &bounds);
        let cut = picture.crop(window.x as usize, window.y as usize, window.width as usize, window.height as usize);
        let rgb: Vec<[u16; 3]> = cut.rgb.iter().map(|c| c.map(u16::from)).collect();
        Patch { window, valid: vec![true; rgb.len()], rgb, white: 255 }
    }
}

/// 8-connected regions by flood fill, in raster order of their first pixel.
pub fn label(mask: &Mask) -> Vec<Region> {
    let window = mask.window();
    let mut left = mask.clone();
    let mut regions = Vec::new();
    for y in window.y..window.bottom() {
        if left.row(y).iter().all(|&w| w == 0) {
            continue;
        }
        for x in window.x..window.right() {
            if left.get(x, y) {
                regions.push(flood(mask, &mut left, x, y));
            }
        }
    }
    regions
}

fn flood(mask: &Mask, left: &mut Mask, x: u64, y: u64) -> Region {
    let whole = mask.window();
    let mut r = Region {
        first: (y, x),
        bounds: Window::new(x, y, 1, 1),
        area: 0,
        sum_x: 0,
        sum_y: 0,
        sum_xx: 0,
        sum_xy: 0,
        sum_yy: 0,
        perimeter: 0,
    };
    let mut todo = vec![(x, y)];
    left.set(x, y, false);
    while let Some((x, y)) = todo.pop() {
        r.bounds = r.bounds.union(&Window::new(x, y, 1, 1));
        r.area += 1;
        let (u, v) = (u128::from(x), u128::from(y));
        (r.sum_x, r.sum_y) = (r.sum_x + u, r.sum_y + v);
        (r.sum_xx, r.sum_xy, r.sum_yy) = (r.sum_xx + u * u, r.sum_xy + u * v, r.sum_yy + v * v);
        for (dx, dy) in [(-1i64, 0i64), (1, 0), (0, -1), (0, 1), (-1, -1), (1, -1), (-1, 1), (1, 1)] {
            let (nx, ny) = (x.wrapping_add_signed(dx), y.wrapping_add_signed(dy));
            let paint = whole.contains(nx, ny) && mask.get(nx, ny);
            r.perimeter += u64::from(!paint && (dx == 0 || dy == 0));
            if paint && left.get(nx, ny) {
                left.set(nx, ny, false);
                todo.push((nx, ny));
            }
        }
    }
    r
}
