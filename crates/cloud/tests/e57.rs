//! E57: what its own crate wrote comes back as it was; what is damaged is refused in one line.

mod common;

use std::path::{Path, PathBuf};

use autoref_cloud::clean::{Invalid, Plan, clean};
use autoref_cloud::io::{self, Header, Precision};
use autoref_cloud::schema::Batch;
use common::{Random, plan};
use e57::{
    E57Reader, E57Writer, Extension, Quaternion, Record, RecordDataType, RecordName, RecordValue, Transform,
    Translation,
};

const LOCAL: &str = r#"LOCAL_CS["a hall",UNIT["metre",1]]"#;

fn record(name: RecordName, data_type: RecordDataType) -> Record {
    Record { name, data_type }
}

fn normal(name: &str) -> Record {
    let name = RecordName::Unknown { namespace: "nor".into(), name: name.into() };
    record(name, RecordDataType::F32)
}

fn pose(quaternion: [f64; 4], translation: [f64; 3]) -> Transform {
    let ([w, x, y, z], [e, n, h]) = (quaternion, translation);
    Transform { rotation: Quaternion { w, x, y, z }, translation: Translation { x: e, y: n, z: h } }
}

/// One scan as it is written.
struct Drawn {
    prototype: Vec<Record>,
    transform: Option<Transform>,
    points: Vec<Vec<RecordValue>>,
}

fn write(path: &Path, scans: &[Drawn], crs: Option<&str>, change: impl Fn(String) -> String) {
    let mut writer = E57Writer::from_file(path, "a file").expect("created");
    writer.set_coordinate_metadata(crs.map(str::to_string));
    let extension = Extension::new("nor", "http://www.libe57.org/E57_NOR_surface_normals.txt");
    writer.register_extension(extension).expect("once");
    for (number, scan) in scans.iter().enumerate() {
        let mut points = writer.add_pointcloud(&format!("scan {number}"), scan.prototype.clone()).expect("sound");
        points.set_transform(scan.transform.clone());
        scan.points.iter().for_each(|point| points.add_point(point.clone()).expect("sound"));
        points.finalize().expect("written");
    }
    writer.finalize_customized_xml(|xml| Ok(change(xml))).expect("written");
}

/// Header, coordinates, and all fields of all points.
type Cloud = (Header, Vec<[f64; 3]>, Vec<Vec<f64>>);

/// Read in batches of `limit`.
fn read(path: &Path, limit: usize) -> Result<Cloud, String> {
    let (header, mut reader) = io::open(path).map_err(|e| e.to_string())?;
    let (mut xyz, mut values) = (Vec::new(), Vec::new());
    let mut batch = Batch::default();
    loop {
        reader.read(&mut batch, limit).map_err(|e| e.to_string())?;
        if batch.is_empty() {
            return Ok((header, xyz, values));
        }
        assert!(batch.len() <= limit && batch.raw.len() == batch.len() * header.schema.stride);
        for index in 0..batch.len() {
            let raw = batch.record(&header.schema, index);
            values.push(header.schema.fields.iter().map(|field| field.value(raw)).collect());
        }
        xyz.extend_from_slice(&batch.xyz);
    }
}

/// Like `read`, of all points.
fn sound(path: &Path) -> Cloud {
    read(path, 1000).expect("it is sound")
}

/// A scan of scaled integers, colours of 8 bits, intensities of fractions, normals; every seventh point is none.
fn hall() -> Drawn {
    let whole = |min, max| RecordDataType::Integer { min, max };
    let scaled = RecordDataType::ScaledInteger { min: -200_000, max: 300_000, scale: 0.001, offset: 7.0 };
    let colour = |name| record(name, RecordDataType::U8);
    let mut random = Random(11);
    let points = (0..900i64).map(|n| {
        let mut at = || RecordValue::ScaledInteger((random.next_u64() % 500_001) as i64 - 200_000);
        let mut point = vec![at(), at(), at(), RecordValue::Integer(if n % 7 == 3 { 2 } else { 0 })];
        point.push(RecordValue::Single(n as f32 / 1024.0));
        point.push(RecordValue::Integer(i64::from(n % 5 == 0)));
        point.extend([n % 256, 255 - n % 256, 3].map(RecordValue::Integer));
        point.extend([n / 30, n % 3, 3].map(RecordValue::Integer));
        point.extend([0.6, 0.0, 0.8].map(RecordValue::Single));
        point
    });
    Drawn {
        points: points.collect(),
        prototype: vec![
            record(RecordName::CartesianX, scaled.clone()),
            record(RecordName::CartesianY, scaled.clone()),
            record(RecordName::CartesianZ, scaled),
            Record::CARTESIAN_INVALID_STATE,
            Record::INTENSITY_UNIT_F32,
            record(RecordName::IsIntensityInvalid, whole(0, 1)),
            colour(RecordName::ColorRed),
            colour(RecordName::ColorGreen),
            colour(RecordName::ColorBlue),
            record(RecordName::RowIndex, whole(0, 29)),
            record(RecordName::ReturnIndex, whole(0, 2)),
            record(RecordName::ReturnCount, whole(3, 3)),
            normal("normalX"),
            normal("normalY"),
            normal("normalZ"),
        ],
        // A quarter turn about z, in numbers that are no unit: x becomes y.
        transform: Some(pose([2.0, 0.0, 0.0, 2.0], [600_000.25, 8_600_000.5, 100.125])),
    }
}

/// A scan of spherical coordinates as doubles, with colours of 16 bits.
fn yard() -> Drawn {
    let points = (0..500i64).map(|n| {
        let angle = n as f64 / 500.0;
        let mut point = [3.0 + angle, angle, 0.5 - angle].map(RecordValue::Double).to_vec();
        point.push(RecordValue::Integer(i64::from(n == 400)));
        point.extend([n * 100, 65_535, 0].map(RecordValue::Integer));
        point
    });
    Drawn {
        points: points.collect(),
        prototype: vec![
            Record::SPHERICAL_RANGE_F64,
            Record::SPHERICAL_AZIMUTH_F64,
            Record::SPHERICAL_ELEVATION_F64,
            Record::SPHERICAL_INVALID_STATE,
            record(RecordName::ColorRed, RecordDataType::U16),
            record(RecordName::ColorGreen, RecordDataType::U16),
            record(RecordName::ColorBlue, RecordDataType::U16),
        ],
        transform: Some(pose([0.0, 1.0, 0.0, 0.0], [1.0, 2.0, 3.0])),
    }
}

fn both(folder: &Path) -> PathBuf {
    let path = folder.join("both.e57");
    write(&path, &[hall(), yard()], Some(LOCAL), |xml| xml);
    path
}

/// Where the points of both scans lie.
fn truth() -> Vec<[f64; 3]> {
    let whole = |value: &RecordValue| match value {
        RecordValue::ScaledInteger(whole) => *whole as f64 * 0.001 + 7.0,
        other => panic!("{other:?}"),
    };
    let of_hall = hall().points.into_iter().enumerate().map(|(n, point)| {
        let [x, y, z] = [0, 1, 2].map(|axis| whole(&point[axis]));
        if n % 7 == 3 { [f64::NAN; 3] } else { [600_000.25 - y, 8_600_000.5 + x, 100.125 + z] }
    });
    let of_yard = (0..500).map(|n| {
        let (range, angle) = (3.0 + f64::from(n) / 500.0, f64::from(n) / 500.0);
        let level = range * (0.5 - angle).cos();
        let [x, y, z] = [level * angle.cos(), level * angle.sin(), range * (0.5 - angle).sin()];
        if n == 400 { [f64::NAN; 3] } else { [1.0 + x, 2.0 - y, 3.0 - z] }
    });
    of_hall.chain(of_yard).collect()
}

#[test]
fn scans_come_back_moved_by_their_poses() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = both(folder.path());
    let (header, xyz, values) = sound(&path);
    assert_eq!((header.points, header.precision), (Some(1400), Precision::Double));
    assert_eq!((header.format.name(), header.description.as_str()), ("E57", "E57, 2 scans"));
    assert_eq!((header.crs.as_deref(), header.intensity), (Some(LOCAL), Some([0.0, 1.0])));
    for (n, (found, expected)) in xyz.iter().zip(truth()).enumerate() {
        // The least step of a double at 8,600 km is 2 nm.
        let near = (0..3).all(|axis| (found[axis] - expected[axis]).abs() < 4e-9);
        assert!(near || (found[0].is_nan() && expected[0].is_nan()), "{n}: {found:?}, {expected:?}");
    }
    let names: Vec<&str> = header.schema.fields.iter().map(|field| field.name.as_str()).collect();
    let expected = "intensity red green blue row_index return_number number_of_returns nx ny nz";
    assert_eq!(names.join(" "), expected);
    for (n, point) in values[..900].iter().enumerate() {
        let n = n as f64;
        assert!(if n % 5.0 == 0.0 { point[0].is_nan() } else { point[0] == n / 1024.0 }, "{n}: {}", point[0]);
        // Beside colours of 16 bits those of 8 are spread.
        assert_eq!(
            point[1..7],
            [n % 256.0 * 257.0, (255.0 - n % 256.0) * 257.0, 771.0, (n / 30.0).floor(), n % 3.0 + 1.0, 3.0]
        );
        let turned = [0.0, 0.6, 0.8];
        assert!((0..3).all(|axis| (point[7 + axis] - turned[axis]).abs() < 1e-7), "{point:?}");
    }
    for (n, point) in values[900..].iter().enumerate() {
        assert!(point[0].is_nan() && point[4].is_nan() && point[7].is_nan());
        assert_eq!((&point[1..4], &point[5..7]), (&[n as f64 * 100.0, 65_535.0, 0.0][..], &[1.0, 1.0][..]));
    }
    for limit in [1, 7, 899] {
        let (_, others, fields) = read(&path, limit).expect("sound");
        assert!(format!("{others:?}{fields:?}") == format!("{xyz:?}{values:?}"), "{limit}");
    }
}

#[test]
fn clouds_are_written_as_laz_and_ply() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = both(folder.path());
    let truth: Vec<[f64; 3]> = truth().into_iter().filter(|place| place[0].is_finite()).collect();
    let refused =
        clean(&path, &folder.path().join("n.ply"), Path::new("n.ply"), &plan(vec![])).expect_err("NaN").to_string();
    assert!(refused.contains("point 4") && refused.contains("--skip-invalid"), "{refused}");
    // One scan alone: the other is too far for LAS beside it.
    let alone = folder.path().join("hall.e57");
    write(&alone, &[hall()], Some(LOCAL), |xml| xml);
    for (input, extension) in [(&path, "ply"), (&alone, "laz")] {
        let output = folder.path().join("out").with_extension(extension);
        let plan = Plan { invalid: Invalid::LeaveOut, ..plan(vec![]) };
        let report = clean(input, &output, &output, &plan).expect("cleaned");
        assert_eq!(report.points - report.invalid, report.points_kept);
        let (header, xyz, values) = sound(&output);
        assert!(header.crs.is_some_and(|crs| crs.contains("a hall")), "{extension}");
        let step = if extension == "ply" { 4e-9 } else { 5.1e-5 };
        for (found, expected) in xyz.iter().zip(&truth) {
            assert!((0..3).all(|axis| (found[axis] - expected[axis]).abs() < step), "{found:?}, {expected:?}");
        }
        let place = |name: &str| header.schema.fields.iter().position(|field| field.name == name).expect(name);
        // The second point of the hall.
        let value = |name: &str| values[1][place(name)];
        assert_eq!([value("red"), value("green"), value("blue")], [257.0, 254.0 * 257.0, 771.0]);
        let intensity = if extension == "ply" { 1.0 / 1024.0 } else { 64.0 };
        assert_eq!([value("intensity"), value("return_number"), value("number_of_returns")], [intensity, 2.0, 3.0]);
        assert_eq!(values[0][place("intensity")].is_nan(), extension == "ply");
    }
}

/// A scan of any attributes and values.
fn any(random: &mut Random, points: usize) -> Drawn {
    let mut kind = || {
        let (a, b) = (
            random.next_u64() as i64 >> (random.next_u64() % 60),
            random.next_u64() as i64 >> (random.next_u64() % 60),
        );
        // The writer subtracts without care.
        let (min, max) = (a.min(b) / 2, a.max(b) / 2);
        match random.next_u64() % 4 {
            0 => RecordDataType::F32,
            1 => RecordDataType::F64,
            2 => RecordDataType::Integer { min, max },
            _ => RecordDataType::ScaledInteger { min, max, scale: 0.01, offset: -3.5 },
        }
    };
    let kinds: Vec<RecordDataType> = (0..3).map(|_| kind()).collect();
    let [x, y, z] = [RecordName::CartesianX, RecordName::CartesianY, RecordName::CartesianZ];
    let mut prototype: Vec<Record> = [x, y, z].into_iter().zip(kinds).map(|(name, kind)| record(name, kind)).collect();
    let (intensity, least) = (kind(), random.next_u64() as i64 % 100);
    prototype.push(record(RecordName::Intensity, intensity));
    prototype.push(record(RecordName::RowIndex, RecordDataType::Integer { min: least, max: least }));
    prototype.push(record(RecordName::TimeStamp, RecordDataType::F64));
    let value = |random: &mut Random, kind: &RecordDataType| {
        let within = |random: &mut Random, min: i64, max: i64| {
            (i128::from(min) + i128::from(random.next_u64()) % (i128::from(max) - i128::from(min) + 1)) as i64
        };
        match *kind {
            RecordDataType::Single { .. } => RecordValue::Single(random.unit() as f32),
            RecordDataType::Double { .. } => RecordValue::Double(random.unit()),
            RecordDataType::Integer { min, max } => RecordValue::Integer(within(random, min, max)),
            RecordDataType::ScaledInteger { min, max, .. } => RecordValue::ScaledInteger(within(random, min, max)),
        }
    };
    let point = |random: &mut Random| prototype.iter().map(|record| value(random, &record.data_type)).collect();
    let points = (0..points).map(|_| point(random)).collect();
    Drawn { prototype, transform: None, points }
}

#[test]
fn points_are_those_of_the_crates_own_reader() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("any.e57");
    let mut random = Random(5);
    for round in 0..40 {
        let drawn = any(&mut random, [1, 2, 77, 12_000][round % 4]);
        write(&path, std::slice::from_ref(&drawn), None, |xml| xml);
        let (header, xyz, values) = sound(&path);
        let mut twin = E57Reader::from_file(&path).expect("sound");
        let cloud = twin.pointclouds().remove(0);
        let kinds: Vec<&RecordDataType> = drawn.prototype.iter().map(|record| &record.data_type).collect();
        let names = ["intensity", "row_index", "time_stamp"];
        assert!(header.schema.fields.iter().map(|field| field.name.as_str()).eq(names));
        let mut count = 0;
        for (n, point) in twin.pointcloud_raw(&cloud).expect("sound").enumerate() {
            let point = point.expect("sound");
            let number = |at: usize| point[at].to_f64(kinds[at]).expect("a number");
            assert_eq!(xyz[n], [0, 1, 2].map(number), "round {round}, point {n}");
            assert_eq!(values[n], [3, 4, 5].map(number), "round {round}, point {n}");
            count += 1;
        }
        assert_eq!((xyz.len(), count), (drawn.points.len(), drawn.points.len()));
    }
}

/// The message of a file that is refused.
fn refusal(path: &Path) -> String {
    let message = read(path, 100).err().unwrap_or_else(|| panic!("{} is read", path.display()));
    assert!(message.starts_with(&path.display().to_string()) && !message.contains('\n'), "{message}");
    message
}

#[test]
fn damaged_files_are_refused_or_read_as_before() {
    let folder = tempfile::tempdir().expect("a folder");
    let whole = std::fs::read(both(folder.path())).expect("there");
    let path = folder.path().join("damaged.e57");
    for length in (9..whole.len()).step_by(89).chain((1024..whole.len()).step_by(1024)) {
        std::fs::write(&path, &whole[..length]).expect("written");
        refusal(&path);
    }
    let before = format!("{:?}", sound(&folder.path().join("both.e57")));
    let mut bytes = whole.clone();
    // All of the header and steps through the rest.
    for at in (8..48).chain((48..whole.len()).step_by(37)) {
        bytes[at] ^= 1 << (at % 8);
        std::fs::write(&path, &bytes).expect("written");
        bytes[at] = whole[at];
        match read(&path, 100) {
            Ok(found) => assert!(format!("{found:?}") == before, "byte {at}"),
            Err(message) => assert!(!message.contains('\n') && message.contains("damaged.e57"), "{message}"),
        }
    }
    let end = whole.len();
    for (field, value) in
        [(16, u64::MAX), (24, u64::MAX), (24, end as u64), (32, u64::MAX), (32, 1 << 40), (40, 0), (40, 1 << 62)]
    {
        let mut bytes = whole.clone();
        bytes[field..field + 8].copy_from_slice(&value.to_le_bytes());
        std::fs::write(&path, &bytes).expect("written");
        refusal(&path);
    }
}

#[test]
fn xml_that_lies_is_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("lies.e57");
    let deep = |xml: String| xml.replace("<data3D", &format!("{}<data3D", "<a>".repeat(200_000)));
    let lies: [(&str, &dyn Fn(String) -> String); 11] = [
        ("truncated", &|xml| xml.replace("recordCount=\"500\"", "recordCount=\"18446744073709551615\"")),
        ("truncated", &|xml| xml.replace("recordCount=\"500\"", "recordCount=\"900000\"")),
        ("fewer points", &|xml| xml.replace("recordCount=\"500\"", "recordCount=\"501\"")),
        ("XML", &|xml| xml.replace("recordCount=\"500\"", "recordCount=\"-1\"")),
        ("page", &|xml| xml.replace("fileOffset=\"", "fileOffset=\"9999999999")),
        ("section", &|xml| xml.replace("fileOffset=\"", "fileOffset=\"4")),
        ("neither Cartesian", &|xml| xml.replace("sphericalRange", "distance")),
        ("a pose", &|xml| xml.replace("<x type=\"Float\">1<", "<x type=\"Float\">0<")),
        ("scale 0", &|xml| xml.replace("scale=\"0.001\"", "scale=\"0\"")),
        ("tags", &|xml| xml.replace("<data3D", &format!("{}<data3D", "<a/>".repeat(1 << 20)))),
        ("XML", &deep),
    ];
    for (word, lie) in lies {
        write(&path, &[hall(), yard()], None, lie);
        let message = refusal(&path);
        assert!(message.contains(word), "{word}: {message}");
    }
    // Nothing says whether points without bits are there.
    let same = |name| record(name, RecordDataType::Integer { min: 4, max: 5 });
    let prototype = vec![same(RecordName::CartesianX), same(RecordName::CartesianY), same(RecordName::CartesianZ)];
    let points = vec![vec![RecordValue::Integer(4); 3]; 3];
    let constant = |xml: String| xml.replace("maximum=\"5\"", "maximum=\"4\"");
    write(&path, &[Drawn { prototype, transform: None, points }], None, constant);
    assert!(refusal(&path).contains("no attribute takes any bits"));
}

#[test]
fn files_without_points_are_clouds_of_none() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("none.e57");
    let empty = || Drawn { points: Vec::new(), ..yard() };
    for scans in [vec![], vec![empty()], vec![empty(), empty()]] {
        write(&path, &scans, Some("no system"), |xml| xml);
        let (header, xyz, _) = sound(&path);
        assert_eq!((header.points, xyz.len(), header.crs), (Some(0), 0, None));
    }
    // One without points beside one with them says nothing of the schema.
    write(&path, &[empty(), hall()], None, |xml| xml);
    assert_eq!(sound(&path).1.len(), 900);
}
