//! GCPs in a drawing (DXF): its POINTs and the places of its blocks.
//!
//! Texts are names, never points: a text stands beside what it names, and a list of them would shift the image unseen.

use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};
use std::io::Read;
use std::path::Path;

use gdal::vector::{Feature, FieldValue, LayerAccess, OGRwkbGeometryType, geometry_type_flatten, geometry_type_has_z};

use crate::gcp::raw::{CrsClaim, RawList, RawPoint};
use crate::gcp::titles::{NAMES, find, tidy};
use crate::gcp::units::Unit;
use crate::gcp::{Gcp, attributes, text};
use autoref_raster::error::{Error, Result};

/// OGR's layer of everything that is drawn; blocks' own definitions are in another.
pub(super) const ENTITIES: &str = "entities";
/// A block in the place of a POINT is its symbol.
const SAME_PLACE: f64 = 1e-3;
/// The text of a point is nearer than this share of its distance from the next text.
const CLEARLY_NEARER: f64 = 0.7;

/// A text, or an attribute of a block, where it stands.
struct Label {
    at: (f64, f64),
    text: String,
}

#[derive(Default)]
struct Drawing {
    points: Vec<RawPoint>,
    blocks: Vec<RawPoint>,
    /// By layer of the drawing.
    labels: BTreeMap<String, Vec<Label>>,
    others: usize,
}

/// Lets GDAL hand out blocks as points; a drawing opened meanwhile has them in their place.
///
/// # Errors
/// Those of `open`.
pub(super) fn with_blocks_whole<T>(open: impl FnOnce() -> T) -> T {
    const OPTION: &str = "DXF_INLINE_BLOCKS";
    // Should GDAL not take the option, blocks are lines, which are counted.
    let _ = gdal::config::set_thread_local_config_option(OPTION, "FALSE");
    let opened = open();
    let _ = gdal::config::clear_thread_local_config_option(OPTION);
    opened
}

/// The points of a drawing, those on its layer `wanted` when that is named.
///
/// # Errors
/// When it has no point, or none on that layer.
pub(super) fn read(path: &Path, layer: &mut impl LayerAccess, crs: CrsClaim, wanted: Option<&str>) -> Result<RawList> {
    let titles: Vec<String> = layer.defn().fields().map(|field| field.name()).collect();
    let mut drawing = Drawing::default();
    for (i, feature) in layer.features().enumerate() {
        drawing.take(i + 1, &feature, &titles);
    }
    let mut notes = Vec::new();
    let mut points = drawing.gathered();
    if let Some(wanted) = wanted {
        let layers: BTreeSet<String> = points.iter().map(|p| layer_of(p).to_string()).collect();
        points.retain(|point| layer_of(point).eq_ignore_ascii_case(wanted));
        if points.is_empty() && !layers.is_empty() {
            let listed = layers.into_iter().collect::<Vec<_>>().join(", ");
            return Err(Error::usage(
                format!("{}: there is no point on a layer `{wanted}`", path.display()),
                format!("there are points on {listed}"),
            ));
        }
    }
    if points.is_empty() {
        return Err(no_points(path, &drawing));
    }
    notes.extend(name(path, &mut points, &drawing.labels));
    if drawing.others > 0 {
        notes.push(format!("{}: passed over, no points: {} of its entities", path.display(), drawing.others));
    }
    let mut list = RawList::new(points, crs);
    list.notes = notes;
    list.drawn_in = stated_unit(path);
    Ok(list)
}

/// The unit that the head of a drawing states (`$INSUNITS`, group 70). Templates leave millimetres and inches there.
fn stated_unit(path: &Path) -> Option<Unit> {
    const HEAD_BYTES: u64 = 1 << 20;
    let mut head = Vec::new();
    std::fs::File::open(path).ok()?.take(HEAD_BYTES).read_to_end(&mut head).ok()?;
    let head = String::from_utf8_lossy(&head);
    let mut lines = head.lines().map(str::trim).skip_while(|line| *line != "$INSUNITS").skip(1);
    if lines.next()? != "70" {
        return None;
    }
    let word = match lines.next()? {
        "1" => "inch",
        "2" => "ft",
        "4" => "mm",
        "5" => "cm",
        "6" => "m",
        "7" => "km",
        "21" => "us ft",
        _ => return None,
    };
    Unit::of_word(word)
}

fn no_points(path: &Path, drawing: &Drawing) -> Error {
    let what = if drawing.labels.is_empty() {
        "it holds no POINT and no block; draw the points as one of them, or give their coordinates as a table"
    } else {
        "it holds texts, but no POINT and no block; a text stands beside its point: draw the points, or give their \
         coordinates as a table"
    };
    Error::format(path, "the drawing", what)
}

fn layer_of(point: &RawPoint) -> &str {
    let layer = point.attributes.iter().find(|(title, _)| title == "Layer");
    layer.map_or("", |(_, layer)| layer.as_str())
}

impl Drawing {
    fn take(&mut self, number: usize, feature: &Feature<'_>, titles: &[String]) {
        let attributes: Vec<(String, String)> = titles.iter().cloned().zip(attributes::fields(feature)).collect();
        let value = |title: &str| {
            attributes.iter().find(|(t, _)| t == title).map_or(String::new(), |(_, text)| text.trim().to_string())
        };
        let geometry = feature.geometry().filter(|g| {
            geometry_type_flatten(g.geometry_type()) == OGRwkbGeometryType::wkbPoint
                && !g.is_empty()
                // What lies on the sheet has the sheet's coordinates.
                && value("PaperSpace") != "1"
        });
        let Some(geometry) = geometry else {
            self.others += 1;
            return;
        };
        let (x, y, z) = geometry.get_point(0);
        let text = text::of_utf8_bytes(value("Text"));
        if !text.is_empty() {
            self.labels.entry(value("Layer")).or_default().push(Label { at: (x, y), text });
            return;
        }
        let height = geometry_type_has_z(geometry.geometry_type()).then_some(z);
        let is_block = !value("BlockName").is_empty();
        let name = attribute_name(feature, titles).unwrap_or_default();
        let gcp = Gcp { height, ..Gcp::control(name, x, y) };
        let point = RawPoint { attributes, ..RawPoint::bare(gcp, format!("feature {number}")) };
        if is_block { self.blocks.push(point) } else { self.points.push(point) }
    }

    /// Points and blocks; a block in the place of a POINT gives that its name.
    fn gathered(&mut self) -> Vec<RawPoint> {
        let mut points = std::mem::take(&mut self.points);
        let by_place = Places::new(points.iter().map(|p| (p.gcp.easting, p.gcp.northing)));
        for block in std::mem::take(&mut self.blocks) {
            match by_place.nearest((block.gcp.easting, block.gcp.northing), None) {
                Some((index, distance)) if distance <= SAME_PLACE => points[index].gcp.name = block.gcp.name,
                _ => points.push(block),
            }
        }
        points
    }
}

/// The attribute of a block that is the point's name: by its tag, or the only one.
fn attribute_name(feature: &Feature<'_>, titles: &[String]) -> Option<String> {
    let column = titles.iter().position(|title| title == "BlockAttributes")?;
    let Some(FieldValue::StringListValue(attributes)) = feature.field(column).ok()? else { return None };
    let pairs: Vec<(String, &str)> = attributes
        .iter()
        .filter_map(|attribute| attribute.split_once(' '))
        .map(|(tag, value)| (tidy(tag), value.trim()))
        .filter(|(_, value)| !value.is_empty())
        .collect();
    let tags: Vec<String> = pairs.iter().map(|(tag, _)| tag.clone()).collect();
    let at = find(&tags, NAMES).or((pairs.len() == 1).then_some(0))?;
    Some(text::of_utf8_bytes(pairs[at].1.to_string()))
}

/// Names the points by the texts beside them, of the layer of the drawing that names most; says what was done.
fn name(path: &Path, points: &mut [RawPoint], labels: &BTreeMap<String, Vec<Label>>) -> Vec<String> {
    let is_value = |text: &str| text.contains(['.', ',']) && crate::gcp::text::number(text).is_some();
    let best = labels
        .iter()
        .map(|(layer, labels)| (layer, naming(points, labels)))
        // Beside a point stands its height, too.
        .max_by_key(|(_, names)| (names.len(), !names.values().any(|text| is_value(text))))
        .filter(|(_, names)| !names.is_empty());
    let all: usize = labels.values().map(Vec::len).sum();
    let mut notes = Vec::new();
    let mut used = 0;
    if let Some((layer, names)) = best {
        used = names.len();
        let of = points.len();
        notes.push(format!("{}: texts of its layer `{layer}` name {used} of {of} points", path.display()));
        for (point, name) in names {
            points[point].gcp.name = name;
        }
    }
    if all > used {
        notes.push(format!("{}: passed over, names of no point: {} of its texts", path.display(), all - used));
    }
    let is_named = points.iter().any(|point| !point.gcp.name.is_empty());
    for (i, point) in points.iter_mut().enumerate().filter(|(_, point)| point.gcp.name.is_empty()) {
        // A number could be another point's name.
        point.gcp.name = if is_named { point.place.clone() } else { (i + 1).to_string() };
    }
    notes
}

/// Which point each text names: the nearest, within half of its distance from the next point. Where two texts are as
/// near, or two points would have one name, none is given.
fn naming(points: &[RawPoint], labels: &[Label]) -> HashMap<usize, String> {
    let places = Places::new(points.iter().map(|p| (p.gcp.easting, p.gcp.northing)));
    let reach = |i: usize| {
        let at = (points[i].gcp.easting, points[i].gcp.northing);
        places.nearest(at, Some(i)).map_or(f64::INFINITY, |(_, distance)| distance / 2.0)
    };
    let mut beside: HashMap<usize, Vec<(f64, &str)>> = HashMap::new();
    for label in labels {
        if let Some((point, distance)) = places.nearest(label.at, None)
            && distance <= reach(point)
        {
            beside.entry(point).or_default().push((distance, &label.text));
        }
    }
    let mut names: HashMap<usize, String> = HashMap::new();
    let mut given: HashMap<&str, usize> = HashMap::new();
    for (point, mut texts) in beside {
        texts.sort_by(|a, b| a.0.total_cmp(&b.0));
        if texts.get(1).is_none_or(|second| texts[0].0 < CLEARLY_NEARER * second.0) {
            names.insert(point, texts[0].1.to_string());
            *given.entry(texts[0].1).or_default() += 1;
        }
    }
    // A block's own name stays, and is no other point's.
    let own: HashSet<&str> = points.iter().map(|point| point.gcp.name.as_str()).collect();
    names.retain(|point, name| {
        given[name.as_str()] == 1 && points[*point].gcp.name.is_empty() && !own.contains(name.as_str())
    });
    names
}

/// Places in the order of their eastings, among which the nearest is found.
struct Places(Vec<(f64, f64, usize)>);

impl Places {
    fn new(places: impl Iterator<Item = (f64, f64)>) -> Self {
        let mut sorted: Vec<(f64, f64, usize)> = places.enumerate().map(|(i, (x, y))| (x, y, i)).collect();
        sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
        Places(sorted)
    }

    /// Index and distance of the place that is nearest to `at`, that of `except` not counted.
    fn nearest(&self, at: (f64, f64), except: Option<usize>) -> Option<(usize, f64)> {
        let start = self.0.partition_point(|place| place.0 < at.0);
        let (mut best, mut best_distance) = (None, f64::INFINITY);
        let (mut left, mut right) = (self.0[..start].iter().rev().peekable(), self.0[start..].iter().peekable());
        loop {
            let gap = |place: Option<&&(f64, f64, usize)>| place.map_or(f64::INFINITY, |p| (p.0 - at.0).abs());
            let (to_left, to_right) = (gap(left.peek()), gap(right.peek()));
            if to_left.min(to_right) >= best_distance {
                return best.map(|index| (index, best_distance));
            }
            let Some(&(x, y, index)) = (if to_left < to_right { left.next() } else { right.next() }) else {
                return best.map(|index| (index, best_distance));
            };
            let distance = (x - at.0).hypot(y - at.1);
            if Some(index) != except && distance < best_distance {
                (best, best_distance) = (Some(index), distance);
            }
        }
    }
}
