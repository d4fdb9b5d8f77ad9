//! Ties between frames that look at the ground aslant: the neighbour is warped by the homography of the ground plane
//! before features are sought in it; they go back to pixels of the frame as it is.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::fmt::Write as _;
use std::path::Path;

use anyhow::{Context, Result};
use autoref_flight::Error;
use autoref_flight::ground_plane::{Interior, homography, mapped};
use autoref_flight::start::Track;
use autoref_flight::ties::{DESCRIPTOR, Features, matched};
use autoref_raster::bounded;
use gdal::vector::{LayerAccess, sql::Dialect};
use gdal::{Dataset, DatasetOptions, GdalOpenFlags};
use nalgebra::Matrix3;
use serde::{Deserialize, Serialize};

use crate::cli::progress::Steps;
use autoref_raster::sets::Sets;

use super::views::{Counted, Masks, Shelf, View, write_png};

/// A feature of a warped neighbour is one of the frame itself when it lies this close.
const SAME_PX: f64 = 1.0;
/// Less of a frame than this seen by its neighbour carries no ties.
const LEAST_OVERLAP: f64 = 0.03;

/// What ties are made of.
pub struct Job<'a> {
    /// The folder of the frames.
    pub frames: &'a Path,
    pub masks: &'a Masks,
    pub views: &'a [View],
    /// Indices into `views`, the lower first, in order.
    pub pairs: &'a [(usize, usize)],
    pub interior: Interior,
    pub ground_m: f64,
    /// Most features of a frame.
    pub features: usize,
}

/// The ties of all pairs as a file keeps them.
#[derive(Default, Serialize, Deserialize)]
pub struct Ties {
    /// Places in pixels by frame, in the order of the job's views.
    places: Vec<Vec<[f64; 2]>>,
    pub pairs: Vec<Pair>,
}

/// The ties of a pair of frames: places of the one and of the other.
#[derive(Serialize, Deserialize)]
pub struct Pair {
    frames: (usize, usize),
    ties: Vec<(usize, usize)>,
}

/// Key points of a frame; those of warped neighbours join those of the frame itself.
#[derive(Default)]
struct KeyPoints {
    at: Vec<[f64; 2]>,
    cells: HashMap<(i64, i64), Vec<usize>>,
}

impl KeyPoints {
    fn cell(p: [f64; 2]) -> (i64, i64) {
        ((p[0] / SAME_PX).floor() as i64, (p[1] / SAME_PX).floor() as i64)
    }
    fn push(&mut self, p: [f64; 2]) -> usize {
        self.at.push(p);
        self.cells.entry(Self::cell(p)).or_default().push(self.at.len() - 1);
        self.at.len() - 1
    }
    fn join(&mut self, p: [f64; 2]) -> usize {
        let (i, j) = Self::cell(p);
        let near = (i - 1..=i + 1).flat_map(|i| (j - 1..=j + 1).map(move |j| (i, j)));
        let away = |k: &usize| (self.at[*k][0] - p[0]).hypot(self.at[*k][1] - p[1]);
        let best =
            near.filter_map(|c| self.cells.get(&c)).flatten().copied().min_by(|a, b| away(a).total_cmp(&away(b)));
        match best.filter(|k| away(k) < SAME_PX) {
            Some(k) => k,
            None => self.push(p),
        }
    }
}

/// Two images, and the features of theirs that match.
type Verified = (String, String, Vec<(usize, usize)>);

/// COLMAP numbers the pair of images a < b as a · this + b.
const IMAGES: u64 = 2_147_483_647;

fn bytes_of(hex: &str) -> Vec<u8> {
    let digit = |c: u8| (c as char).to_digit(16).unwrap_or(0) as u8;
    hex.as_bytes().chunks_exact(2).map(|h| digit(h[0]) << 4 | digit(h[1])).collect()
}

/// COLMAP's database of features.
struct Database {
    set: Dataset,
    name: String,
}

impl Database {
    fn open(path: &Path) -> Result<Self> {
        let name = path.display().to_string();
        let options = DatasetOptions { open_flags: GdalOpenFlags::GDAL_OF_VECTOR, ..DatasetOptions::default() };
        let set = Dataset::open_ex(path, options)
            .with_context(|| format!("{name}: cannot be read; delete it and run again"))?;
        Ok(Database { set, name })
    }

    /// Columns and bytes of the table's row for an image.
    fn blob(&self, table: &str, image: &str) -> Result<Option<(usize, Vec<u8>)>> {
        let failed = || format!("{}: {table} cannot be read; delete the file and run again", self.name);
        let query = format!(
            "SELECT t.cols AS c, hex(t.data) AS d FROM images i JOIN {table} t ON i.image_id = t.image_id WHERE i.name = '{}'",
            image.replace('\'', "''")
        );
        let Some(mut layer) = self.set.execute_sql(query, None, Dialect::DEFAULT).with_context(failed)? else {
            return Ok(None);
        };
        let Some(row) = layer.features().next() else { return Ok(None) };
        let columns = row.field_as_integer(0).with_context(failed)?.unwrap_or(0);
        let hex = row.field_as_string(1).with_context(failed)?.unwrap_or_default();
        Ok(Some((usize::try_from(columns).unwrap_or(0), bytes_of(&hex))))
    }

    /// Matches of two images that COLMAP found to agree with a relative orientation: indices of their features.
    fn verified(&self) -> Result<Vec<Verified>> {
        let failed = || format!("{}: cannot be read; delete it and run again", self.name);
        let rows = |query: &str| -> Result<Vec<[String; 2]>> {
            let Some(mut layer) = self.set.execute_sql(query, None, Dialect::DEFAULT).with_context(failed)? else {
                return Ok(Vec::new());
            };
            let text =
                |row: &gdal::vector::Feature<'_>, i: usize| row.field_as_string(i).map(Option::unwrap_or_default);
            layer.features().map(|row| Ok([text(&row, 0)?, text(&row, 1)?])).collect()
        };
        let number = |text: &str| text.parse::<u64>().ok();
        let images: HashMap<u64, String> = rows("SELECT CAST(image_id AS TEXT) AS i, name FROM images")?
            .into_iter()
            .filter_map(|[id, name]| Some((number(&id)?, name)))
            .collect();
        let mut all = Vec::new();
        // As text: a pair's number needs more than 32 bits.
        let query = "SELECT CAST(pair_id AS TEXT) AS p, hex(data) AS d FROM two_view_geometries WHERE rows > 0";
        for [pair, hex] in rows(query)? {
            let Some(pair) = number(&pair) else { continue };
            let (Some(a), Some(b)) = (images.get(&(pair / IMAGES)), images.get(&(pair % IMAGES))) else { continue };
            let bytes = bytes_of(&hex);
            let index = |b: &[u8]| u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as usize;
            let matches = bytes.chunks_exact(8).map(|m| (index(&m[..4]), index(&m[4..]))).collect();
            all.push((a.clone(), b.clone(), matches));
        }
        Ok(all)
    }

    /// Where an image has features.
    fn places(&self, image: &str) -> Result<Vec<[f64; 2]>> {
        let Some((columns, places)) = self.blob("keypoints", image)?.filter(|(columns, _)| *columns >= 2) else {
            return Ok(Vec::new());
        };
        let number = |b: &[u8]| f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]]));
        Ok(places.chunks_exact(4 * columns).map(|row| [number(&row[..4]), number(&row[4..8])]).collect())
    }

    fn features(&self, image: &str) -> Result<Features> {
        let mut features = Features::default();
        let Some((_, descriptors)) = self.blob("descriptors", image)? else { return Ok(features) };
        features.at = self.places(image)?;
        let (whole, _) = descriptors.as_chunks::<DESCRIPTOR>();
        features.descriptors = whole.to_vec();
        features.at.truncate(whole.len());
        features.descriptors.truncate(features.at.len());
        Ok(features)
    }
}

/// COLMAP looks for features at twice the pixels too, at four times the price, where frames are smaller than this.
/// Grain is smoothed out of larger ones, and nothing finer than a pixel is left: on a rendered flight 15,693 ties
/// instead of 15,834.
const SMALL_PX: usize = 1200;

/// Runs a command of COLMAP with arguments.
pub type Colmap<'a> = &'a dyn Fn(&[(&str, String)], &str) -> Result<()>;

/// Makes the ties of all pairs in `folder`: `ties.json`, and for COLMAP's importers `features/NAME.txt` and
/// `matches.txt`. `colmap` runs one of its commands.
///
/// # Errors
/// When a frame cannot be read or COLMAP fails.
pub fn make(folder: &Path, job: &Job<'_>, colmap: Colmap<'_>) -> Result<()> {
    let images = folder.join("views");
    for new in [&images, &folder.join("features")] {
        std::fs::create_dir_all(new).map_err(|e| Error::io(new, "create", e))?;
    }
    let Drawn { warped, largest_px } = draw(&images, job)?;
    let database = folder.join("views.db");
    let text = |p: &Path| p.display().to_string();
    // Any number of threads: the features of an image do not depend on them, and images are found by name.
    let extract = [
        ("database_path", text(&database)),
        ("image_path", text(&images)),
        ("SiftExtraction.use_gpu", "0".into()),
        ("SiftExtraction.max_num_features", job.features.to_string()),
        ("SiftExtraction.first_octave", if largest_px < SMALL_PX { "-1" } else { "0" }.into()),
    ];
    colmap(&extract, "feature_extractor")?;
    let ties = gather(&Database::open(&database)?, job, &warped)?;
    write(folder, job, &ties)?;
    std::fs::remove_dir_all(&images).map_err(|e| Error::io(&images, "remove", e))?;
    std::fs::remove_file(&database).map_err(|e| Error::io(&database, "remove", e))?;
    Ok(())
}

/// The pictures that COLMAP is to see.
struct Drawn {
    /// Pairs of frames of which the second is warped onto the first, and by what.
    warped: Vec<(usize, usize, Matrix3<f64>)>,
    /// The longest side of a picture.
    largest_px: usize,
}

/// Draws the frames and the warped neighbours as COLMAP is to see them.
fn draw(images: &Path, job: &Job<'_>) -> Result<Drawn> {
    let (mut warped, mut largest_px) = (Vec::new(), 0);
    let mut shelf = Shelf::default();
    let steps = Steps::new("warping neighbours", job.views.len() as u64);
    for (a, view) in job.views.iter().enumerate() {
        steps.at(a as u64, job.views.len() as u64);
        shelf.forget_before(a);
        let frame = shelf.get(job.frames, &view.name, a)?;
        largest_px = largest_px.max(frame.layout.width).max(frame.layout.height);
        write_png(frame, &images.join(format!("r{a}.png")))?;
        for &(_, b) in job.pairs.iter().filter(|p| p.0 == a) {
            let Some(h) = homography(&view.pose, &job.views[b].pose, job.interior, job.ground_m) else { continue };
            shelf.get(job.frames, &job.views[b].name, b)?;
            let (drawn, share) = shelf.have(b).warped(shelf.have(a).layout, &h);
            if share >= LEAST_OVERLAP {
                write_png(&drawn, &images.join(format!("w{a}_{b}.png")))?;
                warped.push((a, b, h));
            }
        }
    }
    Ok(Drawn { warped, largest_px })
}

fn gather(database: &Database, job: &Job<'_>, warped: &[(usize, usize, Matrix3<f64>)]) -> Result<Ties> {
    let count = job.views.len();
    let counted: Vec<Counted> =
        job.views.iter().map(|v| Counted::read(job.frames, &v.name, job.masks)).collect::<Result<_>>()?;
    let mut points: Vec<KeyPoints> = Vec::with_capacity(count);
    for (i, counted) in counted.iter().enumerate() {
        let mut own = KeyPoints::default();
        let layout = counted.layout();
        database.features(&format!("r{i}.png"))?.at.iter().for_each(|p| {
            own.push(layout.to_frame(*p));
        });
        points.push(own);
    }
    let mut pairs = Vec::new();
    let mut first: Option<(usize, Features)> = None;
    let steps = Steps::new("matching", warped.len() as u64);
    for (done, (a, b, h)) in warped.iter().enumerate() {
        steps.at(done as u64, warped.len() as u64);
        if first.as_ref().is_none_or(|(known, _)| known != a) {
            first = Some((*a, database.features(&format!("r{a}.png"))?));
        }
        let Some((_, one)) = &first else { continue };
        let two = database.features(&format!("w{a}_{b}.png"))?;
        let layout = counted[*a].layout();
        let mut ties: Vec<(usize, usize)> = Vec::new();
        let window_px = job.views[*a].window_px.max(job.views[*b].window_px);
        for (p, q) in matched(one, &two, layout.scale.map(|scale| window_px * scale)) {
            let Some(in_b) = mapped(h, layout.to_frame(two.at[q])) else { continue };
            if counted[*a].has(points[*a].at[p]) && counted[*b].has(in_b) {
                ties.push((p, points[*b].join(in_b)));
            }
        }
        ties.sort_unstable();
        // Two key points of one frame cannot be one of the other.
        let mut taken = std::collections::HashSet::new();
        ties.retain(|(_, q)| taken.insert(*q));
        pairs.push(Pair { frames: (*a, *b), ties });
    }
    Ok(Ties { places: points.into_iter().map(|p| p.at).collect(), pairs })
}

fn write(folder: &Path, job: &Job<'_>, ties: &Ties) -> Result<()> {
    let put = |name: String, content: &str| {
        let path = folder.join(name);
        std::fs::write(&path, content).map_err(|e| Error::io(&path, "write", e))
    };
    let mut text = String::new();
    for Pair { frames: (a, b), ties } in ties.pairs.iter().filter(|p| !p.ties.is_empty()) {
        writeln!(text, "{} {}", job.views[*a].name, job.views[*b].name)?;
        ties.iter().try_for_each(|(p, q)| writeln!(text, "{p} {q}"))?;
        writeln!(text)?;
    }
    put("matches.txt".into(), &text)?;
    let zeros = " 0".repeat(DESCRIPTOR);
    for (view, own) in job.views.iter().zip(&ties.places) {
        let mut lines = format!("{} {DESCRIPTOR}\n", own.len());
        own.iter().try_for_each(|p| writeln!(lines, "{} {} 1 0{zeros}", p[0], p[1]))?;
        put(format!("features/{}.txt", view.name), &lines)?;
    }
    put("ties.json".into(), &serde_json::to_string(ties)?)?;
    Ok(())
}

/// What [`make`] wrote.
pub fn read(folder: &Path) -> Result<Ties> {
    let path = folder.join("ties.json");
    let text = bounded::read_to_string(&path, "ties", bounded::DOCUMENT_BYTES)?;
    serde_json::from_str(&text).with_context(|| format!("{}: is broken; run with --overwrite", path.display()))
}

/// What a result says of a pair of frames: their names, and the number of their ties.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PairTies {
    pub frames: [String; 2],
    pub ties: usize,
}

impl Ties {
    pub fn count(&self) -> usize {
        self.pairs.iter().map(|p| p.ties.len()).sum()
    }

    /// The ties that COLMAP found to agree with the relative orientation of their two frames, `names` in the order of
    /// the views.
    pub fn verified(&self, database: &Path, names: &[&str]) -> Result<Ties> {
        let index = |name: &str| names.iter().position(|n| *n == name);
        let mut pairs = Vec::new();
        for (a, b, ties) in Database::open(database)?.verified()? {
            let (Some(a), Some(b)) = (index(&a), index(&b)) else { continue };
            let known = |frame: usize, place: usize| place < self.places[frame].len();
            let ties = ties.into_iter().filter(|(p, q)| known(a, *p) && known(b, *q)).collect();
            pairs.push(Pair { frames: (a, b), ties });
        }
        pairs.sort_by_key(|p| p.frames);
        Ok(Ties { places: self.places.clone(), pairs })
    }

    /// What COLMAP found in the frames as they are, and found to agree with the relative orientation of two frames.
    pub fn of_plain_frames(database: &Path, names: &[&str]) -> Result<Ties> {
        let own = Database::open(database)?;
        let places = names.iter().map(|name| own.places(name)).collect::<Result<_>>()?;
        Ties { places, pairs: Vec::new() }.verified(database, names)
    }

    /// For the result.
    pub fn statistics(&self, names: &[&str]) -> Vec<PairTies> {
        let name = |frame: usize| names[frame].to_string();
        let pair = |p: &Pair| PairTies { frames: [name(p.frames.0), name(p.frames.1)], ties: p.ties.len() };
        self.pairs.iter().map(pair).collect()
    }

    /// The number of ties of each pair of frames.
    pub fn by_pair(&self) -> BTreeMap<(usize, usize), usize> {
        self.pairs.iter().map(|p| (p.frames, p.ties.len())).collect()
    }

    /// How many places of a frame are known, tied or not.
    pub fn features(&self, frame: usize) -> usize {
        self.places.get(frame).map_or(0, Vec::len)
    }

    /// The places of a frame that are tied to another, each once.
    pub fn places_tied(&self, frame: usize) -> Vec<[f64; 2]> {
        let mut tied = BTreeSet::new();
        for Pair { frames: (a, b), ties } in &self.pairs {
            if *a == frame {
                tied.extend(ties.iter().map(|t| t.0));
            } else if *b == frame {
                tied.extend(ties.iter().map(|t| t.1));
            }
        }
        tied.into_iter().map(|k| self.places[frame][k]).collect()
    }

    /// Ties of pairs that share a place are one point of the ground. A point with two places in one frame is none.
    pub fn tracks(&self) -> Vec<Track> {
        let start: Vec<usize> = self
            .places
            .iter()
            .scan(0, |sum, p| {
                let before = *sum;
                *sum += p.len();
                Some(before)
            })
            .collect();
        let mut sets = Sets::apart(self.places.iter().map(Vec::len).sum());
        for Pair { frames: (a, b), ties } in &self.pairs {
            for (p, q) in ties {
                sets.unite(start[*a] + p, start[*b] + q);
            }
        }
        let mut by_root: BTreeMap<usize, Track> = BTreeMap::new();
        for (frame, places) in self.places.iter().enumerate() {
            for (k, place) in places.iter().enumerate() {
                by_root.entry(sets.root(start[frame] + k)).or_default().push((frame, *place));
            }
        }
        let once = |t: &Track| t.windows(2).all(|w| w[0].0 != w[1].0);
        by_root.into_values().filter(|t| t.len() >= 2 && once(t)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ties_of_pairs_join_to_tracks_and_contradictions_are_left_out() {
        let places = vec![vec![[1.0, 1.0], [2.0, 2.0], [9.0, 9.0]], vec![[3.0, 3.0], [4.0, 4.0]], vec![[5.0, 5.0]]];
        let pairs =
            vec![Pair { frames: (0, 1), ties: vec![(0, 0), (1, 1)] }, Pair { frames: (1, 2), ties: vec![(0, 0)] }];
        let ties = Ties { places: places.clone(), pairs };
        assert_eq!(
            ties.tracks(),
            [vec![(0, [1.0, 1.0]), (1, [3.0, 3.0]), (2, [5.0, 5.0])], vec![(0, [2.0, 2.0]), (1, [4.0, 4.0])]]
        );
        let pairs = vec![
            Pair { frames: (0, 1), ties: vec![(0, 0)] },
            Pair { frames: (1, 2), ties: vec![(0, 0)] },
            Pair { frames: (0, 2), ties: vec![(1, 0)] },
        ];
        assert_eq!(Ties { places, pairs }.tracks(), [] as [Track; 0]);
    }
}
