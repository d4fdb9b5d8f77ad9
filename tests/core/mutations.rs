//! Every text that comes from outside, broken in ten thousand ways: an answer or an error, never a panic.
//! `AUTOREF_LARGE=1` breaks each of them more often.

use std::path::Path;

use crate::common::{Random, trials};
use autoref_raster::crs::Crs;
use autoref_review::{PatchFile, Subject};
use autoref_stream::gcp::{self, GcpOptions};
use autoref_stream::georef::candidate_list;
use autoref_stream::profile::Profile;
use autoref_stream::result::RunResult;

/// What is put in the place of a word or a number.
const ODD: [&str; 22] = [
    "",
    "NaN",
    "inf",
    "-inf",
    "1e308",
    "1e-320",
    "-0",
    "99999999999999999999999",
    "0x10",
    "1,5",
    "1.234.567,8",
    "١٢٣",
    "\u{0}",
    "\u{feff}",
    "\"",
    "''",
    ";;;;",
    "\\u0000",
    "EPSG:0",
    "EPSG:999999",
    "]]>",
    "%s",
];

/// One to four changes anywhere.
fn broken(text: &[u8], random: &mut Random) -> Vec<u8> {
    let mut bytes = text.to_vec();
    for _ in 0..1 + random.below(4) {
        if bytes.is_empty() {
            break;
        }
        let at = random.below(bytes.len());
        let end = (at + 1 + random.below(40)).min(bytes.len());
        match random.below(8) {
            0 => bytes[at] = random.bits() as u8,
            1 => bytes[at] ^= 1 << random.below(8),
            2 => drop(bytes.drain(at..end)),
            3 => bytes.truncate(at),
            4 => {
                let piece = bytes[at..end].to_vec();
                let to = random.below(bytes.len() + 1);
                bytes.splice(to..to, piece);
            }
            5 => drop(bytes.splice(at..at, [b"\n,;\t{}[]<>\"' "[random.below(13)]])),
            // A whole word or number.
            _ => {
                let word = |b: &u8| b.is_ascii_alphanumeric() || matches!(b, b'.' | b'-' | b'+');
                let from = (0..at).rev().find(|&i| !word(&bytes[i])).map_or(0, |i| i + 1);
                let to = (at..bytes.len()).find(|&i| !word(&bytes[i])).unwrap_or(bytes.len());
                bytes.splice(from..to.max(from), ODD[random.below(ODD.len())].bytes());
            }
        }
    }
    bytes
}

/// Reads broken copies of each text under its name; a panic is told with what was read.
fn survive(texts: &[(&str, &str)], read: impl Fn(&Path) + std::panic::RefUnwindSafe) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let mut random = Random::new(23);
    for (name, text) in texts {
        let path = folder.path().join(name);
        for trial in 0..trials(250, 20_000) {
            let bytes = broken(text.as_bytes(), &mut random);
            std::fs::write(&path, &bytes).expect("writable");
            let survived = std::panic::catch_unwind(|| read(&path)).is_ok();
            assert!(survived, "{name}, trial {trial}: {:?}", String::from_utf8_lossy(&bytes));
        }
    }
}

#[test]
fn lists_of_every_dialect() {
    let texts = [
        (
            "a.csv",
            "name,easting,northing,height,sigma_m,role,crs\nP1,570406.861,7032516.804,80.3,0.01,control,EPSG:25832\nP2,570413.37,7032503.48,79,,check,\n\"P 3\",570400.1,7032500.2,,,,\n",
        ),
        ("b.csv", "Navn;Nord;Øst;Høyde\nP1;7032516,80;570406,86;80,1\nP2;7032503,48;570413,37;79\n"),
        ("c.txt", "P1 570406.8 7032516.8 80\nP2 570413.3 7032503.4 79\n1001 570403.3 7032513.4 79\n"),
        ("d.csv", "name;lon;lat\nA;10°24'12.5\"E;63°24'36\"N\nB;10,5;63,4\n"),
        ("e.txt", "EPSG:25832\n570406 7032516 80 10 20 a.jpg A\n570410 7032519 80 1 2 a.jpg B\n"),
        (
            "f.points",
            "#CRS: EPSG:25832\nmapX,mapY,sourceX,sourceY,enable,dX,dY,residual\n570406,7032516,3,-4,1,0,0,0\n570416,7032526,30,-40,1,0,0,0\n",
        ),
        (
            "g.kof",
            "-05 PPPPPPPPPP KKKKKKKK XXXXXXXX.XXX YYYYYYY.YYY ZZZZ.ZZZ\n 05 P1        5001     7032516.804   570406.861  80.318\n 05 P2        5001     7032503.480   570413.370  79.000\n",
        ),
        (
            "h.xml",
            "<document><chunk><markers><marker label=\"A\"><reference x=\"570406\" y=\"7032516\" z=\"80\" enabled=\"1\"/></marker><marker label=\"B\"><reference x=\"570416\" y=\"7032526\"/></marker></markers><reference>LOCAL_CS[\"l\"]</reference></chunk></document>",
        ),
        (
            "i.xml",
            "<DicoAppuisFlottant><OneAppuisDAF><Pt>570406 7032516 80</Pt><NamePt>A</NamePt><Incertitude>0.1 0.1 0.1</Incertitude></OneAppuisDAF><OneAppuisDAF><Pt>570416 7032526 81</Pt><NamePt>B</NamePt></OneAppuisDAF></DicoAppuisFlottant>",
        ),
        (
            "j.geojson",
            "{\"type\":\"FeatureCollection\",\"crs\":{\"type\":\"name\",\"properties\":{\"name\":\"urn:ogc:def:crs:EPSG::25832\"}},\"features\":[{\"type\":\"Feature\",\"properties\":{\"name\":\"A\",\"role\":\"check\"},\"geometry\":{\"type\":\"Point\",\"coordinates\":[570406.0,7032516.0,80]}},{\"type\":\"Feature\",\"properties\":{\"id\":2,\"sigma_m\":0.1},\"geometry\":{\"type\":\"Point\",\"coordinates\":[570416,7032526]}}]}",
        ),
        (
            "k.csv",
            "# CoordinateSystem: EPSG:25832\n#Label,X/East,Y/North,Z/Altitude,Accuracy (m),Enabled\nA,570406,7032516,80,0.01,1\nB,570416,7032526,80,0.01,0\n",
        ),
    ];
    survive(&texts, |path| drop(gcp::read(path, &GcpOptions::default())));
}

#[test]
fn profiles_patches_results_and_candidates() {
    let orange = Profile::builtin("orange").expect("shipped").to_toml();
    survive(&[("p.toml", orange.as_str())], |path| drop(Profile::load(path.to_str().expect("plain"))));
    let patch = r#"{"schema":"autoref-stream-patch","schema_version":1,"for":"gcps","source":"a.autoref.json","edits":[{"gcp":"A","action":"reject"},{"gcp":"B","action":"move","x":1.5,"y":2}],"shown":{"points":5,"rmse_m":0.1,"geotransform":[1,2,3,4,5,6]}}"#;
    survive(&[("patch.json", patch)], |path| drop(PatchFile::read(path, Subject::Gcps)));
    let table = "x,y,score,cov_xx,cov_xy,cov_yy,area,width,height,elevation,code\n12.5,40.25,3.5,0.01,0,0.01,96,12,12,80.1,aruco-4x4-50:7\n100,200,,,,,,,,,\n";
    survive(&[("c.csv", table)], |path| drop(candidate_list::read_csv(path)));
    let result = r#"{"schema_version":1,"program":"autoref-stream 0.1.0","status":"refused","reason":"x","image":null,"gcp_file":"a","options":{},"geotransform":null,"crs":null,"rmse_m":null,"rmse_e_m":null,"rmse_n_m":null,"rmse_px":null,"scale_m_per_px":null,"rotation_deg":null,"gcps_listed":3,"gcps_in_image":null,"candidates_found":0,"false_alarms":null,"log10_false_alarms":null,"matches":[],"check_points":[],"accuracy":null,"solution":null,"runner_up":null,"best_pattern":null,"search":{"hypotheses_possible":1.0,"hypotheses_tried":1,"budget_spent":false},"prior_georeference":null,"patch":null,"reading":null,"memory_plan":null,"peak_memory_bytes":null,"elapsed_s":0.1}"#;
    survive(&[("r.autoref.json", result)], |path| drop(RunResult::read(path)));
}

#[test]
fn definitions_of_systems() {
    let mut random = Random::new(5);
    let wkt = Crs::from_epsg(25832).expect("a zone").wkt().to_owned();
    for text in ["EPSG:25832+5941", "+proj=utm +zone=32 +ellps=GRS80 +units=m", "WGS84 UTM 32N", wkt.as_str()] {
        for _ in 0..trials(100, 5_000) {
            let bytes = broken(text.as_bytes(), &mut random);
            let _ = Crs::parse(&String::from_utf8_lossy(&bytes));
        }
    }
}
