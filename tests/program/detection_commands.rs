//! The commands around detection, from the command line: profiles learned from a list, windows around listed marks, the
//! fixed scale of 16-bit samples.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use autoref_stream::gcp::Gcp;
use autoref_stream::profile::{CentreMode, Ordering, Profile, TooClose};
use autoref_synth::{self as synth, Compression, MarkSize, MarkStyle, Output as File, SynthSpec, Truth};
use gdal::raster::{Buffer, RasterCreationOptions};
use serde_json::Value;

fn autoref(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_autoref-stream")).args(args).output().expect("the program starts")
}

fn text(path: &Path) -> &str {
    path.to_str().expect("plain")
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// A JSON document on standard output, of a run that ended well.
fn json(args: &[&str]) -> Value {
    let output = autoref(args);
    assert_eq!(output.status.code(), Some(0), "{args:?}: {}", stderr(&output));
    serde_json::from_slice(&output.stdout).expect("one JSON document")
}

/// A sample with violet marks, which no shipped profile knows; everything in `folder`.
struct Sample {
    folder: tempfile::TempDir,
    spec: SynthSpec,
    truth: Truth,
}

impl Sample {
    fn new(change: impl FnOnce(&mut SynthSpec)) -> Sample {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let mut spec = SynthSpec {
            gcps: synth::random_gcps(12, 22.0, 17.0, 4),
            size_px: Some((800, 620)),
            rotation_deg: 9.0,
            clutter: 12,
            mark: MarkStyle {
                size: MarkSize::Px(13.0),
                paints: vec!["#7828c8".parse().expect("a colour")],
                ..MarkStyle::default()
            },
            output: File { compression: Compression::Deflate, ..File::default() },
            ..SynthSpec::default()
        };
        change(&mut spec);
        let truth = synth::write(&spec, &folder.path().join("image.tif")).expect("a sample");
        synth::write_gcp_geojson(&folder.path().join("points.geojson"), &spec.gcps, Some(32632)).expect("a list");
        Sample { folder, spec, truth }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Writes a placement into the image's tags.
    fn place(&self, transform: [f64; 6], crs: Option<&str>) {
        let mut file = gdal::Dataset::open_ex(
            self.path("image.tif"),
            gdal::DatasetOptions { open_flags: gdal::GdalOpenFlags::GDAL_OF_UPDATE, ..Default::default() },
        )
        .expect("a TIFF that can be written to");
        file.set_geo_transform(&transform).expect("writable");
        if let Some(crs) = crs {
            let crs = gdal::spatial_ref::SpatialRef::from_definition(crs).expect("known");
            file.set_spatial_ref(&crs).expect("writable");
        }
        file.close().expect("written");
    }

    fn found(&self, profile: &Path) -> usize {
        let list = json(&["detect", text(&self.path("image.tif")), "--profile", text(profile), "--json"]);
        let candidates = list["candidates"].as_array().expect("a list");
        let near = |x: f64, y: f64| {
            candidates.iter().any(|c| {
                let at = |axis: &str| c["centre"][axis].as_f64().expect("a number");
                (at("x") - x).hypot(at("y") - y) < 1.0
            })
        };
        self.truth.visible().filter(|gcp| near(gcp.x, gcp.y)).count()
    }

    fn sample(&self, list: &str, extra: &[&str]) -> Value {
        let (image, list) = (self.path("image.tif"), self.path(list));
        let profile = self.path("taught.toml");
        let mut args =
            vec!["sample", text(&image), "--gcps", text(&list), "-o", text(&profile), "--overwrite", "--json"];
        args.extend(extra);
        json(&args)
    }
}

fn names(value: &Value) -> Vec<&str> {
    value.as_array().expect("a list").iter().map(|v| v.as_str().expect("a name")).collect()
}

/// The list in another system, as CSV.
fn rewritten(sample: &Sample, name: &str, epsg: u32, extra: &[Gcp]) {
    use autoref_raster::crs::{Coordinate, Crs};
    let (from, to) = (Crs::from_epsg(32632).expect("known"), Crs::from_epsg(epsg).expect("known"));
    let mut out = String::from("name,easting,northing\n");
    let all = sample.spec.gcps.iter().map(|g| (g.name.clone(), g.easting, g.northing));
    for (name, x, y) in all.chain(extra.iter().map(|g| (g.name.clone(), g.easting, g.northing))) {
        let mut point = [Coordinate { x, y, height: None }];
        from.transform(&mut point, &to, 5.0).expect("one datum");
        out += &format!("{name},{:.10},{:.10}\n", point[0].x, point[0].y);
    }
    std::fs::write(sample.path(name), out).expect("writable");
}

#[test]
fn a_solved_image_teaches_its_marks() {
    // Georeferenced by the program itself: orange marks are found, then learned at the points of the list.
    let sample = Sample::new(|spec| {
        spec.mark.paints = vec!["orange".parse().expect("a paint")];
        spec.clutter = 0;
    });
    let (image, list) = (sample.path("image.tif"), sample.path("points.geojson"));
    assert_eq!(autoref(&[text(&image), "--gcps", text(&list), "--no-report"]).status.code(), Some(0));
    let taught = sample.sample("points.geojson", &[]);
    let visible = sample.truth.visible().count();
    assert_eq!(taught["profile"]["learned"]["marks"], visible, "{taught}");
    let side = taught["profile"]["learned"]["side_px_median"].as_f64().expect("a number");
    assert!((side - 13.0).abs() < 1.5, "{side}");
    let profile = Profile::load(text(&sample.path("taught.toml"))).expect("a profile");
    assert_eq!(profile.learned.expect("statistics").marks, visible as u64);
    assert_eq!(sample.found(&sample.path("taught.toml")), visible);
    // The same windows as pictures.
    let chips = sample.path("chips");
    let written =
        json(&["chips", text(&image), "--gcps", text(&list), "-o", text(&chips), "--side-px", "31", "--json"]);
    assert_eq!(names(&written["files_written"]).len(), visible + 1);
    assert!(chips.join(format!("{}.png", sample.spec.gcps[0].name)).exists());
}

#[test]
fn every_placement_that_is_read_places_the_list() {
    let sample = Sample::new(|_| ());
    let visible = sample.truth.visible().count();
    let transform = sample.truth.geotransform.0;
    let learned = |list: &str, extra: &[&str]| {
        let taught = sample.sample(list, extra);
        assert_eq!(taught["profile"]["learned"]["marks"], visible, "{list}: {taught}");
        assert_eq!(sample.found(&sample.path("taught.toml")), visible, "{list}");
    };
    // A world file, then tags without a CRS: the numbers of the list are taken as they are.
    rewritten(&sample, "plain.csv", 32632, &[]);
    let [e, a, b, n, d, f] = transform;
    let centre = (e + (a + b) / 2.0, n + (d + f) / 2.0);
    std::fs::write(sample.path("image.tfw"), format!("{a}\n{d}\n{b}\n{f}\n{}\n{}\n", centre.0, centre.1))
        .expect("writable");
    learned("plain.csv", &[]);
    std::fs::remove_file(sample.path("image.tfw")).expect("it was written");
    sample.place(transform, None);
    learned("plain.csv", &[]);
    // Tags with one: lists in degrees and in another zone.
    sample.place(transform, Some("EPSG:32632"));
    learned("points.geojson", &[]);
    rewritten(&sample, "degrees.csv", 4326, &[]);
    learned("degrees.csv", &["--crs", "EPSG:4326"]);
    rewritten(&sample, "zone.csv", 32633, &[]);
    learned("zone.csv", &["--crs", "EPSG:32633"]);
}

#[test]
fn an_image_in_degrees_or_feet_places_the_list() {
    use autoref_raster::coords::PixelPoint;
    use autoref_raster::crs::{Coordinate, Crs};
    let sample = Sample::new(|_| ());
    let visible = sample.truth.visible().count();
    // Degrees: the affine transform through three corners, good to far below a pixel over 40 m.
    let (from, to) = (Crs::from_epsg(32632).expect("known"), Crs::from_epsg(4326).expect("known"));
    let corner = |x: f64, y: f64| {
        let map = sample.truth.geotransform.apply(PixelPoint { x, y });
        let mut point = [Coordinate { x: map.easting, y: map.northing, height: None }];
        from.transform(&mut point, &to, 5.0).expect("one datum");
        (point[0].x, point[0].y)
    };
    let (o, r, d) = (corner(0.0, 0.0), corner(800.0, 0.0), corner(0.0, 620.0));
    let degrees = [o.0, (r.0 - o.0) / 800.0, (d.0 - o.0) / 620.0, o.1, (r.1 - o.1) / 800.0, (d.1 - o.1) / 620.0];
    sample.place(degrees, Some("EPSG:4326"));
    assert_eq!(sample.sample("points.geojson", &[])["profile"]["learned"]["marks"], visible);
    let feet = sample.truth.geotransform.0.map(|metres| metres / (1200.0 / 3937.0));
    sample.place(feet, Some("+proj=utm +zone=32 +datum=WGS84 +units=us-ft +type=crs"));
    assert_eq!(sample.sample("points.geojson", &[])["profile"]["learned"]["marks"], visible);
}

#[test]
fn points_outside_hidden_or_of_another_colour_are_named() {
    let nine = |spec: &mut SynthSpec| {
        spec.visible = synth::Visible::Named(spec.gcps[..9].iter().map(|g| g.name.clone()).collect());
    };
    // A green car stands over one of the points that have no mark.
    let plan = Sample::new(nine);
    let covered = plan.spec.gcps[9..]
        .iter()
        .map(|g| {
            let map = autoref_raster::coords::MapPoint { easting: g.easting, northing: g.northing };
            (g.name.as_str(), plan.truth.geotransform.invert(map).expect("a rotation"))
        })
        .find(|(_, at)| (50.0..750.0).contains(&at.x) && (50.0..570.0).contains(&at.y));
    let (covered, at) = covered.expect("one of three lies well inside");
    let sample = Sample::new(|spec| {
        nine(spec);
        let green = MarkStyle { paints: vec!["#00e63c".parse().expect("a colour")], ..spec.mark.clone() };
        spec.placed = vec![synth::PlacedMark { name: "car".into(), x: at.x, y: at.y, style: Some(green) }];
    });
    sample.place(sample.truth.geotransform.0, Some("EPSG:32632"));
    let far = Gcp::control("far", sample.spec.gcps[0].easting + 5000.0, sample.spec.gcps[0].northing);
    rewritten(&sample, "more.csv", 32632, &[far]);
    let taught = sample.sample("more.csv", &["--crs", "EPSG:32632"]);
    let mut outside = names(&taught["outside"]);
    assert_eq!(outside.pop(), Some("far"));
    let mut left: Vec<&str> =
        taught["left_out"].as_array().expect("a list").iter().map(|m| m["name"].as_str().expect("a name")).collect();
    let bare: Vec<&str> = sample.spec.gcps[9..].iter().map(|g| g.name.as_str()).collect();
    let reason = taught["left_out"].as_array().and_then(|all| all.iter().find(|m| m["name"] == covered));
    assert!(reason.is_some_and(|m| m["reason"].to_string().contains("colour")), "{taught}");
    left.extend(outside);
    left.sort_unstable();
    assert_eq!(left, bare);
    assert_eq!(sample.found(&sample.path("taught.toml")), 9);

    let refused = |args: &[&str], word: &str| {
        let output = autoref(args);
        let message = stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{args:?}: {message}");
        assert!(message.contains(word) && message.trim_end().lines().count() == 1, "{message}");
    };
    let image = sample.path("image.tif");
    // Nothing inside, no georeference, nothing pointed at.
    std::fs::write(sample.path("away.csv"), "name,easting,northing\na,100,200\nb,300,100\n").expect("writable");
    refused(
        &["sample", text(&image), "--gcps", text(&sample.path("away.csv")), "--crs", "EPSG:32632"],
        "none of its 2",
    );
    refused(&["sample", text(&image)], "--at");
    let bare = Sample::new(|_| ());
    let list = bare.path("points.geojson");
    refused(&["sample", text(&bare.path("image.tif")), "--gcps", text(&list)], "no georeference");
}

/// A copy of the 8-bit image in 16 bits, every sample through `scale`.
fn widened(from: &Path, to: &Path, options: &[&str], metadata: Option<&str>, scale: impl Fn(u8) -> u16) {
    let source = gdal::Dataset::open(from).expect("an image");
    let (width, height) = source.raster_size();
    let driver = gdal::DriverManager::get_driver_by_name("GTiff").expect("GDAL has it");
    let options = RasterCreationOptions::from_iter(options.iter().copied());
    let mut out =
        driver.create_with_band_type_with_options::<u16, _>(to, width, height, 3, &options).expect("a new file");
    if let Some(value) = metadata {
        use gdal::Metadata;
        out.set_metadata_item("TIFFTAG_MAXSAMPLEVALUE", value, "").expect("kept");
    }
    for band in 1..=3 {
        let read =
            source.rasterband(band).expect("three bands").read_as::<u8>((0, 0), (width, height), (width, height), None);
        let data = read.expect("readable").data().iter().map(|&v| scale(v)).collect();
        let mut buffer = Buffer::new((width, height), data);
        out.rasterband(band).expect("three bands").write((0, 0), (width, height), &mut buffer).expect("written");
    }
    out.close().expect("written");
}

#[test]
fn sixteen_bit_copies_give_the_candidates_of_the_original() {
    let sample = Sample::new(|spec| {
        spec.mark.paints = vec!["orange".parse().expect("a paint")];
        spec.clutter = 40;
    });
    let image = sample.path("image.tif");
    let detect = |image: &Path, extra: &[&str]| {
        let mut args = vec!["detect", text(image), "--quiet"];
        args.extend(extra);
        let output = autoref(&args);
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        String::from_utf8(output.stdout).expect("CSV")
    };
    let original = detect(&image, &[]);
    assert!(original.lines().count() > sample.truth.visible().count(), "{original}");
    let wide = sample.path("wide.tif");
    // Exact multiples: not a byte differs, whether the file or the caller says what white is.
    widened(&image, &wide, &["TILED=YES"], None, |v| u16::from(v) * 257);
    assert_eq!(original, detect(&wide, &[]), "16 bits");
    widened(&image, &wide, &["COMPRESS=LZW"], None, |v| u16::from(v) * 16);
    assert_eq!(original, detect(&wide, &["--white", "4080"]), "12 bits in 16, by --white");
    assert_ne!(original, detect(&wide, &[]), "sixteen times too dark");
    // Rounded to 12 bits: the same marks, centres apart by less than a two-hundredth of a pixel.
    let centres = |list: &str| -> Vec<(f64, f64)> {
        let mut reader = csv::Reader::from_reader(list.as_bytes());
        let header = reader.headers().expect("a header").clone();
        let column = |name: &str| header.iter().position(|h| h == name).expect("a column");
        let (x, y) = (column("x"), column("y"));
        let number = |r: &csv::StringRecord, i: usize| r[i].parse::<f64>().expect("a number");
        reader.records().map(|r| r.expect("a row")).map(|r| (number(&r, x), number(&r, y))).collect()
    };
    let twelve = |v: u8| ((u32::from(v) * 4095 + 127) / 255) as u16;
    let by_caller: &[&str] = &["--white", "4095"];
    let cases: [(&[&str], Option<&str>, &[&str]); 4] = [
        (&["NBITS=12"], None, &[]),
        (&[], Some("4095"), &[]),
        (&["TILED=YES", "COMPRESS=DEFLATE"], None, by_caller),
        // What the file says gives way to the caller.
        (&[], Some("1023"), by_caller),
    ];
    for (options, metadata, extra) in cases {
        widened(&image, &wide, options, metadata, twelve);
        for reader in ["auto", "gdal"] {
            let mut extra = extra.to_vec();
            extra.extend(["--reader", reader]);
            let (a, b) = (centres(&original), centres(&detect(&wide, &extra)));
            assert_eq!(a.len(), b.len(), "{options:?} {metadata:?} {extra:?}");
            for (a, b) in a.iter().zip(&b) {
                assert!((a.0 - b.0).hypot(a.1 - b.1) < 0.005, "{options:?} {metadata:?}: {a:?} {b:?}");
            }
        }
    }
    // The main job and the other commands take it too.
    widened(&image, &wide, &["COMPRESS=LZW"], None, |v| u16::from(v) * 16);
    let list = sample.path("points.geojson");
    assert_eq!(autoref(&[text(&wide), "--gcps", text(&list), "--no-report"]).status.code(), Some(1));
    let solved = json(&[text(&wide), "--gcps", text(&list), "--white", "4080", "--no-report", "--overwrite", "--json"]);
    assert_eq!(solved["options"]["white"], 4080);
    let taught = json(&["sample", text(&wide), "--gcps", text(&list), "--white", "4080", "--json"]);
    let red = taught["profile"]["learned"]["mean_srgb"][0].as_f64().expect("a number");
    assert!(red > 0.6, "{red}");
    let distances = |white: &[&str], name: &str| {
        let out = sample.path(name);
        let mut args = vec!["distance", text(&wide), "-o", text(&out), "--normalised"];
        args.extend(white);
        assert_eq!(autoref(&args).status.code(), Some(0));
        let band = gdal::Dataset::open(&out).expect("written");
        let band = band.rasterband(1).expect("one band");
        let values = band.read_as::<f32>((0, 0), (800, 620), (800, 620), None).expect("readable");
        values.data().iter().filter(|v| **v <= 1.0).count()
    };
    assert!(distances(&["--white", "4080"], "right.tif") > 500);
    assert_eq!(distances(&[], "dark.tif"), 0);
    // No sample of an 8-bit image reaches 4095; 0 is no white.
    let message = stderr(&autoref(&["detect", text(&image), "--white", "4095"]));
    assert!(message.contains("--white 4095") && message.trim_end().lines().count() == 1, "{message}");
    assert_eq!(autoref(&["detect", text(&image), "--white", "0"]).status.code(), Some(2));
}

/// Every key that the table of options names exists, and the profile of the prototype has the prototype's defaults.
#[test]
fn the_table_of_options_names_what_exists() {
    let page = std::fs::read_to_string(crate::common::root().join("docs/detection-options.md")).expect("the page");
    let rooms = ["colour", "gates", "filters", "examine", "size", "target"];
    let keys: std::collections::BTreeSet<&str> = page
        .split('`')
        .skip(1)
        .step_by(2)
        .filter(|word| {
            word.split_once('.').is_some_and(|(room, key)| rooms.contains(&room) && !key.contains([' ', '=']))
        })
        .collect();
    assert!(keys.len() > 30, "{keys:?}");
    let orange = Profile::builtin("orange").expect("shipped").to_toml();
    for key in keys {
        let (room, name) = key.split_once('.').expect("two parts");
        // A key that exists is refused for its value, or taken; one that does not is called unknown.
        let line = format!("{name} = []\n");
        let heading = format!("[{room}]\n");
        let text = match orange.find(&heading) {
            Some(at) => {
                let at = at + heading.len();
                let rest: Vec<&str> = orange[at..].lines().filter(|l| !l.starts_with(&format!("{name} ="))).collect();
                format!("{}{line}{}\n", &orange[..at], rest.join("\n"))
            }
            None => format!("{orange}\n{heading}{line}"),
        };
        let what = Profile::parse(&text).err().map(|(_, what)| what).unwrap_or_default();
        assert!(!what.contains("unknown field") && !what.contains("duplicate"), "{key}: {what}");
    }
    let p = Profile::builtin("autoref-2016").expect("shipped");
    assert!((p.colour.limit.powi(2) - 6.0).abs() < 1e-9);
    assert!(p.colour.rough.as_ref().is_some_and(|r| (r.limit.powi(2) - 20.0).abs() < 1e-9));
    assert!(p.colour.rough_box.is_some());
    assert_eq!((p.gates.min_side_px, p.gates.min_area_px, p.gates.max_area_px), (Some(3), Some(10), Some(300)));
    assert_eq!((p.gates.max_eccentricity, p.gates.min_solidity, p.gates.max_solidity), (Some(0.9), None, None));
    assert_eq!((p.gates.min_tightness, p.gates.max_tightness), (Some(0.4), Some(0.9)));
    assert_eq!((p.filters.median, p.filters.closing_radius_px, p.filters.fill_holes), (true, 5, true));
    assert_eq!((p.examine.too_close, p.examine.min_distance_px), (TooClose::Probable, 30.0));
    assert_eq!((p.examine.centre, p.examine.order), (CentreMode::Centroid, Ordering::Closeness));
}

#[test]
fn lessons_give_rough_boxes_and_densities() {
    let sample = Sample::new(|spec| spec.clutter = 0);
    sample.place(sample.truth.geotransform.0, Some("EPSG:32632"));
    let visible = sample.truth.visible().count();
    let box_of = |extra: &[&str]| {
        let taught = sample.sample("points.geojson", extra);
        let rough = taught["profile"]["colour"]["rough_box"].clone();
        assert!(sample.found(&sample.path("taught.toml")) * 10 >= visible * 9, "{extra:?}");
        let width = |c: usize| rough["high"][c].as_f64().expect("a box") - rough["low"][c].as_f64().expect("a box");
        (0..3).map(width).collect::<Vec<_>>()
    };
    let (all, middle, wide) =
        (box_of(&["--rough-box", "1"]), box_of(&["--rough-box", "0.9"]), box_of(&["--rough-box", "3sd"]));
    assert!((0..3).all(|c| middle[c] > 0.0 && middle[c] < all[c] && wide[c] > 0.0), "{all:?} {middle:?} {wide:?}");
    let taught = sample.sample("points.geojson", &["--density"]);
    assert_eq!(taught["profile"]["examine"]["density"]["min_probability"], 1e-7);
    assert!(sample.found(&sample.path("taught.toml")) * 10 >= visible * 9, "{taught}");
    for bad in ["0", "1.5", "-1sd", "sd", "half"] {
        let image = sample.path("image.tif");
        assert_eq!(
            autoref(&["sample", text(&image), "--at", "5,5", "--rough-box", bad]).status.code(),
            Some(2),
            "{bad}"
        );
    }
}

/// A mask, polygons on the map and in pixels, and a table of the colours below the mask teach what pointing teaches.
#[test]
fn outlines_and_tables_teach_like_a_finger() {
    let sample = Sample::new(|spec| spec.clutter = 0);
    sample.place(sample.truth.geotransform.0, Some("EPSG:32632"));
    let image = sample.path("image.tif");
    let marks: Vec<_> = sample.truth.visible().collect();
    let (width, height) = (800usize, 620usize);
    // The inner 7 x 7 pixels of each mark.
    let inner = |x: f64, y: f64| {
        let (x, y) = (x as usize, y as usize);
        (y - 3..=y + 3).flat_map(move |v| (x - 3..=x + 3).map(move |u| v * width + u))
    };
    let mut mask = vec![0u8; width * height];
    marks.iter().flat_map(|m| inner(m.x, m.y)).for_each(|i| mask[i] = 255);
    let driver = gdal::DriverManager::get_driver_by_name("GTiff").expect("GDAL has it");
    let file = driver.create_with_band_type::<u8, _>(sample.path("mask.tif"), width, height, 1).expect("writable");
    file.rasterband(1)
        .and_then(|mut band| band.write((0, 0), (width, height), &mut Buffer::new((width, height), mask.clone())))
        .expect("writable");
    file.close().expect("written");
    let polygons = |name: &str, place: &dyn Fn(f64, f64) -> [f64; 2], crs: &str| {
        let square = |m: &&autoref_synth::TruthGcp| {
            let (x, y) = (m.x.floor(), m.y.floor());
            let corners = [(-3.0, -3.0), (4.0, -3.0), (4.0, 4.0), (-3.0, 4.0), (-3.0, -3.0)];
            let ring: Vec<[f64; 2]> = corners.iter().map(|(dx, dy)| place(x + dx, y + dy)).collect();
            serde_json::json!({"type": "Feature", "properties": {"name": m.name},
                "geometry": {"type": "Polygon", "coordinates": [ring]}})
        };
        let features: Vec<Value> = marks.iter().map(square).collect();
        let mut document = serde_json::json!({"type": "FeatureCollection", "features": features});
        if !crs.is_empty() {
            document["crs"] = serde_json::json!({"type": "name", "properties": {"name": crs}});
        }
        std::fs::write(sample.path(name), document.to_string()).expect("writable");
        sample.path(name)
    };
    let transform = sample.truth.geotransform;
    let on_map = polygons(
        "map.geojson",
        &|x, y| {
            let p = transform.apply(autoref_raster::coords::PixelPoint { x, y });
            [p.easting, p.northing]
        },
        "urn:ogc:def:crs:EPSG::32632",
    );
    let pixels = polygons("pixels.geojson", &|x, y| [x, y], "urn:ogc:def:crs:EPSG::32632");
    let teach = |extra: &[&str]| {
        let profile = sample.path("taught.toml");
        let page = sample.path("colours.html");
        let mut args = vec!["sample", "-o", text(&profile), "--html", text(&page), "--overwrite", "--json"];
        args.extend(extra);
        let taught = json(&args);
        assert_eq!(taught["files_written"].as_array().map(Vec::len), Some(2));
        let page = std::fs::read_to_string(&page).expect("written");
        assert!(page.contains("Correlation with a*") && page.contains("<circle"), "{page}");
        assert!(sample.found(&profile) * 10 >= marks.len() * 9, "{extra:?}: {} found", sample.found(&profile));
        taught
    };
    let by_mask = teach(&[text(&image), "--mask", text(&sample.path("mask.tif"))]);
    let by_map = teach(&[text(&image), "--polygons", text(&on_map)]);
    let by_pixels = teach(&[text(&image), "--polygons", text(&pixels)]);
    assert_eq!(by_map["statistics"], by_pixels["statistics"]);
    assert_eq!(by_mask["statistics"]["samples"], marks.len() * 49);
    assert_eq!(by_mask["profile"]["learned"]["marks"], marks.len());
    // The colours below the mask as a table.
    let picture = gdal::Dataset::open(&image).expect("opens");
    let band = |n| picture.rasterband(n).and_then(|b| b.read_band_as::<u8>()).expect("readable");
    let bands = [band(1), band(2), band(3)];
    let mut table = String::from("red,green,blue\n");
    for i in (0..width * height).filter(|&i| mask[i] > 0) {
        let [r, g, b] = [0, 1, 2].map(|c: usize| bands[c].data()[i]);
        table += &format!("{r},{g},{b}\n");
    }
    let colours = sample.path("colours.csv");
    std::fs::write(&colours, table).expect("writable");
    let by_table = teach(&["--colours", text(&colours), "--mark-size", "10..16", "--rough-box", "3sd,4sd,5sd"]);
    assert_eq!(by_table["statistics"]["samples"], by_mask["statistics"]["samples"]);
    for space in ["rgb", "lab"] {
        for c in 0..3 {
            let of = |taught: &Value| taught["statistics"][space]["mean"][c].as_f64().expect("a number");
            assert!((of(&by_table) - of(&by_mask)).abs() < 1e-9 && (of(&by_map) - of(&by_mask)).abs() < 1e-9);
        }
    }
    let wide = |taught: &Value, c: usize| {
        let bound = |which: &str| taught["profile"]["colour"]["rough_box"][which][c].as_f64().expect("a box");
        let spread = taught["statistics"]["rgb"]["covariance"][c][c].as_f64().expect("a number").sqrt();
        (bound("high") - bound("low")) / spread
    };
    assert!((wide(&by_table, 2) / wide(&by_table, 0) - 5.0 / 3.0).abs() < 1e-6);
    refused_outlines(&sample, &image);
}

fn refused_outlines(sample: &Sample, image: &Path) {
    let file = |name: &str, text: &str| {
        std::fs::write(sample.path(name), text).expect("writable");
        sample.path(name)
    };
    let away = r#"{"type":"Feature","properties":{},"geometry":{"type":"Polygon","coordinates":[[[0,70],[1,70],[1,71],[0,70]]]}}"#;
    let points = r#"{"type":"Feature","properties":{},"geometry":{"type":"Point","coordinates":[5,5]}}"#;
    let driver = gdal::DriverManager::get_driver_by_name("GTiff").expect("GDAL has it");
    for (name, side) in [("small.tif", (10, 10)), ("empty.tif", (800, 620))] {
        let made = driver.create_with_band_type::<u8, _>(sample.path(name), side.0, side.1, 1).expect("writable");
        made.close().expect("written");
    }
    for (option, path, words) in [
        ("--mask", sample.path("small.tif"), "is 10 × 10 pixels"),
        ("--mask", sample.path("empty.tif"), "no pixel of it is set"),
        ("--mask", file("no.tif", "no raster"), "no.tif"),
        ("--polygons", file("away.geojson", away), "none of its 1 polygons lies in the image"),
        ("--polygons", file("points.json", points), "no polygon in it"),
    ] {
        let output = autoref(&["sample", text(image), option, text(&path)]);
        let said = stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{said}");
        assert!(said.contains(words) && said.trim_end().lines().count() == 1, "{said}");
    }
    for (table, words) in [("1,2\n", "row 1"), ("1,2,3\n4,5,6\n", "2 colours say too little")] {
        let output = autoref(&["sample", "--colours", text(&file("few.csv", table))]);
        let said = stderr(&output);
        assert!(output.status.code() == Some(2) && said.contains(words) && said.contains("few.csv"), "{said}");
    }
}

/// Rules over named properties: a bound in or out decides, probabilities are there, unknown names are refused with
/// their column.
#[test]
fn gates_of_ones_own() {
    use autoref_synth::{self as synth, MarkSize, MarkStyle, SynthSpec, Visible};
    let folder = tempfile::tempdir().expect("a temporary folder");
    let image = folder.path().join("a.tif");
    let spec = SynthSpec {
        gcps: synth::random_gcps(8, 30.0, 20.0, 3),
        size_px: Some((1100, 800)),
        visible: Visible::All,
        mark: MarkStyle { size: MarkSize::Px(14.0), ..MarkStyle::default() },
        ..SynthSpec::default()
    };
    synth::write(&spec, &image).expect("a sample");
    let detect = |rules: &[&str]| {
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_autoref-stream"));
        command.arg("detect").arg(&image).arg("--json");
        for rule in rules {
            command.args(["--gate", rule]);
        }
        command.output().expect("it runs")
    };
    let count = |rules: &[&str]| {
        let finished = detect(rules);
        assert_eq!(finished.status.code(), Some(0), "{rules:?}: {}", String::from_utf8_lossy(&finished.stderr));
        let document: serde_json::Value = serde_json::from_slice(&finished.stdout).expect("one document");
        let candidates = document["candidates"].as_array().expect("a list").clone();
        for candidate in &candidates {
            let (score, probability) = (candidate["score"].as_f64(), candidate["probability"].as_f64());
            assert_eq!(probability, score.map(|s| 1.0 / (1.0 + (-s).exp())));
        }
        candidates.len()
    };
    let all = count(&[]);
    assert!(all >= 6, "{all}");
    assert_eq!(count(&["area > 0 and extent in (0, 1] and solidity <= 1 and perimeter >= width"]), all);
    assert_eq!(count(&["area < 0 or eccentricity > 1"]), 0);
    assert_eq!(count(&["area > 50", "not area > 50"]), 0);
    assert_eq!(count(&["mean_distance > 50"]), 0);
    let (small, large) = (count(&["area < 150"]), count(&["area >= 150"]));
    assert_eq!(small + large, all);
    for (rule, words) in [("area > 2 and roundness > 1", "column 14: `roundness`"), ("area >", "the rule ends")] {
        let finished = detect(&[rule]);
        let said = String::from_utf8_lossy(&finished.stderr).into_owned();
        assert!(finished.status.code() == Some(2) && said.contains(words), "{said}");
    }
}
