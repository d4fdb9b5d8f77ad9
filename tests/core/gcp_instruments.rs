//! Coordinates as instruments and field programs write them.

use crate::lists_folder::Folder;
use autoref_stream::gcp::convert::{ConvertOptions, ListFormat, convert};
use autoref_stream::gcp::{self, GcpOptions};

const GSI16: &str = "*110001+0000000000000101 81..10+0000000569834260 82..10+0000007031894724 83..10+0000000000047211 \n\
                     *110002+0000000000000102 81..10+0000000570032865 82..10+0000007031837651 83..10+0000000000043898 \n";
const SDR33: &str = "00NMSDR33\n\
                     08KI             101     7031894.724      569834.260          47.211GCP             \n\
                     08KI             102     7031837.651      570032.865          43.898GCP             \n";
const RW5: &str = "JB,NMjob,DT05-01-2026\nMO,AD0,UN1,SF1.0\nSP,PN101,N 7031894.724,E 569834.26,EL47.211,--GCP\n\
                   SP,PN102,N 7031837.651,E 570032.865,EL43.898,--GCP\n";
const SIMA: &str = "Z00,job,,\r\nA00,\r\nA01,1,101,7031894.724,569834.26,47.211,\r\nA01,2,102,7031837.651,570032.865,43.898,\r\nA99,\r\n";
const JOBXML: &str = "<?xml version=\"1.0\"?>\n<JOBFile jobName=\"J\"><FieldBook><PointRecord><Name>101</Name><Grid><North>1</North><East>2</East><Elevation/></Grid></PointRecord></FieldBook><Reductions>\n\
                      <Point><Name>101</Name><Grid><North>7031894.724</North><East>569834.26</East><Elevation>47.211</Elevation></Grid></Point>\n\
                      <Point><Name>102</Name><Grid><North>7031837.651</North><East>570032.865</East><Elevation>43.898</Elevation></Grid></Point></Reductions></JOBFile>";

fn landxml(units: &str, crs: &str, scale: f64) -> String {
    let point = |name: &str, n: f64, e: f64, h: f64| {
        format!("<CgPoint name=\"{name}\">{} {} {}</CgPoint>\n", n / scale, e / scale, h / scale)
    };
    format!(
        "<?xml version=\"1.0\"?>\n<LandXML version=\"1.2\"><Units>{units}</Units>{crs}<CgPoints>\n{}{}</CgPoints></LandXML>",
        point("101", 7_031_894.724, 569_834.26, 47.211),
        point("102", 7_031_837.651, 570_032.865, 43.898)
    )
}

#[test]
fn coordinates_of_instruments() {
    let folder = Folder::new();
    let metric = landxml("<Metric linearUnit=\"meter\"/>", "<CoordinateSystem epsgCode=\"25832\"/>", 1.0);
    let feet = landxml("<Imperial linearUnit=\"USSurveyFoot\"/>", "", 1200.0 / 3937.0);
    for (name, content, format) in [
        ("a.gsi", GSI16, ListFormat::Gsi),
        ("a.txt", GSI16, ListFormat::Gsi),
        ("a.sdr", SDR33, ListFormat::Sdr),
        ("b.txt", SDR33, ListFormat::Sdr),
        ("a.rw5", RW5, ListFormat::Carlson),
        ("c.txt", RW5, ListFormat::Carlson),
        ("a.sim", SIMA, ListFormat::Sima),
        ("d.txt", SIMA, ListFormat::Sima),
        ("a.jxl", JOBXML, ListFormat::JobXml),
        ("a.xml", metric.as_str(), ListFormat::LandXml),
        ("b.xml", feet.as_str(), ListFormat::LandXml),
    ] {
        let path = folder.write(name, content);
        let options = GcpOptions { crs: Some("EPSG:25832".into()), ..GcpOptions::default() };
        let list = gcp::read(&path, &options).unwrap_or_else(|e| panic!("{e}"));
        let first = &list.gcps[0];
        assert_eq!((first.name.as_str(), list.gcps.len()), ("101", 2), "{name}");
        let off = (first.easting - 569_834.26).hypot(first.northing - 7_031_894.724);
        assert!(off < 1e-6 && first.height.is_some_and(|h| (h - 47.211).abs() < 1e-6), "{name}: {first:?}");
        let output = folder.0.path().join(format!("{name}.geojson"));
        let done = convert(&path, &output, &ConvertOptions::default()).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!((done.from, done.points), (format, 2), "{name}");
    }
    let list = gcp::read(&folder.write("c.xml", &metric), &GcpOptions::default()).expect("it names its CRS");
    assert_eq!(list.crs.map(|crs| crs.label()).as_deref(), Some("EPSG:25832"));
}

#[test]
fn measurements_alone_are_refused_with_what_to_export() {
    let folder = Folder::new();
    for (name, content, what) in [
        (
            "a.gsi",
            "110001+00000101 21.102+19723700 22.102+10000000 31..00+00045179\n",
            "Leica GSI holds no coordinates",
        ),
        ("a.sdr", "00NMSDR33\n09F1        1 2 3\n", "Sokkia SDR holds no coordinates"),
        ("a.rw5", "JB,NMjob\nSS,OP1,FP2,AR10.0,ZE90.0,SD5.0\n", "no stored points (records SP)"),
        ("a.jxl", "<JOBFile><FieldBook/></JOBFile>", "no points on the grid"),
        ("a.xml", "<LandXML><Surfaces/></LandXML>", "no CgPoints"),
    ] {
        let error = gcp::read(&folder.write(name, content), &GcpOptions::default()).expect_err(name).to_string();
        assert!(error.contains(what) && error.contains(name) && error.contains("export"), "{error}");
        assert!(!error.contains('\n'), "{error}");
    }
    let path = folder.write("b.gsi", GSI16);
    let options = ConvertOptions { to: Some(ListFormat::Gsi), ..ConvertOptions::default() };
    let error = convert(&path, &folder.0.path().join("o.gsi"), &options).expect_err("never written").to_string();
    assert!(error.contains("Leica's GSI is read, never written") && error.contains("geojson"), "{error}");
}

#[test]
fn names_in_japanese_are_read() {
    let text = "Z00,\u{5ea7}\u{6a19}\u{ff83}\u{ff9e}\u{ff70}\u{ff80},,\nA00,\nA01,1,\u{57fa}\u{6e96}\u{70b9}1,-36258.114,-11624.52,12.3,\nA01,2,K2,-36200,-11600,,\n";
    let (bytes, _, lossy) = encoding_rs::SHIFT_JIS.encode(text);
    assert!(!lossy);
    let folder = Folder::new();
    let path = folder.0.path().join("a.sim");
    std::fs::write(&path, &bytes).expect("writable");
    let options = GcpOptions { crs: Some("EPSG:6677".into()), ..GcpOptions::default() };
    let list = gcp::read(&path, &options).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!((list.gcps[0].name.as_str(), list.gcps[0].easting), ("\u{57fa}\u{6e96}\u{70b9}1", -11_624.52));
}
