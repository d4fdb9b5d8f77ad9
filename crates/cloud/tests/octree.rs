//! COPC files: every point once, in a node whose cube holds it, whatever the memory.

mod common;

use std::collections::HashMap;
use std::path::Path;

use autoref_cloud::io::{self, Format, Header, OutPoint, Precision, Target};
use autoref_cloud::schema::{Batch, Kind, Schema};
use common::{Random, plan, shared};

/// A node of the hierarchy.
#[derive(Debug)]
struct Node {
    key: [i32; 4],
    begin: u64,
    bytes: i32,
    points: i32,
}

struct Octree {
    centre: [f64; 3],
    half: f64,
    times: [f64; 2],
    /// In the order of their chunks.
    nodes: Vec<Node>,
}

fn number<const N: usize>(bytes: &[u8], at: usize) -> [u8; N] {
    bytes[at..at + N].try_into().expect("so many bytes")
}

/// Reads the octree as the specification describes it.
fn octree(bytes: &[u8]) -> Octree {
    let (u16_at, u32_at) =
        (|at| u16::from_le_bytes(number(bytes, at)), |at| u32::from_le_bytes(number(bytes, at)) as usize);
    let (u64_at, f64_at) =
        (|at| u64::from_le_bytes(number(bytes, at)) as usize, |at| f64::from_le_bytes(number(bytes, at)));
    assert_eq!((&bytes[24..26], u16_at(94), bytes[6] & 0x10), (&[1u8, 4][..], 375, 0x10));
    assert_eq!((&bytes[377..382], u16_at(393), u16_at(395)), (&b"copc\0"[..], 1, 160));
    let info = 375 + 54;
    let (root, length) = (u64_at(info + 40), u64_at(info + 48));
    // The hierarchy is the only extended record.
    assert_eq!((u64_at(235) + 60, u32_at(243)), (root, 1));
    assert_eq!((&bytes[root - 58..root - 53], u16_at(root - 42)), (&b"copc\0"[..], 1000));
    assert_eq!((u64_at(root - 40), root + length, length % 32), (length, bytes.len(), 0));
    let node = |at: usize| Node {
        key: [0, 4, 8, 12].map(|k| u32_at(at + k) as i32),
        begin: u64_at(at + 16) as u64,
        bytes: u32_at(at + 24) as i32,
        points: u32_at(at + 28) as i32,
    };
    let mut nodes: Vec<Node> = (root..root + length).step_by(32).map(node).collect();
    nodes.sort_by_key(|node| node.begin);
    // Chunks follow each other from the first byte behind the table's place on.
    let mut at = u32_at(96) as u64 + 8;
    for node in &nodes {
        assert_eq!(node.begin, at, "{node:?}");
        at += node.bytes as u64;
    }
    Octree {
        centre: [0, 8, 16].map(|k| f64_at(info + k)),
        half: f64_at(info + 24),
        times: [f64_at(info + 56), f64_at(info + 64)],
        nodes,
    }
}

/// All points in the file's order, with the values of these fields.
fn points(path: &Path, fields: &[&str]) -> Vec<([f64; 3], Vec<f64>)> {
    let (header, mut reader) = io::open(path).expect("a cloud");
    let fields: Vec<_> = fields.iter().map(|name| header.schema.field(name).expect("a field").clone()).collect();
    let (mut all, mut batch) = (Vec::new(), Batch::default());
    loop {
        reader.read(&mut batch, 10_000).expect("points");
        if batch.is_empty() {
            return all;
        }
        for (at, xyz) in batch.xyz.iter().enumerate() {
            let raw = batch.record(&header.schema, at);
            all.push((*xyz, fields.iter().map(|field| field.value(raw)).collect()));
        }
    }
}

/// Every node but the root has its parent, and its points lie in its cube.
fn check_nodes(octree: &Octree, points: &[([f64; 3], Vec<f64>)]) {
    let known: std::collections::HashSet<[i32; 4]> = octree.nodes.iter().map(|node| node.key).collect();
    assert_eq!(known.len(), octree.nodes.len());
    let mut points = points.iter();
    for node in &octree.nodes {
        let [level, place @ ..] = node.key;
        assert!(level == 0 || known.contains(&[level - 1, place[0] / 2, place[1] / 2, place[2] / 2]), "{node:?}");
        let side = 2.0 * octree.half / 2f64.powi(level);
        for _ in 0..node.points {
            let (xyz, _) = points.next().expect("as many as the nodes count");
            for axis in 0..3 {
                let low = octree.centre[axis] - octree.half + f64::from(place[axis]) * side;
                let inside = xyz[axis] >= low - 1e-6 && xyz[axis] <= low + side + 1e-6;
                assert!(inside, "{node:?}: {xyz:?}");
            }
        }
    }
    assert!(points.next().is_none());
}

/// A hilly ground of `count` points, a tower upon it and a thousand points at one place.
fn cloud(count: usize) -> Vec<([f64; 3], f64)> {
    let mut random = Random(11);
    (0..count)
        .map(|index| {
            let (u, v) = (random.unit(), random.unit());
            let xyz: [f64; 3] = match index {
                0..1000 => [512.0, 512.0, 40.0],
                _ if index % 10 == 0 => [700.0 + 20.0 * u, 300.0 + 20.0 * v, 100.0 * random.unit()],
                _ => [1000.0 * u, 1000.0 * v, 20.0 * (9.0 * u).sin() * (7.0 * v).cos()],
            };
            (xyz.map(|value| (value * 1e3).round() / 1e3), 1e5 + index as f64)
        })
        .collect()
}

fn write(path: &Path, points: &[([f64; 3], f64)], memory_bytes: u64) {
    let mut schema = Schema::default();
    schema.push("gps_time", Kind::F64);
    schema.push("weight", Kind::F32);
    let source = Header {
        format: Format::Text,
        points: Some(points.len() as u64),
        schema,
        precision: Precision::Steps([1e-3; 3]),
        crs: Some("EPSG:25833".into()),
        shift: None,
        las: None,
        intensity: None,
        colours: None,
        description: String::new(),
    };
    let all = || points.iter().map(|(xyz, _)| xyz);
    let bound = |of: fn(f64, f64) -> f64, from: f64| [0, 1, 2].map(|axis| all().map(|xyz| xyz[axis]).fold(from, of));
    let scratch = std::env::temp_dir();
    let target = Target {
        source: &source,
        shift: [600_000.0, 8_600_000.0, 0.0],
        points: points.len() as u64,
        with_range: false,
        min: bound(f64::min, f64::INFINITY),
        max: bound(f64::max, f64::NEG_INFINITY),
        crs_wkt: None,
        scratch: &scratch,
        memory_bytes,
    };
    let mut writer = io::create(path, path, &target).expect("a writer");
    for part in points.chunks(5000) {
        let raw: Vec<Vec<u8>> = part
            .iter()
            .map(|(_, time)| [&time.to_le_bytes()[..], &((time - 1e5) as f32).to_le_bytes()].concat())
            .collect();
        let out: Vec<OutPoint<'_>> = part
            .iter()
            .zip(&raw)
            .map(|((xyz, _), raw)| OutPoint { xyz: *xyz, raw, class: Some(2), range: None })
            .collect();
        writer.write(&out).expect("room");
    }
    assert_eq!(writer.finish().expect("room"), points.len() as u64);
}

#[test]
fn every_point_stands_in_its_node_whatever_the_memory() {
    let folder = tempfile::tempdir().expect("a folder");
    let made = cloud(400_000);
    let wide = folder.path().join("wide.copc.laz");
    write(&wide, &made, 1 << 30);
    let bytes = std::fs::read(&wide).expect("there");
    let tree = octree(&bytes);
    let read = points(&wide, &["gps_time", "weight", "classification"]);
    check_nodes(&tree, &read);
    assert!(tree.nodes.iter().any(|node| node.key[0] >= 2), "one level would show nothing");
    // An upper level is a choice from everywhere: no cell of its node has two points.
    let root = &read[..tree.nodes[0].points as usize];
    let side = 2.0 * tree.half / 128.0;
    let low: Vec<f64> = tree.centre.iter().map(|c| c - tree.half).collect();
    let cell = |xyz: &[f64; 3]| [0, 1, 2].map(|axis| ((xyz[axis] - low[axis]) / side).floor() as i64);
    let mut cells: Vec<_> = root.iter().map(|(xyz, _)| cell(xyz)).collect();
    cells.sort_unstable();
    let twice = cells.windows(2).filter(|pair| pair[0] == pair[1]).count();
    assert!(root.len() > 10_000 && twice < root.len() / 1000, "{twice} of {}", root.len());
    assert_eq!(tree.times, [1e5, 1e5 + 399_999.0]);
    // Each point is there once, with its values.
    let by_time: HashMap<u64, &[f64; 3]> = made.iter().map(|(xyz, time)| (time.to_bits(), xyz)).collect();
    assert_eq!(read.len(), made.len());
    let mut seen = std::collections::HashSet::new();
    for (xyz, values) in &read {
        let source = by_time[&values[0].to_bits()];
        assert!(seen.insert(values[0].to_bits()));
        assert_eq!((values[1], values[2]), (values[0] - 1e5, 2.0));
        for (axis, shift) in [600_000.0, 8_600_000.0, 0.0].into_iter().enumerate() {
            assert!((xyz[axis] - source[axis] - shift).abs() < 1e-6, "{xyz:?} {source:?}");
        }
    }
    // From spool to spool the same file comes.
    let narrow = folder.path().join("narrow.copc.laz");
    write(&narrow, &made, 0);
    assert!(bytes == std::fs::read(&narrow).expect("there"));
}

#[test]
fn few_points_and_one_place_are_octrees_too() {
    let folder = tempfile::tempdir().expect("a folder");
    for (name, made) in [
        ("one", vec![([1.0, 2.0, 3.0], 1e5)]),
        ("place", vec![([1.0, 2.0, 3.0], 1e5); 70_000]),
        ("line", (0..80_000).map(|i| ([f64::from(i) * 1e-3, 0.0, 0.0], 1e5)).collect()),
    ] {
        let path = folder.path().join(format!("{name}.copc.laz"));
        write(&path, &made, 1 << 30);
        let read = points(&path, &[]);
        assert_eq!(read.len(), made.len(), "{name}");
        check_nodes(&octree(&std::fs::read(&path).expect("there")), &read);
    }
}

/// LAS 1.2, point format 3, with two extra bytes a point that are described and one that is not.
fn old_las(count: u32) -> Vec<u8> {
    let mut head = vec![0u8; 227];
    head[..4].copy_from_slice(b"LASF");
    head[24..26].copy_from_slice(&[1, 2]);
    // GPS times count from the standard epoch.
    head[6] = 1;
    head[26..30].copy_from_slice(b"MINE");
    head[94..96].copy_from_slice(&227u16.to_le_bytes());
    let vlr_bytes = 54 + 192;
    head[96..100].copy_from_slice(&(227 + vlr_bytes as u32).to_le_bytes());
    head[100..104].copy_from_slice(&1u32.to_le_bytes());
    head[104] = 3;
    head[105..107].copy_from_slice(&37u16.to_le_bytes());
    head[107..111].copy_from_slice(&count.to_le_bytes());
    for (axis, scale) in [0.01f64, 0.01, 0.001].into_iter().enumerate() {
        head[131 + 8 * axis..139 + 8 * axis].copy_from_slice(&scale.to_le_bytes());
        head[155 + 8 * axis..163 + 8 * axis].copy_from_slice(&(1000.5 * axis as f64).to_le_bytes());
    }
    let mut vlr = vec![0u8; vlr_bytes];
    vlr[2..11].copy_from_slice(b"LASF_Spec");
    vlr[18..20].copy_from_slice(&4u16.to_le_bytes());
    vlr[20..22].copy_from_slice(&192u16.to_le_bytes());
    // A number in hundredths.
    vlr[54 + 2..54 + 4].copy_from_slice(&[3, 0x08]);
    vlr[54 + 4..54 + 13].copy_from_slice(b"amplitude");
    vlr[54 + 112..54 + 120].copy_from_slice(&0.01f64.to_le_bytes());
    let mut bytes = [head, vlr].concat();
    for i in 0..count {
        let mut record = vec![0u8; 37];
        for (axis, step) in [7 * i, 13 * (i % 500), i % 1009].into_iter().enumerate() {
            record[4 * axis..4 * axis + 4].copy_from_slice(&step.to_le_bytes());
        }
        record[12..14].copy_from_slice(&((i % 60_000) as u16).to_le_bytes());
        // Return 2 of 3, backwards, and on the edge.
        record[14] = 2 | 3 << 3 | 1 << 6 | 1 << 7;
        // Class 5, a key point.
        record[15] = 5 | 1 << 6;
        record[16] = (i % 41) as u8;
        record[17] = 9;
        record[18..20].copy_from_slice(&77u16.to_le_bytes());
        record[20..28].copy_from_slice(&(3e8 + f64::from(i)).to_le_bytes());
        for (k, colour) in [i, 2 * i, 3 * i].into_iter().enumerate() {
            record[28 + 2 * k..30 + 2 * k].copy_from_slice(&(colour as u16).to_le_bytes());
        }
        record[34..36].copy_from_slice(&((i % 5000) as u16).to_le_bytes());
        record[36] = 3;
        bytes.extend(record);
    }
    bytes
}

#[test]
fn old_point_formats_are_raised_with_all_they_hold() {
    let folder = tempfile::tempdir().expect("a folder");
    let input = folder.path().join("old.las");
    std::fs::write(&input, old_las(3000)).expect("writable");
    let output = folder.path().join("new.copc.laz");
    autoref_cloud::clean::clean(&input, &output, &output, &plan(Vec::new())).expect("cleaned");
    let names = [
        "gps_time",
        "intensity",
        "return_number",
        "number_of_returns",
        "scan_direction_flag",
        "edge_of_flight_line",
        "classification",
        "key_point",
        "withheld",
        "user_data",
        "point_source_id",
        "red",
        "green",
        "blue",
        "amplitude",
    ];
    let ([mut old, mut new], [old_angle, new_angle]) = (
        [points(&input, &names), points(&output, &names)],
        [(&input, "scan_angle_rank"), (&output, "scan_angle")].map(|(path, name)| points(path, &["gps_time", name])),
    );
    old.sort_by(|a, b| a.1[0].total_cmp(&b.1[0]));
    new.sort_by(|a, b| a.1[0].total_cmp(&b.1[0]));
    assert!(old == new);
    let angles = |list: Vec<([f64; 3], Vec<f64>)>| -> HashMap<u64, f64> {
        list.into_iter().map(|(_, values)| (values[0].to_bits(), values[1])).collect()
    };
    let (old_angle, new_angle) = (angles(old_angle), angles(new_angle));
    assert!(old_angle.iter().all(|(time, angle)| (new_angle[time] - angle).abs() <= 0.003 + 1e-9));
    // The byte that nobody described, who made the file, and what its times count from.
    let (header, mut reader) = io::open(&output).expect("a cloud");
    let las = header.las.as_ref().expect("LAS");
    assert_eq!((las.point_format, las.record_bytes, &las.raw[26..30], las.raw[6] & 1), (7, 39, &b"MINE"[..], 1));
    let mut batch = Batch::default();
    reader.read(&mut batch, 1).expect("a point");
    assert_eq!(batch.raw[38], 3);
}

/// Headers of LAS 1.2 are shorter, whatever their point format.
#[test]
fn old_headers_with_new_point_formats_are_lengthened() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut bytes = vec![0u8; 227];
    bytes[..4].copy_from_slice(b"LASF");
    bytes[24..26].copy_from_slice(&[1, 2]);
    bytes[94..96].copy_from_slice(&227u16.to_le_bytes());
    bytes[96..100].copy_from_slice(&227u32.to_le_bytes());
    bytes[104] = 6;
    bytes[105..107].copy_from_slice(&30u16.to_le_bytes());
    bytes[107..111].copy_from_slice(&2u32.to_le_bytes());
    for axis in 0..3 {
        bytes[131 + 8 * axis..139 + 8 * axis].copy_from_slice(&0.01f64.to_le_bytes());
    }
    for step in [100i32, 200] {
        let mut record = vec![0u8; 30];
        (0..3).for_each(|axis| record[4 * axis..4 * axis + 4].copy_from_slice(&step.to_le_bytes()));
        bytes.extend(record);
    }
    let input = folder.path().join("old.las");
    std::fs::write(&input, bytes).expect("writable");
    let output = folder.path().join("new.copc.laz");
    autoref_cloud::clean::clean(&input, &output, &output, &plan(Vec::new())).expect("cleaned");
    assert_eq!(points(&output, &[]).iter().map(|(xyz, _)| xyz[2]).collect::<Vec<_>>(), [1.0, 2.0]);
}

/// The range stands behind bytes that nobody described, and is described there.
#[test]
fn the_range_is_found_behind_bytes_that_nobody_described() {
    use autoref_cloud::clean::Step;
    let folder = tempfile::tempdir().expect("a folder");
    let input = folder.path().join("old.las");
    std::fs::write(&input, old_las(500)).expect("writable");
    let camera = [10.0, 1000.0, 5000.0];
    let crop = autoref_cloud::crop::Crop::range(camera, 10.0).expect("above the ground");
    for name in ["new.laz", "new.copc.laz"] {
        let output = folder.path().join(name);
        autoref_cloud::clean::clean(&input, &output, &output, &plan(vec![Step::Crop(crop.clone())])).expect("cleaned");
        let read = points(&output, &["range", "amplitude", "gps_time"]);
        assert_eq!(read.len(), 500);
        for (xyz, values) in read {
            assert!((values[0] - autoref_cloud::crop::distance(xyz, camera)).abs() < 1e-9, "{name}: {values:?}");
            assert!((values[1] - (values[2] - 3e8) * 0.01).abs() < 1e-9, "{name}: {values:?}");
        }
    }
}

#[test]
fn a_survey_keeps_its_points() {
    let Some(input) = shared("pdal/autzen_trim.laz") else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let output = folder.path().join("autzen.copc.laz");
    autoref_cloud::clean::clean(&input, &output, &output, &plan(Vec::new())).expect("cleaned");
    let names = ["gps_time", "intensity", "return_number", "red", "classification"];
    let (mut old, mut new) = (points(&input, &names), points(&output, &names));
    check_nodes(&octree(&std::fs::read(&output).expect("there")), &new);
    for list in [&mut old, &mut new] {
        list.sort_by(|a, b| a.1.partial_cmp(&b.1).expect("numbers").then(a.0.partial_cmp(&b.0).expect("numbers")));
    }
    assert!(old == new);
}
