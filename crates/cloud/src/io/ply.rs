//! PLY (Turk, *The PLY Polygon File Format*, 1994): binary of both byte orders and text, vertices only.

use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};

use super::{Format, Header, PointReader, Precision};
use crate::error::{Error, Result};
use crate::schema::{Batch, Field, Kind, Schema};

const MOST_HEADER_BYTES: usize = 1 << 20;
const MOST_LINE_BYTES: u64 = 1 << 16;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Encoding {
    Text,
    Little,
    Big,
}

#[derive(Clone, Debug)]
enum Property {
    Scalar(String, Kind),
    /// Kinds of the count and of the items.
    List(Kind, Kind),
}

#[derive(Clone, Debug)]
struct Element {
    name: String,
    count: u64,
    properties: Vec<Property>,
}

struct PlyReader {
    path: PathBuf,
    file: BufReader<File>,
    encoding: Encoding,
    properties: Vec<Property>,
    /// Position among the scalar properties of x, y, z.
    axes: [usize; 3],
    /// All scalars have a fixed place in the file.
    fixed_bytes: Option<usize>,
    points: u64,
    read: u64,
    line: u64,
    /// Nothing stands behind the vertices, which count so many where each has the same length.
    last: Option<Option<u64>>,
}

fn kind_of(name: &str) -> Option<Kind> {
    Some(match name {
        "char" | "int8" => Kind::I8,
        "uchar" | "uint8" => Kind::U8,
        "short" | "int16" => Kind::I16,
        "ushort" | "uint16" => Kind::U16,
        "int" | "int32" => Kind::I32,
        "uint" | "uint32" => Kind::U32,
        "float" | "float32" => Kind::F32,
        "double" | "float64" => Kind::F64,
        "int64" => Kind::I64,
        "uint64" => Kind::U64,
        _ => return None,
    })
}

/// What the header says.
struct Parsed {
    encoding: Encoding,
    elements: Vec<Element>,
    shift: Option<[f64; 3]>,
    crs: Option<String>,
    lines: u64,
    bytes: usize,
}

fn parse_header(path: &Path, file: &mut impl BufRead) -> Result<Parsed> {
    let mut parsed =
        Parsed { encoding: Encoding::Text, elements: Vec::new(), shift: None, crs: None, lines: 0, bytes: 0 };
    let mut encoding = None;
    loop {
        let mut line = Vec::new();
        let read = file.take(MOST_LINE_BYTES).read_until(b'\n', &mut line).map_err(|e| Error::io(path, "read", e))?;
        parsed.lines += 1;
        parsed.bytes += read;
        let bad = |what: String| Error::format(path, format!("PLY header, line {}", parsed.lines), what);
        if read == 0 || parsed.bytes > MOST_HEADER_BYTES {
            return Err(bad("`end_header` is missing".into()));
        }
        let text = String::from_utf8_lossy(&line);
        let words: Vec<&str> = text.split_whitespace().collect();
        match words.as_slice() {
            [] | ["ply"] => {}
            ["comment" | "obj_info", rest @ ..] => read_comment(rest, &mut parsed),
            ["format", kind, _version] => {
                encoding = Some(match *kind {
                    "ascii" => Encoding::Text,
                    "binary_little_endian" => Encoding::Little,
                    "binary_big_endian" => Encoding::Big,
                    other => return Err(bad(format!("`{other}` is no PLY format"))),
                });
            }
            ["element", name, count] => {
                let count = count.parse().map_err(|_| bad(format!("`{count}` is no count")))?;
                parsed.elements.push(Element { name: (*name).into(), count, properties: Vec::new() });
            }
            ["property", "list", count, item, _name] => {
                let (Some(count), Some(item)) = (kind_of(count), kind_of(item)) else {
                    return Err(bad(format!("unknown type in `{}`", text.trim())));
                };
                if matches!(count, Kind::F32 | Kind::F64) {
                    return Err(bad("a list whose length is no whole number".into()));
                }
                let element = parsed.elements.last_mut().ok_or_else(|| bad("a property before any element".into()))?;
                element.properties.push(Property::List(count, item));
            }
            ["property", kind, name] => {
                let kind = kind_of(kind).ok_or_else(|| bad(format!("`{kind}` is no PLY type")))?;
                let element = parsed.elements.last_mut().ok_or_else(|| bad("a property before any element".into()))?;
                element.properties.push(Property::Scalar(name.to_ascii_lowercase(), kind));
            }
            ["end_header"] => break,
            _ => return Err(bad(format!("`{}` is no line of a PLY header", text.trim()))),
        }
    }
    parsed.encoding = encoding.ok_or_else(|| Error::format(path, "PLY header", "the line `format` is missing"))?;
    for element in parsed.elements.iter_mut().filter(|element| element.name == "vertex") {
        give_usual_names(&mut element.properties);
    }
    Ok(parsed)
}

/// Classes and colours under the names of other programs (CloudCompare's scalar fields, colours of materials) are what
/// they say, unless the usual name is there too.
fn give_usual_names(properties: &mut [Property]) {
    const USUAL: [(&str, &str); 5] = [
        ("scalar_classification", "classification"),
        ("class", "classification"),
        ("diffuse_red", "red"),
        ("diffuse_green", "green"),
        ("diffuse_blue", "blue"),
    ];
    for (other, usual) in USUAL {
        let is = |property: &Property, wanted: &str| matches!(property, Property::Scalar(name, _) if name == wanted);
        if properties.iter().any(|property| is(property, usual)) {
            continue;
        }
        if let Some(Property::Scalar(name, _)) = properties.iter_mut().find(|property| is(property, other)) {
            *name = usual.into();
        }
    }
}

/// `comment shift 600000 8600000 0` and what other programs write instead of `shift`; `comment crs EPSG:25833`.
///
/// A global shift is CloudCompare's word for what it adds to map coordinates to make them small: that of ground with
/// positive coordinates is negative there, and is taken off.
fn read_comment(words: &[&str], parsed: &mut Parsed) {
    let Some((first, rest)) = words.split_first() else { return };
    let name = first.trim_end_matches([':', '=']).to_ascii_lowercase();
    let (name, rest) = match (name.as_str(), rest.split_first()) {
        ("global", Some((second, rest))) => {
            (format!("global_{}", second.trim_end_matches([':', '=']).to_ascii_lowercase()), rest)
        }
        _ => (name, rest),
    };
    let numbers = || -> Vec<f64> {
        let words = rest.iter().flat_map(|word| word.split([',', '(', ')', '[', ']']));
        words.filter_map(|word| word.parse().ok()).filter(|number: &f64| number.is_finite()).collect()
    };
    match name.as_str() {
        "shift" | "offset" | "global_offset" | "translation" => {
            if let [e, n, h] = numbers()[..] {
                parsed.shift = Some([e, n, h]);
            }
        }
        "global_shift" | "globalshift" => {
            if let [e, n, h] = numbers()[..] {
                let was_added = e <= 0.0 && n <= 0.0 && e + n < 0.0;
                parsed.shift = Some(if was_added { [e, n, h].map(|value| 0.0 - value) } else { [e, n, h] });
            }
        }
        "crs" | "epsg" | "srs" => {
            let text = rest.join(" ");
            if !text.is_empty() {
                parsed.crs = Some(if name == "epsg" { format!("EPSG:{text}") } else { text });
            }
        }
        _ => {}
    }
}

/// The properties of a vertex that are single numbers.
struct Scalars {
    schema: Schema,
    /// Which of them are x, y and z.
    axes: [usize; 3],
    /// Of these.
    precision: Precision,
    /// There is no list beside them.
    are_all: bool,
}

impl Scalars {
    /// # Errors
    /// When a coordinate is missing.
    fn of(path: &Path, vertex: &Element) -> Result<Self> {
        let scalars: Vec<(&String, Kind)> = vertex
            .properties
            .iter()
            .filter_map(|property| match property {
                Property::Scalar(name, kind) => Some((name, *kind)),
                Property::List(..) => None,
            })
            .collect();
        let mut axes = [0; 3];
        for (axis, place) in ["x", "y", "z"].into_iter().zip(&mut axes) {
            *place = scalars
                .iter()
                .position(|(name, _)| *name == axis)
                .ok_or_else(|| Error::format(path, "PLY header", format!("vertices have no property `{axis}`")))?;
        }
        let mut schema = Schema::default();
        for &(name, kind) in &scalars {
            schema.fields.push(Field::plain(name.clone(), kind, schema.stride));
            schema.stride += kind.size();
        }
        schema.name_once();
        let single = axes.iter().all(|&axis| scalars[axis].1 == Kind::F32);
        let precision = if single { Precision::Single } else { Precision::Double };
        Ok(Scalars { schema, axes, precision, are_all: scalars.len() == vertex.properties.len() })
    }
}

pub(super) fn open(path: &Path) -> Result<(Header, Box<dyn PointReader>)> {
    let file = File::open(path).map_err(|e| Error::io(path, "open", e))?;
    let file_bytes = file.metadata().map_err(|e| Error::io(path, "open", e))?.len();
    let mut file = BufReader::with_capacity(1 << 20, file);
    let parsed = parse_header(path, &mut file)?;
    let mut line = parsed.lines;
    let mut vertex = None;
    for element in &parsed.elements {
        if element.name == "vertex" {
            vertex = Some(element);
            break;
        }
        skip_element(path, &mut file, parsed.encoding, element, &mut line)?;
    }
    let vertex = vertex.ok_or_else(|| Error::format(path, "PLY header", "it has no element `vertex`"))?;
    let Scalars { schema, axes, precision, are_all } = Scalars::of(path, vertex)?;
    let nothing_behind = parsed.elements.last().is_some_and(|element| element.name == "vertex");
    let mut held = None;
    let fixed_bytes = (are_all && parsed.encoding != Encoding::Text).then_some(schema.stride);
    if let Some(bytes) = fixed_bytes {
        let begin = std::io::Seek::stream_position(&mut file).map_err(|e| Error::io(path, "seek", e))?;
        let there = (file_bytes - begin) / bytes as u64;
        if there < vertex.count {
            let what = format!("the header counts {} points, the file holds {there}: it is truncated", vertex.count);
            return Err(Error::format(path, "points", what));
        }
        held = Some(there);
    }
    let encoding = match parsed.encoding {
        Encoding::Text => "text",
        Encoding::Little => "binary little-endian",
        Encoding::Big => "binary big-endian",
    };
    let header = Header {
        format: Format::Ply,
        points: Some(vertex.count),
        schema,
        precision,
        crs: parsed.crs,
        shift: parsed.shift,
        intensity: None,
        colours: None,
        las: None,
        description: format!("PLY, {encoding}"),
    };
    let reader = PlyReader {
        path: path.to_path_buf(),
        file,
        encoding: parsed.encoding,
        properties: vertex.properties.clone(),
        axes,
        fixed_bytes,
        points: vertex.count,
        read: 0,
        line,
        last: nothing_behind.then_some(held),
    };
    Ok((header, Box::new(reader)))
}

/// Passes over what stands before the vertices.
fn skip_element(
    path: &Path,
    file: &mut BufReader<File>,
    encoding: Encoding,
    element: &Element,
    line: &mut u64,
) -> Result<()> {
    let cut = || Error::format(path, format!("element `{}`", element.name), "the file ends in it: it is truncated");
    // Of nothing there may be any number.
    if encoding != Encoding::Text && element.properties.is_empty() {
        return Ok(());
    }
    for _ in 0..element.count {
        if encoding == Encoding::Text {
            if read_line(path, file, line)?.is_none() {
                return Err(cut());
            }
            continue;
        }
        for property in &element.properties {
            match property {
                Property::Scalar(_, kind) => skip(file, kind.size() as u64).map_err(|_| cut())?,
                Property::List(count, item) => skip_list(file, encoding, *count, *item).map_err(|_| cut())?,
            }
        }
    }
    Ok(())
}

fn skip(file: &mut impl Read, bytes: u64) -> std::io::Result<()> {
    match std::io::copy(&mut file.take(bytes), &mut std::io::sink())? {
        copied if copied == bytes => Ok(()),
        _ => Err(std::io::ErrorKind::UnexpectedEof.into()),
    }
}

fn skip_list(file: &mut impl Read, encoding: Encoding, count: Kind, item: Kind) -> std::io::Result<()> {
    let mut bytes = [0; 8];
    let bytes = &mut bytes[..count.size()];
    file.read_exact(bytes)?;
    if encoding == Encoding::Big {
        bytes.reverse();
    }
    let count = count.read(bytes);
    if count < 0.0 {
        return Err(std::io::ErrorKind::InvalidData.into());
    }
    skip(file, (count as u64).saturating_mul(item.size() as u64))
}

/// The next line that is not empty.
fn read_line(path: &Path, file: &mut BufReader<File>, line: &mut u64) -> Result<Option<String>> {
    loop {
        let mut bytes = Vec::new();
        let read = file.take(MOST_LINE_BYTES).read_until(b'\n', &mut bytes).map_err(|e| Error::io(path, "read", e))?;
        if read == 0 {
            return Ok(None);
        }
        *line += 1;
        if read as u64 == MOST_LINE_BYTES {
            return Err(Error::format(path, format!("line {line}"), "the line does not end"));
        }
        let text = String::from_utf8_lossy(&bytes);
        if !text.trim().is_empty() {
            return Ok(Some(text.into_owned()));
        }
    }
}

impl PlyReader {
    fn truncated(&self, point: u64) -> Error {
        let place = format!("point {point} of {}", self.points);
        Error::format(&self.path, place, "the file ends before: it is truncated")
    }

    fn read_fixed(&mut self, batch: &mut Batch, count: usize, bytes: usize) -> Result<()> {
        batch.raw.resize(count * bytes, 0);
        self.file.read_exact(&mut batch.raw).map_err(|_| self.truncated(self.read + 1))?;
        if self.encoding == Encoding::Big {
            for record in batch.raw.chunks_exact_mut(bytes) {
                let mut offset = 0;
                for property in &self.properties {
                    if let Property::Scalar(_, kind) = property {
                        record[offset..offset + kind.size()].reverse();
                        offset += kind.size();
                    }
                }
            }
        }
        Ok(())
    }

    /// Vertices with lists, whose length differs.
    fn read_ragged(&mut self, batch: &mut Batch, count: usize) -> Result<()> {
        for index in 0..count {
            let point = self.read + index as u64 + 1;
            for property in &self.properties {
                let done = match property {
                    Property::Scalar(_, kind) => {
                        let mut bytes = [0; 8];
                        let bytes = &mut bytes[..kind.size()];
                        self.file.read_exact(bytes).map(|()| {
                            if self.encoding == Encoding::Big {
                                bytes.reverse();
                            }
                            batch.raw.extend_from_slice(bytes);
                        })
                    }
                    Property::List(count, item) => skip_list(&mut self.file, self.encoding, *count, *item),
                };
                done.map_err(|_| self.truncated(point))?;
            }
        }
        Ok(())
    }

    fn read_text(&mut self, batch: &mut Batch, count: usize) -> Result<()> {
        for index in 0..count {
            let point = self.read + index as u64 + 1;
            let Some(text) = read_line(&self.path, &mut self.file, &mut self.line)? else {
                return Err(self.truncated(point));
            };
            let mut words = text.split_whitespace();
            let place = || format!("line {}, point {point}", self.line);
            for property in &self.properties {
                match property {
                    Property::Scalar(name, kind) => {
                        let word = words.next().unwrap_or_default();
                        let value = encode(word, *kind).ok_or_else(|| {
                            Error::format(&self.path, place(), format!("`{word}` is no value for `{name}`"))
                        })?;
                        batch.raw.extend_from_slice(&value[..kind.size()]);
                    }
                    Property::List(..) => {
                        let word = words.next().unwrap_or_default();
                        let items: usize = word.parse().map_err(|_| {
                            Error::format(&self.path, place(), format!("`{word}` is no length of a list"))
                        })?;
                        if items > text.len() {
                            return Err(Error::format(&self.path, place(), format!("a list of {items} items")));
                        }
                        words.by_ref().take(items).for_each(|_| {});
                    }
                }
            }
        }
        Ok(())
    }
}

/// A word as the bytes of its kind.
fn encode(word: &str, kind: Kind) -> Option<[u8; 8]> {
    fn padded<const N: usize>(bytes: [u8; N]) -> [u8; 8] {
        let mut all = [0; 8];
        all[..N].copy_from_slice(&bytes);
        all
    }
    let is_whole = |value: &f64| value.fract() == 0.0 && value.abs() < 2f64.powi(63);
    let whole =
        || word.parse::<i64>().ok().or_else(|| word.parse::<f64>().ok().filter(is_whole).map(|value| value as i64));
    Some(match kind {
        Kind::U8 => padded(u8::try_from(whole()?).ok()?.to_le_bytes()),
        Kind::I8 => padded(i8::try_from(whole()?).ok()?.to_le_bytes()),
        Kind::U16 => padded(u16::try_from(whole()?).ok()?.to_le_bytes()),
        Kind::I16 => padded(i16::try_from(whole()?).ok()?.to_le_bytes()),
        Kind::U32 => padded(u32::try_from(whole()?).ok()?.to_le_bytes()),
        Kind::I32 => padded(i32::try_from(whole()?).ok()?.to_le_bytes()),
        Kind::U64 => padded(word.parse::<u64>().ok()?.to_le_bytes()),
        Kind::I64 => padded(word.parse::<i64>().ok()?.to_le_bytes()),
        Kind::F32 => padded(word.parse::<f32>().ok()?.to_le_bytes()),
        Kind::F64 => padded(word.parse::<f64>().ok()?.to_le_bytes()),
    })
}

impl PointReader for PlyReader {
    fn read(&mut self, batch: &mut Batch, limit: usize) -> Result<()> {
        batch.clear();
        let count = (self.points - self.read).min(limit as u64) as usize;
        if count == 0 {
            return Ok(());
        }
        match (self.encoding, self.fixed_bytes) {
            (Encoding::Text, _) => self.read_text(batch, count)?,
            (_, Some(bytes)) => self.read_fixed(batch, count, bytes)?,
            (_, None) => self.read_ragged(batch, count)?,
        }
        self.read += count as u64;
        let mut places = Vec::new();
        let mut stride = 0;
        for property in &self.properties {
            if let Property::Scalar(_, kind) = property {
                places.push((*kind, stride));
                stride += kind.size();
            }
        }
        let axes = self.axes.map(|axis| places[axis]);
        let xyz = batch.raw.chunks_exact(stride).map(|record| axes.map(|(kind, offset)| kind.read(&record[offset..])));
        batch.xyz.extend(xyz);
        Ok(())
    }

    fn left_over(&mut self) -> Result<Option<String>> {
        let mut there = match self.last {
            None => return Ok(None),
            Some(Some(there)) => there,
            Some(None) => self.points,
        };
        if self.encoding == Encoding::Text {
            while read_line(&self.path, &mut self.file, &mut self.line)?.is_some() {
                there += 1;
            }
        }
        Ok(super::uncounted(self.points, there))
    }
}
