//! Rectangles and polygons in a frame that a person named: what to teach, what to keep, what to leave out.

use std::path::{Path, PathBuf};

use autoref_raster::bounded;
use autoref_raster::error::{Error, Result};
use serde::Deserialize;

/// What a class means for matching.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Meaning {
    Keep,
    Mask,
    /// Says nothing: takes no part in teaching or judging.
    Unknown,
}

impl Meaning {
    /// As masks hold it.
    pub fn label(self) -> u8 {
        match self {
            Meaning::Keep => 1,
            Meaning::Mask => 0,
            Meaning::Unknown => SAYS_NOTHING,
        }
    }
}

/// The value of masks that says nothing.
pub const SAYS_NOTHING: u8 = 255;

/// Classes by name; `keep:NAME` and `mask:NAME` name others.
const KEEP: [&str; 12] = [
    "keep",
    "ground",
    "glacier",
    "foreground",
    "background",
    "land",
    "terrain",
    "rock",
    "forest",
    "ice",
    "topography",
    "vegetation",
];
const MASK: [&str; 14] = [
    "mask", "water", "sea", "lake", "river", "cloud", "clouds", "sky", "snow", "border", "text", "shadow", "fog",
    "haze",
];

/// What the class `name` means.
///
/// # Errors
/// A sentence that names the classes there are.
pub fn meaning(name: &str) -> std::result::Result<Meaning, String> {
    let lower = name.to_lowercase();
    let plain = lower.replace(['-', '_'], " ");
    let words = || plain.split(' ');
    // What is said outright goes before what the name itself would mean: `mask:sea ice` is masked.
    if lower.starts_with("keep:") {
        Ok(Meaning::Keep)
    } else if lower.starts_with("mask:") {
        Ok(Meaning::Mask)
    } else if words().any(|word| KEEP.contains(&word)) {
        Ok(Meaning::Keep)
    } else if words().any(|word| MASK.contains(&word)) {
        Ok(Meaning::Mask)
    } else if lower == "unknown" {
        Ok(Meaning::Unknown)
    } else {
        Err(format!(
            "`{name}` is no class known here; keep: {}; mask: {}; or write keep:{name} or mask:{name}",
            KEEP.join(", "),
            MASK.join(", ")
        ))
    }
}

/// A polygon of a class in a frame, pixels of the frame, (0, 0) at the outer corner of the first pixel.
#[derive(Clone, Debug, PartialEq)]
pub struct Shape {
    pub class: String,
    pub meaning: Meaning,
    /// Path, file name or stem; `None` means every frame.
    pub frame: Option<String>,
    /// Rings; a point inside an odd number of them is inside.
    pub rings: Vec<Vec<[f64; 2]>>,
    /// Where it was given, for messages.
    pub place: String,
    /// The list that it was read from. Later shapes of a list lie over earlier ones.
    pub file: Option<PathBuf>,
}

impl Shape {
    /// Is the point inside? Even–odd rule.
    pub fn contains(&self, [x, y]: [f64; 2]) -> bool {
        let crossings = |ring: &Vec<[f64; 2]>| {
            let edges = ring.iter().zip(ring.iter().cycle().skip(1));
            edges
                .filter(|([x0, y0], [x1, y1])| (*y0 > y) != (*y1 > y) && x < x0 + (y - y0) / (y1 - y0) * (x1 - x0))
                .count()
        };
        self.rings.iter().map(crossings).sum::<usize>() % 2 == 1
    }

    /// Left, top, right, bottom.
    pub fn bounds(&self) -> [f64; 4] {
        let mut bounds = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
        for [x, y] in self.rings.iter().flatten() {
            bounds = [bounds[0].min(*x), bounds[1].min(*y), bounds[2].max(*x), bounds[3].max(*y)];
        }
        bounds
    }

    /// Does the shape speak of the frame at `path`?
    pub fn is_of(&self, path: &Path) -> bool {
        let Some(frame) = &self.frame else { return true };
        let named = Path::new(frame);
        let same = || matches!((named.canonicalize(), path.canonicalize()), (Ok(a), Ok(b)) if a == b);
        path == named
            || path
                .file_name()
                .is_some_and(|name| named.file_name() == Some(name) && (named.components().count() == 1 || same()))
            || path.file_stem().is_some_and(|stem| stem == named.as_os_str())
            || path.ends_with(named)
            || same()
    }

    /// # Errors
    /// When the shape does not lie inside a frame of `width` × `height` pixels, or is empty.
    pub fn check_inside(&self, frame: &Path, width: u64, height: u64) -> Result<()> {
        let [left, top, right, bottom] = self.bounds();
        let fine = left >= 0.0 && top >= 0.0 && right <= width as f64 && bottom <= height as f64;
        if fine && right > left && bottom > top {
            return Ok(());
        }
        Err(Error::usage(
            format!(
                "{}: the sample {} ({left}, {top} to {right}, {bottom}) does not lie inside the frame of {width} × {height} px",
                frame.display(),
                self.place
            ),
            "give x,y of its upper left corner and its width and height in pixels of the frame",
        ))
    }
}

/// Reads `CLASS=X,Y,W,H[@FRAME]`.
///
/// # Errors
/// A sentence that says what is wrong.
pub fn parse_sample(text: &str) -> std::result::Result<Shape, String> {
    let form = "write CLASS=X,Y,W,H@FRAME, for example water=100,2000,300,300@S36_3292.tif";
    let (class, rest) = text.split_once('=').ok_or_else(|| format!("`{text}` has no `=`; {form}"))?;
    let (numbers, frame) = match rest.split_once('@') {
        Some((numbers, frame)) if !frame.is_empty() => (numbers, Some(frame.to_string())),
        Some(_) => return Err(format!("`{text}` names no frame after `@`; {form}")),
        None => (rest, None),
    };
    let values: Vec<f64> =
        numbers.split(',').filter_map(|v| v.trim().parse().ok()).filter(|v: &f64| v.is_finite()).collect();
    let [x, y, width, height] = values[..] else {
        return Err(format!("`{numbers}` in `{text}` are not four numbers; {form}"));
    };
    if !(width > 0.0 && height > 0.0) || numbers.split(',').count() != 4 {
        return Err(format!("the rectangle of `{text}` has no area; {form}"));
    }
    Ok(Shape {
        meaning: meaning(class)?,
        class: class.into(),
        frame,
        rings: vec![rectangle([x, y, width, height])],
        place: format!("`{text}`"),
        file: None,
    })
}

fn rectangle([x, y, w, h]: [f64; 4]) -> Vec<[f64; 2]> {
    vec![[x, y], [x + w, y], [x + w, y + h], [x, y + h]]
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TomlFile {
    frame: Option<String>,
    #[serde(default)]
    sample: Vec<TomlSample>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TomlSample {
    class: String,
    frame: Option<String>,
    /// x, y, width, height.
    rectangle: Option<[f64; 4]>,
    polygon: Option<Vec<[f64; 2]>>,
}

/// Reads shapes from TOML (`[[sample]]` with `class`, `frame`, `rectangle` or `polygon`) or GeoJSON (features with the
/// properties `class` and `frame`; the collection may name the `frame` once).
///
/// # Errors
/// When the file cannot be read or says something else; the message names the place.
pub fn read(path: &Path) -> Result<Vec<Shape>> {
    let bytes = bounded::read(path, "a list of outlines", bounded::TEXT_BYTES)?;
    let text = String::from_utf8(bytes)
        .map_err(|_| Error::format(path, "begin", "this is no text; polygons are given as GeoJSON or TOML"))?;
    if text.trim().is_empty() {
        return Err(Error::format(
            path,
            "begin",
            "the file is empty; a list without outlines is `{\"type\": \"FeatureCollection\", \"features\": []}`",
        ));
    }
    let toml = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("toml"));
    if toml { from_toml(path, &text) } else { from_geojson(path, &text) }
}

fn from_toml(path: &Path, text: &str) -> Result<Vec<Shape>> {
    let file: TomlFile = toml::from_str(text).map_err(|e| {
        let line = e.span().map_or(1, |span| 1 + text[..span.start.min(text.len())].matches('\n').count());
        Error::format(path, format!("line {line}"), e.message().replace('\n', " "))
    })?;
    let shape = |(i, sample): (usize, TomlSample)| {
        let place = format!("sample {}", i + 1);
        let rings = match (sample.rectangle, sample.polygon) {
            (Some(sides), None) => vec![rectangle(sides)],
            (None, Some(ring)) => vec![ring],
            _ => {
                return Err(Error::format(
                    path,
                    place,
                    "give either rectangle = [x, y, w, h] or polygon = [[x, y], …]",
                ));
            }
        };
        let meaning = meaning(&sample.class).map_err(|what| Error::format(path, &place, what))?;
        checked(
            path,
            Shape {
                meaning,
                class: sample.class,
                frame: sample.frame.or_else(|| file.frame.clone()),
                rings,
                place,
                file: Some(path.into()),
            },
        )
    };
    file.sample.into_iter().enumerate().map(shape).collect()
}

fn checked(path: &Path, shape: Shape) -> Result<Shape> {
    let sound = |ring: &Vec<[f64; 2]>| ring.len() >= 3 && ring.iter().flatten().all(|v| v.is_finite());
    if shape.rings.is_empty() || !shape.rings.iter().all(sound) {
        return Err(Error::format(path, shape.place, "a polygon needs three corners or more, all of them numbers"));
    }
    Ok(shape)
}

fn from_geojson(path: &Path, text: &str) -> Result<Vec<Shape>> {
    let json: serde_json::Value = serde_json::from_str(text).map_err(|e| {
        Error::format(
            path,
            format!("line {}", e.line()),
            format!("no JSON: {e}; polygons are given as GeoJSON or TOML"),
        )
    })?;
    let features = json["features"]
        .as_array()
        .ok_or_else(|| Error::format(path, "top level", "no `features`: a GeoJSON FeatureCollection is wanted"))?;
    let mut shapes = Vec::new();
    for (i, feature) in features.iter().enumerate() {
        let place = format!("feature {}", i + 1);
        let wrong = |what: String| Error::format(path, &place, what);
        let class = feature["properties"]["class"].as_str().ok_or_else(|| wrong("no property `class`".into()))?;
        let frame = feature["properties"]["frame"].as_str().or(json["frame"].as_str()).map(String::from);
        let coordinates = &feature["geometry"]["coordinates"];
        let polygons: Vec<serde_json::Value> = match feature["geometry"]["type"].as_str() {
            Some("Polygon") => vec![coordinates.clone()],
            Some("MultiPolygon") => coordinates.as_array().cloned().unwrap_or_default(),
            other => return Err(wrong(format!("a geometry of type {}; polygons are wanted", other.unwrap_or("none")))),
        };
        for polygon in polygons {
            // Heights are left out.
            let rings: Vec<Vec<Vec<f64>>> =
                serde_json::from_value(polygon).map_err(|e| wrong(format!("coordinates: {e}")))?;
            if rings.iter().flatten().any(|point| point.len() < 2) {
                return Err(wrong("a point without x and y".into()));
            }
            let rings = rings.into_iter().map(|ring| ring.into_iter().map(|p| [p[0], p[1]]).collect()).collect();
            let meaning = meaning(class).map_err(wrong)?;
            shapes.push(checked(
                path,
                Shape {
                    class: class.into(),
                    meaning,
                    frame: frame.clone(),
                    rings,
                    place: place.clone(),
                    file: Some(path.into()),
                },
            )?);
        }
    }
    Ok(shapes)
}

/// `FRAME=MASK.tif`, as `--teach` takes it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Lesson {
    pub frame: PathBuf,
    pub mask: PathBuf,
}

/// Reads `FRAME=MASK.tif`.
///
/// # Errors
/// A sentence that says what is wrong.
pub fn parse_lesson(text: &str) -> std::result::Result<Lesson, String> {
    match text.rsplit_once('=') {
        Some((frame, mask)) if !frame.is_empty() && !mask.is_empty() => {
            Ok(Lesson { frame: frame.into(), mask: mask.into() })
        }
        _ => Err(format!("`{text}` is not FRAME=MASK.tif, for example S36_3292.tif=S36_3292_Masq.tif")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_said_outright_goes_before_the_name() {
        for (class, is) in [
            ("mask:sea-ice", Meaning::Mask),
            ("mask:dark_rock", Meaning::Mask),
            ("MASK:bare ground", Meaning::Mask),
            ("keep:snow field", Meaning::Keep),
            ("glacier ice", Meaning::Keep),
            ("low_cloud", Meaning::Mask),
        ] {
            assert_eq!(meaning(class), Ok(is), "{class}");
        }
    }

    #[test]
    fn a_file_that_was_not_saved_whole_is_no_empty_list() {
        let folder = tempfile::tempdir().expect("a folder");
        for name in ["a.toml", "a.geojson"] {
            let path = folder.path().join(name);
            std::fs::write(&path, "\n").expect("writable");
            assert!(read(&path).is_err_and(|error| error.to_string().contains("is empty")), "{name}");
            let none =
                if name.ends_with("toml") { "# none\n" } else { r#"{"type": "FeatureCollection", "features": []}"# };
            std::fs::write(&path, none).expect("writable");
            assert!(read(&path).is_ok_and(|shapes| shapes.is_empty()), "{name}");
        }
    }

    #[test]
    fn samples_are_read_and_faults_named() {
        let shape = parse_sample("water=10,20,30,40@roll/S36_3292.tif").expect("a sample");
        assert_eq!((shape.meaning, shape.bounds()), (Meaning::Mask, [10.0, 20.0, 40.0, 60.0]));
        assert!(shape.is_of(Path::new("/data/roll/S36_3292.tif")) && !shape.is_of(Path::new("S36_3304.tif")));
        assert!(shape.contains([10.5, 20.5]) && !shape.contains([40.5, 30.0]));
        assert_eq!(parse_sample("keep=1,2,3,4").expect("a sample").frame, None);
        for (wrong, word) in [
            ("water", "no `=`"),
            ("water=1,2,3", "four numbers"),
            ("water=1,2,0,4", "no area"),
            ("w=1,2,3,4", "no class"),
            ("water=1,2,3,4@", "no frame"),
            ("water=1,2,3,4,x", "no area"),
        ] {
            let message = parse_sample(wrong).expect_err("wrong");
            assert!(message.contains(word), "{message}");
        }
        assert!(parse_lesson("a.tif=b.tif").is_ok() && parse_lesson("a.tif").is_err());
    }

    #[test]
    fn both_kinds_of_file_are_read() {
        let folder = tempfile::tempdir().expect("a folder");
        let toml = folder.path().join("s.toml");
        std::fs::write(&toml, "frame = \"a.tif\"\n[[sample]]\nclass = \"sky\"\nrectangle = [0, 0, 5, 5]\n[[sample]]\nclass = \"mask:kite\"\nframe = \"b.tif\"\npolygon = [[0, 0], [9, 0], [0, 9]]\n").expect("written");
        let shapes = read(&toml).expect("two");
        assert_eq!(shapes.iter().map(|s| s.frame.as_deref()).collect::<Vec<_>>(), [Some("a.tif"), Some("b.tif")]);
        std::fs::write(&toml, "[[sample]]\nclass = \"sky\"\n").expect("written");
        assert!(read(&toml).expect_err("no area").to_string().contains("sample 1"));
        std::fs::write(&toml, "[[sample]]\nclas = \"sky\"\n").expect("written");
        let message = read(&toml).expect_err("unknown key").to_string();
        assert!(message.contains("line ") && message.contains("clas"), "{message}");
        let json = folder.path().join("s.geojson");
        let polygon = |class: &str| {
            format!(
                r#"{{"type":"Feature","properties":{{"class":"{class}"}},"geometry":{{"type":"Polygon","coordinates":[[[0,0],[8,0],[8,8],[0,8],[0,0]],[[2,2],[6,2],[6,6],[2,6],[2,2]]]}}}}"#
            )
        };
        std::fs::write(
            &json,
            format!(r#"{{"type":"FeatureCollection","frame":"c.tif","features":[{}]}}"#, polygon("keep")),
        )
        .expect("written");
        let shapes = read(&json).expect("one");
        assert!(
            shapes[0].contains([1.0, 1.0]) && !shapes[0].contains([4.0, 4.0]) && shapes[0].is_of(Path::new("x/c.tif"))
        );
        std::fs::write(&json, format!(r#"{{"features":[{}]}}"#, polygon("dragon"))).expect("written");
        assert!(read(&json).expect_err("no class").to_string().contains("feature 1"));
        std::fs::write(&json, "{").expect("written");
        assert!(read(&json).expect_err("no JSON").to_string().contains("line 1"));
    }
}
