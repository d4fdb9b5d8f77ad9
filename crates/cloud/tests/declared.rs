//! What files declare beside their points: values that are none, names, reference systems, units. The files are made
//! here.

mod common;
#[path = "declared/unseen.rs"]
mod unseen;

use std::path::{Path, PathBuf};

use autoref_cloud::clean::{Step, clean};
use autoref_cloud::grid::{self, Dimension, GridReport, Manner, Noise, Options, Stat};
use autoref_cloud::info::info;
use autoref_cloud::io;
use autoref_cloud::schema::{Batch, Field};
use autoref_cloud::smrf;
use common::plan;
use gdal::Dataset;

/// A LAS file of sixteen points, 10 × 10 units, with what a test wants in it.
#[derive(Default)]
struct Las {
    minor: u8,
    point_format: u8,
    vlrs: Vec<(&'static str, u16, Vec<u8>)>,
    /// Behind the fields of each point.
    extra: Vec<Vec<u8>>,
    origin: [f64; 2],
}

/// One description of extra bytes.
fn described(name: &str, code: u8, options: u8, no_data: [u8; 8]) -> Vec<u8> {
    let mut bytes = vec![0; 192];
    (bytes[2], bytes[3]) = (code, options);
    bytes[4..4 + name.len()].copy_from_slice(name.as_bytes());
    bytes[40..48].copy_from_slice(&no_data);
    bytes
}

/// GeoTIFF keys with whole numbers.
fn keys(list: &[(u16, u16)]) -> Vec<u8> {
    let mut words = vec![1, 1, 0, list.len() as u16];
    list.iter().for_each(|(key, value)| words.extend([*key, 0, 1, *value]));
    words.into_iter().flat_map(u16::to_le_bytes).collect()
}

impl Las {
    fn write(&self, path: &Path) {
        let base = [20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67][usize::from(self.point_format)];
        let head_bytes: usize = match self.minor {
            5 => 393,
            4 => 375,
            _ => 227,
        };
        let extra = self.extra.first().map_or(0, Vec::len);
        let mut head = vec![0u8; head_bytes];
        let mut put = |at: usize, bytes: &[u8]| head[at..at + bytes.len()].copy_from_slice(bytes);
        put(0, b"LASF");
        put(24, &[1, self.minor]);
        put(94, &(head_bytes as u16).to_le_bytes());
        let vlr_bytes: usize = self.vlrs.iter().map(|(_, _, content)| 54 + content.len()).sum();
        put(96, &((head_bytes + vlr_bytes) as u32).to_le_bytes());
        put(100, &(self.vlrs.len() as u32).to_le_bytes());
        put(104, &[self.point_format]);
        put(105, &((base + extra) as u16).to_le_bytes());
        if self.minor >= 4 {
            put(247, &16u64.to_le_bytes());
        } else {
            put(107, &16u32.to_le_bytes());
        }
        for axis in 0..3 {
            put(131 + 8 * axis, &0.001f64.to_le_bytes());
            put(155 + 8 * axis, &[self.origin[0], self.origin[1], 0.0][axis].to_le_bytes());
        }
        let mut bytes = head;
        for (user, record, content) in &self.vlrs {
            let mut vlr = vec![0u8; 54];
            vlr[2..2 + user.len()].copy_from_slice(user.as_bytes());
            vlr[18..20].copy_from_slice(&record.to_le_bytes());
            vlr[20..22].copy_from_slice(&(content.len() as u16).to_le_bytes());
            bytes.extend(vlr);
            bytes.extend(content);
        }
        for i in 0..16i32 {
            let mut record = vec![0u8; base];
            for (axis, steps) in [i % 4 * 2500 + 500, i / 4 * 2500 + 500, 1000 * i].into_iter().enumerate() {
                record[4 * axis..4 * axis + 4].copy_from_slice(&steps.to_le_bytes());
            }
            record[12..14].copy_from_slice(&(100 + i as u16).to_le_bytes());
            bytes.extend(record);
            bytes.extend(self.extra.get(i as usize).into_iter().flatten());
        }
        std::fs::write(path, bytes).expect("writable");
    }
}

/// A header that counts fewer points than follow is said, with both counts; what stands behind the points is none of
/// them.
#[test]
fn points_that_the_header_does_not_count_are_said() {
    let folder = Folder::new();
    let path = folder.at("less.las");
    let las = Las { minor: 2, point_format: 0, ..Las::default() };
    las.write(&path);
    assert!(info(&path, None).expect("a cloud").notes.is_empty());
    let mut bytes = std::fs::read(&path).expect("there");
    bytes[107..111].copy_from_slice(&12u32.to_le_bytes());
    std::fs::write(&path, &bytes).expect("writable");
    let found = info(&path, None).expect("a cloud");
    assert_eq!(found.points, 12);
    assert!(found.notes[0].contains("counts 12 points, the file holds 16: the last 4"), "{:?}", found.notes);
    let step = Step::Radius { radius_m: 20.0, least: 1 };
    let report = clean(&path, &folder.at("out.las"), &folder.at("out.las"), &plan(vec![step]));
    let report = report.expect("cleaned");
    assert!(report.notes.iter().any(|note| note.contains("the last 4")), "{:?}", report.notes);
    let report = gridded(&path, &["z"], 10.0).expect("gridded");
    assert!(report.notes.iter().any(|note| note.contains("the last 4")), "{:?}", report.notes);
    // An extended record begins where the points end.
    let path = folder.at("record.las");
    Las { minor: 4, point_format: 6, ..Las::default() }.write(&path);
    let mut bytes = std::fs::read(&path).expect("there");
    let end = bytes.len() as u64;
    bytes[235..243].copy_from_slice(&end.to_le_bytes());
    bytes[243..247].copy_from_slice(&1u32.to_le_bytes());
    let mut record = [vec![0; 60], vec![7; 400]].concat();
    record[20..28].copy_from_slice(&400u64.to_le_bytes());
    std::fs::write(&path, [bytes, record].concat()).expect("writable");
    let found = info(&path, None).expect("a cloud");
    assert!(found.points == 16 && !found.notes.iter().any(|note| note.contains("counts")), "{:?}", found.notes);
}

#[test]
fn vertices_that_the_header_does_not_count_are_said() {
    let folder = Folder::new();
    let head = |format: &str, more: &str| {
        format!(
            "ply\nformat {format} 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\n{more}\
             end_header\n"
        )
    };
    let vertices = (0..9).flat_map(|i| (i as f32).to_le_bytes()).collect::<Vec<u8>>();
    let packed = [head("binary_little_endian", "").into_bytes(), vertices].concat();
    let text = [head("ascii", "").as_str(), "0 0 0\n1 1 1\n2 2 2\n"].concat().into_bytes();
    for (name, bytes) in [("packed.ply", packed), ("text.ply", text)] {
        std::fs::write(folder.at(name), bytes).expect("writable");
        let found = info(&folder.at(name), None).expect("a cloud");
        assert!(found.notes[0].contains("counts 2 points, the file holds 3: the last 1"), "{:?}", found.notes);
    }
    let faces = "element face 1\nproperty list uchar int vertex_indices\n";
    let text = [head("ascii", faces).as_str(), "0 0 0\n1 1 1\n2 0 1\n"].concat();
    std::fs::write(folder.at("faces.ply"), text).expect("writable");
    assert!(info(&folder.at("faces.ply"), None).expect("a cloud").notes.is_empty());
}

#[test]
fn a_file_of_the_point_cloud_library_is_named_with_its_remedy() {
    let folder = Folder::new();
    let head = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nPOINTS 1\nDATA ascii\n1 2 3\n";
    for (name, text) in [("remark.pcd", ["# .PCD v0.7 - Point Cloud Data\n", head].concat()), ("bare.pcd", head.into())]
    {
        std::fs::write(folder.at(name), text).expect("writable");
        let error = info(&folder.at(name), None).expect_err("no reader").to_string();
        assert!(error.contains(name) && error.contains("pcl_pcd2ply"), "{error}");
    }
}

/// A chunk whose bytes are damaged is not the end of the file.
#[test]
fn a_damaged_chunk_is_damaged() {
    let folder = Folder::new();
    let (las, laz) = (folder.at("a.las"), folder.at("a.laz"));
    Las { minor: 2, point_format: 0, ..Las::default() }.write(&las);
    let step = Step::Radius { radius_m: 20.0, least: 1 };
    clean(&las, &laz, &laz, &plan(vec![step])).expect("packed");
    let whole = std::fs::read(&laz).expect("there");
    let begin = u32::from_le_bytes(whole[96..100].try_into().expect("four bytes")) as usize;
    for at in begin + 8..whole.len() - 20 {
        let mut bytes = whole.clone();
        bytes[at] ^= 0xff;
        std::fs::write(&laz, bytes).expect("writable");
        if let Err(error) = info(&laz, None) {
            assert!(!error.to_string().contains("ends before: it is truncated"), "byte {at}: {error}");
        }
    }
}

/// All values of a field, in the file's order.
fn values(path: &Path, name: &str) -> Vec<f64> {
    let (header, mut reader) = io::open(path).expect("a cloud");
    let field: Field = header.schema.field(name).unwrap_or_else(|| panic!("{name}: {:?}", names(path))).clone();
    let mut batch = Batch::default();
    reader.read(&mut batch, 1000).expect("points");
    (0..batch.len()).map(|index| field.value(batch.record(&header.schema, index))).collect()
}

fn names(path: &Path) -> Vec<String> {
    let (header, _) = io::open(path).expect("a cloud");
    header.schema.fields.into_iter().map(|field| field.name).collect()
}

fn gridded(path: &Path, dimensions: &[&str], cell_m: f64) -> autoref_cloud::Result<GridReport> {
    grid::grid(path, path.parent().expect("in a folder"), &options(path, dimensions, cell_m))
}

fn options(path: &Path, dimensions: &[&str], cell_m: f64) -> Options {
    Options {
        cell_m,
        stats: vec![("mean".into(), Stat::Mean), ("max".into(), Stat::Max)],
        dimensions: dimensions.iter().map(|name| Dimension { name: (*name).into(), radius_m: 1.5 * cell_m }).collect(),
        fill_cells: 0,
        power: 1.0,
        manner: Manner::Snapped,
        noise: Noise::LeaveOut,
        shift: None,
        camera: None,
        memory_bytes: 512 << 20,
        scratch: path.parent().expect("in a folder").to_path_buf(),
        crs_wkt: None,
    }
}

struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Folder {
        Folder(tempfile::tempdir().expect("a folder"))
    }
    fn at(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }
}

fn cells(path: &Path) -> Vec<f64> {
    let raster = Dataset::open(path).expect("a raster");
    let band = raster.rasterband(1).expect("a band");
    band.read_band_as::<f64>().expect("cells").data().to_vec()
}

#[test]
fn what_stands_for_no_value_is_none() {
    let folder = Folder::new();
    let path = folder.at("trees.las");
    let record = |i: usize| {
        let tree = if i < 8 { f64::MAX } else { i as f64 };
        let height = if i == 15 { u16::MAX } else { i as u16 };
        let huge = if i == 3 { 1e300 } else { 2.0 };
        [&tree.to_le_bytes()[..], &height.to_le_bytes(), &f64::to_le_bytes(huge)].concat()
    };
    let descriptions = [
        described("treeID", 10, 1, f64::MAX.to_le_bytes()),
        described("height", 3, 1, 65_535u64.to_le_bytes()),
        described("huge", 10, 0, [0; 8]),
    ];
    let vlrs = vec![("LASF_Spec", 4, descriptions.concat())];
    Las { minor: 2, vlrs, extra: (0..16).map(record).collect(), ..Las::default() }.write(&path);
    assert!(values(&path, "treeid")[..8].iter().all(|value| value.is_nan()));
    let report = gridded(&path, &["treeid", "height", "huge", "z"], 10.0).expect("gridded");
    assert_eq!((report.points_left_out, &report.points_without_value[..]), (0, &[8, 1, 1, 0][..]));
    assert_eq!(report.notes.len(), 3, "{:?}", report.notes);
    let stat = |name: &str| cells(&folder.at(&format!("trees_{name}.tif")))[0];
    assert_eq!(
        ["treeid_max", "treeid_mean", "height_max", "huge_max", "z_max"].map(stat),
        [15.0, 11.5, 14.0, 2.0, 15.0]
    );
    // PLY has no such numbers; doubles become NaN, and of whole ones it is said.
    let ply = folder.at("trees.ply");
    let report = clean(&path, &ply, &ply, &plan(Vec::new())).expect("cleaned");
    assert!(values(&ply, "treeid")[7].is_nan() && values(&ply, "height")[15] == 65_535.0);
    assert!(report.notes.len() == 1 && report.notes[0].contains("`height`"), "{:?}", report.notes);
}

#[test]
fn names_are_given_once_and_arrays_have_one_for_each_number() {
    let folder = Folder::new();
    let path = folder.at("extra.las");
    let descriptions = [
        described("Colors", 23, 0, [0; 8]),
        described("Reserved", 0, 3, [0; 8]),
        described("Intensity", 5, 0, [0; 8]),
        described("x", 1, 0, [0; 8]),
    ];
    let record = |i: u16| {
        let colours: Vec<u8> = (0..3).flat_map(|k| (10 * i + k).to_le_bytes()).collect();
        [&colours[..], &[1, 2, 3], &(70_000 + u32::from(i)).to_le_bytes(), &[i as u8], &[9, 9]].concat()
    };
    let vlrs = vec![("LASF_Spec", 4, descriptions.concat())];
    Las { minor: 2, vlrs, extra: (0..16).map(record).collect(), ..Las::default() }.write(&path);
    let expected = ["colors_0", "colors_1", "colors_2", "intensity_2", "x_2"];
    assert_eq!(names(&path)[12..], expected);
    let (ply, laz) = (folder.at("extra.ply"), folder.at("again.laz"));
    let report = clean(&path, &ply, &ply, &plan(Vec::new())).expect("cleaned");
    assert!(report.notes.len() == 1 && report.notes[0].contains("5 bytes"), "{:?}", report.notes);
    clean(&ply, &laz, &laz, &plan(Vec::new())).expect("cleaned");
    for file in [&path, &ply, &laz] {
        assert_eq!(values(file, "intensity")[5], 105.0, "{}", file.display());
        assert_eq!(values(file, "intensity_2")[5], 70_005.0, "{}", file.display());
        assert_eq!((values(file, "colors_2")[3], values(file, "x_2")[7]), (32.0, 7.0), "{}", file.display());
    }
}

#[test]
fn waveforms_are_named_when_they_are_left() {
    let folder = Folder::new();
    let (path, ply) = (folder.at("waves.las"), folder.at("waves.ply"));
    Las { minor: 3, point_format: 4, ..Las::default() }.write(&path);
    let report = clean(&path, &ply, &ply, &plan(Vec::new())).expect("cleaned");
    assert!(report.notes.iter().any(|note| note.contains("waveforms")), "{:?}", report.notes);
}

#[test]
fn fractions_of_intensity_stay_whole_numbers_go_to_their_place() {
    let folder = Folder::new();
    let head = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
                property float intensity\nend_header\n";
    let path = folder.at("in.ply");
    std::fs::write(&path, format!("{head}0 0 0 0.25\n1 0 0 7\n0 1 0 70000\n")).expect("writable");
    for name in ["out.las", "out.laz", "out.copc.laz"] {
        let out = folder.at(name);
        clean(&path, &out, &out, &plan(Vec::new())).expect("cleaned");
        assert_eq!(names(&out).iter().filter(|name| name.contains("intensity")).count(), 1, "{name}");
        let mut found = values(&out, "intensity");
        found.sort_by(f64::total_cmp);
        assert_eq!(found, [0.25, 7.0, 70_000.0], "{name}");
        // Other programs find in its place what is whole and fits, and no name twice.
        let (header, mut reader) = io::open(&out).expect("a cloud");
        let mut batch = Batch::default();
        reader.read(&mut batch, 9).expect("points");
        let described = &header.las.as_ref().expect("LAS").vlr("LASF_Spec", 4).expect("described").content;
        assert_eq!(&described[4..19], b"intensity_full\0", "{name}");
        let mut places: Vec<u8> = (0..3).map(|index| batch.record(&header.schema, index)[12]).collect();
        places.sort_unstable();
        assert_eq!(places, [0, 0, 7], "{name}");
    }
    // And back, and once more: nothing is added.
    let (las, back, again) = (folder.at("out.las"), folder.at("back.ply"), folder.at("again.laz"));
    clean(&las, &back, &back, &plan(Vec::new())).expect("cleaned");
    clean(&back, &again, &again, &plan(Vec::new())).expect("cleaned");
    assert_eq!(names(&again), names(&las));
    // What is counted has no fractions.
    std::fs::write(&path, format!("{}0 0 0 0.25\n1 0 0 7\n0 1 0 7\n", head.replace("intensity", "user_data")))
        .expect("writable");
    let error = clean(&path, &las, &las, &plan(Vec::new())).expect_err("a fraction").to_string();
    assert!(error.contains("`user_data` of 0.25"), "{error}");
}

#[test]
fn units_of_heights_reach_the_grid() {
    let folder = Folder::new();
    let path = folder.at("feet.las");
    let unit = |list: &[(u16, u16)], dimension: &str| {
        let vlrs = vec![("LASF_Projection", 34_735, keys(list))];
        Las { minor: 2, vlrs, origin: [1_500_000.0, 700_000.0], ..Las::default() }.write(&path);
        let report = gridded(&path, &[dimension], 10.0).expect("gridded");
        let raster = Dataset::open(folder.at(&format!("feet_{dimension}_mean.tif"))).expect("a raster");
        let wkt = raster.spatial_ref().ok().and_then(|crs| crs.to_wkt().ok()).unwrap_or_default();
        (raster.rasterband(1).expect("a band").unit(), report, wkt)
    };
    // NAVD88 in metres over UTM.
    let (name, report, wkt) = unit(&[(3072, 32_617), (4096, 5703), (4099, 9001)], "z");
    assert!(name == "m" && wkt.contains("NAVD88") && report.notes.is_empty(), "{name} {wkt}");
    assert_eq!(report.crs.as_deref(), Some("EPSG:32617+5703"));
    // Codes that are of no heights are passed over.
    assert_eq!(unit(&[(3072, 32_617), (4096, 5030)], "z").1.crs.as_deref(), Some("EPSG:32617"));
    for (code, expected) in [(9001, "m"), (9002, "ft"), (9003, "US survey foot"), (1025, "mm"), (1033, "cm")] {
        let (name, report, _) = unit(&[(3072, 2229), (4099, code)], "z");
        assert_eq!((name.as_str(), report.notes.len()), (expected, 0));
    }
    assert_eq!(unit(&[(3072, 2229), (4099, 9003)], "intensity").0, "");
    let (name, report, _) = unit(&[(3072, 2229)], "z");
    assert!(name.is_empty() && report.notes.len() == 1 && report.notes[0].contains("metres"), "{:?}", report.notes);
    assert!(report.unit.to_lowercase().contains("foot"), "{}", report.unit);
    let (name, report, _) = unit(&[(3072, 32_617), (4099, 9014)], "z");
    assert!(name.is_empty() && report.notes.iter().any(|note| note.contains("EPSG:9014")), "{:?}", report.notes);
}

/// A compound system of one part.
const BROKEN: &str = "COMPD_CS[\"Projected\", PROJCS[\"UTM_10N\", GEOGCS [ \"WGS84\" ] ] ]";

#[test]
fn a_system_that_is_not_understood_stays_or_gives_way() {
    let folder = Folder::new();
    let (path, out) = (folder.at("broken.las"), folder.at("out.las"));
    let vlrs = vec![("LASF_Projection", 2112, [BROKEN.as_bytes(), &[0]].concat())];
    Las { minor: 4, point_format: 6, vlrs, ..Las::default() }.write(&path);
    let report = clean(&path, &out, &out, &plan(Vec::new())).expect("cleaned");
    assert!(report.notes.len() == 1 && report.notes[0].contains("goes on as it came"), "{:?}", report.notes);
    assert_eq!(io::open(&out).expect("a cloud").0.crs.as_deref(), Some(BROKEN));
    let mut plan = plan(Vec::new());
    plan.crs_wkt = Some(autoref_raster::crs::Crs::from_epsg(32_610).expect("known").wkt().into());
    clean(&path, &out, &out, &plan).expect("cleaned");
    let crs = io::open(&out).expect("a cloud").0.parsed_crs().expect("understood");
    assert_eq!(crs.epsg(), Some(32_610));
    // Words that are no WKT find no room in LAS; the cloud is named.
    let ply = folder.at("words.ply");
    let head = "ply\nformat ascii 1.0\ncomment crs the old grid\nelement vertex 2\nproperty float x\n\
                property float y\nproperty float z\nend_header\n";
    std::fs::write(&ply, format!("{head}0 0 0\n1 1 1\n")).expect("writable");
    let error = clean(&ply, &out, &out, &common::plan(Vec::new())).expect_err("no system").to_string();
    assert!(error.contains("words.ply") && error.contains("`the old grid`") && error.contains("--crs"), "{error}");
    clean(&ply, &out, &out, &plan).expect("--crs takes its place");
    // What it fails at while a file is staged is no failure of the file.
    let mut staged = autoref_raster::atomic::Transaction::new();
    let made = staged.stage(&folder.at("staged.las"), |part| clean(&path, part, &out, &plan).map(|_| ()));
    made.expect("staged");
}

#[test]
fn heights_over_the_ellipsoid_do_not_take_the_map_with_them() {
    let folder = Folder::new();
    let path = folder.at("three.las");
    let wkt = "PROJCRS[\"VicGrid2020\",BASEGEOGCRS[\"GDA2020\",DATUM[\"GDA2020\",ELLIPSOID[\"GRS 1980\",6378137,\
               298.257222101]]],CONVERSION[\"unnamed\",METHOD[\"Lambert Conic Conformal (2SP)\",ID[\"EPSG\",9802]],\
               PARAMETER[\"Latitude of 1st standard parallel\",-36],\
               PARAMETER[\"Latitude of 2nd standard parallel\",-38],PARAMETER[\"Latitude of false origin\",-37],\
               PARAMETER[\"Longitude of false origin\",145],PARAMETER[\"Easting at false origin\",2500000],\
               PARAMETER[\"Northing at false origin\",2500000]],CS[Cartesian,3],AXIS[\"easting\",east,ORDER[1],\
               LENGTHUNIT[\"metre\",1]],AXIS[\"northing\",north,ORDER[2],LENGTHUNIT[\"metre\",1]],\
               AXIS[\"ellipsoidal height (h)\",up,ORDER[3],LENGTHUNIT[\"metre\",1]]]";
    let vlrs = vec![("LASF_Projection", 2112, [wkt.as_bytes(), &[0]].concat())];
    Las { minor: 4, point_format: 6, vlrs, origin: [2_654_529.0, 2_594_889.0], ..Las::default() }.write(&path);
    gridded(&path, &["z"], 2.0).expect("gridded");
    let raster = Dataset::open(folder.at("three_z_mean.tif")).expect("a raster");
    assert!(raster.projection().contains("VicGrid2020"), "{}", raster.projection());
    assert_eq!(raster.rasterband(1).expect("a band").unit(), "m");
}

#[test]
fn degrees_are_no_lengths() {
    let folder = Folder::new();
    let (path, out) = (folder.at("degrees.las"), folder.at("out.las"));
    let vlrs = vec![("LASF_Projection", 34_735, keys(&[(2048, 4326)]))];
    Las { minor: 2, vlrs, ..Las::default() }.write(&path);
    let ground = Step::Ground(smrf::Options::read("").expect("defaults"));
    for step in [ground, Step::Outliers { neighbours: 8, multiplier: 2.0 }, Step::Radius { radius_m: 1.0, least: 2 }] {
        let error = clean(&path, &out, &out, &plan(vec![step])).expect_err("degrees").to_string();
        assert!(error.contains("degrees.las") && error.contains("map projection") && !out.exists(), "{error}");
    }
    assert!(gridded(&path, &["z"], 1.0).expect_err("degrees").to_string().contains("degrees"));
    let heights = Step::Crop(autoref_cloud::crop::Crop::Height { min_m: 0.0, max_m: 9.0 });
    let report = clean(&path, &out, &out, &plan(vec![heights])).expect("heights are none of these");
    assert_eq!(report.unit, "degree");
}

#[test]
fn las_1_5_is_written_as_1_4() {
    let folder = Folder::new();
    let (path, out) = (folder.at("new.las"), folder.at("out.laz"));
    let vlrs = vec![("LASF_Spec", 4, described("weight", 1, 0, [0; 8]))];
    Las { minor: 5, point_format: 6, vlrs, extra: (0..16).map(|i| vec![i]).collect(), ..Las::default() }.write(&path);
    clean(&path, &out, &out, &plan(Vec::new())).expect("cleaned");
    for file in [&path, &out] {
        assert_eq!(values(file, "weight")[9], 9.0);
        assert_eq!(values(file, "intensity")[9], 109.0);
    }
    let bytes = std::fs::read(&out).expect("there");
    assert_eq!((&bytes[24..26], &bytes[94..96]), (&[1u8, 4][..], &375u16.to_le_bytes()[..]));
}

/// LAS calls withheld points deleted: no grid and no step has them, and they are in the output.
#[test]
fn withheld_points_are_counted_and_left_out() {
    let folder = Folder::new();
    let (path, out) = (folder.at("held.las"), folder.at("out.las"));
    for (point_format, flags, bit) in [(1, 15, 0x80), (6, 15, 0x04)] {
        Las { minor: 4, point_format, ..Las::default() }.write(&path);
        let mut bytes = std::fs::read(&path).expect("written");
        let (begin, size) = (375, if point_format == 1 { 28 } else { 30 });
        // A quarter of the points, far below.
        for point in (0..16).step_by(4) {
            let at = begin + point * size;
            bytes[at + 8..at + 12].copy_from_slice(&(-500_000i32).to_le_bytes());
            bytes[at + flags] |= bit;
        }
        std::fs::write(&path, bytes).expect("written");
        let report = gridded(&path, &["z"], 10.0).expect("gridded");
        assert_eq!((report.points, report.points_left_out, report.points_withheld), (16, 4, 4));
        assert!(report.notes[0].contains("4 points are flagged as withheld"), "{:?}", report.notes);
        assert!(cells(&folder.at("held_z_mean.tif"))[0] > 0.0);
        let steps = vec![Step::Outliers { neighbours: 3, multiplier: 2.0 }, Step::Ground(smrf::Options::default())];
        let report = clean(&path, &out, &out, &plan(steps)).expect("cleaned");
        assert_eq!((report.withheld, report.steps[0].points_in), (4, 12));
        assert_eq!(report.points_kept, 16 - report.steps.iter().map(|step| step.dropped).sum::<u64>());
        let classes = values(&out, "classification");
        let held = values(&out, "withheld");
        // Without the deep points the others are ground, as far as they lie low.
        let of = |flag: f64| classes.iter().zip(&held).filter(move |(_, held)| **held == flag).map(|(class, _)| *class);
        assert!(of(1.0).all(|class| class == 0.0), "{classes:?}");
        assert!(of(0.0).filter(|class| *class == 2.0).count() > 6, "{classes:?}");
        assert_eq!(held.iter().sum::<f64>(), 4.0);
    }
}

#[test]
fn large_extended_records_are_named_when_they_are_left() {
    let folder = Folder::new();
    let (path, out) = (folder.at("behind.las"), folder.at("out.las"));
    Las { minor: 4, point_format: 6, ..Las::default() }.write(&path);
    let mut bytes = std::fs::read(&path).expect("written");
    let at = bytes.len() as u64;
    bytes[235..243].copy_from_slice(&at.to_le_bytes());
    bytes[243..247].copy_from_slice(&1u32.to_le_bytes());
    let mut record = vec![0u8; 60];
    record[2..5].copy_from_slice(b"you");
    record[18..20].copy_from_slice(&7u16.to_le_bytes());
    record[20..28].copy_from_slice(&70_000u64.to_le_bytes());
    bytes.extend(record);
    bytes.extend(vec![b'x'; 70_000]);
    std::fs::write(&path, bytes).expect("written");
    let report = clean(&path, &out, &out, &plan(Vec::new())).expect("cleaned");
    let told = |notes: &[String]| notes.iter().any(|note| note.contains("`you` 7 of 70000 bytes is not kept"));
    assert!(told(&report.notes) && told(&info(&path, None).expect("a cloud").notes), "{:?}", report.notes);
}

/// −9999 is a height like any other, and stays one in the grid.
#[test]
fn a_value_is_never_read_as_none() {
    let folder = Folder::new();
    let path = folder.at("deep.las");
    Las { minor: 2, ..Las::default() }.write(&path);
    let mut bytes = std::fs::read(&path).expect("written");
    for point in 0..16 {
        bytes[227 + point * 20 + 8..][..4].copy_from_slice(&(-9_999_000i32).to_le_bytes());
    }
    std::fs::write(&path, bytes).expect("written");
    gridded(&path, &["z"], 10.0).expect("gridded");
    let found = cells(&folder.at("deep_z_max.tif"));
    assert!(found[0] != -9999.0 && (found[0] + 9999.0).abs() < 0.02, "{found:?}");
}

/// A header of 1.2 has no place for the number of points of the new formats.
#[test]
fn old_headers_with_new_point_formats_are_written_as_1_4() {
    let folder = Folder::new();
    let path = folder.at("old.las");
    Las { minor: 2, point_format: 6, ..Las::default() }.write(&path);
    for name in ["out.las", "out.laz", "out.copc.laz"] {
        let out = folder.at(name);
        clean(&path, &out, &out, &plan(Vec::new())).expect("cleaned");
        assert_eq!(info(&out, None).expect("a cloud").points, 16, "{name}");
        assert_eq!(std::fs::read(&out).expect("there")[25], 4, "{name}");
    }
}

/// Steps that count against an axis: the least and the most are those of the map.
#[test]
fn negative_scale_factors_do_not_exchange_the_bounds() {
    let folder = Folder::new();
    let (path, out) = (folder.at("turned.las"), folder.at("out.las"));
    Las { minor: 2, point_format: 0, ..Las::default() }.write(&path);
    let mut bytes = std::fs::read(&path).expect("there");
    bytes[139..147].copy_from_slice(&(-0.001f64).to_le_bytes());
    std::fs::write(&path, bytes).expect("writable");
    clean(&path, &out, &out, &plan(Vec::new())).expect("cleaned");
    let written = std::fs::read(&out).expect("there");
    let number = |at: usize| f64::from_le_bytes(written[at..at + 8].try_into().expect("eight bytes"));
    assert!(number(195) > number(203), "{} to {}", number(203), number(195));
}

#[test]
fn a_binary_element_of_nothing_takes_no_time() {
    let folder = Folder::new();
    let path = folder.at("nothing.ply");
    let head = format!(
        "ply\nformat binary_little_endian 1.0\nelement nothing {}\nelement vertex 3\nproperty float x\nproperty float \
         y\nproperty float z\nend_header\n",
        u64::MAX
    );
    let points: Vec<u8> = (0..9).flat_map(|i| (i as f32).to_le_bytes()).collect();
    std::fs::write(&path, [head.as_bytes(), &points].concat()).expect("writable");
    assert_eq!(info(&path, None).expect("a cloud").points, 3);
}

/// Sixteen points as a PLY of text with this header between its axes and its end, and these values behind x, y and z.
fn ply_of(path: &Path, comment: &str, properties: &[&str], values: &str) {
    let header: String = properties.iter().map(|name| format!("property float {name}\n")).collect();
    let rows: String = (0..16).map(|i| format!("{} {} 5 {values}\n", i % 4, i / 4)).collect();
    let axes = "property double x\nproperty double y\nproperty double z\n";
    let text = format!("ply\nformat ascii 1.0\n{comment}\nelement vertex 16\n{axes}{header}end_header\n{rows}");
    std::fs::write(path, text).expect("writable");
}

#[test]
fn classes_and_colours_of_other_programs_are_classes_and_colours() {
    let folder = Folder::new();
    let (path, laz) = (folder.at("edited.ply"), folder.at("edited.laz"));
    let step = || plan(vec![Step::Radius { radius_m: 20.0, least: 1 }]);
    for (name, value, kept) in [("scalar_Classification", "2", 2), ("class", "6", 6), ("classification", "9", 9)] {
        ply_of(&path, "comment Created by CloudCompare v2.12.4 (Kyiv)", &[name], value);
        assert_eq!(info(&path, None).expect("a cloud").classes, [(kept, 16)].into(), "{name}");
        clean(&path, &laz, &laz, &step()).expect("cleaned");
        assert_eq!(info(&laz, None).expect("a cloud").classes, [(kept, 16)].into(), "{name}");
    }
    // Noise of an earlier session is no part of a grid; of nothing else there is none.
    ply_of(&path, "comment noise", &["scalar_Classification"], "7");
    let left_out = gridded(&path, &["z"], 10.0).map_or(16, |report| report.points_left_out);
    assert_eq!(left_out, 16);
    // Both names: the usual one counts, the other stays beside it.
    ply_of(&path, "comment both", &["classification", "scalar_classification"], "3 4");
    assert_eq!(info(&path, None).expect("a cloud").classes, [(3, 16)].into());
    ply_of(&path, "comment PhotoScan", &["diffuse_red", "diffuse_green", "diffuse_blue"], "10 200 30");
    clean(&path, &laz, &laz, &step()).expect("cleaned");
    assert_eq!(values(&laz, "green"), [200.0; 16]);
}

#[test]
fn a_global_shift_is_taken_off_where_it_was_added() {
    let folder = Folder::new();
    let path = folder.at("shifted.ply");
    for comment in [
        "comment shift 600000 8650000 0",
        "obj_info offset: 600000, 8650000, 0",
        "comment global shift: (-600000, -8650000, 0)",
        "comment global_shift -600000.0 -8650000.0 0.0",
        "comment Global Offset 600000 8650000 0",
    ] {
        ply_of(&path, comment, &[], "");
        let found = info(&path, None).expect("a cloud");
        let (least, most) = (found.min.expect("points"), found.max.expect("points"));
        assert_eq!((least, most), ([600_000.0, 8_650_000.0, 5.0], [600_003.0, 8_650_003.0, 5.0]), "{comment}");
    }
    ply_of(&path, "comment shift -1200000 -400000 0", &[], "");
    assert_eq!(info(&path, None).expect("a cloud").min.expect("points")[0], -1_200_000.0);
}

/// LAS counts times from the week or, with a bit of its header, from 2011: who reads the points must know.
#[test]
fn times_beyond_a_week_are_written_as_what_they_are() {
    let folder = Folder::new();
    for (time, standard) in [("307644287", 1), ("604799", 0), ("-5000000", 1), ("1700000000", 0)] {
        let (ply, las) = (folder.at("timed.ply"), folder.at("timed.las"));
        ply_of(&ply, "comment times", &["gps_time", "las_pointsourceid"], &format!("{time} 7"));
        clean(&ply, &las, &las, &plan(vec![Step::Radius { radius_m: 20.0, least: 1 }])).expect("cleaned");
        let bytes = std::fs::read(&las).expect("readable");
        assert_eq!(bytes[6] & 1, standard, "{time}");
        let begin = u32::from_le_bytes(bytes[96..100].try_into().expect("four")) as usize;
        assert_eq!(bytes[begin + 20], 7, "the source of a point");
    }
}

#[test]
fn what_its_ending_promises_is_not_read_as_text() {
    let folder = Folder::new();
    let pointer = "version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 5\n";
    for (name, text, said) in [
        ("a.laz", pointer, "a pointer of Git LFS"),
        ("b.las", "1 2 3\n4 5 6\n", "does not begin with `LASF`"),
        ("c.e57", "1 2 3\n4 5 6\n", "does not begin with `ASTM-E57`"),
    ] {
        std::fs::write(folder.at(name), text).expect("writable");
        let error = info(&folder.at(name), None).expect_err("no cloud").to_string();
        assert!(error.contains(name) && error.contains(said), "{error}");
    }
}
