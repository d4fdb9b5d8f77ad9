//! What a point carries beside its coordinates: named fields in a raw record.

/// How a number lies in a record; always little-endian.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    U8,
    I8,
    U16,
    I16,
    U32,
    I32,
    U64,
    I64,
    F32,
    F64,
}

impl Kind {
    /// Bytes of a value.
    pub fn size(self) -> usize {
        match self {
            Kind::U8 | Kind::I8 => 1,
            Kind::U16 | Kind::I16 => 2,
            Kind::U32 | Kind::I32 | Kind::F32 => 4,
            Kind::U64 | Kind::I64 | Kind::F64 => 8,
        }
    }

    /// The value at the begin of `bytes`.
    ///
    /// # Panics
    /// When `bytes` is shorter than [`Kind::size`].
    pub fn read(self, bytes: &[u8]) -> f64 {
        match self {
            Kind::U8 => f64::from(bytes[0]),
            Kind::I8 => f64::from(bytes[0] as i8),
            Kind::U16 => f64::from(u16::from_le_bytes(array(bytes))),
            Kind::I16 => f64::from(i16::from_le_bytes(array(bytes))),
            Kind::U32 => f64::from(u32::from_le_bytes(array(bytes))),
            Kind::I32 => f64::from(i32::from_le_bytes(array(bytes))),
            Kind::U64 => u64::from_le_bytes(array(bytes)) as f64,
            Kind::I64 => i64::from_le_bytes(array(bytes)) as f64,
            Kind::F32 => f64::from(f32::from_le_bytes(array(bytes))),
            Kind::F64 => f64::from_le_bytes(array(bytes)),
        }
    }

    /// Whether the value at the begin of `bytes` is `number`: a u64, an i64 or an f64.
    fn is_stored(self, bytes: &[u8], number: [u8; 8]) -> bool {
        match self {
            Kind::U64 | Kind::I64 => bytes[..8] == number,
            Kind::U8 | Kind::U16 | Kind::U32 => self.read(bytes) == u64::from_le_bytes(number) as f64,
            Kind::I8 | Kind::I16 | Kind::I32 => self.read(bytes) == i64::from_le_bytes(number) as f64,
            // A single is compared as a single.
            Kind::F32 => self.read(bytes) == f64::from(f64::from_le_bytes(number) as f32),
            Kind::F64 => self.read(bytes) == f64::from_le_bytes(number),
        }
    }

    /// Its name in a PLY header.
    pub fn ply_name(self) -> &'static str {
        match self {
            Kind::U8 => "uchar",
            Kind::I8 => "char",
            Kind::U16 => "ushort",
            Kind::I16 => "short",
            Kind::U32 => "uint",
            Kind::I32 => "int",
            // PLY has no 64-bit integers.
            Kind::U64 | Kind::I64 | Kind::F64 => "double",
            Kind::F32 => "float",
        }
    }

    /// Its code in the extra bytes record of LAS 1.4.
    pub fn las_code(self) -> u8 {
        match self {
            Kind::U8 => 1,
            Kind::I8 => 2,
            Kind::U16 => 3,
            Kind::I16 => 4,
            Kind::U32 => 5,
            Kind::I32 => 6,
            Kind::U64 => 7,
            Kind::I64 => 8,
            Kind::F32 => 9,
            Kind::F64 => 10,
        }
    }

    /// The inverse of [`Kind::las_code`].
    pub fn from_las_code(code: u8) -> Option<Kind> {
        use Kind::{F32, F64, I8, I16, I32, I64, U8, U16, U32, U64};
        [U8, I8, U16, I16, U32, I32, U64, I64, F32, F64].into_iter().find(|kind| kind.las_code() == code)
    }
}

/// The first bytes of a slice as an array.
pub(crate) fn array<const N: usize>(bytes: &[u8]) -> [u8; N] {
    bytes[..N].try_into().expect("the slice has N bytes")
}

/// One named value of a point.
#[derive(Clone, Debug, PartialEq)]
pub struct Field {
    /// In lower case, as it is asked for: `intensity`, `red`, `gps_time`.
    pub name: String,
    pub kind: Kind,
    /// Bytes from the begin of the record.
    pub offset: usize,
    /// Bits to the right of the value and the value's mask, for packed fields.
    pub bits: Option<(u32, u64)>,
    /// The value is `stored · scale + shift`.
    pub scale: f64,
    pub shift: f64,
    /// The stored number that stands for no value, widened to eight bytes as LAS has it.
    pub no_data: Option<[u8; 8]>,
}

impl Field {
    /// A field that takes whole bytes and means what it stores.
    pub fn plain(name: impl Into<String>, kind: Kind, offset: usize) -> Self {
        Field { name: name.into(), kind, offset, bits: None, scale: 1.0, shift: 0.0, no_data: None }
    }

    /// Some bits of a byte or word.
    pub fn packed(name: &str, kind: Kind, offset: usize, right: u32, mask: u64) -> Self {
        Field { bits: Some((right, mask)), ..Field::plain(name, kind, offset) }
    }

    /// The value in `record`; NaN where the record says that there is none.
    pub fn value(&self, record: &[u8]) -> f64 {
        if self.no_data.is_some_and(|none| self.kind.is_stored(&record[self.offset..], none)) {
            return f64::NAN;
        }
        let stored = self.kind.read(&record[self.offset..]);
        match self.bits {
            Some((right, mask)) => ((stored as u64 >> right) & mask) as f64,
            None => stored * self.scale + self.shift,
        }
    }
}

/// A name without blanks and capitals.
fn plain(name: &str) -> String {
    name.split_whitespace().collect::<Vec<_>>().join("_").to_ascii_lowercase()
}

/// The fields of a cloud's records, coordinates left out.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Schema {
    pub fields: Vec<Field>,
    /// Bytes of a record.
    pub stride: usize,
}

impl Schema {
    /// The field of that name; upper and lower case are the same, and so are blanks and underscores.
    pub fn field(&self, name: &str) -> Option<&Field> {
        let name = plain(name);
        self.fields.iter().find(|field| field.name == name)
    }

    /// Makes names lower-case, words joined by underscores, and no name twice: the second `intensity` becomes
    /// `intensity_2`. So every format knows a field by the same name.
    pub fn name_once(&mut self) {
        let mut taken = std::collections::HashSet::new();
        for field in &mut self.fields {
            let plain = Some(plain(&field.name)).filter(|name| !name.is_empty()).unwrap_or("unnamed".into());
            let mut name = plain.clone();
            let mut number = 1;
            while !taken.insert(name.clone()) {
                number += 1;
                name = format!("{plain}_{number}");
            }
            field.name = name;
        }
    }

    /// Appends a field at the end of the record.
    pub fn push(&mut self, name: &str, kind: Kind) {
        self.fields.push(Field::plain(name.to_ascii_lowercase(), kind, self.stride));
        self.stride += kind.size();
    }
}

/// Points as they come from a file: coordinates, and the raw record of each.
#[derive(Clone, Debug, Default)]
pub struct Batch {
    pub xyz: Vec<[f64; 3]>,
    /// `xyz.len()` records of the schema's stride.
    pub raw: Vec<u8>,
}

impl Batch {
    /// Takes all points out.
    pub fn clear(&mut self) {
        self.xyz.clear();
        self.raw.clear();
    }
    /// Number of points.
    pub fn len(&self) -> usize {
        self.xyz.len()
    }
    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.xyz.is_empty()
    }
    /// The raw record of point `index`.
    pub fn record<'a>(&'a self, schema: &Schema, index: usize) -> &'a [u8] {
        &self.raw[index * schema.stride..(index + 1) * schema.stride]
    }
}
