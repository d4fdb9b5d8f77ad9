//! What the attributes of E57 scans become: one schema for all scans of a file, and how a point of each fills it.

use e57::{PointCloud, RecordDataType, RecordName, RecordValue};

use crate::schema::{Kind, Schema};

const MOST_ATTRIBUTES: usize = 256;

/// How an attribute is stored.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Coding {
    Single,
    Double,
    Whole { least: i64, most: i64 },
    Scaled { least: i64, most: i64, scale: f64, offset: f64 },
}

impl Coding {
    pub(super) fn of(stored: &RecordDataType) -> Self {
        match *stored {
            RecordDataType::Single { .. } => Coding::Single,
            RecordDataType::Double { .. } => Coding::Double,
            RecordDataType::Integer { min, max } => Coding::Whole { least: min, most: max },
            RecordDataType::ScaledInteger { min, max, scale, offset } => {
                Coding::Scaled { least: min, most: max, scale, offset }
            }
        }
    }

    /// Bits of a value.
    pub(super) fn width(self) -> u32 {
        match self {
            Coding::Single => 32,
            Coding::Double => 64,
            Coding::Whole { least, most } | Coding::Scaled { least, most, .. } => {
                64 - most.abs_diff(least).leading_zeros()
            }
        }
    }

    /// The whole number that is stored; `None` beyond the greatest.
    pub(super) fn whole(self, bits: u64) -> Option<i64> {
        match self {
            Coding::Whole { least, most } | Coding::Scaled { least, most, .. } => {
                (bits <= most.abs_diff(least)).then(|| least.wrapping_add_unsigned(bits))
            }
            _ => None,
        }
    }

    /// The value; `None` beyond the greatest.
    pub(super) fn value(self, bits: u64) -> Option<f64> {
        match self {
            Coding::Single => Some(f64::from(f32::from_bits(bits as u32))),
            Coding::Double => Some(f64::from_bits(bits)),
            Coding::Whole { .. } => self.whole(bits).map(|whole| whole as f64),
            Coding::Scaled { scale, offset, .. } => self.whole(bits).map(|whole| whole as f64 * scale + offset),
        }
    }

    /// The kind that holds each value.
    fn kind(self) -> Kind {
        match self {
            Coding::Single => Kind::F32,
            Coding::Double | Coding::Scaled { .. } => Kind::F64,
            Coding::Whole { least, most } => whole_kind(least, most),
        }
    }

    fn is_whole(self) -> bool {
        matches!(self, Coding::Whole { .. })
    }
}

const WHOLE_KINDS: [(Kind, i64, i64); 7] = [
    (Kind::U8, 0, 0xff),
    (Kind::I8, -0x80, 0x7f),
    (Kind::U16, 0, 0xffff),
    (Kind::I16, -0x8000, 0x7fff),
    (Kind::U32, 0, 0xffff_ffff),
    (Kind::I32, -0x8000_0000, 0x7fff_ffff),
    (Kind::I64, i64::MIN, i64::MAX),
];

/// The smallest kind for whole numbers of that span.
fn whole_kind(least: i64, most: i64) -> Kind {
    let fits = |kind: &&(Kind, i64, i64)| kind.1 <= least && most <= kind.2;
    WHOLE_KINDS.iter().find(fits).map_or(Kind::I64, |kind| kind.0)
}

/// The kind that holds what both hold.
fn common(a: Kind, b: Kind) -> Kind {
    let span = |kind| WHOLE_KINDS.iter().find(|whole| whole.0 == kind);
    match (span(a), span(b)) {
        _ if a == b => a,
        (Some(a), Some(b)) => whole_kind(a.1.min(b.1), a.2.max(b.2)),
        _ if fractional(a) == Kind::F32 && fractional(b) == Kind::F32 => Kind::F32,
        _ => Kind::F64,
    }
}

/// The kind that holds NaN beside what this one holds.
fn fractional(kind: Kind) -> Kind {
    if matches!(kind, Kind::F32) || kind.size() <= 2 { Kind::F32 } else { Kind::F64 }
}

/// Writes a value as it lies in a record; `false` when its kind does not hold it.
pub(super) fn put(kind: Kind, value: f64, record: &mut [u8]) -> bool {
    let bytes = &mut record[..kind.size()];
    match kind {
        Kind::F32 => bytes.copy_from_slice(&(value as f32).to_le_bytes()),
        Kind::F64 => bytes.copy_from_slice(&value.to_le_bytes()),
        whole => {
            let fits = |kind: &&(Kind, i64, i64)| kind.0 == whole && (kind.1 as f64..=kind.2 as f64).contains(&value);
            if !WHOLE_KINDS.iter().any(|kind| fits(&kind)) {
                return false;
            }
            bytes.copy_from_slice(&(value as i64).to_le_bytes()[..whole.size()]);
        }
    }
    true
}

/// What a value becomes on its way into the record.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Change {
    Keep,
    /// Counts from one there, from zero in E57.
    AddOne,
    /// A colour of eight bits, where the record has sixteen.
    FromByte,
    /// From these limits to those of sixteen bits.
    Spread {
        least: f64,
        most: f64,
    },
}

/// How a scan fills a field.
#[derive(Clone, Debug)]
pub(super) struct Filled {
    /// Among the attributes of the scan.
    pub(super) attribute: usize,
    /// The attribute that tells by 1 that there is no value.
    pub(super) invalid: Option<usize>,
    pub(super) change: Change,
    pub(super) kind: Kind,
    pub(super) offset: usize,
    pub(super) name: String,
}

/// The name of a field; none for what is no field.
fn name_of(attribute: &RecordName) -> Option<String> {
    Some(match attribute {
        RecordName::Intensity => "intensity".into(),
        RecordName::ColorRed => "red".into(),
        RecordName::ColorGreen => "green".into(),
        RecordName::ColorBlue => "blue".into(),
        RecordName::RowIndex => "row_index".into(),
        RecordName::ColumnIndex => "column_index".into(),
        RecordName::ReturnIndex => "return_number".into(),
        RecordName::ReturnCount => "number_of_returns".into(),
        RecordName::TimeStamp => "time_stamp".into(),
        RecordName::Unknown { namespace, name } => match name.to_ascii_lowercase().as_str() {
            "normalx" => "nx".into(),
            "normaly" => "ny".into(),
            "normalz" => "nz".into(),
            "classification" => "classification".into(),
            // With its namespace, so that an extension's `x` is none of the coordinates.
            other => {
                let namespace = namespace.to_ascii_lowercase();
                format!("{namespace}_{other}").replace(|c: char| !c.is_ascii_alphanumeric(), "_")
            }
        },
        _ => return None,
    })
}

fn flag_of(attribute: &RecordName) -> Option<RecordName> {
    match attribute {
        RecordName::Intensity => Some(RecordName::IsIntensityInvalid),
        RecordName::ColorRed | RecordName::ColorGreen | RecordName::ColorBlue => Some(RecordName::IsColorInvalid),
        RecordName::TimeStamp => Some(RecordName::IsTimeStampInvalid),
        _ => None,
    }
}

fn is_colour(name: &str) -> bool {
    ["red", "green", "blue"].contains(&name)
}

fn is_return(name: &str) -> bool {
    ["return_number", "number_of_returns"].contains(&name)
}

/// Least and greatest value that a scan names for its intensities or colours.
fn limits(scan: &PointCloud, attribute: usize) -> Option<[f64; 2]> {
    let record = &scan.prototype[attribute];
    let number = |value: &Option<RecordValue>| value.as_ref().and_then(|value| value.to_f64(&record.data_type).ok());
    let named = scan.color_limits.as_ref().map(|colour| match record.name {
        RecordName::ColorRed => [number(&colour.red_min), number(&colour.red_max)],
        RecordName::ColorGreen => [number(&colour.green_min), number(&colour.green_max)],
        _ => [number(&colour.blue_min), number(&colour.blue_max)],
    });
    let named = match record.name {
        RecordName::Intensity => {
            scan.intensity_limits.as_ref().map(|limits| [number(&limits.intensity_min), number(&limits.intensity_max)])
        }
        _ => named,
    };
    let sound = |[least, most]: [Option<f64>; 2]| {
        let [least, most] = [least?, most?];
        (least < most && least.is_finite() && most.is_finite()).then_some([least, most])
    };
    named.and_then(sound).filter(|[least, most]| (most - least).is_finite())
}

/// Least and greatest value that the storage of an attribute allows.
fn storage_limits(scan: &PointCloud, attribute: usize) -> Option<[f64; 2]> {
    let pair = match scan.prototype[attribute].data_type {
        RecordDataType::Single { min, max } => min.map(f64::from).zip(max.map(f64::from)),
        RecordDataType::Double { min, max } => min.zip(max),
        RecordDataType::Integer { min, max } => Some((min as f64, max as f64)),
        RecordDataType::ScaledInteger { min, max, scale, offset } => {
            Some((min as f64 * scale + offset, max as f64 * scale + offset))
        }
    };
    pair.map(|(least, most)| [least, most]).filter(|[least, most]| least < most && (most - least).is_finite())
}

/// Limits to spread a value from: those that the file names, else those of fractions between near bounds. A storage
/// that holds more than is in it says nothing.
fn spread_limits(scan: &PointCloud, attribute: usize) -> Option<[f64; 2]> {
    let is_float =
        matches!(scan.prototype[attribute].data_type, RecordDataType::Single { .. } | RecordDataType::Double { .. });
    let near = |[least, most]: &[f64; 2]| is_float && most - least <= 65_536.0;
    limits(scan, attribute).or_else(|| storage_limits(scan, attribute).filter(near))
}

/// What a colour is stored as, and how it gets there: whole numbers of 8 and 16 bits as they are, all else spread from
/// its limits to 16 bits.
fn colour(scan: &PointCloud, attribute: usize) -> (Kind, Change) {
    let coding = Coding::of(&scan.prototype[attribute].data_type);
    let storage = coding.kind();
    let (named, stored) = (spread_limits(scan, attribute), storage_limits(scan, attribute));
    let limits = named.or(stored);
    let within = |most: f64| matches!(limits, Some([least, greatest]) if least >= 0.0 && greatest <= most);
    match (storage, limits) {
        (Kind::U8, _) => (Kind::U8, Change::FromByte),
        (Kind::U16, _) if !within(255.0) => (Kind::U16, Change::Keep),
        _ if coding.is_whole() && within(255.0) => (Kind::U8, Change::FromByte),
        _ if coding.is_whole() && within(65_535.0) => (Kind::U16, Change::Keep),
        (_, Some([least, most])) if named.is_some() => (Kind::U16, Change::Spread { least, most }),
        _ => (storage, Change::Keep),
    }
}

/// One field of the schema while scans are gathered.
struct Gathered {
    name: String,
    kind: Kind,
    scans: usize,
    missing: bool,
}

/// The schema of all scans, and how each fills it. Where a scan has no value there is NaN; colours and returns, which
/// LAS holds as whole numbers, are 0 and 1.
pub(super) fn schema(scans: &[PointCloud]) -> Result<(Schema, Vec<Vec<Filled>>), String> {
    let mut gathered: Vec<Gathered> = Vec::new();
    let mut filled: Vec<Vec<Filled>> = Vec::new();
    for (number, scan) in scans.iter().enumerate() {
        if scan.prototype.len().max(gathered.len()) > MOST_ATTRIBUTES {
            return Err(format!("scan {}: more than {MOST_ATTRIBUTES} attributes", number + 1));
        }
        let mut fields: Vec<Filled> = Vec::new();
        for (attribute, record) in scan.prototype.iter().enumerate() {
            let Some(name) = name_of(&record.name) else { continue };
            if fields.iter().any(|field| field.name == name) {
                return Err(format!("scan {}: the attribute `{name}` is there twice", number + 1));
            }
            let coding = Coding::of(&record.data_type);
            let (kind, change) = match coding {
                _ if is_colour(&name) => colour(scan, attribute),
                Coding::Whole { least, most } if name == "return_number" => {
                    (whole_kind(least.saturating_add(1), most.saturating_add(1)), Change::AddOne)
                }
                _ if name == "return_number" => (coding.kind(), Change::AddOne),
                _ => (coding.kind(), Change::Keep),
            };
            let flag = flag_of(&record.name);
            let invalid = flag.and_then(|flag| scan.prototype.iter().position(|record| record.name == flag));
            match gathered.iter_mut().find(|field| field.name == name) {
                Some(field) => {
                    field.kind = common(field.kind, kind);
                    field.scans += 1;
                    field.missing |= invalid.is_some();
                }
                None => gathered.push(Gathered { name: name.clone(), kind, scans: 1, missing: invalid.is_some() }),
            }
            fields.push(Filled { attribute, invalid, change, kind, offset: 0, name });
        }
        filled.push(fields);
    }
    // Colours are of one kind, or LAS would spread some of them alone.
    let colours = gathered.iter().filter(|field| is_colour(&field.name)).map(|field| field.kind).reduce(common);
    let mut schema = Schema::default();
    for field in &gathered {
        let missing = field.missing || field.scans < scans.len();
        let kind = match colours {
            Some(kind) if is_colour(&field.name) => kind,
            _ if missing && !is_return(&field.name) => fractional(field.kind),
            _ => field.kind,
        };
        schema.push(&field.name, kind);
    }
    for field in filled.iter_mut().flatten() {
        let place = schema.field(&field.name).expect("it was gathered");
        field.offset = place.offset;
        // Eight bits are spread only where other scans have sixteen.
        if field.change == Change::FromByte && place.kind != Kind::U16 {
            field.change = Change::Keep;
        }
        field.kind = place.kind;
    }
    Ok((schema, filled))
}

/// A record that has none of the values.
pub(super) fn blank(schema: &Schema) -> Vec<u8> {
    let mut record = vec![0; schema.stride];
    for field in &schema.fields {
        let missing = if is_return(&field.name) { 1.0 } else { f64::NAN };
        // Whole numbers that no scan lacks, and colours, stay 0.
        put(field.kind, missing, &mut record[field.offset..]);
    }
    record
}

/// The limits of all intensities, where the file names them and they are no whole numbers of sixteen bits.
pub(super) fn intensity_limits(scans: &[PointCloud]) -> Option<[f64; 2]> {
    let mut all: Option<[f64; 2]> = None;
    let mut fits = true;
    for scan in scans {
        let intensity = |record: &e57::Record| record.name == RecordName::Intensity;
        let Some(attribute) = scan.prototype.iter().position(intensity) else { continue };
        fits &= matches!(Coding::of(&scan.prototype[attribute].data_type).kind(), Kind::U8 | Kind::U16);
        let [least, most] = spread_limits(scan, attribute)?;
        let [low, high] = all.unwrap_or([least, most]);
        all = Some([low.min(least), high.max(most)]);
    }
    all.filter(|_| !fits)
}
